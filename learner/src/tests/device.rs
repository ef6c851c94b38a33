//! A GPU against the CPU's kernels, on whatever Vulkan device the machine has.

use policy::{DeviceError, DeviceKind, MoveHead, NetworkConfig};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

use super::learning::{bandit, learn, small_setup};
use crate::{Learner, LearnerError, LearnerSetup};

/// The paper's network, and one gradient step per update.
fn setup(move_head: MoveHead) -> LearnerSetup {
    small_setup(1)
        .with_policy(|c| c.network = NetworkConfig { move_head, ..Default::default() })
        .with(|c| (c.n_epochs, c.minibatch_size) = (1, 256))
        .at_rate(3e-4)
}

/// Without the cargo feature, a GPU is refused, and the rest is compiled all the same.
#[test]
fn an_update_on_a_gpu_equals_one_on_a_cpu() {
    for move_head in [MoveHead::Gaussian, MoveHead::Mixture] {
        let setup = setup(move_head);
        if !cfg!(feature = "gpu") {
            let refused = Learner::new(LearnerSetup { device: DeviceKind::Gpu, ..setup }).err().unwrap();
            assert!(matches!(refused, LearnerError::Device(DeviceError::NotBuiltIn)), "{refused}");
            continue;
        }
        let trajectories = {
            let learner = Learner::new(setup.clone()).unwrap();
            bandit(&setup, &learner.weights(), 256, &mut ChaCha8Rng::seed_from_u64(2))
        };
        let [cpu, gpu] = [DeviceKind::Cpu, DeviceKind::Gpu].map(|device| {
            let mut learner = Learner::new(LearnerSetup { device, ..setup.clone() }).unwrap();
            let before = learner.weights().parameters;
            let metrics = learn(&mut learner, trajectories.clone()).metrics.ppo;
            (metrics, before, learner.weights().parameters)
        });
        assert_eq!(cpu.1, gpu.1, "the same initial parameters");
        let close = |name: &str, a: f64, b: f64| {
            assert!(
                (a - b).abs() <= 1e-3 * a.abs().max(1e-3),
                "{move_head:?}: {name} is {a} on the CPU, {b} on the GPU"
            );
        };
        close("the policy loss", cpu.0.policy_loss, gpu.0.policy_loss);
        close("the value loss", cpu.0.value_loss, gpu.0.value_loss);
        close("the entropy of blocks", cpu.0.entropy_blocks, gpu.0.entropy_blocks);
        close("the entropy of moves", cpu.0.entropy_moves, gpu.0.entropy_moves);
        close("the norm of the gradient", cpu.0.grad_norm, gpu.0.grad_norm);
        close("the effective sample size", cpu.0.effective_sample_size, gpu.0.effective_sample_size);
        // Adam's first step is the rate times the sign of the gradient, and the sign of one near 0 is a matter of
        // rounding: nearly all parameters agree.
        let rate = setup.config.optimizer.learning_rate;
        let n_off = cpu.2.iter().zip(&gpu.2).filter(|(a, b)| (*a - *b).abs() > 0.05 * rate).count();
        let share = n_off as f64 / cpu.2.len() as f64;
        println!("{move_head:?}: {n_off} of {} parameters differ by more than 5 % of a step", cpu.2.len());
        assert!(share < 0.01, "{move_head:?}: {share} of the parameters differ");
    }
}

//! Measures the time of a PPO update with the paper's network, in milliseconds per sample and epoch.
//!
//! `cargo bench -p lab --bench update -- [SAMPLES [THREADS]]`; the default is 1024 samples on one thread.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::time::Instant;

use blueprints::{BlockIdx, BlueprintId, Catalog, N_BLOCKS};
use learner::{DeviceKind, Learner, LearnerConfig, LearnerSetup};
use proto::{Action, ActorId, Pose, RewardTerms, Scene, Start, Status, Task, Trajectory, Transition, Valid};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Number of steps per segment.
const SEGMENT: usize = 32;

fn main() {
    let mut numbers = std::env::args().filter_map(|argument| argument.parse::<usize>().ok());
    let (n_samples, n_threads) = (numbers.next().unwrap_or(1024), numbers.next().unwrap_or(1));
    let id = BlueprintId::try_from("2_000".to_owned()).unwrap();
    let config = LearnerConfig {
        batch_size: n_samples,
        minibatch_size: 256,
        n_threads: Some(n_threads),
        ..LearnerConfig::default()
    };
    let setup = LearnerSetup {
        config: Valid::new(config).unwrap(),
        policy: Valid::default(),
        catalog: Catalog::builtin().clone(),
        tasks: vec![id.clone()],
        seed: 0,
        device: DeviceKind::Cpu,
        settings: Default::default(),
        acting: Default::default(),
        init: None,
    };
    let n_epochs = setup.config.n_epochs;
    let mut learner = Learner::new(setup).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    for round in 0..3 {
        for _ in 0..n_samples.div_ceil(SEGMENT) {
            let segment = segment(&id, learner.version().0, &mut rng);
            learner.mailbox().push_beyond_capacity(segment).unwrap();
        }
        let start = Instant::now();
        learner.update_from_mailbox().unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let per_sample = 1000.0 * seconds / (n_samples * n_epochs) as f64;
        println!("round {round}: {seconds:.2} s, {per_sample:.3} ms a sample and epoch");
    }
}

fn segment(id: &BlueprintId, version: u64, rng: &mut ChaCha8Rng) -> Trajectory {
    let transitions = (0..SEGMENT)
        .map(|_| Transition {
            scene: scene(rng),
            action: Action {
                choices: [0; 2].map(|_| BlockIdx::try_from(rng.random_range(0..N_BLOCKS as u8)).ok()),
                moves: std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))),
            },
            proposals: [None; 2],
            behavior_log_prob: -12.0,
            reward: RewardTerms { blocks: rng.random_range(-0.1..0.1), ..RewardTerms::default() },
            disturbance: None,
        })
        .collect();
    let assignment = BlockIdx::array(|block| block);
    Trajectory {
        actor: ActorId::try_from("bench".to_owned()).unwrap(),
        epoch: 0,
        seq: rng.random(),
        weights_version: proto::WeightsVersion(version),
        settings_hash: proto::CanonicalSettings::default().hash(),
        task: Task { blueprint: id.clone(), assignment, start: Start::Scattered, seed: 0 },
        behavior_policy: proto::BehaviorPolicy::Sampled,
        first_step: 0,
        transitions,
        last_scene: scene(rng),
        status: Status::Running,
        episode_stats: None,
    }
}

fn scene(rng: &mut ChaCha8Rng) -> Scene {
    Scene::at_rest(std::array::from_fn(|_| Pose {
        position: [rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), 0.05],
        orientation: [0.0, 0.0, 0.0, 1.0],
    }))
}

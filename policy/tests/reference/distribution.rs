//! The action distribution on slices and tensors against JAX vectors in `f64`, and its sampling.

use crate::common::{floats, golden_path, numbers, read_json, relative_error};
use blueprints::{BlockIdx, N_BLOCKS};
use burn::tensor::{Device, Tensor, TensorData};
use policy::distribution::{ActionDistribution, MASKED_LOGIT, mask_logits};
use policy::loss_terms::{self, ActionTensors};
use policy::{JointForm, MoveTensors, NetworkOutput};
use proptest::prelude::*;
use proto::Action;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

const TOLERANCE: f64 = 2e-5;
const FORMS: [(JointForm, &str); 3] = [
    (JointForm::ChosenUnique, "chosen_unique"),
    (JointForm::ChosenPerGripper, "chosen_per_gripper"),
    (JointForm::Matrix, "matrix_all"),
];

/// Returns two actions per item that differ only where both grippers chose the same block.
///
/// In the golden file's per-gripper form, each gripper has its own move, but an [`Action`] has one per block. A block
/// chosen twice therefore gets gripper 0's move in one action and gripper 1's in the other, and the mean of the two
/// log-probabilities equals the file's.
fn actions(golden: &Value, form: JointForm) -> [Vec<Action>; 2] {
    let blocks = numbers(&golden["action"]["block"]);
    let matrix = floats(&golden["action"]["move_matrix_16x6"]);
    let own = floats(&golden["action"]["move_per_gripper"]);
    [[1, 0], [0, 1]].map(|order| {
        (0..8)
            .map(|item| {
                let choices: [usize; 2] = [0, 1].map(|g| blocks[item * 2 + g] as usize);
                let mut moves: [[f32; 6]; N_BLOCKS] =
                    std::array::from_fn(|b| std::array::from_fn(|k| matrix[(item * N_BLOCKS + b) * 6 + k]));
                if form == JointForm::ChosenPerGripper {
                    for g in order {
                        moves[choices[g]] = std::array::from_fn(|k| own[(item * 2 + g) * 6 + k]);
                    }
                }
                Action { choices: choices.map(|b| BlockIdx::try_from(b as u8).ok()), moves }
            })
            .collect()
    })
}

struct Heads {
    logits: Vec<f32>,
    locs: Vec<f32>,
    scales: Vec<f32>,
}

impl Heads {
    fn read(json: &Value) -> Self {
        Self { logits: floats(&json["grip_logits"]), locs: floats(&json["locs"]), scales: floats(&json["scales"]) }
    }

    fn row(&self, item: usize, form: JointForm) -> ActionDistribution<'_> {
        let moves = item * 96..(item + 1) * 96;
        ActionDistribution::new(
            &self.logits[item * 32..(item + 1) * 32],
            &self.locs[moves.clone()],
            &self.scales[moves],
            form,
        )
    }

    fn tensors(&self, device: &Device) -> NetworkOutput {
        let b = self.logits.len() / 32;
        // A device without autodiff does not support tracking.
        let leaf = |values: &[f32], shape: [usize; 3]| {
            let tensor = Tensor::from_data(TensorData::new(values.to_vec(), shape), device);
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        NetworkOutput {
            moves: Some(MoveTensors { locs: leaf(&self.locs, [b, 16, 6]), scales: leaf(&self.scales, [b, 16, 6]) }),
            logits: leaf(&self.logits, [b, 2, 16]),
            values: Tensor::zeros([b], device),
            readouts: None,
            draws: None,
        }
    }
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().unwrap()
}

#[test]
fn log_probs_match_in_all_forms() {
    let golden = read_json(&golden_path("ppo_policy.json"));
    for (heads, key) in [("new", "logp"), ("old", "logp_old")] {
        let heads = Heads::read(&golden[heads]);
        for (form, name) in FORMS {
            let expected = numbers(&golden["variants"][name][key]);
            let actions = actions(&golden, form);
            let slices: Vec<f32> =
                (0..8).map(|i| actions.iter().map(|a| heads.row(i, form).log_prob(&a[i])).sum::<f32>() / 2.0).collect();
            assert!(relative_error(&slices, &expected) <= TOLERANCE, "{name} {key}: {slices:?}");
            let output = heads.tensors(&Device::flex());
            let tensors =
                actions.map(|a| loss_terms::log_prob(&output, &ActionTensors::new(a.iter(), 2, &Device::flex()), form));
            let [a, b] = tensors;
            assert!(relative_error(&values((a + b) / 2.0), &expected) <= TOLERANCE, "{name} {key} on tensors");
        }
    }
}

#[test]
fn gradients_of_the_clipped_loss_match_in_all_forms() {
    let golden = read_json(&golden_path("ppo_policy.json"));
    let device = Device::flex().autodiff();
    let advantages = floats(&golden["advantages_normalised"]);
    let clip = golden["clip_eps"].as_f64().unwrap();
    for (form, name) in FORMS {
        let output = Heads::read(&golden["new"]).tensors(&device);
        let [a, b] = actions(&golden, form)
            .map(|a| loss_terms::log_prob(&output, &ActionTensors::new(a.iter(), 2, &device), form));
        let vector = |x: &[f32]| Tensor::<1>::from_data(TensorData::new(x.to_vec(), [8]), &device);
        let variant = &golden["variants"][name];
        let ratio = ((a + b) / 2.0 - vector(&floats(&variant["logp_old"]))).exp();
        let advantages = vector(&advantages);
        let clipped = ratio.clone().clamp(1.0 - clip, 1.0 + clip) * advantages.clone();
        let loss = (ratio * advantages).min_pair(clipped).mean().neg();
        let gradients = loss.backward();
        for (key, ours) in [
            ("grad_logits", values(output.logits.grad(&gradients).unwrap())),
            ("grad_locs", values(output.gaussians().locs.grad(&gradients).unwrap())),
            ("grad_scales", values(output.gaussians().scales.grad(&gradients).unwrap())),
        ] {
            let error = relative_error(&ours, &numbers(&variant[key]));
            assert!(error <= TOLERANCE, "{name} {key} is off by {error:e}");
        }
    }
}

#[test]
fn entropies_match_in_all_forms() {
    let golden = read_json(&golden_path("ppo_policy.json"));
    let heads = Heads::read(&golden["new"]);
    for (form, key) in [
        (JointForm::ChosenUnique, "gaussian_expected_unique"),
        (JointForm::ChosenPerGripper, "gaussian_expected_per_gripper"),
        (JointForm::Matrix, "gaussian_all"),
    ] {
        let (blocks, moves): (Vec<f32>, Vec<f32>) =
            (0..8).map(|i| heads.row(i, form).entropy()).map(|e| (e.blocks, e.moves)).unzip();
        let tensors = loss_terms::entropy(&heads.tensors(&Device::flex()), None, form);
        for (ours, key) in [
            (blocks, "categorical"),
            (values(tensors.blocks), "categorical"),
            (moves, key),
            (values(tensors.moves), key),
        ] {
            let error = relative_error(&ours, &numbers(&golden["entropy"][key]));
            assert!(error <= TOLERANCE, "{key} is off by {error:e}");
        }
    }
}

#[test]
fn entropy_gradients_match_in_the_per_gripper_form() {
    let golden = read_json(&golden_path("ppo_policy.json"));
    let output = Heads::read(&golden["new"]).tensors(&Device::flex().autodiff());
    let entropy = loss_terms::entropy(&output, None, JointForm::ChosenPerGripper);
    let gradients = (entropy.blocks + entropy.moves).mean().backward();
    let expected = &golden["entropy_grad_of_mean_per_gripper_form"];
    let logits = values(output.logits.grad(&gradients).unwrap());
    assert!(relative_error(&logits, &numbers(&expected["grad_logits"])) <= TOLERANCE);
    let scales = values(output.gaussians().scales.grad(&gradients).unwrap());
    assert!(relative_error(&scales, &numbers(&expected["grad_scales"])) <= TOLERANCE);
}

#[test]
fn mode_takes_the_largest_logit_and_the_means() {
    let mut logits = [0.0; 32];
    logits[7] = 2.0;
    logits[16 + 3] = 0.5;
    let locs: Vec<f32> = (0..96).map(|k| k as f32).collect();
    let scales = [0.1; 96];
    let action = ActionDistribution::new(&logits, &locs, &scales, JointForm::ChosenUnique).mode();
    assert_eq!(action.choices.map(|c| c.unwrap().get()), [7, 3]);
    assert_eq!(action.moves[15], [90.0, 91.0, 92.0, 93.0, 94.0, 95.0]);
}

#[test]
fn log_prob_of_a_hand_worked_case() {
    // One gripper, equal logits: ln(1/16) = −2.772589. Move at the mean, σ = 0.5: 6 · (−ln 0.5 − 0.918939) = −1.354748.
    let (logits, locs, scales) = ([0.0; 16], [0.0; 96], [0.5; 96]);
    let distribution = ActionDistribution::new(&logits, &locs, &scales, JointForm::ChosenUnique);
    let action = distribution.mode();
    assert_eq!(action.choices, [BlockIdx::try_from(0).ok(), None]);
    assert!((distribution.log_prob(&action) - (-2.772_589 - 1.354_748)).abs() < 1e-5);
}

#[test]
fn samples_follow_the_distribution() {
    let mut logits = [0.0_f32; 16];
    logits[5] = 3.0_f32.ln();
    let (locs, scales) = ([0.25; 96], [0.5; 96]);
    let distribution = ActionDistribution::new(&logits, &locs, &scales, JointForm::ChosenUnique);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (n, mut hits, mut sum, mut squares) = (20_000, 0, 0.0_f64, 0.0_f64);
    for _ in 0..n {
        let action = distribution.sample(&mut rng).unwrap();
        hits += usize::from(action.choices[0].unwrap().get() == 5);
        sum += f64::from(action.moves[2][1]);
        squares += f64::from(action.moves[2][1]).powi(2);
    }
    let (share, mean) = (hits as f64 / f64::from(n), sum / f64::from(n));
    let std = (squares / f64::from(n) - mean * mean).sqrt();
    // Block 5 has a weight of 3 out of 18. Bounds are 4 standard errors.
    assert!((share - 3.0 / 18.0).abs() < 4.0 * 0.373 / 141.0, "{share}");
    assert!((mean - 0.25).abs() < 4.0 * 0.5 / 141.0, "{mean}");
    assert!((std - 0.5).abs() < 4.0 * 0.5 / 200.0, "{std}");
}

proptest! {
    #[test]
    fn nothing_is_drawn_from_what_is_no_distribution(
        // Finite numbers of any size, infinities, and NaN.
        logits in prop::collection::vec(prop::num::f32::ANY, 32),
        sane in prop::collection::vec(-1e6_f32..1e6, 32),
        seed in any::<u64>(),
    ) {
        let (locs, scales) = ([0.0; 96], [1.0; 96]);
        let sample = |logits: &[f32]| {
            let distribution = ActionDistribution::new(logits, &locs, &scales, JointForm::ChosenUnique);
            distribution.sample(&mut ChaCha8Rng::seed_from_u64(seed))
        };
        let of_any = sample(&logits);
        prop_assert!(of_any.is_none() || logits.iter().all(|x| !x.is_nan() && *x < f32::INFINITY));
        prop_assert!(sample(&sane).is_some());
    }

    #[test]
    fn masked_blocks_are_never_drawn_and_slices_agree_with_tensors(
        logits in prop::collection::vec(-8.0_f32..8.0, 32),
        locs in prop::collection::vec(-1.0_f32..1.0, 96),
        scales in prop::collection::vec(0.05_f32..2.0, 96),
        allowed in any::<[[bool; 16]; 2]>().prop_filter("some block", |a| a.iter().all(|row| row.contains(&true))),
        seed in any::<u64>(),
    ) {
        let mut masked = logits.clone();
        mask_logits(&mut masked, &allowed);
        for (form, _) in FORMS {
            let distribution = ActionDistribution::new(&masked, &locs, &scales, form);
            let action = distribution.sample(&mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
            for (gripper, choice) in action.choices.iter().enumerate() {
                let block = choice.unwrap().get();
                prop_assert!(allowed[gripper][block]);
                prop_assert!(masked[16 * gripper + block] > MASKED_LOGIT);
            }
            let heads = Heads { logits: logits.clone(), locs: locs.clone(), scales: scales.clone() };
            let mut output = heads.tensors(&Device::flex());
            output.logits = loss_terms::mask_logits(output.logits, &[Some(allowed)]);
            let tensors = ActionTensors::new([&action].into_iter(), 2, &Device::flex());
            let on_tensors = values(loss_terms::log_prob(&output, &tensors, form))[0];
            let on_slices = distribution.log_prob(&action);
            prop_assert!((on_tensors - on_slices).abs() <= 1e-4 * on_slices.abs().max(1.0));
            let on_tensors = loss_terms::entropy(&output, None, form);
            let on_slices = distribution.entropy();
            prop_assert!((values(on_tensors.blocks)[0] - on_slices.blocks).abs() <= 1e-4);
            prop_assert!((values(on_tensors.moves)[0] - on_slices.moves).abs() <= 1e-3);
        }
    }
}

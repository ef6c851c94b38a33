//! The action distribution on slices against JAX vectors in `f64`, and its sampling. That on tensors, with entropies and
//! gradients, is compared with the same vectors in `learner/tests/golden.rs`, with the loss that uses them.

use crate::common::{TOLERANCE, actions, numbers, outputs, read_ppo, relative_error, values};
use blueprints::{BlockIdx, N_BLOCKS};
use burn::tensor::Device;
use policy::cpu::Outputs;
use policy::distribution::{ActionDistribution, MASKED_LOGIT, mask_logits};
use policy::loss_terms::{self, ActionTensors};
use proptest::prelude::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

fn row(outputs: &Outputs, item: usize) -> ActionDistribution<'_> {
    let [locs, scales] = [&outputs.locs, &outputs.scales].map(|moves| &moves[item * 96..(item + 1) * 96]);
    ActionDistribution::new(&outputs.logits[item * 32..(item + 1) * 32], locs, scales)
}

#[test]
fn log_probs_match() {
    let golden = &read_ppo()["ppo"];
    let actions = actions(golden);
    for (heads, key) in [("new", "logp"), ("old", "logp_old")] {
        let outputs = outputs(&golden[heads]);
        let expected = numbers(&golden["variants"]["chosen_unique"][key]);
        let slices: Vec<f32> = (0..8).map(|i| row(&outputs, i).log_prob(&actions[i])).collect();
        assert!(relative_error(&slices, &expected) <= TOLERANCE, "{key}: {slices:?}");
    }
}

/// The entropy of a scene with two grippers in `f64`, from the entropy of each block's move.
fn entropy(logits: &[f64], of_moves: &[f64]) -> f64 {
    let probabilities: Vec<Vec<f64>> = logits
        .chunks_exact(N_BLOCKS)
        .map(|row| {
            let sum: f64 = row.iter().map(|x| x.exp()).sum();
            row.iter().map(|x| x.exp() / sum).collect()
        })
        .collect();
    let blocks: f64 = probabilities.iter().flatten().map(|p| -p * p.ln()).sum();
    let chosen = |b: usize| 1.0 - (1.0 - probabilities[0][b]) * (1.0 - probabilities[1][b]);
    blocks + (0..N_BLOCKS).map(|b| chosen(b) * of_moves[b]).sum::<f64>()
}

#[test]
fn entropy_gradients_are_central_differences() {
    let golden = &read_ppo()["ppo"];
    let output = outputs(&golden["new"]).to_tensors(2, &Device::flex().autodiff());
    let found = loss_terms::entropy(&output, None);
    let gradients = (found.blocks + found.moves).sum().backward();
    let (logits, scales) = (numbers(&golden["new"]["grip_logits"]), numbers(&golden["new"]["scales"]));
    const STEP: f64 = 1e-5;
    let (mut by_logits, mut by_scales) = (Vec::new(), Vec::new());
    for (logits, scales) in logits.chunks_exact(2 * N_BLOCKS).zip(scales.chunks_exact(6 * N_BLOCKS)) {
        // The entropy of a Gaussian is ½ ln 2πe + ln σ.
        let of_unit = 0.5 * (std::f64::consts::TAU * std::f64::consts::E).ln();
        let of_move = |scales: &[f64]| scales.iter().map(|s| of_unit + s.ln()).sum::<f64>();
        let of_moves: Vec<f64> = scales.chunks_exact(6).map(of_move).collect();
        by_logits.extend((0..logits.len()).map(|i| {
            let at = |step: f64| {
                let mut logits = logits.to_vec();
                logits[i] += step;
                entropy(&logits, &of_moves)
            };
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        }));
        by_scales.extend((0..scales.len()).map(|i| {
            let at = |step: f64| {
                let mut of_moves = of_moves.clone();
                of_moves[i / 6] += (scales[i] + step).ln() - scales[i].ln();
                entropy(logits, &of_moves)
            };
            (at(STEP) - at(-STEP)) / (2.0 * STEP)
        }));
    }
    let found = values(output.logits.grad(&gradients).unwrap());
    assert!(relative_error(&found, &by_logits) <= TOLERANCE);
    let found = values(output.gaussians().scales.grad(&gradients).unwrap());
    assert!(relative_error(&found, &by_scales) <= TOLERANCE);
}

#[test]
fn mode_takes_the_largest_logit_and_the_means() {
    let mut logits = [0.0; 32];
    logits[7] = 2.0;
    logits[16 + 3] = 0.5;
    let locs: Vec<f32> = (0..96).map(|k| k as f32).collect();
    let scales = [0.1; 96];
    let action = ActionDistribution::new(&logits, &locs, &scales).mode();
    assert_eq!(action.choices.map(|c| c.unwrap().get()), [7, 3]);
    assert_eq!(action.moves[15], [90.0, 91.0, 92.0, 93.0, 94.0, 95.0]);
}

#[test]
fn log_prob_of_a_hand_worked_case() {
    // One gripper, equal logits: ln(1/16) = −2.772589. Move at the mean, σ = 0.5: 6 · (−ln 0.5 − 0.918939) = −1.354748.
    let (logits, locs, scales) = ([0.0; 16], [0.0; 96], [0.5; 96]);
    let distribution = ActionDistribution::new(&logits, &locs, &scales);
    let action = distribution.mode();
    assert_eq!(action.choices, [BlockIdx::try_from(0).ok(), None]);
    assert!((distribution.log_prob(&action) - (-2.772_589 - 1.354_748)).abs() < 1e-5);
}

#[test]
fn samples_follow_the_distribution() {
    let mut logits = [0.0_f32; 16];
    logits[5] = 3.0_f32.ln();
    let (locs, scales) = ([0.25; 96], [0.5; 96]);
    let distribution = ActionDistribution::new(&logits, &locs, &scales);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (n, mut hits, mut sum, mut squares) = (20_000, 0, 0.0_f64, 0.0_f64);
    for _ in 0..n {
        let action = distribution.sample(&mut rng).unwrap();
        hits += usize::from(action.choices[0].unwrap().get() == 5);
        sum += f64::from(action.moves[2][1]);
        squares += f64::from(action.moves[2][1]).powi(2);
    }
    let share = hits as f64 / f64::from(n);
    let mean = sum / f64::from(n);
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
            let distribution = ActionDistribution::new(logits, &locs, &scales);
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
        allowed in any::<[bool; 16]>().prop_filter("some block", |row| row.contains(&true)),
        seed in any::<u64>(),
    ) {
        let mut masked = logits.clone();
        mask_logits(&mut masked, &allowed);
        let distribution = ActionDistribution::new(&masked, &locs, &scales);
        let action = distribution.sample(&mut ChaCha8Rng::seed_from_u64(seed)).unwrap();
        for (gripper, choice) in action.choices.iter().enumerate() {
            let block = choice.unwrap().get();
            prop_assert!(allowed[block]);
            prop_assert!(masked[16 * gripper + block] > MASKED_LOGIT);
        }
        let output = Outputs { locs: locs.clone(), scales: scales.clone(), logits, values: vec![0.0], readouts: Vec::new() };
        let mut output = output.to_tensors(2, &Device::flex());
        output.logits = loss_terms::mask_logits(output.logits, &[Some(allowed)]);
        let tensors = ActionTensors::new([&action].into_iter(), 2, &Device::flex());
        let on_tensors = values(loss_terms::log_prob(&output, &tensors))[0];
        let on_slices = distribution.log_prob(&action);
        prop_assert!((on_tensors - on_slices).abs() <= 1e-4 * on_slices.abs().max(1.0));
    }
}

//! Golden vectors of GAE, PPO losses, Adam, and the curriculum, computed in float64 by an independent implementation.

#![allow(clippy::unwrap_used)]

use blueprints::BlueprintId;
use burn::tensor::{Device, Tensor, TensorData};
use learner::adam::{Adam, BETA1, BETA2, EPSILON, LearningRate, clip_global_norm};
use learner::advantages::{Estimator as _, Steps};
use learner::config::{CurriculumConfig, PaperConfig};
use learner::curriculum::Curriculum;
use learner::gae::{self, Gae};
use learner::loss::{RatioStatistics, policy_loss, value_loss};
use policy::NetworkOutput;
use policy::loss_terms::{self, ActionTensors};
use proto::Status;
use serde_json::Value;

#[path = "../../policy/tests/reference/common.rs"]
#[expect(dead_code)]
mod common;

use common::{actions, floats, golden_path, outputs, read_json, read_ppo, values};

fn close(name: &str, found: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let scale = expected.iter().fold(0.0f32, |max, x| max.max(x.abs()));
    for (i, (x, y)) in found.iter().zip(expected).enumerate() {
        assert!((x - y).abs() <= tolerance * scale, "{name}[{i}]: {x} instead of {y}");
    }
}

#[test]
fn gae_distinguishes_time_limit_from_termination() {
    let golden = &read_ppo()["gae"];
    let (gamma, lambda) = (golden["gamma"].as_f64().unwrap() as f32, golden["lam"].as_f64().unwrap() as f32);
    let (n_steps, n) = (golden["T"].as_u64().unwrap() as usize, golden["N"].as_u64().unwrap() as usize);
    let column = |name: &str, j: usize| -> Vec<f32> { (0..n_steps).map(|t| floats(&golden[name][t][j])[0]).collect() };
    let bit = |name: &str, t: usize, j: usize| golden[name][t][j].as_bool().unwrap();
    for j in 0..n {
        let (rewards, values, final_values) = (column("rewards", j), column("values", j), column("final_values", j));
        let mut advantages = vec![0.0; n_steps];
        let mut first = 0;
        for (t, &final_value) in final_values.iter().enumerate() {
            // In the golden data, a true end takes precedence over a simultaneous time limit.
            let status = match (bit("terminated", t, j), bit("truncated", t, j)) {
                (true, _) => Status::Success,
                (false, true) => Status::TimeLimit,
                (false, false) => Status::Running,
            };
            if status == Status::Running && t + 1 < n_steps {
                continue;
            }
            let last = if status == Status::Running { floats(&golden["bootstrap_value"][j])[0] } else { final_value };
            let segment = first..t + 1;
            let (rewards, values) = (&rewards[segment.clone()], &values[segment.clone()]);
            let bootstrap = gae::bootstrap_value(status, last);
            let steps = Steps { rewards, values, bootstrap, ratios: &[] };
            Gae { gamma, lambda }.advantages(&steps, &mut advantages[segment]);
            first = t + 1;
        }
        close("advantages", &advantages, &column("advantages", j), 1e-6);
        let returns: Vec<f32> = advantages.iter().zip(&values).map(|(a, v)| a + v).collect();
        close("returns", &returns, &column("returns", j), 1e-6);
    }
}

/// The golden batch on an autodiff device.
struct Ppo {
    golden: Value,
    device: Device,
}

impl Ppo {
    fn new() -> Self {
        Self { golden: read_ppo()["ppo"].take(), device: Device::flex().autodiff() }
    }

    fn vector(&self, value: &Value) -> Tensor<1> {
        let values = floats(value);
        let n = values.len();
        Tensor::from_data(TensorData::new(values, [n]), &self.device)
    }

    fn output(&self, which: &str) -> NetworkOutput {
        outputs(&self.golden[which]).to_tensors(2, &self.device)
    }

    fn actions(&self) -> ActionTensors {
        ActionTensors::new(actions(&self.golden).iter(), 2, &self.device)
    }
}

#[test]
fn policy_loss_and_gradients_match() {
    let ppo = Ppo::new();
    let clip = ppo.golden["clip_eps"].as_f64().unwrap() as f32;
    let mut advantages = floats(&ppo.golden["advantages"]);
    gae::normalize(&mut advantages);
    close("advantages", &advantages, &floats(&ppo.golden["advantages_normalised"]), 1e-6);
    let expected = &ppo.golden["variants"]["chosen_unique"];
    let output = ppo.output("new");
    let actions = ppo.actions();
    let log_prob = loss_terms::log_prob(&output, &actions);
    let old = loss_terms::log_prob(&ppo.output("old"), &actions).detach();
    close("log-probabilities", &values(log_prob.clone()), &floats(&expected["logp"]), 2e-6);
    close("old log-probabilities", &values(old.clone()), &floats(&expected["logp_old"]), 2e-6);
    let statistics = RatioStatistics::new(&values(log_prob.clone()), &values(old.clone()), clip);
    assert_eq!(statistics.clip_fraction, expected["clip_fraction"].as_f64().unwrap());
    assert!((statistics.approx_kl - expected["approx_kl_k3"].as_f64().unwrap()).abs() < 1e-4);
    let advantage = ppo.vector(&ppo.golden["advantages_normalised"]);
    let ones = Tensor::ones([advantages.len()], &ppo.device);
    let loss = policy_loss(log_prob, old, ones, advantage, clip);
    close("loss", &values(loss.clone()), &floats(&expected["policy_loss_per_item"]), 1e-4);
    let gradients = loss.mean().backward();
    let moves = output.gaussians();
    for (name, leaf) in [("grad_logits", &output.logits), ("grad_locs", &moves.locs), ("grad_scales", &moves.scales)] {
        close(name, &values(leaf.grad(&gradients).unwrap()), &floats(&expected[name]), 2e-5);
    }
}

#[test]
fn policy_loss_matches_for_other_log_probabilities() {
    let ppo = Ppo::new();
    for name in ["chosen_per_gripper", "chosen_unique", "matrix_all"] {
        let expected = &ppo.golden["variants"][name];
        let log_prob = ppo.vector(&expected["logp"]);
        let old = ppo.vector(&expected["logp_old"]);
        let advantage = ppo.vector(&ppo.golden["advantages_normalised"]);
        let ones = Tensor::ones([8], &ppo.device);
        let loss = values(policy_loss(log_prob, old, ones, advantage, 0.2).mean())[0];
        assert!((f64::from(loss) - expected["policy_loss"].as_f64().unwrap()).abs() < 1e-4, "{name}: {loss}");
    }
}

#[test]
fn value_loss_matches() {
    let ppo = Ppo::new();
    let loss = value_loss(ppo.output("new").values, ppo.vector(&ppo.golden["returns"]));
    close("loss", &values(loss.mean()), &floats(&ppo.golden["value_loss"]["unclipped"]), 1e-6);
}

#[test]
fn entropies_match() {
    let ppo = Ppo::new();
    for (which, name) in [("new", "entropy"), ("old", "old_entropy")] {
        let output = ppo.output(which);
        let expected = &ppo.golden[name];
        let entropy = loss_terms::entropy(&output, None);
        close(name, &values(entropy.blocks), &floats(&expected["categorical"]), 1e-5);
        close(name, &values(entropy.moves), &floats(&expected["gaussian_expected_unique"]), 1e-5);
    }
}

#[test]
fn adam_matches_after_global_norm_clipping() {
    let golden = &read_ppo()["adam_clip"];
    let number = |name: &str| golden[name].as_f64().unwrap() as f32;
    assert_eq!([golden["b1"].as_f64(), golden["b2"].as_f64()], [Some(BETA1), Some(BETA2)]);
    assert_eq!(number("eps"), EPSILON);
    let mut parameters = floats(&golden["w0"]);
    let mut adam = Adam::new(parameters.len());
    for (step, gradient) in golden["raw_grads"].as_array().unwrap().iter().enumerate() {
        let mut gradient = floats(gradient);
        clip_global_norm(&mut gradient, number("max_grad_norm"));
        adam.step(&mut parameters, &gradient, LearningRate(number("lr")));
        close("parameters", &parameters, &floats(&golden["w_after"][step]), 5e-7);
        close("first moment", &adam.first, &floats(&golden["m_after"][step]), 1e-5);
        close("second moment", &adam.second, &floats(&golden["v_after"][step]), 1e-5);
    }
}

#[test]
fn paper_curriculum_matches() {
    let golden = read_json(&golden_path("curriculum.json"));
    let number = |name: &str| golden[name].as_f64().unwrap();
    let ids: Vec<BlueprintId> =
        (0..golden["n"].as_u64().unwrap()).map(|i| BlueprintId::try_from(format!("2_{i:03}")).unwrap()).collect();
    assert_eq!((number("tau"), number("decay")), (0.2, 0.99));
    let config = PaperConfig { temperature: number("temp") };
    let mut curriculum = Curriculum::new(CurriculumConfig::Paper(config), ids.clone());
    for (k, update) in golden["updates"].as_array().unwrap().iter().enumerate() {
        let indices = update["blueprint_indices"].as_array().unwrap().iter();
        let successes = update["success"].as_array().unwrap().iter();
        let batch: Vec<_> = indices
            .zip(successes)
            .map(|(i, success)| (&ids[i.as_u64().unwrap() as usize], success.as_u64() == Some(1)))
            .collect();
        curriculum.update(batch);
        for (i, id) in ids.iter().enumerate() {
            let task = &curriculum.tasks()[id];
            for (found, name) in [(task.success_rate, "success_rates"), (task.probability, "probs")] {
                let expected = update[name][i].as_f64().unwrap();
                assert!((found - expected).abs() < 1e-12, "update {k}, {name}[{i}]: {found} instead of {expected}");
            }
        }
    }
}

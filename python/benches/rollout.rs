//! Environment steps per CPU-second on one thread in Rust, for `benches/speed.py`, which runs the same loops in Python.
//!
//! Prints `{"policy": steps, "random": steps}`: once with the pretrained policy acting, once with uniformly random
//! actions while still computing the policy's features. 32 worlds, goals of the training split, scattered starts.

#![allow(clippy::unwrap_used, missing_docs)]

use std::convert::Infallible;
use std::fmt::Debug;

use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog, N_BLOCKS, Split};
use environment::vec_env::generator;
use environment::{VecEnv, World, sample_assignment};
use policy::{FeatureBatch, Model, Policy, PolicyConfig};
use proto::{Action, ActionMode, Agent, Decision, Observation, Start, Status, Task, Valid};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

const N_WORLDS: usize = 32;
const N_STEPS: usize = 100;
const N_ROUNDS: u64 = 3;

fn main() {
    let bytes = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/pretrained/model.safetensors")).unwrap();
    let model = Model::from_bytes(&bytes).unwrap();
    let best = |measure: &dyn Fn(u64) -> f64| (0..N_ROUNDS).map(measure).fold(0.0, f64::max);
    let policy =
        best(&|seed| rate(Policy::with_weights(&model.policy, &model.weights).unwrap(), ActionMode::Greedy, seed));
    let random = best(&|seed| rate(Random::new(&model.policy), ActionMode::Sampled, seed));
    println!("{{\"policy\": {policy:.1}, \"random\": {random:.1}}}");
}

/// Returns the steps of all worlds per CPU-second.
fn rate<A: Agent<Error: Debug>>(mut agent: A, mode: ActionMode, seed: u64) -> f64 {
    let goals: Vec<BlueprintId> =
        Catalog::builtin().of_split(Split::Train).into_iter().map(Blueprint::id).cloned().collect();
    let world = || World::new(&Valid::default());
    let mut envs = VecEnv::new((0..N_WORLDS).map(|_| world()).collect());
    let mut rngs: Vec<ChaCha8Rng> = (0..N_WORLDS as u64).map(|row| generator(seed, row)).collect();
    let begin = |envs: &mut VecEnv<World>, row: usize, rng: &mut ChaCha8Rng| {
        let mut draw = || {
            let blueprint = goals[rng.random_range(0..goals.len())].clone();
            let assignment = sample_assignment(rng);
            Task { blueprint, assignment, start: Start::Scattered, seed: rng.random() }
        };
        let first = draw();
        let retry = |task: &mut Task, _: &environment::ResetError| {
            *task = draw();
            true
        };
        envs.reset(row, first, Catalog::builtin(), retry).unwrap();
    };
    for (row, rng) in rngs.iter_mut().enumerate() {
        begin(&mut envs, row, rng);
    }
    let before = cpu_seconds();
    for _ in 0..N_STEPS {
        let steps = envs.step(&mut agent, &[mode; N_WORLDS]).unwrap();
        for (row, step) in steps.iter().enumerate() {
            if step.result.status != Status::Running {
                begin(&mut envs, row, &mut rngs[row]);
            }
        }
    }
    (N_STEPS * N_WORLDS) as f64 / (cpu_seconds() - before)
}

/// Draws actions uniformly, and computes the features that a policy would see.
struct Random {
    batch: FeatureBatch,
}

impl Random {
    fn new(config: &PolicyConfig) -> Self {
        Self { batch: FeatureBatch::new(&config.features) }
    }
}

impl Agent for Random {
    type Error = Infallible;

    fn act(
        &mut self,
        observations: &[Observation<'_>],
        _: &[ActionMode],
        rngs: &mut [ChaCha8Rng],
    ) -> Result<Vec<Decision>, Infallible> {
        self.batch.fill(observations);
        let decide = |rng: &mut ChaCha8Rng| {
            let mut block = || BlockIdx::try_from(rng.random_range(0..N_BLOCKS as u8)).ok();
            let choices = [block(), block()];
            let moves = std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            Decision { action: Action { choices, moves }, proposals: [None; 2], log_prob: 0.0, value: 0.0 }
        };
        Ok(rngs.iter_mut().map(decide).collect())
    }
}

/// Returns the CPU time of this thread, because wall time on a shared machine is unreliable.
fn cpu_seconds() -> f64 {
    // The first field of schedstat is the time on the CPU in ns.
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e9
}

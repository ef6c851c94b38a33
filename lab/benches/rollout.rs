//! CPU time of an actor's step and of its parts, in microseconds per environment step.
//!
//! `cargo bench -p lab --bench rollout` rolls out 64 worlds on one thread with the default network, untrained. The parts
//! are then timed individually on the scenes of that rollout. The world's time is what remains of the whole, and the
//! forward pass is what remains of the policy.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::collections::BTreeMap;
use std::hint::black_box;

use actor::{ActorConfig, ActorSetup, Rollout, TaskConfig};
use blueprints::{Blueprint, Catalog};
use environment::{EnvironmentConfig, World};
use policy::cpu::Outputs;
use policy::distribution::ActionDistribution;
use policy::{DeviceKind, Engine, FeatureBatch, Policy, PolicyConfig};
use proto::codec::encode_trajectory;
use proto::{
    ActionMode, ActorId, Agent, Normalization, Observation, Scene, Task, Trajectory, Valid, Weights, WeightsVersion,
};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

const N_WORLDS: usize = 64;
/// Steps of each world before the measurement, so that episodes are at all stages.
const WARM_UP: usize = 50;
const N_STEPS: usize = 100;

fn main() {
    let (policy, environment) = (Valid::default(), Valid::default());
    let weights = untrained(&policy);
    let mut rollout = rollout(&policy, &environment, &weights);
    (0..WARM_UP).for_each(|_| drop(rollout.step().unwrap()));
    let mut segments: Vec<Trajectory> = Vec::new();
    let before = cpu_seconds();
    for _ in 0..N_STEPS {
        segments.extend(rollout.step().unwrap());
    }
    let whole = micros(before, N_WORLDS * N_STEPS);

    // Equal blocks swap roles from episode to episode.
    let goal = |task: &Task| Catalog::builtin().get(&task.blueprint).unwrap().permuted(&task.assignment);
    let goals: Vec<Blueprint> = segments.iter().map(|segment| goal(&segment.task)).collect();
    let blueprints: Vec<&Blueprint> = goals.iter().collect();
    let scenes: Vec<(&Scene, &Blueprint)> = segments
        .iter()
        .zip(&blueprints)
        .flat_map(|(segment, &blueprint)| segment.transitions.iter().map(move |step| (&step.scene, blueprint)))
        .collect();
    let batches: Vec<Vec<Observation<'_>>> = scenes
        .chunks_exact(N_WORLDS)
        .map(|scenes| scenes.iter().map(|&(scene, blueprint)| Observation { scene, blueprint }).collect())
        .collect();
    let n_steps = batches.len() * N_WORLDS;

    let mut batch = FeatureBatch::new(&policy.features);
    let features = best_of(n_steps, || batches.iter().for_each(|observations| batch.fill(observations)));
    let mut agent = Policy::with_weights(&policy, &weights).unwrap();
    let mut rngs: Vec<ChaCha8Rng> = (0..N_WORLDS as u64).map(ChaCha8Rng::seed_from_u64).collect();
    let act = best_of(n_steps, || {
        for observations in &batches {
            black_box(agent.act(observations, &[ActionMode::Greedy; N_WORLDS], &mut rngs).unwrap());
        }
    });
    let rows: Vec<usize> = (0..N_WORLDS).collect();
    let Outputs { locs, scales, logits, .. } = engine(&policy).run(&batch, &rows);
    let (locs, scales, logits) = (locs.chunks_exact(96), scales.chunks_exact(96), logits.chunks_exact(32));
    let distributions: Vec<ActionDistribution<'_>> = locs
        .zip(scales)
        .zip(logits)
        .map(|((locs, scales), logits)| ActionDistribution::new(logits, locs, scales))
        .collect();
    let sampling = best_of(n_steps, || {
        for _ in &batches {
            for (distribution, rng) in distributions.iter().zip(&mut rngs) {
                let action = distribution.sample(rng).unwrap();
                black_box(distribution.log_prob(&action));
            }
        }
    });
    let n_scenes: usize = segments.iter().map(|segment| segment.transitions.len()).sum();
    let sending = best_of(n_scenes, || segments.iter().for_each(|segment| drop(black_box(encode_trajectory(segment)))));

    let world = whole - act;
    println!("microseconds of CPU time per environment step, {N_WORLDS} worlds on one thread");
    for (part, cost) in [
        ("world", world),
        ("features", features),
        ("forward pass", act - features - sampling),
        ("sampling", sampling),
        ("encoding", sending),
        ("all", whole + sending),
    ] {
        println!("{part:16} {cost:8.1}  {:5.1} %", 100.0 * cost / (whole + sending));
    }
}

fn rollout(policy: &Valid<PolicyConfig>, environment: &Valid<EnvironmentConfig>, weights: &Weights) -> Rollout<World> {
    let tasks = TaskConfig { prebuilt_probability: 0.3, ..TaskConfig::default() };
    let setup = ActorSetup {
        config: Valid::new(ActorConfig { segment_len: 32, tasks, ..ActorConfig::default() }).unwrap(),
        policy: policy.clone(),
        environment: environment.clone(),
        id: ActorId::try_from("bench".to_owned()).unwrap(),
        seed: 0,
        catalog: Catalog::builtin().clone(),
    };
    let worlds = (0..N_WORLDS).map(|_| World::new(environment)).collect();
    Rollout::new(setup, 0, 0, worlds, weights).unwrap()
}

fn untrained(policy: &PolicyConfig) -> Weights {
    Weights {
        version: WeightsVersion(0),
        n_env_steps: 0,
        network_hash: policy.hash(),
        settings: Default::default(),
        parameters: engine(policy).parameters(),
        normalization: Normalization::default(),
        task_probabilities: BTreeMap::new(),
    }
}

fn engine(policy: &PolicyConfig) -> Engine {
    Engine::new(policy, 0, &DeviceKind::Cpu.open().unwrap(), false)
}

/// Returns microseconds per step, the best of five rounds.
fn best_of(n_steps: usize, mut work: impl FnMut()) -> f64 {
    let round = |_| {
        let before = cpu_seconds();
        work();
        micros(before, n_steps)
    };
    (0..5).map(round).fold(f64::INFINITY, f64::min)
}

fn micros(before: f64, n_steps: usize) -> f64 {
    1e6 * (cpu_seconds() - before) / n_steps as f64
}

/// Returns the CPU time of this thread, because wall time on a shared machine says little.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    stat.split(' ').next().unwrap().parse::<f64>().unwrap() / 1e9
}

//! The four code paths that dominate training time, each run a given number of times. The benchmark counts
//! instructions, because other load on the machine does not change them.
//!
//! `hot_paths world 3` steps a world for three rounds and prints nothing; `instructions.py` in this folder counts.

#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;

use blueprints::{Blueprint, Catalog};
use burn::tensor::Device;
use environment::{Env, World, sample_assignment};
use policy::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use policy::{FeatureBatch, FeatureConfig, FeatureSizes, Network, NetworkConfig, parameters};
use proto::{Action, Observation, Scene, Start, Task, Valid};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

const STEPS: usize = 50;
const SCENES: usize = 16;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [path, rounds] = &arguments[..] else {
        println!("usage: hot_paths (world | features | forward | gradient) ROUNDS");
        return;
    };
    let rounds: usize = rounds.parse().unwrap();
    match path.as_str() {
        "world" => world(rounds),
        "features" => features(rounds),
        "forward" => forward(rounds),
        "gradient" => gradient(rounds),
        other => println!("no path {other}"),
    }
}

/// A world with scattered blocks, and the blueprint to build in it.
fn begun(seed: u64) -> (World, Blueprint) {
    let catalog = Catalog::builtin();
    let goal = catalog.iter().find(|blueprint| blueprint.n_blocks() == 16).unwrap();
    let mut world = World::new(&Valid::default());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let assignment = sample_assignment(&mut rng);
    world.reset(&Task { blueprint: goal.id().clone(), assignment, start: Start::Scattered, seed }, catalog).unwrap();
    let blueprint = world.blueprint().clone();
    (world, blueprint)
}

/// Takes 50 random steps in one world, the same in every round.
fn world(rounds: usize) {
    for _ in 0..rounds {
        let (mut world, _) = begun(1);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..STEPS {
            let action = Action {
                choices: std::array::from_fn(|_| blueprints::BlockIdx::try_from(rng.random_range(0..16_u8)).ok()),
                moves: std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))),
            };
            black_box(world.step(&action));
        }
    }
}

fn scenes() -> (Vec<Scene>, Blueprint) {
    let (mut world, blueprint) = begun(1);
    let scenes = (0..SCENES).map(|_| {
        world.step(&Action::IDLE);
        world.scene().clone()
    });
    (scenes.collect(), blueprint)
}

/// Computes all features of 16 scenes.
fn features(rounds: usize) {
    let (scenes, blueprint) = scenes();
    let mut batch = FeatureBatch::new(&FeatureConfig::default());
    for _ in 0..rounds {
        batch.clear();
        scenes.iter().for_each(|scene| batch.push(&Observation { scene, blueprint: &blueprint }));
        black_box(&batch);
    }
}

fn network() -> (CpuNetwork, FeatureBatch) {
    let (scenes, blueprint) = scenes();
    let config = FeatureConfig::default();
    let mut batch = FeatureBatch::new(&config);
    scenes.iter().for_each(|scene| batch.push(&Observation { scene, blueprint: &blueprint }));
    let sizes = FeatureSizes::new(&config);
    let network = Network::init(&NetworkConfig::default(), &sizes, 0, &Device::flex());
    let layout = NetworkLayout::new(&NetworkConfig::default(), &sizes, network.table()).unwrap();
    (CpuNetwork::new(&layout, &parameters::flatten(&network), true).unwrap(), batch)
}

/// Runs one forward pass over 16 scenes.
fn forward(rounds: usize) {
    let (network, batch) = network();
    let (rows, mut tape): (Vec<usize>, _) = ((0..SCENES).collect(), Tape::default());
    for _ in 0..rounds {
        black_box(network.infer(&batch, &rows, &mut tape));
    }
}

/// Runs one forward and one backward pass over 16 scenes.
fn gradient(rounds: usize) {
    let (network, batch) = network();
    let (rows, mut tape): (Vec<usize>, _) = ((0..SCENES).collect(), Tape::default());
    let mut gradient = Vec::new();
    for _ in 0..rounds {
        let by_output: Outputs = network.forward(&batch, &rows, &mut tape).clone();
        network.backward(&mut tape, &by_output, &mut gradient);
        black_box(&gradient);
    }
}

//! Control steps per CPU-second of one world.
//!
//! `cargo bench -p environment` prints a table; `--json` prints `{case: steps per CPU-second}` for the peer script beside
//! it; `--five` uses 5 substeps of 20 ms instead of 10 of 10 ms; a case's name times that case only.

#![allow(clippy::unwrap_used, missing_docs)]

use blueprints::{BlockIdx, Blueprint, Catalogue, N_BLOCKS};
use environment::{Env, EnvironmentConfig, World};
use proto::{Action, Start, Status, Task};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const N_STEPS: usize = 1000;
const N_ROUNDS: u64 = 5;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |flag: &str| arguments.iter().any(|argument| argument == flag);
    let mut config = EnvironmentConfig::default();
    if has("--five") {
        config.physics.n_substeps = 5;
        config.physics.substep_ms = 20.0;
    }
    let cases: [(&str, fn(&EnvironmentConfig, u64) -> f64); 4] =
        [("settled", settled), ("random", random), ("held", held), ("moved", moved)];
    let mut lines = vec![];
    let all = !cases.iter().any(|(name, _)| has(name));
    for (name, case) in cases.into_iter().filter(|(name, _)| all || has(name)) {
        // The best of many short rounds: others on the machine only ever slow a round down.
        let best = (0..N_ROUNDS).map(|seed| case(&config, seed)).fold(0.0, f64::max);
        lines.push((name, best));
    }
    if has("--json") {
        let entries: Vec<_> = lines.iter().map(|(name, rate)| format!("\"{name}\": {rate:.1}")).collect();
        println!("{{{}}}", entries.join(", "));
    } else {
        for (name, rate) in lines {
            println!("{name:8} {rate:9.0} steps per CPU-second, {:6.1} µs a step", 1e6 / rate);
        }
    }
}

/// All blocks at rest on the ground, nothing held.
fn settled(config: &EnvironmentConfig, seed: u64) -> f64 {
    let mut world = start(config, two_blocks(), Start::Scattered, seed);
    (0..20).for_each(|_| {
        world.step(&idle());
    });
    timed(N_STEPS, || {
        world.step(&idle());
    })
}

/// Uniformly random blocks and moves in episodes of 100 steps.
fn random(config: &EnvironmentConfig, seed: u64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut world = start(config, two_blocks(), Start::Scattered, seed);
    let mut n = 0;
    timed(N_STEPS, || {
        let block = |rng: &mut ChaCha8Rng| BlockIdx::try_from(rng.random_range(0..N_BLOCKS as u8)).unwrap();
        let choices = [Some(block(&mut rng)), Some(block(&mut rng))];
        let moves = std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        n += 1;
        let status = world.step(&Action { choices, moves }).status;
        if status == Status::Diverged || n % 100 == 0 {
            world = start(config, two_blocks(), Start::Scattered, seed);
        }
    })
}

/// A gripper keeps the largest structure of the catalogue in the air.
fn held(config: &EnvironmentConfig, seed: u64) -> f64 {
    let mut world = lifted(config, seed);
    let still = hold(&world, [0.0; 6]);
    timed(N_STEPS, || {
        world.step(&still);
    })
}

/// A gripper swings it to and fro.
fn moved(config: &EnvironmentConfig, seed: u64) -> f64 {
    let mut world = lifted(config, seed);
    let (there, back) = (hold(&world, [0.1, 0.1, 0.0, 0.0, 0.0, 0.2]), hold(&world, [-0.1, -0.1, 0.0, 0.0, 0.0, -0.2]));
    let mut n = 0;
    timed(N_STEPS, || {
        n += 1;
        world.step(if n % 10 < 5 { &there } else { &back });
    })
}

fn lifted(config: &EnvironmentConfig, seed: u64) -> World {
    let largest = Catalogue::builtin().iter().max_by_key(|b| b.n_blocks()).unwrap();
    let mut world = start(config, two_blocks(), Start::Prebuilt(largest.id().clone()), seed);
    // Upwards as seen from the block that is held.
    let q = world.scene().blocks[held_block(&world).get()].orientation;
    let rotation = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q[3], q[0], q[1], q[2]));
    let up = rotation.inverse() * nalgebra::Vector3::z() * 0.3;
    let lift = hold(&world, [up.x, up.y, up.z, 0.0, 0.0, 0.0]);
    (0..10).for_each(|_| {
        world.step(&lift);
    });
    world
}

/// The block with the most connections.
fn held_block(world: &World) -> BlockIdx {
    let degree = |block: BlockIdx| world.scene().joints.iter().filter(|j| j.a == block || j.b == block).count();
    BlockIdx::all().max_by_key(|&block| degree(block)).unwrap()
}

fn hold(world: &World, velocity: [f32; 6]) -> Action {
    Action { choices: [Some(held_block(world)), None], moves: [velocity; N_BLOCKS] }
}

fn idle() -> Action {
    Action { choices: [None, None], moves: [[0.0; 6]; N_BLOCKS] }
}

fn two_blocks() -> &'static Blueprint {
    Catalogue::builtin().iter().min_by_key(|b| b.n_blocks()).unwrap()
}

fn start(config: &EnvironmentConfig, goal: &Blueprint, start: Start, seed: u64) -> World {
    let mut world = World::new(config).unwrap();
    let assignment = std::array::from_fn(|i| BlockIdx::try_from(i as u8).unwrap());
    let task = Task { blueprint: goal.id().clone(), assignment, start, seed };
    world.reset(&task, Catalogue::builtin()).unwrap();
    world
}

/// Calls per CPU-second of this thread.
fn timed(n: usize, mut f: impl FnMut()) -> f64 {
    let before = cpu_seconds();
    (0..n).for_each(|_| f());
    n as f64 / (cpu_seconds() - before).max(1e-9)
}

/// CPU time of this thread: wall time on a shared machine says little.
fn cpu_seconds() -> f64 {
    // The first field of schedstat is the time on the CPU in ns.
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e9
}

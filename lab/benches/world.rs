//! Control steps per CPU-second of one world.
//!
//! `cargo bench -p lab --bench world` prints a table. `--json` prints `{case: steps per CPU-second}` for
//! `lab/benches/peers.py`. The name of a case runs only that case.

#![allow(clippy::unwrap_used, missing_docs)]

use blueprints::{BlockIdx, Blueprint, Catalog, N_BLOCKS};
use environment::{Env, EnvironmentConfig, World};
use proto::{Action, Start, Status, Task, Valid};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

const N_STEPS: usize = 1000;
const N_ROUNDS: u64 = 5;
/// The held block, near the middle of the row.
const HELD: usize = 9;

/// Runs one round from a seed and returns the control steps per CPU-second.
type Case = fn(&Valid<EnvironmentConfig>, u64) -> f64;

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    let has = |flag: &str| arguments.iter().any(|argument| argument == flag);
    let config = Valid::default();
    let cases: [(&str, Case); 4] = [("settled", settled), ("random", random), ("held", held), ("moved", moved)];
    let mut lines = vec![];
    let all = !cases.iter().any(|(name, _)| has(name));
    for (name, case) in cases.into_iter().filter(|(name, _)| all || has(name)) {
        // The best of many short rounds, because other processes on the machine only ever slow a round down.
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
fn settled(config: &Valid<EnvironmentConfig>, seed: u64) -> f64 {
    let mut world = scattered(config, seed);
    (0..20).for_each(|_| {
        world.step(&idle());
    });
    timed(N_STEPS, || {
        world.step(&idle());
    })
}

/// Uniformly random blocks and moves in episodes of 100 steps.
fn random(config: &Valid<EnvironmentConfig>, seed: u64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut world = scattered(config, seed);
    let mut n = 0;
    timed(N_STEPS, || {
        let block = |rng: &mut ChaCha8Rng| BlockIdx::try_from(rng.random_range(0..N_BLOCKS as u8)).unwrap();
        let choices = [Some(block(&mut rng)), Some(block(&mut rng))];
        let moves = std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        n += 1;
        let status = world.step(&Action { choices, moves }).status;
        if status == Status::Diverged || n % 100 == 0 {
            world = scattered(config, seed);
        }
    })
}

/// A gripper holds a row of all 16 blocks in the air, end to end as in the peer script.
fn held(config: &Valid<EnvironmentConfig>, seed: u64) -> f64 {
    let (mut world, _) = lifted(config, seed);
    let still = hold([0.0; 6]);
    timed(N_STEPS, || {
        world.step(&still);
    })
}

/// A gripper swings the row back and forth.
fn moved(config: &Valid<EnvironmentConfig>, seed: u64) -> f64 {
    let (mut world, up) = lifted(config, seed);
    let velocity = |sign: f32| [0.0, 0.0, 0.0, 0.08 * sign * up.x, 0.08 * sign * up.y, 0.08 * sign * up.z];
    let there = hold(velocity(1.0));
    let back = hold(velocity(-1.0));
    let mut n = 0;
    timed(N_STEPS, || {
        n += 1;
        world.step(if n % 10 < 5 { &there } else { &back });
    })
}

/// Returns the row in the air and the upward direction in the frame of the held block.
fn lifted(config: &Valid<EnvironmentConfig>, seed: u64) -> (World, nalgebra::Vector3<f32>) {
    let row = row();
    let catalog = Catalog::from_files([("16_999.toml", row.as_str())]).unwrap();
    let goal = catalog.iter().next().unwrap();
    let mut world = World::new(config);
    let task = task(goal, Start::Prebuilt(goal.id().clone()), seed);
    world.reset(&task, &catalog).unwrap();
    let q = world.scene().blocks[HELD].orientation;
    let rotation = nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q[3], q[0], q[1], q[2]));
    let up = rotation.inverse() * nalgebra::Vector3::z();
    let lift = hold([0.3 * up.x, 0.3 * up.y, 0.3 * up.z, 0.0, 0.0, 0.0]);
    (0..10).for_each(|_| {
        world.step(&lift);
    });
    assert_eq!(world.scene().joints.len(), N_BLOCKS - 1, "the row came apart");
    (world, up)
}

/// Returns a blueprint of all 16 blocks end to end along x.
fn row() -> String {
    let inventory = blueprints::Inventory::standard();
    let mut blocks = vec![];
    let mut connections = vec![];
    let mut x = 0;
    for block in BlockIdx::all() {
        let i = block.get();
        let cells = inventory.cells(block);
        let name = inventory.block_type(block).name;
        blocks.push(format!(r#"{{ name = "b{i}", type = "{name}", at = [{x}, 0, 0], axes = "+x +y" }}"#));
        if let Some(last) = i.checked_sub(1).and_then(|last| BlockIdx::all().nth(last)) {
            let before = inventory.cells(last);
            let pairs: Vec<_> =
                (0..before[1].min(cells[1])).map(|y| format!(r#""+x({},{y},0) -x(0,{y},0)""#, before[0] - 1)).collect();
            let pairs = pairs.join(", ");
            connections.push(format!(r#"{{ a = "b{}", b = "b{i}", magnets = [{pairs}] }}"#, last.get()));
        }
        x += u32::from(cells[0]);
    }
    format!(
        "id = \"16_999\"\nsplit = \"train\"\ntitle = \"row\"\nprovenance = \"bench\"\nup = \"+z\"\n\
         blocks = [{}]\nconnections = [{}]\n",
        blocks.join(", "),
        connections.join(", ")
    )
}

fn hold(velocity: [f32; 6]) -> Action {
    Action { choices: [BlockIdx::all().nth(HELD), None], moves: [velocity; N_BLOCKS] }
}

fn idle() -> Action {
    Action { choices: [None, None], moves: [[0.0; 6]; N_BLOCKS] }
}

fn scattered(config: &Valid<EnvironmentConfig>, seed: u64) -> World {
    let goal = Catalog::builtin().iter().next().unwrap();
    let mut world = World::new(config);
    world.reset(&task(goal, Start::Scattered, seed), Catalog::builtin()).unwrap();
    world
}

fn task(goal: &Blueprint, start: Start, seed: u64) -> Task {
    let assignment = std::array::from_fn(|i| BlockIdx::try_from(i as u8).unwrap());
    Task { blueprint: goal.id().clone(), assignment, start, seed }
}

/// Returns the calls per CPU-second of this thread.
fn timed(n: usize, mut f: impl FnMut()) -> f64 {
    let before = cpu_seconds();
    (0..n).for_each(|_| f());
    n as f64 / (cpu_seconds() - before).max(1e-9)
}

/// Returns the CPU time of this thread, because wall time on a shared machine says little.
fn cpu_seconds() -> f64 {
    // The first field of schedstat is the time on the CPU in ns.
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e9
}

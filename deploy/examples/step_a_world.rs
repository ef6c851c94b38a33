//! Builds a structure in a world, one control step at a time, and prints the reward of every fifth step.
//!
//! ```sh
//! cargo run --release --example step_a_world            # a structure of four blocks
//! cargo run --release --example step_a_world -- 9_000   # any id of `lodestone blueprints list`
//! ```

use anyhow::Context as _;
use blueprints::{BlockIdx, BlueprintId, Catalog, N_BLOCKS};
use environment::{Env, Expert, World};
use proto::{Start, Status, Task, Valid};

fn main() -> anyhow::Result<()> {
    let id = std::env::args().nth(1).unwrap_or_else(|| "4_000".to_owned());
    let blueprint = BlueprintId::try_from(id)?;

    // The task and its seed determine the episode: every run prints the same numbers.
    let blocks: Vec<BlockIdx> = BlockIdx::all().collect();
    let assignment: [BlockIdx; N_BLOCKS] = blocks.try_into().ok().context("the inventory has 16 blocks")?;
    let task = Task { blueprint, assignment, start: Start::Scattered, seed: 1 };

    let config = Valid::default();
    let mut world = World::new(&config);
    world.reset(&task, Catalog::builtin())?;

    // Like a policy, the expert sees only the scene. Replace it with your own controller.
    let mut expert = Expert::new(&config, world.blueprint())?;
    let mut total = 0.0;
    for step in 1.. {
        let action = expert.act(world.scene());
        let result = world.step(&action);
        total += result.reward.total();
        if step % 5 == 0 || result.status != Status::Running {
            let n_joints = world.scene().joints.len();
            println!("step {step}: {:?}, {n_joints} connections, return {total:.2}", result.status);
        }
        // There is no single `done` flag: success, the time limit, and divergence of the simulation are distinct ends.
        if result.status != Status::Running {
            break;
        }
    }
    Ok(())
}

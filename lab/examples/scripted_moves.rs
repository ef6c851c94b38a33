//! Builds goals by fixed rules in the policy's own action space: what proposals are worth without learning.
//!
//! The rules have no plan. Take a wrong connection apart; else take the nearest open link of the largest piece, and let
//! its two blocks join.
//!
//! ```sh
//! cargo run --release -p lab --example scripted_moves -- 12 16 10   # sizes, and episodes for each training goal
//! ```

use std::collections::BTreeMap;

use anyhow::Context as _;
use blueprints::{BlockIdx, Catalog, Split};
use environment::{Env, World, sample_assignment};
use policy::distribution::unit_normal;
use policy::proposals::{Kind, Proposals, Slot};
use proto::{Action, Joint, Observation, Start, Status, Task, Valid};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Number of steps after which another link is tried.
const PATIENCE: u32 = 12;

/// A block and the proposal that moves it.
type Draw = (BlockIdx, Slot);

/// The link that is being made: the block that moves, its partner, and the number of steps so far.
type Focus = Option<(BlockIdx, BlockIdx, u32)>;

#[derive(Clone, Copy, Default)]
struct Score {
    n_episodes: u32,
    n_built: u32,
    links: f64,
    n_broken: usize,
}

fn main() -> anyhow::Result<()> {
    let args: Vec<u64> = std::env::args().skip(1).map(|arg| arg.parse()).collect::<Result<_, _>>()?;
    let [least, most, n_episodes] = args[..] else { anyhow::bail!("expected: LEAST MOST EPISODES") };
    let catalog = Catalog::builtin();
    let mut world = World::new(&Valid::default());
    let mut scores: BTreeMap<usize, Score> = BTreeMap::new();
    let goals = catalog.of_split(Split::Train);
    for goal in goals.iter().filter(|goal| (least..=most).contains(&(goal.n_blocks() as u64))) {
        for episode in 0..n_episodes {
            let mut rng = ChaCha8Rng::seed_from_u64(episode * 7919 + goal.n_blocks() as u64);
            let assignment = sample_assignment(&mut rng);
            let task = Task { blueprint: goal.id().clone(), assignment, start: Start::Scattered, seed: rng.random() };
            world.reset(&task, catalog).with_context(|| format!("{} cannot start", goal.id()))?;
            play(&mut world, &mut rng, scores.entry(goal.n_blocks()).or_default());
        }
    }
    println!("blocks  episodes  built  links  broken");
    for (n_blocks, Score { n_episodes, n_built, links, n_broken }) in scores {
        let n = f64::from(n_episodes);
        let built = 100.0 * f64::from(n_built) / n;
        let links = 100.0 * links / n;
        let broken = n_broken as f64 / n;
        println!("{n_blocks:>6} {n_episodes:>9} {built:>5.1}% {links:>5.1}% {broken:>7.1}");
    }
    Ok(())
}

/// Plays one episode by the rules.
fn play(world: &mut World, rng: &mut ChaCha8Rng, score: &mut Score) {
    let mut focus = None;
    loop {
        let observation = world.observation();
        let proposals = Proposals::new(&observation);
        let draws = choose(&observation, &proposals, &mut focus, rng);
        let before = observation.scene.joints.clone();
        let mut action = Action::IDLE;
        for (choice, (block, slot)) in action.choices.iter_mut().zip(draws) {
            *choice = Some(block);
            let Some(proposal) = proposals.get(block, slot) else { continue };
            action.moves[block.get()] = proposal.movement.map(|x| x + proposal.noise() * unit_normal(rng));
        }
        let result = world.step(&action);
        let (scene, goal) = (world.scene(), world.blueprint());
        let is_right = |joint: &&Joint| joint.is_right(goal);
        score.n_broken += before.iter().filter(is_right).filter(|joint| !scene.joints.contains(joint)).count();
        if result.status != Status::Running {
            score.n_episodes += 1;
            score.n_built += u32::from(result.status == Status::Success);
            score.links += scene.joints.iter().filter(is_right).count() as f64 / goal.links().len() as f64;
            return;
        }
    }
}

fn choose(seen: &Observation<'_>, proposals: &Proposals, focus: &mut Focus, rng: &mut ChaCha8Rng) -> [Draw; 2] {
    let (scene, goal) = (seen.scene, seen.blueprint);
    let pieces = scene.pieces(goal);
    let size = |block: BlockIdx| pieces.iter().filter(|&&piece| piece == pieces[block.get()]).count();
    let smaller_first = |a, b| if size(a) <= size(b) { (a, b) } else { (b, a) };
    let hold = |block| (block, Slot::HOLD);
    let is_wrong = |joint: &&Joint| !joint.is_right(goal);
    if let Some(wrong) = scene.joints.iter().find(is_wrong) {
        let (i, j) = smaller_first(wrong.a, wrong.b);
        return [(i, Slot::paired(Kind::Detach, j)), hold(j)];
    }
    let is_joined = |a, b| scene.joints.iter().any(|joint| [(a, b), (b, a)].contains(&(joint.a, joint.b)));
    let offered = |block: BlockIdx, kind, partner| proposals.slots(block).contains(&Slot::paired(kind, partner));
    let open = goal.links().iter().filter(|link| !is_joined(link.a, link.b)).map(|link| smaller_first(link.a, link.b));
    let mut open: Vec<(BlockIdx, BlockIdx)> = open.filter(|&(i, j)| offered(i, Kind::Join, j)).collect();
    // The largest piece first, and of its links the nearest: entry 4 of a relation falls with the steps that are left.
    let nearness = |(i, j): (BlockIdx, BlockIdx)| proposals.relation(i, j)[4];
    open.sort_by(|&x, &y| size(y.1).cmp(&size(x.1)).then(nearness(y).total_cmp(&nearness(x))));
    let Some(&first) = open.first() else {
        let block = goal.placements()[0].block;
        return [hold(block), hold(block)];
    };
    let (i, j, n_steps) = focus.filter(|&(i, j, n)| n < PATIENCE && open.contains(&(i, j))).unwrap_or_else(|| {
        // One time in five another of the nearest three, so that nothing is tried forever.
        let other = open[rng.random_range(0..open.len().min(3))];
        let (i, j) = if rng.random_bool(0.8) { first } else { other };
        (i, j, 0)
    });
    *focus = Some((i, j, n_steps + 1));
    [(i, Slot::paired(Kind::Join, j)), (j, Slot::paired(Kind::Join, i))]
}

//! Counts how episodes end, by the size of their goal: where to look when success stays where it is.

use std::collections::BTreeMap;

use blueprints::{Blueprint, Catalog};
use nalgebra::Vector3;
use parking_lot::Mutex;
use policy::proposals::Slot;
use proto::{ActionMode, Joint, Scene, Trajectory};

use crate::report::{End, EpisodeResult};

/// Number of steps without movement after which an episode counts as still.
const STILL_STEPS: usize = 20;
/// Largest distance that a block moves in them, m.
const STILL_M: f32 = 0.03;
/// Number of steps without a new correct connection after which an episode counts as stuck.
const STUCK_STEPS: usize = 30;

/// How an episode ended. Of several that apply, the first counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Ending {
    /// The goal was built.
    Built,
    /// The physics diverged.
    Diverged,
    /// No block of the goal moved by more than 3 cm in the last 20 steps.
    Still,
    /// A wrong connection was left.
    Wrong,
    /// All connections were made, but a pair was not in place.
    Misplaced,
    /// No correct connection was made in the last 30 steps.
    Stuck,
    /// Time ran out while connections were still being made.
    Time,
}

/// How the episodes with goals of one size ended.
#[derive(Debug, Default)]
struct SizeEndings {
    /// Number of episodes by ending.
    endings: BTreeMap<Ending, u64>,
    /// Number of wrong connections that formed.
    n_wrong: u64,
    /// Number of correct connections that broke.
    n_broken: u64,
    /// Number of correct connections missing at the ends.
    n_missing: u64,
    /// Number of draws by kind of proposal; empty for another policy head.
    draws: BTreeMap<String, u64>,
}

/// Collects the endings of episodes, by action mode and number of blocks.
#[derive(Debug, Default)]
pub struct Endings(Mutex<BTreeMap<(ActionMode, usize), SizeEndings>>);

impl Endings {
    /// Formats what was collected as lines, each ending with a line break: the share of each ending in percent; wrong
    /// connections, broken ones, and missing ones at the end, per episode; and the shares of draws by kind of proposal,
    /// in percent.
    pub fn table(&self) -> String {
        let mut text = format!(
            "{:<7} {:>6} {:>6} {:>6} {:>5} {:>5} {:>5} {:>5} {:>5} {:>5} {:>5}  draws, %\n",
            "actions", "blocks", "of", "built", "still", "wrong", "misp.", "stuck", "time", "div.", "w/b/m"
        );
        for ((acting, n_blocks), size) in &*self.0.lock() {
            let acting = acting.name();
            let n = size.endings.values().sum::<u64>().max(1) as f64;
            let share = |ending: Ending| 100.0 * size.endings.get(&ending).copied().unwrap_or(0) as f64 / n;
            let shares = [Ending::Built, Ending::Still, Ending::Wrong, Ending::Misplaced, Ending::Stuck, Ending::Time];
            let shares = shares.map(|ending| format!("{:>5.1}", share(ending))).join(" ");
            let n_draws = size.draws.values().sum::<u64>().max(1) as f64;
            let draw = |(kind, &n): (&String, &u64)| format!("{kind} {:.0}", 100.0 * n as f64 / n_draws);
            let draws: Vec<String> = size.draws.iter().map(draw).collect();
            text += &format!(
                "{acting:<7} {n_blocks:>6} {n:>6}  {shares} {:>5.1} {:.1}/{:.1}/{:.1}  {}\n",
                share(Ending::Diverged),
                size.n_wrong as f64 / n,
                size.n_broken as f64 / n,
                size.n_missing as f64 / n,
                draws.join(" ")
            );
        }
        text
    }

    /// Counts an episode of a goal of the catalog.
    pub(crate) fn count(&self, catalog: &Catalog, episode: &Trajectory, result: &EpisodeResult) {
        let goal = catalog.get(&episode.task.blueprint).expect("the episode began with it");
        let goal = goal.permuted(&episode.task.assignment);
        let (steps, last) = (&episode.transitions, &episode.last_scene);
        let scenes: Vec<&Scene> = steps.iter().map(|step| &step.scene).chain([last]).collect();
        let n_right: Vec<u64> = scenes.iter().map(|scene| count(scene, |joint| joint.is_right(&goal))).collect();
        let n_right_left = count(last, |joint| joint.is_right(&goal));
        let n_missing = goal.links().len() as u64 - n_right_left;
        let steps_since_gain = n_right.array_windows().rev().take_while(|[before, after]| after <= before).count();
        let ending = match result.end {
            End::Success { .. } => Ending::Built,
            End::Diverged => Ending::Diverged,
            End::TimeLimit if is_still(&scenes, &goal) => Ending::Still,
            End::TimeLimit if last.joints.len() as u64 > n_right_left => Ending::Wrong,
            End::TimeLimit if n_missing == 0 => Ending::Misplaced,
            End::TimeLimit if steps_since_gain >= STUCK_STEPS => Ending::Stuck,
            End::TimeLimit => Ending::Time,
        };
        let mut sizes = self.0.lock();
        let size = sizes.entry((result.acting, result.n_blocks)).or_default();
        *size.endings.entry(ending).or_default() += 1;
        size.n_missing += n_missing;
        for [before, after] in scenes.array_windows() {
            size.n_wrong += count(after, |joint| !before.joints.contains(joint) && !joint.is_right(&goal));
            size.n_broken += count(before, |joint| !after.joints.contains(joint) && joint.is_right(&goal));
        }
        let slots = steps.iter().flat_map(|step| step.proposals.into_iter().flatten());
        for slot in slots.filter_map(Slot::from_index) {
            *size.draws.entry(slot.kind().name().to_owned()).or_default() += 1;
        }
    }
}

/// Whether no block of the goal moved in the last steps.
fn is_still(scenes: &[&Scene], goal: &Blueprint) -> bool {
    let Some(first) = scenes.iter().skip(1).rev().nth(STILL_STEPS) else { return false };
    let Some(last) = scenes.last() else { return false };
    goal.placements().iter().all(|placement| {
        let [from, to] = [first, last].map(|scene| Vector3::from(scene.blocks[placement.block.get()].position));
        (from - to).norm() < STILL_M
    })
}

fn count(scene: &Scene, wanted: impl Fn(&Joint) -> bool) -> u64 {
    scene.joints.iter().filter(|joint| wanted(joint)).count() as u64
}

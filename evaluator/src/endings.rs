//! Counts how episodes end, by the size of their goal: where to look when success stays where it is.

use std::collections::{BTreeMap, VecDeque};

use environment::Step;
use nalgebra::Vector3;
use parking_lot::Mutex;
use policy::proposals::Slot;
use proto::{Joint, Observation, Scene};

use crate::report::{End, EpisodeResult};

/// Number of steps without movement after which an episode counts as still.
const STILL_STEPS: usize = 20;
/// Largest distance that a block moves in them, m.
const STILL_M: f32 = 0.03;
/// Number of steps without a new correct connection after which an episode counts as stuck.
const STUCK_STEPS: u32 = 30;

/// How an episode ended. Of several that apply, the first counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ending {
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
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SizeEndings {
    /// Number of episodes by ending.
    pub endings: BTreeMap<Ending, u64>,
    /// Number of wrong connections that formed.
    pub n_wrong: u64,
    /// Number of correct connections that broke.
    pub n_broken: u64,
    /// Number of correct connections missing at the ends.
    pub n_missing: u64,
    /// Number of draws by kind of proposal; empty for another policy head.
    pub draws: BTreeMap<String, u64>,
}

impl SizeEndings {
    /// Returns the number of episodes.
    pub fn n_episodes(&self) -> u64 {
        self.endings.values().sum()
    }
}

/// Collects the endings of episodes, by action mode and size.
#[derive(Debug, Default)]
pub struct Endings(Mutex<BTreeMap<(&'static str, usize), SizeEndings>>);

impl Endings {
    /// Returns what was collected, by action mode (`greedy` or `sampled`) and number of blocks.
    pub fn into_sizes(self) -> BTreeMap<(&'static str, usize), SizeEndings> {
        self.0.into_inner()
    }

    /// Counts an episode that has ended.
    pub(crate) fn count(&self, record: EndingRecord, result: &EpisodeResult) {
        let ending = record.ending(result.end);
        let mut sizes = self.0.lock();
        let size = sizes.entry((result.acting.name(), result.n_blocks)).or_default();
        *size.endings.entry(ending).or_default() += 1;
        size.n_wrong += u64::from(record.n_wrong);
        size.n_broken += u64::from(record.n_broken);
        size.n_missing += u64::from(record.n_missing);
        record.draws.into_iter().for_each(|(kind, n)| *size.draws.entry(kind).or_default() += n);
    }
}

/// What is kept of a running episode.
pub(crate) struct EndingRecord {
    /// Positions of the goal's blocks in the last scenes, oldest first.
    recent: VecDeque<Vec<Vector3<f32>>>,
    /// Correct connections in the newest scene.
    n_right: u32,
    /// Steps since their number last grew.
    steps_since_gain: u32,
    /// Wrong connections that formed.
    n_wrong: u32,
    /// Correct connections that broke.
    n_broken: u32,
    /// Wrong connections after the newest step.
    n_wrong_left: u32,
    /// Correct connections missing after the newest step.
    n_missing: u32,
    draws: BTreeMap<String, u64>,
}

impl EndingRecord {
    pub(crate) fn new(start: Observation<'_>) -> Self {
        Self {
            recent: VecDeque::new(),
            n_right: count(start.scene, |joint| joint.is_right(start.blueprint)),
            steps_since_gain: 0,
            n_wrong: 0,
            n_broken: 0,
            n_wrong_left: 0,
            n_missing: 0,
            draws: BTreeMap::new(),
        }
    }

    /// Counts what a step to the observation `after` changed.
    pub(crate) fn note(&mut self, step: &Step, after: Observation<'_>) {
        let (before, Observation { scene, blueprint }) = (&step.scene, after);
        let is_new = |joint: &Joint| !before.joints.contains(joint);
        self.n_wrong += count(scene, |joint| is_new(joint) && !joint.is_right(blueprint));
        self.n_broken += count(before, |joint| !scene.joints.contains(joint) && joint.is_right(blueprint));
        let n_right = count(scene, |joint| joint.is_right(blueprint));
        self.steps_since_gain = if n_right > self.n_right { 0 } else { self.steps_since_gain + 1 };
        self.n_right = n_right;
        self.n_wrong_left = scene.joints.len() as u32 - n_right;
        self.n_missing = blueprint.links().len() as u32 - n_right;
        for slot in step.decision.proposals.iter().flatten().filter_map(|&slot| Slot::from_index(slot)) {
            *self.draws.entry(slot.kind().name().to_owned()).or_default() += 1;
        }
        if self.recent.len() > STILL_STEPS {
            self.recent.pop_front();
        }
        let places = blueprint.placements().iter();
        self.recent.push_back(places.map(|p| Vector3::from(scene.blocks[p.block.get()].position)).collect());
    }

    fn ending(&self, end: End) -> Ending {
        match end {
            End::Success { .. } => Ending::Built,
            End::Diverged => Ending::Diverged,
            End::TimeLimit if self.is_still() => Ending::Still,
            End::TimeLimit if self.n_wrong_left > 0 => Ending::Wrong,
            End::TimeLimit if self.n_missing == 0 => Ending::Misplaced,
            End::TimeLimit if self.steps_since_gain >= STUCK_STEPS => Ending::Stuck,
            End::TimeLimit => Ending::Time,
        }
    }

    fn is_still(&self) -> bool {
        let (Some(first), Some(last)) = (self.recent.front(), self.recent.back()) else { return false };
        self.recent.len() > STILL_STEPS && first.iter().zip(last).all(|(a, b)| (a - b).norm() < STILL_M)
    }
}

fn count(scene: &Scene, wanted: impl Fn(&Joint) -> bool) -> u32 {
    scene.joints.iter().filter(|joint| wanted(joint)).count() as u32
}

//! Counts how episodes end, by the size of their goal: where to look when success stays where it is.

use std::collections::{BTreeMap, VecDeque};

use environment::Step;
use nalgebra::Vector3;
use parking_lot::Mutex;
use policy::proposals::Slot;
use proto::{ActionMode, Observation, Scene};
use serde::{Deserialize, Serialize};

use crate::connections::Connections;
use crate::report::{End, EpisodeResult};
use crate::sequences::{EpisodeObserver, EpisodeSpec, Place};

/// Number of steps without movement after which an episode counts as still.
const STILL_STEPS: usize = 20;
/// Largest distance that a block moves in them, m.
const STILL_M: f32 = 0.03;
/// Number of steps without a new correct connection after which an episode counts as stuck.
const STUCK_STEPS: u32 = 30;

/// How an episode ended. Of several that apply, the first counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
}

/// What is kept of a running episode.
pub(crate) struct EpisodeRecord {
    /// Positions of the goal's blocks in the last scenes, oldest first.
    recent: VecDeque<Vec<Vector3<f32>>>,
    connections: Connections,
    draws: BTreeMap<String, u64>,
}

impl EpisodeObserver for Option<&Endings> {
    type Record = EpisodeRecord;

    fn begin(&self, _: Place, _: &EpisodeSpec, _: ActionMode, start: Observation<'_>) -> Option<EpisodeRecord> {
        self.map(|_| EpisodeRecord {
            recent: VecDeque::new(),
            connections: Connections::new(start),
            draws: BTreeMap::new(),
        })
    }

    fn observe(&self, record: &mut EpisodeRecord, step: Step, after: Observation<'_>) {
        record.note(&step, after);
    }

    fn end(&self, record: EpisodeRecord, spec: &EpisodeSpec, _: &Scene, result: &EpisodeResult) {
        let Some(endings) = self else { return };
        let Connections { n_wrong, n_broken, n_missing, .. } = record.connections;
        let found = SizeEndings {
            endings: [(record.ending(result.end), 1)].into(),
            n_wrong: n_wrong.into(),
            n_broken: n_broken.into(),
            n_missing: n_missing.into(),
            draws: record.draws,
        };
        endings.0.lock().entry((result.acting.name(), spec.n_blocks)).or_default().add(found);
    }
}

impl EpisodeRecord {
    fn note(&mut self, step: &Step, after: Observation<'_>) {
        self.connections.note(&step.scene, after);
        for slot in step.decision.proposals.iter().flatten().filter_map(|&slot| Slot::from_index(slot)) {
            *self.draws.entry(slot.kind().name().to_owned()).or_default() += 1;
        }
        if self.recent.len() > STILL_STEPS {
            self.recent.pop_front();
        }
        let places = after.blueprint.placements().iter();
        self.recent.push_back(places.map(|p| Vector3::from(after.scene.blocks[p.block.get()].position)).collect());
    }

    fn ending(&self, end: End) -> Ending {
        match end {
            End::Success { .. } => Ending::Built,
            End::Diverged => Ending::Diverged,
            End::TimeLimit if self.is_still() => Ending::Still,
            End::TimeLimit if self.connections.n_wrong_left > 0 => Ending::Wrong,
            End::TimeLimit if self.connections.n_missing == 0 => Ending::Misplaced,
            End::TimeLimit if self.connections.steps_since_gain >= STUCK_STEPS => Ending::Stuck,
            End::TimeLimit => Ending::Time,
        }
    }

    fn is_still(&self) -> bool {
        let (Some(first), Some(last)) = (self.recent.front(), self.recent.back()) else { return false };
        self.recent.len() > STILL_STEPS && first.iter().zip(last).all(|(a, b)| (a - b).norm() < STILL_M)
    }
}

impl SizeEndings {
    fn add(&mut self, other: Self) {
        other.endings.into_iter().for_each(|(ending, n)| *self.endings.entry(ending).or_default() += n);
        other.draws.into_iter().for_each(|(kind, n)| *self.draws.entry(kind).or_default() += n);
        self.n_wrong += other.n_wrong;
        self.n_broken += other.n_broken;
        self.n_missing += other.n_missing;
    }
}

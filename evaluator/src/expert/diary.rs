//! Records the expert's episodes, so that each failure has a cause and a replay.

use std::collections::BTreeMap;
use std::fmt;

use blueprints::BlueprintId;
use environment::{Activity, ExpertAgent, Step};
use parking_lot::Mutex;
use proto::{ActionMode, Observation, Scene, Trajectory};
use serde::{Deserialize, Serialize};

use crate::connections::Connections;
use crate::recording::{Credits, Recording};
use crate::report::{End, EpisodeResult};
use crate::sequences::{EpisodeObserver, EpisodeSpec, Place};

/// Minimum number of steps spent on a problem for it to count as the cause.
const MANY_STEPS: u32 = 15;
/// Minimum number of steps without a new connection for the expert to count as stuck.
const STUCK_STEPS: u32 = 30;

/// Why an episode failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The blueprint has no order of assembly.
    NoOrder,
    /// The physics diverged.
    Diverged,
    /// Wrong connections formed, and taking them apart took too long or was not finished.
    WrongConnection,
    /// Correct connections broke.
    Break,
    /// Moving blocks out of the way took too long.
    Clutter,
    /// No new connection formed for a long time.
    Stuck,
    /// Time ran out, although the episode went well.
    #[default]
    Time,
}

/// Statistics of an episode, and the cause of its failure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trouble {
    /// Cause of the failure.
    pub cause: Cause,
    /// Steps of the episode.
    pub n_steps: u32,
    /// Steps spent on taking apart, not counting those before the first block was fetched.
    pub n_repair_steps: u32,
    /// Steps spent on taking apart before the first block was fetched, because of blocks built at the start.
    pub n_takedown_steps: u32,
    /// Steps spent on moving blocks out of the way.
    pub n_clearing_steps: u32,
    /// Wrong connections that formed.
    pub n_wrong_snaps: u32,
    /// Correct connections that broke.
    pub n_breaks: u32,
    /// Wrong connections at the end.
    pub n_wrong_left: u32,
    /// Correct connections missing at the end.
    pub n_missing: u32,
}

/// A failed episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertFailure {
    /// The goal.
    pub blueprint: BlueprintId,
    /// Index of the episode, from 0.
    pub episode_idx: u64,
    /// Statistics and cause.
    #[serde(flatten)]
    pub trouble: Trouble,
    /// Every step, for a replay; not part of the report's JSON. `None` if the episode has no steps.
    #[serde(skip)]
    pub replay: Option<Trajectory>,
}

/// Replays collected during an evaluation of the expert.
#[derive(Default)]
pub(super) struct Diaries(Mutex<Replays>);

#[derive(Default)]
struct Replays {
    failures: BTreeMap<Place, ExpertFailure>,
    /// The first success of each sequence: one is enough to look at, and all of them would take gigabytes.
    successes: BTreeMap<usize, Trajectory>,
}

/// The record of one episode.
pub(super) struct Diary {
    place: Place,
    recording: Recording,
    trouble: Trouble,
    has_no_order: bool,
    has_fetched: bool,
    connections: Connections,
}

impl Diaries {
    /// Returns the failures and the first success of each sequence, in the order of the sequences.
    pub(super) fn into_replays(self) -> (Vec<ExpertFailure>, Vec<Trajectory>) {
        let Replays { failures, successes } = self.0.into_inner();
        (failures.into_values().collect(), successes.into_values().collect())
    }
}

impl EpisodeObserver<ExpertAgent> for Diaries {
    type Record = Diary;

    fn begin(&self, place: Place, _: &EpisodeSpec, _: ActionMode, start: Observation<'_>) -> Option<Diary> {
        Some(Diary {
            place,
            recording: Recording::default(),
            trouble: Trouble::default(),
            has_no_order: false,
            has_fetched: false,
            connections: Connections::new(start),
        })
    }

    fn observe(&self, diary: &mut Diary, step: Step, agent: &ExpertAgent, row: usize, after: Observation<'_>) {
        diary.note(step, agent.activity(row), after);
    }

    fn end(&self, diary: Diary, spec: &EpisodeSpec, last: &Scene, result: &EpisodeResult) {
        let place = diary.place;
        let trouble = diary.trouble(result.end);
        let replay = diary.recording.into_trajectory(Credits::of_expert(), &spec.task, last, result);
        let mut kept = self.0.lock();
        match (result.end, replay) {
            (End::Success { .. }, Some(replay)) => {
                kept.successes.entry(place.sequence_idx).or_insert(replay);
            }
            (End::Success { .. }, None) => {}
            (End::TimeLimit | End::Diverged, replay) => {
                let blueprint = result.blueprint.clone();
                let episode_idx = place.episode_idx as u64;
                kept.failures.insert(place, ExpertFailure { blueprint, episode_idx, trouble, replay });
            }
        }
    }
}

impl Diary {
    /// Records a step: the step itself, its purpose (`None` without an order of assembly), and the resulting
    /// observation.
    fn note(&mut self, step: Step, activity: Option<Activity>, after: Observation<'_>) {
        let trouble = &mut self.trouble;
        trouble.n_steps += 1;
        match activity {
            Some(Activity::TakingDown) if self.has_fetched => trouble.n_repair_steps += 1,
            Some(Activity::TakingDown) => trouble.n_takedown_steps += 1,
            Some(Activity::Clearing) => trouble.n_clearing_steps += 1,
            Some(Activity::Adding) => self.has_fetched = true,
            Some(Activity::Settling) => {}
            None => self.has_no_order = true,
        }
        self.connections.note(&step.scene, after);
        self.recording.push(step);
    }

    /// Returns the statistics of an episode with this end, including the cause.
    fn trouble(&self, end: End) -> Trouble {
        let t = &self.trouble;
        let c = &self.connections;
        let cause = if self.has_no_order {
            Cause::NoOrder
        } else if end == End::Diverged {
            Cause::Diverged
        } else if c.n_wrong_left > 0 || t.n_repair_steps >= MANY_STEPS {
            Cause::WrongConnection
        } else if t.n_clearing_steps >= MANY_STEPS {
            Cause::Clutter
        } else if c.n_broken > 1 {
            Cause::Break
        } else if c.steps_since_gain >= STUCK_STEPS {
            Cause::Stuck
        } else {
            Cause::Time
        };
        Trouble {
            cause,
            n_wrong_snaps: c.n_wrong,
            n_breaks: c.n_broken,
            n_wrong_left: c.n_wrong_left,
            n_missing: c.n_missing,
            ..*t
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::NoOrder => "no order of assembly",
            Self::Diverged => "diverged",
            Self::WrongConnection => "wrong connection",
            Self::Break => "break",
            Self::Clutter => "clutter",
            Self::Stuck => "stuck",
            Self::Time => "time",
        })
    }
}

//! Selects the episodes of an evaluation to record: those that could become a requested success or failure video.

use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use blueprints::{BlueprintId, Group};
use environment::Step;
use proto::{ActionMode, Observation, Scene, Weights};

use super::queue::{ClipQueue, VideoRequest};
use crate::config::VideosConfig;
use crate::recording::{Credits, Recording};
use crate::report::{End, EpisodeResult};
use crate::sequences::{EpisodeObserver, EpisodeSpec};
use runlog::videos::Ending;

/// Maximum number of episodes recorded at a time. At a kilobyte per step, this takes some tens of megabytes.
const MAX_RECORDING: usize = 256;

/// Selects the episodes to record in one evaluation.
///
/// It is not known in advance which episodes will succeed, so all episodes that may be needed are recorded, and most
/// recordings are discarded.
#[derive(Debug)]
pub(crate) struct EpisodeSelector {
    weights: Arc<Weights>,
    acting: ActionMode,
    open: Mutex<Open>,
    queue: Arc<ClipQueue>,
}

/// A group or blueprint to record.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Subject {
    Group(Group),
    Blueprint(BlueprintId),
}

#[derive(Debug)]
struct Open {
    missing: BTreeSet<(Subject, Ending)>,
    n_taken: BTreeMap<(BlueprintId, Ending), u32>,
    n_recording: usize,
}

impl EpisodeSelector {
    /// Creates the selector for an evaluation of `weights`. Only episodes with the action mode `acting` are recorded.
    pub(super) fn new(config: &VideosConfig, weights: Arc<Weights>, acting: ActionMode, queue: Arc<ClipQueue>) -> Self {
        let groups = config.groups.iter().copied().map(Subject::Group);
        let subjects = groups.chain(config.blueprints.iter().cloned().map(Subject::Blueprint));
        let missing = subjects.flat_map(|subject| Ending::ALL.map(|ending| (subject.clone(), ending))).collect();
        let open = Mutex::new(Open { missing, n_taken: BTreeMap::new(), n_recording: 0 });
        Self { weights, acting, open, queue }
    }
}

impl EpisodeObserver for EpisodeSelector {
    type Record = Recording;

    fn begin(&self, _: usize, spec: &EpisodeSpec, acting: ActionMode, _: Observation<'_>) -> Option<Recording> {
        if acting != self.acting {
            return None;
        }
        let mut open = self.open.lock();
        if !subjects(spec).any(|subject| Ending::ALL.iter().any(|&ending| open.lacks(&subject, ending))) {
            return None;
        }
        if open.n_recording >= MAX_RECORDING {
            self.queue.count_unrecorded();
            return None;
        }
        open.n_recording += 1;
        Some(Recording::default())
    }

    fn observe(&self, recording: &mut Recording, step: Step, _: Observation<'_>) {
        recording.push(step);
    }

    fn end(&self, recording: Recording, spec: &EpisodeSpec, last: &Scene, result: &EpisodeResult) {
        let ending = match result.end {
            End::Success { .. } => Ending::Success,
            End::TimeLimit | End::Diverged => Ending::Failure,
        };
        let mut open = self.open.lock();
        open.n_recording = open.n_recording.saturating_sub(1);
        let wanted: Vec<Subject> = subjects(spec).filter(|subject| open.lacks(subject, ending)).collect();
        if wanted.is_empty() {
            return;
        }
        let credits = Credits::of_policy("evaluator", result.acting, self.weights.version);
        let task = &spec.task;
        let trajectory = recording.into_trajectory(credits, task, last, result);
        for subject in wanted {
            open.missing.remove(&(subject, ending));
        }
        let number = open.n_taken.entry((task.blueprint.clone(), ending)).or_insert(0);
        *number += 1;
        self.queue.offer(VideoRequest { trajectory, ending, number: *number });
    }
}

impl Open {
    fn lacks(&self, subject: &Subject, ending: Ending) -> bool {
        self.missing.contains(&(subject.clone(), ending))
    }
}

fn subjects(spec: &EpisodeSpec) -> impl Iterator<Item = Subject> {
    let group = Group::of(spec.split, spec.n_blocks).map(Subject::Group);
    group.into_iter().chain([Subject::Blueprint(spec.task.blueprint.clone())])
}

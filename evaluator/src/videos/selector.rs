//! Selects the episodes of an evaluation to record: those that could become a requested success or failure video.

use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::sync::Arc;

use blueprints::{BlueprintId, Group, Split};
use proto::{ActionMode, ActorId, Trajectory};

use super::queue::ClipQueue;
use crate::config::VideosConfig;
use crate::recording::Recorder;
use crate::report::{End, EpisodeResult};
use crate::spec::EpisodeSpec;
use runlog::videos::Ending;

/// Maximum number of episodes recorded at a time. At a kilobyte per step, this takes some tens of megabytes.
const MAX_RECORDING: usize = 256;

/// Selects the episodes to record in one evaluation.
///
/// It is not known in advance which episodes will succeed, so all episodes that may be needed are recorded, and most
/// recordings are discarded.
#[derive(Debug)]
pub(crate) struct EpisodeSelector {
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
    n_recording: usize,
}

impl EpisodeSelector {
    /// Creates the selector for an evaluation. Only episodes with the action mode `acting` are recorded.
    pub(super) fn new(config: &VideosConfig, acting: ActionMode, queue: Arc<ClipQueue>) -> Self {
        let groups = config.groups.iter().copied().map(Subject::Group);
        let subjects = groups.chain(config.blueprints.iter().cloned().map(Subject::Blueprint));
        let missing = subjects.flat_map(|subject| Ending::ALL.map(|ending| (subject.clone(), ending))).collect();
        let open = Mutex::new(Open { missing, n_recording: 0 });
        Self { acting, open, queue }
    }
}

impl Recorder for EpisodeSelector {
    fn wants(&self, spec: &EpisodeSpec, acting: ActionMode) -> bool {
        if acting != self.acting {
            return false;
        }
        let mut open = self.open.lock();
        let mut subjects = subjects(&spec.task.blueprint, spec.split, spec.n_blocks);
        if !subjects.any(|subject| Ending::ALL.iter().any(|&ending| open.lacks(&subject, ending))) {
            return false;
        }
        if open.n_recording >= MAX_RECORDING {
            self.queue.count(|counts| counts.unrecorded_total += 1);
            return false;
        }
        open.n_recording += 1;
        true
    }

    fn keep(&self, _: usize, episode: Trajectory, result: &EpisodeResult) {
        let ending = match result.end {
            End::Success { .. } => Ending::Success,
            End::TimeLimit | End::Diverged => Ending::Failure,
        };
        let mut open = self.open.lock();
        open.n_recording = open.n_recording.saturating_sub(1);
        let subjects = subjects(&result.blueprint, result.split, result.n_blocks);
        let wanted: Vec<Subject> = subjects.filter(|subject| open.lacks(subject, ending)).collect();
        if wanted.is_empty() {
            return;
        }
        for subject in wanted {
            open.missing.remove(&(subject, ending));
        }
        let actor = ActorId::try_from("evaluator".to_owned()).expect("the name is lower case");
        self.queue.offer(Trajectory { actor, ..episode });
    }
}

impl Open {
    fn lacks(&self, subject: &Subject, ending: Ending) -> bool {
        self.missing.contains(&(subject.clone(), ending))
    }
}

fn subjects(blueprint: &BlueprintId, split: Split, n_blocks: usize) -> impl Iterator<Item = Subject> + use<> {
    let group = Group::of(split, n_blocks).map(Subject::Group);
    group.into_iter().chain([Subject::Blueprint(blueprint.clone())])
}

//! What a world did since its last start that owed nothing to the episode before: enough to replay it.

use blueprints::BlockIdx;
use environment::{Arrangement, ArrangementError, ResetError};
use proto::{Action, Move, N_GRIPPERS, Scene, Start, Task};

/// Maximum number of steps and starts that are remembered: 1 MB per world. Only worlds whose episodes begin as the last
/// one ended, or that step on and on after an end, get there.
const MAX_EVENTS: usize = 20_000;

/// Bytes of an action: for each gripper, its block and that block's move. Other moves have no effect.
const ACTION_BYTES: usize = N_GRIPPERS * (1 + size_of::<Move>());

/// The byte for a gripper that chooses no block.
const NO_BLOCK: u8 = u8::MAX;

/// The task as JSON, the actions, and the scene that was set as JSON.
pub(crate) type EpisodeState = (String, Vec<u8>, Option<String>);

/// Episodes, the first of which started afresh.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    episodes: Vec<Episode>,
    n_events: usize,
    /// Whether there were too many events to remember.
    is_lost: bool,
}

#[derive(Clone, Debug)]
struct Episode {
    task: Task,
    /// The scene that was set after the start.
    scene: Option<Arrangement>,
    /// The actions after the start, or after the scene was set.
    actions: Vec<u8>,
}

/// Why a history cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum HistoryError {
    /// It is not one that [`History::state`] returned.
    #[error("the pickle is damaged")]
    Damaged,
    #[error("an episode cannot start")]
    Reset(#[from] ResetError),
    #[error("a scene cannot be set")]
    Scene(#[from] ArrangementError),
    #[error(
        "it comes out differently here; pickles are for the same version of the package on the same kind of machine"
    )]
    Different,
    #[error("it has gone on for more than {MAX_EVENTS} steps since it last began with a start other than as-it-is")]
    Lost,
}

impl History {
    /// Adds the start of an episode.
    pub(crate) fn begin(&mut self, task: &Task) {
        if task.start != Start::AsItIs {
            *self = Self::default();
        }
        if self.has_room() {
            self.episodes.push(Episode { task: task.clone(), scene: None, actions: Vec::new() });
        }
    }

    /// Replaces the steps of the episode with a scene that is set.
    pub(crate) fn set_scene(&mut self, scene: &Arrangement) {
        if let Some(episode) = self.episodes.last_mut() {
            self.n_events -= episode.actions.len() / ACTION_BYTES;
            episode.actions.clear();
            episode.scene = Some(scene.clone());
        }
    }

    /// Adds a step.
    pub(crate) fn step(&mut self, action: &Action) {
        if !self.has_room() {
            return;
        }
        let Some(Episode { actions, .. }) = self.episodes.last_mut() else { return };
        for choice in action.choices {
            actions.push(choice.map_or(NO_BLOCK, u8::from));
            let numbers = choice.map_or([0.0; 6], |block| action.moves[block.get()]);
            actions.extend(numbers.into_iter().flat_map(f32::to_le_bytes));
        }
    }

    /// Counts an event and returns whether it can be remembered.
    fn has_room(&mut self) -> bool {
        self.n_events += 1;
        if self.n_events > MAX_EVENTS {
            *self = Self { is_lost: true, ..Self::default() };
        }
        !self.is_lost
    }

    /// Returns the episodes as plain values.
    pub(crate) fn state(&self) -> Result<Vec<EpisodeState>, HistoryError> {
        if self.is_lost {
            return Err(HistoryError::Lost);
        }
        let state = |Episode { task, scene, actions }: &Episode| {
            let scene = scene.as_ref().map(serde_json::to_string).transpose()?;
            Ok((serde_json::to_string(task)?, actions.clone(), scene))
        };
        let states: Result<_, serde_json::Error> = self.episodes.iter().map(state).collect();
        states.map_err(|_| HistoryError::Damaged)
    }
}

/// Returns the bytes of what a replay must lead to.
pub(crate) fn fingerprint(scene: &Scene) -> Vec<u8> {
    let poses = scene.blocks.iter().flat_map(|pose| pose.position.into_iter().chain(pose.orientation));
    poses.chain(scene.speeds_mps).flat_map(f32::to_le_bytes).collect()
}

/// Returns the task, the set scene, and the actions of an episode; `None` if they are damaged.
pub(crate) fn read((task, actions, scene): &EpisodeState) -> Option<(Task, Option<Arrangement>, Vec<Action>)> {
    let scene = scene.as_ref().map(|scene| serde_json::from_str(scene)).transpose().ok()?;
    let (actions, rest) = actions.as_chunks::<ACTION_BYTES>();
    let actions: Option<Vec<Action>> = actions.iter().map(action).collect();
    rest.is_empty().then_some((serde_json::from_str(task).ok()?, scene, actions?))
}

fn action(bytes: &[u8; ACTION_BYTES]) -> Option<Action> {
    let mut action = Action::IDLE;
    let grippers = bytes.as_chunks::<{ ACTION_BYTES / N_GRIPPERS }>().0;
    for (choice, [block, numbers @ ..]) in action.choices.iter_mut().zip(grippers) {
        if *block == NO_BLOCK {
            continue;
        }
        let block = BlockIdx::try_from(*block).ok()?;
        *choice = Some(block);
        for (x, bytes) in action.moves[block.get()].iter_mut().zip(numbers.as_chunks::<4>().0) {
            *x = f32::from_le_bytes(*bytes);
        }
    }
    Some(action)
}

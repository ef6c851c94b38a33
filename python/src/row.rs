//! One world of a batch, with the random generator of its episodes.

use environment::{Env, EnvironmentConfig, Expert, ResetError, StartError, StepResult, World};
use policy::FeatureConfig;
use policy::features::write_features;
use proto::{Action, RewardTerms, Scene, Start, Status, Task};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::history::{EpisodeState, History, HistoryError, fingerprint, read};
use crate::picture::Stage;
use crate::tasks::{Tasks, Wish};

/// Maximum number of draws per episode; blocks may not find room.
const MAX_RESETS: usize = 16;

/// Maximum magnitude of a feature. The largest value in a valid world is 200, for two blocks that are each 50 m from
/// the origin; only a diverged world exceeds it.
const MAX_FEATURE: f32 = 256.0;

/// The state of the generator (seed, stream, position), the episodes, and the bytes of the last scene.
pub(crate) type RowState = (Vec<u8>, u64, u128, Vec<EpisodeState>, Vec<u8>);

/// A world and the state of its episode.
#[derive(Clone)]
pub(crate) struct Row {
    pub(crate) world: World,
    /// Generator from which episodes are drawn.
    pub(crate) rng: ChaCha8Rng,
    /// Task of the episode; `None` before the first one.
    pub(crate) task: Option<Task>,
    /// Status of the episode.
    pub(crate) status: Status,
    /// Scene at the start of the episode, which the camera frames.
    pub(crate) opening: Scene,
    /// Camera of the episode, created for its first picture.
    pub(crate) stage: Option<Stage>,
    /// Expert for the episode, created on first use; the inner value is `None` if the blueprint has no assembly order.
    expert: Option<Option<Expert>>,
    history: History,
}

/// Slices for the features of one world: nodes, edges, and globals.
pub(crate) type Features<'a> = [&'a mut [f32]; 3];

impl Row {
    pub(crate) fn new(world: World, rng: ChaCha8Rng) -> Self {
        let (opening, history) = (world.scene().clone(), History::default());
        Self { world, rng, task: None, status: Status::Running, opening, stage: None, expert: None, history }
    }

    /// Draws an episode and starts it. Draws again while the blocks find no room.
    ///
    /// # Errors
    /// Returns an error if the world cannot start the episode, or after 16 attempts. The world is then unchanged.
    pub(crate) fn begin(&mut self, tasks: &Tasks, wish: &Wish) -> Result<(), StartError> {
        let mut n_tried = 1;
        loop {
            let mut task = tasks.draw(wish, &mut self.rng);
            let mut result = self.world.reset(&task, &tasks.goals.catalog);
            // The first episode has no state to begin with, nor has one after a divergence. Who asks for this very
            // start is told.
            if !wish.has_start() && matches!(result, Err(ResetError::NothingToKeep)) {
                task.start = Start::Scattered;
                result = self.world.reset(&task, &tasks.goals.catalog);
            }
            match result {
                Ok(()) => {
                    self.opened(task);
                    return Ok(());
                }
                Err(ResetError::NoRoom(_)) if n_tried < MAX_RESETS => n_tried += 1,
                Err(source) => return Err(StartError { blueprint: task.blueprint, source }),
            }
        }
    }

    /// Takes note of the episode that the world has just started.
    fn opened(&mut self, task: Task) {
        self.history.begin(&task);
        (self.task, self.status) = (Some(task), Status::Running);
        (self.opening, self.stage, self.expert) = (self.world.scene().clone(), None, None);
    }

    /// Advances the world by one step.
    pub(crate) fn step(&mut self, action: &Action) -> StepResult {
        let result = self.world.step(action);
        self.history.step(action);
        self.status = result.status;
        result
    }

    /// Returns what [`restore`](Self::restore) needs.
    ///
    /// # Errors
    /// Returns an error if too much has happened since the last fresh start.
    pub(crate) fn state(&self) -> Result<RowState, HistoryError> {
        let (seed, stream, position) = (self.rng.get_seed(), self.rng.get_stream(), self.rng.get_word_pos());
        Ok((seed.to_vec(), stream, position, self.history.state()?, fingerprint(self.world.scene())))
    }

    /// Brings a new world to a state by replaying its episodes.
    ///
    /// # Errors
    /// Returns an error if the state is damaged or the replay does not lead to it.
    pub(crate) fn restore(&mut self, tasks: &Tasks, state: RowState) -> Result<(), HistoryError> {
        let (seed, stream, position, episodes, last) = state;
        let seed: [u8; 32] = seed.try_into().map_err(|_| HistoryError::Damaged)?;
        self.rng = ChaCha8Rng::from_seed(seed);
        self.rng.set_stream(stream);
        self.rng.set_word_pos(position);
        self.replay(tasks, &episodes)?;
        if fingerprint(self.world.scene()) == last { Ok(()) } else { Err(HistoryError::Different) }
    }

    fn replay(&mut self, tasks: &Tasks, episodes: &[EpisodeState]) -> Result<(), HistoryError> {
        for episode in episodes {
            let (task, actions) = read(episode).ok_or(HistoryError::Damaged)?;
            self.world.reset(&task, &tasks.goals.catalog)?;
            self.opened(task);
            for action in actions {
                self.step(&action);
            }
        }
        Ok(())
    }

    /// Writes the policy's features.
    pub(crate) fn observe(&self, config: &FeatureConfig, [nodes, edges, globals]: Features<'_>) {
        write_features(&self.world.observation(), config, nodes, edges, globals);
        if self.status == Status::Diverged {
            for x in nodes.iter_mut().chain(edges).chain(globals) {
                *x = if x.is_finite() { x.clamp(-MAX_FEATURE, MAX_FEATURE) } else { 0.0 };
            }
        }
    }

    /// Returns the expert's action; idle if the blueprint has no assembly order.
    pub(crate) fn ask_expert(&mut self, config: &EnvironmentConfig) -> Action {
        let blueprint = self.world.blueprint();
        let expert = self.expert.get_or_insert_with(|| Expert::new(config, blueprint).ok());
        expert.as_mut().map_or(Action::IDLE, |expert| expert.act(self.world.scene()))
    }
}

/// Result of stepping or resetting one world.
#[derive(Clone, Debug)]
pub(crate) struct Outcome {
    pub(crate) reward: RewardTerms,
    pub(crate) status: Status,
    pub(crate) failure: Option<StartError>,
}

impl Default for Outcome {
    fn default() -> Self {
        Self { reward: RewardTerms::default(), status: Status::Running, failure: None }
    }
}

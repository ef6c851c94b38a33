//! One world of a batch, with the random generator of its episodes.

use blueprints::N_BLOCKS;
use environment::{
    Arrangement, ArrangementError, Env, EnvironmentConfig, Expert, ResetError, StartError, StepResult, World,
};
use policy::FeatureConfig;
use policy::features::write_features;
use policy::proposals::Proposals;
use proto::{Action, Observation, SavedRng, Scene, Start, Status, Task};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

use crate::history::{EpisodeState, History, HistoryError, fingerprint, read};
use crate::picture::Stage;
use crate::tasks::{Tasks, Wish};

/// Maximum number of draws per episode; blocks may not find room.
const MAX_RESETS: usize = 16;

/// Maximum magnitude of a feature. The largest value in a valid world is 200, for two blocks that are each 50 m from
/// the origin; only a diverged world exceeds it.
const MAX_FEATURE: f32 = 256.0;

/// The state of the generator (seed, stream, position), the episodes, the bytes of the last scene, and the position of
/// the generator of noise.
pub(crate) type RowState = (Vec<u8>, u64, u128, Vec<EpisodeState>, Vec<u8>, u128);

/// A world and the state of its episode.
#[derive(Clone)]
pub(crate) struct Row {
    pub(crate) world: World,
    /// Generator from which episodes are drawn.
    rng: SavedRng,
    /// Generator of the noise around proposals: another stream of the same seed.
    pub(crate) noise: SavedRng,
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
    /// Proposals of the present scene, made on first use.
    proposals: Option<Proposals>,
    history: History,
}

/// Slices for the features of one world: nodes, edges, and globals.
pub(crate) type Features<'a> = [&'a mut [f32]; 3];

impl Row {
    pub(crate) fn new(world: World, rng: ChaCha8Rng) -> Self {
        let opening = world.scene().clone();
        let history = History::default();
        let (noise, rng) = (noise_beside(&rng), SavedRng(rng));
        let task = None;
        let status = Status::Running;
        Self { world, rng, noise, task, status, opening, stage: None, expert: None, proposals: None, history }
    }

    /// Draws episodes and noise from another seed.
    pub(crate) fn seed(&mut self, rng: ChaCha8Rng) {
        self.noise = noise_beside(&rng);
        self.rng = SavedRng(rng);
    }

    /// Draws an episode and starts it. Draws again while the blocks find no room.
    ///
    /// # Errors
    /// Returns an error if the world cannot start the episode, or after 16 attempts. The world is then unchanged.
    pub(crate) fn begin(&mut self, tasks: &Tasks, wish: &Wish) -> Result<(), StartError> {
        let mut n_tried = 1;
        loop {
            let mut task = tasks.draw(wish, &mut self.rng.0);
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
        self.task = Some(task);
        self.observe_opening();
    }

    fn observe_opening(&mut self) {
        self.status = Status::Running;
        (self.opening, self.stage, self.expert) = (self.world.scene().clone(), None, None);
        self.proposals = None;
    }

    /// Begins the episode anew in a scene.
    ///
    /// # Errors
    /// Returns an error if the scene is illegal. The world is then unchanged.
    pub(crate) fn set_scene(&mut self, scene: &Arrangement) -> Result<(), ArrangementError> {
        self.world.set_scene(scene)?;
        self.history.set_scene(scene);
        self.observe_opening();
        Ok(())
    }

    /// Advances the world by one step.
    pub(crate) fn step(&mut self, action: &Action) -> StepResult {
        let result = self.world.step(action);
        self.proposals = None;
        self.history.step(action);
        self.status = result.status;
        result
    }

    /// Returns what [`restore`](Self::restore) needs.
    pub(crate) fn state(&self) -> Result<RowState, HistoryError> {
        let rng = &self.rng.0;
        let (seed, stream, position) = (rng.get_seed(), rng.get_stream(), rng.get_word_pos());
        let episodes = self.history.state()?;
        let last = fingerprint(self.world.scene());
        Ok((seed.to_vec(), stream, position, episodes, last, self.noise.0.get_word_pos()))
    }

    /// Brings a new world to a state by replaying its episodes.
    pub(crate) fn restore(&mut self, tasks: &Tasks, state: RowState) -> Result<(), HistoryError> {
        let (seed, stream, position, episodes, last, noise) = state;
        let seed: [u8; 32] = seed.try_into().map_err(|_| HistoryError::Damaged)?;
        let mut rng = ChaCha8Rng::from_seed(seed);
        rng.set_stream(stream);
        rng.set_word_pos(position);
        self.seed(rng);
        self.noise.0.set_word_pos(noise);
        for episode in &episodes {
            let (task, scene, actions) = read(episode).ok_or(HistoryError::Damaged)?;
            self.world.reset(&task, &tasks.goals.catalog)?;
            self.opened(task);
            if let Some(scene) = scene {
                self.set_scene(&scene)?;
            }
            for action in actions {
                self.step(&action);
            }
        }
        if fingerprint(self.world.scene()) == last { Ok(()) } else { Err(HistoryError::Different) }
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

    /// Returns the proposals of the scene. After a divergence, they are those of the episode's start: the world steps no
    /// further, and its own would not be finite.
    pub(crate) fn proposals(&mut self) -> &Proposals {
        let Self { world, opening, status, proposals, .. } = self;
        let scene = if *status == Status::Diverged { opening } else { world.scene() };
        let make = || Proposals::new(&Observation { scene, blueprint: world.blueprint() });
        proposals.get_or_insert_with(make)
    }

    /// Returns the blocks that a masked gripper may choose.
    pub(crate) fn allowed(&self) -> [bool; N_BLOCKS] {
        policy::batch::allowed(&self.world.observation())
    }

    /// Returns the expert's action; idle if the blueprint has no assembly order.
    pub(crate) fn ask_expert(&mut self, config: &EnvironmentConfig) -> Action {
        let blueprint = self.world.blueprint();
        let expert = self.expert.get_or_insert_with(|| Expert::new(config, blueprint).ok());
        expert.as_mut().map_or(Action::IDLE, |expert| expert.act(self.world.scene()))
    }
}

/// Returns the generator of noise that goes with a generator of episodes.
fn noise_beside(rng: &ChaCha8Rng) -> SavedRng {
    let mut noise = ChaCha8Rng::from_seed(rng.get_seed());
    noise.set_stream(!rng.get_stream());
    SavedRng(noise)
}

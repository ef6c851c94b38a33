//! One world of a batch, with the generator of its episodes.

use environment::{Env, EnvironmentConfig, Expert, ResetError, StartError, StepResult, World};
use policy::FeatureConfig;
use policy::features::write_features;
use proto::{Action, RewardTerms, Status, Task};
use rand_chacha::ChaCha8Rng;

use crate::picture::Stage;
use crate::tasks::{Tasks, Wish};

/// Episodes that are drawn before one is given up; blocks may find no room.
const MAX_RESETS: usize = 16;

/// Greatest magnitude of a feature. The farthest that a sound world has are two blocks 50 m from the origin each, which is 200;
/// only one that has diverged goes beyond.
const MAX_FEATURE: f32 = 256.0;

/// A world and what belongs to its episode.
pub(crate) struct Row {
    pub(crate) world: World,
    /// Draws the episodes.
    pub(crate) rng: ChaCha8Rng,
    /// The task of the episode; none before the first.
    pub(crate) task: Option<Task>,
    /// How the episode stands.
    pub(crate) status: Status,
    /// The camera of the episode, made for its first picture.
    pub(crate) stage: Option<Stage>,
    /// The expert for the episode, made when it is first asked; none inside if the blueprint has no order of assembly.
    expert: Option<Option<Expert>>,
}

/// Slices for the features of one world: nodes, edges, and globals.
pub(crate) type Features<'a> = [&'a mut [f32]; 3];

impl Row {
    pub(crate) fn new(world: World, rng: ChaCha8Rng) -> Self {
        Self { world, rng, task: None, status: Status::Running, stage: None, expert: None }
    }

    /// Draws an episode and starts it, again as long as the blocks find no room.
    ///
    /// # Errors
    /// When the world cannot start it, or after 16 tries; the world is then as before.
    pub(crate) fn begin(&mut self, tasks: &Tasks, wish: &Wish) -> Result<(), StartError> {
        let mut n_tried = 1;
        loop {
            let task = tasks.draw(wish, &mut self.rng);
            match self.world.reset(&task, &tasks.goals.catalog) {
                Ok(()) => {
                    self.task = Some(task);
                    self.status = Status::Running;
                    self.stage = None;
                    self.expert = None;
                    return Ok(());
                }
                Err(ResetError::NoRoom(_)) if n_tried < MAX_RESETS => n_tried += 1,
                Err(source) => return Err(StartError { blueprint: task.blueprint, source }),
            }
        }
    }

    /// Moves the world by one step.
    pub(crate) fn step(&mut self, action: &Action) -> StepResult {
        let result = self.world.step(action);
        self.status = result.status;
        result
    }

    /// Writes what a policy sees.
    pub(crate) fn observe(&self, config: &FeatureConfig, [nodes, edges, globals]: Features<'_>) {
        write_features(&self.world.observation(), config, nodes, edges, globals);
        if self.status == Status::Diverged {
            for x in nodes.iter_mut().chain(edges).chain(globals) {
                *x = if x.is_finite() { x.clamp(-MAX_FEATURE, MAX_FEATURE) } else { 0.0 };
            }
        }
    }

    /// What the expert does; nothing if the blueprint has no order of assembly.
    pub(crate) fn ask_expert(&mut self, config: &EnvironmentConfig) -> Action {
        let blueprint = self.world.blueprint();
        let expert = self.expert.get_or_insert_with(|| Expert::new(config, blueprint).ok());
        expert.as_mut().map_or(Action::IDLE, |expert| expert.act(self.world.scene()))
    }
}

/// What came of a step or a reset of one world.
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

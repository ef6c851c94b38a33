//! Many worlds, one policy: steps all of them with one forward pass and returns finished segments.

use std::sync::Arc;

use blueprints::Catalog;
use environment::vec_env::generator;
use environment::{Env, ResetError, StartError, Step, VecEnv};
use policy::{Policy, PolicyConfig, PolicyError};
use proto::{ActionMode, CanonicalSettings, Status, Task, Trajectory, Transition, Valid, Weights, WeightsVersion};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::segment::{Cut, Identity, SegmentBuilder};
use crate::setup::ActorSetup;
use crate::task::{FilterError, TaskConfig, TaskSampler};

/// Everything that a rollout needs besides worlds and weights.
#[derive(Clone, Debug)]
pub struct RolloutSetup {
    /// Source of goals and starts.
    pub catalog: Arc<Catalog>,
    /// The policy that acts.
    pub policy: Valid<PolicyConfig>,
    /// Settings of policy and worlds, which must be the learner's.
    pub settings: CanonicalSettings,
    /// Selection of goals and starts.
    pub tasks: TaskConfig,
    /// Steps after which a segment is cut, at least 1.
    pub segment_len: usize,
    /// Origin of the segments.
    pub identity: Identity,
    /// Seed of tasks and actions.
    pub seed: u64,
}

impl RolloutSetup {
    /// Checks that weights are of a run with the settings of this rollout.
    ///
    /// # Errors
    /// [`PolicyError::OtherSettings`] with the first difference.
    pub(crate) fn check(&self, weights: &Weights) -> Result<(), PolicyError> {
        policy::check_settings(weights.version, &weights.settings, &self.settings)
    }

    /// Creates the setup for an actor's rollout.
    pub fn new(setup: &ActorSetup, identity: Identity) -> Self {
        let ActorSetup { config, policy, seed, catalog, .. } = setup;
        Self {
            catalog: catalog.clone(),
            policy: policy.clone(),
            settings: setup.settings(),
            tasks: config.tasks.clone(),
            segment_len: config.segment_len,
            identity,
            seed: *seed,
        }
    }
}

/// Steps a batch of worlds, synchronously and without any I/O or clock. Equal seeds and weights give equal segments.
#[derive(Debug)]
pub struct Rollout<E> {
    setup: RolloutSetup,
    policy: Policy,
    version: WeightsVersion,
    tasks: TaskSampler,
    envs: VecEnv<E>,
    /// One per world.
    slots: Vec<EnvSlot>,
    counters: RolloutCounters,
}

/// Counts since the rollout was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RolloutCounters {
    /// Steps of all worlds.
    pub n_env_steps: u64,
    /// Segments returned.
    pub n_segments: u64,
    /// Episodes that ended in success or at the time limit.
    pub n_episodes: u64,
    /// Episodes that ended in success.
    pub n_successes: u64,
    /// Episodes abandoned because the physics diverged.
    pub n_diverged_episodes: u64,
    /// Dropped steps of those episodes.
    pub n_diverged_steps: u64,
    /// Tasks that a world could not start and that were replaced.
    pub n_failed_resets: u64,
}

/// Reasons why a rollout cannot start or continue.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    /// The task filter selects nothing.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The policy cannot be created or refuses the weights.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A world could not start any of several tasks.
    #[error(transparent)]
    Start(#[from] StartError),
}

/// The current episode of a world, and the generator of its tasks.
#[derive(Debug)]
struct EnvSlot {
    task_rng: ChaCha8Rng,
    segment: SegmentBuilder,
}

impl<E: Env> Rollout<E> {
    /// Starts an episode in each of `worlds`, acting with `weights`.
    ///
    /// # Errors
    /// If the filter selects nothing, the weights do not fit the policy, or no task can be started.
    pub fn new(setup: RolloutSetup, worlds: Vec<E>, weights: &Weights) -> Result<Self, RolloutError> {
        setup.check(weights)?;
        let policy = Policy::with_weights(&setup.policy, weights)?;
        let mut tasks = TaskSampler::new(&setup.tasks, &setup.catalog)?;
        tasks.follow(&weights.task_probabilities);
        let seed = setup.seed;
        let version = weights.version;
        let envs = VecEnv::new(worlds);
        let counters = RolloutCounters::default();
        let mut rollout = Self { setup, policy, version, tasks, envs, slots: Vec::new(), counters };
        rollout.restart(seed)?;
        Ok(rollout)
    }

    /// Acts with other weights from the next step on; episodes continue.
    ///
    /// # Errors
    /// If the weights do not fit the policy; the old ones then stay in use.
    pub fn set_weights(&mut self, weights: &Weights) -> Result<(), RolloutError> {
        self.setup.check(weights)?;
        self.policy.load(weights)?;
        self.tasks.follow(&weights.task_probabilities);
        self.version = weights.version;
        Ok(())
    }

    /// Abandons all episodes and begins new ones as a fresh rollout with `seed` would. The counters continue.
    ///
    /// A run that saves a checkpoint and a run resumed from it both do this, so that they stay equal without saved
    /// worlds.
    ///
    /// # Errors
    /// If no task can be started.
    pub fn restart(&mut self, seed: u64) -> Result<(), RolloutError> {
        self.slots.clear();
        for row in 0..self.envs.n_envs() {
            // Even streams draw tasks and odd ones actions, so neither depends on the number of worlds.
            self.envs.seed(row, generator(seed, 2 * row as u64 + 1));
            let slot = self.begin(row, generator(seed, 2 * row as u64))?;
            self.slots.push(slot);
        }
        Ok(())
    }

    /// Starts an episode in a world with the first task whose blocks find room, as nearly all do.
    fn begin(&mut self, row: usize, mut task_rng: ChaCha8Rng) -> Result<EnvSlot, RolloutError> {
        let setup = &self.setup;
        let task = self.tasks.sample(&mut task_rng);
        let retry = |task: &mut Task, _: &ResetError| {
            self.counters.n_failed_resets += 1;
            *task = self.tasks.sample(&mut task_rng);
            true
        };
        let task = self.envs.reset(row, task, &setup.catalog, retry)?;
        let segment = SegmentBuilder::new(setup.segment_len, task);
        Ok(EnvSlot { task_rng, segment })
    }

    /// Advances every world by one step and returns the segments that this finished, in the order of the
    /// worlds and not yet numbered.
    ///
    /// # Errors
    /// If no new task can be started, or with [`PolicyError::NoDistribution`] before any world has moved. In the latter
    /// case, the rollout can continue with other weights.
    pub fn step(&mut self) -> Result<Vec<Trajectory>, RolloutError> {
        let modes = vec![ActionMode::Sampled; self.slots.len()];
        let steps = self.envs.step(&mut self.policy, &modes)?;
        let mut finished: Vec<Trajectory> = Vec::new();
        let mut ended: Vec<usize> = Vec::new();
        for (row, Step { scene, decision, result }) in steps.into_iter().enumerate() {
            let slot = &mut self.slots[row];
            self.counters.n_env_steps += 1;
            if result.status != Status::Running {
                ended.push(row);
            }
            let transition = Transition {
                scene,
                action: decision.action,
                proposals: decision.proposals,
                behavior_log_prob: decision.log_prob,
                reward: result.reward,
                disturbance: None,
            };
            let identity = &self.setup.identity;
            let after = self.envs.env(row).scene();
            match slot.segment.push(transition, self.version, after, result.status, identity) {
                Cut::None => {}
                Cut::Segment(trajectory) => {
                    self.counters.n_segments += 1;
                    finished.push(*trajectory);
                }
                Cut::Diverged { n_dropped_steps } => {
                    self.counters.n_diverged_episodes += 1;
                    self.counters.n_diverged_steps += n_dropped_steps;
                }
            }
            match result.status {
                Status::Success => {
                    self.counters.n_episodes += 1;
                    self.counters.n_successes += 1;
                }
                Status::TimeLimit => self.counters.n_episodes += 1,
                Status::Running | Status::Diverged => {}
            }
        }
        for row in ended {
            self.slots[row] = self.begin(row, self.slots[row].task_rng.clone())?;
        }
        Ok(finished)
    }

    /// Returns the counts so far.
    pub fn counters(&self) -> RolloutCounters {
        self.counters
    }

    /// Returns the version of the acting weights.
    pub fn version(&self) -> WeightsVersion {
        self.version
    }
}

impl std::ops::AddAssign for RolloutCounters {
    fn add_assign(&mut self, other: Self) {
        self.n_env_steps += other.n_env_steps;
        self.n_segments += other.n_segments;
        self.n_episodes += other.n_episodes;
        self.n_successes += other.n_successes;
        self.n_diverged_episodes += other.n_diverged_episodes;
        self.n_diverged_steps += other.n_diverged_steps;
        self.n_failed_resets += other.n_failed_resets;
    }
}

#[cfg(test)]
mod tests;

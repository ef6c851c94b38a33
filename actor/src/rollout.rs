//! Many worlds, one policy: steps all of them with one forward pass and returns finished segments.

use environment::vec_env::generator;
use environment::{Env, ResetError, StartError, VecEnv};
use policy::{Policy, PolicyError};
use proto::{ActionMode, Status, Task, Trajectory, Weights, WeightsVersion};
use rand::rngs::ChaCha8Rng;

use crate::segment::{Identity, SegmentBuilder};
use crate::setup::ActorSetup;
use crate::task::{FilterError, TaskSampler};

/// Steps a batch of worlds, synchronously and without any I/O or clock. Equal seeds and weights give equal segments.
#[derive(Debug)]
pub struct Rollout<E> {
    setup: ActorSetup,
    identity: Identity,
    policy: Policy,
    version: WeightsVersion,
    tasks: TaskSampler,
    envs: VecEnv<E>,
    /// The generator of each world's tasks.
    task_rngs: Vec<ChaCha8Rng>,
    /// The current segment of each world.
    segments: Vec<SegmentBuilder>,
    counters: RolloutCounters,
}

/// Counts since the rollout was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RolloutCounters {
    /// Steps of all worlds.
    pub n_env_steps: u64,
    /// Segments returned.
    pub n_segments: u64,
    /// Episodes that ended in success or at the time limit.
    pub n_episodes: u64,
    /// Episodes abandoned because the physics diverged.
    pub n_diverged_episodes: u64,
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

impl<E: Env> Rollout<E> {
    /// Starts an episode in each of `worlds`, acting with `weights`. `epoch` is the start time of the process, in ms
    /// since 1970. Tasks and actions follow from `seed` alone, not from the run's seed in `setup`.
    ///
    /// # Errors
    /// If the filter selects nothing, the weights do not fit the policy, or no task can be started.
    pub fn new(
        setup: ActorSetup,
        epoch: u64,
        seed: u64,
        worlds: Vec<E>,
        weights: &Weights,
    ) -> Result<Self, RolloutError> {
        setup.check(weights)?;
        let policy = Policy::with_weights(&setup.policy, weights)?;
        let mut tasks = TaskSampler::new(&setup.config.tasks, &setup.catalog)?;
        tasks.follow(&weights.task_probabilities);
        let (identity, version) = (setup.identity(epoch), weights.version);
        let (envs, counters) = (VecEnv::new(worlds), RolloutCounters::default());
        let (task_rngs, segments) = Default::default();
        let mut rollout = Self { setup, identity, policy, version, tasks, envs, task_rngs, segments, counters };
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
        self.task_rngs.clear();
        self.segments.clear();
        for row in 0..self.envs.n_envs() {
            // Even streams draw tasks and odd ones actions, so neither depends on the number of worlds.
            self.envs.seed(row, generator(seed, 2 * row as u64 + 1));
            self.task_rngs.push(generator(seed, 2 * row as u64));
            let segment = self.begin(row)?;
            self.segments.push(segment);
        }
        Ok(())
    }

    /// Starts an episode in a world with the first task whose blocks find room, as nearly all do.
    fn begin(&mut self, row: usize) -> Result<SegmentBuilder, RolloutError> {
        let task_rng = &mut self.task_rngs[row];
        let task = self.tasks.sample(task_rng);
        let retry = |task: &mut Task, _: &ResetError| {
            *task = self.tasks.sample(task_rng);
            true
        };
        let task = self.envs.reset(row, task, &self.setup.catalog, retry)?;
        Ok(SegmentBuilder::new(self.setup.config.segment_len, task))
    }

    /// Advances every world by one step and returns the segments that this finished, in the order of the
    /// worlds and not yet numbered.
    ///
    /// # Errors
    /// If no new task can be started, or with [`PolicyError::NoDistribution`] before any world has moved. In the latter
    /// case, the rollout can continue with other weights.
    pub fn step(&mut self) -> Result<Vec<Trajectory>, RolloutError> {
        let modes = vec![ActionMode::Sampled; self.segments.len()];
        let steps = self.envs.step(&mut self.policy, &modes)?;
        let mut finished: Vec<Trajectory> = Vec::new();
        let mut ended: Vec<usize> = Vec::new();
        for (row, (transition, status)) in steps.into_iter().enumerate() {
            self.counters.n_env_steps += 1;
            if status != Status::Running {
                ended.push(row);
            }
            let after = self.envs.env(row).scene();
            let segment = &mut self.segments[row];
            finished.extend(segment.push(transition, self.version, after, status, &self.identity));
            match status {
                Status::Running => {}
                Status::Success | Status::TimeLimit => self.counters.n_episodes += 1,
                Status::Diverged => self.counters.n_diverged_episodes += 1,
            }
        }
        self.counters.n_segments += finished.len() as u64;
        for row in ended {
            self.segments[row] = self.begin(row)?;
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
        self.n_diverged_episodes += other.n_diverged_episodes;
    }
}

#[cfg(test)]
mod tests;

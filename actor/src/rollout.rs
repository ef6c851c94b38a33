//! Many worlds, one policy: steps all of them with one forward pass and hands out finished segments.

use blueprints::{BlueprintId, Catalog};
use environment::{Env, EnvironmentConfig, ResetError};
use policy::{FeatureBatch, Policy, PolicyConfig, PolicyError};
use proto::ActionMode;
use proto::{Driver, Status, Task, Trajectory, Transition, Weights, WeightsVersion};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::config::{ActorConfig, BurnInConfig};
use crate::dagger::{DaggerEpisode, DaggerMixture};
use crate::segment::{Cut, Identity, SegmentBuilder, needs_bootstrap};
use crate::task::{FilterError, TaskConfig, TaskSampler};

/// Tasks that are tried before a world gives up on starting an episode.
const MAX_RESETS: usize = 16;

/// All that a rollout needs besides worlds and weights.
#[derive(Clone, Debug)]
pub struct RolloutSetup<'c> {
    /// Where goals and starts come from.
    pub catalog: &'c Catalog,
    /// The policy that acts; it must be the learner's.
    pub policy: PolicyConfig,
    /// Which goals and starts.
    pub tasks: TaskConfig,
    /// Steps after which a segment is cut, at least 1.
    pub segment_len: usize,
    /// Steps that are not learned from.
    pub burn_in: BurnInConfig,
    /// The expert, if there is one.
    pub dagger: Option<DaggerMixture>,
    /// Names and numbers the segments.
    pub identity: Identity,
    /// Determines tasks and actions.
    pub seed: u64,
}

impl RolloutSetup<'static> {
    /// As an actor with these settings rolls out goals of the built-in catalog.
    pub fn new(
        config: &ActorConfig,
        policy: &PolicyConfig,
        environment: &EnvironmentConfig,
        identity: Identity,
        seed: u64,
    ) -> Self {
        Self {
            catalog: Catalog::builtin(),
            policy: policy.clone(),
            tasks: config.tasks.clone(),
            segment_len: config.segment_len,
            burn_in: config.burn_in,
            dagger: config.dagger.clone().map(|dagger| DaggerMixture::new(dagger, environment.clone())),
            identity,
            seed,
        }
    }
}

/// Steps a batch of worlds, synchronously and without any I/O or clock; equal seed and weights give equal segments.
#[derive(Debug)]
pub struct Rollout<'c, E> {
    setup: RolloutSetup<'c>,
    policy: Policy,
    version: WeightsVersion,
    tasks: TaskSampler,
    slots: Vec<EnvSlot<E>>,
    /// One for each world, for its actions.
    action_rngs: Vec<ChaCha8Rng>,
    /// Kept for its memory.
    batch: FeatureBatch,
    counters: RolloutCounters,
}

/// What a rollout did since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RolloutCounters {
    /// Steps of all worlds.
    pub n_env_steps: u64,
    /// Segments handed out.
    pub n_segments: u64,
    /// Episodes that ended in success or at the time limit.
    pub n_episodes: u64,
    /// Episodes that ended in success.
    pub n_successes: u64,
    /// Episodes that were given up because the physics left the rails.
    pub n_diverged_episodes: u64,
    /// Steps of those episodes that were dropped.
    pub n_diverged_steps: u64,
    /// Steps of burn-ins.
    pub n_burn_in_steps: u64,
    /// Tasks that a world could not start and that were replaced by others.
    pub n_failed_resets: u64,
}

/// Why a rollout cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum RolloutError {
    /// The task filter selects nothing.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The policy cannot be made or refuses the weights.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A world could not start any of several tasks.
    #[error("none of {MAX_RESETS} tasks could be started, the last one for blueprint {blueprint}")]
    Reset {
        /// Goal of the last task.
        blueprint: BlueprintId,
        /// Why it failed.
        source: ResetError,
    },
}

/// A world with the generator of its tasks and its episode so far.
#[derive(Debug)]
struct EnvSlot<E> {
    env: E,
    task_rng: ChaCha8Rng,
    segment: SegmentBuilder,
    dagger: Option<DaggerEpisode>,
    /// Steps that the mode still has to act before the episode is learned from.
    n_burn_in: u16,
}

impl<E: Env> EnvSlot<E> {
    /// Starts the next episode.
    fn begin(
        &mut self,
        tasks: &TaskSampler,
        setup: &RolloutSetup<'_>,
        version: WeightsVersion,
        counters: &mut RolloutCounters,
    ) -> Result<(), RolloutError> {
        let task = start_episode(&mut self.env, tasks, setup.catalog, &mut self.task_rng, counters)?;
        self.dagger = begin_dagger(setup, &self.env, version, &mut self.task_rng);
        self.segment.begin(task, driver(self.dagger.as_ref()));
        self.n_burn_in = draw_burn_in(&setup.burn_in, &mut self.task_rng);
        Ok(())
    }
}

impl<'c, E: Env> Rollout<'c, E> {
    /// Starts an episode in each of `worlds`, acting by `weights`.
    ///
    /// # Errors
    /// When the filter selects nothing, the weights do not fit the policy, or no task can be started.
    pub fn new(setup: RolloutSetup<'c>, worlds: Vec<E>, weights: &Weights) -> Result<Self, RolloutError> {
        let mut policy = Policy::new(&setup.policy)?;
        policy.load(weights)?;
        let mut tasks = TaskSampler::new(&setup.tasks, setup.catalog)?;
        tasks.set_probabilities(&weights.task_probabilities);
        let mut counters = RolloutCounters::default();
        let mut slots = Vec::with_capacity(worlds.len());
        for (world_idx, mut env) in worlds.into_iter().enumerate() {
            // Even streams draw tasks, odd ones actions, so neither depends on how many worlds there are.
            let mut task_rng = stream(setup.seed, 2 * world_idx as u64);
            let task = start_episode(&mut env, &tasks, setup.catalog, &mut task_rng, &mut counters)?;
            let dagger = begin_dagger(&setup, &env, weights.version, &mut task_rng);
            let segment = SegmentBuilder::new(setup.segment_len, task, driver(dagger.as_ref()));
            let n_burn_in = draw_burn_in(&setup.burn_in, &mut task_rng);
            slots.push(EnvSlot { env, task_rng, segment, dagger, n_burn_in });
        }
        let action_rngs = (0..slots.len() as u64).map(|world_idx| stream(setup.seed, 2 * world_idx + 1)).collect();
        let batch = policy.batch();
        Ok(Self { setup, policy, version: weights.version, tasks, slots, action_rngs, batch, counters })
    }

    /// Acts by other weights from the next step on; episodes go on.
    ///
    /// # Errors
    /// When the weights do not fit the policy; the old ones then stay in force.
    pub fn set_weights(&mut self, weights: &Weights) -> Result<(), RolloutError> {
        self.policy.load(weights)?;
        self.tasks.set_probabilities(&weights.task_probabilities);
        self.version = weights.version;
        Ok(())
    }

    /// Abandons all episodes and begins new ones as a fresh rollout with `seed` would, still counting on.
    ///
    /// A run that saves and one that resumes there both do this, so that they stay equal without saving worlds.
    ///
    /// # Errors
    /// When no task can be started.
    pub fn restart(&mut self, seed: u64) -> Result<(), RolloutError> {
        self.setup.seed = seed;
        for (world_idx, (slot, action_rng)) in self.slots.iter_mut().zip(&mut self.action_rngs).enumerate() {
            slot.task_rng = stream(seed, 2 * world_idx as u64);
            *action_rng = stream(seed, 2 * world_idx as u64 + 1);
            slot.begin(&self.tasks, &self.setup, self.version, &mut self.counters)?;
        }
        Ok(())
    }

    /// Moves every world by one step and returns the segments that this finished, in the order of the worlds.
    ///
    /// # Errors
    /// When no new task can be started, or [`PolicyError::NoDistribution`] before any world has moved: with other weights it
    /// can go on.
    pub fn step(&mut self) -> Result<Vec<Trajectory>, RolloutError> {
        self.batch.clear();
        for slot in &self.slots {
            self.batch.push(slot.env.scene(), slot.env.blueprint());
        }
        let mode = |slot: &EnvSlot<E>| match driver(slot.dagger.as_ref()) {
            Driver::Sample if slot.n_burn_in == 0 => ActionMode::Sampled,
            _ => ActionMode::Greedy,
        };
        let modes: Vec<ActionMode> = self.slots.iter().map(mode).collect();
        let decisions = self.policy.act_each(&self.batch, &mut self.action_rngs, &modes)?;

        let mut finished: Vec<Trajectory> = Vec::new();
        // From here on the batch takes the scenes whose value a finished segment needs; this is the place of each in
        // it.
        self.batch.clear();
        let mut unvalued: Vec<usize> = Vec::new();
        for ((slot, decision), rng) in self.slots.iter_mut().zip(decisions).zip(&mut self.action_rngs) {
            let EnvSlot { env, segment, dagger, n_burn_in, .. } = &mut *slot;
            let scene = env.scene().clone();
            let (action, label) = match dagger {
                Some(dagger) if *n_burn_in == 0 => dagger.step(&scene, decision.action, rng),
                _ => (decision.action, None),
            };
            let result = env.step(&action);
            self.counters.n_env_steps += 1;
            if *n_burn_in > 0 {
                *n_burn_in -= 1;
                self.counters.n_burn_in_steps += 1;
                segment.skip(&result.reward);
                if result.status != Status::Running {
                    slot.begin(&self.tasks, &self.setup, self.version, &mut self.counters)?;
                }
                continue;
            }
            let transition = Transition {
                scene,
                action,
                // Noise and the expert have no probability under the policy that could be of use.
                behavior_log_prob: if driver(dagger.as_ref()) == Driver::Sample { decision.log_prob } else { 0.0 },
                value: decision.value,
                reward: result.reward,
                label,
            };
            match segment.push(transition, self.version, env.scene(), result.status, &self.setup.identity) {
                Cut::None => {}
                Cut::Segment(mut trajectory) => {
                    let identity = &self.setup.identity;
                    trajectory.seq = identity.first_seq + identity.seq_step * self.counters.n_segments;
                    self.counters.n_segments += 1;
                    if needs_bootstrap(result.status) {
                        self.batch.push(env.scene(), env.blueprint());
                        unvalued.push(finished.len());
                    }
                    finished.push(*trajectory);
                }
                Cut::Diverged { n_dropped_steps } => {
                    self.counters.n_diverged_episodes += 1;
                    self.counters.n_diverged_steps += n_dropped_steps;
                }
            }
            match result.status {
                Status::Running => continue,
                Status::Success => {
                    self.counters.n_episodes += 1;
                    self.counters.n_successes += 1;
                }
                Status::TimeLimit => self.counters.n_episodes += 1,
                Status::Diverged => {}
            }
            slot.begin(&self.tasks, &self.setup, self.version, &mut self.counters)?;
        }
        // The worlds have moved, so weights that have no value for a last scene must not stop the step. The learner refuses a
        // segment without one, which the actor then counts.
        let values = self.policy.values(&self.batch).unwrap_or_else(|_| vec![f32::NAN; unvalued.len()]);
        for (segment_idx, value) in unvalued.into_iter().zip(values) {
            finished[segment_idx].bootstrap_value = value;
        }
        Ok(finished)
    }

    /// What was done so far.
    pub fn counters(&self) -> RolloutCounters {
        self.counters
    }

    /// Version of the weights that act.
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
        self.n_burn_in_steps += other.n_burn_in_steps;
        self.n_failed_resets += other.n_failed_resets;
    }
}

/// Length of an episode's burn-in; without any, nothing is drawn.
fn draw_burn_in(config: &BurnInConfig, rng: &mut ChaCha8Rng) -> u16 {
    if config.probability > 0.0 && rng.random_bool(config.probability) {
        rng.random_range(1..=config.max_steps)
    } else {
        0
    }
}

/// The DAgger part of an episode that has begun; without DAgger nothing is drawn.
fn begin_dagger<E: Env>(
    setup: &RolloutSetup<'_>,
    env: &E,
    version: WeightsVersion,
    rng: &mut ChaCha8Rng,
) -> Option<DaggerEpisode> {
    setup.dagger.as_ref().map(|mixture| mixture.begin(env.blueprint(), version, rng))
}

/// Who acts in an episode.
fn driver(dagger: Option<&DaggerEpisode>) -> Driver {
    dagger.map_or(Driver::Sample, DaggerEpisode::driver)
}

/// An independent generator for each `stream_idx` of a seed.
fn stream(seed: u64, stream_idx: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream_idx);
    rng
}

/// Draws tasks until the world can start one; a start without room for its blocks is possible though rare.
fn start_episode<E: Env>(
    env: &mut E,
    tasks: &TaskSampler,
    catalog: &Catalog,
    rng: &mut ChaCha8Rng,
    counters: &mut RolloutCounters,
) -> Result<Task, RolloutError> {
    let mut n_tried = 0;
    loop {
        let task = tasks.sample(catalog, rng);
        match env.reset(&task, catalog) {
            Ok(()) => return Ok(task),
            Err(source) => {
                n_tried += 1;
                counters.n_failed_resets += 1;
                if n_tried == MAX_RESETS {
                    return Err(RolloutError::Reset { blueprint: task.blueprint, source });
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;

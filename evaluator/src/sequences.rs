//! Runs many short sequences of episodes side by side: one forward pass moves all worlds.

use std::sync::Arc;

use blueprints::hash::fnv1a;
use blueprints::{Blueprint, BlueprintId, Catalog, Split};
use environment::config::SuccessConfig;
use environment::{Env, ResetError, StableSuccess, sample_assignment};
use policy::Policy;
use proto::{Action, RewardTerms, Scene, Start, Status, Task};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::config::Starts;
use crate::films::EpisodeSelector;
use crate::recording::Recording;
use crate::report::Episode;
use crate::setup::EvalError;
use proto::ActionMode;
use proto::unit::End;

/// Steps in which a success can prove stable while the grippers hold still.
const SETTLE_STEPS: usize = 10;

/// Seeds that are tried for a start state before the episode is given up; blocks may find no room.
const MAX_RESETS: u64 = 16;

/// An episode to be run.
#[derive(Clone, Debug)]
pub(crate) struct EpisodeSpec {
    task: Task,
    split: Split,
    n_blocks: usize,
}

/// An episode that was run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct EpisodeResult {
    pub(crate) episode: Episode,
    /// It should have gone on in the world as it was, but that had diverged.
    pub(crate) forced_reset: bool,
}

/// What all worlds of a thread have in common.
pub(crate) struct Rules<'a> {
    pub(crate) catalog: &'a Catalog,
    pub(crate) acting: ActionMode,
    pub(crate) success: &'a SuccessConfig,
    pub(crate) keep_going: &'a (dyn Fn() -> bool + Sync),
    /// Which episodes become films.
    pub(crate) films: Option<&'a EpisodeSelector>,
}

impl EpisodeSpec {
    /// Episode `episode_idx` of a goal that begins as one of `starts`.
    pub(crate) fn one_of(catalog: &Catalog, blueprint: &Blueprint, starts: Starts, seed: u64, idx: u64) -> Self {
        let mut spec = Self::new(blueprint, Start::Scattered, seed, idx);
        let prebuilt = match starts {
            Starts::Scattered => false,
            Starts::Prebuilt => true,
            Starts::Mixed => idx % 5 == 4,
            Starts::NearGoal => {
                spec.task.start = Start::NearGoal { undone: 1 };
                false
            }
        };
        let mut others = catalog.of_split(Split::Train).to_vec();
        others.retain(|other| other.id() != blueprint.id());
        if prebuilt && !others.is_empty() {
            // A generator of its own leaves a task what it is however it starts.
            let mut rng = ChaCha8Rng::seed_from_u64(spec.task.seed);
            spec.task.start = Start::Prebuilt(others[rng.random_range(0..others.len())].id().clone());
        }
        spec
    }

    /// Episode `episode_idx` of a goal; only these and `seed` determine it.
    pub(crate) fn new(blueprint: &Blueprint, start: Start, seed: u64, episode_idx: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(mix(seed, blueprint.id(), episode_idx));
        let assignment = sample_assignment(&mut rng);
        let task = Task { blueprint: blueprint.id().clone(), assignment, start, seed: rng.random() };
        Self { task, split: blueprint.split(), n_blocks: blueprint.n_blocks() }
    }

    /// The episode that a task of another process names; none if the catalog does not have the goal.
    pub(crate) fn of_task(catalog: &Catalog, task: Task) -> Option<Self> {
        let blueprint = catalog.get(&task.blueprint)?;
        Some(Self { task, split: blueprint.split(), n_blocks: blueprint.n_blocks() })
    }

    pub(crate) fn task(&self) -> &Task {
        &self.task
    }

    /// What came of it.
    pub(crate) fn result(
        &self,
        acting: ActionMode,
        end: End,
        n_steps: u32,
        episode_return: RewardTerms,
        forced_reset: bool,
    ) -> EpisodeResult {
        let (blueprint, split, n_blocks) = (self.task.blueprint.clone(), self.split, self.n_blocks);
        EpisodeResult {
            episode: Episode { blueprint, split, n_blocks, acting, end, n_steps, episode_return },
            forced_reset,
        }
    }
}

/// Runs the sequences of `next`: the specs of each one after the other in one world. Worlds take the next sequence when theirs is
/// over; what came of a sequence goes to `done` with its number.
pub(crate) fn run_sequences<E: Env>(
    rules: &Rules<'_>,
    policy: &Policy,
    worlds: Vec<E>,
    mut next: impl FnMut() -> Option<(usize, Arc<[EpisodeSpec]>)>,
    mut done: impl FnMut(usize, Vec<EpisodeResult>),
) -> Result<(), EvalError> {
    let mut slots: Vec<EnvSlot<E>> = Vec::new();
    let mut rngs: Vec<ChaCha8Rng> = Vec::new();
    for env in worlds {
        let Some((sequence_idx, sequence)) = next() else { break };
        let (slot, rng) = EnvSlot::begin(rules, env, sequence_idx, sequence)?;
        slots.push(slot);
        rngs.push(rng);
    }
    let mut batch = policy.batch();
    while !slots.is_empty() {
        if !(rules.keep_going)() {
            return Err(EvalError::Interrupted);
        }
        batch.clear();
        slots.iter().for_each(|slot| batch.push(slot.env.scene(), slot.env.blueprint()));
        let decisions = policy.act(&batch, &mut rngs, rules.acting)?;
        let mut free = Vec::new();
        for (slot_idx, decision) in decisions.into_iter().enumerate() {
            let slot = &mut slots[slot_idx];
            let Some(results) = slot.step(rules, &decision.action) else { continue };
            slot.results.push(results);
            if slot.results.len() == slot.sequence.len() {
                done(slot.sequence_idx, std::mem::take(&mut slot.results));
                let Some((sequence_idx, sequence)) = next() else {
                    free.push(slot_idx);
                    continue;
                };
                (slot.sequence_idx, slot.sequence) = (sequence_idx, sequence);
            }
            rngs[slot_idx] = slot.start(rules, slot.results.len())?;
        }
        for slot_idx in free.into_iter().rev() {
            slots.remove(slot_idx);
            rngs.remove(slot_idx);
        }
    }
    Ok(())
}

/// A world and its current episode.
pub(crate) struct EnvSlot<E> {
    pub(crate) env: E,
    sequence_idx: usize,
    sequence: Arc<[EpisodeSpec]>,
    job_idx: usize,
    results: Vec<EpisodeResult>,
    forced_reset: bool,
    n_steps: u32,
    episode_return: RewardTerms,
    /// Of the last step.
    pub(crate) reward: RewardTerms,
    /// The scene of a success, as the world goes on after it to see whether it is stable.
    pub(crate) end_scene: Option<Scene>,
    /// Of the current episode, if that may become a film.
    recording: Option<Recording>,
}

impl<E: Env> EnvSlot<E> {
    /// Starts the first episode of a sequence, which has at least one, and returns the generator of its actions.
    pub(crate) fn begin(
        rules: &Rules<'_>,
        env: E,
        sequence_idx: usize,
        sequence: Arc<[EpisodeSpec]>,
    ) -> Result<(Self, ChaCha8Rng), EvalError> {
        let mut slot = Self {
            env,
            sequence_idx,
            sequence,
            job_idx: 0,
            results: Vec::new(),
            forced_reset: false,
            n_steps: 0,
            episode_return: RewardTerms::default(),
            reward: RewardTerms::default(),
            end_scene: None,
            recording: None,
        };
        let rng = slot.start(rules, 0)?;
        Ok((slot, rng))
    }

    /// Starts an episode of the sequence and returns the generator of its actions.
    pub(crate) fn start(&mut self, rules: &Rules<'_>, job_idx: usize) -> Result<ChaCha8Rng, EvalError> {
        let seed = self.sequence[job_idx].task.seed;
        let mut task = self.sequence[job_idx].task.clone();
        let mut n_tried = 0;
        self.forced_reset = false;
        while let Err(source) = self.env.reset(&task, rules.catalog) {
            match source {
                ResetError::NothingToKeep if task.start == Start::AsItIs => {
                    task.start = Start::Scattered;
                    self.forced_reset = true;
                }
                ResetError::NoRoom(_) if n_tried < MAX_RESETS => {
                    n_tried += 1;
                    task.seed = task.seed.wrapping_add(1);
                }
                source => return Err(EvalError::Reset { blueprint: task.blueprint, source }),
            }
        }
        (self.job_idx, self.n_steps) = (job_idx, 0);
        self.episode_return = RewardTerms::default();
        self.end_scene = None;
        let spec = &self.sequence[job_idx];
        self.recording = rules.films.and_then(|films| films.begin(&spec.task, spec.split, spec.n_blocks, rules.acting));
        // Stream 0 of the seed belongs to the world.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1);
        Ok(rng)
    }

    /// One step; the episode if that ended it.
    pub(crate) fn step(&mut self, rules: &Rules<'_>, action: &Action) -> Option<EpisodeResult> {
        let before = self.recording.is_some().then(|| self.env.scene().clone());
        let result = self.env.step(action);
        if let (Some(recording), Some(before)) = (&mut self.recording, before) {
            recording.note(before, action.clone(), result.reward);
        }
        self.n_steps += 1;
        self.reward = result.reward;
        self.episode_return = self.episode_return + result.reward;
        let end = match result.status {
            Status::Running => return None,
            Status::Success => {
                self.end_scene = Some(self.env.scene().clone());
                End::Success { stable: self.settles(rules, action) }
            }
            Status::TimeLimit => End::TimeLimit,
            Status::Diverged => End::Diverged,
        };
        let spec = &self.sequence[self.job_idx];
        let results = spec.result(rules.acting, end, self.n_steps, self.episode_return, self.forced_reset);
        if let (Some(films), Some(recording)) = (rules.films, self.recording.take()) {
            let last = self.end_scene.as_ref().unwrap_or_else(|| self.env.scene());
            films.end(recording, &spec.task, last, &results.episode);
        }
        Some(results)
    }

    /// Whether a success proves stable while the grippers hold the last chosen blocks still.
    fn settles(&mut self, rules: &Rules<'_>, last: &Action) -> bool {
        let still = Action { choices: last.choices, moves: [[0.0; 6]; blueprints::N_BLOCKS] };
        let mut stable = StableSuccess::default();
        (0..SETTLE_STEPS).any(|_| {
            let holds = stable.observe(self.env.scene(), self.env.blueprint(), rules.success);
            holds || {
                self.env.step(&still);
                false
            }
        })
    }
}

/// One number from all that names an episode.
fn mix(seed: u64, blueprint: &BlueprintId, episode_idx: u64) -> u64 {
    let bytes = seed.to_le_bytes().into_iter().chain(blueprint.as_str().bytes()).chain(episode_idx.to_le_bytes());
    fnv1a(bytes)
}

#[cfg(test)]
mod tests;

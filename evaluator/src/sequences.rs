//! Runs many short sequences of episodes in parallel: the agent acts in all worlds at once.

use blueprints::Catalog;
use environment::config::SuccessConfig;
use environment::vec_env::generator;
use environment::{Env, EnvironmentConfig, ExpertAgent, ResetError, StableSuccess, VecEnv};
use policy::{Policy, PolicyError};
use proto::{Action, ActionMode, RewardTerms, Start, Status, Task, Transition};

use crate::recording::{Recorder, trajectory};
use crate::report::{End, EpisodeResult};
use crate::setup::{EvalError, Performer};
use crate::spec::EpisodeSpec;

/// Number of steps in which a success can prove stable after the grippers have let go.
const SETTLE_STEPS: u8 = 10;

/// The agent that acts, with its state.
enum PerformerAgent {
    Expert(ExpertAgent),
    Policy(Box<Policy>),
}

/// Settings shared by all worlds of a thread.
pub(crate) struct Rules<'a> {
    pub(crate) catalog: &'a Catalog,
    pub(crate) environment: &'a EnvironmentConfig,
    pub(crate) performer: Performer<'a>,
    pub(crate) acting: ActionMode,
    pub(crate) keep_going: &'a (dyn Fn() -> bool + Sync),
    pub(crate) recorder: Option<&'a dyn Recorder>,
}

/// Runs the sequences returned by `next`. The episodes of a sequence run one after another in one world, which then
/// starts the next sequence. Each sequence's results go to `done` with its index.
pub(crate) fn run_sequences<'s, E: Env + Clone>(
    rules: &Rules<'_>,
    mut worlds: Vec<E>,
    mut next: impl FnMut() -> Option<(usize, &'s [EpisodeSpec])>,
    mut done: impl FnMut(usize, Vec<EpisodeResult>),
) -> Result<(), EvalError> {
    let slots: Vec<EnvSlot<'_>> = worlds.iter().map_while(|_| next()).map(EnvSlot::new).collect();
    worlds.truncate(slots.len());
    let agent = match rules.performer {
        Performer::Expert => PerformerAgent::Expert(ExpertAgent::new(rules.environment)),
        Performer::Policy(config, weights) => PerformerAgent::Policy(Box::new(Policy::with_weights(config, weights)?)),
    };
    let mut running = EnvironmentLoop { rules, agent, envs: VecEnv::new(worlds), slots };
    for row in 0..running.slots.len() {
        running.start(row)?;
    }
    while !running.slots.is_empty() {
        if !(rules.keep_going)() {
            return Err(EvalError::Interrupted);
        }
        let mut free = Vec::new();
        for (row, step) in running.step()?.into_iter().enumerate() {
            let Some(result) = running.observe(row, step) else { continue };
            let slot = &mut running.slots[row];
            slot.results.push(result);
            if slot.results.len() == slot.sequence.len() {
                done(slot.sequence_idx, std::mem::take(&mut slot.results));
                let Some(sequence) = next() else {
                    free.push(row);
                    continue;
                };
                *slot = EnvSlot::new(sequence);
            }
            running.start(row)?;
        }
        for row in free.into_iter().rev() {
            running.slots.remove(row);
            running.envs.remove(row);
        }
    }
    Ok(())
}

/// Worlds, the agent that acts in them, and their episodes.
struct EnvironmentLoop<'a, E> {
    rules: &'a Rules<'a>,
    agent: PerformerAgent,
    envs: VecEnv<E>,
    /// One slot per world.
    slots: Vec<EnvSlot<'a>>,
}

/// A world's sequence and its current episode.
struct EnvSlot<'s> {
    sequence_idx: usize,
    /// Never empty.
    sequence: &'s [EpisodeSpec],
    /// Results of the episodes before the current one.
    results: Vec<EpisodeResult>,
    /// The current episode as it started; differs from `sequence` if the start was retried.
    played: EpisodeSpec,
    forced_reset: bool,
    n_steps: u32,
    episode_return: RewardTerms,
    /// The steps so far, if the episode is recorded.
    recording: Option<Vec<Transition>>,
}

impl<'s> EnvSlot<'s> {
    fn new((sequence_idx, sequence): (usize, &'s [EpisodeSpec])) -> Self {
        let (played, episode_return) = (sequence[0].clone(), RewardTerms::default());
        Self {
            sequence_idx,
            sequence,
            results: Vec::new(),
            played,
            forced_reset: false,
            n_steps: 0,
            episode_return,
            recording: None,
        }
    }
}

impl<E: Env + Clone> EnvironmentLoop<'_, E> {
    /// Starts the next episode of a world's sequence.
    fn start(&mut self, row: usize) -> Result<(), EvalError> {
        let slot = &mut self.slots[row];
        let spec = &slot.sequence[slot.results.len()];
        slot.forced_reset = false;
        let retry = |task: &mut Task, error: &ResetError| match error {
            ResetError::NothingToKeep if task.start == Start::AsItIs => {
                task.start = Start::Scattered;
                slot.forced_reset = true;
                true
            }
            ResetError::NoRoom(_) => {
                task.seed = task.seed.wrapping_add(1);
                true
            }
            _ => false,
        };
        let task = self.envs.reset(row, spec.task.clone(), self.rules.catalog, retry)?;
        // The world uses stream 0 of the seed.
        self.envs.seed(row, generator(spec.task.seed, 1));
        (slot.n_steps, slot.episode_return) = (0, RewardTerms::default());
        slot.played = EpisodeSpec { task, ..spec.clone() };
        let is_recorded = self.rules.recorder.is_some_and(|recorder| recorder.wants(&slot.played, self.rules.acting));
        slot.recording = is_recorded.then(Vec::new);
        Ok(())
    }

    /// Advances every world by one step.
    fn step(&mut self) -> Result<Vec<(Transition, Status)>, PolicyError> {
        let modes = vec![self.rules.acting; self.slots.len()];
        match &mut self.agent {
            PerformerAgent::Expert(expert) => {
                let Ok(steps) = self.envs.step(expert, &modes);
                Ok(steps)
            }
            PerformerAgent::Policy(policy) => self.envs.step(policy.as_mut(), &modes),
        }
    }

    /// Records a step; returns the result if the step ended the episode.
    fn observe(&mut self, row: usize, (step, status): (Transition, Status)) -> Option<EpisodeResult> {
        let rules = self.rules;
        let slot = &mut self.slots[row];
        slot.n_steps += 1;
        slot.episode_return = slot.episode_return + step.reward;
        if let Some(recording) = &mut slot.recording {
            // Without its log-probability, because nothing is learned from it.
            recording.push(Transition { behavior_log_prob: 0.0, ..step });
        }
        if status == Status::Running {
            return None;
        }
        let env = self.envs.env(row);
        let end = match status {
            // In a copy, because the next goal may begin where this one ends, with the structure still held.
            Status::Success => End::Success { stable: settles(env.clone(), &rules.environment.success) },
            Status::Running | Status::TimeLimit => End::TimeLimit,
            Status::Diverged => End::Diverged,
        };
        let EpisodeSpec { task, split, n_blocks } = &slot.played;
        let result = EpisodeResult {
            blueprint: task.blueprint.clone(),
            split: *split,
            n_blocks: *n_blocks,
            acting: rules.acting,
            end,
            n_steps: slot.n_steps,
            episode_return: slot.episode_return,
            forced_reset: slot.forced_reset,
        };
        if let (Some(recorder), Some(transitions)) = (rules.recorder, slot.recording.take()) {
            let episode = trajectory(rules.performer, task, transitions, env.scene(), &result);
            recorder.keep(slot.sequence_idx, episode, &result);
        }
        Some(result)
    }
}

/// Whether a success proves stable after the grippers have let go.
fn settles(mut env: impl Env, success: &SuccessConfig) -> bool {
    let mut stable = StableSuccess::default();
    (0..SETTLE_STEPS).any(|_| {
        env.step(&Action::IDLE);
        stable.observe(env.scene(), env.blueprint(), success)
    })
}

#[cfg(test)]
pub(crate) mod tests;

//! Many worlds that step together, as Gymnasium's vector environments do.

use blueprints::Catalog;
use proto::{ActionMode, Agent, Decision, Observation, Status, Task, Transition};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use crate::env::{Env, ResetError, StartError, StepResult};

/// Maximum number of tasks to try before an episode is given up; the blocks of a task may find no room.
const MAX_RESETS: usize = 16;

/// Worlds, each with the random generator of its actions. A row is the index of a world, from 0.
#[derive(Debug)]
pub struct VecEnv<E> {
    envs: Vec<E>,
    rngs: Vec<ChaCha8Rng>,
}

/// Returns an independent generator for each `stream` of a seed.
pub fn generator(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

/// Draws an item with its weight; the weights are not negative.
///
/// # Panics
/// If no weight is positive.
pub fn draw_weighted<'a, T>(items: &'a [(T, f64)], rng: &mut ChaCha8Rng) -> &'a T {
    let total: f64 = items.iter().map(|(_, weight)| weight).sum();
    let mut rest = rng.random::<f64>() * total;
    let drawn = items.iter().find(|(_, weight)| {
        rest -= weight;
        rest < 0.0
    });
    // Rounding may leave a rest of about 0 after the last item with a positive weight.
    let last = items.iter().rev().find(|(_, weight)| *weight > 0.0);
    &drawn.or(last).expect("an item has a positive weight").0
}

impl<E: Env> VecEnv<E> {
    /// Creates the vector. Each world needs its own [`reset`](Self::reset) and [`seed`](Self::seed) before the first
    /// step.
    pub fn new(envs: Vec<E>) -> Self {
        let rngs = envs.iter().map(|_| generator(0, 0)).collect();
        Self { envs, rngs }
    }

    /// Returns the number of worlds.
    pub fn n_envs(&self) -> usize {
        self.envs.len()
    }

    /// Returns the world of a row.
    ///
    /// # Panics
    /// If there is no such row, as in all methods that take a row.
    pub fn env(&self, row: usize) -> &E {
        &self.envs[row]
    }

    /// Sets the generator that draws a row's actions from now on.
    pub fn seed(&mut self, row: usize, rng: ChaCha8Rng) {
        self.rngs[row] = rng;
    }

    /// Starts an episode of `task` in a row. If the world cannot start a task, `retry` may replace it and return true
    /// to try again. Returns the task that was started.
    ///
    /// # Errors
    /// If `retry` returns false, or after 16 tasks.
    pub fn reset(
        &mut self,
        row: usize,
        mut task: Task,
        catalog: &Catalog,
        mut retry: impl FnMut(&mut Task, &ResetError) -> bool,
    ) -> Result<Task, StartError> {
        let mut n_tried = 1;
        while let Err(source) = self.envs[row].reset(&task, catalog) {
            if n_tried == MAX_RESETS || !retry(&mut task, &source) {
                return Err(StartError { blueprint: task.blueprint, source });
            }
            n_tried += 1;
        }
        Ok(task)
    }

    /// Advances every world by one step; returns the step of each, and the status after it. Calls `agent` once for all
    /// of them, with a mode for each row. Worlds whose episode ends wait for [`reset`](Self::reset).
    ///
    /// # Errors
    /// If `agent` fails; no world has moved then.
    pub fn step<A: Agent>(
        &mut self,
        agent: &mut A,
        modes: &[ActionMode],
    ) -> Result<Vec<(Transition, Status)>, A::Error> {
        let observations: Vec<Observation<'_>> = self.envs.iter().map(Env::observation).collect();
        let decisions = agent.act(&observations, modes, &mut self.rngs)?;
        let step = |(env, decision): (&mut E, Decision)| {
            let scene = env.scene().clone();
            let StepResult { reward, status } = env.step(&decision.action);
            let Decision { action, proposals, log_prob: behavior_log_prob, .. } = decision;
            (Transition { scene, action, proposals, behavior_log_prob, reward, disturbance: None }, status)
        };
        Ok(self.envs.iter_mut().zip(decisions).map(step).collect())
    }

    /// Removes a world; later rows move up.
    pub fn remove(&mut self, row: usize) {
        self.envs.remove(row);
        self.rngs.remove(row);
    }
}

#[cfg(test)]
mod tests {
    use proto::{Start, Valid};

    use super::*;
    use crate::{EnvironmentConfig, Expert, ExpertAgent, World, sample_assignment};

    fn worlds(n: usize) -> Vec<World> {
        (0..n).map(|_| World::new(&Valid::default())).collect()
    }

    fn task(goal: &str, seed: u64) -> Task {
        let assignment = sample_assignment(&mut generator(seed, 0));
        Task { blueprint: goal.parse().unwrap(), assignment, start: Start::Scattered, seed }
    }

    #[test]
    fn an_episode_is_given_up_after_sixteen_tasks() {
        let mut envs = VecEnv::new(worlds(1));
        let (good, bad) = (task("2_000", 1), task("nowhere_2_999", 1));
        // `mended` is the number, from 1, of the retry whose task can be started.
        let mut tries = |mended: usize| {
            let mut n_retries = 0;
            let retry = |task: &mut Task, error: &ResetError| {
                assert_eq!(error, &ResetError::UnknownBlueprint(bad.blueprint.clone()));
                n_retries += 1;
                if n_retries == mended {
                    task.clone_from(&good);
                }
                true
            };
            let started = envs.reset(0, bad.clone(), Catalog::builtin(), retry);
            (started, n_retries)
        };
        assert_eq!(tries(15), (Ok(good.clone()), 15));
        let (refused, n_retries) = tries(16);
        assert_eq!((refused.unwrap_err().blueprint, n_retries), (bad.blueprint.clone(), 15));
    }

    #[test]
    fn worlds_step_together_as_they_would_alone() {
        let config = Valid::<EnvironmentConfig>::default();
        let mut envs = VecEnv::new(worlds(2));
        let mut alone = Vec::new();
        for (row, mut world) in worlds(2).into_iter().enumerate() {
            let task = task(["2_000", "4_000"][row], row as u64);
            world.reset(&task, Catalog::builtin()).unwrap();
            envs.reset(row, task, Catalog::builtin(), |_, _| false).unwrap();
            let expert = Expert::new(&config, world.blueprint()).unwrap();
            alone.push((world, expert));
        }
        let mut agent = ExpertAgent::new(&config);
        while envs.n_envs() > 0 {
            for _ in 0..5 {
                let Ok(steps) = envs.step(&mut agent, &vec![ActionMode::Greedy; alone.len()]);
                assert_eq!(steps.len(), alone.len());
                for ((step, status), (world, expert)) in steps.into_iter().zip(&mut alone) {
                    let action = expert.act(world.scene());
                    assert_eq!((&step.scene, &step.action), (world.scene(), &action));
                    assert_eq!(StepResult { reward: step.reward, status }, world.step(&action));
                }
            }
            // The second world moves up.
            envs.remove(0);
            alone.remove(0);
        }
    }
}

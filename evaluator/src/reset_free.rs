//! Several goals in a row in a world that is never reset (paper, section "Reset-Free Evaluation").

use blueprints::{Blueprint, Split};
use proto::metrics::{EvalResetFree, EvalRuns};
use proto::{ActionMode, Start};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use crate::config::{MIN_BLOCKS, ResetFreeConfig};
use crate::pool::EvaluationPool;
use crate::report::{End, EpisodeResult, outcome};
use crate::setup::EvalError;
use crate::spec::EpisodeSpec;

/// Evaluates the agent of a pool on runs over several goals. A run begins scattered, and each goal begins where the
/// last one ended, by success or at the time limit. Goals are training blueprints of at least [`MIN_BLOCKS`] blocks,
/// never the same twice in a row. The episodes are not recorded.
///
/// A world that diverged is reset, and the reset is counted. Runs depend only on the setup's seed.
pub(crate) fn evaluate(pool: &EvaluationPool<'_>, config: &ResetFreeConfig) -> Result<EvalResetFree, EvalError> {
    let pool = EvaluationPool { recorder: None, ..*pool };
    let mut goals = pool.setup.catalog.of_split(Split::Train);
    goals.retain(|blueprint| blueprint.n_blocks() >= MIN_BLOCKS);
    if goals.is_empty() {
        return Err(EvalError::NoGoals);
    }
    let sequences = plan_runs(&goals, config, pool.setup.seed);
    let (n_runs, n_goals) = (u64::from(config.n_runs), u64::from(config.n_goals));
    let mut found = EvalResetFree { n_runs, n_goals, ..EvalResetFree::default() };
    for &acting in &pool.setup.episodes.acting {
        let (runs, ended) = pool.run(&sequences, acting);
        ended?;
        let runs = count(&runs, acting);
        match acting {
            ActionMode::Greedy => found.greedy = runs,
            ActionMode::Sampled => found.sampled = runs,
        }
    }
    Ok(found)
}

/// Returns one sequence per run.
fn plan_runs(goals: &[&Blueprint], config: &ResetFreeConfig, seed: u64) -> Vec<Vec<EpisodeSpec>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut plan = Vec::new();
    for run_idx in 0..config.n_runs {
        let mut last: Option<usize> = None;
        let mut run = Vec::new();
        for goal_idx in 0..config.n_goals {
            let goal = match last {
                // Draws from the other goals: indices from the last goal on shift by one.
                Some(last) if goals.len() > 1 => {
                    let drawn = rng.random_range(0..goals.len() - 1);
                    drawn + usize::from(drawn >= last)
                }
                _ => rng.random_range(0..goals.len()),
            };
            last = Some(goal);
            let start = if goal_idx == 0 { Start::Scattered } else { Start::AsItIs };
            let episode_idx = u64::from(run_idx) * u64::from(config.n_goals) + u64::from(goal_idx);
            run.push(EpisodeSpec::new(goals[goal], start, seed, episode_idx));
        }
        plan.push(run);
    }
    plan
}

fn count(runs: &[Vec<EpisodeResult>], acting: ActionMode) -> EvalRuns {
    let succeeded = |result: &EpisodeResult| matches!(result.end, End::Success { .. });
    let n_goals = runs.first().map_or(0, Vec::len);
    let n_successes_at = |goal_idx: usize| runs.iter().filter(|run| succeeded(&run[goal_idx])).count() as u64;
    let rates: Vec<f64> =
        runs.iter().map(|run| run.iter().filter(|p| succeeded(p)).count() as f64 / run.len().max(1) as f64).collect();
    let n = rates.len().max(1) as f64;
    let mean = rates.iter().sum::<f64>() / n;
    let variance = rates.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / n;
    let episodes: Vec<&EpisodeResult> = runs.iter().flatten().collect();
    EvalRuns {
        outcome: outcome(&episodes, acting),
        n_successes_by_goal: (0..n_goals).map(n_successes_at).collect(),
        run_rate_std: variance.sqrt(),
        n_forced_resets: episodes.iter().filter(|result| result.forced_reset).count() as u64,
    }
}

#[cfg(test)]
mod tests {
    use blueprints::Catalog;

    use super::*;
    use crate::report::tests::episode;

    fn result(end: End, forced_reset: bool) -> EpisodeResult {
        EpisodeResult { forced_reset, ..episode("2_000", ActionMode::Greedy, end, 10) }
    }

    #[test]
    fn hand_worked_counts() {
        let success = || result(End::Success { stable: true }, false);
        let runs = [
            vec![success(), success()],
            vec![success(), result(End::TimeLimit, false)],
            vec![result(End::Diverged, false), result(End::TimeLimit, true)],
        ];
        let found = count(&runs, ActionMode::Greedy);
        assert_eq!((found.n_successes_by_goal, found.n_forced_resets), (vec![2, 1], 1));
        assert_eq!((found.outcome.success.rate, found.outcome.n_diverged), (0.5, 1));
        // Rates 1, 1/2 and 0: variance (1/4 + 0 + 1/4) / 3.
        assert!((found.run_rate_std - (1.0_f64 / 6.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_run_begins_scattered_and_changes_its_goal_every_time() {
        let goals = Catalog::builtin().of_split(Split::Train);
        let config = ResetFreeConfig { n_runs: 20, n_goals: 10 };
        let plan = plan_runs(&goals[..2], &config, 3);
        assert_eq!((plan.len(), plan[0].len()), (20, 10));
        for run in &plan {
            assert_eq!(run[0].task.start, Start::Scattered);
            assert!(run[1..].iter().all(|spec| spec.task.start == Start::AsItIs));
            assert!(run.windows(2).all(|pair| pair[0].task.blueprint != pair[1].task.blueprint));
        }
    }
}

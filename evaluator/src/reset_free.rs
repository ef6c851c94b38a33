//! Goals one after the other in a world that is never reset (paper, section "Reset-Free Evaluation").

use blueprints::{Blueprint, Catalogue, Split};
use proto::metrics::{EvalResetFree, EvalRuns};
use proto::{Start, Weights};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::config::ResetFreeConfig;
use crate::episodes::{EvalError, EvalSetup, run_all};
use crate::lanes::{Job, Played};
use crate::report::{Acting, End, Episode, outcome};

/// Judges `weights` on runs over several goals: a run begins scattered, and each goal begins where the last one ended,
/// by success or at the time limit. Goals are training blueprints of some size, never the same twice in a row.
///
/// A world that diverged is reset and the reset is counted. Runs depend on the setup's seed only.
///
/// # Errors
/// When the weights do not fit, no blueprint is large enough, or `keep_going` says no.
pub fn evaluate(
    setup: &EvalSetup<'_>,
    config: &ResetFreeConfig,
    weights: &Weights,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<EvalResetFree, EvalError> {
    let lanes = lanes(setup.catalogue, config, setup.seed)?;
    let mut score = EvalResetFree::default();
    for &acting in &setup.episodes.acting {
        let found = self::score(config, &run_all(setup, weights, &lanes, acting, None, keep_going)?, acting);
        (score.n_runs, score.n_goals) = (found.n_runs, found.n_goals);
        match acting {
            Acting::Mode => score.mode = found.mode,
            Acting::Sampled => score.sampled = found.sampled,
        }
    }
    Ok(score)
}

/// The score of runs with one way of acting.
pub(crate) fn score(config: &ResetFreeConfig, runs: &[Vec<Played>], acting: Acting) -> EvalResetFree {
    let mut score = EvalResetFree {
        n_runs: u64::from(config.n_runs),
        n_goals: u64::from(config.n_goals),
        ..EvalResetFree::default()
    };
    let counted = count(runs, acting);
    match acting {
        Acting::Mode => score.mode = counted,
        Acting::Sampled => score.sampled = counted,
    }
    score
}

/// The runs: one lane each.
///
/// # Errors
/// When no training blueprint is large enough.
pub(crate) fn lanes(catalogue: &Catalogue, config: &ResetFreeConfig, seed: u64) -> Result<Vec<Vec<Job>>, EvalError> {
    let mut goals = catalogue.of_split(Split::Train);
    goals.retain(|blueprint| blueprint.n_blocks() >= config.min_blocks);
    if goals.is_empty() {
        return Err(EvalError::NoGoals { min_blocks: config.min_blocks });
    }
    Ok(plan_runs(&goals, config, seed))
}

fn plan_runs(goals: &[&Blueprint], config: &ResetFreeConfig, seed: u64) -> Vec<Vec<Job>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut plan = Vec::new();
    for run_idx in 0..config.n_runs {
        let mut last: Option<usize> = None;
        let mut run = Vec::new();
        for goal_idx in 0..config.n_goals {
            let goal = match last {
                // A draw among the others: those from the last one on move up by one.
                Some(last) if goals.len() > 1 => {
                    let drawn = rng.random_range(0..goals.len() - 1);
                    drawn + usize::from(drawn >= last)
                }
                _ => rng.random_range(0..goals.len()),
            };
            last = Some(goal);
            let start = if goal_idx == 0 { Start::Scattered } else { Start::AsItIs };
            let episode_idx = u64::from(run_idx) * u64::from(config.n_goals) + u64::from(goal_idx);
            run.push(Job::new(goals[goal], start, seed, episode_idx));
        }
        plan.push(run);
    }
    plan
}

fn count(runs: &[Vec<Played>], acting: Acting) -> EvalRuns {
    let succeeded = |played: &Played| matches!(played.episode.end, End::Success { .. });
    let n_goals = runs.first().map_or(0, Vec::len);
    let n_successes_at = |goal_idx: usize| runs.iter().filter(|run| succeeded(&run[goal_idx])).count() as u64;
    let rates: Vec<f64> =
        runs.iter().map(|run| run.iter().filter(|p| succeeded(p)).count() as f64 / run.len().max(1) as f64).collect();
    let n = rates.len().max(1) as f64;
    let mean = rates.iter().sum::<f64>() / n;
    let variance = rates.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / n;
    let episodes: Vec<&Episode> = runs.iter().flatten().map(|played| &played.episode).collect();
    EvalRuns {
        outcome: outcome(&episodes, acting),
        n_successes_by_goal: (0..n_goals).map(n_successes_at).collect(),
        run_rate_std: variance.sqrt(),
        n_forced_resets: runs.iter().flatten().filter(|played| played.forced_reset).count() as u64,
    }
}

#[cfg(test)]
mod tests {
    use proto::RewardTerms;

    use super::*;

    fn played(end: End, forced_reset: bool) -> Played {
        let blueprint = Catalogue::builtin().of_split(Split::Train)[0];
        let episode = Episode {
            blueprint: blueprint.id().clone(),
            split: Split::Train,
            n_blocks: blueprint.n_blocks(),
            acting: Acting::Mode,
            end,
            n_steps: 10,
            episode_return: RewardTerms::default(),
        };
        Played { episode, forced_reset }
    }

    #[test]
    fn hand_worked_counts() {
        let success = || played(End::Success { stable: true }, false);
        let runs = [
            vec![success(), success()],
            vec![success(), played(End::TimeLimit, false)],
            vec![played(End::Diverged, false), played(End::TimeLimit, true)],
        ];
        let found = count(&runs, Acting::Mode);
        assert_eq!((found.n_successes_by_goal, found.n_forced_resets), (vec![2, 1], 1));
        assert_eq!((found.outcome.success.rate, found.outcome.n_diverged), (0.5, 1));
        // Rates 1, 1/2 and 0: variance (1/4 + 0 + 1/4) / 3.
        assert!((found.run_rate_std - (1.0_f64 / 6.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_run_begins_scattered_and_changes_its_goal_every_time() {
        let goals = Catalogue::builtin().of_split(Split::Train);
        let config = ResetFreeConfig { n_runs: 20, n_goals: 10, min_blocks: 1 };
        let plan = plan_runs(&goals[..2], &config, 3);
        assert_eq!((plan.len(), plan[0].len()), (20, 10));
        for run in &plan {
            assert_eq!(run[0].task().start, Start::Scattered);
            assert!(run[1..].iter().all(|job| job.task().start == Start::AsItIs));
            assert!(run.windows(2).all(|pair| pair[0].task().blueprint != pair[1].task().blueprint));
        }
    }
}

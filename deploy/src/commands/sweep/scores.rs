//! Success of runs by goal, and of several runs by group: at their end, and over their environment steps.

use std::collections::BTreeMap;

use blueprints::Group;
use proto::ActionMode;
use runlog::series::lineage;
use runlog::{Evaluation, History, HistoryError, RunPaths};
use serde::{Deserialize, Serialize};

use super::plan::Run;
use super::statistics::Aggregate;

/// Name of the runs of several goals without a reset, as in `report`.
const RESET_FREE: &str = "reset-free";

/// Maximum number of moments of a curve. Each costs a bootstrap for every group.
const MAX_MOMENTS: usize = 40;

/// Success of a run on one goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Score {
    pub(super) group: String,
    pub(super) goal: String,
    pub(super) acting: ActionMode,
    pub(super) rate: f64,
}

/// The success of a point in a group.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct GroupResult {
    pub(super) group: String,
    pub(super) acting: ActionMode,
    pub(super) n_runs: usize,
    pub(super) n_goals: usize,
    #[serde(flatten)]
    pub(super) aggregate: Aggregate,
}

/// The success of an evaluation on every goal.
pub(super) fn scores(evaluation: &Evaluation) -> Vec<Score> {
    let mut scores = Vec::new();
    for acting in [ActionMode::Greedy, ActionMode::Sampled] {
        for score in &evaluation.blueprints {
            if let (Some(group), Some(outcome)) = (score.group(), score.outcome(acting)) {
                let group = group.name().to_owned();
                let goal = score.blueprint.to_string();
                scores.push(Score { group, goal, acting, rate: outcome.success.rate });
            }
        }
    }
    for (acting, runs) in evaluation.reset_free.iter().flat_map(|runs| runs.outcomes()) {
        let rate = runs.outcome.success.rate;
        scores.push(Score { group: RESET_FREE.to_owned(), goal: RESET_FREE.to_owned(), acting, rate });
    }
    scores
}

/// The aggregates of several runs, first those of greedy actions, the groups in their order.
pub(super) fn groups(runs: &[&[Score]]) -> Vec<GroupResult> {
    let mut rates: BTreeMap<(ActionMode, usize, &str), BTreeMap<&str, Vec<f64>>> = BTreeMap::new();
    for Score { group, goal, acting, rate } in runs.iter().copied().flatten() {
        let place = Group::ALL.iter().position(|known| known.name() == group).unwrap_or(Group::ALL.len());
        rates.entry((*acting, place, group)).or_default().entry(goal).or_default().push(*rate);
    }
    let of_group = |((acting, _, group), goals): ((_, _, &str), BTreeMap<&str, Vec<f64>>)| {
        let scores: Vec<Vec<f64>> = goals.into_values().collect();
        let n_runs = scores.iter().map(Vec::len).max().unwrap_or(0);
        let group = group.to_owned();
        let n_goals = scores.len();
        let aggregate = Aggregate::of(&scores);
        GroupResult { group, acting, n_runs, n_goals, aggregate }
    };
    rates.into_iter().map(of_group).collect()
}

/// Success at one number of environment steps.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Moment {
    pub(super) n_env_steps: u64,
    pub(super) groups: Vec<GroupResult>,
}

/// The scores of a run's evaluations, each after its number of environment steps, in order.
type Evaluated = Vec<(u64, Vec<Score>)>;

/// The curve of the runs of a point.
pub(super) fn curve<'r>(runs: impl Iterator<Item = &'r Run>) -> Result<Vec<Moment>, HistoryError> {
    let evaluated = |run: &Run| -> Result<Evaluated, HistoryError> {
        let evaluations = History::read(&RunPaths::new(&run.folder).history())?;
        Ok(lineage(evaluations).iter().map(|evaluation| (evaluation.n_env_steps, scores(evaluation))).collect())
    };
    Ok(moments(&runs.map(evaluated).collect::<Result<Vec<_>, _>>()?))
}

/// Takes the steps from the first run, and for each of them the nearest evaluation of every other run: evaluations of
/// different seeds are some steps apart. Leaves out what is not evaluated in all of them.
fn moments(runs: &[Evaluated]) -> Vec<Moment> {
    let Some(first) = runs.first() else { return Vec::new() };
    let moment = |&(n_env_steps, _): &(u64, Vec<Score>)| {
        let nearest = runs.iter().filter_map(|run| run.iter().min_by_key(|(steps, _)| steps.abs_diff(n_env_steps)));
        let mut groups = groups(&nearest.map(|(_, scores)| scores.as_slice()).collect::<Vec<_>>());
        groups.retain(|group| group.n_runs == runs.len());
        Moment { n_env_steps, groups }
    };
    // The last evaluation stays, as it is the one of the table.
    let every = first.len().div_ceil(MAX_MOMENTS).max(1);
    let mut moments: Vec<Moment> = first.iter().rev().step_by(every).map(moment).collect();
    moments.reverse();
    moments
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(evaluations: &[(u64, &[(&str, f64)])]) -> Evaluated {
        let score = |&(group, rate): &(&str, f64)| Score {
            group: group.to_owned(),
            goal: group.to_owned(),
            acting: ActionMode::Greedy,
            rate,
        };
        evaluations.iter().map(|(steps, scores)| (*steps, scores.iter().map(score).collect())).collect()
    }

    #[test]
    fn a_curve_pairs_the_nearest_evaluations_and_ends_with_that_of_the_table() {
        let (small, large) = ("train 2-6", "train 7-11");
        let first = run(&[(100, &[(small, 0.0)]), (200, &[(small, 0.5)]), (300, &[(small, 1.0), (large, 0.5)])]);
        // Its second evaluation is nearest to 100 and to 200, and only its last one has the other group.
        let second = run(&[(20, &[(small, 0.0)]), (140, &[(small, 0.5)]), (310, &[(small, 0.5), (large, 0.0)])]);
        let found: Vec<_> = moments(&[first.clone(), second])
            .into_iter()
            .map(|moment| {
                let mean = |group: &GroupResult| (group.group.clone(), group.n_runs, group.aggregate.mean);
                (moment.n_env_steps, moment.groups.iter().map(mean).collect::<Vec<_>>())
            })
            .collect();
        let expected = |group: &str, mean| (group.to_owned(), 2, mean);
        assert_eq!(
            found,
            [
                (100, vec![expected(small, 0.25)]),
                (200, vec![expected(small, 0.5)]),
                (300, vec![expected(small, 0.75), expected(large, 0.25)]),
            ]
        );
        assert_eq!(moments(&[first])[2].groups[0].aggregate.mean_interval, None);
        assert!(moments(&[]).is_empty());
        let long: Vec<(u64, &[(&str, f64)])> = (1..=101).map(|steps| (steps, &[][..])).collect();
        let steps: Vec<u64> = moments(&[run(&long)]).iter().map(|moment| moment.n_env_steps).collect();
        // Every third, counted from the last one.
        assert_eq!((steps.len(), steps[0], steps[33]), (34, 2, 101));
    }
}

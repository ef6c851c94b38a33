//! Success of runs by goal, and of several runs by group.

use std::collections::BTreeMap;

use blueprints::Group;
use proto::ActionMode;
use runlog::Evaluation;
use runlog::series::{group_of, outcome_of};
use serde::{Deserialize, Serialize};

use super::statistics::Aggregate;

/// Name of the runs of several goals without a reset, as in `report`.
const RESET_FREE: &str = "reset-free";

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
            if let (Some(group), Some(outcome)) = (group_of(score), outcome_of(score, acting)) {
                let group = group.name().to_owned();
                let goal = score.blueprint.to_string();
                scores.push(Score { group, goal, acting, rate: outcome.success.rate });
            }
        }
    }
    let runs = evaluation
        .reset_free
        .iter()
        .flat_map(|runs| [(ActionMode::Greedy, &runs.greedy), (ActionMode::Sampled, &runs.sampled)]);
    for (acting, runs) in runs.filter(|(_, runs)| runs.outcome.success.n_episodes > 0) {
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

//! Selects evaluations of a history, and computes numbers by blueprint.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Group, Split};
use proto::ActionMode;
use proto::metrics::EvalBlueprint;
use proto::wilson::SuccessRate;
use serde::Serialize;

use crate::Evaluation;

/// A blueprint as a table row; rows sort by split, size, and id.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Row {
    /// Split of the catalog.
    pub split: Split,
    /// Number of blocks.
    pub n_blocks: u64,
    /// The blueprint.
    pub id: BlueprintId,
    /// Name of its group; `None` for a size outside the paper's groups.
    pub group: Option<&'static str>,
}

impl Row {
    /// Returns the row of an evaluated blueprint.
    pub(crate) fn of(score: &EvalBlueprint) -> Self {
        let group = score.group().map(Group::name);
        Self { split: score.split, n_blocks: score.n_blocks, id: score.blueprint.clone(), group }
    }
}

/// Success rates by blueprint and environment steps of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Environment steps, increasing.
    pub steps: Vec<u64>,
    /// For each blueprint, a rate for each step; `None` if not evaluated.
    pub rows: BTreeMap<Row, Vec<Option<SuccessRate>>>,
}

/// Returns the evaluations that led to the last one, with increasing environment steps.
///
/// A run resumed from an older checkpoint repeats some steps. The result leaves out the evaluations of the abandoned
/// weights, and the first evaluation of weights that were evaluated twice.
pub fn lineage(evaluations: Vec<Evaluation>) -> Vec<Evaluation> {
    let mut kept = Vec::new();
    for evaluation in evaluations {
        push_newer(&mut kept, evaluation, |evaluation: &Evaluation| evaluation.n_env_steps);
    }
    kept
}

/// Appends a value of a run and removes those that it makes obsolete, so that the environment steps only increase: a run
/// that was resumed from an older checkpoint repeats some of them.
pub(crate) fn push_newer<T>(kept: &mut Vec<T>, value: T, n_env_steps: impl Fn(&T) -> u64) {
    while kept.last().is_some_and(|last| n_env_steps(last) >= n_env_steps(&value)) {
        kept.pop();
    }
    kept.push(value);
}

impl Grid {
    /// Builds a grid of evaluations with increasing steps; `None` if none used this action mode.
    pub fn success(evaluations: &[Evaluation], acting: ActionMode) -> Option<Self> {
        let is_evaluated = |evaluation: &&Evaluation| {
            let mut scores = evaluation.blueprints.iter();
            scores.any(|score| score.outcome(acting).is_some())
        };
        let evaluations: Vec<_> = evaluations.iter().filter(is_evaluated).collect();
        let mut rows: BTreeMap<Row, Vec<Option<SuccessRate>>> = BTreeMap::new();
        for (i, evaluation) in evaluations.iter().enumerate() {
            for score in &evaluation.blueprints {
                if let Some(outcome) = score.outcome(acting) {
                    let rates = rows.entry(Row::of(score)).or_insert_with(|| vec![None; evaluations.len()]);
                    rates[i] = Some(outcome.success);
                }
            }
        }
        let steps: Vec<u64> = evaluations.iter().map(|evaluation| evaluation.n_env_steps).collect();
        (!steps.is_empty()).then_some(Self { steps, rows })
    }
}

/// Success rates of several runs on the blueprints that all their evaluations share.
#[derive(Clone, Debug, PartialEq)]
pub struct Common {
    /// Number of shared blueprints, at least 1.
    pub n_blueprints: usize,
    /// Environment steps and success rate of each run's evaluations.
    pub of_runs: Vec<Vec<(u64, SuccessRate)>>,
}

/// Returns the success rates of runs on their shared blueprints; `None` if they share none.
pub fn common_rates(runs: &[Grid]) -> Option<Common> {
    let is_whole = |run: &Grid, row| run.rows.get(row).is_some_and(|rates| rates.iter().all(Option::is_some));
    let mut common: Vec<&Row> = runs.first()?.rows.keys().collect();
    common.retain(|row| runs.iter().all(|run| is_whole(run, row)));
    let of_run = |run: &Grid| {
        let at = |i: usize| common.iter().filter_map(|row| run.rows.get(row)?[i]).sum();
        run.steps.iter().enumerate().map(|(i, &steps)| (steps, at(i))).collect()
    };
    let of_runs = runs.iter().map(of_run).collect();
    (!common.is_empty()).then_some(Common { n_blueprints: common.len(), of_runs })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::tests::samples::evaluation;

    const TWO: (&str, Split, u64) = ("2_000", Split::Train, 2);
    const TEN: (&str, Split, u64) = ("10_000", Split::Train, 10);

    fn evaluations(scores: &[(u64, u64, Option<u64>)]) -> Vec<Evaluation> {
        let one = |&(steps, two, ten): &(u64, u64, Option<u64>)| {
            let ten = ten.map(|n| (TEN.0, TEN.1, TEN.2, n));
            evaluation(steps, &[Some((TWO.0, TWO.1, TWO.2, two)), ten].into_iter().flatten().collect::<Vec<_>>())
        };
        scores.iter().map(one).collect()
    }

    #[test]
    fn lineage_of_a_resumed_run_skips_abandoned_evaluations() {
        // Evaluated at 0, 100, 200, 300; resumed from a checkpoint at 150, which repeats 200.
        let all = evaluations(&[
            (0, 0, None),
            (100, 1, None),
            (200, 2, None),
            (300, 3, None),
            (150, 4, None),
            (200, 5, None),
        ]);
        let kept: Vec<(u64, u64)> =
            lineage(all).iter().map(|p| (p.n_env_steps, p.blueprints[0].greedy.success.n_successes)).collect();
        assert_eq!(kept, [(0, 0), (100, 1), (150, 4), (200, 5)]);
        assert_eq!(lineage(Vec::new()), []);
    }

    #[test]
    fn grid_rows_are_sorted_and_gaps_are_none() {
        let all = evaluations(&[(0, 0, None), (100, 10, Some(5))]);
        let grid = Grid::success(&all, ActionMode::Greedy).unwrap();
        assert_eq!(grid.rows.keys().map(|row| row.id.as_str()).collect::<Vec<_>>(), ["2_000", "10_000"]);
        assert_eq!(grid.steps, [0, 100]);
        let rates: Vec<Vec<_>> =
            grid.rows.values().map(|row| row.iter().map(|cell| Some(cell.as_ref()?.rate)).collect()).collect();
        assert_eq!(rates, [vec![Some(0.0), Some(1.0)], vec![None, Some(0.5)]]);
        assert_eq!(Grid::success(&all, ActionMode::Sampled), None);
    }

    #[test]
    fn common_rates_use_the_shared_blueprints() {
        let grid = |all: &[Evaluation]| Grid::success(all, ActionMode::Greedy).unwrap();
        let run = grid(&evaluations(&[(0, 0, None), (100, 6, Some(9))]));
        let other = grid(&evaluations(&[(5, 1, Some(2)), (110, 2, Some(3))]));
        let found = common_rates(&[run.clone(), other]).unwrap();
        let rate = |n| SuccessRate::new(n, 10);
        assert_eq!(found.of_runs, [vec![(0, rate(0)), (100, rate(6))], vec![(5, rate(1)), (110, rate(2))]]);
        assert_eq!(found.n_blueprints, 1);
        let strange = grid(&[evaluation(0, &[("3_000", Split::Train, 3, 0)])]);
        assert_eq!(common_rates(&[run, strange]), None);
    }
}

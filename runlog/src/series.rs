//! Selects evaluations of a history, and computes numbers by blueprint or group.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Group, Split};
use proto::ActionMode;
use proto::metrics::{EvalBlueprint, EvalOutcome};
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
}

/// Values by blueprint and environment steps of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// The blueprints, sorted.
    pub rows: Vec<Row>,
    /// Environment steps, increasing.
    pub steps: Vec<u64>,
    /// For each row, a value for each step; `None` if not evaluated.
    pub values: Vec<Vec<Option<f64>>>,
}

/// Returns the evaluations that led to the last one, with increasing environment steps.
///
/// A run resumed from an older checkpoint repeats some steps. The result leaves out the evaluations of the abandoned
/// weights, and the first evaluation of weights that were evaluated twice.
pub fn lineage(evaluations: &[Evaluation]) -> Vec<&Evaluation> {
    let mut kept: Vec<&Evaluation> = Vec::new();
    for evaluation in evaluations {
        push_newer(&mut kept, evaluation, |evaluation| evaluation.n_env_steps);
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

/// Returns the outcome for one action mode; `None` if it was not evaluated.
pub fn outcome_of(score: &EvalBlueprint, acting: ActionMode) -> Option<&EvalOutcome> {
    let outcome = match acting {
        ActionMode::Greedy => &score.greedy,
        ActionMode::Sampled => &score.sampled,
    };
    (outcome.success.n_episodes > 0).then_some(outcome)
}

/// Returns the success rates of an evaluation by blueprint.
fn rates(evaluation: &Evaluation, acting: ActionMode) -> BTreeMap<Row, SuccessRate> {
    let rate = |score: &EvalBlueprint| {
        let row = Row { split: score.split, n_blocks: score.n_blocks, id: score.blueprint.clone() };
        Some((row, outcome_of(score, acting)?.success))
    };
    evaluation.blueprints.iter().filter_map(rate).collect()
}

/// Returns the group of a blueprint; `None` for a size outside the paper's groups.
pub fn group_of(score: &EvalBlueprint) -> Option<Group> {
    Group::of(score.split, usize::try_from(score.n_blocks).ok()?)
}

/// Success rates of several runs on the blueprints that all their evaluations share.
#[derive(Clone, Debug, PartialEq)]
pub struct Common {
    /// Number of shared blueprints, at least 1.
    pub n_blueprints: usize,
    /// Environment steps and success rate of each run's evaluations.
    pub of_runs: Vec<Vec<(u64, SuccessRate)>>,
}

/// Returns the success rates of runs, each with increasing steps, on their shared blueprints; `None` if they share
/// none.
pub fn common_rates<'r>(runs: impl Iterator<Item = &'r [&'r Evaluation]>, acting: ActionMode) -> Option<Common> {
    let runs: Vec<Vec<Evaluated>> = runs.map(|evaluations| evaluated(evaluations, acting)).collect();
    let mut evaluations = runs.iter().flatten();
    let first = evaluations.next()?;
    if runs.iter().any(Vec::is_empty) {
        return None;
    }
    let mut common: Vec<&Row> = first.1.keys().collect();
    evaluations.for_each(|(_, rates)| common.retain(|row| rates.contains_key(row)));
    let total = |rates: &BTreeMap<Row, SuccessRate>| {
        let of_common = common.iter().filter_map(|row| rates.get(row));
        let (hits, all) = of_common.fold((0, 0), |(h, n), rate| (h + rate.n_successes, n + rate.n_episodes));
        SuccessRate::new(hits, all)
    };
    let of_runs = runs.iter().map(|run| run.iter().map(|(steps, rates)| (*steps, total(rates))).collect()).collect();
    (!common.is_empty()).then_some(Common { n_blueprints: common.len(), of_runs })
}

impl Grid {
    /// Builds a grid of the success rates of evaluations with increasing steps; `None` if none used this action mode.
    pub fn success(evaluations: &[&Evaluation], acting: ActionMode) -> Option<Self> {
        let columns = evaluated(evaluations, acting);
        let mut rows: Vec<Row> = columns.iter().flat_map(|(_, rates)| rates.keys().cloned()).collect();
        rows.sort();
        rows.dedup();
        let of_row = |row: &Row| columns.iter().map(|(_, rates)| Some(rates.get(row)?.rate)).collect();
        let values = rows.iter().map(of_row).collect();
        let steps: Vec<u64> = columns.iter().map(|(steps, _)| *steps).collect();
        (!steps.is_empty()).then_some(Self { rows, steps, values })
    }
}

type Evaluated = (u64, BTreeMap<Row, SuccessRate>);

/// Returns steps and success rates of the evaluations with this action mode.
fn evaluated(evaluations: &[&Evaluation], acting: ActionMode) -> Vec<Evaluated> {
    let all = evaluations.iter().map(|evaluation| (evaluation.n_env_steps, rates(evaluation, acting)));
    all.filter(|(_, rates)| !rates.is_empty()).collect()
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
            lineage(&all).iter().map(|p| (p.n_env_steps, p.blueprints[0].greedy.success.n_successes)).collect();
        assert_eq!(kept, [(0, 0), (100, 1), (150, 4), (200, 5)]);
        assert_eq!(lineage(&[]), [] as [&Evaluation; 0]);
    }

    #[test]
    fn grid_rows_are_sorted_and_gaps_are_none() {
        let all = evaluations(&[(0, 0, None), (100, 10, Some(5))]);
        let grid = Grid::success(&lineage(&all), ActionMode::Greedy).unwrap();
        assert_eq!(grid.rows.iter().map(|row| row.id.as_str()).collect::<Vec<_>>(), ["2_000", "10_000"]);
        assert_eq!(grid.steps, [0, 100]);
        assert_eq!(grid.values, [vec![Some(0.0), Some(1.0)], vec![None, Some(0.5)]]);
        assert_eq!(Grid::success(&lineage(&all), ActionMode::Sampled), None);
    }

    #[test]
    fn common_rates_use_the_shared_blueprints() {
        let run = evaluations(&[(0, 0, None), (100, 6, Some(9))]);
        let other = evaluations(&[(5, 1, Some(2)), (110, 2, Some(3))]);
        let (run, other) = (lineage(&run), lineage(&other));
        let found = common_rates([&run[..], &other[..]].into_iter(), ActionMode::Greedy).unwrap();
        let rate = |n| SuccessRate::new(n, 10);
        assert_eq!(found.of_runs, [vec![(0, rate(0)), (100, rate(6))], vec![(5, rate(1)), (110, rate(2))]]);
        assert_eq!(found.n_blueprints, 1);
        let strange = vec![evaluation(0, &[("3_000", Split::Train, 3, 0)])];
        let strange = lineage(&strange);
        assert_eq!(common_rates([&run[..], &strange[..]].into_iter(), ActionMode::Greedy), None);
        assert_eq!(common_rates([&run[..], &[]].into_iter(), ActionMode::Greedy), None);
    }
}

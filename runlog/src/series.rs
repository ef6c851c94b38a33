//! Selects evaluations of a history, and computes numbers by blueprint or group.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Split};
use proto::metrics::{EvalBlueprint, EvalOutcome};
use proto::wilson::SuccessRate;

use crate::Evaluation;
use blueprints::Group;
use proto::ActionMode;

/// A blueprint as a table row; rows sort by split, size, and id.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
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

/// The success rate of one run minus that of another.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Differences of success rates, −1 to 1, at the steps of the first run.
    pub grid: Grid,
    /// Maximum distance between the two evaluations of a column, in environment steps.
    pub max_apart: u64,
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

/// Returns the success rates of an evaluation by group, with the number of blueprints.
pub fn group_rates(evaluation: &Evaluation, acting: ActionMode) -> BTreeMap<Group, (SuccessRate, usize)> {
    let mut counts: BTreeMap<Group, (u64, u64, usize)> = BTreeMap::new();
    for score in &evaluation.blueprints {
        if let (Some(group), Some(outcome)) = (group_of(score), outcome_of(score, acting)) {
            let (n_successes, n_episodes, n_blueprints) = counts.entry(group).or_default();
            *n_successes += outcome.success.n_successes;
            *n_episodes += outcome.success.n_episodes;
            *n_blueprints += 1;
        }
    }
    counts.into_iter().map(|(group, (hits, all, n))| (group, (SuccessRate::new(hits, all), n))).collect()
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
        let values =
            |rates: BTreeMap<Row, SuccessRate>| rates.into_iter().map(|(row, rate)| (row, rate.rate)).collect();
        let columns = evaluated(evaluations, acting).into_iter().map(|(steps, rates)| (steps, values(rates)));
        Self::of_columns(&columns.collect::<Vec<_>>())
    }

    /// Builds a grid of columns that have values; `None` if there is no column.
    fn of_columns(columns: &[(u64, BTreeMap<Row, f64>)]) -> Option<Self> {
        let mut rows: Vec<Row> = columns.iter().flat_map(|(_, values)| values.keys().cloned()).collect();
        rows.sort();
        rows.dedup();
        let of_row = |row: &Row| columns.iter().map(|(_, values)| values.get(row).copied()).collect();
        let values = rows.iter().map(of_row).collect();
        let steps: Vec<u64> = columns.iter().map(|(steps, _)| *steps).collect();
        (!steps.is_empty()).then_some(Self { rows, steps, values })
    }
}

impl Difference {
    /// Computes the success rate of `run` minus that of `other`, both with increasing steps; `None` if they share no
    /// blueprint.
    ///
    /// Two evaluations form a column if each is the other's nearest in environment steps. So no evaluation appears
    /// twice, and steps that only one run reached have no column.
    pub fn new(run: &[&Evaluation], other: &[&Evaluation], acting: ActionMode) -> Option<Self> {
        let (run, other) = (evaluated(run, acting), evaluated(other, acting));
        let mut max_apart = 0;
        let mut columns = Vec::new();
        for (steps, rates) in &run {
            let Some((their_steps, theirs)) = nearest(&other, *steps) else { continue };
            if nearest(&run, *their_steps).is_none_or(|(back, _)| back != steps) {
                continue;
            }
            let both = rates.iter().filter_map(|(row, rate)| {
                let difference = rate.rate - theirs.get(row)?.rate;
                Some((row.clone(), difference))
            });
            let both: BTreeMap<Row, f64> = both.collect();
            if !both.is_empty() {
                max_apart = max_apart.max(steps.abs_diff(*their_steps));
                columns.push((*steps, both));
            }
        }
        Some(Self { grid: Grid::of_columns(&columns)?, max_apart })
    }
}

type Evaluated = (u64, BTreeMap<Row, SuccessRate>);

/// Returns steps and success rates of the evaluations with this action mode.
fn evaluated(evaluations: &[&Evaluation], acting: ActionMode) -> Vec<Evaluated> {
    let all = evaluations.iter().map(|evaluation| (evaluation.n_env_steps, rates(evaluation, acting)));
    all.filter(|(_, rates)| !rates.is_empty()).collect()
}

/// Returns the evaluation nearest to `steps`; the earlier one if two are equally near.
fn nearest(evaluations: &[Evaluated], steps: u64) -> Option<&Evaluated> {
    evaluations.iter().min_by_key(|(their_steps, _)| their_steps.abs_diff(steps))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::samples::evaluation;

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
    fn difference_pairs_mutually_nearest_evaluations() {
        let run = evaluations(&[(0, 0, None), (100, 6, Some(9)), (190, 8, None), (210, 9, None), (900, 9, None)]);
        let other = evaluations(&[(5, 1, None), (110, 2, None), (200, 4, Some(0))]);
        let found = Difference::new(&lineage(&run), &lineage(&other), ActionMode::Greedy).unwrap();
        // 0 pairs with 5, 100 with 110, and 190 with 200; 210 is as near to 200 but later, and 900 has no partner.
        assert_eq!((found.grid.steps, found.max_apart), (vec![0, 100, 190], 10));
        let values: Vec<f64> = found.grid.values[0].iter().map(|value| (10.0 * value.unwrap()).round()).collect();
        assert_eq!(values, [-1.0, 4.0, 4.0]);
        // 10_000 was never evaluated on both sides of a column.
        assert_eq!(found.grid.rows.len(), 1);
        let strange = vec![evaluation(0, &[("3_000", Split::Train, 3, 0)])];
        assert_eq!(Difference::new(&lineage(&run), &lineage(&strange), ActionMode::Greedy), None);
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

    #[test]
    fn group_rates_sum_their_blueprints() {
        let all = [evaluation(
            0,
            &[("2_000", Split::Train, 2, 4), ("3_000", Split::Train, 3, 9), ("10_000", Split::Train, 10, 1)],
        )];
        let found = group_rates(&all[0], ActionMode::Greedy);
        let counted: Vec<_> = found.iter().map(|(g, (rate, n))| (*g, rate.n_successes, rate.n_episodes, *n)).collect();
        assert_eq!(counted, [(Group::Train2To6, 13, 20, 2), (Group::Train7To11, 1, 10, 1)]);
    }
}

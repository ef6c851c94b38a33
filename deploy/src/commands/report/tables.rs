//! The tables of a report: groups in one evaluation, as Markdown and as comma-separated values, and evaluations over the
//! steps of runs, as comma-separated values alone: rates from 0 to 1, with their 95% Wilson intervals.

use blueprints::Group;
use proto::ActionMode;
use proto::metrics::{EvalOutcome, EvalRuns};
use proto::wilson::SuccessRate;
use runlog::Evaluation;
use runlog::series::{Common, Grid};
use serde::Serialize;

/// Results of a group with one action mode.
#[derive(Serialize)]
pub(super) struct GroupRow {
    /// `train 2-6` and so on, `validation`, `all`, or `reset-free`.
    pub(super) name: String,
    /// Number of blueprints, or of goals in a reset-free run.
    pub(super) n_blueprints: usize,
    pub(super) acting: ActionMode,
    pub(super) success: SuccessRate,
    pub(super) stable_success: SuccessRate,
    /// Mean steps of the successful episodes, if there are any.
    pub(super) mean_steps_to_success: Option<f64>,
    /// Mean undiscounted return.
    pub(super) mean_return: f64,
    /// Episodes whose physics diverged.
    pub(super) n_diverged: u64,
}

/// Returns the rows of an evaluation: the paper's groups in its order, the validation split, all blueprints, and the
/// reset-free runs; those that were not evaluated are left out.
pub(super) fn groups(evaluation: &Evaluation) -> Vec<GroupRow> {
    let mut rows = Vec::new();
    for group in Group::ALL.map(Some).into_iter().chain([None]) {
        for acting in [ActionMode::Greedy, ActionMode::Sampled] {
            let members = evaluation.blueprints.iter().filter(|score| group.is_none() || score.group() == group);
            let outcomes: Vec<&EvalOutcome> = members.filter_map(|score| score.outcome(acting)).collect();
            rows.extend(group_row(group.map_or("all", Group::name), acting, outcomes.len(), &outcomes));
        }
    }
    if let Some(runs) = &evaluation.reset_free {
        let n_goals = usize::try_from(runs.n_goals).unwrap_or(usize::MAX);
        let row = |(acting, runs): (_, &EvalRuns)| group_row("reset-free", acting, n_goals, &[&runs.outcome]);
        rows.extend(runs.outcomes().filter_map(row));
    }
    rows
}

/// Formats the rows as a Markdown table, rates in percent with the 95 % interval.
pub(super) fn groups_markdown(rows: &[GroupRow]) -> String {
    let mut text = "| group | blueprints | actions | episodes | success | 95 % interval | stable | steps to success | \
                    return | diverged |\n|---|---|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    for row in rows {
        let [success, low, high, stable] =
            [row.success.rate, row.success.wilson_low, row.success.wilson_high, row.stable_success.rate]
                .map(|x| 100.0 * x);
        let steps = row.mean_steps_to_success.map_or_else(|| "-".to_owned(), |steps| format!("{steps:.1}"));
        text += &format!(
            "| {} | {} | {} | {} | {success:.1} % | {low:.1} to {high:.1} | {stable:.1} % | {steps} | {:.2} | {} |\n",
            row.name, row.n_blueprints, row.acting, row.success.n_episodes, row.mean_return, row.n_diverged
        );
    }
    text
}

/// Formats the rows as comma-separated values with a header; rates from 0 to 1, missing numbers empty.
pub(super) fn groups_csv(rows: &[GroupRow]) -> String {
    let header = "group,n_blueprints,acting,n_episodes,n_successes,success,wilson_low,wilson_high,n_stable_successes,\
                  mean_steps_to_success,mean_return,n_diverged";
    let cells = rows.iter().map(|row| {
        let SuccessRate { n_successes, n_episodes, rate, wilson_low, wilson_high } = row.success;
        vec![
            row.name.clone(),
            row.n_blueprints.to_string(),
            row.acting.to_string(),
            n_episodes.to_string(),
            n_successes.to_string(),
            rate.to_string(),
            wilson_low.to_string(),
            wilson_high.to_string(),
            row.stable_success.n_successes.to_string(),
            row.mean_steps_to_success.map(|steps| steps.to_string()).unwrap_or_default(),
            row.mean_return.to_string(),
            row.n_diverged.to_string(),
        ]
    });
    csv(std::iter::once(vec![header.to_owned()]).chain(cells))
}

/// One row per blueprint, and one column per evaluation, headed by its environment steps. Missing values are empty.
pub(super) fn grid(grid: &Grid) -> String {
    let steps = grid.steps.iter().map(u64::to_string);
    let header = ["split", "n_blocks", "blueprint"].map(str::to_owned).into_iter().chain(steps);
    let rows = grid.rows.iter().map(|(row, rates)| {
        let names = [row.split.to_string(), row.n_blocks.to_string(), row.id.to_string()];
        let rates = rates.iter().map(|rate| rate.map(|success| success.rate.to_string()).unwrap_or_default());
        names.into_iter().chain(rates).collect::<Vec<_>>()
    });
    csv(std::iter::once(header.collect()).chain(rows))
}

/// One row per group and evaluation.
pub(super) fn curves(evaluations: &[Evaluation], acting: ActionMode) -> String {
    let rows = evaluations.iter().flat_map(|evaluation| {
        let is_group = |name: &str| Group::ALL.iter().any(|group| group.name() == name);
        let of_groups = groups(evaluation).into_iter().filter(move |row| row.acting == acting && is_group(&row.name));
        of_groups.map(|of| row(&of.name, evaluation.n_env_steps, of.n_blueprints, &of.success))
    });
    csv(std::iter::once(header("group")).chain(rows))
}

/// One row per run and evaluation, on the blueprints that all runs have in common.
pub(super) fn comparison(runs: &[String], common: &Common) -> String {
    let rows = runs.iter().zip(&common.of_runs).flat_map(|(run, rates)| {
        rates.iter().map(|(n_env_steps, rate)| row(run, *n_env_steps, common.n_blueprints, rate))
    });
    csv(std::iter::once(header("run")).chain(rows))
}

fn group_row(name: &str, acting: ActionMode, n_blueprints: usize, outcomes: &[&EvalOutcome]) -> Option<GroupRow> {
    let success: SuccessRate = outcomes.iter().map(|outcome| outcome.success).sum();
    let SuccessRate { n_successes, n_episodes, .. } = success;
    let steps =
        outcomes.iter().filter_map(|outcome| Some(outcome.mean_steps_to_success? * outcome.success.n_successes as f64));
    let returns =
        outcomes.iter().map(|outcome| f64::from(outcome.mean_return.total()) * outcome.success.n_episodes as f64);
    (n_episodes > 0).then(|| GroupRow {
        name: name.to_owned(),
        n_blueprints,
        acting,
        success,
        stable_success: outcomes.iter().map(|outcome| outcome.stable_success).sum(),
        mean_steps_to_success: (n_successes > 0).then(|| steps.sum::<f64>() / n_successes as f64),
        mean_return: returns.sum::<f64>() / n_episodes as f64,
        n_diverged: outcomes.iter().map(|outcome| outcome.n_diverged).sum(),
    })
}

fn header(of: &str) -> Vec<String> {
    let numbers = ["n_env_steps", "n_blueprints", "n_episodes", "success", "wilson_low", "wilson_high"];
    std::iter::once(of).chain(numbers).map(str::to_owned).collect()
}

fn row(name: &str, n_env_steps: u64, n_blueprints: usize, of: &SuccessRate) -> Vec<String> {
    let SuccessRate { n_episodes, rate, wilson_low, wilson_high, .. } = of;
    let mut row = vec![quoted(name), n_env_steps.to_string(), n_blueprints.to_string(), n_episodes.to_string()];
    row.extend([rate, wilson_low, wilson_high].map(f64::to_string));
    row
}

/// Puts a name with separators in quotes.
pub(in crate::commands) fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.to_owned() }
}

pub(in crate::commands) fn csv(rows: impl Iterator<Item = Vec<String>>) -> String {
    rows.map(|row| row.join(",") + "\n").collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_a_separator_stays_one_column() {
        let of_runs = vec![vec![(500, SuccessRate::new(3, 4))]];
        let text = comparison(&["a,b".to_owned()], &Common { n_blueprints: 2, of_runs });
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "run,n_env_steps,n_blueprints,n_episodes,success,wilson_low,wilson_high");
        assert!(lines[1].starts_with("\"a,b\",500,2,4,0.75,0."), "{}", lines[1]);
    }
}

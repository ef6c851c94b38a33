//! Evaluations over the steps of runs, as comma-separated values: rates from 0 to 1, with their 95% Wilson intervals.

use proto::ActionMode;
use proto::wilson::SuccessRate;
use runlog::Evaluation;
use runlog::series::{Common, Grid, group_rates};

/// One row per blueprint, and one column per evaluation, headed by its environment steps. Missing values are empty.
pub(super) fn grid(grid: &Grid) -> String {
    let steps = grid.steps.iter().map(u64::to_string);
    let header = ["split", "n_blocks", "blueprint"].map(str::to_owned).into_iter().chain(steps);
    let rows = grid.rows.iter().zip(&grid.values).map(|(row, values)| {
        let names = [row.split.to_string(), row.n_blocks.to_string(), row.id.to_string()];
        let values = values.iter().map(|value| value.map(|value| value.to_string()).unwrap_or_default());
        names.into_iter().chain(values).collect::<Vec<_>>()
    });
    csv(std::iter::once(header.collect()).chain(rows))
}

/// One row per group and evaluation.
pub(super) fn curves(evaluations: &[&Evaluation], acting: ActionMode) -> String {
    let rows = evaluations.iter().flat_map(|evaluation| {
        let rates = group_rates(evaluation, acting).into_iter();
        rates.map(|(group, (rate, n_blueprints))| row(group.name(), evaluation.n_env_steps, n_blueprints, &rate))
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

/// Joins the cells of rows.
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

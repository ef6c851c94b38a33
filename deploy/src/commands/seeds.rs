//! One training with several seeds: `train --seeds`, and how `report` summarizes the resulting folder.

use std::ffi::OsString;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use blueprints::outside::as_text;
use proto::ActionMode;
use render::plot::groups;
use runlog::series::lineage;
use runlog::{History, RunPaths};
use serde::Serialize;
use tokio_util::sync::CancellationToken;

use super::goals::TrainingGoals;
use super::train::{self, Summary};
use crate::cli::{RunArgs, Settings, TrainArgs};
use crate::config::MAX_SEED;
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::{Origin, default_folder};

/// Prefix of the folder name of each seed's run.
const PREFIX: &str = "seed-";

/// Success in a group over several runs.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    /// Name of the group, as in evaluations.
    group: String,
    acting: ActionMode,
    /// Success rate of each run, 0 to 1.
    rates: Vec<f64>,
    mean: f64,
    /// Sample standard deviation; `null` with one run.
    std: Option<f64>,
    /// Mean over the runs of their mean steps to success; `null` if a run has no successful episode.
    mean_steps_to_success: Option<f64>,
}

/// Results of several trainings.
#[derive(Debug, Serialize)]
pub(super) struct SeedsSummary {
    #[serde(serialize_with = "as_text")]
    folder: PathBuf,
    runs: Vec<Summary>,
    groups: Vec<Spread>,
}

/// Trains with the configured seed and the seeds after it, one after the other, each in its own folder.
///
/// # Errors
/// The first failure of a training; earlier trainings have been saved.
pub(super) async fn train(
    settings: &Settings,
    args: &TrainArgs,
    goals: &TrainingGoals,
    n_seeds: u64,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<SeedsSummary, Failure> {
    let first = settings.config.seed;
    if first.checked_add(n_seeds.saturating_sub(1)).is_none_or(|last| last > MAX_SEED) {
        return Err(Failure::Usage(format!("--seeds {n_seeds} from seed {first} on goes beyond {MAX_SEED}")));
    }
    let folder = args.run.run_dir.clone().map_or_else(|| default_folder(&settings.config), Ok)?;
    let mut runs = Vec::new();
    for seed in (first..).take(usize::try_from(n_seeds).unwrap_or(usize::MAX)) {
        let mut own = settings.clone();
        own.config.seed = seed;
        // Without a last evaluation there would be nothing to compare.
        own.config.evaluator.evaluate_last = true;
        let run_dir = folder.join(format!("{PREFIX}{seed}"));
        terminal.print(&format!("seed {seed}, {} of {n_seeds}", runs.len() + 1));
        let origin = Origin::find(&RunArgs { run_dir: Some(run_dir.clone()), ..args.run.clone() });
        // Use a child token, because a training cancels its token when it ends.
        let its_end = shutdown.child_token();
        let trained = train::run(&own, args, goals, Some(&run_dir), origin, terminal, its_end).await;
        let is_complete = trained.as_ref().is_ok_and(Summary::is_complete);
        if shutdown.is_cancelled() && !(is_complete && runs.len() as u64 + 1 == n_seeds) {
            let command = continuing(std::env::args_os(), &args.run, &folder);
            terminal.print(&format!("\nended in seed {seed}\n  continue all {n_seeds} seeds: {command}"));
        }
        runs.push(trained?);
        if shutdown.is_cancelled() {
            break;
        }
    }
    let groups = spreads(&folder)?;
    if !groups.is_empty() {
        terminal.print(&table(&groups));
    }
    Ok(SeedsSummary { folder, runs, groups })
}

/// The command that this process was started with, changed so that it goes on with the seeds in `folder`.
fn continuing(command: impl Iterator<Item = OsString>, run: &RunArgs, folder: &Path) -> String {
    let mut words: Vec<String> = command.map(|word| quoted(&word.to_string_lossy())).collect();
    if run.run_dir.is_none() {
        words.extend(["--run-dir".to_owned(), quoted(&folder.to_string_lossy())]);
    }
    if !run.auto_resume {
        words.push("--auto-resume".to_owned());
    }
    words.join(" ")
}

/// A word as a shell reads it.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_-./=:,@%+".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// The arguments of the first seed's run, whose configuration all seeds share.
pub(super) fn first_run(run: &RunArgs) -> RunArgs {
    let found = run.run_dir.as_deref().map(|folder| seeds_in(folder, RunPaths::config)).unwrap_or_default();
    RunArgs { run_dir: found.into_iter().next().or_else(|| run.run_dir.clone()), ..run.clone() }
}

/// The runs of the seeds in a folder that have been evaluated, ordered by seed.
pub(super) fn runs_in(folder: &Path) -> Vec<PathBuf> {
    seeds_in(folder, RunPaths::history)
}

/// The runs of the seeds in a folder that have this file, ordered by seed.
fn seeds_in(folder: &Path, file: impl Fn(&RunPaths) -> PathBuf) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let seed = |path: &Path| path.file_name()?.to_str()?.strip_prefix(PREFIX)?.parse::<u64>().ok();
    let mut found: Vec<(u64, PathBuf)> =
        entries.filter_map(|entry| Some((seed(&entry.path())?, entry.path()))).collect();
    found.retain(|(_, run)| file(&RunPaths::new(run)).exists());
    found.sort();
    found.into_iter().map(|(_, run)| run).collect()
}

/// Success by group in the last evaluation of each seed's run; groups missing from any of them are left out.
///
/// # Errors
/// When a history cannot be read.
pub(super) fn spreads(folder: &Path) -> Result<Vec<Spread>, Failure> {
    let mut tables = Vec::new();
    for run in runs_in(folder) {
        let passes = History::read(&RunPaths::new(run).history())?;
        tables.push(lineage(&passes).last().map(|last| groups::rows(last)).unwrap_or_default());
    }
    let Some((first, others)) = tables.split_first() else { return Ok(Vec::new()) };
    let spread = |row: &groups::GroupRow| {
        let same = |table: &'_ Vec<groups::GroupRow>| {
            table.iter().find(|other| (&other.name, other.acting) == (&row.name, row.acting)).cloned()
        };
        let rows: Option<Vec<_>> = others.iter().map(same).collect();
        let rows = [vec![row.clone()], rows?].concat();
        let steps: Option<Vec<f64>> = rows.iter().map(|row| row.mean_steps_to_success).collect();
        let rates: Vec<f64> = rows.iter().map(|row| row.success.rate).collect();
        Some(Spread {
            group: row.name.clone(),
            acting: row.acting,
            mean: mean(&rates),
            std: deviation(&rates),
            rates,
            mean_steps_to_success: steps.map(|steps| mean(&steps)),
        })
    };
    Ok(first.iter().filter_map(spread).collect())
}

/// Renders the spreads as a Markdown table, with rates in percent.
pub(super) fn table(spreads: &[Spread]) -> String {
    let n_runs = spreads.first().map_or(0, |spread| spread.rates.len());
    let mut text = format!(
        "| group | actions | mean of {n_runs} seeds, % | deviation | each | steps |\n|---|---|---|---|---|---|\n"
    );
    for Spread { group, acting, rates, mean, std, mean_steps_to_success } in spreads {
        let each: Vec<String> = rates.iter().map(|rate| format!("{:.1}", 100.0 * rate)).collect();
        let std = std.map_or_else(|| "-".to_owned(), |std| format!("{:.1}", 100.0 * std));
        let steps = mean_steps_to_success.map_or_else(|| "-".to_owned(), |steps| format!("{steps:.1}"));
        let mean = 100.0 * mean;
        writeln!(text, "| {group} | {acting} | {mean:.1} | {std} | {} | {steps} |", each.join(", "))
            .expect("a string takes all");
    }
    text
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64]) -> Option<f64> {
    let middle = mean(values);
    let squares: f64 = values.iter().map(|x| (x - middle).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_of_three_rates_is_that_of_a_sample() {
        // Mean 0.6; squared deviations 0.04 + 0 + 0.04, divided by 2.
        let rates = [0.4, 0.6, 0.8];
        assert!((mean(&rates) - 0.6).abs() < 1e-12);
        assert!((deviation(&rates).unwrap() - 0.2).abs() < 1e-12);
        assert_eq!(deviation(&rates[..1]), None);
        let spread = |rates: &[f64]| Spread {
            group: "train 2-6".to_owned(),
            acting: ActionMode::Greedy,
            rates: rates.to_vec(),
            mean: mean(rates),
            std: deviation(rates),
            mean_steps_to_success: Some(21.25),
        };
        assert!(table(&[spread(&rates)]).ends_with("| train 2-6 | greedy | 60.0 | 20.0 | 40.0, 60.0, 80.0 | 21.2 |\n"));
        assert!(table(&[spread(&rates[..1])]).contains("| 40.0 | - | 40.0 |"));
    }

    #[test]
    fn the_command_that_goes_on_can_be_pasted() {
        let command = ["lodestone", "train", "--seeds", "2", "--set", "evaluator.selection.splits=[\"it's\"]"];
        let words = || command.map(OsString::from).into_iter();
        let set = r#"'evaluator.selection.splits=["it'\''s"]'"#;
        let folder = Path::new("runs/a b");
        assert_eq!(
            continuing(words(), &RunArgs::default(), folder),
            format!("lodestone train --seeds 2 --set {set} --run-dir 'runs/a b' --auto-resume")
        );
        let again = RunArgs { run_dir: Some("runs/a b".into()), auto_resume: true, ..RunArgs::default() };
        assert_eq!(continuing(words(), &again, folder), format!("lodestone train --seeds 2 --set {set}"));
    }

    #[test]
    fn only_folders_of_seeds_with_a_history_count() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["seed-10", "seed-9", "seed-x", "other", "seed-11"] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
        }
        for name in ["seed-10", "seed-9", "seed-x", "other"] {
            std::fs::write(RunPaths::new(folder.path().join(name)).history(), "").unwrap();
        }
        assert_eq!(runs_in(folder.path()), ["seed-9", "seed-10"].map(|name| folder.path().join(name)));
    }
}

//! `report`: tables of a run's evaluations, or of a sweep.

mod groups;
pub(super) mod tables;

use std::path::{Path, PathBuf};

use proto::ActionMode;
use runlog::series::{Difference, Grid, common_rates, lineage};
use runlog::{Evaluation, History, RunPaths};
use serde_json::json;

use super::common::serve_command;
use super::files::{File, write_files};
use super::names::{name, names};
use super::sweep::{self, Results};
use crate::cli::ReportArgs;
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::check_exists;

/// Default output folder, inside the run's folder.
const REPORT: &str = "report";

/// Runs the subcommand. Makes every table before it writes the first file.
///
/// # Errors
/// When a history is missing, damaged, written by a newer version, or without evaluations of this action mode, the runs
/// have no blueprint in common, or a file cannot be written.
pub(super) fn run(args: &ReportArgs, terminal: &Terminal) -> Result<(), Failure> {
    let stdout = terminal;
    let terminal = &if args.json { terminal.on_stderr() } else { terminal.clone() };
    if let Some(results) = sweep::results(&args.run)? {
        return of_sweep(args, &results, stdout);
    }
    let acting = args.acting;
    let all = history(&args.run)?;
    let evaluations = shown(&all, &args.run, terminal);
    let grid = success(&args.run, &evaluations, acting)?;
    let mut files = vec![file("success", tables::grid(&grid)), file("curves", tables::curves(&evaluations, acting))];
    let rows = evaluations.last().map(|last| groups::rows(last)).unwrap_or_default();
    files.push(("groups.md".to_owned(), groups::markdown(&rows).into_bytes()));
    files.push(file("groups", groups::csv(&rows)));
    if let Some(minus) = &args.minus {
        files.push(difference(&evaluations, args, minus, terminal)?);
    }
    if !args.beside.is_empty() {
        files.push(comparison(&evaluations, args, terminal)?);
    }
    let written = write(args, &files)?;
    if args.json {
        return super::common::json(&summary(args, &evaluations, &grid, &written), stdout);
    }
    let what = format!("{} of {}", count(evaluations.len(), "evaluation"), count(grid.rows.len(), "blueprint"));
    terminal.print(&format!("{} ({what}):", name(&args.run)));
    tell(args, &groups::markdown(&rows), &written, terminal);
    Ok(())
}

/// Writes the files; returns their paths.
fn write(args: &ReportArgs, files: &[File]) -> anyhow::Result<Vec<String>> {
    let out = args.out.clone().unwrap_or_else(|| args.run.join(REPORT));
    write_files(&out, files)?;
    Ok(files.iter().map(|(file, _)| out.join(file).display().to_string()).collect())
}

/// Prints the table, and where to find the rest.
fn tell(args: &ReportArgs, table: &str, written: &[String], terminal: &Terminal) {
    terminal.print(table.trim_end());
    for path in written {
        terminal.print(&format!("  {path}"));
    }
    let runs: Vec<PathBuf> = [&args.run].into_iter().chain(&args.minus).chain(&args.beside).cloned().collect();
    terminal.print(&format!("heat map and curves: {}", serve_command(&runs)));
}

/// The report of a sweep, all of whose runs that are done are in its curves.
fn of_sweep(args: &ReportArgs, results: &Results, terminal: &Terminal) -> Result<(), Failure> {
    if args.minus.is_some() || !args.beside.is_empty() {
        return Err(Failure::Usage("--minus and --beside compare runs, and RUN is a sweep".to_owned()));
    }
    results.done(1)?;
    if !results.has(args.acting) {
        return Err(Failure::NothingToShow(not_this_way(&args.run, args.acting)));
    }
    let written = write(args, &results.files(args.acting))?;
    if args.json {
        return super::common::json(&json!({ "sweep": results, "files": written }), terminal);
    }
    tell(args, &results.markdown(), &written, terminal);
    Ok(())
}

/// Output of `--json`: the groups of the last evaluation, and the files written.
fn summary(args: &ReportArgs, evaluations: &[&Evaluation], grid: &Grid, files: &[String]) -> serde_json::Value {
    let groups = evaluations.last().map(|last| groups::rows(last)).unwrap_or_default();
    let group = |row: &groups::GroupRow| {
        json!({
            "name": row.name, "n_blueprints": row.n_blueprints, "acting": row.acting.name(), "success": row.success,
            "stable_success": row.stable, "mean_steps_to_success": row.mean_steps_to_success,
            "mean_return": row.mean_return, "n_diverged": row.n_diverged,
        })
    };
    json!({
        "run": args.run.display().to_string(),
        "acting": args.acting.name(),
        "n_evaluations": evaluations.len(),
        "n_blueprints": grid.rows.len(),
        "weights_version": evaluations.last().map(|last| last.weights_version),
        "n_env_steps": evaluations.last().map(|last| last.n_env_steps),
        "groups": groups.iter().map(group).collect::<Vec<_>>(),
        "files": files,
    })
}

fn difference(
    evaluations: &[&Evaluation],
    args: &ReportArgs,
    minus: &Path,
    terminal: &Terminal,
) -> Result<File, Failure> {
    let all = history(minus)?;
    let others = shown(&all, minus, terminal);
    success(minus, &others, args.acting)?;
    let difference = Difference::new(evaluations, &others, args.acting).ok_or_else(|| {
        Failure::NothingToShow(format!(
            "{} and {} evaluated no blueprint in common with {} actions: give --minus a run with the same `evaluator.selection`",
            args.run.display(),
            minus.display(),
            args.acting,
        ))
    })?;
    if difference.max_apart > 0 {
        terminal.print(&format!("compared evaluations are at most {} environment steps apart", difference.max_apart));
    }
    Ok(file("difference", tables::grid(&difference.grid)))
}

fn comparison(evaluations: &[&Evaluation], args: &ReportArgs, terminal: &Terminal) -> Result<File, Failure> {
    let histories = args.beside.iter().map(|run| history(run)).collect::<Result<Vec<_>, _>>()?;
    let mut lineages = vec![evaluations.to_vec()];
    for (run, all) in args.beside.iter().zip(&histories) {
        let shown = shown(all, run, terminal);
        success(run, &shown, args.acting)?;
        lineages.push(shown);
    }
    let common = common_rates(lineages.iter().map(Vec::as_slice), args.acting).ok_or_else(|| {
        Failure::NothingToShow(format!(
            "no blueprint was evaluated with {} actions in every evaluation of {} and the runs beside it: give --beside runs with \
             the same `evaluator.selection`",
            args.acting,
            args.run.display(),
        ))
    })?;
    let folders = [&args.run].into_iter().chain(&args.beside).map(PathBuf::as_path);
    Ok(file("comparison", tables::comparison(&names(folders), &common)))
}

/// All evaluations of a run.
fn history(run: &Path) -> Result<Vec<Evaluation>, Failure> {
    check_exists(run)?;
    Ok(History::read(&RunPaths::new(run).history())?)
}

/// The evaluations to show; prints how many are left out.
fn shown<'p>(all: &'p [Evaluation], run: &Path, terminal: &Terminal) -> Vec<&'p Evaluation> {
    let evaluations = lineage(all);
    let n_left_out = all.len() - evaluations.len();
    if n_left_out > 0 {
        let run = run.display();
        let left_out = count(n_left_out, "evaluation");
        terminal.print(&format!("{run}: left out {left_out} that the run repeated after it was resumed"));
    }
    evaluations
}

/// The success of a run over its evaluations, of which there must be some.
fn success(run: &Path, evaluations: &[&Evaluation], acting: ActionMode) -> Result<Grid, Failure> {
    Grid::success(evaluations, acting).ok_or_else(|| {
        let history = RunPaths::new(run).history();
        Failure::NothingToShow(match Grid::success(evaluations, acting.other()) {
            Some(_) => not_this_way(&history, acting),
            None => format!("{} has no evaluation yet: wait for the first one", history.display()),
        })
    })
}

fn not_this_way(file: &Path, acting: ActionMode) -> String {
    format!("{} has no evaluation of {acting} actions: use --acting {}", file.display(), acting.other())
}

fn file(name: &str, csv: String) -> File {
    (format!("{name}.csv"), csv.into_bytes())
}

fn count(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

//! `report`: tables of a run's evaluations, or of a sweep.

pub(super) mod tables;

use std::path::{Path, PathBuf};

use proto::ActionMode;
use runlog::series::{Grid, common_rates, lineage};
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
pub(super) fn run(args: &ReportArgs, terminal: &Terminal) -> Result<(), Failure> {
    let stdout = terminal;
    let terminal = &if args.json { terminal.on_stderr() } else { terminal.clone() };
    if let Some(results) = sweep::results(&args.run)? {
        return of_sweep(args, &results, stdout);
    }
    let evaluations = evaluations(&args.run, terminal)?;
    let has_greedy = Grid::success(&evaluations, ActionMode::Greedy).is_some();
    let acting = args.acting.unwrap_or(default_acting(has_greedy));
    let grid = success(&args.run, &evaluations, acting)?;
    let mut files = vec![file("success", tables::grid(&grid)), file("curves", tables::curves(&evaluations, acting))];
    let rows = evaluations.last().map(tables::groups).unwrap_or_default();
    files.push(("groups.md".to_owned(), tables::groups_markdown(&rows).into_bytes()));
    files.push(file("groups", tables::groups_csv(&rows)));
    if !args.beside.is_empty() {
        files.push(comparison(&grid, acting, args, terminal)?);
    }
    let written = write(args, &files)?;
    if args.json {
        let summary = json!({
            "run": args.run.display().to_string(),
            "acting": acting.name(),
            "n_evaluations": evaluations.len(),
            "n_blueprints": grid.rows.len(),
            "weights_version": evaluations.last().map(|last| last.weights_version),
            "n_env_steps": evaluations.last().map(|last| last.n_env_steps),
            "groups": rows,
            "files": written,
        });
        return super::common::json(&summary, stdout);
    }
    let what = format!("{} of {}", count(evaluations.len(), "evaluation"), count(grid.rows.len(), "blueprint"));
    terminal.print(&format!("{} ({what}):", name(&args.run)));
    tell(args, &tables::groups_markdown(&rows), &written, terminal);
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
    let runs: Vec<PathBuf> = [&args.run].into_iter().chain(&args.beside).cloned().collect();
    terminal.print(&format!("heat map and curves: {}", serve_command(&runs)));
}

/// The report of a sweep, all of whose runs that are done are in its curves.
fn of_sweep(args: &ReportArgs, results: &Results, terminal: &Terminal) -> Result<(), Failure> {
    if !args.beside.is_empty() {
        return Err(Failure::Usage("--beside compares runs, and RUN is a sweep".to_owned()));
    }
    results.done(1)?;
    let acting = args.acting.unwrap_or(default_acting(results.has(ActionMode::Greedy)));
    if !results.has(acting) {
        return Err(Failure::NothingToShow(not_this_way(&args.run, acting)));
    }
    let written = write(args, &results.files(acting))?;
    if args.json {
        return super::common::json(&json!({ "sweep": results, "files": written }), terminal);
    }
    tell(args, &results.markdown(), &written, terminal);
    Ok(())
}

fn comparison(of_run: &Grid, acting: ActionMode, args: &ReportArgs, terminal: &Terminal) -> Result<File, Failure> {
    let mut grids = vec![of_run.clone()];
    for run in &args.beside {
        grids.push(success(run, &evaluations(run, terminal)?, acting)?);
    }
    let common = common_rates(&grids).ok_or_else(|| {
        Failure::NothingToShow(format!(
            "no blueprint was evaluated with {} actions in every evaluation of {} and the runs beside it: give --beside runs with \
             the same `evaluator.selection`",
            acting,
            args.run.display(),
        ))
    })?;
    let folders = [&args.run].into_iter().chain(&args.beside).map(PathBuf::as_path);
    Ok(file("comparison", tables::comparison(&names(folders), &common)))
}

/// The evaluations to show; prints how many are left out.
fn evaluations(run: &Path, terminal: &Terminal) -> Result<Vec<Evaluation>, Failure> {
    check_exists(run)?;
    let all = History::read(&RunPaths::new(run).history())?;
    let n_all = all.len();
    let evaluations = lineage(all);
    let n_left_out = n_all - evaluations.len();
    if n_left_out > 0 {
        let run = run.display();
        let left_out = count(n_left_out, "evaluation");
        terminal.print(&format!("{run}: left out {left_out} that the run repeated after it was resumed"));
    }
    Ok(evaluations)
}

/// The success of a run over its evaluations, of which there must be some.
fn success(run: &Path, evaluations: &[Evaluation], acting: ActionMode) -> Result<Grid, Failure> {
    Grid::success(evaluations, acting).ok_or_else(|| {
        let history = RunPaths::new(run).history();
        Failure::NothingToShow(match Grid::success(evaluations, acting.other()) {
            Some(_) => not_this_way(&history, acting),
            None => format!(
                "{} has no evaluation yet: wait for the first one, or go on with `train --resume`",
                history.display()
            ),
        })
    })
}

fn default_acting(has_greedy: bool) -> ActionMode {
    if has_greedy { ActionMode::Greedy } else { ActionMode::Sampled }
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

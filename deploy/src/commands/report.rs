//! `report`: plots and tables of a run's evaluations.

use std::path::{Path, PathBuf};

use anyhow::Context;
use proto::ActionMode;
use render::plot::{self, Drawing, MAX_RUNS, groups};
use runlog::series::{Difference, Grid, lineage, outcome_of};
use runlog::{History, Pass, RunPaths};
use serde_json::json;

use super::files::{File, write_files};
use super::names::{name, names};
use crate::cli::ReportArgs;
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::check_exists;

/// Default output folder, inside the run's folder.
const REPORT: &str = "report";

/// Runs the subcommand. Draws everything before it writes the first file.
///
/// # Errors
/// When a history is missing, damaged, written by a newer version, or without evaluations of this action mode, the runs
/// have no blueprint in common, or a file cannot be written.
pub(super) fn run(args: &ReportArgs, terminal: &Terminal) -> Result<(), Failure> {
    let stdout = terminal;
    let terminal = &if args.json { terminal.on_stderr() } else { terminal.clone() };
    if args.beside.len() >= MAX_RUNS {
        return Err(Failure::Usage(format!("--beside: a picture has room for {} runs besides RUN", MAX_RUNS - 1)));
    }
    check_exists(&args.run)?;
    let (acting, name) = (args.acting, name(&args.run));
    let all = history(&args.run)?;
    let passes = shown(&all, &args.run, terminal);
    let grid = Grid::success(&passes, acting).ok_or_else(|| nothing(&args.run, &passes, acting))?;
    let what = format!("{name}, {acting} actions, {}", episodes(&passes, acting));
    let map = plot::success_map(&grid, "Success by blueprint over training", &what);
    let mut files = picture("success", &map)?;
    let what = format!("{what}, 95 % intervals");
    if let Some(curves) = plot::curves(&passes, acting, "Success by group over training", &what) {
        files.extend(picture("curves", &curves)?);
    }
    if let Some(last) = passes.last() {
        let rows = groups::rows(last);
        files.push(("groups.md".to_owned(), groups::markdown(&rows).into_bytes()));
        files.push(("groups.csv".to_owned(), groups::csv(&rows).into_bytes()));
    }
    if let Some(minus) = &args.minus {
        files.extend(difference(&passes, args, minus, terminal)?);
    }
    if !args.beside.is_empty() {
        files.extend(comparison(&passes, args, terminal)?);
    }
    let out = args.out.clone().unwrap_or_else(|| args.run.join(REPORT));
    write_files(&out, &files)?;
    if args.json {
        return super::json(&summary(args, &passes, &grid, &out, &files), stdout);
    }
    let n_passes = count(passes.len(), "evaluation");
    terminal.print(&format!("{n_passes} of {} drawn", count(grid.rows.len(), "blueprint")));
    for (file, _) in files {
        terminal.print(&format!("  {}", out.join(file).display()));
    }
    Ok(())
}

/// Output of `--json`: the groups of the last evaluation, and the files written.
fn summary(args: &ReportArgs, passes: &[&Pass], grid: &Grid, out: &Path, files: &[File]) -> serde_json::Value {
    let groups = passes.last().map(|last| groups::rows(last)).unwrap_or_default();
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
        "n_evaluations": passes.len(),
        "n_blueprints": grid.rows.len(),
        "weights_version": passes.last().map(|last| last.weights_version),
        "n_env_steps": passes.last().map(|last| last.n_env_steps),
        "groups": groups.iter().map(group).collect::<Vec<_>>(),
        "files": files.iter().map(|(file, _)| out.join(file).display().to_string()).collect::<Vec<_>>(),
    })
}

fn difference(passes: &[&Pass], args: &ReportArgs, minus: &Path, terminal: &Terminal) -> Result<Vec<File>, Failure> {
    let all = history(minus)?;
    let others = shown(&all, minus, terminal);
    if Grid::success(&others, args.acting).is_none() {
        return Err(nothing(minus, &others, args.acting));
    }
    let difference = Difference::new(passes, &others, args.acting).ok_or_else(|| {
        Failure::NothingToShow(format!(
            "{} and {} evaluated no blueprint in common with {} actions: give --minus a run with the same `evaluator.selection`",
            args.run.display(),
            minus.display(),
            args.acting,
        ))
    })?;
    let names = names([args.run.as_path(), minus]);
    let title = format!("Success of {}", names.join(" minus "));
    let apart = match difference.max_apart {
        0 => "at equal steps".to_owned(),
        n_steps => format!("at most {} environment steps apart", digits(n_steps)),
    };
    let what = format!("{} actions, blue: {} is better, evaluations {apart}", args.acting, names[0]);
    picture("difference", &plot::difference_map(&difference, &title, &what))
}

fn comparison(passes: &[&Pass], args: &ReportArgs, terminal: &Terminal) -> Result<Vec<File>, Failure> {
    let histories = args.beside.iter().map(|run| history(run)).collect::<Result<Vec<_>, _>>()?;
    let mut evaluations = vec![passes.to_vec()];
    for (run, all) in args.beside.iter().zip(&histories) {
        let passes = shown(all, run, terminal);
        if Grid::success(&passes, args.acting).is_none() {
            return Err(nothing(run, &passes, args.acting));
        }
        evaluations.push(passes);
    }
    let folders = [&args.run].into_iter().chain(&args.beside).map(PathBuf::as_path);
    let runs: Vec<_> = names(folders).into_iter().zip(evaluations).collect();
    let what = format!("{} actions, 95 % intervals, blueprints that every evaluation has", args.acting);
    let drawing = plot::comparison(&runs, args.acting, "Success of several runs over training", &what);
    let drawing = drawing.ok_or_else(|| {
        Failure::NothingToShow(format!(
            "no blueprint was evaluated with {} actions in every evaluation of {} and the runs beside it: give --beside runs with \
             the same `evaluator.selection`",
            args.acting,
            args.run.display(),
        ))
    })?;
    picture("comparison", &drawing)
}

/// All evaluations of a run.
fn history(run: &Path) -> Result<Vec<Pass>, Failure> {
    check_exists(run)?;
    Ok(History::read(&RunPaths::new(run).history())?)
}

/// The evaluations to show; prints how many are left out.
fn shown<'p>(all: &'p [Pass], run: &Path, terminal: &Terminal) -> Vec<&'p Pass> {
    let passes = lineage(all);
    let n_left_out = all.len() - passes.len();
    if n_left_out > 0 {
        let (run, left_out) = (run.display(), count(n_left_out, "evaluation"));
        terminal.print(&format!("{run}: left out {left_out} that the run repeated after it was resumed"));
    }
    passes
}

fn nothing(run: &Path, passes: &[&Pass], acting: ActionMode) -> Failure {
    let other = match acting {
        ActionMode::Greedy => ActionMode::Sampled,
        ActionMode::Sampled => ActionMode::Greedy,
    };
    let history = RunPaths::new(run).history();
    let run = history.display();
    Failure::NothingToShow(if Grid::success(passes, other).is_some() {
        format!("{run} has no evaluation of {acting} actions: use --acting {other}")
    } else {
        format!("{run} has no evaluation yet: wait for the first one")
    })
}

/// How many episodes each cell of the heat map stands for.
fn episodes(passes: &[&Pass], acting: ActionMode) -> String {
    let scores = passes.iter().flat_map(|pass| &pass.blueprints);
    let counts = scores.filter_map(|score| Some(outcome_of(score, acting)?.success.n_episodes));
    match (counts.clone().min(), counts.max()) {
        (Some(least), Some(most)) if least < most => format!("{least} to {most} episodes per blueprint"),
        (Some(1), _) => "1 episode per blueprint".to_owned(),
        (n_episodes, _) => format!("{} episodes per blueprint", n_episodes.unwrap_or_default()),
    }
}

fn picture(name: &str, drawing: &Drawing) -> Result<Vec<File>, Failure> {
    let png = drawing.to_png().context("encoding a picture")?;
    Ok(vec![(format!("{name}.svg"), drawing.to_svg().into_bytes()), (format!("{name}.png"), png)])
}

/// Formats a number with its digits in groups of three.
fn digits(n: u64) -> String {
    let text = n.to_string();
    let groups = text.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy);
    groups.collect::<Vec<_>>().join(" ")
}

fn count(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

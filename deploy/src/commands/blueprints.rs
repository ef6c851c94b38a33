//! `blueprints`: `list` and `check` are here, `show` in a file of its own.

mod physical;
mod show;
mod table;

use std::path::{Path, PathBuf};

use blueprints::catalog::{BUILTIN_FILES, read_files};
use blueprints::checks::{CheckResult, Report, check_all};
use blueprints::outside::printable;
use blueprints::{Blueprint, BlueprintId, Catalog, Split};
use serde::Serialize;

use super::common;
use super::files::write_new;
use crate::cli::{BlueprintsArgs, BlueprintsCommand};
use crate::exit::Failure;
use crate::live::Terminal;

/// A line of `blueprints list`.
#[derive(Debug, Serialize)]
struct Row<'a> {
    id: &'a BlueprintId,
    split: Split,
    n_blocks: usize,
    n_connections: usize,
    title: &'a str,
}

/// An entry of `blueprints check --json`.
#[derive(Debug, Serialize)]
struct Verdict<'a> {
    file: &'a str,
    id: Option<&'a BlueprintId>,
    passed: bool,
    checks: &'a [CheckResult],
    /// What the file leaves open and the checks inferred.
    inferred: Vec<String>,
}

pub(super) fn run(command: &BlueprintsCommand, terminal: &Terminal) -> Result<(), Failure> {
    match command {
        BlueprintsCommand::List(args) => list(args, terminal),
        BlueprintsCommand::Check { files, write } => check(files, write.as_deref(), terminal),
        BlueprintsCommand::Show(args) => show::run(args, terminal),
    }
}

fn list(args: &BlueprintsArgs, terminal: &Terminal) -> Result<(), Failure> {
    let loaded = args.paths.iter().map(|path| Catalog::load(path)).collect::<Result<Vec<_>, _>>()?;
    let catalogs = if loaded.is_empty() { std::slice::from_ref(Catalog::builtin().as_ref()) } else { &loaded };
    let rows: Vec<Row<'_>> = catalogs.iter().flat_map(Catalog::iter).map(row).collect();
    if args.json {
        return common::json(&rows, terminal);
    }
    let line = |row: &Row<'_>| {
        let Row { id, split, n_blocks, n_connections, title } = row;
        format!("{id:<18}{split:<13}{n_blocks:>6}{n_connections:>13}  {}", printable(title))
    };
    let header = format!("{:<18}{:<13}{:>6}{:>13}  title", "id", "split", "blocks", "connections");
    terminal.print_rows(&std::iter::once(header).chain(rows.iter().map(line)).collect::<Vec<_>>());
    Ok(())
}

fn row(blueprint: &Blueprint) -> Row<'_> {
    Row {
        id: blueprint.id(),
        split: blueprint.split(),
        n_blocks: blueprint.n_blocks(),
        n_connections: blueprint.links().len(),
        title: blueprint.title(),
    }
}

fn check(args: &BlueprintsArgs, write: Option<&Path>, terminal: &Terminal) -> Result<(), Failure> {
    let files = files(&args.paths)?;
    if write.is_some() && files.len() != 1 {
        return Err(Failure::Usage(format!("--write completes one file, and {} are named", files.len())));
    }
    let mut reports = check_all(files.iter().map(|(file, text)| (file.as_str(), text.as_str())));
    for report in &mut reports {
        physical::check(report)?;
    }
    if args.json {
        let verdicts: Vec<Verdict<'_>> = reports.iter().map(verdict).collect();
        common::json(&verdicts, terminal)?;
    } else {
        terminal.print(&table::render(&reports));
    }
    if let (Some(path), [report], [(_, text)]) = (write, &reports[..], &files[..])
        && report.blueprint.is_ok()
    {
        write_new(path, report.completed.as_ref().unwrap_or(text))?;
        terminal.on_stderr().print(&format!("the whole of it is in {}", path.display()));
    }
    let n_failed = reports.iter().filter(|report| !report.passed()).count();
    match n_failed {
        0 => Ok(()),
        _ => Err(Failure::Input(format!("{n_failed} of {} blueprints failed a check", reports.len()))),
    }
}

/// The files of all paths, or the built-in ones.
fn files(paths: &[PathBuf]) -> Result<Vec<(String, String)>, Failure> {
    if paths.is_empty() {
        return Ok(BUILTIN_FILES.iter().map(|(file, text)| ((*file).to_owned(), (*text).to_owned())).collect());
    }
    Ok(paths.iter().map(|path| read_files(path)).collect::<Result<Vec<_>, _>>()?.concat())
}

fn verdict(report: &Report) -> Verdict<'_> {
    let inferred = report.inferred.iter().map(ToString::to_string).collect();
    Verdict { file: &report.file, id: report.id.as_ref(), passed: report.passed(), checks: &report.results, inferred }
}

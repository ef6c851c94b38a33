//! `serve`: the web page for finished runs or a sweep, or a static copy of it.

use proto::Valid;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use blueprints::{BlueprintId, Catalog, Group};
use dashboard::config::WebConfig;
use dashboard::{About, Farewell, Finished, Kind, Page, ShownRun};
use proto::keys::METRICS_LEARNER;
use proto::metrics::LearnerMetrics;
use runlog::{History, RunPaths};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::common::serve_command;
use super::goals::Goals;
use super::models::Source;
use super::names::names;
use super::services;
use super::stage::stage;
use super::sweep;
use crate::cli::ServeArgs;
use crate::config::{Config, read};
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::check_run;

/// Maximum number of runs of a sweep that can be looked at one by one; all are kept in memory.
const MAX_RUNS: usize = 60;

/// Serves the page until `shutdown`, or writes the copy.
pub(super) async fn run(args: &ServeArgs, terminal: &Terminal, shutdown: CancellationToken) -> Result<(), Failure> {
    let sweep = match &args.runs[..] {
        [folder] => sweep::results(folder)?,
        _ => None,
    };
    let (folders, names) = match &sweep {
        Some(results) => results.done(MAX_RUNS)?,
        None => (args.runs.clone(), names(args.runs.iter().map(PathBuf::as_path))),
    };
    let sweep = sweep.map(|results| serde_json::to_value(results.without_paths()));
    let sweep = sweep.transpose().map_err(anyhow::Error::from)?;
    let farewell = Farewell { ended: "the program", command: Some(serve_command(&args.runs)) };
    let mut runs = folders.iter().zip(names).map(|(folder, name)| finished(folder, name, farewell.clone()));
    let mut first = runs.next().context("no run was named")??;
    let others = runs.collect::<Result<Vec<_>, _>>()?;
    if let Some(folder) = &args.export {
        let named = Goals::open_beside(&args.blueprint, folders.first().map(PathBuf::as_path))?;
        let goals = recorded(&named.ids, &first.about.blueprints, &first.about.trained, &first.about.catalog);
        first.about.catalog = named.catalog.clone();
        let n_files = tokio::select! {
            () = shutdown.cancelled() => return Err(Failure::NothingWritten(folder.clone())),
            n_files = dashboard::export(Finished { first, others, sweep }, &goals, folder) => n_files?,
        };
        terminal.print(&format!("wrote {n_files} files to {}; any web server can serve them", folder.display()));
        return Ok(());
    }
    let default = WebConfig::default();
    let listen = args.web.unwrap_or(default.listen);
    let web = WebConfig { listen, token: args.token.clone().map(Into::into), ..default };
    let web = Valid::new(web).map_err(|error| Failure::Usage(format!("{error} (here: --web and --token)")))?;
    let page = Page::bind(&web).await?;
    terminal.print(&format!("page at http://{}\nCtrl-C ends", page.address()));
    page.show(Finished { first, others, sweep }, shutdown).await?;
    Ok(())
}

/// The blueprints to record episodes of for a static copy: the named ones, those that the run was given, or one of each
/// group: the last that the run trained on, or else the first.
fn recorded(
    named: &[BlueprintId],
    given: &[BlueprintId],
    trained: &[BlueprintId],
    catalog: &Catalog,
) -> Vec<BlueprintId> {
    if let Some(chosen) = [named, given].into_iter().find(|ids| !ids.is_empty()) {
        return chosen.to_vec();
    }
    let mut chosen = BTreeMap::new();
    for blueprint in catalog.iter() {
        let Some(group) = Group::of(blueprint.split(), blueprint.n_blocks()) else { continue };
        if trained.contains(blueprint.id()) || !chosen.contains_key(&group) {
            chosen.insert(group, blueprint.id().clone());
        }
    }
    chosen.into_values().collect()
}

/// Loads a finished run, shown as `run`, from its files.
fn finished(folder: &Path, run: String, farewell: Farewell) -> Result<ShownRun, Failure> {
    let paths = RunPaths::new(folder);
    check_run(folder)?;
    let path = paths.config();
    let config = Config::parse(&read(&path)?, &path.display().to_string())?.checked()?;
    let history = paths.history();
    let evaluations = if history.exists() { History::read(&history)? } else { Vec::new() };
    let learner = updates(&paths)?;
    let model = match Source::read(folder) {
        Err(error @ Failure::Weights(_)) => return Err(error),
        read => read.inspect_err(|error| tracing::warn!(%error, "no policy plays for this run")).ok(),
    };
    let policy =
        model.as_ref().map_or_else(|| config.part(|config| &config.policy), |source| source.model.policy.clone());
    let weights = watch::channel(model.map(|source| Arc::new(source.model.weights))).1;
    // Without weights, a browser would wait for an episode forever.
    let can_play = weights.borrow().is_some();
    let environment = Config::evaluation_environment(&config);
    let stage = can_play.then(|| stage(environment, policy.clone(), weights.clone(), Some(paths.clone())));
    let catalog = Goals::open_beside(&[], Some(folder))?.catalog;
    let about = About { kind: Kind::Finished, run, ..services::about(&config, Some(&paths), &catalog, farewell) };
    Ok(ShownRun { about, evaluations, learner, run: Some(paths), policy, weights, stage })
}

/// The learner's lines of `metrics.jsonl`; empty if there is no such file. Logs how many lines cannot be parsed.
fn updates(paths: &RunPaths) -> Result<Vec<LearnerMetrics>, Failure> {
    let path = paths.metrics();
    let read = runlog::lines(paths, METRICS_LEARNER, |update: &LearnerMetrics| update.n_env_steps);
    let (found, n_unread) = read.with_context(|| format!("reading {}", path.display()))?;
    if n_unread > 0 {
        tracing::warn!(n_unread, path = %path.display(), "lines of the learner could not be read");
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_has_a_trained_blueprint_of_every_group_unless_some_are_named_or_were_given() {
        let ids = |ids: &[&str]| ids.iter().map(|id| id.parse().unwrap()).collect::<Vec<BlueprintId>>();
        let recorded = |named: &[&str], given: &[&str], trained: &[&str]| {
            recorded(&ids(named), &ids(given), &ids(trained), Catalog::builtin())
        };
        let [first, chosen] = [&[][..], &["2_000", "3_001"]].map(|trained| recorded(&[], &[], trained));
        assert!(first.len() >= 6 && first[0].as_str() == "2_000", "{first:?}");
        assert_eq!((chosen[0].as_str(), &chosen[1..]), ("3_001", &first[1..]));
        assert_eq!(recorded(&["16_002"], &["2_000"], &[]), ids(&["16_002"]));
        assert_eq!(recorded(&[], &["16_002"], &[]), ids(&["16_002"]), "those that the run was given");
    }
}

//! `eval --expert`: evaluates the scripted expert on blueprints.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use blueprints::{Catalog, Group};
use evaluator::{
    EpisodeConfig, EvalSetup, ExpertFailure, ExpertReport, Follower, Selection, evaluate_expert_followed, render_expert,
};
use proto::codec::encode_recording;
use proto::{Trajectory, Valid};
use serde::Serialize;
use tokio_util::sync::CancellationToken;

use super::goals::{Goals, tell_choices};
use crate::cli::EvalArgs;
use crate::config::{Base, Config, Override, merge};
use crate::exit::Failure;
use crate::limits;
use crate::live::{self, EpisodeCounter, Terminal};

/// What differs from the defaults: starts as in the table of results, and the seed of its figures.
const DEFAULTS: &str = "seed = 0\nevaluator.episodes.starts = \"mixed\"";

/// An entry of `failures.json`.
#[derive(Debug, Serialize)]
struct Explained<'a> {
    #[serde(flatten)]
    failure: &'a ExpertFailure,
    /// Name of the replay file in the same folder; it holds a `Trajectory` message of the bus.
    replay: Option<String>,
}

/// Output of `--json`.
#[derive(Debug, Serialize)]
struct Timed<'a> {
    #[serde(flatten)]
    report: &'a ExpertReport,
    /// Environment steps per second over all threads, including planning.
    steps_per_second: f64,
    n_threads: usize,
}

/// Runs the episodes and prints the report.
///
/// # Errors
/// When a blueprint is unknown, an episode cannot be started, or the explanation cannot be written; also when
/// `shutdown` came first, after the results so far have been printed and written.
pub(super) fn run(args: &EvalArgs, terminal: &Terminal, shutdown: &CancellationToken) -> Result<(), Failure> {
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    Override::only_in(&["environment", "evaluator", "seed"], &overrides)?;
    let config = defaults(&overrides)?;
    tell_choices(&args.blueprint, &terminal.on_stderr())?;
    let goals = Goals::open(&args.blueprint)?;
    let mut selection = Selection::default();
    if !args.split.is_empty() {
        selection.splits = args.split.clone();
    }
    let blueprints = goals.or_selected(&selection)?;
    for folder in args.explain.iter().chain(&args.record) {
        fs::create_dir(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    let n_threads = limits::n_threads(args.threads);
    let setup = EvalSetup {
        catalog: &goals.catalog,
        environment: Config::evaluation_environment(&config),
        episodes: EpisodeConfig { n_episodes: args.episodes, n_threads, ..config.evaluator.episodes.clone() },
        reset_free: args.reset_free.then(|| config.evaluator.reset_free.clone().unwrap_or_default()),
        // The expert plans for each world separately, so more than one world per thread gains nothing.
        n_worlds: 1,
        seed: config.seed,
    };
    let n_planned = u64::from(args.episodes) * blueprints.len() as u64;
    let episodes = EpisodeCounter::new(terminal.on_stderr(), n_planned);
    let start = Instant::now();
    let follower =
        Follower { keep_going: &|| !shutdown.is_cancelled(), on_episode: &|episode| episodes.count(episode) };
    let report = evaluate_expert_followed(&setup, &blueprints, &follower);
    let n_ended = episodes.finish();
    let report = report.map_err(anyhow::Error::from)?;
    let steps_per_second = report.n_steps as f64 / start.elapsed().as_secs_f64();
    if let Some(folder) = &args.explain {
        explain(folder, &report.failures)?;
    }
    if let Some(folder) = &args.record {
        record(folder, &goals.catalog, &report)?;
    }
    if args.json {
        let timed = Timed { report: &report, steps_per_second, n_threads };
        super::common::json(&timed, terminal)?;
    } else {
        terminal.print(render_expert(&report, live::detail(args.verbose)).trim_end());
        terminal.print(&format!("{steps_per_second:.0} steps/s on {n_threads} threads, planning included"));
    }
    if report.is_complete { Ok(()) } else { Err(Failure::Interrupted { n_ended, n_planned }) }
}

/// The default configuration with `overrides` applied.
fn defaults(overrides: &[Override]) -> Result<Valid<Config>, Failure> {
    let mut config = merge(DEFAULTS, "the defaults", Base::Defaults, overrides)?;
    // No policy acts here.
    config.policy.features.n_grippers = config.environment.n_grippers;
    Ok(config.checked()?)
}

/// Writes replays of the first success and the first failure of each group.
fn record(folder: &Path, catalog: &Catalog, report: &ExpertReport) -> anyhow::Result<()> {
    let successes = report.successes.iter().map(|replay| ("success", replay));
    let failures =
        report.failures.iter().filter_map(|failure| failure.replay.as_ref()).map(|replay| ("failure", replay));
    let mut known = BTreeSet::new();
    for (end, replay) in successes.chain(failures) {
        let id = &replay.task.blueprint;
        let group = catalog.get(id).and_then(|blueprint| Group::of(blueprint.split(), blueprint.n_blocks()));
        if known.insert((end, group)) {
            write_replay(folder, &format!("{id}-{end}.trajectory"), replay)?;
        }
    }
    Ok(())
}

fn write_replay(folder: &Path, name: &str, replay: &Trajectory) -> anyhow::Result<()> {
    let path = folder.join(name);
    fs::write(&path, encode_recording(replay)).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes one file per replay and the list of causes.
fn explain(folder: &Path, failures: &[ExpertFailure]) -> anyhow::Result<()> {
    let mut entries = Vec::with_capacity(failures.len());
    for failure in failures {
        let mut file = None;
        if let Some(replay) = &failure.replay {
            let name = format!("{}-{:03}.trajectory", failure.blueprint, failure.episode_idx);
            write_replay(folder, &name, replay)?;
            file = Some(name);
        }
        entries.push(Explained { failure, replay: file });
    }
    let path = folder.join("failures.json");
    fs::write(&path, serde_json::to_string_pretty(&entries)?)
        .with_context(|| format!("cannot write {}", path.display()))
}

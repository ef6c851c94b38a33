//! `eval`: evaluates a policy on blueprints.

use std::time::Instant;

use blueprints::Blueprint;
use evaluator::{EvalSetup, Follower, Selection, evaluate_followed, render};
use tokio_util::sync::CancellationToken;

use super::goals::Goals;
use super::models::Source;
use crate::cli::EvalArgs;
use crate::config::Override;
use crate::exit::Failure;
use crate::live::{self, EpisodeCounter, Terminal};

/// Runs the episodes and prints the report: after `shutdown` that of the episodes so far.
///
/// World, seed and, unless a split is asked for, the selection of blueprints are those of the run that the policy is from,
/// or the defaults.
///
/// # Errors
/// When the policy or the run's configuration cannot be read, or an episode cannot be started; also when
/// `shutdown` came first.
pub(super) fn run(args: &EvalArgs, terminal: &Terminal, shutdown: &CancellationToken) -> Result<(), Failure> {
    let source = Source::open(&args.model)?;
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    let config = source.config(&overrides)?;
    let of_split = |split| Selection { splits: vec![split], ..Selection::default() };
    let selection = args.split.map_or_else(|| config.evaluator.selection.clone(), of_split);
    let goals = Goals::open(&args.blueprint)?;
    let (catalog, named) = (goals.catalog(), goals.blueprints()?);
    let blueprints: Vec<&Blueprint> = if named.is_empty() {
        selection.select(catalog).map_err(|error| Failure::Usage(error.to_string()))?
    } else {
        named.iter().map(AsRef::as_ref).collect()
    };
    let mut episodes = config.evaluator.episodes.clone();
    episodes.n_episodes = args.episodes;
    let n_cores = || std::thread::available_parallelism().map_or(1, usize::from);
    episodes.n_threads = args.threads.map_or_else(n_cores, usize::from);
    let setup = EvalSetup {
        catalog,
        environment: config.environment,
        episodes,
        reset_free: args.reset_free.then(|| config.evaluator.reset_free.unwrap_or_default()),
        seed: config.seed,
    };
    let n_planned = setup.episodes.acting.len() * blueprints.len();
    let n_planned = n_planned as u64 * u64::from(setup.episodes.n_episodes);
    let (episodes, start) = (EpisodeCounter::new(terminal.on_stderr(), n_planned), Instant::now());
    let follower =
        Follower { keep_going: &|| !shutdown.is_cancelled(), on_episode: &|episode| episodes.count(episode) };
    let report = evaluate_followed(&setup, &config.policy, &source.model.weights, &blueprints, &follower);
    let n_ended = episodes.finish();
    let mut report = report.map_err(anyhow::Error::from)?;
    report.summary.elapsed_s = start.elapsed().as_secs_f64();
    if args.json {
        super::json(&report, terminal)?;
    } else {
        terminal.print(&render(&report, live::detail(args.verbose)));
    }
    if report.summary.is_complete { Ok(()) } else { Err(Failure::Interrupted { n_ended, n_planned }) }
}

//! `eval`: judges a policy on blueprints.

use blueprints::Catalog;
use evaluator::{Detail, EvalSetup, Selection, evaluate, render};

use super::models::Source;
use crate::cli::EvalArgs;
use crate::config::Override;
use crate::exit::Failure;
use crate::live::Terminal;

/// Runs the episodes and prints the report.
///
/// World, seed and, unless a split is asked for, the selection of blueprints are those of the run that the policy is from,
/// or the defaults.
///
/// # Errors
/// When the policy or the run's configuration cannot be read, or an episode cannot be started.
pub(super) fn run(args: &EvalArgs, terminal: &Terminal) -> Result<(), Failure> {
    let source = Source::open(&args.model)?;
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    let config = source.config(&overrides)?;
    let of_split = |split| Selection { splits: vec![split], ..Selection::default() };
    let selection = args.split.map_or_else(|| config.evaluator.selection.clone(), of_split);
    let catalog = Catalog::builtin();
    let blueprints = selection.select(catalog).map_err(|error| Failure::Usage(error.to_string()))?;
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
    // A signal ends the process: nothing is lost but the episodes so far.
    let report =
        evaluate(&setup, &config.policy, &source.model.weights, &blueprints, &|| true).map_err(anyhow::Error::from)?;
    if args.json {
        terminal.print(&serde_json::to_string_pretty(&report).map_err(anyhow::Error::from)?);
    } else {
        terminal.print(&render(&report, Detail::Blueprints));
    }
    Ok(())
}

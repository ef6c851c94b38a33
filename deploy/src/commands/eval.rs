//! `eval`: judges a checkpoint on blueprints.

use std::path::{Path, PathBuf};

use blueprints::Catalogue;
use evaluator::{Detail, EvalSetup, Selection, evaluate, render};
use learner::Checkpoint;
use learner::run::CHECKPOINTS;

use crate::cli::EvalArgs;
use crate::config::{Config, ConfigError, Override, merge};
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::CONFIG_FILE;

/// Runs the episodes and prints the report.
///
/// World, seed and, unless a split is asked for, the selection of blueprints are those of the run that the checkpoint is
/// from, or the defaults.
///
/// # Errors
/// When the checkpoint or the run's configuration cannot be read, or an episode cannot be started.
pub(super) fn run(args: &EvalArgs, terminal: &Terminal) -> Result<(), Failure> {
    let found = Checkpoint::read_latest(&checkpoint_folder(&args.checkpoint))
        .map_err(|error| Failure::Checkpoint(error.into()))?;
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    let config = run_config(&found.path, &overrides)?;
    tracing::info!(checkpoint = %found.path.display(), "evaluating");
    let of_split = |split| Selection { splits: vec![split], ..Selection::default() };
    let selection = args.split.map_or_else(|| config.evaluator.selection.clone(), of_split);
    let catalogue = Catalogue::builtin();
    let blueprints = selection.select(catalogue).map_err(|error| Failure::Usage(error.to_string()))?;
    let mut episodes = config.evaluator.episodes.clone();
    episodes.n_episodes = args.episodes;
    let setup = EvalSetup {
        catalogue,
        policy: found.checkpoint.model.clone(),
        environment: config.environment,
        episodes,
        reset_free: None,
        seed: config.seed,
    };
    // A signal ends the process: nothing is lost but the episodes so far.
    let report = evaluate(&setup, &found.checkpoint.weights(), &blueprints, &|| true).map_err(anyhow::Error::from)?;
    if args.json {
        terminal.print(&serde_json::to_string_pretty(&report).map_err(anyhow::Error::from)?);
    } else {
        terminal.print(&render(&report, Detail::Blueprints));
    }
    Ok(())
}

/// Where the checkpoints are of a run's folder, or of one checkpoint's.
pub(super) fn checkpoint_folder(given: &Path) -> PathBuf {
    let inside = given.join(CHECKPOINTS);
    if inside.is_dir() { inside } else { given.to_owned() }
}

/// The configuration in the nearest folder above the checkpoint that has one, with `overrides` put over it.
fn run_config(checkpoint: &Path, overrides: &[Override]) -> Result<Config, Failure> {
    let Some(path) =
        checkpoint.ancestors().skip(1).take(2).map(|folder| folder.join(CONFIG_FILE)).find(|path| path.exists())
    else {
        tracing::warn!("no {CONFIG_FILE} above the checkpoint: the world has its default settings");
        return valid("", "the defaults", overrides);
    };
    let text = std::fs::read_to_string(&path).map_err(|source| ConfigError::Read { path: path.clone(), source })?;
    valid(&text, &path.display().to_string(), overrides)
}

/// The configuration of a text with `overrides` put over it, if it is valid.
pub(super) fn valid(text: &str, origin: &str, overrides: &[Override]) -> Result<Config, Failure> {
    let config = merge(text, origin, overrides)?;
    config.validate()?;
    Ok(config)
}

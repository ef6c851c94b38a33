//! Loads policies: from checkpoints, from exported files, and the shipped one.

use std::path::Path;

use anyhow::Context as _;
use evaluator::Policy;
use learner::{Checkpoint, CheckpointError, Model, read_model};
use proto::Valid;

use super::best;
use super::files::write_file;
use crate::cli::ExportArgs;
use crate::config::{Config, DEFAULTS, Override, Preset, merge, read};
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::{check_exists, runs_in};
use crate::shell;
use runlog::RunPaths;
use runlog::paths::BEST_POLICY;

/// The shipped policy; `pretrained/README.md` describes how it was trained and what it can do.
const PRETRAINED: &[u8] = include_bytes!("../../pretrained/model.safetensors");

/// Its successes and episodes by action mode and number of blocks.
const PRETRAINED_SUCCESS: &str = include_str!("../../pretrained/success.json");

const PRETRAINED_PRESET: &str = "laptop";

/// A policy, and the text and origin of the configuration that it was trained with.
pub(super) struct Source {
    pub(super) model: Model,
    config: (String, String),
}

impl Source {
    /// Reads a policy like [`Self::read`], or returns the shipped one.
    pub(super) fn of(checkpoint: Option<&Path>) -> Result<Self, Failure> {
        checkpoint.map_or_else(Self::pretrained, Self::read)
    }

    /// Returns the policy that a training starts from: `pretrained`, or anything that [`Self::read`] accepts.
    pub(super) fn named(name: &Path) -> Result<Self, Failure> {
        if name == Path::new("pretrained") && !name.exists() { Self::pretrained() } else { Self::read(name) }
    }

    fn pretrained() -> Result<Self, Failure> {
        let model = Model::from_bytes(PRETRAINED).context("the program's own policy").map_err(Failure::Checkpoint)?;
        let preset = Preset::find(PRETRAINED_PRESET)?;
        let config = (preset.text.to_owned(), format!("preset {}", preset.name));
        Ok(Self { model, config })
    }

    /// Reads an exported file, a checkpoint, the best policy of a run or else its newest checkpoint, or the newest of a
    /// folder of checkpoints.
    pub(super) fn read(path: &Path) -> Result<Self, Failure> {
        let source = Self::read_untried(path)?;
        // Whoever waits for an action of such a policy would wait forever.
        Policy::with_weights(&source.model.policy, &source.model.weights)
            .map_err(|error| Failure::Weights(anyhow::Error::new(error).context(path.display().to_string())))?;
        Ok(source)
    }

    fn read_untried(path: &Path) -> Result<Self, Failure> {
        check_exists(path)?;
        let unusable = |error: CheckpointError| Failure::Checkpoint(error.into());
        // Anything but a folder, so that a device is refused for what it holds.
        if path.exists() && !path.is_dir() {
            let model = read_model(path).map_err(unusable)?;
            let is_snapshot = path.parent().is_some_and(|folder| folder.ends_with("snapshots"));
            let config = is_snapshot.then(|| run_config(path)).transpose()?;
            return Ok(Self { model, config: config.unwrap_or((String::new(), "the defaults".to_owned())) });
        }
        if let Some(best) = Self::best(path) {
            return best;
        }
        let inside = RunPaths::new(path).checkpoints();
        let folder = if inside.is_dir() { inside.as_path() } else { path };
        let found = Checkpoint::read_latest(folder).map_err(|error| match error {
            CheckpointError::Absent(_) => Failure::Checkpoint(anyhow::anyhow!("{error}{}", runs_in(path))),
            error => unusable(error),
        })?;
        tracing::info!(checkpoint = %found.path.display(), "read");
        Ok(Self { model: Model::from(&found.checkpoint), config: run_config(&found.path)? })
    }

    /// Reads the best policy of the run in `folder`, or the one in `folder` itself; `None` if there is none that can be
    /// read, so that the newest checkpoint takes its place.
    fn best(folder: &Path) -> Option<Result<Self, Failure>> {
        let of_run = RunPaths::new(folder).best();
        let itself = folder.join(BEST_POLICY);
        let path = if folder.ends_with("best") && itself.is_file() { itself } else { of_run.clone() };
        if !path.is_file() {
            return None;
        }
        let model = read_model(&path)
            .inspect_err(|error| tracing::warn!(%error, "the best policy is unusable, trying the newest checkpoint"));
        let model = model.ok()?;
        let n_steps = model.weights.n_env_steps;
        let why = best::verdict_of(&model).map_or_else(String::new, |verdict| format!(", which succeeds in {verdict}"));
        let newest = if path == of_run {
            format!("; for the newest: {}", shell::path(&RunPaths::new(folder).checkpoints()))
        } else {
            String::new()
        };
        tracing::info!("{}: the run's best policy, after {n_steps} environment steps{why}{newest}", path.display());
        let config = path.parent().map_or_else(|| Ok(Default::default()), run_config);
        Some(config.map(|config| Self { model, config }))
    }

    /// The configuration with `overrides` applied and the policy section of the model.
    pub(super) fn config(&self, overrides: &[Override]) -> Result<Valid<Config>, Failure> {
        let (text, origin) = &self.config;
        let config = merge(text, origin, &DEFAULTS, overrides)?;
        Ok(Config { policy: evaluator::PolicyConfig::clone(&self.model.policy), ..config }.checked()?)
    }
}

/// Returns successes and episodes of the shipped policy, for the page.
pub(super) fn pretrained_success() -> serde_json::Value {
    serde_json::from_str(PRETRAINED_SUCCESS).expect("a test reads it")
}

pub(super) fn export(args: &ExportArgs, terminal: &Terminal) -> Result<(), Failure> {
    let paths = &args.checkpoint;
    let models: Vec<Model> = paths.iter().map(|path| Ok(Source::read(path)?.model)).collect::<Result<_, Failure>>()?;
    let mut model = Model::mean(&models).map_err(|odd| {
        let reason = "their networks or the statistics of their observations differ, so they have no mean";
        Failure::Input(format!("{} and {}: {reason}", paths[0].display(), paths[odd].display()))
    })?;
    // Of this run, and nothing that acting needs.
    model.verdict = None;
    if args.out.exists() {
        return Err(Failure::Input(format!("{} is there already; choose another --out", args.out.display())));
    }
    let bytes = model.to_bytes().map_err(|error| Failure::Checkpoint(error.into()))?;
    let n_steps = model.weights.n_env_steps;
    args.out.file_name().ok_or_else(|| Failure::Usage("--out names no file".to_owned()))?;
    write_file(&args.out, &bytes)?;
    terminal.print(&format!(
        "{}: {} kB, after {n_steps} environment steps",
        args.out.display(),
        bytes.len().div_ceil(1000)
    ));
    Ok(())
}

/// The text and the name of the nearest `config.toml` up to two folders above the checkpoint, or the defaults.
fn run_config(checkpoint: &Path) -> Result<(String, String), Failure> {
    let Some(path) =
        checkpoint.ancestors().skip(1).take(2).map(|folder| RunPaths::new(folder).config()).find(|path| path.exists())
    else {
        tracing::warn!("no config.toml above the checkpoint: the world has its default settings");
        return Ok((String::new(), "the defaults".to_owned()));
    };
    Ok((read(&path)?, path.display().to_string()))
}

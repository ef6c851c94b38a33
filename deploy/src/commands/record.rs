//! `record`: records episodes, as a dataset for offline learning or as trajectories.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use blueprints::{Blueprint, Catalog};
use dataset::{About, DatasetError, DatasetId, Origin, Spaces, World, Writer};
use evaluator::{Callbacks, EpisodeConfig, EvalSetup, Performer, Recorded, record};
use parking_lot::Mutex;
use proto::ActionMode;
use proto::codec::encode_recording;
use tokio_util::sync::CancellationToken;

use super::goals::{Goals, find, is_path, tell_choices};
use super::models::Source;
use crate::cli::{PerformerArgs, RecordArgs, RecordFormat, StartArg};
use crate::config::{Config, Override};
use crate::exit::Failure;
use crate::limits;
use crate::live::{EpisodeCounter, Terminal};
use crate::shell;

/// Destination of the episodes.
enum Sink {
    Minari(Box<Writer>),
    /// A folder, and the number of files in it.
    Trajectories(PathBuf, u64),
}

/// State of the recording.
struct Recording<'k> {
    sink: Sink,
    catalog: &'k Catalog,
    n_diverged: u64,
    failure: Option<Failure>,
}

/// Runs the episodes and writes each when it ends. After `shutdown`, the episodes that have ended are kept.
///
/// # Errors
/// When the policy or the run's configuration cannot be read, the dataset already exists, a file cannot be written, or
/// `shutdown` came first.
pub(super) fn run(args: &RecordArgs, terminal: &Terminal, shutdown: &CancellationToken) -> Result<(), Failure> {
    let overrides: Vec<Override> = args.set.iter().map(|text| Override::parse(text)).collect::<Result<_, _>>()?;
    Override::only_in(&["environment", "policy"], &overrides)?;
    let PerformerArgs { checkpoint, expert, sampled, .. } = &args.performer;
    // The expert acts in the world of the shipped policy, and its episodes are recorded with that policy's features.
    let source = Source::of(checkpoint.as_deref())?;
    let config = source.config(&overrides)?;
    tell_choices(&args.goals.blueprint, terminal)?;
    let goals = Goals::open_beside(&args.goals.blueprint, checkpoint.as_deref())?;
    let selected = select(&goals, args)?;
    let blueprints: Vec<&Blueprint> = selected.iter().map(AsRef::as_ref).collect();
    let performer = if *expert { Performer::Expert } else { Performer::Policy(&config.policy, &source.model.weights) };
    let acting = if *sampled { ActionMode::Sampled } else { ActionMode::Greedy };
    let name = dataset_id(args)?;
    let sink = match args.format {
        RecordFormat::Minari => Sink::Minari(Box::new(begin(args, name, &config, &source, acting, &blueprints)?)),
        RecordFormat::Trajectory => Sink::Trajectories(new_folder(&args.out)?, 0),
    };
    let setup = EvalSetup {
        catalog: goals.catalog(),
        environment: config.evaluation_environment(),
        // One world per thread: in a batch of several, rounding makes actions depend on which worlds share the batch,
        // and that depends on timing.
        episodes: EpisodeConfig {
            n_episodes: args.episodes,
            starts: args.start.into(),
            n_threads: limits::n_threads(args.threads),
            n_worlds: 1,
            ..EpisodeConfig::default()
        },
        reset_free: None,
        seed: args.seed,
    };
    let n_planned = u64::from(args.episodes) * blueprints.len() as u64;
    let counter = EpisodeCounter::new(terminal.on_stderr(), n_planned);
    let stop = shutdown.child_token();
    let recording = Mutex::new(Recording { sink, catalog: goals.catalog(), n_diverged: 0, failure: None });
    let callbacks = Callbacks {
        keep_going: &|| !stop.is_cancelled(),
        on_episode: &|episode| {
            counter.count(&episode.result);
            if !recording.lock().keep(&episode) {
                stop.cancel();
            }
        },
    };
    let played = record(&setup, performer, acting, &blueprints, &callbacks);
    let n_ended = counter.finish();
    let recording = recording.into_inner();
    let said = recording.said(args);
    if let Some(failure) = recording.failure {
        return Err(failure);
    }
    let is_complete = played.map_err(anyhow::Error::from)?;
    terminal.print(&said);
    if is_complete { Ok(()) } else { Err(Failure::Interrupted { n_ended, n_planned }) }
}

/// The named blueprints, or those of the splits.
fn select<'g>(goals: &'g Goals, args: &RecordArgs) -> Result<Vec<Cow<'g, Blueprint>>, Failure> {
    if args.goals.split.is_empty() {
        return goals.blueprints();
    }
    let wanted = |blueprint: &&Blueprint| args.goals.split.contains(&blueprint.split());
    Ok(goals.catalog().iter().filter(wanted).map(Cow::Borrowed).collect())
}

/// A word for the acting policy or expert, for use in names.
fn actor(args: &PerformerArgs) -> String {
    match &args.checkpoint {
        _ if args.expert => "expert".to_owned(),
        None => "pretrained".to_owned(),
        Some(path) => path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
    }
}

/// The given name, or one derived from the acting policy or expert.
fn dataset_id(args: &RecordArgs) -> Result<DatasetId, Failure> {
    if let Some(name) = &args.name {
        return Ok(name.clone());
    }
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
    let actor: String = actor(&args.performer).chars().map(plain).collect();
    let sampled = if args.performer.sampled { "-sampled" } else { "" };
    let name = format!("lodestone/{actor}{sampled}-v0");
    name.parse::<DatasetId>().map_err(|error| Failure::Usage(format!("{error}; choose a --name")))
}

/// Creates the dataset.
fn begin(
    args: &RecordArgs,
    id: DatasetId,
    config: &Config,
    source: &Source,
    acting: ActionMode,
    blueprints: &[&Blueprint],
) -> Result<Writer, Failure> {
    let weights = &source.model.weights;
    let (version, n_env_steps) = if args.performer.expert { (0, 0) } else { (weights.version.0, weights.n_env_steps) };
    let origin = Origin {
        lodestone_version: env!("CARGO_PKG_VERSION"),
        weights_version: version,
        n_env_steps,
        acting: acting.name(),
        seed: args.seed,
    };
    let actor = actor(&args.performer);
    let goals = match blueprints {
        [one] => one.id().to_string(),
        several => format!("{} blueprints", several.len()),
    };
    let about = About {
        id,
        description: format!("{actor} of Lodestone assembles {goals}, {} episodes each.", args.episodes),
        algorithm: actor,
        code_permalink: args.code_permalink.clone(),
        origin,
    };
    let world = World {
        blueprint: blueprints.iter().map(|blueprint| known(blueprint)).collect(),
        starts: match args.start {
            StartArg::Scattered => [("scattered", 1.0)].into(),
            StartArg::Prebuilt => [("prebuilt", 1.0)].into(),
            StartArg::Mixed => [("scattered", 0.8), ("prebuilt", 0.2)].into(),
        },
        settings: &config.evaluation_environment(),
        features: &config.policy.features,
    };
    Ok(Writer::create(&args.out, about, Spaces::new(&config.policy.features), &world)?)
}

/// How the Python package identifies a blueprint: by its id, or by its text if it is not built in.
fn known(blueprint: &Blueprint) -> String {
    let own = Catalog::builtin().find(blueprint.id());
    if own.is_some_and(|own| *own == *blueprint) {
        blueprint.id().to_string()
    } else {
        blueprint.to_toml("a goal of recorded episodes")
    }
}

fn new_folder(folder: &Path) -> Result<PathBuf, Failure> {
    if folder.exists() {
        return Err(DatasetError::Exists(folder.to_owned()).into());
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    Ok(folder.to_owned())
}

impl Recording<'_> {
    /// Writes an episode, unless it diverged or an earlier write failed. Returns whether all writes have succeeded.
    fn keep(&mut self, episode: &Recorded) -> bool {
        if episode.is_diverged() {
            self.n_diverged += 1;
        } else if self.failure.is_none() {
            self.failure = self.write(episode).err();
            tracing::debug!(blueprint = %episode.result.blueprint, "an episode was kept");
        }
        self.failure.is_none()
    }

    fn write(&mut self, Recorded { trajectory, seed, .. }: &Recorded) -> Result<(), Failure> {
        let id = &trajectory.task.blueprint;
        match &mut self.sink {
            Sink::Minari(writer) => {
                let goal = find(self.catalog, id.as_str())?;
                writer.write(trajectory, &goal, *seed)?;
            }
            Sink::Trajectories(folder, n_files) => {
                let name = format!("{n_files:05}-{id}.trajectory");
                super::files::write_files(folder, &[(name, encode_recording(trajectory))])?;
                *n_files += 1;
            }
        }
        Ok(())
    }

    /// A summary of the recording and a command that reads it.
    fn said(&self, args: &RecordArgs) -> String {
        let left_out = match self.n_diverged {
            0 => String::new(),
            n => format!(", {n} more diverged and are left out"),
        };
        match &self.sink {
            Sink::Minari(writer) => format!(
                "{} episodes, {} steps, {:.1} MB{left_out}\nMINARI_DATASETS_PATH={} python -c 'import minari; \
                 print(minari.load_dataset(\"{}\"))'",
                writer.n_episodes(),
                writer.n_steps(),
                writer.n_bytes() as f64 / 1e6,
                shell::quoted(&args.out),
                writer.id(),
            ),
            Sink::Trajectories(folder, n_files) => {
                // `render` finds the user's own blueprints in the same files.
                let own = args.goals.blueprint.iter().filter(|name| is_path(name));
                let own: String = own.map(|path| format!(" --blueprint {}", shell::path(Path::new(path)))).collect();
                format!(
                    "{n_files} episodes{left_out}\nlodestone render {}/*.trajectory{own} --out films",
                    shell::path(folder)
                )
            }
        }
    }
}

//! The learner as a service: receives trajectories from the bus, runs updates on a separate thread, and publishes
//! weights and metrics.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use blueprints::outside;
use bus::{Bus, MetricsPublisher, NAME_PATIENCE, WeightsPublisher};
use proto::metrics::LearnerMetrics;
use proto::{Role, WeightsVersion, keys};
use runlog::{MetricsWriter, RunPaths};
use serde::Deserialize;
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use crate::checkpoint::{self, Checkpoint, Found};
use crate::source::Source;
use crate::train::{Output, Publication, Saving, Summary, Trainer};
use crate::{Learner, LearnerSetup};

/// Maximum size of `config.toml` in bytes.
const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// Options of a run.
pub struct RunOptions {
    /// The inputs of the learner.
    pub setup: LearnerSetup,
    /// Folder of the run, for `checkpoints/`, `metrics.jsonl` and `tb/`.
    pub run_dir: RunPaths,
    /// Where to resume: a run's folder, its `checkpoints`, or one checkpoint.
    pub resume: Option<PathBuf>,
    /// Environment steps after which the run ends; `None` runs until shutdown.
    pub max_env_steps: Option<u64>,
    /// The source of trajectories.
    pub source: Source,
    /// Gets the metrics of every update too.
    pub metrics_sender: watch::Sender<Option<LearnerMetrics>>,
    /// Time between attempts while nothing can be saved, for example on a full disk; see [`SAVE_RETRY`](crate::SAVE_RETRY).
    pub save_retry: Duration,
}

/// Trains until `shutdown` or the configured number of steps, then saves a checkpoint. Returns `None` if `shutdown` came
/// before it had begun, for example while it waited for another learner of the run to end.
///
/// # Errors
/// If the source fails, a setting is invalid, the checkpoint cannot be resumed, the session fails, the last checkpoint
/// cannot be written, or training has [diverged](crate::Diverged).
pub async fn run(options: RunOptions, bus: &Bus, shutdown: CancellationToken) -> anyhow::Result<Option<Summary>> {
    let folder = options.run_dir.folder();
    fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    // Wait before any cleanup, because another learner may be writing there.
    let declaring = bus.declare_alive_alone(Role::Learner, "learner", NAME_PATIENCE);
    let Some(alive) = shutdown.run_until_cancelled(declaring).await else { return Ok(None) };
    let _alive = alive?;
    let (setup, resume, checkpoints) = (options.setup.clone(), options.resume.clone(), options.run_dir.checkpoints());
    let learner = tokio::task::spawn_blocking(move || start(setup, resume.as_deref(), &checkpoints)).await??;

    let publisher = bus.weights_publisher().await?;
    let metrics = bus.metrics_publisher(keys::METRICS_LEARNER).await?;
    let (version, current_version) = watch::channel(learner.version());
    let mailbox = learner.mailbox();
    let server = bus.serve_trajectories(move |trajectory| mailbox.push(trajectory), current_version).await?;

    let (publications, mut arrivals) = mpsc::channel(2);
    let (result, ended) = oneshot::channel();
    let before_s = options.resume.as_deref().map_or(0.0, |resume| elapsed_before(resume, learner.n_env_steps()));
    let mut records = MetricsWriter::open(&options.run_dir, Role::Learner)?;
    records.resume(learner.n_env_steps())?;
    if let Ok(settings) = outside::read_text(&options.run_dir.config(), MAX_CONFIG_BYTES) {
        records.settings(&settings)?;
    }
    let RunOptions { run_dir, max_env_steps, source, metrics_sender, save_retry, .. } = options;
    let now = Instant::now();
    let output = Output {
        run_dir,
        records,
        saving: Saving::default(),
        save_retry,
        max_env_steps,
        publications,
        metrics_sender,
        server,
        bus: bus.clone(),
        shutdown,
        start: now,
        before_s,
        update_start: now,
        last_update: now,
        newest: Arc::new(learner.weights()),
    };
    let trainer = Trainer { learner, source, output };
    // Use a separate thread, because an update takes seconds and must not block tokio's workers.
    std::thread::Builder::new()
        .name("learner".to_owned())
        .spawn(move || result.send(trainer.run()))
        .context("starting the learner's thread")?;

    let published = publish_all(&mut arrivals, &publisher, &version, &metrics).await;
    // After an error, the closed channel ends the thread, which saves a checkpoint before.
    drop(arrivals);
    let report = ended.await.context("the learner's thread panicked")?;
    published?;
    report.map(Some)
}

/// Publishes what the learner's thread sends until it ends.
async fn publish_all(
    arrivals: &mut mpsc::Receiver<Publication>,
    publisher: &WeightsPublisher,
    version: &watch::Sender<WeightsVersion>,
    metrics: &MetricsPublisher,
) -> anyhow::Result<()> {
    while let Some(Publication { weights, metrics: numbers }) = arrivals.recv().await {
        let newest = weights.version;
        publisher.publish(weights).await?;
        version.send_replace(newest);
        if let Some(numbers) = numbers {
            metrics.put(&numbers).await?;
        }
    }
    Ok(())
}

/// Checks that a learner with this `setup` can start, or resume from `resume`: a run's folder, its `checkpoints`, or
/// one checkpoint.
///
/// # Errors
/// The errors that [`run`] returns before training: there is no valid checkpoint, its network or goals differ, or the
/// policy to start from does not fit.
pub fn check(setup: &LearnerSetup, resume: Option<&Path>) -> anyhow::Result<()> {
    match resume {
        Some(resume) => Learner::resume(setup.clone(), found(resume)?.checkpoint)?,
        None => Learner::new(setup.clone())?,
    };
    Ok(())
}

/// Reads the newest valid checkpoint of a run's folder, its `checkpoints`, or one checkpoint.
fn found(path: &Path) -> anyhow::Result<Found> {
    let inside = RunPaths::new(path).checkpoints();
    Checkpoint::read_latest(if inside.is_dir() { &inside } else { path })
        .with_context(|| format!("resuming from {}", path.display()))
}

/// Creates a learner, or resumes from the newest valid checkpoint of `resume`. Removes incomplete checkpoints of killed
/// processes from `checkpoints`.
fn start(setup: LearnerSetup, resume: Option<&Path>, checkpoints: &Path) -> anyhow::Result<Learner> {
    checkpoint::clean(checkpoints)?;
    let Some(path) = resume else { return Ok(Learner::new(setup)?) };
    let found = found(path)?;
    tracing::info!(path = %found.path.display(), n_passed_over = found.passed_over.len(), "resuming");
    Ok(Learner::resume(setup, found.checkpoint)?)
}

/// Returns how many seconds the run in a folder had taken by `n_env_steps` environment steps; 0 if unknown.
fn elapsed_before(run: &Path, n_env_steps: u64) -> f64 {
    #[derive(Deserialize)]
    struct Update {
        n_env_steps: u64,
        elapsed_s: f64,
        /// Older metrics have only `elapsed_s`.
        run_elapsed_s: Option<f64>,
    }
    let read = runlog::lines(&RunPaths::new(run), keys::METRICS_LEARNER, |update: &Update| update.n_env_steps);
    let (updates, _) = read.unwrap_or_else(|error| {
        tracing::debug!(%error, "how long the run took so far is not known");
        Default::default()
    });
    let last = updates.iter().rfind(|update| update.n_env_steps <= n_env_steps);
    last.map_or(0.0, |update| update.run_elapsed_s.unwrap_or(update.elapsed_s))
}

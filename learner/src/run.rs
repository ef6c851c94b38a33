//! The learner as a service: receives trajectories from the bus, runs updates on a separate thread, and publishes
//! weights and metrics.

mod saving;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use blueprints::outside::{self, as_text};
use bus::{Bus, Pulse, WeightsPublisher};
use proto::metrics::{BusCounts, IngestCounts};
use proto::metrics::{LearnerMetrics, METRICS_SCHEMA_VERSION};
use proto::{Role, Trajectory, Weights, WeightsVersion, keys};
use runlog::{MetricsWriter, RunPaths};
use serde::Serialize;
use serde_json::Value;
use tokio::sync::{mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

use self::saving::Saving;
use crate::checkpoint::{self, Checkpoint, Found};
use crate::{Learner, LearnerSetup, MailboxCounts, UpdateMetrics};

/// Time that a learner waits for another one to exit. A killed process appears alive for up to 6 s, and its replacement
/// must be able to start.
const NAME_TIMEOUT: Duration = Duration::from_secs(15);

/// Maximum size of `config.toml` in bytes.
const MAX_CONFIG_BYTES: u64 = 1 << 20;

/// Interval at which the updating thread checks for shutdown while it waits for trajectories.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Number of refused updates in a row that ends a run. A single one can come from an odd batch, which the next update
/// does not have. After three, the settings are at fault, and waiting would only cost time.
const MAX_REFUSED: u64 = 3;

/// Time between attempts of a run to save what it could not. Training waits so long.
pub const SAVE_RETRY: Duration = Duration::from_secs(30);

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
    /// The source of trajectories between updates, instead of the bus. Results then do not depend on time.
    pub feed: Option<Feed>,
    /// Gets the metrics of every update too.
    pub told: watch::Sender<Option<LearnerMetrics>>,
    /// Time between attempts while nothing can be saved, for example on a full disk; see [`SAVE_RETRY`].
    pub save_retry: Duration,
}

/// Why training stopped: update after update gave weights with which no policy can act.
#[derive(Debug, thiserror::Error)]
#[error(
    "training has diverged: {MAX_REFUSED} updates in a row gave no usable weights ({reason}); the last usable ones are \
     in {}", checkpoint.display()
)]
pub struct Diverged {
    /// Why the last update was refused.
    reason: String,
    /// The checkpoint with the last usable weights.
    checkpoint: PathBuf,
}

/// A function that steps worlds with the given weights and returns the finished trajectories; `true` requests new
/// episodes that depend only on the version.
pub type Feed = Box<dyn FnMut(&Weights, bool) -> anyhow::Result<Vec<Trajectory>> + Send>;

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Version of the newest weights.
    pub weights_version: WeightsVersion,
    /// Updates, including those before a resume.
    pub n_updates: u64,
    /// Environment steps, including those before a resume.
    pub n_env_steps: u64,
    /// Elapsed seconds, including those before a resume.
    pub run_elapsed_s: f64,
    /// Number of trajectories by result.
    pub mailbox: MailboxCounts,
    /// The last checkpoint.
    #[serde(serialize_with = "as_text")]
    pub checkpoint: PathBuf,
    /// The newest weights themselves, for an evaluator in this process.
    #[serde(skip)]
    pub weights: Arc<Weights>,
}

/// A message from the updating thread to the bus.
struct Publication {
    weights: Arc<Weights>,
    /// `None` for the initial weights of the run.
    metrics: Option<LearnerMetrics>,
}

/// Trains until `shutdown` or the configured number of steps, then saves a checkpoint. Returns `None` if `shutdown` came
/// before it had begun, for example while it waited for another learner of the run to end.
///
/// With a `feed`, the updating thread requests trajectories between updates, and results do not depend on time: equal
/// seeds produce equal weights, even after resuming from one of the periodic checkpoints.
///
/// # Errors
/// If the feed fails, a setting is invalid, the checkpoint cannot be resumed, the session fails, the last checkpoint
/// cannot be written, or training has [`Diverged`].
pub async fn run(options: RunOptions, bus: &Bus, shutdown: CancellationToken) -> anyhow::Result<Option<Summary>> {
    let folder = options.run_dir.folder();
    fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    // Wait before any cleanup, because another learner may be writing there.
    let _alive = tokio::select! {
        alive = bus.declare_alive_alone(Role::Learner, "learner", NAME_TIMEOUT) => alive?,
        () = shutdown.cancelled() => return Ok(None),
    };
    let (setup, resume, checkpoints) = (options.setup.clone(), options.resume.clone(), options.run_dir.checkpoints());
    let learner = tokio::task::spawn_blocking(move || start(setup, resume.as_deref(), &checkpoints)).await??;

    let publisher = bus.weights_publisher().await?;
    let metrics = bus.metrics_publisher(keys::METRICS_LEARNER).await?;
    let (version, current_version) = watch::channel(learner.version());
    let mailbox = learner.mailbox();
    let server = Arc::new(bus.serve_trajectories(move |trajectory| mailbox.push(trajectory), current_version).await?);

    let (publications, mut arrivals) = mpsc::channel(2);
    let (result, ended) = oneshot::channel();
    let (counted, session) = (server.clone(), bus.clone());
    let before_s = options.resume.as_deref().map_or(0.0, |resume| elapsed_before(resume, learner.n_env_steps()));
    let mut records = MetricsWriter::open(&options.run_dir, Role::Learner)?;
    records.resume(learner.n_env_steps())?;
    if let Ok(settings) = outside::read_text(&options.run_dir.config(), MAX_CONFIG_BYTES) {
        records.settings(&settings)?;
    }
    let worker = Worker {
        newest: Arc::new(learner.weights()),
        learner,
        records,
        saving: Saving::default(),
        options,
        counts: Box::new(move || (counted.counts(), session.counts())),
        publications,
        shutdown,
        pulse: bus.pulse().clone(),
        start: Instant::now(),
        before_s,
    };
    // Use a separate thread, because an update takes seconds and must not block tokio's workers.
    std::thread::Builder::new()
        .name("learner".to_owned())
        .spawn(move || result.send(worker.work()))
        .context("starting the learner's thread")?;

    let published = async {
        while let Some(Publication { weights, metrics: numbers }) = arrivals.recv().await {
            publish(&publisher, &version, weights).await?;
            if let Some(numbers) = numbers {
                metrics.put(&numbers).await?;
            }
        }
        anyhow::Ok(())
    }
    .await;
    // After an error, the closed channel ends the thread, which saves a checkpoint before.
    drop(arrivals);
    let report = ended.await.context("the learner's thread panicked")?;
    published?;
    if let Some(server) = Arc::into_inner(server) {
        server.close().await?;
    }
    report.map(Some)
}

async fn publish(
    publisher: &WeightsPublisher,
    version: &watch::Sender<WeightsVersion>,
    weights: Arc<Weights>,
) -> anyhow::Result<()> {
    let newest = weights.version;
    publisher.publish(weights).await?;
    version.send_replace(newest);
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
    let until_then = |line: &Value| line["n_env_steps"].as_u64().is_some_and(|steps| steps <= n_env_steps);
    let last = match runlog::last_line(&RunPaths::new(run), keys::METRICS_LEARNER, until_then) {
        Ok(last) => last,
        Err(error) => {
            tracing::debug!(%error, "how long the run took so far is not known");
            None
        }
    };
    // Older metrics have only `elapsed_s`.
    let seconds = |key: &str| last.as_ref().and_then(|line| line[key].as_f64());
    seconds("run_elapsed_s").or_else(|| seconds("elapsed_s")).unwrap_or_default()
}

/// The state of the updating thread.
struct Worker {
    learner: Learner,
    /// The learner's newest weights.
    newest: Arc<Weights>,
    options: RunOptions,
    records: MetricsWriter,
    saving: Saving,
    counts: Box<dyn Fn() -> (IngestCounts, BusCounts) + Send>,
    publications: mpsc::Sender<Publication>,
    shutdown: CancellationToken,
    pulse: Pulse,
    start: Instant,
    /// Seconds that the run took before this process.
    before_s: f64,
}

impl Worker {
    fn work(mut self) -> anyhow::Result<Summary> {
        let settings = self.options.setup.config.clone();
        let mailbox = self.learner.mailbox();
        let mut last_report = Instant::now();
        let mut restart = true;
        let mut fed = Ok(());
        let mut n_refused = 0;
        let mut diverged = None;
        self.send(None);
        // A closed channel means that the session failed; the run then ends with a checkpoint as usual.
        while !self.publications.is_closed() && !self.is_over() {
            self.pulse.beat();
            let n_left = self.options.max_env_steps.map(|max| max.saturating_sub(self.learner.n_env_steps()));
            let n_steps = next_steps(settings.steps_per_update, n_left);
            let enough = match &mut self.options.feed {
                None => mailbox.wait(n_steps, POLL_INTERVAL),
                Some(_) if mailbox.n_steps() >= n_steps => true,
                Some(feed) => match feed(&self.newest, std::mem::take(&mut restart)) {
                    Ok(trajectories) => {
                        for trajectory in trajectories {
                            // The mailbox counts refusals.
                            let _ = self.learner.ingest(trajectory);
                        }
                        false
                    }
                    Err(error) => {
                        fed = Err(error);
                        break;
                    }
                },
            };
            if !enough {
                continue;
            }
            let began = Instant::now();
            let Some(update) = self.learner.update_on(n_steps) else { continue };
            let pace = Pace { update: began.elapsed(), since_last: last_report.elapsed() };
            last_report = Instant::now();
            self.newest = Arc::new(self.learner.weights());
            let metrics = self.report(&update, &pace);
            self.send(Some(metrics.clone()));
            n_refused = if update.refused.is_some() { n_refused + 1 } else { 0 };
            if let Some(reason) = update.refused {
                tracing::warn!(reason, "an update was taken back");
                if n_refused == MAX_REFUSED {
                    self.keep(metrics, false)?;
                    diverged = Some(reason);
                    break;
                }
            }
            let is_due = self.learner.n_updates().is_multiple_of(settings.checkpoints.every_updates);
            restart |= is_due;
            self.keep(metrics, is_due)?;
        }
        // Trajectories acknowledged after the checkpoint would be lost.
        mailbox.close();
        let checkpoint = self.keep_last()?;
        fed?;
        if let Some(reason) = diverged {
            return Err(Diverged { reason, checkpoint }.into());
        }
        let weights_version = self.learner.version();
        Ok(Summary {
            weights_version,
            n_updates: self.learner.n_updates(),
            n_env_steps: self.learner.n_env_steps(),
            run_elapsed_s: self.run_elapsed_s(),
            mailbox: mailbox.counts(),
            checkpoint,
            weights: Arc::new(self.learner.weights()),
        })
    }

    fn run_elapsed_s(&self) -> f64 {
        self.before_s + self.start.elapsed().as_secs_f64()
    }

    fn is_over(&self) -> bool {
        let reached = self.options.max_env_steps.is_some_and(|max| self.learner.n_env_steps() >= max);
        reached || self.shutdown.is_cancelled()
    }

    /// Shows the metrics in this process, and hands them and the newest weights to the bus, unless the session failed.
    fn send(&self, metrics: Option<LearnerMetrics>) {
        if let Some(metrics) = &metrics {
            self.options.told.send_replace(Some(metrics.clone()));
        }
        let publication = Publication { weights: self.newest.clone(), metrics };
        if self.publications.blocking_send(publication).is_err() {
            tracing::debug!("the weights were not published, because the session failed");
        }
    }

    fn report(&self, update: &UpdateMetrics, pace: &Pace) -> LearnerMetrics {
        let (ingest, bus) = (self.counts)();
        LearnerMetrics {
            schema_version: METRICS_SCHEMA_VERSION,
            weights_version: update.weights_version,
            n_updates: update.n_updates,
            n_env_steps: update.n_env_steps,
            n_update_steps: update.n_steps,
            n_episodes: update.n_episodes,
            elapsed_s: self.start.elapsed().as_secs_f64(),
            run_elapsed_s: self.run_elapsed_s(),
            env_steps_per_s: update.n_steps as f64 / pace.since_last.as_secs_f64().max(1e-9),
            update_s: pace.update.as_secs_f64(),
            policy_lag_mean: update.policy_lag_mean,
            policy_lag_max: update.policy_lag_max,
            policy_lag_histogram: update.policy_lag_histogram.clone(),
            n_mailbox: update.n_mailbox,
            expired_total: update.mailbox.expired_total,
            unmade_total: update.unmade_total,
            refused_total: update.refused_total,
            ppo: update.ppo,
            proposals: update.proposals.clone(),
            episodes: update.episodes.clone(),
            ingest,
            bus,
            task_probabilities: update.task_probabilities.clone(),
            reverse_reach: update.reverse_reach.clone(),
            not_saved: None,
        }
    }
}

/// Returns how many steps the next update takes if `n_left` are left of the run: `per_update`, but the last two updates
/// share what is left. So a run ends with the step that was asked for, give or take the rest of a segment, and not with
/// an update of a handful of steps.
fn next_steps(per_update: usize, n_left: Option<u64>) -> usize {
    match n_left.and_then(|n| usize::try_from(n).ok()) {
        Some(n) if n <= per_update => n.max(1),
        Some(n) if n < 2 * per_update => n.div_ceil(2),
        _ => per_update,
    }
}

/// Durations of an update.
struct Pace {
    update: Duration,
    since_last: Duration,
}

#[cfg(test)]
mod tests {
    use super::next_steps;

    #[test]
    fn the_last_two_updates_share_what_is_left() {
        assert_eq!(next_steps(2048, None), 2048);
        for (n_left, expected) in [(10_000, 2048), (4096, 2048), (4095, 2048), (2500, 1250), (2048, 2048), (1250, 1250)]
        {
            assert_eq!(next_steps(2048, Some(n_left)), expected, "{n_left}");
        }
        assert_eq!((next_steps(2048, Some(1)), next_steps(1, Some(1))), (1, 1));
    }
}

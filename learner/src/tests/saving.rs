//! A learner whose disk takes nothing waits, and goes on.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use bus::{Bus, MetricsSubscriber};
use proto::keys;
use proto::metrics::LearnerMetrics;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use runlog::RunPaths;
use tokio_util::sync::CancellationToken;

use super::learning::{bandit, small_setup};
use super::service::{Learning, options, place, start};
use crate::{CheckpointError, RunOptions, Source};

/// Time between attempts to save, where they should succeed at once.
const SOON: Duration = Duration::from_millis(1);

/// A learner that runs on worlds of its own.
struct Running {
    _dir: tempfile::TempDir,
    bus: Bus,
    paths: RunPaths,
    metrics: MetricsSubscriber,
    /// Times that trajectories were made.
    n_fed: Arc<AtomicU64>,
    shutdown: CancellationToken,
    learning: Learning,
}

impl Running {
    /// Starts it. `spoil` is called after the files are open and before the first step.
    async fn start(save_retry: Duration, every_updates: u64, max_env_steps: u64, spoil: fn(&RunPaths)) -> Self {
        let (dir, bus, paths) = place().await;
        let metrics = bus.metrics_subscriber(keys::METRICS_LEARNER).await.unwrap();
        let setup = small_setup(8).with(|c| c.checkpoints.every_updates = every_updates);
        let n_fed = Arc::new(AtomicU64::new(0));
        let feed = {
            let (setup, paths, n_fed) = (setup.clone(), paths.clone(), n_fed.clone());
            move |weights: &proto::Weights, _| {
                if n_fed.fetch_add(1, Ordering::SeqCst) == 0 {
                    spoil(&paths);
                }
                Ok(bandit(&setup, weights, 256, &mut ChaCha8Rng::seed_from_u64(weights.version.0)))
            }
        };
        let options = RunOptions {
            max_env_steps: Some(max_env_steps),
            source: Source::Made(Box::new(feed)),
            save_retry,
            ..options(setup, &paths)
        };
        let (shutdown, learning) = start(options, &bus);
        Self { _dir: dir, bus, paths, metrics, n_fed, shutdown, learning }
    }

    /// Returns the updates of the next metrics, and why they are not saved.
    async fn news(&mut self) -> (u64, Option<String>) {
        let sample = self.metrics.recv().await.unwrap();
        let metrics: LearnerMetrics = serde_json::from_value(sample.value).unwrap();
        (metrics.n_updates, metrics.not_saved.map(|not_saved| not_saved.reason))
    }

    fn n_fed(&self) -> u64 {
        self.n_fed.load(Ordering::SeqCst)
    }
}

/// A folder in the place of the file makes writing fail, as a full disk would.
fn no_metrics(paths: &RunPaths) {
    fs::remove_file(paths.metrics()).unwrap();
    fs::create_dir(paths.metrics()).unwrap();
}

/// A file in the place of a folder, likewise.
fn no_checkpoint(paths: &RunPaths) {
    fs::create_dir_all(paths.checkpoints()).unwrap();
    fs::write(paths.checkpoints().join(".new-256"), "in the way").unwrap();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_learned_while_nothing_can_be_saved() {
    let spoil = |paths: &RunPaths| {
        no_metrics(paths);
        no_checkpoint(paths);
    };
    let mut running = Running::start(SOON, 1, 512, spoil).await;
    assert_eq!(running.news().await, (1, None));
    let (n_updates, reason) = running.news().await;
    assert!(n_updates == 1 && reason.as_ref().unwrap().contains("metrics.jsonl"), "{reason:?}");
    let not_saved = running.bus.pulse().not_saved().unwrap();
    assert_eq!((Some(not_saved.reason), running.bus.pulse().age().is_zero()), (reason, true));
    assert_eq!(running.n_fed(), 1);

    // The next attempt saves what it can.
    let metrics = running.paths.metrics();
    fs::remove_dir(&metrics).unwrap();
    let (n_updates, reason) = running.news().await;
    assert!(n_updates == 1 && reason.as_ref().unwrap().contains(".new-256"), "{reason:?}");
    let lines = |path: &Path| fs::read_to_string(path).unwrap().lines().count();
    assert_eq!((running.n_fed(), lines(&metrics)), (1, 1));

    fs::remove_file(running.paths.checkpoints().join(".new-256")).unwrap();
    assert_eq!([running.news().await, running.news().await], [(1, None), (2, None)]);
    let summary = running.learning.await.unwrap().unwrap().unwrap();
    assert_eq!((summary.n_updates, lines(&metrics)), (2, 2));
    assert_eq!(running.bus.pulse().not_saved(), None);
    assert!(running.paths.checkpoints().join("step-256").is_dir());
    running.bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_last_checkpoint_waits_for_its_disk_too() {
    let mut running = Running::start(SOON, 50, 256, no_checkpoint).await;
    assert_eq!(running.news().await, (1, None));
    let (n_updates, reason) = running.news().await;
    assert!(n_updates == 1 && reason.as_ref().unwrap().contains(".new-256"), "{reason:?}");
    fs::remove_file(running.paths.checkpoints().join(".new-256")).unwrap();
    assert_eq!(running.news().await, (1, None));
    let summary = running.learning.await.unwrap().unwrap().unwrap();
    assert!(summary.checkpoint.ends_with("checkpoints/step-256"));
    running.bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_being_told_ends_a_learner_that_cannot_save() {
    let mut running = Running::start(Duration::from_secs(3600), 1, 512, no_checkpoint).await;
    assert_eq!(running.news().await, (1, None));
    assert!(running.news().await.1.is_some());
    running.shutdown.cancel();
    let error = running.learning.await.unwrap().unwrap_err();
    assert!(error.chain().any(|cause| cause.is::<CheckpointError>()), "{error:#}");
    assert_eq!(running.n_fed.load(Ordering::SeqCst), 1);
    running.bus.close().await;
}

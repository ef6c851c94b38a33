//! The learner service on an isolated bus.

use bus::{Bus, SendError};
use proto::metrics::LearnerMetrics;
use proto::{ActorId, Refusal, Weights};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::learning::{bandit, small_setup};
use crate::{Checkpoint, CheckpointError, Diverged, LearnerSetup, RunOptions, SAVE_RETRY, Source, Summary, run};
use runlog::RunPaths;

/// Returns a bus and the paths of a run in a temporary folder.
pub(super) async fn place() -> (tempfile::TempDir, Bus, RunPaths) {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let run_dir = RunPaths::new(dir.path().join("run"));
    (dir, bus, run_dir)
}

/// Sends enough trajectories for one update with each of the next `n_updates` weights.
async fn act(bus: &Bus, setup: &LearnerSetup, n_updates: u64) -> Weights {
    let actor = ActorId::try_from("fixture".to_owned()).unwrap();
    let sender = bus.trajectory_sender(&actor).await.unwrap();
    sender.wait_for_learner().await;
    let subscriber = bus.weights_subscriber().await.unwrap();
    let mut watch = subscriber.watch();
    let first = watch.wait_for(Option::is_some).await.unwrap().clone().unwrap();
    let mut newest = first.clone();
    for round in 1..=n_updates {
        let mut rng = ChaCha8Rng::seed_from_u64(round);
        for (seq, mut trajectory) in (256 * round..).zip(bandit(setup, &newest, 256, &mut rng)) {
            trajectory.seq = seq;
            sender.send(&trajectory).await.unwrap();
        }
        let next = first.version.0 + round;
        let seen = watch.wait_for(|w| w.as_ref().is_some_and(|w| w.version.0 >= next)).await.unwrap();
        newest = seen.clone().unwrap();
    }
    let mut unknown = bandit(setup, &newest, 1, &mut ChaCha8Rng::seed_from_u64(0)).remove(0);
    unknown.seq = 256 * (n_updates + 1);
    unknown.task.blueprint = "16_404".parse().unwrap();
    let refused = sender.send(&unknown).await.unwrap_err();
    assert!(matches!(refused, SendError::Refused(Refusal::Invalid(_))), "{refused}");
    (*newest).clone()
}

/// Returns a source that makes `n` episodes of one step at a time.
fn episodes(setup: &LearnerSetup, n: usize, seed: u64) -> Source {
    let (setup, mut rng) = (setup.clone(), ChaCha8Rng::seed_from_u64(seed));
    Source::Made(Box::new(move |weights, _| Ok(bandit(&setup, weights, n, &mut rng))))
}

/// Returns the options of a new run without end in `dir`.
pub(super) fn options(setup: LearnerSetup, dir: &RunPaths) -> RunOptions {
    let metrics_sender = watch::channel(None).0;
    RunOptions {
        setup,
        run_dir: dir.clone(),
        resume: None,
        max_env_steps: None,
        source: Source::Arrivals,
        metrics_sender,
        save_retry: SAVE_RETRY,
    }
}

pub(super) type Learning = JoinHandle<anyhow::Result<Option<Summary>>>;

/// Starts a learner; returns the token that ends it, too.
pub(super) fn start(options: RunOptions, bus: &Bus) -> (CancellationToken, Learning) {
    let shutdown = CancellationToken::new();
    let (bus, its_shutdown) = (bus.clone(), shutdown.clone());
    (shutdown, tokio::spawn(async move { run(options, &bus, its_shutdown).await }))
}

/// Runs a learner in `dir` until an actor has received `n_updates` updates.
async fn session(dir: &RunPaths, bus: &Bus, resume: bool, n_updates: u64) -> (Summary, Weights) {
    let setup = small_setup(5);
    let resume = resume.then(|| dir.folder().to_owned());
    let (shutdown, learning) = start(RunOptions { resume, ..options(setup.clone(), dir) }, bus);
    let weights = act(bus, &setup, n_updates).await;
    shutdown.cancel();
    (learning.await.unwrap().unwrap().unwrap(), weights)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run_learns_reports_saves_and_resumes() {
    let (_dir, bus, run_dir) = place().await;
    let (report, weights) = session(&run_dir, &bus, false, 2).await;
    assert_eq!((report.n_updates, report.n_env_steps, report.weights_version), (2, 512, weights.version));
    assert_eq!((report.mailbox.accepted_total, report.mailbox.invalid_total), (512, 1));
    let found = Checkpoint::read_latest(&run_dir.checkpoints()).unwrap();
    assert_eq!(found.checkpoint.weights(), weights);

    let (report, weights) = session(&run_dir, &bus, true, 1).await;
    assert_eq!((report.n_updates, report.n_env_steps, weights.version.0), (3, 768, 3));
    let lines = std::fs::read_to_string(run_dir.metrics()).unwrap();
    let lines: Vec<LearnerMetrics> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.iter().map(|m| m.n_updates).collect::<Vec<_>>(), [1, 2, 3]);
    assert_eq!(lines[1].episodes.success.n_episodes, 256);
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn failed_final_save_names_lost_and_newest_checkpoints() {
    let (_dir, bus, run_dir) = place().await;
    session(&run_dir, &bus, false, 1).await;
    let checkpoints = run_dir.checkpoints();
    // The next start removes the partial checkpoint of a killed process.
    std::fs::create_dir(checkpoints.join(".new-512")).unwrap();
    let setup = small_setup(5);
    let resume = Some(run_dir.folder().to_owned());
    let (shutdown, learning) = start(RunOptions { resume, ..options(setup.clone(), &run_dir) }, &bus);
    act(&bus, &setup, 1).await;
    assert!(!checkpoints.join(".new-512").exists());
    // A file at that path makes the write fail, as a full disk would.
    std::fs::write(checkpoints.join(".new-512"), b"in the way").unwrap();
    shutdown.cancel();
    let error = learning.await.unwrap().unwrap_err();
    assert!(error.chain().any(|cause| cause.is::<CheckpointError>()), "the exit code follows from it");
    let lost = "the last checkpoint, of 512 environment steps and weights 2, is lost; the newest whole one is";
    let message = format!("{error:#}");
    assert!(message.starts_with(lost) && message.contains("step-256: removing "), "{message}");
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn run_takes_as_many_steps_as_were_asked_for_and_no_whole_update_more() {
    let setup = small_setup(6);
    assert_eq!(setup.config.batch_size, 256);
    for (max_env_steps, n_updates) in [(0, 0), (300, 2)] {
        let (_dir, bus, run_dir) = place().await;
        let source = episodes(&setup, 10, 6);
        let options = RunOptions { max_env_steps: Some(max_env_steps), source, ..options(setup.clone(), &run_dir) };
        let report = run(options, &bus, CancellationToken::new()).await.unwrap().unwrap();
        assert_eq!((report.n_updates, report.n_env_steps), (n_updates, max_env_steps));
        assert!(report.checkpoint.ends_with(format!("checkpoints/step-{max_env_steps}")));
        bus.close().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_learner_that_waits_for_another_one_ends_when_told() {
    let (_dir, bus, run_dir) = place().await;
    let _other = bus.declare_alive(proto::Role::Learner, "learner").await.unwrap();
    let options = options(small_setup(7), &run_dir);
    let shutdown = CancellationToken::new();
    shutdown.cancel();
    assert_eq!(run(options, &bus, shutdown).await.unwrap(), None);
    assert!(!run_dir.checkpoints().exists());
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn training_that_diverges_stops_and_keeps_usable_weights() {
    let (_dir, bus, run_dir) = place().await;
    let setup = small_setup(5).at_rate(1e5).with(|c| c.checkpoints.every_updates = 1);
    let options = RunOptions { source: episodes(&setup, 256, 1), ..options(setup.clone(), &run_dir) };
    let error = run(options, &bus, CancellationToken::new()).await.unwrap_err();
    assert!(error.is::<Diverged>(), "{error:#}");
    let found = Checkpoint::read_latest(&run_dir.checkpoints()).unwrap();
    let message = error.to_string();
    assert!(message.starts_with("training has diverged: 3 updates in a row gave no usable weights ("), "{message}");
    assert!(message.ends_with(&format!("the last usable ones are in {}", found.path.display())), "{message}");
    assert_eq!((found.checkpoint.state.n_updates, found.checkpoint.state.version.0), (3, 0));
    assert!(policy::Policy::with_weights(&setup.policy, &found.checkpoint.weights()).is_ok());
    bus.close().await;
}

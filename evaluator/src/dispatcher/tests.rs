//! Remote workers on an isolated bus do all the work of an evaluation.

use blueprints::{Blueprint, Catalog, Split};
use bus::UnitServer;
use proto::Start;
use tokio_util::sync::CancellationToken;

use super::*;
use crate::config::{EpisodeConfig, EvaluatorConfig};
use crate::episodes::tests::{agent, small_policy, small_setup, weights};
use crate::films::EpisodeSelector;
use crate::pool::EvaluationPool;
use crate::setup::EvaluatorSetup;
use crate::worker::run_worker;

fn setup(id: &str, episode_steps: u16) -> EvaluatorSetup {
    let small = small_setup(EpisodeConfig::default());
    EvaluatorSetup {
        config: EvaluatorConfig::default(),
        policy: small_policy(),
        environment: environment::EnvironmentConfig { episode_steps, ..small.environment },
        id: id.to_owned(),
        seed: 3,
        records: None,
        catalog: Catalog::builtin(),
    }
}

fn sequences() -> Vec<Vec<EpisodeSpec>> {
    let goals: Vec<&Blueprint> = Catalog::builtin().of_split(Split::Train);
    let sequence = |(goal, idx): (&&Blueprint, u64)| {
        vec![EpisodeSpec::new(goal, Start::Scattered, 3, idx), EpisodeSpec::new(goal, Start::AsItIs, 3, idx + 1)]
    };
    goals[..12].iter().zip(0..).map(sequence).collect()
}

async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(120), future).await.expect("it takes a moment only")
}

/// Waits until remote workers have returned all sequences.
async fn brought(queue: &Arc<WorkQueue>) -> Vec<Vec<EpisodeResult>> {
    let queue = queue.clone();
    let waiting = tokio::task::spawn_blocking(move || {
        let start = std::time::Instant::now();
        while !queue.is_done() && start.elapsed() < Duration::from_secs(100) {
            queue.wait_until_done(Duration::from_secs(1));
        }
        queue.clear()
    });
    within(waiting).await.unwrap()
}

#[test]
fn workers_must_act_as_the_evaluator_does() {
    let judge = setup("judge", 8);
    assert_eq!(judge.settings(), setup("worker", 8).settings());
    let mut masked = judge.clone();
    masked.policy.mask = policy::BlockMask::Blueprint;
    let mut gripping = judge.clone();
    gripping.policy.grip_steps += 1;
    for (other, key) in
        [(masked, "policy.mask"), (gripping, "policy.grip_steps"), (setup("judge", 9), "environment.episode_steps")]
    {
        assert_eq!(other.settings().difference(&judge.settings()).unwrap().key, key);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_refused_is_asked_again_in_the_next_evaluation() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let mut units: UnitServer = bus.serve_units("moody").await.unwrap();
    let _token = bus.declare_alive(Role::Worker, "moody").await.unwrap();
    let mut workers = Dispatcher::start(&bus, setup("judge", 8).settings(), UNIT_PATIENCE).await.unwrap();
    for _ in 0..2 {
        let queue = Arc::new(WorkQueue::default());
        queue.post(&sequences(), ActionMode::Greedy);
        workers.open(queue, Arc::new(weights()));
        let call = within(units.recv()).await.unwrap();
        call.answer(EvalAnswer::Refused("not these weights".to_owned())).await;
        workers.close();
    }
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_worker_that_is_too_late_gets_less_and_then_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let mut units: UnitServer = bus.serve_units("slow").await.unwrap();
    let queue = Arc::new(WorkQueue::default());
    queue.post(&sequences(), ActionMode::Greedy);
    let open = Open { pass: PassId { epoch: 1, number: 0 }, queue: queue.clone(), weights: Arc::new(weights()) };
    let caller = bus.worker_caller("slow", Duration::from_millis(500)).await.unwrap();
    let client = WorkerClient {
        name: "slow".to_owned(),
        settings: Default::default(),
        caller,
        evaluations: watch::channel(None).1,
    };
    let holding = async {
        let mut held = Vec::new();
        for _ in 0..MAX_TOO_LATE {
            held.push(units.recv().await.unwrap());
        }
        held
    };
    let (reason, held) = within(async { tokio::join!(client.serve(&open), holding) }).await;
    assert_eq!(reason, "it answered none of 3 units in time");
    assert_eq!(held.iter().map(|call| call.unit.sequences.len()).collect::<Vec<_>>(), [3, 1, 1]);
    // What it left undone is there for others.
    assert_eq!(std::iter::from_fn(|| queue.take()).count(), 12);
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn remote_workers_find_what_the_evaluator_would() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let shutdown = CancellationToken::new();
    // One worker with different settings refuses, one takes sequences and never returns them, and two work.
    let mut services = Vec::new();
    for (id, episode_steps) in [("other", 9), ("a", 8), ("b", 8)] {
        let (bus, shutdown) = (bus.clone(), shutdown.clone());
        services.push(tokio::spawn(async move { run_worker(setup(id, episode_steps), &bus, shutdown).await }));
    }
    let mut idle: UnitServer = bus.serve_units("idle").await.unwrap();
    let token = bus.declare_alive(Role::Worker, "idle").await.unwrap();

    let small = small_setup(EpisodeConfig::default());
    let queue = Arc::new(WorkQueue::default());
    queue.post(&sequences(), ActionMode::Sampled);
    let mut workers = Dispatcher::start(&bus, setup("judge", 8).settings(), UNIT_PATIENCE).await.unwrap();
    workers.open(queue.clone(), Arc::new(weights()));
    let taken = within(idle.recv()).await.unwrap();
    assert!(taken.unit.is_sampled && taken.unit.weights.is_none());
    drop(token);
    drop(taken);
    let shared = brought(&queue).await;

    let alive = bus.alive(Role::Worker).await.unwrap();
    within(alive.watch().wait_for(|names| names.contains("other"))).await.unwrap();
    let caller = bus.worker_caller("other", UNIT_PATIENCE).await.unwrap();
    let unit = EvalUnit {
        settings: setup("judge", 8).settings(),
        pass: PassId { epoch: 1, number: 0 },
        weights: None,
        is_sampled: true,
        sequences: vec![vec![sequences()[0][0].task().clone()]],
    };
    let refusal = "environment.episode_steps is 8 at the evaluator and 9 at the worker: start the worker with the \
                   evaluator's settings";
    assert_eq!(within(caller.run(&unit)).await.unwrap(), EvalAnswer::Refused(refusal.to_owned()));

    let (alone, observer) = (WorkQueue::default(), None::<&EpisodeSelector>);
    let pool = EvaluationPool { setup: &small, agent: &agent, queue: &alone, observer, keep_going: &|| true };
    assert_eq!(shared, pool.run(&sequences(), ActionMode::Sampled).0);
    assert_eq!((queue.n_assisted(), alone.n_assisted()), (12, 0));
    shutdown.cancel();
    let mut n_units = Vec::new();
    for service in services {
        n_units.push(within(service).await.unwrap().unwrap());
    }
    assert!(n_units[0] == 0 && n_units[1] + n_units[2] >= 2, "{n_units:?}");
    bus.close().await;
}

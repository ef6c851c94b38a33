//! Assistants on an isolated bus do the work of a pass in which the evaluator itself does nothing.

use blueprints::{Blueprint, Catalogue, Split};
use proto::Start;
use proto::bus::UnitServer;
use tokio_util::sync::CancellationToken;

use super::*;
use crate::assist::{assist, setup_hash};
use crate::config::{EpisodeConfig, EvaluatorConfig};
use crate::episodes::Workshop;
use crate::episodes::tests::{small_setup, weights};
use crate::lanes::Job;
use crate::run::EvaluatorSetup;

fn setup(id: &str, episode_steps: u16) -> EvaluatorSetup {
    let small = small_setup(EpisodeConfig::default());
    EvaluatorSetup {
        config: EvaluatorConfig::default(),
        policy: small.policy,
        environment: environment::EnvironmentConfig { episode_steps, ..small.environment },
        id: id.to_owned(),
        seed: 3,
        records: None,
    }
}

fn lanes() -> Vec<Vec<Job>> {
    let goals: Vec<&Blueprint> = Catalogue::builtin().of_split(Split::Train);
    let lane = |(goal, idx): (&&Blueprint, u64)| {
        vec![Job::new(goal, Start::Scattered, 3, idx), Job::new(goal, Start::AsItIs, 3, idx + 1)]
    };
    goals[..12].iter().zip(0..).map(lane).collect()
}

async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(120), future).await.expect("it takes a moment only")
}

/// Waits until assistants have brought all lanes.
async fn brought(desk: &Arc<Desk>) -> Vec<Vec<Played>> {
    let desk = desk.clone();
    let waiting = tokio::task::spawn_blocking(move || {
        let start = std::time::Instant::now();
        while !desk.is_done() && start.elapsed() < Duration::from_secs(100) {
            desk.wait_until_done(Duration::from_secs(1));
        }
        desk.clear()
    });
    within(waiting).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn assistants_find_what_the_evaluator_would() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let shutdown = CancellationToken::new();
    // One of another world refuses, one takes lanes and never brings them, two work.
    let mut services = Vec::new();
    for (id, episode_steps) in [("other", 9), ("a", 8), ("b", 8)] {
        let (bus, shutdown) = (bus.clone(), shutdown.clone());
        services.push(tokio::spawn(async move { assist(setup(id, episode_steps), &bus, shutdown).await }));
    }
    let mut idle: UnitServer = bus.serve_units("idle").await.unwrap();
    let token = bus.declare_alive(Role::Assistant, "idle").await.unwrap();

    let small = small_setup(EpisodeConfig::default());
    let desk = Arc::new(Desk::new(Arc::new(weights(&small))));
    desk.post(&lanes(), Acting::Sampled);
    let mut clerks = Clerks::hire(&bus, setup_hash(&setup("judge", 8))).await.unwrap();
    clerks.open(desk.clone());
    let taken = within(idle.recv()).await.unwrap();
    assert!(taken.unit.is_sampled && taken.unit.weights.is_none());
    drop(token);
    drop(taken);
    let shared = brought(&desk).await;

    let alone = Desk::new(desk.weights().clone());
    let workshop = Workshop { setup: &small, desk: &alone, films: None, keep_going: &|| true };
    assert_eq!(shared, workshop.run(&lanes(), Acting::Sampled).unwrap());
    assert_eq!((desk.n_assisted(), alone.n_assisted()), (12, 0));
    shutdown.cancel();
    let mut n_units = Vec::new();
    for service in services {
        n_units.push(within(service).await.unwrap().unwrap());
    }
    assert!(n_units[0] == 0 && n_units[1] + n_units[2] >= 2, "{n_units:?}");
    bus.close().await.unwrap();
}

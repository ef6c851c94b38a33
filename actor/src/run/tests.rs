//! An actor on an isolated bus, with a learner that only counts.

use std::collections::BTreeSet;

use blueprints::{BlockIdx, Catalog};
use policy::{Network, parameters};
use proto::metrics::ActorDrops;
use proto::{Status, Weights, WeightsVersion};
use tokio::sync::mpsc;

use super::*;
use crate::config::{ActorConfig, FullBacklog};
use crate::task::{TaskConfig, TaskFilter};
use crate::tests::toy::{self, setup};

fn config() -> ActorConfig {
    ActorConfig {
        n_threads: 2,
        n_worlds: 2,
        segment_len: 4,
        tasks: TaskConfig { filter: TaskFilter::Sizes { min: 2, max: 2 }, ..Default::default() },
        backlog_limit: 8,
        full_backlog: FullBacklog::Pause,
    }
}

/// Fails a test that would otherwise hang.
async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(60), future).await.expect("it takes a moment only")
}

struct Actor {
    bus: Bus,
    shutdown: CancellationToken,
    task: tokio::task::JoinHandle<anyhow::Result<Summary>>,
    _dir: tempfile::TempDir,
}

impl Actor {
    async fn start(config: ActorConfig) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let bus = Bus::isolated(dir.path()).await.unwrap();
        let shutdown = CancellationToken::new();
        let (its_bus, its_shutdown) = (bus.clone(), shutdown.clone());
        let task =
            tokio::spawn(async move { run(setup(config), &its_bus, watch::channel(None).0, its_shutdown).await });
        Self { bus, shutdown, task, _dir: dir }
    }

    async fn stop(self) -> Summary {
        self.shutdown.cancel();
        let report = within(self.task).await.unwrap().unwrap();
        self.bus.close().await;
        report
    }
}

#[test]
fn an_actor_that_waits_is_not_said_to_stand_still() {
    let mut reports = VecDeque::new();
    let mut at = |seconds, n_env_steps| steps_per_s(&mut reports, Duration::from_secs(seconds), n_env_steps);
    assert_eq!((at(2, 400), at(4, 400), at(8, 400)), (200.0, 100.0, 50.0));
    assert_eq!(at(20, 1000), 50.0);
    // Since 8 s: the report before the last half minute.
    assert_eq!(at(40, 1000), 600.0 / 32.0);
    assert_eq!((at(50, 1000), at(70, 1000)), (0.0, 0.0));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_segment_is_acknowledged_or_counted() {
    let actor = Actor::start(config()).await;
    let (taken, mut received) = mpsc::unbounded_channel();
    let (_version, current_version) = watch::channel(WeightsVersion(3));
    let handler = move |trajectory: Trajectory| {
        if trajectory.seq % 5 == 4 { Err(Refusal::Stale) } else { taken.send(trajectory).map_err(|_| Refusal::Full) }
    };
    let server = actor.bus.serve_trajectories(handler, current_version).await.unwrap();
    let mut metrics = actor.bus.metrics_subscriber("actor/toy").await.unwrap();
    let publisher = actor.bus.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(toy::weights(3, 1.0))).await.unwrap();

    let mut names = BTreeSet::new();
    let mut taken = Vec::new();
    while taken.len() < 40 {
        taken.push(within(received.recv()).await.unwrap());
    }
    let sample = within(metrics.recv()).await.unwrap();
    let said: ActorMetrics = serde_json::from_value(sample.value).unwrap();
    assert_eq!((said.n_worlds, said.actor.as_str()), (4, "toy"));

    let report = actor.stop().await;
    while let Ok(trajectory) = received.try_recv() {
        taken.push(trajectory);
    }
    assert!(taken.iter().all(|trajectory| names.insert(trajectory.seq)), "numbers are unique across threads");
    assert!(taken.iter().all(|trajectory| trajectory.weights_version == WeightsVersion(3)));
    let settings_hash = setup(config()).settings().hash();
    assert!(taken.iter().all(|trajectory| trajectory.settings_hash == settings_hash));
    assert!(taken.iter().any(|trajectory| trajectory.status == Status::TimeLimit));
    let ActorDrops { stale_total, no_learner_total, .. } = report.dropped;
    // What a paused machine does not answer in time may have been taken.
    let n_sent = report.n_trajectories_acked..=report.n_trajectories_acked + no_learner_total;
    assert!(n_sent.contains(&(taken.len() as u64)) && n_sent.contains(&server.counts().accepted_total), "{report:?}");
    assert!(stale_total > 0);
    assert_eq!(report.counters.n_segments, report.n_trajectories_acked + stale_total + no_learner_total);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_a_learner_it_steps_on_and_counts_what_it_drops() {
    let actor = Actor::start(ActorConfig { full_backlog: FullBacklog::DropOldest, ..config() }).await;
    let mut metrics = actor.bus.metrics_subscriber("actor/toy").await.unwrap();
    let publisher = actor.bus.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(toy::weights(0, 1.0))).await.unwrap();
    loop {
        let sample = within(metrics.recv()).await.unwrap();
        let said: ActorMetrics = serde_json::from_value(sample.value).unwrap();
        if said.dropped.no_learner_total > 10 {
            assert!(!said.learner_is_there);
            break;
        }
    }
    let report = actor.stop().await;
    assert_eq!(report.n_trajectories_acked, 0);
    assert_eq!(report.dropped.no_learner_total, report.counters.n_segments);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_waits_for_the_first_weights_and_refuses_other_networks() {
    let actor = Actor::start(config()).await;
    let publisher = actor.bus.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(Weights { network_hash: 1, ..toy::weights(0, 1.0) })).await.unwrap();
    let error = within(actor.task).await.unwrap().unwrap_err();
    assert!(format!("{error:#}").contains("are for network 0000000000000001"), "{error:#}");

    let actor = Actor::start(config()).await;
    assert_eq!(actor.stop().await, Summary::default());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_actor_with_other_settings_than_its_run_ends_and_names_the_first() {
    let mut theirs = setup(config());
    theirs.environment = theirs.environment.with(|worlds| worlds.episode_steps = 7).unwrap();
    let theirs = theirs.settings();
    // With the first weights, and after the learner was replaced.
    for first in [theirs.clone(), setup(config()).settings()] {
        let is_late = first != theirs;
        // No learner takes segments, and the actor must not pause for one.
        let actor = Actor::start(ActorConfig { full_backlog: FullBacklog::DropOldest, ..config() }).await;
        let mut metrics = actor.bus.metrics_subscriber("actor/toy").await.unwrap();
        let publisher = actor.bus.weights_publisher().await.unwrap();
        publisher.publish(Arc::new(Weights { settings: first, ..toy::weights(0, 1.0) })).await.unwrap();
        if is_late {
            within(metrics.recv()).await.unwrap();
            publisher.publish(Arc::new(Weights { settings: theirs.clone(), ..toy::weights(1, 1.0) })).await.unwrap();
        }
        let error = within(actor.task).await.unwrap().unwrap_err();
        let difference = "environment.episode_steps is 7 there and 6 here";
        let sentence = format!("weights {} are of a run with other settings: {difference}", u8::from(is_late));
        assert_eq!(format!("{error:#}"), sentence);
        assert_eq!(actor.bus.counts().weights_refused_total, 1);
        actor.bus.close().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_actor_whose_name_is_another_s_ends_and_says_so() {
    let start = |bus: &Bus| {
        let bus = bus.clone();
        tokio::spawn(async move { run(setup(config()), &bus, watch::channel(None).0, CancellationToken::new()).await })
    };
    let expected = "another live actor of this run is called \"toy\"; choose another --id";
    // The other actor is already present.
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let _taken = bus.declare_alive(Role::Actor, "toy").await.unwrap();
    assert_eq!(within(start(&bus)).await.unwrap().unwrap_err().to_string(), expected);

    // Both checked at the same moment and found no other; the learner accepted a trajectory of the other first. Another
    // bus, because a learner that sees the old token disappear forgets the owner of the name.
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let (_version, current_version) = watch::channel(WeightsVersion(0));
    let server = bus.serve_trajectories(|_| Ok(()), current_version).await.unwrap();
    let actor = start(&bus);
    let alive = bus.alive(Role::Actor).await.unwrap();
    within(alive.watch().wait_for(|names| names.contains("toy"))).await.unwrap();
    let sender = bus.trajectory_sender(&toy::actor()).await.unwrap();
    sender.wait_for_learner().await;
    // Nobody owns the name until the server knows its token. Then, one of two processes in turns is refused.
    let mut n_accepted = 0;
    loop {
        let trajectory = Trajectory { epoch: 1 + n_accepted % 2, seq: n_accepted, ..toy::trajectory() };
        match within(sender.send(&trajectory)).await {
            Ok(_) => n_accepted += 1,
            Err(error) => break assert!(matches!(error, SendError::Refused(Refusal::NameTaken)), "{error}"),
        }
    }
    assert_eq!(server.counts().accepted_total, n_accepted);
    let publisher = bus.weights_publisher().await.unwrap();
    let mut metrics = bus.metrics_subscriber("actor/toy").await.unwrap();
    publisher.publish(Arc::new(toy::weights(0, 1.0))).await.unwrap();
    assert_eq!(within(actor).await.unwrap().unwrap_err().to_string(), expected);
    // What is still under way when its token disappears may find the name free, so what is accepted has no bound here.
    assert!(server.counts().name_taken_total > 1);
    // It has reported how many segments were not accepted.
    loop {
        let said: ActorMetrics = serde_json::from_value(within(metrics.recv()).await.unwrap().value).unwrap();
        assert_eq!(said.n_trajectories_acked, 0);
        if said.dropped.name_taken_total > 0 {
            break;
        }
    }
    bus.close().await;
}

/// Returns untrained weights that become unusable once the first gripper holds a block outside the catalog's first
/// goal. In the trial's scene, it does not.
fn trap(version: u64) -> Weights {
    let mut weights = toy::weights(version, 1.0);
    let config = toy::small_policy();
    let network = Network::init(&config.network, &config.sizes(), 1, &policy::DeviceKind::Cpu.open().unwrap());
    let goal = Catalog::builtin().iter().next().unwrap();
    for (spec, span) in parameters::spans(network.table()) {
        if spec.name.ends_with("input_global.w") {
            for stray in BlockIdx::all().filter(|block| !goal.contains(*block)) {
                // Global features 9..25 encode which block it holds.
                let row = span.start + (9 + stray.get()) * spec.shape[1];
                weights.parameters[row..row + spec.shape[1]].fill(1e6);
            }
        }
    }
    weights.normalization.value_std = 1e4;
    weights
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn weights_that_give_no_distribution_are_counted_and_the_old_ones_stay() {
    let actor = Actor::start(config()).await;
    let (taken, mut received) = mpsc::unbounded_channel();
    let (_version, current_version) = watch::channel(WeightsVersion(0));
    let handler = move |trajectory: Trajectory| taken.send(trajectory.weights_version.0).map_err(|_| Refusal::Full);
    let _server = actor.bus.serve_trajectories(handler, current_version).await.unwrap();
    let publisher = actor.bus.weights_publisher().await.unwrap();
    let mut metrics = actor.bus.metrics_subscriber("actor/toy").await.unwrap();
    let mut refused = async |n: u64| {
        while actor.bus.counts().weights_refused_total < n {
            within(metrics.recv()).await.unwrap();
        }
    };
    let huge = |version| Weights { parameters: vec![1e6; toy::weights(0, 1.0).parameters.len()], ..trap(version) };
    let mut versions = BTreeSet::new();
    let mut until = async |version: u64| {
        while versions.last() != Some(&version) {
            versions.insert(within(received.recv()).await.unwrap());
        }
    };
    // The actor publishes metrics from its first weights on, even if it cannot act with those.
    publisher.publish(Arc::new(huge(1))).await.unwrap();
    refused(1).await;
    publisher.publish(Arc::new(toy::weights(2, 1.0))).await.unwrap();
    until(2).await;
    publisher.publish(Arc::new(huge(3))).await.unwrap();
    refused(2).await;
    publisher.publish(Arc::new(trap(4))).await.unwrap();
    refused(3).await;
    publisher.publish(Arc::new(toy::weights(5, 1.0))).await.unwrap();
    until(5).await;
    // Both threads refuse the same weights, which counts once. The trap may act until a gripper holds such a block.
    assert_eq!(actor.bus.counts().weights_refused_total, 3);
    assert!(versions.is_subset(&[2, 4, 5].into()), "{versions:?}");
    actor.stop().await;
}

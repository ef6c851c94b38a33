//! A learner or a router that disappears and returns.

use proto::Valid;
use std::net::TcpListener;
use std::sync::mpsc;
use std::time::Duration;

use bus::{Bus, BusConfig, BusMode, SendError};

use crate::cluster::{Cluster, Learner, until, within};
use crate::samples;
use crate::trajectories::sender;

#[tokio::test(flavor = "multi_thread")]
async fn actor_waits_for_a_learner() {
    let cluster = Cluster::start().await;
    let actor = cluster.client().await;
    let sender = actor.trajectory_sender(&"a".parse().unwrap()).await.unwrap();
    let mut there = sender.watch_learner();
    let answer = sender.send(&samples::running("a", 0)).await;
    assert!(matches!(answer, Err(SendError::NoLearner)), "{answer:?}");

    let learner_bus = cluster.client().await;
    let learner = Learner::start(&learner_bus, |_| Ok(())).await;
    within("a learner", sender.wait_for_learner()).await;
    within("an ack", sender.send(&samples::running("a", 1))).await.unwrap();
    assert_eq!(learner.seqs(), [1]);

    drop(learner.server);
    until("the learner's absence", &mut there, |there| !there).await;
    let answer = sender.send(&samples::running("a", 2)).await;
    assert!(matches!(answer, Err(SendError::NoLearner)), "{answer:?}");

    let learner = Learner::start(&cluster.client().await, |_| Ok(())).await;
    within("a learner", sender.wait_for_learner()).await;
    within("an ack", sender.send(&samples::running("a", 2))).await.unwrap();
    assert_eq!(learner.seqs(), [2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_reconnect_after_a_router_restart_and_close_in_time_without_it() {
    let cluster = Cluster::start().await;
    let (learner_bus, actor_bus) = (cluster.client().await, cluster.client().await);
    let learner = Learner::start(&learner_bus, |_| Ok(())).await;
    let sender = sender(&actor_bus, "a").await;
    within("an ack", sender.send(&samples::running("a", 0))).await.unwrap();

    let mut there = sender.watch_learner();
    cluster.router.close().await;
    until("the learner's absence", &mut there, |there| !there).await;

    let router = within("router", Bus::open(&BusConfig::isolated_router(cluster.dir.path()))).await.unwrap();
    within("a learner", sender.wait_for_learner()).await;
    within("an ack", sender.send(&samples::running("a", 1))).await.unwrap();
    assert_eq!(learner.seqs(), [0, 1]);
    router.close().await;
    until("the learner's absence", &mut there, |there| !there).await;
    within("the actor's end", actor_bus.close()).await;
    within("the learner's end", learner_bus.close()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn client_starts_before_its_router() {
    let dir = tempfile::tempdir().unwrap();
    let config = BusConfig::isolated_client(dir.path());
    let client = tokio::spawn(async move { Bus::open(&config).await });
    let router = Bus::isolated(dir.path()).await.unwrap();
    let client = within("the client", client).await.unwrap().unwrap();
    client.close().await;
    router.close().await;
}

#[test]
fn an_opening_that_nobody_waits_for_does_not_hold_its_runtime() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let connect = vec![format!("tcp/{}", silent.local_addr().unwrap())];
    let config = Valid::new(BusConfig { mode: BusMode::Client, connect, ..BusConfig::default() }).unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let opening = runtime.spawn(async move { Bus::open(&config).await.map(drop) });
    let _connection = silent.accept().unwrap();
    opening.abort();
    let (ended, end) = mpsc::channel();
    // A runtime waits for all of its threads.
    std::thread::spawn(move || {
        drop(runtime);
        ended.send(()).unwrap();
    });
    end.recv_timeout(Duration::from_secs(60)).expect("the runtime ends");
}

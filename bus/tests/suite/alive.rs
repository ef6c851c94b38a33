//! Tests of liveliness tokens.

use std::collections::BTreeSet;
use std::future::pending;
use std::time::Duration;

use bus::{Bus, BusConfig, BusError};
use proto::Role;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::oneshot;

use crate::cluster::{Cluster, until, within};

fn names(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn alive_watch_follows_tokens() {
    let cluster = Cluster::start().await;
    let (first, second) = (cluster.client().await, cluster.client().await);
    let _first = first.declare_alive(Role::Actor, "a-1").await.unwrap();
    let token = second.declare_alive(Role::Actor, "a-2").await.unwrap();
    let _learner = second.declare_alive(Role::Learner, "main").await.unwrap();

    // The watch starts after both actors are declared, and sees that of its own session and the other.
    let watch = first.alive(Role::Actor).await.unwrap();
    let mut alive = watch.watch();
    until("both actors", &mut alive, |a| *a == names(&["a-1", "a-2"])).await;
    drop(token);
    until("one that left", &mut alive, |a| *a == names(&["a-1"])).await;
    let _token = second.declare_alive(Role::Actor, "a-3").await.unwrap();
    until("a new one", &mut alive, |a| *a == names(&["a-1", "a-3"])).await;
    second.close().await;
    until("one whose session closed", &mut alive, |a| *a == names(&["a-1"])).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn second_process_of_a_name_waits_and_then_fails() {
    let cluster = Cluster::start().await;
    let (first, second) = (cluster.client().await, cluster.client().await);
    let watch = cluster.router.alive(Role::Actor).await.unwrap();
    let token = first.declare_alive_alone(Role::Actor, "a", Duration::ZERO).await.unwrap();
    // The declaration takes a moment to reach the router.
    until("the first", &mut watch.watch(), |alive| *alive == names(&["a"])).await;
    let error = second.declare_alive_alone(Role::Actor, "a", Duration::ZERO).await.unwrap_err().to_string();
    assert_eq!(error, r#"another live actor of this run is called "a"; choose another --id"#);
    // The same name in another role, and another name.
    let _learner = second.declare_alive_alone(Role::Learner, "a", Duration::ZERO).await.unwrap();
    let _other = second.declare_alive_alone(Role::Actor, "b", Duration::ZERO).await.unwrap();
    // A waiting process succeeds once the first is gone.
    let waiting = tokio::spawn({
        let second = second.clone();
        async move { second.declare_alive_alone(Role::Actor, "a", Duration::from_secs(60)).await }
    });
    tokio::task::yield_now().await;
    drop(token);
    let _token = within("the name", waiting).await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_that_does_not_answer_leaves_names_unknown() {
    let cluster = Cluster::start().await;
    let folder = tempfile::tempdir().unwrap();
    let listener = UnixListener::bind(BusConfig::socket(folder.path())).unwrap();
    let socket = BusConfig::socket(cluster.dir.path());
    let (stall, stalled) = oneshot::channel::<()>();
    tokio::spawn(async move {
        let (mut near, _) = listener.accept().await.unwrap();
        let mut far = UnixStream::connect(socket).await.unwrap();
        tokio::select! { _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}, _ = stalled => pending().await }
    });
    let config = BusConfig::isolated_client(folder.path());
    let [stalled, left] = [within("a client", Bus::open(&config)).await.unwrap(), cluster.client().await];
    stall.send(()).unwrap();
    cluster.router.close().await;
    for bus in [stalled, left] {
        let error = within("an error", bus.declare_alive_alone(Role::Learner, "a", Duration::ZERO)).await.unwrap_err();
        assert!(matches!(error, BusError::NoAnswer), "{error}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn name_invalid_in_a_key_is_refused() {
    let cluster = Cluster::start().await;
    let error = cluster.router.declare_alive(Role::Actor, "a/b").await.unwrap_err().to_string();
    assert_eq!(error, r#"name "a/b" is not 1 to 64 characters of a-z, 0-9 and -"#);
}

#[tokio::test(flavor = "multi_thread")]
async fn other_runs_of_a_router_are_listed() {
    let cluster = Cluster::start().await;
    let config = |run: &str| cluster.client_config().with(|config| config.run = run.to_owned()).unwrap();
    let listed = async |run: &str| within("the runs", bus::runs(&config(run))).await.unwrap();
    assert_eq!(listed("paper").await, names(&[]));
    let paper = within("a client", Bus::open(&config("paper"))).await.unwrap();
    let _tokens = (
        paper.declare_alive(Role::Actor, "a").await.unwrap(),
        paper.declare_alive(Role::Learner, "learner").await.unwrap(),
        cluster.router.declare_alive(Role::Evaluator, "e").await.unwrap(),
    );
    // The tokens take a moment to reach the router.
    within("both runs", async { while listed("nobody").await != names(&["default", "paper"]) {} }).await;
    // A run is not listed for itself.
    assert_eq!(listed("paper").await, names(&["default"]));
}

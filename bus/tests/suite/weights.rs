//! Weights reach all subscribers: early ones, late ones, and those of a restarted learner.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use bus::Bus;
use proto::{Weights, WeightsVersion, codec};
use tokio::sync::watch;
use zenoh::Wait;

use crate::cluster::{Cluster, until, within};
use crate::samples;

pub(crate) async fn until_version(
    weights: &mut watch::Receiver<Option<Arc<Weights>>>,
    version: u64,
) -> Option<Arc<Weights>> {
    let is_there = |w: &Option<Arc<Weights>>| w.as_ref().is_some_and(|w| w.version == WeightsVersion(version));
    until("weights", weights, is_there).await
}

#[tokio::test(flavor = "multi_thread")]
async fn newest_weights_arrive_after_several_publications() {
    let cluster = Cluster::start().await;
    let learner = cluster.client().await;
    let subscribers = [cluster.client().await, cluster.client().await, cluster.router.clone(), learner.clone()];
    let mut watches = Vec::new();
    for bus in &subscribers {
        let subscriber = bus.weights_subscriber().await.unwrap();
        assert!(subscriber.watch().borrow().is_none());
        watches.push((subscriber.watch(), subscriber));
    }
    let publisher = learner.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(0))).await.unwrap();
    for (weights, _) in &mut watches {
        until_version(weights, 0).await;
    }
    for version in 1..=10 {
        publisher.publish(Arc::new(samples::weights(version))).await.unwrap();
    }
    for (weights, _) in &mut watches {
        let newest = until_version(weights, 10).await;
        assert_eq!(newest.as_deref(), Some(&samples::weights(10)));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn late_joiner_gets_the_newest_weights() {
    let cluster = Cluster::start().await;
    let publisher = cluster.client().await.weights_publisher().await.unwrap();
    for version in 0..3 {
        // As many parameters as the real network, so that the message has many fragments on the wire.
        let weights = Weights { parameters: vec![version as f32; 1_000_000], ..samples::weights(version) };
        publisher.publish(Arc::new(weights)).await.unwrap();
    }
    let subscriber = cluster.client().await.weights_subscriber().await.unwrap();
    let first = until("weights", &mut subscriber.watch(), Option::is_some).await.unwrap();
    assert_eq!((first.version, first.parameters.len(), first.parameters[999_999]), (WeightsVersion(2), 1_000_000, 2.0));
}

#[tokio::test(flavor = "multi_thread")]
async fn notices_are_repeated_for_who_missed_them() {
    let cluster = Cluster::start().await;
    let publisher = cluster.client().await.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(1))).await.unwrap();
    let script = cluster.script().await;
    let notices = script.declare_subscriber("lodestone/default/weights/version/x").await.unwrap();
    // The first may still have been on its way.
    for _ in 0..2 {
        let notice = within("a notice", notices.recv_async()).await.unwrap();
        assert_eq!(codec::decode_notice(&notice.payload().to_bytes()).unwrap().version, WeightsVersion(1));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn restarted_learner_with_an_older_version_is_followed() {
    let cluster = Cluster::start().await;
    let subscriber = cluster.client().await.weights_subscriber().await.unwrap();
    let mut weights = subscriber.watch();
    let first_learner = cluster.client().await;
    let publisher = first_learner.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(9))).await.unwrap();
    until_version(&mut weights, 9).await;
    drop(publisher);
    first_learner.close().await;

    let publisher = cluster.client().await.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(4))).await.unwrap();
    until_version(&mut weights, 4).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn weights_arrive_after_a_router_restart() {
    let cluster = Cluster::start().await;
    let publisher = cluster.client().await.weights_publisher().await.unwrap();
    let subscriber = cluster.client().await.weights_subscriber().await.unwrap();
    let mut weights = subscriber.watch();
    publisher.publish(Arc::new(samples::weights(1))).await.unwrap();
    until_version(&mut weights, 1).await;
    cluster.router.close().await;
    // No subscriber receives this notice.
    publisher.publish(Arc::new(samples::weights(2))).await.unwrap();
    let router = Bus::isolated(cluster.dir.path()).await.unwrap();
    until_version(&mut weights, 2).await;
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pull_that_nobody_answers_is_repeated() {
    let cluster = Cluster::start().await;
    let script = cluster.script().await;
    // Drops the first query, like a router that does not know the way yet, and sends no notice later.
    let n_asked = AtomicU8::new(0);
    let bytes = codec::encode_weights(&samples::weights(3), 1);
    let learner = script.declare_queryable("lodestone/default/weights/latest").complete(true).callback(move |query| {
        if n_asked.fetch_add(1, Ordering::Relaxed) > 0 {
            drop(query.reply("lodestone/default/weights/latest", bytes.clone()).wait());
        }
    });
    let _learner = learner.await.unwrap();
    let subscriber = cluster.client().await.weights_subscriber().await.unwrap();
    until_version(&mut subscriber.watch(), 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_learner_that_leaves_is_noticed_without_its_weights() {
    let cluster = Cluster::start().await;
    let (learner_bus, actor_bus) = (cluster.client().await, cluster.client().await);
    let learner = actor_bus.learner_watch().await.unwrap();
    let mut there = learner.watch();
    assert!(!*there.borrow());
    let publisher = learner_bus.weights_publisher().await.unwrap();
    until("a learner", &mut there, |there| *there).await;
    drop(publisher);
    until("its absence", &mut there, |there| !there).await;
}

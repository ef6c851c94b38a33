//! Invalid messages are counted and refused, and do not affect other processes.

use std::sync::Arc;

use bus::SendError;
use proto::{Refusal, WeightsVersion, codec};
use zenoh::Wait;

use crate::cluster::{Cluster, Learner, within};
use crate::samples;
use crate::trajectories::sender;
use crate::weights::until_version;

/// Sends a query with a payload and returns the payload of the error reply.
async fn refused(session: &zenoh::Session, key: &str, payload: &[u8]) -> Refusal {
    let replies = session.get(format!("lodestone/default/{key}")).payload(payload).await.unwrap();
    let reply = within("a reply", replies.recv_async()).await.unwrap();
    let error = reply.into_result().unwrap_err();
    codec::decode_refusal(&error.payload().to_bytes()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_trajectory_is_refused() {
    let cluster = Cluster::start().await;
    let learner = Learner::start(&cluster.router, |_| Ok(())).await;
    let script = cluster.script().await;
    let truncated = &codec::encode_trajectory(&samples::running("x", 0))[..500];
    for payload in [b"".as_slice(), b"\xff\xff\xff", b"{}", truncated] {
        let refusal = refused(&script, "ingest/x", payload).await;
        assert!(matches!(refusal, Refusal::Invalid(_)), "{refusal:?}");
    }
    let mut older = codec::encode_trajectory(&samples::running("x", 0));
    assert_eq!(std::mem::replace(&mut older[1], 1), 2);
    let reason = "it has protocol version 1, and this process speaks version 2: run one version of Lodestone in all \
                  processes";
    assert_eq!(refused(&script, "ingest/x", &older).await, Refusal::Invalid(reason.to_owned()));
    assert_eq!(learner.server.counts().invalid_total, 5);
    let sender = sender(&cluster.client().await, "a").await;
    within("an ack", sender.send(&samples::of_expert("a", 0))).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_weights_query_is_refused() {
    let cluster = Cluster::start().await;
    let publisher = cluster.router.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(0))).await.unwrap();
    let refusal = refused(&cluster.script().await, "weights/latest", b"garbage").await;
    assert_eq!(refusal, Refusal::Invalid("a query for weights/latest has no payload".into()));
    assert_eq!(cluster.router.counts().queries_invalid_total, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_notices_and_weights_are_ignored() {
    let cluster = Cluster::start().await;
    let script = cluster.script().await;
    let (answered, mut answers) = tokio::sync::mpsc::unbounded_channel();
    let impostor = script
        .declare_queryable("lodestone/default/weights/latest")
        .callback(move |query| {
            answered.send(()).unwrap();
            drop(query.reply("lodestone/default/weights/latest", "no weights").wait());
        })
        .await
        .unwrap();
    let actor = cluster.client().await;
    let subscriber = actor.weights_subscriber().await.unwrap();
    let mut weights = subscriber.watch();
    within("a pull", answers.recv()).await.unwrap();

    let notices = script.declare_publisher("lodestone/default/weights/version/*").await.unwrap();
    let matching = notices.matching_listener().await.unwrap();
    while !notices.matching_status().await.unwrap().matching() {
        within("a subscriber", matching.recv_async()).await.unwrap();
    }
    notices.put("no notice").await.unwrap();
    let promise = codec::WeightsNotice { epoch: 1, version: WeightsVersion(u64::MAX) };
    notices.put(codec::encode_notice(promise)).await.unwrap();
    // The second pull comes after the first answer was processed.
    within("another pull", answers.recv()).await.unwrap();
    assert!(actor.counts().weights_invalid_total >= 1, "{:?}", actor.counts());
    assert!(weights.borrow().is_none());
    impostor.undeclare().await.unwrap();

    let publisher = cluster.client().await.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(3))).await.unwrap();
    until_version(&mut weights, 3).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_answers_are_errors_at_the_sender() {
    let cluster = Cluster::start().await;
    let script = cluster.script().await;
    // Answers the first query with garbage and the second with a made-up error. Does not answer the third.
    let n = std::sync::atomic::AtomicU8::new(0);
    let impostor = script.declare_queryable("lodestone/default/ingest/*").complete(true).callback(move |query| {
        let key = query.key_expr().clone();
        match n.fetch_add(1, std::sync::atomic::Ordering::Relaxed) {
            0 => drop(query.reply(key, "yes").wait()),
            1 => drop(query.reply_err("no").wait()),
            _ => {}
        }
    });
    let impostor = impostor.await.unwrap();
    let sender = sender(&cluster.client().await, "a").await;
    let answer = within("an answer", sender.send(&samples::running("a", 0))).await;
    assert!(matches!(answer, Err(SendError::BadReply(_))), "{answer:?}");
    for _ in 0..2 {
        let answer = within("an answer", sender.send(&samples::running("a", 0))).await;
        assert!(matches!(answer, Err(SendError::NoReply)), "{answer:?}");
    }
    impostor.undeclare().await.unwrap();
}

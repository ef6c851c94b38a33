//! Floods: what exceeds the limits is refused and counted, and does not affect others.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, mpsc};

use bus::SendError;
use zenoh::bytes::Encoding;
use zenoh::query::Reply;

use crate::cluster::{Cluster, Learner, within};
use crate::samples;
use crate::trajectories::sender;
use crate::weights::until_version;

#[tokio::test(flavor = "multi_thread")]
async fn router_ends_most_pulls_of_a_flood_and_others_get_new_weights() {
    const N_FLOOD: usize = 10_000;
    let cluster = Cluster::start().await;
    let publisher = cluster.client().await.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(samples::weights(1))).await.unwrap();
    let honest = cluster.client().await.weights_subscriber().await.unwrap();
    let mut weights = honest.watch();
    until_version(&mut weights, 1).await;

    let script = cluster.script().await;
    let n_reached = Arc::new(AtomicUsize::new(0));
    let (open, mut ended) = tokio::sync::mpsc::channel::<()>(1);
    for _ in 0..N_FLOOD {
        let (n_reached, open) = (n_reached.clone(), open.clone());
        let count = move |reply: Reply| {
            // Zenoh drops the callback, and with it `open`, when the query has ended.
            let _open = &open;
            // Its own errors are of queries that nobody has answered.
            let refusal = Encoding::APPLICATION_PROTOBUF.with_schema("lodestone.v1.Refusal");
            let is_reached = reply.result().map_or_else(|error| *error.encoding() == refusal, |_| true);
            n_reached.fetch_add(usize::from(is_reached), Ordering::Relaxed);
        };
        script.get("lodestone/default/weights/latest").callback(count).await.unwrap();
    }
    publisher.publish(Arc::new(samples::weights(2))).await.unwrap();
    until_version(&mut weights, 2).await;
    drop(open);
    within("the end of all pulls", ended.recv()).await;
    // Answers and refusals of the learner. A hundred seconds of the router's limit would let half of the flood through.
    let n_reached = n_reached.load(Ordering::Relaxed);
    assert!((1..N_FLOOD / 2).contains(&n_reached), "{n_reached}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn garbage_is_refused_before_it_is_decoded() {
    const N_FLOOD: u64 = 1000;
    let cluster = Cluster::start().await;
    let (entered, mut inside) = tokio::sync::mpsc::unbounded_channel();
    let (leave, exit) = mpsc::channel::<()>();
    let exit = Mutex::new(exit);
    let learner = Learner::start(&cluster.router, move |_| {
        entered.send(()).unwrap();
        exit.lock().unwrap().recv().unwrap();
        Ok(())
    })
    .await;
    let sender = Arc::new(sender(&cluster.client().await, "a").await);
    let honest = tokio::spawn({
        let sender = sender.clone();
        async move { sender.send(&samples::running("a", 0)).await }
    });
    within("the handler", inside.recv()).await.unwrap();

    // Nothing is decoded while the handler does not return, and the queue has room for 256.
    let script = cluster.script().await;
    let mut n_told = 0;
    for _ in 0..N_FLOOD {
        let replies = script.get("lodestone/default/ingest/x").payload("garbage").await.unwrap();
        n_told += u64::from(within("the end of a query", replies.recv_async()).await.is_ok());
    }
    let counts = learner.server.counts();
    assert_eq!((counts.received_total, counts.invalid_total, counts.full_total), (N_FLOOD + 1, N_FLOOD, 0));
    assert!((1..N_FLOOD).contains(&n_told), "{n_told}");
    (0..2).for_each(|_| leave.send(()).unwrap());
    // The flood may last longer than a sender waits.
    let answer = within("an answer", honest).await.unwrap();
    assert!(matches!(answer, Ok(_) | Err(SendError::NoReply)), "{answer:?}");
    within("an ack", sender.send(&samples::running("a", 1))).await.unwrap();
    assert_eq!(learner.server.counts().accepted_total, 2);
}

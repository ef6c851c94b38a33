//! Metrics are plain JSON for anybody, live and afterwards.

use bus::MetricsSample;
use proto::keys;
use proto::metrics::{EvalGroup, EvalOutcome};
use proto::wilson::SuccessRate;
use serde_json::{Value, json};

use crate::cluster::{Cluster, within};

#[tokio::test(flavor = "multi_thread")]
async fn a_session_without_our_schema_reads_metrics() {
    let cluster = Cluster::start().await;
    let evaluator = cluster.client().await;
    let publisher = evaluator.metrics_publisher(keys::METRICS_EVAL_SUMMARY).await.unwrap();
    let mode = EvalOutcome { success: SuccessRate::new(36, 40), ..EvalOutcome::default() };
    let group = EvalGroup { n_blueprints: 1, mode, ..EvalGroup::default() };
    publisher.put(&group).await.unwrap();

    // Asked for: the latest, although nobody listened when it was put.
    let stranger = cluster.stranger().await;
    let replies = stranger.get("lodestone/default/metrics/**").await.unwrap();
    let reply = within("the latest", replies.recv_async()).await.unwrap();
    let sample = reply.result().unwrap();
    assert_eq!(sample.encoding().to_string(), "application/json");
    assert_eq!(sample.key_expr().as_str(), "lodestone/default/metrics/eval/summary");
    let value: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
    assert_eq!(value["n_blueprints"], json!(1));
    assert_eq!(value["mode"]["success"]["rate"], json!(0.9));
    assert_eq!(serde_json::from_value::<EvalGroup>(value).unwrap(), group);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_gets_the_latest_and_then_what_comes() {
    let cluster = Cluster::start().await;
    let bus = cluster.client().await;
    let publisher = bus.metrics_publisher("actor/a").await.unwrap();
    publisher.put(&json!({ "n": 1 })).await.unwrap();
    publisher.put(&json!({ "n": 2 })).await.unwrap();

    let mut reader = cluster.client().await.metrics_subscriber("actor/*").await.unwrap();
    let sample = |n: u64| MetricsSample { suffix: "actor/a".into(), value: json!({ "n": n }) };
    // Values still on their way when the reader subscribes reach it too, so the query's answer may be neither the first
    // nor the only one of its kind.
    let in_flight = [sample(1), sample(2)];
    let mut latest = within("the latest", reader.recv()).await.unwrap();
    while latest != sample(2) {
        assert!(in_flight.contains(&latest), "{latest:?}");
        latest = within("the latest", reader.recv()).await.unwrap();
    }
    publisher.put(&json!({ "n": 3 })).await.unwrap();
    let mut next = within("the next", reader.recv()).await.unwrap();
    while next != sample(3) {
        assert!(in_flight.contains(&next), "{next:?}");
        next = within("the next", reader.recv()).await.unwrap();
    }
    // Whoever asks again gets the latest again, though nothing new was put.
    reader.ask_latest().await.unwrap();
    let mut again = within("the latest again", reader.recv()).await.unwrap();
    while again != sample(3) {
        assert!(in_flight.contains(&again), "{again:?}");
        again = within("the latest again", reader.recv()).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_json_is_counted() {
    let cluster = Cluster::start().await;
    let mut reader = cluster.router.metrics_subscriber("**").await.unwrap();
    let stranger = cluster.stranger().await;
    stranger.put("lodestone/default/metrics/learner", "not { json").await.unwrap();
    stranger.put("lodestone/default/metrics/learner", "[1]").await.unwrap();
    let sample = within("the valid one", reader.recv()).await.unwrap();
    assert_eq!((sample.suffix.as_str(), sample.value), ("learner", json!([1])));
    assert_eq!(cluster.router.counts().metrics_invalid_total, 1);
}

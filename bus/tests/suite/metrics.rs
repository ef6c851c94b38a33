//! Metrics are plain JSON for any client, live and on request.

use bus::{MetricsSample, MetricsSubscriber};
use proto::keys;
use proto::metrics::{EvalGroup, EvalOutcome};
use proto::wilson::SuccessRate;
use serde_json::{Value, json};

use crate::cluster::{Cluster, within};

#[tokio::test(flavor = "multi_thread")]
async fn plain_zenoh_session_reads_metrics() {
    let cluster = Cluster::start().await;
    let evaluator = cluster.client().await;
    let publisher = evaluator.metrics_publisher(keys::METRICS_EVAL_SUMMARY).await.unwrap();
    let greedy = EvalOutcome { success: SuccessRate::new(36, 40), ..EvalOutcome::default() };
    let group = EvalGroup { n_blueprints: 1, greedy, ..EvalGroup::default() };
    publisher.put(&group).await.unwrap();

    // A query returns the latest value, although there was no subscriber when it was published.
    let script = cluster.script().await;
    // A query reaches only the processes that the router knows by then, so it is repeated until there is an answer.
    let answer = async {
        loop {
            let replies = script.get("lodestone/default/metrics/**").await.unwrap();
            if let Ok(reply) = replies.recv_async().await {
                break reply;
            }
        }
    };
    let reply = within("the latest", answer).await;
    let sample = reply.result().unwrap();
    assert_eq!(sample.encoding().to_string(), "application/json");
    assert_eq!(sample.key_expr().as_str(), "lodestone/default/metrics/eval/summary");
    let value: Value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap();
    assert_eq!(value["n_blueprints"], json!(1));
    assert_eq!(value["greedy"]["success"]["rate"], json!(0.9));
    assert_eq!(serde_json::from_value::<EvalGroup>(value).unwrap(), group);
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_subscriber_gets_the_latest_and_then_new_values() {
    let cluster = Cluster::start().await;
    let bus = cluster.client().await;
    let publisher = bus.metrics_publisher("actor/a").await.unwrap();
    publisher.put(&json!({ "n": 1 })).await.unwrap();
    publisher.put(&json!({ "n": 2 })).await.unwrap();

    let mut reader = cluster.client().await.metrics_subscriber("actor/*").await.unwrap();
    let sample = |n: u64| MetricsSample { suffix: "actor/a".into(), value: json!({ "n": n }) };
    // Values in flight when the reader subscribes reach it too, so the answer to the query may be neither the first nor
    // the only one of its kind.
    let in_flight = [sample(1), sample(2)];
    until_sample(&mut reader, &sample(2), &in_flight).await;
    publisher.put(&json!({ "n": 3 })).await.unwrap();
    until_sample(&mut reader, &sample(3), &in_flight).await;
    // Asking again returns the latest value again, although nothing new was published.
    reader.ask_latest().await.unwrap();
    until_sample(&mut reader, &sample(3), &in_flight).await;
}

/// Waits for a sample, before which there may be others of those in flight.
async fn until_sample(reader: &mut MetricsSubscriber, wanted: &MetricsSample, in_flight: &[MetricsSample]) {
    loop {
        let sample = within("a sample", reader.recv()).await.unwrap();
        if sample == *wanted {
            return;
        }
        assert!(in_flight.contains(&sample), "{sample:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_that_are_not_json_are_counted() {
    let cluster = Cluster::start().await;
    let mut reader = cluster.router.metrics_subscriber("**").await.unwrap();
    let script = cluster.script().await;
    script.put("lodestone/default/metrics/learner", "not { json").await.unwrap();
    script.put("lodestone/default/metrics/learner", "[1]").await.unwrap();
    let sample = within("the valid one", reader.recv()).await.unwrap();
    assert_eq!((sample.suffix.as_str(), sample.value), ("learner", json!([1])));
    assert_eq!(cluster.router.counts().metrics_invalid_total, 1);
}

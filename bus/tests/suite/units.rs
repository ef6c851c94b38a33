//! Evaluation units and their answers across the bus, and invalid ones.

use std::time::Duration;

use proto::codec::{decode_answer, encode_unit};
use proto::unit::{EvalAnswer, EvalUnit};

use crate::cluster::{Cluster, within};
use crate::samples;

#[tokio::test(flavor = "multi_thread")]
async fn unit_is_answered() {
    let cluster = Cluster::start().await;
    let mut server = cluster.client().await.serve_units("helper").await.unwrap();
    let caller = cluster.client().await.worker_caller("helper", Duration::from_secs(300)).await.unwrap();
    let answering = tokio::spawn(async move {
        let call = server.recv().await.unwrap();
        let unit = call.unit.clone();
        call.answer(samples::episodes()).await;
        // A call that is dropped ends without an answer.
        drop(server.recv().await.unwrap());
        unit
    });
    let unit = EvalUnit { weights: Some(samples::weights(4)), ..samples::unit() };
    assert_eq!(within("an answer", caller.run(&unit)).await.unwrap(), samples::episodes());
    assert_eq!(within("no answer", caller.run(&unit)).await.unwrap_err().to_string(), "no answer");
    assert_eq!(within("the unit", answering).await.unwrap(), unit);
}

#[tokio::test(flavor = "multi_thread")]
async fn garbage_unit_is_refused_and_counted() {
    let cluster = Cluster::start().await;
    let bus = cluster.client().await;
    let mut server = bus.serve_units("helper").await.unwrap();
    let script = cluster.script().await;
    let bytes = encode_unit(&samples::unit());
    let serving = tokio::spawn(async move { server.recv().await.map(|call| call.unit) });
    for payload in [b"".as_slice(), b"\xff\xff", &bytes[..bytes.len() / 2]] {
        // There is no answer before the router knows the worker.
        let asked = async {
            loop {
                let replies = script.get("lodestone/default/worker/helper").payload(payload).await.unwrap();
                if let Ok(reply) = replies.recv_async().await {
                    return reply;
                }
            }
        };
        let reply = within("a reply", asked).await;
        let answer = decode_answer(&reply.result().unwrap().payload().to_bytes()).unwrap();
        assert!(matches!(answer, EvalAnswer::Refused(_)), "{answer:?}");
    }
    assert_eq!(bus.counts().queries_invalid_total, 3);
    let _reply = script.get("lodestone/default/worker/helper").payload(bytes).await.unwrap();
    assert_eq!(within("the unit", serving).await.unwrap(), Some(samples::unit()));
}

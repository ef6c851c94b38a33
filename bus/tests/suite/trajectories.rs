//! Every trajectory is answered, and taken once. Actors send copies only while there are viewers.

use std::sync::atomic::{AtomicBool, Ordering};

use bus::{Bus, SendError, TrajectorySender};
use proto::{ActorId, Refusal, Role, Valid, WeightsVersion};

use crate::cluster::{Cluster, Learner, until, within};
use crate::samples;

pub(crate) async fn sender(bus: &Bus, actor: &str) -> TrajectorySender {
    let sender = bus.trajectory_sender(&actor.parse::<ActorId>().unwrap()).await.unwrap();
    within("a learner", sender.wait_for_learner()).await;
    sender
}

#[tokio::test(flavor = "multi_thread")]
async fn trajectory_arrives_whole_and_is_acknowledged() {
    let cluster = Cluster::start().await;
    let learner = Learner::start(&cluster.client().await, |_| Ok(())).await;
    let sender = sender(&cluster.client().await, "a").await;
    for sent in [samples::running("a", 0), samples::successful("a", 1), samples::one_gripper("a", 2)] {
        assert_eq!(within("an ack", sender.send(&sent)).await.unwrap(), WeightsVersion(12));
        assert_eq!(learner.taken.lock().unwrap().last(), Some(&sent));
    }
    assert_eq!(learner.server.counts().accepted_total, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn viewer_gets_copies() {
    let cluster = Cluster::start().await;
    let _learner = Learner::start(&cluster.router, |_| Ok(())).await;
    let sender = sender(&cluster.client().await, "a").await;
    let mut viewer = cluster.client().await.trajectory_viewer().await.unwrap();
    let sent = samples::successful("a", 1);
    // The actor's session hears of the viewer a moment later.
    let copied = async {
        loop {
            tokio::select! {
                copy = viewer.recv() => break copy,
                answer = sender.send(&sent) => drop(answer.unwrap()),
            }
        }
    };
    assert_eq!(within("a copy", copied).await, Some(sent));
}

#[tokio::test(flavor = "multi_thread")]
async fn trajectories_work_within_one_process() {
    let bus = Bus::open(&Valid::default()).await.unwrap();
    let learner = Learner::start(&bus, |_| Ok(())).await;
    let sender = sender(&bus, "a").await;
    within("an ack", sender.send(&samples::running("a", 0))).await.unwrap();
    assert_eq!(learner.seqs(), [0]);
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn refusal_has_its_reason() {
    let cluster = Cluster::start().await;
    let learner = Learner::start(&cluster.router, |t| match t.seq {
        0 => Err(Refusal::Stale),
        1 => Err(Refusal::Full),
        2 => Err(Refusal::Invalid("unknown blueprint".into())),
        _ => Ok(()),
    })
    .await;
    let sender = sender(&cluster.client().await, "a").await;
    for (seq, expected) in
        [(0, Refusal::Stale), (1, Refusal::Full), (2, Refusal::Invalid("unknown blueprint".to_owned()))]
    {
        let answer = within("a refusal", sender.send(&samples::running("a", seq))).await;
        assert!(matches!(&answer, Err(SendError::Refused(refusal)) if *refusal == expected), "{answer:?}");
    }
    within("an ack", sender.send(&samples::running("a", 3))).await.unwrap();
    let counts = learner.server.counts();
    assert_eq!((counts.received_total, counts.accepted_total), (4, 1));
    assert_eq!((counts.stale_total, counts.full_total, counts.invalid_total), (1, 1, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_trajectory_is_refused_before_the_handler() {
    let cluster = Cluster::start().await;
    let learner = Learner::start(&cluster.router, |_| Ok(())).await;
    let sender = sender(&cluster.client().await, "a").await;
    let mut nan = samples::running("a", 0);
    nan.last_scene.blocks[0].position[0] = f32::NAN;
    let of_another = samples::running("b", 0);
    for (trajectory, expected) in
        [(nan, "scene.poses is NaN, expected a number in −1e6..=1e6"), (of_another, "actor b may not send to ingest/a")]
    {
        let answer = within("a refusal", sender.send(&trajectory)).await;
        assert!(
            matches!(&answer, Err(SendError::Refused(Refusal::Invalid(reason))) if reason == expected),
            "{answer:?}"
        );
    }
    assert!(learner.seqs().is_empty());
    assert_eq!(learner.server.counts().invalid_total, 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn retried_trajectory_is_taken_once() {
    let cluster = Cluster::start().await;
    let full = AtomicBool::new(true);
    // The mailbox is full only at the first attempt.
    let learner = Learner::start(&cluster.router, move |_| match full.swap(false, Ordering::Relaxed) {
        true => Err(Refusal::Full),
        false => Ok(()),
    })
    .await;
    let sender = sender(&cluster.client().await, "a").await;
    let trajectory = samples::running("a", 7);
    within("a refusal", sender.send(&trajectory)).await.unwrap_err();
    for _ in 0..3 {
        within("an ack", sender.send(&trajectory)).await.unwrap();
    }
    assert_eq!(learner.seqs(), [7]);
    // The same number from a restarted actor is a new trajectory.
    within("an ack", sender.send(&proto::Trajectory { epoch: trajectory.epoch + 1, ..trajectory })).await.unwrap();
    assert_eq!(learner.seqs(), [7, 7]);
    let counts = learner.server.counts();
    assert_eq!((counts.accepted_total, counts.duplicates_total, counts.full_total), (2, 2, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn first_of_two_live_processes_of_a_name_is_accepted() {
    let cluster = Cluster::start().await;
    let bus = cluster.client().await;
    let watch = bus.alive(Role::Actor).await.unwrap();
    let learner = Learner::start(&bus, |_| Ok(())).await;
    let (first, second) = (cluster.client().await, cluster.client().await);
    let token = first.declare_alive(Role::Actor, "a").await.unwrap();
    until("the first", &mut watch.watch(), |alive| alive.contains("a")).await;
    let senders = [sender(&first, "a").await, sender(&second, "a").await];
    let of = |seq, epoch| proto::Trajectory { epoch, ..samples::running("a", seq) };
    within("an ack", senders[0].send(&of(0, 1))).await.unwrap();
    let answer = within("a refusal", senders[1].send(&of(0, 2))).await;
    assert!(matches!(answer, Err(SendError::Refused(Refusal::NameTaken))), "{answer:?}");
    within("an ack", senders[0].send(&of(1, 1))).await.unwrap();
    // A restarted process with the name, after the token has gone.
    drop(token);
    until("nobody", &mut watch.watch(), |alive| alive.is_empty()).await;
    let _token = second.declare_alive(Role::Actor, "a").await.unwrap();
    until("the second", &mut watch.watch(), |alive| alive.contains("a")).await;
    within("an ack", senders[1].send(&of(0, 2))).await.unwrap();
    let answer = within("a refusal", senders[0].send(&of(2, 1))).await;
    assert!(matches!(answer, Err(SendError::Refused(Refusal::NameTaken))), "{answer:?}");
    let counts = learner.server.counts();
    assert_eq!((counts.received_total, counts.accepted_total, counts.name_taken_total), (5, 3, 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn oversized_trajectory_is_not_sent() {
    let cluster = Cluster::start().await;
    let learner = Learner::start(&cluster.router, |_| Ok(())).await;
    let sender = sender(&cluster.client().await, "a").await;
    let mut huge = samples::running("a", 0);
    // About 1.1 kB per step.
    huge.transitions = vec![huge.transitions[0].clone(); 9000];
    let error = sender.send(&huge).await.unwrap_err().to_string();
    assert!(error.starts_with("a trajectory of ") && error.ends_with("the limit of 8388608 bytes"), "{error}");
    assert_eq!(learner.server.counts().received_total, 0);
}

//! Actors send copies only while there are viewers.

use proto::ActorId;

use crate::cluster::{Cluster, Learner, within};
use crate::samples;
use crate::trajectories::sender;

#[tokio::test(flavor = "multi_thread")]
async fn viewer_gets_copies() {
    let cluster = Cluster::start().await;
    let _learner = Learner::start(&cluster.router, |_| Ok(())).await;
    let sender = sender(&cluster.client().await, "a").await;
    assert!(!sender.viewers_are_there());
    within("an ack", sender.send(&samples::running("a", 0))).await.unwrap();

    let actor: ActorId = "a".parse().unwrap();
    let mut viewer = cluster.client().await.trajectory_viewer(Some(&actor)).await.unwrap();
    within("a viewer", sender.wait_for_viewer()).await;
    let sent = samples::successful("a", 1);
    within("an ack", sender.send(&sent)).await.unwrap();
    assert_eq!(within("a copy", viewer.recv()).await, Some(sent));
}

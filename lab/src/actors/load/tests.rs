//! Simulated actors against a learner that refuses some segments.

use std::sync::atomic::{AtomicU64, Ordering};

use bus::WeightsPublisher;
use proto::{Refusal, Weights, WeightsVersion};
use tokio::sync::{mpsc, watch};

use super::*;
use crate::actors::fingerprint::fingerprint;
use crate::actors::weights::Moment;

#[path = "../../../../proto/src/codec/tests/samples.rs"]
#[expect(dead_code)]
mod samples;

fn segment(n_steps: usize) -> Trajectory {
    let mut segment = samples::running("recorded", 0);
    segment.transitions = vec![segment.transitions[0].clone(); n_steps];
    segment
}

fn weights(version: u64) -> Arc<Weights> {
    Arc::new(samples::weights(version))
}

#[test]
fn segments_are_due_when_their_steps_are_stepped() {
    let script = Script::new(vec![segment(4), segment(2)], 2.0).unwrap();
    // Steps 4, 6, 10, and 12 at two per second.
    let due: Vec<_> = (0..4).map(|seq| script.due(seq).unwrap().as_secs_f64()).collect();
    assert_eq!(due, [2.0, 3.0, 5.0, 6.0]);
    // A segment takes 1.5 s on average.
    let phases: Vec<_> = (0..3).map(|number| script.phase(number).as_secs_f64()).collect();
    assert!(phases[0] == 0.0 && (phases[1] - 0.927).abs() < 1e-3 && (phases[2] - 0.354).abs() < 1e-3, "{phases:?}");
    let fast = Script::new(vec![segment(4)], 0.0).unwrap();
    assert_eq!((fast.due(3), fast.phase(3)), (None, Duration::ZERO));
    assert!(Script::new(Vec::new(), 1.0).is_err());
}

/// Refuses every fifth segment of an actor as stale, and every seventh of the others because of a full mailbox.
fn picky(accepted: mpsc::UnboundedSender<Trajectory>) -> impl Fn(Trajectory) -> Result<(), Refusal> {
    let n_asked = AtomicU64::new(0);
    move |trajectory: Trajectory| {
        if trajectory.seq % 5 == 4 {
            return Err(Refusal::Stale);
        }
        if n_asked.fetch_add(1, Ordering::Relaxed) % 7 == 6 {
            return Err(Refusal::Full);
        }
        accepted.send(trajectory).map_err(|_| Refusal::Full)
    }
}

/// Takes segments, publishes newer weights after 50, and stops the actors once enough have arrived.
async fn receive(
    mut received: mpsc::UnboundedReceiver<Trajectory>,
    publisher: WeightsPublisher,
    stop: CancellationToken,
) -> Vec<Trajectory> {
    let mut taken = Vec::new();
    let mut n_newer = 0;
    while let Some(trajectory) = received.recv().await {
        n_newer += usize::from(trajectory.weights_version.0 == 4);
        taken.push(trajectory);
        if taken.len() == 50 {
            publisher.publish(weights(4)).await.unwrap();
        }
        // Only an actor that has pulled the newer weights sends under their version.
        if taken.len() >= 100 && n_newer >= 20 {
            stop.cancel();
        }
    }
    taken
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn both_ends_count_the_same_segments() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let (accepted, received) = mpsc::unbounded_channel();
    let (_version, current_version) = watch::channel(WeightsVersion(3));
    let server = bus.serve_trajectories(picky(accepted), current_version).await.unwrap();
    let publisher = bus.weights_publisher().await.unwrap();
    publisher.publish(weights(3)).await.unwrap();

    let plan = LoadPlan {
        bus: BusConfig::clone(&BusConfig::isolated_client(dir.path())),
        first_actor: 10,
        n_actors: 3,
        steps_per_s: 0.0,
    };
    let load = Load::open(plan).await.unwrap();
    assert_eq!((load.n_actors(), load.shortfall()), (3, None));
    let stop = CancellationToken::new();
    let receiving = tokio::spawn(receive(received, publisher, stop.clone()));
    let running = load.run(vec![segment(4), segment(2)], stop);
    let report = tokio::time::timeout(Duration::from_secs(60), running).await.expect("enough arrives in time").unwrap();
    load.close().await;
    let counts = server.counts();
    drop(server);
    bus.close().await;
    let taken = receiving.await.unwrap();

    assert_eq!((report.counts.invalid_total, &report.counts.first_error), (0, &None));
    assert_eq!((report.n_actors, report.counts.in_doubt_total, report.counts.unsent_total), (3, 0, 0));
    let ends = [report.counts.acked_total, counts.accepted_total, taken.len() as u64];
    assert_eq!(ends, [ends[0]; 3]);
    let sum = taken.iter().fold(0_u64, |sum, trajectory| sum.wrapping_add(fingerprint(trajectory)));
    assert_eq!(report.counts.acked_fingerprints, sum);
    let n_steps: usize = taken.iter().map(|trajectory| trajectory.transitions.len()).sum();
    assert_eq!(report.counts.acked_steps_total, n_steps as u64);
    assert_eq!((report.counts.stale_total, report.counts.full_total), (counts.stale_total, counts.full_total));
    assert!(report.counts.stale_total > 0 && report.counts.full_total > 0);
    assert_eq!(report.counts.ack_latency.n, report.counts.acked_total);
    let versions = |pulls: &Vec<Moment>| pulls.iter().map(|pull| pull.version).collect::<Vec<_>>();
    assert!(report.pulls.iter().any(|pulls| versions(pulls) == [3, 4]), "{:?}", report.pulls);
}

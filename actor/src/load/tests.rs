//! Simulated actors against a learner that refuses some segments.

use std::sync::atomic::{AtomicU64, Ordering};

use blueprints::BlockIdx;
use proto::{BehaviorPolicy, Refusal, Status, Transition, WeightsVersion};
use tokio::sync::{mpsc, watch};

use super::*;
use crate::segment::{Cut, SegmentBuilder};
use crate::toy;

/// Returns a segment of `n_steps` steps.
fn segment(n_steps: usize) -> Trajectory {
    let mut builder = SegmentBuilder::new(n_steps, toy::task(), BehaviorPolicy::Sampled);
    for _ in 0..n_steps {
        let transition = Transition {
            scene: toy::scene(),
            action: proto::Action {
                choices: [BlockIdx::try_from(0).ok(), BlockIdx::try_from(1).ok()],
                moves: [[0.0; 6]; 16],
            },
            proposals: [None; 2],
            behavior_log_prob: 0.0,
            reward: Default::default(),
        };
        let cut = builder.push(transition, WeightsVersion(0), &toy::scene(), Status::Running, &toy::identity());
        if let Cut::Segment(segment) = cut {
            return *segment;
        }
    }
    panic!("a segment is complete after its last step")
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

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn both_ends_count_the_same_segments() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let (accepted, mut received) = mpsc::unbounded_channel();
    let n_asked = AtomicU64::new(0);
    let handler = move |trajectory: Trajectory| {
        if trajectory.seq % 5 == 4 {
            return Err(Refusal::Stale);
        }
        if n_asked.fetch_add(1, Ordering::Relaxed) % 7 == 6 {
            return Err(Refusal::Full);
        }
        accepted.send(trajectory).map_err(|_| Refusal::Full)
    };
    let (_version, current_version) = watch::channel(WeightsVersion(3));
    let server = bus.serve_trajectories(handler, current_version).await.unwrap();
    let publisher = bus.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(toy::weights(3, 1.0))).await.unwrap();

    let plan = LoadPlan {
        bus: BusConfig::isolated_client(dir.path()),
        first_actor: 10,
        n_actors: 3,
        steps_per_s: 0.0,
        n_outstanding: 2,
        metrics_period_ms: 50,
        drain_timeout_ms: 60_000,
    };
    let load = Load::open(plan).await.unwrap();
    assert_eq!((load.n_actors(), load.shortfall()), (3, None));
    let stop = CancellationToken::new();
    let stopping = stop.clone();
    let receiving = tokio::spawn(async move {
        let (mut taken, mut n_newer) = (Vec::new(), 0);
        while let Some(trajectory) = received.recv().await {
            n_newer += usize::from(trajectory.weights_version.0 == 4);
            taken.push(trajectory);
            if taken.len() == 50 {
                publisher.publish(Arc::new(toy::weights(4, 1.0))).await.unwrap();
            }
            // Only an actor that has pulled the newer weights sends under their version.
            if taken.len() >= 100 && n_newer >= 20 {
                stopping.cancel();
            }
        }
        taken
    });
    let running = load.run(vec![segment(4), segment(2)], stop);
    let report = tokio::time::timeout(Duration::from_secs(60), running).await.expect("enough arrives in time").unwrap();
    load.close().await;
    let counts = server.counts();
    server.close().await.unwrap();
    bus.close().await;
    let taken = receiving.await.unwrap();

    assert_eq!((report.counts.invalid_total, &report.counts.first_error), (0, &None));
    assert!(report.drained && report.n_actors == 3);
    let ends = [report.counts.acked_total, counts.accepted_total, taken.len() as u64];
    assert_eq!(ends, [ends[0]; 3]);
    let sum = taken.iter().fold(0_u64, |sum, trajectory| sum.wrapping_add(trajectory.fingerprint()));
    assert_eq!(report.counts.acked_fingerprints, sum);
    let n_steps: usize = taken.iter().map(|trajectory| trajectory.transitions.len()).sum();
    assert_eq!(report.counts.acked_steps_total, n_steps as u64);
    assert_eq!((report.counts.stale_total, report.counts.full_total), (counts.stale_total, counts.full_total));
    assert!(report.counts.stale_total > 0 && report.counts.full_total > 0);
    assert_eq!(report.counts.ack_latency.n(), report.counts.acked_total);
    let versions = |pulls: &Vec<Pull>| pulls.iter().map(|pull| pull.version).collect::<Vec<_>>();
    assert!(report.pulls.iter().any(|pulls| versions(pulls) == [3, 4]), "{:?}", report.pulls);
}

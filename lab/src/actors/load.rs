//! Simulated actors that step no worlds. They send recorded segments and pull weights as real actors do, so that bus
//! and learner can be measured without the processors of a cluster.
//!
//! Each has its own session, name, and sequence numbers, and as many attempts in flight as a real one. A segment is
//! sent again if the learner's mailbox is full or there is no answer.

mod histogram;
mod member;
mod tally;

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use bus::{Bus, BusConfig};
use proto::codec::encode_trajectory;
use proto::{Trajectory, Valid};
use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use self::histogram::Histogram;
use self::member::Member;
use self::tally::Tally;
pub(super) use self::tally::{LoadCounts, LoadReport};

/// Maximum time for an actor to join and receive its first weights. A router without room for another session never
/// answers.
const JOIN_TIMEOUT: Duration = Duration::from_secs(150);

/// Maximum time to wait for answers at the end.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(60);

/// Configuration of the simulated actors in one process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct LoadPlan {
    /// How each actor joins the bus.
    pub(super) bus: BusConfig,
    /// Number of the first actor, which makes names unique across processes.
    pub(super) first_actor: usize,
    /// Number of actors, at least 1.
    pub(super) n_actors: usize,
    /// Steps per second of each actor; 0 sends as fast as answers arrive.
    pub(super) steps_per_s: f64,
}

/// Simulated actors that have joined the bus.
#[derive(Debug)]
pub(super) struct Load {
    plan: LoadPlan,
    members: Vec<Arc<Member>>,
    /// Why fewer joined than planned.
    shortfall: Option<String>,
}

/// What all actors of a process send, and when.
#[derive(Debug)]
pub(super) struct Script {
    segments: Vec<Trajectory>,
    /// Encoded size of each segment, with a name and numbers of typical length.
    n_bytes: Vec<usize>,
    /// Number of steps before each segment; `n_steps` is the total.
    steps_before: Vec<u64>,
    n_steps: u64,
    steps_per_s: f64,
}

impl Load {
    /// Lets the actors join and receive their first weights one after another, until one finds no room.
    ///
    /// One at a time, so that a router need not accept them all at once, which is a different test.
    ///
    /// # Errors
    /// If the first actor cannot join, or the learner sends no weights.
    pub(super) async fn open(plan: LoadPlan) -> anyhow::Result<Self> {
        let mut members = Vec::with_capacity(plan.n_actors);
        let mut shortfall = None;
        for number in plan.first_actor..plan.first_actor + plan.n_actors {
            let joining = async {
                let member = Member::join(number, Bus::open(&Valid::new(plan.bus.clone())?).await?).await?;
                member.first_weights().await?;
                Ok(member)
            };
            let joined = tokio::time::timeout(JOIN_TIMEOUT, joining)
                .await
                .unwrap_or_else(|_| Err(anyhow::anyhow!("actor {number} had no weights after {JOIN_TIMEOUT:?}")));
            match joined {
                Ok(member) => members.push(Arc::new(member)),
                Err(error) if members.is_empty() => return Err(error),
                Err(error) => {
                    shortfall = Some(format!("{error:#}"));
                    break;
                }
            }
        }
        Ok(Self { plan, members, shortfall })
    }

    /// Returns the number of actors that have joined.
    pub(super) fn n_actors(&self) -> usize {
        self.members.len()
    }

    /// Returns why fewer have joined than planned.
    pub(super) fn shortfall(&self) -> Option<&str> {
        self.shortfall.as_deref()
    }

    /// Sends `segments` over and over, under the actors' names and numbers, until `stop`. Then waits for answers up to a
    /// minute for answers.
    ///
    /// # Errors
    /// If there is nothing to send, or a task panicked.
    pub(super) async fn run(&self, segments: Vec<Trajectory>, stop: CancellationToken) -> anyhow::Result<LoadReport> {
        let script = Arc::new(Script::new(segments, self.plan.steps_per_s)?);
        let (start, give_up) = (Instant::now(), CancellationToken::new());
        let mut tasks = JoinSet::new();
        let mut watchers = JoinSet::new();
        for member in &self.members {
            let tally = Arc::new(Tally::default());
            let start = start + script.phase(member.number());
            for _ in 0..actor::N_OUTSTANDING {
                let (member, script, tally) = (member.clone(), script.clone(), tally.clone());
                let (stop, give_up) = (stop.clone(), give_up.clone());
                tasks.spawn(async move { member.send_all(&script, start, &tally, &stop, &give_up).await });
            }
            let (member, give_up) = (member.clone(), give_up.clone());
            watchers.spawn(async move {
                let pulls = member.watch_and_report(&tally, &give_up).await;
                (tally, pulls)
            });
        }
        stop.cancelled().await;
        let elapsed = start.elapsed();
        let drained = async { while tasks.join_next().await.is_some() {} };
        // Afterwards, the tasks count what still has no answer.
        let _: Result<(), _> = tokio::time::timeout(DRAIN_TIMEOUT, drained).await;
        give_up.cancel();
        while let Some(ended) = tasks.join_next().await {
            ended.context("a simulated actor panicked")?;
        }
        let mut report = LoadReport { elapsed_s: elapsed.as_secs_f64(), ..LoadReport::default() };
        while let Some(ended) = watchers.join_next().await {
            let (tally, pulls) = ended.context("a simulated actor panicked")?;
            report.n_actors += 1;
            report.counts.add(&tally.take());
            report.pulls.push(pulls);
        }
        for member in &self.members {
            report.pulls_failed_total += member.counts().pulls_failed_total;
            report.weights_invalid_total += member.counts().weights_invalid_total;
        }
        Ok(report)
    }

    /// Leaves the bus.
    pub(super) async fn close(self) {
        for member in &self.members {
            member.close().await;
        }
    }
}

impl Script {
    fn new(segments: Vec<Trajectory>, steps_per_s: f64) -> anyhow::Result<Self> {
        anyhow::ensure!(!segments.is_empty(), "there are no segments to send");
        let mut n_steps = 0;
        let mut steps_before = Vec::with_capacity(segments.len());
        for segment in &segments {
            steps_before.push(n_steps);
            n_steps += segment.transitions.len() as u64;
        }
        let n_bytes = segments.iter().map(|segment| encode_trajectory(segment).len()).collect();
        Ok(Self { segments, n_bytes, steps_before, n_steps, steps_per_s })
    }

    fn n_bytes(&self, seq: u64) -> usize {
        self.n_bytes[(seq % self.n_bytes.len() as u64) as usize]
    }

    /// Returns the segment with this sequence number; segments repeat in order.
    fn segment(&self, seq: u64) -> &Trajectory {
        &self.segments[(seq % self.segments.len() as u64) as usize]
    }

    /// Returns the time from the start until an actor has stepped the segment with this number; `None` at full speed.
    fn due(&self, seq: u64) -> Option<Duration> {
        let n_segments = self.segments.len() as u64;
        let index = (seq % n_segments) as usize;
        let steps =
            seq / n_segments * self.n_steps + self.steps_before[index] + self.segments[index].transitions.len() as u64;
        (self.steps_per_s > 0.0).then(|| Duration::from_secs_f64(steps as f64 / self.steps_per_s))
    }

    /// Returns how much later than others an actor starts, which spreads the actors evenly over the time of one
    /// segment.
    fn phase(&self, number: usize) -> Duration {
        const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;
        let mean_period = self.n_steps as f64 / self.segments.len() as f64 / self.steps_per_s;
        let share = (number as f64 * GOLDEN_RATIO).fract();
        if self.steps_per_s > 0.0 { Duration::from_secs_f64(share * mean_period) } else { Duration::ZERO }
    }
}

#[cfg(test)]
mod tests;

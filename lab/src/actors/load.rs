//! Simulated actors that step no worlds. They send recorded segments and pull weights as real actors do, so that bus
//! and learner can be measured without the processors of a cluster.
//!
//! Each has its own session, name, and sequence numbers, and as many attempts in flight as a real one. A segment is
//! sent again if the learner's mailbox is full or there is no answer.

mod histogram;
mod member;
mod script;
mod tally;

use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use bus::{Bus, BusConfig};
use proto::{Trajectory, Valid};
use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use self::member::Member;
use self::script::Script;
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

#[cfg(test)]
mod tests;

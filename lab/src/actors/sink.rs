//! A learner that computes nothing: it accepts trajectories through a real mailbox, drains it in batches as updates
//! would, and publishes weights at intervals. It measures the throughput of the bus and of ingest.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context;
use bus::{AliveToken, Bus, TrajectoryServer, WeightsPublisher};
use learner::{Learner, Mailbox, MailboxCounts};
use proto::metrics::IngestCounts;
use proto::{Role, Trajectory, Weights, WeightsVersion};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::fingerprint::fingerprint;
use super::weights::Moment;

/// Interval at which the draining thread checks for shutdown while it waits for a batch.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// The settings of a sink.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SinkPlan {
    /// Steps per update.
    pub(super) batch_size: usize,
    /// Number of parameters of the published weights; `None` for the size of the network.
    pub(super) n_parameters: Option<usize>,
    /// Interval between publications, milliseconds; 0 publishes only the first weights.
    pub(super) publish_every_ms: u64,
}

/// The result of a sink.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct SinkReport {
    /// All messages, by result.
    pub(super) ingest: IngestCounts,
    /// Valid messages, by result.
    pub(super) mailbox: MailboxCounts,
    /// Trajectories taken by updates.
    pub(super) taken_total: u64,
    /// Trajectories not taken by any update.
    pub(super) waiting_total: u64,
    /// Number of updates.
    pub(super) updates_total: u64,
    /// Wrapping sum of the [`fingerprint`]s of the accepted trajectories.
    pub(super) accepted_fingerprints: u64,
    /// The published weights, each with the time before its encoding.
    pub(super) published: Vec<Moment>,
    /// Queries for weights refused because too many came.
    pub(super) queries_dropped_total: u64,
}

/// A running sink.
#[derive(Debug)]
pub(super) struct Sink {
    plan: SinkPlan,
    bus: Bus,
    mailbox: Arc<Mailbox>,
    server: TrajectoryServer,
    publisher: WeightsPublisher,
    version: watch::Sender<WeightsVersion>,
    weights: Arc<Weights>,
    published: Vec<Moment>,
    fingerprints: Arc<AtomicU64>,
    drain: Drain,
    _alive: AliveToken,
}

impl Sink {
    /// Starts accepting trajectories as `learner` would, and publishes its weights once.
    ///
    /// # Errors
    /// If the session fails or the thread cannot be started.
    pub(super) async fn open(learner: &Learner, plan: SinkPlan, bus: &Bus) -> anyhow::Result<Self> {
        let mut weights = learner.weights();
        if let Some(n_parameters) = plan.n_parameters {
            weights.parameters.resize(n_parameters, 0.0);
        }
        let (version, current_version) = watch::channel(weights.version);
        let mailbox = learner.mailbox();
        let fingerprints = Arc::new(AtomicU64::new(0));
        let (inbox, sum) = (mailbox.clone(), fingerprints.clone());
        let handler = move |trajectory: Trajectory| {
            let own = fingerprint(&trajectory);
            inbox.push(trajectory)?;
            sum.fetch_add(own, Ordering::Relaxed);
            Ok(())
        };
        let mut sink = Self {
            _alive: bus.declare_alive(Role::Learner, "learner").await?,
            publisher: bus.weights_publisher().await?,
            server: bus.serve_trajectories(handler, current_version).await?,
            drain: Drain::start(mailbox.clone(), plan.batch_size)?,
            bus: bus.clone(),
            plan,
            mailbox,
            version,
            weights: Arc::new(weights),
            published: Vec::new(),
            fingerprints,
        };
        sink.publish().await?;
        Ok(sink)
    }

    /// Publishes newer weights at intervals until `stop`.
    ///
    /// # Errors
    /// If the session fails.
    pub(super) async fn publish_until(&mut self, stop: &CancellationToken) -> anyhow::Result<()> {
        let period = Duration::from_millis(self.plan.publish_every_ms);
        loop {
            tokio::select! {
                () = stop.cancelled() => return Ok(()),
                () = tokio::time::sleep(period), if !period.is_zero() => {}
            }
            let next = WeightsVersion(self.weights.version.0 + 1);
            Arc::make_mut(&mut self.weights).version = next;
            self.mailbox.set_version(next);
            self.version.send_replace(next);
            self.publish().await?;
        }
    }

    /// Stops the sink and returns the result.
    ///
    /// # Errors
    /// If the draining thread panicked.
    pub(super) fn close(self) -> anyhow::Result<SinkReport> {
        let ingest = self.server.counts();
        drop(self.server);
        let (taken_total, updates_total) = self.drain.stop()?;
        let (mailbox, waiting) = self.mailbox.snapshot();
        Ok(SinkReport {
            ingest,
            mailbox,
            taken_total,
            waiting_total: waiting.len() as u64,
            updates_total,
            accepted_fingerprints: self.fingerprints.load(Ordering::Relaxed),
            published: self.published,
            queries_dropped_total: self.bus.counts().queries_dropped_total,
        })
    }

    async fn publish(&mut self) -> anyhow::Result<()> {
        self.published.push(Moment::now(self.weights.version));
        Ok(self.publisher.publish(self.weights.clone()).await?)
    }
}

/// The thread that drains the mailbox in batches.
#[derive(Debug)]
struct Drain {
    stop: CancellationToken,
    thread: JoinHandle<(u64, u64)>,
}

impl Drain {
    fn start(mailbox: Arc<Mailbox>, n_steps: usize) -> anyhow::Result<Self> {
        let stop = CancellationToken::new();
        let stopped = stop.clone();
        let drain = move || {
            let (mut n_taken, mut n_updates) = (0, 0);
            while !stopped.is_cancelled() {
                if mailbox.wait(n_steps, POLL_INTERVAL) {
                    n_taken += mailbox.take(n_steps).len() as u64;
                    n_updates += 1;
                }
            }
            (n_taken, n_updates)
        };
        let thread = std::thread::Builder::new().name("drain".to_owned()).spawn(drain).context("starting the drain")?;
        Ok(Self { stop, thread })
    }

    fn stop(self) -> anyhow::Result<(u64, u64)> {
        self.stop.cancel();
        self.thread.join().map_err(|_| anyhow::anyhow!("the draining thread panicked"))
    }
}

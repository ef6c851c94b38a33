//! The child processes of a measurement. Each reads its plan and its orders from stdin, one per line, and writes notes
//! to stdout.

use std::io::{self, BufRead, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use blueprints::{Catalog, outside};
use bus::{Bus, BusConfig};
use deploy::commands::learner_setup;
use deploy::config::{DEFAULTS, merge};
use deploy::exit::Failure;
use learner::Learner;
use proto::codec::{MAX_RECORDING_BYTES, decode_recording};
use proto::{Trajectory, Valid};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::load::{Load, LoadPlan, LoadReport};
use super::sink::{Sink, SinkPlan, SinkReport};

/// Plan of the ingest process.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct IngestPlan {
    /// The learner's configuration, as TOML.
    pub(super) config: String,
    pub(super) bus: BusConfig,
    pub(super) sink: SinkPlan,
}

/// Plan of a process with actors.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct LoadOrder {
    pub(super) load: LoadPlan,
    /// Files with one segment each.
    pub(super) segments: Vec<PathBuf>,
}

/// An order to a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Order {
    /// Begin.
    Go,
    /// Stop and report.
    Stop,
}

/// A note from a process.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Note {
    /// The process waits for [`Order::Go`].
    Ready {
        /// Actors that have joined; 0 for the ingest.
        n_actors: usize,
        /// Why fewer actors have joined than planned.
        shortfall: Option<String>,
    },
    /// What the ingest received.
    Sank(SinkReport),
    /// What the actors sent.
    Sent(LoadReport),
}

/// Runs `lab router`: like `lodestone router`, but exits with the process that measures.
pub(crate) async fn router(shutdown: CancellationToken) -> Result<(), Failure> {
    let mut orders = Orders::open(&shutdown);
    let plan = orders.plan().await?;
    let Some(bus) = orders.join(&plan).await? else { return Ok(()) };
    orders.gone.cancelled().await;
    bus.close().await;
    Ok(())
}

/// Runs `lab ingest`.
pub(crate) async fn ingest(shutdown: CancellationToken) -> Result<(), Failure> {
    let mut orders = Orders::open(&shutdown);
    let plan: IngestPlan = orders.plan().await?;
    let config = merge(&plan.config, "the plan", &DEFAULTS, &[])?.checked()?;
    let learner = Learner::new(learner_setup(&config, None, Catalog::builtin())?).map_err(anyhow::Error::new)?;
    let Some(bus) = orders.join(&plan.bus).await? else { return Ok(()) };
    let mut sink = Sink::open(&learner, plan.sink, &bus).await?;
    say(&Note::Ready { n_actors: 0, shortfall: None })?;
    if orders.next().await == Some(Order::Go) {
        let stop = orders.stop();
        sink.publish_until(&stop).await?;
    }
    say(&Note::Sank(sink.close()?))?;
    bus.close().await;
    Ok(())
}

/// Runs `lab load`.
pub(crate) async fn load(shutdown: CancellationToken) -> Result<(), Failure> {
    let mut orders = Orders::open(&shutdown);
    let LoadOrder { load: plan, segments } = orders.plan().await?;
    let segments = segments.iter().map(|path| read_segment(path)).collect::<anyhow::Result<Vec<Trajectory>>>()?;
    let gone = orders.gone.clone();
    let measure = async {
        let load = Load::open(plan).await?;
        say(&Note::Ready { n_actors: load.n_actors(), shortfall: load.shortfall().map(str::to_owned) })?;
        if orders.next().await == Some(Order::Go) {
            let stop = orders.stop();
            say(&Note::Sent(load.run(segments, stop).await?))?;
        }
        load.close().await;
        Ok(())
    };
    // Nobody waits for the report of a measurement that was ended.
    tokio::select! {
        () = gone.cancelled() => Ok(()),
        measured = measure => measured,
    }
}

fn read_segment(path: &Path) -> anyhow::Result<Trajectory> {
    let context = || format!("reading {}", path.display());
    let bytes = outside::read(path, MAX_RECORDING_BYTES as u64).with_context(context)?;
    decode_recording(&bytes).with_context(context)
}

/// Writes a note to stdout, where the parent process reads it.
fn say(note: &Note) -> anyhow::Result<()> {
    let line = serde_json::to_string(note).context("a note is JSON")?;
    writeln!(io::stdout(), "{line}").context("the process that measures is gone")
}

/// The lines of stdin. End of file is an order to stop, so that no process outlives the one that measures.
struct Orders {
    lines: mpsc::UnboundedReceiver<String>,
    /// Canceled when the process shuts down and at the end of stdin.
    gone: CancellationToken,
}

impl Orders {
    fn open(shutdown: &CancellationToken) -> Self {
        let (sender, lines) = mpsc::unbounded_channel();
        let gone = shutdown.child_token();
        let ended = gone.clone();
        // On a separate thread, because a blocking read of stdin cannot be canceled and the runtime would wait for it.
        std::thread::spawn(move || {
            for line in io::stdin().lock().lines() {
                let Ok(line) = line else { break };
                if sender.send(line).is_err() {
                    return;
                }
            }
            ended.cancel();
        });
        Self { lines, gone }
    }

    async fn plan<T: DeserializeOwned>(&mut self) -> anyhow::Result<T> {
        let line = tokio::select! {
            () = self.gone.cancelled() => None,
            line = self.lines.recv() => line,
        };
        let line = line.context("stdin ended before the plan; `lab actors` starts this process")?;
        serde_json::from_str(&line).context("reading the plan")
    }

    /// Joins the bus; `None` if the process shall end before a router answers.
    async fn join(&self, config: &BusConfig) -> anyhow::Result<Option<Bus>> {
        let config = Valid::new(config.clone())?;
        tokio::select! {
            () = self.gone.cancelled() => Ok(None),
            bus = Bus::open(&config) => Ok(Some(bus?)),
        }
    }

    async fn next(&mut self) -> Option<Order> {
        tokio::select! {
            () = self.gone.cancelled() => None,
            line = self.lines.recv() => serde_json::from_str(&line?).ok(),
        }
    }

    /// Returns a token that is canceled by the next line, by the end of stdin, and on shutdown.
    fn stop(mut self) -> CancellationToken {
        let stop = CancellationToken::new();
        let cancel = stop.clone();
        tokio::spawn(async move {
            self.next().await;
            cancel.cancel();
        });
        stop
    }
}

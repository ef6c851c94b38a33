//! `lab actors`: starts the processes, lets them run, and compares the counts of both ends.

mod children;
mod fingerprint;
mod load;
pub(crate) mod parts;
mod record;
mod report;
mod sink;
mod text;
mod usage;
mod weights;

use proto::Valid;
use std::net::TcpListener;
use std::path::Path;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use anyhow::Context;
use bus::{BusConfig, BusMode};
use deploy::config::Config;
use deploy::exit::Failure;
use deploy::live::Terminal;
use rustix::process::{Resource, getrlimit};
use tempfile::TempDir;

use self::children::Part;
use self::load::{LoadPlan, LoadReport};
use self::parts::{IngestPlan, LoadOrder, Note, Order};
use self::record::{Recording, record};
use self::report::{Report, Roles, Used};
use self::sink::SinkPlan;
use self::usage::{MemoryCurve, cpu_s, loopback_bytes};
use crate::cli::{ActorsArgs, Transport};

/// Default number of actors per process.
const ACTORS_PER_PROCESS: u32 = 1000;

/// Time between memory samples.
const SAMPLE_PERIOD: Duration = Duration::from_secs(1);

/// Time limit for a process to become ready or to report, not counting [`PATIENCE_PER_ACTOR`].
const READY_PATIENCE: Duration = Duration::from_secs(330);

/// Additional time limit per actor for joining.
const PATIENCE_PER_ACTOR: Duration = Duration::from_millis(200);

/// Runs the measurement.
///
/// # Errors
/// When a process cannot be started or fails, or an acknowledged segment was lost.
pub(crate) fn run(args: &ActorsArgs, terminal: &Terminal) -> anyhow::Result<()> {
    let config = args.config.load(None, Vec::new()).map_err(Failure::from)?.config;
    if args.config.print_config {
        terminal.print(&config.to_toml());
        return Ok(());
    }
    if args.processes.is_some_and(|n| n < args.leaves || n > args.actors) {
        return Err(Failure::Usage("--processes: expected at least --leaves and at most --actors".to_owned()).into());
    }
    let folder = tempfile::tempdir().context("making a folder for segments and sockets")?;
    tracing::info!("recording segments");
    let recording = record(&config, folder.path())?;
    let ring = Ring::start(args, &config, &recording, folder)?;
    if let Some(shortfall) = &ring.shortfall {
        let limit = getrlimit(Resource::Nofile).maximum;
        let n_files = limit.map_or_else(|| "any number of".to_owned(), |n| n.to_string());
        tracing::warn!(
            "{} of {} actors have joined; each process may open {n_files} files. {shortfall}",
            ring.n_actors,
            args.actors
        );
    }
    let report = ring.measure(args, &recording)?;
    let shown = if args.json {
        serde_json::to_string_pretty(&report).context("a report is JSON")?
    } else {
        text::render(&report)
    };
    terminal.print(&shown);
    anyhow::ensure!(report.reconciled.agrees, "the counts of both ends contradict each other");
    Ok(())
}

/// All processes of a measurement.
struct Ring {
    routers: Vec<Part>,
    ingest: Part,
    loads: Vec<Part>,
    n_actors: usize,
    shortfall: Option<String>,
    _folder: TempDir,
}

impl Ring {
    fn start(
        args: &ActorsArgs,
        config: &Valid<Config>,
        recording: &Recording,
        folder: TempDir,
    ) -> anyhow::Result<Self> {
        let (root, routers, doors) = match &args.connect {
            Some(endpoint) => (endpoint.clone(), Vec::new(), vec![endpoint.clone()]),
            None => start_routers(args, folder.path())?,
        };
        let bus = |endpoint: &str| BusConfig {
            mode: BusMode::Client,
            connect: vec![endpoint.to_owned()],
            listen: Vec::new(),
            ..config.bus.clone()
        };
        let sink = SinkPlan {
            batch_size: config.learner.batch_size,
            n_parameters: args.weights_bytes.map(|bytes| bytes as usize / size_of::<f32>()),
            publish_every_ms: (args.weights_every * 1000.0) as u64,
        };
        let mut ingest = Part::start("ingest", "ingest")?;
        ingest.tell(&IngestPlan { config: config.to_toml(), bus: bus(&root), sink })?;
        expect_ready(&ingest, READY_PATIENCE)?;

        let n_processes = args.processes.unwrap_or_else(|| args.actors.div_ceil(ACTORS_PER_PROCESS).max(args.leaves));
        let n_processes = n_processes.min(args.actors) as usize;
        let mut loads = Vec::new();
        for i in 0..n_processes {
            let [first, next] = [i, i + 1].map(|i| i * args.actors as usize / n_processes);
            let load = LoadPlan {
                bus: bus(&doors[i % doors.len()]),
                first_actor: first,
                n_actors: next - first,
                steps_per_s: args.rate,
            };
            let mut part = Part::start(format!("process {i} of actors"), "load")?;
            part.tell(&LoadOrder { load, segments: recording.files.clone() })?;
            loads.push(part);
        }
        let patience = READY_PATIENCE + PATIENCE_PER_ACTOR * args.actors;
        let (mut n_actors, mut shortfall) = (0, None);
        for load in &loads {
            let (n_joined, reason) = expect_ready(load, patience)?;
            n_actors += n_joined;
            shortfall = shortfall.or(reason);
        }
        Ok(Self { routers, ingest, loads, n_actors, shortfall, _folder: folder })
    }

    /// Lets the actors send for the given time and collects the reports of both ends.
    fn measure(mut self, args: &ActorsArgs, recording: &Recording) -> anyhow::Result<Report> {
        tracing::info!(n_actors = self.n_actors, seconds = args.seconds, "all have joined, sending");
        let cpu_before = self.cpu()?;
        let wire_before = loopback_bytes();
        for part in self.loads.iter_mut().chain([&mut self.ingest]) {
            part.tell(&Order::Go)?;
        }
        let start = Instant::now();
        let memory = self.watch(start, Duration::from_secs(args.seconds))?;
        for load in &mut self.loads {
            load.tell(&Order::Stop)?;
        }
        let mut sent = LoadReport::default();
        for load in &self.loads {
            let Note::Sent(report) = load.hear(READY_PATIENCE)? else { anyhow::bail!("actors end with a report") };
            sent.add(report);
        }
        let cpu_after = self.cpu()?;
        let wire = loopback_bytes().zip(wire_before).map(|(after, before)| after.saturating_sub(before));
        self.ingest.tell(&Order::Stop)?;
        let Note::Sank(sank) = self.ingest.hear(READY_PATIENCE)? else {
            anyhow::bail!("the ingest ends with a report")
        };
        let used = Used { cpu_s: cpu_after - cpu_before, memory, loopback_bytes: wire };
        let report = Report::new(args, recording, &sent, &sank, &used);
        self.end()?;
        Ok(report)
    }

    /// Samples memory until `time` has passed; fails if a process ends earlier.
    fn watch(&mut self, start: Instant, time: Duration) -> anyhow::Result<Roles<MemoryCurve>> {
        let mut memory = Roles::<MemoryCurve>::default();
        // Nothing is ever sent: receiving with a timeout serves as the clock.
        let (_sender, never) = mpsc::channel::<()>();
        loop {
            let elapsed = start.elapsed();
            let pids = self.pids();
            memory.router.sample(elapsed.as_secs_f64(), &pids.router)?;
            memory.ingest.sample(elapsed.as_secs_f64(), &pids.ingest)?;
            memory.actors.sample(elapsed.as_secs_f64(), &pids.actors)?;
            for part in self.routers.iter_mut().chain(&mut self.loads).chain([&mut self.ingest]) {
                part.check()?;
            }
            let Some(rest) = time.checked_sub(elapsed).filter(|rest| !rest.is_zero()) else { return Ok(memory) };
            let _: Result<(), mpsc::RecvTimeoutError> = never.recv_timeout(rest.min(SAMPLE_PERIOD));
        }
    }

    fn end(self) -> anyhow::Result<()> {
        self.loads.into_iter().chain([self.ingest]).chain(self.routers).try_for_each(Part::join)
    }

    fn pids(&self) -> Roles<Vec<u32>> {
        let pids = |parts: &[Part]| parts.iter().map(Part::pid).collect();
        Roles { router: pids(&self.routers), ingest: vec![self.ingest.pid()], actors: pids(&self.loads) }
    }

    fn cpu(&self) -> anyhow::Result<Roles<f64>> {
        let sum = |pids: Vec<u32>| pids.into_iter().map(cpu_s).sum::<anyhow::Result<f64>>();
        let Roles { router, ingest, actors } = self.pids();
        Ok(Roles { router: sum(router)?, ingest: sum(ingest)?, actors: sum(actors)? })
    }
}

/// Starts the root router and its leaves. Returns the root's endpoint, all router processes, and the endpoints that
/// actors join.
fn start_routers(args: &ActorsArgs, folder: &Path) -> anyhow::Result<(String, Vec<Part>, Vec<String>)> {
    let root = endpoint(args.transport, folder, "root")?;
    let start = |name: String, listen: &str, connect: Option<&String>| {
        let mut router = Part::start(name, "router")?;
        let listen = vec![listen.to_owned()];
        let connect = connect.cloned().into_iter().collect();
        router.tell(&BusConfig { mode: BusMode::Router, listen, connect, ..BusConfig::default() })?;
        anyhow::Ok(router)
    };
    let mut routers = vec![start("router".to_owned(), &root, None)?];
    let mut doors = Vec::new();
    for i in 0..args.leaves {
        let leaf = endpoint(args.transport, folder, &format!("leaf-{i}"))?;
        routers.push(start(format!("leaf {i}"), &leaf, Some(&root))?);
        doors.push(leaf);
    }
    if doors.is_empty() {
        doors.push(root.clone());
    }
    Ok((root, routers, doors))
}

fn endpoint(transport: Transport, folder: &Path, name: &str) -> anyhow::Result<String> {
    match transport {
        Transport::Unix => Ok(format!("unixsock-stream/{}", folder.join(name).display())),
        Transport::Tcp => {
            // This port was free a moment ago. Clients retry until the router listens on it.
            let address = TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
            Ok(format!("tcp/{}", address.context("finding a free port")?))
        }
    }
}

fn expect_ready(part: &Part, patience: Duration) -> anyhow::Result<(usize, Option<String>)> {
    match part.hear(patience)? {
        Note::Ready { n_actors, shortfall } => Ok((n_actors, shortfall)),
        Note::Sank(_) | Note::Sent(_) => anyhow::bail!("a process reported before it was ready"),
    }
}

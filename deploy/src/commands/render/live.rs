//! Episodes of running actors, received over the bus.

use std::time::Duration;

use anyhow::anyhow;
use bus::{Bus, BusConfig, BusMode, SecurityConfig, TrajectoryViewer};
use proto::{Trajectory, Valid};
use render::video::Collector;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::recordings::{Goals, Named, Recording};
use super::{make_all, policy};
use crate::cli::RenderArgs;
use crate::commands::common::join_bus;
use crate::exit::Failure;
use crate::live::Terminal;

/// Waits for complete episodes and makes videos of them. After `shutdown`, makes videos of those received so far.
pub(in crate::commands) async fn run(
    args: &RenderArgs,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let goals = Goals::new(args)?;
    let policy = policy(args)?;
    let (run, connect) = (args.run.clone(), args.connect.clone());
    let security = SecurityConfig { keys: args.keys.folder("evaluator") };
    let config = BusConfig { run, connect, security, mode: BusMode::Client, ..BusConfig::default() };
    let config = Valid::new(config).map_err(|error| Failure::Usage(format!("--run or --connect: {error}")))?;
    let patience = Duration::from_secs(args.timeout);
    let Ok(opened) = timeout(patience, join_bus(&config, &shutdown)).await else {
        let endpoints = config.connect.join(", ");
        let seconds = args.timeout;
        return Err(Failure::Bus(anyhow!("no router answers at {endpoints} after {seconds} s")));
    };
    let Some(bus) = opened? else { return Ok(()) };
    // Episodes received before a failure are still shown.
    let (recorded, ended) = record(&bus, args, &goals, &config, patience, &shutdown).await;
    bus.close().await;
    let episodes: Vec<Named> =
        recorded.into_iter().enumerate().map(|(i, segments)| named(i, segments, &goals)).collect::<Result<_, _>>()?;
    make_all(&episodes, args, policy.as_ref(), terminal)?;
    ended
}

/// The next episode with a shown goal, complete from its first step to its last; `None` after the bus is closed.
async fn next_episode(
    collector: &mut Collector,
    viewer: &mut TrajectoryViewer,
    goals: &Goals,
) -> Option<Vec<Trajectory>> {
    loop {
        let segment = viewer.recv().await?;
        if !goals.are_shown(&segment.task.blueprint) {
            continue;
        }
        if let Some(episode) = collector.add(segment) {
            return Some(episode);
        }
    }
}

/// The episodes received, and why there are no more.
async fn record(
    bus: &Bus,
    args: &RenderArgs,
    goals: &Goals,
    config: &Valid<BusConfig>,
    patience: Duration,
    shutdown: &CancellationToken,
) -> (Vec<Vec<Trajectory>>, Result<(), Failure>) {
    let mut viewer = match bus.trajectory_viewer(args.actor.as_ref()).await {
        Ok(viewer) => viewer,
        Err(error) => return (Vec::new(), Err(error.into())),
    };
    let (mut collector, mut recorded) = (Collector::default(), Vec::new());
    while recorded.len() < args.episodes as usize {
        tracing::info!(run = args.run, "waiting for an episode");
        let next = tokio::select! {
            () = shutdown.cancelled() => return (recorded, Ok(())),
            next = timeout(patience, next_episode(&mut collector, &mut viewer, goals)) => next,
        };
        match next {
            Ok(Some(segments)) => recorded.push(segments),
            Ok(None) => return (recorded, Err(Failure::Bus(anyhow!("the bus was closed")))),
            Err(_) => {
                let ended = tokio::select! {
                    () = shutdown.cancelled() => Ok(()),
                    reason = silent(args, &collector, bus, config) => Err(reason),
                };
                return (recorded, ended);
            }
        }
    }
    (recorded, Ok(()))
}

/// Explains why no episode arrived.
async fn silent(args: &RenderArgs, collector: &Collector, bus: &Bus, config: &Valid<BusConfig>) -> Failure {
    let who = args.actor.as_ref().map_or_else(|| "any actor".to_owned(), |actor| format!("the actor {actor}"));
    let seconds = args.timeout;
    let run = &args.run;
    let counts = bus.counts();
    let n_missed = counts.viewed_dropped_total + counts.viewed_invalid_total;
    let others = bus::runs(config).await.unwrap_or_default();
    let elsewhere = match others.is_empty() {
        true => String::new(),
        false => format!(" (this router has {})", Vec::from_iter(others).join(", ")),
    };
    Failure::NothingToShow(format!(
        "no whole episode of {who} of run `{run}` within {seconds} s (segments of others: {}, missed: {n_missed}); --run \
         chooses another run{elsewhere}, --actor another actor, --timeout a longer wait",
        collector.n_left_out()
    ))
}

fn named(idx: usize, segments: Vec<Trajectory>, goals: &Goals) -> Result<Named, Failure> {
    let Some(first) = segments.first() else { return Err(Failure::Input("a live episode: is empty".to_owned())) };
    let (blueprint, version) = (&first.task.blueprint, first.weights_version.0);
    let name = format!("{}-{:02}-{blueprint}-{version:08}", first.actor, idx + 1).into();
    // There is no file, but this is what an error begins with.
    Recording { name, files: vec!["a live episode".into()], segments }.episode(goals)
}

//! Episodes of running actors, received over the bus.

use std::time::Duration;

use anyhow::anyhow;
use bus::{Bus, BusConfig, BusMode, SecurityConfig, TrajectoryViewer};
use proto::{Trajectory, Valid};
use render::video::Collector;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::recordings::{Named, Recording, goals_of, is_shown};
use super::{make_all, policy};
use crate::cli::RenderArgs;
use crate::commands::common::join_bus;
use crate::commands::goals::Goals;
use crate::exit::Failure;
use crate::live::Terminal;

/// Waits for complete episodes and makes videos of them. After `shutdown`, makes videos of those received so far.
pub(in crate::commands) async fn run(
    args: &RenderArgs,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let goals = goals_of(args)?;
    let policy = policy(args)?;
    let (run, connect) = (args.run.clone(), args.connect.clone());
    let security = SecurityConfig { keys: args.keys.folder("evaluator") };
    let config = BusConfig { run, connect, security, mode: BusMode::Client, ..BusConfig::default() };
    let config = Valid::new(config).map_err(|error| Failure::Usage(format!("--run or --connect: {error}")))?;
    let seconds = args.timeout;
    let Ok(opened) = timeout(Duration::from_secs(seconds), join_bus(&config, &shutdown)).await else {
        let endpoints = config.connect.join(", ");
        return Err(Failure::Bus(anyhow!("no router answers at {endpoints} after {seconds} s")));
    };
    let Some(bus) = opened? else { return Ok(()) };
    // Episodes received before a failure are still shown.
    let mut recorded = Vec::new();
    let ended = record(&mut recorded, &bus, args, &goals, &config, &shutdown).await;
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
        if is_shown(goals, &segment.task.blueprint)
            && let Some(episode) = collector.add(segment)
        {
            return Some(episode);
        }
    }
}

/// Receives episodes into `recorded`, until there are enough, or `shutdown`.
async fn record(
    recorded: &mut Vec<Vec<Trajectory>>,
    bus: &Bus,
    args: &RenderArgs,
    goals: &Goals,
    config: &Valid<BusConfig>,
    shutdown: &CancellationToken,
) -> Result<(), Failure> {
    let mut viewer = bus.trajectory_viewer(args.actor.as_ref()).await?;
    let mut collector = Collector::default();
    let patience = Duration::from_secs(args.timeout);
    while recorded.len() < args.episodes as usize {
        tracing::info!(run = args.run, "waiting for an episode");
        let next = tokio::select! {
            () = shutdown.cancelled() => return Ok(()),
            next = timeout(patience, next_episode(&mut collector, &mut viewer, goals)) => next,
        };
        match next {
            Ok(Some(segments)) => recorded.push(segments),
            Ok(None) => return Err(Failure::Bus(anyhow!("the bus was closed"))),
            Err(_) => tokio::select! {
                () = shutdown.cancelled() => return Ok(()),
                reason = silent(args, &collector, bus, config) => return Err(reason),
            },
        }
    }
    Ok(())
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

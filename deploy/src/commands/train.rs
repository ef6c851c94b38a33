//! `train`: learner, actors, and evaluator in this process, on its own bus.

use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::time::Instant;

use actor::ActorSetup;
use blueprints::outside::as_text;
use bus::BusConfig;
use dashboard::config::WebConfig;
use dashboard::{About, Farewell, Page};
use evaluator::{EvaluatorSetup, Stop};
use learner::{Arrivals, Source};
use proto::ActorId;
use proto::keys::Role;
use proto::metrics::EvalSummary;
use serde::Serialize;
use tokio::sync::{oneshot, watch};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::goals::TrainingGoals;
use super::in_process::InProcess;
use super::{join_bus, serve, services};
use crate::cli::{Settings, TrainArgs};
use crate::config::{Config, Preset};
use crate::exit::Failure;
use crate::health::Reporter;
use crate::live::{self, Terminal};
use crate::run_dir::{Origin, RunDir};
use crate::shell::{self, program};

/// Name of this process's actor and evaluator, unlike those of processes that join.
const LOCAL: &str = "local";

/// Summary of a training.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    run: String,
    #[serde(serialize_with = "as_text")]
    run_dir: PathBuf,
    /// Whether the training reached its number of steps.
    is_complete: bool,
    /// Seconds since the training started in this process.
    elapsed_s: f64,
    #[serde(flatten)]
    learner: learner::Summary,
    /// The last evaluation in this process; `null` if there was none.
    evaluation: Option<EvalSummary>,
}

/// Trains until the configured number of steps is reached, a service fails, or `shutdown`.
///
/// # Errors
/// The first failure of a service, after all others have stopped and the learner has saved.
pub(super) async fn run(
    settings: &Settings,
    args: &TrainArgs,
    goals: &TrainingGoals,
    origin: Origin,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<Summary, Failure> {
    let (config, start, catalog) = (&settings.config, Instant::now(), goals.catalog());
    services::check_evaluator(config, catalog)?;
    let setup = services::learner_setup(config, args.run.init_from.as_deref(), catalog)?;
    // Bind the page before writing anything, because the address may be taken.
    let page = page(config, args, terminal).await?;
    let health = Reporter::start("train", args.health.health_file.as_deref())?;
    let run_dir = services::run_dir(args.run.run_dir.as_deref(), settings, &setup, &origin)?;
    let preset = run_dir.preset().map(str::to_owned);
    let last_words = Farewell { ended: "the run", command: Some(serve::command(&[run_dir.path().to_owned()])) };
    let about = About { preset, ..services::about(settings, catalog, last_words) };
    let page = page.map(|page| services::Opened { page, about, first: None });
    terminal.print(&introduction(settings, &origin, &run_dir));
    let id = ActorId::try_from(LOCAL.to_owned()).expect("the name is lower case");
    let joined =
        join_bus(&watchable(&config.bus, run_dir.path()), &shutdown).await.inspect_err(|_| run_dir.abandon())?;
    let Some(bus) = joined else {
        run_dir.abandon();
        return Err(Failure::NothingWritten(run_dir.path().to_owned()));
    };
    goals.keep(run_dir.paths())?;
    health.joined(&bus);
    let (told, metrics) = watch::channel(None);
    let actors = bus.alive(Role::Actor).await?;
    let (reports, evaluated) = watch::channel(None);
    let (whole, shown, its_reports) = (config.clone(), terminal.clone(), evaluated.clone());
    let learning = tokio::spawn(async move { live::show_learning(metrics, actors, its_reports, shown, &whole).await });
    let evaluating = tokio::spawn(live::show_reports(evaluated, terminal.clone(), live::detail(args.verbose)));
    let (progress, counted) = watch::channel(None);
    let (tell, last) = watch::channel(None);
    let learner_is_done = {
        let last = last.clone();
        move || last.borrow().is_some()
    };
    let counting = tokio::spawn(live::show_evaluating(counted, terminal.clone(), learner_is_done));

    let mut running = JoinSet::new();
    let source: Box<dyn Source> = match config.lockstep {
        true => Box::new(InProcess::new(config, catalog.clone())),
        false => Box::new(Arrivals::default()),
    };
    let options = services::run_options(setup, config, &run_dir, origin.checkpoint, source, told);
    let evaluator = EvaluatorSetup {
        catalog: catalog.clone(),
        ..services::evaluator_setup(config, LOCAL.to_owned(), Some(run_dir.path()))
    };
    let (learned, its_summary) = oneshot::channel();
    let stop = Stop { now: shutdown.clone(), last: Some(last.clone()) };
    let training = shutdown.child_token();
    let learner = services::learner(options, bus.clone(), training.clone());
    let folder = run_dir.path().to_owned();
    let (interrupted, told) = (shutdown.clone(), config.evaluator.evaluate_last.then(|| terminal.clone()));
    running.spawn(async move {
        let Some(report) = learner.await? else {
            return Err(Failure::NothingWritten(folder));
        };
        if let Some(terminal) = told.filter(|_| !interrupted.is_cancelled()) {
            terminal.print("the last weights are evaluated now; Ctrl-C ends without that");
        }
        tell.send_replace(Some(report.weights.clone()));
        // The receiver may be gone after another service failed.
        drop(learned.send(report));
        Ok(())
    });
    if !config.lockstep {
        let actor = ActorSetup { catalog: catalog.clone(), ..services::actor_setup(config, id) };
        // The learner's lines and bar count all actors.
        let told = watch::channel(None).0;
        running.spawn(services::actor(actor, bus.clone(), told, training.clone()));
    }
    running.spawn(services::evaluator(evaluator, reports, progress, page, bus.clone(), stop));
    let mut ended = Ok(());
    while let Some(service) = running.join_next().await {
        // Any service that ends, even without an error, ends the run, because the others have nothing to do without it.
        // Only the evaluator may still have work: the last evaluation.
        training.cancel();
        let result = service.map_err(|panic| Failure::Service(panic.into())).flatten();
        ended = ended.and(result);
        if !(config.evaluator.evaluate_last && last.borrow().is_some() && ended.is_ok()) {
            shutdown.cancel();
        }
    }
    bus.close().await;
    let panicked = |panic: tokio::task::JoinError| Failure::Service(panic.into());
    learning.await.map_err(panicked)?;
    counting.await.map_err(panicked)?;
    let evaluation = evaluating.await.map_err(panicked)?;
    ended?;
    let learner = its_summary.await.map_err(|error| Failure::Service(error.into()))?;
    let is_complete = learner.n_env_steps >= config.n_env_steps;
    terminal.print(&farewell(&run_dir, is_complete));
    Ok(Summary {
        run: config.bus.run.clone(),
        run_dir: run_dir.path().to_owned(),
        is_complete,
        elapsed_s: start.elapsed().as_secs_f64(),
        learner,
        evaluation: evaluation.map(|report| report.summary.clone()),
    })
}

/// The bus with a socket in the run's folder, so that `watch` finds it; without one if the file system or the keys rule it
/// out.
fn watchable(bus: &BusConfig, folder: &Path) -> BusConfig {
    let socket = BusConfig::socket(folder);
    let listen = bus.listen.iter().cloned().chain(BusConfig::isolated_router(folder).listen).collect();
    let with_socket = BusConfig { listen, ..bus.clone() };
    // A process that was killed leaves its socket behind. No other one is alive, because this one holds the folder.
    drop(std::fs::remove_file(&socket));
    // An endpoint is text in which these characters begin something else.
    let is_named = socket.to_str().is_some_and(|name| !name.contains(['?', '#']));
    let is_possible = is_named && with_socket.validate().is_ok() && UnixListener::bind(&socket).is_ok();
    if is_possible { with_socket } else { bus.clone() }
}

/// Serves the page at the configured address, or else on a free port, where a failure is only logged.
async fn page(config: &Config, args: &TrainArgs, terminal: &Terminal) -> Result<Option<Page>, Failure> {
    if args.no_web {
        return Ok(None);
    }
    if config.dashboard.web.is_some() {
        return services::page(config.dashboard.web.as_ref(), terminal).await;
    }
    let page = services::page(Some(&WebConfig::default()), terminal).await;
    Ok(page.unwrap_or_else(|error| {
        tracing::warn!(%error, "training without a page");
        None
    }))
}

fn introduction(settings: &Settings, origin: &Origin, run_dir: &RunDir) -> String {
    let config = &settings.config;
    let (actor, path, curves) = (&config.actor, run_dir.path().display(), shell::path(&run_dir.path().join("tb")));
    let how = if origin.checkpoint.is_some() { "continuing" } else { "training" };
    let program = program();
    let run = &config.bus.run;
    let listening = match &config.bus.listen[..] {
        [] => format!(
            "\nin a terminal: {program} watch {}; for actors elsewhere: --listen tcp/127.0.0.1:7447",
            shell::path(run_dir.path())
        ),
        endpoints => format!(
            "\nothers can join at {}, run `{run}`\nin a terminal: {program} watch --connect {} --run {run}",
            endpoints.join(" and "),
            shell::quoted(&endpoints[0]),
        ),
    };
    let takes = settings.preset.map_or_else(String::new, |preset| format!("\n{}", takes(preset, config.n_env_steps)));
    format!(
        "{how} `{}` up to {} environment steps with {} × {} worlds, seed {}\n\
         settings: {}{takes}\n\
         everything goes to {path}; Ctrl-C saves and ends{listening}\n\
         curves: tensorboard --logdir {curves}",
        config.bus.run, config.n_env_steps, actor.n_threads, actor.n_worlds, config.seed, settings.source,
    )
}

/// What a training of `n_env_steps` with this preset takes.
fn takes(preset: &Preset, n_env_steps: u64) -> String {
    let whole = Config::parse(preset.text, preset.name).map_or(n_env_steps, |config| config.n_env_steps);
    if n_env_steps == whole {
        return format!("the whole preset takes {}", preset.takes);
    }
    let percent = 100.0 * n_env_steps as f64 / whole as f64;
    let digits = if percent < 10.0 { 1 } else { 0 };
    format!("the preset's {whole} steps take {}; {n_env_steps} are {percent:.digits$} % of them", preset.takes)
}

fn farewell(run_dir: &RunDir, is_complete: bool) -> String {
    // Without a higher step limit, a complete run would stop at once.
    let steps = if is_complete { " --steps N" } else { "" };
    let (shown, path, program) = (run_dir.path().display(), shell::path(run_dir.path()), program());
    format!(
        "\nsaved in {shown}\n  evaluate it: {program} eval --checkpoint {path}\n  \
         continue it: {program} train --resume {path}{steps}\n  \
         look at it: {program} serve {path}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_is_that_of_the_steps_that_are_asked_for() {
        let preset = Preset::find("quickstart").unwrap();
        let whole = Config::parse(preset.text, preset.name).unwrap().n_env_steps;
        assert_eq!(takes(preset, whole), format!("the whole preset takes {}", preset.takes));
        let part = takes(preset, whole / 40);
        assert!(part.starts_with(&format!("the preset's {whole} steps take about")), "{part}");
        assert!(part.ends_with(&format!("; {} are 2.5 % of them", whole / 40)), "{part}");
    }
}

//! `train`: learner, actors, and evaluator in this process, on its own bus.

use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use actor::Lockstep;
use blueprints::Catalog;
use blueprints::outside::as_text;
use bus::{Bus, BusConfig};
use dashboard::{About, Farewell, Page};
use evaluator::{Listeners, Stop};
use learner::{RunOptions, Source};
use proto::keys::Role;
use proto::metrics::EvalSummary;
use proto::{ActorId, Valid, Weights};
use serde::Serialize;
use tokio::sync::{oneshot, watch};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::common::{configure, farewell, join_bus, json, origin, serve_command};
use super::goals::Goals;
use super::runtime::on_runtime;
use super::services;
use crate::cli::{Settings, TrainArgs};
use crate::config::{Config, Override, Preset};
use crate::exit::Failure;
use crate::health::Reporter;
use crate::live::{self, Terminal};
use crate::run_dir::{Origin, RunDir};
use crate::shell::{self, program};
use crate::signals;

/// Name of this process's actor and evaluator, unlike those of processes that join.
const LOCAL: &str = "local";

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

pub(super) fn command(args: &TrainArgs, terminal: &Terminal) -> Result<(), Failure> {
    let listen = (!args.listen.is_empty()).then(|| Override::flag("--listen", "bus.listen", args.listen.clone()));
    let actors = args.actors.map(|n_threads| Override::flag("--actors", "actor.n_threads", n_threads));
    let lockstep = args.lockstep.then(|| Override::flag("--lockstep", "lockstep", true));
    let keys = args.keys.overrides("router").filter(|_| !args.listen.is_empty());
    let given = [listen, actors, lockstep, keys, args.page.overrides()];
    let said = if args.json { terminal.on_stderr() } else { terminal.clone() };
    let origin = origin(&args.run, &args.config, &said)?;
    if let (Some(run), false) = (&origin.checkpoint, args.blueprint.is_empty()) {
        return Err(Failure::Usage(format!(
            "--blueprint: the run in {} goes on with the goals that it began with; for others, start a run with \
             `--init-from {} --blueprint …`",
            run.display(),
            shell::path(run)
        )));
    }
    let goals = Goals::for_training(&args.blueprint, origin.config.as_deref())?;
    goals.tell_choices(&said);
    let flags = args.run.overrides().into_iter().chain(goals.settings());
    let flags = flags.chain(given.into_iter().flatten()).collect();
    let Some(settings) = configure(&args.config, origin.config.as_ref(), flags, terminal)? else {
        return Ok(());
    };
    on_runtime(async |shutdown| {
        if args.end_with_stdin {
            signals::cancel_with_stdin(shutdown.clone());
        }
        let summary = run(&settings, args, &goals, origin, &said, shutdown).await?;
        if args.json { json(&summary, terminal) } else { Ok(()) }
    })
}

/// Trains until the configured number of steps is reached, a service fails, or `shutdown`.
///
/// # Errors
/// The first failure of a service, after all others have stopped and the learner has saved.
pub(super) async fn run(
    settings: &Settings,
    args: &TrainArgs,
    goals: &Goals,
    origin: Origin,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<Summary, Failure> {
    let start = Instant::now();
    let config = &settings.config;
    services::check_evaluator(config, &goals.catalog)?;
    let setup = services::learner_setup(config, args.run.init_from.as_deref(), &goals.catalog)?;
    // Bind the page before writing anything, because the address may be taken.
    let page = page(config, args).await?;
    let health = Reporter::start("train", args.health.health_file.as_deref())?;
    let run_dir = services::run_dir(args.run.run_dir.as_deref(), settings, &setup, &origin)?;
    services::tell_page(page.as_ref(), terminal);
    let last_words = Farewell { ended: "the run", command: Some(serve_command(&[run_dir.path().to_owned()])) };
    let page = page.map(|page| (page, services::about(config, Some(&run_dir.paths), &goals.catalog, last_words)));
    terminal.print(&introduction(settings, &origin, &run_dir));
    let bus = watchable(config.part(|config| &config.bus), run_dir.path());
    let joined = join_bus(&bus, &shutdown).await.inspect_err(|_| run_dir.abandon())?;
    let Some(bus) = joined else {
        run_dir.abandon();
        return Err(Failure::NothingWritten(run_dir.path().to_owned()));
    };
    goals.keep(&run_dir.paths)?;
    health.joined(&bus);
    let actors = bus.alive(Role::Actor).await?;
    let (metrics, updates) = watch::channel(None);
    let listeners = Listeners::default();
    let (evaluated, counted) = (listeners.reports.subscribe(), listeners.progress.subscribe());
    let (last, last_weights) = watch::channel(None);
    let learner_is_done = move || last_weights.borrow().is_some();
    let mut views = JoinSet::new();
    views.spawn(live::show_learning(updates, actors, evaluated.clone(), terminal.clone(), config.n_env_steps));
    views.spawn(live::show_reports(evaluated.clone(), terminal.clone(), args.verbose));
    views.spawn(live::show_episodes(counted, "evaluated", terminal.clone(), learner_is_done));
    let source = match config.lockstep {
        true => in_turns(config, &goals.catalog),
        false => Source::Arrivals,
    };
    let options = services::run_options(setup, config, &run_dir, origin.checkpoint, source, metrics);
    let services = Services { config, catalog: &goals.catalog, bus: &bus, folder: run_dir.path(), terminal, shutdown };
    let ended = services.run(options, last, listeners, page).await;
    bus.close().await;
    while let Some(view) = views.join_next().await {
        view?;
    }
    let learner = ended?;
    let is_complete = learner.n_env_steps >= config.n_env_steps;
    terminal.print(&farewell(&run_dir, is_complete));
    Ok(Summary {
        run: config.bus.run.clone(),
        run_dir: run_dir.path().to_owned(),
        is_complete,
        elapsed_s: start.elapsed().as_secs_f64(),
        learner,
        evaluation: evaluated.borrow().as_ref().map(|report| report.summary.clone()),
    })
}

/// Worlds that step in turns with the learner, so that equal seeds give equal trajectories, byte for byte.
fn in_turns(config: &Valid<Config>, catalog: &Arc<Catalog>) -> Source {
    let id = "lockstep".parse().expect("the name is lower case");
    let mut worlds = Lockstep::new(services::actor_setup(config, id, catalog));
    Source::Made(Box::new(move |weights, restart| worlds.step(weights, restart)))
}

struct Services<'t> {
    config: &'t Valid<Config>,
    catalog: &'t Arc<Catalog>,
    bus: &'t Bus,
    folder: &'t Path,
    terminal: &'t Terminal,
    shutdown: CancellationToken,
}

impl Services<'_> {
    /// Runs all of them until each has ended. The learner sends the weights that it ends with to `last`.
    async fn run(
        self,
        options: RunOptions,
        last: watch::Sender<Option<Arc<Weights>>>,
        listeners: Listeners,
        page: Option<(Page, About)>,
    ) -> Result<learner::Summary, Failure> {
        let last_weights = last.subscribe();
        // Ends what needs the learner; the evaluator may still have the last weights to evaluate.
        let training = self.shutdown.child_token();
        let (summary, learned) = oneshot::channel();
        let mut running = JoinSet::new();
        running.spawn(self.learner(options, last, summary, training.clone()));
        if !self.config.lockstep {
            let id = ActorId::try_from(LOCAL.to_owned()).expect("the name is lower case");
            let setup = services::actor_setup(self.config, id, self.catalog);
            // The learner's lines and bar count all actors.
            let metrics = watch::channel(None).0;
            let bus = self.bus.clone();
            let shutdown = training.clone();
            running.spawn(
                async move { actor::run(setup, &bus, metrics, shutdown).await.map(drop).map_err(Failure::from) },
            );
        }
        let stop = Stop { now: self.shutdown.clone(), last: Some(last_weights.clone()) };
        let setup = services::evaluator_setup(self.config, LOCAL.to_owned(), Some(self.folder), self.catalog);
        running.spawn(services::evaluator(setup, self.config.n_env_steps, listeners, page, self.bus.clone(), stop));
        let mut ended = Ok(());
        while let Some(service) = running.join_next().await {
            // Any service that ends, even without an error, ends the run, because the others have nothing to do without
            // it. Only the evaluator may still have work: the last evaluation.
            training.cancel();
            ended = ended.and(service.map_err(Failure::from).flatten());
            let is_evaluated = self.config.evaluator.evaluate_last && last_weights.borrow().is_some() && ended.is_ok();
            if !is_evaluated {
                self.shutdown.cancel();
            }
        }
        ended?;
        learned.await.map_err(|error| Failure::Service(error.into()))
    }

    /// The learner, which sends the weights that it ends with to `last` and its summary to `summary`.
    fn learner(
        &self,
        options: RunOptions,
        last: watch::Sender<Option<Arc<Weights>>>,
        summary: oneshot::Sender<learner::Summary>,
        training: CancellationToken,
    ) -> impl Future<Output = Result<(), Failure>> + use<> {
        let bus = self.bus.clone();
        let folder = self.folder.to_owned();
        let interrupted = self.shutdown.clone();
        let terminal = self.config.evaluator.evaluate_last.then(|| self.terminal.clone());
        async move {
            let Some(report) = learner::run(options, &bus, training).await? else {
                return Err(Failure::NothingWritten(folder));
            };
            if let Some(terminal) = terminal.filter(|_| !interrupted.is_cancelled()) {
                terminal.print("the last weights are evaluated now; Ctrl-C ends without that");
            }
            last.send_replace(Some(report.weights.clone()));
            // The receiver may be gone after another service failed.
            drop(summary.send(report));
            Ok(())
        }
    }
}

/// The bus with a socket in the run's folder, so that `watch` finds it; without one if the file system or the keys rule
/// it out.
fn watchable(bus: Valid<BusConfig>, folder: &Path) -> Valid<BusConfig> {
    let socket = BusConfig::socket(folder);
    // A process that was killed leaves its socket behind. No other one is alive, because this one holds the folder.
    drop(std::fs::remove_file(&socket));
    // An endpoint is text in which these characters begin something else.
    let is_named = socket.to_str().is_some_and(|name| !name.contains(['?', '#']));
    match bus.with(|bus| bus.listen.push(BusConfig::socket_endpoint(folder))) {
        Ok(with_socket) if is_named && UnixListener::bind(&socket).is_ok() => with_socket,
        _ => bus,
    }
}

/// Serves the page at the configured address, or else on a free port, where a failure is only logged.
async fn page(config: &Valid<Config>, args: &TrainArgs) -> Result<Option<Page>, Failure> {
    if args.no_web {
        return Ok(None);
    }
    if let Some(page) = services::page(config).await? {
        return Ok(Some(page));
    }
    let page = Page::bind(&Valid::default()).await;
    Ok(page.inspect_err(|error| tracing::warn!(%error, "training without a page")).ok())
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
    let times = n_env_steps as f64 / whole as f64;
    let digits = if times < 0.1 { 1 } else { 0 };
    let share = match times > 1.0 {
        true => format!("{times:.1} times as many"),
        false => format!("{:.digits$} % of them", 100.0 * times),
    };
    format!("the preset's {whole} steps take {}; {n_env_steps} are {share}", preset.takes)
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
        assert!(takes(preset, 5 * whole).ends_with("; 1000000 are 5.0 times as many"));
    }
}

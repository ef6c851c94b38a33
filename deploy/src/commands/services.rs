//! The services, both as separate processes and as parts of `train`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use actor::{ActorSetup, TaskFilter};
use blueprints::Catalog;
use bus::{Bus, BusConfig, BusError, BusMode, SecurityConfig};
use dashboard::{About, Farewell, Kind, Page, ShownRun};
use evaluator::{EvaluatorConfig, EvaluatorSetup, Listeners, Stop};
use learner::{LearnerSetup, RunOptions, SAVE_RETRY};
use proto::metrics::LearnerMetrics;
use proto::{ActorId, Role, Valid};
use runlog::RunPaths;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use super::common::{farewell, join_bus, serve_command};
use super::stage::stage;
use super::{best, models};
use crate::cli::{EvaluatorArgs, LearnerArgs, MemberArgs, RouterArgs, Settings};
use crate::config::{Config, ConfigError};
use crate::exit::Failure;
use crate::health::Reporter;
use crate::live::{self, Terminal};
use crate::names::random_name;
use crate::run_dir::{Origin, RunDir, origin_of, preset_of};

/// Delay before the first notice that no router answers, and between later notices.
const FIRST_WAIT_NOTICE: Duration = Duration::from_secs(3);
const WAIT_NOTICE: Duration = Duration::from_secs(10);

pub(super) async fn run_actor(
    settings: &Settings,
    args: &MemberArgs,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let config = &settings.config;
    let id = name(args.id.clone(), Role::Actor)?;
    let id = ActorId::try_from(id).map_err(|error| Failure::Usage(format!("--id: {error}")))?;
    let health = Reporter::start(Role::Actor.as_str(), args.health.health_file.as_deref())?;
    let (n_threads, n_worlds) = (config.actor.n_threads, config.actor.n_worlds);
    terminal.print(&begins(&format!("actor `{id}` steps {n_threads} × {n_worlds} worlds"), settings));
    let setup = actor_setup(config, id, Catalog::builtin());
    let (metrics_sender, metrics) = watch::channel(None);
    let shown = tokio::spawn(live::show_acting(metrics, terminal.clone()));
    let act = async |bus: Bus| {
        let _told = AbortOnDropHandle::new(tokio::spawn(tell_of_learner(bus.clone())));
        actor::run(setup, &bus, metrics_sender, shutdown.clone()).await.map(drop).map_err(Failure::from)
    };
    let ended = on_bus(config, &health, &shutdown, act).await;
    // What shows a service's progress ends with the service, here and below.
    shown.await?;
    ended
}

/// Describes what a process of a run is about to do.
fn begins(what: &str, settings: &Settings) -> String {
    let config = &settings.config;
    let how = match &config.bus.listen[..] {
        [] => format!("router: {}", config.bus.connect.join(", ")),
        endpoints => format!("others can join at {}", endpoints.join(" and ")),
    };
    format!("{what} for the run `{}`\nsettings: {}\n{how}", config.bus.run, settings.source)
}

pub(super) async fn run_learner(
    settings: &Settings,
    args: &LearnerArgs,
    origin: Origin,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let config = &settings.config;
    check_evaluator(config, Catalog::builtin())?;
    let setup = learner_setup(config, args.run.init_from.as_deref(), Catalog::builtin())?;
    let health = Reporter::start(Role::Learner.as_str(), args.member.health.health_file.as_deref())?;
    let run_dir = run_dir(args.run.run_dir.as_deref(), settings, &setup, &origin)?;
    let what = format!("learning up to {} environment steps, seed {},", config.n_env_steps, config.seed);
    terminal.print(&begins(&what, settings));
    terminal.print(&format!("everything goes to {}", run_dir.path().display()));
    let (metrics_sender, metrics) = watch::channel(None);
    let source = learner::Source::Arrivals;
    let options = run_options(setup, config, &run_dir, origin.checkpoint, source, metrics_sender);
    let (mut shown, mut summary) = (None, None);
    let ended = on_bus(config, &health, &shutdown, async |bus| {
        let actors = bus.alive(Role::Actor).await?;
        // The evaluator shows evaluations.
        let reports = watch::channel(None).1;
        let learning = live::show_learning(metrics, actors, reports, terminal.clone(), config.n_env_steps);
        shown = Some(tokio::spawn(learning));
        summary = learner::run(options, &bus, shutdown.clone()).await?;
        Ok(())
    })
    .await;
    if let Some(shown) = shown {
        shown.await?;
    }
    ended?;
    let is_complete = summary.as_ref().is_some_and(|summary| summary.n_env_steps >= config.n_env_steps);
    if summary.is_some() {
        terminal.print(&farewell(&run_dir, is_complete));
    }
    if args.fail_unfinished && !is_complete { Err(Failure::Unfinished(config.n_env_steps)) } else { Ok(()) }
}

pub(super) async fn run_evaluator(
    settings: &Settings,
    args: &EvaluatorArgs,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let config = &settings.config;
    check_evaluator(config, Catalog::builtin())?;
    let id = name(args.member.id.clone(), Role::Evaluator)?;
    terminal.print(&begins(&format!("evaluator `{id}` evaluates weights"), settings));
    let setup = evaluator_setup(config, id, args.run_dir.as_deref(), Catalog::builtin());
    let health = Reporter::start(Role::Evaluator.as_str(), args.member.health.health_file.as_deref())?;
    let page = page(config).await?;
    tell_page(page.as_ref(), terminal);
    let command = args.run_dir.clone().map(|run_dir| serve_command(&[run_dir]));
    let farewell = Farewell { ended: "the evaluator", command };
    let preset = settings.preset.map(|preset| preset.name.to_owned());
    let page = page.map(|page| (page, About { preset, ..about(config, None, &setup.catalog, farewell) }));
    let listeners = Listeners::default();
    let (evaluated, counted) = (listeners.reports.subscribe(), listeners.progress.subscribe());
    let shown = tokio::spawn(live::show_reports(evaluated, terminal.clone(), args.verbose));
    let counting = tokio::spawn(live::show_episodes(counted, "evaluated", terminal.clone(), || true));
    let stop = Stop { now: shutdown.clone(), ..Stop::default() };
    let evaluate = async |bus: Bus| {
        let _told = AbortOnDropHandle::new(tokio::spawn(tell_of_learner(bus.clone())));
        evaluator(setup, config.n_env_steps, listeners, page, bus, stop).await
    };
    let ended = on_bus(config, &health, &shutdown, evaluate).await;
    counting.await?;
    shown.await?;
    ended
}

pub(super) async fn run_router(args: &RouterArgs, shutdown: CancellationToken) -> Result<(), Failure> {
    // A run's name prefixes only the keys that its own processes use, so one router serves every run.
    let (listen, connect) = (args.listen.clone(), args.connect.clone());
    let security = SecurityConfig { keys: args.keys.folder("router") };
    let config = BusConfig { mode: BusMode::Router, listen, connect, security, ..BusConfig::default() };
    let config = Valid::new(config).map_err(ConfigError::from)?;
    let health = Reporter::start("router", args.health.health_file.as_deref())?;
    let Some(bus) = join_bus(&config, &shutdown).await? else { return Ok(()) };
    health.joined(&bus);
    // A router has no main loop that could hang.
    let _waiting = bus.pulse().waiting();
    tracing::info!(listen = ?config.listen, with_keys = config.security.keys.is_some(), "routing");
    shutdown.cancelled().await;
    bus.close().await;
    Ok(())
}

/// Joins the bus for as long as `service` runs; does nothing if `shutdown` comes before a router answers.
async fn on_bus(
    config: &Valid<Config>,
    health: &Reporter,
    shutdown: &CancellationToken,
    service: impl AsyncFnOnce(Bus) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let endpoints = config.bus.connect.join(", ");
    let notice = async {
        let mut pause = FIRST_WAIT_NOTICE;
        loop {
            tokio::time::sleep(pause).await;
            tracing::warn!("no router answers at {endpoints} yet; trying again until one does");
            pause = WAIT_NOTICE;
        }
    };
    let bus_config = config.part(|config| &config.bus);
    let bus = tokio::select! {
        bus = join_bus(&bus_config, shutdown) => bus?,
        () = notice => unreachable!("it has no end"),
    };
    let Some(bus) = bus else { return Ok(()) };
    tracing::info!(run = config.bus.run, "joined the bus");
    health.joined(&bus);
    let ended = service(bus.clone()).await;
    bus.close().await;
    ended
}

/// Says when the learner is gone, because whoever waits for its weights may wait for long.
async fn tell_of_learner(bus: Bus) -> Result<(), BusError> {
    let learner = bus.learner_watch().await?;
    let mut there = learner.watch();
    while there.wait_for(|there| *there).await.is_ok() && there.wait_for(|there| !there).await.is_ok() {
        tracing::warn!(run = bus.run(), "the learner is gone, so no newer weights come until one is there again");
    }
    Ok(())
}

/// Describes a training with these settings for its page, also by what is recorded in the folder of the `run`;
/// `catalog` has all of its goals.
pub(super) fn about(config: &Config, run: Option<&RunPaths>, catalog: &Arc<Catalog>, farewell: Farewell) -> About {
    About {
        kind: Kind::Training,
        run: config.bus.run.clone(),
        preset: run.and_then(preset_of),
        n_env_steps: Some(config.n_env_steps),
        blueprints: config.evaluator.selection.blueprints.clone(),
        trained: config.actor.tasks.filter.select(catalog).unwrap_or_default(),
        catalog: catalog.clone(),
        farewell,
        origin: origin_of(run, config),
        success: serde_json::Value::Null,
    }
}

/// Runs an evaluator with these listeners, and serves its page if there is one. If the evaluator keeps records, keeps
/// the best policy and snapshots as well, of a run of `n_env_steps`.
pub(super) async fn evaluator(
    setup: EvaluatorSetup,
    n_env_steps: u64,
    mut listeners: Listeners,
    page: Option<(Page, About)>,
    bus: Bus,
    stop: Stop,
) -> Result<(), Failure> {
    let mut keeping = None;
    if let Some(paths) = setup.records.clone() {
        let (evaluated, verdicts) = mpsc::unbounded_channel();
        listeners.evaluated = evaluated;
        let newest = listeners.weights.subscribe();
        keeping = Some(tokio::spawn(best::keep(verdicts, newest, n_env_steps, setup.policy.clone(), paths)));
    }
    let shown = page.map(|(page, about)| {
        let (sender, evaluations) = mpsc::unbounded_channel();
        listeners.evaluations = sender;
        let weights = listeners.weights.subscribe();
        let (policy, run) = (setup.policy.clone(), setup.records.clone());
        let stage = Some(stage(setup.environment.clone(), policy.clone(), weights.clone(), run.clone()));
        let run = ShownRun { about, evaluations: Vec::new(), learner: Vec::new(), run, policy, weights, stage };
        (page, run, evaluations)
    });
    let now = stop.now.clone();
    let serving = async {
        match shown {
            Some((page, run, evaluations)) => page.serve(&bus, run, evaluations).await.inspect_err(|_| now.cancel()),
            None => Ok(()),
        }
    };
    // The page ends after the evaluator, however that ends, to tell browsers so.
    let (evaluated, served) = tokio::join!(evaluator::run(setup, &bus, listeners, stop), serving);
    // It ends with the evaluator, and the last verdict may be the best.
    if let Some(keeping) = keeping {
        keeping.await?;
    }
    evaluated.map(drop).and(served)?;
    Ok(())
}

/// Binds the address of the page that these settings ask for, if they do.
pub(super) async fn page(config: &Valid<Config>) -> Result<Option<Page>, Failure> {
    match config.part(|config| &config.dashboard.web).transpose() {
        Some(web) => Ok(Some(Page::bind(&web).await?)),
        None => Ok(None),
    }
}

pub(super) fn tell_page(page: Option<&Page>, terminal: &Terminal) {
    if let Some(page) = page {
        terminal.print(&format!("page at http://{}", page.address()));
    }
}

/// The setup of an actor; `catalog` has the goals.
pub fn actor_setup(config: &Valid<Config>, id: ActorId, catalog: &Arc<Catalog>) -> ActorSetup {
    ActorSetup {
        config: config.part(|config| &config.actor),
        policy: config.part(|config| &config.policy),
        environment: config.part(|config| &config.environment),
        id,
        seed: config.seed,
        catalog: catalog.clone(),
    }
}

/// The setup of an evaluator, which keeps its reports in `run_dir`; `catalog` has the goals.
pub(super) fn evaluator_setup(
    config: &Valid<Config>,
    id: String,
    run_dir: Option<&Path>,
    catalog: &Arc<Catalog>,
) -> EvaluatorSetup {
    EvaluatorSetup {
        config: config.part(|config| &config.evaluator),
        policy: config.part(|config| &config.policy),
        environment: Config::evaluation_environment(config),
        id,
        seed: config.seed,
        records: run_dir.map(RunPaths::new),
        catalog: catalog.clone(),
    }
}

/// The setup of a learner. `init` names a policy to start from; `catalog` has the goals.
///
/// # Errors
/// Before anything is written, if the device, the selection of goals, or the policy cannot be used.
pub fn learner_setup(
    config: &Valid<Config>,
    init: Option<&Path>,
    catalog: &Arc<Catalog>,
) -> Result<LearnerSetup, Failure> {
    config.device.open().map_err(|error| invalid("device", error))?;
    let selected = |key, filter: &TaskFilter| filter.select(catalog).map_err(|error| invalid(key, error));
    let tasks = selected("actor.tasks.filter", &config.actor.tasks.filter)?;
    selected("actor.tasks.prebuilt_filter", &config.actor.tasks.prebuilt_filter)?;
    Ok(LearnerSetup {
        config: config.part(|config| &config.learner),
        policy: config.part(|config| &config.policy),
        catalog: catalog.clone(),
        tasks,
        settings: config.settings(),
        acting: config.acting_limits(),
        seed: config.seed,
        device: config.device,
        init: init.map(|name| models::Source::named(name).map(|source| Arc::new(source.model))).transpose()?,
    })
}

/// Checks, before anything is written, that an evaluator with these settings finds all of its blueprints in `catalog`.
/// The last evaluation needs no check of its own, because it adds splits to the selection.
///
/// # Errors
/// Names the section with an unknown blueprint, or with a selection of none.
pub(super) fn check_evaluator(config: &Config, catalog: &Catalog) -> Result<(), Failure> {
    let EvaluatorConfig { selection, videos, .. } = &config.evaluator;
    selection.select(catalog).map_err(|error| invalid("evaluator.selection", error))?;
    videos.check_in(catalog).map_err(|error| invalid("evaluator.videos.blueprints", error))
}

/// Claims the run folder that a learner with this setup starts or continues. If it cannot continue the run, the folder
/// stays unchanged.
pub(super) fn run_dir(
    path: Option<&Path>,
    settings: &Settings,
    setup: &LearnerSetup,
    origin: &Origin,
) -> Result<RunDir, Failure> {
    let run_dir = RunDir::claim(path, &settings.config, origin)?;
    learner::check(setup, origin.checkpoint.as_deref()).inspect_err(|_| run_dir.abandon())?;
    run_dir.describe(&settings.config, settings.preset, origin)?;
    Ok(run_dir)
}

/// The options of a learner for this run with trajectories of this source, which sends its metrics to `metrics_sender`
/// too.
pub(super) fn run_options(
    setup: LearnerSetup,
    config: &Config,
    run_dir: &RunDir,
    resume: Option<PathBuf>,
    source: learner::Source,
    metrics_sender: watch::Sender<Option<LearnerMetrics>>,
) -> RunOptions {
    let run_dir = run_dir.paths.clone();
    let max_env_steps = Some(config.n_env_steps);
    RunOptions { setup, run_dir, resume, max_env_steps, source, metrics_sender, save_retry: SAVE_RETRY }
}

/// The given name, or a new one.
fn name(given: Option<String>, role: Role) -> anyhow::Result<String> {
    Ok(given.map_or_else(|| random_name(role.as_str()), Ok)?)
}

fn invalid(origin: &str, message: impl std::fmt::Display) -> Failure {
    ConfigError::at(origin, message).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DEFAULTS, Override, merge};

    #[test]
    fn an_evaluator_without_its_blueprints_is_refused_by_the_name_of_the_setting() {
        let check = |set: &str| {
            let config = merge("", "defaults", &DEFAULTS, &[Override::parse(set).unwrap()]).unwrap();
            check_evaluator(&config, Catalog::builtin())
        };
        assert!(check("evaluator.videos.blueprints=[\"2_000\"]").is_ok());
        for (set, expected) in [
            ("evaluator.selection.blueprints=[\"2_999\"]", "evaluator.selection: the catalog has no blueprint 2_999"),
            (
                "evaluator.selection.splits=[]",
                "evaluator.selection: the selection of splits, sizes and blueprints leaves nothing to evaluate",
            ),
            (
                "evaluator.videos.blueprints=[\"2_999\"]",
                "evaluator.videos.blueprints: the catalog has no blueprint 2_999",
            ),
        ] {
            let failure = check(set).unwrap_err();
            assert!(matches!(failure, Failure::Config(_)), "{failure:?}");
            assert_eq!(failure.to_string(), expected);
        }
    }
}

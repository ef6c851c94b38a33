//! The evaluator as a service: judges weights as they come and tells the bus, a file and the caller.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Context;
use blueprints::{Blueprint, BlueprintId, Catalogue};
use environment::EnvironmentConfig;
use policy::PolicyConfig;
use proto::bus::{Bus, HistoryAnswer, MetricsPublisher, Pulse};
use proto::{Role, Weights, WeightsVersion, keys};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::assist::setup_hash;
use crate::clerks::Clerks;
use crate::config::EvaluatorConfig;
use crate::desk::Desk;
use crate::episodes::{EvalError, EvalSetup, Workshop, evaluate_in_parts};
use crate::films::{Casting, Studio};
use crate::history::overview::Passes;
use crate::history::{History, Pass};
use crate::nice::on_thread;
use crate::records::Records;
use crate::report::EvalReport;
use crate::schedule::{Due, LastPass, due};
use crate::vetting::vetted;
use crate::web::{OpenPage, Page};

/// How long an evaluator waits for another of its name to go: a process that was killed seems to live for up to 6 s.
const NAME_PATIENCE: Duration = Duration::from_secs(15);

/// How long the last weights may be on their way.
const LAST_WEIGHTS_WAIT: Duration = Duration::from_secs(15);

/// What an evaluator process needs besides the bus.
#[derive(Clone, Debug)]
pub struct EvaluatorSetup {
    /// When, on what and how.
    pub config: EvaluatorConfig,
    /// The policy; it must be the learner's.
    pub policy: PolicyConfig,
    /// The world.
    pub environment: EnvironmentConfig,
    /// Name among the living: 1 to 64 characters of `a-z`, `0-9`, `-`.
    pub id: String,
    /// Seed of start states and sampled actions.
    pub seed: u64,
    /// Where reports are kept; none keeps nothing.
    pub records: Option<RecordPaths>,
}

/// The files that keep reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordPaths {
    /// Each report is appended as lines of JSON; `metrics.jsonl` in a run's folder, where others write too.
    pub metrics: PathBuf,
    /// Database of all reports; [`HISTORY`](crate::HISTORY) in a run's folder.
    pub history: PathBuf,
    /// Folder of event files for TensorBoard.
    pub tensorboard: PathBuf,
    /// Folder of films, with one for each blueprint in it.
    pub videos: PathBuf,
    /// Folder of the recordings that films are made of, likewise.
    pub replays: PathBuf,
}

/// What ends an evaluator.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    /// A pass under way is given up.
    pub now: CancellationToken,
    /// Says which weights are the last, once that is known: these are judged if they are not yet, due or not.
    pub last: Option<watch::Receiver<Option<WeightsVersion>>>,
}

/// Judges the newest weights whenever a pass is due, the first ones at once, until `stop`. Returns the number of passes.
///
/// Each report goes to `metrics/eval/<split>/<blueprint>` and `metrics/eval/summary`, to the files of records, and into
/// `reports`, which may have no receiver. While a pass is under way its first numbers go to the bus, see
/// [`FIRST_PART`](crate::episodes::FIRST_PART). Passes run on threads of their own and share their episodes with all
/// [assistants](crate::assist()); weights that come meanwhile wait. A `page` is served for as long.
///
/// # Errors
/// When the configuration is invalid, the session fails, the weights are of another network, an episode cannot be
/// started, or the records cannot be written; also when another evaluator writes the same history.
pub async fn run(
    setup: EvaluatorSetup,
    bus: &Bus,
    reports: watch::Sender<Option<Arc<EvalReport>>>,
    page: Option<Page>,
    stop: Stop,
) -> anyhow::Result<u64> {
    setup.config.validate().context("invalid evaluator configuration")?;
    let selected = setup.config.selection.select(Catalogue::builtin())?;
    let records = setup.records.as_ref().map(Records::open).transpose()?;
    let history = past(setup.records.as_ref()).await?;
    let films = match &setup.records {
        Some(paths) => Studio::open(&setup.config.films, paths)?,
        None => None,
    };
    let subscriber = bus.weights_subscriber().await?;
    let (weights, _vetting) = vetted(subscriber.watch(), setup.policy.clone(), bus.clone());
    let page = match page {
        Some(page) => {
            let policy = setup.policy.clone();
            Some(page.open(bus, &history, setup.records.as_ref(), policy, weights.clone()).await?)
        }
        None => None,
    };
    let mut passes = Passes::default();
    history.iter().for_each(|pass| passes.push(pass));
    let publishers = Publishers::new(bus).await?;
    publishers.history.set(&passes.overview())?;
    let outlets = Outlets { records, passes, publishers, reports, page: page.as_ref() };
    let ended = judge_all(&setup, bus, weights, &selected, films.as_ref(), outlets, &stop).await;
    if let Some(films) = films {
        // Off the runtime: the film in hand takes a moment.
        tokio::task::spawn_blocking(move || films.close()).await.context("the thread that closes films panicked")?;
    }
    if let Some(page) = page {
        page.close().await;
    }
    ended
}

/// The passes that are recorded already.
async fn past(records: Option<&RecordPaths>) -> anyhow::Result<Vec<Pass>> {
    let Some(path) = records.map(|paths| paths.history.clone()).filter(|path| path.is_file()) else {
        return Ok(Vec::new());
    };
    // Off the runtime, because it waits for the disk.
    Ok(tokio::task::spawn_blocking(move || History::read(&path)).await??)
}

/// Judges whenever a pass is due, until `stop`.
async fn judge_all(
    setup: &EvaluatorSetup,
    bus: &Bus,
    mut weights: watch::Receiver<Option<Arc<Weights>>>,
    selected: &[&'static Blueprint],
    films: Option<&Studio>,
    mut outlets: Outlets<'_>,
    stop: &Stop,
) -> anyhow::Result<u64> {
    let _alive = tokio::select! {
        () = stop.now.cancelled() => return Ok(0),
        alive = bus.declare_alive_alone(Role::Evaluator, &setup.id, NAME_PATIENCE) => alive?,
    };
    let mut clerks = Clerks::hire(bus, setup_hash(setup)).await?;
    let mut last: Option<(Instant, Arc<Weights>)> = None;
    let mut n_passes = 0;
    loop {
        let waiting = bus.pulse().waiting();
        let newest = tokio::select! {
            () = stop.now.cancelled() => return Ok(n_passes),
            newest = next_due(setup, &mut weights, last.as_ref(), stop.last.clone()) => newest?,
        };
        drop(waiting);
        let Some(newest) = newest else { return Ok(n_passes) };
        let start = Instant::now();
        last = Some((start, newest.clone()));
        let (parts, mut newest_part) = watch::channel(None);
        let casting = films.and_then(|films| films.casting(&newest, &setup.config.episodes.acting));
        let desk = Arc::new(Desk::new(newest));
        clerks.open(desk.clone());
        let pass = judge(setup, selected.to_vec(), desk, casting, parts, (&stop.now, bus.pulse()));
        tokio::pin!(pass);
        let stamp = |mut report: EvalReport| {
            report.summary.elapsed_s = start.elapsed().as_secs_f64();
            report.summary.bus = bus.counts();
            report.summary.films = films.map(Studio::counts);
            report
        };
        let ended = loop {
            tokio::select! {
                // A part that came just before the end is still told.
                biased;
                Ok(()) = newest_part.changed() => {
                    let part = newest_part.borrow_and_update().clone();
                    if let Some(part) = part {
                        outlets.publishers.publish(&stamp(part)).await?;
                    }
                }
                ended = &mut pass => break ended?,
            }
        };
        clerks.close();
        let report = match ended {
            Err(EvalError::Interrupted) => return Ok(n_passes),
            // They were of use on the scene of the trial, but not throughout.
            Err(EvalError::Policy(error)) if error.is_of_weights() => {
                bus.count_refused_weights();
                tracing::warn!(%error, "weights refused, the pass is given up");
                continue;
            }
            report => stamp(report?),
        };
        n_passes += 1;
        outlets.put(report).await?;
    }
}

/// Where reports go.
struct Outlets<'r> {
    records: Option<Records>,
    passes: Passes,
    publishers: Publishers<'r>,
    reports: watch::Sender<Option<Arc<EvalReport>>>,
    page: Option<&'r OpenPage>,
}

impl Outlets<'_> {
    async fn put(&mut self, report: EvalReport) -> anyhow::Result<()> {
        let pass = Pass::new(&report, unix_ms());
        if let Some(page) = self.page {
            page.judged(&pass);
        }
        self.passes.push(&pass);
        self.publishers.history.set(&self.passes.overview())?;
        if let Some(open) = self.records.take() {
            let report = report.clone();
            // Off the runtime: the disk and whoever reads the history may take their time.
            let kept = tokio::task::spawn_blocking(move || open.keep(&report, &pass));
            self.records = Some(kept.await.context("the recording thread panicked")??);
        }
        self.publishers.publish(&report).await?;
        self.reports.send_replace(Some(Arc::new(report)));
        Ok(())
    }
}

/// Waits for weights that are to be judged; `None` if there will be none.
async fn next_due(
    setup: &EvaluatorSetup,
    weights: &mut watch::Receiver<Option<Arc<Weights>>>,
    last: Option<&(Instant, Arc<Weights>)>,
    mut told: Option<watch::Receiver<Option<WeightsVersion>>>,
) -> anyhow::Result<Option<Arc<Weights>>> {
    loop {
        if let Some(version) = told.as_mut().and_then(|told| *told.borrow_and_update()) {
            // They may still be on their way. Should they have been lost, those before them are judged.
            let are_there = |weights: &Option<Arc<Weights>>| weights.as_ref().is_some_and(|w| w.version >= version);
            drop(tokio::time::timeout(LAST_WEIGHTS_WAIT, weights.wait_for(are_there)).await);
            let judged = last.map(|(_, weights)| (weights.version, weights.n_env_steps));
            let newest = weights.borrow_and_update().clone();
            return Ok(newest.filter(|newest| judged != Some((newest.version, newest.n_env_steps))));
        }
        let newest = weights.borrow_and_update().clone();
        let rest = match newest {
            None => None,
            Some(newest) => {
                let last = last.map(|(start, weights)| LastPass {
                    version: weights.version,
                    n_env_steps: weights.n_env_steps,
                    elapsed: start.elapsed(),
                });
                match due(setup.config.every, last, &newest) {
                    Due::Now => return Ok(Some(newest)),
                    Due::After(rest) => Some(rest),
                    Due::WithNewer => None,
                }
            }
        };
        tokio::select! {
            changed = weights.changed() => changed.context("the bus closed")?,
            () = is_told(&mut told) => {}
            () = tokio::time::sleep(rest.unwrap_or_default()), if rest.is_some() => {}
        }
    }
}

/// Waits until the last weights are known; for ever if nobody says.
async fn is_told(told: &mut Option<watch::Receiver<Option<WeightsVersion>>>) {
    if let Some(told) = told
        && told.changed().await.is_ok()
    {
        return;
    }
    std::future::pending().await
}

/// Milliseconds since 1970, 0 before.
fn unix_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// One pass on a thread of its own; what it has found so far goes to `parts`.
async fn judge(
    setup: &EvaluatorSetup,
    selected: Vec<&'static Blueprint>,
    desk: Arc<Desk>,
    films: Option<Casting>,
    parts: watch::Sender<Option<EvalReport>>,
    (shutdown, pulse): (&CancellationToken, &Pulse),
) -> anyhow::Result<Result<EvalReport, EvalError>> {
    let eval_setup = EvalSetup {
        catalogue: Catalogue::builtin(),
        policy: setup.policy.clone(),
        environment: setup.environment.clone(),
        episodes: setup.config.episodes.clone(),
        reset_free: setup.config.reset_free.clone(),
        seed: setup.seed,
    };
    let (shutdown, pulse) = (shutdown.clone(), pulse.clone());
    on_thread(setup.config.nice, move || {
        let keep_going = || {
            pulse.beat();
            !shutdown.is_cancelled()
        };
        let workshop = Workshop { setup: &eval_setup, desk: &desk, films: films.as_ref(), keep_going: &keep_going };
        evaluate_in_parts(&workshop, &selected, &mut |part| drop(parts.send_replace(Some(part))))
    })
    .await
}

/// The keys that reports go to.
struct Publishers<'b> {
    bus: &'b Bus,
    history: HistoryAnswer,
    summary: MetricsPublisher,
    blueprints: BTreeMap<BlueprintId, MetricsPublisher>,
}

impl<'b> Publishers<'b> {
    async fn new(bus: &'b Bus) -> anyhow::Result<Self> {
        let summary = bus.metrics_publisher(keys::METRICS_EVAL_SUMMARY).await?;
        Ok(Self { bus, history: bus.history_answer().await?, summary, blueprints: BTreeMap::new() })
    }

    async fn publish(&mut self, report: &EvalReport) -> anyhow::Result<()> {
        for score in &report.blueprints {
            if !self.blueprints.contains_key(&score.blueprint) {
                let publisher = self.bus.metrics_publisher(&keys::metrics_eval(score.split, &score.blueprint)).await?;
                self.blueprints.insert(score.blueprint.clone(), publisher);
            }
            if let Some(publisher) = self.blueprints.get(&score.blueprint) {
                publisher.put(score).await?;
            }
        }
        // Last, so that whoever waits for the summary finds its blueprints there.
        self.summary.put(&report.summary).await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests;

//! The evaluator service: evaluates weights as they arrive and reports to the bus, to files, and to the caller.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anyhow::Context;
use blueprints::{Blueprint, BlueprintId, Catalog};
use bus::{Bus, HistoryAnswer, MetricsPublisher, Pulse};
use policy::Policy;
use proto::metrics::{EvalBlueprint, EvalReport};
use proto::{Role, Weights, WeightsVersion, keys};
use runlog::overview::Evaluations;
use runlog::series::outcome_of;
use runlog::{Evaluation, History, RunPaths};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::best::{Scored, Verdict};
use crate::config::{EpisodeConfig, EvaluatorConfigError, Selection};
use crate::episodes::evaluate_in_parts;
use crate::nice::on_thread;
use crate::pool::{EvaluationPool, EvaluationProgress};
use crate::records::Records;
use crate::schedule::{Due, LastEvaluation, due};
use crate::setup::{EvalError, EvalSetup, EvaluatorSetup, N_WORLDS};
use crate::validation::validated;
use crate::videos::{EpisodeSelector, VideoRecorder};

/// How long an evaluator waits for another one with its name to disconnect: a killed process still appears alive for up
/// to 6 s.
const NAME_PATIENCE: Duration = Duration::from_secs(15);

/// Channels to other parts of this process. Closed receivers are ignored.
#[derive(Debug, Default)]
pub struct Listeners {
    /// The newest report. If an evaluation is interrupted, an incomplete report of the episodes so far.
    pub reports: Option<watch::Sender<Option<Arc<EvalReport>>>>,
    /// Every evaluation: first those in the history, then each new one as it ends.
    pub evaluations: Option<mpsc::UnboundedSender<Evaluation>>,
    /// Progress of the current evaluation; `None` between evaluations.
    pub progress: Option<watch::Sender<Option<EvaluationProgress>>>,
    /// The weights of every complete evaluation with the verdict on them.
    pub evaluated: Option<mpsc::UnboundedSender<Scored>>,
    /// The newest weights with which a policy can act.
    pub weights: Option<watch::Sender<Option<Arc<Weights>>>>,
}

/// Summary of an evaluator's work, returned when it ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Completed evaluations.
    pub n_evaluations: u64,
}

/// Signals that end an evaluator.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    /// Abandons the current evaluation.
    pub now: CancellationToken,
    /// The last weights, once known. They are evaluated even if no evaluation is due, unless they already were. They do
    /// not come over the bus: a learner that has ended answers no pulls.
    pub last: Option<watch::Receiver<Option<Arc<Weights>>>>,
}

/// Evaluates the newest weights whenever an evaluation is due, until `stop`.
///
/// Each report goes to `metrics/eval/<split>/<blueprint>` and `metrics/eval/summary`, to the files of the run, and to
/// the `listeners`. During an evaluation, intermediate results go to the bus; see
/// [`FIRST_PART`](crate::episodes::FIRST_PART). If its weights prove unusable, the last complete report follows them.
/// Evaluations run on their own threads. Weights that arrive in the meantime wait.
///
/// # Errors
/// If the configuration is invalid, the session fails, the weights are of another network, an episode cannot be
/// started, the records cannot be opened or the history's last rows cannot be written at the end, or another evaluator
/// writes the same history.
pub async fn run(setup: EvaluatorSetup, bus: &Bus, mut listeners: Listeners, stop: Stop) -> anyhow::Result<Summary> {
    setup.config.videos.check_in(&setup.catalog)?;
    let selection = [&setup.config.selection, &setup.config.last_selection()];
    let [selected, last_selected] = selection.map(|selection| goals(selection, &setup.catalog));
    let selected = Selected { usual: selected?, last: last_selected? };
    let records = setup.records.as_ref().map(Records::open).transpose()?;
    let history = past(setup.records.as_ref()).await?;
    let videos = match &setup.records {
        Some(paths) => VideoRecorder::open(&setup.config.videos, paths, setup.catalog.clone())?,
        None => None,
    };
    let subscriber = bus.weights_subscriber().await?;
    let usable = listeners.weights.take().unwrap_or_else(|| watch::channel(None).0);
    let (weights, _validation) = validated(subscriber.watch(), usable, setup.policy.clone(), bus.clone());
    let mut evaluations = Evaluations::default();
    let last = history.last().and_then(|evaluation| Evaluated::before(evaluation, &setup, &selected));
    for evaluation in history {
        evaluations.push(&evaluation);
        tell(listeners.evaluations.as_ref(), evaluation);
    }
    let publishers = Publishers::new(bus).await?;
    publishers.history.set(&evaluations.overview())?;
    let mut outlets = Outlets { records, evaluations, publishers, last: None, listeners, videos: videos.as_ref() };
    let ended = evaluate_all(&setup, bus, weights, &selected, last, &mut outlets, &stop).await;
    let kept = outlets.catch_up().await;
    if let Some(videos) = videos {
        // Off the async runtime, because a frame of the current video takes a moment.
        tokio::task::spawn_blocking(move || videos.close()).await.context("the thread that closes videos panicked")?;
    }
    let n_evaluations = ended?;
    kept?;
    Ok(Summary { n_evaluations })
}

/// Sends an evaluation to the listener, which may be gone.
fn tell(listener: Option<&mpsc::UnboundedSender<Evaluation>>, evaluation: Evaluation) {
    if let Some(listener) = listener {
        let _ = listener.send(evaluation);
    }
}

/// Reads the evaluations that are already recorded.
async fn past(records: Option<&RunPaths>) -> anyhow::Result<Vec<Evaluation>> {
    let Some(path) = records.map(RunPaths::history).filter(|path| path.is_file()) else {
        return Ok(Vec::new());
    };
    // Off the async runtime, because it waits for the disk.
    Ok(tokio::task::spawn_blocking(move || History::read(&path)).await??)
}

/// Evaluates whenever an evaluation is due after `last`, until `stop`. Returns the number of completed evaluations.
async fn evaluate_all(
    setup: &EvaluatorSetup,
    bus: &Bus,
    mut weights: watch::Receiver<Option<Arc<Weights>>>,
    selected: &Selected,
    mut last: Option<Evaluated>,
    outlets: &mut Outlets<'_>,
    stop: &Stop,
) -> anyhow::Result<u64> {
    let _alive = tokio::select! {
        () = stop.now.cancelled() => return Ok(0),
        alive = bus.declare_alive_alone(Role::Evaluator, &setup.id, NAME_PATIENCE) => alive?,
    };
    let mut n_evaluations = 0;
    loop {
        let waiting = bus.pulse().waiting();
        let newest = tokio::select! {
            () = stop.now.cancelled() => return Ok(n_evaluations),
            newest = next_due(setup, &mut weights, last.as_ref(), selected, stop.last.clone()) => newest?,
        };
        drop(waiting);
        let Some((newest, is_last)) = newest else { return Ok(n_evaluations) };
        let start = Instant::now();
        last = Some(Evaluated { start, version: newest.version, n_env_steps: newest.n_env_steps, is_last });
        let (parts, mut newest_part) = watch::channel(None);
        let videos = outlets.videos;
        let selector = videos.and_then(|videos| videos.selector(&newest, &setup.config.episodes.acting));
        let (counted, progress) = watch::channel(EvaluationProgress::default());
        let goals = selected.of(is_last).to_vec();
        let signals = (&stop.now, bus.pulse());
        let evaluation = evaluate_once(setup, goals, newest.clone(), selector, parts, counted, signals);
        let stamp = |mut report: EvalReport| {
            report.summary.elapsed_s = start.elapsed().as_secs_f64();
            report.summary.bus = bus.counts();
            report.summary.videos = videos.map(VideoRecorder::counts);
            report
        };
        let report = match outlets.follow(evaluation, &mut newest_part, progress, &stamp).await? {
            Err(EvalError::Interrupted) => {
                // The partial report goes to the listener but not to the history, which has only complete evaluations.
                let part = newest_part.borrow().clone().filter(|part| !part.blueprints.is_empty());
                if let (Some(part), Some(reports)) = (part, &outlets.listeners.reports) {
                    reports.send_replace(Some(Arc::new(stamp(part))));
                }
                return Ok(n_evaluations);
            }
            // The weights passed the validation scene but failed on another one.
            Err(EvalError::Policy(error)) if error.is_of_weights() => {
                bus.count_refused_weights();
                tracing::warn!(%error, "weights refused, the evaluation is given up");
                outlets.publish_last().await?;
                continue;
            }
            report => stamp(report?),
        };
        n_evaluations += 1;
        outlets.judge(newest, Verdict::of(&setup.config.best, &selected.usual, &report));
        outlets.put(report).await?;
    }
}

/// Destinations of reports.
struct Outlets<'r> {
    records: Option<Records>,
    evaluations: Evaluations,
    publishers: Publishers<'r>,
    /// The newest complete report of this process.
    last: Option<EvalReport>,
    listeners: Listeners,
    videos: Option<&'r VideoRecorder>,
}

impl Outlets<'_> {
    fn progress(&self, so_far: Option<EvaluationProgress>) {
        if let Some(progress) = &self.listeners.progress {
            progress.send_replace(so_far);
        }
    }

    fn judge(&self, weights: Arc<Weights>, verdict: Verdict) {
        if let Some(evaluated) = &self.listeners.evaluated {
            // The receiver may be gone.
            drop(evaluated.send(Scored { weights, verdict }));
        }
    }

    /// Waits for the end of an evaluation. Until then, publishes its parts, after `stamp`, and its progress.
    async fn follow<T>(
        &mut self,
        evaluation: impl Future<Output = anyhow::Result<T>>,
        parts: &mut watch::Receiver<Option<EvalReport>>,
        mut progress: watch::Receiver<EvaluationProgress>,
        stamp: impl Fn(EvalReport) -> EvalReport,
    ) -> anyhow::Result<T> {
        tokio::pin!(evaluation);
        let ended = loop {
            tokio::select! {
                // Biased, so that a part that arrives just before the end is still published.
                biased;
                Ok(()) = parts.changed() => {
                    let part = parts.borrow_and_update().clone();
                    if let Some(part) = part {
                        self.publishers.publish(&stamp(part)).await?;
                    }
                }
                Ok(()) = progress.changed() => self.progress(Some(*progress.borrow_and_update())),
                ended = &mut evaluation => break ended,
            }
        };
        self.progress(None);
        ended
    }

    async fn put(&mut self, report: EvalReport) -> anyhow::Result<()> {
        let evaluation = Evaluation::new(&report, unix_ms());
        tell(self.listeners.evaluations.as_ref(), evaluation.clone());
        self.evaluations.push(&evaluation);
        self.publishers.history.set(&self.evaluations.overview())?;
        if let Some(mut open) = self.records.take() {
            let report = report.clone();
            // Off the async runtime, because the disk and readers of the history may be slow.
            let kept = tokio::task::spawn_blocking(move || {
                open.keep(&report, evaluation);
                open
            });
            self.records = Some(kept.await.context("the recording thread panicked")?);
        }
        self.publishers.publish(&report).await?;
        if let Some(reports) = &self.listeners.reports {
            reports.send_replace(Some(Arc::new(report.clone())));
        }
        self.last = Some(report);
        Ok(())
    }

    /// Writes the evaluations that the history could not take before.
    async fn catch_up(&mut self) -> anyhow::Result<()> {
        let Some(mut open) = self.records.take() else { return Ok(()) };
        let kept = tokio::task::spawn_blocking(move || open.catch_up());
        kept.await.context("the recording thread panicked")?.context("the last evaluations are lost")
    }

    /// Publishes the last complete report again, if there is one. After an evaluation that is given up, its last part
    /// would otherwise stay the newest report, and viewers would show it as in progress.
    async fn publish_last(&mut self) -> anyhow::Result<()> {
        let Some(report) = &mut self.last else { return Ok(()) };
        // Counters of the process, which must not fall back to their values of that time.
        report.summary.bus = self.publishers.bus.counts();
        report.summary.videos = self.videos.map(VideoRecorder::counts);
        self.publishers.publish(report).await
    }
}

/// The blueprints to evaluate.
struct Selected {
    /// For every evaluation except the one of the last weights.
    usual: Vec<Blueprint>,
    /// For the last weights: `usual`, plus those of
    /// [`EvaluatorConfig::last_splits`](crate::EvaluatorConfig::last_splits).
    last: Vec<Blueprint>,
}

impl Selected {
    fn of(&self, is_last: bool) -> &[Blueprint] {
        if is_last { &self.last } else { &self.usual }
    }

    /// Whether an evaluation covered everything that the evaluation of the last weights would.
    fn is_covered(&self, evaluated: &Evaluated) -> bool {
        evaluated.is_last || self.last.len() == self.usual.len()
    }
}

/// The newest evaluation, complete or not.
struct Evaluated {
    start: Instant,
    version: WeightsVersion,
    n_env_steps: u64,
    /// Whether it covered all blueprints of `Selected::last`.
    is_last: bool,
}

impl Evaluated {
    /// Returns the last evaluation of the history, unless it lacks some episodes of the current configuration and must
    /// be repeated.
    fn before(evaluation: &Evaluation, setup: &EvaluatorSetup, selected: &Selected) -> Option<Self> {
        let EpisodeConfig { n_episodes, acting, .. } = &setup.config.episodes;
        let has = |blueprint: &Blueprint| {
            let of_it = |score: &&EvalBlueprint| score.blueprint == *blueprint.id();
            let has_all = |score: &EvalBlueprint| {
                let of = |acting| outcome_of(score, acting).map(|outcome| outcome.success.n_episodes);
                acting.iter().all(|&acting| of(acting) == Some(u64::from(*n_episodes)))
            };
            evaluation.blueprints.iter().find(of_it).is_some_and(has_all)
        };
        let of_evaluation = evaluation.reset_free.as_ref().map(|runs| (runs.n_runs, runs.n_goals));
        let wanted = setup.config.reset_free.as_ref().map(|runs| (runs.n_runs.into(), runs.n_goals.into()));
        let has_runs = wanted.is_none() || wanted == of_evaluation;
        let has_all_results = evaluation.seed == setup.seed && has_runs && selected.usual.iter().all(has);
        let since = unix_ms().saturating_sub(evaluation.ended_unix_ms) as f64 / 1000.0 + evaluation.elapsed_s;
        let start = Duration::try_from_secs_f64(since).ok().and_then(|since| Instant::now().checked_sub(since));
        has_all_results.then(|| Self {
            // The monotonic clock may have started after that evaluation, for example after a reboot.
            start: start.unwrap_or_else(Instant::now),
            version: evaluation.weights_version,
            n_env_steps: evaluation.n_env_steps,
            is_last: selected.last.iter().all(has),
        })
    }
}

/// Waits for weights that are due, and returns them with whether they are the last; `None` if no more will be
/// evaluated.
async fn next_due(
    setup: &EvaluatorSetup,
    weights: &mut watch::Receiver<Option<Arc<Weights>>>,
    last: Option<&Evaluated>,
    selected: &Selected,
    mut last_weights: Option<watch::Receiver<Option<Arc<Weights>>>>,
) -> anyhow::Result<Option<(Arc<Weights>, bool)>> {
    loop {
        if let Some(newest) = last_weights.as_mut().and_then(|last| last.borrow_and_update().clone()) {
            let covered = last.filter(|last| selected.is_covered(last));
            let evaluated = covered.map(|last| (last.version, last.n_env_steps));
            let is_new = evaluated != Some((newest.version, newest.n_env_steps));
            return Ok(is_new.then_some((newest, true)));
        }
        let newest = weights.borrow_and_update().clone();
        let rest = match newest {
            None => None,
            Some(newest) => {
                let last = last.map(|last| LastEvaluation {
                    version: last.version,
                    n_env_steps: last.n_env_steps,
                    elapsed: last.start.elapsed(),
                });
                match due(setup.config.every, last, &newest) {
                    Due::Now => return Ok(Some((newest, false))),
                    Due::After(rest) => Some(rest),
                    Due::WithNewer => None,
                }
            }
        };
        tokio::select! {
            changed = weights.changed() => changed.context("the bus closed")?,
            () = is_known(&mut last_weights) => {}
            () = tokio::time::sleep(rest.unwrap_or_default()), if rest.is_some() => {}
        }
    }
}

/// Waits until the last weights are known, or forever if there is no sender.
async fn is_known(last_weights: &mut Option<watch::Receiver<Option<Arc<Weights>>>>) {
    if let Some(last_weights) = last_weights
        && last_weights.changed().await.is_ok()
    {
        return;
    }
    std::future::pending().await
}

fn goals(selection: &Selection, catalog: &Catalog) -> Result<Vec<Blueprint>, EvaluatorConfigError> {
    Ok(selection.select(catalog)?.into_iter().cloned().collect())
}

/// Returns the milliseconds since 1970; 0 if the clock is earlier.
fn unix_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// Runs one evaluation on a separate thread; intermediate reports go to `parts`, its progress goes to `counted`.
async fn evaluate_once(
    setup: &EvaluatorSetup,
    selected: Vec<Blueprint>,
    weights: Arc<Weights>,
    videos: Option<EpisodeSelector>,
    parts: watch::Sender<Option<EvalReport>>,
    counted: watch::Sender<EvaluationProgress>,
    (shutdown, pulse): (&CancellationToken, &Pulse),
) -> anyhow::Result<Result<EvalReport, EvalError>> {
    let (setup, shutdown, pulse) = (setup.clone(), shutdown.clone(), pulse.clone());
    on_thread(move || {
        let EvaluatorSetup { config, policy, environment, seed, catalog, .. } = setup;
        let (episodes, reset_free) = (config.episodes.clone(), config.reset_free.clone());
        let eval_setup = EvalSetup { catalog: &catalog, environment, episodes, reset_free, n_worlds: N_WORLDS, seed };
        let keep_going = || {
            pulse.beat();
            !shutdown.is_cancelled()
        };
        let agent = || Policy::with_weights(&policy, &weights).map_err(EvalError::from);
        let setup = &eval_setup;
        let observer = videos.as_ref();
        let progress = Some(&counted);
        let pool = EvaluationPool { setup, agent: &agent, observer, progress, keep_going: &keep_going };
        let selected: Vec<&Blueprint> = selected.iter().collect();
        evaluate_in_parts(&pool, Some(&weights), &selected, &mut |part| drop(parts.send_replace(Some(part))))
    })
    .await
}

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
        // Published last, so that subscribers that wait for the summary already have its blueprints.
        self.summary.put(&report.summary).await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests;

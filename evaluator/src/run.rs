//! The evaluator service: evaluates weights as they arrive and reports to the bus, to files, and to the caller.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use blueprints::{Blueprint, BlueprintId};
use bus::{Bus, HistoryAnswer, MetricsPublisher, NAME_PATIENCE, Pulse, unix_ms};
use policy::Policy;
use proto::metrics::{EvalBlueprint, EvalReport};
use proto::{Role, Weights, keys};
use runlog::overview::Evaluations;
use runlog::{Evaluation, History, RunPaths};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::best::{Scored, Verdict};
use crate::config::{EpisodeConfig, EvaluatorConfigError, Selection};
use crate::episodes::evaluate_in_parts;
use crate::nice::on_thread;
use crate::pool::{EvaluationPool, EvaluationProgress};
use crate::recording::Recorder;
use crate::records::Records;
use crate::schedule::{Due, Evaluated, due};
use crate::setup::{EvalError, EvalSetup, EvaluatorSetup, N_WORLDS, Performer};
use crate::videos::{EpisodeSelector, VideoRecorder};

/// Channels to other parts of this process. Closed receivers are ignored.
#[derive(Debug)]
pub struct Listeners {
    /// The newest report. If an evaluation is interrupted, an incomplete report of the episodes so far.
    pub reports: watch::Sender<Option<Arc<EvalReport>>>,
    /// Every evaluation: first those in the history, then each new one as it ends.
    pub evaluations: mpsc::UnboundedSender<Evaluation>,
    /// Progress of the current evaluation; `None` between evaluations.
    pub progress: watch::Sender<Option<EvaluationProgress>>,
    /// The weights of every complete evaluation with the verdict on them.
    pub evaluated: mpsc::UnboundedSender<Scored>,
    /// The newest weights with which a policy can act.
    pub weights: watch::Sender<Option<Arc<Weights>>>,
}

impl Default for Listeners {
    /// Returns channels without receivers.
    fn default() -> Self {
        Self {
            reports: watch::Sender::default(),
            evaluations: mpsc::unbounded_channel().0,
            progress: watch::Sender::default(),
            evaluated: mpsc::unbounded_channel().0,
            weights: watch::Sender::default(),
        }
    }
}

/// Signals that end an evaluator.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    /// Abandons the current evaluation.
    pub now: CancellationToken,
    /// The last weights, once known. They are evaluated even if no evaluation is due, unless they already were, and then
    /// the evaluator ends. They do not come over the bus: a learner that has ended answers no pulls.
    pub last: Option<watch::Receiver<Option<Arc<Weights>>>>,
}

/// Evaluates the newest weights whenever an evaluation is due, until `stop`. Returns how many evaluations it completed.
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
pub async fn run(setup: EvaluatorSetup, bus: &Bus, mut listeners: Listeners, stop: Stop) -> anyhow::Result<u64> {
    setup.config.videos.check_in(&setup.catalog)?;
    let goals = |selection: &Selection| -> Result<Vec<Blueprint>, EvaluatorConfigError> {
        Ok(selection.select(&setup.catalog)?.into_iter().cloned().collect())
    };
    let selected = Selected { usual: goals(&setup.config.selection)?, last: goals(&setup.config.last_selection())? };
    let records = setup.records.as_ref().map(Records::open).transpose()?;
    let history = past(setup.records.as_ref()).await?;
    let videos = match &setup.records {
        Some(paths) => VideoRecorder::open(&setup.config.videos, paths, setup.catalog.clone())?,
        None => None,
    };
    let usable = std::mem::take(&mut listeners.weights);
    let (weights, policy) = (usable.subscribe(), setup.policy.clone());
    let try_out = move |weights: Weights| match Policy::with_weights(&policy, &weights) {
        Err(error) if error.is_of_weights() => {
            tracing::warn!(version = weights.version.0, %error, "weights refused, those before them stay in force");
            None
        }
        // Weights of another network pass, because waiting does not help: the evaluation then reports the error.
        _ => {
            usable.send_replace(Some(Arc::new(weights)));
            Some(())
        }
    };
    let _subscriber = bus.weights_subscriber_keeping(try_out).await?;
    let mut evaluations = Evaluations::default();
    let last = history.last().and_then(|evaluation| Evaluated::before(evaluation, &setup, &selected));
    for evaluation in history {
        evaluations.push(&evaluation);
        drop(listeners.evaluations.send(evaluation));
    }
    let publishers = Publishers::new(bus).await?;
    publishers.history.set(&evaluations.overview())?;
    let mut outlets = Outlets { records, evaluations, publishers, listeners, videos: videos.as_ref() };
    let ended = evaluate_all(&setup, bus, weights, &selected, last, &mut outlets, &stop).await;
    let kept = outlets.catch_up().await;
    if let Some(videos) = videos {
        // Off the async runtime, because a frame of the current video takes a moment.
        tokio::task::spawn_blocking(move || videos.close()).await.context("the thread that closes videos panicked")?;
    }
    let n_evaluations = ended?;
    kept?;
    Ok(n_evaluations)
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
    // Without `stop.last`, the newest weights may be the last ones once the learner is gone.
    let learner = match setup.config.evaluate_last && stop.last.is_none() {
        true => Some(bus.learner_watch().await?),
        false => None,
    };
    let mut n_evaluations = 0;
    loop {
        let waiting = bus.pulse().waiting();
        let is_there = learner.as_ref().map(|learner| learner.watch());
        let next = next_due(setup, &mut weights, last.as_ref(), selected, stop.last.clone(), is_there);
        let newest = tokio::select! {
            () = stop.now.cancelled() => return Ok(n_evaluations),
            newest = next => newest?,
        };
        drop(waiting);
        let Some((newest, is_last)) = newest else { return Ok(n_evaluations) };
        let start = Instant::now();
        last = Some(Evaluated { start, version: newest.version, n_env_steps: newest.n_env_steps, is_last });
        let (parts, newest_part) = watch::channel(None);
        let videos = outlets.videos;
        let selector = videos.and_then(|videos| videos.selector(&setup.config.episodes.acting));
        let progress = outlets.listeners.progress.clone();
        let goals = if is_last { selected.last.clone() } else { selected.usual.clone() };
        let signals = (&stop.now, bus.pulse());
        let evaluation = evaluate_once(setup, goals, newest.clone(), selector, parts, progress, signals);
        let stamp = |mut report: EvalReport| {
            report.summary.elapsed_s = start.elapsed().as_secs_f64();
            report.summary.bus = bus.counts();
            report.summary.videos = videos.map(VideoRecorder::counts);
            report
        };
        let report = match outlets.follow(evaluation, newest_part, &stamp).await? {
            // The weights passed the validation scene but failed on another one.
            Err(EvalError::Policy(error)) if error.is_of_weights() => {
                bus.count_refused_weights();
                tracing::warn!(%error, "weights refused, the evaluation is given up");
                outlets.publish_last().await?;
                continue;
            }
            report => stamp(report?),
        };
        if !report.summary.is_complete {
            // Interrupted. The history has only complete evaluations.
            if !report.blueprints.is_empty() {
                outlets.publishers.publish(&report).await?;
                outlets.listeners.reports.send_replace(Some(Arc::new(report)));
            }
            return Ok(n_evaluations);
        }
        n_evaluations += 1;
        let verdict = Verdict::of(&setup.config.best, &selected.usual, &report);
        drop(outlets.listeners.evaluated.send(Scored { weights: newest, verdict }));
        outlets.put(report).await?;
    }
}

/// Destinations of reports.
struct Outlets<'r> {
    records: Option<Records>,
    evaluations: Evaluations,
    publishers: Publishers<'r>,
    listeners: Listeners,
    videos: Option<&'r VideoRecorder>,
}

impl Outlets<'_> {
    /// Waits for the end of an evaluation. Until then, publishes its parts, after `stamp`.
    async fn follow<T>(
        &mut self,
        evaluation: impl Future<Output = anyhow::Result<T>>,
        mut parts: watch::Receiver<Option<EvalReport>>,
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
                ended = &mut evaluation => break ended,
            }
        };
        self.listeners.progress.send_replace(None);
        ended
    }

    async fn put(&mut self, report: EvalReport) -> anyhow::Result<()> {
        let evaluation = Evaluation::new(&report, unix_ms());
        // First, so that whoever is told of it finds it in the files.
        if let Some(mut open) = self.records.take() {
            let (report, row) = (report.clone(), evaluation.clone());
            // Off the async runtime, because the disk and readers of the history may be slow.
            let kept = tokio::task::spawn_blocking(move || {
                open.keep(&report, row);
                open
            });
            self.records = Some(kept.await.context("the recording thread panicked")?);
        }
        self.evaluations.push(&evaluation);
        self.publishers.history.set(&self.evaluations.overview())?;
        drop(self.listeners.evaluations.send(evaluation));
        self.publishers.publish(&report).await?;
        self.listeners.reports.send_replace(Some(Arc::new(report)));
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
        let Some(mut report) = self.listeners.reports.borrow().as_deref().cloned() else { return Ok(()) };
        // Counters of the process, which must not fall back to their values of that time.
        report.summary.bus = self.publishers.bus.counts();
        report.summary.videos = self.videos.map(VideoRecorder::counts);
        self.publishers.publish(&report).await
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

impl Evaluated {
    /// Returns the last evaluation of the history, unless it lacks some episodes of the current configuration and must
    /// be repeated.
    fn before(evaluation: &Evaluation, setup: &EvaluatorSetup, selected: &Selected) -> Option<Self> {
        let EpisodeConfig { n_episodes, acting, .. } = &setup.config.episodes;
        let has = |blueprint: &Blueprint| {
            let of_it = |score: &&EvalBlueprint| score.blueprint == *blueprint.id();
            let has_all = |score: &EvalBlueprint| {
                let of = |acting| score.outcome(acting).map(|outcome| outcome.success.n_episodes);
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
/// evaluated. The last ones are `last_weights`, once known, or the newest when no learner `is_there` any longer.
async fn next_due(
    setup: &EvaluatorSetup,
    weights: &mut watch::Receiver<Option<Arc<Weights>>>,
    last: Option<&Evaluated>,
    selected: &Selected,
    mut last_weights: Option<watch::Receiver<Option<Arc<Weights>>>>,
    mut is_there: Option<watch::Receiver<bool>>,
) -> anyhow::Result<Option<(Arc<Weights>, bool)>> {
    // The last weights may have more goals: an evaluation without those does not count as theirs.
    let covers = |last: &&Evaluated| last.is_last || selected.last.len() == selected.usual.len();
    let evaluated = last.filter(covers).map(|last| (last.version, last.n_env_steps));
    let is_new = |newest: &Weights| evaluated != Some((newest.version, newest.n_env_steps));
    loop {
        if let Some(newest) = last_weights.as_mut().and_then(|last| last.borrow_and_update().clone()) {
            return Ok(is_new(&newest).then_some((newest, true)));
        }
        let newest = weights.borrow_and_update().clone();
        let is_gone = is_there.as_mut().is_some_and(|is_there| !*is_there.borrow_and_update());
        if is_gone && let Some(newest) = newest.clone().filter(|newest| newest.n_env_steps > 0 && is_new(newest)) {
            return Ok(Some((newest, true)));
        }
        let rest = match newest.map(|newest| (due(setup.config.every, last, &newest, Instant::now()), newest)) {
            Some((Due::Now, newest)) => return Ok(Some((newest, false))),
            Some((Due::After(rest), _)) => Some(rest),
            Some((Due::WithNewer, _)) | None => None,
        };
        tokio::select! {
            changed = weights.changed() => changed.context("the bus closed")?,
            // Never, if there is no receiver or its sender is gone.
            Some(Ok(())) = async { Some(last_weights.as_mut()?.changed().await) } => {}
            Some(Ok(())) = async { Some(is_there.as_mut()?.changed().await) } => {}
            () = tokio::time::sleep(rest.unwrap_or_default()), if rest.is_some() => {}
        }
    }
}

/// Runs one evaluation on a separate thread; intermediate reports go to `parts`.
async fn evaluate_once(
    setup: &EvaluatorSetup,
    selected: Vec<Blueprint>,
    weights: Arc<Weights>,
    videos: Option<EpisodeSelector>,
    parts: watch::Sender<Option<EvalReport>>,
    progress: watch::Sender<Option<EvaluationProgress>>,
    (shutdown, pulse): (&CancellationToken, &Pulse),
) -> anyhow::Result<Result<EvalReport, EvalError>> {
    let (setup, shutdown, pulse) = (setup.clone(), shutdown.clone(), pulse.clone());
    on_thread(move || {
        let EvaluatorSetup { config, policy, environment, seed, catalog, .. } = setup;
        let (episodes, reset_free) = (config.episodes.clone(), config.reset_free.clone());
        let setup = EvalSetup { catalog: &catalog, environment, episodes, reset_free, n_worlds: N_WORLDS, seed };
        let keep_going = || {
            pulse.beat();
            !shutdown.is_cancelled()
        };
        let (setup, performer) = (&setup, Performer::Policy(&policy, &weights));
        let recorder = videos.as_ref().map(|selector| selector as &dyn Recorder);
        let pool = EvaluationPool { setup, performer, recorder, progress: Some(&progress), keep_going: &keep_going };
        let selected: Vec<&Blueprint> = selected.iter().collect();
        evaluate_in_parts(&pool, &selected, &mut |part| drop(parts.send_replace(Some(part))))
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

//! An evaluator on an isolated bus.

use std::time::Duration;

use blueprints::{Catalog, Split};
use proto::metrics::EvalSummary;
use proto::{ActionMode, Valid, WeightsVersion};
use tokio::task::JoinHandle;

use super::*;
use crate::config::{EvaluatorConfig, Every, ResetFreeConfig, Selection};
use crate::episodes::tests::{small_policy, small_setup, weights};
use crate::report::tests::episode;
use crate::report::{End, summarize};

/// Fails a test that waits for something that does not happen.
async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(120), future).await.expect("it takes a moment only")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn reports_reach_the_bus_the_files_and_the_caller() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let episodes = EpisodeConfig { n_episodes: 1, ..Default::default() };
    let selection = Selection { sizes: [2, 2], ..Default::default() };
    let n_selected = selection.select(Catalog::builtin()).unwrap().len();
    let records = RunPaths::new(dir.path());
    let config = EvaluatorConfig { every: Every::Versions(2), selection, episodes, ..Default::default() };
    let setup = setup(config, Some(records.clone()));
    let (reports, mut seen) = watch::channel(None);
    let listeners = Listeners { reports, ..Default::default() };
    let (tell, last) = watch::channel(None);
    let stop = Stop { last: Some(last), ..Stop::default() };
    let service = start(setup, &bus, listeners, &stop);

    let publisher = bus.weights_publisher().await.unwrap();
    let untrained = weights();
    // Refused without ending the service: the next weights are evaluated. The version is lower because, within one
    // epoch, only newer weights are pulled.
    let version = WeightsVersion(untrained.version.0 - 1);
    let huge = Weights { version, parameters: vec![1e6; untrained.parameters.len()], ..untrained.clone() };
    publisher.publish(Arc::new(huge)).await.unwrap();
    within(async {
        while bus.counts().weights_refused_total == 0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    publisher.publish(Arc::new(untrained.clone())).await.unwrap();
    let report = within(seen.wait_for(Option::is_some)).await.unwrap().clone().unwrap();
    assert_eq!(report.summary.weights_version, untrained.version);
    assert_eq!(report.blueprints.len(), n_selected);

    // One version later no evaluation is due; two versions later one is.
    for passed in [1, 2] {
        let version = WeightsVersion(untrained.version.0 + passed);
        publisher.publish(Arc::new(Weights { version, ..untrained.clone() })).await.unwrap();
    }
    let is_later = |report: &Option<Arc<EvalReport>>| {
        report.as_ref().is_some_and(|report| report.summary.weights_version.0 == untrained.version.0 + 2)
    };
    within(seen.wait_for(is_later)).await.unwrap();
    // Not due, but the last weights.
    let last = WeightsVersion(untrained.version.0 + 3);
    tell.send_replace(Some(Arc::new(Weights { version: last, ..untrained.clone() })));
    assert_eq!(within(service).await.unwrap().unwrap(), 3);
    assert_eq!(seen.borrow().as_ref().unwrap().summary.weights_version, last);

    let text = std::fs::read_to_string(records.metrics()).unwrap();
    let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 3 * (1 + n_selected));
    assert_eq!(lines[0]["key"], "eval/summary");
    let summary: EvalSummary = serde_json::from_value(lines[0].clone()).unwrap();
    assert_eq!(summary, report.summary);
    let first: EvalBlueprint = serde_json::from_value(lines[1].clone()).unwrap();
    assert_eq!(first, report.blueprints[0]);
    assert_eq!(lines[1]["key"], format!("eval/train/{}", first.blueprint));
    let evaluations = History::read(&records.history()).unwrap();
    assert_eq!(evaluations.len(), 3);
    assert_eq!(evaluations[0], Evaluation::new(&report, evaluations[0].ended_unix_ms));
    // The evaluations ended in order, after the start of 2026.
    assert!(
        1_767_225_600_000 < evaluations[0].ended_unix_ms
            && evaluations[0].ended_unix_ms <= evaluations[1].ended_unix_ms
    );
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_first_numbers_of_an_evaluation_are_told_before_it_ends() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let episodes = EpisodeConfig { n_episodes: 1, acting: vec![ActionMode::Greedy], ..Default::default() };
    // 45 blueprints: parts of 32 and 45 episodes.
    let selection = Selection { sizes: [2, 3], splits: vec![Split::Train], ..Default::default() };
    let config = EvaluatorConfig { every: Every::Versions(1), selection, episodes, ..Default::default() };
    let setup = setup(config, None);
    let mut summaries = bus.metrics_subscriber(keys::METRICS_EVAL_SUMMARY).await.unwrap();
    let (reports, seen) = watch::channel(None);
    let (so_far, counted) = watch::channel(None);
    let listeners = Listeners { reports, progress: so_far, ..Default::default() };
    let stop = Stop::default();
    let service = start(setup, &bus, listeners, &stop);
    let publisher = bus.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(weights())).await.unwrap();

    let mut progress = Vec::new();
    while !progress.last().is_some_and(|&(is_complete, _)| is_complete) {
        let sample = within(summaries.recv()).await.unwrap();
        let summary: EvalSummary = serde_json::from_value(sample.value).unwrap();
        assert_eq!(summary.n_planned, 45);
        progress.push((summary.is_complete, summary.all.greedy.success.n_episodes));
    }
    assert_eq!(progress, [(false, 32), (true, 45)]);
    assert!(counted.borrow().is_none(), "nothing is under way");
    stop.now.cancel();
    within(service).await.unwrap().unwrap();
    // The caller's channel receives complete evaluations, and a partial one only if it is interrupted.
    assert_eq!(seen.borrow().as_ref().unwrap().summary.all.greedy.success.n_episodes, 45);
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_last_weights_are_evaluated_on_the_last_splits_too() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let episodes = EpisodeConfig { n_episodes: 1, acting: vec![ActionMode::Greedy], ..Default::default() };
    let blueprints = ["2_000", "validation_7_000"].map(|id| id.parse().unwrap()).to_vec();
    let selection = Selection { splits: vec![Split::Train], blueprints, ..Default::default() };
    let last_splits = vec![Split::Validation];
    let config = EvaluatorConfig { every: Every::Versions(1), selection, last_splits, episodes, ..Default::default() };
    let setup = setup(config, None);
    let (reports, mut seen) = watch::channel(None);
    let (evaluated, mut verdicts) = mpsc::unbounded_channel();
    let listeners = Listeners { reports, evaluated, ..Default::default() };
    let (tell, last) = watch::channel(None);
    let stop = Stop { last: Some(last), ..Stop::default() };
    let service = start(setup, &bus, listeners, &stop);
    let publisher = bus.weights_publisher().await.unwrap();
    let untrained = weights();
    publisher.publish(Arc::new(untrained.clone())).await.unwrap();
    let ids = |report: &EvalReport| -> Vec<String> {
        report.blueprints.iter().map(|score| score.blueprint.to_string()).collect()
    };
    let report = within(seen.wait_for(Option::is_some)).await.unwrap().clone().unwrap();
    assert_eq!(ids(&report), ["2_000"]);
    // Already evaluated, but not on the last splits.
    tell.send_replace(Some(Arc::new(untrained.clone())));
    assert_eq!(within(service).await.unwrap().unwrap(), 2);
    let report = seen.borrow().clone().unwrap();
    assert_eq!(ids(&report), ["2_000", "validation_7_000"]);
    assert_eq!(report.summary.groups.last().unwrap().name, "validation");
    // The best weights are chosen by the usual goals alone.
    for _ in 0..2 {
        let Scored { weights, verdict } = verdicts.recv().await.unwrap();
        assert_eq!((weights.version, verdict.goals.as_str(), verdict.n_goals), (untrained.version, "train", 1));
    }
    assert!(verdicts.recv().await.is_none());
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_interrupted_evaluation_tells_of_every_episode_that_has_ended() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    // Never complete before it is interrupted.
    let setup = one_goal(10_000, None);
    let (reports, seen) = watch::channel(None);
    let (progress, mut counted) = watch::channel(None);
    let listeners = Listeners { reports, progress, ..Default::default() };
    let stop = Stop::default();
    let service = start(setup, &bus, listeners, &stop);
    let publisher = bus.weights_publisher().await.unwrap();
    publisher.publish(Arc::new(weights())).await.unwrap();
    let some = within(counted.wait_for(|progress| progress.is_some_and(|progress| progress.n_ended > 0)));
    let n_ended = some.await.unwrap().unwrap().n_ended;
    stop.now.cancel();
    assert_eq!(within(service).await.unwrap().unwrap(), 0);
    let report = seen.borrow().clone().unwrap();
    assert!(!report.summary.is_complete);
    assert_eq!(report.summary.n_planned, 10_000);
    let n_told = report.summary.all.greedy.success.n_episodes;
    assert!((n_ended..10_000).contains(&n_told), "{n_told} after {n_ended}");
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_last_complete_report_replaces_the_parts_of_one_that_is_given_up() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let mut summaries = bus.metrics_subscriber(keys::METRICS_EVAL_SUMMARY).await.unwrap();
    let mut outlets = Outlets {
        records: None,
        evaluations: Evaluations::default(),
        publishers: Publishers::new(&bus).await.unwrap(),
        listeners: Listeners::default(),
        videos: None,
    };
    let goal = Catalog::builtin().of_split(Split::Train)[0];
    let episode = episode(goal.id().as_str(), ActionMode::Greedy, End::TimeLimit, 8);
    let report = |version, is_complete| {
        let mut report = summarize(WeightsVersion(version), 0, std::slice::from_ref(&episode));
        report.summary.is_complete = is_complete;
        report
    };
    // Before the first complete report, there is nothing to tell.
    outlets.publish_last().await.unwrap();
    outlets.put(report(1, true)).await.unwrap();
    outlets.publishers.publish(&report(2, false)).await.unwrap();
    bus.count_refused_weights();
    outlets.publish_last().await.unwrap();
    let mut published = Vec::new();
    for _ in 0..3 {
        let sample = within(summaries.recv()).await.unwrap();
        let summary: EvalSummary = serde_json::from_value(sample.value).unwrap();
        published.push((summary.weights_version.0, summary.is_complete, summary.bus.weights_refused_total));
    }
    assert_eq!(published, [(1, true, 0), (2, false, 0), (1, true, 1)]);
    // Its results by blueprint are told again too.
    let mut scores = bus.metrics_subscriber(&keys::metrics_eval(Split::Train, goal.id())).await.unwrap();
    let score: EvalBlueprint = serde_json::from_value(within(scores.recv()).await.unwrap().value).unwrap();
    assert_eq!(score.weights_version.0, 1);
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn weights_that_an_earlier_evaluator_of_the_run_evaluated_are_not_evaluated_again() {
    let dir = tempfile::tempdir().unwrap();
    let records = RunPaths::new(dir.path());
    let runs = |n_runs| Some(ResetFreeConfig { n_runs, n_goals: 1 });
    // The second run resumes from the weights of the first. The third has more episodes, the next ones have runs without
    // resets as well: one, the same again, and two.
    let all = [(1, None, 1), (1, None, 0), (2, None, 1), (2, runs(1), 1), (2, runs(1), 0), (2, runs(2), 1)];
    for (k, (n_episodes, reset_free, expected)) in all.into_iter().enumerate() {
        let bus = Bus::isolated(dir.path()).await.unwrap();
        let publisher = bus.weights_publisher().await.unwrap();
        publisher.publish(Arc::new(weights())).await.unwrap();
        let (_tell, last) = watch::channel(Some(Arc::new(weights())));
        let stop = Stop { last: Some(last), ..Stop::default() };
        let mut setup = one_goal(n_episodes, Some(records.clone()));
        setup.config = setup.config.with(|config| config.reset_free = reset_free).unwrap();
        let n_evaluations = within(run(setup, &bus, Listeners::default(), stop)).await.unwrap();
        assert_eq!(n_evaluations, expected, "case {k}");
        bus.close().await;
    }
    assert_eq!(History::read(&records.history()).unwrap().len(), 4);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_newest_weights_are_evaluated_once_the_learner_is_gone() {
    let dir = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(dir.path()).await.unwrap();
    let mut setup = one_goal(1, None);
    let rare = |config: &mut EvaluatorConfig| (config.every, config.evaluate_last) = (Every::Versions(1000), true);
    setup.config = setup.config.with(rare).unwrap();
    let (reports, mut seen) = watch::channel(None);
    let (usable, mut arrived) = watch::channel(None);
    let listeners = Listeners { reports, weights: usable, ..Default::default() };
    let stop = Stop::default();
    let service = start(setup, &bus, listeners, &stop);
    // Each learner is gone before an evaluation is due.
    for version in [1, 2].map(WeightsVersion) {
        let publisher = bus.weights_publisher().await.unwrap();
        publisher.publish(Arc::new(Weights { version, n_env_steps: version.0, ..weights() })).await.unwrap();
        let is_there = |newest: &Option<Arc<Weights>>| newest.as_ref().is_some_and(|newest| newest.version == version);
        within(arrived.wait_for(is_there)).await.unwrap();
        assert!(seen.borrow().as_ref().is_none_or(|report: &Arc<EvalReport>| report.summary.weights_version < version));
        drop(publisher);
        let is_evaluated = |report: &Option<Arc<EvalReport>>| {
            report.as_ref().is_some_and(|report| report.summary.weights_version == version)
        };
        within(seen.wait_for(is_evaluated)).await.unwrap();
    }
    stop.now.cancel();
    // Neither was evaluated twice.
    assert_eq!(within(service).await.unwrap().unwrap(), 2);
    bus.close().await;
}

/// A setup with `n_episodes` greedy episodes of one goal.
fn one_goal(n_episodes: u32, records: Option<RunPaths>) -> EvaluatorSetup {
    let episodes = EpisodeConfig { n_episodes, acting: vec![ActionMode::Greedy], ..Default::default() };
    let selection =
        Selection { splits: vec![Split::Train], blueprints: vec!["2_000".parse().unwrap()], ..Default::default() };
    setup(EvaluatorConfig { every: Every::Versions(1), selection, episodes, ..Default::default() }, records)
}

fn setup(config: EvaluatorConfig, records: Option<RunPaths>) -> EvaluatorSetup {
    EvaluatorSetup {
        policy: small_policy(),
        environment: small_setup(config.episodes.clone()).environment.clone(),
        config: Valid::new(config).unwrap(),
        id: "judge".to_owned(),
        seed: 3,
        records,
        catalog: Catalog::builtin().clone(),
    }
}

fn start(setup: EvaluatorSetup, bus: &Bus, listeners: Listeners, stop: &Stop) -> JoinHandle<anyhow::Result<u64>> {
    let (bus, stop) = (bus.clone(), stop.clone());
    tokio::spawn(async move { run(setup, &bus, listeners, stop).await })
}

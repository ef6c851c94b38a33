//! Evaluations of untrained weights in real worlds.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use blueprints::{Catalog, Split};
use environment::EnvironmentConfig;
use policy::PolicyConfig;
use proto::{ActionMode, Valid, Weights, WeightsVersion};

use super::*;
use crate::config::{EpisodeConfig, Starts};
use crate::setup::N_WORLDS;

#[path = "../../../policy/tests/samples/untrained.rs"]
mod untrained;

pub(crate) use untrained::{small_policy, weights};

/// A setup with short episodes.
pub(crate) fn small_setup(episodes: EpisodeConfig) -> EvalSetup<'static> {
    EvalSetup {
        catalog: Catalog::builtin(),
        environment: Valid::new(EnvironmentConfig { episode_steps: 8, ..Default::default() }).unwrap(),
        episodes,
        reset_free: None,
        n_worlds: N_WORLDS,
        seed: 3,
    }
}

/// Returns the small policy with the weights of [`weights`].
pub(crate) fn performer() -> Performer<'static> {
    static POLICY: LazyLock<(Valid<PolicyConfig>, Weights)> = LazyLock::new(|| (small_policy(), weights()));
    Performer::Policy(&POLICY.0, &POLICY.1)
}

fn blueprints(n: usize) -> Vec<&'static Blueprint> {
    Catalog::builtin().of_split(Split::Train)[..n].to_vec()
}

fn report(setup: &EvalSetup<'_>, n_blueprints: usize) -> EvalReport {
    evaluate(setup, performer(), &blueprints(n_blueprints), &Follower::default()).unwrap()
}

#[test]
fn the_same_weights_get_the_same_report() {
    let setup = EvalSetup { n_worlds: 4, ..small_setup(EpisodeConfig { n_episodes: 3, ..Default::default() }) };
    let first = report(&setup, 2);
    assert_eq!(first, report(&setup, 2));
    let summary = &first.summary;
    assert_eq!((summary.weights_version, summary.n_env_steps, summary.seed), (WeightsVersion(2), 77, 3));
    let n_episodes = [summary.all.greedy.success.n_episodes, summary.all.sampled.success.n_episodes];
    assert_eq!((n_episodes, first.blueprints.len()), ([6, 6], 2));
}

#[test]
fn parts_are_spread_over_all_blueprints_and_grow_into_the_whole() {
    let setup = small_setup(EpisodeConfig { n_episodes: 2, acting: vec![ActionMode::Greedy], ..Default::default() });
    // 62 blueprints of 2 to 4 blocks: 124 episodes in parts of 32, 64, and 124.
    let blueprints = blueprints(62);
    let mut parts = Vec::new();
    let performer = performer();
    let pool = EvaluationPool { setup: &setup, performer, recorder: None, progress: None, keep_going: &|| true };
    let whole = evaluate_in_parts(&pool, &blueprints, &mut |part| parts.push(part)).unwrap();
    let n_episodes = |report: &EvalReport| report.summary.all.greedy.success.n_episodes;
    assert_eq!(parts.iter().map(n_episodes).collect::<Vec<_>>(), [32, 64]);
    assert_eq!((n_episodes(&whole), whole.summary.n_planned, whole.summary.is_complete), (124, 124, true));
    assert!(parts.iter().all(|part| part.summary.n_planned == 124 && !part.summary.is_complete));
    // Every second blueprint comes first, then the others.
    let first: Vec<_> = parts[0].blueprints.iter().map(|score| &score.blueprint).collect();
    assert!(blueprints.iter().step_by(2).all(|blueprint| first.contains(&blueprint.id())), "{first:?}");
    assert_eq!(parts[1].blueprints.len(), 62);
    assert_eq!(whole, evaluate(&setup, performer, &blueprints, &Follower::default()).unwrap());
}

#[test]
fn an_episode_is_the_same_whatever_runs_beside_it() {
    let setup = |n_threads, n_worlds| {
        let episodes = EpisodeConfig { n_episodes: 2, n_threads, ..Default::default() };
        EvalSetup { n_worlds, ..small_setup(episodes) }
    };
    let (alone, crowded) = (setup(1, 1), setup(2, 3));
    let (alone, crowded) = (report(&alone, 1), report(&crowded, 3));
    let (alone, crowded) = (&alone.blueprints[0], &crowded.blueprints[0]);
    assert_eq!(alone.blueprint, crowded.blueprint);
    assert_eq!(alone.sampled.mean_steps, crowded.sampled.mean_steps);
    // Sums in another order may round differently, but no more than that.
    let difference = alone.sampled.mean_return.total() - crowded.sampled.mean_return.total();
    assert!(difference.abs() < 1e-3, "{difference}");
}

#[test]
fn what_an_interrupted_evaluation_found_is_reported() {
    let acting = vec![ActionMode::Greedy];
    let episodes = EpisodeConfig { n_episodes: 3, acting, n_threads: 1, ..Default::default() };
    let setup = EvalSetup { n_worlds: 1, ..small_setup(episodes) };
    let progress = watch::Sender::<Option<EvaluationProgress>>::default();
    let keep_going = || progress.borrow().is_none_or(|so_far| so_far.n_ended < 2);
    let follower = Follower { keep_going: &keep_going, progress: Some(&progress), endings: None };
    let report = evaluate(&setup, performer(), &blueprints(1), &follower).unwrap();
    let summary = &report.summary;
    assert_eq!((summary.is_complete, summary.n_planned, summary.all.greedy.success.n_episodes), (false, 3, 2));
}

#[test]
fn what_one_thread_cannot_start_ends_the_work_of_all() {
    let episodes = EpisodeConfig { n_episodes: 1, n_threads: 2, ..Default::default() };
    let goals = blueprints(2);
    let catalog = Catalog::of_one(goals[0].clone());
    let setup = EvalSetup { catalog: &catalog, n_worlds: 1, ..small_setup(episodes) };
    let result = evaluate(&setup, performer(), &goals, &Follower::default());
    assert_eq!(result.unwrap_err().to_string(), format!("an episode of blueprint {} cannot be started", goals[1].id()));
}

#[test]
fn a_panic_of_one_thread_is_passed_on() {
    let episodes = EpisodeConfig { n_episodes: 1, n_threads: 2, ..Default::default() };
    let setup = EvalSetup { n_worlds: 1, ..small_setup(episodes) };
    let n_calls = AtomicUsize::new(0);
    let keep_going = || match n_calls.fetch_add(1, Ordering::Relaxed) {
        0 => panic!("out of order"),
        _ => true,
    };
    let follower = Follower { keep_going: &keep_going, ..Follower::default() };
    let evaluation = || evaluate(&setup, performer(), &blueprints(2), &follower);
    let panic = catch_unwind(AssertUnwindSafe(evaluation)).unwrap_err();
    assert_eq!(panic.downcast_ref::<&str>(), Some(&"out of order"));
}

#[test]
fn reset_free_runs_count_every_goal() {
    let mut setup =
        small_setup(EpisodeConfig { n_episodes: 1, acting: vec![ActionMode::Greedy], ..Default::default() });
    setup.reset_free = Some(ResetFreeConfig { n_runs: 2, n_goals: 3 });
    let runs = report(&setup, 1).summary.reset_free.unwrap();
    assert_eq!((runs.n_runs, runs.n_goals), (2, 3));
    assert_eq!((runs.greedy.outcome.success.n_episodes, runs.greedy.n_successes_by_goal.len()), (6, 3));
    assert_eq!(runs.sampled.outcome.success.n_episodes, 0);
    let small = Catalog::of_one(blueprints(1)[0].clone());
    let setup = EvalSetup { catalog: &small, ..setup };
    let result = evaluate(&setup, performer(), &blueprints(1), &Follower::default());
    assert_eq!(result.unwrap_err().to_string(), "no training blueprint has 12 blocks or more for the reset-free runs");
}

fn of_expert(setup: &EvalSetup<'_>, blueprints: &[&Blueprint]) -> EvalReport {
    evaluate(setup, Performer::Expert, blueprints, &Follower::default()).unwrap()
}

/// A setup with episodes of full length, for the expert.
fn expert_setup() -> EvalSetup<'static> {
    let episodes = EpisodeConfig { n_episodes: 5, starts: Starts::Mixed, n_threads: 2, ..Default::default() };
    EvalSetup { environment: Valid::default(), ..small_setup(episodes) }
}

#[test]
fn the_expert_builds_a_sample_of_the_catalog() {
    // Every seventh blueprint, so that all sizes and splits are included. On the whole catalog the rate is 99 %.
    let sample: Vec<&Blueprint> = Catalog::builtin().iter().step_by(7).collect();
    let report = of_expert(&expert_setup(), &sample);
    let all = report.summary.all;
    assert_eq!((all.n_blueprints, all.greedy.success.n_episodes), (sample.len() as u64, 5 * sample.len() as u64));
    assert_eq!(all.sampled.success.n_episodes, 0, "the expert acts in one way");
    assert!(all.greedy.success.rate >= 0.9, "{:?}", report.blueprints);
    assert!(all.greedy.stable_success.rate >= 0.8, "{:?}", report.blueprints);
    assert!(report.blueprints.iter().all(|goal| goal.greedy.success.n_successes > 0), "{:?}", report.blueprints);
}

#[test]
fn the_expert_builds_goals_in_a_row_where_the_last_one_ended() {
    let setup = EvalSetup { reset_free: Some(ResetFreeConfig { n_runs: 2, n_goals: 3 }), ..expert_setup() };
    let found = of_expert(&setup, &blueprints(1)).summary.reset_free.unwrap();
    assert_eq!((found.n_runs, found.n_goals, found.greedy.outcome.success.n_episodes), (2, 3, 6));
    assert!(found.greedy.outcome.success.n_successes >= 4, "{found:?}");
}

//! The expert on real worlds: its success, its failures, and their causes.

use blueprints::Catalog;
use proto::Valid;

use super::*;
use crate::config::{EpisodeConfig, ResetFreeConfig, Starts};
use crate::setup::N_WORLDS;

fn setup() -> EvalSetup<'static> {
    EvalSetup {
        catalog: Catalog::builtin(),
        environment: Valid::default(),
        episodes: EpisodeConfig { n_episodes: 5, starts: Starts::Mixed, n_threads: 2, ..Default::default() },
        reset_free: None,
        n_worlds: N_WORLDS,
        seed: 1,
    }
}

fn evaluate(setup: &EvalSetup<'_>, blueprints: &[&Blueprint]) -> ExpertReport {
    evaluate_expert_followed(setup, blueprints, &Follower::default()).unwrap()
}

#[test]
fn the_expert_builds_a_sample_of_the_catalog() {
    // Every seventh blueprint, so that all sizes and splits are included. On the whole catalog the rate is 99 %.
    let sample: Vec<&Blueprint> = Catalog::builtin().iter().step_by(7).collect();
    let report = evaluate(&setup(), &sample);
    let all = report.groups.last().unwrap();
    assert_eq!((all.name.as_str(), all.n_blueprints), ("all", sample.len() as u64));
    assert!(all.outcome.success.rate >= 0.9, "{:?}", report.failures);
    assert_eq!(all.n_built, all.n_blueprints);
    let n_failures = report.failures.len() as u64;
    assert_eq!(all.outcome.success.n_successes + n_failures, all.outcome.success.n_episodes);
}

#[test]
fn a_report_does_not_depend_on_the_threads() {
    let sample: Vec<&Blueprint> = Catalog::builtin().iter().step_by(40).collect();
    let report = |n_threads, n_worlds| {
        let mut setup = setup();
        (setup.episodes.n_threads, setup.n_worlds) = (n_threads, n_worlds);
        evaluate(&setup, &sample)
    };
    assert_eq!(report(1, 1), report(3, 2));
}

#[test]
fn a_failure_has_a_cause_and_a_replay_that_can_be_sent() {
    let mut setup = setup();
    (setup.episodes.n_episodes, setup.episodes.starts) = (1, Starts::Scattered);
    setup.environment = setup.environment.with(|environment| environment.episode_steps = 5).unwrap();
    let goal = Catalog::builtin().get(&"16_000".parse().unwrap()).unwrap();
    let report = evaluate(&setup, &[goal]);
    let [failure] = &report.failures[..] else { panic!("{:?}", report.failures) };
    assert_eq!((failure.trouble.cause, failure.trouble.n_steps), (Cause::Time, 5));
    assert_eq!(failure.trouble.n_missing as usize, goal.links().len());
    let replay = failure.replay.as_ref().unwrap();
    assert_eq!(replay.transitions.len(), 5);
    let bytes = proto::codec::encode_recording(replay);
    assert_eq!(&proto::codec::decode_recording(&bytes).unwrap(), replay);
}

#[test]
fn goals_in_a_row_are_built_where_the_last_one_ended() {
    let config = ResetFreeConfig { n_runs: 2, n_goals: 3 };
    let setup = EvalSetup { reset_free: Some(config), ..setup() };
    let goal = &Catalog::builtin().of_split(Split::Train)[..1];
    let found = evaluate(&setup, goal).reset_free.unwrap();
    assert_eq!((found.n_runs, found.n_goals, found.runs.outcome.success.n_episodes), (2, 3, 6));
    assert!(found.runs.outcome.success.n_successes >= 4, "{found:?}");
}

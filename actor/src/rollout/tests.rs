//! Rollouts of toy worlds with scripted endings.

use proto::{EpisodeStats, RewardTerms, WeightsVersion};

use super::*;
use crate::config::ActorConfig;
use crate::task::{TaskConfig, TaskFilter};
use crate::tests::toy::{self, Toy, id};

/// Untrained values are within a few standard deviations (0.001) of the mean in the weights.
const VALUE: f32 = 5.0;

fn rollout(scripts: &[&[Status]], seed: u64) -> Rollout<Toy> {
    let tasks = TaskConfig { filter: TaskFilter::Sizes { min: 2, max: 3 }, ..Default::default() };
    let setup = toy::setup(ActorConfig { segment_len: 3, tasks, ..Default::default() });
    let worlds = scripts.iter().map(|script| Toy::new(script)).collect();
    Rollout::new(setup, 1, seed, worlds, &toy::weights(0, VALUE)).unwrap()
}

fn run(rollout: &mut Rollout<Toy>, n_steps: usize) -> Vec<Trajectory> {
    (0..n_steps).flat_map(|_| rollout.step().unwrap()).collect()
}

#[test]
fn segments_end_with_a_cut_a_success_and_the_time_limit() {
    use Status::{Running, Success, TimeLimit};
    // Segments of 3: a cut, an end by success, and an episode of 2 steps up to the time limit.
    let script = [Running, Running, Running, Success, Running, TimeLimit];
    let segments = run(&mut rollout(&[&script], 1), 6);
    let [cut, success, time_limit] = &segments[..] else { panic!("{} segments", segments.len()) };
    assert_eq!((cut.status, cut.transitions.len(), cut.episode_stats), (Running, 3, None));
    assert_eq!((success.status, success.first_step, success.transitions.len()), (Success, 3, 1));
    assert_eq!((time_limit.status, time_limit.first_step), (TimeLimit, 0));
    // The script's rewards are 1 to 6.
    let of_terms = |connected| RewardTerms { connected, ..RewardTerms::default() };
    assert_eq!(success.episode_stats, Some(EpisodeStats { success: true, n_steps: 4, episode_return: of_terms(10.0) }));
    assert_eq!(
        time_limit.episode_stats,
        Some(EpisodeStats { success: false, n_steps: 2, episode_return: of_terms(11.0) })
    );
    // The last scene is the one before the reset. Only within an episode does the next segment begin with it.
    assert_eq!(cut.last_scene, success.transitions[0].scene);
    assert!(cut.transitions.iter().all(|step| step.behavior_log_prob.is_finite()));
}

#[test]
fn segments_come_in_the_order_of_the_worlds() {
    let script = [Status::Running];
    let segments = run(&mut rollout(&[&script, &script], 1), 6);
    assert_eq!(segments.iter().map(|segment| segment.first_step).collect::<Vec<_>>(), [0, 0, 3, 3]);
}

#[test]
fn diverged_episodes_are_dropped_and_counted() {
    use Status::{Diverged, Running};
    let mut rollout = rollout(&[&[Running, Running, Running, Running, Diverged]], 1);
    let segments = run(&mut rollout, 10);
    // The first 3 steps of each episode of 5 were cut before it diverged.
    assert_eq!(segments.len(), 2);
    assert!(segments.iter().all(|segment| segment.status == Running && segment.first_step == 0));
    let expected = RolloutCounters { n_env_steps: 10, n_segments: 2, n_episodes: 0, n_diverged_episodes: 2 };
    assert_eq!(rollout.counters(), expected);
}

#[test]
fn the_same_seed_gives_the_same_segments() {
    use Status::{Running, Success, TimeLimit};
    let scripts: [&[Status]; 3] = [&[Running, TimeLimit], &[Running, Running, Success], &[Running]];
    let segments = |seed| run(&mut rollout(&scripts, seed), 12);
    assert_eq!(segments(1), segments(1));
    assert_ne!(segments(1), segments(2));
}

#[test]
fn a_restart_equals_a_fresh_rollout() {
    let scripts: [&[Status]; 2] = [&[Status::Running, Status::TimeLimit], &[Status::Success]];
    let mut used = rollout(&scripts, 1);
    run(&mut used, 2);
    used.restart(9).unwrap();
    let again = run(&mut used, 2);
    let actions = |segments: &[Trajectory]| -> Vec<_> {
        segments.iter().flat_map(|s| &s.transitions).map(|t| t.action.choices).collect()
    };
    let fresh = run(&mut rollout(&scripts, 9), 2);
    assert_eq!(actions(&again), actions(&fresh));
    let tasks = |segments: &[Trajectory]| segments.iter().map(|s| s.task.clone()).collect::<Vec<_>>();
    assert_eq!(tasks(&again), tasks(&fresh));
}

#[test]
fn new_weights_act_from_the_next_step_and_move_the_tasks() {
    use Status::{Running, TimeLimit};
    let mut rollout = rollout(&[&[Running, Running, Running, TimeLimit]], 1);
    run(&mut rollout, 1);
    let mut weights = toy::weights(4, 2.0 * VALUE);
    weights.task_probabilities = [(id("3_002"), 1.0)].into();
    rollout.set_weights(&weights).unwrap();
    let segments = run(&mut rollout, 6);
    // The first segment began with version 0. After the cut, the rest of its episode has version 4 alone.
    assert_eq!((segments[0].weights_version, rollout.version()), (WeightsVersion(0), WeightsVersion(4)));
    assert_eq!((segments[1].weights_version, segments[1].first_step), (WeightsVersion(4), 3));
    // Later episodes follow the new probabilities.
    assert_eq!((segments[2].weights_version, &segments[2].task.blueprint), (WeightsVersion(4), &id("3_002")));
    // The oldest version counts, also where an actor falls back to it.
    run(&mut rollout, 2);
    rollout.set_weights(&toy::weights(3, VALUE)).unwrap();
    assert_eq!(run(&mut rollout, 2)[0].weights_version, WeightsVersion(3));
}

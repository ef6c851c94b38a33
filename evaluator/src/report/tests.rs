//! Outcomes worked out by hand, and what other tests build reports from.

use blueprints::{Blueprint, Catalog};

use super::*;

pub(crate) fn goal(id: &str) -> &'static Blueprint {
    Catalog::builtin().get(&id.parse().unwrap()).unwrap()
}

/// Returns the result of an episode of a goal in the catalog.
pub(crate) fn episode(id: &str, acting: ActionMode, end: End, n_steps: u32) -> EpisodeResult {
    let goal = goal(id);
    EpisodeResult {
        blueprint: goal.id().clone(),
        split: goal.split(),
        n_blocks: goal.n_blocks(),
        acting,
        end,
        n_steps,
        episode_return: RewardTerms { connected: 1.0, wrong: -0.25, ..RewardTerms::default() },
        forced_reset: false,
    }
}

#[test]
fn a_hand_worked_outcome() {
    let steady = End::Success { stable: true };
    let shaky = End::Success { stable: false };
    let episodes = [
        episode("2_000", ActionMode::Greedy, steady, 10),
        episode("2_000", ActionMode::Greedy, shaky, 20),
        episode("2_000", ActionMode::Greedy, End::TimeLimit, 100),
        episode("2_000", ActionMode::Greedy, End::Diverged, 30),
        episode("2_000", ActionMode::Sampled, End::TimeLimit, 100),
    ];
    let found = outcome(&episodes.iter().collect::<Vec<_>>(), ActionMode::Greedy);
    assert_eq!((found.success.n_successes, found.success.n_episodes, found.success.rate), (2, 4, 0.5));
    assert_eq!((found.stable_success.n_successes, found.n_diverged), (1, 1));
    assert_eq!((found.mean_steps, found.mean_steps_to_success), (40.0, Some(15.0)));
    assert_eq!((found.mean_return.connected, found.mean_return.wrong), (1.0, -0.25));
}

#[test]
fn episodes_are_sorted_into_blueprints_and_groups() {
    let success = End::Success { stable: true };
    let episodes = [
        episode("10_000", ActionMode::Greedy, End::TimeLimit, 100),
        episode("3_000", ActionMode::Greedy, success, 5),
        episode("2_000", ActionMode::Greedy, End::TimeLimit, 100),
        episode("2_000", ActionMode::Sampled, success, 9),
    ];
    let report = summarize(WeightsVersion(7), 11, &episodes);
    let ids: Vec<&str> = report.blueprints.iter().map(|score| score.blueprint.as_str()).collect();
    assert_eq!(ids, ["2_000", "3_000", "10_000"]);
    let groups: Vec<_> =
        report.summary.groups.iter().map(|g| (g.name.as_str(), g.n_blueprints, g.greedy.success.rate)).collect();
    assert_eq!(groups, [("train 2-6", 2, 0.5), ("train 7-11", 1, 0.0)]);
    let all = &report.summary.all;
    assert_eq!((all.n_blueprints, all.greedy.success.n_episodes, all.sampled.success.n_episodes), (3, 3, 1));
}

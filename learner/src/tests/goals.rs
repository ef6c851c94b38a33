//! Goals are generated after every other check, and in bounded number.

use blueprints::generator::{Draws, Style};

use super::learning::{feed, small_setup};
use crate::fixtures::trajectory;
use crate::{Learner, UpdateMetrics};

/// Runs an update of 256 steps with one segment per goal.
fn update(goals: &[String]) -> UpdateMetrics {
    let mut setup = small_setup(4);
    setup.generated = Some(Draws::new(Style::ALL, 2..=16));
    let mut learner = Learner::new(setup).unwrap();
    let segments = goals.iter().map(|goal| {
        let mut segment = trajectory(256 / goals.len(), 0);
        segment.task.blueprint = goal.parse().unwrap();
        segment
    });
    feed(&learner, segments.collect());
    learner.update_from_mailbox().unwrap()
}

#[test]
fn held_out_structures_are_dropped_under_any_id() {
    // The generator's ids of a tower in the test split and of an arch in the validation split.
    for held_out in ["gen1-tallest-16_14_162", "gen1-arch-18_7_000"] {
        let mut goals = vec![held_out.to_owned(); 4];
        goals.resize(32, "gen1-tower-7_3_001".to_owned());
        let update = update(&goals);
        assert_eq!((update.unmade_total, update.n_steps, update.n_env_steps), (4, 28 * 8, 28 * 8), "{held_out}");
    }
}

#[test]
fn goals_generated_per_update_are_bounded() {
    let goal = |index: usize| format!("gen1-any-7_8_{index:03}");
    // 256 steps allow 1,024 blocks: 128 goals with 8 blocks each.
    let distinct: Vec<String> = (0..256).map(goal).collect();
    let all = update(&distinct);
    assert_eq!((all.unmade_total, all.n_steps), (128, 128));
    // A goal that was already generated counts only once.
    let again: Vec<String> = (0..256).map(|index| goal(index % 100)).collect();
    assert_eq!(update(&again).unmade_total, 0);
}

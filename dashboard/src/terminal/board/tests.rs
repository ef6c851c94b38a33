//! What the board keeps of what comes, and what it counts instead.

use bus::MetricsSample;
use serde_json::{Value, json};

use super::super::samples;
use super::*;

const SECOND: Duration = Duration::from_secs(1);

fn roster(actors: &[&str]) -> Roster {
    Roster { actors: actors.iter().map(|&name| name.to_owned()).collect(), n_learners: 1, n_evaluators: 1 }
}

fn alive(board: &Board) -> Vec<(&str, bool)> {
    board.actors().iter().map(|(id, actor)| (id.as_str(), actor.is_alive)).collect()
}

#[test]
fn the_newest_of_each_part_is_kept_with_its_time() {
    let mut board = Board::default();
    assert!(!board.has_summary());
    board.take(&samples::actor("a"), SECOND);
    assert!(!board.has_summary());
    board.take(&samples::learner(), SECOND);
    board.take(&samples::evaluation(), 2 * SECOND);
    let mut newer = samples::learner();
    newer.value["weights_version"] = 813.into();
    board.take(&newer, 3 * SECOND);
    let learner = board.learner().unwrap();
    assert_eq!((learner.value.weights_version.0, learner.at), (813, 3 * SECOND));
    // The same again, as the answer to a question, is no news.
    board.take(&samples::evaluation(), 3 * SECOND);
    assert_eq!(board.evaluation().unwrap().at, 2 * SECOND);
    assert_eq!(board.actors().values().next().unwrap().metrics.as_ref().unwrap().value.policy_lag, 1);
    assert_eq!(board.unread(), Unread::default());
}

/// Takes a changed sample and expects that it is counted as `expected` and shown nowhere.
#[track_caller]
fn check_refused(mut sample: MetricsSample, change: impl Fn(&mut MetricsSample), expected: Unread) {
    change(&mut sample);
    let mut board = Board::default();
    board.take(&sample, SECOND);
    assert_eq!(board, Board { unread: expected, ..Board::default() }, "{}", sample.value);
}

#[test]
fn what_cannot_be_shown_is_counted_by_reason() {
    let schema = Unread { schema_unknown_total: 1, ..Unread::default() };
    let unreadable = Unread { metrics_unreadable_total: 1, ..Unread::default() };
    let key = Unread { keys_unknown_total: 1, ..Unread::default() };
    check_refused(samples::learner(), |s| s.value["schema_version"] = 2.into(), schema);
    check_refused(samples::learner(), |s| s.value["schema_version"] = "1".into(), schema);
    for value in [Value::Null, json!(1), json!("x"), json!([1]), json!({})] {
        check_refused(samples::learner(), |s| s.value = value.clone(), schema);
    }
    check_refused(samples::learner(), |s| s.value["ppo"] = Value::Null, unreadable);
    check_refused(samples::learner(), |s| s.value["n_env_steps"] = (-1).into(), unreadable);
    // More successes than episodes, and a rate that is no share.
    check_refused(samples::evaluation(), |s| s.value["all"]["mode"]["success"]["n_episodes"] = 59.into(), unreadable);
    check_refused(
        samples::evaluation(),
        |s| s.value["groups"][0]["sampled"]["success"]["rate"] = 1.5.into(),
        unreadable,
    );
    check_refused(samples::blueprint("2_000", 3), |s| s.value["blueprint"] = "\u{1b}[2J".into(), unreadable);
    check_refused(samples::blueprint("2_000", 3), |s| s.value["blueprint"] = "2_001".into(), unreadable);
    check_refused(samples::blueprint("2_000", 3), |s| s.value["split"] = "test".into(), unreadable);
    check_refused(samples::actor("a"), |s| s.value["actor"] = "b".into(), unreadable);
    check_refused(samples::actor("a"), |s| s.value["actor"] = "A\u{7}".into(), unreadable);
    check_refused(samples::learner(), |s| s.suffix = "learners".to_owned(), key);
    check_refused(samples::learner(), |s| s.suffix = String::new(), key);
}

#[test]
fn an_actor_without_its_token_is_lost_until_it_comes_back() {
    let mut board = Board::default();
    assert!(board.set_roster(&roster(&["a", "b"])));
    assert!(!board.set_roster(&roster(&["a", "b"])));
    assert_eq!(board.n_services(), (1, 1));
    assert!(board.set_roster(&roster(&["b"])));
    assert_eq!(alive(&board), [("a", false), ("b", true)]);
    assert!(board.set_roster(&roster(&["a", "b", "c"])));
    assert_eq!(alive(&board), [("a", true), ("b", true), ("c", true)]);
}

#[test]
fn only_so_many_actors_are_remembered_and_lost_ones_make_room() {
    let mut board = Board::default();
    let names: Vec<String> = (0..MAX_ACTORS).map(|i| format!("actor-{i:05}")).collect();
    board.set_roster(&roster(&names.iter().map(String::as_str).collect::<Vec<_>>()));
    board.take(&samples::actor("one-more"), SECOND);
    assert_eq!((board.actors().len(), board.unread().over_limit_total), (MAX_ACTORS, 1));
    board.set_roster(&roster(&names[1..].iter().map(String::as_str).collect::<Vec<_>>()));
    board.take(&samples::actor("one-more"), SECOND);
    assert_eq!((board.actors().len(), board.unread().over_limit_total), (MAX_ACTORS, 1));
    assert!(!board.actors().keys().any(|id| id.as_str() == "actor-00000"));
}

#[test]
fn a_router_is_lost_only_after_it_was_reached() {
    let mut board = Board::default();
    assert!(!board.set_connected(false, SECOND));
    assert_eq!(board.link(), (Link::Joining, Duration::ZERO));
    assert!(board.set_connected(true, 2 * SECOND));
    assert!(board.set_connected(false, 3 * SECOND));
    assert!(!board.set_connected(false, 4 * SECOND));
    assert_eq!(board.link(), (Link::Lost, 3 * SECOND));
    assert!(board.set_connected(true, 5 * SECOND));
    assert_eq!(board.link(), (Link::Connected, 5 * SECOND));
}

#[test]
fn blueprints_of_other_weights_than_the_evaluation_are_left_out() {
    let mut board = Board::default();
    let mut old = samples::blueprint("2_001", 1);
    old.value["weights_version"] = 799.into();
    board.take(&old, SECOND);
    assert_eq!(board.judged_blueprints().len(), 1);
    board.take(&samples::blueprint("2_000", 30), SECOND);
    let ids = |board: &Board| -> Vec<String> {
        board.judged_blueprints().iter().map(|blueprint| blueprint.blueprint.to_string()).collect()
    };
    assert_eq!(ids(&board), ["2_000"]);
    board.take(&samples::evaluation(), SECOND);
    assert_eq!(ids(&board), ["2_000"]);
}

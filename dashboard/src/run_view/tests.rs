//! Tests of what the view keeps, and what it only counts.

use bus::MetricsSample;
use serde_json::{Value, json};

use super::*;
use crate::tests::samples;

const SECOND: Duration = Duration::from_secs(1);

fn alive(run: &RunView) -> Vec<(&str, bool)> {
    run.actors.keys().map(|id| (id.as_str(), run.is_alive(id))).collect()
}

#[test]
fn the_newest_of_each_part_is_kept_with_its_time() {
    let mut run = RunView::default();
    assert!(!run.has_summary());
    run.take(&samples::actor("a"), SECOND);
    assert!(!run.has_summary());
    assert!(run.take(&samples::learner(), SECOND));
    assert!(run.take(&samples::evaluation(), 2 * SECOND));
    let mut newer = samples::learner();
    newer.value["weights_version"] = 813.into();
    run.take(&newer, 3 * SECOND);
    let learner = run.learner.as_ref().unwrap();
    assert_eq!((learner.value.weights_version.0, learner.at), (813, 3 * SECOND));
    // Receiving the same sample again, as the reply to a query, changes nothing.
    assert!(!run.take(&samples::evaluation(), 3 * SECOND));
    assert_eq!(run.evaluation.as_ref().unwrap().at, 2 * SECOND);
    assert_eq!(run.actors.values().flatten().next().unwrap().value.policy_lag, 1);
    assert_eq!(run.unread, Unread::default());
}

/// Checks that a modified sample is counted as `expected` and not shown.
#[track_caller]
fn check_refused(mut sample: MetricsSample, change: impl Fn(&mut MetricsSample), expected: Unread) {
    change(&mut sample);
    let mut run = RunView::default();
    assert!(!run.take(&sample, SECOND));
    assert_eq!(run, RunView { unread: expected, ..RunView::default() }, "{}", sample.value);
}

#[test]
fn what_cannot_be_shown_is_counted_by_reason() {
    let schema = Unread { schema_unknown_total: 1, ..Unread::default() };
    let unreadable = Unread { metrics_unreadable_total: 1, ..Unread::default() };
    let key = Unread { keys_unknown_total: 1, ..Unread::default() };
    check_refused(samples::learner(), |s| s.value["schema_version"] = 1.into(), schema);
    check_refused(samples::learner(), |s| s.value["schema_version"] = "2".into(), schema);
    for value in [Value::Null, json!(1), json!("x"), json!([1]), json!({})] {
        check_refused(samples::learner(), |s| s.value = value.clone(), schema);
    }
    check_refused(samples::learner(), |s| s.value["ppo"] = Value::Null, unreadable);
    check_refused(samples::learner(), |s| s.value["n_env_steps"] = (-1).into(), unreadable);
    // More successes than episodes, and a rate above 1.
    check_refused(samples::evaluation(), |s| s.value["all"]["greedy"]["success"]["n_episodes"] = 59.into(), unreadable);
    check_refused(
        samples::evaluation(),
        |s| s.value["groups"][0]["sampled"]["success"]["rate"] = 1.5.into(),
        unreadable,
    );
    // Draws that cannot be.
    let wrong = [("join", "share", json!(1.5)), ("join", "success", json!(-0.5)), ("detach", "n_tries", json!(11))];
    for (kind, name, value) in wrong {
        let change = |s: &mut MetricsSample| s.value["proposals"]["kinds"][kind][name] = value.clone();
        check_refused(samples::mixture_learner(), change, unreadable);
    }
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
    let mut run = RunView::default();
    assert!(run.set_session(&samples::session(&["a", "b"]), SECOND));
    assert!(!run.set_session(&samples::session(&["a", "b"]), SECOND));
    assert_eq!((run.roster.learners.len(), run.roster.evaluators.len()), (1, 1));
    assert!(run.set_session(&samples::session(&["b"]), SECOND));
    assert_eq!(alive(&run), [("a", false), ("b", true)]);
    assert!(run.set_session(&samples::session(&["a", "b", "c"]), SECOND));
    assert_eq!(alive(&run), [("a", true), ("b", true), ("c", true)]);
}

#[test]
fn only_so_many_actors_are_remembered_and_lost_ones_make_room() {
    let mut run = RunView::default();
    let names: Vec<String> = (0..MAX_ACTORS).map(|i| format!("actor-{i:05}")).collect();
    run.set_session(&samples::session(&names.iter().map(String::as_str).collect::<Vec<_>>()), SECOND);
    run.take(&samples::actor("one-more"), SECOND);
    assert_eq!((run.actors.len(), run.unread.over_limit_total), (MAX_ACTORS, 1));
    run.set_session(&samples::session(&names[1..].iter().map(String::as_str).collect::<Vec<_>>()), SECOND);
    run.take(&samples::actor("one-more"), SECOND);
    assert_eq!((run.actors.len(), run.unread.over_limit_total), (MAX_ACTORS, 1));
    assert!(!run.actors.keys().any(|id| id.as_str() == "actor-00000"));
}

#[test]
fn a_router_is_lost_only_after_it_was_reached_and_takes_nobody_with_it() {
    let mut run = RunView::default();
    assert!(!run.set_session(&samples::cut_off(), SECOND));
    assert_eq!((run.link, run.link_since), (Link::Joining, Duration::ZERO));
    assert!(run.set_session(&samples::session(&["a"]), 2 * SECOND));
    assert!(run.set_session(&samples::cut_off(), 3 * SECOND));
    assert!(!run.set_session(&samples::cut_off(), 4 * SECOND));
    assert_eq!((run.link, run.link_since), (Link::Lost, 3 * SECOND));
    assert_eq!((alive(&run), run.roster.learners.len()), (vec![("a", true)], 1));
    assert!(run.set_session(&samples::session(&[]), 5 * SECOND));
    assert_eq!((run.link, run.link_since), (Link::Connected, 5 * SECOND));
}

#[test]
fn blueprints_of_other_weights_than_the_evaluation_are_left_out() {
    let mut run = RunView::default();
    let mut old = samples::blueprint("2_001", 1);
    old.value["weights_version"] = 799.into();
    run.take(&old, SECOND);
    assert_eq!(run.evaluated_blueprints().len(), 1);
    run.take(&samples::blueprint("2_000", 30), SECOND);
    let ids = |run: &RunView| -> Vec<String> {
        run.evaluated_blueprints().iter().map(|blueprint| blueprint.blueprint.to_string()).collect()
    };
    assert_eq!(ids(&run), ["2_000"]);
    run.take(&samples::evaluation(), SECOND);
    assert_eq!(ids(&run), ["2_000"]);
}

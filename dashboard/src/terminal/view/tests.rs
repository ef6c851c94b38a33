//! Hand-made views and the exact screen contents that they produce.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::*;
use crate::run_view::SessionState;
use crate::tests::samples;

fn config() -> BusConfig {
    let run = "two-blocks".to_owned();
    let connect = vec!["tcp/127.0.0.1:7447".to_owned()];
    BusConfig { run, connect, ..BusConfig::default() }
}

fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

/// A run with three actors, one of them lost. The learner last reported at 30 s, the evaluator at 20 s.
fn busy() -> RunView {
    let mut run = RunView::default();
    run.set_session(&samples::session(&["actor-1", "actor-2", "quiet"]), seconds(1));
    run.take(&samples::actor("actor-2"), seconds(5));
    run.take(&samples::evaluation(), seconds(20));
    for (id, n_successes) in [("2_000", 40), ("2_001", 39), ("2_002", 2), ("2_003", 20), ("2_004", 40)] {
        run.take(&samples::blueprint(id, n_successes), seconds(20));
    }
    run.take(&samples::learner(), seconds(30));
    run.take(&samples::actor("actor-1"), seconds(31));
    run.set_session(&samples::session(&["actor-1", "quiet"]), seconds(31));
    run
}

/// The screen contents, line by line without trailing spaces.
fn screen(run: &RunView, now: Duration, width: u16, height: u16) -> Vec<String> {
    screen_of(run, &mut Controls::default(), now, width, height)
}

/// Like [`screen`], with the state of the controls.
fn screen_of(run: &RunView, controls: &mut Controls, now: Duration, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, run, &config(), controls, now)).unwrap();
    let lines = terminal.backend().buffer().content().chunks(width.into());
    lines.map(|line| line.iter().map(|cell| cell.symbol()).collect::<String>().trim_end().to_owned()).collect()
}

/// The controls after these key presses, none of which quits.
fn pressed(keys: &[KeyCode]) -> Controls {
    let mut controls = Controls::default();
    for key in keys {
        assert!(!controls.press(KeyEvent::new(*key, KeyModifiers::NONE)), "{key:?}");
    }
    controls
}

#[test]
fn a_learner_that_cannot_save_says_so_and_has_learned_nothing_more() {
    let mut run = busy();
    let n_values = |run: &RunView| run.trends().map(|(_, values)| values.len()).sum::<usize>();
    let before = n_values(&run);
    let mut learner = samples::learner();
    learner.value["not_saved"] =
        serde_json::json!({ "since_unix_ms": 1_769_846_700_000_u64, "reason": "no\u{1b}[2J room" });
    assert!(run.take(&learner, seconds(32)));
    let text = text(&run, &config(), seconds(33));
    let line = "training waits: not saved since 2026-01-31 08:05 UTC: no\\u001b[2J room";
    assert_eq!(text.lines().nth(2), Some(line), "{text}");
    assert_eq!(n_values(&run), before);
    learner.value["not_saved"]["since_unix_ms"] = u64::MAX.into();
    assert!(run.take(&learner, seconds(34)));
    let text = self::text(&run, &config(), seconds(35));
    assert!(text.contains("not saved since an unknown time: no"), "{text}");
}

#[test]
fn a_run_fits_on_80_by_24() {
    let expected = [
        "Run two-blocks at tcp/127.0.0.1:7447",
        "learner heard 12 s ago, evaluator heard 22 s ago",
        "Success in %: weights 800, 3 276 800 environment steps, evaluated 22 s ago",
        "  group                   greedy (95 %)       of   sampled (95 %)             of",
        "  train 2-6       100.0 ( 91.2 to 100.0)      40   95.0 ( 83.5 to  98.6)      40",
        "  test 12-16       50.0 ( 35.2 to  64.8)      40   80.0 ( 65.2 to  89.5)      40",
        "  all              75.0 ( 64.5 to  83.2)      80   87.5 ( 78.5 to  93.1)      80",
        "  worst  2_002 5.0  2_003 50.0  2_001 97.5",
        "  best   2_004 100.0  2_000 100.0",
        "Learning: weights 812, 3 326 976 environment steps in 42 min",
        "  throughput  1 234 steps/s, 2 048 waiting; lag 1.25 versions, at most 3",
        "  loss        total 0.031, policy -0.004, value 0.250, gradient norm 0.520",
        "  policy      KL 4.5e-4, entropy 5.432, clipped 0.080, explained variance 0.875",
        "  episodes    success 50.0 ( 23.7 to  76.3) of 10, return 3.250, 45.2 steps",
        "Actors: 2 alive, 1 lost; 640 steps/s",
        "  actor                       steps/s  weights  lag  accepted  dropped  heard",
        "  actor-1              alive      640      811    1     2 500       12  11 s ago",
        "  quiet                alive has said nothing so far",
        "  actor-2              lost       640      811    1     2 500       12  37 s ago",
        "Dropped",
        "  actors: full 14  actors: stale 10  evaluator: diverged 2  learner: expired 4",
        "  learner: stale 12",
        "",
        "[overview] blueprints actors learning  ? help",
    ];
    assert_eq!(screen(&busy(), seconds(42), 80, 24), expected);
}

#[test]
fn an_evaluation_that_runs_is_shown_as_such_and_is_no_part_of_the_curve() {
    let mut run = busy();
    let mut part = samples::evaluation();
    part.value["is_complete"] = false.into();
    part.value["n_planned"] = 320.into();
    part.value["weights_version"] = 900.into();
    part.value["all"]["greedy"]["success"]["n_successes"] = 0.into();
    part.value["all"]["greedy"]["success"]["rate"] = 0.0.into();
    run.take(&part, seconds(40));
    let shown = screen(&run, seconds(42), 80, 24);
    assert!(shown.contains(&"Success in % so far, 160 of 320 episodes: weights 900, 3 276 800 steps".to_owned()));
    assert_eq!(run.evaluated, [0.75]);
}

#[test]
fn success_by_size_is_that_of_more_than_one_update() {
    let mut run = RunView::default();
    for (update, id, n_successes) in [(1, "2_000", 10), (2, "3_000", 9)] {
        let mut sample = samples::learner();
        (sample.value["n_updates"], sample.value["weights_version"]) = (update.into(), update.into());
        sample.value["episodes"]["success_by_blueprint"] =
            serde_json::json!({ id: proto::wilson::SuccessRate::new(n_successes, 10) });
        run.take(&sample, seconds(30 + update));
    }
    let shown = screen(&run, seconds(42), 80, 24);
    assert!(shown.contains(&"  by blocks   2: 100  3: 90 %".to_owned()), "{shown:#?}");
}

#[test]
fn draws_of_the_mixture_head_are_told_by_kind() {
    let mut run = RunView::default();
    run.take(&samples::mixture_learner(), seconds(30));
    let shown = screen(&run, seconds(42), 80, 24);
    let expected = [
        "  draws       join 75 %, detach 5 %, hold 20 %",
        "  succeeded   join 12 %, detach 40 %; entropy 1.50 / 1.25 / 0.75",
    ];
    let start = shown.iter().position(|line| line.starts_with("  draws")).unwrap();
    assert_eq!(shown[start..start + 2], expected);
    let learning = screen_of(&run, &mut pressed(&[KeyCode::Char('4')]), seconds(42), 80, 40).join("\n");
    for name in ["share of hold", "success of detach", "entropy 2nd proposal"] {
        assert!(learning.contains(name), "{learning}");
    }
}

#[test]
fn an_empty_run_says_what_it_waits_for() {
    let mut run = RunView::default();
    let waiting = [
        "Run two-blocks at tcp/127.0.0.1:7447",
        "No router was reached in 12 s; still trying",
        "Success: no evaluation so far",
        "Learning: no update so far",
        "Actors: 0 alive, 0 lost; 0 steps/s",
        "Dropped: nothing",
    ];
    assert_eq!(screen(&run, seconds(12), 80, 6), waiting);
    let mut session = SessionState { is_connected: true, ..SessionState::default() };
    run.set_session(&session, seconds(12));
    let nothing = "Nothing has arrived in 3 s: no learner, evaluator or actor has joined this run";
    assert_eq!(screen(&run, seconds(15), 80, 6)[1], nothing);
    session.roster.evaluators.insert("evaluator".to_owned());
    run.set_session(&session, seconds(12));
    assert_eq!(screen(&run, seconds(15), 80, 6)[1], "no learner, evaluator silent so far");
}

#[test]
fn a_router_that_is_gone_is_told_with_the_age_of_the_rest() {
    let mut run = busy();
    run.set_session(&samples::cut_off(), seconds(40));
    let lines = screen(&run, seconds(52), 80, 24);
    assert_eq!(lines[1], "The router has been gone for 12 s; the newest came 22 s ago");
    assert!(lines.iter().any(|line| line == "Actors: unknown while the router is gone"), "{lines:#?}");
    let mut run = RunView::default();
    run.set_session(&samples::session(&[]), seconds(1));
    run.set_session(&samples::cut_off(), seconds(2));
    assert_eq!(screen(&run, seconds(3), 80, 24)[1], "The router has been gone for 1 s; nothing came before");
}

#[test]
fn a_learner_that_is_gone_is_told() {
    let mut run = busy();
    let mut session = samples::session(&["actor-1", "quiet"]);
    session.roster.learners.clear();
    run.set_session(&session, seconds(42));
    assert_eq!(screen(&run, seconds(42), 80, 24)[1], "learner gone, heard 12 s ago, evaluator heard 22 s ago");
}

#[test]
fn many_actors_leave_room_for_the_rest() {
    let mut run = busy();
    let names: Vec<String> = (0..500).map(|i| format!("an-actor-with-a-long-name-{i:03}")).collect();
    run.set_session(&samples::session(&names.iter().map(String::as_str).collect::<Vec<_>>()), seconds(42));
    let lines = screen(&run, seconds(42), 80, 24);
    assert!(lines.iter().any(|line| line.starts_with("Actors: 500 alive, 3 lost")), "{lines:#?}");
    assert!(lines.iter().any(|line| line.starts_with("  an-actor-with-a-lon~ alive has said nothing")), "{lines:#?}");
    assert!(lines.iter().any(|line| line == "  and 500 more"), "{lines:#?}");
    assert!(lines[21].starts_with("  actors: full"), "{lines:#?}");
}

#[test]
fn no_size_is_too_small() {
    for run in [RunView::default(), busy()] {
        for (width, height) in (1..=100).flat_map(|width| (1..=30).map(move |height| (width, height))) {
            for key in "1234?".chars() {
                let lines = screen_of(&run, &mut pressed(&[KeyCode::Char(key)]), seconds(42), width, height);
                assert!(lines[0].starts_with('R'), "{key} {width}x{height}: {lines:#?}");
            }
        }
    }
}

#[test]
fn names_from_the_bus_cannot_touch_the_terminal() {
    let mut run = busy();
    let mut evaluation = samples::evaluation();
    evaluation.value["groups"][0]["name"] = "\u{1b}]0;x\u{7}\n".into();
    run.take(&evaluation, seconds(21));
    let text = text(&run, &config(), seconds(42));
    assert!(text.contains("\n  \\u001b]0;x\\u0007\\n  "), "{text}");
    assert!(text.chars().all(|c| c == '\n' || !c.is_control()), "{text:?}");
}

#[test]
fn videos_that_were_not_made_are_listed() {
    let mut evaluation = samples::evaluation();
    evaluation.value["videos"] = serde_json::json!({
        "written_total": 6, "n_waiting": 1, "dropped_total": 2, "failed_total": 0, "unrecorded_total": 4,
        "oversized_total": 0,
    });
    let mut run = RunView::default();
    run.take(&evaluation, seconds(21));
    let text = text(&run, &config(), seconds(42));
    assert!(text.contains("\n  evaluator: diverged 2  videos: dropped 2  videos: unrecorded 4"), "{text}");
}

#[test]
fn every_blueprint_can_be_seen_in_any_order() {
    let shown = |keys: &str| {
        let keys: Vec<KeyCode> = keys.chars().map(KeyCode::Char).collect();
        screen_of(&busy(), &mut pressed(&keys), seconds(42), 80, 24)
    };
    let firsts = |lines: &[String]| -> Vec<String> {
        lines[4..9].iter().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect()
    };
    let worst_first = shown("2");
    assert_eq!(worst_first[2], "Success by blueprint in %: weights 800, evaluated 22 s ago");
    assert_eq!(worst_first[4], "  2_002                 2   5.0 ( 91.2 to 100.0)  40  95.0 ( 83.5 to  98.6)  40");
    assert_eq!(firsts(&worst_first), ["2_002", "2_003", "2_001", "2_000", "2_004"]);
    assert!(worst_first[23].ends_with("? help  by success"), "{worst_first:#?}");
    assert_eq!(firsts(&shown("2s")), ["2_000", "2_001", "2_002", "2_003", "2_004"]);
    let turned = shown("2sr");
    assert_eq!(firsts(&turned), ["2_004", "2_003", "2_002", "2_001", "2_000"]);
    assert!(turned[23].ends_with("by blueprint ↑"), "{turned:#?}");
}

#[test]
fn many_actors_can_be_scrolled_to_and_sorted() {
    let mut run = RunView::default();
    let names: Vec<String> = (0..500).map(|i| format!("actor-{i:03}")).collect();
    run.set_session(&samples::session(&names.iter().map(String::as_str).collect::<Vec<_>>()), seconds(1));
    let mut fast = samples::actor("actor-250");
    fast.value["env_steps_per_s"] = 9000.into();
    run.take(&fast, seconds(2));
    run.take(&samples::actor("actor-400"), seconds(2));
    let mut controls = pressed(&[KeyCode::Char('3'), KeyCode::End]);
    let lines = screen_of(&run, &mut controls, seconds(3), 80, 24);
    // 24 lines minus 2 of the header, 2 of the table and the footer.
    assert!(lines[4].starts_with("  actor-481 ") && lines[22].starts_with("  actor-499 "), "{lines:#?}");
    assert!(lines[23].ends_with("by name  482 to 500 of 500"), "{lines:#?}");
    // Paging keeps one line of the previous page.
    controls.press(KeyEvent::new(KeyCode::PageUp, KeyModifiers::NONE));
    assert!(screen_of(&run, &mut controls, seconds(3), 80, 24)[22].starts_with("  actor-481 "));
    let lines = screen_of(&run, &mut pressed(&[KeyCode::Char('3'), KeyCode::Char('s')]), seconds(3), 80, 24);
    assert!(lines[4].starts_with("  actor-250 ") && lines[5].starts_with("  actor-400 "), "{lines:#?}");
}

#[test]
fn a_small_screen_can_be_scrolled() {
    let lines = screen_of(&busy(), &mut pressed(&[KeyCode::Char('j'), KeyCode::Down]), seconds(42), 80, 10);
    assert!(lines[2].starts_with("  train 2-6 ") && lines[9].contains("  3 to 9 of "), "{lines:#?}");
}

#[test]
fn help_comes_and_goes() {
    let mut controls = pressed(&[KeyCode::Char('4'), KeyCode::Char('?')]);
    let lines = screen_of(&busy(), &mut controls, seconds(42), 80, 24);
    assert_eq!((lines[2].as_str(), controls.part()), ("Keys", None));
    // Escape goes back step by step, and quits from the overview.
    for (part, ends) in [(Some(Part::Learning), false), (Some(Part::Overview), false), (Some(Part::Overview), true)] {
        assert_eq!(controls.press(KeyEvent::new(KeyCode::Esc, KeyModifiers::NONE)), ends);
        assert_eq!(controls.part(), part);
    }
    for (key, modifiers) in [(KeyCode::Char('q'), KeyModifiers::NONE), (KeyCode::Char('c'), KeyModifiers::CONTROL)] {
        assert!(Controls::default().press(KeyEvent::new(key, modifiers)));
    }
}

#[test]
fn numbers_are_drawn_over_time() {
    let mut run = busy();
    for n_done in 1..4_u32 {
        let mut learner = samples::learner();
        learner.value["n_env_steps"] = (4_000_000 + n_done).into();
        learner.value["env_steps_per_s"] = (1234.4 + 100.0 * f64::from(n_done)).into();
        run.take(&learner, seconds(30 + u64::from(n_done)));
    }
    let overview = screen(&run, seconds(42), 80, 30);
    assert!(overview.contains(&"  trend       steps per second ▁▃▆█".to_owned()), "{overview:#?}");
    let learning = screen_of(&run, &mut pressed(&[KeyCode::Char('4')]), seconds(42), 80, 30);
    assert!(
        learning.contains(&"  steps per second       1534.400  1234.400  1534.400  ▁▃▆█".to_owned()),
        "{learning:#?}"
    );
    assert!(learning.contains(&"  success, evaluated        0.750     0.750     0.750  ▁".to_owned()), "{learning:#?}");
}

#[test]
fn other_runs_are_listed_where_nobody_is() {
    let mut run = RunView::default();
    run.set_session(&SessionState { is_connected: true, ..SessionState::default() }, seconds(1));
    run.others = ["paper", "quickstart"].map(str::to_owned).into();
    assert_eq!(screen(&run, seconds(3), 80, 24)[2], "Runs on this router: paper, quickstart; --run NAME watches one");
    let mut run = busy();
    run.others = ["paper".to_owned()].into();
    assert!(!screen(&run, seconds(3), 80, 24).iter().any(|line| line.contains("paper")));
}

//! Views made by hand, and exactly what a screen shows of them.

use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::*;
use crate::run_view::SessionState;
use crate::samples;

fn source() -> Source {
    Source { run: "two-blocks".to_owned(), endpoints: vec!["tcp/127.0.0.1:7447".to_owned()] }
}

fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

/// A run with two actors, one of them lost: the learner was heard at 30 s, the evaluator at 20 s.
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

/// What a screen shows, line by line without the spaces at the ends.
fn screen(run: &RunView, now: Duration, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, run, &source(), now)).unwrap();
    let buffer = terminal.backend().buffer();
    let symbol = |x, y| buffer.cell((x, y)).unwrap().symbol();
    let line = |y| (0..width).map(|x| symbol(x, y)).collect::<String>().trim_end().to_owned();
    (0..height).map(line).collect()
}

#[test]
fn a_run_fits_on_80_by_24() {
    let expected = [
        "Run two-blocks at tcp/127.0.0.1:7447",
        "learner heard 12 s ago, evaluator heard 22 s ago",
        "Success in %: weights 800, 3 276 800 environment steps, evaluated 22 s ago",
        "  group          mode (95 % interval)       of   sampled (95 %)             of",
        "  train 2-6     100.0 ( 91.2 to 100.0)      40   95.0 ( 83.5 to  98.6)      40",
        "  test 12-16     50.0 ( 35.2 to  64.8)      40   80.0 ( 65.2 to  89.5)      40",
        "  all            75.0 ( 64.5 to  83.2)      80   87.5 ( 78.5 to  93.1)      80",
        "  worst  2_002 5.0  2_003 50.0  2_001 97.5",
        "  best   2_004 100.0  2_000 100.0",
        "Learning: weights 812, 3 326 976 environment steps in 42 min",
        "  throughput  1 234 steps/s, 2 048 waiting; policy lag 1.25, at most 3",
        "  loss        total 0.031, policy -0.004, value 0.250, gradient norm 0.520",
        "  policy      KL 4.5e-4, entropy 5.432, clipped 0.080, explained variance 0.875",
        "  episodes    success 50.0 ( 23.7 to  76.3) of 10, return 3.250, 45.2 steps",
        "Actors: 2 alive, 1 lost; 640 steps/s",
        "  actor                       steps/s  weights  lag  accepted  dropped  heard",
        "  actor-1              alive      640      811    1     2 500       12  11 s ago",
        "  quiet                alive has said nothing so far",
        "  actor-2              lost       640      811    1     2 500       12  37 s ago",
        "Dropped",
        "  actors.dropped.full_total 14  actors.dropped.stale_total 10",
        "  evaluator.n_diverged 2  learner.expired_total 4  learner.ingest.stale_total 12",
        "",
        "",
    ];
    assert_eq!(screen(&busy(), seconds(42), 80, 24), expected);
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
    assert_eq!(lines[1], "The router is gone since 12 s; the newest came 22 s ago");
    assert!(lines.iter().any(|line| line == "Actors: unknown while the router is gone"), "{lines:#?}");
    let mut run = RunView::default();
    run.set_session(&samples::session(&[]), seconds(1));
    run.set_session(&samples::cut_off(), seconds(2));
    assert_eq!(screen(&run, seconds(3), 80, 24)[1], "The router is gone since 1 s; nothing came before");
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
    assert!(lines.iter().any(|line| line.starts_with("  and 49")), "{lines:#?}");
    assert!(lines[22].starts_with("  actors.dropped"), "{lines:#?}");
}

#[test]
fn no_size_is_too_small() {
    for run in [RunView::default(), busy()] {
        for (width, height) in (1..=100).flat_map(|width| (1..=30).map(move |height| (width, height))) {
            let lines = screen(&run, seconds(42), width, height);
            assert!(lines[0].starts_with('R'), "{width}x{height}: {lines:#?}");
        }
    }
}

#[test]
fn names_from_the_bus_cannot_touch_the_terminal() {
    let mut run = busy();
    let mut evaluation = samples::evaluation();
    evaluation.value["groups"][0]["name"] = "\u{1b}]0;x\u{7}\n".into();
    run.take(&evaluation, seconds(21));
    let text = text(&run, &source(), seconds(42));
    assert!(text.contains("\n  ?]0;x??  "), "{text}");
    assert!(text.chars().all(|c| c == '\n' || !c.is_control()), "{text:?}");
}

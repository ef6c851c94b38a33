//! Videos of small evaluations in real worlds.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use blueprints::{Catalog, Split};
use proto::codec::decode_recording;
use proto::metrics::VideoCounts;
use proto::{Action, ActionMode, RewardTerms, Start, Transition};
use runlog::RunPaths;

use super::VideoRecorder;
use super::queue::{ClipQueue, ROOM};
use super::selector::EpisodeSelector;
use crate::config::{EpisodeConfig, VideosConfig};
use crate::episodes::evaluate_in_parts;
use crate::episodes::tests::{performer, small_setup, weights};
use crate::pool::EvaluationPool;
use crate::recording::{Recorder, trajectory};
use crate::report::End;
use crate::report::tests::episode;
use crate::sequences::tests::{goal, scene};
use crate::spec::EpisodeSpec;

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn the_first_failure_of_a_group_becomes_a_video_and_the_report_is_as_without() {
    let dir = tempfile::tempdir().unwrap();
    let setup = small_setup(EpisodeConfig { n_episodes: 2, ..Default::default() });
    let config = VideosConfig::default();
    let recorder =
        VideoRecorder::open(&config, &RunPaths::new(dir.path()), Catalog::builtin().clone()).unwrap().unwrap();
    let selector = recorder.selector(&setup.episodes.acting);
    let goals = Catalog::builtin().of_split(Split::Train)[..2].to_vec();
    let evaluate = |selector: Option<&EpisodeSelector>| {
        let (performer, recorder) = (performer(), selector.map(|selector| selector as &dyn Recorder));
        let pool = EvaluationPool { setup: &setup, performer, recorder, progress: None, keep_going: &|| true };
        evaluate_in_parts(&pool, &goals, &mut |_| {}).unwrap()
    };
    assert_eq!(evaluate(selector.as_ref()), evaluate(None));
    let written = recorder.queue.wait_until(|counts| counts.written_total + counts.failed_total > 0);
    assert_eq!(written, VideoCounts { written_total: 1, ..VideoCounts::default() });
    recorder.close();

    // Untrained weights with eight steps build nothing, so the video shows the first episode that ends.
    let [folder] = names(&dir.path().join("videos")).try_into().unwrap();
    let goal = goals.iter().find(|goal| goal.id().as_str() == folder).unwrap();
    assert_eq!(names(&dir.path().join("videos").join(&folder)), ["00000002-failure.mp4"]);
    let replay = dir.path().join("replays").join(&folder).join("00000002-failure.trajectory");
    let segment = decode_recording(&fs::read(replay).unwrap()).unwrap();
    assert_eq!((segment.transitions.len(), segment.weights_version), (8, weights().version));
    render::video::Episode::new(&segment, goal).unwrap();
}

/// Plays an episode of one step with this end; returns whether it was recorded.
fn play(selector: &EpisodeSelector, acting: ActionMode, end: End) -> bool {
    let spec = EpisodeSpec::new(goal(), Start::Scattered, 1, 0);
    if !selector.wants(&spec, acting) {
        return false;
    }
    let (action, reward) = (Action::IDLE, RewardTerms::default());
    let step =
        Transition { scene: scene(), action, proposals: [None; 2], behavior_log_prob: 0.0, reward, disturbance: None };
    let result = episode(goal().id().as_str(), acting, end, 1);
    selector.keep(0, trajectory(performer(), &spec.task, vec![step], &scene(), &result), &result);
    true
}

fn selector(config: &VideosConfig, queue: &Arc<ClipQueue>) -> EpisodeSelector {
    EpisodeSelector::new(config, ActionMode::Greedy, queue.clone())
}

#[test]
fn nothing_is_recorded_once_every_wanted_video_is_taken() {
    let queue = Arc::new(ClipQueue::default());
    let config = VideosConfig { blueprints: vec![goal().id().clone()], ..Default::default() };
    let selector = selector(&config, &queue);
    let success = End::Success { stable: true };
    assert!(!play(&selector, ActionMode::Sampled, success), "only one way of acting is recorded");
    for _ in 0..2 {
        assert!(play(&selector, ActionMode::Greedy, success));
    }
    // One success was taken for both group and blueprint; the other was recorded because a failure was still wanted.
    assert_eq!(queue.counts().n_waiting, 1);
    assert!(play(&selector, ActionMode::Greedy, End::Diverged), "a diverged episode is a failure");
    assert_eq!(queue.counts().n_waiting, 2);
    assert!(!play(&selector, ActionMode::Greedy, success));
}

#[test]
fn a_full_queue_drops_and_counts_and_nobody_waits() {
    let queue = Arc::new(ClipQueue::default());
    // Nothing consumes this queue.
    for _ in 0..ROOM + 3 {
        let selector = selector(&VideosConfig::default(), &queue);
        assert!(play(&selector, ActionMode::Greedy, End::TimeLimit));
    }
    let expected = VideoCounts { n_waiting: ROOM as u64, dropped_total: 3, ..VideoCounts::default() };
    assert_eq!(queue.counts(), expected);
}

#[test]
fn an_empty_list_makes_no_videos() {
    let dir = tempfile::tempdir().unwrap();
    let config = VideosConfig { groups: Vec::new(), ..Default::default() };
    assert!(VideoRecorder::open(&config, &RunPaths::new(dir.path()), Catalog::builtin().clone()).unwrap().is_none());
    assert!(names(dir.path()).is_empty());
}

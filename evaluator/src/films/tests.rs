//! Films of small passes in real worlds.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use blueprints::{Blueprint, Catalog, Split};
use proto::codec::decode_trajectory;
use proto::metrics::FilmCounts;
use proto::{RewardTerms, Scene, Start, Task};

use super::VideoRecorder;
use super::queue::{ClipQueue, ROOM};
use super::selector::EpisodeSelector;
use crate::config::{EpisodeConfig, FilmsConfig};
use crate::episodes::evaluate_in_parts;
use crate::episodes::tests::{small_setup, weights};
use crate::pool::EvaluationPool;
use crate::report::Episode;
use crate::sequences::EpisodeSpec;
use crate::work_queue::WorkQueue;
use proto::ActionMode;
use proto::unit::End;
use runlog::RunPaths;

fn blueprint() -> &'static Blueprint {
    Catalog::builtin().of_split(Split::Train)[0]
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn the_first_failure_of_a_group_becomes_a_film_and_the_report_is_as_without() {
    let dir = tempfile::tempdir().unwrap();
    let setup = small_setup(EpisodeConfig { n_episodes: 2, ..Default::default() });
    let weights = Arc::new(weights(&setup));
    let config = FilmsConfig { width: 480, fps: 10, ..Default::default() };
    let recorder = VideoRecorder::open(&config, &RunPaths::new(dir.path())).unwrap().unwrap();
    let selector = recorder.selector(&weights, &setup.episodes.acting);
    let goals = Catalog::builtin().of_split(Split::Train)[..2].to_vec();
    let evaluate = |films: Option<&EpisodeSelector>| {
        let queue = WorkQueue::new(weights.clone());
        let pool = EvaluationPool { setup: &setup, queue: &queue, films, keep_going: &|| true };
        evaluate_in_parts(&pool, &goals, &mut |_| {}).unwrap()
    };
    assert_eq!(evaluate(selector.as_ref()), evaluate(None));
    let written = recorder.wait_until(|counts| counts.written_total + counts.failed_total > 0);
    assert_eq!(written, FilmCounts { written_total: 1, ..FilmCounts::default() });
    recorder.close();

    // Untrained weights with eight steps build nothing: the first episode of the first blueprint that ends is the film.
    let [folder] = names(&dir.path().join("videos")).try_into().unwrap();
    let goal = goals.iter().find(|goal| goal.id().as_str() == folder).unwrap();
    assert_eq!(names(&dir.path().join("videos").join(&folder)), ["00000002-failure.mp4"]);
    let replay = dir.path().join("replays").join(&folder).join("00000002-failure.trajectory");
    let segment = decode_trajectory(&fs::read(replay).unwrap()).unwrap();
    assert_eq!((segment.transitions.len(), segment.weights_version), (8, weights.version));
    render::video::Episode::new(&[segment], goal).unwrap();
    assert_eq!(names(&dir.path().join("tb/evaluator/films")).len(), 1);
}

/// An episode of one step that ended so.
fn play(selector: &EpisodeSelector, scene: &Scene, acting: ActionMode, end: End) -> bool {
    let goal = blueprint();
    let spec = EpisodeSpec::new(goal, Start::Scattered, 1, 0);
    let task: &Task = spec.task();
    let Some(mut recording) = selector.begin(task, goal.split(), goal.n_blocks(), acting) else { return false };
    let action = proto::Action { choices: [None, None], moves: [[0.0; 6]; blueprints::N_BLOCKS] };
    recording.note(scene.clone(), action, RewardTerms::default());
    let episode = Episode {
        blueprint: goal.id().clone(),
        split: goal.split(),
        n_blocks: goal.n_blocks(),
        acting,
        end,
        n_steps: 1,
        episode_return: RewardTerms::default(),
    };
    selector.end(recording, task, scene, &episode);
    true
}

fn scene() -> Scene {
    let still = proto::Pose { position: [0.0, 0.0, 0.05], orientation: [0.0, 0.0, 0.0, 1.0] };
    Scene {
        blocks: [still; blueprints::N_BLOCKS],
        speeds_mps: [0.0; blueprints::N_BLOCKS],
        joints: Vec::new(),
        grippers: [None, None],
        n_heavy_contacts: 0,
    }
}

fn selector(config: &FilmsConfig, queue: &Arc<ClipQueue>) -> EpisodeSelector {
    let setup = small_setup(EpisodeConfig::default());
    EpisodeSelector::new(config, Arc::new(weights(&setup)), ActionMode::Greedy, queue.clone()).unwrap()
}

#[test]
fn nothing_is_recorded_once_every_wanted_film_is_taken() {
    let queue = Arc::new(ClipQueue::default());
    let config = FilmsConfig { blueprints: vec![blueprint().id().clone()], n_of_each: 2, ..Default::default() };
    let selector = selector(&config, &queue);
    let success = End::Success { stable: true };
    assert!(!play(&selector, &scene(), ActionMode::Sampled, success), "only one way of acting is filmed");
    for end in [success, success, success, End::TimeLimit] {
        assert!(play(&selector, &scene(), ActionMode::Greedy, end));
    }
    // Two successes for group and blueprint alike; the third was recorded because a failure was still wanted.
    assert_eq!(queue.counts().n_waiting, 3);
    assert!(play(&selector, &scene(), ActionMode::Greedy, End::Diverged), "a diverged episode is a failure");
    assert_eq!(queue.counts().n_waiting, 4);
    assert!(!play(&selector, &scene(), ActionMode::Greedy, success));
}

#[test]
fn a_full_desk_drops_and_counts_and_nobody_waits() {
    let queue = Arc::new(ClipQueue::default());
    let config = FilmsConfig { n_of_each: 10, ..Default::default() };
    // Nobody takes anything off this queue.
    for _ in 0..ROOM / 10 + 1 {
        let selector = selector(&config, &queue);
        (0..10).for_each(|_| assert!(play(&selector, &scene(), ActionMode::Greedy, End::TimeLimit)));
    }
    let n_offered = (ROOM as u64 / 10 + 1) * 10;
    let expected =
        FilmCounts { n_waiting: ROOM as u64, dropped_total: n_offered - ROOM as u64, ..FilmCounts::default() };
    assert_eq!(queue.counts(), expected);
}

#[test]
fn an_empty_list_makes_no_films() {
    let dir = tempfile::tempdir().unwrap();
    let config = FilmsConfig { groups: Vec::new(), ..Default::default() };
    assert!(VideoRecorder::open(&config, &RunPaths::new(dir.path())).unwrap().is_none());
    assert!(names(dir.path()).is_empty());
}

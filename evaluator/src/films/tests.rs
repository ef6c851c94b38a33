//! Films of small passes in real worlds.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use blueprints::{Blueprint, Catalogue, Split};
use proto::codec::decode_trajectory;
use proto::metrics::FilmCounts;
use proto::{RewardTerms, Scene, Start, Task};

use super::casting::Casting;
use super::studio::{ROOM, Tray};
use super::{FilmsConfig, Studio};
use crate::config::EpisodeConfig;
use crate::desk::Desk;
use crate::episodes::tests::{small_setup, weights};
use crate::episodes::{Workshop, evaluate_in_parts};
use crate::lanes::Job;
use crate::report::{Acting, End, Episode};
use crate::run::RecordPaths;

fn paths(folder: &Path) -> RecordPaths {
    RecordPaths {
        metrics: folder.join("metrics.jsonl"),
        history: folder.join("eval.db"),
        tensorboard: folder.join("tb"),
        videos: folder.join("videos"),
        replays: folder.join("replays"),
    }
}

fn blueprint() -> &'static Blueprint {
    Catalogue::builtin().of_split(Split::Train)[0]
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
    let studio = Studio::open(&config, &paths(dir.path())).unwrap().unwrap();
    let casting = studio.casting(&weights, &setup.episodes.acting);
    let goals = Catalogue::builtin().of_split(Split::Train)[..2].to_vec();
    let evaluate = |films: Option<&Casting>| {
        let desk = Desk::new(weights.clone());
        let workshop = Workshop { setup: &setup, desk: &desk, films, keep_going: &|| true };
        evaluate_in_parts(&workshop, &goals, &mut |_| {}).unwrap()
    };
    assert_eq!(evaluate(casting.as_ref()), evaluate(None));
    let written = studio.wait_until(|counts| counts.written_total + counts.failed_total > 0);
    assert_eq!(written, FilmCounts { written_total: 1, ..FilmCounts::default() });
    studio.close();

    // Untrained weights with eight steps build nothing: the first episode of the first blueprint that ends is the film.
    let [folder] = names(&dir.path().join("videos")).try_into().unwrap();
    let goal = goals.iter().find(|goal| goal.id().as_str() == folder).unwrap();
    assert_eq!(names(&dir.path().join("videos").join(&folder)), ["00000002-failure.mp4"]);
    let replay = dir.path().join("replays").join(&folder).join("00000002-failure.trajectory");
    let segment = decode_trajectory(&fs::read(replay).unwrap()).unwrap();
    assert_eq!((segment.transitions.len(), segment.weights_version), (8, weights.version));
    crate::video::Episode::new(&[segment], goal).unwrap();
    assert_eq!(names(&dir.path().join("tb/films")).len(), 1);
}

/// An episode of one step that ended so.
fn play(casting: &Casting, scene: &Scene, acting: Acting, end: End) -> bool {
    let goal = blueprint();
    let job = Job::new(goal, Start::Scattered, 1, 0);
    let task: &Task = job.task();
    let Some(mut recording) = casting.begin(task, goal.split(), goal.n_blocks(), acting) else { return false };
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
    casting.end(recording, task, scene, &episode);
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

fn casting(config: &FilmsConfig, tray: &Arc<Tray>) -> Casting {
    let setup = small_setup(EpisodeConfig::default());
    Casting::new(config, Arc::new(weights(&setup)), Acting::Mode, tray.clone()).unwrap()
}

#[test]
fn nothing_is_recorded_once_every_wanted_film_is_taken() {
    let tray = Arc::new(Tray::default());
    let config = FilmsConfig { blueprints: vec![blueprint().id().clone()], n_of_each: 2, ..Default::default() };
    let casting = casting(&config, &tray);
    let success = End::Success { stable: true };
    assert!(!play(&casting, &scene(), Acting::Sampled, success), "only one way of acting is filmed");
    for end in [success, success, success, End::TimeLimit] {
        assert!(play(&casting, &scene(), Acting::Mode, end));
    }
    // Two successes for group and blueprint alike; the third was recorded because a failure was still wanted.
    assert_eq!(tray.counts().n_waiting, 3);
    assert!(play(&casting, &scene(), Acting::Mode, End::Diverged), "a diverged episode is a failure");
    assert_eq!(tray.counts().n_waiting, 4);
    assert!(!play(&casting, &scene(), Acting::Mode, success));
}

#[test]
fn a_full_desk_drops_and_counts_and_nobody_waits() {
    let tray = Arc::new(Tray::default());
    let config = FilmsConfig { n_of_each: 10, ..Default::default() };
    // Nobody takes anything off this tray.
    for _ in 0..ROOM / 10 + 1 {
        let casting = casting(&config, &tray);
        (0..10).for_each(|_| assert!(play(&casting, &scene(), Acting::Mode, End::TimeLimit)));
    }
    let n_offered = (ROOM as u64 / 10 + 1) * 10;
    let expected =
        FilmCounts { n_waiting: ROOM as u64, dropped_total: n_offered - ROOM as u64, ..FilmCounts::default() };
    assert_eq!(tray.counts(), expected);
}

#[test]
fn an_empty_list_makes_no_films() {
    let dir = tempfile::tempdir().unwrap();
    let config = FilmsConfig { groups: Vec::new(), ..Default::default() };
    assert!(Studio::open(&config, &paths(dir.path())).unwrap().is_none());
    assert!(names(dir.path()).is_empty());
}

//! Recorded episodes: trajectories for `render`.

use std::process::Stdio;

use proto::codec::decode_recording;

use crate::support::program::{finished, kill, lines, lodestone, names, printed, refused};

#[test]
fn a_recording_has_the_episodes_that_were_asked_for_and_can_be_shown() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = ["record", "--expert", "--blueprint", "2_000", "--blueprint", "3_000", "--episodes", "2"];
    let mut record = lodestone(folder.path());
    record.args(wanted).args(["--out", "played", "--seed", "3"]);
    let said = printed(&mut record);
    assert_eq!(said, "4 episodes\nlodestone render played/*.trajectory --out videos\n");
    let ids = ["00000-2_000", "00001-3_000", "00002-2_000", "00003-3_000"];
    assert_eq!(names(&folder.path().join("played")), ids.map(|id| format!("{id}.trajectory")));

    let files = ids.map(|id| format!("played/{id}.trajectory"));
    let shown = ["--format", "png-strip", "--out", "shown"];
    finished(lodestone(folder.path()).arg("render").args(files).args(shown));
    assert_eq!(names(&folder.path().join("shown")), ids.map(|id| format!("{id}.png")));

    refused(&mut record, 64, &["played exists already; nothing was written"]);
}

#[test]
fn an_interrupted_recording_has_whole_episodes() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = lodestone(folder.path());
    recording.args(["record", "--expert", "--blueprint", "2_000", "--episodes", "10000", "--out", "played"]);
    recording.env("RUST_LOG", "lodestone=debug,deploy=debug").stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut recording = recording.spawn().unwrap();
    let mut lines = lines(recording.stderr.take().unwrap());
    assert!(lines.any(|line| line.contains("an episode was kept")));
    kill("-INT", recording.id());
    let rest: Vec<String> = lines.collect();
    assert_eq!(recording.wait().unwrap().code(), Some(130), "{rest:?}");
    let played = folder.path().join("played");
    let names = names(&played);
    assert!((1..10_000).contains(&names.len()), "{} episodes", names.len());
    // Numbers may be missing, because several episodes run at once.
    for name in &names {
        assert!(name.ends_with("-2_000.trajectory"), "{name}");
        let episode = decode_recording(&std::fs::read(played.join(name)).unwrap()).unwrap();
        assert!(episode.episode_stats.is_some(), "{name} is only part of an episode");
    }
}

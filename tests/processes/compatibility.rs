//! This version reads the history and the recordings of version 0.1.0, and says that it cannot read its policies.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::program::{finished, lodestone, n_saved_steps, refused};

/// Copies the run that version 0.1.0 left behind into `folder`.
pub(crate) fn old_run(folder: &Path) -> PathBuf {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/run-0.1.0");
    let run = folder.join("run-0.1.0");
    copy(&golden, &run);
    run
}

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let name = entry.unwrap().file_name();
            copy(&from.join(&name), &to.join(&name));
        }
    } else {
        fs::copy(from, to).unwrap();
    }
}

#[test]
fn the_policy_of_a_run_of_version_0_1_0_is_refused_and_everything_else_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let run = old_run(folder.path());
    finished(lodestone(folder.path()).args(["report", "run-0.1.0"]));
    let groups = fs::read_to_string(run.join("report/groups.md")).unwrap();
    assert!(groups.contains("train 2-6"), "{groups}");
    let recording = "run-0.1.0/replays/2_000/00000000-failure.trajectory";
    finished(lodestone(folder.path()).args(["render", recording, "--format", "png-strip", "--out", "pictures"]));
    for (command, code, reason) in [
        (["eval", "--checkpoint", "run-0.1.0"], 66, "has format version 1, and this program reads version 4"),
        (["train", "--resume", "run-0.1.0"], 64, "run-0.1.0/config.toml:11: unknown key `ack_timeout_ms`"),
    ] {
        refused(lodestone(folder.path()).args(command), code, &[reason]);
    }
    assert_eq!(n_saved_steps(&run), 256);
}

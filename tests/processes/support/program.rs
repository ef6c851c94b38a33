//! Runs the program for the tests.

use std::path::Path;
use std::process::Command;

/// The program, in `folder` and without the caller's `LODESTONE_*` variables and `RUST_LOG`.
pub(crate) fn lodestone(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lodestone"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("LODESTONE_") || name == "RUST_LOG") {
        command.env_remove(name);
    }
    command.current_dir(folder);
    command
}

/// Environment steps of a run's newest checkpoint.
pub(crate) fn n_saved_steps(run_dir: &Path) -> u64 {
    let folders = std::fs::read_dir(run_dir.join("checkpoints")).unwrap();
    let names = folders.map(|folder| folder.unwrap().file_name().into_string().unwrap());
    names.filter_map(|name| name.strip_prefix("step-")?.parse().ok()).max().unwrap()
}

//! Python programs that read this program's output and share no code with it.

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::Command;

/// A Python that has the packages in `deploy/examples/requirements.txt`; `.ci/run` installs one.
pub(crate) fn python() -> Option<OsString> {
    let python = std::env::var_os("LODESTONE_PYTHON");
    if python.is_none() {
        eprintln!(
            "LODESTONE_PYTHON names no Python with the packages of deploy/examples, so nothing was read with one"
        );
    }
    python
}

/// Runs a script from `deploy/examples` and returns the JSON that it prints.
pub(crate) fn output_of(python: &OsStr, script: &str, args: &[&str]) -> serde_json::Value {
    output_of_script(python, &Path::new(env!("CARGO_MANIFEST_DIR")).join("examples").join(script), args)
}

/// Runs a script and returns the JSON that it prints.
pub(crate) fn output_of_script(python: &OsStr, script: &Path, args: &[&str]) -> serde_json::Value {
    let read = Command::new(python).arg(script).args(args).output().unwrap();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    serde_json::from_slice(&read.stdout).unwrap()
}

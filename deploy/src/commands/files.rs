//! Writes the output files of commands, and reads those that are JSON.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use anyhow::Context;
use blueprints::outside;
use serde::de::DeserializeOwned;

use crate::exit::Failure;
use crate::replace::{PLAIN, replace};

/// Maximum size of a JSON file in bytes; the largest, the plan of a sweep, has about 10 000 for each point.
const MAX_JSON_BYTES: u64 = 256 << 20;

/// Name and content of a file.
pub(super) type File = (String, Vec<u8>);

/// Writes files to a folder like [`write_file`].
pub(super) fn write_files(folder: &Path, files: &[File]) -> anyhow::Result<()> {
    files.iter().try_for_each(|(name, bytes)| write_file(&folder.join(name), bytes))
}

/// Writes a file to a folder, which is created if it does not exist. No reader sees a partial file.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let written = fs::create_dir_all(path.with_file_name("")).and_then(|()| replace(path, bytes, PLAIN));
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// Reads a JSON file of a run or a sweep.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Failure> {
    let read = || Ok(serde_json::from_slice(&outside::read(path, MAX_JSON_BYTES)?)?);
    read().map_err(|error: anyhow::Error| Failure::Checkpoint(error.context(format!("reading {}", path.display()))))
}

/// Writes a blueprint file; never replaces an existing one.
pub(super) fn write_new(path: &Path, text: &str) -> Result<(), Failure> {
    let failed = |error: io::Error| Failure::Input(format!("cannot write {}: {error}", path.display()));
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(failed)?;
    file.write_all(text.as_bytes()).map_err(failed)
}

//! Writes the output files of commands.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

use anyhow::Context;

use crate::exit::Failure;
use crate::replace::{PLAIN, replace};

/// Name and content of a file.
pub(super) type File = (String, Vec<u8>);

/// Writes files to a folder, which is created if it does not exist. No reader sees a partial file.
pub(super) fn write_files(folder: &Path, files: &[(impl AsRef<Path>, Vec<u8>)]) -> anyhow::Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for (name, bytes) in files {
        let path = folder.join(name);
        replace(&path, bytes, PLAIN).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// Writes a blueprint file; never replaces an existing one.
pub(super) fn write_new(path: &Path, text: &str) -> Result<(), Failure> {
    let failed = |error: io::Error| Failure::Input(format!("cannot write {}: {error}", path.display()));
    let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(failed)?;
    file.write_all(text.as_bytes()).map_err(failed)
}

//! Writes the output files of commands.

use std::fs;
use std::path::Path;

use anyhow::Context;

use crate::replace::{PLAIN, replace};

/// Name and content of a file.
pub(super) type File = (String, Vec<u8>);

/// Writes files to a folder, which is created if it does not exist. No reader sees a partial file.
///
/// # Errors
/// Names the file or folder that cannot be written.
pub(super) fn write_files(folder: &Path, files: &[(impl AsRef<Path>, Vec<u8>)]) -> anyhow::Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for (name, bytes) in files {
        let path = folder.join(name);
        replace(&path, bytes, PLAIN).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

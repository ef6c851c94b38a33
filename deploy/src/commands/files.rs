//! Writes the output files of commands.

use std::fs;
use std::path::Path;

use anyhow::Context;

/// Name and content of a file.
pub(super) type File = (String, Vec<u8>);

/// Writes files to a folder, which is created if it does not exist. Each file is written under another name and then
/// renamed, so that no reader sees a partial file.
///
/// # Errors
/// Names the file or folder that cannot be written.
pub(super) fn write_files(folder: &Path, files: &[File]) -> anyhow::Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for (name, bytes) in files {
        let (path, part) = (folder.join(name), folder.join(format!(".{name}.part")));
        fs::write(&part, bytes)
            .and_then(|()| fs::rename(&part, &path))
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

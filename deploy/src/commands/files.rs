//! Files that a command leaves behind.

use std::fs;
use std::path::Path;

use anyhow::Context;

/// A file to be written: its name and its bytes.
pub(super) type File = (String, Vec<u8>);

/// Writes files into a folder, which is made if there is none; each under another name first, so that none is ever seen
/// half.
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

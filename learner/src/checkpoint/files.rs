//! The files of a checkpoint: durable writes and verified reads.

use blueprints::hash::fnv1a;
use blueprints::outside;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::{CheckpointError, damaged, io};

/// Prefix of a checkpoint's folder name; its number of environment steps follows.
pub(super) const STEP: &str = "step-";

/// Prefix of the folder name while a checkpoint is being written; its number of environment steps follows.
pub(super) const NEW: &str = ".new-";

/// Prefix of the folder name while a checkpoint is being replaced; its own name follows.
const OLD: &str = ".old-";

/// The expected length and hash of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FileInfo {
    pub(super) name: String,
    n_bytes: u64,
    /// FNV-1a hash of the bytes, as 16 hexadecimal digits.
    fnv1a: String,
}

/// Writes a new file and flushes it to disk.
pub(crate) fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<FileInfo, CheckpointError> {
    let path = folder.join(name);
    let mut file = File::create_new(&path).map_err(io("creating", &path))?;
    file.write_all(bytes).map_err(io("writing", &path))?;
    file.sync_all().map_err(io("flushing", &path))?;
    Ok(FileInfo { name: name.to_owned(), n_bytes: bytes.len() as u64, fnv1a: hash(bytes) })
}

/// Reads a file of at most `max_bytes` bytes.
pub(super) fn read(folder: &Path, name: &str, max_bytes: u64) -> Result<Vec<u8>, CheckpointError> {
    let path = folder.join(name);
    outside::read(&path, max_bytes).map_err(io("reading", &path))
}

/// Reads a file and verifies it against its entry in `infos`.
pub(super) fn read_verified(folder: &Path, name: &str, infos: &[FileInfo]) -> Result<Vec<u8>, CheckpointError> {
    let Some(info) = infos.iter().find(|info| info.name == name) else {
        return Err(damaged(folder, name, "the state file does not list it"));
    };
    let n_bytes = fs::metadata(folder.join(name)).map_or(info.n_bytes, |file| file.len());
    if n_bytes != info.n_bytes {
        return Err(damaged(folder, name, format!("it has {n_bytes} bytes instead of {}", info.n_bytes)));
    }
    let bytes = read(folder, name, info.n_bytes)?;
    let found = hash(&bytes);
    if found != info.fnv1a {
        return Err(damaged(folder, name, format!("its hash is {found} instead of {}", info.fnv1a)));
    }
    Ok(bytes)
}

/// Renames `new` to `path`, replacing an existing folder; if that fails, the existing folder remains.
pub(super) fn replace(new: &Path, path: &Path) -> Result<(), CheckpointError> {
    if !path.exists() {
        return fs::rename(new, path).map_err(io("renaming", new));
    }
    // A folder cannot be renamed to a non-empty folder, so move the old one aside first and remove it last.
    let old = path.with_file_name(format!("{OLD}{}", path.file_name().unwrap_or_default().to_string_lossy()));
    remove(&old)?;
    fs::rename(path, &old).map_err(io("renaming", path))?;
    if let Err(error) = fs::rename(new, path) {
        fs::rename(&old, path).map_err(io("renaming", &old))?;
        return Err(io("renaming", new)(error));
    }
    if let Err(error) = remove(&old) {
        // The replacement is complete; the next write or start removes the old one.
        tracing::warn!(%error, "a replaced checkpoint was not removed");
    }
    Ok(())
}

/// Flushes a folder's entries to disk.
pub(super) fn sync_folder(folder: &Path) -> Result<(), CheckpointError> {
    File::open(folder).and_then(|file| file.sync_all()).map_err(io("flushing", folder))
}

/// Removes a folder if it exists.
pub(super) fn remove(folder: &Path) -> Result<(), CheckpointError> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(io("removing", folder)(error)),
        _ => Ok(()),
    }
}

/// Returns the folders `step-<n>` in `dir` by `n`; empty if `dir` does not exist.
pub(super) fn steps(dir: &Path) -> Result<BTreeMap<u64, PathBuf>, CheckpointError> {
    let step = |name: &str| name.strip_prefix(STEP)?.parse().ok();
    Ok(names(dir)?.into_iter().filter_map(|(name, path)| Some((step(&name)?, path))).collect())
}

/// Removes the leftovers of interrupted writes in `dir`, and restores a checkpoint whose replacement was interrupted.
/// No other process may write to `dir` at the same time.
///
/// # Errors
/// If the file system returns an error.
pub fn clean(dir: &Path) -> Result<(), CheckpointError> {
    for (name, path) in names(dir)? {
        let replaced = name.strip_prefix(OLD).filter(|of| of.starts_with(STEP)).map(|of| dir.join(of));
        match replaced {
            Some(original) if !original.exists() => fs::rename(&path, original).map_err(io("renaming", &path))?,
            None if !name.starts_with(NEW) => {}
            _ => remove(&path)?,
        }
    }
    Ok(())
}

fn names(dir: &Path) -> Result<Vec<(String, PathBuf)>, CheckpointError> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(io("listing", dir))?,
    };
    let named = |entry: fs::DirEntry| (entry.file_name().to_string_lossy().into_owned(), entry.path());
    entries.map(|entry| entry.map(named).map_err(io("listing", dir))).collect()
}

/// Returns the FNV-1a hash as 16 hexadecimal digits.
fn hash(bytes: &[u8]) -> String {
    format!("{:016x}", fnv1a(bytes.iter().copied()))
}

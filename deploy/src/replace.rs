//! Replaces files in one step.

use std::fs::Permissions;
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use tempfile::NamedTempFile;

/// Mode of a file without secrets; the process's umask takes away from it.
pub(crate) const PLAIN: u32 = 0o666;

/// Mode of a file that holds a secret.
pub(crate) const SECRET: u32 = 0o600;

/// Replaces or creates a file with this mode. A reader sees the old bytes or the new ones, even after a power loss.
///
/// # Errors
/// When the file cannot be written; an existing file then stays as it is.
pub(crate) fn replace(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    let part = write_part(path, bytes, mode)?;
    part.as_file().sync_all()?;
    part.persist(path)?;
    Ok(())
}

/// Like [`replace`], but does not wait for the disk: after a power loss, the file may be empty.
pub(crate) fn replace_unsynced(path: &Path, bytes: &[u8], mode: u32) -> io::Result<()> {
    write_part(path, bytes, mode)?.persist(path)?;
    Ok(())
}

/// Writes a new file beside `path`, which is removed when dropped.
fn write_part(path: &Path, bytes: &[u8], mode: u32) -> io::Result<NamedTempFile> {
    // A rename works only within a file system. The name is new, because an existing file would keep its mode, and
    // short, because the file's own name may be as long as a name can be.
    let mut part = tempfile::Builder::new()
        .prefix(".")
        .suffix(".part")
        .permissions(Permissions::from_mode(mode))
        .tempfile_in(path.parent().unwrap_or(Path::new("")))?;
    part.write_all(bytes)?;
    Ok(part)
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::io::Read;

    use super::*;

    #[test]
    fn a_reader_sees_the_old_bytes_or_the_new_ones() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        replace_unsynced(&path, b"old", PLAIN).unwrap();
        let mut reader = File::open(&path).unwrap();
        replace(&path, b"new", SECRET).unwrap();
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        assert_eq!((text.as_str(), fs::read_to_string(&path).unwrap().as_str()), ("old", "new"));
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else is left");
    }

    #[test]
    fn a_file_that_cannot_be_replaced_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::create_dir(&path).unwrap();
        assert!(replace(&path, b"new", PLAIN).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

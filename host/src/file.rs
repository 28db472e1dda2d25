//! Files are written beside their place and renamed into it, so that a crash or a full disk never leaves half a file.

use std::fs;
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Calls `write` with a temporary path in the folder of `path` and renames the result to `path`.
///
/// # Errors
/// Whatever `write` returns, or the failure to rename; then the temporary file is removed and what stood at `path` is untouched.
pub fn write_beside(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let temporary = temporary_for(path);
    let finished = write(&temporary).and_then(|()| fs::rename(&temporary, path).map_err(Error::io("write", path)));
    if finished.is_err() {
        // Best effort: the error that matters is the one returned.
        let _ = fs::remove_file(&temporary);
    }
    finished
}

/// Writes `bytes` to `path` by way of a temporary file.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be written or the disk is full.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_beside(path, |temporary| fs::write(temporary, bytes).map_err(Error::io("write", path)))
}

fn temporary_for(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.rigel-tmp", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        write_bytes(&path, b"before").unwrap();
        let failed = write_beside(&path, |temporary| {
            fs::write(temporary, b"half").unwrap();
            Err(Error::Interrupted)
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"before");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

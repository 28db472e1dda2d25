//! One writer at a time: a file in the session's folder that the writer holds locked.

use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;

use crate::{Error, Result};

/// The file's name. It stays when the writer is gone; what counts is who holds it, and the dead hold nothing.
pub(super) const LOCK_FILE: &str = "capture.lock";

/// The right to write into a session, until it is dropped or the process ends in whatever way.
#[derive(Debug)]
pub(super) struct Lock(#[expect(dead_code, reason = "held, not read")] File);

impl Lock {
    /// Takes the lock of the session in `folder`.
    ///
    /// # Errors
    /// [`Error::Input`] when another process, or another part of this one, has it; [`Error::Io`] when it cannot be made.
    pub(super) fn take(folder: &Path) -> Result<Self> {
        let path = folder.join(LOCK_FILE);
        let file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&path)
            .map_err(Error::io("write", &path))?;
        match file.try_lock() {
            Ok(()) => Ok(Self(file)),
            Err(TryLockError::WouldBlock) => Err(Error::input(
                folder,
                "another rigel is writing into this session",
                "wait until it is done, or stop it",
            )),
            Err(TryLockError::Error(error)) => Err(Error::io("lock", &path)(error)),
        }
    }
}

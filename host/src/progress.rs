//! How long work tells that it goes on, and is told to stop.

use crate::Result;

/// Receives the progress of one piece of work. Called from several threads.
pub trait Progress: Sync {
    /// `done` of `total` steps are finished.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] when the user asked to stop: the work then leaves what it has finished and returns.
    fn step(&self, done: usize, total: usize) -> Result<()>;
}

/// Progress that nobody watches.
pub struct Silent;

impl Progress for Silent {
    fn step(&self, _done: usize, _total: usize) -> Result<()> {
        Ok(())
    }
}

//! A camera: something that takes a photograph with a given exposure time and leaves its own file.

use std::path::{Path, PathBuf};

use crate::Result;

/// What a camera took.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// The camera's own file.
    pub file: PathBuf,
    /// The exposure time that was really used, seconds: a camera rounds what it is asked for.
    pub exposure_s: f64,
}

/// A camera whose exposure time can be set.
pub trait Camera {
    /// Make, model and settings in one line, for the session's manifest.
    fn describe(&self) -> String;

    /// Shortest and longest exposure time, seconds.
    fn exposure_range_s(&self) -> [f64; 2];

    /// Takes one photograph and leaves the camera's own file at `stem` plus its extension.
    ///
    /// # Errors
    /// [`crate::Error::Request`] when the camera cannot expose for `exposure_s`, [`crate::Error::Device`] when it does
    /// not answer, [`crate::Error::Io`] when the file cannot be written.
    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Taken>;

    /// Size of one file, bytes, for planning.
    fn file_size_bytes(&self) -> u64;
}

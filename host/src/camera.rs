//! A camera: something that takes a photograph with a given exposure time and leaves its own file.

pub mod exif;
pub mod folder;
pub mod matching;
pub mod trigger;
#[cfg(feature = "webcam")]
pub mod webcam;

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::Result;

/// What a camera took.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// The camera's own file.
    pub file: PathBuf,
    /// The exposure time that was really used, seconds: a camera rounds what it is asked for.
    pub exposure_s: f64,
}

/// A photograph, or the promise of one.
#[derive(Debug, Clone, PartialEq)]
pub enum Shot {
    /// The photograph's file is here.
    Taken(Taken),
    /// The camera has exposed; its file stays in the camera and is collected afterwards.
    Later {
        /// The exposure time that the camera was asked for, seconds.
        exposure_s: f64,
        /// When the exposure began, by the host's clock.
        at: SystemTime,
    },
}

impl Shot {
    /// What was taken.
    ///
    /// # Errors
    /// [`crate::Error::Request`] when the file comes later.
    pub fn taken(self) -> Result<Taken> {
        match self {
            Self::Taken(taken) => Ok(taken),
            Self::Later { .. } => Err(crate::Error::request(
                "the camera keeps its photographs, but the next one is needed now",
                "name a camera that hands its photographs over, such as trigger:FOLDER",
            )),
        }
    }
}

/// A camera whose exposure time can be set.
pub trait Camera {
    /// Make, model and settings in one line, for the session's manifest.
    fn describe(&self) -> String;

    /// Shortest and longest exposure time, seconds.
    fn exposure_range_s(&self) -> [f64; 2];

    /// Takes one photograph and leaves the camera's own file at `stem` plus its extension, or says that it comes later.
    ///
    /// # Errors
    /// [`crate::Error::Request`] when the camera cannot expose for `exposure_s`, [`crate::Error::Device`] when it does
    /// not answer or answers what cannot be true, [`crate::Error::Input`] when the file that it left is not the
    /// photograph that was asked for, [`crate::Error::Io`] when the file cannot be written.
    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot>;

    /// How much longer than its exposure of `exposure_s` a photograph takes at most when all is well, seconds, for planning.
    fn overhead_s(&self, exposure_s: f64) -> f64 {
        let _ = exposure_s;
        0.0
    }

    /// Size of one file, bytes, for planning.
    fn file_size_bytes(&self) -> u64;
}

//! What a journal remembers: one event per line.

use std::time::SystemTime;

use serde::{Deserialize, Serialize};

use super::content::Content;
use super::time;

/// What the journal remembers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Event {
    /// A capture began, or went on, with these devices and programs.
    Run(Run),
    /// A photograph was taken and its file is complete.
    Photograph(Photograph),
    /// The camera has exposed; its file is collected later.
    Exposed(Exposed),
    /// All photographs of a view were taken.
    ViewDone {
        /// Index of the view in the manifest.
        view: usize,
    },
    /// The rig did not stand still while a view was photographed: its photographs until here count no longer.
    ViewMoved {
        /// Index of the view in the manifest.
        view: usize,
    },
    /// Something happened to a device that whoever doubts a photograph should know: it was started or connected again.
    Notice {
        /// When.
        #[serde(with = "time")]
        at: SystemTime,
        /// What, in a sentence.
        text: String,
    },
}

/// Who took the photographs that follow.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    /// When it began.
    #[serde(with = "time")]
    pub at: SystemTime,
    /// Version of rigel.
    pub rigel: String,
    /// Version of the conversation with the rig.
    pub protocol: u16,
    /// Fingerprint of that conversation's words, eight hexadecimal digits.
    pub schema: String,
    /// The rig's description of itself.
    pub rig: String,
    /// The camera's description of itself.
    pub camera: String,
    /// Operating system and processor.
    pub system: String,
}

impl Run {
    /// This program, now, with these devices.
    pub fn now(rig: impl Into<String>, camera: impl Into<String>) -> Self {
        Self {
            at: time::now(),
            rigel: env!("CARGO_PKG_VERSION").into(),
            protocol: rigel_protocol::VERSION,
            schema: format!("{:08x}", rigel_protocol::SCHEMA),
            rig: rig.into(),
            camera: camera.into(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

/// One photograph of a view. What old journals and imports do not know is absent.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Photograph {
    /// Index of the view in the manifest.
    pub view: usize,
    /// The camera's own file, relative to the session's folder.
    pub file: String,
    /// The exposure time that was really used, seconds; absent where nobody knows it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// The exposure time that the camera was asked for, seconds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub asked_exposure_s: Option<f64>,
    /// When it was taken, by the host's clock.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "time::optional")]
    pub at: Option<SystemTime>,
    /// Where the rig was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<Place>,
    /// The file's size and hash.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content: Option<Content>,
}

/// A photograph whose file is still in the camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Exposed {
    /// Index of the view in the manifest.
    pub view: usize,
    /// Its file's name once it is collected, relative to the session's folder and without extension.
    pub stem: String,
    /// The exposure time that the camera was asked for, seconds.
    pub asked_exposure_s: f64,
    /// When the exposure began, by the host's clock.
    #[serde(with = "time")]
    pub at: SystemTime,
    /// Where the rig was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<Place>,
}

/// Where the rig was when a photograph was taken; pan, then tilt.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Where it was sent, degrees.
    pub commanded_deg: [f64; 2],
    /// Where it said that it was, degrees.
    pub reported_deg: [f64; 2],
    /// How long it was left to swing after the move, seconds.
    pub settle_s: f64,
}

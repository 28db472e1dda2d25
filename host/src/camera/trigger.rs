//! A camera on the rig's trigger line: the rig releases it, its photographs come into a folder or, after the session, from
//! its card.

use std::path::Path;
use std::time::{Duration, SystemTime};

use super::folder::Inbox;
use super::matching::{Exposure, Matcher};
use super::{Camera, Shot, Taken};
use crate::rig::Contact;
use crate::{Error, Result};

/// A photograph of a camera with 24 megapixels at its best JPEG quality, bytes.
const FILE_SIZE_BYTES: u64 = 20_000_000;
/// What cameras can expose for as long as a contact is closed, seconds.
const BULB_RANGE_S: [f64; 2] = [1.0 / 60.0, 900.0];

/// Closes the contact for so many seconds and says when that began.
pub type Shutter = Box<dyn FnMut(f64) -> Result<SystemTime> + Send>;

/// A camera in bulb mode that something else releases.
pub struct TriggerCamera {
    shutter: Shutter,
    inbox: Option<Inbox>,
    wait: Duration,
    matcher: Matcher,
}

impl TriggerCamera {
    /// A camera behind a shutter contact. Where its photographs appear in a folder while it takes them, each must come within
    /// `wait` after its exposure; what is in that folder now belongs to somebody else.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be read.
    pub fn new(shutter: Shutter, folder: Option<&Path>, wait: Duration) -> Result<Self> {
        let mut inbox = folder.map(Inbox::new).transpose()?;
        if let Some(inbox) = &mut inbox {
            inbox.ignore_present()?;
        }
        Ok(Self { shutter, inbox, wait, matcher: Matcher::default() })
    }
}

impl Camera for TriggerCamera {
    fn describe(&self) -> String {
        match &self.inbox {
            Some(inbox) => {
                format!("camera on the trigger line, photographs from the folder {}", inbox.folder.display())
            }
            None => "camera on the trigger line, photographs collected afterwards".into(),
        }
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        BULB_RANGE_S
    }

    /// Releases the camera, and waits for its photograph where there is a folder.
    ///
    /// # Errors
    /// Beside those of every camera, [`Error::Input`] naming the file when a photograph comes that nobody asked for, when two
    /// come for one exposure, and what [`Matcher::accept`] refuses; [`Error::Device`] when none comes.
    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        let [shortest, longest] = BULB_RANGE_S;
        if !(shortest..=longest).contains(&exposure_s) {
            return Err(Error::request(
                format!("a camera in bulb mode cannot expose for {exposure_s} s"),
                format!("choose a time from {shortest:.3} s to {longest} s"),
            ));
        }
        let unasked = self.inbox.as_ref().map(Inbox::new_files).transpose()?.unwrap_or_default();
        if let Some(path) = unasked.first() {
            return Err(Error::input(
                path,
                "came without an exposure of this session",
                "see that nobody else releases the camera, and move the file away",
            ));
        }
        let at = (self.shutter)(exposure_s)?;
        let Some(inbox) = &mut self.inbox else {
            return Ok(Shot::Later { exposure_s, at });
        };
        let file = inbox.wait(self.wait + Duration::from_secs_f64(exposure_s), |new| match &new[..] {
            [] => Ok(None),
            [path] => Ok(Some(path.clone())),
            [path, second, ..] => Err(Error::input(
                second,
                format!("came together with {} although the camera was released once", path.display()),
                "let the camera write one file for each photograph, and see that nobody else releases it",
            )),
        })?;
        let exposure_s = self.matcher.accept(&Exposure { at, exposure_s }, &file)?;
        let file = inbox.take(&file, stem)?;
        Ok(Shot::Taken(Taken { file, exposure_s }))
    }

    /// The contact's half-press and pause, and the time in which the photograph must come into its folder.
    fn overhead_s(&self, _exposure_s: f64) -> f64 {
        let Contact { half_press_s, pause_s, .. } = Contact::default();
        half_press_s + pause_s + self.inbox.as_ref().map_or(0.0, |_| self.wait.as_secs_f64())
    }

    fn file_size_bytes(&self) -> u64 {
        FILE_SIZE_BYTES
    }
}

#[cfg(test)]
mod tests;

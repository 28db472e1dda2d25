//! The camera's contact on the rig.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use rigel_protocol::{Answer, Bracket, Command, LONGEST_BRACKET, Reply};

use super::conversation::confused;
use super::serial::Line;
use crate::{Error, Result};

/// A photograph that the rig has triggered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposed {
    /// When the contact closed, by the host's clock.
    pub at: SystemTime,
    /// Whether the camera's flash-sync came.
    pub confirmed: bool,
}

/// A rig's contact for a camera: a handle that other threads may have.
#[derive(Clone)]
pub struct TriggerLine {
    pub(super) line: Arc<Mutex<Line>>,
}

impl TriggerLine {
    /// Closes the contact for each of these times, seconds, one after the other; returns when the last has ended.
    ///
    /// # Errors
    /// [`Error::Request`] for no or too many times, or times that no contact can have; [`Error::Device`] when the rig does
    /// not do it.
    pub fn expose(&self, exposures_s: &[f64]) -> Result<Vec<Exposed>> {
        let pulses_us = exposures_s.iter().map(|&s| pulse_us(s)).collect::<Result<_>>()?;
        if exposures_s.is_empty() {
            return Err(Error::request("a bracket of no photographs", "ask for one at least"));
        }
        let mut line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        let bracket = Bracket { half_press_ms: 0, pulses_us, pause_ms: 500, confirm_ms: 0 };
        match line.ask(Command::Trigger(bracket))? {
            Reply::Accepted { duration_ms } => {
                let deadline = Instant::now() + Duration::from_millis(duration_ms.into());
                let mut taken = vec![];
                while Instant::now() < deadline + Duration::from_secs(3) {
                    match line.hear(Duration::from_millis(200))? {
                        Some(Answer { reply: Reply::Exposed { confirmed, .. }, .. }) => {
                            taken.push(Exposed { at: SystemTime::now(), confirmed });
                        }
                        Some(Answer { reply: Reply::Triggered { .. }, .. }) => return Ok(taken),
                        _ => {}
                    }
                }
                Err(line.error("the bracket did not end", "look at the rig, then start again"))
            }
            Reply::Refused(fault) => {
                Err(line
                    .error(format!("the rig refuses to trigger: {fault:?}"), "wait until it stands still"))
            }
            reply => Err(confused(&line.name, &reply)),
        }
    }
}

fn pulse_us(exposure_s: f64) -> Result<u32> {
    let pulse_us = (exposure_s * 1e6).round();
    if (1.0..=f64::from(u32::MAX)).contains(&pulse_us) {
        return Ok(pulse_us as u32);
    }
    Err(Error::request(
        format!("no contact can be closed for {exposure_s} s"),
        format!("choose up to {LONGEST_BRACKET} times of 1e-6 to 4294 s"),
    ))
}

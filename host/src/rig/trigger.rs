//! The camera's contact on the rig.

use std::time::{Duration, Instant, SystemTime};

use rigel_protocol::{Bracket, Command, Fault, LONGEST_BRACKET, Reply, State, Status};

use super::clock::Moment;
use super::link::Link;
use crate::{Error, Result};

/// How much later than announced a bracket may end.
const PATIENCE: Duration = Duration::from_secs(3);
/// How often the rig is asked for the time before a bracket: the shortest round trip counts.
const PINGS: u32 = 4;

/// A photograph that the rig has triggered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposed {
    /// When the contact closed, by the host's clock; right within a fraction of a second.
    pub at: SystemTime,
    /// Whether the camera's flash-sync came.
    pub confirmed: bool,
}

/// How a camera wants its contact to be closed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// How long the half-press (focus, wake-up) is held before the first photograph, seconds; 0 for none.
    pub half_press_s: f64,
    /// From the end of one photograph to the start of the next, seconds.
    pub pause_s: f64,
    /// How long after its contact closed a photograph's flash-sync may come, seconds; 0 where none is wired.
    pub confirm_s: f64,
}

impl Default for Contact {
    /// A third of a second to wake up, half a second to store a photograph, no flash-sync.
    fn default() -> Self {
        Self { half_press_s: 0.3, pause_s: 0.5, confirm_s: 0.0 }
    }
}

/// A rig's contact for a camera: a handle that other threads may have. The port stays open as long as it lives.
#[derive(Clone)]
pub struct TriggerLine {
    link: Link,
    /// How its camera wants it.
    pub contact: Contact,
}

impl TriggerLine {
    pub(super) fn new(link: Link) -> Self {
        Self { link, contact: Contact::default() }
    }

    /// Closes the contact for each of these times, seconds, one after the other; returns when the last has ended.
    ///
    /// When the cable is out meanwhile, the rig goes on; what it did is asked for when the cable is back, and the times of
    /// photographs whose word was lost are computed from the others.
    ///
    /// # Errors
    /// [`Error::Request`] for no times, or times that no contact can have; [`Error::Device`] when the rig does not do it,
    /// not all of it, or has restarted: how many photographs the camera has then taken is told where it is known.
    pub fn expose(&self, exposures_s: &[f64]) -> Result<Vec<Exposed>> {
        if exposures_s.is_empty() {
            return Err(Error::request("a bracket of no photographs", "ask for one at least"));
        }
        let pulses_us = exposures_s.iter().map(|&time_s| pulse_us(time_s)).collect::<Result<Vec<_>>>()?;
        let mut taken = Vec::with_capacity(pulses_us.len());
        for pulses_us in pulses_us.chunks(LONGEST_BRACKET) {
            taken.extend(self.bracket(pulses_us)?);
        }
        Ok(taken)
    }

    fn bracket(&self, pulses_us: &[u32]) -> Result<Vec<Exposed>> {
        let Contact { half_press_s, pause_s, confirm_s } = self.contact;
        let (pause_ms, half_press_ms) = (ms(pause_s)?, ms(half_press_s)?);
        let bracket = Bracket {
            half_press_ms,
            pulses_us: pulses_us.iter().copied().collect(),
            pause_ms,
            confirm_ms: ms(confirm_s)?,
        };
        for _ in 0..PINGS {
            self.link.ping()?;
        }
        let asked = self.link.ask(&Command::Trigger(bracket))?;
        let duration = match asked.reply {
            Reply::Accepted { duration_ms } => Duration::from_millis(duration_ms.into()),
            Reply::Refused(Fault::Busy) => {
                return Err(self.link.error("the rig is busy", "photograph when it stands still"));
            }
            Reply::Refused(Fault::NoHello) => return Err(self.restarted()),
            Reply::Refused(fault) => {
                let what = format!("the rig refuses to trigger: {fault:?}");
                return Err(self.link.error(what, "choose other exposure times"));
            }
            reply => return Err(self.link.confused(&reply)),
        };
        let began = SystemTime::now() - asked.heard.elapsed() + Duration::from_millis(half_press_ms.into());
        let mut heard = vec![None; pulses_us.len()];
        let (exposed, confirmed) = self.wait(asked.sequence, duration, &mut heard)?;
        if usize::from(exposed) != pulses_us.len() {
            return Err(self.link.error(
                format!("only {exposed} of {} photographs were triggered", pulses_us.len()),
                "see what stopped the rig, then start again",
            ));
        }
        Ok(filled(&heard, usize::from(confirmed), pulses_us, pause_ms, began))
    }

    /// Waits for the end of a bracket: how many photographs were taken and how many confirmed.
    fn wait(&self, sequence: u16, duration: Duration, heard: &mut [Option<Exposed>]) -> Result<(u8, u8)> {
        let deadline = Instant::now() + duration + PATIENCE;
        loop {
            match self.link.ear().event(sequence, self.link.timing().silence()) {
                Some(Reply::Exposed { index, at_us, confirmed }) => {
                    self.note(heard, index, at_us, confirmed);
                    continue;
                }
                Some(Reply::Triggered { exposed, confirmed }) => return Ok((exposed, confirmed)),
                Some(reply @ (Reply::Stopped { .. } | Reply::Halted { .. })) => {
                    return Err(self.link.error(
                        format!("the bracket was ended early: {reply:?}"),
                        "see what stopped the rig, then start again",
                    ));
                }
                _ => {}
            }
            match self.link.ask(&Command::Status)?.reply {
                Reply::Status(Status { state: State::Exposing, .. }) if Instant::now() < deadline => {}
                Reply::Status(Status { state: State::Exposing, exposed, .. }) => {
                    let _ = self.link.ask(&Command::Stop);
                    return Err(self.link.error(
                        format!("the bracket did not end: {exposed} photographs were triggered"),
                        "look at the rig, then start again",
                    ));
                }
                Reply::Status(Status { exposed, confirmed, .. }) => {
                    // The bracket may have ended between the last look and this answer: what was said before it is here.
                    while let Some(event) = self.link.ear().event(sequence, Duration::ZERO) {
                        if let Reply::Exposed { index, at_us, confirmed } = event {
                            self.note(heard, index, at_us, confirmed);
                        }
                    }
                    return Ok((exposed, confirmed));
                }
                Reply::Refused(Fault::NoHello) => return Err(self.restarted()),
                reply => return Err(self.link.confused(&reply)),
            }
        }
    }

    fn note(&self, heard: &mut [Option<Exposed>], index: u8, at_us: u64, confirmed: bool) {
        let moment = self.link.ear().moment(at_us);
        // What was heard is no story of the future, however badly the clock is known.
        let at = moment.map(|moment: Moment| self.link.ear().system_time(moment).min(SystemTime::now()));
        if let (Some(slot), Some(at)) = (heard.get_mut(usize::from(index)), at) {
            *slot = Some(Exposed { at, confirmed });
        }
    }

    fn restarted(&self) -> Error {
        self.link.error(
            "the rig has restarted in a bracket: nobody knows how many photographs the camera has taken",
            "check the rig's power supply, then start again",
        )
    }
}

/// Every photograph of a bracket that was taken whole: those whose word was lost are placed by the bracket's own times, and
/// unconfirmed unless all were confirmed.
fn filled(
    heard: &[Option<Exposed>],
    confirmed: usize,
    pulses_us: &[u32],
    pause_ms: u16,
    began: SystemTime,
) -> Vec<Exposed> {
    let starts: Vec<Duration> = pulses_us
        .iter()
        .scan(Duration::ZERO, |start, &pulse_us| {
            let this = *start;
            *start += Duration::from_micros(pulse_us.into()) + Duration::from_millis(pause_ms.into());
            Some(this)
        })
        .collect();
    let known = heard.iter().zip(&starts).find_map(|(exposed, &start)| Some(exposed.as_ref()?.at - start));
    let first = known.unwrap_or(began);
    heard
        .iter()
        .zip(&starts)
        .map(|(exposed, &start)| {
            exposed.unwrap_or(Exposed { at: first + start, confirmed: confirmed == heard.len() })
        })
        .collect()
}

fn pulse_us(exposure_s: f64) -> Result<u32> {
    let pulse_us = (exposure_s * 1e6).round();
    if (1.0..=f64::from(u32::MAX)).contains(&pulse_us) {
        return Ok(pulse_us as u32);
    }
    Err(Error::request(
        format!("no contact can be closed for {exposure_s} s"),
        "choose times from a microsecond to 4294 s",
    ))
}

fn ms(time_s: f64) -> Result<u16> {
    let time_ms = (time_s * 1e3).round();
    if (0.0..=f64::from(u16::MAX)).contains(&time_ms) {
        return Ok(time_ms as u16);
    }
    Err(Error::request(format!("a camera's contact cannot wait {time_s} s"), "choose a time up to 65 s"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_whose_word_was_lost_are_placed_by_the_others() {
        let began = SystemTime::UNIX_EPOCH + Duration::from_secs(100);
        let (pulses_us, pause_ms) = ([1_000_000, 500_000, 250_000], 100);
        let after = |ms| began + Duration::from_millis(ms);
        let told = |at, confirmed| Some(Exposed { at, confirmed });
        // None was heard: the plan counts.
        let all = filled(&[None; 3], 3, &pulses_us, pause_ms, began);
        assert_eq!(all.iter().map(|e| e.at).collect::<Vec<_>>(), [after(0), after(1100), after(1700)]);
        assert!(all.iter().all(|e| e.confirmed));
        // One was heard, 50 ms later than planned: so were its neighbours.
        let all = filled(&[None, told(after(1150), true), None], 1, &pulses_us, pause_ms, began);
        assert_eq!(all.iter().map(|e| e.at).collect::<Vec<_>>(), [after(50), after(1150), after(1750)]);
        assert_eq!(all.iter().map(|e| e.confirmed).collect::<Vec<_>>(), [false, true, false]);
    }

    #[test]
    fn times_that_no_contact_can_have_are_refused() {
        assert_eq!(pulse_us(0.25).unwrap(), 250_000);
        for time_s in [0.0, 1e-9, -1.0, 5000.0, f64::NAN, f64::INFINITY] {
            assert!(pulse_us(time_s).is_err(), "{time_s}");
        }
        assert_eq!(ms(0.3).unwrap(), 300);
        assert!(ms(-0.1).is_err() && ms(66.0).is_err() && ms(f64::NAN).is_err());
    }
}

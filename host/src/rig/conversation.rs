//! The conversation with the rig at the other end of a serial port (or of a pseudo-terminal, where it is simulated).

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use rigel_protocol::{Answer, Command, Fault, Limits, Reply, SCHEMA, State, Status, VERSION};

use super::serial::Line;
use super::{Reached, Rig, RigLimits, TriggerLine};
use crate::{Error, Result};

/// How long a moving rig may be silent before it is asked: its word that it arrived can be lost.
const SILENCE: Duration = Duration::from_millis(200);
/// How much later than announced a move may end.
const PATIENCE: Duration = Duration::from_secs(3);

/// No rig has coarser steps than a tenth of a degree; it goes to the step nearest to an angle.
const LARGEST_STEP_MDEG: u32 = 100;

/// The rig on a serial port: homed, in conversation, and asked one thing at a time.
pub struct SerialRig {
    line: Arc<Mutex<Line>>,
    name: String,
    board: String,
    limits: RigLimits,
}

impl SerialRig {
    /// Opens a port (`/dev/ttyACM0`, `COM3`), says hello and homes the rig; returns when it stands at pan 0, tilt 0.
    ///
    /// # Errors
    /// [`Error::Device`], naming the port: when it cannot be opened, when nothing there answers within two seconds, when
    /// the firmware speaks another version or schema (both are named), when the rig does not home.
    pub fn open(port_name: &str) -> Result<Self> {
        let mut line = Line::open(port_name)?;
        // A hello of another version or schema never gets here: the line refuses it.
        let hello = match line.ask(Command::Hello {
            version: VERSION,
            schema: SCHEMA,
            conversation: conversation(),
        })? {
            Reply::Hello(hello) => hello,
            reply => return Err(confused(&line.name, &reply)),
        };
        if hello.limits.speed_mdeg_s == 0 || hello.limits.acceleration_mdeg_s2 == 0 {
            let what = format!("the rig says that it cannot move: {:?}", hello.limits);
            return Err(line.error(what, "correct the limits in its firmware"));
        }
        let mut rig = Self {
            name: line.name.clone(),
            line: Arc::new(Mutex::new(line)),
            board: hello.board.as_str().into(),
            limits: limits(&hello.limits),
        };
        rig.home()?;
        Ok(rig)
    }

    /// The camera's contact: a handle that other threads may have.
    pub fn trigger_line(&self) -> TriggerLine {
        TriggerLine { line: self.line.clone() }
    }

    fn line(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn ask(&self, command: Command) -> Result<Reply> {
        self.line().ask(command)
    }

    fn error(&self, what: impl Into<String>, remedy: &str) -> Error {
        Error::Device { device: self.name.clone(), what: what.into(), remedy: remedy.into() }
    }

    fn home(&mut self) -> Result<()> {
        // A host that went away may have left the rig moving.
        if let Reply::Accepted { duration_ms } = self.ask(Command::Stop)?
            && duration_ms > 0
        {
            self.wait(None, duration_ms)?;
        }
        match self.ask(Command::Home)? {
            Reply::Accepted { duration_ms } => self.wait(Some([0, 0]), duration_ms).map(|_| ()),
            Reply::Refused(fault) => {
                Err(self.error(format!("the rig refuses to home: {fault:?}"), "switch it off and on again"))
            }
            reply => Err(confused(&self.name, &reply)),
        }
    }

    /// Waits until a move has ended, at `goal` if there is one.
    fn wait(&mut self, goal: Option<[i32; 2]>, duration_ms: u32) -> Result<Reached> {
        let sequence = self.line().sequence();
        let deadline = Instant::now() + Duration::from_millis(duration_ms.into()) + PATIENCE;
        loop {
            let heard = self.line().hear(SILENCE)?;
            let at = match heard {
                Some(Answer { sequence: s, reply: Reply::Arrived { pan_mdeg, tilt_mdeg } })
                    if s == sequence =>
                {
                    [pan_mdeg, tilt_mdeg]
                }
                Some(Answer { reply: Reply::Stopped { pan_mdeg, tilt_mdeg }, .. }) => [pan_mdeg, tilt_mdeg],
                // An answer to something older.
                Some(_) => continue,
                None => match self.ask(Command::Status)? {
                    Reply::Status(Status { state: State::Still, pan_mdeg, tilt_mdeg, .. }) => {
                        [pan_mdeg, tilt_mdeg]
                    }
                    // Stopped on its way to the switches.
                    Reply::Status(Status { state: State::Lost, pan_mdeg, tilt_mdeg, .. })
                        if goal.is_none() =>
                    {
                        [pan_mdeg, tilt_mdeg]
                    }
                    Reply::Status(Status {
                        state: State::Homing | State::Moving | State::Braking | State::Settling,
                        ..
                    }) if Instant::now() < deadline => {
                        continue;
                    }
                    Reply::Status(Status {
                        state: State::Homing | State::Moving | State::Braking | State::Settling,
                        pan_mdeg,
                        tilt_mdeg,
                        ..
                    }) => {
                        // Nothing is known about what holds it up: better that it stands still.
                        let _ = self.ask(Command::Stop);
                        return Err(self.error(
                            format!(
                                "the rig did not arrive within {:.1} s and is at pan {}°, tilt {}°",
                                f64::from(duration_ms) / 1000.0 + PATIENCE.as_secs_f64(),
                                degrees(pan_mdeg),
                                degrees(tilt_mdeg)
                            ),
                            "see what blocks it, then start again",
                        ));
                    }
                    _ => return Err(self.restarted()),
                },
            };
            return match goal {
                Some(goal) if (0..2).any(|i| goal[i].abs_diff(at[i]) > LARGEST_STEP_MDEG / 2) => Err(self
                    .error(
                        format!(
                            "the rig stopped at pan {}°, tilt {}° instead of pan {}°, tilt {}°",
                            degrees(at[0]),
                            degrees(at[1]),
                            degrees(goal[0]),
                            degrees(goal[1])
                        ),
                        "see what stopped it, then start again",
                    )),
                _ => {
                    Ok(Reached { pan_rad: rad(at[0]), tilt_rad: rad(at[1]), settle_s: self.limits.settle_s })
                }
            };
        }
    }

    fn restarted(&self) -> Error {
        self.error("the rig has restarted and lost its position", "check its power supply, then start again")
    }

    fn outside(&self, axis: &str, asked_rad: f64, [low_rad, high_rad]: [f64; 2]) -> Error {
        self.error(
            format!(
                "a {axis} of {:.3}° is outside the rig's limits of {:.3}° to {:.3}°",
                asked_rad.to_degrees(),
                low_rad.to_degrees(),
                high_rad.to_degrees()
            ),
            "choose a view that the rig can reach",
        )
    }
}

impl Rig for SerialRig {
    fn limits(&self) -> RigLimits {
        self.limits
    }

    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached> {
        // Only what fits the words is said; whether it is within the limits, the rig decides.
        let pan_mdeg = mdeg(pan_rad).ok_or_else(|| self.outside("pan", pan_rad, self.limits.pan_rad))?;
        let tilt_mdeg = mdeg(tilt_rad).ok_or_else(|| self.outside("tilt", tilt_rad, self.limits.tilt_rad))?;
        match self.ask(Command::MoveTo { pan_mdeg, tilt_mdeg })? {
            Reply::Accepted { duration_ms } => self.wait(Some([pan_mdeg, tilt_mdeg]), duration_ms),
            Reply::Refused(Fault::PanOutside { min_mdeg, max_mdeg, .. }) => {
                Err(self.outside("pan", pan_rad, [rad(min_mdeg), rad(max_mdeg)]))
            }
            Reply::Refused(Fault::TiltOutside { min_mdeg, max_mdeg, .. }) => {
                Err(self.outside("tilt", tilt_rad, [rad(min_mdeg), rad(max_mdeg)]))
            }
            Reply::Refused(Fault::NoHello | Fault::NotHomed) => Err(self.restarted()),
            Reply::Refused(Fault::Busy) => {
                Err(self.error("the rig is still moving", "wait until it stands still, then start again"))
            }
            reply => Err(confused(&self.name, &reply)),
        }
    }

    fn describe(&self) -> String {
        let [[pan_min, pan_max], [tilt_min, tilt_max]] =
            [self.limits.pan_rad, self.limits.tilt_rad].map(|range| range.map(f64::to_degrees));
        format!(
            "{} on {} (protocol {VERSION}): pan {pan_min:.1}° to {pan_max:.1}°, tilt {tilt_min:.1}° to {tilt_max:.1}°, \
             {:.0}°/s",
            self.board,
            self.name,
            self.limits.speed_rad_s.to_degrees()
        )
    }
}

fn limits(said: &Limits) -> RigLimits {
    RigLimits {
        pan_rad: [rad(said.pan_min_mdeg), rad(said.pan_max_mdeg)],
        tilt_rad: [rad(said.tilt_min_mdeg), rad(said.tilt_max_mdeg)],
        speed_rad_s: f64::from(said.speed_mdeg_s) * RAD_PER_MDEG,
        acceleration_rad_s2: f64::from(said.acceleration_mdeg_s2) * RAD_PER_MDEG,
        settle_s: f64::from(said.settle_ms) / 1000.0,
    }
}

pub(super) fn confused(name: &str, reply: &Reply) -> Error {
    Error::Device {
        device: name.into(),
        what: format!("the rig answered something else than was asked: {reply:?}"),
        remedy: "report this as a defect of its firmware".into(),
    }
}

/// A number that no other host has: taken from the clock.
fn conversation() -> u32 {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    (now.as_micros() as u32) ^ std::process::id().rotate_left(16)
}

const RAD_PER_MDEG: f64 = std::f64::consts::PI / 180_000.0;

fn rad(mdeg: i32) -> f64 {
    f64::from(mdeg) * RAD_PER_MDEG
}

fn degrees(mdeg: i32) -> f64 {
    f64::from(mdeg) / 1000.0
}

/// The nearest thousandth of a degree; `None` for what is no angle or does not fit.
fn mdeg(angle_rad: f64) -> Option<i32> {
    let mdeg = (angle_rad / RAD_PER_MDEG).round();
    (mdeg.abs() < f64::from(i32::MAX)).then_some(mdeg as i32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_round_to_the_nearest_thousandth_of_a_degree_and_nothing_wraps() {
        assert_eq!(mdeg(std::f64::consts::PI), Some(180_000));
        assert_eq!(mdeg(-1.4 * RAD_PER_MDEG), Some(-1));
        assert_eq!(mdeg(rad(-123_457)), Some(-123_457));
        for no_angle in [f64::NAN, f64::INFINITY, 1e9] {
            assert_eq!(mdeg(no_angle), None);
        }
    }

    #[test]
    fn a_port_that_is_not_there_is_named() {
        let error = SerialRig::open("/dev/no-such-port").err().unwrap().to_string();
        assert!(error.starts_with("/dev/no-such-port: cannot open the port"), "{error}");
    }
}

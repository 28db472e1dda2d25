//! The conversation with a rig: hello, homing, moves, and what is done when the rig has restarted meanwhile.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::time::{Duration, Instant};

use rigel_protocol::{Command, Fault, Halt, Hello, Limits, Reply, Restart, State, Status, Tracking, VERSION};

use super::link::Link;
use super::place::{Place, Timing};
use super::serial::SerialPlace;
use super::tracking::Pinger;
use super::trigger::TriggerLine;
use super::{ROUNDING_RAD, Reached, Rig, RigLimits, RigStatus, degrees, mdeg, rad};
use crate::{Error, Result};

/// How much later than announced a move may end.
const PATIENCE: Duration = Duration::from_secs(3);
/// How long a rig that is told to stop may take to be asked again.
const STANDING: Duration = Duration::from_millis(50);
/// How often a move is begun when the rig restarts in it; a rig whose power fails at every move is an error.
const ATTEMPTS: u32 = 3;

/// The rig on a serial port.
///
/// It survives its cable. When the line ends, the port is looked for, under another name too, and what was asked is asked
/// again. A rig that went on meanwhile is only asked where it is. A rig that has restarted, or has stopped because the host
/// was silent for too long, does not know where it is: it is homed again and the move repeated. Every such thing is told to
/// [`SerialRig::on_notice`] and kept for [`Rig::take_notices`].
pub struct SerialRig {
    pub(super) link: Link,
    board: String,
    said: Limits,
    homed: bool,
    pub(super) tracking: Option<Tracking>,
    pub(super) pinger: Option<Pinger>,
}

/// No rig has coarser steps than this; it goes to the step nearest to an angle, and says where that is.
const LARGEST_STEP_MDEG: u32 = 100;

/// Stops a rig that somebody else moves.
pub struct StopLine(Link);

impl StopLine {
    /// Tells the rig to stop whatever it does; whoever waits for its move hears that it stopped.
    ///
    /// # Errors
    /// [`Error::Device`] when the rig does not answer.
    pub fn stop(&self) -> Result<()> {
        match self.0.ask(&Command::Stop)?.reply {
            // A rig that has restarted stands.
            Reply::Accepted { .. } | Reply::Refused(Fault::NoHello) => Ok(()),
            reply => Err(self.0.confused(&reply)),
        }
    }
}

/// How a motion ended.
enum End {
    At([i32; 2]),
    Stopped([i32; 2]),
    Halted(Halt),
    Restarted,
}

impl SerialRig {
    /// Opens a port (`/dev/ttyACM0`, `COM3`), says hello and homes the rig; returns when it stands at pan 0, tilt 0.
    ///
    /// # Errors
    /// Those of [`SerialRig::greet`] and [`SerialRig::home`].
    pub fn open(port_name: &str) -> Result<Self> {
        let mut rig = Self::greet(port_name)?;
        rig.home()?;
        Ok(rig)
    }

    /// Opens a port and says hello; nothing moves. The first move homes the rig.
    ///
    /// # Errors
    /// [`Error::Device`], naming the port: when it cannot be opened, when nothing there answers within two seconds (and
    /// whether anything is heard there at all), when the firmware speaks another version or schema (both are named).
    pub fn greet(port_name: &str) -> Result<Self> {
        Self::greet_at(Box::new(SerialPlace::new(port_name)), Timing::default())
    }

    /// Opens any place and says hello; nothing moves.
    ///
    /// # Errors
    /// Those of [`SerialRig::greet`].
    pub fn greet_at(place: Box<dyn Place>, timing: Timing) -> Result<Self> {
        let link = Link::open(place, timing)?;
        let hello = hello(&link)?;
        if hello.limits.speed_mdeg_s == 0 || hello.limits.acceleration_mdeg_s2 == 0 {
            let what = format!("the rig says that it cannot move: {:?}", hello.limits);
            return Err(link.error(what, "correct the limits in its firmware"));
        }
        if hello.restart != Restart::Power {
            link.notices().tell(format!("{}: the rig had restarted: {}", link.name(), why(hello.restart)));
        }
        let board = hello.board.as_str().into();
        Ok(Self { link, board, said: hello.limits, homed: false, tracking: None, pinger: None })
    }

    /// From now on `listener` hears at once what people should know: a cable that is out, a rig that has restarted, what the
    /// firmware logs. It may be called from another thread.
    pub fn on_notice(&mut self, listener: impl Fn(&str) + Send + Sync + 'static) {
        self.link.notices().listen(Box::new(listener));
    }

    /// The camera's contact: a handle that other threads may have.
    pub fn trigger_line(&self) -> TriggerLine {
        TriggerLine::new(self.link.clone())
    }

    /// What stops the rig: a handle that other threads may have.
    pub fn stop_line(&self) -> StopLine {
        StopLine(self.link.clone())
    }

    /// Where the rig is and what has happened; nothing moves.
    ///
    /// # Errors
    /// [`Error::Device`] when the rig does not answer.
    pub fn status(&mut self) -> Result<RigStatus> {
        for _ in 0..ATTEMPTS {
            if let Some(status) = self.ask_status()? {
                return Ok(RigStatus::new(&status));
            }
            self.greet_again()?;
        }
        Err(self.restarts())
    }

    /// Stops whatever moves, finds the switches and goes to pan 0, tilt 0.
    ///
    /// # Errors
    /// [`Error::Device`] when the rig does not answer or says that it cannot home, and why.
    pub fn home(&mut self) -> Result<()> {
        self.homed = false;
        for _ in 0..ATTEMPTS {
            // A host that went away may have left the rig moving.
            if !self.stand()? {
                self.greet_again()?;
                continue;
            }
            let asked = self.link.ask(&Command::Home)?;
            let duration_ms = match asked.reply {
                Reply::Accepted { duration_ms } => duration_ms,
                Reply::Refused(Fault::NoHello) => {
                    self.greet_again()?;
                    continue;
                }
                Reply::Refused(fault) => {
                    let what = format!("the rig refuses to home: {fault:?}");
                    return Err(self.link.error(what, "switch it off and on again"));
                }
                reply => return Err(self.link.confused(&reply)),
            };
            match self.wait(asked.sequence, duration_ms)? {
                End::At(at) if is_there([0, 0], at) => {
                    self.tell_lost_steps()?;
                    self.homed = true;
                    return Ok(());
                }
                End::At(at) | End::Stopped(at) => return Err(self.stopped([0, 0], at)),
                End::Halted(halt) => self.survive(halt)?,
                End::Restarted => self.greet_again()?,
            }
        }
        Err(self.restarts())
    }

    /// Stops the rig and waits until it stands; false when it has restarted.
    fn stand(&mut self) -> Result<bool> {
        let duration_ms = match self.link.ask(&Command::Stop)?.reply {
            Reply::Accepted { duration_ms } => duration_ms,
            Reply::Refused(Fault::NoHello) => return Ok(false),
            reply => return Err(self.link.confused(&reply)),
        };
        // The dead-man is part of every motion from here on.
        let silence_ms = self.link.timing().dead_man.as_millis() as u32;
        match self.link.ask(&Command::DeadMan { silence_ms })?.reply {
            Reply::Accepted { .. } => {}
            Reply::Refused(Fault::NoHello) => return Ok(false),
            reply => return Err(self.link.confused(&reply)),
        }
        let deadline = Instant::now() + Duration::from_millis(duration_ms.into()) + PATIENCE;
        loop {
            match self.ask_status()? {
                None => return Ok(false),
                Some(Status { state: State::Still | State::Lost, .. }) => return Ok(true),
                Some(status) if Instant::now() >= deadline => {
                    let what = format!("the rig was told to stop and is still {:?}", status.state);
                    return Err(self.link.error(what, "switch it off and look at it"));
                }
                Some(_) => std::thread::sleep(STANDING),
            }
        }
    }

    /// Waits until a motion has ended, whether or not its event comes.
    fn wait(&mut self, sequence: u16, duration_ms: u32) -> Result<End> {
        let deadline = Instant::now() + Duration::from_millis(duration_ms.into()) + PATIENCE;
        let silence = self.link.timing().silence();
        let mut asked = Instant::now();
        loop {
            let left = silence.saturating_sub(asked.elapsed());
            match self.link.ear().event(sequence, left) {
                Some(Reply::Arrived { pan_mdeg, tilt_mdeg }) => return Ok(End::At([pan_mdeg, tilt_mdeg])),
                Some(Reply::Stopped { pan_mdeg, tilt_mdeg }) => {
                    return Ok(End::Stopped([pan_mdeg, tilt_mdeg]));
                }
                Some(Reply::Halted { halt, .. }) => return Ok(End::Halted(halt)),
                _ => {}
            }
            asked = Instant::now();
            let Some(status) = self.ask_status()? else { return Ok(End::Restarted) };
            let at = [status.pan_mdeg, status.tilt_mdeg];
            match (status.state, status.halt) {
                (State::Still, _) => return Ok(End::At(at)),
                (State::Lost, Some(halt)) => return Ok(End::Halted(halt)),
                (State::Lost, None) => return Ok(End::Stopped(at)),
                _ if Instant::now() < deadline => {}
                _ => {
                    // Nothing is known about what holds it up: better that it stands still.
                    let _ = self.link.ask(&Command::Stop);
                    return Err(self.link.error(
                        format!(
                            "the rig did not arrive within {:.1} s and is at {}",
                            f64::from(duration_ms) / 1000.0 + PATIENCE.as_secs_f64(),
                            place(at)
                        ),
                        "see what blocks it, then start again",
                    ));
                }
            }
        }
    }

    /// The rig's status; `None` when it has restarted.
    fn ask_status(&self) -> Result<Option<Status>> {
        match self.link.ask(&Command::Status)?.reply {
            Reply::Status(status) => Ok(Some(status)),
            Reply::Refused(Fault::NoHello) => Ok(None),
            reply => Err(self.link.confused(&reply)),
        }
    }

    /// Opens a new conversation with a rig that has restarted; it is lost, and its tracker is off.
    pub(super) fn greet_again(&mut self) -> Result<()> {
        self.homed = false;
        let hello = hello(&self.link)?;
        if hello.board.as_str() != self.board || hello.limits != self.said {
            return Err(self.link.error(
                format!("another rig is plugged in now: {}, not {}", hello.board, self.board),
                "plug the first one in and start again",
            ));
        }
        self.link.notices().tell(format!(
            "{}: the rig has restarted ({}) and does not know where it is: it is homed before it moves again",
            self.link.name(),
            why(hello.restart)
        ));
        self.track_again()
    }

    /// What a halt means for the work: a silent host is over, everything else needs a person.
    fn survive(&mut self, halt: Halt) -> Result<()> {
        self.homed = false;
        let axis = |axis: rigel_protocol::Axis| format!("{axis:?}").to_lowercase();
        let (what, remedy) = match halt {
            Halt::SilentHost => {
                self.link.notices().tell(format!(
                    "{}: the rig has stopped because it heard nothing for {} s: it is homed before it moves again",
                    self.link.name(),
                    self.link.timing().dead_man.as_secs_f64()
                ));
                return Ok(());
            }
            Halt::Switch(a) => {
                (format!("the {}'s limit switch closed in a move", axis(a)), "see what it has run into")
            }
            Halt::NoSwitch(a) => (
                format!("homing did not find the {}'s switch", axis(a)),
                "check the motor and the switch's wires",
            ),
            Halt::StuckSwitch(a) => {
                (format!("the {}'s switch does not open", axis(a)), "check the switch and its wires")
            }
            Halt::TooLong => ("a move took longer than it can take".into(), "see what blocks the rig"),
        };
        Err(self.link.error(format!("the rig has stopped: {what}"), &format!("{remedy}, then start again")))
    }

    fn tell_lost_steps(&self) -> Result<()> {
        if let Some(Status { lost_steps: [pan, tilt], .. }) = self.ask_status()?
            && [pan, tilt] != [0, 0]
        {
            self.link.notices().tell(format!(
                "{}: homing found the pan off by {pan} steps and the tilt by {tilt}: views since the last homing may be off",
                self.link.name()
            ));
        }
        Ok(())
    }

    fn stopped(&self, goal: [i32; 2], at: [i32; 2]) -> Error {
        self.link.error(
            format!("the rig stopped at {} instead of {}", place(at), place(goal)),
            "see what stopped it, then start again",
        )
    }

    fn restarts(&self) -> Error {
        self.link.error(
            format!("the rig was lost {ATTEMPTS} times within one move"),
            "check its power supply and its cable, then start again",
        )
    }

    fn outside(&self, axis: &str, asked_rad: f64, [low_rad, high_rad]: [f64; 2]) -> Error {
        self.link.error(
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
        RigLimits::new(&self.said)
    }

    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached> {
        // Only what fits the words is said; the rig itself looks at its limits again.
        let limits = self.limits();
        let pan_mdeg = mdeg(pan_rad).ok_or_else(|| self.outside("pan", pan_rad, limits.pan_rad))?;
        let tilt_mdeg = mdeg(tilt_rad).ok_or_else(|| self.outside("tilt", tilt_rad, limits.tilt_rad))?;
        // Before it is homed: what cannot be reached moves nothing.
        for (axis, asked_rad, [low_rad, high_rad]) in
            [("pan", pan_rad, limits.pan_rad), ("tilt", tilt_rad, limits.tilt_rad)]
        {
            if !(low_rad - ROUNDING_RAD..=high_rad + ROUNDING_RAD).contains(&asked_rad) {
                return Err(self.outside(axis, asked_rad, [low_rad, high_rad]));
            }
        }
        let goal = [pan_mdeg, tilt_mdeg];
        for _ in 0..ATTEMPTS {
            if !self.homed {
                self.home()?;
            }
            let asked = self.link.ask(&Command::MoveTo { pan_mdeg, tilt_mdeg })?;
            let duration_ms = match asked.reply {
                Reply::Accepted { duration_ms } => duration_ms,
                Reply::Refused(Fault::NoHello) => {
                    self.greet_again()?;
                    continue;
                }
                // Halted while nobody waited for it.
                Reply::Refused(Fault::NotHomed) => {
                    self.homed = false;
                    continue;
                }
                Reply::Refused(fault) => return Err(self.refused(fault, pan_rad, tilt_rad)),
                reply => return Err(self.link.confused(&reply)),
            };
            match self.wait(asked.sequence, duration_ms)? {
                End::At(at) if is_there(goal, at) => {
                    let settle_s = limits.settle_s;
                    return Ok(Reached { pan_rad: rad(at[0]), tilt_rad: rad(at[1]), settle_s });
                }
                End::At(at) | End::Stopped(at) => return Err(self.stopped(goal, at)),
                End::Halted(halt) => self.survive(halt)?,
                End::Restarted => self.greet_again()?,
            }
        }
        Err(self.restarts())
    }

    fn is_there(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<bool> {
        let Some(status) = self.ask_status()? else {
            self.greet_again()?;
            return Ok(false);
        };
        let at = [status.pan_mdeg, status.tilt_mdeg];
        let goal = [mdeg(pan_rad), mdeg(tilt_rad)];
        let is_near = goal[0].zip(goal[1]).is_some_and(|(pan, tilt)| is_there([pan, tilt], at));
        // Another thread's hello can have been heard by a rig that had restarted: then it is lost.
        if self.homed && status.state == State::Still && is_near {
            return Ok(true);
        }
        self.homed = false;
        self.link.notices().tell(format!(
            "{}: the rig is {:?} at {} although nobody moved it: it is homed before it moves again",
            self.link.name(),
            status.state,
            place(at)
        ));
        Ok(false)
    }

    fn describe(&self) -> String {
        let limits = self.limits();
        let [[pan_min, pan_max], [tilt_min, tilt_max]] =
            [limits.pan_rad, limits.tilt_rad].map(|range| range.map(f64::to_degrees));
        format!(
            "{} on {} (protocol {VERSION}): pan {pan_min:.1}° to {pan_max:.1}°, tilt {tilt_min:.1}° to {tilt_max:.1}°, \
             {:.0}°/s",
            self.board,
            self.link.name(),
            limits.speed_rad_s.to_degrees()
        )
    }

    fn take_notices(&mut self) -> Vec<String> {
        self.link.notices().take()
    }
}

impl SerialRig {
    fn refused(&self, fault: Fault, pan_rad: f64, tilt_rad: f64) -> Error {
        match fault {
            Fault::PanOutside { min_mdeg, max_mdeg, .. } => {
                self.outside("pan", pan_rad, [rad(min_mdeg), rad(max_mdeg)])
            }
            Fault::TiltOutside { min_mdeg, max_mdeg, .. } => {
                self.outside("tilt", tilt_rad, [rad(min_mdeg), rad(max_mdeg)])
            }
            Fault::Winding { limit_mdeg, .. } => self.link.error(
                format!(
                    "a pan of {:.3}° winds the cables further than the {:.3}° that they bear",
                    pan_rad.to_degrees(),
                    degrees(limit_mdeg)
                ),
                "choose a view that the rig can reach",
            ),
            Fault::Busy => self.link.error("the rig is busy", "wait until it stands still, then start again"),
            fault => self
                .link
                .error(format!("the rig refuses to move: {fault:?}"), "report this as a defect of Rigel"),
        }
    }
}

/// Says hello in a conversation of its own.
fn hello(link: &Link) -> Result<Hello> {
    // A hasher's keys are the only randomness in the standard library; the clock would repeat after a restart.
    let conversation = RandomState::new().build_hasher().finish() as u32;
    // A hello of another version or schema never gets here: the link refuses it.
    match link.hello(conversation)? {
        Reply::Hello(hello) => Ok(hello),
        reply => Err(link.confused(&reply)),
    }
}

fn why(restart: Restart) -> &'static str {
    match restart {
        Restart::Power => "it was switched on or reset",
        Restart::Watchdog => "its program hung and the watchdog ended it",
        Restart::Panic => "its program panicked",
    }
}

/// Whether the rig stands on the step nearest to its goal.
fn is_there(goal: [i32; 2], at: [i32; 2]) -> bool {
    (0..2).all(|axis| goal[axis].abs_diff(at[axis]) <= LARGEST_STEP_MDEG / 2)
}

fn place([pan_mdeg, tilt_mdeg]: [i32; 2]) -> String {
    format!("pan {}°, tilt {}°", degrees(pan_mdeg), degrees(tilt_mdeg))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_is_not_there_is_named() {
        let error = SerialRig::open("/dev/no-such-port").err().unwrap().to_string();
        assert!(error.starts_with("/dev/no-such-port: cannot open the port"), "{error}");
    }
}

//! The state machine of commands: one activity at a time, in one enum.

use rigel_protocol::{
    Answer, Axis, Bracket, Command, Fault, Halt, Hello, Limits, Reply, Request, Restart, SCHEMA, State,
    Status, VERSION,
};

use crate::conversation::{Conversation, Verdict};
use crate::drive::{Drive, Progress};
use crate::homing::{Homing, Outcome};
use crate::mechanics::{AXES, Mechanics};
use crate::pins::Pins;
use crate::trigger::{Event, Trigger};

/// What a move may take longer than planned: an eighth, and half a second.
const MARGIN_US: u64 = 500_000;

/// The rig's mind: hears requests, moves the motors, photographs, tells what has ended.
///
/// Times are microseconds of a clock that never turns back. A board hands every request to [`Self::handle`], and calls
/// [`Self::advance`] at the time of [`Self::next_us`] and as often as that lies in the past.
pub struct Controller {
    board: &'static str,
    restart: Restart,
    mechanics: Mechanics,
    conversation: Conversation,
    drive: Drive,
    activity: Activity,
    /// The request that began the activity; 0 when an earlier conversation did.
    sequence: u16,
    /// Whether the position can be trusted.
    homed: bool,
    /// Whether the position counts from switches that were once found: a new homing tells the lost steps.
    counted: bool,
    /// When the move is over at the latest.
    deadline_us: u64,
    /// How long the host may be silent; 0 for ever.
    silence_us: u64,
    heard_us: u64,
    halt: Option<Halt>,
    lost_steps: [i32; 2],
    /// Photographs of the last bracket, and how many of them were confirmed.
    taken: (u8, u8),
    bad_frames: u32,
}

/// What the rig does.
enum Activity {
    Idle,
    Homing(Homing),
    Moving { target: [i32; 2] },
    Braking { halt: Option<Halt> },
    Settling { until_us: u64, stopped: bool },
    Exposing(Trigger),
}

/// What becomes of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Handled {
    /// This is to be said.
    Answer(Answer),
    /// The request is `Track` or `Tracker`, and whoever owns the tracker is to obey it: the reply goes through
    /// [`Controller::remember`].
    Tracker,
}

impl Controller {
    /// A rig that was just switched on. `None` when there can be no such rig: its limits must include 0 on both axes,
    /// stay within two turns, with a speed of 1 to 1 000 000 mdeg/s, an acceleration of 1 to 5 000 000 mdeg/s², between
    /// 1 and 100 000 steps per second at every speed; the switches must lie beyond the limits and be found within the
    /// longest way; backing off must be longer than braking from the search; a board's name has at most 24 bytes.
    pub const fn new(board: &'static str, mechanics: Mechanics, restart: Restart) -> Option<Self> {
        if !mechanics.is_possible() || board.len() > 24 {
            return None;
        }
        Some(Self {
            board,
            restart,
            mechanics,
            conversation: Conversation::new(),
            drive: Drive::new(),
            activity: Activity::Idle,
            sequence: 0,
            homed: false,
            counted: false,
            deadline_us: 0,
            silence_us: 0,
            heard_us: 0,
            halt: None,
            lost_steps: [0; 2],
            taken: (0, 0),
            bad_frames: 0,
        })
    }

    /// Obeys, refuses or answers again: every request is executed once.
    pub fn handle(&mut self, request: &Request, now_us: u64, pins: &mut impl Pins) -> Handled {
        let sequence = request.sequence;
        if let Command::Hello { version, schema, conversation } = request.command {
            if self.conversation.hello(sequence, version, schema, conversation) {
                // What an earlier conversation began goes on; its end is no answer to a request of this one.
                (self.sequence, self.silence_us) = (0, 0);
            }
            return Handled::Answer(Answer { sequence, reply: self.hello() });
        }
        self.heard_us = now_us;
        let reply = match self.conversation.judge(request) {
            Verdict::Unknown => Reply::Refused(Fault::NoHello),
            Verdict::Stale => Reply::Refused(Fault::Stale),
            Verdict::Again(Some(reply)) => reply,
            Verdict::New | Verdict::Again(None) if is_for_tracker(&request.command) => {
                return Handled::Tracker;
            }
            Verdict::Again(None) => Reply::Refused(Fault::Stale),
            Verdict::New => match request.command {
                Command::Ping => Reply::Pong { at_us: now_us },
                Command::Status => self.status(),
                _ => {
                    let reply = self.obey(request, now_us, pins).unwrap_or_else(Reply::Refused);
                    self.conversation.remember(&reply);
                    reply
                }
            },
        };
        Handled::Answer(Answer { sequence, reply })
    }

    /// The answer to the request that was [`Handled::Tracker`]; when the request is repeated, this is said again.
    pub fn remember(&mut self, reply: Reply) -> Answer {
        Answer { sequence: self.conversation.remember(&reply), reply }
    }

    /// When there is something to do; `None` when nothing happens until a request comes.
    pub fn next_us(&self) -> Option<u64> {
        match &self.activity {
            Activity::Idle => None,
            Activity::Homing(_) | Activity::Moving { .. } => {
                Some(self.silent_us().map_or(self.drive.due_us, |us| us.min(self.drive.due_us)))
            }
            Activity::Braking { .. } => Some(self.drive.due_us),
            Activity::Settling { until_us, .. } => Some(*until_us),
            Activity::Exposing(trigger) => Some(trigger.due_us),
        }
    }

    /// Does one thing that is due, if anything is, and tells what there is to tell.
    pub fn advance(&mut self, now_us: u64, pins: &mut impl Pins) -> Option<Answer> {
        match &mut self.activity {
            Activity::Idle => None,
            Activity::Homing(_) | Activity::Moving { .. } | Activity::Braking { .. } => {
                self.run(now_us, pins)
            }
            Activity::Settling { until_us, stopped } => {
                if now_us < *until_us {
                    return None;
                }
                let stopped = *stopped;
                let [pan_mdeg, tilt_mdeg] = self.position_mdeg();
                Some(self.end(if stopped {
                    Reply::Stopped { pan_mdeg, tilt_mdeg }
                } else {
                    Reply::Arrived { pan_mdeg, tilt_mdeg }
                }))
            }
            Activity::Exposing(trigger) => {
                let event = trigger.advance(now_us, pins)?;
                self.taken = trigger.taken();
                let [pan_mdeg, tilt_mdeg] = self.position_mdeg();
                Some(match event {
                    Event::Exposed { index, at_us, confirmed } => {
                        let reply = Reply::Exposed { index, at_us, confirmed };
                        Answer { sequence: self.sequence, reply }
                    }
                    Event::Triggered { exposed, confirmed } => {
                        self.end(Reply::Triggered { exposed, confirmed })
                    }
                    Event::Stopped => self.end(Reply::Stopped { pan_mdeg, tilt_mdeg }),
                })
            }
        }
    }

    /// What the rig is doing.
    pub fn state(&self) -> State {
        match &self.activity {
            Activity::Idle if self.homed => State::Still,
            Activity::Idle => State::Lost,
            Activity::Homing(_) => State::Homing,
            Activity::Moving { .. } => State::Moving,
            Activity::Braking { .. } => State::Braking,
            Activity::Settling { .. } => State::Settling,
            Activity::Exposing(_) => State::Exposing,
        }
    }

    /// Where pan and tilt are, steps.
    pub fn steps(&self) -> [i64; 2] {
        self.drive.position.map(i64::from)
    }

    /// Where pan and tilt are, to the nearest thousandth of a degree.
    pub fn position_mdeg(&self) -> [i32; 2] {
        AXES.map(|axis| self.mechanics.mdeg(axis, self.drive.position[axis as usize]))
    }

    /// Counts a damaged or unknown frame.
    pub fn bad_frame(&mut self) {
        self.bad_frames = self.bad_frames.saturating_add(1);
    }

    fn obey(&mut self, request: &Request, now_us: u64, pins: &mut impl Pins) -> Result<Reply, Fault> {
        let begins = matches!(request.command, Command::Home | Command::MoveTo { .. } | Command::Trigger(_));
        if begins && !matches!(self.activity, Activity::Idle) {
            return Err(Fault::Busy);
        }
        let duration_us = match &request.command {
            Command::Stop => self.stop(now_us, pins),
            Command::DeadMan { silence_ms } => {
                self.silence_us = u64::from(*silence_ms) * 1_000;
                0
            }
            Command::Home => self.home(now_us, pins),
            Command::MoveTo { pan_mdeg, tilt_mdeg } => self.move_to(*pan_mdeg, *tilt_mdeg, now_us, pins)?,
            Command::Trigger(bracket) => self.trigger(bracket, now_us, pins)?,
            _ => return Err(Fault::Senseless),
        };
        if begins {
            self.sequence = request.sequence;
        }
        let duration_ms = u32::try_from(duration_us.div_ceil(1_000)).unwrap_or(u32::MAX);
        Ok(Reply::Accepted { duration_ms })
    }

    fn home(&mut self, now_us: u64, pins: &mut impl Pins) -> u64 {
        if !self.counted {
            self.drive.position = [0; 2];
        }
        (self.homed, self.halt) = (false, None);
        let duration_us = Homing::longest_us(&self.mechanics);
        self.set_deadline(duration_us, now_us);
        self.activity = Activity::Homing(Homing::start(&mut self.drive, &self.mechanics, now_us, pins));
        duration_us + self.settle_us()
    }

    fn move_to(
        &mut self,
        pan_mdeg: i32,
        tilt_mdeg: i32,
        now_us: u64,
        pins: &mut impl Pins,
    ) -> Result<u64, Fault> {
        if !self.homed {
            return Err(Fault::NotHomed);
        }
        self.within_limits(pan_mdeg, tilt_mdeg)?;
        self.halt = None;
        let target = [self.mechanics.step(Axis::Pan, pan_mdeg), self.mechanics.step(Axis::Tilt, tilt_mdeg)];
        Ok(self.travel(target, now_us, pins) + self.settle_us())
    }

    fn travel(&mut self, target: [i32; 2], now_us: u64, pins: &mut impl Pins) -> u64 {
        let duration_us = self.drive.travel_us(target, &self.mechanics);
        self.set_deadline(duration_us, now_us);
        if !self.drive.start_leg(target, &self.mechanics, now_us, pins) {
            self.drive.rest(now_us);
        }
        self.activity = Activity::Moving { target };
        duration_us
    }

    fn trigger(&mut self, bracket: &Bracket, now_us: u64, pins: &mut impl Pins) -> Result<u64, Fault> {
        let trigger = Trigger::start(bracket, now_us, pins).ok_or(Fault::Senseless)?;
        self.taken = (0, 0);
        let duration_us = trigger.longest_us();
        self.activity = Activity::Exposing(trigger);
        Ok(duration_us)
    }

    fn stop(&mut self, now_us: u64, pins: &mut impl Pins) -> u64 {
        match &mut self.activity {
            Activity::Idle => 0,
            Activity::Homing(_) | Activity::Moving { .. } => {
                self.brake(None, now_us);
                self.drive.left_us(now_us) + self.settle_us()
            }
            Activity::Braking { .. } => self.drive.left_us(now_us) + self.settle_us(),
            Activity::Settling { until_us, .. } => until_us.saturating_sub(now_us),
            Activity::Exposing(trigger) => {
                trigger.stop(now_us, pins);
                0
            }
        }
    }

    /// A position beyond a limit is an error: a rig that went elsewhere instead would spoil the photograph silently.
    fn within_limits(&self, pan_mdeg: i32, tilt_mdeg: i32) -> Result<(), Fault> {
        let Limits { pan_min_mdeg, pan_max_mdeg, winding_mdeg, tilt_min_mdeg, tilt_max_mdeg, .. } =
            self.mechanics.limits;
        if !(pan_min_mdeg..=pan_max_mdeg).contains(&pan_mdeg) {
            let (min_mdeg, max_mdeg) = (pan_min_mdeg, pan_max_mdeg);
            return Err(Fault::PanOutside { asked_mdeg: pan_mdeg, min_mdeg, max_mdeg });
        }
        if !(-winding_mdeg..=winding_mdeg).contains(&pan_mdeg) {
            return Err(Fault::Winding { asked_mdeg: pan_mdeg, limit_mdeg: winding_mdeg });
        }
        if !(tilt_min_mdeg..=tilt_max_mdeg).contains(&tilt_mdeg) {
            let (min_mdeg, max_mdeg) = (tilt_min_mdeg, tilt_max_mdeg);
            return Err(Fault::TiltOutside { asked_mdeg: tilt_mdeg, min_mdeg, max_mdeg });
        }
        Ok(())
    }

    /// Goes on with whatever moves the motors.
    fn run(&mut self, now_us: u64, pins: &mut impl Pins) -> Option<Answer> {
        let braking = matches!(self.activity, Activity::Braking { .. });
        if !braking && self.silent_us().is_some_and(|us| now_us >= us) {
            self.brake(Some(Halt::SilentHost), now_us);
            return None;
        }
        if now_us > self.deadline_us {
            if braking {
                return Some(self.halted(Halt::TooLong, now_us));
            }
            self.brake(Some(Halt::TooLong), now_us);
            return None;
        }
        match self.drive.advance(now_us, pins) {
            Progress::Waiting => None,
            Progress::Stepped => self.stepped(now_us),
            Progress::Ended => self.ended(now_us, pins),
        }
    }

    fn stepped(&mut self, now_us: u64) -> Option<Answer> {
        if let Activity::Homing(homing) = &mut self.activity {
            homing.stepped(&mut self.drive, &self.mechanics);
            return None;
        }
        // Whoever brakes out of homing may still stand on a switch.
        let pressed = AXES.into_iter().find(|&axis| self.homed && self.drive.is_pressed(axis))?;
        Some(self.halted(Halt::Switch(pressed), now_us))
    }

    fn ended(&mut self, now_us: u64, pins: &mut impl Pins) -> Option<Answer> {
        match &mut self.activity {
            Activity::Homing(homing) => match homing.ended(&mut self.drive, &self.mechanics, now_us, pins) {
                Outcome::GoesOn => None,
                Outcome::Halt(halt) => {
                    self.counted = false;
                    Some(self.halted(halt, now_us))
                }
                Outcome::Found => {
                    self.lost_steps = if self.counted { homing.off_steps } else { [0; 2] };
                    (self.homed, self.counted) = (true, true);
                    self.travel([0, 0], now_us, pins);
                    None
                }
            },
            Activity::Moving { target } => {
                if !self.drive.start_leg(*target, &self.mechanics, now_us, pins) {
                    self.settle(false, now_us);
                }
                None
            }
            Activity::Braking { halt: Some(halt) } => {
                let halt = *halt;
                Some(self.halted(halt, now_us))
            }
            Activity::Braking { halt: None } => {
                self.settle(true, now_us);
                None
            }
            Activity::Idle | Activity::Settling { .. } | Activity::Exposing(_) => None,
        }
    }

    fn brake(&mut self, halt: Option<Halt>, now_us: u64) {
        self.drive.brake();
        self.set_deadline(self.drive.left_us(now_us), now_us);
        self.activity = Activity::Braking { halt };
    }

    fn settle(&mut self, stopped: bool, now_us: u64) {
        self.activity = Activity::Settling { until_us: now_us.saturating_add(self.settle_us()), stopped };
    }

    /// The rig has stopped by itself, and its position is no longer trusted.
    fn halted(&mut self, halt: Halt, now_us: u64) -> Answer {
        self.drive.rest(now_us);
        (self.homed, self.halt) = (false, Some(halt));
        let [pan_mdeg, tilt_mdeg] = self.position_mdeg();
        self.end(Reply::Halted { halt, pan_mdeg, tilt_mdeg })
    }

    fn end(&mut self, reply: Reply) -> Answer {
        self.activity = Activity::Idle;
        Answer { sequence: self.sequence, reply }
    }

    fn set_deadline(&mut self, duration_us: u64, now_us: u64) {
        self.deadline_us = now_us.saturating_add(duration_us + duration_us / 8 + MARGIN_US);
    }

    /// When the host has been silent for too long.
    fn silent_us(&self) -> Option<u64> {
        (self.silence_us > 0).then(|| self.heard_us.saturating_add(self.silence_us))
    }

    fn settle_us(&self) -> u64 {
        u64::from(self.mechanics.limits.settle_ms) * 1_000
    }

    fn hello(&self) -> Reply {
        let mut hello = Hello {
            version: VERSION,
            schema: SCHEMA,
            board: Default::default(),
            limits: self.mechanics.limits,
            restart: self.restart,
        };
        // `new` has checked the length, so this cannot fail.
        let _ = hello.board.push_str(self.board);
        Reply::Hello(hello)
    }

    fn status(&self) -> Reply {
        let [pan_mdeg, tilt_mdeg] = self.position_mdeg();
        let (exposed, confirmed) = self.taken;
        Reply::Status(Status {
            state: self.state(),
            pan_mdeg,
            tilt_mdeg,
            halt: self.halt,
            lost_steps: self.lost_steps,
            exposed,
            confirmed,
            bad_frames: self.bad_frames,
        })
    }
}

fn is_for_tracker(command: &Command) -> bool {
    matches!(command, Command::Track(_) | Command::Tracker)
}

#[cfg(test)]
mod tests;

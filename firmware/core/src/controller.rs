//! The state machine of commands: one activity at a time, in one enum.

use rigel_protocol::{
    Answer, Command, Fault, Halt, Hello, Reply, Request, Restart, SCHEMA, State, Status, VERSION,
};

use crate::conversation::{Conversation, Verdict};
use crate::drive::Drive;
use crate::homing::Homing;
use crate::mechanics::{AXES, Mechanics};
use crate::pins::Pins;
use crate::trigger::{Event, Trigger};

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
    Settling { until_us: u64, then: End },
    Exposing(Trigger),
}

/// What a move that has ended is told as, once the rig has settled.
#[derive(Clone, Copy)]
enum End {
    Arrived,
    Stopped,
    Halted(Halt),
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
                self.conversation.pass_to_tracker();
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

    /// The answer to the request that was last [`Handled::Tracker`], whatever was asked since; when that request is
    /// repeated, this is said again. A repetition that comes before the reply is [`Handled::Tracker`] again.
    pub fn remember(&mut self, reply: Reply) -> Answer {
        Answer { sequence: self.conversation.remember_tracker(&reply), reply }
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
                self.run(now_us, pins);
                None
            }
            Activity::Settling { until_us, then } => {
                if now_us < *until_us {
                    return None;
                }
                let then = *then;
                let [pan_mdeg, tilt_mdeg] = self.position_mdeg();
                Some(self.end(match then {
                    End::Arrived => Reply::Arrived { pan_mdeg, tilt_mdeg },
                    End::Stopped => Reply::Stopped { pan_mdeg, tilt_mdeg },
                    End::Halted(halt) => Reply::Halted { halt, pan_mdeg, tilt_mdeg },
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

mod obey;
mod run;
#[cfg(test)]
mod tests;

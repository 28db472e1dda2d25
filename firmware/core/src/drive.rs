//! Both motors: counts every step, knows which way the play lies, feels the switches.

use crate::mechanics::{AXES, Mechanics};
use crate::motion::{Motion, Pace};
use crate::pins::Pins;

/// So many readings in a row must agree before a switch counts as pressed: motors disturb wires.
pub(crate) const READINGS: u8 = 3;

/// Where the motors are and the move that they are in.
pub(crate) struct Drive {
    /// Pan and tilt, steps.
    pub position: [i32; 2],
    /// Steps with increasing angle since the last with decreasing angle: below the backlash, the play is not taken up.
    taken_up: [u32; 2],
    /// Readings in a row that say "pressed".
    pressed: [u8; 2],
    motion: Motion,
    start_us: u64,
    /// When there is something to do.
    pub due_us: u64,
}

/// What an advance has done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    Waiting,
    Stepped,
    /// The motors stand.
    Ended,
}

impl Drive {
    pub const fn new() -> Self {
        Self {
            position: [0; 2],
            taken_up: [0; 2],
            pressed: [0; 2],
            motion: Motion::NONE,
            start_us: 0,
            due_us: 0,
        }
    }

    /// Begins a move by so many steps from standstill.
    pub fn start(&mut self, way: [i32; 2], paces: [Pace; 2], now_us: u64, pins: &mut impl Pins) {
        for (axis, way) in AXES.into_iter().zip(way) {
            if way != 0 {
                pins.set_direction(axis, way > 0);
            }
        }
        self.pressed = [0; 2];
        self.motion = Motion::new(way, paces);
        self.start_us = now_us;
        self.due_us = now_us.saturating_add(self.motion.next_us());
    }

    /// Begins the next leg to a target, or tells that there is none: see [`Mechanics`].
    pub fn start_leg(
        &mut self,
        target: [i32; 2],
        mechanics: &Mechanics,
        now_us: u64,
        pins: &mut impl Pins,
    ) -> bool {
        let Some(way) = self.leg(target, mechanics) else { return false };
        self.start(way, mechanics.paces(mechanics.limits.speed_mdeg_s), now_us, pins);
        true
    }

    /// The way of the next leg to a target.
    fn leg(&self, target: [i32; 2], mechanics: &Mechanics) -> Option<[i32; 2]> {
        let backlash = mechanics.backlash_steps;
        let way = [0, 1].map(|axis| target[axis].wrapping_sub(self.position[axis]));
        let stays = [0, 1].map(|axis| way[axis] == 0 && self.taken_up[axis] >= backlash[axis]);
        let direct = [0, 1].map(|axis| {
            let rise = u32::try_from(way[axis]).unwrap_or(0);
            stays[axis] || way[axis] >= 0 && rise.saturating_add(self.taken_up[axis]) >= backlash[axis]
        });
        if stays == [true; 2] {
            None
        } else if direct == [true; 2] || backlash == [0; 2] {
            Some(way)
        } else {
            // Both go below their target, so that they come up to it together.
            Some([0, 1].map(|axis| if stays[axis] { 0 } else { way[axis] - backlash[axis] as i32 }))
        }
    }

    /// How long all legs to a target take, microseconds.
    pub fn travel_us(&self, target: [i32; 2], mechanics: &Mechanics) -> u64 {
        let Some(way) = self.leg(target, mechanics) else { return 0 };
        let paces = mechanics.paces(mechanics.limits.speed_mdeg_s);
        let rest = [0, 1].map(|axis| target[axis].wrapping_sub(self.position[axis]) - way[axis]);
        Motion::new(way, paces).end_us() + Motion::new(rest, paces).end_us()
    }

    /// How long the move still takes, microseconds.
    pub fn left_us(&self, now_us: u64) -> u64 {
        self.start_us.saturating_add(self.motion.end_us()).saturating_sub(now_us)
    }

    /// Does the step that is due, if one is.
    ///
    /// A late call delays what is left instead of catching up: two edges are never closer than at full speed, and never
    /// more than an eighth closer than planned.
    pub fn advance(&mut self, now_us: u64, pins: &mut impl Pins) -> Progress {
        if now_us < self.due_us {
            return Progress::Waiting;
        }
        if self.motion.is_done() {
            return Progress::Ended;
        }
        let moves = self.motion.direction();
        for axis in AXES {
            let (readings, moves) = (&mut self.pressed[axis as usize], moves[axis as usize] != 0);
            *readings = if moves && pins.is_switch_pressed(axis) { readings.saturating_add(1) } else { 0 };
        }
        let planned_us = self.due_us - self.start_us;
        for (axis, step) in AXES.into_iter().zip(self.motion.step()) {
            if step != 0 {
                pins.step(axis);
                let i = axis as usize;
                self.position[i] = self.position[i].wrapping_add(step);
                self.taken_up[i] = if step > 0 { self.taken_up[i].saturating_add(1) } else { 0 };
            }
        }
        let next_us = self.motion.next_us();
        let gap_us = next_us - planned_us;
        let earliest_us = now_us.saturating_add(self.motion.interval_us().max(gap_us - gap_us / 8));
        self.start_us = self.start_us.max(earliest_us.saturating_sub(next_us));
        self.due_us = self.start_us.saturating_add(next_us);
        Progress::Stepped
    }

    /// Whether the switch of an axis is pressed, as far as the move has felt it.
    pub fn is_pressed(&self, axis: rigel_protocol::Axis) -> bool {
        self.pressed[axis as usize] >= READINGS
    }

    /// Brakes to a standstill within the limits.
    pub fn brake(&mut self) {
        self.motion.brake();
        self.due_us = self.start_us.saturating_add(self.motion.next_us());
    }

    /// Stays where it is: no further step.
    pub fn rest(&mut self, now_us: u64) {
        (self.motion, self.start_us, self.due_us) = (Motion::NONE, now_us, now_us);
    }
}

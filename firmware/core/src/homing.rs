//! Finding the switches, one axis after the other: fast until the switch closes, back off, slowly until it closes
//! again, back off for good. Backing off is a fixed way, at the end of which the switch must be open. Where the two
//! places differ by more than a sixteenth of that way, something else than the switch was felt, and it is searched again.

use rigel_protocol::{Axis, Halt};

use crate::drive::{Drive, READINGS};
use crate::mechanics::{AXES, Mechanics};
use crate::motion::Motion;
use crate::pins::Pins;

/// Homing on its way.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Homing {
    axis: Axis,
    phase: Phase,
    /// Where the switch of this phase closed.
    edge: Option<i32>,
    /// Where it closed in the search.
    found: i32,
    /// Where the switches were found by the old count, less where they should have been.
    pub off_steps: [i32; 2],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Off a switch that is pressed at the start.
    Leave,
    Seek,
    BackOff,
    Approach,
    Depart,
}

/// Whether a phase that has ended was the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    GoesOn,
    Found,
    Halt(Halt),
}

impl Homing {
    /// Begins with the pan.
    pub fn start(drive: &mut Drive, mechanics: &Mechanics, now_us: u64, pins: &mut impl Pins) -> Self {
        let mut homing =
            Self { axis: Axis::Pan, phase: Phase::Seek, edge: None, found: 0, off_steps: [0; 2] };
        homing.begin_axis(Axis::Pan, drive, mechanics, now_us, pins);
        homing
    }

    /// The longest time that it can take, with the move to zero, microseconds.
    pub fn longest_us(mechanics: &Mechanics) -> u64 {
        let phases = [Phase::Leave, Phase::Seek, Phase::BackOff, Phase::Approach, Phase::Depart];
        let search_us = |axis: Axis| -> u64 {
            phases.into_iter().map(|phase| phase.motion(axis, mechanics).end_us()).sum()
        };
        let back = AXES.map(|axis| mechanics.step(axis, mechanics.switch_mdeg[axis as usize]));
        let paces = mechanics.paces(mechanics.limits.speed_mdeg_s);
        let take_up = mechanics.backlash_steps.map(|steps| steps as i32);
        let return_us = Motion::new(back, paces).end_us() + 2 * Motion::new(take_up, paces).end_us();
        search_us(Axis::Pan) + search_us(Axis::Tilt) + return_us
    }

    /// Looks at the switch after a step.
    pub fn stepped(&mut self, drive: &mut Drive, mechanics: &Mechanics) {
        let looks = matches!(self.phase, Phase::Seek | Phase::Approach) && self.edge.is_none();
        if looks && drive.is_pressed(self.axis) {
            // Felt for the first time so many steps ago.
            let since = i32::from(READINGS) * mechanics.side(self.axis);
            self.edge = Some(drive.position[self.axis as usize].wrapping_sub(since));
            drive.brake();
        }
    }

    /// Begins what follows the phase that has ended, with the motors at a standstill.
    pub fn ended(
        &mut self,
        drive: &mut Drive,
        mechanics: &Mechanics,
        now_us: u64,
        pins: &mut impl Pins,
    ) -> Outcome {
        let axis = self.axis;
        let next = match (self.phase, self.edge.take()) {
            (Phase::Leave | Phase::BackOff | Phase::Depart, _) if drive.is_pressed(axis) => {
                return Outcome::Halt(Halt::StuckSwitch(axis));
            }
            (Phase::Seek | Phase::Approach, None) => return Outcome::Halt(Halt::NoSwitch(axis)),
            (Phase::Leave, _) => Phase::Seek,
            (Phase::Seek, Some(edge)) => {
                self.found = edge;
                Phase::BackOff
            }
            (Phase::BackOff, _) => Phase::Approach,
            (Phase::Approach, Some(edge))
                if edge.abs_diff(self.found) > mechanics.step(axis, mechanics.back_off_mdeg) as u32 / 16 =>
            {
                Phase::Leave
            }
            (Phase::Approach, Some(edge)) => {
                let i = axis as usize;
                let off = edge.wrapping_sub(mechanics.step(axis, mechanics.switch_mdeg[i]));
                self.off_steps[i] = off;
                drive.position[i] = drive.position[i].wrapping_sub(off);
                Phase::Depart
            }
            (Phase::Depart, _) => match axis {
                Axis::Pan => {
                    self.begin_axis(Axis::Tilt, drive, mechanics, now_us, pins);
                    return Outcome::GoesOn;
                }
                Axis::Tilt => return Outcome::Found,
            },
        };
        self.begin(next, drive, mechanics, now_us, pins);
        Outcome::GoesOn
    }

    fn begin_axis(
        &mut self,
        axis: Axis,
        drive: &mut Drive,
        mechanics: &Mechanics,
        now_us: u64,
        pins: &mut impl Pins,
    ) {
        self.axis = axis;
        let phase = if pins.is_switch_pressed(axis) { Phase::Leave } else { Phase::Seek };
        self.begin(phase, drive, mechanics, now_us, pins);
    }

    fn begin(
        &mut self,
        phase: Phase,
        drive: &mut Drive,
        mechanics: &Mechanics,
        now_us: u64,
        pins: &mut impl Pins,
    ) {
        self.phase = phase;
        let (way, paces) = phase.way(self.axis, mechanics);
        drive.start(way, paces, now_us, pins);
    }
}

impl Phase {
    /// The farthest that a phase goes, and how fast.
    fn way(self, axis: Axis, mechanics: &Mechanics) -> ([i32; 2], [crate::motion::Pace; 2]) {
        let i = axis as usize;
        let (mdeg, speed_mdeg_s) = match self {
            Self::Seek => (mechanics.longest_way_mdeg[i], mechanics.seek_mdeg_s),
            Self::Approach => (2 * mechanics.back_off_mdeg, mechanics.approach_mdeg_s),
            Self::Leave | Self::BackOff | Self::Depart => (-mechanics.back_off_mdeg, mechanics.seek_mdeg_s),
        };
        let steps = mechanics.step(axis, mdeg) * mechanics.side(axis);
        let way = match axis {
            Axis::Pan => [steps, 0],
            Axis::Tilt => [0, steps],
        };
        (way, mechanics.paces(speed_mdeg_s))
    }

    fn motion(self, axis: Axis, mechanics: &Mechanics) -> Motion {
        let (way, paces) = self.way(axis, mechanics);
        Motion::new(way, paces)
    }
}

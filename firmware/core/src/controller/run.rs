//! How what moves goes on and ends.

use rigel_protocol::{Answer, Halt, Reply};

use super::{Activity, Controller, End};
use crate::drive::Progress;
use crate::homing::Outcome;
use crate::mechanics::AXES;
use crate::pins::Pins;

/// What a move may take longer than planned: an eighth, and half a second.
const MARGIN_US: u64 = 500_000;

impl Controller {
    /// Goes on with whatever moves the motors.
    pub(super) fn run(&mut self, now_us: u64, pins: &mut impl Pins) {
        let braking = matches!(self.activity, Activity::Braking { .. });
        if !braking && self.silent_us().is_some_and(|us| now_us >= us) {
            self.brake(Some(Halt::SilentHost), now_us);
            return;
        }
        if now_us > self.deadline_us {
            if braking {
                self.halt(Halt::TooLong, now_us);
            } else {
                self.brake(Some(Halt::TooLong), now_us);
            }
            return;
        }
        match self.drive.advance(now_us, pins) {
            Progress::Waiting => {}
            Progress::Stepped => self.stepped(now_us),
            Progress::Ended => self.ended(now_us, pins),
        }
    }

    fn stepped(&mut self, now_us: u64) {
        if let Activity::Homing(homing) = &mut self.activity {
            homing.stepped(&mut self.drive, &self.mechanics);
            return;
        }
        // Whoever brakes out of homing may still stand on a switch.
        if let Some(pressed) = AXES.into_iter().find(|&axis| self.homed && self.drive.is_pressed(axis)) {
            self.halt(Halt::Switch(pressed), now_us);
        }
    }

    fn ended(&mut self, now_us: u64, pins: &mut impl Pins) {
        match &mut self.activity {
            Activity::Homing(homing) => match homing.ended(&mut self.drive, &self.mechanics, now_us, pins) {
                Outcome::GoesOn => {}
                Outcome::Halt(halt) => {
                    self.counted = false;
                    self.halt(halt, now_us);
                }
                Outcome::Found => {
                    self.lost_steps = if self.counted { homing.off_steps } else { [0; 2] };
                    (self.homed, self.counted) = (true, true);
                    self.travel([0, 0], now_us, pins);
                }
            },
            Activity::Moving { target } => {
                if !self.drive.start_leg(*target, &self.mechanics, now_us, pins) {
                    self.settle(End::Arrived, now_us);
                }
            }
            Activity::Braking { halt: Some(halt) } => {
                let halt = *halt;
                self.halt(halt, now_us);
            }
            Activity::Braking { halt: None } => self.settle(End::Stopped, now_us),
            Activity::Idle | Activity::Settling { .. } | Activity::Exposing(_) => {}
        }
    }

    pub(super) fn brake(&mut self, halt: Option<Halt>, now_us: u64) {
        self.drive.brake();
        self.set_deadline(self.drive.left_us(now_us), now_us);
        self.activity = Activity::Braking { halt };
    }

    fn settle(&mut self, then: End, now_us: u64) {
        self.activity = Activity::Settling { until_us: now_us.saturating_add(self.settle_us()), then };
    }

    /// The rig has stopped by itself, and its position is no longer trusted. It swings more than after a move.
    fn halt(&mut self, halt: Halt, now_us: u64) {
        self.drive.rest(now_us);
        (self.homed, self.halt) = (false, Some(halt));
        self.settle(End::Halted(halt), now_us);
    }

    pub(super) fn end(&mut self, reply: Reply) -> Answer {
        self.activity = Activity::Idle;
        Answer { sequence: self.sequence, reply }
    }

    pub(super) fn set_deadline(&mut self, duration_us: u64, now_us: u64) {
        self.deadline_us = now_us.saturating_add(duration_us + duration_us / 8 + MARGIN_US);
    }
}

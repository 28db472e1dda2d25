//! What a request begins or ends.

use rigel_protocol::{Axis, Bracket, Command, Fault, Limits, Reply, Request};

use super::{Activity, Controller};
use crate::homing::Homing;
use crate::pins::Pins;
use crate::trigger::Trigger;

impl Controller {
    pub(super) fn obey(
        &mut self,
        request: &Request,
        now_us: u64,
        pins: &mut impl Pins,
    ) -> Result<Reply, Fault> {
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
        let target = [self.mechanics.step(Axis::Pan, pan_mdeg), self.mechanics.step(Axis::Tilt, tilt_mdeg)];
        Ok(self.travel(target, now_us, pins) + self.settle_us())
    }

    pub(super) fn travel(&mut self, target: [i32; 2], now_us: u64, pins: &mut impl Pins) -> u64 {
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
}

//! What turns the surface in front of the camera: one small trait, and the rig on a serial port behind it.
//!
//! The surface turns by the pan about its normal and then by the tilt about the rig's horizontal axis
//! ([`crate::geometry::Pose::from_rig`]); the camera stays where it is.

use rigel_protocol::{Limits, Status};

use crate::Result;

mod clock;
mod conversation;
mod ear;
mod link;
mod notice;
mod place;
mod serial;
mod tracking;
mod trigger;

pub use clock::{Clock, Moment};
pub use conversation::{SerialRig, StopLine};
pub use place::{Ends, Place, Timing};
pub use rigel_protocol::{Format, Halt, Output, State, TrackerState, TrackerStatus, Tracking};
pub use serial::{Port, SerialPlace, Usb, ports};
pub use tracking::Records;
pub use trigger::{Contact, Exposed, TriggerLine};

/// Where a move has ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reached {
    /// The pan that the rig reports, radians.
    pub pan_rad: f64,
    /// The tilt that the rig reports, radians.
    pub tilt_rad: f64,
    /// How long the rig was left to swing, seconds.
    pub settle_s: f64,
}

/// Something that turns the surface to a pan and a tilt, radians.
pub trait Rig {
    /// How far and how fast it goes.
    fn limits(&self) -> RigLimits;

    /// Goes to a position; returns once it has arrived and settled.
    ///
    /// # Errors
    /// A position beyond the limits is refused, never replaced by another; a rig that does not answer, does not arrive
    /// or is unplugged is an error that names it.
    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached>;

    /// Whether it stands where it was sent to, and has stood there all the time: a rig that has restarted or stopped since
    /// is not there. Nothing moves; the next move goes there again.
    ///
    /// # Errors
    /// A rig that does not answer is an error that names it.
    fn is_there(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<bool>;

    /// Which rig this is, in a line for people.
    fn describe(&self) -> String;

    /// What happened since this was last asked although the work went on, in sentences for the journal: a cable that was
    /// out, a rig that was homed again.
    fn take_notices(&mut self) -> Vec<String> {
        vec![]
    }
}

/// How far and how fast a rig goes; both axes share speed and acceleration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigLimits {
    /// Smallest and largest pan, radians.
    pub pan_rad: [f64; 2],
    /// Smallest and largest tilt, radians.
    pub tilt_rad: [f64; 2],
    /// Largest speed of an axis, radians per second.
    pub speed_rad_s: f64,
    /// Acceleration and braking of an axis, radians per second squared.
    pub acceleration_rad_s2: f64,
    /// How long the rig swings after a move before a photograph is sharp, seconds.
    pub settle_s: f64,
}

impl RigLimits {
    fn new(said: &Limits) -> Self {
        // A pan must be within the limits and must not wind the cables too far.
        let winding = said.winding_mdeg;
        Self {
            pan_rad: [rad(said.pan_min_mdeg.max(-winding)), rad(said.pan_max_mdeg.min(winding))],
            tilt_rad: [rad(said.tilt_min_mdeg), rad(said.tilt_max_mdeg)],
            speed_rad_s: f64::from(said.speed_mdeg_s) * RAD_PER_MDEG,
            acceleration_rad_s2: f64::from(said.acceleration_mdeg_s2) * RAD_PER_MDEG,
            settle_s: f64::from(said.settle_ms) / 1000.0,
        }
    }

    /// The time of a move between two positions (pan, tilt; radians), settling included, seconds.
    ///
    /// Both axes arrive together, so the longer way decides: a trapezoid of speed, or a triangle where the way is too
    /// short for full speed.
    pub fn travel_time_s(&self, from: [f64; 2], to: [f64; 2]) -> f64 {
        let way_rad = (to[0] - from[0]).abs().max((to[1] - from[1]).abs());
        let ramp_s = self.speed_rad_s / self.acceleration_rad_s2;
        let moving_s = if way_rad >= self.speed_rad_s * ramp_s {
            way_rad / self.speed_rad_s + ramp_s
        } else {
            2.0 * (way_rad / self.acceleration_rad_s2).sqrt()
        };
        moving_s + self.settle_s
    }

    /// Whether a position lies within the limits; their rounding to the rig's own unit is forgiven.
    pub fn contains(&self, pan_rad: f64, tilt_rad: f64) -> bool {
        let within =
            |angle: f64, [low, high]: [f64; 2]| angle >= low - ROUNDING_RAD && angle <= high + ROUNDING_RAD;
        within(pan_rad, self.pan_rad) && within(tilt_rad, self.tilt_rad)
    }
}

/// Where a rig is and what has happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RigStatus {
    /// What it is doing.
    pub state: State,
    /// Its pan, radians.
    pub pan_rad: f64,
    /// Its tilt, radians.
    pub tilt_rad: f64,
    /// Why it ended the last thing that moved by itself; `None` when it did not.
    pub halt: Option<Halt>,
    /// By how many steps pan and tilt were off at the last homing.
    pub lost_steps: [i32; 2],
    /// How many photographs of the last bracket were taken.
    pub exposed: u8,
    /// How many of them the flash-sync confirmed.
    pub confirmed: u8,
    /// How many damaged or unknown frames it has heard since it was switched on.
    pub bad_frames: u32,
}

impl RigStatus {
    fn new(said: &Status) -> Self {
        let Status { state, pan_mdeg, tilt_mdeg, halt, lost_steps, exposed, confirmed, bad_frames } = *said;
        let (pan_rad, tilt_rad) = (rad(pan_mdeg), rad(tilt_mdeg));
        Self { state, pan_rad, tilt_rad, halt, lost_steps, exposed, confirmed, bad_frames }
    }
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

/// A tenth of the rig's unit, a thousandth of a degree: a limit of π is 180.000 degrees there.
const ROUNDING_RAD: f64 = 1.7e-6;

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: RigLimits = RigLimits {
        pan_rad: [-3.0, 3.0],
        tilt_rad: [-0.5, 1.5],
        speed_rad_s: 1.0,
        acceleration_rad_s2: 2.0,
        settle_s: 0.3,
    };

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
    fn travel_takes_the_time_of_the_longer_axis() {
        // Half a second up and half a second down cover half a radian; a radian and a half is left at full speed.
        assert!((LIMITS.travel_time_s([-1.0, 0.0], [1.0, 0.7]) - 2.8).abs() < 1e-12);
        assert!((LIMITS.travel_time_s([0.0, 0.0], [0.01, -0.125]) - 0.8).abs() < 1e-12);
        assert_eq!(LIMITS.travel_time_s([1.0, 1.0], [1.0, 1.0]), 0.3);
    }

    #[test]
    fn travel_time_grows_with_the_way_and_has_no_jump() {
        let times: Vec<f64> =
            (0..2000).map(|i| LIMITS.travel_time_s([0.0; 2], [f64::from(i) * 1e-3, 0.0])).collect();
        assert!(times.windows(2).all(|t| t[1] > t[0]));
        assert!(times[100..].windows(2).all(|t| t[1] - t[0] < 3e-3));
    }

    #[test]
    fn the_limit_itself_is_within() {
        assert!(LIMITS.contains(3.0, -0.5) && LIMITS.contains(3.0 + 1e-7, 1.5));
        assert!(
            !LIMITS.contains(3.0 + 1e-5, 0.0)
                && !LIMITS.contains(0.0, -0.51)
                && !LIMITS.contains(f64::NAN, 0.0)
        );
    }
}

//! One move of both axes along a straight line of angles, with a trapezoidal speed profile, in integers.
//!
//! Angles are microdegrees, times microseconds. The axis with the longer way sets the profile and the other follows in
//! proportion, so both start, arrive and brake together. No product exceeds 63 bits within the bounds that
//! [`crate::Controller::new`] checks.

/// Where both axes are at every moment of a move.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    from_udeg: [i64; 2],
    way_udeg: [i64; 2],
    /// The longer of the two ways.
    length_udeg: i64,
    /// How much of the length lay behind when this profile began: not 0 for braking.
    behind_udeg: i64,
    profile: Profile,
}

impl Motion {
    /// The move between two positions (pan, tilt), from standstill to standstill.
    pub fn new(from_udeg: [i64; 2], to_udeg: [i64; 2], speed_udeg_s: i64, acceleration_udeg_s2: i64) -> Self {
        let way_udeg = [to_udeg[0] - from_udeg[0], to_udeg[1] - from_udeg[1]];
        let length_udeg = way_udeg[0].abs().max(way_udeg[1].abs());
        let profile = Profile::new(length_udeg, speed_udeg_s, acceleration_udeg_s2);
        Self { from_udeg, way_udeg, length_udeg, behind_udeg: 0, profile }
    }

    /// The move that brakes to a standstill on the way of this one, `time_us` after its start.
    pub fn brake(&self, time_us: i64, acceleration_udeg_s2: i64) -> Self {
        let behind_udeg = self.behind_udeg + self.profile.distance_at(time_us);
        let profile = Profile::brake(self.profile.speed_at(time_us), acceleration_udeg_s2);
        Self { behind_udeg, profile, ..*self }
    }

    /// How long it takes, microseconds.
    pub fn duration_us(&self) -> i64 {
        self.profile.duration_us()
    }

    /// The position (pan, tilt) `time_us` after the start.
    pub fn position_udeg(&self, time_us: i64) -> [i64; 2] {
        if self.length_udeg == 0 {
            return self.from_udeg;
        }
        let done = (self.behind_udeg + self.profile.distance_at(time_us)).min(self.length_udeg);
        [0, 1].map(|axis| self.from_udeg[axis] + self.way_udeg[axis] * done / self.length_udeg)
    }
}

/// Distance over time: speed rises, holds and falls in straight lines.
#[derive(Debug, Clone, Copy)]
struct Profile {
    distance_udeg: i64,
    speed_udeg_s: i64,
    rise_us: i64,
    hold_us: i64,
    fall_us: i64,
}

impl Profile {
    fn new(distance_udeg: i64, speed_udeg_s: i64, acceleration_udeg_s2: i64) -> Self {
        // A short way ends before full speed is reached: the highest speed there is sqrt(distance x acceleration).
        let speed_udeg_s = speed_udeg_s.min((distance_udeg * acceleration_udeg_s2).isqrt());
        if speed_udeg_s == 0 {
            return Self { distance_udeg, speed_udeg_s, rise_us: 0, hold_us: 0, fall_us: 0 };
        }
        let rise_us = speed_udeg_s * 1_000_000 / acceleration_udeg_s2;
        let held_udeg = distance_udeg - 2 * ramp(speed_udeg_s, rise_us, rise_us);
        let hold_us = (held_udeg * 1_000_000).div_euclid(speed_udeg_s) + 1;
        Self { distance_udeg, speed_udeg_s, rise_us, hold_us, fall_us: rise_us }
    }

    fn brake(speed_udeg_s: i64, acceleration_udeg_s2: i64) -> Self {
        let fall_us = speed_udeg_s * 1_000_000 / acceleration_udeg_s2;
        let distance_udeg = ramp(speed_udeg_s, fall_us, fall_us);
        Self { distance_udeg, speed_udeg_s, rise_us: 0, hold_us: 0, fall_us }
    }

    fn duration_us(&self) -> i64 {
        self.rise_us + self.hold_us + self.fall_us
    }

    fn distance_at(&self, time_us: i64) -> i64 {
        let left_us = self.duration_us() - time_us;
        if left_us <= 0 {
            self.distance_udeg
        } else if left_us < self.fall_us {
            self.distance_udeg - ramp(self.speed_udeg_s, self.fall_us, left_us)
        } else if time_us < self.rise_us {
            ramp(self.speed_udeg_s, self.rise_us, time_us.max(0))
        } else {
            let risen = ramp(self.speed_udeg_s, self.rise_us, self.rise_us);
            let falling = ramp(self.speed_udeg_s, self.fall_us, self.fall_us);
            let held = self.speed_udeg_s * (time_us - self.rise_us) / 1_000_000;
            (risen + held).min(self.distance_udeg - falling)
        }
    }

    fn speed_at(&self, time_us: i64) -> i64 {
        let left_us = self.duration_us() - time_us;
        if left_us <= 0 || time_us <= 0 && self.rise_us > 0 {
            0
        } else if left_us < self.fall_us {
            self.speed_udeg_s * left_us / self.fall_us
        } else if time_us < self.rise_us {
            self.speed_udeg_s * time_us / self.rise_us
        } else {
            self.speed_udeg_s
        }
    }
}

/// The distance gone `time_us` after standstill while the speed rises to `speed_udeg_s` within `ramp_us`.
fn ramp(speed_udeg_s: i64, ramp_us: i64, time_us: i64) -> i64 {
    if ramp_us == 0 {
        return 0;
    }
    speed_udeg_s * time_us / ramp_us * time_us / 2_000_000
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEGREE: i64 = 1_000_000;

    /// A motion, where it starts and ends, its speed and its acceleration.
    type Case = (Motion, [i64; 2], [i64; 2], i64, i64);

    /// Moves of every size, at the ordinary and at the most extreme speeds that are allowed.
    fn motions() -> Vec<Case> {
        let mut all = Vec::new();
        for (speed, acceleration) in
            [(60 * DEGREE, 120 * DEGREE), (1_000, 1_000), (1_000 * DEGREE, 5_000 * DEGREE)]
        {
            for (pan, tilt) in
                [(0, 0), (1_000, 0), (0, -7_000), (-DEGREE, 333_000), (90 * DEGREE, -45 * DEGREE)]
            {
                for scale in [1, 8] {
                    let (from, to) = ([-pan, 5_000], [pan * scale, tilt * scale]);
                    all.push((Motion::new(from, to, speed, acceleration), from, to, speed, acceleration));
                }
            }
        }
        all
    }

    #[test]
    fn it_starts_at_the_start_and_arrives_exactly() {
        for (motion, from, to, ..) in motions() {
            assert_eq!(motion.position_udeg(0), from);
            assert_eq!(motion.position_udeg(motion.duration_us()), to);
            assert_eq!(motion.position_udeg(i64::MAX / 4), to);
        }
    }

    #[test]
    fn speed_and_acceleration_stay_within_their_limits_and_nothing_turns_back() {
        for (motion, from, to, speed, acceleration) in motions() {
            let (steps, duration) = (1_000, motion.duration_us());
            let step_us = (duration / steps).max(1);
            let mut before = (from, 0);
            for step in 1..=steps + 1 {
                let at = motion.position_udeg(step * step_us);
                let moved = [0, 1].map(|axis| (at[axis] - before.0[axis]) * (to[axis] - from[axis]).signum());
                assert!(moved.iter().all(|&m| m >= 0), "turned back");
                // A position is whole microdegrees: what that rounding alone can do to a difference is allowed.
                let way = moved[0].max(moved[1]);
                assert!(way <= speed * step_us / 1_000_000 + 3, "{way} in {step_us} us at {speed}");
                // The changes between rise, hold and fall fall on whole microseconds: one of them is allowed, too.
                let change = i128::from(acceleration) * i128::from(step_us).pow(2) / 1_000_000_000_000
                    + i128::from(way.max(before.1) / step_us);
                let changed = i128::from((way - before.1).abs());
                assert!(changed <= change + change / 1_000 + 8, "{changed} instead of {change}");
                before = (at, way);
            }
        }
    }

    #[test]
    fn both_axes_arrive_together() {
        let motion = Motion::new([0, 0], [90 * DEGREE, -30 * DEGREE], 60 * DEGREE, 120 * DEGREE);
        for i in 0..=100 {
            let [pan, tilt] = motion.position_udeg(motion.duration_us() * i / 100);
            assert!((pan + 3 * tilt).abs() <= 3);
        }
    }

    #[test]
    fn the_duration_is_that_of_a_trapezoid_or_a_triangle() {
        // 90 degrees at 60/s and 120/s²: half a second up, half a second down, a second at full speed between.
        let long = Motion::new([0, 0], [90 * DEGREE, 0], 60 * DEGREE, 120 * DEGREE);
        assert!((long.duration_us() - 2_000_000).abs() <= 2);
        // 1.2 degrees: full speed is never reached, 2 sqrt(1.2 / 120) seconds.
        let short = Motion::new([0, 0], [1_200_000, 0], 60 * DEGREE, 120 * DEGREE);
        assert!((short.duration_us() - 200_000).abs() <= 2);
    }

    #[test]
    fn braking_is_smooth_and_never_goes_beyond_the_goal() {
        for (motion, from, to, speed, acceleration) in motions() {
            for i in 0..=50 {
                let time = motion.duration_us() * i / 50;
                let brake = motion.brake(time, acceleration);
                assert_eq!(brake.position_udeg(0), motion.position_udeg(time));
                let end = brake.position_udeg(brake.duration_us());
                for axis in 0..2 {
                    let (low, high) = (from[axis].min(to[axis]), from[axis].max(to[axis]));
                    assert!((low..=high).contains(&end[axis]));
                }
                let soon = brake.position_udeg(1_000);
                let jump = (soon[0] - motion.position_udeg(time)[0]).abs();
                assert!(jump <= speed / 1_000 + 2);
                assert!(brake.duration_us() <= speed * 1_000_000 / acceleration + 1);
                assert_eq!(brake.brake(brake.duration_us(), acceleration).duration_us(), 0);
            }
        }
    }
}

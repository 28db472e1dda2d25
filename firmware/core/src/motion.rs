//! When the steps of a move are due, in whole microseconds.
//!
//! A move goes from standstill to standstill. The axis with more steps leads; the other follows by Bresenham's
//! algorithm, always on an edge of the leader, and both make their last step on the same edge. The time of every step
//! is computed by itself from its number, so nothing adds up and nothing drifts.
//!
//! With K the square of the microseconds that the first step would take twice over (`K = 1e12 / acceleration`) and c
//! the interval at full speed, the trapezoid crosses the middle before step i at
//!
//! * `sqrt((2i - 1) K)` while the speed rises, which is as long as `(2i - 1) c² <= K`, and
//! * `(2i - 1) c / 2 + K / 2c` at full speed,
//!
//! and at the mirror images of these times while it falls. K and c are rounded up, so the trapezoid keeps to both
//! limits exactly, and every time is rounded up to a whole microsecond. Therefore:
//!
//! * two steps are never closer than c: no pair of edges is faster than the limit;
//! * there is one trapezoid within the limits, begun less than one microsecond late, that crosses every step less than
//!   one microsecond away from its edge: the acceleration is within its limit but for the clock's tick.
//!
//! Braking cuts a move short: the same formulas with the smallest number of steps that has the same past. So it keeps
//! to the same two properties from any point of the way.

use rigel_protocol::Axis;

/// How fast an axis may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Pace {
    /// Between two steps at full speed, microseconds.
    pub interval_us: u64,
    /// The inverse of the acceleration, square microseconds per step.
    pub rise_us2: u64,
}

impl Pace {
    /// The pace of an axis; `None` where a speed or an acceleration is 0.
    pub const fn new(speed_mdeg_s: u32, acceleration_mdeg_s2: u32, steps_per_turn: u32) -> Option<Self> {
        let speed = speed_mdeg_s as u64 * steps_per_turn as u64;
        let acceleration = acceleration_mdeg_s2 as u64 * steps_per_turn as u64;
        if speed == 0 || acceleration == 0 {
            return None;
        }
        // 360 000 mdeg are a turn; 1e6 us are a second.
        let interval_us = 360_000_000_000_u64.div_ceil(speed);
        let rise_us2 = 360_000_000_000_000_000_u64.div_ceil(acceleration);
        Some(Self { interval_us, rise_us2 })
    }

    /// The steps from full speed to standstill, rounded up from half a step behind the last edge.
    pub const fn braking_steps(&self) -> u64 {
        let square = self.interval_us * self.interval_us;
        (self.rise_us2 + square).div_ceil(2 * square)
    }
}

/// The times of the leading axis' steps.
#[derive(Debug, Clone, Copy)]
struct Profile {
    steps: u32,
    pace: Pace,
    /// So many steps from either end, the speed is full.
    ramp_steps: u64,
    /// Step i at full speed is due at `i * interval_us + offset_us`.
    offset_us: i64,
    /// When standstill is reached.
    end_us: u64,
}

impl Profile {
    fn new(steps: u32, pace: Pace) -> Self {
        let Pace { interval_us, rise_us2 } = pace;
        let square = interval_us * interval_us;
        let ramp_steps = (rise_us2 / square).div_ceil(2);
        let offset_us = ceil_div(rise_us2 as i64 - square as i64, 2 * interval_us as i64);
        let n = u64::from(steps);
        let end_us = if n == 0 {
            0
        } else if rise_us2.div_ceil(square) <= n {
            ((n + 1) * interval_us).saturating_add_signed(2 * offset_us)
        } else {
            // Full speed is not reached. The two steps beside the middle keep their distance, too.
            let middle_us = ceil_sqrt(n * rise_us2);
            let beside_us = ceil_sqrt((n - 1) * rise_us2);
            (2 * middle_us).max(if n.is_multiple_of(2) { 2 * beside_us + interval_us } else { 0 })
        };
        Self { steps, pace, ramp_steps, offset_us, end_us }
    }

    /// When a step (from 1) is due.
    fn time_us(&self, step: u32) -> u64 {
        let (from_start, from_end) = (u64::from(step), u64::from(self.steps + 1 - step));
        let nearer = from_start.min(from_end);
        let time_us = if nearer <= self.ramp_steps {
            ceil_sqrt((2 * nearer - 1) * self.pace.rise_us2)
        } else {
            (nearer * self.pace.interval_us).saturating_add_signed(self.offset_us)
        };
        if from_start <= from_end { time_us } else { self.end_us - time_us }
    }

    /// The profile that brakes after `done` steps.
    fn braked(&self, done: u32) -> Self {
        // Without a step nothing moves yet. While the speed rises, it falls again over the same way.
        let left = if done == 0 { 0 } else { (u64::from(done) + 1).min(self.pace.braking_steps()) };
        Self::new(self.steps.min(done.saturating_add(left as u32)), self.pace)
    }
}

/// One move of both axes (pan, tilt), as steps and the times at which they are due, counted from its start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    /// The direction of each axis: -1, 0 or 1.
    direction: [i32; 2],
    lead: Axis,
    profile: Profile,
    done: u32,
    /// The whole way of the leader and of the follower, also when it is cut short.
    whole: u32,
    follower: u32,
    /// Bresenham's rest, below `whole`.
    rest: u32,
}

impl Motion {
    /// A move that goes nowhere and is over.
    pub const NONE: Self = Self {
        direction: [0; 2],
        lead: Axis::Pan,
        profile: Profile {
            steps: 0,
            pace: Pace { interval_us: 1, rise_us2: 1 },
            ramp_steps: 0,
            offset_us: 0,
            end_us: 0,
        },
        done: 0,
        whole: 0,
        follower: 0,
        rest: 0,
    };

    /// The move by so many steps.
    pub fn new(way: [i32; 2], paces: [Pace; 2]) -> Self {
        let [pan, tilt] = way.map(i32::unsigned_abs);
        let [pan_pace, tilt_pace] = paces;
        let (lead, whole, follower, own, other) = if pan >= tilt {
            (Axis::Pan, pan, tilt, pan_pace, tilt_pace)
        } else {
            (Axis::Tilt, tilt, pan, tilt_pace, pan_pace)
        };
        let mut pace = own;
        // The follower's steps are at least `ratio` of the leader's apart, and its acceleration is in proportion.
        if let Some(ratio) = whole.checked_div(follower) {
            let rise_us2 = (other.rise_us2 * u64::from(follower)).div_ceil(u64::from(whole));
            pace.rise_us2 = pace.rise_us2.max(rise_us2);
            pace.interval_us = pace.interval_us.max(other.interval_us.div_ceil(u64::from(ratio)));
        }
        let profile = Profile::new(whole, pace);
        Self { direction: way.map(i32::signum), lead, profile, done: 0, whole, follower, rest: 0 }
    }

    /// The direction of each axis: -1, 0 or 1.
    pub fn direction(&self) -> [i32; 2] {
        self.direction
    }

    /// Whether every step is done.
    pub fn is_done(&self) -> bool {
        self.done >= self.profile.steps
    }

    /// When the next step is due or, after the last, when standstill is reached.
    pub fn next_us(&self) -> u64 {
        if self.is_done() { self.profile.end_us } else { self.profile.time_us(self.done + 1) }
    }

    /// When standstill is reached.
    pub fn end_us(&self) -> u64 {
        self.profile.end_us
    }

    /// The smallest time between two steps.
    pub fn interval_us(&self) -> u64 {
        self.profile.pace.interval_us
    }

    /// Does the next step: by how much each axis steps, -1, 0 or 1.
    pub fn step(&mut self) -> [i32; 2] {
        if self.is_done() {
            return [0; 2];
        }
        self.done += 1;
        self.rest += self.follower;
        let follows = self.rest >= self.whole;
        if follows {
            self.rest -= self.whole;
        }
        let [pan, tilt] = self.direction;
        match (self.lead, follows) {
            (_, true) => [pan, tilt],
            (Axis::Pan, false) => [pan, 0],
            (Axis::Tilt, false) => [0, tilt],
        }
    }

    /// Cuts the move short: from here on it brakes.
    pub fn brake(&mut self) {
        self.profile = self.profile.braked(self.done);
    }
}

fn ceil_sqrt(square: u64) -> u64 {
    let root = square.isqrt();
    root + u64::from(root * root < square)
}

fn ceil_div(a: i64, b: i64) -> i64 {
    -(-a).div_euclid(b)
}

#[cfg(test)]
mod tests;

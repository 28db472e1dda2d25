//! What a rig is made of: gears, limits, switches; and what follows from it for its steps.

use rigel_protocol::{Axis, Limits};

use crate::motion::Pace;

/// The largest angle that a limit may allow, either way: two turns.
const LARGEST_MDEG: i32 = 720_000;
/// The largest way of an axis that homing may try: eight turns.
const LONGEST_WAY_MDEG: i32 = 2_880_000;
const LARGEST_SPEED_MDEG_S: u32 = 1_000_000;
const LARGEST_ACCELERATION_MDEG_S2: u32 = 5_000_000;
/// Coarser steps than a tenth of a degree would spoil every angle; finer ones overflow.
const FEWEST_STEPS: u32 = 3_600;
const MOST_STEPS: u32 = 1 << 22;
/// No board keeps up with more than 100 000 steps per second.
const SHORTEST_INTERVAL_US: u64 = 10;
const LONGEST_INTERVAL_US: u64 = 1_000_000;

/// What a rig is made of. Pairs are pan and tilt.
///
/// A target is always approached with increasing angle. A move that ends with decreasing angle goes `backlash_steps`
/// further and comes back, so at a lower limit the motor's shaft turns so far beyond it: by the play in the gear, which
/// is what keeps the surface itself within its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mechanics {
    /// How far and how fast it may go; what the hello says.
    pub limits: Limits,
    /// Steps (microsteps) of each motor for a whole turn of its axis: 3600 to 4 194 304.
    pub steps_per_turn: [u32; 2],
    /// At least the play of each gear, steps; 0 for none. At most a sixteenth of a turn.
    pub backlash_steps: [u32; 2],
    /// Where the switches close: beyond the limits, either side, and not within the backlash.
    pub switch_mdeg: [i32; 2],
    /// The speed of the search for a switch. What it takes to brake from it is how far the switches are overrun.
    pub seek_mdeg_s: u32,
    /// The speed at which a switch's place is measured.
    pub approach_mdeg_s: u32,
    /// How far homing backs off from a switch: more than the overrun and what the switch needs to open.
    pub back_off_mdeg: i32,
    /// The longest way on which homing looks for each switch: at least from the far limit.
    pub longest_way_mdeg: [i32; 2],
}

/// Pan and tilt, in the order of every pair.
pub(crate) const AXES: [Axis; 2] = [Axis::Pan, Axis::Tilt];

impl Mechanics {
    /// The smallest and the largest angle of an axis.
    const fn range_mdeg(&self, axis: Axis) -> [i32; 2] {
        let Limits { pan_min_mdeg, pan_max_mdeg, tilt_min_mdeg, tilt_max_mdeg, .. } = self.limits;
        match axis {
            Axis::Pan => [pan_min_mdeg, pan_max_mdeg],
            Axis::Tilt => [tilt_min_mdeg, tilt_max_mdeg],
        }
    }

    /// The step nearest to an angle: always the same one for the same angle.
    pub(crate) const fn step(&self, axis: Axis, mdeg: i32) -> i32 {
        let steps = self.steps_per_turn[axis as usize] as i64;
        (mdeg as i64 * steps + 180_000).div_euclid(360_000) as i32
    }

    /// The angle of a step, to the nearest thousandth of a degree.
    pub(crate) const fn mdeg(&self, axis: Axis, step: i32) -> i32 {
        let steps = self.steps_per_turn[axis as usize] as i64;
        (step as i64 * 360_000 + steps / 2).div_euclid(steps) as i32
    }

    /// -1 when an axis' switch is at the end of decreasing angles, else 1.
    pub(crate) const fn side(&self, axis: Axis) -> i32 {
        if self.switch_mdeg[axis as usize] < self.range_mdeg(axis)[0] { -1 } else { 1 }
    }

    /// The pace of both axes at a speed; an impossible pace, which [`Self::is_possible`] has excluded, is a slow one.
    pub(crate) const fn paces(&self, speed_mdeg_s: u32) -> [Pace; 2] {
        let [pan, tilt] = self.steps_per_turn;
        [self.pace(speed_mdeg_s, pan), self.pace(speed_mdeg_s, tilt)]
    }

    const fn pace(&self, speed_mdeg_s: u32, steps_per_turn: u32) -> Pace {
        match Pace::new(speed_mdeg_s, self.limits.acceleration_mdeg_s2, steps_per_turn) {
            Some(pace) => pace,
            None => Pace { interval_us: LONGEST_INTERVAL_US, rise_us2: 1 << 40 },
        }
    }

    /// Whether there can be such a rig, and no number of its moves overflows.
    pub(crate) const fn is_possible(&self) -> bool {
        let Limits { winding_mdeg, speed_mdeg_s, acceleration_mdeg_s2, .. } = self.limits;
        winding_mdeg >= 0
            && winding_mdeg <= LARGEST_MDEG
            && 0 < self.approach_mdeg_s
            && self.approach_mdeg_s <= self.seek_mdeg_s
            && self.seek_mdeg_s <= speed_mdeg_s
            && speed_mdeg_s <= LARGEST_SPEED_MDEG_S
            && 0 < acceleration_mdeg_s2
            && acceleration_mdeg_s2 <= LARGEST_ACCELERATION_MDEG_S2
            && self.is_axis_possible(Axis::Pan)
            && self.is_axis_possible(Axis::Tilt)
    }

    const fn is_axis_possible(&self, axis: Axis) -> bool {
        let [min, max] = self.range_mdeg(axis);
        let (switch, longest) = (self.switch_mdeg[axis as usize], self.longest_way_mdeg[axis as usize]);
        let (steps, backlash) = (self.steps_per_turn[axis as usize], self.backlash_steps[axis as usize]);
        let sound = -LARGEST_MDEG <= min
            && min <= 0
            && 0 <= max
            && max <= LARGEST_MDEG
            && -LARGEST_MDEG * 2 <= switch
            && switch <= LARGEST_MDEG * 2
            && FEWEST_STEPS <= steps
            && steps <= MOST_STEPS
            && backlash <= steps / 16
            && 0 < self.back_off_mdeg
            && self.back_off_mdeg <= LARGEST_MDEG
            && 0 < longest
            && longest <= LONGEST_WAY_MDEG;
        if !sound {
            return false;
        }
        let [first, last] = [self.step(axis, min) - backlash as i32, self.step(axis, max)];
        let edge = self.step(axis, switch);
        if first <= edge && edge <= last {
            return false;
        }
        let far = if edge < first { max - switch } else { switch - min };
        let back_off = self.step(axis, self.back_off_mdeg) as u64;
        let seek = self.pace(self.seek_mdeg_s, steps);
        far <= longest
            && back_off >= 16
            && back_off > seek.braking_steps()
            && self.is_pace_possible(self.limits.speed_mdeg_s)
            && self.is_pace_possible(self.seek_mdeg_s)
            && self.is_pace_possible(self.approach_mdeg_s)
    }

    /// Whether the intervals are ones that a board can keep, and `2 * steps * rise_us2` fits for the longest way of all.
    const fn is_pace_possible(&self, speed_mdeg_s: u32) -> bool {
        let [pan, tilt] = self.paces(speed_mdeg_s);
        let coarser = if pan.rise_us2 > tilt.rise_us2 { pan.rise_us2 } else { tilt.rise_us2 };
        let finer = if self.steps_per_turn[0] > self.steps_per_turn[1] {
            self.steps_per_turn[0]
        } else {
            self.steps_per_turn[1]
        };
        let longest = finer as u64 * (LONGEST_WAY_MDEG as u64 / 360_000 + 1);
        SHORTEST_INTERVAL_US <= pan.interval_us
            && pan.interval_us <= LONGEST_INTERVAL_US
            && SHORTEST_INTERVAL_US <= tilt.interval_us
            && tilt.interval_us <= LONGEST_INTERVAL_US
            && coarser <= (1 << 62) / (2 * longest)
    }
}

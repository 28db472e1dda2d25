//! A tracker's jitter taken out while it speaks: a filter that knows only the past.
//!
//! A polynomial of the first degree with fading memory (Morrison, "Introduction to sequential smoothing and prediction", 1969, chapter
//! 9.5), on rotations: what was said counts e times less with every `memory_s` that passes. It foretells with the speed, so at an even speed it does not
//! lag at all; while the speed changes by a (radians per second squared) it is behind by a [`Causal::lag_s2`].

use glam::{DQuat, DVec3};

use super::Turned;
use super::smooth::rotation_vector;

/// So many records tell how noisy they are.
const SPREAD: f64 = 60.0;
/// Of two records that lie closer, seconds, the second tells no speed: a rig puts one that seems to be earlier a microsecond behind the one before.
const NEAREST_S: f64 = 1e-3;

/// What was known with a record.
#[derive(Debug, Clone, Copy)]
struct Node {
    time_s: f64,
    turn: DQuat,
    rate: DVec3,
    sigma_rad: f64,
}

/// A one-sided filter of orientations.
#[derive(Debug, Clone)]
pub struct Causal {
    memory_s: f64,
    nodes: Vec<Node>,
    count: f64,
    /// Of records from what was foretold, about each axis, radians squared.
    far2: f64,
}

impl Causal {
    /// A filter that forgets in so many seconds (above 0).
    pub fn new(memory_s: f64) -> Self {
        Self { memory_s, nodes: vec![], count: 0.0, far2: 0.0 }
    }

    /// What part of white jitter is left when records come every `interval_s` seconds.
    pub fn noise_factor(&self, interval_s: f64) -> f64 {
        let (angle, speed) = self.gains(interval_s);
        variance_left(angle, speed).sqrt()
    }

    /// How far it is behind per angular acceleration, seconds squared, when records come every `interval_s` seconds.
    pub fn lag_s2(&self, interval_s: f64) -> f64 {
        let (angle, speed) = self.gains(interval_s);
        interval_s * interval_s * (1.0 - angle) / speed
    }

    /// Shares of what was not foretold that angle and speed (times the interval) take.
    fn gains(&self, interval_s: f64) -> (f64, f64) {
        let fade = (-interval_s / self.memory_s).exp();
        (1.0 - fade * fade, (1.0 - fade) * (1.0 - fade))
    }

    /// Takes a record: seconds, later than all before, and the orientation that was said. `false` where it is not later, or by less than a millisecond, and
    /// is left out.
    pub fn push(&mut self, time_s: f64, said: DQuat) -> bool {
        let Some(last) = self.nodes.last().copied() else {
            self.nodes.push(Node { time_s, turn: said, rate: DVec3::ZERO, sigma_rad: f64::INFINITY });
            self.count = 1.0;
            return true;
        };
        let interval_s = time_s - last.time_s;
        if interval_s.is_nan() || interval_s < NEAREST_S {
            return false;
        }
        if interval_s > 5.0 * self.memory_s {
            // Nothing that was known then is worth anything now.
            self.count = 0.0;
        }
        self.count += 1.0;
        let n = self.count;
        let (fading, fading_speed) = self.gains(interval_s);
        // At the beginning all records count the same: least squares with growing memory.
        let angle = fading.max(2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))).min(1.0);
        let speed = fading_speed.max(6.0 / (n * (n + 1.0))).min(1.0);
        let foretold = (last.turn * DQuat::from_scaled_axis(last.rate * interval_s)).normalize();
        let off = rotation_vector(foretold.inverse() * said);
        // Of the same memory as what is foretold from.
        let left = variance_left(fading, fading_speed);
        let foretold2 = (left - fading * fading) / (1.0 - fading).powi(2).max(1e-9);
        if n > 2.0 {
            let share = (1.0 / (n - 2.0)).max(1.0 / SPREAD);
            self.far2 += share * (off.length_squared() / 3.0 / (1.0 + foretold2) - self.far2);
        }
        let is_new = n <= 1.0;
        self.nodes.push(Node {
            time_s,
            turn: if is_new { said } else { (foretold * DQuat::from_scaled_axis(off * angle)).normalize() },
            rate: if is_new { DVec3::ZERO } else { last.rate + off * (speed / interval_s) },
            sigma_rad: if n > 2.0 { (self.far2 * left.max(angle * angle)).sqrt() } else { f64::INFINITY },
        });
        true
    }

    /// How the receiver was turned at a time, by the records until then alone; `None` before the first.
    pub fn at(&self, time_s: f64) -> Option<Turned> {
        let after = self.nodes.partition_point(|node| node.time_s <= time_s);
        let node = self.nodes.get(after.checked_sub(1)?)?;
        let turn = node.turn * DQuat::from_scaled_axis(node.rate * (time_s - node.time_s));
        Some(Turned { orientation: turn.normalize(), rate: node.rate, sigma_rad: node.sigma_rad })
    }

    /// When the last record was said at or before a time, seconds.
    pub fn heard_s(&self, time_s: f64) -> Option<f64> {
        let after = self.nodes.partition_point(|node| node.time_s <= time_s);
        Some(self.nodes.get(after.checked_sub(1)?)?.time_s)
    }

    /// When the last record of all was said, seconds.
    pub fn last_s(&self) -> Option<f64> {
        self.nodes.last().map(|node| node.time_s)
    }
}

/// What part of a record's variance is left in the angle (Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
/// navigation", 2001, chapter 6.5, with no acceleration).
fn variance_left(angle: f64, speed: f64) -> f64 {
    (2.0 * angle * angle + speed * (2.0 - 3.0 * angle)) / (angle * (4.0 - 2.0 * angle - speed))
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    const INTERVAL_S: f64 = 1.0 / 60.0;

    fn filtered(memory_s: f64, turn: impl Fn(f64) -> DQuat) -> Causal {
        let mut filter = Causal::new(memory_s);
        (0..1200)
            .for_each(|k| assert!(filter.push(f64::from(k) * INTERVAL_S, turn(f64::from(k) * INTERVAL_S))));
        filter
    }

    fn off(filter: &Causal, time_s: f64, truth: DQuat) -> DVec3 {
        rotation_vector(truth.inverse() * filter.at(time_s).unwrap().orientation)
    }

    #[test]
    fn at_an_even_speed_nothing_lags_also_between_records() {
        let axis = DVec3::new(0.3, 0.9, -0.2);
        let truth = |time_s: f64| DQuat::from_scaled_axis(axis * time_s);
        let filter = filtered(0.1, truth);
        for time_s in [15.0, 17.003, 1199.5 * INTERVAL_S] {
            assert!(off(&filter, time_s, truth(time_s)).length() < 1e-7, "{time_s}");
        }
    }

    #[test]
    fn records_a_microsecond_apart_make_no_speed() {
        let noise = DQuat::from_rotation_x(0.01);
        let truth = |time_s: f64| DQuat::from_rotation_y(0.5 * time_s);
        // At the beginning, where little is known, and later.
        for pair in [0, 1, 2, 30] {
            let mut filter = Causal::new(0.1);
            for k in 0..60 {
                let time_s = f64::from(k) * INTERVAL_S;
                filter.push(time_s, truth(time_s));
                if k == pair {
                    filter.push(time_s + 1e-6, truth(time_s) * noise);
                }
            }
            let last_s = 59.0 * INTERVAL_S;
            assert!(off(&filter, last_s, truth(last_s)).length() < 1e-3, "{pair}");
            assert!((filter.at(last_s).unwrap().rate.y - 0.5).abs() < 1e-2, "{pair}");
        }
    }

    #[test]
    fn where_the_speed_changes_it_is_behind_by_what_is_stated() {
        for memory_s in [0.05, 0.1, 0.3] {
            let acceleration = 0.8;
            let truth = |time_s: f64| DQuat::from_rotation_y(0.5 * acceleration * time_s * time_s);
            let filter = filtered(memory_s, truth);
            let behind = -off(&filter, 1199.0 * INTERVAL_S, truth(1199.0 * INTERVAL_S)).y / acceleration;
            let stated = filter.lag_s2(INTERVAL_S);
            assert!((behind / stated - 1.0).abs() < 0.02, "{memory_s}: {behind} {stated}");
        }
    }

    #[test]
    fn white_jitter_shrinks_by_what_is_stated_and_what_is_left_is_told() {
        let noise = 0.75f64.to_radians();
        for memory_s in [0.05, 0.1, 0.3] {
            let mut random = StdRng::seed_from_u64(4);
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let mut filter = Causal::new(memory_s);
            let truth = |time_s: f64| DQuat::from_rotation_y(0.7 * time_s);
            let (mut squares, mut told, mut count) = (0.0, 0.0, 0.0);
            for k in 0..20_000 {
                let time_s = f64::from(k) * INTERVAL_S;
                let jitter = DVec3::new(normal(), normal(), normal()) * noise;
                filter.push(time_s, truth(time_s) * DQuat::from_scaled_axis(jitter));
                if k > 200 {
                    squares += off(&filter, time_s, truth(time_s)).length_squared() / 3.0;
                    told += filter.at(time_s).unwrap().sigma_rad.powi(2);
                    count += 1.0;
                }
            }
            let (left, told) = (f64::sqrt(squares / count) / noise, f64::sqrt(told / count) / noise);
            let stated = filter.noise_factor(INTERVAL_S);
            assert!((left / stated - 1.0).abs() < 0.05, "{memory_s}: {left} {stated}");
            assert!((told / stated - 1.0).abs() < 0.1, "{memory_s}: {told} {stated}");
        }
    }

    #[test]
    fn nothing_after_a_time_changes_what_is_said_of_it() {
        let truth = |time_s: f64| DQuat::from_rotation_y((1.3 * time_s).sin());
        let mut filter = Causal::new(0.1);
        let mut said = vec![];
        for k in 0..300 {
            filter.push(f64::from(k) * INTERVAL_S, truth(f64::from(k) * INTERVAL_S));
            said.push(filter.at(f64::from(k) * INTERVAL_S).unwrap());
        }
        for (k, said) in said.iter().enumerate() {
            assert_eq!(filter.at(k as f64 * INTERVAL_S), Some(*said));
        }
        assert_eq!(filter.at(-0.1), None);
        assert!(!filter.push(1.0, DQuat::IDENTITY), "time runs backwards");
    }
}

//! Jitter taken out of orientations without lag: a Kalman filter forwards and Rauch, Tung and Striebel's smoother backwards, on rotations.
//!
//! A receiver turns at a speed that changes by chance (white angular acceleration); what the tracker says is that plus white noise. All three
//! axes share one covariance of angle and speed. Errors are small turns after the orientation, in the receiver's own axes, so no
//! angle ever wraps.

use glam::{DQuat, DVec3};

/// A record farther from what was expected, squared, in variances of three axes, is left out: 5.5 standard deviations.
const GATE: f64 = 30.0;
/// So many in a row are no outliers but a motion that nobody expected: it is followed.
const PERSISTENT: usize = 4;
/// No tracker is better, radians.
const LEAST_NOISE_RAD: f64 = 1e-4;

/// The rotation vector of the short way round.
pub fn rotation_vector(turn: DQuat) -> DVec3 {
    if turn.w < 0.0 { (-turn).to_scaled_axis() } else { turn.to_scaled_axis() }
}

/// Orientation, angular velocity in the receiver's axes, and the variances of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State {
    pub turn: DQuat,
    pub rate: DVec3,
    /// Angle, angle with speed, speed: rad², rad²/s, rad²/s².
    pub variance: [f64; 3],
}

impl State {
    /// What is expected after (or, negative, before) so many seconds, with white acceleration of this strength, rad²/s³.
    pub fn after(&self, time_s: f64, strength: f64) -> Self {
        let [a, b, c] = self.variance;
        let t = time_s;
        let grown = strength * t.abs();
        Self {
            turn: (self.turn * DQuat::from_scaled_axis(self.rate * t)).normalize(),
            rate: self.rate,
            variance: [
                a + 2.0 * t * b + t * t * c + grown * t * t / 3.0,
                b + t * c + grown * t / 2.0,
                c + grown,
            ],
        }
    }

    /// What is known of this state, `time_s` before another one of which more is known now than was `expected` then.
    pub fn smoothed(&self, time_s: f64, expected: &Self, known: &Self) -> Self {
        let [a, b, c] = self.variance;
        let [ea, eb, ec] = expected.variance;
        let determinant = ea * ec - eb * eb;
        if determinant.is_nan() || determinant <= 0.0 {
            return *self;
        }
        // P Fᵀ, then times the inverse of what was expected.
        let (p00, p01, p10, p11) = (a + time_s * b, b, b + time_s * c, c);
        let gain = |x: f64, y: f64| ((x * ec - y * eb) / determinant, (y * ea - x * eb) / determinant);
        let ((g00, g01), (g10, g11)) = (gain(p00, p01), gain(p10, p11));
        let turned = rotation_vector(expected.turn.inverse() * known.turn);
        let faster = known.rate - expected.rate;
        let [da, db, dc] = std::array::from_fn(|i| known.variance[i] - expected.variance[i]);
        let by = |x: (f64, f64), y: (f64, f64)| x.0 * (da * y.0 + db * y.1) + x.1 * (db * y.0 + dc * y.1);
        let (first, second) = ((g00, g01), (g10, g11));
        Self {
            turn: (self.turn * DQuat::from_scaled_axis(turned * g00 + faster * g01)).normalize(),
            rate: self.rate + turned * g10 + faster * g11,
            variance: [
                (a + by(first, first)).max(0.0),
                b + by(first, second),
                (c + by(second, second)).max(0.0),
            ],
        }
    }
}

/// A record that was used: what was expected of it, what was known with it, and what is known with all.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    time_s: f64,
    expected: State,
    filtered: State,
    smoothed: State,
}

/// A tracker's path without jitter.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Smooth {
    nodes: Vec<Node>,
    /// White angular acceleration, rad²/s³.
    strength: f64,
    /// Of a record about an axis, radians.
    pub noise_rad: f64,
    /// Records that lie far beside the path.
    pub outliers: usize,
}

impl Smooth {
    /// Of at least four records in the order of time. Noise and acceleration are those that make the records likeliest, each as expected from
    /// those before it.
    pub fn new(records: &[(f64, DQuat)]) -> Self {
        let mut noise_rad = roughness_rad(records).max(LEAST_NOISE_RAD);
        let mut intervals_s: Vec<f64> = records.windows(2).map(|r| r[1].0 - r[0].0).collect();
        intervals_s.sort_by(f64::total_cmp);
        let usual_s = intervals_s[intervals_s.len() / 2].max(1e-6);
        // Strength times the cube of the interval, in variances of the noise.
        let strength =
            |ln_ratio: f64, noise_rad: f64| ln_ratio.exp() * noise_rad * noise_rad / usual_s.powi(3);
        let mut best = 0.0;
        for _ in 0..2 {
            let cost = |ln_ratio: f64| filter(records, noise_rad, strength(ln_ratio, noise_rad)).1;
            let grid = (-20..=6).map(|i| f64::from(i) * 0.9);
            best =
                grid.map(|at| (cost(at), at)).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |best| best.1);
            let mut step = 0.45;
            while step > 0.02 {
                let around = [best - step, best, best + step].map(|at| (cost(at), at));
                best = around.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(best, |best| best.1);
                step /= 2.0;
            }
            let scale = filter(records, noise_rad, strength(best, noise_rad)).2;
            noise_rad = (noise_rad * scale).max(LEAST_NOISE_RAD);
        }
        let strength = strength(best, noise_rad);
        let mut nodes = filter(records, noise_rad, strength).0;
        for k in (0..nodes.len().saturating_sub(1)).rev() {
            let (here, next) = (nodes[k], nodes[k + 1]);
            nodes[k].smoothed =
                here.filtered.smoothed(next.time_s - here.time_s, &next.expected, &next.smoothed);
        }
        let outliers = records.len() - nodes.len();
        Self { nodes, strength, noise_rad, outliers }
    }

    /// What is known at a time, also between records and before and after all of them.
    pub fn at(&self, time_s: f64) -> State {
        let after = self.nodes.partition_point(|node| node.time_s <= time_s);
        if after == 0 {
            let first = &self.nodes[0];
            return first.smoothed.after(time_s - first.time_s, self.strength);
        }
        let before = &self.nodes[after - 1];
        let Some(next) = self.nodes.get(after) else {
            return before.smoothed.after(time_s - before.time_s, self.strength);
        };
        let here = before.filtered.after(time_s - before.time_s, self.strength);
        here.smoothed(next.time_s - time_s, &next.expected, &next.smoothed)
    }
}

/// Noise of an angle as second differences have it, whose median few outliers and motion do not change.
pub(super) fn roughness_rad(records: &[(f64, DQuat)]) -> f64 {
    let mut squares: Vec<f64> = records
        .windows(3)
        .map(|r| {
            let turn = |i: usize| rotation_vector(r[i].1.inverse() * r[i + 1].1);
            (turn(1) - turn(0)).length_squared()
        })
        .collect();
    squares.sort_by(f64::total_cmp);
    // Six variances a second difference; the median of three squares is 2.366 of their variance.
    squares.get(squares.len() / 2).map_or(0.0, |median| (median / 6.0 / 2.366).sqrt())
}

/// Forwards: what was used, how unlikely the records are (minus the logarithm, up to a constant), and by what factor the noise differs
/// from the one assumed.
fn filter(records: &[(f64, DQuat)], noise_rad: f64, strength: f64) -> (Vec<Node>, f64, f64) {
    let noise = noise_rad * noise_rad;
    let start = State {
        turn: records[0].1,
        rate: DVec3::ZERO,
        // A hand turns by radians per second.
        variance: [noise, 0.0, 4.0],
    };
    let mut nodes = Vec::with_capacity(records.len());
    nodes.push(Node { time_s: records[0].0, expected: start, filtered: start, smoothed: start });
    let (mut logarithms, mut squares, mut used, mut missed) = (0.0, 0.0, 0.0, 0);
    let (mut last_s, mut state) = (records[0].0, start);
    for &(time_s, turn) in &records[1..] {
        let mut expected = state.after(time_s - last_s, strength);
        let off = rotation_vector(expected.turn.inverse() * turn);
        let mut total = expected.variance[0] + noise;
        let far = off.length_squared() / total;
        logarithms += 1.5 * total.ln();
        squares += far.min(GATE);
        used += 3.0;
        if far > GATE {
            missed += 1;
            if missed < PERSISTENT {
                continue;
            }
            let pause_s = (time_s - last_s).max(1e-6);
            expected.variance[0] += off.length_squared();
            expected.variance[2] += off.length_squared() / (pause_s * pause_s);
            total = expected.variance[0] + noise;
        }
        missed = 0;
        let [a, b, c] = expected.variance;
        let (angle, speed) = (a / total, b / total);
        state = State {
            turn: (expected.turn * DQuat::from_scaled_axis(off * angle)).normalize(),
            rate: expected.rate + off * speed,
            variance: [a * (1.0 - angle), b * (1.0 - angle), c - b * speed],
        };
        last_s = time_s;
        nodes.push(Node { time_s, expected, filtered: state, smoothed: state });
    }
    let scale2: f64 = if used > 0.0 { squares / used } else { 1.0 };
    // The noise's size is free: with the best one, what is left is its logarithm.
    (nodes, logarithms + 0.5 * used * scale2.max(1e-12).ln(), scale2.sqrt())
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    /// A hand's motion, sixty records per second.
    fn truth(time_s: f64) -> DQuat {
        DQuat::from_rotation_y(0.4 * time_s + 0.3 * (1.7 * time_s).sin())
            * DQuat::from_rotation_x(0.5 * (0.6 * time_s).sin())
    }

    fn records(noise_rad: f64) -> Vec<(f64, DQuat)> {
        let mut random = StdRng::seed_from_u64(8);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        (0..1200)
            .map(|k| {
                let off = DVec3::new(normal(), normal(), normal()) * noise_rad;
                (f64::from(k) / 60.0, truth(f64::from(k) / 60.0) * DQuat::from_scaled_axis(off))
            })
            .collect()
    }

    /// Root mean square about an axis, actual and stated, between records.
    fn error_rad(smooth: &Smooth) -> (f64, f64) {
        let (mut actual, mut stated, mut count) = (0.0, 0.0, 0.0);
        for k in 30..1170 {
            let time_s = (f64::from(k) + 0.37) / 60.0;
            let state = smooth.at(time_s);
            actual += rotation_vector(truth(time_s).inverse() * state.turn).length_squared();
            stated += 3.0 * state.variance[0];
            count += 3.0;
        }
        (f64::sqrt(actual / count), f64::sqrt(stated / count))
    }

    #[test]
    fn jitter_falls_to_less_than_a_third_and_what_is_left_is_stated() {
        let noise = 0.75f64.to_radians();
        let smooth = Smooth::new(&records(noise));
        let (actual, stated) = error_rad(&smooth);
        println!("{:.3} of {:.3}, stated {:.3}", actual / noise, smooth.noise_rad / noise, stated / noise);
        assert!(actual < noise / 3.0);
        assert!((0.75..1.35).contains(&(actual / stated)), "{actual} {stated}");
        assert!((0.95..1.05).contains(&(smooth.noise_rad / noise)) && smooth.outliers == 0);
    }

    #[test]
    fn nothing_lags() {
        let smooth = Smooth::new(&records(0.75f64.to_radians()));
        // The error along the motion over the speed is a time.
        let (mut along, mut squares) = (0.0, 0.0);
        for k in 30..1170 {
            let time_s = f64::from(k) / 60.0;
            let speed = rotation_vector(truth(time_s - 0.01).inverse() * truth(time_s + 0.01)) / 0.02;
            along += rotation_vector(truth(time_s).inverse() * smooth.at(time_s).turn).dot(speed);
            squares += speed.length_squared();
        }
        let lag_s: f64 = along / squares;
        assert!(lag_s.abs() < 0.001, "{lag_s} s");
    }

    #[test]
    fn a_gap_is_bridged_and_less_sure() {
        let mut records = records(0.002);
        records.retain(|(time_s, _)| !(8.0..8.6).contains(time_s));
        let smooth = Smooth::new(&records);
        let state = smooth.at(8.3);
        let off = rotation_vector(truth(8.3).inverse() * state.turn).length();
        let sigma = state.variance[0].sqrt();
        assert!(sigma > 4.0 * smooth.at(7.0).variance[0].sqrt());
        assert!(off < 3.0 * 3f64.sqrt() * sigma, "{off} {sigma}");
        // Outside all records it is less sure with every moment.
        let later = [20.05, 20.3, 21.0].map(|time_s| smooth.at(time_s).variance[0]);
        assert!(later[0] < later[1] && later[1] < later[2], "{later:?}");
        let before = [-0.05, -0.3, -1.0].map(|time_s| smooth.at(time_s).variance[0]);
        assert!(before[0] < before[1] && before[1] < before[2], "{before:?}");
    }

    #[test]
    fn single_wrong_records_do_not_pull() {
        let mut wrong = records(0.004);
        for k in [200, 500, 501, 900] {
            wrong[k].1 *= DQuat::from_rotation_z(0.4);
        }
        let smooth = Smooth::new(&wrong);
        assert_eq!(smooth.outliers, 4);
        let off = |k: f64| rotation_vector(truth(k / 60.0).inverse() * smooth.at(k / 60.0).turn).length();
        assert!(off(200.0) < 0.012 && off(500.5) < 0.012, "{} {}", off(200.0), off(500.5));
    }
}

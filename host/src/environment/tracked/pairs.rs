//! Delay and mount from turns between consecutive photographs: the tracker's angular speed against the pictures' motion, robustly.

use glam::{DQuat, DVec3};
use nalgebra::{Matrix4, Vector4};

use super::{Known, Tracked};
use crate::tracker::{Turned, rotation_vector};

/// Delays that are tried, seconds.
const LONGEST_S: f64 = 0.5;
const STEP_S: f64 = 0.01;
/// Fewer pairs tell nothing: a mount has three angles and a delay is one number more.
const FEWEST: usize = 4;
/// Pairs farther off than so many standard deviations count less and less.
const ROBUST: f64 = 3.0;
const ROUNDS: usize = 12;

/// Two photographs and the turn between them as their corners have it.
#[derive(Debug, Clone, Copy)]
pub(in crate::environment) struct Pair {
    pub photographs: [usize; 2],
    /// Takes the camera frame of the second to that of the first.
    pub turn: DQuat,
    /// About each axis, radians.
    pub sigma_rad: f64,
}

impl Tracked {
    /// The turn that is expected between two photographs, and how far it can be off, standard deviation about each axis, radians.
    pub(in crate::environment) fn expected(&self, [i, j]: [usize; 2], known: &Known) -> (DQuat, f64) {
        let [from, to] = [i, j].map(|i| self.track.at(self.times_s[i] - known.delay_s));
        let turn = between(&from, &to, known.mount);
        let late = (from.rate - to.rate).length() * self.delay_sigma_s();
        let askew = 2.0 * (rotation_vector(turn).length() / 2.0).sin() * self.mount_sigma_rad();
        let jitter = from.sigma_rad.hypot(to.sigma_rad);
        (turn, (late * late + askew * askew + jitter * jitter).sqrt())
    }

    /// Delay and mount from such pairs; as before where there are too few.
    pub(in crate::environment) fn known_by_pairs(&self, pairs: &[Pair]) -> Known {
        let before = self.before();
        if pairs.len() < FEWEST {
            return before;
        }
        let steps = (LONGEST_S / STEP_S) as i32;
        let grid = (-steps..=steps).map(|step| before.delay_s + STEP_S * f64::from(step));
        let Some(best) = grid
            .map(|delay_s| self.solve(pairs, &before, (delay_s, before.mount), false))
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
        else {
            return before;
        };
        let solved = self.solve(pairs, &before, (best.delay_s, best.mount), true);
        let mut known = Known { delay_s: solved.delay_s, mount: solved.mount, ..before };
        for i in 0..4 {
            (0..4).for_each(|j| known.covariance[(i, j)] = solved.covariance[(i, j)]);
        }
        known
    }

    /// Gauss-Newton on the mount and, if it is free, on the delay.
    fn solve(&self, pairs: &[Pair], before: &Known, start: (f64, DQuat), is_free: bool) -> Solved {
        let (mut delay_s, mut mount) = start;
        let mut cost = f64::INFINITY;
        let mut covariance = Matrix4::zeros();
        let rounds = if is_free { ROUNDS } else { ROUNDS / 2 };
        for _ in 0..rounds {
            let mut normal = Matrix4::zeros();
            let mut right = Vector4::zeros();
            cost = 0.0;
            let mut far = vec![];
            for pair in pairs {
                let [from, to] = pair.photographs.map(|i| self.track.at(self.times_s[i] - delay_s));
                let variance = from.sigma_rad.powi(2) + to.sigma_rad.powi(2) + pair.sigma_rad.powi(2);
                let said = between(&from, &to, mount);
                let off = rotation_vector(said.inverse() * pair.turn);
                let ratio = off.length_squared() / variance;
                far.push(ratio);
                let weight = 1.0 / (variance * (1.0 + ratio / (ROBUST * ROBUST)));
                cost += 0.5 * ROBUST * ROBUST * (ratio / (ROBUST * ROBUST)).ln_1p();
                // The end turns with its speed and the start with its own, seen from the end.
                let back = said.inverse();
                let late = mount.inverse() * to.rate - back * (mount.inverse() * from.rate);
                let columns = [late, DVec3::X, DVec3::Y, DVec3::Z];
                let by = |k: usize| if k == 0 { columns[0] } else { back * columns[k] - columns[k] };
                let by = std::array::from_fn::<DVec3, 4, _>(by);
                for a in 0..4 {
                    (0..4).for_each(|b| normal[(a, b)] += weight * by[a].dot(by[b]));
                    right[a] -= weight * by[a].dot(off);
                }
            }
            let (late, askew) = (delay_s - before.delay_s, rotation_vector(before.mount.inverse() * mount));
            let [sure_s, sure_rad] =
                [self.delay_sigma_s(), self.mount_sigma_rad()].map(|sigma: f64| sigma.powi(-2));
            cost += 0.5 * (late * late * sure_s + askew.length_squared() * sure_rad);
            normal[(0, 0)] += sure_s;
            right[0] -= late * sure_s;
            for c in 0..3 {
                normal[(1 + c, 1 + c)] += sure_rad;
                right[1 + c] -= askew[c] * sure_rad;
            }
            if !is_free {
                (1..4).for_each(|k| (normal[(0, k)], normal[(k, 0)]) = (0.0, 0.0));
                right[0] = 0.0;
            }
            let Some(inverse) = normal.try_inverse() else { break };
            let step = inverse * right;
            delay_s += step[0].clamp(-0.05, 0.05);
            let turn = DVec3::new(step[1], step[2], step[3]).clamp_length_max(0.3);
            mount = (mount * DQuat::from_scaled_axis(turn)).normalize();
            far.sort_by(f64::total_cmp);
            // The median of three squares is 2.366 of their variance.
            covariance = inverse * (far[far.len() / 2] / 2.366).max(1.0);
        }
        Solved { delay_s, mount, cost, covariance }
    }
}

struct Solved {
    delay_s: f64,
    mount: DQuat,
    cost: f64,
    covariance: Matrix4<f64>,
}

/// Takes the camera frame at the second time to that at the first.
fn between(from: &Turned, to: &Turned, mount: DQuat) -> DQuat {
    mount.inverse() * from.orientation.inverse() * to.orientation * mount
}

//! Delay, mount and drift from photographs whose orientations their corners tell, all at once.

use glam::{DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

use super::{Known, Tracked, column, jacobian};
use crate::tracker::rotation_vector;

/// So many photographs at least.
const FEWEST: usize = 6;
/// How well corners tell an orientation at worst, radians.
const CORNERS_RAD: f64 = 0.001;
/// All orientations may be turned together, radians.
const TOGETHER_RAD: f64 = 0.2;
/// Photographs farther off than so many standard deviations count less and less; so far, the tracker is said to be wrong there.
const ROBUST: f64 = 3.0;
const WRONG: f64 = 4.5;
const ROUNDS: usize = 15;
/// The session is taken apart into so many pieces to see how sure the delay is.
const PIECES: usize = 10;

impl Tracked {
    /// What is known with the orientations (camera frame to the world) of these photographs, which are in the order of time. The delay's
    /// standard deviation is the larger of the adjustment's and the jackknife's over tenths of the session, as neighbours err alike.
    pub(in crate::environment) fn known_by_views(&self, views: &[(usize, DQuat)], start: &Known) -> Known {
        let before = self.before();
        if views.len() < FEWEST {
            return start.clone();
        }
        let mut known = Known { off_rad: before.off_rad.clone(), ..start.clone() };
        let Some(scale) = self.adjust(views, &before, &mut known, ROUNDS) else { return start.clone() };
        let pieces = PIECES.min(views.len());
        let tenth = |i: usize| i * pieces / views.len();
        let without = |piece: usize| {
            let rest: Vec<(usize, DQuat)> =
                (0..views.len()).filter(|&i| tenth(i) != piece).map(|i| views[i]).collect();
            let mut known = known.clone();
            self.adjust(&rest, &before, &mut known, 4)?;
            Some(known.delay_s)
        };
        let delays_s: Vec<f64> = (0..pieces).filter_map(without).collect();
        let mean = delays_s.iter().sum::<f64>() / delays_s.len().max(1) as f64;
        let squares: f64 = delays_s.iter().map(|delay| (delay - mean) * (delay - mean)).sum();
        let jackknife = squares * (1.0 - 1.0 / delays_s.len().max(1) as f64);
        known.covariance[(0, 0)] = known.covariance[(0, 0)].max(jackknife);
        self.find_wrong(views, &mut known, scale);
        known
    }

    /// Gauss-Newton with Cauchy's weights; how many of its standard deviations a photograph is off, in the median.
    fn adjust(
        &self,
        views: &[(usize, DQuat)],
        before: &Known,
        known: &mut Known,
        rounds: usize,
    ) -> Option<f64> {
        let size = known.covariance.nrows();
        let mut scale = 1f64;
        for _ in 0..rounds {
            let mut normal = DMatrix::<f64>::zeros(size, size);
            let mut right = DVector::<f64>::zeros(size);
            let mut far = vec![];
            for &(photograph, turn) in views {
                let (off, variance, by) = self.off(photograph, turn, known);
                let ratio = off.length_squared() / variance;
                far.push(ratio);
                let weight = 1.0 / (variance * (1.0 + ratio / (ROBUST * scale).powi(2)));
                normal += by.transpose() * &by * weight;
                right += by.transpose() * column(off) * weight;
            }
            self.add_before(before, known, &mut normal, &mut right);
            let cholesky = normal.cholesky()?;
            let step = cholesky.solve(&right);
            known.delay_s += step[0].clamp(-0.05, 0.05);
            let vector = |i: usize| DVec3::new(step[i], step[i + 1], step[i + 2]).clamp_length_max(0.2);
            known.mount = (known.mount * DQuat::from_scaled_axis(vector(1))).normalize();
            for (k, drift) in known.drift.iter_mut().enumerate() {
                *drift += vector(4 + 3 * k);
            }
            far.sort_by(f64::total_cmp);
            // The median of three squares is 2.366 of their variance.
            scale = (far[far.len() / 2] / 2.366).sqrt().max(1.0);
            known.covariance = cholesky.inverse() * (scale * scale);
        }
        Some(scale)
    }

    /// How far a photograph is off what the tracker says, in its frame, with the variance of that and how what the tracker says changes.
    fn off(&self, photograph: usize, turn: DQuat, known: &Known) -> (DVec3, f64, DMatrix<f64>) {
        let taken_s = self.times_s[photograph] - known.delay_s;
        let at = self.track.at(taken_s);
        let bends = known.bends(taken_s);
        let said = DQuat::from_scaled_axis(known.drift_at(bends)) * at.orientation * known.mount;
        let off = rotation_vector(said.inverse() * turn);
        let variance = at.sigma_rad.powi(2) + CORNERS_RAD * CORNERS_RAD;
        (off, variance, jacobian(known, said, at.rate, bends))
    }

    /// What was known before any photograph: delay, mount, and how slowly the drift changes.
    fn add_before(&self, before: &Known, known: &Known, normal: &mut DMatrix<f64>, right: &mut DVector<f64>) {
        let mut add = |i: usize, away: f64, sigma2: f64| {
            normal[(i, i)] += 1.0 / sigma2;
            right[i] -= away / sigma2;
        };
        add(0, known.delay_s - before.delay_s, self.delay_sigma_s().powi(2));
        let askew = rotation_vector(before.mount.inverse() * known.mount);
        (0..3).for_each(|c| add(1 + c, askew[c], self.mount_sigma_rad().powi(2)));
        (0..3).for_each(|c| add(4 + c, known.drift[0][c], TOGETHER_RAD * TOGETHER_RAD));
        for (k, pair) in known.bends_s.windows(2).enumerate() {
            let weight = 1.0 / self.step_rad2(pair);
            let bent = known.drift[k + 1] - known.drift[k];
            for c in 0..3 {
                let (i, j) = (4 + 3 * k + c, 4 + 3 * (k + 1) + c);
                normal[(i, i)] += weight;
                normal[(j, j)] += weight;
                normal[(i, j)] -= weight;
                normal[(j, i)] -= weight;
                right[i] += weight * bent[c];
                right[j] -= weight * bent[c];
            }
        }
    }

    /// Where the tracker is far off what the photographs say, it is as unsure; so it is for photographs beside these whose corners tell
    /// nothing.
    fn find_wrong(&self, views: &[(usize, DQuat)], known: &mut Known, scale: f64) {
        let off = |&(photograph, turn): &(usize, DQuat)| {
            let (off, variance, _) = self.off(photograph, turn, known);
            let is_wrong = off.length() > WRONG * scale * variance.sqrt();
            (photograph, if is_wrong { off.length() } else { 0.0 })
        };
        let told: Vec<(usize, f64)> = views.iter().map(off).collect();
        for photograph in 0..known.off_rad.len() {
            let after = told.partition_point(|(told, _)| *told < photograph);
            let at = |i: usize| told.get(i).map_or(0.0, |(_, off)| *off);
            known.off_rad[photograph] = match told.get(after) {
                Some((told, off)) if *told == photograph => *off,
                _ => at(after).max(after.checked_sub(1).map_or(0.0, at)),
            };
        }
    }
}

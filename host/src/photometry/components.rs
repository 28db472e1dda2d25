//! What of the views' gains is the lamp's: variance components, estimated from the gains themselves.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// The lamp's slow drift is forgotten over this part of the session; the surface's look over this angle, radians.
const FORGOTTEN: f64 = 0.3;
const ALIKE_RAD: f64 = 0.7;
/// Standard deviations that are tried.
const LEAST: f64 = 3e-4;
const RATIO: f64 = 1.8;
const TRIED: i32 = 13;
/// Twice the gain in log likelihood, less the price of the components, beyond which a lamp that varies is no chance.
const CHANCE: f64 = 8.0;
/// Rounds over the components at most.
const ROUNDS: usize = 4;

/// Where and when the views were taken: unit vectors (none where the surface's look is known not to change), times from 0 to 1.
pub(super) struct Views<'a> {
    pub direction: &'a [DVec3],
    pub time: &'a [f64],
}

/// The lamp's part of one mix of channels, logarithms with mean 0.
#[derive(Debug, Clone)]
pub(super) struct Component {
    /// Whether there is a lamp's part that is no chance; all of it is 0 otherwise.
    pub is_there: bool,
    pub lamp: Vec<f64>,
    pub variance: Vec<f64>,
    /// Standard deviations: from view to view, slowly in time, with direction.
    sigma: [f64; 3],
}

impl Component {
    pub fn find(value: &DVector<f64>, covariance: &DMatrix<f64>, seen: &Views) -> Self {
        let views = value.len();
        let kernels = kernels(seen);
        // Nobody knows the mean.
        let open = covariance.add_scalar(1.0);
        let likelihood = |sigma: [f64; 3]| {
            let mut matrix = open.clone();
            for (kernel, sigma) in kernels.iter().zip(sigma).filter(|(_, sigma)| *sigma > 0.0) {
                matrix += kernel * (sigma * sigma);
            }
            let Some(factor) = matrix.cholesky() else { return f64::NEG_INFINITY };
            let ln_root = factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
            -ln_root - 0.5 * value.dot(&factor.solve(value))
        };
        // A component that explains no more than it costs is left out (Schwarz: the logarithm of the number of views for each).
        let price = 0.5 * (views as f64).ln();
        let best = |choices: &[&[usize]]| {
            let climbed = choices.iter().map(|free| {
                let (found, sigma) = climb(free, &likelihood);
                (found - price * free.len() as f64, sigma)
            });
            climbed.fold((f64::NEG_INFINITY, [0.0; 3]), |best, one| if one.0 > best.0 { one } else { best })
        };
        let without = best(&[&[], &[2]]);
        let with = best(&[&[0], &[1], &[0, 1], &[0, 2], &[1, 2], &[0, 1, 2]]);
        let is_there = 2.0 * (with.0 - without.0) > CHANCE;
        let none = vec![0.0; views];
        if !is_there {
            return Self { is_there, lamp: none.clone(), variance: none, sigma: without.1 };
        }
        let sigma = with.1;
        let lamp = &kernels[0] * sigma[0].powi(2) + &kernels[1] * sigma[1].powi(2);
        let all = &open + &lamp + &kernels[2] * sigma[2].powi(2);
        let Some(factor) = all.cholesky() else {
            return Self { is_there: false, lamp: none.clone(), variance: none, sigma: without.1 };
        };
        let mean = &lamp * factor.solve(value);
        let after = &lamp - &lamp * factor.solve(&lamp);
        // Relative to the mean over the views.
        let centre = mean.mean();
        let (by_view, total) = (after.column_mean(), after.mean());
        Self {
            is_there,
            lamp: mean.iter().map(|value| value - centre).collect(),
            variance: (0..views).map(|v| (after[(v, v)] - 2.0 * by_view[v] + total).max(0.0)).collect(),
            sigma,
        }
    }

    /// How much the gains vary with the direction, where nobody can tell the lamp from the surface's look; they vary by
    /// `all` altogether.
    pub fn look(&self, all: f64) -> f64 {
        self.sigma[2].min(all)
    }

    /// Root mean square over the views.
    pub fn spread(&self) -> f64 {
        (self.lamp.iter().map(|value| value * value).sum::<f64>() / self.lamp.len().max(1) as f64).sqrt()
    }

    /// What is known of the gains before they are measured: the covariance of the lamp's part, where it counts, and of the surface's; no
    /// less than `held`, and nothing of the mean.
    pub fn prior(&self, seen: &Views, lamp: bool, held: f64) -> DMatrix<f64> {
        let mut prior =
            DMatrix::from_diagonal_element(seen.time.len(), seen.time.len(), held * held).add_scalar(1.0);
        for (i, kernel) in kernels(seen).iter().enumerate().filter(|(i, _)| *i == 2 || lamp) {
            prior += kernel * self.sigma[i].powi(2);
        }
        prior
    }
}

/// Correlations between views: of what is independent, what goes with time, what goes with direction.
fn kernels(seen: &Views) -> [DMatrix<f64>; 3] {
    let views = seen.time.len();
    let time = |i: usize, k: usize| (-(seen.time[i] - seen.time[k]).abs() / FORGOTTEN).exp();
    let direction = |i: usize, k: usize| match (seen.direction.get(i), seen.direction.get(k)) {
        (Some(a), Some(b)) => (-a.angle_between(*b) / ALIKE_RAD).exp(),
        _ => 0.0,
    };
    [
        DMatrix::identity(views, views),
        DMatrix::from_fn(views, views, time),
        DMatrix::from_fn(views, views, direction),
    ]
}

/// The likeliest standard deviations, those of `free` being tried in turn, the others 0.
fn climb(free: &[usize], likelihood: &(impl Fn([f64; 3]) -> f64 + Sync)) -> (f64, [f64; 3]) {
    let mut best = (likelihood([0.0; 3]), [0.0; 3]);
    for _ in 0..ROUNDS {
        let before = best.0;
        for &k in free {
            let tried: Vec<(f64, [f64; 3])> = (-1..TRIED)
                .into_par_iter()
                .map(|i| {
                    let mut sigma = best.1;
                    sigma[k] = if i < 0 { 0.0 } else { LEAST * RATIO.powi(i) };
                    (likelihood(sigma), sigma)
                })
                .collect();
            for one in tried {
                if one.0 > best.0 {
                    best = one;
                }
            }
        }
        if best.0 - before < 0.01 {
            break;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::sampling::spiral;

    fn normal(random: &mut StdRng) -> f64 {
        (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
    }

    /// Gains of a lamp that flickers by `flicker`, seen with an error of `noise`, of a surface that adds what `look` says.
    fn found(flicker: f64, noise: f64, look: impl Fn(DVec3) -> f64, seed: u64) -> (Component, Vec<f64>) {
        let mut random = StdRng::seed_from_u64(seed);
        let direction = spiral(60, 1.2).unwrap();
        // In no order of direction.
        let time: Vec<f64> = (0..60).map(|i| f64::from(i * 37 % 60) / 59.0).collect();
        let truth: Vec<f64> = (0..60).map(|_| flicker * normal(&mut random)).collect();
        let mean = truth.iter().sum::<f64>() / 60.0;
        let value =
            DVector::from_fn(60, |v, _| truth[v] - mean + look(direction[v]) + noise * normal(&mut random));
        let covariance = DMatrix::from_diagonal_element(60, 60, noise * noise);
        let component = Component::find(&value, &covariance, &Views { direction: &direction, time: &time });
        (component, truth.iter().map(|value| value - mean).collect())
    }

    #[test]
    fn a_flicker_is_found_as_surely_as_it_is_said() {
        let (mut within, mut all) = (0, 0);
        for seed in 0..12 {
            let (component, truth) = found(0.02, 0.005, |_| 0.0, seed);
            assert!(component.is_there && (component.spread() / 0.02 - 1.0).abs() < 0.3);
            for (v, truth) in truth.iter().enumerate() {
                within += u32::from((component.lamp[v] - truth).abs() <= component.variance[v].sqrt());
                all += 1;
            }
        }
        let share = f64::from(within) / f64::from(all);
        assert!((0.63..0.73).contains(&share), "{share}");
    }

    #[test]
    fn noise_and_a_look_that_changes_with_direction_are_no_lamp() {
        let mut there = 0;
        for seed in 0..20 {
            there += u32::from(found(0.0, 0.01, |_| 0.0, seed).0.is_there);
            there += u32::from(found(0.0, 0.01, |d| 0.05 * d.x + 0.1 * d.z * d.y, seed).0.is_there);
        }
        assert!(there <= 1, "{there} of 40");
    }
}

//! What cameras' responses look like before a photograph is seen.
//!
//! Photographs three stops apart leave every ripple of three stops' period open: the prior decides. It is a Gaussian process
//! (Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, chapters 2 and 5) for the deviation of ln
//! exposure from sRGB's: any factor, any gamma, S-shaped curves that are smooth over the level, toes that are smooth over its
//! logarithm, and a little roughness, whose size the photographs choose by their evidence (equation 5.8).

use nalgebra::{DMatrix, DVector};

use super::rows::{KNOTS, knot_levels};

/// Where ln(level + SOFTENING) turns from linear to logarithmic, in 256ths of white.
const SOFTENING: f64 = 6.0;
/// Standard deviation of the factor, and of the exponent.
const FACTOR: f64 = 1.0;
const EXPONENT: f64 = 1.0;
/// Standard deviation and length of what is smooth over the level (white is 1), and over its logarithm.
const BEND: (f64, f64) = (1.0, 0.5);
const TOE: (f64, f64) = (0.6, 1.5);
/// Standard deviations of what is rough over the logarithm of the level, to choose from, and its length.
const ROUGH: [f64; 5] = [0.001, 0.003, 0.01, 0.03, 0.1];
const ROUGH_LENGTH: f64 = 0.5;
/// Keeps the matrix from being singular in numbers of 16 digits.
const JITTER: f64 = 1e-8;

/// The inverse covariance of the deviation from the baseline, KNOTS x KNOTS, with its determinant.
pub(super) struct Prior {
    pub precision: DMatrix<f64>,
    pub ln_determinant: f64,
}

/// One prior for each size of the roughness, from smooth to rough.
pub(super) fn priors() -> Vec<Prior> {
    let levels: Vec<f64> = knot_levels().collect();
    let logs: Vec<f64> = levels.iter().map(|level| (255.0 * level + SOFTENING).ln()).collect();
    let middle = logs[KNOTS / 2];
    let even = |distance: f64, (sigma, length): (f64, f64)| {
        sigma * sigma * (-0.5 * (distance / length).powi(2)).exp()
    };
    ROUGH
        .iter()
        .filter_map(|rough| {
            let covariance = DMatrix::from_fn(KNOTS, KNOTS, |i, k| {
                // Twice differentiable (Matérn 5/2): rough, but no noise.
                let r = 5f64.sqrt() * (logs[i] - logs[k]).abs() / ROUGH_LENGTH;
                FACTOR * FACTOR
                    + EXPONENT * EXPONENT * (logs[i] - middle) * (logs[k] - middle)
                    + even(levels[i] - levels[k], BEND)
                    + even(logs[i] - logs[k], TOE)
                    + rough * rough * (1.0 + r + r * r / 3.0) * (-r).exp()
                    + if i == k { JITTER } else { 0.0 }
            });
            let factor = covariance.cholesky()?;
            let ln_determinant = -2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
            Some(Prior { precision: factor.inverse(), ln_determinant })
        })
        .collect()
}

/// A curve that the photographs make likely: its deviation from the baseline, and how sure it is.
pub(super) struct Posterior {
    /// Deviation of ln exposure from the baseline, per knot.
    pub deviation: DVector<f64>,
    /// Its inverse covariance.
    pub precision: DMatrix<f64>,
}

/// The posterior under the prior with the greatest evidence, for normal equations in the deviation from the baseline.
pub(super) fn posterior(priors: &[Prior], matrix: &DMatrix<f64>, right: &DVector<f64>) -> Option<Posterior> {
    let mut best: Option<(f64, Posterior)> = None;
    for prior in priors {
        let precision = matrix + &prior.precision;
        let Some(factor) = precision.clone().cholesky() else { continue };
        let deviation = factor.solve(right);
        let ln_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        let evidence = 0.5 * (prior.ln_determinant - ln_determinant + deviation.dot(right));
        if best.as_ref().is_none_or(|(most, _)| evidence > *most) {
            best = Some((evidence, Posterior { deviation, precision }));
        }
    }
    best.map(|(_, posterior)| posterior)
}

//! A quadratic in the direction fitted to the logarithm of radiance: six numbers for each channel.
//!
//! From a dozen views in a narrow cone no highlight's centre and no harmonics can be found; the logarithm of radiance
//! is there still close to a quadratic (it is exactly one for a Gaussian lobe), and never turns negative.

use glam::{DVec3, Vec3};
use nalgebra::{Matrix6, Matrix6x3, Vector6};

use super::weights::Samples;

/// 1, x, y, x², xy, y² of a unit vector.
pub(super) fn terms(direction: Vec3) -> [f64; 6] {
    let (x, y) = (f64::from(direction.x), f64::from(direction.y));
    [1.0, x, y, x * x, x * y, y * y]
}

/// What each unit of the quadratic's slope and curvature about the views' centre costs, in mean squared log radiance.
/// Of a ladder of half decades, generalised cross-validation picks this or the step below for a glossy desk seen in 13
/// photographs, and held-out photographs agree.
const RIDGE: f64 = 1e-4;

/// An exponential runs away where no view holds it: nowhere is the model brighter than this times the brightest
/// observation. Flattening the quadratic instead doubles the error beside the views.
const BRIGHTEST: f64 = 4.0;

/// The logarithm has no black.
const BLACK: f64 = 1e-30;

/// The 6 × 3 coefficients (term by term, R G B each) and the logarithm of the greatest radiance; `None` without a
/// sample of positive radiance. A channel that is black on average is black.
pub(super) fn fit(samples: &Samples) -> Option<[[f64; 3]; 7]> {
    let total: f64 = samples.weights.iter().sum();
    let mean = samples.mean();
    // Far below the mean a logarithm is noise.
    let least = mean.map(|l| (1e-3 * l).max(BLACK));
    if !(mean.iter().any(|l| *l > 0.0) && total > 0.0) {
        return None;
    }
    let centre = samples.directions.iter().sum::<DVec3>() / samples.len() as f64;
    let (mut gram, mut right, mut sum) = (Matrix6::zeros(), Matrix6x3::zeros(), 0.0);
    for ((direction, radiance), weight) in
        samples.directions.iter().zip(&samples.radiance).zip(&samples.weights)
    {
        let row = Vector6::from(terms((*direction - centre).as_vec3()));
        let brightness = (radiance[0] + radiance[1] + radiance[2]) / 3.0;
        // An error of the logarithm is an error of radiance divided by the radiance.
        let weight = weight * brightness.max(0.0).powi(2);
        sum += weight;
        gram.ger(weight, &row, &row, 1.0);
        for c in 0..3 {
            let log = if mean[c] > 0.0 { radiance[c].max(least[c]).ln() } else { BLACK.ln() };
            for i in 0..6 {
                right[(i, c)] += weight * row[i] * log;
            }
        }
    }
    if sum <= 0.0 {
        return None;
    }
    for i in 1..6 {
        gram[(i, i)] += RIDGE * sum;
    }
    let found = about_the_axis(&gram.cholesky()?.solve(&right), centre);
    let brightest = |c: usize| samples.radiance.iter().fold(least[c], |most, radiance| most.max(radiance[c]));
    let most =
        std::array::from_fn(|c| if mean[c] > 0.0 { (BRIGHTEST * brightest(c)).ln() } else { BLACK.ln() });
    let [a, b, c, d, e, f] = found;
    Some([a, b, c, d, e, f, most])
}

/// The same quadratic with x and y counted from the axis, so that the file needs no centre.
fn about_the_axis(found: &Matrix6x3<f64>, centre: DVec3) -> [[f64; 3]; 6] {
    let (u, v) = (centre.x, centre.y);
    std::array::from_fn(|i| {
        std::array::from_fn(|c| {
            let [k, x, y, xx, xy, yy] = std::array::from_fn(|j| found[(j, c)]);
            match i {
                0 => k - x * u - y * v + xx * u * u + xy * u * v + yy * v * v,
                1 => x - 2.0 * xx * u - xy * v,
                2 => y - 2.0 * yy * v - xy * u,
                3 => xx,
                4 => xy,
                _ => yy,
            }
        })
    })
}

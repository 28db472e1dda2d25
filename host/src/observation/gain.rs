//! One gain for each view: where nobody knows exposure times, and where the lamp drifted.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use crate::{Error, Result};

/// A drift is removed where its chi-squared of two degrees of freedom is beyond noise once in a thousand times, and where it
/// changes the light by more than this, relative, from its brightest to its darkest.
const DRIFT_CHI_SQUARED: f64 = 13.8;
const LEAST_DRIFT: f64 = 0.01;
/// A drift is not looked for where the directions explain more than this part of the order of capture (a tour from the top
/// down, ring by ring): whatever the surface does beyond a quadratic would pass for the lamp's.
const MOST_EXPLAINED: f64 = 0.5;

/// The gains of a lamp that drifted slowly, quadratic in the order of capture, geometric mean 1; `None` where what the views
/// show is no drift beyond its standard deviation.
///
/// How bright a surface looks depends on the direction as well: that is taken for a quadratic in the direction, together with
/// the drift, so that a drift that the order of the directions might explain is not beyond its standard deviation. Neighbours
/// that err alike count for less.
///
/// `logs` as for [`estimate`]; `directions` from the surface to the camera, in the order of capture.
pub(super) fn drift(logs: &[Vec<f32>], names: &[String], directions: &[DVec3]) -> Option<Vec<f64>> {
    let n = directions.len();
    // Texels beyond this number take time and change nothing.
    let some: Vec<Vec<f32>> = logs.iter().step_by(logs.len().div_ceil(600).max(1)).cloned().collect();
    let gains: Vec<f64> = estimate(&some, names).ok()?.iter().map(|gain| gain.ln()).collect();
    let order = |view: usize| 2.0 * view as f64 / (n as f64 - 1.0) - 1.0;
    let columns = |view: usize| {
        let (o, d) = (order(view), directions[view].normalize());
        [o, o * o - 1.0 / 3.0, 1.0, d.x, d.y, d.z, d.x * d.x, d.x * d.y, d.y * d.y]
    };
    const COLUMNS: usize = 9;
    if n < 3 * COLUMNS {
        return None;
    }
    let design = DMatrix::from_fn(n, COLUMNS, |view, k| columns(view)[k]);
    let order_of_capture = design.column(0).into_owned();
    let of_direction = design.columns(2, COLUMNS - 2).into_owned();
    let ridge = DMatrix::<f64>::identity(COLUMNS - 2, COLUMNS - 2) * 1e-6;
    let normal = of_direction.transpose() * &of_direction + ridge;
    let explained_by =
        &of_direction * normal.cholesky()?.solve(&(of_direction.transpose() * &order_of_capture));
    let left = (&order_of_capture - explained_by).norm_squared() / order_of_capture.norm_squared();
    if left < 1.0 - MOST_EXPLAINED {
        return None;
    }
    let observed = DVector::from_vec(gains);
    let mut weights = DVector::from_element(n, 1.0);
    let (mut found, mut residuals, mut inverse) =
        (DVector::zeros(COLUMNS), observed.clone(), DMatrix::zeros(0, 0));
    for _ in 0..10 {
        let weighted = DMatrix::from_fn(n, COLUMNS, |view, k| weights[view] * design[(view, k)]);
        let ridge = DMatrix::<f64>::identity(COLUMNS, COLUMNS) * 1e-6;
        inverse = (design.transpose() * &weighted + ridge).cholesky()?.inverse();
        found = &inverse * (weighted.transpose() * &observed);
        residuals = &observed - &design * &found;
        let mut sizes: Vec<f64> = residuals.iter().map(|r| r.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        // Views into a highlight are no measure of the lamp.
        let limit = 2.0 * sizes[n * 683 / 1000].max(1e-6);
        weights = residuals.map(|r| (limit / r.abs().max(1e-12)).min(1.0));
    }
    let variance = (0..n).map(|i| weights[i] * residuals[i].powi(2)).sum::<f64>() / (n - COLUMNS) as f64;
    let lagged =
        (1..n).map(|i| residuals[i] * residuals[i - 1]).sum::<f64>() / residuals.norm_squared().max(1e-30);
    let alike = lagged.clamp(0.0, 0.95);
    let covariance = inverse.view((0, 0), (2, 2)) * (variance * (1.0 + alike) / (1.0 - alike)).max(1e-12);
    let slow = DVector::from_vec(vec![found[0], found[1]]);
    let chi_squared = slow.dot(&(covariance.cholesky()?.inverse() * &slow));
    let curve: Vec<f64> =
        (0..n).map(|view| found[0] * columns(view)[0] + found[1] * columns(view)[1]).collect();
    let mean = curve.iter().sum::<f64>() / n as f64;
    let (least, most) = curve.iter().fold((f64::MAX, f64::MIN), |(a, b), &c| (a.min(c), b.max(c)));
    (chi_squared > DRIFT_CHI_SQUARED && most - least > LEAST_DRIFT)
        .then(|| curve.iter().map(|c| (c - mean).exp()).collect())
}

/// Estimates the gain of each view from texels that several views measured: `logs[texel][view]` is the logarithm of the radiance
/// over gain, NaN where absent. Alternates between a texel's median over views and a view's median over texels, so that
/// highlights, which few views see in few texels, do not pull. The gains' geometric mean is 1.
///
/// What the surface does in the same way at all its texels (a highlight as large as the surface) cannot be told from a gain.
///
/// # Errors
/// [`Error::Request`] when a view shares no texel with the others.
pub(super) fn estimate(logs: &[Vec<f32>], names: &[String]) -> Result<Vec<f64>> {
    let views = names.len();
    let mut gains = vec![0f32; views];
    // A texel that a single view measured agrees with any gain: it must not vote for the present one.
    let shared = |texel: &&Vec<f32>| texel.iter().filter(|log| !log.is_nan()).count() >= 2;
    let logs: Vec<&Vec<f32>> = logs.iter().filter(shared).collect();
    for _ in 0..50 {
        let references: Vec<f32> =
            logs.iter().map(|texel| median(texel.iter().zip(&gains).map(|(log, gain)| log - gain))).collect();
        let mut change = 0f32;
        for view in 0..views {
            let gain = median(logs.iter().zip(&references).map(|(texel, reference)| texel[view] - reference));
            if gain.is_nan() {
                return Err(Error::request(
                    format!("view {} shows no texel that another view shows", names[view]),
                    "leave it out, or give its exposure time",
                ));
            }
            change = change.max((gain - gains[view]).abs());
            gains[view] = gain;
        }
        let mean = gains.iter().sum::<f32>() / views as f32;
        gains.iter_mut().for_each(|gain| *gain -= mean);
        if change < 1e-4 {
            break;
        }
    }
    Ok(gains.iter().map(|&gain| f64::from(gain).exp()).collect())
}

/// Median of the numbers that are not NaN; NaN of none.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.filter(|value| !value.is_nan()).collect();
    if values.is_empty() {
        return f32::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn gains_are_recovered_in_spite_of_highlights_and_gaps() {
        let truth = [0.5f32, 1.0, 2.0, 1.3];
        let names: Vec<String> = (0..4).map(|view| view.to_string()).collect();
        let mean = truth.iter().map(|gain| gain.ln()).sum::<f32>() / 4.0;
        let logs: Vec<Vec<f32>> = (0..200)
            .map(|texel| {
                let albedo = 0.1 + 0.004 * texel as f32;
                let radiance =
                    |view: usize| albedo + if texel % 4 == view && texel % 3 == 0 { 5.0 } else { 0.0 };
                let absent = |view: usize| (texel + view).is_multiple_of(7);
                (0..4)
                    .map(|view| if absent(view) { f32::NAN } else { (radiance(view) * truth[view]).ln() })
                    .collect()
            })
            .collect();
        for (gain, truth) in estimate(&logs, &names).unwrap().iter().zip(truth) {
            assert!((gain.ln() - f64::from(truth.ln() - mean)).abs() < 0.01, "{gain} {truth}");
        }
    }

    /// Logarithms of radiance of a shining board seen from directions in a scattered order, under a lamp that changes.
    fn board(seed: u64, drift: impl Fn(f64) -> f64) -> (Vec<Vec<f32>>, Vec<String>, Vec<DVec3>) {
        let mut random = StdRng::seed_from_u64(seed);
        let views = 75;
        let directions: Vec<DVec3> = (0..views)
            .map(|_| {
                let (azimuth, z) =
                    (random.random_range(0.0..std::f64::consts::TAU), random.random_range(0.3..1.0f64));
                let r = (1.0 - z * z).sqrt();
                DVec3::new(r * azimuth.cos(), r * azimuth.sin(), z)
            })
            .collect();
        let lamp = DVec3::new(0.3, -0.4, 0.86).normalize();
        let logs = (0..150)
            .map(|texel| {
                let albedo = 0.1 + 0.004 * f64::from(texel);
                let shine = if texel % 3 == 0 { 3.0 } else { 0.2 };
                let log = |(view, direction): (usize, &DVec3)| {
                    let radiance =
                        albedo * (1.0 + 0.2 * direction.z) + shine * direction.dot(lamp).max(0.0).powi(30);
                    let noise: f64 = random.random_range(-0.03..0.03);
                    (radiance.ln() + drift(view as f64 / 74.0) + noise) as f32
                };
                directions.iter().enumerate().map(log).collect()
            })
            .collect();
        (logs, (0..views).map(|view| view.to_string()).collect(), directions)
    }

    #[test]
    fn a_lamp_that_fades_is_found_and_a_steady_one_left_alone() {
        let (mut taken, mut missed) = (0, 0);
        for seed in 0..20 {
            let (logs, names, directions) = board(seed, |_| 0.0);
            taken += usize::from(drift(&logs, &names, &directions).is_some());
            let (logs, names, directions) = board(seed, |at| -0.08 * at);
            let Some(gains) = drift(&logs, &names, &directions) else {
                missed += 1;
                continue;
            };
            let fell = (gains[74] / gains[0]).ln();
            assert!((fell + 0.08).abs() < 0.03, "{seed}: {fell}");
            let mean = gains.iter().map(|gain| gain.ln()).sum::<f64>();
            assert!(mean.abs() < 1e-9);
        }
        println!("{taken} of 20 steady lamps taken for fading ones, {missed} of 20 fading ones missed");
        assert!(taken <= 1 && missed <= 4, "{taken} {missed}");
    }

    /// The patchwork capture, ring by ring from the top down, was "drifting" by 70 %: its error rose from 5 to 11 of 255.
    #[test]
    fn a_tour_ring_by_ring_tells_nothing_of_the_lamp() {
        let names: Vec<String> = (0..75).map(|view| view.to_string()).collect();
        let directions: Vec<DVec3> = (0..75)
            .map(|view| {
                let zenith = 0.05 + 1.2 * f64::from(view / 12) / 6.0;
                crate::geometry::unit_vector(f64::from(view % 12) * 0.52 + zenith, zenith)
            })
            .collect();
        // Brighter and brighter towards the horizon, as foils are, and not like a quadratic.
        let log = |d: &DVec3| (0.2 + (1.0 - d.z).powf(0.3) + 2.0 * (1.0 - d.z).powi(6)).ln() as f32;
        let logs = vec![directions.iter().map(log).collect::<Vec<f32>>(); 50];
        assert_eq!(drift(&logs, &names, &directions), None);
    }

    #[test]
    fn the_order_of_the_directions_is_not_taken_for_a_drift() {
        let (logs, names, mut directions) = board(1, |_| 0.0);
        let mut at: Vec<usize> = (0..75).collect();
        // From the top down: the board looks darker and darker.
        at.sort_by(|&a, &b| directions[b].z.total_cmp(&directions[a].z));
        let sorted: Vec<Vec<f32>> = logs.iter().map(|texel| at.iter().map(|&i| texel[i]).collect()).collect();
        directions.sort_by(|a, b| b.z.total_cmp(&a.z));
        assert_eq!(drift(&sorted, &names, &directions), None);
    }

    #[test]
    fn texels_of_a_single_view_do_not_pin_the_gains() {
        let names = ["a".to_string(), "b".to_string()];
        let mut logs = vec![vec![4f32.ln(), 0.0]; 40];
        logs.extend(vec![vec![1.0, f32::NAN]; 60]);
        logs.extend(vec![vec![f32::NAN, 2.0]; 60]);
        let gains = estimate(&logs, &names).unwrap();
        assert!((gains[0] / gains[1] - 4.0).abs() < 1e-3, "{gains:?}");
    }

    #[test]
    fn a_view_apart_from_the_others_is_named() {
        let mut logs = vec![vec![0.0, f32::NAN, 0.0]; 3];
        logs.extend(vec![vec![f32::NAN, 1.0, f32::NAN]; 3]);
        let error = estimate(&logs, &["a".into(), "b".into(), "c".into()]).unwrap_err().to_string();
        assert!(error.contains("view b"), "{error}");
    }
}

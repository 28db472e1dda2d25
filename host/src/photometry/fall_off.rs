//! The fall-off towards the corners, once it is known what of the views' gains is the lamp's.

use glam::DVec2;

use super::components::Views;
use super::equations::TERMS;
use super::estimate::{COMMON, Estimate, MIXES};
use super::looks::Texel;
use crate::calibration::{Photometry, Vignetting};

/// The fall-off is told where it is surer than this over the places where the surface was seen, and so many times larger than its
/// standard deviation there.
const SURE: f64 = 0.03;
const TIMES: f64 = 3.0;

/// The fall-off, given what gains the lamp explains.
pub(super) fn fall_off(
    estimate: &Estimate,
    seen: &Views,
    texels: &[Texel],
    (width, height): (u32, u32),
    found: &mut Photometry,
) {
    let views = estimate.unknowns.views();
    let n = estimate.unknowns.len();
    // What is known of the gains: as much as the lamp varies at all, and what the surface does in all texels alike.
    let mut information = estimate.solved.information.clone();
    let right = &information * estimate.unknowns.values();
    for (component, mix) in estimate.components(seen).iter().zip(MIXES) {
        // A drift that is to stay in the radiance is there all the same.
        let Some(inverse) =
            component.prior(seen, component.is_there, COMMON).cholesky().map(|factor| factor.inverse())
        else {
            continue;
        };
        for v in 0..views {
            for w in 0..views {
                for (a, b) in (0..9).map(|i| (i / 3, i % 3)) {
                    information[(3 * v + a, 3 * w + b)] += mix[a] * inverse[(v, w)] * mix[b];
                }
            }
        }
    }
    let Some(factor) = information.cholesky() else { return };
    let solution = factor.solve(&right);
    let inverse = factor.inverse();
    let first = n - TERMS;
    let mut vignetting = Vignetting::centred(width, height);
    let [a, b, c, x, y]: [f64; TERMS] = std::array::from_fn(|i| solution[first + i]);
    vignetting.coefficients = [a, b, c];
    vignetting.centre_x += x;
    vignetting.centre_y += y;
    vignetting.covariance = std::array::from_fn(|i| std::array::from_fn(|k| inverse[(first + i, first + k)]));
    vignetting.residual = estimate.residual;
    vignetting.settled = true;

    let pixels: Vec<DVec2> = texels.iter().flat_map(|texel| texel.pixel.iter().copied()).collect();
    // The scale is nobody's: what counts is by how much places differ.
    let slopes: Vec<[f64; TERMS]> = pixels.iter().map(|pixel| vignetting.ln_at(pixel.x, pixel.y).1).collect();
    let mean: [f64; TERMS] =
        std::array::from_fn(|i| slopes.iter().map(|s| s[i]).sum::<f64>() / slopes.len() as f64);
    let variance = |slope: &[f64; TERMS]| {
        let pairs = (0..TERMS * TERMS).map(|i| (i / TERMS, i % TERMS));
        pairs
            .map(|(i, k)| (slope[i] - mean[i]) * vignetting.covariance[i][k] * (slope[k] - mean[k]))
            .sum::<f64>()
    };
    let told = (slopes.iter().map(variance).sum::<f64>() / slopes.len() as f64).max(0.0).sqrt();
    // No surer than what models get wrong; the less the places of a texel differ, the more that counts.
    let sigma = told.hypot(COMMON * lever(texels, &vignetting));
    let wider = (sigma / told.max(1e-3 * COMMON)).powi(2);
    let own = vignetting.covariance.map(|row| row.map(|value| wider * value));
    let values: Vec<f64> = pixels.iter().map(|pixel| vignetting.ln_at(pixel.x, pixel.y).0).collect();
    let size = (scatter(&values) / values.len() as f64).sqrt();
    let (least, most) = values.iter().fold((f64::MAX, f64::MIN), |(l, m), v| (v.min(l), v.max(m)));
    if sigma > SURE {
        found.notes.push(format!(
            "no flats, and the views do not tell the vignetting (to {:.1} % only, where the surface was seen): it stays in the radiance; photograph flat fields",
            100.0 * sigma
        ));
    } else if size < TIMES * sigma {
        found.notes.push(format!(
            "no flats, and the views show no vignetting (to {:.2} %, where the surface was seen): nothing is changed",
            100.0 * sigma
        ));
    } else {
        vignetting.covariance = own;
        found.notes.push(format!(
            "no flats: vignetting is found from the overlapping views, {:.0} % from the brightest to the darkest place where the surface was seen, to {:.2} % there; it is removed",
            100.0 * (1.0 - (least - most).exp()),
            100.0 * sigma
        ));
        found.vignetting = Some(vignetting);
    }
}

/// How much more places differ in their distance from the centre (squared, as the fall-off goes) from texel to texel than within a texel from
/// view to view.
fn lever(texels: &[Texel], vignetting: &Vignetting) -> f64 {
    let (mut all, mut within) = (vec![], 0.0);
    for texel in texels.iter().filter(|texel| !texel.pixel.is_empty()) {
        let r2: Vec<f64> = texel.pixel.iter().map(|pixel| vignetting.ln_at(pixel.x, pixel.y).1[0]).collect();
        within += scatter(&r2);
        all.extend(r2);
    }
    (scatter(&all) / within.max(f64::MIN_POSITIVE)).sqrt()
}

/// Sum of the squares about the mean.
fn scatter(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}

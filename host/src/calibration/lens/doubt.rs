//! How sure a lens is.

use glam::DVec2;
use nalgebra::SMatrix;

use super::adjust::{Estimate, Sight, information, residuals};
use super::project::LENS;
use super::{LensCovariance, LensModel};
use crate::geometry::Lens;

/// Covariance and what belongs to it.
pub(super) struct Doubt {
    pub covariance: LensCovariance,
    pub excess: f64,
    pub rms_px: f64,
}

/// What may be in a term that was left out: it may move the corner of the picture by this share of its distance from the centre.
/// Lenses whose k1 is large have as a rule k2 and k3 of the order of its powers.
const LEFT_OUT: [f64; 3] = [0.02, 0.01, 0.005];
/// The tangential terms, about as large as decentred elements make them.
const LEFT_OUT_TANGENTIAL: f64 = 0.002;

/// The least squares' covariance; `None` where the boards leave a number of the lens open, or see too little of it.
pub(super) fn doubt(boards: &[Vec<Sight>], estimate: &Estimate, model: LensModel) -> Option<Doubt> {
    let (mut squares, mut weighted) = (0.0, 0.0);
    for (sights, pose) in boards.iter().zip(&estimate.poses) {
        for (residual, sight) in residuals(&estimate.lens, pose, sights)?.into_iter().zip(sights) {
            squares += residual.length_squared();
            weighted += sight.weight * residual.length_squared();
        }
    }
    let free = model.estimated();
    let unknowns = 6 * boards.len() + free.iter().filter(|free| **free).count();
    let count: usize = boards.iter().map(Vec::len).sum();
    let freedom = (2 * count).checked_sub(unknowns).filter(|freedom| *freedom > 0)?;
    let variance = (weighted / freedom as f64).max(1e-18);
    let (normal, parts, pulls) = information(boards, estimate)?;
    let excess = excess(&normal, &parts, &pulls, free, variance)?;
    let left_out = left_out(&estimate.lens);
    let scale: [f64; LENS] = std::array::from_fn(|k| 1.0 / normal[(k, k)].max(1e-300).sqrt());
    let known = SMatrix::<f64, LENS, LENS>::from_fn(|i, j| {
        let usual = if i == j && !free[i] { left_out[i].powi(-2) } else { 0.0 };
        (normal[(i, j)] / (variance * excess) + usual) * scale[i] * scale[j]
    });
    let inverse = known.cholesky()?.inverse();
    let covariance = std::array::from_fn(|i| std::array::from_fn(|j| inverse[(i, j)] * scale[i] * scale[j]));
    Some(Doubt { covariance, excess, rms_px: (squares / count as f64).sqrt() })
}

/// Standard deviations of the numbers of a lens that were left out; those that never are have none.
fn left_out(lens: &Lens) -> [f64; LENS] {
    let corner = DVec2::new(f64::from(lens.width) / lens.fx, f64::from(lens.height) / lens.fy) / 2.0;
    let r2 = corner.length_squared();
    let k1 = lens.k1.abs();
    let [first, second, third] = LEFT_OUT;
    let radial = |share: f64, power: i32, usual: f64| (share / r2.powi(power)).max(usual);
    let tangential = LEFT_OUT_TANGENTIAL;
    let (k2, k3) = (radial(second, 2, 2.0 * k1 * k1), radial(third, 3, 2.0 * k1.powi(3)));
    let never = f64::INFINITY;
    [never, never, never, never, radial(first, 1, 0.0), k2, tangential, tangential, k3]
}

type Square9 = SMatrix<f64, LENS, LENS>;

/// How much more the boards pull at the lens than the noise of their corners explains: the mean of gᵀ H⁻¹ g over the free numbers against what
/// noise would give. 1 where chance may explain it (two and a half standard deviations).
fn excess(
    normal: &Square9,
    parts: &[Square9],
    pulls: &[nalgebra::SVector<f64, LENS>],
    free: [bool; LENS],
    variance: f64,
) -> Option<f64> {
    let only = |matrix: &Square9, diagonal: f64| {
        Square9::from_fn(|i, j| match (free[i] && free[j], i == j) {
            (true, _) => matrix[(i, j)],
            (false, true) => diagonal,
            (false, false) => 0.0,
        })
    };
    let whole = only(normal, 1.0);
    let scale = nalgebra::SVector::<f64, LENS>::from_fn(|k, _| 1.0 / whole[(k, k)].max(1e-300).sqrt());
    let scaled = |matrix: &Square9| Square9::from_fn(|i, j| matrix[(i, j)] * scale[i] * scale[j]);
    let factor = scaled(&whole).cholesky()?;
    let unknowns = free.iter().filter(|free| **free).count() as f64;
    let (mut pulled, mut leverage) = (0.0, 0.0);
    for (part, pull) in parts.iter().zip(pulls) {
        let pull =
            nalgebra::SVector::<f64, LENS>::from_fn(|k, _| if free[k] { pull[k] * scale[k] } else { 0.0 });
        pulled += pull.dot(&factor.solve(&pull)) / variance;
        let share = factor.solve(&scaled(&only(part, 0.0)));
        leverage += (share * share).trace();
    }
    let expected = unknowns - leverage;
    if expected < 0.3 * unknowns {
        return Some(1.0);
    }
    let ratio = pulled / expected;
    let chance = (2.0 * leverage).sqrt() / expected;
    Some(if ratio > 1.0 + 2.5 * chance { ratio } else { 1.0 })
}

//! Real spherical harmonics and three ways to their coefficients.
//!
//! No photograph is taken from below the surface and none from its horizon, so the least-squares problem alone is
//! ill-posed (condition 4e8 for 36 coefficients). [`HarmonicsMethod::Smoothed`] adds the integral of the squared
//! Laplacian, which grows as (l (l + 1))², with a weight chosen by generalised cross-validation once for a surface.
//! The thesis's two methods are kept to be compared with.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

use std::f64::consts::PI;
use std::sync::LazyLock;

use glam::DVec3;
use nalgebra::{Cholesky, DMatrix, DVector};

use super::voronoi;

/// The most coefficients of one channel: order 10.
pub const MOST: usize = 100;
const ORDERS: usize = 10;

/// How the coefficients of spherical harmonics are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HarmonicsMethod {
    /// Weighted least squares on the directions themselves with a penalty on the Laplacian.
    Smoothed,
    /// Projection with radiance 0 below the horizon (the thesis's zero hemisphere): rings at the horizon.
    ZeroHemisphere,
    /// Least-squares optimal projection: quadrature over Voronoi cells and the inverse Gram matrix of the hemisphere
    /// (thesis, 12.4): less accurate than least squares on the samples.
    Lsop,
}

/// Factors of the recurrence for the normalised associated Legendre functions, by l and m.
static FACTORS: LazyLock<[[(f64, f64); ORDERS]; ORDERS]> = LazyLock::new(|| {
    let mut factors = [[(0.0, 0.0); ORDERS]; ORDERS];
    for l in 1..ORDERS {
        for m in 0..l {
            let (lf, mf) = (l as f64, m as f64);
            let a = ((4.0 * lf * lf - 1.0) / (lf * lf - mf * mf)).sqrt();
            let p = lf - 1.0;
            factors[l][m] =
                (a, if l > m + 1 { ((p * p - mf * mf) / (4.0 * p * p - 1.0)).sqrt() } else { 0.0 });
        }
    }
    factors
});

/// The real orthonormal harmonics below `order` (1 to 10) at a unit vector: `basis[l (l + 1) + m]`. No Condon-Shortley
/// phase: l = 1 is proportional to y, z, x.
pub fn basis(order: usize, direction: DVec3, basis: &mut [f64]) {
    let DVec3 { x, y, z } = direction;
    let factors = &*FACTORS;
    // (x + iy)^m carries the azimuth and the power of the sine of the zenith.
    let (mut re, mut im) = (1.0, 0.0);
    let mut diagonal = (1.0 / (4.0 * PI)).sqrt();
    for m in 0..order {
        if m > 0 {
            (re, im) = (re * x - im * y, re * y + im * x);
            diagonal *= ((2 * m + 1) as f64 / (2 * m) as f64).sqrt();
        }
        let scale = if m == 0 { 1.0 } else { std::f64::consts::SQRT_2 };
        let (mut before, mut legendre) = (0.0, diagonal);
        for l in m..order {
            if l > m {
                let (a, b) = factors[l][m];
                (before, legendre) = (legendre, a * (z * legendre - b * before));
            }
            basis[l * (l + 1) + m] = scale * legendre * re;
            if m > 0 {
                basis[l * (l + 1) - m] = scale * legendre * im;
            }
        }
    }
}

/// The normal equations of one texel, weights normalised to sum 1.
pub(super) struct Normal {
    /// AᵀWA, k × k.
    pub gram: DMatrix<f64>,
    /// AᵀWy, k × 3.
    pub right: DMatrix<f64>,
    /// yᵀWy summed over the channels.
    pub energy: f64,
    /// Number of samples.
    pub samples: usize,
}

pub(super) fn normal(order: usize, directions: &[DVec3], radiance: &[[f64; 3]], weights: &[f64]) -> Normal {
    let (n, k) = (directions.len(), order * order);
    let total: f64 = weights.iter().sum();
    let mut design = DMatrix::zeros(k, n);
    let mut values = DMatrix::zeros(n, 3);
    let mut energy = 0.0;
    for (i, direction) in directions.iter().enumerate() {
        let root = (weights[i] / total).sqrt();
        let mut column = design.column_mut(i);
        basis(order, *direction, column.as_mut_slice());
        column *= root;
        for c in 0..3 {
            values[(i, c)] = root * radiance[i][c];
            energy += values[(i, c)] * values[(i, c)];
        }
    }
    Normal { gram: &design * design.transpose(), right: &design * values, energy, samples: n }
}

/// The smoothness penalty of each coefficient: (l (l + 1))².
fn roughness(k: usize) -> impl Iterator<Item = f64> {
    (0..k).map(|i| {
        let l = (i as f64).sqrt().floor();
        (l * (l + 1.0)).powi(2)
    })
}

fn factor(normal: &Normal, penalty: f64) -> Option<Cholesky<f64, nalgebra::Dyn>> {
    let mut system = normal.gram.clone();
    for (i, rough) in roughness(system.nrows()).enumerate() {
        // The last term only keeps what no sample touches from being undefined when there is no penalty.
        system[(i, i)] += penalty * rough + 1e-15;
    }
    system.cholesky()
}

/// The k × 3 coefficients that minimise the weighted mean squared residual plus `penalty` times the roughness.
pub(super) fn smoothed(normal: &Normal, penalty: f64) -> Option<DMatrix<f64>> {
    factor(normal, penalty).map(|factor| factor.solve(&normal.right))
}

/// Generalised cross-validation (Golub, Heath, Wahba 1979), logarithm of the score for one texel; lower is better.
pub(super) fn cross_validation(normal: &Normal, penalty: f64) -> Option<f64> {
    let factor = factor(normal, penalty)?;
    let coefficients = factor.solve(&normal.right);
    let freedom = factor.solve(&normal.gram).trace();
    let residual = normal.energy - 2.0 * coefficients.dot(&normal.right)
        + coefficients.dot(&(&normal.gram * &coefficients));
    let left = 1.0 - freedom / normal.samples as f64;
    // A residual below rounding error says nothing about the choice.
    let residual = residual.max(1e-12 * normal.energy).max(f64::MIN_POSITIVE);
    (left > 1e-6).then(|| (residual / (left * left)).ln())
}

/// Directions spread evenly over the upper hemisphere (a Fibonacci lattice), each for the same solid angle.
pub(super) fn hemisphere(count: usize) -> impl Iterator<Item = DVec3> {
    let golden = PI * (1.0 + 5.0_f64.sqrt());
    (0..count).map(move |i| {
        let i = i as f64 + 0.5;
        let z = 1.0 - i / count as f64;
        let s = (1.0 - z * z).sqrt();
        DVec3::new(s * (golden * i).cos(), s * (golden * i).sin(), z)
    })
}

/// The inverse of the harmonics' Gram matrix over the upper hemisphere, as a factor.
pub(super) fn hemisphere_gram(order: usize) -> Option<Cholesky<f64, nalgebra::Dyn>> {
    let k = order * order;
    let count = 20_000;
    let mut gram = DMatrix::zeros(k, k);
    let mut row = DVector::zeros(k);
    for direction in hemisphere(count) {
        basis(order, direction, row.as_mut_slice());
        gram.ger(2.0 * PI / count as f64, &row, &row, 1.0);
    }
    gram.cholesky()
}

/// Σ cell × radiance × harmonic over the samples: quadrature with the solid angles of their Voronoi cells.
pub(super) fn projected(order: usize, directions: &[DVec3], radiance: &[[f64; 3]]) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(order * order, 3);
    let mut row = vec![0.0; order * order];
    for ((direction, cell), radiance) in directions.iter().zip(voronoi::cells_sr(directions)).zip(radiance) {
        basis(order, *direction, &mut row);
        for (i, value) in row.iter().enumerate() {
            for c in 0..3 {
                sum[(i, c)] += cell * radiance[c] * value;
            }
        }
    }
    sum
}

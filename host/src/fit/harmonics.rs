//! Smooth bases: harmonics on the hemisphere, and the thesis's ways to spherical harmonics.
//!
//! No photograph is taken from below the surface and none from its horizon, so the least-squares problem for spherical
//! harmonics alone is ill-posed (condition 4e8 for 36 coefficients). Functions that are orthogonal on the hemisphere, a
//! penalty on their roughness chosen by generalised cross-validation once for a surface, and a weak penalty on slope where
//! nothing was measured make it well-posed ([`Smooth`]). The thesis's two methods are kept to be compared with.

mod basis;
mod kernel;
mod lanes;
mod packed;
mod penalty;
mod positive;
mod smooth;
mod stability;
#[cfg(test)]
mod tests;

use std::f64::consts::PI;

use glam::DVec3;
use nalgebra::{Cholesky, DMatrix, DVector};

use super::voronoi;
pub(super) use basis::Basis;
pub(crate) use basis::Written;
pub use smooth::{Smooth, SmoothFit, Weighing};
pub use stability::Stability;

/// The most coefficients of one channel.
pub const MOST: usize = 100;
/// One more than the highest degree of any basis.
const ORDERS: usize = 14;

/// Which harmonics, and how their coefficients are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HarmonicsMethod {
    /// Spherical harmonics that are even in z, order (order + 1) / 2 of them: the radiance below the horizon is its mirror
    /// image (Westin, Arvo, Torrance 1992). Smoothed.
    Mirrored,
    /// Hemispherical harmonics (Gautron et al. 2004), order² of them. Smoothed.
    Hemispherical,
    /// Spherical harmonics, order² of them. Smoothed.
    Smoothed,
    /// Spherical harmonics by projection with radiance 0 below the horizon (the thesis's zero hemisphere): rings at the
    /// horizon.
    ZeroHemisphere,
    /// Spherical harmonics by least-squares optimal projection: quadrature over Voronoi cells and the inverse Gram matrix of
    /// the hemisphere (thesis, 12.4): less accurate than least squares on the samples.
    Lsop,
}

impl HarmonicsMethod {
    /// All methods.
    pub const ALL: [Self; 5] =
        [Self::Mirrored, Self::Hemispherical, Self::Smoothed, Self::ZeroHemisphere, Self::Lsop];

    /// The functions of direction that the coefficients belong to.
    pub(super) fn basis(self) -> Basis {
        match self {
            Self::Mirrored => Basis::Mirrored,
            Self::Hemispherical => Basis::Stretched,
            Self::Smoothed | Self::ZeroHemisphere | Self::Lsop => Basis::Sphere,
        }
    }

    /// Whether its functions are those of the hemisphere: their systems are well-posed, and fitted tile by tile.
    pub fn is_on_the_hemisphere(self) -> bool {
        matches!(self, Self::Mirrored | Self::Hemispherical)
    }

    /// Whether it is kept to be compared with.
    pub fn is_for_comparison(self) -> bool {
        self != Self::Mirrored
    }

    /// The orders that have a name: 15, 36, 66 and 91 coefficients for [`Self::Mirrored`], else 16, 36, 64 and 100.
    pub fn orders(self) -> [u8; 4] {
        if self == Self::Mirrored { [5, 8, 11, 13] } else { [4, 6, 8, 10] }
    }

    /// Radiance toward `direction` (unit vector, surface frame) of a texel's coefficients (function after function, R G B
    /// each), negative where they say so.
    pub fn radiance(self, order: u8, parameters: &[f32], direction: DVec3) -> [f64; 3] {
        let mut row = [0.0; MOST];
        self.basis().at(usize::from(order), direction, &mut row);
        let terms = || row.iter().zip(parameters.chunks_exact(3));
        std::array::from_fn(|c| terms().map(|(value, p)| value * f64::from(p[c])).sum())
    }

    /// The functions below `order` as WGSL, in an order of their own; see [`Written`].
    pub(crate) fn written(self, order: u8) -> Vec<Written> {
        self.basis().written(usize::from(order))
    }

    /// Number of coefficients of one channel.
    pub fn count(self, order: u8) -> usize {
        self.basis().count(usize::from(order))
    }
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
        Basis::Sphere.at(order, direction, row.as_mut_slice());
        gram.ger(2.0 * PI / count as f64, &row, &row, 1.0);
    }
    gram.cholesky()
}

/// Σ cell × radiance × harmonic over the samples: quadrature with the solid angles of their Voronoi cells.
pub(super) fn projected(order: usize, directions: &[DVec3], radiance: &[[f64; 3]]) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(order * order, 3);
    let mut row = vec![0.0; order * order];
    for ((direction, cell), radiance) in directions.iter().zip(voronoi::cells_sr(directions)).zip(radiance) {
        Basis::Sphere.at(order, *direction, &mut row);
        for (i, value) in row.iter().enumerate() {
            for c in 0..3 {
                sum[(i, c)] += cell * radiance[c] * value;
            }
        }
    }
    sum
}

//! What a fit prefers where the views leave it open.

use glam::DVec3;
use nalgebra::{Cholesky, DMatrix, DVector, SymmetricEigen};

use super::basis::Basis;
use super::hemisphere;

/// What each unit of the squared slope costs where nothing was measured, integrated over the steradians there, in units
/// of the weighted mean squared residual. At 3e-5 to 3e-4 the noise gain over the hemisphere of 289 views that end at
/// zenith 75 degrees falls from 1.3 to 0.6 and the error inside the views does not change (tests/examples/harmonics.rs).
const SLOPE: f64 = 2e-4;

/// The penalty on smoothness of each function, (l (l + 1))²: the integral of its squared Laplacian.
pub(super) fn roughness(basis: Basis, order: usize) -> DVector<f64> {
    let rough = basis.indices(order).map(|(l, _)| (f64::from(l) * f64::from(l + 1)).powi(2));
    DVector::from_iterator(basis.count(order), rough)
}

/// The integral of the squared slope over the directions that no view is near, k x k: there the fit goes on as flat as
/// the rest lets it, instead of swinging with the noise.
///
/// A direction counts fully from 1.2 times the spacing of as many views spread over the hemisphere on, and not below 0.6.
pub(super) fn hole_slope(basis: Basis, order: usize, views: &[DVec3]) -> DMatrix<f64> {
    let (k, count) = (basis.count(order), 600);
    let spacing = (2.0 * std::f64::consts::PI / views.len().max(1) as f64).sqrt();
    let mut slopes = Vec::new();
    for direction in hemisphere(count) {
        let nearest = views.iter().map(|view| view.dot(direction)).fold(-1.0, f64::max);
        let share = ((nearest.min(1.0).acos() / spacing - 0.6) / 0.6).clamp(0.0, 1.0);
        if share == 0.0 {
            continue;
        }
        let root = (share * 2.0 * std::f64::consts::PI / count as f64).sqrt();
        let across = direction.any_orthonormal_vector();
        for tangent in [across, direction.cross(across)] {
            let (mut ahead, mut behind) = (DVector::zeros(k), DVector::zeros(k));
            let step = 1e-4;
            basis.at(order, (direction + step * tangent).normalize(), ahead.as_mut_slice());
            basis.at(order, (direction - step * tangent).normalize(), behind.as_mut_slice());
            slopes.push((ahead - behind) * (root / (2.0 * step)));
        }
    }
    if slopes.is_empty() {
        return DMatrix::zeros(k, k);
    }
    let slopes = DMatrix::from_columns(&slopes);
    &slopes * slopes.transpose() * SLOPE
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

/// The normal equations for `directions` (unit), their radiance and weights.
pub(super) fn normal(
    basis: Basis,
    order: usize,
    directions: &[DVec3],
    radiance: &[[f64; 3]],
    weights: &[f64],
) -> Normal {
    let (n, k) = (directions.len(), basis.count(order));
    let total: f64 = weights.iter().sum();
    let mut design = DMatrix::zeros(k, n);
    let mut values = DMatrix::zeros(n, 3);
    for (i, direction) in directions.iter().enumerate() {
        let root = (weights[i] / total).sqrt();
        let mut column = design.column_mut(i);
        basis.at(order, *direction, column.as_mut_slice());
        column *= root;
        for c in 0..3 {
            values[(i, c)] = root * radiance[i][c];
        }
    }
    let energy = values.norm_squared();
    Normal { gram: &design * design.transpose(), right: &design * values, energy, samples: n }
}

/// The weight of the roughness that predicts best what a fit has not seen: generalised cross-validation (Golub, Heath,
/// Wahba 1979), the geometric mean of the scores of all texels.
pub(super) fn choose(normals: &[Normal], rough: &DVector<f64>, hole: &DMatrix<f64>) -> f64 {
    let ladder: Vec<f64> = (-48..=8).map(|quarter| 10.0_f64.powf(f64::from(quarter) / 4.0)).collect();
    let mut scores = vec![0.0; ladder.len()];
    for normal in normals {
        let Some(texel) = scores_of(normal, rough, hole, &ladder) else { continue };
        for (sum, score) in scores.iter_mut().zip(texel) {
            *sum += score;
        }
    }
    let best = scores.iter().zip(&ladder).min_by(|a, b| a.0.total_cmp(b.0));
    best.map_or(1e-6, |(_, penalty)| *penalty)
}

/// Logarithm of the score of each weight. All weights share one decomposition: in the system's own coordinates at the
/// least weight, the roughness is diagonal.
fn scores_of(normal: &Normal, rough: &DVector<f64>, hole: &DMatrix<f64>, ladder: &[f64]) -> Option<Vec<f64>> {
    let rough = DMatrix::from_diagonal(rough);
    let lower = system(&(&normal.gram + hole + &rough * ladder[0]))?.unpack();
    let into = |matrix: &DMatrix<f64>| {
        let half = lower.solve_lower_triangular(matrix)?;
        lower.solve_lower_triangular(&half.transpose())
    };
    let own = SymmetricEigen::new(into(&rough)?);
    let gram = own.eigenvectors.tr_mul(&into(&normal.gram)?) * &own.eigenvectors;
    let right = own.eigenvectors.tr_mul(&lower.solve_lower_triangular(&normal.right)?);
    let score = |penalty: &f64| {
        let shrink = own.eigenvalues.map(|value| 1.0 / (1.0 + (penalty - ladder[0]) * value.max(0.0)));
        let mut found = right.clone();
        found.column_iter_mut().for_each(|mut column| column.component_mul_assign(&shrink));
        let residual = normal.energy - 2.0 * found.dot(&right) + found.dot(&(&gram * &found));
        let freedom = gram.diagonal().dot(&shrink);
        let left = (1.0 - freedom / normal.samples as f64).max(1e-6);
        // A residual below rounding error says nothing about the choice.
        (residual.max(1e-12 * normal.energy).max(f64::MIN_POSITIVE) / (left * left)).ln()
    };
    Some(ladder.iter().map(score).collect())
}

/// The factor of a fit's system; what nothing touches is kept from being undefined.
pub(super) fn system(matrix: &DMatrix<f64>) -> Option<Cholesky<f64, nalgebra::Dyn>> {
    let mut matrix = matrix.clone();
    let least = 1e-14 * matrix.trace();
    for i in 0..matrix.nrows() {
        matrix[(i, i)] += least;
    }
    matrix.cholesky()
}

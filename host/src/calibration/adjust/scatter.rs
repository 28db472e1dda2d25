//! How much the views deviate, and by how much what was measured is worse than it seemed: from the residuals themselves.

use nalgebra::{DMatrix, DVector};

use super::share::Share;
use super::{ALL, Adjusted, DEVIATIONS, PARTS, POINT, POINTS, SHARED, ViewData};

/// The smallest deviations that are told from none, radians or metres.
const SMALLEST: f64 = 1e-6;
/// Fewer views tell nothing of how much views deviate, fewer points nothing of how even the surface is.
const FEWEST_VIEWS: usize = 6;
const FEWEST_POINTS: usize = 6;
/// Degrees of freedom of the weights' t distribution.
const TAIL: f64 = 5.0;
/// A view's or a point's noise is as good as the others' until so many residuals say otherwise.
const PRIOR: f64 = 8.0;

/// What agrees less counts less: a square's place and shape by themselves, a point.
pub fn weights(
    view: &ViewData,
    residual: &DVector<f64>,
    noise: &[f64; PARTS],
    point_noise: &[f64],
    misfit: &mut [[f64; 2]],
) -> Vec<f64> {
    let mut weights = vec![1.0; residual.len()];
    let mut weigh = |rows: std::ops::Range<usize>, noise: f64| {
        let (n, variance) = (rows.len() as f64, noise * noise);
        let squared = rows.clone().map(|row| residual[row] * residual[row]).sum::<f64>() / variance;
        weights[rows].fill((TAIL + n) / (TAIL + squared) / variance);
        squared / n
    };
    for (i, misfit) in misfit.iter_mut().enumerate().take(view.squares.len()) {
        for (part, rows) in [(0, 0..2), (1, 2..8)] {
            misfit[part] = weigh(8 * i + rows.start..8 * i + rows.end, noise[part]);
        }
    }
    for (i, measured) in view.points.iter().enumerate() {
        let row = view.point_row(i);
        weigh(row..row + 2, noise[POINTS] * point_noise[measured.point]);
    }
    weights
}

pub fn estimate_sigma(state: &mut Adjusted) {
    let views = state.deviations.len();
    if views < FEWEST_VIEWS {
        return;
    }
    for k in 0..DEVIATIONS {
        let squares = state.deviations.iter().map(|deviation| deviation[k].powi(2));
        let unknown = state.joint.iter().map(|joint| joint[(k, k)]);
        state.sigma[k] = scatter(squares.sum(), unknown.sum(), views, state.sigma[k]);
    }
}

pub fn estimate_height(covariance: &DMatrix<f64>, state: &mut Adjusted) {
    let points = state.offsets_m.len();
    if points < FEWEST_POINTS {
        return;
    }
    let squares = state.offsets_m.iter().map(|offset| offset.z.powi(2));
    let z = |point: usize| SHARED + POINT * point + 2;
    let unknown = (0..points).map(|point| covariance[(z(point), z(point))]);
    state.height_m = scatter(squares.sum(), unknown.sum(), points, state.height_m);
}

/// The standard deviation of `count` unknowns from the sum of their squares and of their variances.
fn scatter(squares: f64, unknown: f64, count: usize, sigma: f64) -> f64 {
    // So many of them were measured.
    let known = count as f64 - unknown / (sigma * sigma);
    if known < 1.0 {
        // None was: what was assumed stands.
        return sigma;
    }
    (squares / known).sqrt().clamp(sigma / 5.0, sigma * 5.0).max(SMALLEST)
}

/// Sums of residuals squared in units of their weight, and of the part of each that no unknown has determined.
#[derive(Clone, Copy, Default)]
struct Sums {
    squared: f64,
    free: f64,
}

impl Sums {
    fn add(&mut self, squared: f64, free: f64) {
        self.squared += squared;
        self.free += free;
    }

    /// The noise of a few, whose noise was taken to be `noise`.
    fn of_few(&self, noise: f64) -> f64 {
        ((self.squared * noise * noise + PRIOR) / (self.free + PRIOR)).sqrt()
    }
}

/// The scale of the t distribution that the residuals follow, allowing for the unknowns that they have determined: of all
/// views, and of each view and each point as far as its few residuals tell.
pub fn estimate_noise(
    views: &[ViewData],
    shares: &[Share<'_>],
    covariance: &DMatrix<f64>,
    state: &mut Adjusted,
) {
    let mut parts = [Sums::default(); PARTS];
    let mut points = vec![Sums::default(); state.point_noise.len()];
    for (index, (view, share)) in views.iter().zip(shares).enumerate() {
        let mut own = [Sums::default(); 2];
        let joint = &state.joint[index];
        for row in 0..view.rows() {
            let derivative = share.linear.derivative.fixed_view::<1, ALL>(row, 0);
            let mut known = (derivative * joint * derivative.transpose())[0];
            let point = row.checked_sub(8 * view.squares.len()).map(|row| (row / 2, row % 2));
            let part = match point {
                Some((point, axis)) => {
                    let column = SHARED + POINT * view.points[point].point;
                    let by_point = share.linear.by_point[point].fixed_view::<1, POINT>(axis, 0);
                    let (of_view, of_shared) = (
                        derivative.fixed_columns::<DEVIATIONS>(0),
                        derivative.fixed_columns::<SHARED>(DEVIATIONS),
                    );
                    let with = of_view * share.mixed.fixed_columns::<POINT>(column)
                        + of_shared * covariance.fixed_view::<SHARED, POINT>(0, column);
                    let alone = covariance.fixed_view::<POINT, POINT>(column, column);
                    known += ((with * 2.0 + by_point * alone) * by_point.transpose())[0];
                    POINTS
                }
                None => usize::from(row % 8 >= 2),
            };
            // The residual's square in units of the noise, and the part of it that is free.
            let relative = share.weight[row] * share.residual[row].powi(2);
            let free = (1.0 - known * share.weight[row]).max(0.0);
            parts[part].add(relative, free);
            own[part / 2].add(relative, free);
            if let Some((point, _)) = point {
                points[view.points[point].point].add(relative, free);
            }
        }
        for (noise, sums) in state.view_noise[index].iter_mut().zip(own) {
            *noise = sums.of_few(*noise);
        }
    }
    for (noise, sums) in state.point_noise.iter_mut().zip(points) {
        *noise = sums.of_few(*noise);
    }
    for (noise, sums) in state.noise.iter_mut().zip(parts) {
        if sums.free >= 8.0 {
            *noise = (*noise * (sums.squared / sums.free).sqrt()).clamp(0.3, 30.0);
        }
    }
}

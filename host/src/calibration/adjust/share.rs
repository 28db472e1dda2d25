//! What one view adds to the normal equations.

use nalgebra::{Const, DVector, Dyn, Matrix3, Matrix6, OMatrix, SMatrix, SVector, Vector3};

use super::scatter::weights;
use super::{ALL, Adjusted, DEVIATIONS, Deviation, Linear, POINT, SHARED, ViewData};

/// A view's own unknowns against the shared ones and those of all points.
pub type ByAll = OMatrix<f64, Const<DEVIATIONS>, Dyn>;

/// What the equations keep of a view.
pub struct Share<'a> {
    pub own: Matrix6<f64>,
    pub cross: ByAll,
    pub right: SVector<f64, DEVIATIONS>,
    /// Whitened residuals, not weighted, and their derivatives.
    pub residual: DVector<f64>,
    pub linear: &'a Linear,
    /// Weight of each residual, noise included.
    pub weight: Vec<f64>,
    /// Covariance of the view's deviation with the shared unknowns and all points, once it is known.
    pub mixed: ByAll,
}

/// What a view adds to them.
pub struct Made<'a> {
    pub share: Share<'a>,
    /// To the shared unknowns, and to the right side.
    pub normal: SMatrix<f64, SHARED, SHARED>,
    pub right: DVector<f64>,
    /// Of each of its points, with the shared unknowns and by itself.
    pub of_points: Vec<(SMatrix<f64, SHARED, POINT>, Matrix3<f64>)>,
    /// Times itself, what the elimination of its own unknowns takes away.
    pub root: ByAll,
    pub misfit: Vec<[f64; 2]>,
}

/// The unknowns as they are.
pub struct Now<'a> {
    pub state: &'a Adjusted,
    /// How far the points are from where they were when the views were linearised.
    pub moved_m: &'a [Vector3<f64>],
    /// The inverse covariance of the views' deviations.
    pub deviations: &'a Matrix6<f64>,
    /// How many unknowns there are but for the views' own.
    pub unknowns: usize,
}

impl Now<'_> {
    fn residual(&self, view: &ViewData, linear: &Linear, deviation: &Deviation) -> DVector<f64> {
        let mut step = SVector::<f64, ALL>::zeros();
        step.fixed_rows_mut::<DEVIATIONS>(0)
            .copy_from(&(SVector::from(*deviation) - SVector::from(linear.deviation)));
        step.fixed_rows_mut::<SHARED>(DEVIATIONS).copy_from(&(self.state.shared - linear.shared));
        let mut residual = &linear.residual - &linear.derivative * step;
        for (i, (measured, by_point)) in view.points.iter().zip(&linear.by_point).enumerate() {
            let mut own = residual.fixed_rows_mut::<2>(view.point_row(i));
            own -= by_point * self.moved_m[measured.point];
        }
        residual
    }

    pub fn make<'a>(&self, index: usize, view: &ViewData, linear: &'a Linear) -> Option<Made<'a>> {
        let state = self.state;
        let deviation = &state.deviations[index];
        let residual = self.residual(view, linear, deviation);
        let noise = [0, 1, 2].map(|part| state.noise[part] * state.view_noise[index][part / 2]);
        let mut misfit = state.misfit[index].clone();
        let weight = weights(view, &residual, &noise, &state.point_noise, &mut misfit);
        let mut weighted = linear.derivative.clone();
        weighted.row_iter_mut().zip(&weight).for_each(|(mut row, weight)| row *= *weight);
        let normal = weighted.transpose() * &linear.derivative;
        let gradient = weighted.transpose() * &residual;
        let own = (normal.fixed_view::<DEVIATIONS, DEVIATIONS>(0, 0) + self.deviations).try_inverse()?;
        let mut cross = ByAll::zeros(self.unknowns);
        cross.fixed_columns_mut::<SHARED>(0).copy_from(&normal.view((0, DEVIATIONS), (DEVIATIONS, SHARED)));
        let mut right = DVector::zeros(self.unknowns);
        right.fixed_rows_mut::<SHARED>(0).copy_from(&gradient.fixed_rows::<SHARED>(DEVIATIONS));
        let mut of_points = Vec::with_capacity(view.points.len());
        for (i, (measured, by_point)) in view.points.iter().zip(&linear.by_point).enumerate() {
            let (row, column) = (view.point_row(i), SHARED + POINT * measured.point);
            let weighted_point = by_point * weight[row];
            let with = linear.derivative.fixed_rows::<2>(row).transpose() * weighted_point;
            cross.fixed_columns_mut::<POINT>(column).copy_from(&with.fixed_rows::<DEVIATIONS>(0));
            let with_shared = with.fixed_rows::<SHARED>(DEVIATIONS).into_owned();
            of_points.push((with_shared, by_point.transpose() * weighted_point));
            let mut own = right.fixed_rows_mut::<POINT>(column);
            own += weighted_point.transpose() * residual.fixed_rows::<2>(row);
        }
        let own_right = gradient.fixed_rows::<DEVIATIONS>(0) - self.deviations * SVector::from(*deviation);
        right -= cross.transpose() * (own * own_right);
        Some(Made {
            normal: normal.fixed_view::<SHARED, SHARED>(DEVIATIONS, DEVIATIONS).into_owned(),
            right,
            of_points,
            root: own.cholesky()?.l().transpose() * &cross,
            misfit,
            share: Share { own, cross, right: own_right, residual, linear, weight, mixed: ByAll::zeros(0) },
        })
    }
}

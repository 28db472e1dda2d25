//! One adjustment of all views of a rig together: shared rig, lens and squares, and per view what deviates from them.
//!
//! How much the views deviate in each of their six degrees of freedom is estimated from the views themselves (restricted
//! maximum likelihood; MacKay, "Bayesian Interpolation", 1992, equations 4.8 and 4.9): one in which they do not deviate
//! ends near zero and so is shared by all, one in which they do stays free. Squares count by a t distribution's weights.
//! Every view's unknowns are eliminated first (Schur complement), so a view costs the same however many there are.

mod pose;
mod scatter;
mod share;
mod solve;

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, SVector};

use super::edge::Quad;
use super::rig_model::{DEVIATIONS, Deviation, RIG, RigModel, Seen};
use super::square::{CornerCovariance, MeasuredSquare};
use super::squares::Squares;
use crate::geometry::Lens;
pub(super) use pose::solo;
pub(super) use solve::{ROUNDS, adjust, adjust_from};

/// Numbers of a lens, in the order fx fy cx cy k1 k2 p1 p2 k3.
pub(super) const LENS: usize = 9;
/// Shared unknowns: rig, lens, by how many pixels the squares' edges seem to lie further out, by how many metres the
/// squares are larger on each side.
pub(super) const SHARED: usize = RIG + LENS + 2;
/// Unknowns that a view's measurements depend on: its own first.
const ALL: usize = DEVIATIONS + SHARED;
pub(super) type Joint = SMatrix<f64, ALL, ALL>;
/// Unknowns of a tracked point: where it is on the surface's plane, and its height over it.
const POINT: usize = 3;
/// How all points may move together and no picture changes: two shifts, a turn, a scale.
const GAUGE: usize = 4;
/// What is worse than its covariance by a factor of its own: the squares' places, their shapes, the points.
pub(super) const PARTS: usize = 3;
/// The part of the points.
const POINTS: usize = 2;

/// What is known of one view.
#[derive(Debug, Clone, Default)]
pub(super) struct ViewData {
    pub pan_rad: f64,
    pub tilt_rad: f64,
    pub squares: Vec<MeasuredSquare>,
    pub points: Vec<MeasuredPoint>,
}

/// A point of the surface in a view. Nobody knows where on the surface it is, but it is there in all views: texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MeasuredPoint {
    /// Index in [`Frame::points_m`].
    pub point: usize,
    /// Where it appears, pixels.
    pub at: DVec2,
    /// How sure that is, pixels².
    pub covariance: Matrix2<f64>,
}

/// What does not depend on the view.
#[derive(Debug, Clone)]
pub(super) struct Frame<'a> {
    pub layout: &'a Squares,
    pub lens: Lens,
    pub lens_covariance: SMatrix<f64, LENS, LENS>,
    pub distance_m: f64,
    /// About where the tracked points are on the surface.
    pub points_m: Vec<DVec3>,
    /// Whether nothing but the rig says where the surface's frame is: its origin is then where the pan axis meets the surface,
    /// its x where the commanded pan is 0, and the camera is as far away as was said.
    pub is_rig_s: bool,
}

/// What an adjustment found.
#[derive(Debug, Clone)]
pub(super) struct Adjusted {
    pub shared: SVector<f64, SHARED>,
    pub deviations: Vec<Deviation>,
    /// Standard deviation of each degree of freedom over the views.
    pub sigma: [f64; DEVIATIONS],
    /// By which factor the squares' places, their shapes, and the points are worse than their covariance says.
    pub noise: [f64; PARTS],
    /// By which factor the squares of a view, and its points, are worse than those of the others: its light differs, or it is
    /// blurred.
    pub view_noise: Vec<[f64; 2]>,
    /// By which factor a point is worse than the others: it glitters.
    pub point_noise: Vec<f64>,
    /// By how much the points are elsewhere than the frame has them, metres.
    pub offsets_m: Vec<DVec3>,
    /// Standard deviation of their heights, metres.
    pub height_m: f64,
    /// Per view the covariance of its deviation and the shared unknowns.
    pub joint: Vec<Joint>,
    /// Per view the covariance of these with what all points have in common, and the covariance of that.
    mixed: Vec<SMatrix<f64, ALL, GAUGE>>,
    gauge: SMatrix<f64, GAUGE, GAUGE>,
    /// Per view and square, residuals squared over their expected value: 1 on average, of its place and of its shape.
    pub misfit: Vec<Vec<[f64; 2]>>,
    /// Whether it came to rest.
    pub settled: bool,
}

/// A corner is never known better than this, pixels.
const FLOOR_PX: f64 = 0.01;
/// Steps of the numerical derivatives: turns, shifts, then fx fy cx cy k1 k2 p1 p2 k3, edge, size.
const STEP_RAD: f64 = 1e-5;
const STEP_M: f64 = 1e-5;
const STEPS_LENS: [f64; LENS] = [0.1, 0.1, 0.1, 0.1, 1e-4, 1e-3, 1e-5, 1e-5, 1e-2];

impl Frame<'_> {
    /// Where the drawing of the rig has a view at these angles (pan and tilt, radians).
    pub fn commanded(&self, (pan_rad, tilt_rad): (f64, f64)) -> Seen {
        RigModel::nominal(self.distance_m).see(pan_rad, tilt_rad, &[0.0; DEVIATIONS])
    }

    pub fn rig(&self, shared: &SVector<f64, SHARED>) -> RigModel {
        RigModel::from_numbers(self.distance_m, &shared.as_slice()[..RIG])
    }

    pub fn lens(&self, shared: &SVector<f64, SHARED>) -> Lens {
        let mut numbers = self.lens.numbers();
        numbers.iter_mut().zip(&shared.as_slice()[RIG..]).for_each(|(number, change)| *number += change);
        self.lens.with_numbers(numbers)
    }

    /// Where a square's corners appear; `None` where they do not.
    pub fn corners(
        &self,
        square: usize,
        seen: &Seen,
        lens: &Lens,
        out_px: f64,
        out_m: f64,
    ) -> Option<[DVec2; 4]> {
        let mut corners = [DVec2::ZERO; 4];
        for (corner, point) in corners.iter_mut().zip(self.layout.corners_m(square, out_m)) {
            *corner = lens.project(seen.to_camera(point))?;
        }
        if out_px == 0.0 { Some(corners) } else { Some(Quad::new(&corners)?.grown(out_px)) }
    }

    /// Everything that a view's measurements should be: its squares' corners, then its points.
    fn predict(
        &self,
        view: &ViewData,
        shared: &SVector<f64, SHARED>,
        deviation: &Deviation,
        offsets_m: &[DVec3],
    ) -> Option<DVector<f64>> {
        let seen = self.rig(shared).see(view.pan_rad, view.tilt_rad, deviation);
        let lens = self.lens(shared);
        let mut all = Vec::with_capacity(view.rows());
        for measured in &view.squares {
            let corners =
                self.corners(measured.square, &seen, &lens, shared[RIG + LENS], shared[RIG + LENS + 1])?;
            all.extend(corners.iter().flat_map(|corner| corner.to_array()));
        }
        for measured in &view.points {
            let point = self.points_m[measured.point] + offsets_m[measured.point];
            all.extend(lens.project(seen.to_camera(point))?.to_array());
        }
        Some(DVector::from_vec(all))
    }

    /// A view's measurements about where the unknowns are now.
    fn linearise(
        &self,
        view: &ViewData,
        shared: &SVector<f64, SHARED>,
        deviation: &Deviation,
        offsets_m: &[DVec3],
    ) -> Option<Linear> {
        let predicted = self.predict(view, shared, deviation, offsets_m)?;
        let mut derivative = DMatrix::zeros(predicted.len(), ALL);
        for i in 0..ALL {
            let step = step_of(i, self.layout.size_m);
            let moved = |by: f64| {
                let (mut shared, mut deviation) = (*shared, *deviation);
                match i {
                    0..DEVIATIONS => deviation[i] += by,
                    _ => shared[i - DEVIATIONS] += by,
                }
                self.predict(view, &shared, &deviation, offsets_m)
            };
            derivative.set_column(i, &((moved(step)? - moved(-step)?) / (2.0 * step)));
        }
        let mut by_point = vec![ByPoint::zeros(); view.points.len()];
        for axis in 0..POINT {
            let moved = |by: f64| {
                let moved: Vec<DVec3> = offsets_m.iter().map(|&at| at + DVec3::AXES[axis] * by).collect();
                self.predict(view, shared, deviation, &moved)
            };
            let along = (moved(STEP_M)? - moved(-STEP_M)?) / (2.0 * STEP_M);
            for (i, by_point) in by_point.iter_mut().enumerate() {
                by_point.set_column(axis, &along.fixed_rows::<2>(view.point_row(i)));
            }
        }
        let mut residual = -predicted;
        for (i, measured) in view.squares.iter().enumerate() {
            let whitener = whitener(&measured.covariance)?;
            let own = residual.fixed_rows::<8>(8 * i) + measured.corners;
            residual.fixed_rows_mut::<8>(8 * i).copy_from(&(whitener * own));
            let rows = whitener * derivative.fixed_rows::<8>(8 * i);
            derivative.fixed_rows_mut::<8>(8 * i).copy_from(&rows);
        }
        for (i, (measured, by_point)) in view.points.iter().zip(&mut by_point).enumerate() {
            let row = view.point_row(i);
            let floor = Matrix2::identity() * FLOOR_PX.powi(2);
            let whitener = (measured.covariance + floor).cholesky()?.l().try_inverse()?;
            let own = residual.fixed_rows::<2>(row) + nalgebra::Vector2::new(measured.at.x, measured.at.y);
            residual.fixed_rows_mut::<2>(row).copy_from(&(whitener * own));
            let rows = whitener * derivative.fixed_rows::<2>(row);
            derivative.fixed_rows_mut::<2>(row).copy_from(&rows);
            *by_point = whitener * *by_point;
        }
        Some(Linear { residual, derivative, by_point, shared: *shared, deviation: *deviation })
    }
}

impl ViewData {
    /// How many numbers were measured in it.
    fn rows(&self) -> usize {
        self.point_row(self.points.len())
    }

    /// The first of a point's two.
    fn point_row(&self, point: usize) -> usize {
        8 * self.squares.len() + 2 * point
    }
}

type ByPoint = SMatrix<f64, 2, POINT>;

/// A view's measurements as a linear function of its deviation, the shared unknowns and its points.
struct Linear {
    /// Whitened residuals where it was linearised, and their derivatives by the view's and the shared unknowns.
    residual: DVector<f64>,
    derivative: DMatrix<f64>,
    /// Of a point's two residuals by its own unknowns, of each point.
    by_point: Vec<ByPoint>,
    shared: SVector<f64, SHARED>,
    deviation: Deviation,
}

fn step_of(unknown: usize, size_m: f64) -> f64 {
    match unknown {
        0..3 => STEP_RAD,
        3..DEVIATIONS => STEP_M,
        _ => match unknown - DEVIATIONS {
            0..7 => STEP_RAD,
            7..RIG => STEP_M,
            shared if shared < RIG + LENS => STEPS_LENS[shared - RIG],
            shared if shared == RIG + LENS => 1e-3,
            _ => 1e-3 * size_m,
        },
    }
}

/// Turns corners into two independent parts of variance 1: where the square is (2), and what shape it has, given that (6).
///
/// The shape suffers from whatever the picture of a square does not model (rounded corners, a bent sheet), its place hardly,
/// so the two have a noise of their own.
fn whitener(covariance: &CornerCovariance) -> Option<CornerCovariance> {
    const PATTERNS: [[f64; 4]; 4] =
        [[0.5, 0.5, 0.5, 0.5], [0.5, 0.5, -0.5, -0.5], [0.5, -0.5, -0.5, 0.5], [0.5, -0.5, 0.5, -0.5]];
    let basis =
        CornerCovariance::from_fn(
            |row, column| {
                if row % 2 == column % 2 { PATTERNS[row / 2][column / 2] } else { 0.0 }
            },
        );
    let floor = CornerCovariance::identity() * FLOOR_PX.powi(2);
    let lower = (basis * (covariance + floor) * basis.transpose()).cholesky()?.l();
    Some(lower.try_inverse()? * basis)
}

#[cfg(test)]
mod tests;

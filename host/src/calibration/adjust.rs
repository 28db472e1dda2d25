//! One adjustment of all views of a rig together: shared rig, lens and squares, and per view what deviates from them.
//!
//! How much the views deviate in each of their six degrees of freedom is estimated from the views themselves (restricted
//! maximum likelihood; MacKay, "Bayesian Interpolation", 1992, equations 4.8 and 4.9): one in which they do not deviate
//! ends near zero and so is shared by all, one in which they do stays free. Squares count by a t distribution's weights.
//! Every view's unknowns are eliminated first (Schur complement), so a view costs the same however many there are.

use glam::DVec2;
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector};
use rayon::prelude::*;

use super::edge::Quad;
use super::rig_model::{DEVIATIONS, Deviation, RIG, RigModel, Seen};
use super::square::{CornerCovariance, MeasuredSquare};
use super::squares::Squares;
use crate::geometry::{Lens, PoseCovariance};

/// Numbers of a lens, in the order fx fy cx cy k1 k2 p1 p2 k3.
pub(super) const LENS: usize = 9;
/// Shared unknowns: rig, lens, by how many pixels the squares' edges seem to lie further out, by how many metres the
/// squares are larger on each side.
pub(super) const SHARED: usize = RIG + LENS + 2;
/// Unknowns that a view's measurements depend on: its own first.
const ALL: usize = DEVIATIONS + SHARED;
pub(super) type Joint = SMatrix<f64, ALL, ALL>;

/// What is known of one view.
#[derive(Debug, Clone, Default)]
pub(super) struct ViewData {
    pub pan_rad: f64,
    pub tilt_rad: f64,
    pub squares: Vec<MeasuredSquare>,
}

/// What does not depend on the view.
#[derive(Debug, Clone)]
pub(super) struct Frame<'a> {
    pub layout: &'a Squares,
    pub lens: Lens,
    pub lens_covariance: SMatrix<f64, LENS, LENS>,
    pub distance_m: f64,
}

/// What an adjustment found.
#[derive(Debug, Clone)]
pub(super) struct Adjusted {
    pub shared: SVector<f64, SHARED>,
    pub deviations: Vec<Deviation>,
    /// Standard deviation of each degree of freedom over the views.
    pub sigma: [f64; DEVIATIONS],
    /// By which factor the squares' places, and their shapes, are worse than their covariance says.
    pub noise: [f64; 2],
    /// By which factor the squares of a view are worse than those of the others: its light differs, or it is blurred.
    pub view_noise: Vec<f64>,
    /// Per view the covariance of its deviation and the shared unknowns.
    pub joint: Vec<Joint>,
    /// Per view and square, residuals squared over their expected value: 1 on average, of its place and of its shape.
    pub misfit: Vec<Vec<[f64; 2]>>,
    /// Whether it came to rest.
    pub settled: bool,
}

/// Rounds at most, and when the standard deviations have settled (relative).
const ROUNDS: usize = 60;
const SETTLED: f64 = 0.01;
/// The poses are known to a hundredth of a pixel after so many rounds: the rest only settles how sure everything is.
const RELINEARISED: usize = 5;
/// Deviations less than this part of what they are at first count as none.
const NEGLIGIBLE: f64 = 0.02;
/// What deviations are before they are estimated: half a degree, 3 mm at 0.9 m.
const ANGLE_RAD: f64 = 0.0087;
const SHIFT: f64 = 0.0033;
/// The smallest deviations that are told from none, radians or metres.
const SMALLEST: f64 = 1e-6;
/// Fewer views tell nothing of how much views deviate.
const FEWEST_VIEWS: usize = 6;
/// Degrees of freedom of the weights' t distribution.
const TAIL: f64 = 5.0;
/// A view's noise is as good as the others' until so many residuals say otherwise.
const VIEW_PRIOR: f64 = 8.0;
/// A corner is never known better than this, pixels.
const FLOOR_PX: f64 = 0.01;
/// Steps of the numerical derivatives: turns, shifts, then fx fy cx cy k1 k2 p1 p2 k3, edge, size.
const STEP_RAD: f64 = 1e-5;
const STEP_M: f64 = 1e-5;
const STEPS_LENS: [f64; LENS] = [0.1, 0.1, 0.1, 0.1, 1e-4, 1e-3, 1e-5, 1e-5, 1e-2];

impl Frame<'_> {
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

    /// Everything that a view's measurements should be.
    fn predict(
        &self,
        view: &ViewData,
        shared: &SVector<f64, SHARED>,
        deviation: &Deviation,
    ) -> Option<DVector<f64>> {
        let seen = self.rig(shared).see(view.pan_rad, view.tilt_rad, deviation);
        let lens = self.lens(shared);
        let mut all = Vec::with_capacity(8 * view.squares.len());
        for measured in &view.squares {
            let corners =
                self.corners(measured.square, &seen, &lens, shared[RIG + LENS], shared[RIG + LENS + 1])?;
            all.extend(corners.iter().flat_map(|corner| corner.to_array()));
        }
        Some(DVector::from_vec(all))
    }

    /// Whitened residuals and their derivatives by deviation and shared unknowns.
    fn linearise(
        &self,
        view: &ViewData,
        shared: &SVector<f64, SHARED>,
        deviation: &Deviation,
    ) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let predicted = self.predict(view, shared, deviation)?;
        let mut derivative = DMatrix::zeros(predicted.len(), ALL);
        for i in 0..ALL {
            let step = step_of(i, self.layout.size_m);
            let moved = |by: f64| {
                let (mut shared, mut deviation) = (*shared, *deviation);
                match i {
                    0..DEVIATIONS => deviation[i] += by,
                    _ => shared[i - DEVIATIONS] += by,
                }
                self.predict(view, &shared, &deviation)
            };
            derivative.set_column(i, &((moved(step)? - moved(-step)?) / (2.0 * step)));
        }
        let mut residual = -predicted;
        for (i, measured) in view.squares.iter().enumerate() {
            let whitener = whitener(&measured.covariance)?;
            let own = residual.fixed_rows::<8>(8 * i) + measured.corners;
            residual.fixed_rows_mut::<8>(8 * i).copy_from(&(whitener * own));
            let rows = whitener * derivative.fixed_rows::<8>(8 * i);
            derivative.fixed_rows_mut::<8>(8 * i).copy_from(&rows);
        }
        Some((residual, derivative))
    }
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

/// The prior's inverse covariance of the shared unknowns.
fn shared_prior(frame: &Frame) -> Option<SMatrix<f64, SHARED, SHARED>> {
    let mut prior = SMatrix::<f64, SHARED, SHARED>::zeros();
    let d = frame.distance_m;
    let shifts = [0.07 * d, 0.07 * d, 0.07 * d, 0.02 * d, 0.02 * d, 0.02 * d, 0.02 * d];
    for i in 0..7 {
        prior[(i, i)] = 0.035f64.powi(-2);
        prior[(7 + i, 7 + i)] = shifts[i].powi(-2);
    }
    let mut lens = frame.lens_covariance;
    for i in 0..LENS {
        // What the calibration held fixed has no variance.
        lens[(i, i)] += (1e-3 * STEPS_LENS[i]).powi(2);
    }
    prior.fixed_view_mut::<LENS, LENS>(RIG, RIG).copy_from(&lens.try_inverse()?);
    prior[(RIG + LENS, RIG + LENS)] = 0.1f64.powi(-2);
    prior[(RIG + LENS + 1, RIG + LENS + 1)] = (0.005 * frame.layout.size_m).powi(-2);
    Some(prior)
}

/// A view's measurements as a linear function of its deviation and the shared unknowns.
struct Linear {
    /// Whitened residuals where it was linearised, and their derivative.
    residual: DVector<f64>,
    derivative: DMatrix<f64>,
    shared: SVector<f64, SHARED>,
    deviation: Deviation,
}

impl Linear {
    fn residual_at(&self, shared: &SVector<f64, SHARED>, deviation: &Deviation) -> DVector<f64> {
        let mut step = SVector::<f64, ALL>::zeros();
        step.fixed_rows_mut::<DEVIATIONS>(0)
            .copy_from(&(SVector::from(*deviation) - SVector::from(self.deviation)));
        step.fixed_rows_mut::<SHARED>(DEVIATIONS).copy_from(&(shared - self.shared));
        &self.residual - &self.derivative * step
    }
}

/// One view's share of the normal equations.
struct Share<'a> {
    own: Matrix6<f64>,
    cross: SMatrix<f64, DEVIATIONS, SHARED>,
    right: SVector<f64, DEVIATIONS>,
    /// Whitened residuals and derivatives, not weighted.
    residual: DVector<f64>,
    derivative: &'a DMatrix<f64>,
    /// Weight of each residual, noise included.
    weight: Vec<f64>,
}

/// Adjusts all views. `None` where the equations cannot be solved: a view whose squares cannot be where they are.
pub(super) fn adjust(frame: &Frame, views: &[ViewData]) -> Option<Adjusted> {
    let start = Adjusted {
        shared: SVector::zeros(),
        deviations: vec![[0.0; DEVIATIONS]; views.len()],
        sigma: default_sigma(frame.distance_m),
        noise: [1.0; 2],
        view_noise: vec![1.0; views.len()],
        joint: vec![],
        misfit: views.iter().map(|view| vec![[1.0; 2]; view.squares.len()]).collect(),
        settled: false,
    };
    adjust_from(frame, views, start)
}

pub(super) fn default_sigma(distance_m: f64) -> [f64; DEVIATIONS] {
    let shift_m = SHIFT * distance_m;
    [ANGLE_RAD, ANGLE_RAD, ANGLE_RAD, shift_m, shift_m, shift_m]
}

/// The same from what an earlier adjustment found.
pub(super) fn adjust_from(frame: &Frame, views: &[ViewData], mut state: Adjusted) -> Option<Adjusted> {
    let prior = shared_prior(frame)?;
    let mut linears = vec![];
    for round in 0..ROUNDS {
        let deviations = Matrix6::from_diagonal(&SVector::from(state.sigma.map(|sigma| sigma.powi(-2))));
        let (mut matrix, mut right) = (prior, -(prior * state.shared));
        let mut shares = Vec::with_capacity(views.len());
        if round < RELINEARISED {
            let linear = |(view, deviation): (&ViewData, &Deviation)| {
                let (residual, derivative) = frame.linearise(view, &state.shared, deviation)?;
                Some(Linear { residual, derivative, shared: state.shared, deviation: *deviation })
            };
            linears = views.par_iter().zip(&state.deviations).map(linear).collect::<Option<_>>()?;
        }
        for (index, (view, linear)) in views.iter().zip(&linears).enumerate() {
            let residual = linear.residual_at(&state.shared, &state.deviations[index]);
            let derivative = &linear.derivative;
            let noise = state.noise.map(|noise| noise * state.view_noise[index]);
            let weight = weights(view, &residual, &noise, &mut state.misfit[index]);
            let mut weighted = derivative.clone();
            weighted.row_iter_mut().zip(&weight).for_each(|(mut row, weight)| row *= *weight);
            let normal = weighted.transpose() * derivative;
            let gradient = weighted.transpose() * &residual;
            let own = normal.fixed_view::<DEVIATIONS, DEVIATIONS>(0, 0) + deviations;
            let share = Share {
                own: own.try_inverse()?,
                cross: normal.fixed_view::<DEVIATIONS, SHARED>(0, DEVIATIONS).into_owned(),
                right: gradient.fixed_rows::<DEVIATIONS>(0)
                    - deviations * SVector::from(state.deviations[index]),
                residual,
                derivative,
                weight,
            };
            matrix += normal.fixed_view::<SHARED, SHARED>(DEVIATIONS, DEVIATIONS)
                - share.cross.transpose() * share.own * share.cross;
            right += gradient.fixed_rows::<SHARED>(DEVIATIONS)
                - share.cross.transpose() * (share.own * share.right);
            shares.push(share);
        }
        let shared_covariance = matrix.cholesky()?.inverse();
        let step = shared_covariance * right;
        state.shared += step;
        state.joint.clear();
        for (share, deviation) in shares.iter().zip(&mut state.deviations) {
            let own = share.own * (share.right - share.cross * step);
            deviation.iter_mut().zip(own.iter()).for_each(|(value, step)| *value += step);
            let through = share.own * share.cross;
            let mut joint = Joint::zeros();
            let mixed = -(through * shared_covariance);
            joint
                .fixed_view_mut::<DEVIATIONS, DEVIATIONS>(0, 0)
                .copy_from(&(share.own - mixed * through.transpose()));
            joint.fixed_view_mut::<DEVIATIONS, SHARED>(0, DEVIATIONS).copy_from(&mixed);
            joint.fixed_view_mut::<SHARED, DEVIATIONS>(DEVIATIONS, 0).copy_from(&mixed.transpose());
            joint.fixed_view_mut::<SHARED, SHARED>(DEVIATIONS, DEVIATIONS).copy_from(&shared_covariance);
            state.joint.push(joint);
        }
        if round < 2 {
            // The first steps go the way to where the views are: they say nothing of noise.
            continue;
        }
        let before = state.sigma;
        estimate_sigma(&mut state);
        estimate_noise(views, &shares, &mut state);
        let first = default_sigma(frame.distance_m);
        let change = (0..DEVIATIONS)
            .filter(|&k| state.sigma[k] > NEGLIGIBLE * first[k])
            .map(|k| (before[k] / state.sigma[k]).ln().abs())
            .fold(0.0, f64::max);
        state.settled = change < SETTLED;
        if round >= RELINEARISED && state.settled {
            break;
        }
    }
    Some(state)
}

/// A square counts less the less it agrees; place and shape by themselves.
fn weights(view: &ViewData, residual: &DVector<f64>, noise: &[f64; 2], misfit: &mut [[f64; 2]]) -> Vec<f64> {
    let mut weights = vec![1.0; residual.len()];
    for (i, misfit) in misfit.iter_mut().enumerate().take(view.squares.len()) {
        for (part, rows) in [(0, 0..2), (1, 2..8)] {
            let n = rows.len() as f64;
            let rows = 8 * i + rows.start..8 * i + rows.end;
            let variance = noise[part] * noise[part];
            let squared = rows.clone().map(|row| residual[row] * residual[row]).sum::<f64>() / variance;
            misfit[part] = squared / n;
            weights[rows].fill((TAIL + n) / (TAIL + squared) / variance);
        }
    }
    weights
}

fn estimate_sigma(state: &mut Adjusted) {
    let views = state.deviations.len();
    if views < FEWEST_VIEWS {
        return;
    }
    for k in 0..DEVIATIONS {
        let variance = state.sigma[k].powi(2);
        let squares: f64 = state.deviations.iter().map(|deviation| deviation[k].powi(2)).sum();
        let unknown: f64 = state.joint.iter().map(|joint| joint[(k, k)]).sum();
        // So many of the views say something of this degree of freedom.
        let known = views as f64 - unknown / variance;
        if known < 1.0 {
            // Nothing was measured: what was assumed stands.
            continue;
        }
        let sigma = (squares / known).sqrt();
        state.sigma[k] = sigma.clamp(state.sigma[k] / 5.0, state.sigma[k] * 5.0).max(SMALLEST);
    }
}

/// The scale of the t distribution that the residuals follow, allowing for the unknowns that they have determined: of all
/// views, and of each as far as its few squares tell.
fn estimate_noise(views: &[ViewData], shares: &[Share<'_>], state: &mut Adjusted) {
    let (mut squared, mut free) = ([0.0; 2], [0.0; 2]);
    for (index, ((view, share), joint)) in views.iter().zip(shares).zip(&state.joint).enumerate() {
        let (mut own_squared, mut own_free) = (0.0, 0.0);
        let own = state.view_noise[index].powi(2);
        for row in 0..8 * view.squares.len() {
            let part = usize::from(row % 8 >= 2);
            let derivative = share.derivative.fixed_view::<1, ALL>(row, 0);
            let determined = (derivative * joint * derivative.transpose())[0] * share.weight[row];
            // The residual's square in units of the noise, and the part of it that is free.
            let relative = share.weight[row] * share.residual[row].powi(2);
            let left = (1.0 - determined).max(0.0);
            squared[part] += relative * state.noise[part].powi(2);
            free[part] += left;
            own_squared += relative * own;
            own_free += left;
        }
        state.view_noise[index] = ((own_squared + VIEW_PRIOR) / (own_free + VIEW_PRIOR)).sqrt();
    }
    for part in 0..2 {
        if free[part] >= 8.0 {
            state.noise[part] = (squared[part] / free[part]).sqrt().clamp(0.3, 30.0);
        }
    }
}

impl Adjusted {
    /// Where a view was seen from.
    pub fn seen(&self, frame: &Frame, view: usize, data: &ViewData) -> Seen {
        frame.rig(&self.shared).see(data.pan_rad, data.tilt_rad, &self.deviations[view])
    }

    /// The covariance of a view's pose, and the same for the lens as it was found: what the picture's blur is made of,
    /// since an error of the lens and the error of the pose that makes up for it move nothing in the picture.
    pub fn covariance(&self, frame: &Frame, view: usize, data: &ViewData) -> [PoseCovariance; 2] {
        let at = self.seen(frame, view, data);
        let mut derivative = SMatrix::<f64, 6, ALL>::zeros();
        for i in 0..DEVIATIONS + RIG {
            let step = step_of(i, frame.layout.size_m);
            let (mut shared, mut deviation) = (self.shared, self.deviations[view]);
            match i {
                0..DEVIATIONS => deviation[i] += step,
                _ => shared[i - DEVIATIONS] += step,
            }
            let moved = frame.rig(&shared).see(data.pan_rad, data.tilt_rad, &deviation);
            derivative.set_column(i, &(SVector::from(at.difference(&moved)) / step));
        }
        let joint = &self.joint[view];
        let lens = joint.fixed_view::<LENS, LENS>(DEVIATIONS + RIG, DEVIATIONS + RIG).into_owned();
        let mixed = joint.fixed_view::<ALL, LENS>(0, DEVIATIONS + RIG).into_owned();
        let given = lens.try_inverse().map_or(*joint, |inverse| joint - mixed * inverse * mixed.transpose());
        [joint, &given].map(|joint| {
            let covariance = derivative * joint * derivative.transpose();
            std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)]))
        })
    }

    /// What the squares of a view leave, root mean square over their corners, pixels; 0 without squares.
    pub fn rms_px(&self, frame: &Frame, view: usize, data: &ViewData) -> f64 {
        let predicted = frame.predict(data, &self.shared, &self.deviations[view]);
        let (Some(predicted), false) = (predicted, data.squares.is_empty()) else { return 0.0 };
        let squared = data
            .squares
            .iter()
            .enumerate()
            .map(|(i, measured)| (measured.corners - predicted.fixed_rows::<8>(8 * i)).norm_squared())
            .sum::<f64>();
        (squared / (4 * data.squares.len()) as f64).sqrt()
    }
}

/// One view by itself, on the nominal rig: its deviation, and the misfit of each square's place and shape as if a corner was
/// known to a few tenths of a pixel. Tells squares that do not agree with the others before they are believed.
pub(super) fn solo(frame: &Frame, view: &ViewData) -> Option<(Deviation, Vec<f64>)> {
    let sigma = [0.035, 0.035, 0.035, 0.03, 0.03, 0.03];
    let prior = Matrix6::from_diagonal(&SVector::from(std::array::from_fn::<f64, 6, _>(|i| {
        let sigma = if i < 3 { sigma[i] } else { sigma[i] * frame.distance_m };
        sigma.powi(-2)
    })));
    let mut deviation = [0.0; DEVIATIONS];
    let rough = CornerCovariance::identity() * 0.2f64.powi(2);
    let blurred = |measured: &MeasuredSquare| MeasuredSquare {
        covariance: measured.covariance + rough,
        ..measured.clone()
    };
    let view = ViewData { squares: view.squares.iter().map(blurred).collect(), ..view.clone() };
    let mut misfit = vec![[1.0; 2]; view.squares.len()];
    for _ in 0..8 {
        let (residual, derivative) = frame.linearise(&view, &SVector::zeros(), &deviation)?;
        let weight = weights(&view, &residual, &[1.0; 2], &mut misfit);
        let own = derivative.fixed_columns::<DEVIATIONS>(0).into_owned();
        let mut weighted = own.clone();
        weighted.row_iter_mut().zip(&weight).for_each(|(mut row, weight)| row *= *weight);
        let matrix = prior + weighted.transpose() * &own;
        let right = weighted.transpose() * &residual - prior * SVector::from(deviation);
        let step = matrix.cholesky()?.solve(&right);
        deviation.iter_mut().zip(step.iter()).for_each(|(value, step)| *value += step);
    }
    let total = |[place, shape]: &[f64; 2]| (2.0 * place + 6.0 * shape) / 8.0;
    Some((deviation, misfit.iter().map(total).collect()))
}

#[cfg(test)]
mod tests;

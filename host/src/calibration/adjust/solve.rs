//! The normal equations, round by round.

use glam::DVec3;
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector, Vector3};
use rayon::prelude::*;

use super::scatter::{estimate_height, estimate_noise, estimate_sigma};
use super::share::{Made, Now, Share};
use super::{
    ALL, Adjusted, DEVIATIONS, Deviation, Frame, GAUGE, Joint, LENS, Linear, POINT, RIG, SHARED, STEPS_LENS,
    ViewData,
};

/// Rounds at most, and when the standard deviations have settled (relative).
pub const ROUNDS: usize = 60;
const SETTLED: f64 = 0.01;
/// The poses are known to a hundredth of a pixel after so many rounds: the rest only settles how sure everything is.
const RELINEARISED: usize = 5;
/// Deviations less than this part of what they are at first count as none.
const NEGLIGIBLE: f64 = 0.02;
/// What deviations are before they are estimated: half a degree, 3 mm at 0.9 m.
const ANGLE_RAD: f64 = 0.0087;
const SHIFT: f64 = 0.0033;
/// Points lie about where they seem to, part of the distance (standard deviation); what is even is so to this part at first.
const PLACE: f64 = 0.05;
const HEIGHT: f64 = 0.0003;
/// What the rig defines, it defines to so much, radians or metres.
const DEFINED: f64 = 1e-6;

/// Adjusts all views. `None` where the equations cannot be solved: a view whose squares cannot be where they are.
pub fn adjust(frame: &Frame, views: &[ViewData]) -> Option<Adjusted> {
    let start = Adjusted {
        shared: SVector::zeros(),
        deviations: vec![[0.0; DEVIATIONS]; views.len()],
        sigma: default_sigma(frame.distance_m),
        noise: [1.0; 3],
        view_noise: vec![[1.0; 2]; views.len()],
        point_noise: vec![1.0; frame.points_m.len()],
        offsets_m: vec![DVec3::ZERO; frame.points_m.len()],
        height_m: HEIGHT * frame.distance_m,
        joint: vec![],
        mixed: vec![],
        gauge: SMatrix::zeros(),
        misfit: views.iter().map(|view| vec![[1.0; 2]; view.squares.len()]).collect(),
        settled: false,
    };
    adjust_from(frame, views, start, ROUNDS)
}

fn default_sigma(distance_m: f64) -> [f64; DEVIATIONS] {
    let shift_m = SHIFT * distance_m;
    [ANGLE_RAD, ANGLE_RAD, ANGLE_RAD, shift_m, shift_m, shift_m]
}

/// The same from what an earlier adjustment of the same views and points found, in so many rounds at most.
pub fn adjust_from(
    frame: &Frame,
    views: &[ViewData],
    mut state: Adjusted,
    rounds: usize,
) -> Option<Adjusted> {
    let prior = shared_prior(frame)?;
    let points = frame.points_m.len();
    let unknowns = SHARED + POINT * points;
    let mut linears: Vec<Linear> = vec![];
    let mut linear_offsets_m = state.offsets_m.clone();
    let between = |(to, from): (&DVec3, &DVec3)| Vector3::from((*to - *from).to_array());
    for round in 0..rounds {
        let deviations = Matrix6::from_diagonal(&SVector::from(state.sigma.map(|sigma| sigma.powi(-2))));
        let mut matrix = DMatrix::zeros(unknowns, unknowns);
        let mut right = DVector::zeros(unknowns);
        matrix.fixed_view_mut::<SHARED, SHARED>(0, 0).copy_from(&prior);
        right.fixed_rows_mut::<SHARED>(0).copy_from(&-(prior * state.shared));
        let place_m = PLACE * frame.distance_m;
        for (point, offset_m) in state.offsets_m.iter().enumerate() {
            for (axis, sigma_m) in [place_m, place_m, state.height_m].into_iter().enumerate() {
                let i = SHARED + POINT * point + axis;
                matrix[(i, i)] = sigma_m.powi(-2);
                right[i] = -offset_m[axis] * sigma_m.powi(-2);
            }
        }
        if round < RELINEARISED {
            let linear = |(view, deviation): (&ViewData, &Deviation)| {
                frame.linearise(view, &state.shared, deviation, &state.offsets_m)
            };
            linears = views.par_iter().zip(&state.deviations).map(linear).collect::<Option<_>>()?;
            linear_offsets_m.clone_from(&state.offsets_m);
        }
        let moved_m: Vec<Vector3<f64>> = state.offsets_m.iter().zip(&linear_offsets_m).map(between).collect();
        let now = Now { state: &state, moved_m: &moved_m, deviations: &deviations, unknowns };
        let made = views.par_iter().zip(&linears).enumerate();
        let made: Vec<Made> =
            made.map(|(index, (view, linear))| now.make(index, view, linear)).collect::<Option<_>>()?;
        let mut shares = Vec::with_capacity(views.len());
        // What the elimination of the views takes away, as a product of itself.
        let mut eliminated = DMatrix::zeros(DEVIATIONS * views.len(), unknowns);
        for (index, (view, made)) in views.iter().zip(made).enumerate() {
            let mut block = matrix.fixed_view_mut::<SHARED, SHARED>(0, 0);
            block += made.normal;
            right += made.right;
            for (measured, (with_shared, alone)) in view.points.iter().zip(&made.of_points) {
                let column = SHARED + POINT * measured.point;
                let mut block = matrix.fixed_view_mut::<SHARED, POINT>(0, column);
                block += with_shared;
                let mut block = matrix.fixed_view_mut::<POINT, SHARED>(column, 0);
                block += with_shared.transpose();
                let mut block = matrix.fixed_view_mut::<POINT, POINT>(column, column);
                block += alone;
            }
            eliminated.rows_mut(DEVIATIONS * index, DEVIATIONS).copy_from(&made.root);
            state.misfit[index] = made.misfit;
            shares.push(made.share);
        }
        matrix -= eliminated.transpose() * eliminated;
        let covariance = matrix.cholesky()?.inverse();
        let step = &covariance * right;
        state.shared += step.fixed_rows::<SHARED>(0);
        for (point, offset_m) in state.offsets_m.iter_mut().enumerate() {
            let own = step.fixed_rows::<POINT>(SHARED + POINT * point);
            *offset_m += DVec3::new(own[0], own[1], own[2]);
        }
        let gauge = gauge(frame);
        let with_gauge = &covariance * &gauge;
        state.gauge.copy_from(&(gauge.transpose() * &with_gauge));
        let of_view = |(share, deviation): (&mut Share, &mut Deviation)| {
            let own = share.own * (share.right - &share.cross * &step);
            deviation.iter_mut().zip(own.iter()).for_each(|(value, step)| *value += step);
            let through = share.own * &share.cross;
            share.mixed = -(&through * &covariance);
            let mut joint = Joint::zeros();
            let mixed = share.mixed.fixed_columns::<SHARED>(0);
            joint
                .fixed_view_mut::<DEVIATIONS, DEVIATIONS>(0, 0)
                .copy_from(&(share.own - &share.mixed * through.transpose()));
            joint.fixed_view_mut::<DEVIATIONS, SHARED>(0, DEVIATIONS).copy_from(&mixed);
            joint.fixed_view_mut::<SHARED, DEVIATIONS>(DEVIATIONS, 0).copy_from(&mixed.transpose());
            let shared = covariance.fixed_view::<SHARED, SHARED>(0, 0);
            joint.fixed_view_mut::<SHARED, SHARED>(DEVIATIONS, DEVIATIONS).copy_from(&shared);
            let mut with = SMatrix::<f64, ALL, GAUGE>::zeros();
            with.fixed_rows_mut::<DEVIATIONS>(0).copy_from(&(&share.mixed * &gauge));
            with.fixed_rows_mut::<SHARED>(DEVIATIONS).copy_from(&with_gauge.fixed_rows::<SHARED>(0));
            (joint, with)
        };
        (state.joint, state.mixed) = shares.par_iter_mut().zip(&mut state.deviations).map(of_view).unzip();
        if round < 2 {
            // The first steps go the way to where the views are: they say nothing of noise.
            continue;
        }
        let before = state.sigma;
        estimate_sigma(&mut state);
        estimate_height(&covariance, &mut state);
        estimate_noise(views, &shares, &covariance, &mut state);
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

/// The prior's inverse covariance of the shared unknowns.
fn shared_prior(frame: &Frame) -> Option<SMatrix<f64, SHARED, SHARED>> {
    let mut prior = SMatrix::<f64, SHARED, SHARED>::zeros();
    let d = frame.distance_m;
    let shifts = [0.07 * d, 0.07 * d, 0.07 * d, 0.02 * d, 0.02 * d, 0.02 * d, 0.02 * d];
    for i in 0..7 {
        prior[(i, i)] = 0.035f64.powi(-2);
        prior[(7 + i, 7 + i)] = shifts[i].powi(-2);
    }
    if frame.is_rig_s {
        // The surface's turn about the pan axis, the distance, the surface's shift across the axis.
        for i in [6, 9, 11, 12] {
            prior[(i, i)] = DEFINED.powi(-2);
        }
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

/// The points' mean shift along x and y, their turn about z and their scale, as a linear function of all unknowns but the
/// views' own.
fn gauge(frame: &Frame) -> DMatrix<f64> {
    let points = &frame.points_m;
    let mut gauge = DMatrix::zeros(SHARED + POINT * points.len(), GAUGE);
    let n = points.len().max(1) as f64;
    let centre = points.iter().sum::<DVec3>() / n;
    let spread = points.iter().map(|&point| (point - centre).length_squared()).sum::<f64>();
    for (i, point) in points.iter().enumerate() {
        let at = (*point - centre) / spread.max(f64::MIN_POSITIVE);
        let row = SHARED + POINT * i;
        gauge.fixed_view_mut::<1, GAUGE>(row, 0).copy_from_slice(&[1.0 / n, 0.0, -at.y, at.x]);
        gauge.fixed_view_mut::<1, GAUGE>(row + 1, 0).copy_from_slice(&[0.0, 1.0 / n, at.x, at.y]);
    }
    gauge
}

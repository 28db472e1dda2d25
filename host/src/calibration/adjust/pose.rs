//! What an adjustment says of a view.

use nalgebra::{Matrix6, SMatrix, SVector};

use super::scatter::weights;
use super::{
    ALL, Adjusted, CornerCovariance, DEVIATIONS, Deviation, Frame, LENS, Linear, MeasuredSquare, RIG, Seen,
    ViewData, step_of,
};
use crate::geometry::PoseCovariance;

impl Adjusted {
    /// Where a view was seen from.
    pub fn seen(&self, frame: &Frame, view: usize, data: &ViewData) -> Seen {
        frame.rig(&self.shared).see(data.pan_rad, data.tilt_rad, &self.deviations[view])
    }

    /// The covariance of a view's pose, and the same for the lens as it was found: what the picture's blur is made of,
    /// since an error of the lens and the error of the pose that makes up for it move nothing in the picture. Where only the
    /// texture says where the surface is, the latter is also for the place, turn and scale of the texture as found.
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
        let whole = &self.joint[view];
        // What moves all points of the texture together is no one's to see.
        let joint = &match self.gauge.try_inverse().filter(|_| frame.is_rig_s) {
            Some(inverse) => whole - self.mixed[view] * inverse * self.mixed[view].transpose(),
            None => *whole,
        };
        let lens = joint.fixed_view::<LENS, LENS>(DEVIATIONS + RIG, DEVIATIONS + RIG).into_owned();
        let mixed = joint.fixed_view::<ALL, LENS>(0, DEVIATIONS + RIG).into_owned();
        let given = lens.try_inverse().map_or(*joint, |inverse| joint - mixed * inverse * mixed.transpose());
        [whole, &given].map(|joint| {
            let covariance = derivative * joint * derivative.transpose();
            std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)]))
        })
    }

    /// What the squares of a view leave, root mean square over their corners, pixels; 0 without squares.
    pub fn rms_px(&self, frame: &Frame, view: usize, data: &ViewData) -> f64 {
        let predicted = frame.predict(data, &self.shared, &self.deviations[view], &self.offsets_m);
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
pub fn solo(frame: &Frame, view: &ViewData) -> Option<(Deviation, Vec<f64>)> {
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
    let view =
        ViewData { squares: view.squares.iter().map(blurred).collect(), points: vec![], ..view.clone() };
    let mut misfit = vec![[1.0; 2]; view.squares.len()];
    for _ in 0..8 {
        let Linear { residual, derivative, .. } =
            frame.linearise(&view, &SVector::zeros(), &deviation, &[])?;
        let weight = weights(&view, &residual, &[1.0; 3], &[], &mut misfit);
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

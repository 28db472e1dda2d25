//! How a fit answers to noise.

use glam::DVec3;
use nalgebra::{DMatrix, DVector};

use super::{Smooth, hemisphere};

/// What a set of views makes of noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stability {
    /// Condition number of the system that is solved, penalties included.
    pub condition: f64,
    /// Standard deviation of the fitted radiance, root mean square over the hemisphere, per standard deviation of one
    /// observation where all have the same.
    pub noise_gain: f64,
    /// The same in the direction where it is greatest.
    pub noise_gain_max: f64,
}

impl Smooth {
    /// Condition and noise gain for equally weighted `views` (unit vectors, surface frame).
    pub fn stability(&self, views: &[DVec3]) -> Stability {
        let (k, n) = (self.basis.count(self.order), views.len().max(1) as f64);
        let mut design = DMatrix::zeros(k, views.len());
        for (view, mut column) in views.iter().zip(design.column_iter_mut()) {
            self.basis.at(self.order, *view, column.as_mut_slice());
        }
        let system = &design * design.transpose() / n + &self.prior;
        let values = system.clone().symmetric_eigenvalues();
        let condition = values.max() / values.min().max(f64::MIN_POSITIVE);
        // From the noise of the observations to that of the coefficients.
        let operator = super::penalty::system(&system)
            .map_or_else(|| DMatrix::zeros(k, views.len()), |factor| factor.solve(&design) / n);
        let covariance = &operator * operator.transpose();
        let mut row = DVector::zeros(k);
        let (count, mut sum, mut most) = (2000, 0.0, 0.0_f64);
        for direction in hemisphere(count) {
            self.basis.at(self.order, direction, row.as_mut_slice());
            let gain = row.dot(&(&covariance * &row));
            sum += gain / count as f64;
            most = most.max(gain);
        }
        Stability { condition, noise_gain: sum.sqrt(), noise_gain_max: most.sqrt() }
    }
}

//! How much each observation counts.

use glam::DVec3;

use crate::observation::TexelObservations;

/// One texel's observations as the solvers want them: double precision, weighted.
pub(super) struct Samples {
    pub directions: Vec<DVec3>,
    pub radiance: Vec<[f64; 3]>,
    pub weights: Vec<f64>,
}

impl Samples {
    /// Weights are 1 / (σ² + (relative error × radiance)² + floor²): noise, and what no model says exactly.
    ///
    /// Observations that are not finite, or whose weight would not be, are left out.
    pub fn of(texel: &TexelObservations, relative_error: f64, floor: f64) -> Self {
        let n = texel.direction.len();
        let mut samples = Self {
            directions: Vec::with_capacity(n),
            radiance: Vec::with_capacity(n),
            weights: Vec::with_capacity(n),
        };
        for ((direction, radiance), sigma) in texel.direction.iter().zip(&texel.radiance).zip(&texel.sigma) {
            let radiance = radiance.map(f64::from);
            let mean = (radiance[0] + radiance[1] + radiance[2]) / 3.0;
            let model = relative_error * mean;
            let variance = f64::from(*sigma).powi(2) + model * model + floor * floor;
            let weight = variance.recip();
            if direction.is_finite()
                && radiance.iter().all(|l| l.is_finite())
                && weight.is_finite()
                && weight > 0.0
            {
                samples.directions.push(direction.as_dvec3());
                samples.radiance.push(radiance);
                samples.weights.push(weight);
            }
        }
        samples
    }

    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// The weighted mean radiance.
    pub fn mean(&self) -> [f64; 3] {
        let total: f64 = self.weights.iter().sum();
        let mut mean = [0.0; 3];
        for (radiance, weight) in self.radiance.iter().zip(&self.weights) {
            for c in 0..3 {
                mean[c] += weight * radiance[c] / total;
            }
        }
        mean
    }
}

//! The views of one texel, as the loops want them.

use super::lanes::{self, Block, Lane, WIDTH};
use crate::observation::TexelObservations;

/// Directions, root weights and weighted radiance in single precision, in blocks of [`WIDTH`]; what is missing in the
/// last block counts nothing. Weights and radiance are divided by what makes them about 1.
#[derive(Debug, Default)]
pub(super) struct Views {
    pub blocks: Vec<Block>,
    /// How many views there are.
    pub count: usize,
    /// Radiance that counts as 1.
    pub unit: f64,
    /// The expected error of a view whose weight is 1, in units.
    pub error: f64,
    /// Weighted mean radiance, roughly.
    pub mean: [f64; 3],
    /// Sum of weight × radiance² over the channels, roughly.
    pub energy: f64,
    /// Of each view, the root of how much less it counts because it disagrees.
    factors: Vec<Lane>,
    /// Room for the columns, kept between texels.
    pub rows: Vec<Lane>,
    /// Room for one value of each view.
    pub values: Vec<Lane>,
    sorted: Vec<f32>,
}

impl Views {
    /// Takes over a texel's observations. Weights are 1 / (σ² + (relative error × mean of the channels)² + floor²).
    ///
    /// Observations that are not finite are left out.
    pub fn fill(&mut self, texel: &TexelObservations, relative_error: f64, floor: f64) {
        let count = texel.direction.len().min(texel.radiance.len()).min(texel.sigma.len());
        let (direction, radiance) = (&texel.direction[..count], &texel.radiance[..count]);
        let sigma = &texel.sigma[..count];
        let brightest = lanes::brightest_value(direction, radiance, sigma);
        if !brightest.is_finite() {
            return self.fill(&finite(texel), relative_error, floor);
        }
        // A power of two loses no digit.
        self.unit = f64::from(brightest).clamp(1e-30, 1e30).log2().floor().exp2();
        let floor = (floor / self.unit).clamp(1e-15, 1e15) as f32;
        let error = lanes::Error {
            per_unit: (1.0 / self.unit) as f32,
            relative_squared: (relative_error * relative_error / 9.0) as f32,
            floor_squared: floor * floor,
        };
        self.count = count;
        self.blocks.clear();
        lanes::lay(direction, radiance, sigma, error, &mut self.blocks);
        let most = self.blocks.iter().flat_map(|block| block.root_weight).fold(0.0, f32::max);
        self.error = 1.0 / f64::from(most.max(f32::MIN_POSITIVE));
        let [weight, red, green, blue, energy] = lanes::weigh(&mut self.blocks, self.error as f32);
        self.mean = [red, green, blue].map(|sum| sum / weight.max(1e-30));
        self.energy = energy;
        self.factors.clear();
    }

    /// Lowers the weight of views that disagree with the rest (Huber 1964), after the residuals in the last three of
    /// `R` rows; `false`, and nothing changed, where none does.
    pub fn reweight<const R: usize>(&mut self) -> bool {
        let Self { blocks, rows, values, factors, .. } = self;
        values.resize(blocks.len(), [0.0; WIDTH]);
        factors.resize(blocks.len(), [1.0; WIDTH]);
        lanes::misses(blocks, &rows.as_chunks::<R>().0[..blocks.len()], values);
        // Back to what a view counted before, as standard deviations.
        let per_error = (1.0 / 3.0 / (self.error * self.error)) as f32;
        for (miss, factor) in values.as_flattened_mut().iter_mut().zip(factors.as_flattened()) {
            *miss = (*miss * per_error).sqrt() / factor;
        }
        self.sorted.clear();
        self.sorted.extend_from_slice(&values.as_flattened()[..self.count]);
        let (middle, most) = (self.count / 2, self.sorted.iter().copied().fold(0.0, f32::max));
        // The median miss of a Gaussian in three channels is 0.89 standard deviations.
        // Most observations may agree to the last bit: one that rounding moves is no less true, so what is far below
        // the expected error counts as agreement.
        let scale = (*self.sorted.select_nth_unstable_by(middle, f32::total_cmp).1 / 0.89).max(0.01);
        if most <= 4.0 * scale {
            return false;
        }
        for (value, factor) in values.as_flattened_mut().iter_mut().zip(factors.as_flattened_mut()) {
            let new = (2.0 * scale / value.max(f32::MIN_POSITIVE)).min(1.0).sqrt();
            *value = new / *factor;
            *factor = new;
        }
        lanes::scale(blocks, values);
        true
    }

    /// Sums of the squared residuals in the last three of `R` rows: weighted and not; and of the squared radiance.
    pub fn misses<const R: usize>(&mut self) -> [f64; 3] {
        let Self { blocks, rows, values, .. } = self;
        values.resize(blocks.len(), [0.0; WIDTH]);
        lanes::misses(blocks, &rows.as_chunks::<R>().0[..blocks.len()], values)
    }

    /// Counts all views as at first.
    pub fn unweight(&mut self) {
        for factor in self.factors.as_flattened_mut() {
            *factor = 1.0 / *factor;
        }
        lanes::scale(&mut self.blocks, &self.factors);
        self.factors.clear();
    }
}

fn finite(texel: &TexelObservations) -> TexelObservations {
    let mut kept = TexelObservations::default();
    for i in 0..texel.direction.len().min(texel.radiance.len()).min(texel.sigma.len()) {
        if texel.direction[i].is_finite()
            && texel.sigma[i].is_finite()
            && texel.radiance[i].iter().all(|value| value.is_finite())
        {
            kept.direction.push(texel.direction[i]);
            kept.radiance.push(texel.radiance[i]);
            kept.sigma.push(texel.sigma[i]);
        }
    }
    kept
}

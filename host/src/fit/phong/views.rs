//! The views of one texel, as the loops want them.
#![expect(clippy::needless_range_loop, reason = "one index runs through several channels")]

use glam::{DVec3, Vec3};

use super::Lobe;
use super::lanes::{self, Block, Lane, WIDTH};
use super::layout;
use super::refine::{lane_lobe, turns};
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
    /// What each channel was multiplied by, so that all leave equally much.
    pub channels: [f64; 3],
    /// Squares that no lobe can explain, beside those of the blocks.
    pub beyond: f64,
    /// Of each view, the root of how much less it counts because it disagrees.
    factors: Vec<Lane>,
    /// Room for the columns, kept between texels.
    pub rows: Vec<Lane>,
    /// What the lobes leave, weighted.
    pub left: Vec<[Lane; 3]>,
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
        let brightest = layout::brightest_value(radiance);
        if !brightest.is_finite() {
            return self.fill(&texel.usable(), relative_error, floor);
        }
        // A power of two loses no digit.
        self.unit = f64::from(brightest).clamp(1e-30, 1e30).log2().floor().exp2();
        let floor_units = (floor / self.unit).clamp(1e-15, 1e15) as f32;
        let error = layout::Error {
            per_unit: (1.0 / self.unit) as f32,
            relative_squared: (relative_error * relative_error / 9.0) as f32,
            floor_squared: floor_units * floor_units,
        };
        self.count = count;
        self.blocks.clear();
        if layout::lay(direction, radiance, sigma, error, &mut self.blocks).is_nan() {
            return self.fill(&texel.usable(), relative_error, floor);
        }
        let most = self.blocks.iter().flat_map(|block| block.root_weight).fold(0.0, f32::max);
        self.error = 1.0 / f64::from(most.max(f32::MIN_POSITIVE));
        let [weight, red, green, blue, energy] = layout::weigh(&mut self.blocks, self.error as f32);
        self.mean = [red, green, blue].map(|sum| sum / weight.max(1e-30));
        self.energy = energy;
        self.factors.clear();
        (self.channels, self.beyond) = ([1.0; 3], 0.0);
    }

    /// Sum over views and channels of the squares of what is left divided by the expected error, in the samples' own scale.
    pub fn misses(&mut self) -> f64 {
        let Self { blocks, left, values, .. } = self;
        values.resize(blocks.len(), [0.0; WIDTH]);
        let (sums, _) = lanes::misses(&left[..blocks.len()], values);
        let scaled = sums.iter().zip(self.channels).map(|(sum, scale)| sum / (scale * scale));
        scaled.sum::<f64>() / (self.error * self.error)
    }

    /// Scales the channels so that they leave equally much: their noise differs, and the views know it better than a
    /// standard deviation common to them. `squares` are what each leaves; gives what each was multiplied by.
    pub fn balance(&mut self, squares: [f64; 3]) -> [f64; 3] {
        let mean = squares.iter().sum::<f64>() / 3.0;
        // Black views leave nothing.
        let least = (super::refine::ROUNDING * self.energy).max(f64::MIN_POSITIVE);
        let factors = squares.map(|sum| ((mean + least) / (sum + least)).sqrt().clamp(0.25, 4.0));
        layout::scale_channels(&mut self.blocks, factors.map(|factor| factor as f32));
        for c in 0..3 {
            self.channels[c] *= factors[c];
        }
        factors
    }

    /// The most that a single view leaves, squared and summed over its channels.
    pub fn largest_left(&mut self) -> f64 {
        let Self { blocks, left, values, .. } = self;
        values.resize(blocks.len(), [0.0; WIDTH]);
        lanes::misses(&left[..blocks.len()], values).1.into()
    }

    /// Lowers the weight of views that disagree with the rest (Huber 1964), after what is left of them; `false`, and
    /// nothing changed, where none does.
    pub fn reweight(&mut self) -> bool {
        let Self { blocks, left, values, factors, .. } = self;
        values.resize(blocks.len(), [0.0; WIDTH]);
        factors.resize(blocks.len(), [1.0; WIDTH]);
        lanes::misses(&left[..blocks.len()], values);
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
        layout::scale(blocks, values);
        true
    }

    /// A lobe's value in each view, times its root weight.
    pub fn lobe_values(&mut self, lobe: &Lobe) -> &[Lane] {
        let Self { blocks, values, .. } = self;
        values.resize(blocks.len(), [0.0; WIDTH]);
        let values = &mut values[..blocks.len()];
        lanes::values(blocks, &lane_lobe(lobe, &turns(lobe.direction)), values.as_chunks_mut::<1>().0, 0);
        values
    }

    /// Counts all views as at first.
    pub fn unweight(&mut self) {
        for factor in self.factors.as_flattened_mut() {
            *factor = 1.0 / *factor;
        }
        layout::scale(&mut self.blocks, &self.factors);
        self.factors.clear();
    }

    /// Moves to `alone` the views around a direction, with what is left of them for their radiance; what the others say
    /// of the constant becomes a single view from below, which no lobe meets.
    pub fn isolate(&self, around: DVec3, cosine: f64, alone: &mut Self) {
        let around = around.as_vec3().to_array();
        alone.blocks.clear();
        let (mut used, mut rest, mut squares) = (WIDTH, [0.0_f64; 4], 0.0_f64);
        let mut push = |direction: [f32; 3], root: f32, radiance: [f32; 3]| {
            if used == WIDTH {
                alone.blocks.push(Block::EMPTY);
                used = 0;
            }
            if let Some(block) = alone.blocks.last_mut() {
                block.root_weight[used] = root;
                for i in 0..3 {
                    block.direction[i][used] = direction[i];
                    block.radiance[i][used] = radiance[i];
                }
            }
            used += 1;
        };
        for (block, left) in self.blocks.iter().zip(&self.left) {
            for lane in 0..WIDTH {
                let (direction, root) = (block.direction.map(|axis| axis[lane]), block.root_weight[lane]);
                let radiance = left.map(|channel| channel[lane]);
                let near: f32 = direction.iter().zip(around).map(|(a, b)| a * b).sum();
                if f64::from(near) > cosine {
                    push(direction, root, radiance);
                } else {
                    rest[3] += f64::from(root * root);
                    for c in 0..3 {
                        rest[c] += f64::from(root * radiance[c]);
                        squares += f64::from(radiance[c] * radiance[c]);
                    }
                }
            }
        }
        alone.beyond = 0.0;
        if rest[3] > 0.0 {
            let root = rest[3].sqrt();
            let [red, green, blue, _] = rest.map(|sum| sum / root);
            push([0.0, 0.0, -1.0], root as f32, [red as f32, green as f32, blue as f32]);
            // What a constant cannot explain of the rest.
            alone.beyond = (squares - red * red - green * green - blue * blue).max(0.0);
        }
        (alone.count, alone.unit, alone.error) = (self.count, self.unit, self.error);
        (alone.energy, alone.channels) = (self.energy, self.channels);
    }

    /// The brightest view, and the nearest of those around it.
    pub fn peak(&self) -> (DVec3, Vec<DVec3>) {
        let (mut most, mut peak) = (f32::MIN, DVec3::Z);
        let mut all = Vec::new();
        for block in &self.blocks {
            for lane in 0..WIDTH {
                let root = block.root_weight[lane];
                let direction = Vec3::from(block.direction.map(|axis| axis[lane])).as_dvec3();
                if root > 0.0 && direction.z >= 0.0 {
                    all.push(direction);
                    let bright = block.radiance.iter().map(|channel| channel[lane]).sum::<f32>() / root;
                    if bright > most {
                        (most, peak) = (bright, direction);
                    }
                }
            }
        }
        all.retain(|direction| *direction != peak);
        all.sort_by(|a, b| b.dot(peak).total_cmp(&a.dot(peak)));
        all.truncate(6);
        (peak, all)
    }
}

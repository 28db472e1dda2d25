//! One number for each pixel of a view: what squares and texture are aligned by.

use glam::DVec2;

use crate::radiance::RadianceImage;

/// How much each channel counts: about as JPEG keeps them.
const WEIGHTS: [f32; 3] = [0.25, 0.6, 0.15];

/// Radiance of a view as one channel.
pub(super) struct Luminance {
    pub width: usize,
    pub height: usize,
    /// Weighted mean of the channels, row by row; a bound where a pixel was saturated or dark.
    pub value: Vec<f32>,
    /// Variance of it; infinite where nothing is known.
    pub variance: Vec<f32>,
}

impl Luminance {
    /// Over- and under-exposed pixels count with their bounds: a square is dark on bright all the same.
    pub fn of(image: &RadianceImage) -> Self {
        let pixels = image.radiance.iter().zip(&image.variance).zip(&image.mask);
        let (value, variance) = pixels
            .map(|((radiance, variance), &mask)| {
                let (mut sum, mut spread) = (0.0, 0.0);
                for ((&value, &variance), weight) in radiance.iter().zip(variance).zip(WEIGHTS) {
                    let (value, variance) = match variance.is_finite() {
                        true => (value, variance),
                        // At least so much, up to twice of it for all we know.
                        false if mask & RadianceImage::SATURATED != 0 => (value, value * value / 4.0),
                        // Between nothing and the bound, evenly.
                        false if mask & RadianceImage::DARK != 0 => (value / 2.0, value * value / 12.0),
                        false => (value, f32::INFINITY),
                    };
                    sum += weight * value;
                    spread += weight * weight * variance;
                }
                if sum.is_finite() { (sum, spread) } else { (0.0, f32::INFINITY) }
            })
            .unzip();
        Self { width: image.width as usize, height: image.height as usize, value, variance }
    }

    /// The same at a whole fraction of the size: means of blocks of `by` x `by` pixels.
    pub fn reduced(&self, by: usize) -> Self {
        let (width, height) = (self.width / by, self.height / by);
        let mean = |plane: &[f32], power: f32| {
            let block = |i: usize| {
                let first = (i / width) * by * self.width + (i % width) * by;
                let rows = (0..by).map(|row| &plane[first + row * self.width..][..by]);
                rows.flatten().sum::<f32>() / ((by * by) as f32).powf(power)
            };
            (0..width * height).map(block).collect()
        };
        Self { width, height, value: mean(&self.value, 1.0), variance: mean(&self.variance, 2.0) }
    }

    /// Whether a box of pixels lies in the picture.
    pub fn holds(&self, low: DVec2, high: DVec2) -> bool {
        low.min_element() >= 0.0 && high.x < self.width as f64 && high.y < self.height as f64
    }
}

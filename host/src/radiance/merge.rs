//! Merging a view's photographs into radiance: the inverse-variance mean over its exposures.

use rayon::prelude::*;

use super::{Mask, NoiseModel, RadianceImage, Response, Stack};
use crate::{Error, Result};

/// Turns a stack into radiance with its variance. A single photograph will do.
///
/// Each channel is the mean of exposure / time, weighted by the inverse of its variance. A noisy level that happens to
/// be low would claim a small variance and draw the mean down; so the mean found first tells the level that was to be
/// expected in each photograph, and the variances are evaluated there. For the same reason a photograph is left out
/// where its *expected* level comes near black or saturation, as long as others remain.
///
/// A channel that every photograph clipped gets a lower bound, one that was too dark in all of them an upper bound; the
/// pixel is flagged and the channel's variance is infinite. A photograph's pure colours (a border shifted in by an
/// alignment tool, say) are black or saturated in every channel and so never counted as measured.
///
/// # Errors
/// [`Error::Input`] where the response belongs to photographs of another depth.
pub fn merge(stack: &Stack, response: &Response, noise: &NoiseModel) -> Result<RadianceImage> {
    let first = &stack.pictures[0];
    if response.white() != first.white {
        let what = format!("its levels go to {}, the response's to {}", first.white, response.white());
        return Err(Error::input(&first.path, what, "recover or choose a response for these photographs"));
    }
    let tables = [0, 1, 2].map(|channel| Tables::new(response, noise, channel));
    let times: Vec<f32> = stack.exposure_s.iter().map(|&t| t as f32).collect();
    let (width, height) = (first.width as usize, first.height as usize);
    let mut image = RadianceImage {
        width: first.width,
        height: first.height,
        radiance: vec![[0.0; 3]; width * height],
        variance: vec![[0.0; 3]; width * height],
        mask: vec![0; width * height],
    };
    let rows = image.radiance.par_chunks_mut(width).zip(image.variance.par_chunks_mut(width));
    rows.zip(image.mask.par_chunks_mut(width)).enumerate().for_each(|(y, ((radiance, variance), mask))| {
        let levels: Vec<&[[u16; 3]]> =
            stack.pictures.iter().map(|p| &p.levels[y * width..(y + 1) * width]).collect();
        for x in 0..width {
            for (channel, table) in tables.iter().enumerate() {
                let level = |j: usize| levels[j][x][channel];
                let (value, spread, flags) = table.merge(&times, level);
                radiance[x][channel] = value;
                variance[x][channel] = spread;
                mask[x] |= flags;
            }
        }
    });
    Ok(image)
}

/// What a level is worth, and what an exposure would be, in one channel.
struct Tables {
    /// Per level: exposure, and the inverse of its variance; 0 where the level is too dark or saturated.
    levels: Vec<(f32, f32)>,
    /// Inverse variance by exposure, in steps of a 32nd of an octave; 0 where the level to be expected may be clipped.
    expected: Vec<f32>,
    dark_level: u16,
    saturated_level: u16,
    dark: f32,
    saturated: f32,
}

/// The topmost bits of a positive float count its logarithm, near enough.
const SHIFT: u32 = 18;

impl Tables {
    fn new(response: &Response, noise: &NoiseModel, channel: usize) -> Self {
        let table = response.exposure(channel);
        let (dark_level, saturated_level) = (noise.dark_level[channel], noise.saturated_level[channel]);
        let (dark, saturated) = (table[usize::from(dark_level)], table[usize::from(saturated_level)]);
        let variance_at = |x: f32, level: usize| {
            noise.variance(channel, f64::from(x), f64::from(response.slope(channel, level))) as f32
        };
        let levels = (0..table.len()).map(|z| {
            let valid = z > usize::from(dark_level) && z < usize::from(saturated_level);
            (table[z], if valid { 1.0 / variance_at(table[z], z) } else { 0.0 })
        });
        let expected = (0..=(f32::INFINITY.to_bits() >> SHIFT)).map(|index| {
            let x = f32::from_bits((index << SHIFT) | (1 << (SHIFT - 1)));
            let level = table.partition_point(|&entry| entry < x).min(table.len() - 1);
            let variance = variance_at(x, level);
            let margin = 2.0 * variance.sqrt();
            if x - margin > dark && x + margin < saturated { 1.0 / variance } else { 0.0 }
        });
        Self {
            levels: levels.collect(),
            expected: expected.collect(),
            dark_level,
            saturated_level,
            dark,
            saturated,
        }
    }

    /// Radiance, variance and flags from the levels of a pixel; `times` in seconds.
    #[inline]
    fn merge(&self, times: &[f32], level: impl Fn(usize) -> u16) -> (f32, f32, Mask) {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (j, &time_s) in times.iter().enumerate() {
            let (x, inverse) = self.levels[usize::from(level(j))];
            sum += time_s * inverse * x;
            weights += time_s * time_s * inverse;
        }
        if weights == 0.0 {
            return self.bound(times, level);
        }
        let first = sum / weights;
        let (mut sum, mut expected_weights) = (0.0, 0.0);
        for (j, &time_s) in times.iter().enumerate() {
            let z = level(j);
            if z < self.saturated_level {
                let inverse = self.expected[((first * time_s).to_bits() >> SHIFT) as usize];
                sum += time_s * inverse * self.levels[usize::from(z)].0;
                expected_weights += time_s * time_s * inverse;
            }
        }
        if expected_weights > 0.0 {
            return (sum / expected_weights, 1.0 / expected_weights, 0);
        }
        (first, 1.0 / weights, 0)
    }

    #[cold]
    fn bound(&self, times: &[f32], level: impl Fn(usize) -> u16) -> (f32, f32, Mask) {
        let (mut lower, mut upper) = (0.0f32, f32::INFINITY);
        for (j, &time_s) in times.iter().enumerate() {
            if level(j) >= self.saturated_level {
                lower = lower.max(self.saturated / time_s);
            } else if level(j) <= self.dark_level {
                upper = upper.min(self.dark / time_s);
            }
        }
        let mut flags = 0;
        if lower > 0.0 {
            flags |= RadianceImage::SATURATED;
        }
        if upper < f32::INFINITY {
            flags |= RadianceImage::DARK;
        }
        (if lower > 0.0 { lower } else { upper }, f32::INFINITY, flags)
    }
}

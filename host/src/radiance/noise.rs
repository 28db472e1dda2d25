//! How much the exposure that a level stands for varies: shot noise, read noise, and the noise of levels themselves.

use rayon::prelude::*;

use super::samples::SIDE;
use super::{Response, Samples};
use crate::picture::Picture;

/// The variance of an exposure x (response table's unit), per channel:
/// `shot * x + read + slope(x)² * level`, where the slope is the response's: exposure per level.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseModel {
    /// Variance per exposure: the photons' own.
    pub shot: [f64; 3],
    /// Variance of what the sensor adds before the response.
    pub read: [f64; 3],
    /// Variance in levels after the response: rounding (1/12) and JPEG's quantisation.
    pub level: [f64; 3],
    /// From this level on a pixel counts as saturated.
    pub saturated_level: [u16; 3],
    /// Up to this level a pixel counts as too dark.
    pub dark_level: [u16; 3],
}

/// A block is looked at where its mean exposure is so many standard deviations of a pixel from black.
const FAINT: f64 = 3.0;

/// What one bin of pairs says: observed variance of relative differences, and what one unit of each term would cause.
struct Equation {
    observed: f64,
    terms: [f64; 3],
    weight: f64,
}

impl NoiseModel {
    /// An ordinary camera: 10,000 electrons at white, 5 of read noise, and half a level of JPEG noise in 8-bit
    /// pictures. For photographs without a bracket to learn from.
    pub fn assumed(response: &Response) -> Self {
        const WELL: f64 = 10_000.0;
        let white = usize::from(response.white());
        let full = [0, 1, 2].map(|c| match response.white() {
            // Half floats reach far beyond what a sensor holds; take 1 for its white.
            Picture::FLOAT_WHITE => 1.0,
            _ => f64::from(response.exposure(c)[white]),
        });
        let level = if white == 255 { 1.0 / 12.0 + 0.25 } else { 1.0 / 12.0 };
        let mut noise = Self {
            shot: full.map(|x| x / WELL),
            read: full.map(|x| (5.0 * x / WELL).powi(2)),
            level: [level; 3],
            // JPEG's ringing leaves clipped pixels a few levels below white.
            saturated_level: [if white == 255 { 250 } else { (white - white / 100) as u16 }; 3],
            dark_level: [0; 3],
        };
        noise.set_dark_level(response);
        noise
    }

    /// Variance of the exposure `x` where one level means `slope` of it.
    pub(crate) fn variance(&self, channel: usize, x: f64, slope: f64) -> f64 {
        self.shot[channel] * x.max(0.0) + self.read[channel] + slope * slope * self.level[channel]
    }

    /// Variance of the exposure at a level, relative to its square.
    pub(super) fn relative_variance(&self, response: &Response, channel: usize, level: usize) -> f64 {
        let x = f64::from(response.exposure(channel)[level]);
        let slope = f64::from(response.slope(channel, level));
        self.variance(channel, x, slope) / (x * x).max(f64::MIN_POSITIVE)
    }

    /// A level is too dark where the standard deviation is more than half of the exposure.
    fn set_dark_level(&mut self, response: &Response) {
        let middle = usize::from(response.white()) / 2;
        for channel in 0..3 {
            let dark = (1..middle).rev().find(|&z| self.relative_variance(response, channel, z) > 0.25);
            self.dark_level[channel] = dark.unwrap_or(0) as u16;
        }
    }
}

impl Samples {
    /// The noise of the camera, from how much the exposures of a block contradict each other; what the samples do not
    /// show keeps the value of [`NoiseModel::assumed`].
    pub fn noise(&self, response: &Response) -> NoiseModel {
        let mut noise = NoiseModel::assumed(response);
        let found: Vec<NoiseModel> =
            (0..3).into_par_iter().map(|channel| self.noise_of(channel, response, noise.clone())).collect();
        for (c, found) in found.iter().enumerate() {
            (noise.shot[c], noise.read[c], noise.level[c]) = (found.shot[c], found.read[c], found.level[c]);
            noise.saturated_level[c] = found.saturated_level[c];
        }
        noise.set_dark_level(response);
        noise
    }

    /// `noise` with one channel's part as it is found.
    fn noise_of(&self, channel: usize, response: &Response, mut noise: NoiseModel) -> NoiseModel {
        // Where the curve is a guess, what it says of white is one too.
        if !response.is_assumed()
            && let Some(limit) = saturation(self, response, channel, noise.saturated_level[channel])
        {
            noise.saturated_level[channel] = limit;
        }
        // What is too dark to be looked at depends on the noise: once more with what was found.
        for _ in 0..2 {
            let equations = equations(self, response, &noise, channel);
            if equations.len() >= 8 {
                // Rounding is certain, so it is taken out first and put back.
                let rounding = 1.0 / 12.0;
                let terms = fit(&equations, rounding);
                [noise.shot[channel], noise.read[channel]] = [terms[0], terms[1]];
                noise.level[channel] = rounding + terms[2];
            }
        }
        noise
    }
}

/// Pairs of neighbouring exposures of each pixel, gathered by brightness and ratio of times. A block counts where its mean
/// says that black and saturation are out of noise's reach: chosen by its own level, a pixel would be chosen by its noise.
fn equations(samples: &Samples, response: &Response, noise: &NoiseModel, channel: usize) -> Vec<Equation> {
    let table = response.exposure(channel);
    let level_at = |x: f64| table.partition_point(|&entry| f64::from(entry) < x).min(table.len() - 1);
    let saturated = f64::from(table[usize::from(noise.saturated_level[channel])]);
    let mut bins: std::collections::BTreeMap<(i32, i32), (Vec<f64>, [f64; 3])> = Default::default();
    for block in samples.thinned() {
        let exposure_s = samples.exposure_s(block);
        let exposures: Vec<[f64; SIDE * SIDE]> = block
            .levels
            .iter()
            .map(|levels| levels.map(|l| f64::from(table[usize::from(l[channel])])))
            .collect();
        let clear: Vec<bool> = exposures
            .iter()
            .map(|block| {
                let mean = block.iter().sum::<f64>() / block.len() as f64;
                let most = block.iter().fold(0.0f64, |most, &x| most.max(x));
                let slope = f64::from(response.slope(channel, level_at(mean)));
                let sigma = noise.variance(channel, mean, slope).sqrt();
                mean > FAINT * sigma && mean + 4.0 * sigma < saturated && most < saturated
            })
            .collect();
        for i in (1..block.levels.len()).filter(|&i| clear[i - 1] && clear[i]) {
            let times = [exposure_s[i - 1], exposure_s[i]];
            let stops = (times[0] / times[1]).log2();
            if !(0.1..=4.0).contains(&stops) {
                continue;
            }
            for (&a, &b) in exposures[i - 1].iter().zip(&exposures[i]) {
                let radiance = (a + b) / (times[0] + times[1]);
                let mut terms = [0.0; 3];
                for t in times {
                    let (x, unit) = (radiance * t, (radiance * t).powi(-2));
                    terms[0] += x * unit;
                    terms[1] += unit;
                    terms[2] += f64::from(response.slope(channel, level_at(x))).powi(2) * unit;
                }
                let key = ((4.0 * (radiance * times[0]).log2()) as i32, (4.0 * stops).round() as i32);
                let (differences, sums) = bins.entry(key).or_default();
                differences.push((a / times[0] - b / times[1]) / radiance);
                sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
            }
        }
    }
    bins.into_values().filter(|(d, _)| d.len() >= 64).map(|(d, sums)| equation(d, sums)).collect()
}

fn equation(mut differences: Vec<f64>, sums: [f64; 3]) -> Equation {
    let count = differences.len();
    differences.sort_by(f64::total_cmp);
    let median = differences[count / 2];
    differences.iter_mut().for_each(|d| *d = (*d - median).abs());
    differences.sort_by(f64::total_cmp);
    // The variance of all but the few that something else than noise disturbed: a ghost, a moved edge.
    let limit = 4.0 * differences[count * 683 / 1000];
    let kept = differences.partition_point(|&d| d <= limit);
    let observed = differences[..kept].iter().map(|d| d * d).sum::<f64>() / kept as f64;
    Equation { observed, terms: sums.map(|sum| sum / count as f64), weight: (count as f64).sqrt().min(100.0) }
}

/// Shot, read and level variance, none negative, that explain the bins best, each by its relative error.
/// At least `rounding` of level variance is taken as given and not returned.
fn fit(equations: &[Equation], rounding: f64) -> [f64; 3] {
    let mut terms = [0.0; 3];
    let scale: [f64; 3] =
        [0, 1, 2].map(|k| equations.iter().map(|e| e.terms[k]).sum::<f64>() / equations.len() as f64);
    // Coordinate descent on the non-negative quadratic; the weights follow the prediction, which a small observed
    // variance would otherwise draw down.
    for round in 0..400 {
        for k in 0..3 {
            let (mut up, mut down) = (0.0, 0.0);
            for e in equations {
                let given = rounding * e.terms[2];
                let predicted = given + (0..3).map(|j| terms[j] * e.terms[j]).sum::<f64>();
                let expected = if round < 20 { e.observed.max(given) } else { predicted };
                let weight = e.weight / (expected * expected).max(f64::MIN_POSITIVE);
                up += weight * e.terms[k] * (e.observed - predicted);
                down += weight * e.terms[k] * e.terms[k];
            }
            if down > 0.0 && scale[k] > 0.0 {
                terms[k] = (terms[k] + up / down).max(0.0);
            }
        }
    }
    terms
}

/// The lowest level near white at which clipped pixels are found: such a level was seen where the shorter exposures
/// say that white was passed. `None` where nothing came near.
fn saturation(samples: &Samples, response: &Response, channel: usize, assumed: u16) -> Option<u16> {
    let table = response.exposure(channel);
    let white = usize::from(response.white());
    // Below three quarters of white only something other than clipping explains a contradiction.
    let lowest = white * 3 / 4;
    let bins = 256.min(white + 1);
    let bin_of = |z: usize| z * bins / (white + 1);
    let (mut seen, mut clipped) = (vec![0u32; bins], vec![0u32; bins]);
    for block in samples.thinned() {
        let exposure_s = samples.exposure_s(block);
        for i in 1..block.levels.len() {
            for (a, b) in block.levels[i - 1].iter().zip(&block.levels[i]) {
                let (long, short) = (usize::from(a[channel]), usize::from(b[channel]));
                if long < lowest || short == 0 || short >= usize::from(assumed) {
                    continue;
                }
                let expected = f64::from(table[short]) * exposure_s[i - 1] / exposure_s[i];
                seen[bin_of(long)] += 1;
                clipped[bin_of(long)] += u32::from(expected > 1.05 * f64::from(table[white]));
            }
        }
    }
    let first = (bin_of(lowest)..bins).rev().find(|&k| seen[k] >= 16 && clipped[k] * 10 < seen[k])?;
    // The level after the last good one, but never above what is assumed without data.
    let level = ((first + 1) * (white + 1) / bins).min(usize::from(assumed));
    Some(level as u16)
}

#[cfg(test)]
mod tests {
    use super::super::samples::{Block, Bracket};
    use super::super::simulated::{self, CURVES};
    use super::*;

    #[test]
    fn the_noise_of_a_simulated_camera_is_found() {
        let (_, curve) = CURVES[0];
        let table: Vec<f32> = (0..256).map(|z| simulated::truth(curve, z) as f32).collect();
        let response = Response::from_tables([table.clone(), table.clone(), table]);
        for scale in [1.0, 3.0] {
            let mut samples = Samples::default();
            for view in 0..3 {
                let scene = simulated::scene(256, 192, view);
                samples
                    .add(&simulated::shoot(&scene, 256, &[4.0, 2.0, 1.0, 0.5], curve, scale, view))
                    .unwrap();
            }
            let noise = samples.noise(&response);
            println!("{noise:?}");
            let unit = simulated::truth(curve, 128);
            for level in [30, 80, 130, 180, 230] {
                let x = simulated::truth(curve, level);
                let electrons = x * simulated::WELL;
                let slope = f64::from(response.slope(1, level)) * unit;
                let sensor = scale * scale * (electrons + simulated::READ.powi(2)) / electrons.powi(2);
                let truth = sensor + (slope / x).powi(2) / 12.0;
                let ratio = noise.relative_variance(&response, 1, level) / truth;
                assert!((0.75..1.33).contains(&ratio), "noise x{scale}, level {level}: {ratio}");
            }
        }
    }

    #[test]
    fn clipping_below_white_is_noticed() {
        let (_, curve) = CURVES[0];
        let scene = simulated::scene(256, 192, 4);
        let mut stack = simulated::shoot(&scene, 256, &[4.0, 2.0, 1.0, 0.5], curve, 1.0, 4);
        // A converter that never goes beyond 240, with some ringing.
        for picture in &mut stack.pictures {
            for (i, level) in picture.levels.iter_mut().flatten().enumerate() {
                *level = if *level >= 240 { 238 + (i % 5) as u16 } else { *level };
            }
        }
        let mut samples = Samples::default();
        samples.add(&stack).unwrap();
        let noise = samples.noise(&samples.response().unwrap());
        assert!(
            noise.saturated_level.iter().all(|&z| (225..=238).contains(&z)),
            "{:?}",
            noise.saturated_level
        );
    }

    #[test]
    fn sixteen_bits_that_never_clip_are_not_all_saturated() {
        let response = Response::linear(u16::MAX);
        let block = |long: u16| Block {
            stack: 0,
            levels: vec![[[long; 3]; SIDE * SIDE], [[long / 2; 3]; SIDE * SIDE]],
        };
        let samples = Samples {
            blocks: vec![block(65_500), block(65_400)],
            stacks: vec![Bracket { paths: vec!["a.png".into(), "b.png".into()], exposure_s: vec![1.0, 0.5] }],
            white: u16::MAX,
            bracketed: true,
        };
        let assumed = NoiseModel::assumed(&response).saturated_level;
        assert_eq!(samples.noise(&response).saturated_level, assumed);
    }
}

//! Recovery of the response from bracketed photographs.
//!
//! Debevec and Malik, "Recovering High Dynamic Range Radiance Maps from Photographs", SIGGRAPH 97, equation 3:
//! g(level) = ln radiance + ln exposure time, solved for g and for the radiances at once. What differs here:
//! - an observation is the mean over a block of pixels. The mean of g is linear in g, so the equation stays exact on
//!   texture, and the noise of levels, which flattens a curve fitted to single pixels, averages out.
//! - weights are inverse variances from the noise model instead of a hat, and large residuals count less.
//! - smoothness is asked of the deviation from sRGB over the logarithm of the level, in which cameras' curves bend evenly.
//! - the radiances are eliminated, so that the system has the size of the curve however many pixels are used.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::samples::Block;
use super::{NoiseModel, Response, Samples};
use crate::{Error, Result};

/// The curve is sought at this many levels; deeper pictures are interpolated between them.
const KNOTS: usize = 256;
/// Blocks beyond this number are thinned out evenly: they would take time and change nothing.
const MOST_BLOCKS: usize = 8000;
/// How well the model itself is thought to hold, relative; keeps single blocks from ruling.
const MODEL_ERROR: f64 = 0.01;
/// Standard deviation of the curve's second derivative over ln(level), from sRGB's: how much cameras differ in bend.
const BEND: f64 = 0.3;
/// Where ln(level + SOFTENING) turns from linear to logarithmic, in 256ths of white.
const SOFTENING: f64 = 6.0;

impl Samples {
    /// The camera's response, per channel, never decreasing, 1 at the middle level.
    ///
    /// # Errors
    /// [`Error::Request`] where no stack had two different exposure times, or where no block was measured twice.
    pub fn response(&self) -> Result<Response> {
        if !self.bracketed {
            return Err(Error::request(
                "the response cannot be recovered: no view was photographed with two different exposure times",
                "photograph some views with times one stop apart, or choose the response `srgb` or `linear`",
            ));
        }
        let step = self.blocks.len().div_ceil(MOST_BLOCKS).max(1);
        let blocks: Vec<&Block> = self.blocks.iter().step_by(step).collect();
        let mut response = Response::srgb(self.white);
        let mut noise = NoiseModel::assumed(&response);
        for _ in 0..2 {
            let tables: Vec<Vec<f32>> = (0..3usize)
                .into_par_iter()
                .map(|channel| recover(&blocks, self.white, channel, &response, &noise))
                .collect::<Result<_>>()?;
            let tables = tables.try_into().expect("three channels were asked for");
            response = Response::from_tables(tables);
            noise = self.noise(&response);
        }
        Ok(response)
    }
}

/// A block in one photograph: its histogram over knots (adding to 1), ln exposure time, and variance of its mean g.
struct Row {
    histogram: Vec<(usize, f64)>,
    ln_time: f64,
    weight: f64,
}

fn recover(
    blocks: &[&Block],
    white: u16,
    channel: usize,
    response: &Response,
    noise: &NoiseModel,
) -> Result<Vec<f32>> {
    let relative_variance: Vec<f64> = (0..=usize::from(white))
        .map(|level| noise.relative_variance(response, channel, level).min(1e6))
        .collect();
    let groups: Vec<Vec<Row>> = blocks
        .iter()
        .map(|block| rows(block, white, channel, &relative_variance, noise.saturated_level[channel]))
        .filter(|rows| rows.len() >= 2 && rows[0].ln_time - rows[rows.len() - 1].ln_time > 0.05)
        .collect();
    if groups.is_empty() {
        return Err(Error::request(
            format!(
                "the response cannot be recovered: no part of the photographs is well exposed twice in channel {channel}"
            ),
            "take exposures at most two stops apart, or choose the response `srgb` or `linear`",
        ));
    }
    let baseline: Vec<f64> = knot_levels().map(baseline_at).collect();
    let mut g = baseline.clone();
    // Residuals of the baseline say nothing about outliers: the first pass trusts every row.
    for pass in 0..5 {
        let (mut matrix, mut right) = smoothness(&baseline);
        for rows in &groups {
            add_group(rows, (pass > 0).then_some(&g), &mut matrix, &mut right);
        }
        g = solve_monotone(&matrix, &right);
    }
    Ok((0..=usize::from(white)).map(|level| interpolate(&g, level, white).exp() as f32).collect())
}

/// Rows of the photographs in which the whole block lies between black and saturation.
fn rows(block: &Block, white: u16, channel: usize, relative_variance: &[f64], saturated: u16) -> Vec<Row> {
    let mut rows = Vec::new();
    for (levels, &time_s) in block.levels.iter().zip(&block.exposure_s) {
        if levels.iter().any(|l| l[channel] == 0 || l[channel] >= saturated) {
            continue;
        }
        let share = 1.0 / levels.len() as f64;
        let mut histogram: Vec<(usize, f64)> = Vec::with_capacity(8);
        let mut add = |knot: usize, weight: f64| match histogram.iter_mut().find(|(k, _)| *k == knot) {
            _ if weight == 0.0 => {}
            Some((_, sum)) => *sum += weight,
            None => histogram.push((knot, weight)),
        };
        let mut variance = MODEL_ERROR.powi(2);
        for level in levels.map(|l| usize::from(l[channel])) {
            let (knot, part) = knot_of(level, white);
            add(knot, share * (1.0 - part));
            add((knot + 1).min(KNOTS - 1), share * part);
            variance += relative_variance[level] * share * share;
        }
        rows.push(Row { histogram, ln_time: time_s.ln(), weight: 1.0 / variance });
    }
    rows
}

/// Adds a block's rows to the normal equations with its ln radiance eliminated; where a curve is known already, rows
/// count less the more they contradict it (Cauchy's weights).
fn add_group(rows: &[Row], g: Option<&Vec<f64>>, matrix: &mut DMatrix<f64>, right: &mut DVector<f64>) {
    let mut weights: Vec<f64> = rows.iter().map(|row| row.weight).collect();
    if let Some(g) = g {
        let says: Vec<f64> = rows
            .iter()
            .map(|row| row.histogram.iter().map(|&(k, share)| share * g[k]).sum::<f64>() - row.ln_time)
            .collect();
        for _ in 0..3 {
            let total: f64 = weights.iter().sum();
            let mean = weights.iter().zip(&says).map(|(w, s)| w * s).sum::<f64>() / total;
            for ((weight, row), s) in weights.iter_mut().zip(rows).zip(&says) {
                *weight = row.weight / (1.0 + (s - mean).powi(2) * row.weight / 4.0);
            }
        }
    }
    let total: f64 = weights.iter().sum();
    let mean_time = weights.iter().zip(rows).map(|(w, row)| w * row.ln_time).sum::<f64>() / total;
    let mut mean: Vec<(usize, f64)> = Vec::new();
    for (row, &weight) in rows.iter().zip(&weights) {
        for &(i, share_i) in &row.histogram {
            right[i] += weight * share_i * (row.ln_time - mean_time);
            for &(k, share_k) in &row.histogram {
                matrix[(i, k)] += weight * share_i * share_k;
            }
            mean.push((i, weight * share_i));
        }
    }
    mean.sort_unstable_by_key(|&(i, _)| i);
    mean.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    for &(i, a) in &mean {
        for &(k, b) in &mean {
            matrix[(i, k)] -= a * b / total;
        }
    }
}

/// The penalty on bend, the integral of the squared second derivative over ln(level + SOFTENING), of the deviation
/// from the baseline; and the middle level pinned, which the photographs leave free.
fn smoothness(baseline: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
    let mut matrix = DMatrix::<f64>::zeros(KNOTS, KNOTS);
    let at: Vec<f64> = knot_levels().map(|level| (level * 255.0 + SOFTENING).ln()).collect();
    for k in 1..KNOTS - 1 {
        let (before, after) = (at[k] - at[k - 1], at[k + 1] - at[k]);
        let width = (before + after) / 2.0;
        let bend = [1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after].map(|b| b / width);
        for (i, a) in bend.iter().enumerate() {
            for (j, b) in bend.iter().enumerate() {
                matrix[(k - 1 + i, k - 1 + j)] += a * b * width / (BEND * BEND);
            }
        }
    }
    let mut right: DVector<f64> = &matrix * DVector::from_column_slice(baseline);
    matrix[(KNOTS / 2, KNOTS / 2)] += 1.0;
    right[KNOTS / 2] += baseline[KNOTS / 2];
    (matrix, right)
}

/// The curve of least cost that grows everywhere: steps that fall are fastened, one set after the other.
fn solve_monotone(matrix: &DMatrix<f64>, right: &DVector<f64>) -> Vec<f64> {
    // The least growth per knot: a curve that is flat would give a level no exposure of its own.
    const LEAST: f64 = 1e-4;
    let firm = matrix.diagonal().max() * 1e3;
    let (mut held, mut right) = (matrix.clone(), right.clone());
    for _ in 0..KNOTS {
        let Some(factor) = held.clone().cholesky() else { break };
        let g = factor.solve(&right);
        let falling: Vec<usize> = (1..KNOTS).filter(|&k| g[k] - g[k - 1] < LEAST / 2.0).collect();
        if falling.is_empty() {
            return g.iter().copied().collect();
        }
        for k in falling {
            held[(k, k)] += firm;
            held[(k - 1, k - 1)] += firm;
            held[(k, k - 1)] -= firm;
            held[(k - 1, k)] -= firm;
            right[k] += firm * LEAST;
            right[k - 1] -= firm * LEAST;
        }
    }
    // Not reached for finite weights: the penalty alone makes the matrix positive definite, and each round fastens a
    // new step. The baseline grows.
    knot_levels().map(baseline_at).collect()
}

fn knot_levels() -> impl Iterator<Item = f64> {
    (0..KNOTS).map(|k| k as f64 / (KNOTS - 1) as f64)
}

/// ln of sRGB's exposure; finite at level 0, which stands for half a level.
fn baseline_at(level: f64) -> f64 {
    let level = level.max(0.5 / 255.0);
    if level <= 0.04045 { (level / 12.92).ln() } else { 2.4 * ((level + 0.055) / 1.055).ln() }
}

fn knot_of(level: usize, white: u16) -> (usize, f64) {
    let at = level as f64 * (KNOTS - 1) as f64 / f64::from(white);
    (at as usize, at.fract())
}

fn interpolate(g: &[f64], level: usize, white: u16) -> f64 {
    let (knot, part) = knot_of(level, white);
    g[knot] * (1.0 - part) + g[(knot + 1).min(KNOTS - 1)] * part
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{self, CURVES, Curve};
    use super::*;

    fn recovered(curve: Curve, times: &[f64], noise: f64, views: u64) -> Response {
        let mut samples = Samples::default();
        for view in 0..views {
            let scene = simulated::scene(192, 144, view);
            samples.add(&simulated::shoot(&scene, 192, times, curve, noise, 100 + view)).unwrap();
        }
        samples.response().unwrap()
    }

    /// Median relative error over levels 20 to 235 after the median factor, the worst channel.
    fn error(response: &Response, curve: Curve) -> f64 {
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let channels = (0..3).map(|channel| {
            let table = response.exposure(channel);
            let ratio: Vec<f64> =
                (20..=235).map(|z| f64::from(table[z]) / simulated::truth(curve, z)).collect();
            let scale = median(ratio.clone());
            median(ratio.iter().map(|r| (r / scale - 1.0).abs()).collect())
        });
        channels.fold(0.0, f64::max)
    }

    fn grows(response: &Response) -> bool {
        (0..3).all(|c| response.exposure(c).windows(2).all(|pair| pair[0] < pair[1]))
    }

    #[test]
    fn curves_unlike_each_other_are_recovered_from_few_exposures() {
        for (name, curve) in CURVES {
            for (times, views) in
                [(&[4.0, 1.0, 0.25][..], 3), (&[2.0, 1.0], 6), (&[4.0, 2.0, 1.0, 0.5, 0.25], 2)]
            {
                let response = recovered(curve, times, 1.0, views);
                let error = error(&response, curve);
                println!("{name}, {} exposures, {views} views: {:.2} %", times.len(), 100.0 * error);
                assert!(error < 0.02, "{name} {times:?}: {error}");
                assert!(grows(&response), "{name} {times:?}");
            }
        }
    }

    #[test]
    fn the_curve_grows_whatever_the_noise() {
        for (name, curve) in CURVES {
            assert!(grows(&recovered(curve, &[1.0, 0.5], 10.0, 1)), "{name}");
        }
    }

    #[test]
    fn sixteen_bits_are_recovered_like_eight() {
        let (_, curve) = CURVES[0];
        let mut samples = Samples::default();
        for view in 0..3 {
            let scene = simulated::scene(192, 144, view);
            let mut stack = simulated::shoot(&scene, 192, &[4.0, 2.0, 1.0, 0.5], curve, 1.0, view);
            for picture in &mut stack.pictures {
                picture.white = u16::MAX;
                picture.levels.iter_mut().flatten().for_each(|level| *level *= 257);
            }
            samples.add(&stack).unwrap();
        }
        let response = samples.response().unwrap();
        assert_eq!(response.white(), u16::MAX);
        assert!(grows(&response));
        let ratio = |z: usize| f64::from(response.exposure(1)[z * 257]) / simulated::truth(curve, z);
        for z in [30, 60, 90, 180, 230] {
            assert!((ratio(z) / ratio(120) - 1.0).abs() < 0.03, "{z}: {}", ratio(z) / ratio(120));
        }
    }

    #[test]
    fn without_a_bracket_there_is_nothing_to_recover() {
        let scene = simulated::scene(64, 48, 1);
        let mut samples = Samples::default();
        samples.add(&simulated::shoot(&scene, 64, &[1.0], CURVES[0].1, 1.0, 1)).unwrap();
        samples.add(&simulated::shoot(&scene, 64, &[1.0, 1.0], CURVES[0].1, 1.0, 1)).unwrap();
        let message = samples.response().unwrap_err().to_string();
        assert!(message.contains("two different exposure times") && message.contains("srgb"), "{message}");
        // A bracket of nothing but black tells nothing either.
        samples
            .add(&simulated::shoot(&vec![[0.0; 3]; 64 * 48], 64, &[1.0, 2.0], CURVES[0].1, 0.0, 1))
            .unwrap();
        assert!(samples.response().unwrap_err().to_string().contains("well exposed"));
        let mut deep = simulated::shoot(&scene, 64, &[1.0, 2.0], CURVES[0].1, 1.0, 1);
        deep.pictures.iter_mut().for_each(|picture| picture.white = u16::MAX);
        assert!(samples.add(&deep).unwrap_err().to_string().contains("65535"));
    }
}

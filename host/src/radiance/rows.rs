//! Blocks of pixels as rows of equations for the logarithm of a response at its knots; what recovers the curve and what
//! measures exposure times have in common.

use nalgebra::DVector;

use super::samples::Block;
use super::{NoiseModel, Response};

/// The curve is sought at this many levels; deeper pictures are interpolated between them.
pub(super) const KNOTS: usize = 256;
/// How well the model itself is thought to hold, relative, before it has been tried; keeps single blocks from ruling.
pub(super) const MODEL_ERROR: f64 = 0.01;
/// Where a pixel's relative variance is greater than this, black cuts off too much of its noise for an unbiased mean.
const FAINT: f64 = 1.0 / 16.0;

/// What is known of one channel before the curve is found again.
pub(super) struct Camera {
    channel: usize,
    pub white: u16,
    saturated_level: u16,
    /// Per knot, the variance of a pixel's exposure relative to its square.
    relative_variance: Vec<f64>,
    dark_knot: usize,
    saturated_knot: usize,
    /// How well the model holds, relative.
    pub model_error: f64,
}

impl Camera {
    pub fn new(response: &Response, noise: &NoiseModel, channel: usize) -> Self {
        let white = response.white();
        let level_of = |knot: usize| knot * usize::from(white) / (KNOTS - 1);
        let knot = |level: u16| knot_of(usize::from(level), white).0;
        Self {
            channel,
            white,
            saturated_level: noise.saturated_level[channel],
            relative_variance: (0..KNOTS)
                .map(|k| noise.relative_variance(response, channel, level_of(k)).min(1e6))
                .collect(),
            dark_knot: knot(noise.dark_level[channel]),
            saturated_knot: knot(noise.saturated_level[channel]),
            model_error: MODEL_ERROR,
        }
    }
}

impl Camera {
    /// Whether the whole block is black, or saturated.
    pub fn beyond<const N: usize>(&self, levels: &[[u16; 3]; N]) -> (bool, bool) {
        let all = |is: &dyn Fn(u16) -> bool| levels.iter().all(|level| is(level[self.channel]));
        (all(&|level| level == 0), all(&|level| level >= self.saturated_level))
    }

    /// ln exposure below which a level is too dark, and from which on it is saturated.
    pub fn limits(&self, curve: &DVector<f64>) -> [f64; 2] {
        [curve[self.dark_knot], curve[self.saturated_knot]]
    }
}

/// A block in one photograph: its histogram over knots (adding to 1) and ln exposure time.
pub(super) struct Row {
    pub photograph: usize,
    pub pixels: f64,
    pub histogram: Vec<(usize, f64)>,
    pub ln_time: f64,
}

/// Rows of the photographs in which the whole block lies between black and saturation.
pub(super) fn rows(block: &Block, exposure_s: &[f64], camera: &Camera) -> Vec<Row> {
    let mut rows = Vec::new();
    for (photograph, (levels, &time_s)) in block.levels.iter().zip(exposure_s).enumerate() {
        if levels.iter().any(|l| l[camera.channel] == 0 || l[camera.channel] >= camera.saturated_level) {
            continue;
        }
        let share = 1.0 / levels.len() as f64;
        let mut histogram: Vec<(usize, f64)> = Vec::with_capacity(8);
        let mut add = |knot: usize, weight: f64| match histogram.iter_mut().find(|(k, _)| *k == knot) {
            _ if weight == 0.0 => {}
            Some((_, sum)) => *sum += weight,
            None => histogram.push((knot, weight)),
        };
        for level in levels.map(|l| usize::from(l[camera.channel])) {
            let (knot, part) = knot_of(level, camera.white);
            add(knot, share * (1.0 - part));
            add((knot + 1).min(KNOTS - 1), share * part);
        }
        rows.push(Row { photograph, pixels: levels.len() as f64, histogram, ln_time: time_s.ln() });
    }
    rows
}

/// A block in all its photographs, about the last curve found.
pub(super) struct Group<'a> {
    pub rows: &'a [Row],
    /// Per row: ln of the mean exposure, as the curve has it.
    pub ln_exposure: Vec<f64>,
    pub weights: Vec<f64>,
}

impl<'a> Group<'a> {
    /// `None` where fewer than two photographs count. Where the curve is `known`, rows count less the more they contradict
    /// it (Cauchy's weights), and not at all where noise may have taken their level into black or saturation.
    pub fn new(rows: &'a [Row], g: &DVector<f64>, camera: &Camera, known: bool) -> Option<Self> {
        let ln_exposure: Vec<f64> = rows
            .iter()
            .map(|row| row.histogram.iter().map(|&(k, share)| share * g[k].exp()).sum::<f64>().ln())
            .collect();
        let mean = |weights: &[f64]| {
            let sum: f64 =
                rows.iter().zip(&ln_exposure).zip(weights).map(|((r, x), w)| w * (x - r.ln_time)).sum();
            sum / weights.iter().sum::<f64>()
        };
        let knot_at = |ln_exposure: f64| g.as_slice().partition_point(|&x| x < ln_exposure).min(KNOTS - 1);
        let pixels = rows[0].pixels;
        let weight =
            |knot: usize| 1.0 / (camera.model_error.powi(2) + camera.relative_variance[knot] / pixels);
        let mut weights: Vec<f64> = ln_exposure.iter().map(|&x| weight(knot_at(x))).collect();
        for _ in 0..if known { 3 } else { 1 } {
            let ln_radiance = mean(&weights);
            for ((new, row), x) in weights.iter_mut().zip(rows).zip(&ln_exposure) {
                let expected = ln_radiance + row.ln_time;
                let knot = knot_at(expected);
                *new = weight(knot);
                if known {
                    let margin = 3.0 * camera.relative_variance[knot].sqrt();
                    *new /= 1.0 + (x - expected).powi(2) * *new / 4.0;
                    let faint = camera.relative_variance[knot] > FAINT || knot <= camera.dark_knot;
                    if faint || expected + margin > g[camera.saturated_knot] {
                        *new = 0.0;
                    }
                }
            }
            if weights.iter().filter(|&&w| w > 0.0).count() < 2 {
                return None;
            }
        }
        Some(Self { rows, ln_exposure, weights })
    }
}

/// The knots' levels, 0 to 1.
pub(super) fn knot_levels() -> impl Iterator<Item = f64> {
    (0..KNOTS).map(|k| k as f64 / (KNOTS - 1) as f64)
}

/// The knot at or below a level, and how far the level lies towards the next.
pub(super) fn knot_of(level: usize, white: u16) -> (usize, f64) {
    let at = level as f64 * (KNOTS - 1) as f64 / f64::from(white);
    (at as usize, at.fract())
}

//! One gain per photograph and channel, and what the overlaps tell of the lens's shading and of a response that nobody measured.

use glam::DQuat;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::lattice::evenly;
use super::map::KNOTS;
use super::warp::Border;
use crate::geometry::Lens;
use crate::{Error, Result};

/// Directions that are looked at.
const DIRECTIONS: usize = 40_000;
/// Directions that two photographs must share for the one to tell the other's gain.
const SHARED: usize = 12;
const ROUNDS: usize = 12;
/// So many neighbouring directions are one observation.
const ALIKE: f64 = 50.0;
/// A stated exposure is thought to hold so well, relative; without any, gains are near each other in their logarithms so far.
const STATED: f64 = 0.05;
const UNSTATED: f64 = 3.0;
/// White balance moves red and blue so far from what the exposure says.
const BALANCE: f64 = 0.1;
/// Shading by r² and r⁴, r of the half diagonal.
const SHAPE_SIGMA: f64 = 0.1;
/// Levels go about with this root of the exposure.
const TONE: f64 = 2.2;
/// How far a camera's curve is from the assumed one at a knot, and how far a knot's value is from the mean of its neighbours.
const CURVE_SIGMA: f64 = 1.0;
const CURVE_BEND: f64 = 0.1;
/// Stated exposures that differ less, by their logarithms, tell no curve.
const SPREAD: f64 = 0.7;

/// A photograph's exposures, averaged over blocks of pixels; `None` where one was not measured.
pub(super) struct Blocks {
    pub lens: Lens,
    pub exposure: Vec<Option<[f32; 3]>>,
}

/// What turns exposures of one channel into radiance: `exp(ln x + curve(x) + shade r² + shade2 r⁴ - gain)`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Photometry {
    /// Natural logarithms, one for each photograph.
    pub gains: Vec<f64>,
    pub sigmas: Vec<f64>,
    /// Shading by r² and r⁴.
    pub shape: [f64; 2],
    /// What the assumed response lacks, as a logarithm, at the knots.
    pub curve: [f64; KNOTS],
    /// ln exposure of white.
    pub ln_white: f64,
    /// Photographs whose gain no other one tells.
    pub alone: Vec<usize>,
}

impl Photometry {
    /// What a pixel's exposure is worth before the gain, as its logarithm.
    pub fn ln_radiance(&self, ln_exposure: f64, r2: f64) -> f64 {
        let [shade, shade2] = self.shape;
        let (knot, part) = tone(ln_exposure - self.ln_white);
        let curve = self.curve[knot] * (1.0 - part) + self.curve[knot + 1] * part;
        ln_exposure + curve + r2 * (shade + shade2 * r2)
    }

    /// How fast the radiance's logarithm grows with that of the exposure.
    fn steepness(&self, ln_exposure: f64) -> f64 {
        let (knot, part) = tone(ln_exposure - self.ln_white);
        let per_knot = self.curve[knot + 1] - self.curve[knot];
        (1.0 + per_knot * (knot as f64 + part) / TONE).max(0.3)
    }
}

/// The knot at or before an exposure relative to white, and how far on the way to the next one it is: about what is even in levels.
fn tone(ln_exposure: f64) -> (usize, f64) {
    let at = (ln_exposure / TONE).exp().clamp(0.0, 1.0) * (KNOTS - 1) as f64;
    let knot = (at as usize).min(KNOTS - 2);
    (knot, at - knot as f64)
}

/// The squared distance of a pixel from the axis, 1 in the corner.
pub(super) fn shade_r2(lens: &Lens, x: f64, y: f64) -> f64 {
    let half = 0.25 * (f64::from(lens.width).powi(2) + f64::from(lens.height).powi(2));
    ((x - lens.cx).powi(2) + (y - lens.cy).powi(2)) / half
}

/// Solves green, with the curve where the response is only assumed (`bends`) and the exposures stated tell it; red and blue, whose
/// white balance may change, follow the same curve. `white` is the exposure of the highest level; a `curve` that is known is taken.
///
/// # Errors
/// [`Error::Request`] for a curve with another number of knots.
pub(super) fn solve(
    blocks: &[Blocks],
    turns: &[DQuat],
    stated: &[Option<f64>],
    (white, bends, curve): (f64, bool, &[f64]),
) -> Result<[Photometry; 3]> {
    for blocks in blocks {
        Border::new(&blocks.lens)?;
    }
    // What every direction looks like in every photograph: number, r² and exposure.
    let looks: Vec<Vec<(usize, f64, [f32; 3])>> = (0..DIRECTIONS)
        .into_par_iter()
        .map(|i| {
            let direction = evenly(i, DIRECTIONS);
            let look = |(frame, (blocks, turn)): (usize, (&Blocks, &DQuat))| {
                let at = blocks.lens.project(turn.inverse() * direction)?;
                let (x, y) = (at.x.round(), at.y.round());
                let (width, height) = (f64::from(blocks.lens.width), f64::from(blocks.lens.height));
                if !(x >= 0.0 && y >= 0.0 && x < width && y < height) {
                    return None;
                }
                let exposure = blocks.exposure[y as usize * width as usize + x as usize]?;
                Some((frame, shade_r2(&blocks.lens, at.x, at.y), exposure))
            };
            blocks.iter().zip(turns).enumerate().filter_map(look).collect()
        })
        .collect();
    let alone = alone(&looks, blocks.len());
    let known = || stated.iter().flatten().map(|exposure| exposure.ln());
    let spread = known().fold(f64::NEG_INFINITY, f64::max) - known().fold(f64::INFINITY, f64::min);
    let start = Photometry {
        gains: vec![],
        sigmas: vec![],
        shape: [0.0; 2],
        curve: if curve.is_empty() {
            [0.0; KNOTS]
        } else {
            curve.try_into().map_err(|_| {
                let what = format!("a camera's curve of {} knots, not {KNOTS}", curve.len());
                Error::request(what, "make the map anew")
            })?
        },
        ln_white: white.ln(),
        alone,
    };
    let bends = bends && curve.is_empty() && spread > SPREAD;
    let green = channel_of(1, &looks, stated, (&start, bends));
    let start = Photometry { curve: green.curve, ..start };
    let other = |channel| channel_of(channel, &looks, stated, (&start, false));
    let (red, blue) = rayon::join(|| other(0), || other(2));
    Ok([red, green, blue])
}

fn channel_of(
    channel: usize,
    looks: &[Vec<(usize, f64, [f32; 3])>],
    stated: &[Option<f64>],
    (start, bends): (&Photometry, bool),
) -> Photometry {
    let frames = stated.len();
    let knots = if bends { KNOTS } else { 0 };
    let (curve_at, unknowns) = (frames + 2, frames + 2 + knots);
    let balance = if channel == 1 { 0.0 } else { BALANCE };
    let known: Vec<f64> = stated.iter().flatten().map(|exposure| exposure.ln()).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let prior: Vec<(f64, f64)> = stated
        .iter()
        .map(|exposure| {
            exposure.map_or((0.0, UNSTATED), |exposure| (exposure.ln() - mean, STATED.hypot(balance)))
        })
        .collect();
    let mut found = Photometry {
        gains: prior.iter().map(|(gain, _)| *gain).collect(),
        sigmas: vec![0.0; frames],
        ..start.clone()
    };
    let mut scale = 0.5;
    for round in 0..ROUNDS {
        let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut right = DVector::<f64>::zeros(unknowns);
        let mut distances = vec![];
        let mut add = |(i, r2_i, x_i): (usize, f64, f64), (j, r2_j, x_j): (usize, f64, f64), share: f64| {
            let difference =
                found.ln_radiance(x_i, r2_i) - found.gains[i] - found.ln_radiance(x_j, r2_j) + found.gains[j];
            distances.push(difference.abs());
            let weight = share / (scale * scale + difference * difference);
            // The curve's own rows are taken where both agree: at the exposures measured, whose errors are in the difference too,
            // a flat curve would make every difference small.
            let (knot_i, part_i) = tone(x_i - 0.5 * difference / found.steepness(x_i) - found.ln_white);
            let (knot_j, part_j) = tone(x_j + 0.5 * difference / found.steepness(x_j) - found.ln_white);
            let row = [
                (i, -1.0),
                (j, 1.0),
                (frames, r2_i - r2_j),
                (frames + 1, r2_i * r2_i - r2_j * r2_j),
                (curve_at + knot_i, 1.0 - part_i),
                (curve_at + knot_i + 1, part_i),
                (curve_at + knot_j, part_j - 1.0),
                (curve_at + knot_j + 1, -part_j),
            ];
            let row = &row[..if bends { 8 } else { 4 }];
            for &(a, by_a) in row {
                for &(b, by_b) in row {
                    normal[(a, b)] += weight * by_a * by_b;
                }
                right[a] -= weight * by_a * difference;
            }
        };
        for look in looks.iter().filter(|look| look.len() > 1) {
            let of = |k: usize| (look[k].0, look[k].1, f64::from(look[k].2[channel]).ln());
            // Pairs of a direction are not so many observations, nor are neighbouring directions, which show the same object.
            let share = 2.0 / (ALIKE * look.len() as f64);
            for a in 0..look.len() {
                (a + 1..look.len()).for_each(|b| add(of(a), of(b), share));
            }
        }
        for (i, (gain, sigma)) in prior.iter().enumerate() {
            normal[(i, i)] += sigma.powi(-2);
            right[i] -= (found.gains[i] - gain) / (sigma * sigma);
        }
        for k in 0..2 {
            let sigma = SHAPE_SIGMA;
            normal[(frames + k, frames + k)] += sigma.powi(-2);
            right[frames + k] -= found.shape[k] / (sigma * sigma);
        }
        for k in 0..knots {
            let at = curve_at + k;
            normal[(at, at)] += CURVE_SIGMA.powi(-2);
            right[at] -= found.curve[k] / (CURVE_SIGMA * CURVE_SIGMA);
            if k == 0 || k + 1 == knots {
                continue;
            }
            let (row, weight) = ([(k - 1, -0.5), (k, 1.0), (k + 1, -0.5)], CURVE_BEND.powi(-2));
            let bend: f64 = row.iter().map(|&(knot, by)| by * found.curve[knot]).sum();
            for (a, by_a) in row {
                row.iter().for_each(|&(b, by_b)| {
                    normal[(curve_at + a, curve_at + b)] += weight * by_a * by_b;
                });
                right[curve_at + a] -= weight * by_a * bend;
            }
        }
        let Some(cholesky) = normal.cholesky() else { break };
        let step = cholesky.solve(&right);
        found.gains.iter_mut().enumerate().for_each(|(i, gain)| *gain += step[i]);
        (0..2).for_each(|k| found.shape[k] += step[frames + k]);
        (0..knots).for_each(|k| found.curve[k] += step[curve_at + k]);
        distances.sort_by(f64::total_cmp);
        scale = (1.5 * distances.get(distances.len() / 2).copied().unwrap_or(scale)).clamp(0.01, 0.5);
        if round + 1 == ROUNDS {
            let covariance = cholesky.inverse();
            (0..frames).for_each(|i| found.sigmas[i] = covariance[(i, i)].sqrt());
        }
    }
    found
}

/// Photographs that are not linked to the largest group by directions that both show.
fn alone(looks: &[Vec<(usize, f64, [f32; 3])>], frames: usize) -> Vec<usize> {
    let mut shared = vec![0usize; frames * frames];
    for look in looks {
        for a in 0..look.len() {
            for b in a + 1..look.len() {
                shared[look[a].0 * frames + look[b].0] += 1;
            }
        }
    }
    let mut group: Vec<usize> = (0..frames).collect();
    // Frames are few: as many passes as a chain could need.
    for _ in 0..frames {
        for i in 0..frames {
            for j in i + 1..frames {
                if shared[i * frames + j] >= SHARED {
                    let least = group[i].min(group[j]);
                    (group[i], group[j]) = (least, least);
                }
            }
        }
    }
    let size = |of: usize| group.iter().filter(|&&other| other == of).count();
    let largest = (0..frames).max_by_key(|&of| (size(of), frames - of)).unwrap_or(0);
    (0..frames).filter(|&i| group[i] != largest).collect()
}

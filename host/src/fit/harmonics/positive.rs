//! Coefficients whose radiance is negative nowhere on the hemisphere.

use glam::DVec3;
use multiversion::multiversion;

use super::basis::Basis;
use super::hemisphere;
use super::kernel::{Rgb, matrix_product};
use super::lanes::{LANES, Lane};

/// Directions at which every texel is looked at: over the hemisphere as a multiple of the square of the order, along the
/// horizon, near which such a lattice is sparse, of the order.
const COARSE: [usize; 2] = [3, 4];
/// Directions at which a suspect is held: 3 degrees apart for order 10, whose finest wave has 18 from crest to trough.
const FINE: [usize; 2] = [24, 24];
/// What lies below this share of a texel's greatest radiance in the coarse directions may be negative between them.
const SUSPECT: f32 = 0.03;
/// A suspect is held above this share of its mean radiance: between the fine directions it may dip by less.
const LEAST: f32 = 3e-2;

/// Finds and mends negative radiance.
pub(super) struct Positive {
    count: usize,
    one: f32,
    coarse: Vec<f32>,
    fine: Vec<f32>,
}

impl Positive {
    pub fn new(basis: Basis, order: usize) -> Self {
        let count = basis.count(order);
        let rows = |[over, along]: [usize; 2]| {
            let mut row = vec![0.0; count];
            let mut rows = Vec::new();
            let horizon = (0..along * order).map(|i| {
                let azimuth = i as f64 / (along * order) as f64 * std::f64::consts::TAU;
                DVec3::new(azimuth.cos(), azimuth.sin(), 0.0)
            });
            for direction in hemisphere(over * order * order).chain(horizon) {
                basis.at(order, direction, &mut row);
                rows.extend(row.iter().map(|value| *value as f32));
            }
            rows
        };
        Self { count, one: basis.one() as f32, coarse: rows(COARSE), fine: rows(FINE) }
    }

    /// Makes the coefficients of eight texels positive where their mean radiance is, by the least change in the measure
    /// of `inverse` (the inverse of the fit's system, k x k). `mean` is each texel's mean radiance. Returns for each texel
    /// whether it was changed.
    pub fn mend(&self, coefficients: &mut [Rgb], mean: &Rgb, inverse: &[f32]) -> [bool; LANES] {
        let mut seen = vec![[Lane::ZERO; 3]; self.coarse.len() / self.count];
        matrix_product(&self.coarse, coefficients, &mut seen);
        let mut changed = [false; LANES];
        for c in 0..3 {
            for (lane, changed) in changed.iter_mut().enumerate() {
                let least = seen.iter().map(|seen| seen[c].0[lane]).fold(f32::INFINITY, f32::min);
                let most = seen.iter().map(|seen| seen[c].0[lane]).fold(0.0, f32::max);
                let mean = mean[c].0[lane].max(0.0);
                if least >= SUSPECT * most {
                    continue;
                }
                let mut own: Vec<f32> = coefficients.iter().map(|rgb| rgb[c].0[lane]).collect();
                if self.mend_one(&mut own, mean, most, inverse) {
                    *changed = true;
                    for (rgb, value) in coefficients.iter_mut().zip(own) {
                        rgb[c].0[lane] = value;
                    }
                }
            }
        }
        changed
    }

    fn mend_one(&self, coefficients: &mut [f32], mean: f32, most: f32, inverse: &[f32]) -> bool {
        let k = self.count;
        // Between two directions a fit dips the more, the more it swings at all.
        let least = (LEAST * (mean + 0.1 * most)).min(0.5 * mean);
        // Held directions: their basis, what the inverse makes of it, and the multiplier.
        let mut held: Vec<(&[f32], Vec<f32>, f32)> = Vec::new();
        let mut changed = false;
        for _ in 0..12 {
            let (low, lowest) = self.lowest(coefficients, 0.8 * least);
            if lowest >= 0.0 {
                return changed;
            }
            changed = true;
            for row in low {
                let mut answer = vec![0.0; k];
                products(inverse, row, &mut answer);
                held.push((row, answer, 0.0));
            }
            // Hildreth's sweeps: one multiplier after the other, none below zero.
            for _ in 0..20 {
                let mut moved = 0.0_f32;
                for (row, answer, multiplier) in &mut held {
                    let gap = least - dot(row, coefficients);
                    let step = (gap / dot(row, answer).max(f32::MIN_POSITIVE)).max(-*multiplier);
                    if step != 0.0 {
                        *multiplier += step;
                        coefficients.iter_mut().zip(answer.iter()).for_each(|(to, a)| *to += step * a);
                        moved = moved.max(gap);
                    }
                }
                if moved <= 0.1 * least {
                    break;
                }
            }
        }
        // What is left is blended with the constant, which is positive everywhere.
        let enough = 0.8 * least;
        let (_, lowest) = self.lowest(coefficients, enough);
        if lowest < 0.0 {
            let share = ((mean - enough) / (mean - enough - lowest)).clamp(0.0, 1.0);
            coefficients.iter_mut().for_each(|value| *value *= share);
            coefficients[0] += (1.0 - share) * mean * self.one;
        }
        changed
    }

    /// The lowest directions below `least`, none near another, and how far the lowest lies above `least`.
    fn lowest(&self, coefficients: &[f32], least: f32) -> (Vec<&[f32]>, f32) {
        let mut below: Vec<(f32, usize)> = Vec::new();
        let mut lowest = f32::INFINITY;
        let mut values = vec![0.0; self.fine.len() / self.count];
        products(&self.fine, coefficients, &mut values);
        for (i, value) in values.into_iter().map(|value| value - least).enumerate() {
            lowest = lowest.min(value);
            if value < 0.0 {
                below.push((value, i));
            }
        }
        below.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut chosen: Vec<&[f32]> = Vec::new();
        for (_, i) in below {
            let row = &self.fine[i * self.count..(i + 1) * self.count];
            let apart = |other: &&[f32]| dot(row, other).abs() < 0.5 * dot(row, row);
            if chosen.len() < 8 && chosen.iter().all(apart) {
                chosen.push(row);
            }
        }
        (chosen, lowest)
    }
}

/// `matrix` (row after row, each as long as `of`) times `of`.
#[multiversion(targets("x86_64+avx2+fma"))]
fn products(matrix: &[f32], of: &[f32], product: &mut [f32]) {
    for (row, target) in matrix.chunks_exact(of.len()).zip(product) {
        *target = dot(row, of);
    }
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    // Eight sums side by side: one would be added up in order.
    let mut sums = [0.0_f32; LANES];
    let (a_parts, b_parts) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f32 = a_parts.remainder().iter().zip(b_parts.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_parts.zip(b_parts) {
        for i in 0..LANES {
            sums[i] += a[i] * b[i];
        }
    }
    rest + sums.iter().sum::<f32>()
}

//! Overlapping splats show a mixture of their colours: which mixture, and which colours make up for it.
//!
//! Toward one direction every place shows Σ w C of the splats around it, with weights that depend only on the order in which they
//! are drawn, front first. That is a convolution, so that the harmonics whose mixture comes nearest to what is to be seen, over all
//! directions and all places between the splats, follow frequency by frequency from least squares. They are again a convolution of
//! the harmonics that are to be seen: nearly all of it within two splats.

use std::f64::consts::TAU;

use glam::{DVec2, Vec3};
use nalgebra::{SMatrix, SVector};

use super::{CLIP, FUNCTIONS, OPACITY_LOGIT, SIGMA, functions};
use crate::{Error, Result};

/// What a splat weighs less than is not drawn.
const LEAST: f64 = 1.0 / 255.0;
/// How many splats to each side of a place are seen there.
const SEEN: i32 = 3;
/// How many to each side make up for it.
const REACH: i32 = 2;
/// Frequencies to each side; places between two splats to each side.
const FREQUENCIES: usize = 16;
const PLACES: usize = 3;
/// What holds harmonics that no direction shows where they are.
const RIDGE: f64 = 1e-6;

type Square<T> = SMatrix<T, FUNCTIONS, FUNCTIONS>;
/// A splat's harmonics, for each colour.
pub(super) type Harmonics = SMatrix<f32, FUNCTIONS, 3>;

/// A grid of splats, `pitch_m` apart along x and y.
pub(super) struct Overlap {
    pitch_m: DVec2,
    /// Row by row, what the harmonics of each splat around add to one's own.
    taps: Vec<Square<f32>>,
}

/// Steps along columns and rows (downward), with what a splat there weighs.
type Weights = Vec<([i32; 2], f64)>;

impl Overlap {
    /// `directions` are those toward which the mixture matters.
    ///
    /// # Errors
    /// [`Error::Request`] when they determine nothing.
    pub(super) fn new(pitch_m: DVec2, directions: &[Vec3]) -> Result<Self> {
        let mut overlap = Self { pitch_m, taps: vec![] };
        let frequencies = FREQUENCIES * FREQUENCIES;
        // Normal equations for each frequency, left side real, right side complex.
        let mut left = vec![Square::<f64>::zeros(); frequencies];
        let mut right = [left.clone(), left.clone()];
        let waves: Vec<[f64; 2]> =
            (0..FREQUENCIES).map(|i| (TAU * i as f64 / FREQUENCIES as f64).sin_cos().into()).collect();
        let wave = |frequency: usize, step: [i32; 2]| {
            let [u, v] = [(frequency % FREQUENCIES) as i32, (frequency / FREQUENCIES) as i32];
            waves[(u * step[0] + v * step[1]).rem_euclid(FREQUENCIES as i32) as usize]
        };
        let spectrum = |weights: &Weights, frequency: usize| {
            weights.iter().fold([0.0; 2], |[re, im], (step, weight)| {
                let [sin, cos] = wave(frequency, *step);
                [re + weight * cos, im + weight * sin]
            })
        };
        for direction in directions {
            let y = SVector::<f64, FUNCTIONS>::from_iterator(functions(-*direction).map(f64::from));
            let outer = y * y.transpose() / directions.len() as f64;
            let places = (0..PLACES * PLACES).map(|i| {
                let part = |i: usize| (i as f64 + 0.5) / PLACES as f64;
                let at = DVec2::new(part(i % PLACES), part(i / PLACES));
                (overlap.weights(*direction, at), blend(at))
            });
            let places: Vec<(Weights, Weights)> = places.collect();
            for frequency in 0..frequencies {
                let (mut power, mut product) = (0.0, [0.0; 2]);
                for (mixed, wanted) in &places {
                    let ([a, b], [c, d]) = (spectrum(mixed, frequency), spectrum(wanted, frequency));
                    power += a * a + b * b;
                    product[0] += a * c + b * d;
                    product[1] += a * d - b * c;
                }
                left[frequency] += outer * (power / places.len() as f64);
                for (right, product) in right.iter_mut().zip(product) {
                    right[frequency] += outer * (product / places.len() as f64);
                }
            }
        }
        let ridge = Square::from_fn(|i, j| {
            let degree = (i as f64).sqrt().floor();
            if i == j { RIDGE + super::RIDGE * (degree * (degree + 1.0)).powi(2) } else { 0.0 }
        });
        let mut found = [vec![], vec![]];
        for frequency in 0..frequencies {
            let factor = (left[frequency] + ridge).cholesky().ok_or_else(|| {
                Error::request("the directions of the splats determine nothing", "report this as a bug")
            })?;
            found[0].push(factor.solve(&(right[0][frequency] + ridge)));
            found[1].push(factor.solve(&right[1][frequency]));
        }
        let mut taps = vec![];
        for (row, column) in (-REACH..=REACH).flat_map(|row| (-REACH..=REACH).map(move |c| (row, c))) {
            let share = |frequency: usize| {
                let [sin, cos] = wave(frequency, [column, row]);
                found[0][frequency] * cos + found[1][frequency] * sin
            };
            taps.push((0..frequencies).map(share).sum::<Square<f64>>() / frequencies as f64);
        }
        // Where everything is alike nothing may be lost with what is farther away.
        let lost = found[0][0] - taps.iter().sum::<Square<f64>>();
        let own = taps.len() / 2;
        taps[own] += lost;
        overlap.taps = taps.iter().map(|tap| tap.map(|value| value as f32)).collect();
        Ok(overlap)
    }

    /// What the splats around weigh at a place between four of them (`at`, 0 to 1), seen from `direction`: those in front cover the others.
    pub(super) fn weights(&self, direction: Vec3, at: DVec2) -> Weights {
        let near = |[column, row]: [i32; 2]| {
            let [x, y] = (DVec2::new(column.into(), row.into()) * self.pitch_m).to_array();
            x * f64::from(direction.x) - y * f64::from(direction.y)
        };
        let around = -SEEN + 1..=SEEN;
        let mut steps: Vec<[i32; 2]> =
            around.clone().flat_map(|row| around.clone().map(move |column| [column, row])).collect();
        steps.sort_by(|a, b| near(*b).total_cmp(&near(*a)));
        let opacity = 1.0 / (1.0 + (-f64::from(OPACITY_LOGIT)).exp());
        let mut left = 1.0;
        let mut weights = vec![];
        for step in steps {
            let off = (DVec2::new(step[0].into(), step[1].into()) - at) / SIGMA;
            let alpha = (opacity * (-0.5 * off.length_squared()).exp()).min(CLIP);
            if alpha >= LEAST {
                weights.push((step, left * alpha));
                left *= 1.0 - alpha;
            }
        }
        weights
    }

    /// The harmonics that a splat needs, where `wanted` are those that are to be seen at a step along columns and rows from it. Levels
    /// are absolute: 0 is black.
    pub(super) fn made_up(&self, wanted: impl Fn([i32; 2]) -> Harmonics) -> Harmonics {
        let steps = (-REACH..=REACH).flat_map(|row| (-REACH..=REACH).map(move |column| [column, row]));
        steps.zip(&self.taps).fold(Harmonics::zeros(), |sum, (step, tap)| sum + tap * wanted(step))
    }
}

/// What is to be seen between four splats: their blend.
pub(super) fn blend(at: DVec2) -> Weights {
    let share = |side: i32, part: f64| if side == 0 { 1.0 - part } else { part };
    [[0, 0], [1, 0], [0, 1], [1, 1]].map(|step| (step, share(step[0], at.x) * share(step[1], at.y))).to_vec()
}

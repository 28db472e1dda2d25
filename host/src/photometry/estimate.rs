//! Gains and fall-off as the views tell them, before anything is assumed of the lamp.

use nalgebra::{DMatrix, DVector};

use super::components::{Component, Views};
use super::equations::{Equations, Solved, Unknowns};
use super::looks::{Looks, Texel};
use crate::Result;
use crate::fit::{FitOptions, Fitter, Model};
use crate::progress::Progress;

/// Models and gains are fitted in turn so many times.
const ROUNDS: usize = 4;
/// What all models get wrong in one view alike, relative: in all channels, and in each. No patch tells it, so no gain is believed to be
/// surer. (On simulated surfaces 0.0005 in the root mean square.)
pub(super) const COMMON: f64 = 5e-4;
const COLOUR: f64 = 3e-4;
/// A reference patch whose gains differ from those of the surface by more is no reference (relative; standard deviations).
const STRANGE: f64 = 0.01;
const STRANGE_TIMES: f64 = 5.0;

/// Gains (logarithms) and fall-off, free of each other's priors.
pub(super) struct Estimate {
    pub unknowns: Unknowns,
    pub solved: Solved,
    /// What the models leave, root mean square, relative.
    pub residual: f64,
}

/// Fits the models and solves for gains and fall-off in turn.
pub(super) fn estimate(
    looks: &Looks,
    views: usize,
    model: Model,
    size: Option<(u32, u32)>,
    progress: &dyn Progress,
) -> Result<Estimate> {
    let mut unknowns = Unknowns::new(views, size);
    let mut round = 0;
    loop {
        progress.step(round, ROUNDS)?;
        let corrected: Vec<Texel> = looks.texels.iter().map(|texel| unknowns.correct(texel)).collect();
        let sample: Vec<_> = corrected.iter().map(|texel| texel.observations.clone()).collect();
        let fitter = Fitter::new(model, &FitOptions::default(), &sample)?;
        let equations = Equations::of(&corrected, &fitter, &unknowns);
        let solved = equations.solve(&unknowns);
        unknowns.step(&solved.step);
        round += 1;
        if round == ROUNDS {
            return Ok(Estimate { unknowns, residual: equations.residual(), solved });
        }
    }
}

/// What three channels have in common, and two ways in which their colour changes: orthonormal.
pub(super) const MIXES: [[f64; 3]; 3] = {
    const A: f64 = 0.577_350_269_189_625_8;
    const B: f64 = std::f64::consts::FRAC_1_SQRT_2;
    const C: f64 = 0.408_248_290_463_863;
    [[A, A, A], [B, -B, 0.0], [C, C, -2.0 * C]]
};

impl Estimate {
    /// One mix of the channels' ln gains, and its covariance.
    pub fn mixed(&self, mix: [f64; 3]) -> (DVector<f64>, DMatrix<f64>) {
        let views = self.unknowns.views();
        let gains = &self.unknowns.ln_gain;
        let value = DVector::from_fn(views, |v, _| (0..3).map(|c| mix[c] * gains[3 * v + c]).sum());
        let covariance = &self.solved.covariance;
        let wrong = (mix.iter().sum::<f64>() * COMMON).powi(2) + COLOUR * COLOUR;
        let of = |v: usize, w: usize| {
            let pairs = (0..9).map(|i| (i / 3, i % 3));
            let found = pairs.map(|(a, b)| mix[a] * covariance[(3 * v + a, 3 * w + b)] * mix[b]).sum::<f64>();
            if v == w { found + wrong } else { found }
        };
        (value, DMatrix::from_fn(views, views, of))
    }

    /// What is to be said where a reference patch tells of another lamp than the surface does.
    pub fn contradiction(&self, surface: &Estimate) -> Option<String> {
        let [(here, sure_here), (there, sure_there)] =
            [self, surface].map(|estimate| estimate.mixed(MIXES[0]));
        let views = here.len() as f64;
        let off = ((here - there).norm_squared() / views).sqrt() * MIXES[0][0];
        let sigma = ((sure_here.trace() + sure_there.trace()) / views).sqrt() * MIXES[0][0];
        (off > STRANGE && off > STRANGE_TIMES * sigma).then(|| {
            format!(
                "warning: the reference patch tells of another lamp than the surface does, by {:.1} %: it is not matte, or not where it is said to be",
                100.0 * off
            )
        })
    }

    pub fn components(&self, seen: &Views) -> [Component; 3] {
        MIXES.map(|mix| {
            let (value, covariance) = self.mixed(mix);
            Component::find(&value, &covariance, seen)
        })
    }
}

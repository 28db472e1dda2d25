//! Letting the data choose: which model predicts views that its fit has not seen?

use glam::Vec3;
use rayon::prelude::*;

use super::fitter::{FitOptions, Fitter};
use super::model::Model;
use crate::observation::TexelObservations;
use crate::progress::Progress;
use crate::{Error, Result};

/// How well a model did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The model.
    pub model: Model,
    /// Median over texels of the mean error |prediction − measured| / (measured + floor) in views left out of the fit.
    pub held_out_error: f64,
    /// What it costs.
    pub bytes_per_texel: usize,
}

/// The views are dealt into this many parts, each predicted from the others.
const PARTS: u32 = 5;

/// The models worth choosing among: all but those that are kept for comparison only.
pub fn candidates() -> Vec<Model> {
    let kept_for_comparison = |model: &Model| match model {
        Model::Harmonics { method, .. } => method.is_for_comparison(),
        _ => false,
    };
    Model::all().into_iter().filter(|model| !kept_for_comparison(model)).collect()
}

/// Ranks `models` on a `sample` of a surface's texels: best first, where one within 5 % of the best error and smaller
/// counts as better. Models that need more views than there are take no part.
///
/// # Errors
/// [`Error::Request`] when no model can be fitted to the sample; [`Error::Interrupted`].
pub fn choose_model(
    sample: &[TexelObservations],
    models: &[Model],
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Vec<Candidate>> {
    let mut ranking = Vec::new();
    for (index, &model) in models.iter().enumerate() {
        progress.step(index, models.len())?;
        if let Some(held_out_error) = held_out_error(sample, model, options) {
            ranking.push(Candidate { model, held_out_error, bytes_per_texel: model.bytes_per_texel() });
        }
    }
    let best = ranking.iter().map(|c| c.held_out_error).fold(f64::INFINITY, f64::min);
    if !best.is_finite() {
        let views = sample.iter().map(|texel| texel.direction.len()).max().unwrap_or(0);
        return Err(Error::request(
            format!("no texel of the sample has more than {views} views, too few to compare models"),
            "photograph more views or name the model",
        ));
    }
    // Good enough first, the smallest of them foremost; then the rest by error.
    let good = |c: &Candidate| c.held_out_error <= 1.05 * best;
    ranking.sort_by(|a, b| match (good(a), good(b)) {
        (true, true) => {
            a.bytes_per_texel.cmp(&b.bytes_per_texel).then(a.held_out_error.total_cmp(&b.held_out_error))
        }
        (true, false) => std::cmp::Ordering::Less,
        (false, true) => std::cmp::Ordering::Greater,
        (false, false) => a.held_out_error.total_cmp(&b.held_out_error),
    });
    Ok(ranking)
}

fn held_out_error(sample: &[TexelObservations], model: Model, options: &FitOptions) -> Option<f64> {
    let mut errors = Vec::new();
    for part in 0..PARTS {
        let (kept, held): (Vec<_>, Vec<_>) = sample.iter().map(|texel| split(texel, part)).unzip();
        let fitter = Fitter::new(model, options, &kept).ok()?;
        errors.par_extend(kept.par_iter().zip(&held).filter_map(|(kept, held)| {
            let errors = part_errors(&fitter, kept, held)?;
            Some(errors.iter().map(|error| f64::from(*error)).sum::<f64>() / errors.len() as f64)
        }));
    }
    if errors.is_empty() {
        return None;
    }
    let middle = errors.len() / 2;
    Some(*errors.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The error in each view of `held` of a fit to `kept`, |prediction − measured| / (measured + floor), mean of the
/// channels; `None` where nothing can be fitted or there is nothing to compare.
fn part_errors(fitter: &Fitter, kept: &TexelObservations, held: &TexelObservations) -> Option<Vec<f32>> {
    let model = fitter.model();
    if kept.len() < model.unknowns() || held.is_empty() {
        return None;
    }
    let fit = fitter.fit(kept);
    let floor = fitter.floor() as f32;
    let error = |(direction, measured): (&Vec3, &[f32; 3])| {
        let predicted = model.radiance(&fit.parameters, *direction);
        let of = |c: usize| {
            (predicted[c] - measured[c]).abs() / (measured[c].max(0.0) + floor).max(f32::MIN_POSITIVE)
        };
        (of(0) + of(1) + of(2)) / 3.0
    };
    Some(held.direction.iter().zip(&held.radiance).map(error).collect())
}

/// What a texel's own views say about the models, each predicting views that its fit has not seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// Per model the mean error |prediction − measured| / (measured + floor); infinite where it cannot be fitted.
    pub error: Vec<f32>,
    /// Per model by how much that exceeds the least of them, and the standard error of this over the views.
    pub excess: Vec<[f32; 2]>,
}

impl Evidence {
    /// Compares the models of `fitters` on one texel: every fifth of its views predicted from the others.
    pub fn of(fitters: &[Fitter], texel: &TexelObservations) -> Self {
        let mut errors: Vec<Option<Vec<f32>>> = vec![Some(vec![]); fitters.len()];
        for part in 0..PARTS {
            let (kept, held) = split(texel, part);
            if held.is_empty() {
                continue;
            }
            for (errors, fitter) in errors.iter_mut().zip(fitters) {
                let more = part_errors(fitter, &kept, &held);
                *errors = errors.take().zip(more).map(|(mut errors, more)| {
                    errors.extend(more);
                    errors
                });
            }
        }
        let mean = |errors: &Option<Vec<f32>>| match errors {
            Some(errors) if !errors.is_empty() => errors.iter().sum::<f32>() / errors.len() as f32,
            _ => f32::INFINITY,
        };
        let error: Vec<f32> = errors.iter().map(mean).collect();
        let least = (0..error.len()).min_by(|&a, &b| error[a].total_cmp(&error[b]));
        let Some(best) = least.and_then(|best| errors[best].as_ref()) else { return Self::default() };
        let excess = |errors: &Option<Vec<f32>>| {
            let Some(errors) = errors else { return [f32::INFINITY, 0.0] };
            let count = errors.len() as f32;
            let mean = errors.iter().zip(best).map(|(error, best)| error - best).sum::<f32>() / count;
            let squares = errors.iter().zip(best).map(|(error, best)| (error - best - mean).powi(2));
            [mean, (squares.sum::<f32>() / (count - 1.0).max(1.0) / count).sqrt()]
        };
        Self { excess: errors.iter().map(excess).collect(), error }
    }

    /// The smallest sufficient model (the models are in order of their size), and the smallest of which the views cannot say
    /// that it is worse: where the two differ the choice is open.
    ///
    /// Sufficient is what predicts at most 2 % worse than the best, or within `tolerance`. `None` where no model can be
    /// fitted.
    pub fn choices(&self, tolerance: f32) -> Option<[usize; 2]> {
        let least = self.error.iter().copied().fold(f32::INFINITY, f32::min);
        let enough = |sigmas: f32| {
            let is_enough = |m: &usize| {
                let [excess, sigma] = self.excess[*m];
                excess <= SLACK * least + sigmas * sigma || self.error[*m] <= tolerance
            };
            (0..self.error.len()).filter(|m| self.error[*m].is_finite()).find(is_enough)
        };
        Some([enough(0.0)?, enough(OPEN_SIGMAS)?])
    }

    /// By how much a model predicts worse than the best, relative to that.
    pub fn relative_excess(&self, model: usize) -> f32 {
        let least = self.error.iter().copied().fold(f32::INFINITY, f32::min);
        (self.excess[model][0] / least.max(f32::MIN_POSITIVE)).min(MOST_EXCESS)
    }

    /// The best of the other models.
    pub fn runner_up(&self, choice: usize) -> Option<usize> {
        let others = (0..self.error.len()).filter(|m| *m != choice && self.error[*m].is_finite());
        others.min_by(|&a, &b| self.error[a].total_cmp(&self.error[b]))
    }
}

/// A model that predicts so little worse than the best is as good.
pub const SLACK: f32 = 0.02;
/// A difference below so many standard errors is open.
const OPEN_SIGMAS: f32 = 1.0;
/// A texel's excess counts no more than this among its neighbours'.
const MOST_EXCESS: f32 = 0.2;

/// The texel without, and with only, the views of one part.
fn split(texel: &TexelObservations, part: u32) -> (TexelObservations, TexelObservations) {
    let (mut kept, mut held) = (TexelObservations::default(), TexelObservations::default());
    for i in 0..texel.direction.len() {
        let to = if texel.view[i] % PARTS == part { &mut held } else { &mut kept };
        to.view.push(texel.view[i]);
        to.direction.push(texel.direction[i]);
        to.radiance.push(texel.radiance[i]);
        to.sigma.push(texel.sigma[i]);
    }
    (kept, held)
}

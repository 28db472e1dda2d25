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
pub(super) const PARTS: u32 = 5;

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
            let views = predict(&fitter, kept, held)?;
            Some(views.iter().map(|view| f64::from(view.error)).sum::<f64>() / views.len() as f64)
        }));
    }
    if errors.is_empty() {
        return None;
    }
    let middle = errors.len() / 2;
    Some(*errors.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// How well a view was predicted that the fit has not seen.
pub(super) struct HeldOut {
    /// |prediction − measured| / (measured + floor) and 1 at most, mean of the channels: a lobe that only the views left out
    /// show is missed by all models, and by how much says nothing.
    pub error: f32,
    /// |prediction − measured| / (prediction + floor) of each channel.
    pub relative: [f32; 3],
    /// Cosine of the view's zenith.
    pub cosine: f32,
}

/// The views of `held` as a fit to `kept` predicts them; `None` where nothing can be fitted or there is nothing to compare.
pub(super) fn predict(
    fitter: &Fitter,
    kept: &TexelObservations,
    held: &TexelObservations,
) -> Option<Vec<HeldOut>> {
    let model = fitter.model();
    if kept.len() < model.unknowns() || held.is_empty() {
        return None;
    }
    let parameters = fitter.parameters(kept);
    let floor = (fitter.floor() as f32).max(f32::MIN_POSITIVE);
    let view = |(direction, measured): (&Vec3, &[f32; 3])| {
        let predicted = model.radiance(&parameters, *direction);
        let miss = |c: usize| (predicted[c] - measured[c]).abs();
        let error = |c: usize| (miss(c) / (measured[c].max(0.0) + floor)).min(1.0);
        HeldOut {
            error: (error(0) + error(1) + error(2)) / 3.0,
            relative: [0, 1, 2].map(|c| miss(c) / (predicted[c] + floor)),
            cosine: direction.z,
        }
    };
    Some(held.direction.iter().zip(&held.radiance).map(view).collect())
}

/// The texel without, and with only, the views of one part.
pub(super) fn split(texel: &TexelObservations, part: u32) -> (TexelObservations, TexelObservations) {
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

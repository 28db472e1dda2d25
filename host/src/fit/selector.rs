//! The smallest sufficient model for every texel of a surface: what settles it for all of them, and the steps for some.

use rayon::prelude::*;

use super::choice::{Choice, choose};
use super::evidence::{Evidence, one_sigma};
use super::fitter::{FitOptions, Fitter, TexelFit};
use super::harmonics::HarmonicsMethod;
use super::held_out::{HeldOut, held_out};
use super::model::Model;
use super::pooled;
use crate::geometry::Texels;
use crate::observation::TexelObservations;
use crate::{Error, Result};

/// A model that fewer of the sampled texels choose is tried on the others only if some need it.
const LEAST_SHARE: f64 = 0.02;
/// Some: two, who would be so much worse without it, relative, and so many standard errors.
const NEEDED: (usize, f32, f32) = (2, 0.1, 3.0);
/// So many texels are compared at a time.
const BATCH: usize = 256;

/// The models worth choosing among: all but those that are kept for comparison only.
pub fn candidates() -> Vec<Model> {
    let kept_for_comparison = |model: &Model| match model {
        Model::Harmonics { method, .. } => HarmonicsMethod::is_for_comparison(*method),
        Model::SharedPhong { .. } => true,
        _ => false,
    };
    Model::all().into_iter().filter(|model| !kept_for_comparison(model)).collect()
}

/// Chooses and fits the smallest sufficient model texel by texel.
///
/// Each model predicts a fifth of a texel's views from the others, five times; the smallest within 2 % of the best is taken.
/// Where the texel's own views leave that open, those of the eight around it decide. Models that need more views than there
/// are take no part.
pub struct Selector {
    fitters: Vec<Fitter>,
    tolerance: f32,
}

impl Selector {
    /// Prepares for a surface of which `sample` holds some texels (a few hundred, spread over it): of `models` those are kept
    /// that some of them want. A mean relative error of `tolerance` in unseen views suffices; 0: none does. `go_on` is asked
    /// again and again.
    ///
    /// # Errors
    /// [`Error::Request`] when none of the models can be fitted to any texel of the sample; what `go_on` says.
    pub fn new(
        models: &[Model],
        options: &FitOptions,
        tolerance: f32,
        sample: &[TexelObservations],
        go_on: &(dyn Fn() -> Result<()> + Sync),
    ) -> Result<Self> {
        let Some(smallest) = models.iter().min_by_key(|model| model.unknowns()) else {
            return Err(Error::request("there is no model to choose from", "name some"));
        };
        let prepared: Vec<Option<Fitter>> = models
            .par_iter()
            .map(|&model| {
                go_on()?;
                Ok(Fitter::new(model, options, sample).ok())
            })
            .collect::<Result<_>>()?;
        let mut fitters: Vec<Fitter> = prepared.into_iter().flatten().collect();
        if fitters.is_empty() {
            // Says why.
            Fitter::new(*smallest, options, sample)?;
        }
        fitters.sort_by_key(|fitter| fitter.model().bytes_per_texel());
        let evidence: Vec<Vec<Evidence>> = sample
            .par_chunks(BATCH)
            .map(|texels| {
                go_on()?;
                Ok(Evidence::of(&fitters, &texels.iter().collect::<Vec<_>>()))
            })
            .collect::<Result<_>>()?;
        let wanted = wanted(fitters.len(), &evidence.concat(), tolerance);
        let mut wanted = wanted.into_iter();
        fitters.retain(|_| wanted.next() == Some(true));
        Ok(Self { fitters, tolerance })
    }

    /// What is chosen from, in order of size.
    pub fn models(&self) -> Vec<Model> {
        self.fitters.iter().map(Fitter::model).collect()
    }

    pub(super) fn fitters(&self) -> &[Fitter] {
        &self.fitters
    }

    pub(super) fn tolerance(&self) -> f32 {
        self.tolerance
    }

    /// The absolute part of the expected error, radiance; see [`Fitter::floor`].
    pub fn floor(&self) -> f64 {
        self.fitters[0].floor()
    }

    /// What the views of each texel say about the models; texels that lie beside each other.
    pub fn evidence(&self, texels: &[&TexelObservations]) -> Vec<Evidence> {
        texels.par_chunks(BATCH).flat_map_iter(|texels| Evidence::of(&self.fitters, texels)).collect()
    }

    /// The model of every texel of a surface, row by row.
    pub fn choose(&self, evidence: &[Evidence], texels: Texels) -> Vec<Choice> {
        let sizes: Vec<usize> = self.fitters.iter().map(|fitter| fitter.model().bytes_per_texel()).collect();
        choose(evidence, texels, &sizes, self.tolerance)
    }

    /// Fits to each texel the model that was chosen for it; texels that lie beside each other.
    pub fn fit(&self, texels: &[&TexelObservations], chosen: &[Choice]) -> Vec<TexelFit> {
        let fit = |(texels, chosen): (&[&TexelObservations], &[Choice])| {
            let mut fits = vec![None; texels.len()];
            for (model, fitter) in self.fitters.iter().enumerate() {
                let of: Vec<usize> = (0..texels.len()).filter(|&i| chosen[i].model == model).collect();
                let found = fitter.fit_tile(&of.iter().map(|&i| texels[i]).collect::<Vec<_>>());
                of.into_iter().zip(found).for_each(|(i, fit)| fits[i] = Some(fit));
            }
            fits.into_iter().flatten()
        };
        texels.par_chunks(BATCH).zip(chosen.par_chunks(BATCH)).flat_map_iter(fit).collect()
    }

    /// The part of (radiance + floor) within which 68 % of what a texel's chosen model predicts of unseen views lie; infinite
    /// where that is not known.
    pub fn sigma(&self, evidence: &Evidence, choice: &Choice) -> f32 {
        evidence.of.get(choice.model).map_or(f32::INFINITY, |prediction| prediction.sigma)
    }

    /// The mean error of a texel's chosen model in unseen views, as [`Evidence::errors`]; infinite where that is not known.
    pub fn error_in_unseen(&self, evidence: &Evidence, choice: &Choice) -> f32 {
        evidence.of.get(choice.model).map_or(f32::INFINITY, |prediction| prediction.error)
    }

    /// By how much the mean error in unseen views grows where `side` x `side` texels become one, relative: `tiles` are blocks of
    /// texels, row by row, so many columns wide. By the best single one of the constant and the models of lobes. `None` where no
    /// block fits in or too few views saw one.
    pub fn growth(&self, tiles: &[(usize, Vec<TexelObservations>)], side: usize) -> Option<f64> {
        let lobes = |fitter: &Fitter| matches!(fitter.model(), Model::Constant | Model::Phong { .. });
        let fitters = &self.fitters[..self.fitters.partition_point(lobes)];
        let blocks = tiles.iter().flat_map(|(columns, texels)| {
            let (wide, high) = (columns / side, texels.len() / columns / side);
            (0..wide * high).map(move |block| {
                let corner = block / wide * side * columns + block % wide * side;
                let of = move |i: usize| &texels[corner + i / side * columns + i % side];
                (0..side * side).map(of).collect::<Vec<_>>()
            })
        });
        let blocks: Vec<Vec<&TexelObservations>> = blocks.collect();
        let sums = blocks.par_iter().filter_map(|block| pooled::errors(fitters, block));
        let sums = sums.reduce_with(|mut a, b| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = [a[0] + b[0], a[1] + b[1]]);
            a
        })?;
        let least = |which: usize| sums.iter().map(|sum| sum[which]).fold(f64::INFINITY, f64::min);
        (least(1) > 0.0).then(|| least(0) / least(1) - 1.0)
    }

    /// Measures how much less sure the chosen models are near the horizon, on some of the texels.
    pub fn zenith_ratios(&self, texel: &TexelObservations, sigma: f32, choice: &Choice) -> ZenithRatios {
        let fitters = &self.fitters[choice.model..=choice.model];
        let views = held_out(fitters, &[&*texel.usable()]).pop().and_then(|mut views| views.pop().flatten());
        ZenithRatios::of(choice.model, &views.unwrap_or_default(), sigma)
    }
}

/// Which models at least some of the texels want.
fn wanted(models: usize, evidence: &[Evidence], tolerance: f32) -> Vec<bool> {
    let chosen: Vec<[usize; 2]> = evidence.iter().filter_map(|texel| texel.choices(tolerance)).collect();
    let share = |model: usize| {
        chosen.iter().filter(|choices| choices.contains(&model)).count() as f64 / chosen.len() as f64
    };
    let mut wanted: Vec<bool> = (0..models).map(|model| share(model) >= LEAST_SHARE).collect();
    let (some, clearly, sigmas) = NEEDED;
    for model in 0..models {
        let needs = |texel: &&Evidence| {
            let Some([own, _]) = texel.choices(tolerance) else { return false };
            let others = texel.possible().filter(|other| wanted[*other]);
            let best = others.min_by(|a, b| texel.of[*a].error.total_cmp(&texel.of[*b].error));
            let worse = |other: usize| {
                let [excess, error] = texel.of[other].excess;
                excess > clearly * texel.least() && excess > sigmas * error
            };
            own == model && best.is_none_or(worse)
        };
        wanted[model] |= evidence.iter().filter(needs).count() >= some.min(evidence.len());
    }
    // No texel has views enough for anything but the smallest.
    wanted[0] |= !wanted.contains(&true);
    wanted
}

/// Width of the bands in which [`zenith_factors`] are measured, degrees.
const BAND_DEG: f32 = 15.0;
/// How many there are.
pub const BANDS: usize = 6;
/// Fewer residuals in a band say nothing of it.
const FEWEST_RESIDUALS: usize = 300;

/// Which band of zeniths, each 15 degrees wide, a direction is in, by the cosine of its zenith.
pub fn zenith_band(cosine: f32) -> usize {
    ((cosine.clamp(0.0, 1.0).acos().to_degrees() / BAND_DEG) as usize).min(BANDS - 1)
}

/// In each band of zeniths, what unseen views differ by from what a model predicts, in standard deviations averaged over the
/// texel's views.
#[derive(Debug, Clone, Default)]
pub struct ZenithRatios([Vec<(usize, f32)>; BANDS]);

impl ZenithRatios {
    /// Those of a texel with this model, whose own standard deviation is `sigma`.
    pub(super) fn of(model: usize, views: &[HeldOut], sigma: f32) -> Self {
        let mut ratios = Self::default();
        for view in views.iter().filter(|_| sigma > 0.0) {
            let band = &mut ratios.0[zenith_band(view.cosine)];
            band.extend(view.relative.map(|miss| (model, miss / sigma)));
        }
        ratios
    }

    /// Adds those of other texels.
    pub fn extend(&mut self, others: Self) {
        self.0.iter_mut().zip(others.0).for_each(|(to, from)| to.extend(from));
    }

    /// Per model a factor for each band: by how much its standard deviation differs from the texel's own there. 1 where too
    /// little was seen.
    pub fn factors(&self, models: usize) -> Vec<[f32; BANDS]> {
        let factor = |model: usize, band: usize| {
            let of_model = self.0[band].iter().filter(|(of, _)| *of == model);
            let mut ratios: Vec<f32> = of_model.map(|(_, ratio)| *ratio).collect();
            if ratios.len() < FEWEST_RESIDUALS { 1.0 } else { one_sigma(&mut ratios) }
        };
        (0..models).map(|model| std::array::from_fn(|band| factor(model, band))).collect()
    }
}

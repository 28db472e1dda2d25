//! One model fitted to texel after texel, and what there is to say about each fit.

use glam::DVec3;
use nalgebra::DMatrix;

use super::harmonics::{self, HarmonicsMethod, Smooth, SmoothFit, Weighing};
use super::log_quadratic;
use super::model::{Model, SHININESS};
use super::phong::{self, PhongFit, PhongOptions};
use super::surface::{sharpest, typical_radiance};
use super::weights::Samples;
use crate::observation::TexelObservations;
use crate::{Error, Result};

/// What a fit may be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions {
    /// What no model says exactly, as a fraction of the radiance.
    pub relative_error: f64,
    /// What no model says exactly, as a radiance; `None`: 5 % of the surface's median radiance (mean of the channels).
    pub floor: Option<f64>,
    /// Observations that disagree with the rest count less (Huber weights): passers-by, flares, wrong pixels.
    pub robust: bool,
    /// Weight of the harmonics' smoothness; `None`: chosen for the surface by generalised cross-validation.
    pub penalty: Option<f64>,
    /// Lobes that the views do not determine are left out, the others fitted without them. Otherwise they stay, being
    /// the best guess between the views, and are flagged all the same.
    pub identified_only: bool,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self { relative_error: 0.03, floor: None, robust: true, penalty: None, identified_only: false }
    }
}

/// What is doubtful about a texel's fit; kept beside its coefficients.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FitFlags(pub u8);

impl FitFlags {
    /// Fewer views measured the texel than the model has unknowns: it is a constant in the model's parameters.
    pub const TOO_FEW_VIEWS: Self = Self(1);
    /// No view measured the texel: its radiance is 0 because something must be stored.
    pub const NO_VIEWS: Self = Self(2);
    /// A lobe's shininess or direction ended at its bound.
    pub const AT_BOUND: Self = Self(4);
    /// The search ran out of steps.
    pub const NOT_CONVERGED: Self = Self(8);
    /// The views do not determine a lobe: its direction may be off by more than 1 degree or its shininess by more than
    /// 20 %, though the fit reproduces what was measured.
    pub const UNIDENTIFIED: Self = Self(16);
    /// The harmonics had to be held above zero somewhere: they say less there than elsewhere.
    pub const HELD: Self = Self(32);

    /// Whether all flags of `other` are set.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    fn set(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

/// A fitted texel.
#[derive(Debug, Clone, PartialEq)]
pub struct TexelFit {
    /// As many as [`Model::parameter_count`], always finite.
    pub parameters: Vec<f32>,
    /// Root mean square of (model − measured) / expected error over views and channels: about 1 or less is as
    /// good as the measurement.
    pub residual: f32,
    /// How many views took part.
    pub views: u32,
    /// What is doubtful.
    pub flags: FitFlags,
}

/// Fits one model to the texels of one surface.
pub struct Fitter {
    model: Model,
    options: FitOptions,
    floor: f64,
    shininess_max: f64,
    /// A lobe counts as identified where it is right with at least this probability.
    identified: f64,
    gram: Option<nalgebra::Cholesky<f64, nalgebra::Dyn>>,
    smooth: Option<Smooth>,
}

impl Fitter {
    /// Prepares for a surface of which `sample` holds some texels (a few hundred, spread over it): from them come the
    /// scale of its radiance and, for smoothed harmonics, the weight of the smoothness.
    ///
    /// # Errors
    /// [`Error::Request`] when no texel of the sample was measured in as many views as the model has unknowns, or the model is
    /// none of [`Model::all`].
    pub fn new(model: Model, options: &FitOptions, sample: &[TexelObservations]) -> Result<Self> {
        if !Model::all().contains(&model) {
            return Err(Error::request(
                format!("there is no model {}", model.name()),
                "choose one of Model::all()",
            ));
        }
        let views = sample.iter().map(|texel| texel.direction.len()).max().unwrap_or(0);
        if views < model.unknowns() {
            return Err(Error::request(
                format!(
                    "{} needs {} views and no texel has more than {views}",
                    model.name(),
                    model.unknowns()
                ),
                "photograph more views or fit a smaller model (constant needs 1, phong 5, log-quadratic 6)",
            ));
        }
        let typical = typical_radiance(sample);
        // Where a black texel has no error at all its weight would be infinite.
        let floor = options.floor.unwrap_or(0.05 * typical).max(1e-6 * typical);
        let mut fitter = Self {
            model,
            options: *options,
            floor,
            shininess_max: *SHININESS.end(),
            identified: 0.95,
            gram: None,
            smooth: None,
        };
        if let Model::Phong { .. } | Model::SharedPhong { .. } = model {
            fitter.shininess_max = sharpest(sample);
            fitter.identified = fitter.sure_enough(sample);
        }
        if let Model::Harmonics { order, method } = model {
            match method {
                HarmonicsMethod::Mirrored | HarmonicsMethod::Hemispherical | HarmonicsMethod::Smoothed => {
                    let FitOptions { relative_error, robust, penalty, .. } = *options;
                    let weighing = Weighing { relative_error, floor, robust };
                    fitter.smooth = Some(Smooth::new(method, order, penalty, weighing, sample));
                }
                HarmonicsMethod::Lsop => fitter.gram = harmonics::hemisphere_gram(usize::from(order)),
                HarmonicsMethod::ZeroHemisphere => {}
            }
        }
        Ok(fitter)
    }

    /// What is fitted.
    pub fn model(&self) -> Model {
        self.model
    }

    /// The absolute part of the expected error, radiance.
    pub fn floor(&self) -> f64 {
        self.floor
    }

    /// Fits texels that lie beside each other, in order: smooth models share work between them. Never fails: what is
    /// missing or doubtful is flagged.
    pub fn fit_tile(&self, texels: &[&TexelObservations]) -> Vec<TexelFit> {
        match (&self.smooth, self.model) {
            (Some(smooth), Model::Harmonics { method, .. }) if method.is_on_the_hemisphere() => {
                let fits = smooth.fit_tile(texels).into_iter().zip(texels);
                fits.map(|(fit, texel)| self.smooth_fit(fit, texel)).collect()
            }
            _ => texels.iter().map(|texel| self.fit_one(texel)).collect(),
        }
    }

    /// Fits one texel; see [`Fitter::fit_tile`].
    pub fn fit(&self, texel: &TexelObservations) -> TexelFit {
        let mut fits = self.fit_tile(&[texel]);
        fits.pop().expect("as many fits as texels")
    }

    fn smooth_fit(&self, fit: SmoothFit, texel: &TexelObservations) -> TexelFit {
        if (fit.views as usize) < self.model.unknowns() {
            return self.fit_one(texel);
        }
        let mut flags = FitFlags::default();
        if !fit.converged {
            flags.set(FitFlags::NOT_CONVERGED);
        }
        if fit.held {
            flags.set(FitFlags::HELD);
        }
        let SmoothFit { parameters, residual, views, .. } = fit;
        TexelFit { parameters, residual, views, flags }
    }

    fn fit_one(&self, texel: &TexelObservations) -> TexelFit {
        if let Some(options) = self.phong_options() {
            return self.lobes(phong::fit(texel, &options), texel);
        }
        let mut samples = Samples::of(texel, self.options.relative_error, self.floor);
        let weights = samples.weights.clone();
        let (mut parameters, mut flags) = self.solve(&samples);
        if self.options.robust && samples.len() > self.model.unknowns() {
            for _ in 0..3 {
                if !self.reweight(&mut samples, &weights, &parameters) {
                    break;
                }
                (parameters, flags) = self.solve(&samples);
            }
        }
        if !parameters.iter().all(|value| value.is_finite()) {
            parameters = self.constant(&samples);
            flags.set(FitFlags::NOT_CONVERGED);
        }
        samples.weights = weights;
        let residual = self.residual(&samples, &parameters);
        TexelFit { parameters, residual, views: samples.len() as u32, flags }
    }

    /// For each of `fitters`, which are made for one surface, the parameters that [`Fitter::fit`] finds for each texel, without its
    /// verdict: for a comparison of predictions. Numbers of lobes ascend.
    pub(super) fn parameters(fitters: &[Self], texels: &[&TexelObservations]) -> Vec<Vec<Vec<f32>>> {
        let lobes = |fitter: &Self| match fitter.model {
            Model::Phong { lobes } if !fitter.options.identified_only => Some(usize::from(lobes)),
            _ => None,
        };
        let numbers: Vec<usize> = fitters.iter().filter_map(lobes).collect();
        let options = fitters.iter().find(|fitter| lobes(fitter).is_some()).and_then(Self::phong_options);
        let mut nested: Vec<_> = numbers.iter().map(|_| Vec::with_capacity(texels.len())).collect();
        if let Some(options) = options {
            for texel in texels {
                let fits = phong::nested(texel, &numbers, &options);
                nested.iter_mut().zip(fits).for_each(|(to, parameters)| to.push(parameters));
            }
        }
        let mut nested = nested.into_iter();
        let of = |fitter: &Self| match lobes(fitter) {
            Some(_) => nested.next().unwrap_or_default(),
            None => fitter.fit_tile(texels).into_iter().map(|fit| fit.parameters).collect(),
        };
        fitters.iter().map(of).collect()
    }

    /// Fits one texel, and predicts how far its radiance (RGB) toward some directions (unit vectors) may be off because
    /// the coefficients are uncertain: one standard deviation each. `None` for models that do not say.
    pub fn fit_toward(
        &self,
        texel: &TexelObservations,
        toward: &[DVec3],
    ) -> (TexelFit, Option<Vec<[f64; 3]>>) {
        let Some(options) = self.phong_options() else { return (self.fit(texel), None) };
        let fit = phong::fit(texel, &options);
        let sigma = toward.iter().map(|direction| fit.sigma(*direction)).collect();
        (self.lobes(fit, texel), Some(sigma))
    }

    /// Fits one texel from parameters that are roughly right: a neighbour's, or those of an earlier fit. Of the models, only
    /// lobes with a shininess each are searched for; the others are fitted as [`Fitter::fit`] does.
    pub fn fit_from(&self, texel: &TexelObservations, parameters: &[f32]) -> TexelFit {
        match self.phong_options() {
            Some(options) if parameters.len() == 3 + 7 * options.lobes => {
                self.lobes(phong::refit(texel, parameters, &options), texel)
            }
            _ => self.fit(texel),
        }
    }

    fn phong_options(&self) -> Option<PhongOptions> {
        let (lobes, shared_shininess) = match self.model {
            Model::Phong { lobes } => (lobes, false),
            Model::SharedPhong { lobes } => (lobes, true),
            _ => return None,
        };
        Some(PhongOptions {
            lobes: usize::from(lobes),
            shared_shininess,
            shininess_max: self.shininess_max,
            relative_error: self.options.relative_error,
            floor: self.floor,
            robust: self.options.robust,
            identified: Some(self.identified),
            identified_only: self.options.identified_only,
        })
    }

    /// The smallest probability of being right that still leaves all lobes above it right in 98.5 of 100 cases, on this
    /// surface: where most are certain, a doubtful one more does little harm; where none is, each must be sure.
    fn sure_enough(&self, sample: &[TexelObservations]) -> f64 {
        let Some(options) = self.phong_options() else { return 1.0 };
        let stride = sample.len().div_ceil(200).max(1);
        let texels = sample.iter().step_by(stride);
        let mut right: Vec<f64> = texels.flat_map(|texel| phong::fit(texel, &options).right).collect();
        if right.len() < 20 {
            return 0.95;
        }
        right.sort_by(|a, b| b.total_cmp(a));
        let (mut sum, mut least) = (0.0, 1.0);
        for (index, probability) in right.iter().enumerate() {
            sum += probability;
            if sum < 0.985 * (index + 1) as f64 {
                break;
            }
            least = *probability;
        }
        least.clamp(0.75, 0.97)
    }

    fn lobes(&self, mut fit: PhongFit, texel: &TexelObservations) -> TexelFit {
        if let Model::SharedPhong { .. } = self.model {
            // The strongest lobe comes first: it has radiance if any has.
            let (diffuse, lobes) = fit.parameters.split_at(3);
            let each = lobes.chunks_exact(7).flat_map(|lobe| [&lobe[..3], &lobe[4..]].concat());
            fit.parameters = diffuse.iter().copied().chain([lobes[3]]).chain(each).collect();
        }
        if !fit.parameters.iter().all(|value| value.is_finite()) {
            let samples = Samples::of(texel, self.options.relative_error, self.floor);
            fit.parameters = self.constant(&samples);
            (fit.residual, fit.converged) = (self.residual(&samples, &fit.parameters).into(), false);
        }
        let mut flags = FitFlags::default();
        for (is, flag) in [
            (fit.views == 0, FitFlags::NO_VIEWS),
            (fit.views < self.model.unknowns(), FitFlags::TOO_FEW_VIEWS),
            (fit.at_bound, FitFlags::AT_BOUND),
            (!fit.converged, FitFlags::NOT_CONVERGED),
            (!fit.identified, FitFlags::UNIDENTIFIED),
        ] {
            if is {
                flags.set(flag);
            }
        }
        TexelFit { parameters: fit.parameters, residual: fit.residual as f32, views: fit.views as u32, flags }
    }

    /// The mean of what was measured, as parameters.
    fn constant(&self, samples: &Samples) -> Vec<f32> {
        // Without any sample the mean is no number.
        let is_finite = |value: f32| if value.is_finite() { value } else { 0.0 };
        self.model.constant(samples.mean().map(|l| is_finite(l.max(0.0) as f32)))
    }

    fn solve(&self, samples: &Samples) -> (Vec<f32>, FitFlags) {
        let mut flags = FitFlags::default();
        if samples.len() == 0 {
            flags.set(FitFlags::NO_VIEWS);
            flags.set(FitFlags::TOO_FEW_VIEWS);
            return (self.model.constant([0.0; 3]), flags);
        }
        let constant = || self.constant(samples);
        if samples.len() < self.model.unknowns() {
            flags.set(FitFlags::TOO_FEW_VIEWS);
            return (constant(), flags);
        }
        let parameters = match self.model {
            Model::Constant | Model::Phong { .. } | Model::SharedPhong { .. } => Some(constant()),
            Model::LogQuadratic => {
                log_quadratic::fit(samples).map(|found| found.iter().flatten().map(|v| *v as f32).collect())
            }
            Model::Harmonics { order, method } => {
                self.harmonics(usize::from(order), method, samples).map(|found| {
                    (0..found.nrows()).flat_map(|i| [0, 1, 2].map(|c| found[(i, c)] as f32)).collect()
                })
            }
        };
        let parameters = parameters.unwrap_or_else(|| {
            flags.set(FitFlags::NOT_CONVERGED);
            constant()
        });
        (parameters, flags)
    }

    fn harmonics(&self, order: usize, method: HarmonicsMethod, samples: &Samples) -> Option<DMatrix<f64>> {
        let Samples { directions, radiance, .. } = samples;
        match method {
            HarmonicsMethod::Mirrored | HarmonicsMethod::Hemispherical | HarmonicsMethod::Smoothed => {
                self.smooth.as_ref()?.fit_alone(samples)
            }
            HarmonicsMethod::ZeroHemisphere => Some(harmonics::projected(order, directions, radiance)),
            HarmonicsMethod::Lsop => {
                self.gram.as_ref().map(|gram| gram.solve(&harmonics::projected(order, directions, radiance)))
            }
        }
    }

    /// Huber's weights; `false`, and nothing changed, where no observation disagrees with the rest.
    fn reweight(&self, samples: &mut Samples, weights: &[f64], parameters: &[f32]) -> bool {
        let misses: Vec<f64> = (0..samples.len())
            .map(|i| (squared_miss(self.model, parameters, samples, i) * weights[i] / 3.0).sqrt())
            .collect();
        let mut sorted = misses.clone();
        sorted.sort_by(f64::total_cmp);
        // The median miss of a Gaussian in three channels is 0.89 standard deviations.
        // Most observations may agree to the last bit: one that rounding moves is no less true, so what is far below
        // the expected error counts as agreement.
        let scale = (sorted[sorted.len() / 2] / 0.89).max(0.01);
        if sorted[sorted.len() - 1] <= 4.0 * scale {
            return false;
        }
        for ((to, weight), miss) in samples.weights.iter_mut().zip(weights).zip(misses) {
            *to = weight * (2.0 * scale / miss.max(f64::MIN_POSITIVE)).min(1.0);
        }
        true
    }

    /// [`TexelFit::residual`] and [`TexelFit::views`] of a texel that parameters are given for.
    pub(super) fn residual_of(&self, texel: &TexelObservations, parameters: &[f32]) -> (f32, u32) {
        let samples = Samples::of(texel, self.options.relative_error, self.floor);
        (self.residual(&samples, parameters), samples.len() as u32)
    }

    fn residual(&self, samples: &Samples, parameters: &[f32]) -> f32 {
        let miss = |i: usize| samples.weights[i] * squared_miss(self.model, parameters, samples, i);
        let count = (3 * samples.len()).max(1) as f64;
        ((0..samples.len()).map(miss).sum::<f64>() / count).sqrt() as f32
    }
}

fn squared_miss(model: Model, parameters: &[f32], samples: &Samples, i: usize) -> f64 {
    let direction: DVec3 = samples.directions[i];
    let predicted = model.radiance(parameters, direction.as_vec3());
    predicted.iter().zip(samples.radiance[i]).map(|(p, l)| (f64::from(*p) - l).powi(2)).sum()
}

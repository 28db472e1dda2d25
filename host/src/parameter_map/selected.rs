//! The smallest sufficient model for every texel of a surface.

use std::collections::HashSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::fitted::{empty, leave_out};
use super::{ParameterMap, Uncertainty};
use crate::fit::{Evidence, FitOptions, Fitter, Model, Reason, choose_models, zenith_factors};
use crate::observation::{ObservationMap, TexelObservations};
use crate::progress::Progress;
use crate::{Error, Result};

/// What [`select_surface`] is told.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Selection {
    /// How each model is fitted.
    pub fit: FitOptions,
    /// A model whose mean relative error in views that its fit has not seen is at most this suffices, however much better a
    /// larger one is; 0: none.
    pub tolerance: f32,
}

/// Fits to every texel of `map` the smallest of `models` that suffices, leaving out the views `without`.
///
/// Each model predicts every fifth of a texel's views from the others; the smallest within 2 % of the best is taken. Where
/// the texel's own views leave that open, those of the eight around it decide. Models that need more views than there are
/// take no part.
///
/// # Errors
/// [`Error::Input`] when none of the models can be fitted; [`Error::Io`] when the map cannot be read;
/// [`Error::Interrupted`].
pub fn select_surface(
    map: &ObservationMap,
    models: &[Model],
    selection: &Selection,
    without: &[u32],
    progress: &dyn Progress,
) -> Result<ParameterMap> {
    let header = map.header();
    let sample = map.sample(without)?;
    let mut fitters: Vec<Fitter> =
        models.iter().filter_map(|&model| Fitter::new(model, &selection.fit, &sample).ok()).collect();
    fitters.sort_by_key(|fitter| fitter.model().bytes_per_texel());
    if fitters.is_empty() {
        // Says why.
        Fitter::new(Model::Constant, &selection.fit, &sample).map_err(|error| error.about(map.path()))?;
        return Err(Error::request("there is no model to choose from", "name some"));
    }
    shorten(&mut fitters, &sample, selection.tolerance);
    let (texels, tiles) = (header.texels, header.tiles().count());
    let done = AtomicUsize::new(0);
    let step = || progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, 2 * tiles);
    let evidence = Mutex::new(vec![Evidence::default(); texels.count()]);
    let index = |(column, row): (u32, u32)| row as usize * texels.columns as usize + column as usize;
    (0..tiles).into_par_iter().try_for_each(|tile| {
        let found: Vec<_> = map
            .tile(tile)?
            .iter()
            .map(|(texel, observations)| (*texel, Evidence::of(&fitters, &leave_out(observations, without))))
            .collect();
        let mut evidence = evidence.lock().map_err(|_| Error::Interrupted)?;
        found.into_iter().for_each(|(texel, found)| evidence[index(texel)] = found);
        drop(evidence);
        step()
    })?;
    let evidence = evidence.into_inner().map_err(|_| Error::Interrupted)?;

    let mut fitted = ParameterMap {
        surface: header.surface,
        texels,
        models: fitters.iter().map(Fitter::model).collect(),
        choice: vec![0; texels.count()],
        parameters: vec![],
        diagnostics: None,
        uncertainty: None,
    };
    let sizes: Vec<usize> = fitted.models.iter().map(Model::bytes_per_texel).collect();
    let mut diagnostics = empty(texels.count());
    (diagnostics.runner_up, diagnostics.reason) =
        (vec![0; texels.count()], vec![Reason::Only; texels.count()]);
    diagnostics.sigma = vec![0.0; texels.count()];
    for (i, (choice, reason)) in
        choose_models(&evidence, texels, &sizes, selection.tolerance).into_iter().enumerate()
    {
        (fitted.choice[i], diagnostics.reason[i]) = (choice as u8, reason);
        diagnostics.runner_up[i] = evidence[i].runner_up(choice).unwrap_or(choice) as u8;
        diagnostics.sigma[i] = evidence[i].sigma.get(choice).copied().unwrap_or(f32::INFINITY);
    }
    let stride = fitted.stride();
    let target = Mutex::new((vec![0f32; texels.count() * stride], diagnostics));
    (0..tiles).into_par_iter().try_for_each(|tile| {
        let fit = |(texel, observations): &((u32, u32), _)| {
            let i = index(*texel);
            (i, fitters[usize::from(fitted.choice[i])].fit(&leave_out(observations, without)))
        };
        let fits: Vec<_> = map.tile(tile)?.iter().map(fit).collect();
        let mut target = target.lock().map_err(|_| Error::Interrupted)?;
        let (parameters, diagnostics) = &mut *target;
        for (i, fit) in fits {
            parameters[i * stride..][..fit.parameters.len()].copy_from_slice(&fit.parameters);
            (diagnostics.residual[i], diagnostics.views[i]) = (fit.residual, fit.views);
            diagnostics.flags[i] = fit.flags;
        }
        drop(target);
        step()
    })?;
    let (parameters, diagnostics) = target.into_inner().map_err(|_| Error::Interrupted)?;
    fitted.parameters = parameters;
    fitted.diagnostics = Some(diagnostics);
    fitted.uncertainty = Some(Uncertainty {
        floor: fitters[0].floor() as f32,
        zenith: zenith_factors(&fitters, &sample, selection.tolerance),
    });
    fitted.forget_unused();
    Ok(fitted)
}

/// A model that fewer of the sampled texels choose is not tried on the others.
const LEAST_SHARE: f64 = 0.02;

/// Keeps the models that a few hundred texels want.
fn shorten(fitters: &mut Vec<Fitter>, sample: &[TexelObservations], tolerance: f32) {
    let chosen: Vec<usize> = sample
        .par_iter()
        .filter_map(|texel| Evidence::of(fitters, texel).choices(tolerance))
        .map(|[_, open]| open)
        .collect();
    let share = |model: usize| chosen.iter().filter(|c| **c == model).count() as f64 / chosen.len() as f64;
    let keep: Vec<bool> = (0..fitters.len()).map(|model| share(model) >= LEAST_SHARE).collect();
    if keep.contains(&true) {
        let mut keep = keep.into_iter();
        fitters.retain(|_| keep.next() == Some(true));
    } else {
        // No texel has views enough for anything but the smallest.
        fitters.truncate(1);
    }
}

impl ParameterMap {
    /// Leaves out the models that no texel has taken or nearly taken.
    fn forget_unused(&mut self) {
        let nearly = self.diagnostics.iter().flat_map(|diagnostics| &diagnostics.runner_up);
        let named: HashSet<u8> = self.choice.iter().chain(nearly).copied().collect();
        let before = self.stride();
        let mut named: Vec<u8> = named.into_iter().collect();
        named.sort_unstable();
        let renumber = |choice: &mut u8| *choice = named.iter().filter(|model| *model < choice).count() as u8;
        self.choice.iter_mut().for_each(renumber);
        if let Some(diagnostics) = &mut self.diagnostics {
            diagnostics.runner_up.iter_mut().for_each(renumber);
        }
        if let Some(uncertainty) = &mut self.uncertainty {
            uncertainty.zenith = named.iter().map(|model| uncertainty.zenith[usize::from(*model)]).collect();
        }
        self.models = named.iter().map(|model| self.models[usize::from(*model)]).collect();
        let stride = self.stride();
        let texels = self.parameters.chunks_exact(before);
        self.parameters = texels.flat_map(|texel| &texel[..stride]).copied().collect();
        if self.models.len() == 1 {
            self.choice.clear();
            if let Some(diagnostics) = &mut self.diagnostics {
                diagnostics.runner_up.clear();
                diagnostics.reason.clear();
            }
        }
    }
}

//! The smallest sufficient model for every texel of a surface.

use std::collections::HashSet;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::fitted::{empty, leave_out};
use super::memory::require;
use super::{Diagnostics, ParameterMap, Uncertainty};
use crate::fit::{Choice, Evidence, FitOptions, Model, Reason, Selector, TexelFit, ZenithRatios};
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

/// Of so many texels the doubt is measured by zenith.
const MEASURED: usize = 1000;

/// So many texels are compared at a time.
const BATCH: usize = 128;

/// Fits to every texel of `map` the smallest of `models` that suffices, leaving out the views `without`: see [`Selector`]. Texels
/// that look alike share a fit where that predicts them as well: see [`Selector::palette`].
///
/// # Errors
/// [`Error::Input`] when none of the models can be fitted; [`Error::Request`] when the machine has too little memory;
/// [`Error::Io`] when the map cannot be read; [`Error::Interrupted`].
pub fn select_surface(
    map: &ObservationMap,
    models: &[Model],
    selection: &Selection,
    without: &[u32],
    progress: &dyn Progress,
) -> Result<ParameterMap> {
    let header = map.header();
    let (texels, tiles) = (header.texels, header.tiles().count());
    let done = AtomicUsize::new(0);
    let sample = map.sample(without)?;
    let go_on = || progress.step(done.load(Ordering::Relaxed), 2 * tiles);
    let selector = Selector::new(models, &selection.fit, selection.tolerance, &sample, &go_on)
        .map_err(|error| error.about(map.path()))?;
    let palette = selector.palette(&sample, &go_on)?;
    drop(sample);
    let models = selector.models();
    let stride = models.iter().map(Model::parameter_count).max().unwrap_or(0);
    // Evidence, parameters, and once more the parameters while they are written.
    require(texels, models.len() * 16 + 2 * stride * 4 + 96)?;

    let step = || progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, 2 * tiles);
    let evidence = Mutex::new(vec![Evidence::default(); texels.count()]);
    let index = |(column, row): (u32, u32)| row as usize * texels.columns as usize + column as usize;
    (0..tiles).into_par_iter().try_for_each_init(Vec::new, |read, tile| {
        map.read_tile(tile, read)?;
        leave_out(read, without);
        let found = read.par_chunks(BATCH).map(|some| {
            // Whoever wants to stop does not wait for the whole tile.
            go_on()?;
            Ok(selector.evidence(&some.iter().map(|(_, texel)| texel).collect::<Vec<_>>()))
        });
        let found = found.collect::<Result<Vec<_>>>()?.concat();
        let mut evidence = evidence.lock().map_err(|_| Error::Interrupted)?;
        read.iter().zip(found).for_each(|((texel, _), found)| evidence[index(*texel)] = found);
        drop(evidence);
        step()
    })?;
    let evidence = evidence.into_inner().map_err(|_| Error::Interrupted)?;
    let mut chosen = selector.choose(&evidence, texels);
    let [sigma, error] = [Selector::sigma, Selector::error_in_unseen].map(|of| -> Vec<f32> {
        evidence.iter().zip(&chosen).map(|(evidence, choice)| of(&selector, evidence, choice)).collect()
    });
    drop(evidence);

    let diagnostics = Diagnostics {
        palette: vec![0; texels.count()],
        sigma: vec![f32::INFINITY; texels.count()],
        ..empty(map, without)
    };
    let target = Mutex::new((vec![0f32; texels.count() * stride], diagnostics, ZenithRatios::default()));
    let measured_step = texels.count().div_ceil(MEASURED);
    (0..tiles).into_par_iter().try_for_each_init(Vec::new, |read, tile| {
        map.read_tile(tile, read)?;
        leave_out(read, without);
        let places: Vec<usize> = read.iter().map(|(texel, _)| index(*texel)).collect();
        let shared = |(i, (_, texel)): (&usize, &(_, TexelObservations))| {
            go_on()?;
            Ok(selector.entry(&palette, texel, error[*i]))
        };
        let shared: Vec<Option<usize>> =
            places.par_iter().zip(read.par_iter()).map(shared).collect::<Result<_>>()?;
        let own: Vec<usize> = (0..read.len()).filter(|&k| shared[k].is_none()).collect();
        let fits = selector.fit(
            &own.iter().map(|&k| &read[k].1).collect::<Vec<_>>(),
            &own.iter().map(|&k| chosen[places[k]]).collect::<Vec<Choice>>(),
        );
        let mut ratios = ZenithRatios::default();
        let is_measured = |k: usize| places[k].is_multiple_of(measured_step);
        for (k, i) in own.iter().filter(|k| is_measured(**k)).map(|&k| (k, places[k])) {
            ratios.extend(selector.zenith_ratios(&read[k].1, sigma[i], &chosen[i]));
        }
        let mut found: Vec<(usize, TexelFit, f32, usize)> =
            own.iter().zip(fits).map(|(&k, fit)| (places[k], fit, sigma[places[k]], 0)).collect();
        for (k, entry) in shared.into_iter().enumerate().filter_map(|(k, entry)| Some((k, entry?))) {
            let (fit, sigma, of) = selector.shared_fit(&palette.entries()[entry], &read[k].1);
            found.push((places[k], fit, sigma, entry + 1));
            if is_measured(k) {
                ratios.extend(of);
            }
        }
        let mut target = target.lock().map_err(|_| Error::Interrupted)?;
        let (parameters, diagnostics, all) = &mut *target;
        for (i, fit, sigma, entry) in found {
            (diagnostics.sigma[i], diagnostics.palette[i]) = (sigma, entry as u8);
            parameters[i * stride..][..fit.parameters.len()].copy_from_slice(&fit.parameters);
            (diagnostics.residual[i], diagnostics.views[i]) = (fit.residual, fit.views);
            diagnostics.flags[i] = fit.flags;
        }
        all.extend(ratios);
        drop(target);
        step()
    })?;
    let (parameters, mut diagnostics, ratios) = target.into_inner().map_err(|_| Error::Interrupted)?;
    for (choice, entry) in chosen.iter_mut().zip(&diagnostics.palette) {
        if let Some(entry) = entry.checked_sub(1).map(|entry| &palette.entries()[usize::from(entry)]) {
            let runner_up = if choice.model == entry.model { choice.runner_up } else { choice.model };
            *choice = Choice { model: entry.model, runner_up, reason: Reason::Palette };
        }
    }
    diagnostics.runner_up = chosen.iter().map(|choice| choice.runner_up as u8).collect();
    diagnostics.reason = chosen.iter().map(|choice| choice.reason).collect();
    let zenith = ratios.factors(models.len());
    let mut fitted = ParameterMap {
        surface: header.surface,
        texels,
        models,
        choice: chosen.iter().map(|choice| choice.model as u8).collect(),
        parameters,
        diagnostics: Some(diagnostics),
        uncertainty: Some(Uncertainty { floor: selector.floor() as f32, zenith }),
    };
    fitted.forget_unused();
    Ok(fitted)
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
        if stride < before {
            for texel in 0..self.texels.count() {
                self.parameters.copy_within(texel * before..texel * before + stride, texel * stride);
            }
            self.parameters.truncate(self.texels.count() * stride);
        }
        if self.models.len() == 1 {
            self.choice.clear();
            if let Some(diagnostics) = &mut self.diagnostics {
                diagnostics.runner_up.clear();
                diagnostics.reason.clear();
            }
        }
        if let Some(diagnostics) = &mut self.diagnostics
            && diagnostics.palette.iter().all(|entry| *entry == 0)
        {
            diagnostics.palette.clear();
        }
    }
}

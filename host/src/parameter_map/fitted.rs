//! A model is fitted to a whole observation map, tile by tile, in bounded memory.

use std::borrow::Cow;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{Diagnostics, ParameterMap};
use crate::fit::{FitFlags, FitOptions, Fitter, Model};
use crate::observation::{ObservationMap, TexelObservations};
use crate::progress::Progress;
use crate::{Error, Result};

/// Fits `model` to every texel of `map`, leaving out the views `without` (indices in the map's header).
///
/// # Errors
/// [`Error::Input`] when the model has more unknowns than there are views or no view is left; [`Error::Io`] when the map
/// cannot be read; [`Error::Interrupted`].
pub fn fit_surface(
    map: &ObservationMap,
    model: Model,
    options: &FitOptions,
    without: &[u32],
    progress: &dyn Progress,
) -> Result<ParameterMap> {
    let header = map.header();
    let fitter =
        Fitter::new(model, options, &map.sample(without)?).map_err(|error| error.about(map.path()))?;
    let (texels, count) = (header.texels, model.parameter_count());
    let target = Mutex::new((vec![0f32; texels.count() * count], empty(texels.count())));
    let (tiles, done) = (header.tiles().count(), AtomicUsize::new(0));
    progress.step(0, tiles)?;
    (0..tiles).into_par_iter().try_for_each(|tile| {
        let observed = map.tile(tile)?;
        let rest: Vec<_> = observed.iter().map(|(_, texel)| leave_out(texel, without)).collect();
        let fits = fitter.fit_tile(&rest.iter().map(|texel| &**texel).collect::<Vec<_>>());
        let mut target = target.lock().map_err(|_| Error::Interrupted)?;
        let (parameters, diagnostics) = &mut *target;
        for (((column, row), _), fit) in observed.iter().zip(fits) {
            let (column, row) = (*column, *row);
            let index = row as usize * texels.columns as usize + column as usize;
            parameters[index * count..(index + 1) * count].copy_from_slice(&fit.parameters);
            diagnostics.residual[index] = fit.residual;
            diagnostics.views[index] = fit.views;
            diagnostics.flags[index] = fit.flags;
        }
        drop(target);
        progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, tiles)
    })?;
    let (parameters, diagnostics) = target.into_inner().map_err(|_| Error::Interrupted)?;
    Ok(ParameterMap {
        surface: header.surface,
        texels,
        models: vec![model],
        choice: vec![],
        parameters,
        diagnostics: Some(diagnostics),
        uncertainty: None,
    })
}

pub(super) fn leave_out<'a>(texel: &'a TexelObservations, without: &[u32]) -> Cow<'a, TexelObservations> {
    if without.is_empty() { Cow::Borrowed(texel) } else { Cow::Owned(texel.without(without)) }
}

pub(super) fn empty(count: usize) -> Diagnostics {
    Diagnostics {
        residual: vec![0.0; count],
        views: vec![0; count],
        flags: vec![FitFlags::default(); count],
        ..Diagnostics::default()
    }
}

//! A model is fitted to a whole observation map, tile by tile: beside the parameters only the tiles in work are in memory.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::memory::require;
use super::{Diagnostics, ParameterMap};
use crate::fit::{FitFlags, FitOptions, Fitter, Model};
use crate::observation::{ObservationMap, TexelObservations};
use crate::progress::Progress;
use crate::{Error, Result};

/// Fits `model` to every texel of `map`, leaving out the views `without` (indices in the map's header).
///
/// # Errors
/// [`Error::Input`] when the model has more unknowns than there are views or no view is left; [`Error::Request`] when the
/// machine has too little memory; [`Error::Io`] when the map cannot be read; [`Error::Interrupted`].
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
    // The parameters, and once more while they are written.
    require(texels, 2 * count * 4 + 32)?;
    let target = Mutex::new((vec![0f32; texels.count() * count], empty(map, without)));
    let (tiles, done) = (header.tiles().count(), AtomicUsize::new(0));
    progress.step(0, tiles)?;
    // As many as there are cores at work; each is used again.
    let idle = Mutex::new(vec![]);
    (0..tiles).into_par_iter().try_for_each(|tile| {
        let mut read = idle.lock().map_err(|_| Error::Interrupted)?.pop().unwrap_or_default();
        map.read_tile(tile, &mut read)?;
        leave_out(&mut read, without);
        let observed: Vec<_> = read.iter().map(|(_, texel)| texel).collect();
        // Where there are few tiles each is work for all cores.
        let some = if tiles < 4 * rayon::current_num_threads() { SOME } else { observed.len() };
        let fits: Vec<_> =
            observed.par_chunks(some.max(1)).flat_map_iter(|texels| fitter.fit_tile(texels)).collect();
        let mut target = target.lock().map_err(|_| Error::Interrupted)?;
        let (parameters, diagnostics) = &mut *target;
        for (&((column, row), _), fit) in read.iter().zip(fits) {
            let index = row as usize * texels.columns as usize + column as usize;
            parameters[index * count..(index + 1) * count].copy_from_slice(&fit.parameters);
            diagnostics.residual[index] = fit.residual;
            diagnostics.views[index] = fit.views;
            diagnostics.flags[index] = fit.flags;
        }
        drop(target);
        idle.lock().map_err(|_| Error::Interrupted)?.push(read);
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

/// So many texels of a tile are worth the work that smooth models share between them.
const SOME: usize = 256;

/// Forgets some views.
pub(super) fn leave_out(texels: &mut [((u32, u32), TexelObservations)], without: &[u32]) {
    for (_, texel) in texels.iter_mut().filter(|_| !without.is_empty()) {
        *texel = texel.without(without);
    }
}

/// For fits to the texels of `map`.
pub(super) fn empty(map: &ObservationMap, without: &[u32]) -> Diagnostics {
    let count = map.header().texels.count();
    let views = || (0..).zip(&map.header().views).filter(|(view, _)| !without.contains(view));
    let zenith_rad = |centre_m: DVec3| centre_m.truncate().length().atan2(centre_m.z);
    Diagnostics {
        residual: vec![0.0; count],
        views: vec![0; count],
        flags: vec![FitFlags::default(); count],
        seen: views().map(|(_, view)| view.name.clone()).collect(),
        zenith_rad: views().map(|(_, view)| zenith_rad(view.centre_m)).max_by(f64::total_cmp),
        photometry: map.header().photometry.clone(),
        ..Diagnostics::default()
    }
}

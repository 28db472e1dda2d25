//! One scale for a whole session, from views that overlap: how bright the lamp was in each view, and how the light falls off towards the
//! corners of the picture where no flat fields tell.
//!
//! The same texels are seen by many views. What one model of radiance against direction for each texel leaves, in one view at all texels
//! alike, is the lamp; at one place of the picture in all views alike, the lens. Both are solved for together with the models
//! (`equations`), as sure as patches of the surface agree. A gain for each view and the surface's own look are confounded where they
//! change with direction in the same way: so a gain counts as the lamp's only as far as views from about the same direction, or
//! about the same time, say so (`components`); it is drawn towards 1 by how much the lamp varies at all, and nothing is done
//! where that may be chance.

mod components;
mod equations;
mod estimate;
mod fall_off;
mod lamp;
mod looks;

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use crate::calibration::{Photometry, Registration};
use crate::fit::Model;
use crate::geometry::Surface;
use crate::measure::radiance_is_flattened;
use crate::progress::Progress;
use crate::session::{Event, Session};
use crate::{Error, Result};
use components::Views;
use estimate::{Estimate, estimate};
use fall_off::fall_off;
use lamp::lamp;
use looks::look;

/// A matte patch in the picture of every view: where its radiance changes, the lamp did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Its centre, surface frame; it may lie beside the sampled area.
    pub centre_m: DVec2,
    /// The length of its sides.
    pub side_m: f64,
}

/// What to look for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How bright the lamp was in each view.
    pub lamp: bool,
    /// The fall-off, where the session has no flat fields.
    pub vignetting: bool,
    /// Where to look for the lamp in place of the whole surface.
    pub reference: Option<Patch>,
}

impl Default for Options {
    /// Everything, from the surface itself.
    fn default() -> Self {
        Self { lamp: true, vignetting: true, reference: None }
    }
}

/// Fewer views than this tell nothing of the lamp: the models of the texels could be anything.
const FEWEST_VIEWS: usize = 12;
/// So many views determine two lobes for each texel, fewer one.
const VIEWS_FOR_TWO_LOBES: usize = 30;

/// Finds what there is to find; nothing of a session whose exposure times are unknown, where every view has a gain of its own anyway.
/// Everything is said in the notes of the result.
///
/// # Errors
/// [`crate::Error::Input`] when the session lacks radiance, poses, a lens or the surface's size; [`crate::Error::Request`] when the
/// reference patch is not seen, or tells nothing because no exposure time is known; [`crate::Error::Interrupted`].
pub fn find(session: &Session, options: &Options, progress: &dyn Progress) -> Result<Photometry> {
    let mut found = Photometry::nothing(session)?;
    let registration = Registration::of(session)?;
    let mut views = session.done_views();
    if let Some(registration) = &registration {
        views.retain(|&view| registration.view(&session.manifest.views[view].name).is_some());
    }
    let is_timed = |view: &usize| session.photographs(*view).iter().all(|photo| photo.exposure_s.is_some());
    let reference = options.reference.filter(|_| options.lamp);
    if !views.iter().all(is_timed) {
        if reference.is_some() {
            return Err(Error::request(
                "a reference patch tells nothing of the lamp where the exposure times are not known",
                "leave --reference out",
            ));
        }
        return Ok(found);
    }
    let names: Vec<&str> = views.iter().map(|&view| session.manifest.views[view].name.as_str()).collect();
    let order = in_time(session, &views);
    let told = from_the_surface(
        session,
        registration.as_ref(),
        (&views, &names, &order),
        options,
        &mut found,
        progress,
    )?;
    if let Some(patch) = reference {
        let side = Surface { width_m: patch.side_m, height_m: patch.side_m };
        let (patch_at, at) = (patch.centre_m, (side, patch.centre_m.extend(0.0)));
        let patch = look(session, registration.as_ref(), &views, at, &found, progress)?;
        if patch.pixels().is_empty() {
            return Err(Error::request(
                format!(
                    "no view shows the reference patch at {:.1}, {:.1} mm",
                    1e3 * patch_at.x,
                    1e3 * patch_at.y
                ),
                "give its centre from the centre of the surface, x right and y up",
            ));
        }
        let shows = |view: u32| patch.texels.iter().any(|texel| texel.observations.view.contains(&view));
        let blind: Vec<&str> =
            (0..).zip(&names).filter(|(view, _)| !shows(*view)).map(|(_, name)| *name).collect();
        found.notes.push(match blind.as_slice() {
            [] => format!("the reference patch is seen in all {} views", names.len()),
            blind => format!(
                "warning: the reference patch is seen in {} of {} views only; of the lamp in the others ({}) it tells nothing",
                names.len() - blind.len(),
                names.len(),
                blind.join(", ")
            ),
        });
        let reference = estimate(&patch, views.len(), Model::Constant, None, progress)?;
        lamp(&reference, &Views { direction: &[], time: &order }, &names, &mut found);
        found.notes.extend(told.and_then(|told| reference.contradiction(&told)));
    }
    Ok(found)
}

/// What the texels of the whole surface tell: of the lamp, unless a patch does, and of the fall-off. `None` where that is not asked
/// for or they do not.
fn from_the_surface(
    session: &Session,
    registration: Option<&Registration>,
    (views, names, order): (&[usize], &[&str], &[f64]),
    options: &Options,
    found: &mut Photometry,
    progress: &dyn Progress,
) -> Result<Option<Estimate>> {
    let falls_off = if options.vignetting { unflattened(session, views, found)? } else { None };
    let asks = match (options.lamp && options.reference.is_none(), falls_off) {
        (true, None) => Some("the lamp was steady"),
        (true, Some(_)) => Some("the lamp was steady and the lens even"),
        (false, Some(_)) => Some("the lens was even"),
        // Whether it contradicts the patch.
        (false, None) if options.lamp => None,
        (false, None) => return Ok(None),
    };
    if views.len() < FEWEST_VIEWS {
        let note = |asks| {
            format!(
                "{} views do not tell whether {asks}, {FEWEST_VIEWS} would: nothing is changed",
                views.len()
            )
        };
        found.notes.extend(asks.map(note));
        return Ok(None);
    }
    let surface = session.manifest.surface()?;
    let whole = look(session, registration, views, (surface, DVec3::ZERO), found, progress)?;
    let most = whole.texels.iter().map(|texel| texel.observations.len()).max().unwrap_or(0);
    if most < FEWEST_VIEWS {
        let note = |asks| {
            format!(
                "the views overlap too little to tell whether {asks}: no place was seen by more than {most} of them, {FEWEST_VIEWS} would do: nothing is changed"
            )
        };
        found.notes.extend(asks.map(note));
        return Ok(None);
    }
    let model = Model::Phong { lobes: if views.len() < VIEWS_FOR_TWO_LOBES { 1 } else { 2 } };
    let told = estimate(&whole, views.len(), model, falls_off, progress)?;
    let seen = Views { direction: &whole.direction, time: order };
    if options.lamp && options.reference.is_none() {
        lamp(&told, &seen, names, found);
    }
    if let Some(start) = falls_off {
        fall_off(&told, &seen, &whole.texels, start, found);
    }
    Ok(Some(told))
}

/// Width and height of the pictures whose fall-off flat fields do not tell.
fn unflattened(session: &Session, views: &[usize], found: &mut Photometry) -> Result<Option<(u32, u32)>> {
    if !session.flats()?.is_empty() {
        if !radiance_is_flattened(session)? {
            found.notes.push(
                "the radiance was measured before the flat fields were there: run `rigel radiance` again"
                    .into(),
            );
        }
        return Ok(None);
    }
    let lens = lens_of_all(session, views);
    if lens.is_none() {
        found.notes.push(
            "vignetting stays in the radiance: the views have lenses of their own; photograph flat fields"
                .into(),
        );
    }
    Ok(lens)
}

/// Width and height of the pictures where one lens took all of them.
fn lens_of_all(session: &Session, views: &[usize]) -> Option<(u32, u32)> {
    let first = session.manifest.lens(*views.first()?).ok()?;
    let same = |view: &usize| session.manifest.lens(*view).is_ok_and(|lens| lens == first);
    views.iter().all(same).then_some((first.width, first.height))
}

/// When each view was taken, from 0 to 1: its rank in the journal.
fn in_time(session: &Session, views: &[usize]) -> Vec<f64> {
    let mut first = BTreeMap::new();
    for (place, event) in session.events().iter().enumerate() {
        if let Event::Photograph(photograph) = event {
            first.entry(photograph.view).or_insert(place);
        }
    }
    let mut ranks: Vec<usize> = (0..views.len()).collect();
    ranks.sort_by_key(|&i| first.get(&views[i]));
    let mut times = vec![0.0; views.len()];
    for (rank, &i) in ranks.iter().enumerate() {
        times[i] = rank as f64 / (views.len().max(2) - 1) as f64;
    }
    times
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The unit vector towards a view.
fn toward(centre_m: DVec3) -> DVec3 {
    centre_m.normalize_or(DVec3::Z)
}

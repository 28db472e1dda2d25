//! What the views see of a grid of texels, and where in their pictures.

use glam::{DVec2, DVec3};

use super::toward;
use crate::Result;
use crate::calibration::{Photometry, Registration, view_geometry};
use crate::geometry::{Surface, Texels};
use crate::observation::{Area, TexelObservations, sample_area};
use crate::progress::Progress;
use crate::session::Session;

/// Observations that are looked at, about, and the texels on a side that make them.
const OBSERVATIONS: usize = 45_000;
const SIDES: std::ops::RangeInclusive<u32> = 12..=24;
/// Patches on a side: what is wrong with the model of a material is wrong all over it, so only patches are independent of each other.
const PATCHES: u32 = 4;

/// Number of patches.
pub(super) const BLOCKS: usize = (PATCHES * PATCHES) as usize;

/// One texel in all views that measured it.
#[derive(Debug, Clone)]
pub(super) struct Texel {
    /// In which patch it lies.
    pub block: usize,
    pub observations: TexelObservations,
    /// Where it appears, per observation.
    pub pixel: Vec<DVec2>,
}

/// All texels, and the unit vector towards each view.
pub(super) struct Looks {
    pub texels: Vec<Texel>,
    pub direction: Vec<DVec3>,
}

impl Looks {
    /// Where in the pictures anything was measured.
    pub fn pixels(&self) -> Vec<DVec2> {
        self.texels.iter().flat_map(|texel| texel.pixel.iter().copied()).collect()
    }
}

/// Looks at a rectangle around a point of the surface's plane.
pub(super) fn look(
    session: &Session,
    registration: Option<&Registration>,
    views: &[usize],
    (surface, centre_m): (Surface, DVec3),
    photometry: &Photometry,
    progress: &dyn Progress,
) -> Result<Looks> {
    let side = ((OBSERVATIONS / views.len().max(1)) as f64).sqrt() as u32;
    let side = side.clamp(*SIDES.start(), *SIDES.end());
    let texels = Texels { columns: side, rows: side };
    let area = Area { surface, centre_m, texels };
    let block = |i: u32| ((i / side * PATCHES / side) * PATCHES + i % side * PATCHES / side) as usize;
    let empty = |i: u32| Texel { block: block(i), observations: TexelObservations::default(), pixel: vec![] };
    let mut looks = Looks { texels: (0..side * side).map(empty).collect(), direction: vec![] };
    for (index, &view) in views.iter().enumerate() {
        progress.step(index, views.len())?;
        let samples = sample_area(session, registration, Some(photometry), view, &area)?;
        let (lens, pose) = view_geometry(session, registration, view)?;
        for ((i, sample), texel) in (0..).zip(samples).zip(&mut looks.texels) {
            let point = centre_m + surface.texel_centre(texels, i % side, i / side);
            let (Some(sample), Some(pixel)) = (sample, lens.project(pose.to_camera(point))) else { continue };
            let seen = &mut texel.observations;
            seen.view.push(index as u32);
            seen.direction.push(toward(pose.centre_m - point).as_vec3());
            seen.radiance.push(sample.radiance);
            seen.sigma.push(sample.sigma);
            texel.pixel.push(pixel);
        }
        looks.direction.push(toward(pose.centre_m));
    }
    Ok(looks)
}

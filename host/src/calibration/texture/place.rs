//! Views that nothing but their commanded angles has placed, shifted to where their texture is that of the others.

use rayon::prelude::*;

use super::pattern::{Pattern, Reference};
use super::plate::{Grid, Plate};
use super::search::{Found, search};
use super::{Texture, shifted};
use crate::calibration::rig_model::{Deviation, RigModel};
use crate::geometry::Lens;

/// The sizes of nodes at which it is tried: fine texture is seen at the second only.
const LEVELS: [usize; 2] = [2, 1];
/// One of so many views that see the surface from the front is the first.
const FIRST: usize = 5;

/// Why the texture does not place a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Unplaced {
    /// It has hardly any.
    Even,
    /// It is the same again elsewhere.
    Repeated,
    /// It has some, but none that is the others'.
    Unlike,
}

/// A view with where it should be.
pub struct Candidate<'a> {
    pub plate: &'a Plate,
    pub pan_rad: f64,
    pub tilt_rad: f64,
    pub deviation: Deviation,
    /// Whether it is there.
    pub is_placed: bool,
}

/// Places the views that are not; without any that is, one of the most frontal ones is taken to be. What the result says of
/// a view is `None` where it is placed: its deviation is then set.
pub fn place(
    texture: &Texture,
    lens: &Lens,
    rig: &RigModel,
    views: &mut [Candidate],
) -> Vec<Option<Unplaced>> {
    let mut found = vec![None; views.len()];
    for level in LEVELS {
        if views.iter().any(|view| !view.is_placed) {
            at_level(texture, level, (lens, rig), views, &mut found);
        }
    }
    found
}

fn at_level(
    texture: &Texture,
    level: usize,
    (lens, rig): (&Lens, &RigModel),
    views: &mut [Candidate],
    found: &mut [Option<Unplaced>],
) {
    let grid = texture.grid(level, 0);
    let reach = (texture.reach_m / grid.spacing_m).ceil() as usize;
    let wide = texture.grid(level, reach);
    let pattern = |view: &Candidate, grid: Grid| {
        let seen = rig.see(view.pan_rad, view.tilt_rad, &view.deviation);
        Pattern::of(&view.plate.seen_from(lens, &seen, grid), view.plate.noise)
    };
    let mut reference = Reference::new(grid);
    let placed: Vec<Option<Pattern>> =
        views.par_iter().map(|view| view.is_placed.then(|| pattern(view, grid))).collect();
    placed.iter().flatten().for_each(|pattern| reference.add(pattern));
    let far: Vec<Option<Pattern>> =
        views.par_iter().map(|view| (!view.is_placed).then(|| pattern(view, wide))).collect();
    let toward: Vec<_> =
        views.iter().map(|view| rig.pose(view.pan_rad, view.tilt_rad).centre_m.normalize()).collect();
    let mut order: Vec<usize> = (0..views.len()).filter(|&view| !views[view].is_placed).collect();
    order.sort_by(|&a, &b| toward[b].z.total_cmp(&toward[a].z));
    let mut alone = None;
    if placed.iter().all(Option::is_none) {
        let frontal = &order[..order.len().min(FIRST)];
        // The one that most of the others are like.
        let alike = |first: usize| -> f64 {
            let mut alone = Reference::new(grid);
            alone.add(&pattern(&views[first], grid));
            let others = frontal.iter().filter(|&&other| other != first);
            let like = |&other: &usize| match far[other].as_ref().map(|far| search(&alone, far, reach)) {
                Some(Found::At(_, like)) => like,
                _ => 0.0,
            };
            others.map(like).sum()
        };
        let scores: Vec<f64> = frontal.par_iter().map(|&first| alike(first)).collect();
        let Some(best) = (0..scores.len()).max_by(|&a, &b| scores[a].total_cmp(&scores[b])) else { return };
        let first = order.remove(best);
        views[first].is_placed = true;
        found[first] = None;
        alone = Some(first);
        reference.add(&pattern(&views[first], grid));
        order.sort_by(|&a, &b| toward[b].dot(toward[first]).total_cmp(&toward[a].dot(toward[first])));
    }
    // Those that are not like the first few are compared with all.
    for _ in 0..2 {
        order.retain(|&view| {
            let Some(far) = &far[view] else { return false };
            found[view] = match search(&reference, far, reach) {
                Found::At(shift, _) => {
                    let own = &mut views[view];
                    let seen = rig.see(own.pan_rad, own.tilt_rad, &own.deviation);
                    own.deviation = shifted(&seen, &own.deviation, shift * grid.spacing_m);
                    own.is_placed = true;
                    reference.add(&pattern(own, grid));
                    None
                }
                Found::Repeated => Some(Unplaced::Repeated),
                Found::Nowhere(_) if far.is_textured() => Some(Unplaced::Unlike),
                Found::Nowhere(_) => Some(Unplaced::Even),
            };
            found[view].is_some()
        });
    }
    if let Some(first) = alone.filter(|_| views.iter().filter(|view| view.is_placed).count() == 1) {
        views[first].is_placed = false;
        found[first] = order.first().and_then(|&other| found[other]).or(Some(Unplaced::Even));
    }
}

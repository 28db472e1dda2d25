//! Views aligned by the surface's own texture: what the squares leave, or where there are none.
//!
//! A view's radiance is laid out on the surface as the poses so far have it ([`plate`]); of that only what is brighter or
//! darker than around it counts ([`pattern`]), so that neither a lamp nor a highlight matters much. Views without a pose
//! are first shifted as a whole to where they are like the others ([`search`]); then patches of every view are compared with
//! the mean of all other views, coarse to fine ([`patch`]), and where they are found goes into the one adjustment as points
//! that have no known place but are the same in all views.

mod patch;
mod pattern;
mod place;
mod plate;
mod search;

use glam::{DVec2, DVec3};
use nalgebra::Matrix2;
use rayon::prelude::*;

use super::adjust::{Adjusted, Frame, MeasuredPoint, ViewData, adjust_from};
use super::rig_model::{Deviation, Seen};
use crate::geometry::{Lens, Surface};
use patch::Patch;
use pattern::{Pattern, Reference};
pub(super) use place::{Candidate, Unplaced, place};
use plate::Grid;
pub(super) use plate::Plate;

/// No more nodes than these along the longer side, however fine the pictures are.
const MOST_NODES: f64 = 320.0;
/// About so many patches.
const PATCHES: f64 = 48.0;
/// Plates reach so far beyond the surface, part of the distance: by so much views may be elsewhere.
const REACH: f64 = 0.02;
/// Sizes of nodes, each the double of the one before: the finest is a pixel's.
const LEVELS: usize = 3;
/// At which of them patches are compared, one after the other.
const ROUNDS: [usize; 4] = [2, 1, 0, 0];
/// How far an adjustment is taken in between.
const ROUNDS_OF_ADJUSTMENT: usize = 8;
/// Nodes beyond the surface that patches may be found in.
const MARGIN: usize = 4;
/// Fewer patches do not place a view.
pub(super) const FEWEST_PATCHES: usize = 6;

/// The surface of a session, and how finely it is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Texture {
    surface: Surface,
    finest_m: f64,
    reach_m: f64,
}

impl Texture {
    pub fn new(surface: Surface, lens: &Lens, distance_m: f64) -> Self {
        let pixel_m = distance_m / lens.fx.max(lens.fy);
        let longest_m = surface.width_m.max(surface.height_m);
        Self { surface, finest_m: pixel_m.max(longest_m / MOST_NODES), reach_m: REACH * distance_m }
    }

    fn grid(&self, level: usize, margin: usize) -> Grid {
        Grid::over(&self.surface, self.finest_m * f64::from(1 << level), margin)
    }

    /// What a view shows of the surface and around it, if it was taken from `seen` or not far from there.
    pub fn plate(&self, picture: &super::luminance::Luminance, lens: &Lens, seen: Seen) -> Plate {
        // A view may be elsewhere by as much again as it is looked for.
        let margin = (2.0 * self.reach_m / self.finest_m).ceil() as usize;
        Plate::new(picture, lens, seen, self.grid(0, margin), LEVELS)
    }

    /// Patches of a grid, row by row.
    fn patches(&self, grid: &Grid, margin: usize) -> Vec<Patch> {
        let Surface { width_m, height_m } = self.surface;
        let columns = (PATCHES * width_m / height_m).sqrt().round().clamp(2.0, PATCHES) as usize;
        let rows = ((PATCHES / columns as f64).round() as usize).max(2);
        let part = |i: usize, of: usize, nodes: usize| {
            let inside = nodes - 2 * margin;
            (margin + i * inside / of, margin + (i + 1) * inside / of)
        };
        let patch = |i: usize| Patch {
            columns: part(i % columns, columns, grid.columns),
            rows: part(i / columns, rows, grid.rows),
        };
        (0..columns * rows).map(patch).collect()
    }
}

/// Compares the patches of all placed views with the others', and adjusts, coarse to fine; where the poses are known but for
/// a pixel, at the finest level only. Sets the frame's points and those of `views`; views of which too little was found have
/// none. `None` where the equations cannot be solved.
pub(super) fn align(
    texture: &Texture,
    frame: &mut Frame,
    views: &mut [ViewData],
    (plates, placed): (&[&Plate], &[bool]),
    mut state: Adjusted,
    is_near: bool,
) -> Option<Adjusted> {
    let rounds = if is_near { &ROUNDS[ROUNDS.len() - 1..] } else { &ROUNDS[..] };
    for &level in rounds {
        let lens = frame.lens(&state.shared);
        let rig = frame.rig(&state.shared);
        let places = views.iter().zip(&state.deviations);
        let seen: Vec<Seen> =
            places.map(|(view, deviation)| rig.see(view.pan_rad, view.tilt_rad, deviation)).collect();
        let grid = texture.grid(level, MARGIN);
        let patches = texture.patches(&grid, MARGIN);
        frame.points_m = patches.iter().map(|patch| grid.place_m(patch.centre())).collect();
        let found = compare(&patches, grid, &lens, &seen, plates, placed);
        for (view, mut points) in views.iter_mut().zip(found) {
            if points.len() < FEWEST_PATCHES {
                points.clear();
            }
            view.points = points;
        }
        // What is at a patch's place now is another point than before.
        state.point_noise.resize(patches.len(), 1.0);
        state.offsets_m = vec![DVec3::ZERO; patches.len()];
        let before = state.deviations.clone();
        state = adjust_from(frame, views, state, ROUNDS_OF_ADJUSTMENT)?;
        for ((view, deviation), before) in views.iter().zip(&mut state.deviations).zip(before) {
            if view.points.is_empty() && view.squares.is_empty() {
                // At the next level there may be more to see.
                *deviation = before;
            }
        }
    }
    Some(state)
}

/// Where the patches of each placed view are in its picture.
fn compare(
    patches: &[Patch],
    grid: Grid,
    lens: &Lens,
    seen: &[Seen],
    plates: &[&Plate],
    placed: &[bool],
) -> Vec<Vec<MeasuredPoint>> {
    let pattern = |view: usize| {
        let sheet = || plates[view].seen_from(lens, &seen[view], grid);
        placed[view].then(|| Pattern::of(&sheet(), plates[view].noise))
    };
    let patterns: Vec<Option<Pattern>> = (0..plates.len()).into_par_iter().map(pattern).collect();
    let mut reference = Reference::new(grid);
    patterns.iter().flatten().for_each(|pattern| reference.add(pattern));
    let of_view = |(view, pattern): (usize, &Option<Pattern>)| {
        let Some(pattern) = pattern else { return vec![] };
        let measured = |(point, patch): (usize, &Patch)| {
            let tracked = patch.track(&reference, pattern, Some(pattern))?;
            let appear =
                |nodes: DVec2| lens.project(seen[view].to_camera(grid.place_m(patch.centre() + nodes)));
            let at = appear(tracked.shift)?;
            let (x, y) = (appear(tracked.shift + DVec2::X)? - at, appear(tracked.shift + DVec2::Y)? - at);
            let by_node = Matrix2::new(x.x, y.x, x.y, y.y);
            let covariance = by_node * tracked.covariance * by_node.transpose();
            Some(MeasuredPoint { point, at, covariance })
        };
        patches.iter().enumerate().filter_map(measured).collect()
    };
    patterns.par_iter().enumerate().map(of_view).collect()
}

/// A deviation with the surface's content shifted by `shift_m` on the surface.
fn shifted(seen: &Seen, deviation: &Deviation, shift_m: DVec2) -> Deviation {
    let by = seen.rotation * shift_m.extend(0.0);
    let mut deviation = *deviation;
    deviation[3] += by.x;
    deviation[4] += by.y;
    deviation
}

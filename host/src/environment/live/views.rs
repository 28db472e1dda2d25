//! How photographs were turned, by what they show of each other.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::environment::align::between;
use crate::environment::features::{Corners, Gray};
use crate::environment::mosaic::DETAILED;
use crate::geometry::{Lens, world_from_camera};
use crate::picture::Picture;

/// Pixels across for a look.
const LOOK: u32 = 320;
/// Pixels across for corners.
const GRAY: u32 = 640;
/// Photographs that are compared with a new one: the last ones, how far apart they may point (standard deviation about each axis, radians), and then those
/// that know their own place best.
const BESIDE: usize = 6;
const APART_RAD: f64 = 0.3;
const AROUND: usize = 4;
/// Turns that were added up are no surer than this, radians.
pub(super) const SUREST_RAD: f64 = 0.017;

/// A photograph with its corners.
pub(super) struct View {
    gray: Gray,
    corners: Corners,
}

impl View {
    pub fn new(lens: &Lens, picture: &Picture) -> Self {
        let white = f32::from(picture.white) * 3.0;
        let level = |i: usize| picture.levels[i].iter().map(|&level| f32::from(level)).sum::<f32>() / white;
        let gray = Gray::new(lens, level, GRAY);
        let corners = gray.corners();
        Self { gray, corners }
    }
}

/// A photograph whose turn is known: camera frame to the world, and how surely, radians.
struct Placed {
    view: View,
    turn: DQuat,
    sigma_rad: f64,
}

/// Those whose turn is known, in the order in which it became known.
#[derive(Default)]
pub(super) struct Views(Vec<Placed>);

impl Views {
    pub fn count(&self) -> usize {
        self.0.len()
    }

    pub fn add(&mut self, view: View, turn: DQuat, sigma_rad: f64) {
        self.0.push(Placed { view, turn, sigma_rad });
    }

    /// How a photograph was turned and how sure that is, by what it shares with others than the first `compared`, which share nothing with it; or why that
    /// cannot be told.
    pub fn turn_of(&self, view: &View, compared: usize) -> Result<(DQuat, f64), &'static str> {
        if self.0.is_empty() {
            // What shows nothing would never be found again by those that follow.
            return match view.corners.at.len() >= DETAILED {
                true => Ok((world_from_camera(DQuat::IDENTITY), SUREST_RAD)),
                false => Err("shows too few details to begin with"),
            };
        }
        let beside = |placed: &Placed, expected: (DQuat, f64)| {
            let other = &placed.view;
            let pair = between([&other.gray, &view.gray], [&other.corners, &view.corners], [0, 1], expected)?;
            Some(((placed.turn * pair.turn).normalize(), placed.sigma_rad.hypot(pair.sigma_rad)))
        };
        let surest = |found: Vec<(DQuat, f64)>| found.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        // The last ones first, then all in turn.
        let order: Vec<&Placed> = self.0[compared..].iter().rev().collect();
        let found = order.chunks(BESIDE).find_map(|some| {
            let found = some.par_iter().filter_map(|placed| beside(placed, (DQuat::IDENTITY, APART_RAD)));
            surest(found.collect())
        });
        let Some(found) = found else {
            return Err(
                "shows too little of what earlier photographs show; it counts once one between them has come",
            );
        };
        // It may meet one that was there long ago, and is surer.
        let is_near = |placed: &&Placed| {
            placed.sigma_rad < found.1 && (placed.turn * DVec3::Z).angle_between(found.0 * DVec3::Z) < 0.7
        };
        let mut near: Vec<&Placed> = self.0.iter().filter(is_near).collect();
        near.sort_by(|a, b| a.sigma_rad.total_cmp(&b.sigma_rad));
        let again = near.into_iter().take(AROUND).filter_map(|placed| {
            let doubt = placed.sigma_rad.hypot(found.1).max(0.01);
            beside(placed, ((placed.turn.inverse() * found.0).normalize(), doubt))
        });
        Ok(surest(again.chain([found]).collect()).unwrap_or(found))
    }
}

/// Every so many pixels of a picture.
pub(super) fn smaller(picture: &Picture) -> Picture {
    let by = picture.width.div_ceil(LOOK).max(1);
    let (width, height) = (picture.width.div_ceil(by), picture.height.div_ceil(by));
    let at = |i: u32| picture.levels[((i / width * by) * picture.width + i % width * by) as usize];
    let levels = (0..width * height).map(at).collect();
    Picture { path: picture.path.clone(), width, height, levels, white: picture.white }
}

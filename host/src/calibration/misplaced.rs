//! A square that is not where the file has it: all views say so together.

use glam::{DMat2, DVec2, DVec3};

use super::adjust::{Frame, ViewData, solo};
use super::look::FEWEST_SQUARES;
use super::median;
use super::rig_model::RigModel;

/// So many views must show the square and two others.
const FEWEST_VIEWS: usize = 5;
/// Without the square the others agree at least so many times better.
const BETTER: f64 = 3.0;
/// The others agree so many times better without it than without any other.
const CERTAIN: f64 = 2.0;
/// Where the views have it is so many standard deviations from where the file has it ...
const SURE_SIGMA: f64 = 6.0;
/// ... and at least this part of its side: rulers and printers are no better than that.
const LEAST_PART: f64 = 0.05;

/// A square and where it really is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Misplaced {
    /// Index in the layout.
    pub square: usize,
    /// Where the views have it less where the file has it, metres.
    pub by_m: DVec2,
    /// Whether no other square explains the views nearly as well: of four at the corners of a rectangle, each can make up for each
    /// other's small error.
    pub is_certain: bool,
}

/// What one view says of a square when the others put the view in its place: how far the square is from where the file has it, and
/// how badly the others agree.
struct Vote {
    by_m: DVec2,
    misfit: f64,
}

/// What all views together say of a square.
pub(super) struct Blamed {
    pub square: usize,
    /// Where the views have it less where the file has it, metres, and the standard deviation of that.
    pub by_m: DVec2,
    sigma_m: f64,
    /// How badly the others agree without it.
    misfit: f64,
}

/// The square without which the others agree, if it is consistently elsewhere; `views` have all that looks like a square.
pub(super) fn misplaced(frame: &Frame, views: &[ViewData]) -> Option<Misplaced> {
    let together: Vec<f64> = views
        .iter()
        .filter(|view| view.squares.len() > FEWEST_SQUARES)
        .filter_map(|view| Some(mean(&solo(frame, view)?.1)))
        .collect();
    let mut blamed = blamed(frame, views).into_iter();
    let Blamed { square, by_m, sigma_m, misfit } = blamed.next()?;
    let is_certain = blamed.next().is_none_or(|other| other.misfit > CERTAIN * misfit);
    let least = (SURE_SIGMA * sigma_m).max(LEAST_PART * frame.layout.size_m);
    let is_elsewhere = by_m.length() > least && BETTER * misfit < median(&together);
    is_elsewhere.then_some(Misplaced { square, by_m, is_certain })
}

/// The squares that enough views show, the one without which the others agree best first.
pub(super) fn blamed(frame: &Frame, views: &[ViewData]) -> Vec<Blamed> {
    let blamed = (0..frame.layout.centres_m.len()).filter_map(|square| {
        let votes: Vec<Vote> = views.iter().filter_map(|view| vote(frame, view, square)).collect();
        if votes.len() < FEWEST_VIEWS {
            return None;
        }
        let misfit = median(&votes.iter().map(|vote| vote.misfit).collect::<Vec<_>>());
        let along = |axis: usize| {
            let offsets: Vec<f64> = votes.iter().map(|vote| vote.by_m[axis]).collect();
            let middle = median(&offsets);
            let spread = median(&offsets.iter().map(|offset| (offset - middle).abs()).collect::<Vec<_>>());
            // Of normal numbers: their standard deviation, and that of their median.
            (middle, 1.2533 * spread / 0.6745 / (votes.len() as f64).sqrt())
        };
        let ((x, sigma_x), (y, sigma_y)) = (along(0), along(1));
        Some(Blamed { square, by_m: DVec2::new(x, y), sigma_m: sigma_x.hypot(sigma_y), misfit })
    });
    let mut blamed: Vec<Blamed> = blamed.collect();
    blamed.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
    blamed
}

fn vote(frame: &Frame, view: &ViewData, square: usize) -> Option<Vote> {
    let measured = view.squares.iter().find(|measured| measured.square == square)?;
    let squares: Vec<_> = view.squares.iter().filter(|other| other.square != square).cloned().collect();
    if squares.len() < FEWEST_SQUARES {
        return None;
    }
    let (deviation, misfit) = solo(frame, &ViewData { squares, ..view.clone() })?;
    let seen = RigModel::nominal(frame.distance_m).see(view.pan_rad, view.tilt_rad, &deviation);
    let centre_m = frame.layout.centres_m[square];
    let pixel = |offset: DVec3| frame.lens.project(seen.to_camera(centre_m + offset));
    let corners = frame.corners(square, &seen, &frame.lens, 0.0, 0.0)?;
    let off_px = (0..4)
        .map(|i| DVec2::new(measured.corners[2 * i], measured.corners[2 * i + 1]) - corners[i])
        .sum::<DVec2>()
        / 4.0;
    let step_m = 0.1 * frame.layout.size_m;
    let along = |axis: DVec3| Some((pixel(axis * step_m)? - pixel(-axis * step_m)?) / (2.0 * step_m));
    let by_place = DMat2::from_cols(along(DVec3::X)?, along(DVec3::Y)?);
    let by_m = (by_place.determinant() != 0.0).then(|| by_place.inverse() * off_px)?;
    Some(Vote { by_m, misfit: mean(&misfit) })
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

//! From corners to a lens: what does not belong is set aside, the model is chosen, and the result is judged.

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};

use super::adjust::{Estimate, Loss, Sight, adjust, residuals};
use super::choose::choose;
use super::doubt::{Doubt, doubt};
use super::start::start;
use super::verdict::{refuse_unknown_focal_length, verdict};
use super::{BoardFit, DroppedBoard, FittedCorner, LensCalibration, LensModel};
use crate::calibration::chessboard::BoardCorner;
use crate::calibration::median;
use crate::{Error, Result};

/// Fewer boards tell a lens from a tilt only by luck.
const LEAST_BOARDS: usize = 3;
/// A corner this many standard deviations off is none: noise does that once in 270,000.
const OUTLIER_SIGMAS: f64 = 5.0;
/// A board is none of these when its typical corner is so many times as far off as those of the others, and so many pixels.
const STRANGE: f64 = 5.0;
const STRANGE_PX: f64 = 0.7;
/// The median length of a residual whose coordinates have a standard deviation of 1.
const MEDIAN_LENGTH: f64 = 1.177_41;

/// The corners of one board in one photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardView {
    /// The photograph, to name it in messages.
    pub path: PathBuf,
    /// The corners that were found.
    pub corners: Vec<BoardCorner>,
}

/// Estimates a lens from boards whose squares have sides of `square_m` metres, seen in pictures of `width` x `height` pixels. Corners and
/// boards that contradict the others are set aside by name; `model` is chosen by the boards themselves where it is `None`: the
/// smallest one that foretells boards that it has not seen as well as the larger ones do, to within a standard error.
///
/// # Errors
/// [`Error::Input`] when there are fewer than three boards, or they do not tell the focal length.
pub fn calibrate_lens(
    views: &[BoardView],
    (width, height): (u32, u32),
    square_m: f64,
    model: Option<LensModel>,
) -> Result<LensCalibration> {
    let enough = |count: usize, path: &Path| match count {
        0 => Err(Error::request("there is no board to calibrate with", "give photographs of a chessboard")),
        1..LEAST_BOARDS => Err(Error::input(
            path,
            format!("is one of only {count} usable boards, which do not tell a lens from a tilt"),
            "photograph the board in ten positions, tilted to all sides and out to the corners of the picture",
        )),
        _ => Ok(()),
    };
    let first = views.first().map(|view| view.path.clone()).unwrap_or_default();
    enough(views.len(), &first)?;
    let mut kept: Vec<usize> = (0..views.len()).collect();
    let sigmas: Vec<f64> =
        views.iter().flat_map(|view| &view.corners).map(|corner| corner.sigma_px).collect();
    let usual_px = median(&sigmas);
    let all: Vec<Vec<Sight>> = views.iter().map(|view| sights(&view.corners, square_m, usual_px)).collect();
    let nonsense = || {
        Error::input(
            &first,
            "and the other boards fit no lens at all",
            "check --board and photograph them again",
        )
    };
    let mut estimate = start(&all, width, height).ok_or_else(nonsense)?;
    let largest = model.unwrap_or(LensModel::All);
    let mut dropped = vec![];
    let masks: Vec<Vec<bool>>;
    loop {
        let boards: Vec<Vec<Sight>> = kept.iter().map(|&i| all[i].clone()).collect();
        for _ in 0..2 {
            let typical = typical_lengths(&boards, &estimate).ok_or_else(nonsense)?;
            let half = (2.385 * median(&typical.concat()) / MEDIAN_LENGTH).max(1e-6);
            if let Some(better) = adjust(&boards, estimate.clone(), largest.estimated(), Loss::Cauchy(half)) {
                estimate = better;
            }
        }
        let lengths = typical_lengths(&boards, &estimate).ok_or_else(nonsense)?;
        let of_boards: Vec<f64> = lengths.iter().map(|lengths| median(lengths)).collect();
        let usual = median(&of_boards);
        let worst = (0..kept.len()).max_by(|&a, &b| of_boards[a].total_cmp(&of_boards[b])).unwrap_or(0);
        if of_boards[worst] > (STRANGE * usual).max(STRANGE_PX) {
            dropped.push(DroppedBoard {
                path: views[kept[worst]].path.clone(),
                reason: format!(
                    "its corners are {:.1} px from where the lens of the other boards shows them, where {usual:.2} px is usual; \
                     photograph a flat board, with one zoom and focus for all",
                    of_boards[worst]
                ),
            });
            kept.remove(worst);
            estimate.poses.remove(worst);
            enough(kept.len(), &first)?;
            continue;
        }
        let limit = OUTLIER_SIGMAS * median(&lengths.concat()) / MEDIAN_LENGTH;
        masks = lengths.iter().map(|board| board.iter().map(|length| *length <= limit).collect()).collect();
        break;
    }
    let boards: Vec<Vec<Sight>> = kept.iter().zip(&masks).map(|(&i, mask)| masked(&all[i], mask)).collect();
    let model = match model {
        Some(model) => model,
        None => choose(&boards, &estimate).ok_or_else(nonsense)?,
    };
    estimate.lens = super::choose::without(&estimate.lens, model);
    let estimate = adjust(&boards, estimate, model.estimated(), Loss::Squares).ok_or_else(nonsense)?;
    let doubt = doubt(&boards, &estimate, model);
    refuse_unknown_focal_length(&first, &estimate, doubt.as_ref())?;
    let Doubt { covariance, excess, rms_px } = doubt.ok_or_else(nonsense)?;
    let fits = kept
        .iter()
        .zip(&masks)
        .zip(&estimate.poses)
        .map(|((&i, mask), pose)| {
            let residuals = residuals(&estimate.lens, pose, &all[i]).unwrap_or_default();
            let corners: Vec<FittedCorner> = views[i]
                .corners
                .iter()
                .zip(residuals)
                .zip(mask)
                .map(|((&corner, residual), &used)| FittedCorner { corner, residual, used })
                .collect();
            let used: Vec<DVec2> = corners.iter().filter(|c| c.used).map(|c| c.residual).collect();
            let squares: f64 = used.iter().map(|residual| residual.length_squared()).sum();
            BoardFit {
                path: views[i].path.clone(),
                rms_px: (squares / used.len().max(1) as f64).sqrt(),
                tilt_rad: pose.rotation.z_axis.z.abs().min(1.0).acos(),
                corners,
            }
        })
        .collect();
    let mut calibration = LensCalibration {
        lens: estimate.lens,
        covariance,
        model,
        rms_px,
        excess,
        boards: fits,
        dropped,
        verdict: String::new(),
    };
    calibration.verdict = verdict(&calibration, estimate.settled);
    Ok(calibration)
}

/// What every corner has beside the noise around it (the board is not quite flat, the lens not quite the model) is as much as that noise
/// usually is.
fn sights(corners: &[BoardCorner], square_m: f64, usual_px: f64) -> Vec<Sight> {
    let variance = |sigma_px: f64| usual_px.powi(2) + sigma_px.powi(2);
    let weight = |corner: &BoardCorner| match variance(corner.sigma_px) {
        variance if variance > 0.0 => 2.0 * usual_px.powi(2) / variance,
        _ => 1.0,
    };
    let point = |corner: &BoardCorner| {
        DVec3::new(f64::from(corner.column) * square_m, f64::from(corner.row) * square_m, 0.0)
    };
    let sight = |corner| Sight { point_m: point(corner), pixel: corner.pixel, weight: weight(corner) };
    corners.iter().map(sight).collect()
}

fn masked(sights: &[Sight], mask: &[bool]) -> Vec<Sight> {
    sights.iter().zip(mask).filter(|(_, used)| **used).map(|(sight, _)| *sight).collect()
}

/// The lengths of all residuals, board by board.
fn typical_lengths(boards: &[Vec<Sight>], estimate: &Estimate) -> Option<Vec<Vec<f64>>> {
    let of_board = |(sights, pose): (&Vec<Sight>, _)| {
        Some(residuals(&estimate.lens, pose, sights)?.into_iter().map(DVec2::length).collect())
    };
    boards.iter().zip(&estimate.poses).map(of_board).collect()
}

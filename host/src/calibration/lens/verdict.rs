//! What was achieved, in a sentence, and what would improve it.

use std::path::Path;

use glam::{DVec2, DVec3};

use super::adjust::Estimate;
use super::doubt::Doubt;
use super::{BoardFit, LensCalibration};
use crate::calibration::median;
use crate::{Error, Result};

/// The focal length counts as known when its standard deviation is this share of it.
const KNOWN_FOCAL_LENGTH: f64 = 0.02;
/// Boards within this angle of each other are parallel, degrees.
const PARALLEL_DEG: f64 = 8.0;
/// A corner of the picture was not covered when no board came nearer than this share of the diagonal ...
const COVERED: f64 = 0.15;
/// ... and things are shown there with a standard deviation of more than this, pixels.
const SURE_PX: f64 = 0.25;
/// Boards that contradict each other by this factor more than the noise of their corners are worth a word.
const BENT: f64 = 1.5;

/// Fewer boards may agree by chance.
const ENOUGH_BOARDS: usize = 6;
/// A focal length that is less sure than this share of it, or things that are, in pixels, are known roughly only.
const ROUGH_FOCAL_LENGTH: f64 = 0.01;
const ROUGH_PX: f64 = 1.5;
/// Corners of sharp photographs of a flat board are nearer than this to where the lens shows them (median), pixels.
const COARSE_PX: f64 = 0.25;
/// A board is coarser than the others when its corners are so many times as far off, and blurred when they are so many times as
/// blurred.
const COARSER: f64 = 2.0;
const MORE_BLURRED: f64 = 1.4;

/// What is doubtful of a board that takes part in a calibration; `None` where it is like the others.
pub(super) fn doubt_about(calibration: &LensCalibration, board: &BoardFit) -> Option<String> {
    let of_all =
        |of: &dyn Fn(&BoardFit) -> f64| median(&calibration.boards.iter().map(of).collect::<Vec<_>>());
    let blur = |board: &BoardFit| median(&board.corners.iter().map(|c| c.corner.blur_px).collect::<Vec<_>>());
    let (typical, usual) = (board.typical_px(), of_all(&BoardFit::typical_px));
    let (blurred, blur_usual) = (blur(board), of_all(&blur));
    let why = match blurred > MORE_BLURRED * blur_usual {
        true => format!("it is more blurred ({blurred:.1} px, {blur_usual:.1} px is usual)"),
        false => "it may be bent, or have moved meanwhile".into(),
    };
    (typical > (COARSER * usual).max(0.6 * COARSE_PX)).then(|| {
        format!(
            "its corners are {typical:.2} px off where {usual:.2} px is usual: {why}; photograph it again"
        )
    })
}

/// Refuses boards that do not tell the focal length.
pub(super) fn refuse_unknown_focal_length(
    path: &Path,
    estimate: &Estimate,
    doubt: Option<&Doubt>,
) -> Result<()> {
    let lens = &estimate.lens;
    let sigma = |k: usize| doubt.map_or(f64::INFINITY, |doubt| doubt.covariance[k][k].sqrt());
    let share = (sigma(0) / lens.fx).max(sigma(1) / lens.fy);
    if share <= KNOWN_FOCAL_LENGTH {
        return Ok(());
    }
    let normals: Vec<DVec3> = estimate.poses.iter().map(|pose| pose.rotation.z_axis).collect();
    let between = |a: &DVec3, b: &DVec3| a.dot(*b).abs().min(1.0).acos().to_degrees();
    let widest = normals.iter().flat_map(|a| normals.iter().map(move |b| between(a, b))).fold(0.0, f64::max);
    let known = match share.is_finite() {
        true => format!("which tells the focal length only to within {:.0} %", 100.0 * share),
        false => "which does not tell the focal length".into(),
    };
    let what = match widest < PARALLEL_DEG {
        true => format!("and all other boards are parallel to within {widest:.0} degrees, {known}"),
        false => format!("and the other boards show too little of the picture, {known}"),
    };
    let remedy = "tilt the board by 20 to 45 degrees to all sides and photograph it near, in ten positions";
    Err(Error::input(path, what, remedy))
}

/// The verdict on a calibration, and whether its adjustment came to rest.
pub(super) fn verdict(calibration: &LensCalibration, settled: bool) -> String {
    let lens = &calibration.lens;
    let mut sigmas = calibration.projection_sigmas_px(9, 7);
    sigmas.sort_by(f64::total_cmp);
    let typical = sigmas[sigmas.len() / 2];
    let (right, bottom) = (f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0);
    let corners = [
        ("top left", DVec2::ZERO),
        ("top right", DVec2::new(right, 0.0)),
        ("bottom left", DVec2::new(0.0, bottom)),
        ("bottom right", DVec2::new(right, bottom)),
    ];
    let at_corners: Vec<f64> = corners.iter().map(|(_, at)| calibration.projection_sigma_px(*at)).collect();
    let worst = at_corners.iter().copied().fold(0.0, f64::max);
    let seen = || calibration.boards.iter().flat_map(|board| &board.corners).filter(|corner| corner.used);
    let bare: Vec<&str> = corners
        .iter()
        .zip(&at_corners)
        .filter(|((_, at), sigma)| {
            let near = COVERED * right.hypot(bottom);
            **sigma > SURE_PX && seen().all(|seen| seen.corner.pixel.distance(*at) > near)
        })
        .map(|((name, _), _)| *name)
        .collect();
    let count = calibration.boards.len();
    let focal = calibration.sigmas()[0] / lens.fx;
    let usual = median(&calibration.boards.iter().map(BoardFit::typical_px).collect::<Vec<_>>());
    let coarse = usual > COARSE_PX;
    let bent = calibration.excess.sqrt() > BENT;
    let found = if count < ENOUGH_BOARDS {
        format!("calibrated roughly, from too few boards ({count}; take ten or more)")
    } else if focal > ROUGH_FOCAL_LENGTH || typical > ROUGH_PX {
        format!(
            "calibrated roughly (the focal length is known to {:.1} %; tilt the board more and go nearer)",
            100.0 * focal
        )
    } else if coarse || bent || !settled {
        "calibrated roughly".into()
    } else {
        "calibrated".into()
    };
    let mut text = match worst.is_finite() {
        true => format!(
            "{found}: things are shown where they are to within {typical:.2} px, and {worst:.2} px in the corners of the picture"
        ),
        false => {
            format!("{found} where the boards were; the lens shows nothing in the corners of the picture")
        }
    };
    match bare.len() {
        0 => {}
        4 => text += "; the corners of the picture were not covered: tilt the board there",
        1 => {
            text += &format!("; the {} corner of the picture was not covered: tilt the board there", bare[0])
        }
        _ => {
            let (last, others) = bare.split_last().unwrap_or((&"", &[]));
            let others = others.join(", ");
            text += &format!(
                "; the {others} and {last} corners of the picture were not covered: tilt the board there"
            );
        }
    }
    if coarse {
        text += &format!(
            "; the corners are {usual:.2} px from where the lens shows them, where 0.1 px is usual: the photographs are blurred or much compressed, or the board is not flat"
        );
    }
    if bent {
        text += &format!(
            "; the boards contradict each other {:.1} times more than the noise of their corners: glue the board to something flat",
            calibration.excess.sqrt()
        );
    }
    if !settled {
        text += "; the calibration had not come to rest when it was stopped: photograph more boards, tilted to all sides";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::LensModel;
    use crate::geometry::Lens;

    #[test]
    fn a_calibration_that_has_not_come_to_rest_says_so() {
        let calibration = LensCalibration {
            lens: Lens::pinhole(640, 480, 500.0),
            covariance: [[0.0; 9]; 9],
            model: LensModel::Pinhole,
            rms_px: 0.1,
            excess: 1.0,
            boards: vec![],
            dropped: vec![],
            verdict: String::new(),
        };
        assert!(verdict(&calibration, false).contains("not come to rest"));
        assert!(!verdict(&calibration, true).contains("rest"));
    }
}

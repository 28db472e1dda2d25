//! First values: homographies of the boards, the focal length from them (Zhang 2000, A flexible new technique for camera
//! calibration, equations 3 and 4, with the principal point at the picture's centre), poses from both.

use glam::{DMat3, DVec2, DVec3};
use nalgebra::SMatrix;

use super::adjust::{Estimate, Loss, Sight, adjust, residuals};
use super::project::{BoardPose, LENS};
use crate::geometry::Lens;

/// Focal lengths that are tried where the homographies do not tell one: shares of the picture's longer side.
const USUAL: [f64; 5] = [0.5, 0.8, 1.2, 2.0, 4.0];

/// The homography from a board's plane to the picture (Hartley's normalised direct linear transformation).
pub(super) fn homography(sights: &[Sight]) -> Option<DMat3> {
    let normaliser = |points: &mut dyn Iterator<Item = DVec2>, count: f64| {
        let points: Vec<DVec2> = points.collect();
        let centre = points.iter().sum::<DVec2>() / count;
        let spread = points.iter().map(|p| p.distance(centre)).sum::<f64>() / count;
        let scale = std::f64::consts::SQRT_2 / spread.max(1e-300);
        DMat3::from_cols(
            DVec3::new(scale, 0.0, 0.0),
            DVec3::new(0.0, scale, 0.0),
            DVec3::new(-scale * centre.x, -scale * centre.y, 1.0),
        )
    };
    let count = sights.len() as f64;
    let board = normaliser(&mut sights.iter().map(|s| s.point_m.truncate()), count);
    let picture = normaliser(&mut sights.iter().map(|s| s.pixel), count);
    let mut gram = SMatrix::<f64, 9, 9>::zeros();
    for sight in sights {
        let p = board * sight.point_m.truncate().extend(1.0);
        let q = picture * sight.pixel.extend(1.0);
        for row in [
            [p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, -q.x],
            [0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y, -q.y],
        ] {
            let row = nalgebra::SVector::<f64, 9>::from(row);
            gram += row * row.transpose();
        }
    }
    let eigen = gram.symmetric_eigen();
    let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let normalised = DMat3::from_cols(
        DVec3::new(h[0], h[3], h[6]),
        DVec3::new(h[1], h[4], h[7]),
        DVec3::new(h[2], h[5], h[8]),
    );
    let found = picture.inverse() * normalised * board;
    found.is_finite().then_some(found)
}

/// The pose of a board under a lens without distortion.
pub(super) fn pose(lens: &Lens, homography: &DMat3) -> Option<BoardPose> {
    let plain = |v: DVec3| DVec3::new((v.x - lens.cx * v.z) / lens.fx, (v.y - lens.cy * v.z) / lens.fy, v.z);
    let (a, b, c) = (plain(homography.x_axis), plain(homography.y_axis), plain(homography.z_axis));
    let mut scale = 2.0 / (a.length() + b.length());
    // The board is in front of the camera.
    if c.z < 0.0 {
        scale = -scale;
    }
    let (a, b) = (scale * a, scale * b);
    // The nearest two orthogonal unit vectors: the bisectors are, whatever their lengths.
    let (along, across) = (
        (a.normalize_or_zero() + b.normalize_or_zero()).try_normalize()?,
        (a.normalize_or_zero() - b.normalize_or_zero()).try_normalize()?,
    );
    let (x, y) = (
        (along + across) * std::f64::consts::FRAC_1_SQRT_2,
        (along - across) * std::f64::consts::FRAC_1_SQRT_2,
    );
    let rotation = DMat3::from_cols(x, y, x.cross(y));
    (rotation.is_finite() && c.is_finite()).then_some(BoardPose { rotation, translation_m: scale * c })
}

/// Poses of all boards and a lens to start an adjustment from; `None` where the boards make no sense as boards.
pub(super) fn start(boards: &[Vec<Sight>], width: u32, height: u32) -> Option<Estimate> {
    let homographies: Vec<DMat3> = boards.iter().map(|sights| homography(sights)).collect::<Option<_>>()?;
    let longer = f64::from(width.max(height));
    let told = focal(&homographies, width, height).filter(|focal| (0.2..20.0).contains(&(focal / longer)));
    let usual = USUAL.map(|share| share * longer);
    let tried = told.into_iter().chain(usual);
    let mut best: Option<(f64, Estimate)> = None;
    for (attempt, focal_px) in tried.enumerate() {
        let lens = Lens::pinhole(width, height, focal_px);
        let Some(poses) = homographies.iter().map(|h| pose(&lens, h)).collect::<Option<Vec<_>>>() else {
            continue;
        };
        // Most of the distortion is in k1 and k2; the centre follows when they are known.
        let rough = [true, true, false, false, true, true, false, false, false];
        let free: [bool; LENS] = [true, true, true, true, true, true, false, false, false];
        let Some(found) = adjust(boards, Estimate { lens, poses, settled: false }, rough, Loss::Cauchy(4.0))
            .and_then(|found| adjust(boards, found, free, Loss::Cauchy(2.0)))
        else {
            continue;
        };
        let error = typical(boards, &found);
        if best.as_ref().is_none_or(|(least, _)| error < *least) {
            best = Some((error, found));
        }
        // What the homographies tell is as a rule good; the usual focal lengths are for when it is not.
        if attempt == 0 && told.is_some() && error < 1e-3 * longer {
            break;
        }
    }
    best.map(|(_, estimate)| estimate)
}

/// The median residual, pixels.
fn typical(boards: &[Vec<Sight>], estimate: &Estimate) -> f64 {
    let mut lengths: Vec<f64> = boards
        .iter()
        .zip(&estimate.poses)
        .filter_map(|(sights, pose)| residuals(&estimate.lens, pose, sights))
        .flatten()
        .map(|residual| residual.length())
        .collect();
    lengths.sort_by(f64::total_cmp);
    lengths.get(lengths.len() / 2).copied().unwrap_or(f64::INFINITY)
}

/// The focal length that makes the boards' axes orthogonal and equally long, in least squares over the boards.
fn focal(homographies: &[DMat3], width: u32, height: u32) -> Option<f64> {
    let centre = DVec2::new(f64::from(width) - 1.0, f64::from(height) - 1.0) / 2.0;
    let (mut square, mut product) = (0.0, 0.0);
    for h in homographies {
        let shift = |v: DVec3| (v.truncate() - centre * v.z, v.z);
        let ((a, az), (b, bz)) = (shift(h.x_axis), shift(h.y_axis));
        let size = a.length() * b.length();
        // a·b / f² + az bz = 0 and (a·a - b·b) / f² + az² - bz² = 0.
        for (by, constant) in [(a.dot(b), az * bz), (a.dot(a) - b.dot(b), az * az - bz * bz)] {
            square += (by / size) * (by / size);
            product -= (by / size) * (constant / size);
        }
    }
    let inverse = product / square;
    (inverse > 0.0).then(|| 1.0 / inverse.sqrt())
}

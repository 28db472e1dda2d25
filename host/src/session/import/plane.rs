//! The plane on which most of a model's points lie becomes the surface.

use glam::{DMat3, DQuat, DVec3};

use crate::geometry::Surface;

/// From a camera towards a point.
pub(super) struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
}

/// The surface found in a model.
pub(super) struct Frame {
    /// Turns a vector of the surface frame into the model's world.
    pub world_from_surface: DQuat,
    /// The centre of the sampled area, in the model's world.
    pub origin: DVec3,
    /// What the points on the plane cover.
    pub surface: Surface,
    /// How many points there are.
    pub points: usize,
    /// How many of them lie on the plane.
    pub on_plane: usize,
}

/// A point is on the plane within this part of the median distance from the cameras.
const TOLERANCE: f64 = 0.005;

/// Triangulates the tracks (rays to one point each), finds their dominant plane, turns it towards the cameras, and lays x along
/// their mean `rights`. `None` when fewer than 10 points lie on one plane.
pub(super) fn find(tracks: &[Vec<Ray>], centres: &[DVec3], rights: &[DVec3]) -> Option<Frame> {
    let points: Vec<DVec3> =
        tracks.iter().filter(|rays| rays.len() >= 3).filter_map(|rays| triangulate(rays)).collect();
    if points.len() < 10 {
        return None;
    }
    let eye = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let tolerance = TOLERANCE * median(points.iter().map(|point| point.distance(eye)).collect());
    let (mut base, mut normal) = dominant_plane(&points, tolerance)?;
    let mut inliers = vec![];
    for _ in 0..5 {
        inliers =
            points.iter().copied().filter(|&point| ((point - base).dot(normal)).abs() < tolerance).collect();
        base = inliers.iter().sum::<DVec3>() / inliers.len() as f64;
        normal = smallest_axis(&inliers, base)?;
    }
    if inliers.len() < 10 {
        return None;
    }
    let z = normal * (eye - base).dot(normal).signum();
    let right = rights.iter().sum::<DVec3>();
    let x = (right - z * right.dot(z)).try_normalize()?;
    let y = z.cross(x);
    let (left, width) = extent(inliers.iter().map(|&point| (point - base).dot(x)).collect());
    let (bottom, height) = extent(inliers.iter().map(|&point| (point - base).dot(y)).collect());
    Some(Frame {
        world_from_surface: DQuat::from_mat3(&DMat3::from_cols(x, y, z)),
        origin: base + x * (left + width / 2.0) + y * (bottom + height / 2.0),
        surface: Surface { width_m: width, height_m: height },
        points: points.len(),
        on_plane: inliers.len(),
    })
}

/// The point nearest to all rays in the least-squares sense.
fn triangulate(rays: &[Ray]) -> Option<DVec3> {
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for ray in rays {
        let d = ray.direction;
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        matrix += across;
        right += across * ray.origin;
    }
    // Rays that are nearly parallel say nothing of the distance.
    (matrix.determinant() > 1e-6 * (rays.len() as f64).powi(3)).then(|| matrix.inverse() * right)
}

/// RANSAC (Fischler and Bolles 1981) with fixed draws, so that an import can be repeated.
fn dominant_plane(points: &[DVec3], tolerance: f64) -> Option<(DVec3, DVec3)> {
    let mut state = 1u64;
    let mut draw = || {
        // Knuth's MMIX linear congruential generator; its high bits are good enough to pick points.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        points[((state >> 33) % points.len() as u64) as usize]
    };
    let mut best: Option<(usize, DVec3, DVec3)> = None;
    for _ in 0..1000 {
        let (a, b, c) = (draw(), draw(), draw());
        let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
        let count = points.iter().filter(|&&point| (point - a).dot(normal).abs() < tolerance).count();
        if best.is_none_or(|(most, ..)| count > most) {
            best = Some((count, a, normal));
        }
    }
    best.map(|(_, base, normal)| (base, normal))
}

/// The direction in which the points scatter least.
fn smallest_axis(points: &[DVec3], centre: DVec3) -> Option<DVec3> {
    let mut scatter = nalgebra::Matrix3::<f64>::zeros();
    for &point in points {
        let d = nalgebra::Vector3::from((point - centre).to_array());
        scatter += d * d.transpose();
    }
    let eigen = nalgebra::SymmetricEigen::new(scatter);
    let axis = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    DVec3::new(axis[0], axis[1], axis[2]).try_normalize()
}

/// Start and length of the middle 96 % of the values: a few stray points do not enlarge the surface.
fn extent(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| values[(part * (values.len() - 1) as f64).round() as usize];
    (at(0.02), at(0.98) - at(0.02))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plane_of_most_points_is_found_among_others() {
        let (x, y) = (DVec3::new(0.6, 0.8, 0.0), DVec3::new(0.0, 0.0, 1.0));
        let z = x.cross(y);
        let centres: Vec<DVec3> =
            (0..4).map(|k| z * 10.0 + x * f64::from(k) - y * f64::from(k * k) * 0.3).collect();
        let mut tracks = vec![];
        for i in 0..400 {
            let (u, v) = (f64::from(i % 20) / 10.0 - 1.0, f64::from(i / 20) / 10.0 - 1.0);
            let above = if i % 3 == 0 { 1.0 + u * v } else { 0.0 };
            let point = x * u + y * v + z * above;
            tracks.push(
                centres.iter().map(|&c| Ray { origin: c, direction: (point - c).normalize() }).collect(),
            );
        }
        let frame = find(&tracks, &centres, &[x; 4]).unwrap();
        assert!((frame.world_from_surface * DVec3::Z).dot(z) > 0.999_999);
        assert!((frame.world_from_surface * DVec3::X).dot(x) > 0.999_999);
        assert!(frame.origin.dot(z).abs() < 1e-6 && frame.on_plane >= 266);
        assert!((frame.surface.width_m - 1.9).abs() < 0.15);
    }
}

//! Moving the camera about the surface's middle. Whatever else its pose is (roll, where it looks) turns with it.

use glam::{DQuat, DVec3};
use rigel::geometry::{Lens, Pose, azimuth_zenith};
use winit::dpi::PhysicalSize;

/// The flattest view.
const MOST_ZENITH_RAD: f64 = 1.55;

/// The camera carried around the surface's normal, and towards or from it.
pub(super) fn turned(pose: &Pose, azimuth_rad: f64, zenith_rad: f64) -> Pose {
    let (_, before) = azimuth_zenith(pose.centre_m);
    let after = (before + zenith_rad).clamp(0.0, MOST_ZENITH_RAD.max(before));
    // From straight above it leaves towards the lower edge of the picture.
    let level = DVec3::new(pose.centre_m.x, pose.centre_m.y, 0.0);
    let level = if level.length() > 1e-9 * pose.centre_m.length() {
        level
    } else {
        pose.direction_to_surface(DVec3::Y).with_z(0.0)
    };
    let lean = level
        .try_normalize()
        .map_or(DQuat::IDENTITY, |level| DQuat::from_axis_angle(DVec3::Z.cross(level), after - before));
    let turn = DQuat::from_rotation_z(azimuth_rad) * lean;
    Pose {
        camera_from_surface: (pose.camera_from_surface * turn.inverse()).normalize(),
        centre_m: turn * pose.centre_m,
    }
}

/// The camera nearer or farther, no farther than `bounds_m` allow.
pub(super) fn moved(pose: &Pose, factor: f64, bounds_m: (f64, f64)) -> Pose {
    let distance_m = pose.centre_m.length();
    let wanted_m = (distance_m * factor).clamp(bounds_m.0, bounds_m.1);
    Pose { centre_m: pose.centre_m * (wanted_m / distance_m), ..*pose }
}

/// The same lens for a window of any size: as much is seen along the window's shorter side.
pub(super) fn fitting(lens: &Lens, size: PhysicalSize<u32>) -> Lens {
    let (width, height) = (size.width.max(1), size.height.max(1));
    let by = f64::from(width.min(height)) / f64::from(lens.width.min(lens.height).max(1));
    let centre =
        |c: f64, of: u32, size: u32| (f64::from(size) - 1.0) / 2.0 + by * (c - (f64::from(of) - 1.0) / 2.0);
    Lens {
        width,
        height,
        fx: lens.fx * by,
        fy: lens.fy * by,
        cx: centre(lens.cx, lens.width, width),
        cy: centre(lens.cy, lens.height, height),
        ..*lens
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigel::geometry::unit_vector;

    fn apart(a: &Pose, b: &Pose) -> f64 {
        a.camera_from_surface.angle_between(b.camera_from_surface) + (a.centre_m - b.centre_m).length()
    }

    /// It neither looks at the middle nor has y up.
    fn crooked() -> Pose {
        let pose = Pose::from_axes(unit_vector(1.0, 0.6), DVec3::new(-0.3, -0.5, -0.9), DVec3::Y);
        let roll = DQuat::from_rotation_z(0.3);
        Pose { camera_from_surface: roll * pose.camera_from_surface, ..pose }
    }

    #[test]
    fn there_and_back_is_the_same_whole_pose() {
        for pose in [crooked(), Pose::from_rig(0.4, 0.7, 0.8)] {
            assert!(apart(&turned(&pose, 0.0, 0.0), &pose) < 1e-6);
            let there = turned(&turned(&pose, 0.7, 0.0), 0.0, 0.2);
            let back = turned(&turned(&there, 0.0, -0.2), -0.7, 0.0);
            assert!(apart(&there, &pose) > 0.1 && apart(&back, &pose) < 1e-6);
            // Where the middle of the surface appears does not change.
            let seen = |pose: &Pose| pose.to_camera(DVec3::ZERO);
            assert!((seen(&there) - seen(&pose)).length() < 1e-6);
            let nearer = moved(&pose, 0.5, (0.01, 10.0));
            assert!(apart(&moved(&nearer, 2.0, (0.01, 10.0)), &pose) < 1e-6);
        }
    }

    #[test]
    fn from_straight_above_the_lower_edge_comes_nearer() {
        let above = Pose::from_rig(0.5, 0.0, 1.0);
        let leaning = turned(&above, 0.0, 0.4);
        assert!((azimuth_zenith(leaning.centre_m).1 - 0.4).abs() < 1e-6);
        // What was below in the picture is nearer now than what was above.
        let below = above.direction_to_surface(DVec3::Y) * 0.1;
        assert!(leaning.to_camera(below).z < leaning.to_camera(-below).z);
        assert!((leaning.to_camera(DVec3::ZERO) - DVec3::Z).length() < 1e-6);
    }

    #[test]
    fn the_horizon_and_the_bounds_hold() {
        let pose = Pose::from_rig(0.4, 0.7, 0.8);
        assert!(turned(&pose, 0.0, 3.0).centre_m.z > 0.0);
        assert!(turned(&pose, 0.0, -3.0).centre_m.truncate().length() < 1e-6);
        assert!((moved(&pose, 1e9, (0.1, 5.0)).centre_m.length() - 5.0).abs() < 1e-6);
        assert!((moved(&pose, 0.0, (0.1, 5.0)).centre_m.length() - 0.1).abs() < 1e-6);
    }

    #[test]
    fn a_lens_keeps_its_axis_and_bending_in_another_window() {
        let lens = Lens { cx: 330.0, cy: 200.0, k1: -0.2, ..Lens::pinhole(640, 480, 700.0) };
        let same = fitting(&lens, PhysicalSize::new(640, 480));
        assert_eq!(same, lens);
        let wide = fitting(&lens, PhysicalSize::new(1600, 960));
        assert_eq!((wide.fx, wide.k1), (1400.0, -0.2));
        assert!((wide.cy - (2.0 * 200.5 - 0.5)).abs() < 1e-9, "{}", wide.cy);
    }
}

//! What a pan/tilt rig really is: two axes that are not quite where the drawing has them, and a camera that is not either.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::geometry::Pose;

/// What all views of a rig have in common. A point of the surface is turned by its mounting, about the pan axis, about the
/// tilt axis, and seen by the camera at `distance_m`:
///
/// `camera = flip · Rc · (Rx(tilt) · Ry(axis_angle) · Rz(pan) · (Rs · surface + surface_shift) + axis_distance along y, tilted) + camera_shift`
///
/// Everything but the distance is 0 for the nominal rig of [`Pose::from_rig`]. Turns are vectors (axis times angle). These
/// 14 are all that the poses of two axes show: what a turn about or a shift along an axis would add is in the others.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RigModel {
    /// The nominal distance from the rig's centre to the camera, metres.
    pub distance_m: f64,
    /// Turn of the camera against the tilt axis; x is also the zero of the tilt.
    pub camera_turn_rad: [f64; 3],
    /// By how much the axes are not at right angles.
    pub axis_angle_rad: f64,
    /// Turn of the surface against the pan axis; z is also the zero of the pan.
    pub surface_turn_rad: [f64; 3],
    /// Shift of the picture's content in the camera frame.
    pub camera_shift_m: [f64; 3],
    /// By how much the axes miss each other.
    pub axis_distance_m: f64,
    /// Shift of the surface's origin against the pan axis; z is its height over the tilt axis.
    pub surface_shift_m: [f64; 3],
}

/// How many numbers a rig model has beside the distance.
pub(super) const RIG: usize = 14;
/// How many ways a view has to deviate from the rig model.
pub(super) const DEVIATIONS: usize = 6;

/// How a view deviates from where its commanded angles put it: pan, tilt and about the third axis at right angles to both
/// (radians); shift of the picture's content along the camera's x, y and z (metres).
pub(super) type Deviation = [f64; DEVIATIONS];

impl RigModel {
    /// The rig as drawn.
    pub fn nominal(distance_m: f64) -> Self {
        Self { distance_m, ..Self::default() }
    }

    pub(super) fn from_numbers(distance_m: f64, n: &[f64]) -> Self {
        Self {
            distance_m,
            camera_turn_rad: [n[0], n[1], n[2]],
            axis_angle_rad: n[3],
            surface_turn_rad: [n[4], n[5], n[6]],
            camera_shift_m: [n[7], n[8], n[9]],
            axis_distance_m: n[10],
            surface_shift_m: [n[11], n[12], n[13]],
        }
    }

    /// Where the model puts the camera at these commanded angles.
    pub fn pose(&self, pan_rad: f64, tilt_rad: f64) -> Pose {
        let seen = self.see(pan_rad, tilt_rad, &[0.0; DEVIATIONS]);
        seen.pose()
    }

    pub(super) fn see(&self, pan_rad: f64, tilt_rad: f64, deviation: &Deviation) -> Seen {
        let [pan, tilt, third, x, y, z] = *deviation;
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let camera = flip * turn(self.camera_turn_rad);
        let tilting = DMat3::from_rotation_x(tilt_rad + tilt);
        let panning = DMat3::from_rotation_z(pan_rad + pan);
        let stage = tilting * DMat3::from_rotation_y(third + self.axis_angle_rad) * panning;
        let moved = stage * DVec3::from_array(self.surface_shift_m)
            + tilting * DVec3::new(0.0, self.axis_distance_m, 0.0);
        Seen {
            rotation: camera * stage * turn(self.surface_turn_rad),
            origin_m: camera * moved
                + DVec3::from_array(self.camera_shift_m)
                + DVec3::new(x, y, z + self.distance_m),
        }
    }
}

/// A pose as a camera sees it: its turn and where the surface's origin is in the camera frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub rotation: DMat3,
    pub origin_m: DVec3,
}

impl Seen {
    #[cfg(test)]
    pub fn of(pose: &Pose) -> Self {
        let rotation = DMat3::from_quat(pose.camera_from_surface);
        Self { rotation, origin_m: -(rotation * pose.centre_m) }
    }

    pub fn pose(&self) -> Pose {
        Pose {
            camera_from_surface: glam::DQuat::from_mat3(&self.rotation).normalize(),
            centre_m: -(self.rotation.transpose() * self.origin_m),
        }
    }

    pub fn to_camera(self, point_m: DVec3) -> DVec3 {
        self.rotation * point_m + self.origin_m
    }

    /// What leads from `self` to `other`, in the order of [`crate::geometry::PoseCovariance`]: small rotation of the camera, shift of
    /// its centre.
    pub fn difference(&self, other: &Self) -> [f64; 6] {
        let turn = other.rotation * self.rotation.transpose();
        let axis = DVec3::new(
            turn.y_axis.z - turn.z_axis.y,
            turn.z_axis.x - turn.x_axis.z,
            turn.x_axis.y - turn.y_axis.x,
        ) / 2.0;
        let shift = other.pose().centre_m - self.pose().centre_m;
        [axis.x, axis.y, axis.z, shift.x, shift.y, shift.z]
    }

    /// The pose after a difference.
    #[cfg(test)]
    pub fn after(&self, difference: &[f64; 6]) -> Self {
        let [a, b, c, x, y, z] = *difference;
        let rotation = turn([a, b, c]) * self.rotation;
        let centre_m = self.pose().centre_m + DVec3::new(x, y, z);
        Self { rotation, origin_m: -(rotation * centre_m) }
    }
}

fn turn(vector: [f64; 3]) -> DMat3 {
    DMat3::from_quat(glam::DQuat::from_scaled_axis(DVec3::from_array(vector)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nominal_model_is_the_nominal_rig() {
        for (pan, tilt) in [(0.0, 0.0), (1.0, 0.7), (-2.0, 1.2)] {
            let (a, b) = (RigModel::nominal(0.9).pose(pan, tilt), Pose::from_rig(pan, tilt, 0.9));
            assert!((a.centre_m - b.centre_m).length() < 1e-12);
            assert!(a.camera_from_surface.angle_between(b.camera_from_surface) < 1e-7);
        }
    }

    #[test]
    fn a_difference_leads_there() {
        let numbers: Vec<f64> = (0..RIG).map(|i| 0.001 * (i as f64 - 5.0)).collect();
        let rig = RigModel::from_numbers(0.9, &numbers);
        let a = rig.see(0.5, 0.8, &[0.0; 6]);
        let b = rig.see(0.5, 0.8, &[1e-4, -2e-4, 3e-4, 1e-4, 2e-4, -1e-4]);
        let there = a.after(&a.difference(&b));
        let point = DVec3::new(0.1, -0.05, 0.0);
        assert!((there.to_camera(point) - b.to_camera(point)).length() < 1e-9);
        assert!((b.pose().to_camera(point) - b.to_camera(point)).length() < 1e-12);
        assert!((Seen::of(&b.pose()).to_camera(point) - b.to_camera(point)).length() < 1e-12);
    }

    #[test]
    fn every_number_of_the_model_changes_the_poses_in_its_own_way() {
        // Derivatives of the corners' places over some views: no combination of the numbers leaves them all.
        let views = [(0.1, 0.1), (1.3, 0.5), (2.9, 0.9), (4.0, 1.2), (5.2, 0.3), (0.7, 1.1)];
        let points = [(0.1, 0.08), (-0.1, 0.08), (0.1, -0.08)].map(|(x, y)| DVec3::new(x, y, 0.0));
        let place = |n: &[f64; RIG]| -> Vec<f64> {
            let rig = RigModel::from_numbers(0.9, n);
            let see = |&(pan, tilt): &(f64, f64)| {
                let seen = rig.see(pan, tilt, &[0.0; 6]);
                points.map(|p| seen.to_camera(p).to_array())
            };
            views.iter().flat_map(see).flatten().collect()
        };
        let mut columns = nalgebra::DMatrix::zeros(views.len() * 9, RIG);
        for i in 0..RIG {
            let (mut up, mut down) = ([0.0; RIG], [0.0; RIG]);
            (up[i], down[i]) = (1e-5, -1e-5);
            let (up, down) = (place(&up), place(&down));
            for row in 0..up.len() {
                columns[(row, i)] = (up[row] - down[row]) / 2e-5;
            }
        }
        let values = columns.singular_values();
        assert!(values.min() > 1e-3 * values.max(), "{values}");
    }
}

//! A plane through the surface's normal, in which radiance is drawn against direction.

use glam::DVec3;

/// Views within so many degrees of the plane count as in it.
const NEAR_DEG: f64 = 10.0;

/// A plane through the surface's normal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cut {
    along: DVec3,
    across: DVec3,
}

impl Cut {
    /// The one that a direction (surface frame) lies in.
    pub fn through(direction: DVec3) -> Self {
        let along = DVec3::new(direction.x, direction.y, 0.0).try_normalize().unwrap_or(DVec3::X);
        Self { along, across: DVec3::Z.cross(along) }
    }

    /// The unit vector so far from the normal, towards the side of [`Self::through`]'s direction.
    pub fn direction(&self, from_normal_deg: f64) -> DVec3 {
        let (sine, cosine) = from_normal_deg.to_radians().sin_cos();
        self.along * sine + DVec3::Z * cosine
    }

    /// How far from the normal a unit vector appears in the plane, degrees; `None` for one that is not within 10 degrees of it.
    pub fn from_normal_deg(&self, direction: DVec3) -> Option<f64> {
        let is_near = direction.dot(self.across).abs() < NEAR_DEG.to_radians().sin();
        is_near.then(|| direction.dot(self.along).atan2(direction.z).to_degrees())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::unit_vector;

    #[test]
    fn directions_of_the_plane_come_back_and_others_are_beside_it() {
        let cut = Cut::through(unit_vector(2.0, 0.6));
        assert!((cut.from_normal_deg(unit_vector(2.0, 0.6)).unwrap() - 0.6f64.to_degrees()).abs() < 1e-9);
        for degrees in [-80.0, -10.0, 0.0, 45.0] {
            assert!((cut.from_normal_deg(cut.direction(degrees)).unwrap() - degrees).abs() < 1e-9);
        }
        assert_eq!(cut.from_normal_deg(unit_vector(2.0 + std::f64::consts::FRAC_PI_2, 0.6)), None);
        // Every plane holds the normal.
        assert_eq!(cut.from_normal_deg(DVec3::Z), Some(0.0));
        assert_eq!(Cut::through(DVec3::Z).from_normal_deg(DVec3::Z), Some(0.0));
    }
}

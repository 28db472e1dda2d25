//! The tracker: where a receiver is and how it is turned, in the world's frame, and how well that is known.
//!
//! World: y up, right-handed; what looks straight ahead looks along -z. The tracker's own axes are the transmitter's: X
//! forward, Y right, Z down. So world x is tracker Y, world y is tracker -Z, world z is tracker -X; that map is itself a
//! rotation, so that nothing is mirrored. A receiver whose axes lie along the transmitter's is not turned at all: the
//! identity looks along -z with y up.

use std::f64::consts::PI;
use std::time::SystemTime;

use glam::{DQuat, DVec3};
use rigel_protocol::{Orientation, Record};

mod causal;
mod records;
mod smooth;
mod tail;
mod track;
mod watch;

pub use causal::Causal;
pub use smooth::rotation_vector;
pub use tail::Tail;
pub use track::{Jump, Track, Turned};
pub use watch::{StationSummary, Summary, Watch};

/// A tracker's record with the host's time, in the world's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackerRecord {
    /// When its first byte came, by the host's clock.
    pub at: SystemTime,
    /// By how much `at` can be wrong at most, seconds.
    pub bound_s: f64,
    /// Counts the records since the tracker was started: a gap was lost on the way.
    pub count: u32,
    /// The receiver: 1 or 2.
    pub station: u8,
    /// The tracker's status character.
    pub status: u8,
    /// Where the receiver is from the transmitter, world axes, metres.
    pub position_m: DVec3,
    /// How the receiver is turned: takes its own axes (x right, y up, looking along -z) to the world's.
    pub orientation: DQuat,
}

impl TrackerRecord {
    /// What the tracker said, at the host's time `at` (wrong by at most `bound_s` seconds); `None` if its quaternion is
    /// zero, which no rig forwards.
    pub fn new(at: SystemTime, bound_s: f64, record: &Record) -> Option<Self> {
        let position = DVec3::from_array(record.position_um.map(|um| f64::from(um) / 1e6));
        Some(Self {
            at,
            bound_s,
            count: record.count,
            station: record.station,
            status: record.status,
            position_m: to_world(position),
            orientation: orientation(&record.orientation)?,
        })
    }
}

/// The unit quaternion, in the world's frame, of an orientation as the tracker says it; `None` for the quaternion zero.
///
/// Azimuth, elevation and roll are turns about Z, then the new Y, then the new X: R = Rz(azimuth) Ry(elevation) Rx(roll)
/// in the tracker's axes. Nothing else reads these angles.
pub fn orientation(said: &Orientation) -> Option<DQuat> {
    let q = match said {
        Orientation::Quaternion(millionths) => {
            let [w, x, y, z] = millionths.map(f64::from);
            DQuat::from_xyzw(x, y, z, w)
        }
        Orientation::Euler(angles_mdeg) => {
            let [azimuth, elevation, roll] = angles_mdeg.map(|mdeg| f64::from(mdeg) * PI / 180e3);
            DQuat::from_rotation_z(azimuth) * DQuat::from_rotation_y(elevation) * DQuat::from_rotation_x(roll)
        }
    };
    let axis = to_world(DVec3::new(q.x, q.y, q.z));
    (q.length_squared() > 0.0).then(|| DQuat::from_xyzw(axis.x, axis.y, axis.z, q.w).normalize())
}

/// A vector in the tracker's axes, said in the world's.
fn to_world(tracker: DVec3) -> DVec3 {
    DVec3::new(tracker.y, -tracker.z, -tracker.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    /// Azimuth, elevation, roll in steps that meet ±180, ±90 and 0, the poles included.
    fn all_angles() -> impl Iterator<Item = [i32; 3]> {
        let full = || (-12..=12).map(|i| i * 15_000);
        let odd = |mdeg: i32| [mdeg, mdeg - mdeg.signum() * 1_234];
        full().flat_map(odd).flat_map(move |azimuth| {
            (-6..=6)
                .map(|i| i * 15_000)
                .flat_map(odd)
                .flat_map(move |elevation| full().map(move |roll| [azimuth, elevation, roll]))
        })
    }

    /// The documented matrix, written out, columns the receiver's axes in the transmitter's frame.
    fn documented(angles_mdeg: [i32; 3]) -> DMat3 {
        let [(sa, ca), (se, ce), (sr, cr)] =
            angles_mdeg.map(|mdeg| (f64::from(mdeg) / 1e3).to_radians().sin_cos());
        DMat3::from_cols(
            DVec3::new(ca * ce, sa * ce, -se),
            DVec3::new(ca * se * sr - sa * cr, sa * se * sr + ca * cr, ce * sr),
            DVec3::new(ca * se * cr + sa * sr, sa * se * cr - ca * sr, ce * cr),
        )
    }

    #[test]
    fn every_angle_agrees_with_the_documented_convention() {
        for angles in all_angles() {
            let q = orientation(&Orientation::Euler(angles)).unwrap();
            assert!((q.length() - 1.0).abs() < 1e-12);
            let matrix = documented(angles);
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let difference = q * to_world(axis) - to_world(matrix * axis);
                assert!(difference.length() < 1e-6, "{angles:?}: {difference}");
            }
        }
    }

    #[test]
    fn the_quaternion_of_the_same_pose_is_the_same_orientation() {
        for angles in all_angles() {
            // The quaternion of the documented matrix, found without the turns about the axes.
            let q = DQuat::from_mat3(&documented(angles)).normalize();
            let said = [q.w, q.x, q.y, q.z].map(|c| (c * 1e6).round() as i32);
            let from_quaternion = orientation(&Orientation::Quaternion(said)).unwrap();
            let from_euler = orientation(&Orientation::Euler(angles)).unwrap();
            let minus = orientation(&Orientation::Quaternion(said.map(|c| -c))).unwrap();
            // Rounding to millionths is half a millionth in each component.
            assert!(1.0 - from_quaternion.dot(from_euler).abs() < 1e-12, "{angles:?}");
            assert!((from_quaternion * DVec3::X - from_euler * DVec3::X).length() < 2e-6);
            assert!((from_quaternion * DVec3::X - minus * DVec3::X).length() < 1e-12);
        }
    }

    #[test]
    fn at_the_poles_azimuth_and_roll_are_one_turn() {
        for turn in (-180..=180).map(|i| 1_000 * i) {
            for roll in [-90_000, 0, 30_000] {
                let up = orientation(&Orientation::Euler([turn, 90_000, roll])).unwrap();
                let same = orientation(&Orientation::Euler([0, 90_000, roll - turn])).unwrap();
                assert!(up.dot(same).abs() > 1.0 - 1e-12, "{turn} {roll}");
                let down = orientation(&Orientation::Euler([turn, -90_000, roll])).unwrap();
                let same = orientation(&Orientation::Euler([0, -90_000, roll + turn])).unwrap();
                assert!(down.dot(same).abs() > 1.0 - 1e-12, "{turn} {roll}");
            }
        }
    }

    #[test]
    fn turns_go_the_way_that_people_expect() {
        let ahead = |angles| orientation(&Orientation::Euler(angles)).unwrap() * DVec3::NEG_Z;
        assert!((ahead([0, 0, 0]) - DVec3::NEG_Z).length() < 1e-12);
        // Azimuth turns to the right, elevation up; roll leaves the view and drops the right-hand side.
        assert!((ahead([90_000, 0, 0]) - DVec3::X).length() < 1e-12);
        assert!((ahead([0, 90_000, 0]) - DVec3::Y).length() < 1e-12);
        assert!((ahead([0, 0, 90_000]) - DVec3::NEG_Z).length() < 1e-12);
        let rolled = orientation(&Orientation::Euler([0, 0, 90_000])).unwrap();
        assert!((rolled * DVec3::X - DVec3::NEG_Y).length() < 1e-12);
    }

    #[test]
    fn a_record_is_said_in_metres_and_world_axes() {
        let mut record = Record {
            count: 3,
            at_us: 0,
            station: 2,
            status: b'@',
            position_um: [1_000_000, 200_000, -30_000],
            orientation: Orientation::Quaternion([1_000_000, 0, 0, 0]),
        };
        let read = TrackerRecord::new(SystemTime::UNIX_EPOCH, 0.001, &record).unwrap();
        assert!((read.position_m - DVec3::new(0.2, 0.03, -1.0)).length() < 1e-12);
        assert_eq!((read.orientation, read.station, read.count), (DQuat::IDENTITY, 2, 3));
        record.orientation = Orientation::Quaternion([0; 4]);
        assert_eq!(TrackerRecord::new(SystemTime::UNIX_EPOCH, 0.001, &record), None);
    }
}

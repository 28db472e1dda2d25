//! The vocabulary of space: lens, pose, surface, directions.
//!
//! Surface frame: right-handed, origin at the centre of the sampled area, x right, y up, z out of the surface, metres.
//! Camera frame: x right, y down, z forward; integer pixel coordinates are pixel centres.
//! `azimuth` is measured from +x towards +y, `zenith` from +z, both in radians.
//!
//! World of environments: right-handed, y up; a camera that is not turned looks along -z with y up (glTF), so that its camera
//! frame is the world turned by half a turn about x ([`world_from_camera`]).
//! Latitude-longitude maps ([`LatLong`]) have the axes of OpenEXR's `latlong`: latitude 90 degrees (+y) at the top, longitude
//! +180 degrees at the left edge, falling to the right; latitude 0 is +z at longitude 0 (the map's centre) and +x at longitude
//! 90 degrees, so that what is right of something in the room is right of it in the map. A pixel is an area, and its centre lies half
//! a pixel from its borders, as in all other maps of this program and in the maps that other programs share; OpenEXR's
//! own library puts the centres of the outermost pixels on the poles and on the seam, at most half a pixel away.

use std::f64::consts::PI;

use glam::{DMat3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// A camera's lens and picture size: pinhole and Brown-Conrady distortion, in OpenCV's order (k1 k2 p1 p2 k3).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Picture width, pixels.
    pub width: u32,
    /// Picture height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point, x; a pixel's centre is an integer.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
    /// Radial distortion, r².
    #[serde(default)]
    pub k1: f64,
    /// Radial distortion, r⁴.
    #[serde(default)]
    pub k2: f64,
    /// Tangential distortion.
    #[serde(default)]
    pub p1: f64,
    /// Tangential distortion.
    #[serde(default)]
    pub p2: f64,
    /// Radial distortion, r⁶.
    #[serde(default)]
    pub k3: f64,
}

impl Lens {
    /// A lens without distortion, its axis through the centre of the picture.
    pub fn pinhole(width: u32, height: u32, focal_px: f64) -> Self {
        let (cx, cy) = ((f64::from(width) - 1.0) / 2.0, (f64::from(height) - 1.0) / 2.0);
        Self {
            width,
            height,
            fx: focal_px,
            fy: focal_px,
            cx,
            cy,
            k1: 0.0,
            k2: 0.0,
            p1: 0.0,
            p2: 0.0,
            k3: 0.0,
        }
    }

    /// Where a point of the camera frame appears, in pixels of the distorted photograph; `None` behind the camera or
    /// so far out that the distortion polynomial has turned back on itself. The pixel may lie outside the picture.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        if point.z <= 0.0 {
            return None;
        }
        let u = point.truncate() / point.z;
        let r2 = u.length_squared();
        // The radial map r -> r (1 + k1 r² + ...) is one-to-one only while it grows.
        let growth = 1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + r2 * 7.0 * self.k3));
        if growth <= 0.0 {
            return None;
        }
        let d = self.distort(u);
        Some(DVec2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy))
    }

    /// The unit direction, in the camera frame, of what appears at `pixel`; `None` where no direction projects there.
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        let target = DVec2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        let mut u = target;
        // Newton with a numerical Jacobian: converges in three or four steps even for strong distortion.
        for _ in 0..30 {
            let error = self.distort(u) - target;
            if error.length_squared() < 1e-26 {
                break;
            }
            let h = 1e-6;
            let dx =
                (self.distort(u + DVec2::new(h, 0.0)) - self.distort(u - DVec2::new(h, 0.0))) / (2.0 * h);
            let dy =
                (self.distort(u + DVec2::new(0.0, h)) - self.distort(u - DVec2::new(0.0, h))) / (2.0 * h);
            let determinant = dx.x * dy.y - dy.x * dx.y;
            if determinant.abs() < 1e-12 {
                return None;
            }
            u -= DVec2::new(dy.y * error.x - dy.x * error.y, dx.x * error.y - dx.y * error.x) / determinant;
        }
        let direction = DVec3::new(u.x, u.y, 1.0);
        let back = self.project(direction)?;
        (back.distance(pixel) < 1e-6 * self.fx).then(|| direction.normalize())
    }

    /// Its numbers, in the order fx fy cx cy k1 k2 p1 p2 k3.
    pub fn numbers(&self) -> [f64; 9] {
        [self.fx, self.fy, self.cx, self.cy, self.k1, self.k2, self.p1, self.p2, self.k3]
    }

    /// A lens with these numbers, for pictures of the same size.
    pub fn with_numbers(&self, numbers: [f64; 9]) -> Self {
        let [fx, fy, cx, cy, k1, k2, p1, p2, k3] = numbers;
        Self { width: self.width, height: self.height, fx, fy, cx, cy, k1, k2, p1, p2, k3 }
    }

    /// The same lens for a photograph of another size, each axis scaled by itself.
    pub fn scaled_to(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            // Pixel centres are integers, so the picture's edge is at -1/2.
            cx: (self.cx + 0.5) * sx - 0.5,
            cy: (self.cy + 0.5) * sy - 0.5,
            ..*self
        }
    }

    /// The covariance of its numbers for a photograph of another size, see [`Self::scaled_to`].
    pub fn scaled_covariance(&self, covariance: &LensCovariance, width: u32, height: u32) -> LensCovariance {
        let (sx, sy) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        let by = [sx, sy, sx, sy, 1.0, 1.0, 1.0, 1.0, 1.0];
        std::array::from_fn(|i| std::array::from_fn(|j| by[i] * covariance[i][j] * by[j]))
    }

    fn distort(&self, u: DVec2) -> DVec2 {
        let r2 = u.length_squared();
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let tangential = DVec2::new(
            2.0 * self.p1 * u.x * u.y + self.p2 * (r2 + 2.0 * u.x * u.x),
            self.p1 * (r2 + 2.0 * u.y * u.y) + 2.0 * self.p2 * u.x * u.y,
        );
        u * radial + tangential
    }
}

/// Where a camera stands and how it is turned, in the surface's frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Turns a vector of the surface frame into the camera frame (x y z w in files).
    pub camera_from_surface: DQuat,
    /// The camera's optical centre in the surface frame, metres.
    pub centre_m: DVec3,
}

/// How sure a pose is: covariance of a small rotation `d` of the camera (radians, camera frame: R' = exp(d) R) and, after
/// it, of a shift of its optical centre (metres, surface frame).
pub type PoseCovariance = [[f64; 6]; 6];

impl Pose {
    /// The nominal pose of the pan/tilt rig: the camera stays on +z at `distance_m`, the surface turns by `pan_rad`
    /// about its z and then by `tilt_rad` about x.
    pub fn from_rig(pan_rad: f64, tilt_rad: f64, distance_m: f64) -> Self {
        let turned = DMat3::from_rotation_x(tilt_rad) * DMat3::from_rotation_z(pan_rad);
        let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        Self {
            camera_from_surface: DQuat::from_mat3(&(facing * turned)),
            centre_m: turned.transpose() * DVec3::new(0.0, 0.0, distance_m),
        }
    }

    /// The pose of a camera at `centre_m` with the given viewing and up directions (surface frame).
    pub fn from_axes(centre_m: DVec3, forward: DVec3, up: DVec3) -> Self {
        let right = forward.cross(up).normalize();
        let down = forward.cross(right).normalize();
        let surface_from_camera = DMat3::from_cols(right, down, forward.normalize());
        Self { camera_from_surface: DQuat::from_mat3(&surface_from_camera.transpose()), centre_m }
    }

    /// A point of the surface frame in the camera frame, metres.
    pub fn to_camera(&self, point_m: DVec3) -> DVec3 {
        self.camera_from_surface * (point_m - self.centre_m)
    }

    /// A direction of the camera frame in the surface frame.
    pub fn direction_to_surface(&self, direction: DVec3) -> DVec3 {
        self.camera_from_surface.inverse() * direction
    }
}

/// The sampled area: a rectangle in the plane z = 0 of the surface frame, centred on the origin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Surface {
    /// Extent along x, metres.
    pub width_m: f64,
    /// Extent along y, metres.
    pub height_m: f64,
}

impl Surface {
    /// The centre of texel (`column`, `row`); (0, 0) is the top-left one.
    pub fn texel_centre(&self, texels: Texels, column: u32, row: u32) -> DVec3 {
        DVec3::new(
            ((f64::from(column) + 0.5) / f64::from(texels.columns) - 0.5) * self.width_m,
            (0.5 - (f64::from(row) + 0.5) / f64::from(texels.rows)) * self.height_m,
            0.0,
        )
    }

    /// The (fractional) column and row at a point of the surface: a texel's centre is an integer.
    pub fn texel_at(&self, texels: Texels, point_m: DVec3) -> DVec2 {
        DVec2::new(
            (point_m.x / self.width_m + 0.5) * f64::from(texels.columns) - 0.5,
            (0.5 - point_m.y / self.height_m) * f64::from(texels.rows) - 0.5,
        )
    }

    /// Whether a point of the plane lies in the sampled area.
    pub fn contains(&self, point_m: DVec3) -> bool {
        point_m.x.abs() < self.width_m / 2.0 && point_m.y.abs() < self.height_m / 2.0
    }

    /// Where the ray from `origin_m` along `direction` meets the plane from above; `None` where it does not.
    pub fn intersect(&self, origin_m: DVec3, direction: DVec3) -> Option<DVec3> {
        if direction.z >= 0.0 || origin_m.z <= 0.0 {
            return None;
        }
        Some(origin_m - direction * (origin_m.z / direction.z))
    }
}

/// How finely the sampled area is divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texels {
    /// Number of texels along x.
    pub columns: u32,
    /// Number of texels along y.
    pub rows: u32,
}

impl Texels {
    /// How many texels there are.
    pub fn count(&self) -> usize {
        self.columns as usize * self.rows as usize
    }
}

/// The unit vector at `azimuth_rad` (from +x towards +y) and `zenith_rad` (from +z).
pub fn unit_vector(azimuth_rad: f64, zenith_rad: f64) -> DVec3 {
    let (s, c) = zenith_rad.sin_cos();
    DVec3::new(s * azimuth_rad.cos(), s * azimuth_rad.sin(), c)
}

/// Azimuth in [0, 2π) and zenith in [0, π] of a vector.
pub fn azimuth_zenith(direction: DVec3) -> (f64, f64) {
    let zenith = direction.truncate().length().atan2(direction.z);
    (direction.y.atan2(direction.x).rem_euclid(2.0 * PI), zenith)
}

/// A camera's frame in the world of environments, from how the camera (x right, y up, looking along -z) is turned.
pub fn world_from_camera(orientation: DQuat) -> DQuat {
    orientation * DQuat::from_rotation_x(PI)
}

/// The size of a latitude-longitude map: twice as wide as high. Pixel (0, 0) is at the top left; a pixel's centre is an integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LatLong {
    height: u32,
}

impl LatLong {
    /// The most rows.
    pub const MOST_ROWS: u32 = 16384;

    /// A map of `2 height` columns and `height` rows, at least 2 and at most [`Self::MOST_ROWS`].
    ///
    /// # Errors
    /// [`Error::Request`] for any other number.
    pub fn new(width: u32, height: u32) -> Result<Self> {
        if !(2..=Self::MOST_ROWS).contains(&height) || width != 2 * height {
            return Err(Error::request(
                format!("a latitude-longitude map of {width}x{height} pixels"),
                format!(
                    "make it twice as wide as high, such as 4096x2048, with 2 to {} rows",
                    Self::MOST_ROWS
                ),
            ));
        }
        Ok(Self { height })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        2 * self.height as usize
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height as usize
    }

    /// How many pixels there are.
    pub fn count(&self) -> usize {
        self.width() * self.height()
    }

    /// The longitude of a column, radians: from +z towards +x.
    pub fn longitude(&self, column: f64) -> f64 {
        PI - 2.0 * PI * (column + 0.5) / self.width() as f64
    }

    /// The latitude of a row, radians: from the horizon towards +y.
    pub fn latitude(&self, row: f64) -> f64 {
        PI / 2.0 - PI * (row + 0.5) / self.height() as f64
    }

    /// The unit vector, in the world of environments, that a (fractional) pixel shows.
    pub fn direction(&self, pixel: DVec2) -> DVec3 {
        let ((sin, cos), (up, level)) = (self.longitude(pixel.x).sin_cos(), self.latitude(pixel.y).sin_cos());
        DVec3::new(sin * level, up, cos * level)
    }

    /// The (fractional) pixel that shows a direction of any length; columns from -1/2 to less than width - 1/2.
    pub fn pixel(&self, direction: DVec3) -> DVec2 {
        let (width, height) = (self.width() as f64, self.height() as f64);
        let latitude = direction.y.atan2(direction.x.hypot(direction.z));
        let turn = (0.5 - direction.x.atan2(direction.z) / (2.0 * PI)).rem_euclid(1.0);
        DVec2::new(turn * width - 0.5, (0.5 - latitude / PI) * height - 0.5)
    }

    /// The solid angle of a pixel of this row, steradians.
    pub fn solid_angle(&self, row: usize) -> f64 {
        let edge = |row: usize| (PI * row as f64 / self.height() as f64).cos();
        2.0 * PI / self.width() as f64 * (edge(row) - edge(row + 1))
    }
}

/// How sure the numbers of a lens are: their covariance in the order fx fy cx cy k1 k2 p1 p2 k3 (pixels, and none).
pub type LensCovariance = [[f64; 9]; 9];

/// A chessboard by its inner corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardSize {
    /// Inner corners along one side.
    pub columns: u32,
    /// Inner corners along the other.
    pub rows: u32,
}

impl BoardSize {
    /// How many inner corners there are.
    pub fn count(&self) -> usize {
        self.columns as usize * self.rows as usize
    }
}

impl std::fmt::Display for BoardSize {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}x{}", self.columns, self.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> Lens {
        Lens { k1: -0.62, k2: 0.87, p1: -4e-4, p2: 5e-4, ..Lens::pinhole(640, 480, 1349.0) }
    }

    #[test]
    fn unproject_undoes_project_across_the_picture() {
        let lens = lens();
        for y in (0..480).step_by(40) {
            for x in (0..640).step_by(40) {
                let pixel = DVec2::new(f64::from(x), f64::from(y));
                let direction = lens.unproject(pixel).unwrap();
                assert!((lens.project(direction * 3.0).unwrap() - pixel).length() < 1e-6);
            }
        }
    }

    #[test]
    fn nothing_projects_from_behind_or_beyond_the_turning_point() {
        let lens = Lens { k1: -0.3, ..Lens::pinhole(640, 480, 500.0) };
        assert_eq!(lens.project(DVec3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(lens.project(DVec3::new(3.0, 0.0, 1.0)), None);
    }

    #[test]
    fn scaling_keeps_the_ray_of_a_relative_position() {
        let lens = lens();
        let half = lens.scaled_to(320, 240);
        let a = lens.unproject(DVec2::new(99.5, 49.5)).unwrap();
        let b = half.unproject(DVec2::new(49.5, 24.5)).unwrap();
        assert!((a - b).length() < 1e-9);
    }

    #[test]
    fn the_rig_at_rest_looks_straight_down_with_y_up_in_the_picture() {
        let pose = Pose::from_rig(0.0, 0.0, 0.9);
        let camera = pose.to_camera(DVec3::new(0.01, 0.02, 0.0));
        assert!((camera - DVec3::new(0.01, -0.02, 0.9)).length() < 1e-12);
    }

    #[test]
    fn a_tilted_rig_sees_the_surface_from_its_zenith_angle() {
        let (_, zenith) = azimuth_zenith(Pose::from_rig(1.0, 0.7, 0.9).centre_m);
        assert!((zenith - 0.7).abs() < 1e-12);
    }

    #[test]
    fn texels_and_points_are_inverse() {
        let (surface, texels) = (Surface { width_m: 0.2, height_m: 0.15 }, Texels { columns: 7, rows: 5 });
        for row in 0..5 {
            for column in 0..7 {
                let at = surface.texel_at(texels, surface.texel_centre(texels, column, row));
                assert!((at - DVec2::new(f64::from(column), f64::from(row))).length() < 1e-12);
            }
        }
        assert!(surface.texel_centre(texels, 0, 0).y > 0.0, "texel (0, 0) is at the top");
    }

    #[test]
    fn azimuth_and_zenith_are_inverse_to_the_unit_vector() {
        for (azimuth, zenith) in [(0.1, 0.2), (4.0, 1.5), (6.2, 3.0)] {
            let (a, z) = azimuth_zenith(unit_vector(azimuth, zenith));
            assert!((a - azimuth).abs() < 1e-12 && (z - zenith).abs() < 1e-12);
        }
    }

    #[test]
    fn a_map_of_the_sphere_has_openexrs_axes_and_is_not_mirrored() {
        let map = LatLong::new(400, 200).unwrap();
        let at = |x: f64, y: f64, z: f64| map.pixel(DVec3::new(x, y, z));
        assert!((at(0.0, 0.0, 2.0) - DVec2::new(199.5, 99.5)).length() < 1e-9);
        assert!((at(3.0, 0.0, 0.0) - DVec2::new(99.5, 99.5)).length() < 1e-9);
        assert!((at(-1.0, 0.0, 0.0) - DVec2::new(299.5, 99.5)).length() < 1e-9);
        assert!((at(0.0, 1.0, 0.0).y + 0.5).abs() < 1e-9 && (at(0.0, -1.0, 0.0).y - 199.5).abs() < 1e-9);
        // Who looks along -z has +x at the right hand; so has the map, whose edge that is.
        assert!(at(0.1, 0.0, -1.0).x < 20.0 && at(-0.1, 0.0, -1.0).x > 380.0);
        for pixel in [
            DVec2::new(0.0, 0.0),
            DVec2::new(399.0, 199.0),
            DVec2::new(-0.4, 30.3),
            DVec2::new(210.0, 150.25),
        ] {
            assert!((map.pixel(map.direction(pixel)) - pixel).length() < 1e-9);
        }
    }

    #[test]
    fn the_pixels_of_a_map_cover_the_sphere() {
        let map = LatLong::new(34, 17).unwrap();
        let sum: f64 = (0..17).map(|row| 34.0 * map.solid_angle(row)).sum();
        assert!((sum - 4.0 * PI).abs() < 1e-12);
        for (width, height) in [(400, 201), (0, 0), (2, 1), (40000, 20000)] {
            assert!(LatLong::new(width, height).is_err(), "{width}x{height}");
        }
    }

    #[test]
    fn a_camera_that_is_not_turned_looks_along_minus_z_with_y_up() {
        let turned = world_from_camera(DQuat::IDENTITY);
        assert!((turned * DVec3::Z + DVec3::Z).length() < 1e-12);
        assert!((turned * DVec3::NEG_Y - DVec3::Y).length() < 1e-12);
        assert!((turned * DVec3::X - DVec3::X).length() < 1e-12);
    }

    #[test]
    fn axes_and_rig_agree() {
        let rig = Pose::from_rig(0.4, 0.6, 0.9);
        let forward = rig.direction_to_surface(DVec3::Z);
        let up = rig.direction_to_surface(-DVec3::Y);
        let axes = Pose::from_axes(rig.centre_m, forward, up);
        let point = DVec3::new(0.05, -0.03, 0.0);
        assert!((rig.to_camera(point) - axes.to_camera(point)).length() < 1e-12);
    }
}

//! Where every view of a session was really taken from, as a file: `registration.toml`.

use std::path::PathBuf;

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::rig_model::RigModel;
use crate::geometry::{Lens, Pose, PoseCovariance};
use crate::session::Session;
use crate::{Error, Result, file};

const NAME: &str = "registration.toml";

/// The poses of a session's views with how sure they are, and the views that have none.
///
/// Where squares say where the surface is, its frame is theirs. Where only texture aligns the views it is the rig's: the origin is
/// where the pan axis meets the surface, x is where the commanded pan is 0, and the camera is as far away as was said; how well
/// the views know that is in the covariances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Registration {
    /// Version of the file.
    pub format: u32,
    /// Tells the photographs, radiance and commanded angles from which it was made.
    pub made_from: String,
    /// By which factor the squares' places, their shapes and patches of texture were worse than the noise around them says; 1
    /// where there are none.
    pub noise: [f64; 3],
    /// The lens, adjusted together with the poses.
    pub lens: Lens,
    /// The rig that all views share.
    pub rig: RigModel,
    /// How much the views deviate from it.
    pub deviations: DeviationSigma,
    /// What is doubtful of all views, one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// The registered views.
    #[serde(rename = "view", default)]
    pub views: Vec<RegisteredView>,
    /// The views without a trustworthy pose.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<DroppedView>,
}

/// Standard deviations over the views of what differs from view to view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DeviationSigma {
    /// Of the pan, radians.
    pub pan_rad: f64,
    /// Of the tilt, radians.
    pub tilt_rad: f64,
    /// Of the turn about the axis at right angles to both, radians.
    pub third_rad: f64,
    /// Of the surface's place in the camera frame, metres.
    pub shift_m: [f64; 3],
}

/// A view with its pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegisteredView {
    /// Its name in the session.
    pub name: String,
    /// Corners of squares that the pose rests on.
    pub corners: usize,
    /// Patches of the surface's texture that it rests on.
    pub patches: usize,
    /// What the corners leave, root mean square, pixels; 0 without corners.
    pub rms_px: f64,
    /// The pose.
    pub pose: Pose,
    /// Its covariance.
    pub covariance: PoseCovariance,
    /// Its covariance if the lens is exactly the one stated: what displaces the picture. Without squares also if the texture of
    /// all views is on the surface where they have it together: what displaces the picture against the others.
    pub covariance_given_lens: PoseCovariance,
}

/// A view that was left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DroppedView {
    /// Its name in the session.
    pub name: String,
    /// Why, as a clause that goes on from the name.
    pub reason: String,
}

impl RegisteredView {
    /// Standard deviation of the direction from the surface's origin to the camera, radians: root of the summed variances at
    /// right angles to it.
    pub fn direction_sigma_rad(&self) -> f64 {
        let (a, b) = self.pose.centre_m.normalize().any_orthonormal_pair();
        let variance = self.centre_covariance(a, a) + self.centre_covariance(b, b);
        variance.max(0.0).sqrt() / self.pose.centre_m.length()
    }

    /// Of the centre's places along two axes.
    fn centre_covariance(&self, p: DVec3, q: DVec3) -> f64 {
        (0..9).map(|i| p[i / 3] * self.covariance[3 + i / 3][3 + i % 3] * q[i % 3]).sum()
    }

    /// How far that direction is from the one of another pose, the true one say: the angle, radians.
    pub fn direction_error_rad(&self, truth: &Pose) -> f64 {
        self.pose.centre_m.angle_between(truth.centre_m)
    }

    /// The same error in standard deviations, along the two axes of its covariance, across the direction.
    pub fn direction_scores(&self, truth: &Pose) -> [f64; 2] {
        let centre = self.pose.centre_m;
        let (a, b) = centre.normalize().any_orthonormal_pair();
        let error = truth.centre_m - centre;
        let covariance = |p: DVec3, q: DVec3| self.centre_covariance(p, q);
        let (aa, ab, bb) = (covariance(a, a), covariance(a, b), covariance(b, b));
        let angle = 0.5 * (2.0 * ab).atan2(aa - bb);
        [angle, angle + std::f64::consts::FRAC_PI_2].map(|angle| {
            let along = a * angle.cos() + b * angle.sin();
            error.dot(along) / covariance(along, along).sqrt()
        })
    }

    /// Covariance (xx, xy, yy; pixels²) of where a point of the surface appears through `lens`; `None` where it does not.
    pub fn place_covariance_px2(&self, lens: &Lens, point_m: DVec3) -> Option<[f64; 3]> {
        let at = self.pose.to_camera(point_m);
        let step = 1e-4 * at.length();
        let along = |axis: DVec3| {
            Some((lens.project(at + axis * step)? - lens.project(at - axis * step)?) / (2.0 * step))
        };
        let by_place = [along(DVec3::X)?, along(DVec3::Y)?, along(DVec3::Z)?];
        // A turn d of the camera moves the point by d x at, a shift of its centre by minus that shift in the camera frame.
        let moved = |place: DVec3| by_place[0] * place.x + by_place[1] * place.y + by_place[2] * place.z;
        let columns: [DVec2; 6] = std::array::from_fn(|i| match i {
            0..3 => moved(DVec3::AXES[i].cross(at)),
            _ => moved(self.pose.camera_from_surface * -DVec3::AXES[i - 3]),
        });
        let mut place = [0.0; 3];
        for (a, row) in columns.iter().zip(&self.covariance_given_lens) {
            for (b, covariance) in columns.iter().zip(row) {
                place[0] += a.x * covariance * b.x;
                place[1] += a.x * covariance * b.y;
                place[2] += a.y * covariance * b.y;
            }
        }
        Some(place)
    }
}

impl Registration {
    /// The only version of the file so far.
    pub(super) const FORMAT: u32 = 2;

    /// Where a session keeps it.
    pub fn path(session: &Session) -> PathBuf {
        session.folder().join(NAME)
    }

    /// Writes the session's registration.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be written; what stood there before then stays.
    pub fn write(&self, session: &Session) -> Result<()> {
        let text = toml::to_string(self).expect("a registration is plain data");
        file::write_bytes(&Self::path(session), text.as_bytes())
    }

    /// The session's registration; `None` where it has none.
    ///
    /// # Errors
    /// [`Error::Input`] where it is damaged, or the session's photographs, radiance or angles are not those from which it
    /// was made, or it does not know a view that is done; [`Error::Io`].
    pub fn of(session: &Session) -> Result<Option<Self>> {
        const AGAIN: &str = "run `rigel register` again, or remove the file to use the poses of session.toml";
        let path = Self::path(session);
        if !path.exists() {
            return Ok(None);
        }
        let text = std::fs::read_to_string(&path).map_err(Error::io("read", &path))?;
        // Before anything else: another version may have other entries.
        let table: toml::Table = toml::from_str(&text)
            .map_err(|error| Error::input(&path, format!("is damaged ({})", error.message()), AGAIN))?;
        if let Some(format) =
            table.get("format").filter(|format| format.as_integer() != Some(Self::FORMAT.into()))
        {
            let what = format!("has format {format}, this reads format {}", Self::FORMAT);
            return Err(Error::input(&path, what, AGAIN));
        }
        let registration: Self = table.try_into().map_err(|error: toml::de::Error| {
            Error::input(&path, format!("is damaged ({})", error.message()), AGAIN)
        })?;
        if registration.made_from != made_from(session)? {
            return Err(Error::input(&path, "was made from other radiance or angles", AGAIN));
        }
        let known = |name: &String| {
            registration.view(name).is_some() || registration.dropped.iter().any(|view| view.name == *name)
        };
        for view in session.done_views() {
            let name = &session.manifest.views[view].name;
            if !known(name) {
                return Err(Error::input(&path, format!("does not know view {name}"), AGAIN));
            }
        }
        Ok(Some(registration))
    }

    /// A view by its name; `None` where it was dropped.
    pub fn view(&self, name: &str) -> Option<&RegisteredView> {
        self.views.iter().find(|view| view.name == name)
    }
}

/// Lens and pose of a session's view: as registered where there is a registration, else those of its manifest.
///
/// # Errors
/// [`Error::Input`] where the registration has dropped the view, or the session has no lens or pose for it.
pub fn view_geometry(
    session: &Session,
    registration: Option<&Registration>,
    view: usize,
) -> Result<(Lens, Pose)> {
    let Some(registration) = registration else {
        return Ok((*session.manifest.lens(view)?, session.pose(view)?));
    };
    let name = &session.manifest.views[view].name;
    match registration.view(name) {
        Some(view) => Ok((registration.lens, view.pose)),
        None => Err(Error::input(
            Registration::path(session),
            format!("has no pose for view {name}"),
            "leave the view out, or register again",
        )),
    }
}

/// A hash of everything that a registration depends on: what the radiance was made from (the photographs among it), the
/// commanded angles, the surface.
pub(super) fn made_from(session: &Session) -> Result<String> {
    let path = session.radiance_folder().join("made_from.txt");
    let radiance = std::fs::read(&path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => {
            Error::input(session.folder(), "has no radiance", "run `rigel radiance` first")
        }
        _ => Error::io("read", &path)(error),
    })?;
    let mut hasher = Sha256::new();
    hasher.update(&radiance);
    let manifest = &session.manifest;
    hasher.update(format!("{:?} {:?} {:?}", manifest.views, manifest.surface, manifest.distance_m));
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::rig_model::Seen;

    fn view(covariance: PoseCovariance) -> RegisteredView {
        RegisteredView {
            name: "view000".into(),
            corners: 16,
            patches: 0,
            rms_px: 0.1,
            pose: Pose::from_rig(0.4, 0.9, 0.9),
            covariance,
            covariance_given_lens: covariance,
        }
    }

    #[test]
    fn a_pose_s_error_moves_points_as_its_covariance_says() {
        let lens = Lens { k1: -0.4, ..Lens::pinhole(640, 480, 1350.0) };
        let point = DVec3::new(0.07, -0.05, 0.0);
        for i in 0..6 {
            let step = 1e-5;
            let mut covariance = [[0.0; 6]; 6];
            covariance[i][i] = step * step;
            let view = view(covariance);
            let mut difference = [0.0; 6];
            difference[i] = step;
            let seen = Seen::of(&view.pose);
            let place = |seen: &Seen| lens.project(seen.to_camera(point)).unwrap();
            let moved = place(&seen.after(&difference)) - place(&seen);
            let [xx, xy, yy] = view.place_covariance_px2(&lens, point).unwrap();
            let close = |a: f64, b: f64| (a - b).abs() < 2e-3 * (xx + yy);
            assert!(close(xx, moved.x * moved.x) && close(yy, moved.y * moved.y), "{i}");
            assert!(close(xy, moved.x * moved.y), "{i}: {xy} {moved}");
        }
    }

    #[test]
    fn a_direction_is_as_sure_as_the_shift_across_it() {
        let mut covariance = [[0.0; 6]; 6];
        (3..6).for_each(|i| covariance[i][i] = 1e-6);
        // Two of the three directions are across.
        let expected = 2f64.sqrt() * 1e-3 / 0.9;
        assert!((view(covariance).direction_sigma_rad() / expected - 1.0).abs() < 1e-9);
    }
}

//! A surface with dark squares around it on a rig that is not quite as drawn: where every view truly stands, and what it shows.

use std::fs;
use std::path::Path;

use glam::{DVec2, DVec3};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rayon::prelude::*;
use rigel::calibration::{RigModel, SquareCorners, Squares, ViewCorners};
use rigel::geometry::{Lens, Pose, Surface};
use rigel::radiance::RadianceImage;
use rigel::session::{Event, Manifest, Photograph, Session, View};
use rigel::{Error, Result, file};

use crate::board::normal;
use crate::texture::Texture;

/// From the rig's centre to the camera as drawn, metres.
pub const DISTANCE_M: f64 = 0.9;
/// Sides of the area that the squares surround, metres.
const SURFACE: Surface = Surface { width_m: 0.2, height_m: 0.15 };
/// Radiance of squares, ground and the surface between them.
const LEVELS: [f64; 3] = [0.04, 0.8, 0.35];
/// Sub-samples along either side of a pixel.
const FINE: i32 = 8;
/// The same for a texture.
const TEXTURE_FINE: usize = 2;
/// It lies on the plane up to so much of the surface's sides from the middle.
const TEXTURE_REACH: f64 = 0.75;
/// Tilts reach so far, radians.
const STEEPEST_RAD: f64 = 1.25;

/// A rig, its camera and the squares around its surface, as they truly are.
#[derive(Debug, Clone, PartialEq)]
pub struct SquaresRig {
    /// The squares: four, 12 mm wide, around an area of 200 mm x 150 mm.
    pub layout: Squares,
    /// The lens of the camera, 640x480 pixels.
    pub lens: Lens,
    /// What all views share.
    pub rig: RigModel,
    /// What the squares lie on, each on its white ground. Where there is none it is white, but for a grey area of no stated size.
    pub texture: Option<Texture>,
}

/// A view: what was commanded, and where it was truly taken from.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueView {
    /// Its name.
    pub name: String,
    /// The commanded pan, radians.
    pub pan_rad: f64,
    /// The commanded tilt, radians.
    pub tilt_rad: f64,
    /// The truth.
    pub pose: Pose,
}

/// What a view's radiance is like.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// Standard deviation of a pixel relative to its radiance; it is stated.
    pub noise: f64,
    /// Squares on which a lamp is mirrored, 20 pixels wide and much brighter than the ground.
    pub glare: Vec<usize>,
    /// The radiance beyond which every photograph was saturated.
    pub saturated: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Look {
    fn default() -> Self {
        Self { noise: 0.02, glare: vec![], saturated: f64::INFINITY, seed: 1 }
    }
}

impl SquaresRig {
    /// A rig whose axes, camera and surface are off by a few milliradians and millimetres, each `seed` in its own way.
    pub fn new(seed: u64) -> Self {
        let mut random = StdRng::seed_from_u64(seed);
        let mut three = |sigma: f64| [0; 3].map(|_| sigma * normal(&mut random));
        let (camera_turn_rad, surface_turn_rad) = (three(0.003), three(0.003));
        let (camera_shift_m, surface_shift_m) = (three(0.002), three(0.002));
        let [axis_angle_rad, axis_distance_m, _] = three(0.002);
        let rig = RigModel {
            camera_turn_rad,
            surface_turn_rad,
            camera_shift_m,
            surface_shift_m,
            axis_angle_rad,
            axis_distance_m,
            distance_m: DISTANCE_M,
        };
        let places = [(-0.112, -0.087), (-0.112, 0.087), (0.112, -0.087), (0.112, 0.087)];
        let centres_m = places.map(|(x, y)| DVec3::new(x, y, 0.0)).to_vec();
        let layout = Squares { size_m: 0.012, ground_m: 0.003, centres_m };
        let lens = Lens { k1: -0.6, k2: 0.9, ..Lens::pinhole(640, 480, 1350.0) };
        Self { layout, lens, rig, texture: None }
    }

    /// Views all around down to a tilt of 70 degrees, each off by what play and a soft mounting leave: 0.2 degrees in pan and tilt, 2 mm
    /// in the picture's plane.
    pub fn views(&self, count: usize, seed: u64) -> Vec<TrueView> {
        let mut random = StdRng::seed_from_u64(seed);
        let mut off = |sigma: f64| sigma * normal(&mut random);
        (0..count)
            .map(|view| {
                let (pan_rad, tilt_rad) =
                    (2.4 * view as f64, STEEPEST_RAD * (view as f64 + 0.5) / count as f64);
                let mut rig = self.rig;
                rig.camera_shift_m[0] += off(0.002);
                rig.camera_shift_m[1] += off(0.0015);
                let pose = rig.pose(pan_rad + off(0.004), tilt_rad + off(0.003));
                TrueView { name: format!("view{view:03}"), pan_rad, tilt_rad, pose }
            })
            .collect()
    }

    /// Where the corners of a square truly appear.
    fn corners(&self, view: &TrueView, square: usize) -> Option<[DVec2; 4]> {
        let mut pixels = [DVec2::ZERO; 4];
        for (pixel, point) in pixels.iter_mut().zip(self.layout.corners_m(square, 0.0)) {
            *pixel = self.lens.project(view.pose.to_camera(point))?;
        }
        Some(pixels)
    }

    /// The corners of all squares as a detector with noise of `sigma_px` finds them.
    pub fn detected(&self, views: &[TrueView], sigma_px: f64, seed: u64) -> Vec<ViewCorners> {
        let mut random = StdRng::seed_from_u64(seed);
        let mut noise = || sigma_px * DVec2::new(normal(&mut random), normal(&mut random));
        let view = |view: &TrueView| {
            let squares = (0..self.layout.centres_m.len()).filter_map(|square| {
                let pixels = self.corners(view, square)?.map(|pixel| pixel + noise());
                Some(SquareCorners { square, pixels, sigma_px })
            });
            let squares = squares.collect();
            ViewCorners { name: view.name.clone(), pan_rad: view.pan_rad, tilt_rad: view.tilt_rad, squares }
        };
        views.iter().map(view).collect()
    }

    /// The radiance that a view shows.
    pub fn radiance(&self, view: &TrueView, look: &Look) -> RadianceImage {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        let mut light = vec![LEVELS[1]; width * height];
        let appear = |point_m: DVec3| self.lens.project(view.pose.to_camera(point_m));
        match &self.texture {
            Some(texture) => self.lay(&mut light, view, texture),
            None => {
                let half = DVec2::new(SURFACE.width_m, SURFACE.height_m) / 2.0;
                let ends = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
                let ends = ends.map(|end| appear((DVec2::from(end) * half).extend(0.0)));
                if let [Some(a), Some(b), Some(c), Some(d)] = ends {
                    paint(&mut light, width, &[a, b, c, d], LEVELS[2]);
                }
            }
        }
        for square in 0..self.layout.centres_m.len() {
            let Some(corners) = self.corners(view, square) else { continue };
            if self.texture.is_some()
                && let [Some(a), Some(b), Some(c), Some(d)] =
                    self.layout.corners_m(square, self.layout.ground_m).map(appear)
            {
                paint(&mut light, width, &[a, b, c, d], LEVELS[1]);
            }
            paint(&mut light, width, &corners, LEVELS[0]);
            if look.glare.contains(&square) {
                let centre = corners.iter().sum::<DVec2>() / 4.0;
                for (i, light) in light.iter_mut().enumerate() {
                    let pixel = DVec2::new((i % width) as f64, (i / width) as f64);
                    *light += 30.0 * (-pixel.distance_squared(centre) / 200.0).exp();
                }
            }
        }
        let mut random = StdRng::seed_from_u64(look.seed);
        let pixels = light.into_iter().map(|light| {
            let sigma = look.noise * (light + 0.05);
            if light > look.saturated {
                return (look.saturated, f64::INFINITY, RadianceImage::SATURATED);
            }
            ((light + sigma * normal(&mut random)).max(0.0), sigma * sigma, 0)
        });
        let pixels: Vec<(f64, f64, u8)> = pixels.collect();
        RadianceImage {
            width: self.lens.width,
            height: self.lens.height,
            radiance: pixels.iter().map(|p| [p.0 as f32; 3]).collect(),
            variance: pixels.iter().map(|p| [p.1 as f32; 3]).collect(),
            mask: pixels.iter().map(|p| p.2).collect(),
        }
    }

    /// Puts a texture on the surface and around it: each pixel the mean of what it covers.
    fn lay(&self, light: &mut [f64], view: &TrueView, texture: &Texture) {
        let width = self.lens.width as usize;
        let part = |k: usize| (k as f64 + 0.5) / TEXTURE_FINE as f64 - 0.5;
        for (i, light) in light.iter_mut().enumerate() {
            let at = DVec2::new((i % width) as f64, (i / width) as f64);
            let fine = (0..TEXTURE_FINE * TEXTURE_FINE).filter_map(|k| {
                let ray =
                    self.lens.unproject(at + DVec2::new(part(k % TEXTURE_FINE), part(k / TEXTURE_FINE)))?;
                let along = view.pose.direction_to_surface(ray);
                let point = SURFACE.intersect(view.pose.centre_m, along)?;
                let is_on = point.x.abs() < TEXTURE_REACH * SURFACE.width_m
                    && point.y.abs() < TEXTURE_REACH * SURFACE.height_m;
                is_on.then(|| texture.radiance(point, -along))
            });
            let fine: Vec<f64> = fine.collect();
            if !fine.is_empty() {
                *light = fine.iter().sum::<f64>() / fine.len() as f64;
            }
        }
    }

    /// A session in `folder` whose radiance is measured already: each view with its look.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be written; [`Error::Input`] where the folder holds something.
    pub fn session(&self, folder: &Path, views: &[(TrueView, Look)]) -> Result<Session> {
        let listed = |(view, _): &(TrueView, Look)| View {
            name: view.name.clone(),
            pan_deg: Some(view.pan_rad.to_degrees()),
            tilt_deg: Some(view.tilt_rad.to_degrees()),
            lens: 0,
            pose: None,
        };
        let manifest = Manifest {
            views: views.iter().map(listed).collect(),
            lenses: vec![self.lens],
            distance_m: Some(DISTANCE_M),
            surface: self.texture.map(|_| SURFACE),
            ..Manifest::new("simulated")
        };
        let mut session = Session::create(folder, manifest)?;
        let radiance = session.radiance_folder();
        fs::create_dir(&radiance).map_err(Error::io("create", &radiance))?;
        file::write_bytes(&radiance.join("made_from.txt"), b"simulated")?;
        for view in 0..views.len() {
            let photograph = Photograph {
                view,
                file: format!("{view}.png"),
                exposure_s: Some(1.0),
                ..Photograph::default()
            };
            session.record(Event::Photograph(photograph))?;
            session.record(Event::ViewDone { view })?;
        }
        views.par_iter().enumerate().try_for_each(|(index, (view, look))| {
            self.radiance(view, look).write_exr(&session.radiance_path(index), "simulated")
        })?;
        Ok(session)
    }
}

/// Fills a convex quadrangle: pixels on its edges by the part of them that it covers.
fn paint(light: &mut [f64], width: usize, corners: &[DVec2; 4], level: f64) {
    let height = light.len() / width;
    let low = corners.iter().copied().reduce(DVec2::min).unwrap_or_default() - 1.0;
    let high = corners.iter().copied().reduce(DVec2::max).unwrap_or_default() + 1.0;
    let area: f64 = (0..4).map(|i| corners[i].perp_dot(corners[(i + 1) % 4])).sum();
    // How far inside the quadrangle a place is, pixels.
    let depth = |at: DVec2| {
        let side = |i: usize| {
            let (a, b) = (corners[i], corners[(i + 1) % 4]);
            area.signum() * (b - a).perp_dot(at - a) / (b - a).length()
        };
        (0..4).map(side).fold(f64::INFINITY, f64::min)
    };
    for y in low.y.max(0.0) as usize..=(high.y.max(0.0) as usize).min(height - 1) {
        for x in low.x.max(0.0) as usize..=(high.x.max(0.0) as usize).min(width - 1) {
            let at = DVec2::new(x as f64, y as f64);
            let covered = match depth(at) {
                d if d > 1.0 => 1.0,
                d if d < -1.0 => 0.0,
                _ => {
                    let part = |k: i32| (f64::from(k) + 0.5) / f64::from(FINE) - 0.5;
                    let inside = (0..FINE * FINE)
                        .filter(|k| depth(at + DVec2::new(part(k % FINE), part(k / FINE))) > 0.0)
                        .count();
                    inside as f64 / f64::from(FINE * FINE)
                }
            };
            let light = &mut light[y * width + x];
            *light += covered * (level - *light);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_darkens_its_pixels_and_glare_brightens_them() {
        let rig = SquaresRig::new(1);
        let view = &rig.views(3, 2)[0];
        let centre = rig.lens.project(view.pose.to_camera(rig.layout.centres_m[1])).unwrap();
        let at = centre.y.round() as usize * 640 + centre.x.round() as usize;
        let quiet = Look { noise: 0.0, ..Look::default() };
        let dark = rig.radiance(view, &quiet);
        assert_eq!((dark.radiance[at][0], dark.mask[at]), (0.04, 0));
        let glare = rig.radiance(view, &Look { glare: vec![1], saturated: 10.0, ..quiet });
        assert_eq!((glare.radiance[at][0], glare.mask[at]), (10.0, RadianceImage::SATURATED));
    }

    #[test]
    fn a_painted_quadrangle_has_its_area() {
        let corners = [(10.3, 8.2), (40.7, 12.4), (38.1, 30.9), (8.8, 25.5)].map(DVec2::from);
        for corners in [corners, [corners[3], corners[2], corners[1], corners[0]]] {
            let mut light = vec![0.0; 64 * 48];
            paint(&mut light, 64, &corners, 1.0);
            let area: f64 = (0..4).map(|i| corners[i].perp_dot(corners[(i + 1) % 4])).sum::<f64>() / 2.0;
            assert!((light.iter().sum::<f64>() - area.abs()).abs() < 0.5, "{area}");
        }
    }

    #[test]
    fn detected_corners_have_the_noise_that_was_asked_for() {
        let rig = SquaresRig::new(1);
        let views = rig.views(40, 2);
        let (exact, noisy) = (rig.detected(&views, 0.0, 3), rig.detected(&views, 0.1, 3));
        let pairs = exact.iter().zip(&noisy).flat_map(|(a, b)| a.squares.iter().zip(&b.squares));
        let squared: Vec<f64> = pairs
            .flat_map(|(a, b)| a.pixels.iter().zip(&b.pixels).map(|(a, b)| a.distance_squared(*b)))
            .collect();
        assert_eq!(squared.len(), 40 * 16);
        let rms = (squared.iter().sum::<f64>() / squared.len() as f64 / 2.0).sqrt();
        assert!((rms / 0.1 - 1.0).abs() < 0.1, "{rms}");
    }
}

//! A camera that photographs a [`Scene`] through a lens with distortion and vignetting, a response curve and noise,
//! all of them known.

mod eye;
mod file;
mod sensor;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use glam::DVec2;
use rigel::camera::{Camera, Shot, Taken, exif};
use rigel::file::write_bytes;
use rigel::geometry::{Lens, Pose};
use rigel::radiance::RadianceImage;
use rigel::{Error, Result};

use crate::scene::Scene;
use eye::{Eye, vignetting};
pub use file::write_photograph;
use file::{encode, number_of};
use sensor::response;

/// Exposure times are multiples of this, seconds.
const TICK_S: f64 = 1e-5;
/// What a simulated camera is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Lens and picture size.
    pub lens: Lens,
    /// From the camera to the centre of the surface, metres.
    pub distance_m: f64,
    /// Shot and read noise.
    pub noise: bool,
    /// Whether the picture darkens towards its corners.
    pub vignetting: bool,
    /// Quality of the JPEG files; `None` writes PNG.
    pub jpeg_quality: Option<u8>,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Options {
    /// 320x240 pixels at 0.9 m, a board with its frames just inside the picture however it turns; everything that
    /// disturbs is on.
    fn default() -> Self {
        Self {
            lens: Lens { k1: -0.5, k2: 0.6, p1: -4e-4, p2: 5e-4, ..Lens::pinhole(320, 240, 700.0) },
            distance_m: 0.9,
            noise: true,
            vignetting: true,
            jpeg_quality: Some(95),
            seed: 1,
        }
    }
}

/// A camera in front of a board that a rig turns.
pub struct SimulatedCamera<R> {
    eye: Eye,
    /// Where the rig truly stands: pan and tilt, radians.
    rig: R,
    /// The radiance of the pose that was last photographed: a bracket renders once.
    seen: Option<(Pose, Vec<[f32; 3]>)>,
    photographs: u64,
}

impl<R: Fn() -> (f64, f64)> SimulatedCamera<R> {
    /// A camera that sees `scene` from [`Pose::from_rig`] of the pan and tilt (radians) that `rig` tells.
    pub fn new(scene: Scene, options: Options, rig: R) -> Self {
        Self { eye: Eye::new(scene, options), rig, seen: None, photographs: 0 }
    }

    /// The true lens.
    pub fn lens(&self) -> &Lens {
        &self.eye.options.lens
    }

    /// The true pose at this moment.
    pub fn pose(&self) -> Pose {
        let (pan_rad, tilt_rad) = (self.rig)();
        Pose::from_rig(pan_rad, tilt_rad, self.eye.options.distance_m)
    }

    /// The fraction of the light from the centre that reaches `pixel`: 1 in the centre, about 2/3 in the corners.
    pub fn vignetting(&self, pixel: DVec2) -> f64 {
        if self.eye.options.vignetting { vignetting(&self.eye.options.lens, pixel) } else { 1.0 }
    }

    /// The level (0 to 255, not rounded) that an exposure (radiance times seconds, behind the vignetting) gives in every
    /// channel, without noise: a linear toe, a power of 0.45 and a soft contrast curve; 255 from saturation upwards.
    pub fn response(&self, exposure: f64) -> f64 {
        response(exposure)
    }

    /// What a perfect camera would measure at `pose`: the scene's radiance averaged over each pixel, through this lens'
    /// geometry but without vignetting and noise. The variance is 0 and nothing is masked.
    pub fn truth(&self, pose: &Pose) -> RadianceImage {
        let radiance = self.eye.render(pose);
        RadianceImage {
            width: self.eye.options.lens.width,
            height: self.eye.options.lens.height,
            variance: vec![[0.0; 3]; radiance.len()],
            mask: vec![0; radiance.len()],
            radiance,
        }
    }

    /// Photographs an evenly lit sheet of radiance 1 in place of the board: a flat field.
    ///
    /// # Errors
    /// Those of [`Camera::photograph`].
    pub fn photograph_even_sheet(&mut self, exposure_s: f64, stem: &Path) -> Result<Taken> {
        self.seen = Some((self.pose(), vec![[1.0; 3]; self.eye.rays.len()]));
        let shot = self.photograph(exposure_s, stem);
        self.seen = None;
        shot?.taken()
    }

    /// The levels of one photograph, RGB row by row, as [`Camera::photograph`] writes them. Each call has new noise; that of
    /// a photograph in a file depends on the file's name instead, so that one that is taken again is the same again.
    pub fn levels(&mut self, exposure_s: f64) -> Vec<u8> {
        self.photographs += 1;
        self.expose(exposure_s, self.photographs)
    }

    fn expose(&mut self, exposure_s: f64, photograph: u64) -> Vec<u8> {
        let pose = self.pose();
        let radiance = match self.seen.take() {
            Some((at, radiance)) if at == pose => radiance,
            _ => self.eye.render(&pose),
        };
        let levels = self.eye.develop(&radiance, exposure_s, photograph);
        self.seen = Some((pose, radiance));
        levels
    }
}

impl<R: Fn() -> (f64, f64)> Camera for SimulatedCamera<R> {
    fn describe(&self) -> String {
        let Options { lens, noise, vignetting, seed, .. } = self.eye.options;
        let on = |on| if on { "on" } else { "off" };
        format!(
            "simulated camera, {}x{}, noise {} (seed {seed}), vignetting {}",
            lens.width,
            lens.height,
            on(noise),
            on(vignetting)
        )
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        [1e-4, 2.0]
    }

    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        let [shortest, longest] = self.exposure_range_s();
        if !(shortest..=longest).contains(&exposure_s) {
            return Err(Error::request(
                format!("the simulated camera cannot expose for {exposure_s} s"),
                format!("choose a time from {shortest} s to {longest} s"),
            ));
        }
        let ticks = (exposure_s / TICK_S).round();
        let levels = self.expose(ticks * TICK_S, number_of(stem));
        // Without a time: equal photographs are equal files.
        let exif = exif::block(ticks * TICK_S, None);
        let (extension, bytes) = encode(&self.eye.options, &levels, exif)?;
        // `with_extension` would cut a stem such as "view.3" short.
        let mut file = stem.as_os_str().to_os_string();
        file.push(extension);
        let file = PathBuf::from(file);
        write_bytes(&file, &bytes)?;
        Ok(Shot::Taken(Taken { file, exposure_s: ticks * TICK_S }))
    }

    fn file_size_bytes(&self) -> u64 {
        let pixels = u64::from(self.eye.options.lens.width) * u64::from(self.eye.options.lens.height);
        if self.eye.options.jpeg_quality.is_some() { pixels / 2 } else { pixels * 3 }
    }
}

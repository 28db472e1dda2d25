//! A camera that photographs a [`Scene`] through a lens with distortion and vignetting, a response curve and noise,
//! all of them known.

mod sensor;

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use glam::{DVec2, DVec3};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;
use rigel::camera::{Camera, Shot, Taken, exif};
use rigel::file::write_bytes;
use rigel::geometry::{Lens, Pose};
use rigel::radiance::RadianceImage;
use rigel::{Error, Result};

use crate::scene::Scene;
use sensor::{FULL_EXPOSURE, Noise, response};

/// Exposure times are multiples of this, seconds.
const TICK_S: f64 = 1e-5;
/// Sub-samples of a pixel, in pixels from its centre.
const SAMPLES: [DVec2; 4] =
    [DVec2::new(-0.25, -0.25), DVec2::new(0.25, -0.25), DVec2::new(-0.25, 0.25), DVec2::new(0.25, 0.25)];

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

/// The part of the camera that many threads share.
struct Eye {
    scene: Scene,
    options: Options,
    /// Per pixel the unit directions of its sub-samples in the camera frame; `None` where no light comes from.
    rays: Vec<[Option<DVec3>; 4]>,
    /// Vignetting of every pixel.
    transmission: Vec<f64>,
}

impl<R: Fn() -> (f64, f64)> SimulatedCamera<R> {
    /// A camera that sees `scene` from [`Pose::from_rig`] of the pan and tilt (radians) that `rig` tells.
    pub fn new(scene: Scene, options: Options, rig: R) -> Self {
        let lens = options.lens;
        let pixels: Vec<DVec2> = (0..lens.height)
            .flat_map(|y| (0..lens.width).map(move |x| DVec2::new(f64::from(x), f64::from(y))))
            .collect();
        let rays = pixels.par_iter().map(|&pixel| SAMPLES.map(|s| lens.unproject(pixel + s))).collect();
        let transmission =
            pixels.iter().map(|&p| if options.vignetting { vignetting(&lens, p) } else { 1.0 }).collect();
        Self { eye: Eye { scene, options, rays, transmission }, rig, seen: None, photographs: 0 }
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

impl Eye {
    fn render(&self, pose: &Pose) -> Vec<[f32; 3]> {
        let surface = self.scene.surface();
        let to_surface = pose.camera_from_surface.inverse();
        let mean = |rays: &[Option<DVec3>; 4]| {
            let mut sum = DVec3::ZERO;
            for ray in rays.iter().flatten().map(|&ray| to_surface * ray) {
                if let Some(point) = surface.intersect(pose.centre_m, ray) {
                    sum += DVec3::from_array(self.scene.radiance(point, -ray));
                }
            }
            (sum / SAMPLES.len() as f64).as_vec3().to_array()
        };
        self.rays.par_iter().map(mean).collect()
    }

    /// The levels of the `photograph`th photograph. Its noise depends on the seed, that number and the row alone,
    /// however many threads there are.
    fn develop(&self, radiance: &[[f32; 3]], exposure_s: f64, photograph: u64) -> Vec<u8> {
        let width = self.options.lens.width as usize;
        let mut levels = vec![0; radiance.len() * 3];
        levels.par_chunks_mut(width * 3).enumerate().for_each(|(row, levels)| {
            let mut noise =
                self.options.noise.then(|| Noise::new([self.options.seed, photograph, row as u64]));
            for (column, level) in levels.chunks_exact_mut(3).enumerate() {
                let pixel = row * width + column;
                for c in 0..3 {
                    let light = f64::from(radiance[pixel][c]) * self.transmission[pixel];
                    let full = light * exposure_s / FULL_EXPOSURE;
                    let full = noise.as_mut().map_or(full, |noise| noise.disturb(full));
                    level[c] = response(full * FULL_EXPOSURE).round() as u8;
                }
            }
        });
        levels
    }

    /// A file's extension and content.
    fn encode(&self, levels: &[u8], exif: Vec<u8>) -> Result<(&'static str, Vec<u8>)> {
        let (width, height) = (self.options.lens.width, self.options.lens.height);
        let mut bytes = Vec::new();
        let written = match self.options.jpeg_quality {
            Some(quality) => {
                encode_with(JpegEncoder::new_with_quality(&mut bytes, quality), exif, levels, width, height)
            }
            None => encode_with(PngEncoder::new(&mut bytes), exif, levels, width, height),
        };
        written.map_err(|error| {
            Error::request(
                format!("a picture of {width}x{height} pixels cannot be encoded ({error})"),
                "choose another picture size",
            )
        })?;
        Ok((if self.options.jpeg_quality.is_some() { ".jpg" } else { ".png" }, bytes))
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
        let (extension, bytes) = self.eye.encode(&levels, exif)?;
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

/// A number for the photograph of that stem: FNV-1a of its file's name.
fn number_of(stem: &Path) -> u64 {
    let name = stem.file_name().unwrap_or_default().as_encoded_bytes();
    name.iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}

/// Writes a small JPEG photograph of a grey wedge as a camera does that is released by a contact: with its exposure time and
/// when the exposure began, by the camera's clock, in its EXIF block.
///
/// # Errors
/// [`Error::Io`] when it cannot be written.
pub fn write_photograph(path: &Path, exposure_s: f64, at: SystemTime) -> Result<()> {
    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 48;
    let level = |x: u32| response(f64::from(x + 1) / f64::from(WIDTH) * exposure_s).round() as u8;
    let levels: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(|pixel| [level(pixel % WIDTH); 3]).collect();
    let mut bytes = vec![];
    let exif = exif::block(exposure_s, Some(at));
    encode_with(JpegEncoder::new_with_quality(&mut bytes, 95), exif, &levels, WIDTH, HEIGHT)
        .map_err(|error| Error::request(format!("cannot be encoded ({error})"), "report this").about(path))?;
    write_bytes(path, &bytes)
}

fn encode_with(
    mut encoder: impl ImageEncoder,
    exif: Vec<u8>,
    levels: &[u8],
    width: u32,
    height: u32,
) -> image::ImageResult<()> {
    encoder.set_exif_metadata(exif).map_err(image::ImageError::Unsupported)?;
    encoder.write_image(levels, width, height, ExtendedColorType::Rgb8)
}

fn vignetting(lens: &Lens, pixel: DVec2) -> f64 {
    let half_diagonal = DVec2::new(f64::from(lens.width), f64::from(lens.height)).length() / 2.0;
    let r2 = (pixel - DVec2::new(lens.cx, lens.cy)).length_squared() / (half_diagonal * half_diagonal);
    1.0 - 0.26 * r2 - 0.08 * r2 * r2
}

#[cfg(test)]
mod tests {
    use super::sensor::{FULL_ELECTRONS, READ_ELECTRONS};
    use super::*;
    use std::cell::Cell;
    use std::fs;
    use std::rc::Rc;

    fn rig_at(pan_rad: f64, tilt_rad: f64) -> impl Fn() -> (f64, f64) {
        move || (pan_rad, tilt_rad)
    }

    fn small() -> Options {
        let default = Options::default();
        Options { lens: default.lens.scaled_to(160, 120), ..default }
    }

    /// Exposure in every pixel and channel, from the truth.
    fn exposures<R: Fn() -> (f64, f64)>(camera: &SimulatedCamera<R>, exposure_s: f64) -> Vec<f64> {
        let truth = camera.truth(&camera.pose());
        let at = |i: usize| DVec2::new((i % truth.width as usize) as f64, (i / truth.width as usize) as f64);
        let exposure = |(i, rgb): (usize, &[f32; 3])| {
            let transmission = camera.vignetting(at(i));
            rgb.map(|radiance| f64::from(radiance) * transmission * exposure_s)
        };
        truth.radiance.iter().enumerate().flat_map(exposure).collect()
    }

    #[test]
    fn without_noise_a_level_is_the_response_to_the_true_exposure() {
        let options = Options { noise: false, ..small() };
        let mut camera = SimulatedCamera::new(Scene::patchwork(), options, rig_at(0.4, 0.5));
        let expected = exposures(&camera, 0.03);
        let levels = camera.levels(0.03);
        for (level, exposure) in levels.iter().zip(&expected) {
            assert!((f64::from(*level) - camera.response(*exposure)).abs() <= 0.5 + 1e-6);
        }
        assert!(levels.contains(&255) && levels.contains(&0), "clips at both ends");
        assert!(
            levels.iter().filter(|&&l| l > 20 && l < 250).count() > levels.len() / 10,
            "and measures between"
        );
    }

    #[test]
    fn noise_grows_with_the_signal_as_shot_and_read_noise_do() {
        let mut camera = SimulatedCamera::new(Scene::patchwork(), small(), rig_at(0.0, 0.2));
        let exposure_s = 0.01;
        let expected = exposures(&camera, exposure_s);
        let photographs: Vec<Vec<u8>> = (0..8).map(|_| camera.levels(exposure_s)).collect();
        // (sum of squares, of expected squares, count) for a dark and a bright range of exposures
        let mut ranges = [(0.02, 0.08, 0.0, 0.0, 0.0), (0.4, 0.8, 0.0, 0.0, 0.0)];
        for (i, exposure) in expected.iter().enumerate() {
            let full = exposure / FULL_EXPOSURE;
            for (low, high, squares, model, count) in &mut ranges {
                if (*low..*high).contains(&full) {
                    let slope = (response(exposure * 1.001) - response(exposure * 0.999)) / (full * 0.002);
                    let variance = (full * FULL_ELECTRONS + READ_ELECTRONS.powi(2)) / FULL_ELECTRONS.powi(2);
                    for photograph in &photographs {
                        let error = (f64::from(photograph[i]) - response(*exposure)) / slope;
                        *squares += error * error;
                        // Rounding to whole levels adds 1/12.
                        *model += variance + 1.0 / (12.0 * slope * slope);
                        *count += 1.0;
                    }
                }
            }
        }
        let [dark, bright] = ranges;
        assert!(dark.4 > 10_000.0 && bright.4 > 10_000.0, "{ranges:?}");
        for (_, _, squares, model, _) in ranges {
            assert!((squares / model - 1.0).abs() < 0.03, "{ranges:?}");
        }
        assert!(bright.2 / bright.4 > 4.0 * dark.2 / dark.4);
    }

    #[test]
    fn noise_differs_between_photographs_and_not_between_runs() {
        let take = |seed| {
            let options = Options { seed, ..small() };
            let mut camera = SimulatedCamera::new(Scene::one_lobe(), options, rig_at(0.1, 0.2));
            [camera.levels(0.01), camera.levels(0.01)]
        };
        let first = take(1);
        assert_ne!(first[0], first[1]);
        assert_eq!(first, take(1));
        assert_ne!(first[0], take(2)[0]);
    }

    #[test]
    fn a_bracket_renders_once_and_a_turned_rig_again() {
        let angle = Rc::new(Cell::new((0.0, 0.2)));
        let handle = angle.clone();
        let options = Options { noise: false, ..small() };
        let mut camera = SimulatedCamera::new(Scene::one_lobe(), options, move || handle.get());
        let before = camera.levels(0.01);
        assert_eq!(camera.levels(0.01), before);
        angle.set((0.3, 0.2));
        let turned = camera.levels(0.01);
        assert_ne!(turned, before);
        let mut fresh = SimulatedCamera::new(Scene::one_lobe(), options, rig_at(0.3, 0.2));
        assert_eq!(fresh.levels(0.01), turned);
    }

    #[test]
    fn the_edge_of_the_sampled_area_appears_where_the_lens_projects_it() {
        // The white frame's outer edge against the black frame, along all four sides: half of each in the picture.
        let camera = SimulatedCamera::new(Scene::one_lobe(), Options::default(), rig_at(0.3, 0.4));
        let (pose, lens) = (camera.pose(), *camera.lens());
        let truth = camera.truth(&pose);
        let sample = |pixel: DVec2| {
            let (base, f) = (pixel.floor(), pixel.fract());
            let at = |x: f64, y: f64| {
                f64::from(truth.radiance[(base.y + y) as usize * 320 + (base.x + x) as usize][1])
            };
            (at(0.0, 0.0) * (1.0 - f.x) + at(1.0, 0.0) * f.x) * (1.0 - f.y)
                + (at(0.0, 1.0) * (1.0 - f.x) + at(1.0, 1.0) * f.x) * f.y
        };
        let (half_x, half_y) = (0.104, 0.079);
        for side in [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y] {
            let along = DVec3::new(side.y, side.x, 0.0);
            let mean = (-60..=60)
                .map(|i| {
                    let edge = (side + along * f64::from(i) / 100.0) * DVec3::new(half_x, half_y, 0.0);
                    let at = |offset_m: f64| {
                        let point = edge + side * offset_m;
                        sample(lens.project(pose.to_camera(point)).unwrap())
                    };
                    let (inner, outer) = (at(-0.002), at(0.002));
                    (at(0.0) - outer) / (inner - outer)
                })
                .sum::<f64>()
                / 121.0;
            // A shift by 0.1 pixel would change this by 0.1.
            assert!((mean - 0.5).abs() < 0.05, "{side}: {mean}");
        }
    }

    #[test]
    fn the_truth_is_the_scene_s_radiance_where_it_varies_slowly() {
        let scene = Scene::patchwork();
        let camera = SimulatedCamera::new(scene.clone(), Options::default(), rig_at(-0.7, 0.6));
        let (pose, lens) = (camera.pose(), *camera.lens());
        let truth = camera.truth(&pose);
        let mut compared = 0;
        for x in -9..=9 {
            for y in -6..=6 {
                let point = DVec3::new(f64::from(x) * 0.01, f64::from(y) * 0.01 + 0.004, 0.0);
                let Some(pixel) = lens.project(pose.to_camera(point)) else { continue };
                let ray = pose.direction_to_surface(lens.unproject(pixel.round()).unwrap());
                let seen = scene.surface().intersect(pose.centre_m, ray).unwrap();
                if (point.x.abs() % 0.05).min(0.05 - point.x.abs() % 0.05) < 0.002 {
                    continue; // on the border of two patches
                }
                let expected = scene.radiance(seen, -ray);
                let got = truth.radiance[pixel.round().y as usize * 320 + pixel.round().x as usize];
                for c in 0..3 {
                    assert!(
                        (f64::from(got[c]) / expected[c] - 1.0).abs() < 0.02,
                        "{point}: {got:?} {expected:?}"
                    );
                }
                compared += 1;
            }
        }
        assert!(compared > 150);
    }

    #[test]
    fn a_photograph_is_a_file_that_tells_its_exposure_time() {
        let folder = tempfile::tempdir().unwrap();
        for jpeg_quality in [Some(95), None] {
            let options = Options { jpeg_quality, noise: false, ..small() };
            let mut camera = SimulatedCamera::new(Scene::patchwork(), options, rig_at(0.0, 0.3));
            let taken = camera.photograph(0.012_344, &folder.path().join("view.7")).unwrap().taken().unwrap();
            assert!((taken.exposure_s - 0.01234).abs() < 1e-9);
            let name = taken.file.file_name().unwrap().to_str().unwrap();
            assert_eq!(name, if jpeg_quality.is_some() { "view.7.jpg" } else { "view.7.png" });
            let told = exif::read(&taken.file).unwrap();
            assert!((told.exposure_s.unwrap() - taken.exposure_s).abs() < 1e-9);
            let picture = image::open(&taken.file).unwrap().to_rgb8();
            let mut again = SimulatedCamera::new(Scene::patchwork(), options, rig_at(0.0, 0.3));
            let levels = again.levels(taken.exposure_s);
            let worst: f64 =
                picture.iter().zip(&levels).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
            let rms = (worst / levels.len() as f64).sqrt();
            assert!(rms < if jpeg_quality.is_some() { 4.0 } else { 1e-9 }, "{rms}");
            assert!(fs::metadata(&taken.file).unwrap().len() < camera.file_size_bytes() + 1000);
        }
    }

    #[test]
    fn a_photograph_that_is_taken_again_is_the_same_again() {
        let folder = tempfile::tempdir().unwrap();
        let photograph = |camera: &mut SimulatedCamera<_>, name: &str| {
            let taken = camera.photograph(0.01, &folder.path().join(name)).unwrap().taken().unwrap();
            fs::read(taken.file).unwrap()
        };
        let mut camera = SimulatedCamera::new(Scene::patchwork(), small(), rig_at(0.0, 0.3));
        let first = photograph(&mut camera, "view000_1");
        assert_ne!(photograph(&mut camera, "view000_2"), first, "another one has other noise");
        assert_eq!(photograph(&mut camera, "view000_1"), first);
    }

    #[test]
    fn a_photograph_of_a_released_camera_tells_its_time_and_shows_its_exposure() {
        let folder = tempfile::tempdir().unwrap();
        let mean = |exposure_s: f64| {
            let path = folder.path().join(format!("{exposure_s}.jpg"));
            let at = SystemTime::UNIX_EPOCH + std::time::Duration::from_millis(1_790_000_000_250);
            write_photograph(&path, exposure_s, at).unwrap();
            let told = exif::read(&path).unwrap();
            assert!((told.exposure_s.unwrap() - exposure_s).abs() < 1e-6);
            assert!((told.taken.unwrap().clock_s - 1_790_000_000.25).abs() < 1e-6);
            let picture = image::open(path).unwrap().to_luma8();
            picture.iter().map(|&level| f64::from(level)).sum::<f64>() / picture.len() as f64
        };
        assert!(mean(0.002) < mean(0.004) && mean(0.004) < mean(0.008));
    }

    #[test]
    fn an_impossible_exposure_time_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut camera = SimulatedCamera::new(Scene::one_lobe(), small(), rig_at(0.0, 0.0));
        for exposure_s in [0.0, -1.0, 5.0, f64::NAN] {
            let error = camera.photograph(exposure_s, &folder.path().join("a")).unwrap_err();
            assert!(error.to_string().contains("choose a time"), "{error}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

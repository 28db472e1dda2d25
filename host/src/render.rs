//! Rendering on the processor: a surface whose radiance is known, seen through a lens from a pose.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use exr::prelude::{Encoding, Image, LineOrder, SpecificChannels, Vec2, WritableImage};
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use crate::file::write_beside;
use crate::geometry::{Lens, Pose, Surface};
use crate::progress::Progress;
use crate::{Error, Result};

/// A rendered photograph, row by row from the top-left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendering {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Linear RGB radiance in the session's unit; black outside the sampled area.
    pub radiance: Vec<[f32; 3]>,
    /// Whether the pixel's centre shows a point of the sampled area whose radiance is known.
    pub inside: Vec<bool>,
}

/// What a camera with `lens` at `pose` sees of `surface`: one ray through the centre of every pixel, distorted as the
/// lens distorts.
///
/// `radiance` is given a point of the surface (metres) and the unit vector from it to the camera, and returns linear RGB
/// radiance; where it returns something that is not finite, the pixel counts as outside. Runs on all cores; `progress`
/// counts rows.
///
/// # Errors
/// [`Error::Request`] when the picture has no pixels or the camera does not stand above the surface;
/// [`Error::Interrupted`] from `progress`.
pub fn render(
    surface: &Surface,
    lens: &Lens,
    pose: &Pose,
    radiance: impl Fn(DVec3, Vec3) -> [f32; 3] + Sync,
    progress: &dyn Progress,
) -> Result<Rendering> {
    if lens.width == 0 || lens.height == 0 {
        return Err(Error::request(
            format!("a picture of {}x{} pixels cannot be rendered", lens.width, lens.height),
            "give a lens whose picture has at least one pixel",
        ));
    }
    let height_m = pose.centre_m.z;
    if height_m.is_nan() || height_m <= 0.0 {
        return Err(Error::request(
            format!("the camera stands at z = {height_m} m, not above the surface"),
            "choose a pose with a positive z",
        ));
    }
    let (width, height) = (lens.width as usize, lens.height as usize);
    let to_surface = pose.camera_from_surface.inverse();
    let see = |column: usize, row: usize| {
        let ray = to_surface * lens.unproject(DVec2::new(column as f64, row as f64))?;
        let point_m = surface.intersect(pose.centre_m, ray).filter(|&point| surface.contains(point))?;
        let seen = radiance(point_m, (-ray).as_vec3());
        seen.iter().all(|value| value.is_finite()).then_some(seen)
    };
    let done = AtomicUsize::new(0);
    let mut pixels = vec![None; width * height];
    pixels.par_chunks_mut(width).enumerate().try_for_each(|(row, pixels)| {
        for (column, pixel) in pixels.iter_mut().enumerate() {
            *pixel = see(column, row);
        }
        progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, height)
    })?;
    Ok(Rendering {
        width: lens.width,
        height: lens.height,
        inside: pixels.iter().map(Option::is_some).collect(),
        radiance: pixels.into_iter().map(Option::unwrap_or_default).collect(),
    })
}

impl Rendering {
    /// Writes an 8-bit PNG of [`expose`]d radiance, `255 y` without an sRGB curve: the picture that is scored.
    ///
    /// # Errors
    /// [`Error::Request`] when `gamma` is not a positive number, [`Error::Io`] when the file cannot be written.
    pub fn write_png(&self, path: &Path, gamma: f32) -> Result<()> {
        let bytes = self.png(gamma)?;
        crate::file::write_bytes(path, &bytes)
    }

    /// The content of the file that [`Rendering::write_png`] writes.
    ///
    /// # Errors
    /// [`Error::Request`] when `gamma` is not a positive number.
    pub fn png(&self, gamma: f32) -> Result<Vec<u8>> {
        if !gamma.is_finite() || gamma <= 0.0 {
            return Err(Error::request(
                format!("a picture cannot be exposed with gamma = {gamma}"),
                "give a positive number, such as ln 2 / median radiance",
            ));
        }
        let level = |&radiance: &f32| (255.0 * expose(radiance, gamma)).round() as u8;
        let levels: Vec<u8> = self.radiance.as_flattened().iter().map(level).collect();
        png(self.width, self.height, &levels)
    }

    /// Writes an OpenEXR file with 32-bit channels R, G, B (radiance) and A: 1 inside, 0 outside.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn write_exr(&self, path: &Path) -> Result<()> {
        let (width, height) = (self.width as usize, self.height as usize);
        write_beside(path, |temporary| {
            let channels = SpecificChannels::rgba(|at: Vec2<usize>| {
                let index = at.y() * width + at.x();
                let [r, g, b] = self.radiance[index];
                (r, g, b, f32::from(u8::from(self.inside[index])))
            });
            // A fixed order: the same picture is the same file, however many threads compress it.
            let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::FAST_LOSSLESS };
            let image = Image::from_encoded_channels((width, height), encoding, channels);
            image.write().to_file(temporary).map_err(|error| match error {
                exr::error::Error::Io(source) => Error::io("write", path)(source),
                other => {
                    Error::input(path, format!("cannot be written ({other})"), "render a smaller picture")
                }
            })
        })
    }
}

/// The content of an 8-bit RGB PNG file: three levels a pixel, row by row from the top-left one.
///
/// # Errors
/// [`Error::Request`] when the levels are not those of `width` x `height` pixels.
pub fn png(width: u32, height: u32, levels: &[u8]) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image::write_buffer_with_format(
        &mut std::io::Cursor::new(&mut bytes),
        levels,
        width,
        height,
        image::ExtendedColorType::Rgb8,
        image::ImageFormat::Png,
    )
    .map_err(|error| {
        Error::request(
            format!("a PNG of {width}x{height} pixels cannot be made ({error})"),
            "render a smaller picture",
        )
    })?;
    Ok(bytes)
}

/// The brightness in 0..1 of a radiance, `1 - exp(-gamma radiance)`: nothing clips, and one `gamma` serves photograph and
/// rendering alike. Negative radiance, which a fit can yield, is black.
pub fn expose(radiance: f32, gamma: f32) -> f32 {
    1.0 - (-gamma * radiance.max(0.0)).exp()
}

/// The gamma with which the median of `values` (radiance, any order) becomes a brightness of one half: ln 2 / median.
///
/// # Errors
/// [`Error::Request`] when there are no values, one is not a number, or the median is not positive.
pub fn gamma_for_median(values: &[f32]) -> Result<f32> {
    let not_numbers = values.iter().filter(|value| value.is_nan()).count();
    if values.is_empty() || not_numbers > 0 {
        return Err(Error::request(
            format!(
                "the median of {} radiances, {not_numbers} of them not a number, is unknown",
                values.len()
            ),
            "give the radiance of the measured pixels only",
        ));
    }
    let mut values = values.to_vec();
    let middle = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(middle, f32::total_cmp);
    let lower = if even { below.iter().copied().fold(f32::MIN, f32::max) } else { upper };
    let median = (lower + upper) / 2.0;
    if median <= 0.0 || median.is_infinite() {
        return Err(Error::request(
            format!("the median radiance is {median}"),
            "give the radiance of pixels that show the surface, or choose an exposure yourself",
        ));
    }
    Ok(std::f32::consts::LN_2 / median)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::unit_vector;
    use crate::progress::Silent;

    const SURFACE: Surface = Surface { width_m: 0.2, height_m: 0.15 };

    fn lens() -> Lens {
        Lens { k1: -0.5, k2: 0.6, p1: -4e-4, p2: 5e-4, ..Lens::pinhole(160, 120, 350.0) }
    }

    /// The point itself as a colour, so that a picture tells what every pixel saw.
    fn position(point_m: DVec3, _: Vec3) -> [f32; 3] {
        [point_m.x as f32, point_m.y as f32, 1.0]
    }

    #[test]
    fn a_pixel_shows_the_point_that_projects_onto_it() {
        let (lens, pose) = (lens(), Pose::from_rig(0.6, 0.8, 0.9));
        let picture = render(&SURFACE, &lens, &pose, position, &Silent).unwrap();
        let mut inside = 0;
        for (i, rgb) in picture.radiance.iter().enumerate().filter(|(i, _)| picture.inside[*i]) {
            let point = DVec3::new(f64::from(rgb[0]), f64::from(rgb[1]), 0.0);
            let pixel = lens.project(pose.to_camera(point)).unwrap();
            let expected = DVec2::new((i % 160) as f64, (i / 160) as f64);
            assert!((pixel - expected).length() < 1e-4, "{pixel} {expected}");
            inside += 1;
        }
        // The area of the projected rectangle, without distortion.
        let expected = 0.2 * 0.15 * 0.8f64.cos() * (350.0f64 / 0.9).powi(2);
        assert!((f64::from(inside) / expected - 1.0).abs() < 0.05, "{inside} {expected}");
    }

    #[test]
    fn outside_is_black_and_marked() {
        let picture = render(&SURFACE, &lens(), &Pose::from_rig(0.0, 0.0, 0.9), position, &Silent).unwrap();
        assert!(!picture.inside[0] && picture.inside[60 * 160 + 80]);
        for (rgb, inside) in picture.radiance.iter().zip(&picture.inside) {
            assert_eq!(rgb[2], if *inside { 1.0 } else { 0.0 });
        }
    }

    #[test]
    fn the_direction_is_the_one_from_the_point_to_the_camera() {
        let pose = Pose::from_rig(0.3, 0.5, 0.9);
        let check = |point_m: DVec3, direction: Vec3| {
            let expected = (pose.centre_m - point_m).normalize().as_vec3();
            [(direction - expected).length(), direction.length(), 0.0]
        };
        let picture = render(&SURFACE, &lens(), &pose, check, &Silent).unwrap();
        for (rgb, _) in picture.radiance.iter().zip(&picture.inside).filter(|(_, inside)| **inside) {
            assert!(rgb[0] < 1e-6 && (rgb[1] - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_is_not_finite_counts_as_outside() {
        let hole = |point_m: DVec3, _: Vec3| if point_m.x > 0.0 { [f32::NAN; 3] } else { [1.0; 3] };
        let picture = render(&SURFACE, &lens(), &Pose::from_rig(0.0, 0.0, 0.9), hole, &Silent).unwrap();
        assert!(picture.inside[60 * 160 + 75] && !picture.inside[60 * 160 + 85]);
        assert!(picture.radiance.as_flattened().iter().all(|value| value.is_finite()));
    }

    #[test]
    fn impossible_requests_say_what_to_do() {
        let below = Pose { centre_m: -unit_vector(0.0, 0.3), ..Pose::from_rig(0.0, 0.3, 1.0) };
        let error = render(&SURFACE, &lens(), &below, position, &Silent).unwrap_err();
        assert!(error.to_string().contains("positive z"), "{error}");
        let empty = Lens { width: 0, ..lens() };
        assert!(render(&SURFACE, &empty, &Pose::from_rig(0.0, 0.0, 1.0), position, &Silent).is_err());
        assert!(gamma_for_median(&[]).is_err());
        assert!(gamma_for_median(&[1.0, f32::NAN]).is_err());
        assert!(gamma_for_median(&[0.0, 0.0, 1.0]).is_err());
    }

    #[test]
    fn an_interrupted_rendering_stops() {
        struct Stop;
        impl Progress for Stop {
            fn step(&self, done: usize, total: usize) -> Result<()> {
                assert!(done <= total && total == 120);
                if done > 3 { Err(Error::Interrupted) } else { Ok(()) }
            }
        }
        let stopped = render(&SURFACE, &lens(), &Pose::from_rig(0.0, 0.0, 0.9), position, &Stop);
        assert!(matches!(stopped, Err(Error::Interrupted)));
    }

    #[test]
    fn the_median_becomes_one_half() {
        for values in [vec![5.0, 1.0, 2.0], vec![4.0, 1.0, 100.0, 3.0]] {
            let gamma = gamma_for_median(&values).unwrap();
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            let median = (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]) / 2.0;
            assert!((expose(median, gamma) - 0.5).abs() < 1e-6);
        }
        assert_eq!((expose(-1.0, 2.0), expose(0.0, 2.0), expose(f32::INFINITY, 2.0)), (0.0, 0.0, 1.0));
    }

    #[test]
    fn files_hold_what_was_rendered() {
        let folder = tempfile::tempdir().unwrap();
        let colour = |point_m: DVec3, _: Vec3| [0.3 + point_m.x as f32, 0.7, 2.0];
        let picture = render(&SURFACE, &lens(), &Pose::from_rig(0.0, 0.4, 0.9), colour, &Silent).unwrap();
        let (exr, png) = (folder.path().join("a.exr"), folder.path().join("a.png"));
        picture.write_exr(&exr).unwrap();
        picture.write_png(&png, 1.5).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "no temporary file stays");
        let levels = image::open(&png).unwrap().to_rgb8();
        for (i, pixel) in levels.pixels().enumerate() {
            let expected = picture.radiance[i].map(|x| (255.0 * (1.0 - (-1.5 * x).exp())).round() as u8);
            assert_eq!(pixel.0, expected);
        }
        let read = exr::prelude::read_first_rgba_layer_from_file(
            &exr,
            |size, _| vec![[0.0f32; 4]; size.area()],
            |pixels, at, (r, g, b, a): (f32, f32, f32, f32)| pixels[at.y() * 160 + at.x()] = [r, g, b, a],
        )
        .unwrap();
        for (i, [r, g, b, a]) in read.layer_data.channel_data.pixels.iter().enumerate() {
            assert_eq!(([*r, *g, *b], *a == 1.0), (picture.radiance[i], picture.inside[i]));
        }
        assert!(picture.png(0.0).is_err() && picture.png(f32::NAN).is_err());
        let nowhere = folder.path().join("missing/a.exr");
        assert!(matches!(picture.write_exr(&nowhere), Err(Error::Io { .. })));
    }
}

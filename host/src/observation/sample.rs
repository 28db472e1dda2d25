//! What one view's radiance picture says of one texel.

use glam::{DVec2, DVec3, Vec2};

use super::place::PlaceError;
use crate::geometry::{Lens, Pose, Surface, Texels};
use crate::radiance::RadianceImage;

/// A texel that covers many pixels is averaged over at most this many positions along each side.
const MOST_POSITIONS: u32 = 8;

/// Radiance and its standard deviation (root mean square over the channels).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Linear RGB.
    pub radiance: [f32; 3],
    /// Same unit.
    pub sigma: f32,
}

/// One view, ready to be asked for texels.
pub(super) struct ViewSampler<'a> {
    pub image: &'a RadianceImage,
    pub lens: &'a Lens,
    pub pose: &'a Pose,
    /// How far texels may appear from where the pose puts them, where that is known.
    pub place: Option<&'a PlaceError>,
    pub surface: Surface,
    pub texels: Texels,
}

impl ViewSampler<'_> {
    /// The texel's radiance: bilinear in the distorted photograph, averaged over the texel where it covers several pixels
    /// (else fine texture would alias). `None` where any of it was not measured (see [`measured`]), is outside the picture, or is seen from behind.
    ///
    /// Its variance is that of the pixels plus that of the registration: the gradient of the radiance times the error of the place.
    pub fn sample(&self, column: u32, row: u32) -> Option<Sample> {
        let centre = self.surface.texel_centre(self.texels, column, row);
        if self.pose.centre_m.z <= 0.0 {
            return None;
        }
        let (half_x, half_y) = (
            DVec3::X * self.surface.width_m / f64::from(self.texels.columns) / 2.0,
            DVec3::Y * self.surface.height_m / f64::from(self.texels.rows) / 2.0,
        );
        let count = |half: DVec3| {
            let (a, b) = (self.project(centre - half)?, self.project(centre + half)?);
            Some((a.distance(b).round() as u32).clamp(1, MOST_POSITIONS))
        };
        let (nx, ny) = (count(half_x)?, count(half_y)?);
        let (mut radiance, mut variance, mut gradient) = ([0.0; 3], 0.0, [Vec2::ZERO; 3]);
        for j in 0..ny {
            for i in 0..nx {
                let offset = half_x * ((2 * i + 1) as f64 / f64::from(nx) - 1.0)
                    + half_y * ((2 * j + 1) as f64 / f64::from(ny) - 1.0);
                let between = bilinear(self.image, self.project(centre + offset)?)?;
                for channel in 0..3 {
                    radiance[channel] += between.radiance[channel];
                    gradient[channel] += between.gradient[channel];
                }
                variance += between.variance;
            }
        }
        let n = (nx * ny) as f32;
        // The positions are about a pixel apart, so their errors are nearly independent.
        let noise = variance / (n * n);
        let blur = match self.place {
            None => 0.0,
            Some(place) => {
                let [xx, xy, yy] = place.at(self.texels, column, row)?;
                // As the noise, the mean over the channels.
                let of = |sum: Vec2| {
                    let g = sum / n;
                    g.x * g.x * xx + 2.0 * g.x * g.y * xy + g.y * g.y * yy
                };
                gradient.map(of).iter().sum::<f32>() / 3.0
            }
        };
        Some(Sample { radiance: radiance.map(|sum| sum / n), sigma: (noise + blur.max(0.0)).sqrt() })
    }

    fn project(&self, point_m: DVec3) -> Option<DVec2> {
        self.lens.project(self.pose.to_camera(point_m))
    }
}

/// What lies between four pixels.
struct Between {
    radiance: [f32; 3],
    /// Mean over the channels.
    variance: f32,
    /// Per channel, by the pixel.
    gradient: [Vec2; 3],
}

/// The picture between four pixels; `None` unless all four were measured.
fn bilinear(image: &RadianceImage, pixel: DVec2) -> Option<Between> {
    let (x, y) = (pixel.x.floor(), pixel.y.floor());
    if x < 0.0 || y < 0.0 || x + 1.0 >= f64::from(image.width) || y + 1.0 >= f64::from(image.height) {
        return None;
    }
    let (fx, fy) = ((pixel.x - x) as f32, (pixel.y - y) as f32);
    let first = y as usize * image.width as usize + x as usize;
    let below = first + image.width as usize;
    let mut between = Between { radiance: [0.0; 3], variance: 0.0, gradient: [Vec2::ZERO; 3] };
    for (index, weight, slope) in [
        (first, (1.0 - fx) * (1.0 - fy), Vec2::new(fy - 1.0, fx - 1.0)),
        (first + 1, fx * (1.0 - fy), Vec2::new(1.0 - fy, -fx)),
        (below, (1.0 - fx) * fy, Vec2::new(-fy, 1.0 - fx)),
        (below + 1, fx * fy, Vec2::new(fy, fx)),
    ] {
        let (pixel, pixel_variance) = measured(image, index)?;
        for channel in 0..3 {
            between.radiance[channel] += weight * pixel[channel];
            between.gradient[channel] += slope * pixel[channel];
            between.variance += weight * weight * pixel_variance[channel] / 3.0;
        }
    }
    Some(between)
}

/// Radiance and variance of a pixel; `None` where it was not measured.
///
/// A channel that was too dark is known all the same: it lies between 0 and its bound, evenly for all we know. Orange
/// wood has next to no blue, and would else be absent. A pixel too dark in every channel may be no surface at all (a
/// border shifted in) and stays absent.
fn measured(image: &RadianceImage, index: usize) -> Option<([f32; 3], [f32; 3])> {
    let (mut radiance, mut variance) = (image.radiance[index], image.variance[index]);
    // What moved between the photographs counts where most of them agree.
    match image.mask[index] & !RadianceImage::GHOST {
        0 if variance.iter().all(|v| v.is_finite()) => {}
        RadianceImage::DARK if variance.iter().any(|v| v.is_finite()) => {
            for (value, spread) in radiance.iter_mut().zip(&mut variance).filter(|(_, v)| !v.is_finite()) {
                *spread = *value * *value / 12.0;
                *value /= 2.0;
            }
        }
        _ => return None,
    }
    Some((radiance, variance))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SURFACE: Surface = Surface { width_m: 0.2, height_m: 0.15 };

    /// A picture whose radiance grows linearly with the pixel.
    fn ramp() -> RadianceImage {
        let (width, height) = (64, 48);
        let pixels = (0..width * height).map(|i| ((i % width) as f32, (i / width) as f32));
        RadianceImage {
            width,
            height,
            radiance: pixels.map(|(x, y)| [x, y, 1.0]).collect(),
            variance: vec![[0.04; 3]; (width * height) as usize],
            mask: vec![0; (width * height) as usize],
        }
    }

    fn sampler<'a>(
        image: &'a RadianceImage,
        lens: &'a Lens,
        pose: &'a Pose,
        columns: u32,
    ) -> ViewSampler<'a> {
        let texels = Texels { columns, rows: columns * 3 / 4 };
        ViewSampler { image, lens, pose, place: None, surface: SURFACE, texels }
    }

    #[test]
    fn a_linear_picture_is_sampled_exactly_at_any_resolution() {
        let (image, lens) = (ramp(), Lens { k1: -0.1, ..Lens::pinhole(64, 48, 200.0) });
        let pose = Pose::from_rig(0.3, 0.0, 0.9);
        for columns in [4, 32, 256] {
            let sampler = sampler(&image, &lens, &pose, columns);
            for (column, row) in [(0, 0), (columns / 2, columns / 4), (columns - 1, columns * 3 / 4 - 1)] {
                let expected = sampler.project(SURFACE.texel_centre(sampler.texels, column, row)).unwrap();
                let sample = sampler.sample(column, row).unwrap();
                // A coarse texel averages over a distorted patch: its mean is not its centre exactly.
                let slack = if columns == 4 { 0.1 } else { 1e-3 };
                assert!(
                    (sample.radiance[0] - expected.x as f32).abs() < slack,
                    "{columns} {sample:?} {expected}"
                );
                assert!(
                    (sample.radiance[1] - expected.y as f32).abs() < slack,
                    "{columns} {sample:?} {expected}"
                );
            }
        }
    }

    #[test]
    fn averaging_lowers_the_variance() {
        let (image, lens, pose) = (ramp(), Lens::pinhole(64, 48, 200.0), Pose::from_rig(0.0, 0.0, 0.9));
        let fine = sampler(&image, &lens, &pose, 256).sample(128, 96).unwrap();
        let coarse = sampler(&image, &lens, &pose, 4).sample(2, 1).unwrap();
        assert!(
            fine.sigma <= 0.2 + 1e-6 && coarse.sigma < fine.sigma / 3.0,
            "{} {}",
            fine.sigma,
            coarse.sigma
        );
    }

    #[test]
    fn an_uncertain_place_blurs_where_the_radiance_has_a_gradient() {
        let (mut image, lens, pose) = (ramp(), Lens::pinhole(64, 48, 200.0), Pose::from_rig(0.0, 0.0, 0.9));
        image.variance.fill([0.0; 3]);
        // Red grows with x by 1 for each pixel, green with y, blue not at all.
        let place = PlaceError::constant([0.09, 0.02, 0.25]);
        for columns in [8, 64] {
            let sampler = ViewSampler { place: Some(&place), ..sampler(&image, &lens, &pose, columns) };
            let sample = sampler.sample(columns / 2, columns / 3).unwrap();
            assert!((sample.sigma.powi(2) - (0.09 + 0.25) / 3.0).abs() < 1e-4, "{sample:?}");
        }
    }

    #[test]
    fn a_masked_pixel_makes_its_texels_absent_and_no_others() {
        let (mut image, lens, pose) = (ramp(), Lens::pinhole(64, 48, 200.0), Pose::from_rig(0.0, 0.0, 0.9));
        image.mask[24 * 64 + 32] = RadianceImage::SATURATED;
        let sampler = sampler(&image, &lens, &pose, 64);
        let mut absent = 0;
        for row in 0..48 {
            for column in 0..64 {
                let at = sampler.project(SURFACE.texel_centre(sampler.texels, column, row)).unwrap();
                let near = (at - DVec2::new(32.0, 24.0)).abs().max_element() < 1.0;
                assert_eq!(sampler.sample(column, row).is_none(), near, "{column} {row} {at}");
                absent += usize::from(near);
            }
        }
        assert!(absent > 0);
    }

    #[test]
    fn a_dark_channel_is_half_its_bound_and_a_pixel_of_dark_channels_is_absent() {
        let (mut image, lens, pose) = (ramp(), Lens::pinhole(64, 48, 200.0), Pose::from_rig(0.0, 0.0, 0.9));
        image.mask.fill(RadianceImage::DARK);
        image.variance.fill([0.04, 0.04, f32::INFINITY]);
        let sample = sampler(&image, &lens, &pose, 64).sample(32, 24).unwrap();
        assert!((sample.radiance[2] - 0.5).abs() < 1e-6 && sample.radiance[0] > 1.0, "{sample:?}");
        assert!(sample.sigma > 0.1 && sample.sigma < 0.3, "{sample:?}");
        image.variance.fill([f32::INFINITY; 3]);
        assert_eq!(sampler(&image, &lens, &pose, 64).sample(32, 24), None);
    }

    #[test]
    fn outside_the_picture_and_behind_the_surface_is_absent() {
        let (image, lens) = (ramp(), Lens::pinhole(64, 48, 2000.0));
        let pose = Pose::from_rig(0.0, 0.0, 0.9);
        assert_eq!(sampler(&image, &lens, &pose, 64).sample(0, 0), None);
        let lens = Lens::pinhole(64, 48, 200.0);
        let below = Pose::from_rig(0.0, 2.0, 0.9);
        assert_eq!(sampler(&image, &lens, &below, 64).sample(32, 24), None);
    }
}

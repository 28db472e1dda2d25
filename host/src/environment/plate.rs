//! A photograph made ready to be put on the sphere: radiance of every pixel, how far it counts, and where the camera looked.

use glam::DQuat;

use super::pages::zeros;
use super::reduce::{reduce, spline_coefficients};
use super::warp::{Border, Filter, View};
use crate::geometry::{LatLong, Lens};
use crate::{Error, Result};

/// A picture is made smaller where its pixels lie closer than the map's by more than this factor, so that nothing is aliased.
const WORTH_REDUCING: f64 = 1.2;

/// The variance of a pixel's radiance L: `constant + linear L + square L²`, in the square of the radiance's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// What is there in the dark.
    pub constant: f32,
    /// Shot noise.
    pub linear: f32,
    /// A relative error.
    pub square: f32,
}

impl Noise {
    /// Every pixel counts the same.
    pub const EVEN: Self = Self { constant: 1.0, linear: 0.0, square: 0.0 };

    /// The variance at a radiance.
    #[inline(always)]
    pub(super) fn variance(&self, radiance: f32) -> f32 {
        let radiance = radiance.max(0.0);
        self.constant + radiance * (self.linear + radiance * self.square)
    }
}

/// One photograph's radiance with its lens and orientation. Pixels are held as validity times radiance and validity, which is 1
/// where a pixel was measured and next to nothing where its radiance is only a lower bound: what was not measured does not spoil what
/// was by interpolation.
pub struct Plate {
    pub(super) view: View,
    pub(super) noise: Noise,
    /// Columns between the beginnings of two rows of `pixels`, which has [`BORDER`] more pixels on every side.
    pub(super) stride: usize,
    pub(super) pixels: Vec<[f32; 4]>,
    filter: Filter,
}

/// Pixels repeated on every side, so that no filter reaches beyond.
pub(super) const BORDER: usize = 3;

impl Plate {
    /// A plate for a map of `sphere`'s size. `pixel` says red, green, blue and validity (0 to 1) of each of the lens's pixels, counted row by row from the top left; `world_from_camera` takes the camera frame (x right, y down, z forward) to the world. A photograph that is finer
    /// than the map is made as small as the map needs.
    ///
    /// # Errors
    /// [`Error::Request`] where the pixels are not as many as the lens says, or the lens folds the picture over itself.
    pub fn new(
        sphere: LatLong,
        lens: &Lens,
        world_from_camera: DQuat,
        pixel: impl Fn(usize) -> [f32; 4],
        noise: Noise,
        filter: Filter,
    ) -> Result<Self> {
        let (width, height) = (lens.width as usize, lens.height as usize);
        if width < 2 || height < 2 {
            return Err(Error::request(format!("a picture of {width}x{height} pixels"), "give a larger one"));
        }
        let weighed = |i: usize| {
            let [r, g, b, valid] = pixel(i);
            [r * valid, g * valid, b * valid, valid]
        };
        let border = Border::new(lens)?;
        let finer = border.pixels_per_radian(lens) * std::f64::consts::PI / sphere.height() as f64;
        let mut lens = *lens;
        let pixels = if finer > WORTH_REDUCING {
            let smaller = |pixels: u32| ((f64::from(pixels) / finer).round() as u32).max(2);
            lens = lens.scaled_to(smaller(lens.width), smaller(lens.height));
            let pixels: Vec<[f32; 4]> = (0..width * height).map(weighed).collect();
            let size = (lens.width as usize, lens.height as usize);
            let pixels = reduce(&pixels, (width, height), size);
            padded(size, filter, |i| pixels[i])
        } else {
            padded((width, height), filter, weighed)
        };
        let stride = lens.width as usize + 2 * BORDER;
        Ok(Self { view: View::new(&lens, world_from_camera, border), noise, stride, pixels, filter })
    }

    /// How it is looked at between its pixels.
    pub fn filter(&self) -> Filter {
        self.filter
    }
}

/// A picture with its border repeated; for the spline its coefficients, which are mirrored there.
fn padded(
    (width, height): (usize, usize),
    filter: Filter,
    pixel: impl Fn(usize) -> [f32; 4],
) -> Vec<[f32; 4]> {
    if filter != Filter::Spline {
        return bordered((width, height), pixel);
    }
    let mut coefficients: Vec<[f32; 4]> = (0..width * height).map(pixel).collect();
    spline_coefficients(&mut coefficients, width);
    bordered((width, height), |i| coefficients[i])
}

fn bordered((width, height): (usize, usize), pixel: impl Fn(usize) -> [f32; 4]) -> Vec<[f32; 4]> {
    let stride = width + 2 * BORDER;
    let mut pixels = zeros(stride * (height + 2 * BORDER));
    let rows = BORDER * stride..(BORDER + height) * stride;
    for (row, line) in pixels[rows].chunks_exact_mut(stride).enumerate() {
        let numbers = row * width..(row + 1) * width;
        line[BORDER..].iter_mut().zip(numbers).for_each(|(to, i)| *to = pixel(i));
        let (left, right) = (line[BORDER], line[BORDER + width - 1]);
        line[..BORDER].fill(left);
        line[BORDER + width..].fill(right);
    }
    for row in 0..BORDER {
        pixels.copy_within(stride * BORDER..stride * (BORDER + 1), stride * row);
        let last = BORDER + height - 1;
        pixels.copy_within(stride * last..stride * (last + 1), stride * (last + 1 + row));
    }
    pixels
}

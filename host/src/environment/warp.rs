//! The inverse map: which pixel of a photograph every pixel of a latitude-longitude map sees, row by row, and the filters between them.
//!
//! In one row of the map the direction is (sin longitude cos latitude, sin latitude, cos longitude cos latitude), so each camera
//! coordinate is a sum of a sine, a cosine and a constant: exact, with two multiplications per coordinate and pixel. The columns
//! that the photograph can cover lie between four planes through the camera, which cut a row in arcs.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use glam::{DMat3, DQuat, DVec2, DVec3};
use multiversion::multiversion;

use super::plate::{BORDER, Plate};
use crate::geometry::{LatLong, Lens};
use crate::{Error, Result};

/// So many pixels are worked on at once.
pub(super) const CHUNK: usize = 64;

/// How a photograph is looked at between its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Filter {
    /// The nearest pixel.
    Nearest,
    /// Linear between four pixels.
    Bilinear,
    /// Cubic convolution over 16 pixels (Keys, "Cubic convolution interpolation for digital image processing", IEEE Transactions
    /// on Acoustics, Speech and Signal Processing 1981, equation 15).
    Bicubic,
    /// The cubic spline through the pixels.
    Spline,
}

/// Sines and cosines of a map's longitudes, which all rows share. Towards the poles, where a map's columns crowd, only
/// every second, fourth, ... is looked at, so that those left are still closer than at the equator by two thirds; those between follow from them.
pub struct Sphere {
    pub(super) size: LatLong,
    levels: Vec<[Vec<f32>; 2]>,
}

impl Sphere {
    /// The table for a map of this size.
    pub fn new(size: LatLong) -> Self {
        let level = |level: u32| {
            let width = size.width() >> level;
            let angles = (0..width).map(|column| PI - TAU * (column as f64 + 0.5) / width as f64);
            let (sin, cos) = angles.map(|angle| (angle.sin() as f32, angle.cos() as f32)).unzip();
            [sin, cos]
        };
        let most = size.width().trailing_zeros().min(8);
        Self { size, levels: (0..=most).map(level).collect() }
    }

    /// How often the columns of these rows may be halved.
    pub(super) fn level(&self, rows: &Range<usize>) -> usize {
        let part = |row: usize| self.size.latitude(row as f64).cos();
        let widest = if rows.contains(&(self.size.height() / 2)) {
            1.0
        } else {
            part(rows.start).max(part(rows.end - 1))
        };
        ((0.6 / widest).log2().max(0.0) as usize).min(self.levels.len() - 1)
    }

    /// How many columns are left at a level.
    pub(super) fn width(&self, level: usize) -> usize {
        self.levels[level][0].len()
    }
}

/// What a picture's border encloses, on the plane at distance 1 before the camera, without the distortion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Border {
    least: DVec2,
    most: DVec2,
    /// The largest squared distance from the axis.
    radius2: f64,
}

impl Border {
    /// # Errors
    /// [`Error::Request`] where a pixel of the border is not where any direction projects.
    pub(super) fn new(lens: &Lens) -> Result<Self> {
        let (right, bottom) = (f64::from(lens.width - 1), f64::from(lens.height - 1));
        let mut border = Self { least: DVec2::INFINITY, most: DVec2::NEG_INFINITY, radius2: 0.0 };
        const STEPS: u32 = 64;
        for i in 0..=STEPS {
            let part = f64::from(i) / f64::from(STEPS);
            for pixel in [
                DVec2::new(part * right, 0.0),
                DVec2::new(part * right, bottom),
                DVec2::new(0.0, part * bottom),
                DVec2::new(right, part * bottom),
            ] {
                let direction = lens.unproject(pixel).ok_or_else(|| {
                    Error::request(
                        format!("the lens's distortion has no direction for the pixel ({:.0}, {:.0}) of its picture", pixel.x, pixel.y),
                        "calibrate the lens with boards that reach the corners of the picture",
                    )
                })?;
                let at = direction.truncate() / direction.z;
                border.least = border.least.min(at);
                border.most = border.most.max(at);
                border.radius2 = border.radius2.max(at.length_squared());
            }
        }
        Ok(border)
    }

    /// How many pixels of the picture a radian has, between its middle and its corners.
    pub(super) fn pixels_per_radian(&self, lens: &Lens) -> f64 {
        // Seen from the centre the plane's pixels shrink with 1 + r² along the radius and with its root across.
        (lens.fx * lens.fy).sqrt() * (1.0 + self.radius2 / 3.0).powf(0.75)
    }
}

/// A camera as the inverse map needs it.
pub(super) struct View {
    lens: Lens,
    camera_from_world: DMat3,
    border: Border,
    /// The planes that enclose what is seen, as vectors of the camera frame that point inside.
    planes: [DVec3; 4],
}

/// What a chunk of a row sees: where in the picture, and how far from its border.
pub(super) struct Places {
    x: [f32; CHUNK],
    y: [f32; CHUNK],
    /// 0 at the border and outside, 1 in the middle.
    pub feather: [f32; CHUNK],
}

impl Places {
    pub(super) const NONE: Self = Self { x: [0.0; CHUNK], y: [0.0; CHUNK], feather: [0.0; CHUNK] };
}

impl View {
    pub(super) fn new(lens: &Lens, world_from_camera: DQuat, border: Border) -> Self {
        let Border { least, most, .. } = border;
        // A hair wider, so that rounding loses no pixel.
        let (least, most) = (least - 1e-6, most + 1e-6);
        Self {
            lens: *lens,
            camera_from_world: DMat3::from_quat(world_from_camera.inverse()),
            border,
            planes: [
                DVec3::new(1.0, 0.0, -least.x),
                DVec3::new(-1.0, 0.0, most.x),
                DVec3::new(0.0, 1.0, -least.y),
                DVec3::new(0.0, -1.0, most.y),
            ],
        }
    }

    /// The rows of a map that the picture may cover.
    pub(super) fn rows(&self, size: LatLong) -> Range<usize> {
        let axis = self.camera_from_world.transpose() * DVec3::Z;
        let (latitude, reach) = (axis.y.clamp(-1.0, 1.0).asin(), self.border.radius2.sqrt().atan());
        let row =
            |latitude: f64| ((0.5 - latitude / PI) * size.height() as f64).clamp(0.0, size.height() as f64);
        (row(latitude + reach) as usize)..(row(latitude - reach).ceil() as usize)
    }

    /// Where the pixels of a part of a row are seen.
    fn places(
        &self,
        sphere: &Sphere,
        (row, level, columns): (usize, usize, Range<usize>),
        places: &mut Places,
    ) {
        let (up, horizontal) = sphere.size.latitude(row as f64).sin_cos();
        let camera = self.camera_from_world;
        let coordinate = |i: usize| {
            let axis = camera.row(i);
            [axis.x * horizontal, axis.z * horizontal, axis.y * up].map(|factor| factor as f32)
        };
        let lens = &self.lens;
        let numbers = lens.numbers().map(|number| number as f32);
        let straight = numbers[4..] == [0.0; 5];
        let size = [(lens.width - 1) as f32, (lens.height - 1) as f32];
        let [sin, cos] = &sphere.levels[level];
        find(
            [coordinate(0), coordinate(1), coordinate(2)],
            (&sin[columns.clone()], &cos[columns]),
            (numbers, straight, self.border.radius2 as f32 * 1.0001),
            size,
            places,
        );
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn find(
    [x, y, z]: [[f32; 3]; 3],
    (sin, cos): (&[f32], &[f32]),
    ([fx, fy, cx, cy, k1, k2, p1, p2, k3], straight, radius2): ([f32; 9], bool, f32),
    [right, bottom]: [f32; 2],
    places: &mut Places,
) {
    let scale = [2.0 / right, 2.0 / bottom];
    let outputs = places.x.iter_mut().zip(&mut places.y).zip(&mut places.feather);
    for (((px, py), feather), (sin, cos)) in outputs.zip(sin.iter().zip(cos)) {
        let depth = z[0].mul_add(*sin, z[1].mul_add(*cos, z[2]));
        let inverse = 1.0 / depth;
        let mut u = x[0].mul_add(*sin, x[1].mul_add(*cos, x[2])) * inverse;
        let mut v = y[0].mul_add(*sin, y[1].mul_add(*cos, y[2])) * inverse;
        let r2 = u * u + v * v;
        if !straight {
            let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
            let du = 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u);
            let dv = p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v;
            u = u * radial + du;
            v = v * radial + dv;
        }
        let (at_x, at_y) = (fx * u + cx, fy * v + cy);
        let (to_x, to_y) = (at_x.min(right - at_x), at_y.min(bottom - at_y));
        let inside = depth > 0.0 && r2 <= radius2 && to_x >= 0.0 && to_y >= 0.0;
        *px = if inside { at_x } else { 0.0 };
        *py = if inside { at_y } else { 0.0 };
        // Never quite 0 inside: what a single photograph shows at its border is better than nothing.
        *feather = if inside { (to_x * scale[0] * (to_y * scale[1])).max(1e-3) } else { 0.0 };
    }
}

/// The columns of a row of `width` where all planes say inside: arcs on a circle, as half-open ranges of columns.
pub(super) fn columns(view: &View, size: LatLong, row: usize, width: usize) -> Vec<(usize, usize)> {
    let mut arcs = vec![(0, width)];
    let (up, level) = size.latitude(row as f64).sin_cos();
    let world_from_camera = view.camera_from_world.transpose();
    for plane in view.planes {
        // normal · direction = level |horizontal| cos(longitude - towards) + up normal.y, which must not be negative.
        let normal = world_from_camera * plane;
        let horizontal = level * normal.x.hypot(normal.z);
        let (constant, towards) = (up * normal.y, normal.x.atan2(normal.z));
        if constant >= horizontal {
            continue;
        }
        if constant <= -horizontal {
            return vec![];
        }
        let half = (-constant / horizontal).acos();
        // Longitude falls with the column.
        let column = |longitude: f64| (PI - longitude) / TAU * width as f64 - 0.5;
        let first = column(towards + half).floor();
        let count = ((column(towards - half).ceil() - first) as usize + 1).min(width);
        let first = first.rem_euclid(width as f64) as usize % width;
        let end = first + count;
        let pieces = if end > width { [(0, end - width), (first, width)] } else { [(first, end), (0, 0)] };
        let before = std::mem::take(&mut arcs);
        for (a, b) in before {
            for (c, d) in pieces {
                if a.max(c) < b.min(d) {
                    arcs.push((a.max(c), b.min(d)));
                }
            }
        }
    }
    arcs.sort_unstable();
    arcs.dedup_by(|next, before| {
        let joined = next.0 <= before.1;
        if joined {
            before.1 = before.1.max(next.1);
        }
        joined
    });
    arcs
}

/// What pixels see in a plate, those of a row (at a level of [`Sphere`]) in a range of at most [`CHUNK`] columns: validity times red, green and blue, and validity; `places.feather` is 0 where
/// they see nothing of it.
pub(super) fn look(
    plate: &Plate,
    sphere: &Sphere,
    (row, level, columns): (usize, usize, Range<usize>),
    places: &mut Places,
    seen: &mut [[f32; 4]; CHUNK],
) {
    let count = columns.len();
    for unused in [&mut places.x, &mut places.y, &mut places.feather] {
        unused[count..].fill(0.0);
    }
    plate.view.places(sphere, (row, level, columns), places);
    sample(plate.filter(), &plate.pixels, plate.stride, places, &mut seen[..count]);
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn sample(filter: Filter, pixels: &[[f32; 4]], stride: usize, places: &Places, seen: &mut [[f32; 4]]) {
    match filter {
        Filter::Nearest => gather::<1, false>(pixels, stride, places, seen, |_| [1.0]),
        Filter::Bilinear => gather::<2, false>(pixels, stride, places, seen, |t| [1.0 - t, t]),
        Filter::Bicubic => gather::<4, true>(pixels, stride, places, seen, |t| {
            let s = 1.0 - t;
            [-0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t]
        }),
        Filter::Spline => gather::<4, false>(pixels, stride, places, seen, |t| {
            let s = 1.0 - t;
            const SIXTH: f32 = 1.0 / 6.0;
            [
                SIXTH * s * s * s,
                2.0 / 3.0 - 0.5 * t * t * (2.0 - t),
                2.0 / 3.0 - 0.5 * s * s * (2.0 - s),
                SIXTH * t * t * t,
            ]
        }),
    }
}

/// The pixel at or before a place that is not negative (for a whole number perhaps the one before it), as integer and as float: unlike a
/// cast, which looks for numbers that are none, many at a time.
#[inline(always)]
fn floor(at: f32) -> (i32, f32) {
    // Floats from here on are whole, and their last bits count them.
    const WHOLE: f32 = 8_388_608.0;
    let above = (at + 0.5) + WHOLE;
    (above.to_bits() as i32 - WHOLE.to_bits() as i32 - 1, above - WHOLE - 1.0)
}

/// How far below the least of the four pixels around a place cubic convolution may go: its negative lobes would make black rings around
/// lamps.
const LEAST: f32 = 0.75;

/// The lesser of two numbers: unlike `f32::min`, without looking for numbers that are none.
#[inline(always)]
fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `LOBES` says that weights may be negative, of pixels that are not.
#[inline(always)]
fn gather<const TAPS: usize, const LOBES: bool>(
    pixels: &[[f32; 4]],
    stride: usize,
    places: &Places,
    seen: &mut [[f32; 4]],
    weights: impl Fn(f32) -> [f32; TAPS],
) {
    // The first tap, seen from the pixel at or before the place; the nearest pixel is the one before the place half a pixel on.
    let (offset, before) = match TAPS {
        1 => (0.5, 0),
        2 => (0.0, 0),
        _ => (0.0, 1),
    };
    // Numbers and weights of all pixels first, many at a time.
    let (mut across, mut down) = ([[0f32; CHUNK]; TAPS], [[0f32; CHUNK]; TAPS]);
    let (mut first, mut part) = ([0i32; CHUNK], [[0f32; CHUNK]; 2]);
    let (stride_i, skipped) = (stride as i32, (BORDER - before) as i32);
    for i in 0..CHUNK {
        let (x, y) = (places.x[i] + offset, places.y[i] + offset);
        let ((column, left), (line, top)) = (floor(x), floor(y));
        first[i] = (line + skipped) * stride_i + column + skipped;
        (part[0][i], part[1][i]) = (x - left, y - top);
        let (wx, wy) = (weights(x - left), weights(y - top));
        for k in 0..TAPS {
            (across[k][i], down[k][i]) = (wx[k], wy[k]);
        }
    }
    for (i, target) in seen.iter_mut().enumerate().take(CHUNK) {
        let first = first[i] as usize;
        let Some(lines) = pixels.get(first..first + (TAPS - 1) * stride + TAPS) else { continue };
        // Down first: the columns' sums do not wait for each other.
        let mut columns = [[0f32; 4]; TAPS];
        for (j, down) in down.iter().enumerate() {
            // All their numbers in one row: two pixels to a register.
            let line = lines[j * stride..j * stride + TAPS].as_flattened();
            for (column, value) in columns.as_flattened_mut().iter_mut().zip(line) {
                *column = down[i].mul_add(*value, *column);
            }
        }
        let mut sum = [0f32; 4];
        for (across, column) in across.iter().zip(&columns) {
            (0..4).for_each(|c| sum[c] = across[i].mul_add(column[c], sum[c]));
        }
        if LOBES {
            let (above, below) = (stride + 1, 2 * stride + 1);
            let inner = [lines[above], lines[above + 1], lines[below], lines[below + 1]];
            if sum[3] < 0.5 {
                // Lobes may leave next to nothing of what was measured: without them.
                let (s, t) = (part[0][i], part[1][i]);
                let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
                sum = [0.0; 4];
                for (weight, pixel) in weights.iter().zip(&inner) {
                    (0..4).for_each(|c| sum[c] += weight * pixel[c]);
                }
            } else {
                for c in 0..4 {
                    let least = lesser(lesser(inner[0][c], inner[1][c]), lesser(inner[2][c], inner[3][c]));
                    sum[c] = if LEAST * least > sum[c] { LEAST * least } else { sum[c] };
                }
            }
        }
        *target = sum;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_span_the_equator_keep_all_columns() {
        let level = |width: u32, rows: Range<usize>| {
            Sphere::new(LatLong::new(width, width / 2).unwrap()).level(&rows)
        };
        assert_eq!(level(64, 0..32), 0);
        assert_eq!(level(32, 0..16), 0);
        assert_eq!(level(512, 96..128), 0);
        assert_eq!(level(512, 128..160), 0);
        // The first rows of a large map are short circles.
        assert!(level(4096, 0..32) >= 3);
    }
}

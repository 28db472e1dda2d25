//! The fall-off of light towards the corners, learnt from photographs of an even surface.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::picture::Picture;
use crate::radiance::{NoiseModel, RadianceImage, Response};
use crate::{Error, Result};

/// Side of the squares over which a flat field is averaged, pixels.
const SQUARE: usize = 8;
/// Rounds of the fit; it has come to rest when the last one changes no pixel by more than this, relative.
const ROUNDS: usize = 12;
const SETTLED: f64 = 1e-3;

/// Relative illumination: exp(Σ c_k r^(2k+2)), 1 at the centre, r being the distance from the centre in units of half
/// the picture's diagonal. The exponential keeps it positive however it is extrapolated.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vignetting {
    /// Width of the photographs it was learnt from, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Where the light falls off from, x; a pixel's centre is an integer.
    pub centre_x: f64,
    /// Where the light falls off from, y.
    pub centre_y: f64,
    /// Coefficients of r², r⁴ and r⁶.
    pub coefficients: [f64; 3],
    /// Root mean square of what the model leaves of the flat fields, relative, over squares of 8 pixels.
    pub residual: f64,
    /// Covariance of the coefficients and of the centre, as what is left tells it.
    pub covariance: [[f64; 5]; 5],
    /// Whether the fit came to rest.
    pub settled: bool,
}

impl Vignetting {
    /// Whether all of its numbers are.
    pub(super) fn is_finite(&self) -> bool {
        let numbers = [self.centre_x, self.centre_y, self.residual].into_iter().chain(self.coefficients);
        numbers.chain(self.covariance.into_iter().flatten()).all(f64::is_finite)
    }

    /// None, about the middle of the picture.
    pub(crate) fn centred(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            centre_x: (f64::from(width) - 1.0) / 2.0,
            centre_y: (f64::from(height) - 1.0) / 2.0,
            coefficients: [0.0; 3],
            residual: 0.0,
            covariance: [[0.0; 5]; 5],
            settled: false,
        }
    }

    /// Fits flat fields: photographs of an evenly lit even surface, of any exposure each.
    ///
    /// # Errors
    /// [`Error::Request`] without photographs; [`Error::Input`] naming a photograph of another size or depth, one that
    /// is too dark or saturated over more than half of its area, or the first one where all together are not flat
    /// (residual above 5 %).
    pub fn fit(flats: &[Picture], response: &Response, noise: &NoiseModel) -> Result<Self> {
        let Some(first) = flats.first() else {
            return Err(Error::request(
                "no flat fields",
                "photograph an evenly lit sheet, or go on without vignetting",
            ));
        };
        let mut squares = Vec::new();
        for (index, flat) in flats.iter().enumerate() {
            if (flat.width, flat.height, flat.white) != (first.width, first.height, response.white()) {
                let what =
                    format!("the flat field is {}x{} with levels to {}", flat.width, flat.height, flat.white);
                return Err(Error::input(
                    &flat.path,
                    what,
                    "take it with the settings of the other photographs",
                ));
            }
            let before = squares.len();
            gather(flat, index, response, noise, &mut squares);
            let most = 3 * (flat.width as usize / SQUARE) * (flat.height as usize / SQUARE);
            if 2 * (squares.len() - before) < most {
                let what = "more than half of the flat field is too dark or saturated";
                return Err(Error::input(&flat.path, what, "photograph it at about half of white"));
            }
        }
        let fitted = fit(&squares, flats.len(), first);
        if fitted.residual.is_nan() || fitted.residual > 0.05 {
            let what = format!(
                "the flat fields differ by {:.1} % from a fall-off about a centre",
                100.0 * fitted.residual
            );
            return Err(Error::input(&first.path, what, "photograph an even surface without shadows"));
        }
        Ok(fitted)
    }

    /// Relative illumination at a pixel, 1 at the centre of the fall-off.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.ln_at(x, y).0.exp()
    }

    /// How sure that is: its variance, relative.
    pub fn relative_variance_at(&self, x: f64, y: f64) -> f64 {
        let (_, by) = self.ln_at(x, y);
        let sum = |i: usize| (0..5).map(|j| by[i] * self.covariance[i][j] * by[j]).sum::<f64>();
        (0..5).map(sum).sum::<f64>().max(0.0)
    }

    /// The logarithm of the illumination, and how it moves with the coefficients and the centre.
    pub(crate) fn ln_at(&self, x: f64, y: f64) -> (f64, [f64; 5]) {
        let half = half_diagonal_squared(self.width, self.height);
        let (dx, dy) = (x - self.centre_x, y - self.centre_y);
        let r2 = (dx * dx + dy * dy) / half;
        let [a, b, c] = self.coefficients;
        let by_r2 = a + r2 * (2.0 * b + r2 * 3.0 * c);
        let by = [r2, r2 * r2, r2 * r2 * r2, -2.0 * dx / half * by_r2, -2.0 * dy / half * by_r2];
        (r2 * (a + r2 * (b + r2 * c)), by)
    }

    /// Divides a view's radiance by the illumination, and its variance by the square; the illumination's own doubt is added.
    ///
    /// # Errors
    /// [`Error::Request`] where the view has another size than the flat fields.
    pub fn correct(&self, image: &mut RadianceImage) -> Result<()> {
        self.correct_by(&self.gains(), image)
    }

    /// What each pixel is multiplied by, and the relative variance of that.
    pub(crate) fn gains(&self) -> Vec<[f32; 2]> {
        let pixels = (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y)));
        let mut doubt = 0.0;
        let gain = |(x, y): (u32, u32)| {
            // It varies slowly.
            if (x as usize).is_multiple_of(SQUARE) {
                doubt = self.relative_variance_at(x.into(), y.into()) as f32;
            }
            [1.0 / self.at(x.into(), y.into()) as f32, doubt]
        };
        pixels.map(gain).collect()
    }

    /// [`Vignetting::correct`] by gains that were found before.
    pub(crate) fn correct_by(&self, gains: &[[f32; 2]], image: &mut RadianceImage) -> Result<()> {
        if (self.width, self.height) != (image.width, image.height) {
            return Err(Error::request(
                format!(
                    "vignetting was learnt at {}x{}, the view has {}x{}",
                    self.width, self.height, image.width, image.height
                ),
                "photograph flat fields at the size of the views",
            ));
        }
        for ((radiance, variance), [gain, doubt]) in
            image.radiance.iter_mut().zip(&mut image.variance).zip(gains)
        {
            for (r, v) in radiance.iter_mut().zip(variance) {
                *r *= gain;
                *v = *v * gain * gain + doubt * *r * *r;
            }
        }
        Ok(())
    }
}

/// The unit of r².
fn half_diagonal_squared(width: u32, height: u32) -> f64 {
    0.25 * (f64::from(width).powi(2) + f64::from(height).powi(2))
}

/// The mean exposure of a square in one channel of one flat field, which share a gain.
struct Square {
    x: f64,
    y: f64,
    gain: usize,
    ln_exposure: f64,
}

fn gather(flat: &Picture, index: usize, response: &Response, noise: &NoiseModel, squares: &mut Vec<Square>) {
    let (width, height) = (flat.width as usize, flat.height as usize);
    for row in 0..height / SQUARE {
        for column in 0..width / SQUARE {
            for channel in 0..3 {
                let table = response.exposure(channel);
                let valid = noise.dark_level[channel] + 1..noise.saturated_level[channel];
                let mut sum = Some(0.0);
                for i in 0..SQUARE * SQUARE {
                    let pixel = (row * SQUARE + i / SQUARE) * width + column * SQUARE + i % SQUARE;
                    let level = flat.levels[pixel][channel];
                    sum = sum
                        .filter(|_| valid.contains(&level))
                        .map(|s| s + f64::from(table[usize::from(level)]));
                }
                if let Some(sum) = sum {
                    let middle = (SQUARE - 1) as f64 / 2.0;
                    squares.push(Square {
                        x: (column * SQUARE) as f64 + middle,
                        y: (row * SQUARE) as f64 + middle,
                        gain: 3 * index + channel,
                        ln_exposure: (sum / (SQUARE * SQUARE) as f64).ln(),
                    });
                }
            }
        }
    }
}

/// Gauss-Newton over the centre, the three coefficients and a gain for every channel of every flat field.
fn fit(squares: &[Square], flats: usize, picture: &Picture) -> Vignetting {
    let (width, height) = (f64::from(picture.width), f64::from(picture.height));
    let half = half_diagonal_squared(picture.width, picture.height);
    let mut v = Vignetting::centred(picture.width, picture.height);
    let unknowns = 5 + 3 * flats;
    let mut gains = vec![0.0; 3 * flats];
    // The first step finds the coefficients; only then does the centre mean anything.
    for _ in 0..ROUNDS {
        let (mut matrix, mut right) =
            (DMatrix::<f64>::zeros(unknowns, unknowns), DVector::<f64>::zeros(unknowns));
        let mut squared = 0.0;
        for s in squares {
            let (ln_illumination, [a, b, c, x, y]) = v.ln_at(s.x, s.y);
            let residual = s.ln_exposure - gains[s.gain] - ln_illumination;
            squared += residual * residual;
            let row = [(0, a), (1, b), (2, c), (3, x), (4, y), (5 + s.gain, 1.0)];
            for (i, p) in row {
                right[i] += p * residual;
                for (k, q) in row {
                    matrix[(i, k)] += p * q;
                }
            }
        }
        v.residual = (squared / squares.len() as f64).sqrt();
        // A centre without fall-off cannot be seen: a faint pull keeps it where it is.
        for (i, faint) in [(0, 1e-9), (1, 1e-9), (2, 1e-9), (3, 1e-6), (4, 1e-6)] {
            matrix[(i, i)] += faint * squares.len() as f64 * if i < 3 { 1.0 } else { 1.0 / half };
        }
        let Some(factor) = matrix.cholesky() else { break };
        let (step, inverse) = (factor.solve(&right), factor.inverse());
        v.covariance =
            std::array::from_fn(|i| std::array::from_fn(|k| v.residual * v.residual * inverse[(i, k)]));
        // What the step changes half a diagonal away, where the fall-off is felt most.
        let by_r2 = v.coefficients.iter().zip([1.0, 2.0, 3.0]).map(|(c, k)| k * c).sum::<f64>();
        let change = step.iter().take(3).map(|s| s.abs()).sum::<f64>()
            + 2.0 * by_r2.abs() * step[3].hypot(step[4]) / half.sqrt();
        for k in 0..3 {
            v.coefficients[k] += step[k];
        }
        v.centre_x = (v.centre_x + step[3]).clamp(0.0, width);
        v.centre_y = (v.centre_y + step[4]).clamp(0.0, height);
        gains.iter_mut().zip(step.iter().skip(5)).for_each(|(gain, s)| *gain += s);
        v.settled = change < SETTLED;
    }
    v
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    const WIDTH: u32 = 160;
    const HEIGHT: u32 = 120;

    /// What a lens with this fall-off writes of an even surface; a little uneven from pixel to pixel, as paper is.
    fn flat(truth: &Vignetting, white: f64) -> Picture {
        let response = Response::srgb(255);
        let levels = (0..WIDTH * HEIGHT).map(|i| {
            let x = white
                * truth.at(f64::from(i % WIDTH), f64::from(i / WIDTH))
                * (1.0 + 0.02 * f64::from(i % 7 % 3));
            [0, 1, 2].map(|c| response.exposure(c).partition_point(|&entry| f64::from(entry) < x) as u16)
        });
        Picture {
            path: "flat.jpg".into(),
            width: WIDTH,
            height: HEIGHT,
            levels: levels.collect(),
            white: 255,
        }
    }

    fn truth() -> Vignetting {
        Vignetting {
            width: WIDTH,
            height: HEIGHT,
            centre_x: 84.0,
            centre_y: 57.0,
            coefficients: [-0.4, -0.15, 0.02],
            residual: 0.0,
            covariance: [[0.0; 5]; 5],
            settled: true,
        }
    }

    fn fitted(flats: &[Picture]) -> Result<Vignetting> {
        let response = Response::srgb(255);
        Vignetting::fit(flats, &response, &NoiseModel::assumed(&response))
    }

    #[test]
    fn a_known_fall_off_is_found_from_flats_of_unlike_exposure() {
        let found = fitted(&[flat(&truth(), 2.0), flat(&truth(), 1.1)]).unwrap();
        assert!(found.residual < 0.01 && found.settled);
        assert!((found.centre_x - 84.0).abs() < 1.0 && (found.centre_y - 57.0).abs() < 1.0, "{found:?}");
        for (x, y) in [(0.0, 0.0), (159.0, 0.0), (80.0, 60.0), (10.0, 110.0), (84.0, 57.0)] {
            assert!((found.at(x, y) / truth().at(x, y) - 1.0).abs() < 0.01, "({x}, {y})");
        }
    }

    #[test]
    fn an_even_picture_has_no_fall_off() {
        let even = Vignetting { coefficients: [0.0; 3], ..truth() };
        let found = fitted(&[flat(&even, 1.5)]).unwrap();
        assert!((found.at(0.0, 0.0) - 1.0).abs() < 0.005);
    }

    #[test]
    fn correcting_a_view_makes_an_even_surface_even() {
        let pixels: Vec<[f32; 3]> = (0..WIDTH * HEIGHT)
            .map(|i| [truth().at(f64::from(i % WIDTH), f64::from(i / WIDTH)) as f32; 3])
            .collect();
        let variance = pixels.iter().map(|p| p.map(|r| r * r)).collect();
        let mask = vec![0; pixels.len()];
        let mut image = RadianceImage { width: WIDTH, height: HEIGHT, radiance: pixels, variance, mask };
        truth().correct(&mut image).unwrap();
        let close = |value: &f32| (value - 1.0).abs() < 1e-5;
        assert!(image.radiance.iter().flatten().all(close) && image.variance.iter().flatten().all(close));
        image.width = 80;
        assert!(truth().correct(&mut image).unwrap_err().to_string().contains("160x120"));
    }

    #[test]
    fn what_is_no_flat_field_is_refused() {
        assert!(fitted(&[]).is_err());
        let mut shadow = flat(&truth(), 1.5);
        shadow.levels[..8000].iter_mut().flatten().for_each(|level| *level /= 2);
        assert!(fitted(&[shadow]).unwrap_err().to_string().contains("differ by"));
        assert!(
            fitted(&[flat(&truth(), 1.5), flat(&truth(), 100.0)])
                .unwrap_err()
                .to_string()
                .contains("saturated")
        );
    }

    #[test]
    fn flats_that_stand_for_no_exposure_are_refused_although_their_residual_is_no_number() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("response.csv");
        // Nothing up to level 120.
        let line = |z: u32| format!("{z},{0},{0},{0}\n", if z > 120 { f64::from(z) / 128.0 } else { 0.0 });
        std::fs::write(&path, (0..256).fold(String::from("level,R,G,B\n"), |text, z| text + &line(z)))
            .unwrap();
        let (response, even) = (Response::read_csv(&path).unwrap(), flat(&truth(), 0.2));
        let noise = NoiseModel { dark_level: [0; 3], ..NoiseModel::assumed(&response) };
        assert!(Vignetting::fit(&[even], &response, &noise).is_err());
    }

    #[test]
    fn the_doubt_of_the_flats_is_in_the_radiance() {
        let mut random = StdRng::seed_from_u64(3);
        let (mut scores, mut stated) = (vec![], 0.0);
        for _ in 0..20 {
            let mut noisy = flat(&truth(), 1.5);
            for level in noisy.levels.iter_mut().flatten() {
                *level = level.saturating_add_signed(random.random_range(-12..=12));
            }
            let found = fitted(&[noisy]).unwrap();
            let pixels = (WIDTH * HEIGHT) as usize;
            let mut image = RadianceImage {
                width: WIDTH,
                height: HEIGHT,
                radiance: vec![[1.0; 3]; pixels],
                variance: vec![[0.0; 3]; pixels],
                mask: vec![0; pixels],
            };
            found.correct(&mut image).unwrap();
            for (x, y) in [(0, 0), (159, 0), (0, 119), (159, 119), (20, 60)] {
                let i = (y * WIDTH + x) as usize;
                let sigma = image.variance[i][1].sqrt();
                let off = image.radiance[i][1] - 1.0 / truth().at(f64::from(x), f64::from(y)) as f32;
                scores.push(f64::from(off / sigma));
                stated += f64::from(sigma / image.radiance[i][1]) / 100.0;
            }
        }
        let spread = (scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64).sqrt();
        println!("stated {:.3} % on average; scores spread by {spread:.2}", 100.0 * stated);
        assert!((0.6..1.6).contains(&spread), "{spread}");
    }
}

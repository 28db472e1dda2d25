//! One square in one view: found near where it is expected ([`search`]), then measured by fitting the picture of a square
//! to it.

mod search;

use glam::DVec2;
use nalgebra::{SMatrix, SVector};

use super::edge::Quad;
use super::luminance::Luminance;
pub(super) use search::{Found, Search};

/// Corners (x0 y0 ... x3 y3), pixels.
pub(super) type Corners = SVector<f64, 8>;
/// Their covariance, pixels².
pub(super) type CornerCovariance = SMatrix<f64, 8, 8>;

/// A square that was measured.
#[derive(Debug, Clone)]
pub(super) struct MeasuredSquare {
    /// Index in the layout.
    pub square: usize,
    /// Where its corners are, in the layout's order.
    pub corners: Corners,
    /// How sure that is, by the noise and texture around it.
    pub covariance: CornerCovariance,
}

/// Why a square could not be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unseen {
    Outside,
    NoContrast,
    NotThere,
}

/// So far outside the square and so far inside its edges the fit looks, pixels.
const OUTSIDE_PX: f64 = 3.0;
const INSIDE_PX: f64 = 6.0;
/// What the optics' blur is before it is known, and how well: most lenses are sharper than half a pixel.
const BLUR_PX: f64 = 0.25;
const BLUR_SIGMA_PX: f64 = 0.25;
const BLURS_PX: std::ops::RangeInclusive<f64> = 0.05..=4.0;
const STEPS: usize = 25;
/// A residual counts in full up to so many standard deviations.
const HUBER: f64 = 2.5;
/// A square is at most so bright beside its ground: glare makes it brighter.
const DARKEST_GROUND: f64 = 0.6;
/// The model itself is so good beside an edge, relative to the contrast (at its middle).
const EDGE_ERROR: f64 = 0.06;
/// So far out or in is an edge along a row of pixels, standard deviation.
const ALIGNED_EDGE_PX: f64 = 0.2;
/// Unknowns of a fit: corners, ground (mean and slopes), square, blur.
const UNKNOWNS: usize = 13;

struct Pixel {
    at: DVec2,
    value: f64,
    variance: f64,
    covered: f64,
    by_corners: [f64; 8],
    by_blur: f64,
    /// Residual and weight.
    residual: f64,
    weight: f64,
}

/// Measures the square whose corners should be about at `expected`; `ground` are the corners of the even ground around it
/// there.
pub(super) fn measure_square(
    picture: &Luminance,
    square: usize,
    expected: &[DVec2; 4],
    ground: &[DVec2; 4],
) -> Result<MeasuredSquare, Unseen> {
    let mut corners = *expected;
    let mut blur_px = BLUR_PX;
    let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    for step in 0.. {
        let quad = Quad::new(&corners).ok_or(Unseen::NotThere)?;
        let shift = mean(&corners) - mean(expected);
        let ground = Quad::new(&ground.map(|corner| corner + shift)).ok_or(Unseen::NotThere)?;
        let mut pixels = gather(picture, &corners, &quad, &ground, blur_px)?;
        let centre = mean(&corners);
        let levels = weigh(&mut pixels, centre)?;
        let (matrix, right) = equations(&pixels, centre, &levels, blur_px);
        normal = matrix;
        let Some(solved) = matrix.cholesky().map(|factor| factor.solve(&right)) else {
            return Err(Unseen::NotThere);
        };
        let longest = solved.rows(0, 8).amax();
        let damping = (1.5 / longest).min(1.0);
        for (i, corner) in corners.iter_mut().enumerate() {
            *corner += DVec2::new(solved[2 * i], solved[2 * i + 1]) * damping;
        }
        blur_px = (blur_px + solved[12] * damping).clamp(*BLURS_PX.start(), *BLURS_PX.end());
        if longest < 2e-3 || (step >= STEPS && longest < 0.05) {
            break;
        }
        if step >= STEPS || !longest.is_finite() {
            return Err(Unseen::NotThere);
        }
    }
    // A square that has changed its shape by much is something else.
    let size = expected[0].distance(expected[2]).max(expected[1].distance(expected[3]));
    let shift = mean(&corners) - mean(expected);
    let strain = (0..4).map(|i| (corners[i] - expected[i] - shift).length()).fold(0.0, f64::max);
    if strain > 0.15 * size + 0.7 || shift.length() > 0.3 * size + 2.0 {
        return Err(Unseen::NotThere);
    }
    let covariance = normal.try_inverse().ok_or(Unseen::NotThere)?.fixed_view::<8, 8>(0, 0).into_owned();
    Ok(MeasuredSquare { square, corners: vector(&corners), covariance: covariance + along_pixels(&corners) })
}

/// What no noise of single pixels says: a pixel is no exact box, and along an edge that follows the pixels' rows all of
/// them err alike. It makes dark squares smaller or larger and leaves them where they are. An edge that crosses rows
/// averages over as many.
fn along_pixels(corners: &[DVec2; 4]) -> CornerCovariance {
    let mut covariance = CornerCovariance::zeros();
    for edge in 0..2 {
        let mut grown = Corners::zeros();
        for (a, b) in [(edge, edge + 1), (edge + 2, (edge + 3) % 4)] {
            let along = corners[b] - corners[a];
            let across = along.perp().normalize_or_zero();
            let out = across * across.dot(corners[a] - mean(corners)).signum();
            let share = 1.0 / (1.0 + along.abs().min_element()).sqrt();
            for corner in [a, b] {
                grown[2 * corner] = share * out.x;
                grown[2 * corner + 1] = share * out.y;
            }
        }
        covariance += grown * grown.transpose() * ALIGNED_EDGE_PX.powi(2);
    }
    covariance
}

pub(super) fn vector(corners: &[DVec2; 4]) -> Corners {
    Corners::from_fn(|i, _| corners[i / 2][i % 2])
}

fn mean(corners: &[DVec2; 4]) -> DVec2 {
    corners.iter().sum::<DVec2>() / 4.0
}

/// The pixels on and around the square's edges, with what the model says of them.
fn gather(
    picture: &Luminance,
    corners: &[DVec2; 4],
    quad: &Quad,
    ground: &Quad,
    blur_px: f64,
) -> Result<Vec<Pixel>, Unseen> {
    let (low, high) = bounds(corners, OUTSIDE_PX + 1.0);
    if !picture.holds(low, high) {
        return Err(Unseen::Outside);
    }
    let mut pixels = vec![];
    for y in low.y as usize..=high.y as usize {
        for x in low.x as usize..=high.x as usize {
            let at = DVec2::new(x as f64, y as f64);
            let index = y * picture.width + x;
            if !(-OUTSIDE_PX..=INSIDE_PX).contains(&quad.depth(at))
                || ground.depth(at) < 0.0
                || !picture.variance[index].is_finite()
            {
                continue;
            }
            let (covered, by_corners) = quad.coverage(at, blur_px);
            let (more, _) = quad.coverage(at, blur_px * 1.05);
            pixels.push(Pixel {
                at,
                value: f64::from(picture.value[index]),
                variance: f64::from(picture.variance[index]),
                covered,
                by_corners,
                by_blur: (more - covered) / (0.05 * blur_px),
                residual: 0.0,
                weight: 1.0,
            });
        }
    }
    if pixels.len() > 2 * UNKNOWNS { Ok(pixels) } else { Err(Unseen::NotThere) }
}

fn bounds(corners: &[DVec2; 4], margin_px: f64) -> (DVec2, DVec2) {
    let low = corners.iter().copied().reduce(DVec2::min).unwrap_or_default();
    let high = corners.iter().copied().reduce(DVec2::max).unwrap_or_default();
    ((low - margin_px).floor(), (high + margin_px).ceil())
}

/// The ground's radiance with its slopes (per 10 pixels) and the square's: what a pixel would be at coverage 0 and 1.
type Levels = SVector<f64, 4>;

fn terms(pixel: &Pixel, centre: DVec2) -> Levels {
    let outside = 1.0 - pixel.covered;
    let at = (pixel.at - centre) / 10.0;
    Levels::new(outside, outside * at.x, outside * at.y, pixel.covered)
}

/// Finds the levels, and from what they leave how much the ground's texture and the square's vary: paper has grain that
/// no photograph's noise knows of. Residuals and weights are left in the pixels.
fn weigh(pixels: &mut [Pixel], centre: DVec2) -> Result<Levels, Unseen> {
    let mut levels = Levels::zeros();
    for round in 0..4 {
        let (mut matrix, mut right) = (SMatrix::<f64, 4, 4>::zeros(), Levels::zeros());
        for pixel in &*pixels {
            let row = terms(pixel, centre);
            matrix += row * row.transpose() * pixel.weight;
            right += row * (pixel.weight * pixel.value);
        }
        levels = matrix.cholesky().ok_or(Unseen::NotThere)?.solve(&right);
        for pixel in &mut *pixels {
            pixel.residual = pixel.value - terms(pixel, centre).dot(&levels);
        }
        if round == 3 {
            break;
        }
        let contrast = (levels[0] - levels[3]).abs();
        let grain = |part: &dyn Fn(f64) -> bool, otherwise: f64| {
            let mut sizes: Vec<f64> = vec![];
            let mut noise = 0.0;
            for pixel in pixels.iter().filter(|p| part(p.covered)) {
                sizes.push(pixel.residual.abs());
                noise += pixel.variance;
            }
            if sizes.len() < 5 {
                return otherwise;
            }
            noise /= sizes.len() as f64;
            let middle = sizes.len() / 2;
            // Of a normal distribution, the median size is 0.6745 of the standard deviation.
            let all = *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745;
            (all * all - noise).max(0.0).sqrt()
        };
        let ground = grain(&|covered| covered < 0.1, 0.1 * contrast).max(1e-3 * contrast);
        let square = grain(&|covered| covered > 0.9, 0.03 * contrast).max(1e-3 * contrast);
        for pixel in &mut *pixels {
            let (inside, outside) = (pixel.covered, 1.0 - pixel.covered);
            let edge = 4.0 * EDGE_ERROR * contrast * inside * outside;
            let variance =
                pixel.variance + (ground * outside).powi(2) + (square * inside).powi(2) + edge * edge;
            let size = pixel.residual.abs() / variance.sqrt();
            pixel.weight = (HUBER / size).min(1.0) / variance;
        }
    }
    match levels[3] < DARKEST_GROUND * levels[0] {
        true => Ok(levels),
        false => Err(Unseen::NoContrast),
    }
}

/// Normal equations of all unknowns together, so that the corners' covariance knows of the others.
fn equations(
    pixels: &[Pixel],
    centre: DVec2,
    levels: &Levels,
    blur_px: f64,
) -> (SMatrix<f64, UNKNOWNS, UNKNOWNS>, SVector<f64, UNKNOWNS>) {
    let (mut matrix, mut right) =
        (SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros(), SVector::<f64, UNKNOWNS>::zeros());
    for pixel in pixels {
        let at = (pixel.at - centre) / 10.0;
        let difference = levels[3] - (levels[0] + levels[1] * at.x + levels[2] * at.y);
        let mut row = SVector::<f64, UNKNOWNS>::zeros();
        for i in 0..8 {
            row[i] = difference * pixel.by_corners[i];
        }
        row.fixed_rows_mut::<4>(8).copy_from(&terms(pixel, centre));
        row[12] = difference * pixel.by_blur;
        matrix.syger(pixel.weight, &row, &row, 1.0);
        right += row * (pixel.weight * pixel.residual);
    }
    matrix.fill_upper_triangle_with_lower_triangle();
    // A corner is known to a few pixels before it is looked at.
    for i in 0..8 {
        matrix[(i, i)] += 1e-2;
    }
    matrix[(12, 12)] += BLUR_SIGMA_PX.powi(-2);
    right[12] += (BLUR_PX - blur_px) / BLUR_SIGMA_PX.powi(2);
    (matrix, right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    fn normal(random: &mut StdRng) -> f64 {
        let (a, b): (f64, f64) = (random.random(), random.random());
        (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }

    /// A dark square on bright ground by brute force: 8 x 8 rays for each pixel, grain on the ground and noise on all.
    pub fn picture(corners: &[DVec2; 4], noise: f64, random: &mut StdRng) -> Luminance {
        let (width, height) = (64, 56);
        let quad = Quad::new(corners).unwrap();
        let value = |i: usize, random: &mut StdRng| {
            let at = DVec2::new((i % width) as f64, (i / width) as f64);
            let inside = (0..64)
                .filter(|ray| {
                    quad.depth(at + (DVec2::new((ray % 8) as f64, (ray / 8) as f64) - 3.5) / 8.0) > 0.0
                })
                .count() as f64
                / 64.0;
            let ground = 1.0 + 0.002 * at.x + 0.6 * noise * normal(random);
            (ground * (1.0 - inside) + 0.03 * inside + noise * normal(random)) as f32
        };
        Luminance {
            width,
            height,
            value: (0..width * height).map(|i| value(i, random)).collect(),
            variance: vec![(noise * noise) as f32; width * height],
        }
    }

    /// A square of about 18 pixels seen at some slant, with even ground around it.
    pub fn square(random: &mut StdRng) -> ([DVec2; 4], [DVec2; 4]) {
        let turn = DVec2::from_angle(random.random::<f64>() * 6.0);
        let flat = 0.4 + 0.6 * random.random::<f64>();
        let lean = DVec2::from_angle(random.random::<f64>() * 6.0);
        let centre = DVec2::new(32.0, 28.0) + DVec2::new(random.random(), random.random());
        let corners = |half: f64| {
            [(-half, -half), (half, -half), (half, half), (-half, half)].map(|(x, y)| {
                let at = turn.rotate(DVec2::new(x, y * flat));
                lean.rotate(at) + centre
            })
        };
        (corners(9.0), corners(13.0))
    }

    #[test]
    fn corners_are_found_within_what_is_stated() {
        let mut random = StdRng::seed_from_u64(1);
        let (mut scores, mut errors) = (vec![], vec![]);
        for _ in 0..60 {
            let (truth, ground) = square(&mut random);
            let picture = picture(&truth, 0.05, &mut random);
            let off = DVec2::new(random.random::<f64>() * 2.0 - 1.0, random.random::<f64>() * 2.0 - 1.0);
            let found =
                measure_square(&picture, 0, &truth.map(|c| c + off), &ground.map(|c| c + off)).unwrap();
            let error = found.corners - vector(&truth);
            errors.extend(error.iter().copied());
            scores.push((error.transpose() * found.covariance.try_inverse().unwrap() * error)[0]);
        }
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let squared = scores.iter().sum::<f64>() / scores.len() as f64;
        println!("corners within {rms:.3} pixels RMS; squared score {squared:.1} of 8");
        assert!(rms < 0.08, "{rms}");
        // These pixels are the boxes that those of a camera are not: what is stated for that is too much here.
        assert!((2.5..14.0).contains(&squared), "{squared}");
    }

    #[test]
    fn what_is_not_a_dark_square_is_refused() {
        let mut random = StdRng::seed_from_u64(3);
        let (truth, ground) = square(&mut random);
        let mut glare = picture(&truth, 0.02, &mut random);
        glare.value.iter_mut().for_each(|value| *value = 2.0 - *value);
        assert_eq!(measure_square(&glare, 0, &truth, &ground).unwrap_err(), Unseen::NoContrast);
        let mut even = picture(&truth, 0.02, &mut random);
        even.value.iter_mut().for_each(|value| *value = value.max(0.8));
        assert!(measure_square(&even, 0, &truth, &ground).is_err());
        let outside = truth.map(|c| c - DVec2::new(30.0, 0.0));
        assert_eq!(measure_square(&even, 0, &outside, &outside).unwrap_err(), Unseen::Outside);
        let mut unknown = picture(&truth, 0.02, &mut random);
        unknown.variance.fill(f32::INFINITY);
        assert!(measure_square(&unknown, 0, &truth, &ground).is_err());
    }
}

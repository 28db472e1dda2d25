//! Making a picture smaller without aliasing, and the coefficients of the spline through a picture.

use rayon::prelude::*;

type Pixel = [f32; 4];

/// Half the width of the kernel, in pixels of the smaller picture.
const REACH: f64 = 2.0;

/// Resamples a picture to a smaller size with a cubic (Mitchell and Netravali, "Reconstruction filters in computer graphics", SIGGRAPH
/// 1988, equation 8 with B = C = 1/3) as wide as two of the smaller picture's pixels on either side. Nothing becomes less than the least
/// of the pixels that count positively: the kernel's negative lobes would make black rings around lamps.
pub(super) fn reduce(pixels: &[Pixel], from: (usize, usize), to: (usize, usize)) -> Vec<Pixel> {
    let (across, down) = (Taps::new(from.0, to.0), Taps::new(from.1, to.1));
    let mut narrow = vec![[0.0; 4]; to.0 * from.1];
    narrow.par_chunks_mut(to.0).zip(pixels.par_chunks(from.0)).for_each(|(line, source)| {
        for (target, (first, weights)) in line.iter_mut().zip(&across.0) {
            let (mut sum, mut least) = ([0.0; 4], [f32::INFINITY; 4]);
            for (weight, pixel) in weights.iter().zip(&source[*first..]) {
                (0..4).for_each(|c| sum[c] += weight * pixel[c]);
                if *weight > 0.0 {
                    (0..4).for_each(|c| least[c] = least[c].min(pixel[c]));
                }
            }
            *target = [0, 1, 2, 3].map(|c| sum[c].max(least[c]));
        }
    });
    let mut small = vec![[0.0; 4]; to.0 * to.1];
    small.par_chunks_mut(to.0).zip(&down.0).for_each(|(line, (first, weights))| {
        let mut least = vec![[f32::INFINITY; 4]; to.0];
        for (weight, source) in weights.iter().zip(narrow[first * to.0..].chunks_exact(to.0)) {
            for (target, pixel) in line.iter_mut().zip(source) {
                (0..4).for_each(|c| target[c] += weight * pixel[c]);
            }
            if *weight > 0.0 {
                for (least, pixel) in least.iter_mut().zip(source) {
                    (0..4).for_each(|c| least[c] = least[c].min(pixel[c]));
                }
            }
        }
        for (target, least) in line.iter_mut().zip(&least) {
            (0..4).for_each(|c| target[c] = target[c].max(least[c]));
        }
    });
    small
}

/// Per target pixel, the first source pixel and the weights of it and those that follow.
struct Taps(Vec<(usize, Vec<f32>)>);

impl Taps {
    fn new(from: usize, to: usize) -> Self {
        let scale = from as f64 / to as f64;
        let taps = (0..to).map(|target| {
            let centre = (target as f64 + 0.5) * scale - 0.5;
            let first = (centre - REACH * scale).ceil().max(0.0) as usize;
            let last = ((centre + REACH * scale).floor() as usize).min(from - 1);
            let weights: Vec<f64> = (first..=last).map(|i| mitchell((i as f64 - centre) / scale)).collect();
            let sum: f64 = weights.iter().sum();
            (first, weights.into_iter().map(|weight| (weight / sum) as f32).collect())
        });
        Self(taps.collect())
    }
}

fn mitchell(x: f64) -> f64 {
    let x = x.abs();
    match x {
        _ if x < 1.0 => (7.0 * x * x * x - 12.0 * x * x + 16.0 / 3.0) / 6.0,
        _ if x < 2.0 => (-7.0 / 3.0 * x * x * x + 12.0 * x * x - 20.0 * x + 32.0 / 3.0) / 6.0,
        _ => 0.0,
    }
}

/// The pole of the cubic spline's recursion.
const POLE: f32 = -0.267_949_2;
/// After so many pixels the recursion has forgotten where it began.
const FORGOTTEN: usize = 16;

/// Replaces a picture, in place, by the coefficients of the cubic spline that goes through its pixels, mirrored at its borders
/// (Unser, "Splines: a perfect fit for signal and image processing", IEEE Signal Processing Magazine 1999, box 2).
pub(super) fn spline_coefficients(pixels: &mut [Pixel], width: usize) {
    let height = pixels.len() / width;
    for line in pixels.chunks_exact_mut(width) {
        let mut first = [0.0; 4];
        let mut power = 1.0;
        for pixel in line.iter().take(FORGOTTEN) {
            (0..4).for_each(|c| first[c] += power * pixel[c]);
            power *= POLE;
        }
        line[0] = first;
        for i in 1..width {
            let before = line[i - 1];
            (0..4).for_each(|c| line[i][c] += POLE * before[c]);
        }
        let (last, before) = (line[width - 1], line[width - 2]);
        line[width - 1] = [0, 1, 2, 3].map(|c| POLE / (POLE * POLE - 1.0) * (last[c] + POLE * before[c]));
        for i in (0..width - 1).rev() {
            let after = line[i + 1];
            (0..4).for_each(|c| line[i][c] = POLE * (after[c] - line[i][c]));
        }
    }
    let gain = 36.0;
    let mut first = vec![[0.0; 4]; width];
    let mut power = 1.0;
    for line in pixels.chunks_exact(width).take(FORGOTTEN) {
        for (first, pixel) in first.iter_mut().zip(line) {
            (0..4).for_each(|c| first[c] += power * pixel[c]);
        }
        power *= POLE;
    }
    pixels[..width].copy_from_slice(&first);
    let pair = |pixels: &mut [Pixel], upper: usize, step: &dyn Fn(&mut [Pixel], &mut [Pixel])| {
        let (above, below) = pixels[upper * width..(upper + 2) * width].split_at_mut(width);
        step(above, below);
    };
    for row in 1..height {
        pair(pixels, row - 1, &|above, below| {
            for (below, above) in below.iter_mut().zip(above) {
                (0..4).for_each(|c| below[c] += POLE * above[c]);
            }
        });
    }
    pair(pixels, height - 2, &|before, last| {
        for (last, before) in last.iter_mut().zip(before) {
            (0..4).for_each(|c| last[c] = POLE / (POLE * POLE - 1.0) * (last[c] + POLE * before[c]));
        }
    });
    for row in (0..height - 1).rev() {
        pair(pixels, row, &|above, below| {
            for (above, below) in above.iter_mut().zip(below) {
                (0..4).for_each(|c| above[c] = POLE * (below[c] - above[c]));
            }
        });
    }
    pixels.iter_mut().for_each(|pixel| pixel.iter_mut().for_each(|value| *value *= gain));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smaller_picture_keeps_what_it_can_show_and_drops_what_it_cannot() {
        let wave = |period: f64| -> Vec<Pixel> {
            let value = |i: usize| (std::f64::consts::TAU * ((i % 120) as f64 + 0.5) / period).cos() as f32;
            (0..120 * 80).map(|i| [value(i), 1.0, 0.0, 1.0]).collect()
        };
        let amplitude = |period: f64| {
            let small = reduce(&wave(period), (120, 80), (40, 30));
            assert!(small.iter().all(|p| (p[1] - 1.0).abs() < 1e-5 && (p[3] - 1.0).abs() < 1e-5));
            small[10 * 40 + 5..10 * 40 + 35].iter().fold(0f32, |most, p| most.max(p[0].abs()))
        };
        assert!(amplitude(40.0) > 0.93 && amplitude(40.0) < 1.01, "{}", amplitude(40.0));
        // A period of 4 pixels is beyond what every third pixel can tell.
        assert!(amplitude(4.0) < 0.06, "{}", amplitude(4.0));
        assert!(amplitude(3.0) < 0.03, "{}", amplitude(3.0));
    }

    #[test]
    fn the_spline_goes_through_the_pixels() {
        let (width, height) = (31, 23);
        let value = |i: usize| ((i * 7919) % 101) as f32 / 50.0;
        let picture: Vec<Pixel> =
            (0..width * height).map(|i| [value(i), value(i + 5), value(3 * i), 1.0]).collect();
        let mut spline = picture.clone();
        spline_coefficients(&mut spline, width);
        let mirrored = |i: isize, n: usize| i.unsigned_abs().min(2 * (n - 1) - i.unsigned_abs());
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0; 4];
                for (j, wy) in [(-1, 1.0), (0, 4.0), (1, 1.0)] {
                    for (i, wx) in [(-1, 1.0), (0, 4.0), (1, 1.0)] {
                        let at = mirrored(y as isize + j, height) * width + mirrored(x as isize + i, width);
                        (0..4).for_each(|c| sum[c] += wx * wy / 36.0 * spline[at][c]);
                    }
                }
                for c in 0..4 {
                    assert!((sum[c] - picture[y * width + x][c]).abs() < 1e-4, "{x} {y} {c}");
                }
            }
        }
    }
}

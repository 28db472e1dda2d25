//! How far one picture is shifted against another, to a small part of a pixel.

use glam::DVec2;
use rigel::geometry::Lens;

/// Steps of Gauss and Newton; each corrects what the linear picture of the one before left, and trusts pixels by how far they were off.
const STEPS: usize = 40;
/// No step is longer: farther away the linear picture says nothing.
const LONGEST_PX: f64 = 2.0;
/// The last step is shorter.
const CLOSE_PX: f64 = 0.01;
/// Nothing is looked for farther away.
pub const FAR_PX: f64 = 10.0;
/// Fewer pixels tell nothing.
const FEWEST: usize = 100;
/// Of a picture's contrast: less in the other tells nothing.
const LEAST_GAIN: f64 = 1e-3;

/// So many parts of the picture, which tiles of so many pixels make up in turn, must tell the same shift.
const PARTS: usize = 4;
const TILE: usize = 12;
/// A shift whose standard error, from how its parts differ, is larger is not told.
const UNSURE_PX: f64 = 0.3;

/// How far a photograph is shifted against its reconstruction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shift {
    /// By so many pixels: x right, y down.
    By(DVec2),
    /// By more than [`FAR_PX`].
    Far,
    /// Too few pixels show the surface, one of the two is too even beside the noise, or they do not resemble each other.
    Untold,
}

/// By how many pixels `photograph` is shifted against `reconstruction`, where `counts` says that both show the
/// surface: the least sum of squares after a gain and an offset between them are allowed for, in which pixels count the less the farther
/// they are off (a highlight that the model does not know is no shift). It is looked for from none on: a pattern that repeats matches at
/// its nearest repetition. Parts of the picture must agree on it.
pub fn shift_px(photograph: &[[u8; 3]], reconstruction: &[[u8; 3]], lens: &Lens, counts: &[bool]) -> Shift {
    let (width, height) = (lens.width as usize, lens.height as usize);
    let grey = |pixel: &[u8; 3]| pixel.iter().map(|level| f64::from(*level)).sum::<f64>() / 3.0;
    let [seen, said] = [photograph, reconstruction].map(|p| p.iter().map(grey).collect::<Vec<f64>>());
    let around = |i: usize| [i, i - 1, i + 1, i - width, i + width];
    let is_inner = |i: usize| {
        let is_within = |at: usize, side: usize| at >= 2 && at + 2 < side;
        is_within(i % width, width)
            && is_within(i / width, height)
            && around(i).iter().all(|&j| around(j).iter().all(|&k| counts[k]))
    };
    let inner: Vec<bool> = (0..width * height).map(is_inner).collect();
    let pair = Pair { seen, said, width, inner };
    let all: Vec<usize> = (0..width * height).filter(|&i| pair.inner[i]).collect();
    let whole = pair.shift_of(&all, DVec2::ZERO);
    let part = |part: usize| {
        // Neighbours of a tile belong to other parts.
        let of = |i: usize| (i % width / TILE + 2 * (i / width / TILE)) % PARTS;
        let pixels: Vec<usize> = all.iter().copied().filter(|&i| of(i) == part).collect();
        pair.shift_of(&pixels, if let Shift::By(shift) = whole { shift } else { DVec2::ZERO })
    };
    match whole {
        Shift::By(_) => {
            let mut parts = [DVec2::ZERO; PARTS];
            for (i, told) in parts.iter_mut().enumerate() {
                let Shift::By(shift) = part(i) else { return Shift::Untold };
                *told = shift;
            }
            let mean = parts.iter().sum::<DVec2>() / PARTS as f64;
            let squares: f64 = parts.iter().map(|part| part.distance_squared(mean)).sum();
            let error_px = (squares / (PARTS * (PARTS - 1)) as f64).sqrt();
            if error_px < UNSURE_PX { whole } else { Shift::Untold }
        }
        Shift::Far if (0..PARTS).all(|i| part(i) == Shift::Far) => Shift::Far,
        Shift::Far | Shift::Untold => Shift::Untold,
    }
}

/// Grey levels of a photograph and of its reconstruction, and which pixels count with all that are near them.
struct Pair {
    seen: Vec<f64>,
    said: Vec<f64>,
    width: usize,
    inner: Vec<bool>,
}

impl Pair {
    /// What these pixels of the photograph tell, looked for from `start` on.
    fn shift_of(&self, pixels: &[usize], start: DVec2) -> Shift {
        let Self { seen, said, width, inner } = self;
        let is_inner = |x: f64, y: f64| {
            x >= 0.0
                && y >= 0.0
                && (x as usize) < *width
                && inner.get(y as usize * width + x as usize).is_some_and(|inner| *inner)
        };
        // Photograph(x) = gain (said(x - shift)) + offset, said linear about the shift so far.
        let (mut shift, mut weights) = (start, vec![1.0; inner.len()]);
        for _ in 0..STEPS {
            let row = |i: usize| {
                let DVec2 { x, y } = DVec2::new((i % width) as f64, (i / width) as f64) - shift;
                let at = |x: f64, y: f64| bilinear(said, *width, x, y);
                is_inner(x, y).then(|| {
                    let (dx, dy) = (at(x + 0.5, y) - at(x - 0.5, y), at(x, y + 0.5) - at(x, y - 0.5));
                    (i, [-dx, -dy, at(x, y), 1.0, seen[i]])
                })
            };
            let rows: Vec<(usize, [f64; 5])> = pixels.iter().filter_map(|&i| row(i)).collect();
            if rows.len() < FEWEST {
                return Shift::Untold;
            }
            let mut sums = [[0.0; 5]; 4];
            for (i, row) in &rows {
                for a in 0..4 {
                    for b in 0..5 {
                        sums[a][b] += weights[*i] * row[a] * row[b];
                    }
                }
            }
            // One is not the other's negative.
            let Some(found) = solved(sums).filter(|found| found[2] >= LEAST_GAIN) else {
                return Shift::Untold;
            };
            let step = DVec2::new(found[0], found[1]) / found[2];
            if !step.is_finite() {
                return Shift::Untold;
            }
            let off = |row: &[f64; 5]| ((0..4).map(|a| found[a] * row[a]).sum::<f64>() - row[4]).abs();
            let mut sorted: Vec<f64> = rows.iter().map(|(_, row)| off(row)).collect();
            let middle = sorted.len() / 2;
            // Levels are whole numbers: below half of one nothing is told.
            let usual = sorted.select_nth_unstable_by(middle, f64::total_cmp).1.max(0.5);
            rows.iter().for_each(|(i, row)| weights[*i] = 1.0 / (1.0 + (off(row) / usual).powi(2)));
            shift += step.clamp_length_max(LONGEST_PX);
            if shift.length() > FAR_PX {
                return Shift::Far;
            }
            if step.length() < CLOSE_PX {
                return Shift::By(shift);
            }
        }
        Shift::Untold
    }
}

/// Between four pixels that are there.
fn bilinear(values: &[f64], width: usize, x: f64, y: f64) -> f64 {
    let (left, top) = (x.floor(), y.floor());
    let (right, below, first) = (x - left, y - top, top as usize * width + left as usize);
    let upper = values[first] * (1.0 - right) + values[first + 1] * right;
    let lower = values[first + width] * (1.0 - right) + values[first + width + 1] * right;
    upper * (1.0 - below) + lower * below
}

/// Gauss's elimination of four equations; `None` where they do not determine their unknowns.
fn solved(mut rows: [[f64; 5]; 4]) -> Option<[f64; 4]> {
    for pivot in 0..4 {
        let best = (pivot..4).max_by(|&a, &b| rows[a][pivot].abs().total_cmp(&rows[b][pivot].abs()))?;
        rows.swap(pivot, best);
        if rows[pivot][pivot].abs() < 1e-6 {
            return None;
        }
        for row in (0..4).filter(|row| *row != pivot) {
            let (part, by) = (rows[row][pivot] / rows[pivot][pivot], rows[pivot]);
            for (value, of) in rows[row].iter_mut().zip(by).skip(pivot) {
                *value -= part * of;
            }
        }
    }
    Some(std::array::from_fn(|i| rows[i][4] / rows[i][i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(shift: DVec2, gain: f64) -> Vec<[u8; 3]> {
        let level = |i: usize| {
            let (x, y) = ((i % 80) as f64 - shift.x, (i / 80) as f64 - shift.y);
            let waves = (0.31 * x + 0.12 * y).sin() + (0.17 * x - 0.29 * y).cos() + (0.002 * x * y).sin();
            [(100.0 + gain * 20.0 * waves).round() as u8; 3]
        };
        (0..80 * 60).map(level).collect()
    }

    fn shift(photograph: &[[u8; 3]], reconstruction: &[[u8; 3]]) -> Shift {
        shift_px(photograph, reconstruction, &Lens::pinhole(80, 60, 100.0), &[true; 80 * 60])
    }

    fn assert_by(found: Shift, want: DVec2) {
        assert!(matches!(found, Shift::By(by) if (by - want).length() < 0.05), "{found:?} for {want}");
    }

    #[test]
    fn a_known_shift_is_found_under_another_gain() {
        for (x, y) in [(0.0, 0.0), (0.3, -0.2), (-0.7, 0.55), (4.0, 0.0), (-3.0, 2.5), (-4.2, -4.0)] {
            let by = DVec2::new(x, y);
            assert_by(shift(&drawn(by, 1.2), &drawn(DVec2::ZERO, 1.0)), by);
        }
    }

    #[test]
    fn a_highlight_that_the_model_does_not_know_is_no_shift() {
        let mut photograph = drawn(DVec2::new(0.2, 0.1), 1.0);
        for (i, pixel) in photograph.iter_mut().enumerate() {
            let (x, y) = ((i % 80) as f64 - 20.0, (i / 80) as f64 - 40.0);
            let light = 120.0 * (-(x * x + y * y) / 60.0).exp();
            *pixel = pixel.map(|level| (f64::from(level) + light).min(255.0) as u8);
        }
        assert_by(shift(&photograph, &drawn(DVec2::ZERO, 1.0)), DVec2::new(0.2, 0.1));
    }

    #[test]
    fn what_lies_farther_apart_is_far_and_a_negative_tells_nothing() {
        let spot = |x: f64| {
            let level = |i: usize| {
                let off = DVec2::new((i % 80) as f64 - x, (i / 80) as f64 - 30.0);
                [(30.0 + 200.0 * (-off.length_squared() / 300.0).exp()) as u8; 3]
            };
            (0..80 * 60).map(level).collect::<Vec<_>>()
        };
        assert_by(shift(&spot(39.0), &spot(31.0)), DVec2::new(8.0, 0.0));
        assert_eq!(shift(&spot(51.0), &spot(31.0)), Shift::Far);
        let negative: Vec<[u8; 3]> = spot(31.0).iter().map(|pixel| pixel.map(|level| 255 - level)).collect();
        assert_eq!(shift(&negative, &spot(31.0)), Shift::Untold);
    }

    #[test]
    fn noise_on_a_smooth_shading_tells_no_shift() {
        use rand::{Rng, SeedableRng, rngs::StdRng};
        const WIDTH: u32 = 160;
        let smooth = |i: usize| {
            let (x, y) = ((i % WIDTH as usize) as f64 / 160.0, (i / WIDTH as usize) as f64 / 100.0);
            120.0 + 5.0 * x + 3.0 * y * y
        };
        let said: Vec<[u8; 3]> = (0..16000).map(|i| [smooth(i).round() as u8; 3]).collect();
        for seed in 0..12 {
            let mut random = StdRng::seed_from_u64(seed);
            let noisy = |i: usize| [(smooth(i) + random.random_range(-4.0..4.0)).round() as u8; 3];
            let seen: Vec<[u8; 3]> = (0..16000).map(noisy).collect();
            let found = shift_px(&seen, &said, &Lens::pinhole(WIDTH, 100, 200.0), &[true; 16000]);
            let is_right =
                matches!(found, Shift::Untold) || matches!(found, Shift::By(by) if by.length() < 0.5);
            assert!(is_right, "{seed}: {found:?}");
        }
    }

    #[test]
    fn an_even_picture_and_a_hidden_one_tell_nothing() {
        let (even, drawn) = (vec![[90; 3]; 80 * 60], drawn(DVec2::ZERO, 1.0));
        assert_eq!(shift(&drawn, &even), Shift::Untold);
        assert_eq!(shift(&even, &drawn), Shift::Untold);
        let lens = Lens::pinhole(80, 60, 100.0);
        assert_eq!(shift_px(&drawn, &drawn, &lens, &[false; 4800]), Shift::Untold);
    }
}

//! How far one picture is shifted against another, to a small part of a pixel.

use glam::DVec2;
use rigel::geometry::Lens;

/// Steps of Gauss and Newton; each corrects what the linear picture of the one before left, and trusts pixels by how far they were off.
const STEPS: usize = 8;
/// Fewer pixels tell nothing.
const FEWEST: usize = 100;

/// By how many pixels `photograph` is shifted against `reconstruction` (x right, y down), where `counts` says that both show the
/// surface: the least sum of squares after a gain and an offset between them are allowed for, in which pixels count the less the farther
/// they are off (a highlight that the model does not know is no shift). `None` where too few pixels count, or the reconstruction is too even to tell.
pub fn shift_px(
    photograph: &[[u8; 3]],
    reconstruction: &[[u8; 3]],
    lens: &Lens,
    counts: &[bool],
) -> Option<DVec2> {
    let (width, height) = (lens.width as usize, lens.height as usize);
    let grey = |pixel: &[u8; 3]| pixel.iter().map(|level| f64::from(*level)).sum::<f64>() / 3.0;
    let [seen, said] = [photograph, reconstruction].map(|p| p.iter().map(grey).collect::<Vec<f64>>());
    let around = |i: usize| [i, i - 1, i + 1, i - width, i + width];
    let inner = |i: &usize| {
        let (x, y) = (i % width, i / width);
        (2..width.saturating_sub(2)).contains(&x)
            && (2..height.saturating_sub(2)).contains(&y)
            && around(*i).iter().all(|&j| around(j).iter().all(|&k| counts[k]))
    };
    let pixels: Vec<usize> = (0..width * height).filter(inner).collect();
    if pixels.len() < FEWEST {
        return None;
    }
    // Photograph(x) = gain (said(x - shift)) + offset, said linear about the shift so far.
    let (mut shift, mut weights) = (DVec2::ZERO, vec![1.0; pixels.len()]);
    for _ in 0..STEPS {
        let mut sums = [[0.0; 5]; 4];
        let row = |i: usize| {
            let (x, y) = ((i % width) as f64 - shift.x, (i / width) as f64 - shift.y);
            let at = |x: f64, y: f64| bilinear(&said, width, height, x, y);
            let (dx, dy) = (at(x + 0.5, y) - at(x - 0.5, y), at(x, y + 0.5) - at(x, y - 0.5));
            [-dx, -dy, at(x, y), 1.0, seen[i]]
        };
        let rows: Vec<[f64; 5]> = pixels.iter().map(|&i| row(i)).collect();
        for (row, weight) in rows.iter().zip(&weights) {
            for a in 0..4 {
                for b in 0..5 {
                    sums[a][b] += weight * row[a] * row[b];
                }
            }
        }
        let found = solved(sums)?;
        if found[2].abs() < 1e-3 {
            return None;
        }
        let off = |row: &[f64; 5]| (0..4).map(|a| found[a] * row[a]).sum::<f64>() - row[4];
        let offs: Vec<f64> = rows.iter().map(|row| off(row).abs()).collect();
        let mut sorted = offs.clone();
        let middle = sorted.len() / 2;
        // Levels are whole numbers: below half of one nothing is told.
        let usual = sorted.select_nth_unstable_by(middle, f64::total_cmp).1.max(0.5);
        weights = offs.iter().map(|off| 1.0 / (1.0 + (off / usual).powi(2))).collect();
        shift += DVec2::new(found[0], found[1]) / found[2];
        if !shift.is_finite() || shift.length() > 0.1 * width as f64 {
            return None;
        }
    }
    Some(shift)
}

fn bilinear(values: &[f64], width: usize, height: usize, x: f64, y: f64) -> f64 {
    let (x, y) = (x.clamp(0.0, (width - 2) as f64), y.clamp(0.0, (height - 2) as f64));
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

    #[test]
    fn a_known_shift_is_found_under_another_gain() {
        let (lens, all) = (Lens::pinhole(80, 60, 100.0), vec![true; 80 * 60]);
        for shift in [DVec2::ZERO, DVec2::new(0.3, -0.2), DVec2::new(-0.7, 0.55)] {
            let found = shift_px(&drawn(shift, 1.2), &drawn(DVec2::ZERO, 1.0), &lens, &all).unwrap();
            assert!((found - shift).length() < 0.03, "{found} for {shift}");
        }
    }

    #[test]
    fn a_highlight_that_the_model_does_not_know_is_no_shift() {
        let (lens, all) = (Lens::pinhole(80, 60, 100.0), vec![true; 80 * 60]);
        let mut photograph = drawn(DVec2::new(0.2, 0.1), 1.0);
        for (i, pixel) in photograph.iter_mut().enumerate() {
            let (x, y) = ((i % 80) as f64 - 20.0, (i / 80) as f64 - 40.0);
            let light = 120.0 * (-(x * x + y * y) / 60.0).exp();
            *pixel = pixel.map(|level| (f64::from(level) + light).min(255.0) as u8);
        }
        let found = shift_px(&photograph, &drawn(DVec2::ZERO, 1.0), &lens, &all).unwrap();
        assert!((found - DVec2::new(0.2, 0.1)).length() < 0.05, "{found}");
    }

    #[test]
    fn an_even_picture_and_a_hidden_one_tell_nothing() {
        let lens = Lens::pinhole(80, 60, 100.0);
        let even = vec![[90; 3]; 80 * 60];
        assert_eq!(shift_px(&drawn(DVec2::ZERO, 1.0), &even, &lens, &[true; 4800]), None);
        assert_eq!(shift_px(&even, &drawn(DVec2::ZERO, 1.0), &lens, &[false; 4800]), None);
    }
}

//! Where dark squares on bright ground are, all shifted by about as much from where they are expected.

use glam::DVec2;

use super::super::edge::Quad;
use super::super::luminance::Luminance;
use super::bounds;

/// Where the squares of a view seem to be.
pub(in super::super) struct Found {
    /// Correlation of each with the picture of a dark square on bright ground there, -1 to 1.
    pub scores: Vec<f64>,
    /// Where each is beside its expected place, pixels.
    pub shifts: Vec<DVec2>,
}

/// How well each square agrees with the picture, by shift.
pub(in super::super) struct Search {
    maps: Vec<Option<Vec<f64>>>,
    reach: i64,
    /// Pixels of the picture to one of the maps.
    scale: f64,
}

impl Search {
    /// Looks for squares within `reach_px` of where they are expected (`None` where one would be outside the picture).
    pub fn new(picture: &Luminance, expected: &[Option<[DVec2; 4]>], reach_px: f64) -> Self {
        // Squares of a dozen pixels are enough to look for.
        let size = expected.iter().flatten().map(|c| c[0].distance(c[2])).fold(0.0, f64::max);
        let by = ((size / 20.0) as usize).max(1);
        let reduced;
        let (picture, scale) = match by {
            1 => (picture, 1.0),
            _ => {
                reduced = picture.reduced(by);
                (&reduced, by as f64)
            }
        };
        let reach = (reach_px / scale).ceil() as i64;
        let to_reduced = |corner: DVec2| (corner + 0.5) / scale - 0.5;
        let roots: Vec<f32> = picture.value.iter().map(|value| value.max(0.0).sqrt()).collect();
        let size = (picture.width as i64, picture.height as i64);
        let map = |corners: &Option<[DVec2; 4]>| {
            correlations(&roots, size, &corners.as_ref()?.map(to_reduced), reach)
        };
        Self { maps: expected.iter().map(map).collect(), reach, scale }
    }

    /// The squares where all are shifted by as much, but for `spread` pixels of the maps: a single dark spot beside a square does not lead
    /// astray, nor does glare on some of them.
    pub fn within(&self, spread: i64) -> Found {
        let side = (2 * self.reach + 1) as usize;
        let mut sum = vec![0.0; side * side];
        for map in self.maps.iter().flatten() {
            sum.iter_mut().zip(widened(map, side, spread)).for_each(|(sum, best)| *sum += best);
        }
        let at = |index: usize| ((index % side) as i64 - self.reach, (index / side) as i64 - self.reach);
        let best = (0..sum.len()).max_by(|&a, &b| sum[a].total_cmp(&sum[b])).unwrap_or(0);
        let (x, y) = at(best);
        let mut found = Found { scores: vec![], shifts: vec![] };
        for map in &self.maps {
            let close = |&i: &usize| (at(i).0 - x).abs() <= spread && (at(i).1 - y).abs() <= spread;
            let own = map.as_ref().and_then(|map| {
                (0..map.len()).filter(close).max_by(|&a, &b| map[a].total_cmp(&map[b])).map(|i| (i, map[i]))
            });
            let (own, score) = own.unwrap_or((best, 0.0));
            found.scores.push(score);
            found.shifts.push(DVec2::new(at(own).0 as f64, at(own).1 as f64) * self.scale);
        }
        found
    }
}

/// The largest value within `spread` rows and columns, not below 0: what disagrees with a square is no evidence against
/// the others.
fn widened(map: &[f64], side: usize, spread: i64) -> Vec<f64> {
    let along = |from: &[f64], stride: usize, other: usize| {
        let mut to = vec![0.0f64; from.len()];
        for line in 0..side {
            for i in 0..side {
                let window = i.saturating_sub(spread as usize)..=(i + spread as usize).min(side - 1);
                to[line * other + i * stride] =
                    window.map(|j| from[line * other + j * stride]).fold(0.0, f64::max);
            }
        }
        to
    };
    along(&along(map, 1, side), side, 1)
}

/// The correlation of the picture's square roots with the picture of a square, by shift.
fn correlations(
    roots: &[f32],
    (width, height): (i64, i64),
    corners: &[DVec2; 4],
    reach: i64,
) -> Option<Vec<f64>> {
    let quad = Quad::new(corners)?;
    let half_px = corners[0].distance(corners[1]).min(corners[1].distance(corners[2])) / 4.0;
    let (low, high) = bounds(corners, half_px);
    let (mut pixels, mut model) = (vec![], vec![]);
    for y in low.y as i64..=high.y as i64 {
        for x in low.x as i64..=high.x as i64 {
            let at = DVec2::new(x as f64, y as f64);
            if quad.depth(at) > -half_px {
                pixels.push((x, y));
                model.push(-quad.coverage(at, 0.5).0);
            }
        }
    }
    let n = pixels.len() as f64;
    let mean = model.iter().sum::<f64>() / n;
    let norm = model.iter().map(|m| (m - mean).powi(2)).sum::<f64>().sqrt();
    let correlation = |dx: i64, dy: i64| {
        if low.x as i64 + dx < 0
            || low.y as i64 + dy < 0
            || high.x as i64 + dx >= width
            || high.y as i64 + dy >= height
        {
            return 0.0;
        }
        let (mut sum, mut squares, mut product) = (0.0, 0.0, 0.0);
        for (&(x, y), m) in pixels.iter().zip(&model) {
            let value = f64::from(roots[((y + dy) * width + x + dx) as usize]);
            sum += value;
            squares += value * value;
            product += value * m;
        }
        let spread = squares - sum * sum / n;
        if spread > 0.0 { (product - sum * mean) / (norm * spread.sqrt()) } else { 0.0 }
    };
    Some(
        (-reach..=reach)
            .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
            .map(|(dx, dy)| correlation(dx, dy))
            .collect(),
    )
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand::rngs::StdRng;

    use super::super::tests::{picture, square};
    use super::*;

    #[test]
    fn squares_are_found_at_a_common_shift() {
        let mut random = StdRng::seed_from_u64(2);
        for _ in 0..5 {
            let (truth, _) = square(&mut random);
            let picture = picture(&truth, 0.05, &mut random);
            let off = DVec2::new(7.0, -5.0);
            let found = Search::new(&picture, &[Some(truth.map(|c| c - off)), None], 12.0).within(4);
            assert!(found.scores[0] > 0.8 && found.scores[1] == 0.0, "{:?}", found.scores);
            assert!((found.shifts[0] - off).length() < 1.5, "{}", found.shifts[0]);
        }
    }
}

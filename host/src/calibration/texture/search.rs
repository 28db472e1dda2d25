//! By how much a whole view is shifted against others, from far off.

use glam::DVec2;

use super::pattern::{Pattern, Reference};

/// A correlation is that of chance up to so many standard deviations of it.
const CHANCE: f64 = 5.0;
/// So many nodes of a pattern go together: it is smoothed by a normal curve of standard deviation 1.
pub const TOGETHER: f64 = 12.6;
/// A second place that is so nearly as good may be it as well.
const NEARLY: f64 = 0.75;
/// Places this near (nodes) are the same.
const NEAR: i64 = 2;
/// Of a view and its reference so much must overlap.
const OVERLAP: f64 = 0.3;

/// Where a view fits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Found {
    /// Its texture is that of the reference so far on (nodes), with this correlation.
    At(DVec2, f64),
    /// At several places nearly as well.
    Repeated,
    /// Nowhere within reach, at best with this correlation.
    Nowhere(f64),
}

/// Looks for a pattern (on the reference's grid with a margin of `reach` nodes around it) within `reach` nodes of where it is
/// thought to be.
pub fn search(reference: &Reference, pattern: &Pattern, reach: usize) -> Found {
    let grid = reference.grid;
    let (columns, wide) = (grid.columns, pattern.grid.columns);
    let of_reference: Vec<(f32, f32)> = (0..grid.count()).map(|i| reference.without(i, 0.0, 0.0)).collect();
    let value: Vec<f32> = of_reference.iter().map(|r| r.0 * r.1).collect();
    let square: Vec<f32> = value.iter().map(|v| v * v).collect();
    let known: Vec<f32> = of_reference.iter().map(|r| r.1).collect();
    let total: f32 = known.iter().sum();
    let least = CHANCE * (TOGETHER / f64::from(total).max(1.0)).sqrt();
    let span = 2 * reach + 1;
    let correlation = |shift: usize| {
        let (dx, dy) = (shift % span, shift / span);
        let (mut product, mut of_view, mut of_others, mut overlap) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for row in 0..grid.rows {
            let theirs = row * columns..(row + 1) * columns;
            let first = (row + dy) * wide + dx;
            let (mine, weight) = (&pattern.value[first..][..columns], &pattern.weight[first..][..columns]);
            let (a, b, c, d) =
                sums(&value[theirs.clone()], &square[theirs.clone()], &known[theirs], mine, weight);
            product += f64::from(a);
            of_view += f64::from(b);
            of_others += f64::from(c);
            overlap += f64::from(d);
        }
        if overlap < OVERLAP * f64::from(total) || of_view * of_others <= 0.0 {
            return 0.0;
        }
        product / (of_view * of_others).sqrt()
    };
    let map: Vec<f64> = (0..span * span).map(correlation).collect();
    let best = (0..map.len()).max_by(|&a, &b| map[a].total_cmp(&map[b])).unwrap_or(0);
    let place = |shift: usize| ((shift % span) as i64, (shift / span) as i64);
    let (x, y) = place(best);
    let is_inside = |x: i64, y: i64| x > 0 && y > 0 && x + 1 < span as i64 && y + 1 < span as i64;
    if map[best] < least || !is_inside(x, y) {
        return Found::Nowhere(map[best]);
    }
    let is_peak = |shift: usize| {
        let (x, y) = place(shift);
        is_inside(x, y)
            && [-1i64, 0, 1].iter().all(|dy| {
                [-1i64, 0, 1].iter().all(|dx| map[((y + dy) * span as i64 + x + dx) as usize] <= map[shift])
            })
    };
    let is_other = |shift: usize| {
        let (px, py) = place(shift);
        (px - x).abs().max((py - y).abs()) > NEAR && map[shift] > NEARLY * map[best] && is_peak(shift)
    };
    if (0..map.len()).any(is_other) {
        return Found::Repeated;
    }
    let top = |before: f64, at: f64, after: f64| {
        let bend = before - 2.0 * at + after;
        if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    };
    let finer = DVec2::new(
        top(map[best - 1], map[best], map[best + 1]),
        top(map[best - span], map[best], map[best + span]),
    );
    Found::At(DVec2::new(x as f64, y as f64) + finer - reach as f64, map[best])
}

/// Of a row: products, squares of either where both are known, how many those are.
fn sums(value: &[f32], square: &[f32], known: &[f32], mine: &[f32], weight: &[f32]) -> (f32, f32, f32, f32) {
    let n = value.len();
    let (square, known, mine, weight) = (&square[..n], &known[..n], &mine[..n], &weight[..n]);
    let mut lanes = [[0.0f32; 8]; 4];
    let mut add = |lane: usize, i: usize| {
        lanes[0][lane] += value[i] * mine[i];
        lanes[1][lane] += mine[i] * mine[i] * known[i];
        lanes[2][lane] += square[i] * weight[i];
        lanes[3][lane] += known[i] * weight[i];
    };
    for chunk in 0..n / 8 {
        for lane in 0..8 {
            add(lane, 8 * chunk + lane);
        }
    }
    for i in n / 8 * 8..n {
        add(0, i);
    }
    let [a, b, c, d] = lanes.map(|lane| lane.iter().sum());
    (a, b, c, d)
}

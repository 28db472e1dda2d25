//! Corners of a photograph and how they are found again in another one that was turned.

use glam::{DMat2, DQuat, DVec2};
use rayon::prelude::*;

use crate::geometry::Lens;

/// The most corners of a cell, and cells across and down a picture.
const PER_CELL: usize = 6;
const CELLS: (usize, usize) = (14, 11);
/// Samples along the side of a patch, and pixels between them.
const SIDE: usize = 12;
const SPACING: f64 = 2.0;
/// Corners whose patches are less alike than this do not match, nor those that another one resembles nearly as much.
const ALIKE: f32 = 0.75;
const BETTER: f32 = 0.75;
/// A patch whose levels (of 1) vary less than this shows nothing.
const FLAT: f32 = 0.01;

/// Of [`aligned`].
const STEPS: usize = 5;
const FARTHEST_PX: f64 = 1.5;

type Patch = [f32; SIDE * SIDE];

/// Brightness of a photograph, 0 to 1, no larger than corners need, and its lens at that size.
pub(super) struct Gray {
    pub lens: Lens,
    values: Vec<f32>,
}

/// A photograph's corners, as pixels of its [`Gray`].
pub(super) struct Corners {
    pub at: Vec<DVec2>,
    patches: Vec<Option<Patch>>,
}

impl Gray {
    /// From levels of 0 to 1, averaged until it is at most `most` pixels wide.
    pub fn new(lens: &Lens, level: impl Fn(usize) -> f32 + Sync, most: u32) -> Self {
        let by = lens.width.div_ceil(most).max(1) as usize;
        let (width, height) = (lens.width as usize / by, lens.height as usize / by);
        let mean = |i: usize| {
            let (x, y) = (i % width * by, i / width * by);
            let all = (0..by * by).map(|k| level((y + k / by) * lens.width as usize + x + k % by));
            all.sum::<f32>() / (by * by) as f32
        };
        let values = (0..width * height).into_par_iter().map(mean).collect();
        let scale = 1.0 / by as f64;
        let shift = |centre: f64| (centre + 0.5) * scale - 0.5;
        let lens = Lens {
            width: width as u32,
            height: height as u32,
            fx: lens.fx * scale,
            fy: lens.fy * scale,
            cx: shift(lens.cx),
            cy: shift(lens.cy),
            ..*lens
        };
        let mut gray = Self { lens, values };
        gray.smooth();
        gray
    }

    /// Takes away what lies between pixels.
    fn smooth(&mut self) {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        let before = self.values.clone();
        let at = |x: usize, y: usize| before[y.min(height - 1) * width + x.min(width - 1)];
        for y in 0..height {
            for x in 0..width {
                let line = |y: usize| at(x.saturating_sub(1), y) + 2.0 * at(x, y) + at(x + 1, y);
                self.values[y * width + x] = (line(y.saturating_sub(1)) + 2.0 * line(y) + line(y + 1)) / 16.0;
            }
        }
    }

    fn value(&self, at: DVec2) -> Option<f32> {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < (width - 1) as f64 && at.y < (height - 1) as f64) {
            return None;
        }
        let (x, y, s, t) = (at.x as usize, at.y as usize, at.x.fract() as f32, at.y.fract() as f32);
        let line = |i: usize| self.values[i] * (1.0 - s) + self.values[i + 1] * s;
        Some(line(y * width + x) * (1.0 - t) + line((y + 1) * width + x) * t)
    }

    /// A patch with mean 0 and length 1, `place` taking steps from its middle to pixels.
    fn patch(&self, place: impl Fn(DVec2) -> Option<DVec2>) -> Option<Patch> {
        let mut patch = [0.0; SIDE * SIDE];
        for (i, value) in patch.iter_mut().enumerate() {
            let step = DVec2::new((i % SIDE) as f64, (i / SIDE) as f64) - (SIDE - 1) as f64 / 2.0;
            *value = self.value(place(step * SPACING)?)?;
        }
        let mean = patch.iter().sum::<f32>() / patch.len() as f32;
        patch.iter_mut().for_each(|value| *value -= mean);
        let length = patch.iter().map(|value| value * value).sum::<f32>().sqrt();
        patch.iter_mut().for_each(|value| *value /= length.max(f32::MIN_POSITIVE));
        (length > FLAT * SIDE as f32).then_some(patch)
    }

    /// Corners by the smaller eigenvalue of the gradient's moments (Shi and Tomasi, "Good features to track", CVPR 1994), the best
    /// of each cell of the picture, to a part of a pixel.
    pub fn corners(&self) -> Corners {
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        const EDGE: usize = 4;
        if width < 4 * EDGE || height < 4 * EDGE {
            return Corners { at: vec![], patches: vec![] };
        }
        let value = |x: usize, y: usize| self.values[y * width + x];
        let mut moments = vec![[0f32; 3]; width * height];
        for y in 1..height - 1 {
            for x in 1..width - 1 {
                let (dx, dy) = (value(x + 1, y) - value(x - 1, y), value(x, y + 1) - value(x, y - 1));
                moments[y * width + x] = [dx * dx, dx * dy, dy * dy];
            }
        }
        let mut strength = vec![0f32; width * height];
        for y in EDGE..height - EDGE {
            for x in EDGE..width - EDGE {
                let mut sum = [0f32; 3];
                for line in y - 2..=y + 2 {
                    for moment in &moments[line * width + x - 2..=line * width + x + 2] {
                        (0..3).for_each(|c| sum[c] += moment[c]);
                    }
                }
                let [a, b, c] = sum;
                strength[y * width + x] = 0.5 * (a + c) - (0.25 * (a - c) * (a - c) + b * b).sqrt();
            }
        }
        let mut cells: Vec<Vec<(f32, DVec2)>> = vec![vec![]; CELLS.0 * CELLS.1];
        for y in EDGE + 1..height - EDGE - 1 {
            for x in EDGE + 1..width - EDGE - 1 {
                let here = strength[y * width + x];
                let near = |dx: usize, dy: usize| strength[(y + dy - 1) * width + x + dx - 1];
                let is_top = (0..9)
                    .all(|k| k == 4 || near(k % 3, k / 3) < here || (near(k % 3, k / 3) == here && k > 4));
                if here < 1e-4 || !is_top {
                    continue;
                }
                let peak = |before: f32, after: f32| {
                    f64::from(((before - after) / (2.0 * (before - 2.0 * here + after))).clamp(-0.5, 0.5))
                };
                let by = DVec2::new(peak(near(0, 1), near(2, 1)), peak(near(1, 0), near(1, 2)));
                let cell = y * CELLS.1 / height * CELLS.0 + x * CELLS.0 / width;
                cells[cell].push((
                    here,
                    DVec2::new(x as f64, y as f64) + if by.is_finite() { by } else { DVec2::ZERO },
                ));
            }
        }
        for cell in &mut cells {
            cell.sort_by(|a, b| b.0.total_cmp(&a.0));
            cell.truncate(PER_CELL);
        }
        let at: Vec<DVec2> = cells.into_iter().flatten().map(|(_, at)| at).collect();
        let patches = at.iter().map(|&at| self.patch(|step| Some(at + step))).collect();
        Corners { at, patches }
    }
}

/// Where in the first photograph the surroundings of a corner of the second lie, from a place at most [`FARTHEST_PX`] off: Gauss and Newton on the
/// shift, after brightness and contrast of both patches are taken away (Lucas and Kanade, IJCAI 1981). The place itself where that does not
/// make them more alike.
pub(super) fn aligned(
    (first, place): (&Gray, DVec2),
    (second, corner): (&Gray, DVec2),
    first_from_second: DQuat,
) -> DVec2 {
    let try_it = || {
        // Straight lines of one photograph are bent in the other by more than what is looked for: no affine map will do.
        let second_from_first = first_from_second.inverse();
        let there = |at: DVec2| second.lens.project(second_from_first * first.lens.unproject(at)?);
        let off = corner - there(place)?;
        let wanted = second.patch(|step| Some(there(place + step)? + off))?;
        let patch = |at: DVec2| first.patch(|step| Some(at + step));
        let alike = |patch: &Patch| -> f32 { patch.iter().zip(&wanted).map(|(a, b)| a * b).sum() };
        let before = alike(&patch(place)?);
        let mut at = place;
        for _ in 0..STEPS {
            let here = patch(at)?;
            let slope = |axis: DVec2| -> Option<Patch> {
                let (before, after) = (patch(at - 0.5 * axis)?, patch(at + 0.5 * axis)?);
                Some(std::array::from_fn(|i| after[i] - before[i]))
            };
            let (by_x, by_y) = (slope(DVec2::X)?, slope(DVec2::Y)?);
            let dot = |a: &Patch, b: &Patch| f64::from(a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>());
            let off: Patch = std::array::from_fn(|i| wanted[i] - here[i]);
            let (xx, xy, yy) = (dot(&by_x, &by_x), dot(&by_x, &by_y), dot(&by_y, &by_y));
            let normal = DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy));
            let step = normal.inverse() * DVec2::new(dot(&by_x, &off), dot(&by_y, &off));
            if !step.is_finite() {
                return None;
            }
            at += step.clamp_length_max(0.5);
        }
        (at.distance(place) < FARTHEST_PX && alike(&patch(at)?) >= before).then_some(at)
    };
    try_it().unwrap_or(place)
}

/// Pairs of corners (of the first and of the second photograph) that look alike and lie within `reach_rad` of where the rotation
/// `first_from_second` puts them.
pub(super) fn matches(
    (first, first_corners): (&Gray, &Corners),
    (second, second_corners): (&Gray, &Corners),
    first_from_second: DQuat,
    reach_rad: f64,
) -> Vec<(usize, usize)> {
    let reach = reach_rad * first.lens.fx;
    let cell = reach.max(8.0);
    let (columns, rows) = (
        (f64::from(first.lens.width) / cell) as usize + 1,
        (f64::from(first.lens.height) / cell) as usize + 1,
    );
    let mut grid: Vec<Vec<usize>> = vec![vec![]; columns * rows];
    for (i, at) in first_corners.at.iter().enumerate().filter(|(i, _)| first_corners.patches[*i].is_some()) {
        grid[(at.y / cell) as usize * columns + (at.x / cell) as usize].push(i);
    }
    let second_from_first = first_from_second.inverse();
    // Best match of every corner of the first, and how alike.
    let mut best_of_first: Vec<(f32, usize)> = vec![(0.0, usize::MAX); first_corners.at.len()];
    let mut found = vec![];
    for (j, &at) in second_corners.at.iter().enumerate() {
        let Some(expected) =
            second.lens.unproject(at).and_then(|d| first.lens.project(first_from_second * d))
        else {
            continue;
        };
        let across = |step: DVec2| {
            let there = first.lens.unproject(expected + step)?;
            second.lens.project(second_from_first * there)
        };
        let (Some(right), Some(left), Some(down), Some(up)) =
            (across(DVec2::X), across(-DVec2::X), across(DVec2::Y), across(-DVec2::Y))
        else {
            continue;
        };
        let (x, y) = (expected.x / cell, expected.y / cell);
        if x < -1.0 || y < -1.0 || x > columns as f64 || y > rows as f64 {
            continue;
        }
        let turn = DMat2::from_cols((right - left) / 2.0, (down - up) / 2.0);
        let Some(patch) = second.patch(|step| Some(at + turn * step)) else { continue };
        let (mut best, mut next) = ((f32::NEG_INFINITY, usize::MAX), f32::NEG_INFINITY);
        let around = |at: f64, most: usize| {
            (at.floor() as isize - 1).max(0) as usize..((at.floor() as isize + 2).max(0) as usize).min(most)
        };
        for row in around(y, rows) {
            for column in around(x, columns) {
                for &i in &grid[row * columns + column] {
                    if first_corners.at[i].distance(expected) > reach {
                        continue;
                    }
                    let Some(known) = &first_corners.patches[i] else { continue };
                    let alike: f32 = known.iter().zip(&patch).map(|(a, b)| a * b).sum();
                    if alike > best.0 {
                        if best.1 != usize::MAX
                            && first_corners.at[best.1].distance(first_corners.at[i]) > 3.0
                        {
                            next = best.0;
                        }
                        best = (alike, i);
                    } else if alike > next && first_corners.at[best.1].distance(first_corners.at[i]) > 3.0 {
                        next = alike;
                    }
                }
            }
        }
        let (alike, i) = best;
        if alike > ALIKE && 1.0 - alike < BETTER * (1.0 - next.max(0.0)) {
            found.push((i, j, alike));
            if alike > best_of_first[i].0 {
                best_of_first[i] = (alike, j);
            }
        }
    }
    found.into_iter().filter(|&(i, j, _)| best_of_first[i].1 == j).map(|(i, j, _)| (i, j)).collect()
}

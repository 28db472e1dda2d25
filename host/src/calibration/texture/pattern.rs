//! What is the same in all views of a texture: where it is brighter and darker than around it, not by how much.

use super::plate::{Grid, Sheet};

/// Around a node the texture is compared with what lies within so many nodes.
const AROUND: usize = 7;
/// Contrast below this (standard deviation of the radiance's logarithm) is no texture, nor is what is below the noise.
const FAINT: f32 = 0.01;
/// What is left of a view's contrast where there is texture.
const TEXTURED: f32 = 0.25;
/// A highlight counts no more than so many standard deviations.
const MOST: f32 = 2.5;
/// A mean over known nodes is known where they make up this part.
const KNOWN: f32 = 0.6;

/// A texture free of brightness and contrast: 0 where nothing is known, with a weight of 0.
#[derive(Debug, Clone)]
pub struct Pattern {
    pub grid: Grid,
    pub value: Vec<f32>,
    pub weight: Vec<f32>,
}

impl Pattern {
    /// Of a view whose pixels have this noise, relative to their radiance.
    pub fn of(sheet: &Sheet, noise: f32) -> Self {
        let grid = sheet.grid;
        let faint = FAINT.max(noise).powi(2);
        let known: Vec<f32> = sheet.value.iter().map(|v| if v.is_nan() { 0.0 } else { 1.0 }).collect();
        let value: Vec<f32> = sheet.value.iter().map(|v| if v.is_nan() { 0.0 } else { *v }).collect();
        let smooth = |plane: &[f32]| along(&grid, plane, &blurred);
        let (sum, weight) = (smooth(&value), smooth(&known));
        let inside: Vec<f32> = known
            .iter()
            .zip(&weight)
            .map(|(&known, &weight)| if known > 0.0 && weight > KNOWN { 1.0 } else { 0.0 })
            .collect();
        let fine: Vec<f32> =
            (0..grid.count()).map(|i| if inside[i] > 0.0 { sum[i] / weight[i] } else { 0.0 }).collect();
        let around = |plane: &[f32]| along(&grid, plane, &boxed);
        let count = around(&inside);
        let first = around(&fine);
        let second = around(&fine.iter().map(|v| v * v).collect::<Vec<_>>());
        let pattern = |i: usize| {
            if inside[i] == 0.0 {
                return 0.0;
            }
            let mean = first[i] / count[i];
            let variance = (second[i] / count[i] - mean * mean).max(0.0);
            ((fine[i] - mean) / (variance + faint).sqrt()).clamp(-MOST, MOST)
        };
        Self { grid, value: (0..grid.count()).map(pattern).collect(), weight: inside }
    }
}

impl Pattern {
    /// Whether there is more to it than noise.
    pub fn is_textured(&self) -> bool {
        let known: f32 = self.weight.iter().sum();
        let contrast: f32 = self.value.iter().map(|v| v * v).sum();
        contrast > TEXTURED * known
    }
}

/// A filter of lines along the rows and then along the columns.
fn along(grid: &Grid, plane: &[f32], filter: &dyn Fn(&[f32], &mut [f32])) -> Vec<f32> {
    let Grid { columns, rows, .. } = *grid;
    let mut wide = vec![0.0; plane.len()];
    for (line, out) in plane.chunks_exact(columns).zip(wide.chunks_exact_mut(columns)) {
        filter(line, out);
    }
    let turned = |plane: &[f32], columns: usize, rows: usize| -> Vec<f32> {
        let mut turned = vec![0.0; plane.len()];
        for (row, line) in plane.chunks_exact(columns).enumerate() {
            for (column, value) in line.iter().enumerate() {
                turned[column * rows + row] = *value;
            }
        }
        turned
    };
    let high = turned(&wide, columns, rows);
    let mut out = vec![0.0; plane.len()];
    for (line, out) in high.chunks_exact(rows).zip(out.chunks_exact_mut(rows)) {
        filter(line, out);
    }
    turned(&out, rows, columns)
}

/// Binomial weights of five: standard deviation 1.
fn blurred(line: &[f32], out: &mut [f32]) {
    let n = line.len();
    for (i, out) in out.iter_mut().enumerate() {
        let tap = |by: usize, back: usize| {
            (i + by).checked_sub(back).filter(|&at| at < n).map_or(0.0, |at| line[at])
        };
        *out = (tap(0, 2) + tap(2, 0) + 4.0 * (tap(0, 1) + tap(1, 0)) + 6.0 * line[i]) / 16.0;
    }
}

/// Sums of [`AROUND`] on either side.
fn boxed(line: &[f32], out: &mut [f32]) {
    let n = line.len();
    let mut sum: f64 = line[..AROUND.min(n)].iter().map(|&v| f64::from(v)).sum();
    for i in 0..n {
        if i + AROUND < n {
            sum += f64::from(line[i + AROUND]);
        }
        if i > AROUND {
            sum -= f64::from(line[i - AROUND - 1]);
        }
        out[i] = sum as f32;
    }
}

/// What several patterns have in common.
#[derive(Debug, Clone)]
pub struct Reference {
    pub grid: Grid,
    sum: Vec<f32>,
    weight: Vec<f32>,
}

impl Reference {
    pub fn new(grid: Grid) -> Self {
        Self { grid, sum: vec![0.0; grid.count()], weight: vec![0.0; grid.count()] }
    }

    pub fn add(&mut self, pattern: &Pattern) {
        for i in 0..self.sum.len() {
            self.sum[i] += pattern.weight[i] * pattern.value[i];
            self.weight[i] += pattern.weight[i];
        }
    }

    /// The mean without one of them (which had this value and weight at the node); weight 0 where nothing is left.
    pub fn without(&self, i: usize, value: f32, weight: f32) -> (f32, f32) {
        let left = self.weight[i] - weight;
        if left < 0.5 { (0.0, 0.0) } else { ((self.sum[i] - weight * value) / left, 1.0) }
    }
}

//! Where a view was taken from, by what the surface itself shows: each view is aligned with what its neighbours show.
//!
//! What a surface shows changes with the direction, so views are compared through a band-pass filter of the logarithm of
//! their radiance, on the surface, with a gain for each block of it; texels that differ from view to view (foil, glints)
//! count little. Coarse bands first. How sure the alignment is follows from two halves of the surface, aligned by
//! themselves: neighbouring residuals are alike, and counting pixels would claim too much.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;

use super::adjust::MeasuredPose;
use super::luminance::Luminance;
use super::rig_model::Seen;
use crate::geometry::{Lens, Surface};

/// Texels along the longer side of the surface.
const TEXELS: usize = 200;
/// Band-pass filters, coarse to fine: standard deviations of the two Gaussians, texels, and how often each is used.
pub(super) const BANDS: [(f64, f64, usize); 2] = [(6.0, 20.0, 4), (3.0, 12.0, 4)];
/// So many neighbours foretell a view.
const NEIGHBOURS: usize = 6;
/// Side of the blocks that have a gain, texels.
const BLOCK: usize = 25;
/// A residual counts in full up to so many standard deviations.
const HUBER: f64 = 2.0;
/// Inverse variance of a step (radians, metres) before the texture is looked at: 5 milliradians, 5 millimetres.
const STIFFNESS: f64 = 4e4;
/// Darker than this part of the view's brightest tenth, the logarithm shows noise only.
const DARKEST: f32 = 0.01;

/// The surface, divided for alignment.
pub(super) struct Grid {
    columns: usize,
    rows: usize,
    step_m: f64,
    points: Vec<DVec3>,
}

impl Grid {
    pub fn new(surface: &Surface) -> Self {
        let step_m = surface.width_m.max(surface.height_m) / TEXELS as f64;
        let count = |length: f64| ((length / step_m).round() as usize).max(2);
        let (columns, rows) = (count(surface.width_m), count(surface.height_m));
        let texels = crate::geometry::Texels { columns: columns as u32, rows: rows as u32 };
        let points = (0..columns * rows)
            .map(|i| surface.texel_centre(texels, (i % columns) as u32, (i / columns) as u32))
            .collect();
        Self { columns, rows, step_m, points }
    }
}

/// One view as it appears on the surface.
struct Band {
    /// Filtered logarithm of the radiance; 0 where it was not seen.
    value: Vec<f32>,
    seen: Vec<bool>,
    /// Unit vector to the camera.
    direction: DVec3,
}

/// An alignment of all views.
pub(super) struct Alignment {
    /// Per view where it was aligned to; `None` where the texture does not suffice.
    pub measured: Vec<Option<MeasuredPose>>,
    /// Energy of what the neighbours do not foretell, relative to the energy of what is seen.
    pub unexplained: f64,
}

/// Aligns every view with its neighbours, one step from where they are.
pub(super) fn align(
    grid: &Grid,
    pictures: &[Luminance],
    lens: &Lens,
    poses: &[Seen],
    band: (f64, f64),
) -> Alignment {
    let bands: Vec<Band> = pictures
        .par_iter()
        .zip(poses)
        .map(|(picture, pose)| filtered(grid, picture, lens, pose, band))
        .collect();
    let residuals: Vec<Vec<f32>> =
        (0..bands.len()).into_par_iter().map(|view| residual(grid, &bands, view)).collect();
    let (mut left, mut energy) = (0.0, 0.0);
    for (band, residual) in bands.iter().zip(&residuals) {
        left += residual.iter().map(|r| f64::from(r.abs())).sum::<f64>();
        energy += band.value.iter().map(|v| f64::from(v.abs())).sum::<f64>();
    }
    let spread = spread(&residuals);
    let margin = (2.0 * band.0) as usize + 1;
    let halves: Vec<[(Matrix6<f64>, Vector6<f64>); 2]> = (0..bands.len())
        .into_par_iter()
        .map(|view| equations(grid, lens, &poses[view], &bands[view], &residuals[view], &spread, margin))
        .collect();
    // How much more the two halves of the surface differ than they would if texels were independent.
    let (mut squared, mut count) = (0.0, 0.0);
    let regular = Matrix6::identity() * STIFFNESS;
    for [(a, p), (b, q)] in &halves {
        let solved = |m: &Matrix6<f64>, r: &Vector6<f64>| Some((m + regular).cholesky()?.solve(r));
        let (Some(p), Some(q), Some(a), Some(b)) =
            (solved(a, p), solved(b, q), a.try_inverse(), b.try_inverse())
        else {
            continue;
        };
        if let Some(inverse) = (a + b).try_inverse() {
            let difference = p - q;
            let score = (difference.transpose() * inverse * difference)[0];
            if score.is_finite() && score > 0.0 {
                squared += score.ln();
                count += 1.0;
            }
        }
    }
    // The typical view's, not the worst one's: the geometric mean of chi-squared with six degrees of freedom is 5.03.
    let excess = if count > 0.0 { ((squared / count).exp() / 5.03f64).max(1.0) } else { 1.0 };
    let measured = halves.iter().zip(poses).map(|([(a, p), (b, q)], pose)| {
        let (matrix, right) = (a + b, p + q);
        // In directions of which the texture says next to nothing the pose stays where it is.
        let step = (matrix / excess + regular).cholesky()?.solve(&(right / excess));
        let step: [f64; 6] = step.into();
        let usable = step.iter().all(|value| value.is_finite()) && matrix.trace() > 0.0;
        usable.then(|| MeasuredPose { at: pose.after(&step), information: matrix / excess })
    });
    Alignment { measured: measured.collect(), unexplained: left / energy.max(f64::MIN_POSITIVE) }
}

fn filtered(grid: &Grid, picture: &Luminance, lens: &Lens, pose: &Seen, (fine, coarse): (f64, f64)) -> Band {
    let mut bright: Vec<f32> = picture.value.iter().step_by(17).copied().collect();
    let at = bright.len() * 9 / 10;
    let least = DARKEST * *bright.select_nth_unstable_by(at, f32::total_cmp).1;
    let sample = |point: &DVec3| {
        let pixel = lens.project(pose.to_camera(*point))?;
        Some(bilinear(picture, pixel)?.max(least).ln())
    };
    let samples: Vec<Option<f32>> = grid.points.iter().map(sample).collect();
    let seen: Vec<bool> = samples.iter().map(Option::is_some).collect();
    let known: Vec<f32> = samples.iter().flatten().copied().collect();
    let mean = known.iter().sum::<f32>() / known.len().max(1) as f32;
    let plane: Vec<f32> = samples.into_iter().map(|value| value.unwrap_or(mean) - mean).collect();
    let (a, b) = (blurred(grid, &plane, fine), blurred(grid, &plane, coarse));
    let value = a.iter().zip(&b).zip(&seen).map(|((a, b), &seen)| if seen { a - b } else { 0.0 }).collect();
    Band { value, seen, direction: pose.pose().centre_m.normalize() }
}

fn bilinear(picture: &Luminance, pixel: DVec2) -> Option<f32> {
    let (x, y) = (pixel.x.floor(), pixel.y.floor());
    if !picture.holds(DVec2::new(x, y), DVec2::new(x + 1.0, y + 1.0)) {
        return None;
    }
    let (fx, fy) = ((pixel.x - x) as f32, (pixel.y - y) as f32);
    let first = y as usize * picture.width + x as usize;
    let [a, b] = [first, first + picture.width]
        .map(|row| picture.value[row] * (1.0 - fx) + picture.value[row + 1] * fx);
    Some(a * (1.0 - fy) + b * fy)
}

/// Gaussian blur, edges repeated.
fn blurred(grid: &Grid, plane: &[f32], sigma: f64) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as i64;
    let kernel: Vec<f32> =
        (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp() as f32).collect();
    let sum: f32 = kernel.iter().sum();
    let (columns, rows) = (grid.columns, grid.rows);
    let along = |plane: &[f32], count: usize, stride: usize, other: usize, jump: usize| {
        let mut out = vec![0.0; plane.len()];
        let mut line = vec![0.0; count + 2 * reach as usize];
        for start in (0..other).map(|i| i * jump) {
            for (i, value) in line.iter_mut().enumerate() {
                let at = (i as i64 - reach).clamp(0, count as i64 - 1) as usize;
                *value = plane[start + at * stride];
            }
            for i in 0..count {
                let window = &line[i..i + kernel.len()];
                out[start + i * stride] = window.iter().zip(&kernel).map(|(v, k)| v * k).sum::<f32>() / sum;
            }
        }
        out
    };
    let across = along(plane, columns, 1, rows, columns);
    along(&across, rows, columns, columns, 1)
}

/// What the neighbours do not foretell of a view; 0 where either did not see.
fn residual(grid: &Grid, bands: &[Band], view: usize) -> Vec<f32> {
    let own = &bands[view];
    let mut near: Vec<(f64, usize)> = (0..bands.len())
        .filter(|&other| other != view)
        .map(|other| (own.direction.dot(bands[other].direction), other))
        .collect();
    near.sort_by(|a, b| b.0.total_cmp(&a.0));
    near.truncate(NEIGHBOURS);
    let (mut sum, mut weight) = (vec![0f32; own.value.len()], vec![0f32; own.value.len()]);
    for (cosine, other) in near {
        let closeness = (1.0 / (1.0 - cosine + 0.02)) as f32;
        let other = &bands[other];
        for i in (0..sum.len()).filter(|&i| other.seen[i]) {
            sum[i] += closeness * other.value[i];
            weight[i] += closeness;
        }
    }
    let foretold: Vec<f32> =
        sum.iter().zip(&weight).map(|(sum, weight)| if *weight > 0.0 { sum / weight } else { 0.0 }).collect();
    let mut residual = vec![0.0; foretold.len()];
    for top in (0..grid.rows).step_by(BLOCK) {
        for left in (0..grid.columns).step_by(BLOCK) {
            let block = (top..(top + BLOCK).min(grid.rows)).flat_map(|row| {
                let end = (left + BLOCK).min(grid.columns);
                row * grid.columns + left..row * grid.columns + end
            });
            let usable: Vec<usize> = block.filter(|&i| own.seen[i] && weight[i] > 0.0).collect();
            let (mut product, mut square) = (0.0, 1e-9);
            for &i in &usable {
                product += foretold[i] * own.value[i];
                square += foretold[i] * foretold[i];
            }
            let gain = (product / square).clamp(0.0, 3.0);
            usable.iter().for_each(|&i| residual[i] = own.value[i] - gain * foretold[i]);
        }
    }
    residual
}

/// Per texel, how much views usually differ from what is foretold of them.
fn spread(residuals: &[Vec<f32>]) -> Vec<f32> {
    let texels = residuals.first().map_or(0, Vec::len);
    let mut spread: Vec<f32> = (0..texels)
        .into_par_iter()
        .map(|texel| {
            let mut sizes: Vec<f32> = residuals.iter().map(|view| view[texel].abs()).collect();
            let middle = sizes.len() / 2;
            *sizes.select_nth_unstable_by(middle, f32::total_cmp).1 / 0.6745
        })
        .collect();
    let mut sorted = spread.clone();
    sorted.sort_by(f32::total_cmp);
    // Where nothing ever differs there is nothing to see either.
    let floor = (0.3 * sorted.get(texels / 2).copied().unwrap_or(1.0)).max(1e-4);
    spread.iter_mut().for_each(|value| *value = value.max(floor));
    spread
}

/// The normal equations of one view's pose (order of [`crate::geometry::PoseCovariance`]) from two halves of the surface,
/// a chessboard of blocks.
fn equations(
    grid: &Grid,
    lens: &Lens,
    pose: &Seen,
    band: &Band,
    residual: &[f32],
    spread: &[f32],
    margin: usize,
) -> [(Matrix6<f64>, Vector6<f64>); 2] {
    let mut halves = [(Matrix6::zeros(), Vector6::zeros()); 2];
    let mut sizes: Vec<f32> =
        residual.iter().zip(spread).filter(|(r, _)| **r != 0.0).map(|(r, s)| (r / s).abs()).collect();
    if sizes.is_empty() {
        return halves;
    }
    let middle = sizes.len() / 2;
    let scale = f64::from(*sizes.select_nth_unstable_by(middle, f32::total_cmp).1 / 0.6745).max(1e-3);
    let rotation = pose.rotation;
    let (right, up) = (rotation * DVec3::X, rotation * DVec3::Y);
    for row in margin..grid.rows.saturating_sub(margin) {
        for column in margin..grid.columns.saturating_sub(margin) {
            let i = row * grid.columns + column;
            let around = [i - 1, i + 1, i - grid.columns, i + grid.columns];
            if residual[i] == 0.0 || around.iter().any(|&j| !band.seen[j]) {
                continue;
            }
            let at = pose.to_camera(grid.points[i]);
            let Some(by_place) = derivative(lens, at) else { continue };
            let moved = |place: DVec3| by_place[0] * place.x + by_place[1] * place.y + by_place[2] * place.z;
            // A step on the surface that moves the picture as much as the pose does.
            let (across, along) = (moved(right), moved(up));
            let determinant = across.perp_dot(along);
            if determinant.abs() < 1e-9 {
                continue;
            }
            let [a, b, c, d] = around.map(|j| f64::from(band.value[j]));
            let gradient = DVec2::new(b - a, c - d) / (2.0 * grid.step_m);
            let mut line = Vector6::zeros();
            for k in 0..6 {
                let pixel = match k {
                    0..3 => moved(DVec3::AXES[k].cross(at)),
                    _ => moved(rotation * -DVec3::AXES[k - 3]),
                };
                let step = DVec2::new(pixel.perp_dot(along), across.perp_dot(pixel)) / determinant;
                line[k] = gradient.dot(step);
            }
            let sigma = f64::from(spread[i]) * scale;
            let size = f64::from(residual[i].abs()) / sigma;
            let weight = (HUBER / size).min(1.0) / (sigma * sigma);
            let half = &mut halves[(row / BLOCK + column / BLOCK) % 2];
            half.0 += line * line.transpose() * weight;
            half.1 -= line * (weight * f64::from(residual[i]));
        }
    }
    halves
}

/// How a point's pixel moves with its place in the camera frame, pixels per metre along x, y and z.
fn derivative(lens: &Lens, at: DVec3) -> Option<[DVec2; 3]> {
    let step = 1e-4 * at.z;
    let mut columns = [DVec2::ZERO; 3];
    for (column, axis) in columns.iter_mut().zip(DVec3::AXES) {
        *column = (lens.project(at + axis * step)? - lens.project(at - axis * step)?) / (2.0 * step);
    }
    Some(columns)
}

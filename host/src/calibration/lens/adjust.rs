//! Levenberg and Marquardt's adjustment of one lens and the poses of all boards: the poses are eliminated board by board
//! (Schur's complement), so that a step costs as much as the boards have corners.

use glam::{DVec2, DVec3};
use nalgebra::{SMatrix, SVector};

use super::project::{BoardPose, LENS, project};
use crate::geometry::Lens;

type Square9 = SMatrix<f64, LENS, LENS>;
/// Lens, pose and residual.
const ROW: usize = 16;
const POSE: usize = 6;
/// Steps of an adjustment at most.
const ROUNDS: usize = 60;

/// A corner of a board: where it is on it and where it was seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    pub point_m: DVec3,
    pub pixel: DVec2,
    /// What it counts for, 1 for a corner that is as sure as most.
    pub weight: f64,
}

/// A lens and the boards' poses.
#[derive(Debug, Clone)]
pub(super) struct Estimate {
    pub lens: Lens,
    pub poses: Vec<BoardPose>,
    /// Whether the adjustment that found it came to rest.
    pub settled: bool,
}

/// How residuals are weighed.
#[derive(Debug, Clone, Copy)]
pub(super) enum Loss {
    /// Least squares.
    Squares,
    /// Cauchy's: half the weight for a residual of this length, pixels.
    Cauchy(f64),
}

impl Loss {
    /// Weight of and price for a residual of this square.
    fn of(self, square: f64) -> (f64, f64) {
        match self {
            Loss::Squares => (1.0, square),
            Loss::Cauchy(half) => {
                let scaled = square / (half * half);
                (1.0 / (1.0 + scaled), half * half * scaled.ln_1p())
            }
        }
    }
}

/// What the data say of the lens when the poses are free: the normal matrix of all its numbers, each board's share of it, and what
/// each board alone would pull the lens by (its share of the gradient).
type Information = (Square9, Vec<Square9>, Vec<SVector<f64, LENS>>);

/// One board's normal equations; the last column is the gradient.
struct Block([[f64; ROW]; ROW]);

/// One board with its pose eliminated.
struct Reduced {
    normal: Square9,
    right: SVector<f64, LENS>,
    /// C⁻¹ Bᵀ and C⁻¹ h.
    back: SMatrix<f64, POSE, LENS>,
    own: SVector<f64, POSE>,
}

/// Residuals (seen minus predicted) of a board; `None` where the lens cannot show a corner.
pub(super) fn residuals(lens: &Lens, pose: &BoardPose, sights: &[Sight]) -> Option<Vec<DVec2>> {
    let predicted = |sight: &Sight| {
        lens.project(pose.rotation * sight.point_m + pose.translation_m).map(|p| sight.pixel - p)
    };
    sights.iter().map(predicted).collect()
}

fn price(estimate: &Estimate, boards: &[Vec<Sight>], loss: Loss) -> f64 {
    let mut sum = 0.0;
    for (sights, pose) in boards.iter().zip(&estimate.poses) {
        for sight in sights {
            match estimate.lens.project(pose.rotation * sight.point_m + pose.translation_m) {
                Some(pixel) => sum += sight.weight * loss.of(pixel.distance_squared(sight.pixel)).1,
                None => return f64::INFINITY,
            }
        }
    }
    sum
}

fn block(lens: &Lens, pose: &BoardPose, sights: &[Sight], loss: Loss) -> Option<Block> {
    let mut normal = [[0.0; ROW]; ROW];
    for sight in sights {
        let turned = pose.rotation * sight.point_m;
        let (pixel, by_lens, by_point) = project(lens, turned + pose.translation_m)?;
        let residual = sight.pixel - pixel;
        let weight = sight.weight * loss.of(residual.length_squared()).0;
        let [px, py, pz] = by_point;
        // A turn w of the board moves its point by w x turned.
        let turns =
            [pz * turned.y - py * turned.z, px * turned.z - pz * turned.x, py * turned.x - px * turned.y];
        let (mut x, mut y) = ([0.0; ROW], [0.0; ROW]);
        for (k, by) in by_lens.iter().chain(&turns).chain(&by_point).chain([&residual]).enumerate() {
            (x[k], y[k]) = (by.x, by.y);
        }
        for i in 0..ROW - 1 {
            let (a, b) = (weight * x[i], weight * y[i]);
            for j in 0..ROW {
                normal[i][j] += a * x[j] + b * y[j];
            }
        }
    }
    Some(Block(normal))
}

impl Block {
    fn reduced(&self, damping: f64) -> Option<Reduced> {
        let n = &self.0;
        let own = SMatrix::<f64, POSE, POSE>::from_fn(|i, j| {
            n[LENS + i][LENS + j] * if i == j { 1.0 + damping } else { 1.0 }
        });
        let with = SMatrix::<f64, POSE, LENS>::from_fn(|i, j| n[LENS + i][j]);
        let gradient = SVector::<f64, POSE>::from_fn(|i, _| n[LENS + i][ROW - 1]);
        let factor = own.cholesky()?;
        let (back, own) = (factor.solve(&with), factor.solve(&gradient));
        let normal = Square9::from_fn(|i, j| n[i][j]) - with.transpose() * back;
        let right = SVector::<f64, LENS>::from_fn(|i, _| n[i][ROW - 1]) - with.transpose() * own;
        Some(Reduced { normal, right, back, own })
    }
}

/// Finds the lens and the poses that fit best, from `start`; only the `free` numbers of the lens move. `None` where `start` cannot show the corners.
pub(super) fn adjust(
    boards: &[Vec<Sight>],
    start: Estimate,
    free: [bool; LENS],
    loss: Loss,
) -> Option<Estimate> {
    let mut estimate = Estimate { settled: false, ..start };
    let mut cost = price(&estimate, boards, loss);
    if !cost.is_finite() {
        return None;
    }
    let mut damping = 1e-4;
    for _ in 0..ROUNDS {
        let blocks: Vec<Block> = boards
            .iter()
            .zip(&estimate.poses)
            .map(|(sights, pose)| block(&estimate.lens, pose, sights, loss))
            .collect::<Option<_>>()?;
        let mut gain = None;
        while damping < 1e8 {
            if let Some(next) = step(&estimate, &blocks, free, damping) {
                let price = price(&next, boards, loss);
                if price <= cost {
                    gain = Some(cost - price);
                    (estimate, cost) = (next, price);
                    damping = (damping * 0.1).max(1e-10);
                    break;
                }
            }
            damping *= 6.0;
        }
        if gain.is_none_or(|gain| gain <= 1e-9 * cost.max(1e-12)) {
            estimate.settled = true;
            break;
        }
    }
    Some(estimate)
}

fn step(estimate: &Estimate, blocks: &[Block], free: [bool; LENS], damping: f64) -> Option<Estimate> {
    let reduced: Vec<Reduced> = blocks.iter().map(|block| block.reduced(damping)).collect::<Option<_>>()?;
    let mut normal = Square9::zeros();
    let mut right = SVector::<f64, LENS>::zeros();
    for (block, reduced) in blocks.iter().zip(&reduced) {
        normal += reduced.normal;
        right += reduced.right;
        for k in 0..LENS {
            normal[(k, k)] += damping * block.0[k][k];
        }
    }
    for k in (0..LENS).filter(|k| !free[*k]) {
        normal.row_mut(k).fill(0.0);
        normal.column_mut(k).fill(0.0);
        (normal[(k, k)], right[k]) = (1.0, 0.0);
    }
    // The numbers differ by many orders of magnitude.
    let scale = SVector::<f64, LENS>::from_fn(|k, _| 1.0 / normal[(k, k)].abs().max(1e-300).sqrt());
    let scaled = Square9::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
    let shift = scaled.cholesky()?.solve(&right.component_mul(&scale)).component_mul(&scale);
    let Lens { width, height, .. } = estimate.lens;
    let mut changed = estimate.lens.numbers();
    for k in 0..LENS {
        changed[k] += shift[k];
    }
    bound(&mut changed, width, height);
    let poses = reduced
        .iter()
        .zip(&estimate.poses)
        .map(|(reduced, pose)| pose.moved((reduced.own - reduced.back * shift).as_slice()))
        .collect();
    Some(Estimate { lens: estimate.lens.with_numbers(changed), poses, settled: false })
}

/// No lens is beyond these: the focal length within a twentieth and fifty times the picture's longer side, the principal
/// point within twice the picture.
fn bound(numbers: &mut [f64; LENS], width: u32, height: u32) {
    let (width, height) = (f64::from(width), f64::from(height));
    let longer = width.max(height);
    for focal in &mut numbers[..2] {
        *focal = focal.clamp(0.05 * longer, 50.0 * longer);
    }
    numbers[2] = numbers[2].clamp(-0.5 * width, 1.5 * width);
    numbers[3] = numbers[3].clamp(-0.5 * height, 1.5 * height);
}

/// What least squares know of the lens at an estimate.
pub(super) fn information(boards: &[Vec<Sight>], estimate: &Estimate) -> Option<Information> {
    let (mut normal, mut parts, mut pulls) = (Square9::zeros(), vec![], vec![]);
    for (sights, pose) in boards.iter().zip(&estimate.poses) {
        let reduced = block(&estimate.lens, pose, sights, Loss::Squares)?.reduced(0.0)?;
        normal += reduced.normal;
        parts.push(reduced.normal);
        pulls.push(reduced.right);
    }
    Some((normal, parts, pulls))
}

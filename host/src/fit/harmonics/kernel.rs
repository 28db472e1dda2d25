//! The two products that a fit repeats, for eight texels at once and with every texel's own directions and weights.

use multiversion::multiversion;

use super::basis::{Number, Rule};
use super::lanes::{LANES, Lane};

/// Three colour channels of eight texels.
pub(super) type Rgb = [Lane; 3];

/// So many views share each load of a coefficient.
const VIEWS: usize = 4;

/// What the views saw of eight texels, view after view. A texel that a view did not measure has weight 0.
#[derive(Default)]
pub(super) struct Packed {
    pub x: Vec<Lane>,
    pub y: Vec<Lane>,
    pub z: Vec<Lane>,
    pub weight: Vec<Lane>,
    pub radiance: Vec<Rgb>,
}

impl Packed {
    /// Room for `views` that no texel was measured in.
    pub fn start(&mut self, views: usize) {
        for (to, value) in [(&mut self.x, 0.0), (&mut self.y, 0.0), (&mut self.z, 1.0), (&mut self.weight, 0.0)] {
            to.clear();
            to.resize(views, Lane([value; LANES]));
        }
        self.radiance.clear();
        self.radiance.resize(views, [Lane::ZERO; 3]);
    }
}

/// Room for the basis of a few views.
pub(super) type Scratch = Vec<[Lane; VIEWS]>;

/// For the coefficients `of`: what they predict for each view, and its weighted product with the basis (A and AᵀWA).
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn normal_product(
    rule: &Rule<f32>,
    packed: &Packed,
    of: &[Rgb],
    scratch: &mut Scratch,
    predicted: &mut [Rgb],
    product: &mut [Rgb],
) {
    product.fill([Lane::ZERO; 3]);
    for first in (0..packed.x.len()).step_by(VIEWS) {
        basis(rule, packed, first, scratch);
        let mut sums = [[Lane::ZERO; 3]; VIEWS];
        for (basis, of) in scratch.iter().zip(of) {
            for v in 0..VIEWS {
                for c in 0..3 {
                    sums[v][c] = basis[v].times_plus(of[c], sums[v][c]);
                }
            }
        }
        let count = VIEWS.min(packed.x.len() - first);
        predicted[first..first + count].copy_from_slice(&sums[..count]);
        for v in 0..VIEWS {
            let weight = if v < count { packed.weight[first + v] } else { Lane::ZERO };
            for c in 0..3 {
                sums[v][c] = sums[v][c].times(weight);
            }
        }
        accumulate(scratch, &sums, product);
    }
}

/// AᵀW of one value per view.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn transposed_product(
    rule: &Rule<f32>,
    packed: &Packed,
    values: &[Rgb],
    scratch: &mut Scratch,
    product: &mut [Rgb],
) {
    product.fill([Lane::ZERO; 3]);
    for first in (0..packed.x.len()).step_by(VIEWS) {
        basis(rule, packed, first, scratch);
        let mut sums = [[Lane::ZERO; 3]; VIEWS];
        for v in 0..VIEWS.min(packed.x.len() - first) {
            for c in 0..3 {
                sums[v][c] = values[first + v][c].times(packed.weight[first + v]);
            }
        }
        accumulate(scratch, &sums, product);
    }
}

/// `matrix` (k x k, row after row) times `of`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn matrix_product(matrix: &[f32], of: &[Rgb], product: &mut [Rgb]) {
    let k = of.len();
    let mut rows = matrix.chunks_exact(k * VIEWS);
    let mut targets = product.chunks_exact_mut(VIEWS);
    for (rows, targets) in rows.by_ref().zip(targets.by_ref()) {
        let mut sums = [[Lane::ZERO; 3]; VIEWS];
        for (j, of) in of.iter().enumerate() {
            for r in 0..VIEWS {
                let factor = Lane::splat(rows[r * k + j]);
                for c in 0..3 {
                    sums[r][c] = factor.times_plus(of[c], sums[r][c]);
                }
            }
        }
        targets.copy_from_slice(&sums);
    }
    for (row, target) in rows.remainder().chunks_exact(k).zip(targets.into_remainder()) {
        let mut sum = [Lane::ZERO; 3];
        for (factor, of) in row.iter().zip(of) {
            for c in 0..3 {
                sum[c] = Lane::splat(*factor).times_plus(of[c], sum[c]);
            }
        }
        *target = sum;
    }
}

#[inline(always)]
fn basis(rule: &Rule<f32>, packed: &Packed, first: usize, scratch: &mut Scratch) {
    for v in 0..VIEWS {
        // Past the last view its basis stands in, with weight 0.
        let i = (first + v).min(packed.x.len() - 1);
        let (x, y, z) = (packed.x[i], packed.y[i], packed.z[i]);
        rule.fill(rule.order(), x, y, z, |index, value| scratch[index][v] = value);
    }
}

#[inline(always)]
fn accumulate(scratch: &Scratch, sums: &[Rgb; VIEWS], product: &mut [Rgb]) {
    for (basis, product) in scratch.iter().zip(product) {
        for v in 0..VIEWS {
            for c in 0..3 {
                product[c] = basis[v].times_plus(sums[v][c], product[c]);
            }
        }
    }
}

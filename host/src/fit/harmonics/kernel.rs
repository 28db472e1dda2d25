//! The two products that a fit repeats, for eight texels at once and with every texel's own directions and weights.
#![expect(clippy::needless_range_loop, reason = "indices name lanes and channels")]

use multiversion::multiversion;

use super::basis::{Number, Rule};
use super::lanes::Lane;
use super::packed::{Design, Packed};

/// Three colour channels of eight texels.
pub(super) type Rgb = [Lane; 3];

/// So many views, or rows, share each load of a coefficient: their sums are nine of the sixteen vector registers. With
/// four one is kept in memory and the products take twice as long.
const VIEWS: usize = 3;

/// The basis of a few views.
type Scratch = Vec<[Lane; VIEWS]>;

/// Memory that the products need.
pub(super) struct Room {
    basis: Scratch,
    weighted: Vec<Rgb>,
}

impl Room {
    pub fn new(count: usize) -> Self {
        Self { basis: vec![[Lane::ZERO; VIEWS]; count], weighted: Vec::new() }
    }
}

/// For the coefficients `of`: what they predict for each view, and its weighted product with the basis (A and AᵀWA).
pub(super) fn normal_product(
    rule: &Rule<f32>,
    packed: &Packed,
    of: &[Rgb],
    work: &mut Room,
    predicted: &mut [Rgb],
    product: &mut [Rgb],
) {
    match &packed.design {
        Design::Own => own_product(rule, packed, of, &mut work.basis, predicted, product),
        Design::Shared(design) => {
            transposed_matrix_product(design, of, predicted);
            weigh(&packed.weight, predicted, &mut work.weighted);
            matrix_product(design, &work.weighted, product);
        }
    }
}

/// For the coefficients `of`: what they predict for each view (A alone).
pub(super) fn predict(rule: &Rule<f32>, packed: &Packed, of: &[Rgb], work: &mut Room, predicted: &mut [Rgb]) {
    match &packed.design {
        Design::Own => own_predicted(rule, packed, of, &mut work.basis, predicted),
        Design::Shared(design) => transposed_matrix_product(design, of, predicted),
    }
}

/// AᵀW of one value per view.
pub(super) fn transposed_product(
    rule: &Rule<f32>,
    packed: &Packed,
    values: &[Rgb],
    work: &mut Room,
    product: &mut [Rgb],
) {
    match &packed.design {
        Design::Own => own_transposed(rule, packed, values, &mut work.basis, product),
        Design::Shared(design) => {
            weigh(&packed.weight, values, &mut work.weighted);
            matrix_product(design, &work.weighted, product);
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn weigh(weights: &[Lane], values: &[Rgb], weighted: &mut Vec<Rgb>) {
    weighted.clear();
    weighted.extend(weights.iter().zip(values).map(|(w, v)| [w.times(v[0]), w.times(v[1]), w.times(v[2])]));
}

/// For the coefficients `of`: what they predict for each view, and its weighted product with the basis (A and AᵀWA).
#[multiversion(targets("x86_64+avx2+fma"))]
fn own_product(
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
        let mut sums = seen(scratch, of);
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

/// What the coefficients `of` predict for each view.
#[multiversion(targets("x86_64+avx2+fma"))]
fn own_predicted(
    rule: &Rule<f32>,
    packed: &Packed,
    of: &[Rgb],
    scratch: &mut Scratch,
    predicted: &mut [Rgb],
) {
    for (block, predicted) in predicted.chunks_mut(VIEWS).enumerate() {
        basis(rule, packed, block * VIEWS, scratch);
        predicted.copy_from_slice(&seen(scratch, of)[..predicted.len()]);
    }
}

/// AᵀW of one value per view.
#[multiversion(targets("x86_64+avx2+fma"))]
fn own_transposed(
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

/// `matrix` (row after row, each as long as `of`) times `of`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn matrix_product(matrix: &[f32], of: &[Rgb], product: &mut [Rgb]) {
    let k = of.len();
    if k == 0 {
        return product.fill([Lane::ZERO; 3]);
    }
    let mut rows = matrix.chunks_exact(k * VIEWS);
    let mut targets = product.chunks_exact_mut(VIEWS);
    for (rows, targets) in rows.by_ref().zip(targets.by_ref()) {
        let mut sums = [[Lane::ZERO; 3]; VIEWS];
        let (r0, rest) = rows.split_at(k);
        let (r1, rest) = rest.split_at(k);
        for (((of, a), b), c) in of.iter().zip(r0).zip(r1).zip(rest) {
            outer([*a, *b, *c], of, &mut sums);
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

/// The transpose of `matrix` (as many rows as `of` has, each as long as `product`) times `of`.
#[multiversion(targets("x86_64+avx2+fma"))]
fn transposed_matrix_product(matrix: &[f32], of: &[Rgb], product: &mut [Rgb]) {
    let n = product.len();
    for first in (0..n).step_by(VIEWS) {
        let mut sums = [[Lane::ZERO; 3]; VIEWS];
        let last = VIEWS.min(n - first);
        for (row, of) in matrix.chunks_exact(n).zip(of) {
            let mut factors = [0.0; VIEWS];
            if last == VIEWS {
                factors.copy_from_slice(&row[first..first + VIEWS]);
            } else {
                factors[..last].copy_from_slice(&row[first..]);
            }
            outer(factors, of, &mut sums);
        }
        product[first..first + last].copy_from_slice(&sums[..last]);
    }
}

#[inline(always)]
fn outer(factors: [f32; VIEWS], of: &Rgb, sums: &mut [Rgb; VIEWS]) {
    for r in 0..VIEWS {
        let factor = Lane::splat(factors[r]);
        for c in 0..3 {
            sums[r][c] = factor.times_plus(of[c], sums[r][c]);
        }
    }
}

/// Adds `factor` times `from`.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn advance(to: &mut [Rgb], from: &[Rgb], factor: &Rgb) {
    for (to, from) in to.iter_mut().zip(from) {
        for c in 0..3 {
            to[c] = from[c].times_plus(factor[c], to[c]);
        }
    }
}

/// The weighted sum of the squares of one value per view.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn energy(weights: &[Lane], values: &[Rgb]) -> Rgb {
    let mut sums = [Lane::ZERO; 3];
    for (weight, values) in weights.iter().zip(values) {
        for c in 0..3 {
            sums[c] = values[c].times(values[c]).times_plus(*weight, sums[c]);
        }
    }
    sums
}

/// Sums of the squares of what is `missing`: with the expected weights, and with the fit's weights for each channel.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn tally(expected: &[Lane], packed: &Packed, missing: &[Rgb]) -> (Lane, Rgb) {
    let (mut weighted, mut misfit) = (Lane::ZERO, [Lane::ZERO; 3]);
    for ((expected, weight), missing) in expected.iter().zip(&packed.weight).zip(missing) {
        for c in 0..3 {
            let square = missing[c].times(missing[c]);
            weighted = square.times_plus(*expected, weighted);
            misfit[c] = square.times_plus(*weight, misfit[c]);
        }
    }
    (weighted, misfit)
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
fn seen(scratch: &Scratch, of: &[Rgb]) -> [Rgb; VIEWS] {
    let mut sums = [[Lane::ZERO; 3]; VIEWS];
    for (basis, of) in scratch.iter().zip(of) {
        for v in 0..VIEWS {
            for c in 0..3 {
                sums[v][c] = basis[v].times_plus(of[c], sums[v][c]);
            }
        }
    }
    sums
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

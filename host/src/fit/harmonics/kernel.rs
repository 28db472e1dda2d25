//! The two products that a fit repeats, for eight texels at once and with every texel's own directions and weights.
#![expect(clippy::needless_range_loop, reason = "indices name lanes and channels")]

use glam::DVec3;
use multiversion::multiversion;

use super::basis::{Basis, Number, Rule};
use super::lanes::{LANES, Lane};
use super::smooth::Weighing;

/// Three colour channels of eight texels.
pub(super) type Rgb = [Lane; 3];

/// So many views, or rows, share each load of a coefficient: their sums are nine of the sixteen vector registers. With
/// four one is kept in memory and the products take twice as long.
const VIEWS: usize = 3;

/// What the views saw of eight texels, view after view. A texel that a view did not measure has weight 0.
pub(super) struct Packed {
    pub x: Vec<Lane>,
    pub y: Vec<Lane>,
    pub z: Vec<Lane>,
    pub weight: Vec<Lane>,
    pub radiance: Vec<Rgb>,
    pub design: Design,
}

impl Packed {
    pub fn new() -> Self {
        let none = Vec::new;
        Self { x: none(), y: none(), z: none(), weight: none(), radiance: Vec::new(), design: Design::Own }
    }

    /// Room for `views` that no texel was measured in.
    pub fn start(&mut self, views: usize) {
        // Until the observations are weighed, a standard deviation stands for the weight.
        let none = f32::NAN;
        for (to, value) in
            [(&mut self.x, 0.0), (&mut self.y, 0.0), (&mut self.z, 1.0), (&mut self.weight, none)]
        {
            to.clear();
            to.resize(views, Lane([value; LANES]));
        }
        self.radiance.clear();
        self.radiance.resize(views, [Lane::ZERO; 3]);
    }
}

/// What stands for the views' directions in a group of eight texels.
pub(super) enum Design {
    /// The texels see the views from nearly the same directions: the basis at their means, k x n.
    Shared(Vec<f32>),
    /// Every texel has its own.
    Own,
}

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

/// Puts weights where the standard deviations are. What is no number takes no part, and leaves none behind.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn weigh_observations(packed: &mut Packed, weighing: &Weighing) {
    let Packed { x, y, z, weight, radiance, .. } = packed;
    for ((((x, y), z), weight), radiance) in x.iter_mut().zip(y).zip(z).zip(weight).zip(radiance) {
        for i in 0..LANES {
            let seen = [radiance[0].0[i], radiance[1].0[i], radiance[2].0[i]];
            // A sum with anything in it that is not finite is not finite, and 0 times that is no number.
            let finite = 0.0 * (seen[0] + seen[1] + seen[2] + x.0[i] + y.0[i] + z.0[i]) == 0.0;
            let own = weighing.weight(seen, weight.0[i]);
            weight.0[i] = if finite { own } else { 0.0 };
            let used = finite && own > 0.0;
            for channel in radiance.iter_mut() {
                channel.0[i] = if used { channel.0[i] } else { 0.0 };
            }
            x.0[i] = if used { x.0[i] } else { 0.0 };
            y.0[i] = if used { y.0[i] } else { 0.0 };
            z.0[i] = if used { z.0[i] } else { 1.0 };
        }
    }
}

/// Settles the design, once the views are in. A direction that is nearer to the mean of its view's than
/// `shared_within` (chord of the unit sphere) may be taken for it.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn settle(packed: &mut Packed, basis: Basis, rule: &Rule<f32>, count: usize, shared_within: f32) {
    let n = packed.weight.len();
    let mut means = Vec::with_capacity(n);
    let mut farthest = 0.0_f32;
    for row in 0..n {
        let (x, y, z) = (packed.x[row].0, packed.y[row].0, packed.z[row].0);
        let measured = packed.weight[row].0.map(|weight| if weight > 0.0 { 1.0 } else { 0.0 });
        let total = |lanes: [f32; LANES]| {
            let halves: [f32; 4] =
                std::array::from_fn(|i| lanes[i] * measured[i] + lanes[i + 4] * measured[i + 4]);
            (halves[0] + halves[2]) + (halves[1] + halves[3])
        };
        let mean = DVec3::new(total(x).into(), total(y).into(), total(z).into()).normalize_or(DVec3::Z);
        let (mx, my, mz) = (mean.x as f32, mean.y as f32, mean.z as f32);
        for i in 0..LANES {
            let square = (x[i] - mx).powi(2) + (y[i] - my).powi(2) + (z[i] - mz).powi(2);
            farthest = farthest.max(square * measured[i]);
        }
        means.push(basis.place(mean));
    }
    if farthest > shared_within * shared_within {
        packed.design = Design::Own;
        for row in 0..n {
            for i in 0..LANES {
                let own = DVec3::new(
                    packed.x[row].0[i].into(),
                    packed.y[row].0[i].into(),
                    packed.z[row].0[i].into(),
                );
                let place = basis.place(own);
                (packed.x[row].0[i], packed.y[row].0[i], packed.z[row].0[i]) =
                    (place.x as f32, place.y as f32, place.z as f32);
            }
        }
        return;
    }
    let mut design = match std::mem::replace(&mut packed.design, Design::Own) {
        Design::Shared(design) => design,
        Design::Own => Vec::new(),
    };
    design.resize(n * count, 0.0);
    for (block, places) in means.chunks(LANES).enumerate() {
        let at = |axis: usize| Lane::of(|i| places[i.min(places.len() - 1)][axis] as f32);
        rule.fill(rule.order(), at(0), at(1), at(2), |index, value| {
            let first = index * n + block * LANES;
            if places.len() == LANES {
                design[first..first + LANES].copy_from_slice(&value.0);
            } else {
                design[first..first + places.len()].copy_from_slice(&value.0[..places.len()]);
            }
        });
    }
    packed.design = Design::Shared(design);
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
fn accumulate(scratch: &Scratch, sums: &[Rgb; VIEWS], product: &mut [Rgb]) {
    for (basis, product) in scratch.iter().zip(product) {
        for v in 0..VIEWS {
            for c in 0..3 {
                product[c] = basis[v].times_plus(sums[v][c], product[c]);
            }
        }
    }
}

//! Smoothed fits of the texels of a tile, eight side by side.
//!
//! Every texel has its own weights and, in perspective, its own directions, so every texel has its own system of
//! equations. Neighbours' systems are alike: the inverse of the tile's mean system is the preconditioner of a conjugate
//! gradient search in each texel's own system, which ends when what is left is small against the noise of the fit. A
//! tile of equal texels takes one step, and what the sharing costs is known for each texel instead of hoped for.

use std::sync::Arc;

use glam::DVec3;
use nalgebra::DMatrix;

use super::HarmonicsMethod;
use super::basis::{Basis, Number, Rule};
use super::kernel::{
    Rgb, Room, advance, energy, matrix_product, normal_product, predict, tally, transposed_product,
};
use super::lanes::{LANES, Lane};
use super::packed::{Packed, pack, settle, weigh_observations};
use super::penalty::{self, Normal};
use super::positive::Positive;
use crate::fit::weights::Samples;
use crate::observation::TexelObservations;

/// The search ends where its error is below this share of the standard deviation that the noise gives the fit.
const ACCURACY: f32 = 0.1;
/// A step whose error is foretold, from the fall of the one before, to end this many times below what is asked for is the last:
/// what is left is not worked out.
const FORETOLD: f32 = 4.0;
/// A neighbour's coefficients are a beginning where they leave less than this of a texel's energy.
const LIKE: f32 = 0.25;
/// Most steps of a search: a texel seen by a few views of its tile's takes longest.
const STEPS: usize = 16;
/// So many texels of a tile stand for it.
const STAND_FOR_A_TILE: usize = 64;
/// Eight neighbours take one direction for each view where theirs are within this of their mean (0.1 degrees): it turns
/// what they are fitted to by less than that.
const SHARED_WITHIN: f32 = 0.1 * std::f32::consts::PI / 180.0;
/// How sure the expected errors are, in observations: they count beside the residuals of a texel with few views.
const PRIOR_FREEDOM: f32 = 4.0;

/// How much an observation counts: 1 / (σ² + (relative error x radiance)² + floor²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weighing {
    /// What no model says exactly, as a fraction of the radiance.
    pub relative_error: f64,
    /// What no model says exactly, as a radiance.
    pub floor: f64,
    /// Observations that disagree with the rest count less (Huber weights).
    pub robust: bool,
}

impl Weighing {
    /// 0 for what cannot be weighed.
    #[inline(always)]
    pub(super) fn weight(&self, [r, g, b]: [f32; 3], sigma: f32) -> f32 {
        let model = self.relative_error as f32 * (r + g + b) * (1.0 / 3.0);
        let floor = self.floor as f32;
        let weight = 1.0 / (sigma * sigma + model * model + floor * floor);
        if weight > 0.0 && weight < f32::INFINITY { weight } else { 0.0 }
    }
}

/// One texel's smooth fit.
#[derive(Debug, Clone)]
pub struct SmoothFit {
    /// Coefficients, function after function, R G B each.
    pub parameters: Vec<f32>,
    /// Root mean square of (model - measured) / expected error, robust weights left out.
    pub residual: f32,
    /// How many views took part.
    pub views: u32,
    /// Whether the search reached its accuracy.
    pub converged: bool,
    /// Whether the fit had to be held above zero somewhere.
    pub held: bool,
    /// Variance of an observation of weight 1, from the residuals, for each channel.
    variance: [f32; 3],
    spread: Arc<Spread>,
}

/// The shape of the uncertainty of all fits of a tile.
#[derive(Debug)]
struct Spread {
    basis: Basis,
    order: usize,
    inverse: DMatrix<f64>,
}

impl SmoothFit {
    /// Standard deviation of the model's radiance toward `direction` (unit vector, surface frame), for each channel.
    ///
    /// The posterior's (Wahba 1983): noise, and what the penalty hides under the assumption that truth is as smooth as
    /// the penalty says. What the functions cannot say at all, a highlight sharper than they are, is not in it.
    pub fn sigma(&self, direction: DVec3) -> [f64; 3] {
        let Spread { basis, order, inverse } = &*self.spread;
        let mut row = nalgebra::DVector::zeros(basis.count(*order));
        basis.at(*order, direction, row.as_mut_slice());
        let shape = row.dot(&(inverse * &row)).max(0.0);
        self.variance.map(|variance| (f64::from(variance) * shape).sqrt())
    }
}

/// Fits smooth functions of direction to the texels of one surface.
pub struct Smooth {
    pub(super) basis: Basis,
    pub(super) order: usize,
    weighing: Weighing,
    rule: Rule<f32>,
    /// The penalty's matrix, k x k.
    pub(super) prior: DMatrix<f64>,
    prior_single: Vec<f32>,
    positive: Positive,
}

/// The tile's mean system.
struct Shared {
    inverse: Vec<f32>,
    freedom: f32,
    spread: Arc<Spread>,
}

impl Smooth {
    /// Prepares for a surface of which `sample` holds some texels. `order`: one more than the highest degree. `penalty`:
    /// weight of the smoothness; `None`: chosen by generalised cross-validation on the sample; 0: plain least squares.
    pub fn new(
        method: HarmonicsMethod,
        order: u8,
        penalty: Option<f64>,
        weighing: Weighing,
        sample: &[TexelObservations],
    ) -> Self {
        let (basis, order) = (method.basis(), usize::from(order));
        let rough = penalty::roughness(basis, order);
        // Without any penalty it is plain least squares.
        let hole = match penalty {
            Some(0.0) => DMatrix::zeros(rough.len(), rough.len()),
            _ => penalty::hole_slope(basis, order, &views_of(sample)),
        };
        let penalty = penalty.unwrap_or_else(|| {
            let stride = sample.len().div_ceil(64).max(1);
            let normals: Vec<Normal> = sample
                .iter()
                .step_by(stride)
                .map(|texel| Samples::of(texel, weighing.relative_error, weighing.floor))
                .filter(|samples| samples.len() > 1)
                .map(|s| penalty::normal(basis, order, &s.directions, &s.radiance, &s.weights))
                .collect();
            penalty::choose(&normals, &rough, &hole)
        });
        let prior = hole + DMatrix::from_diagonal(&(rough * penalty));
        Self {
            basis,
            order,
            weighing,
            rule: basis.rule(order).single(),
            prior_single: single(&prior),
            prior,
            positive: Positive::new(basis, order),
        }
    }

    /// [`Smooth::fit_tile`]'s coefficients of one texel without its shortcuts, robust weights and bound; slow, in double
    /// precision. `None` where nothing was measured.
    pub fn fit_directly(&self, texel: &TexelObservations) -> Option<Vec<f32>> {
        let samples = Samples::of(texel, self.weighing.relative_error, self.weighing.floor);
        let found = self.fit_alone(&samples).filter(|_| samples.len() > 0)?;
        Some(found.transpose().iter().map(|value| *value as f32).collect())
    }

    /// One texel's coefficients (k x 3) in double precision, without sharing anything and without holding them above zero:
    /// what [`Smooth::fit_tile`] comes close to. For bases whose systems are too ill-conditioned for less, and for tests.
    pub(in crate::fit) fn fit_alone(&self, samples: &Samples) -> Option<DMatrix<f64>> {
        let Samples { directions, radiance, weights } = samples;
        let normal = penalty::normal(self.basis, self.order, directions, radiance, weights);
        penalty::system(&(normal.gram + &self.prior)).map(|factor| factor.solve(&normal.right))
    }

    /// Fits texels that lie beside each other, in order. Texels without any usable observation are black.
    pub fn fit_tile(&self, texels: &[&TexelObservations]) -> Vec<SmoothFit> {
        let shared = self.shared(texels);
        let mut work = Work::new(self.basis.count(self.order));
        texels.chunks(LANES).flat_map(|group| self.fit_group(group, &shared, &mut work)).collect()
    }

    /// The mean system of a tile: of each view, the mean direction and weight over some of its texels.
    fn shared(&self, texels: &[&TexelObservations]) -> Shared {
        let k = self.basis.count(self.order);
        let mut views: Vec<(DVec3, f64)> = Vec::new();
        let stride = texels.len().div_ceil(STAND_FOR_A_TILE).max(1);
        for texel in texels.iter().step_by(stride) {
            let weight = |i: usize| {
                let (direction, radiance, sigma) = (texel.direction[i], texel.radiance[i], texel.sigma[i]);
                let seen = direction.to_array().into_iter().chain(radiance).all(f32::is_finite);
                if seen { f64::from(self.weighing.weight(radiance, sigma)) } else { 0.0 }
            };
            let weights: Vec<f64> = (0..texel.len()).map(weight).collect();
            let total: f64 = weights.iter().sum();
            for ((view, direction), weight) in texel.view.iter().zip(&texel.direction).zip(weights) {
                if weight > 0.0 {
                    let view = *view as usize;
                    views.resize(views.len().max(view + 1), (DVec3::ZERO, 0.0));
                    views[view].0 += direction.as_dvec3();
                    views[view].1 += weight / total;
                }
            }
        }
        let total: f64 = views.iter().map(|view| view.1).sum::<f64>().max(f64::MIN_POSITIVE);
        let present: Vec<_> = views.iter().filter(|view| view.1 > 0.0).collect();
        let mut design = DMatrix::zeros(k, present.len());
        for ((direction, weight), mut column) in present.into_iter().zip(design.column_iter_mut()) {
            self.basis.at(self.order, direction.normalize(), column.as_mut_slice());
            column *= (weight / total).sqrt();
        }
        let gram = &design * design.transpose();
        let inverse = penalty::system(&(&gram + &self.prior))
            .map_or_else(|| DMatrix::identity(k, k), |factor| factor.inverse());
        let freedom = inverse.dot(&gram) as f32;
        let spread = Arc::new(Spread { basis: self.basis, order: self.order, inverse });
        Shared { inverse: single(&spread.inverse), freedom, spread }
    }

    fn pack(&self, group: &[&TexelObservations], packed: &mut Packed, rows: &mut Vec<usize>) {
        pack(group, packed, rows);
        weigh_observations(packed, &self.weighing);
        settle(packed, self.basis, &self.rule, self.basis.count(self.order), SHARED_WITHIN);
    }

    fn fit_group(&self, group: &[&TexelObservations], shared: &Shared, work: &mut Work) -> Vec<SmoothFit> {
        self.pack(group, &mut work.packed, &mut work.rows);
        let expected = work.packed.weight.clone();
        let total = sum(expected.iter().copied());
        let views = sum(expected.iter().map(|w| Lane::of(|i| f32::from(u8::from(w.0[i] > 0.0)))));
        let inverse_total = Lane::of(|i| if total.0[i] > 0.0 { 1.0 / total.0[i] } else { 0.0 });
        work.packed.weight.iter_mut().for_each(|weight| *weight = weight.times(inverse_total));
        let mean: Rgb = std::array::from_fn(|c| {
            let Packed { weight, radiance, .. } = &work.packed;
            sum(weight.iter().zip(radiance).map(|(weight, radiance)| weight.times(radiance[c])))
        });
        work.predicted.resize(work.packed.radiance.len(), [Lane::ZERO; 3]);
        self.begin(work);
        let mut converged = self.search(shared, &views, work);
        if self.weighing.robust {
            for _ in 0..3 {
                if !reweight(&expected, work) {
                    break;
                }
                converged = self.search(shared, &views, work);
            }
        }
        let held = self.positive.mend(&mut work.found, &mean, &shared.inverse);
        if held.contains(&true) {
            self.miss(work);
        }
        let (weighted, misfit) = tally(&expected, &work.packed, &work.missing);
        let parameters = |lane: usize| work.found.iter().flat_map(move |rgb| rgb.map(|c| c.0[lane]));
        let constant = |lane: usize| {
            let value = |c: usize| mean[c].0[lane].max(0.0) * self.basis.one() as f32;
            let first = [0, 1, 2].map(|c| if value(c).is_finite() { value(c) } else { 0.0 });
            first.into_iter().chain(std::iter::repeat(0.0)).take(3 * work.found.len())
        };
        let fits = (0..group.len()).map(|lane| {
            let finite = parameters(lane).all(f32::is_finite);
            let n = views.0[lane];
            let left = (n - shared.freedom).max(0.0) + PRIOR_FREEDOM;
            let prior = PRIOR_FREEDOM * inverse_total.0[lane];
            SmoothFit {
                parameters: if finite { parameters(lane).collect() } else { constant(lane).collect() },
                residual: (weighted.0[lane] / (3.0 * n).max(1.0)).sqrt(),
                views: n as u32,
                converged: converged[lane] && finite,
                held: held[lane],
                variance: misfit.map(|misfit| (misfit.0[lane] + prior) / left),
                spread: shared.spread.clone(),
            }
        });
        fits.collect()
    }

    /// What the views saw more than `work.found` predicts.
    fn miss(&self, work: &mut Work) {
        let Work { packed, room, missing, predicted, found, .. } = work;
        predict(&self.rule, packed, found, room, predicted);
        missing.clear();
        let both = packed.radiance.iter().zip(predicted.iter());
        missing.extend(both.map(|(seen, predicted)| minus(seen, predicted)));
    }

    /// Begins a search: with the coefficients of the group before, which lies beside this one, where they are like it, else with none.
    fn begin(&self, work: &mut Work) {
        self.miss(work);
        let Work { packed, missing, found, prior, .. } = work;
        matrix_product(&self.prior_single, found, prior);
        let objective = plus(&energy(&packed.weight, missing), &inner(found, prior));
        let energy = energy(&packed.weight, &packed.radiance);
        for c in 0..3 {
            // What is no number is not like it either.
            let is_like = |i: &usize| objective[c].0[*i] < LIKE * energy[c].0[*i];
            for i in (0..LANES).filter(|i| !is_like(i)) {
                found.iter_mut().for_each(|found| found[c].0[i] = 0.0);
                let both = missing.iter_mut().zip(&packed.radiance);
                both.for_each(|(missing, seen)| missing[c].0[i] = seen[c].0[i]);
            }
        }
    }

    /// Conjugate gradients from `work.found`, for which `work.missing` is what the views saw more than it predicts.
    fn search(&self, shared: &Shared, views: &Lane, work: &mut Work) -> [bool; LANES] {
        let Work { packed, room, missing, predicted, found, residue, step, product, prior, turned, .. } =
            work;
        transposed_product(&self.rule, packed, missing, room, residue);
        matrix_product(&self.prior_single, found, prior);
        let mut objective = plus(&energy(&packed.weight, missing), &inner(found, prior));
        let whole = energy(&packed.weight, &packed.radiance);
        residue.iter_mut().zip(prior.iter()).for_each(|(to, from)| *to = minus(to, from));
        matrix_product(&shared.inverse, residue, turned);
        step.copy_from_slice(turned);
        let mut height = inner(residue, turned);
        let reached = |left: &Rgb, objective: &Rgb| -> [bool; LANES] {
            std::array::from_fn(|i| {
                (0..3).all(|c| {
                    let noise = objective[c].0[i].max(0.0) * shared.freedom / views.0[i].max(1.0);
                    left[c].0[i] <= ACCURACY * ACCURACY * noise + 1e-10 * whole[c].0[i]
                })
            })
        };
        let mut converged = reached(&height, &objective);
        // What a step leaves of `height`.
        let mut fall = [Lane([1.0; LANES]); 3];
        for _ in 0..STEPS {
            if converged == [true; LANES] {
                break;
            }
            let foretold: Rgb =
                std::array::from_fn(|c| height[c].times(fall[c]).times(Lane::splat(FORETOLD)));
            let last = reached(&foretold, &objective) == [true; LANES];
            let curve = if last {
                predict(&self.rule, packed, step, room, predicted);
                matrix_product(&self.prior_single, step, prior);
                plus(&energy(&packed.weight, predicted), &inner(step, prior))
            } else {
                normal_product(&self.rule, packed, step, room, predicted, product);
                matrix_product(&self.prior_single, step, prior);
                product.iter_mut().zip(prior.iter()).for_each(|(to, from)| *to = plus(to, from));
                inner(step, product)
            };
            let length: Rgb = std::array::from_fn(|c| ratio(height[c], curve[c]));
            advance(found, step, &length);
            let back = length.map(|l| Lane::ZERO.minus(l));
            advance(missing, predicted, &back);
            if last {
                return [true; LANES];
            }
            advance(residue, product, &back);
            for c in 0..3 {
                objective[c] = objective[c].minus(length[c].times(height[c]));
            }
            matrix_product(&shared.inverse, residue, turned);
            let left = inner(residue, turned);
            converged = reached(&left, &objective);
            let turn: Rgb = std::array::from_fn(|c| ratio(left[c], height[c]));
            for (step, turned) in step.iter_mut().zip(turned.iter()) {
                *step = std::array::from_fn(|c| turned[c].plus(step[c].times(turn[c])));
            }
            (height, fall) = (left, turn);
        }
        converged
    }
}

/// The mean direction of each view of a sample.
fn views_of(sample: &[TexelObservations]) -> Vec<DVec3> {
    let mut sums: Vec<DVec3> = Vec::new();
    for texel in sample {
        for (view, direction) in texel.view.iter().zip(&texel.direction).filter(|(_, d)| d.is_finite()) {
            sums.resize(sums.len().max(*view as usize + 1), DVec3::ZERO);
            sums[*view as usize] += direction.as_dvec3();
        }
    }
    sums.into_iter().filter_map(DVec3::try_normalize).collect()
}

/// Huber's weights from the misses; `false`, and nothing changed, where no observation of the eight texels disagrees with
/// the rest. The weights' sum stays that of before.
fn reweight(expected: &[Lane], work: &mut Work) -> bool {
    let mut any = false;
    for lane in 0..LANES {
        let misses = &mut work.misses;
        misses.clear();
        for (missing, weight) in work.missing.iter().zip(expected).filter(|(_, w)| w.0[lane] > 0.0) {
            let square: f32 = missing.iter().map(|channel| channel.0[lane].powi(2)).sum();
            misses.push((square * weight.0[lane] / 3.0).sqrt());
        }
        if misses.is_empty() {
            continue;
        }
        let most = misses.iter().copied().fold(0.0, f32::max);
        let middle = misses.len() / 2;
        let in_order = misses.clone();
        // The median miss of a Gaussian in three channels is 0.89 standard deviations. Far below the expected error
        // is agreement.
        let scale = (*misses.select_nth_unstable_by(middle, f32::total_cmp).1 / 0.89).max(0.01);
        if most <= 4.0 * scale {
            continue;
        }
        any = true;
        let mut total = 0.0;
        let measured = || expected.iter().enumerate().filter(|(_, w)| w.0[lane] > 0.0);
        for ((row, weight), miss) in measured().zip(&in_order) {
            let weight = weight.0[lane] * (2.0 * scale / miss.max(f32::MIN_POSITIVE)).min(1.0);
            work.packed.weight[row].0[lane] = weight;
            total += weight;
        }
        for (row, _) in measured() {
            work.packed.weight[row].0[lane] /= total;
        }
    }
    any
}

/// Memory that the groups of a tile share.
struct Work {
    packed: Packed,
    rows: Vec<usize>,
    misses: Vec<f32>,
    room: Room,
    missing: Vec<Rgb>,
    predicted: Vec<Rgb>,
    found: Vec<Rgb>,
    residue: Vec<Rgb>,
    step: Vec<Rgb>,
    product: Vec<Rgb>,
    prior: Vec<Rgb>,
    turned: Vec<Rgb>,
}

impl Work {
    fn new(count: usize) -> Self {
        let rgb = || vec![[Lane::ZERO; 3]; count];
        Self {
            packed: Packed::new(),
            rows: Vec::new(),
            misses: Vec::new(),
            room: Room::new(count),
            missing: Vec::new(),
            predicted: Vec::new(),
            found: rgb(),
            residue: rgb(),
            step: rgb(),
            product: rgb(),
            prior: rgb(),
            turned: rgb(),
        }
    }
}

// Outside the kernels a fused product would be a library call: these sums are not where the time goes.

fn sum(values: impl Iterator<Item = Lane>) -> Lane {
    values.fold(Lane::ZERO, Lane::plus)
}

fn inner(a: &[Rgb], b: &[Rgb]) -> Rgb {
    std::array::from_fn(|c| sum(a.iter().zip(b).map(|(a, b)| a[c].times(b[c]))))
}

fn plus(a: &Rgb, b: &Rgb) -> Rgb {
    std::array::from_fn(|c| a[c].plus(b[c]))
}

fn minus(a: &Rgb, b: &Rgb) -> Rgb {
    std::array::from_fn(|c| a[c].minus(b[c]))
}

/// 0 where there is nothing left to divide.
fn ratio(a: Lane, b: Lane) -> Lane {
    Lane::of(|i| if b.0[i] > 0.0 { a.0[i] / b.0[i] } else { 0.0 })
}

/// Row after row, single precision.
fn single(matrix: &DMatrix<f64>) -> Vec<f32> {
    matrix.transpose().iter().map(|value| *value as f32).collect()
}

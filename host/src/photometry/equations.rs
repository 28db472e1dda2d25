//! Gains and fall-off together with the models of all texels: one step of Gauss and Newton, from which the texels' own parameters are
//! eliminated, and what it leaves, patch by patch.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::looks::{BLOCKS, Texel};
use crate::calibration::Vignetting;
use crate::fit::{Fitter, Model, TexelFit};

/// The fall-off's: coefficients of r², r⁴, r⁶, and where its centre is.
pub(super) const TERMS: usize = 5;
/// How large they may be, standard deviations: the coefficients, and the centre in diagonals of the picture.
const COEFFICIENT: f64 = 1.0;
const CENTRE: f64 = 0.05;
/// How much a lamp varies at most, relative.
const GAIN: f64 = 0.5;
/// Residuals follow a t distribution of so many degrees of freedom: highlights that no model meets.
const TAIL: f64 = 4.0;
/// What is not measured to this, relative, says nothing.
const WORST: f64 = 0.3;
/// The texels are gone through in so many parts at a time: always the same ones, so that sums are.
const PARTS: usize = 4;

/// Where the gains and the fall-off stand.
#[derive(Debug, Clone)]
pub(super) struct Unknowns {
    /// Logarithm of the lamp's gain, view by view in three channels.
    pub ln_gain: Vec<f64>,
    /// The fall-off, where it is looked for.
    pub vignetting: Option<Vignetting>,
}

impl Unknowns {
    pub fn new(views: usize, size: Option<(u32, u32)>) -> Self {
        let vignetting = size.map(|(width, height)| Vignetting::centred(width, height));
        Self { ln_gain: vec![0.0; 3 * views], vignetting }
    }

    pub fn views(&self) -> usize {
        self.ln_gain.len() / 3
    }

    pub fn len(&self) -> usize {
        self.ln_gain.len() + if self.vignetting.is_some() { TERMS } else { 0 }
    }

    /// All of them, the centre as the way from the middle of the picture.
    pub fn values(&self) -> DVector<f64> {
        let mut values = self.ln_gain.clone();
        if let Some(v) = &self.vignetting {
            let middle = Vignetting::centred(v.width, v.height);
            values.extend(v.coefficients);
            values.extend([v.centre_x - middle.centre_x, v.centre_y - middle.centre_y]);
        }
        DVector::from_vec(values)
    }

    /// What is assumed of them: one over variance.
    fn prior(&self) -> DVector<f64> {
        let mut prior = vec![GAIN.powi(-2); self.ln_gain.len()];
        if let Some(v) = &self.vignetting {
            let diagonal = f64::from(v.width).hypot(f64::from(v.height));
            prior.extend([COEFFICIENT.powi(-2); 3]);
            prior.extend([(CENTRE * diagonal).powi(-2); 2]);
        }
        DVector::from_vec(prior)
    }

    /// Goes a step; the gains' geometric mean stays 1.
    pub fn step(&mut self, step: &DVector<f64>) {
        let gains = self.ln_gain.len();
        self.ln_gain.iter_mut().zip(step.iter()).for_each(|(gain, step)| *gain += step.clamp(-GAIN, GAIN));
        for c in 0..3 {
            let mean = self.ln_gain.iter().skip(c).step_by(3).sum::<f64>() * 3.0 / gains.max(1) as f64;
            self.ln_gain.iter_mut().skip(c).step_by(3).for_each(|gain| *gain -= mean);
        }
        if let Some(v) = &mut self.vignetting {
            for (i, coefficient) in v.coefficients.iter_mut().enumerate() {
                *coefficient += step[gains + i];
            }
            v.centre_x += step[gains + 3];
            v.centre_y += step[gains + 4];
        }
    }

    /// A texel as it would look under a steady lamp through an even lens.
    pub fn correct(&self, texel: &Texel) -> Texel {
        let mut texel = texel.clone();
        let seen = &mut texel.observations;
        for (i, pixel) in texel.pixel.iter().enumerate() {
            let lens = self.vignetting.map_or(1.0, |vignetting| vignetting.at(pixel.x, pixel.y));
            let first = 3 * seen.view[i] as usize;
            let factors = [0, 1, 2].map(|c| (1.0 / (lens * self.ln_gain[first + c].exp())) as f32);
            seen.radiance[i].iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
            seen.sigma[i] *= factors.iter().sum::<f32>() / 3.0;
        }
        texel
    }
}

/// What one texel says: per observation and channel the logarithm of measured over modelled, its weight, and how it moves with the
/// texel's own parameters; per observation, how it moves with the fall-off.
struct Rows {
    block: usize,
    view: Vec<u32>,
    left: DVector<f64>,
    weight: DVector<f64>,
    own: DMatrix<f64>,
    place: Vec<[f64; TERMS]>,
    factor: Cholesky<f64, nalgebra::Dyn>,
}

/// All texels' equations.
pub(super) struct Equations {
    rows: Vec<Rows>,
}

/// A step, and how sure the unknowns are then.
pub(super) struct Solved {
    pub step: DVector<f64>,
    /// Covariance of all unknowns, as sure as patches of the surface agree.
    pub covariance: DMatrix<f64>,
    /// Its inverse.
    pub information: DMatrix<f64>,
}

impl Equations {
    /// Fits all texels and linearises around that.
    pub fn of(texels: &[Texel], fitter: &Fitter, unknowns: &Unknowns) -> Self {
        let rows = texels.par_iter().filter_map(|texel| {
            let fit = fitter.fit(&texel.observations);
            rows(texel, &fit, fitter.model(), unknowns.vignetting.as_ref())
        });
        Self { rows: rows.collect() }
    }

    /// Root of the weighted mean square of what the models leave, relative.
    pub fn residual(&self) -> f64 {
        let (mut squares, mut weights) = (0.0, 0.0);
        for rows in &self.rows {
            squares +=
                rows.left.iter().zip(&rows.weight).map(|(left, weight)| left * left * weight).sum::<f64>();
            weights += rows.weight.sum();
        }
        (squares / weights.max(f64::MIN_POSITIVE)).sqrt()
    }

    pub fn solve(&self, unknowns: &Unknowns) -> Solved {
        let n = unknowns.len();
        let chunk = self.rows.len().div_ceil(PARTS).max(1);
        let parts: Vec<(DMatrix<f64>, DVector<f64>)> = self
            .rows
            .par_chunks(chunk)
            .map(|part| {
                let mut sum = (DMatrix::zeros(n, n), DVector::zeros(n));
                part.iter().for_each(|rows| rows.add_to(&mut sum.0, &mut sum.1, unknowns));
                sum
            })
            .collect();
        let (mut normal, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for (matrix, vector) in parts {
            normal += matrix;
            right += vector;
        }
        let (prior, values) = (unknowns.prior(), unknowns.values());
        for i in 0..n {
            normal[(i, i)] += prior[i];
            right[i] -= prior[i] * values[i];
        }
        // The scale of each channel is nobody's: held where it is.
        let views = unknowns.views();
        let held = normal.diagonal().mean() / views as f64;
        for i in 0..3 * views {
            (i % 3..3 * views).step_by(3).for_each(|k| normal[(i, k)] += held);
        }
        let Some(factor) = normal.clone().cholesky() else {
            let wide = DMatrix::from_diagonal(&prior.map(|p| 1.0 / p));
            return Solved {
                step: DVector::zeros(n),
                covariance: wide,
                information: DMatrix::from_diagonal(&prior),
            };
        };
        let step = factor.solve(&right);
        let inverse = factor.inverse();
        let scale = self.design_effect(&step, &inverse, unknowns).map(f64::sqrt);
        let covariance = DMatrix::from_fn(n, n, |i, k| scale[i] * inverse[(i, k)] * scale[k]);
        let information = DMatrix::from_fn(n, n, |i, k| normal[(i, k)] / (scale[i] * scale[k]));
        Solved { step, covariance, information }
    }

    /// By which factor variances are larger than independent texels would leave them: how much the patches contradict each other,
    /// in each unknown and, because a patch is few, in all of its kind.
    fn design_effect(
        &self,
        step: &DVector<f64>,
        inverse: &DMatrix<f64>,
        unknowns: &Unknowns,
    ) -> DVector<f64> {
        let n = unknowns.len();
        let mut scores = vec![None; BLOCKS];
        for rows in &self.rows {
            let score = scores[rows.block].get_or_insert_with(|| DVector::zeros(n));
            rows.score(step, unknowns, score);
        }
        let scores: Vec<DVector<f64>> = scores.into_iter().flatten().collect();
        let free = scores.len() as f64 - 1.0;
        if free < 2.0 {
            return DVector::from_element(n, 1.0);
        }
        let mut variance = DVector::zeros(n);
        for score in &scores {
            variance += (inverse * score).map(|x: f64| x * x) * ((free + 1.0) / free);
        }
        let ratio = DVector::from_fn(n, |i, _| variance[i] / inverse[(i, i)]);
        let gains = unknowns.ln_gain.len();
        let mean = |range: std::ops::Range<usize>| ratio.rows(range.start, range.len()).mean();
        let kinds = [mean(0..gains), if n > gains { mean(gains..n) } else { 1.0 }];
        // As many degrees of freedom are lent by the others as it has itself.
        DVector::from_fn(n, |i, _| (0.5 * (ratio[i] + kinds[usize::from(i >= gains)])).max(1.0))
    }
}

fn rows(texel: &Texel, fit: &TexelFit, model: Model, vignetting: Option<&Vignetting>) -> Option<Rows> {
    let seen = &texel.observations;
    let count = seen.len();
    let steps = steps(fit, seen.radiance.iter().flatten().sum::<f32>() / (3 * count.max(1)) as f32);
    if 3 * count <= steps.len() {
        return None;
    }
    let (mut left, mut variance) = (DVector::zeros(3 * count), DVector::zeros(3 * count));
    let mut own = DMatrix::zeros(3 * count, steps.len());
    let moved: Vec<[Vec<f32>; 2]> = steps
        .iter()
        .map(|&(k, step)| {
            [step, -step].map(|step| {
                let mut parameters = fit.parameters.clone();
                parameters[k] += step;
                parameters
            })
        })
        .collect();
    for i in 0..count {
        let modelled = model.radiance(&fit.parameters, seen.direction[i]);
        let slopes: Vec<[f32; 3]> = moved
            .iter()
            .zip(&steps)
            .map(|(moved, (_, step))| {
                let [up, down] = [0, 1].map(|side| model.radiance(&moved[side], seen.direction[i]));
                [0, 1, 2].map(|c| (up[c] - down[c]) / (2.0 * step))
            })
            .collect();
        for c in 0..3 {
            let (measured, modelled) = (f64::from(seen.radiance[i][c]), f64::from(modelled[c]));
            let relative = f64::from(seen.sigma[i]) / measured;
            if measured > 0.0 && modelled > 0.0 && relative < WORST {
                // The logarithm of noise has a mean of its own.
                left[3 * i + c] = (measured / modelled).ln() + 0.5 * relative * relative;
                variance[3 * i + c] = (relative * relative).max(1e-8);
                slopes.iter().enumerate().for_each(|(k, s)| own[(3 * i + c, k)] = f64::from(s[c]) / modelled);
            }
        }
    }
    let weight = weights(&left, &variance, steps.len())?;
    let mut normal =
        own.transpose() * DMatrix::from_fn(3 * count, steps.len(), |i, k| weight[i] * own[(i, k)]);
    // What the views do not determine stays where it is; more would be taken for knowledge.
    let faint = 1e-14 * normal.diagonal().max();
    (0..steps.len()).for_each(|k| normal[(k, k)] += 1e-10 * normal[(k, k)] + faint);
    let place = |pixel: &glam::DVec2| vignetting.map_or([0.0; TERMS], |v| v.ln_at(pixel.x, pixel.y).1);
    Some(Rows {
        block: texel.block,
        view: seen.view.clone(),
        left,
        weight,
        own,
        place: texel.pixel.iter().map(place).collect(),
        factor: normal.cholesky()?,
    })
}

/// Which of a fit's parameters can move, and by how much to find out what that does.
fn steps(fit: &TexelFit, typical: f32) -> Vec<(usize, f32)> {
    const PART: f32 = 0.01;
    let mut steps: Vec<(usize, f32)> = (0..3).map(|k| (k, PART * typical)).collect();
    for (l, lobe) in fit.parameters.get(3..).unwrap_or_default().chunks_exact(7).enumerate() {
        // A lobe without radiance has nowhere to go.
        if lobe[..3].iter().any(|&value| value > 1e-3 * typical) {
            let first = 3 + 7 * l;
            steps.extend((first..first + 3).map(|k| (k, PART * typical)));
            steps.push((first + 3, PART * lobe[3]));
            steps.extend((first + 4..first + 7).map(|k| (k, PART)));
        }
    }
    steps
}

/// One over variance, measured and of what the model does not say, less for outliers; 0 where there is no measurement. `None`
/// where there are too few.
fn weights(left: &DVector<f64>, variance: &DVector<f64>, parameters: usize) -> Option<DVector<f64>> {
    let valid: Vec<usize> = (0..left.len()).filter(|&i| variance[i] > 0.0).collect();
    let free = valid.len().checked_sub(parameters).filter(|&free| free > 0)?;
    let scale = 1.4826 * super::middle(valid.iter().map(|&i| left[i].abs()).collect());
    let noise = super::middle(valid.iter().map(|&i| variance[i]).collect());
    let misfit = (scale * scale * valid.len() as f64 / free as f64 - noise).max(0.0);
    let weight = |i: usize| match variance[i] {
        0.0 => 0.0,
        noise => {
            let v = noise + misfit;
            (TAIL + 1.0) / (TAIL + left[i] * left[i] / v) / v
        }
    };
    Some(DVector::from_fn(left.len(), |i, _| weight(i)))
}

impl Rows {
    /// The unknowns that it touches, in the order of its own: gains, then the fall-off.
    fn touched(&self, unknowns: &Unknowns) -> Vec<usize> {
        let gains = self.view.iter().flat_map(|&view| (0..3).map(move |c| 3 * view as usize + c));
        gains.chain(unknowns.ln_gain.len()..unknowns.len()).collect()
    }

    /// Sums over rows, by unknown: of the gains each row by itself, of the fall-off all of them.
    fn gather(&self, value: impl Fn(usize) -> f64, unknowns: &Unknowns) -> DVector<f64> {
        let rows = self.left.len();
        let mut sums = DVector::zeros(rows + unknowns.len() - unknowns.ln_gain.len());
        for row in 0..rows {
            let value = value(row);
            sums[row] = value;
            (rows..sums.len()).for_each(|i| sums[i] += value * self.place[row / 3][i - rows]);
        }
        sums
    }

    fn add_to(&self, normal: &mut DMatrix<f64>, right: &mut DVector<f64>, unknowns: &Unknowns) {
        let (rows, own) = (self.left.len(), self.own.ncols());
        let touched = self.touched(unknowns);
        let mut mixed = DMatrix::zeros(touched.len(), own);
        for k in 0..own {
            mixed.set_column(k, &self.gather(|row| self.weight[row] * self.own[(row, k)], unknowns));
        }
        let reduced = self.factor.l().solve_lower_triangular(&mixed.transpose());
        let Some(reduced) = reduced else { return };
        let mut matrix = -(reduced.transpose() * &reduced);
        for row in 0..rows {
            let weight = self.weight[row];
            matrix[(row, row)] += weight;
            for i in rows..touched.len() {
                let slope = weight * self.place[row / 3][i - rows];
                matrix[(row, i)] += slope;
                matrix[(i, row)] += slope;
                (rows..touched.len()).for_each(|k| matrix[(i, k)] += slope * self.place[row / 3][k - rows]);
            }
        }
        for (k, &column) in touched.iter().enumerate() {
            for (i, &row) in touched.iter().enumerate() {
                normal[(row, column)] += matrix[(i, k)];
            }
        }
        self.score(&DVector::zeros(unknowns.len()), unknowns, right);
    }

    /// Adds the derivative of the fit's quality by the unknowns once they have gone a step, its own parameters following.
    fn score(&self, step: &DVector<f64>, unknowns: &Unknowns, score: &mut DVector<f64>) {
        let gains = unknowns.ln_gain.len();
        let explained = |row: usize| {
            let lens = (gains..step.len()).map(|i| step[i] * self.place[row / 3][i - gains]).sum::<f64>();
            step[3 * self.view[row / 3] as usize + row % 3] + lens
        };
        let left =
            DVector::from_fn(self.left.len(), |row, _| self.weight[row] * (self.left[row] - explained(row)));
        let follows = self.factor.solve(&(self.own.transpose() * &left));
        let rest = left - (&self.own * follows).component_mul(&self.weight);
        for (&i, value) in self.touched(unknowns).iter().zip(self.gather(|row| rest[row], unknowns).iter()) {
            score[i] += value;
        }
    }
}

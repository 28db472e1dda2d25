//! Exposure times as the pixels have them, beside those that were stated.

use std::collections::BTreeSet;
use std::path::PathBuf;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::rows::{Camera, Group, KNOTS, Row, rows};
use super::{NoiseModel, Response, Samples, Stack};
use crate::{Error, Result};

/// A stated time is doubted where the pixels contradict it by more than so many standard deviations, and so much.
const BEYOND_SIGMA: f64 = 5.0;
const BEYOND: f64 = 0.03;
/// Blocks of a stack beyond this number are thinned out evenly.
const MOST_BLOCKS: usize = 600;
/// Times that doubtful times are replaced and the response is recovered again; until none changes by more than this.
const ROUNDS: usize = 8;
const SETTLED: f64 = 0.003;

/// What the pixels say of a photograph's exposure time.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredTime {
    /// The photograph.
    pub path: PathBuf,
    /// The exposure time that was stated, seconds.
    pub stated_s: f64,
    /// The exposure time that the pixels have, if most photographs of its stack have theirs, seconds.
    pub measured_s: f64,
    /// Its standard deviation, relative; infinite where the photograph shares too little with the others.
    pub sigma: f64,
}

impl MeasuredTime {
    /// Whether the pixels contradict the stated time by more than noise and more than a shutter's own error.
    pub fn is_doubtful(&self) -> bool {
        self.off() > BEYOND_SIGMA * self.sigma && self.off() > BEYOND
    }

    /// |ln(measured / stated)|.
    fn off(&self) -> f64 {
        (self.measured_s / self.stated_s).ln().abs()
    }

    /// The sentence for it: a wrong time, or light that changed, which are the same to the pixels.
    pub fn error(&self) -> Error {
        let what = format!(
            "its exposure time is stated as {:.4} s, but beside the other photographs of its view the pixels measure {:.4} s, {:.2} times as long (within {:.1} %): the time is wrong, or the light changed",
            self.stated_s,
            self.measured_s,
            self.measured_s / self.stated_s,
            100.0 * self.sigma
        );
        let remedy =
            "correct the time, leave the photograph out, or go by the pixels with --exposure-times measured";
        Error::input(&self.path, what, remedy)
    }
}

/// What a session's samples tell of its camera.
#[derive(Debug, Clone)]
pub struct Learnt {
    /// The camera's response.
    pub response: Response,
    /// Its noise.
    pub noise: NoiseModel,
    /// The photographs whose stated times the pixels contradict; the response was recovered with the measured ones.
    pub doubtful: Vec<MeasuredTime>,
}

impl Stack {
    /// Each photograph's stated time beside what the pixels say, for a response that is known.
    pub fn times(&self, response: &Response, noise: &NoiseModel) -> Vec<MeasuredTime> {
        let mut samples = Samples::default();
        let sampled = samples.add(self);
        let mut times: Vec<MeasuredTime> = self
            .pictures
            .iter()
            .zip(&self.exposure_s)
            .map(|(picture, &time_s)| MeasuredTime {
                path: picture.path.clone(),
                stated_s: time_s,
                measured_s: time_s,
                sigma: f64::INFINITY,
            })
            .collect();
        if sampled.is_ok() && !samples.stacks.is_empty() {
            let mut measured = samples.times_of(0, response, noise);
            among_all(&mut measured, &samples.stacks[0].exposure_s);
            for (i, time) in self.longest_first().into_iter().zip(measured) {
                times[i] = time;
            }
        }
        times
    }
}

impl Samples {
    /// Response and noise, with the exposure times that the pixels contradict replaced by what they measure, the worst of
    /// each stack first. With two photographs, or where half of them are wrong, nobody can say which.
    ///
    /// # Errors
    /// Those of [`Samples::response`].
    pub fn learn(&self) -> Result<Learnt> {
        self.learn_unless(&|| Ok(()))
    }

    /// The same, asking between its rounds whether to go on.
    ///
    /// # Errors
    /// Those of [`Samples::response`] and of `interrupted`.
    pub(crate) fn learn_unless(&self, interrupted: &dyn Fn() -> Result<()>) -> Result<Learnt> {
        let mut samples = self.clone();
        let mut replaced = BTreeSet::new();
        for round in 0.. {
            interrupted()?;
            let (response, noise) = samples.response_and_noise()?;
            let times: Vec<Vec<MeasuredTime>> = (0..samples.stacks.len())
                .into_par_iter()
                .map(|stack| {
                    let mut times = samples.times_of(stack, &response, &noise);
                    among_all(&mut times, &self.stacks[stack].exposure_s);
                    times
                })
                .collect();
            let all = times.iter().enumerate().flat_map(|(i, times)| (0..times.len()).map(move |j| (i, j)));
            let doubtful: Vec<(usize, usize)> = all.filter(|&(i, j)| times[i][j].is_doubtful()).collect();
            let off = |&(i, j): &(usize, usize)| times[i][j].off();
            // A wrong time draws the curve to its side and makes others look wrong: the worst come first.
            let worst = doubtful.iter().map(off).fold(0.0, f64::max);
            replaced.extend(doubtful.iter().filter(|at| off(at) > 0.5 * worst));
            let settled = replaced.iter().all(|at| off(at) < SETTLED);
            if settled || round == ROUNDS {
                return self.compare(samples, Learnt { response, noise, doubtful: vec![] });
            }
            for &(i, j) in &replaced {
                samples.stacks[i].exposure_s[j] = times[i][j].measured_s;
            }
        }
        unreachable!("the loop returns after ROUNDS")
    }

    /// The photographs whose times were replaced, and still are in doubt. Any other has its stated time back: nothing is replaced
    /// that is not told.
    fn compare(&self, mut replaced: Self, mut learnt: Learnt) -> Result<Learnt> {
        let mut is_back = false;
        for (stack, stated) in self.stacks.iter().enumerate() {
            if stated.exposure_s == replaced.stacks[stack].exposure_s {
                continue;
            }
            let mut times = replaced.times_of(stack, &learnt.response, &learnt.noise);
            among_all(&mut times, &stated.exposure_s);
            for (j, (time, &stated_s)) in times.into_iter().zip(&stated.exposure_s).enumerate() {
                let time = MeasuredTime { stated_s, ..time };
                let used_s = &mut replaced.stacks[stack].exposure_s[j];
                if *used_s != stated_s && !time.is_doubtful() {
                    *used_s = stated_s;
                    is_back = true;
                } else if *used_s != stated_s {
                    learnt.doubtful.push(time);
                }
            }
        }
        if is_back {
            (learnt.response, learnt.noise) = replaced.response_and_noise()?;
        }
        Ok(learnt)
    }

    /// ln(true time / stated time) of each photograph of a stack by least squares over its blocks, the radiances eliminated;
    /// the median photograph is taken at its word.
    fn times_of(&self, stack: usize, response: &Response, noise: &NoiseModel) -> Vec<MeasuredTime> {
        let bracket = &self.stacks[stack];
        let n = bracket.exposure_s.len();
        let mut equations = Equations::new(n);
        let cameras = [0, 1, 2].map(|channel| Camera::new(response, noise, channel));
        let curves = [0, 1, 2].map(|channel| curve(response, channel));
        let blocks: Vec<_> = self.blocks.iter().filter(|block| block.stack == stack).collect();
        let gathered: Vec<(usize, Vec<_>)> = blocks
            .iter()
            .step_by(blocks.len().div_ceil(MOST_BLOCKS).max(1))
            .flat_map(|block| (0..3).map(move |channel| (channel, block)))
            .map(|(channel, block)| (channel, rows(block, &bracket.exposure_s, &cameras[channel])))
            .filter(|(_, rows)| rows.len() >= 2 && is_lit(&rows[0]))
            .collect();
        let groups: Vec<(usize, Group)> = gathered
            .iter()
            .filter_map(|(channel, rows)| {
                Group::new(rows, &curves[*channel], &cameras[*channel], false).map(|group| (*channel, group))
            })
            .collect();
        let mut off = DVector::zeros(n);
        // A wrong time is no outlier once it is known: the weights follow.
        for _ in 0..5 {
            equations = Equations::new(n);
            groups.iter().for_each(|(channel, group)| equations.add(group, *channel, &off));
            let Some(solved) = equations.solve() else { break };
            off = solved;
        }
        let covariance = equations.covariance(response);
        let mut sorted: Vec<f64> = off.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        // Of two, the one in the middle is the longer exposure, for want of a better judge.
        let median = if n == 2 { off[0] } else { sorted[n / 2] };
        (0..n)
            .map(|j| {
                // Against the mean of the others.
                let others = 1.0 / (n as f64 - 1.0);
                let against = DVector::from_fn(n, |k, _| if k == j { 1.0 } else { -others });
                let sigma = if n < 2 { f64::INFINITY } else { against.dot(&(&covariance * &against)).sqrt() };
                let stated_s = bracket.exposure_s[j];
                let stands = !self.contradicts(stack, j, &off, &cameras, &curves);
                let sigma = if stands { sigma } else { f64::INFINITY };
                MeasuredTime {
                    path: bracket.paths[j].clone(),
                    stated_s,
                    measured_s: stated_s * (off[j] - median).exp(),
                    sigma,
                }
            })
            .collect()
    }
}

/// Of fewer photographs one that is wrong could be taken for a power of all times; times nearer to each other (ln) tell none.
const FEWEST_FOR_POWER: usize = 5;
const APART: f64 = 0.2;
/// A median of absolute values, of a standard deviation.
const MEDIAN_OF_SIGMA: f64 = 0.6745;

/// A power of all times and a power of the response are the same to the pixels: what a stack's measured times have of it, beside the stated
/// ones, says nothing of any of them. The median of the slopes between any two: a few wrong ones do not matter. What most of them
/// scatter about it is the camera's, of which no model says all: none is known better than that.
fn among_all(times: &mut [MeasuredTime], stated_s: &[f64]) {
    // What was black or saturated throughout was not measured.
    let told = times.iter().zip(stated_s).filter(|(time, _)| time.sigma.is_finite());
    let told: Vec<(f64, f64)> = told.map(|(time, s)| (s.ln(), (time.measured_s / s).ln())).collect();
    if told.len() < FEWEST_FOR_POWER {
        return;
    }
    let pairs = (0..told.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let slope = |(i, j): (usize, usize)| {
        let apart = told[i].0 - told[j].0;
        (apart.abs() > APART).then(|| (told[i].1 - told[j].1) / apart)
    };
    let slope = middle(pairs.filter_map(slope).collect());
    let rest: Vec<f64> = told.iter().map(|(ln_s, off)| off - slope * ln_s).collect();
    let centre = middle(rest.clone());
    let scatter = middle(rest.iter().map(|rest| (rest - centre).abs()).collect()) / MEDIAN_OF_SIGMA;
    for (time, stated_s) in times.iter_mut().zip(stated_s) {
        time.measured_s /= (slope * stated_s.ln() + centre).exp();
        time.sigma = time.sigma.hypot(scatter);
    }
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// So many blocks must contradict a time, and this part of those that are black or saturated (most are so at any time); by so much (ln
/// exposure).
const LEAST_CONTRADICTING: usize = 8;
const PART_CONTRADICTING: f64 = 0.05;
const CONTRADICTING: f64 = 0.3;

impl Samples {
    /// Whether what a photograph saturated, or left black, would have been neither with the time that is measured for it. What JPEG
    /// leaves in the black beside a bright edge is alike in all photographs: where nothing else of a photograph is measured, it says that all
    /// times are the same.
    fn contradicts(
        &self,
        stack: usize,
        j: usize,
        off: &DVector<f64>,
        cameras: &[Camera; 3],
        curves: &[DVector<f64>; 3],
    ) -> bool {
        let exposure_s = &self.stacks[stack].exposure_s;
        let (mut beyond, mut contradicting) = (0, 0);
        for block in self.blocks.iter().filter(|block| block.stack == stack) {
            for (camera, curve) in cameras.iter().zip(curves) {
                let (black, white) = camera.beyond(&block.levels[j]);
                if !(black || white) {
                    continue;
                }
                // Of what is white the longest photograph that is not tells most, of what is black the longest of all.
                let rows = rows(block, exposure_s, camera);
                let Some(row) = rows.iter().find(|row| row.photograph != j) else { continue };
                let exposure: f64 = row.histogram.iter().map(|&(k, share)| share * curve[k].exp()).sum();
                let longer = (exposure_s[j] / exposure_s[row.photograph]).ln() + off[j] - off[row.photograph];
                let expected = exposure.ln() + longer;
                let [dark, saturated] = camera.limits(curve);
                beyond += 1;
                contradicting += usize::from(match white {
                    true => expected < saturated - CONTRADICTING,
                    false => expected > dark + CONTRADICTING + 1.0,
                });
            }
        }
        contradicting >= LEAST_CONTRADICTING && contradicting as f64 > PART_CONTRADICTING * beyond as f64
    }
}

/// What stays darker than this, of 255 levels, in the longest photograph that measures it is as likely dirt of the compression.
const LIT: usize = 16;

fn is_lit(row: &Row) -> bool {
    row.histogram.iter().map(|&(knot, share)| knot as f64 * share).sum::<f64>() >= (LIT * KNOTS / 256) as f64
}

/// ln exposure at the knots.
fn curve(response: &Response, channel: usize) -> DVector<f64> {
    let table = response.exposure(channel);
    let white = response.white();
    let at = |level: usize| f64::from(table[level]).max(1e-12).ln();
    DVector::from_fn(KNOTS, |knot, _| at(knot * usize::from(white) / (KNOTS - 1)))
}

/// Normal equations for the logarithms of the photographs' true times over the stated ones.
struct Equations {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    /// How the right side depends on the curve of each channel.
    by_curve: [DMatrix<f64>; 3],
    squares: f64,
    rows: f64,
}

impl Equations {
    fn new(n: usize) -> Self {
        Self {
            // Without a shared pixel a time is anything within a factor of e.
            matrix: DMatrix::identity(n, n),
            right: DVector::zeros(n),
            by_curve: [0; 3].map(|_| DMatrix::zeros(n, KNOTS)),
            squares: 0.0,
            rows: 0.0,
        }
    }

    fn add(&mut self, group: &Group, channel: usize, off: &DVector<f64>) {
        let says: Vec<f64> =
            group.ln_exposure.iter().zip(group.rows).map(|(x, row)| x - row.ln_time).collect();
        let mut weights = group.weights.clone();
        for _ in 0..3 {
            let total: f64 = weights.iter().sum();
            let mean =
                (0..says.len()).map(|i| weights[i] * (says[i] - off[group.rows[i].photograph])).sum::<f64>()
                    / total;
            for (i, weight) in weights.iter_mut().enumerate() {
                let residual = says[i] - off[group.rows[i].photograph] - mean;
                *weight = group.weights[i] / (1.0 + residual * residual * group.weights[i] / 4.0);
            }
        }
        let total: f64 = weights.iter().sum();
        let mean = (0..says.len()).map(|i| weights[i] * says[i]).sum::<f64>() / total;
        let mean_off =
            (0..says.len()).map(|i| weights[i] * off[group.rows[i].photograph]).sum::<f64>() / total;
        for (i, row) in group.rows.iter().enumerate() {
            let (j, weight) = (row.photograph, weights[i]);
            self.right[j] += weight * (says[i] - mean);
            self.matrix[(j, j)] += weight;
            let residual = says[i] - mean - (off[j] - mean_off);
            self.squares += weight * residual * residual;
            self.rows += 1.0;
            for (k, other) in group.rows.iter().enumerate() {
                self.matrix[(j, other.photograph)] -= weight * weights[k] / total;
            }
            let curve = &mut self.by_curve[channel];
            for &(knot, share) in &row.histogram {
                curve[(j, knot)] += weight * share;
                for (k, other) in group.rows.iter().enumerate() {
                    curve[(other.photograph, knot)] -= weight * share * weights[k] / total;
                }
            }
        }
    }

    fn solve(&self) -> Option<DVector<f64>> {
        self.matrix.clone().cholesky().map(|factor| factor.solve(&self.right))
    }

    /// From the blocks' scatter and from the doubt in the response.
    fn covariance(&self, response: &Response) -> DMatrix<f64> {
        let n = self.right.len();
        let Some(inverse) = self.matrix.clone().cholesky().map(|factor| factor.inverse()) else {
            return DMatrix::identity(n, n);
        };
        let mut covariance = &inverse * (self.squares / self.rows.max(1.0)).max(1.0);
        for (channel, by_curve) in self.by_curve.iter().enumerate() {
            if let Some(doubt) = response.covariance(channel) {
                let lever = &inverse * by_curve;
                covariance += &lever * doubt * lever.transpose();
            }
        }
        covariance
    }
}

#[cfg(test)]
mod tests;

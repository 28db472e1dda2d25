//! Exposure times as the pixels have them, beside those that were stated.

use std::path::PathBuf;

use nalgebra::{DMatrix, DVector};

use super::recover::{Camera, Group, KNOTS, rows};
use super::{NoiseModel, Response, Samples, Stack};
use crate::{Error, Result};

/// A stated time is doubted where the pixels contradict it by more than so many standard deviations, and so much.
const BEYOND_SIGMA: f64 = 5.0;
const BEYOND: f64 = 0.03;
/// Blocks of a stack beyond this number are thinned out evenly.
const MOST_BLOCKS: usize = 600;
/// Times that doubtful times are replaced and the response is recovered again.
const ROUNDS: usize = 6;

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
        let off = (self.measured_s / self.stated_s).ln().abs();
        off > BEYOND_SIGMA * self.sigma && off > BEYOND
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
            for (i, time) in self.longest_first().into_iter().zip(samples.times_of(0, response, noise)) {
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
        let mut samples = self.clone();
        for round in 0.. {
            let response = samples.response()?;
            let noise = samples.noise(&response);
            let mut replaced = false;
            for stack in 0..samples.stacks.len() {
                let times = samples.times_of(stack, &response, &noise);
                let off = |time: &MeasuredTime| (time.measured_s / time.stated_s).ln().abs();
                let worst = (0..times.len())
                    .filter(|&j| times[j].is_doubtful())
                    .max_by(|&a, &b| off(&times[a]).total_cmp(&off(&times[b])));
                if let Some(worst) = worst {
                    samples.stacks[stack].exposure_s[worst] = times[worst].measured_s;
                    replaced = true;
                }
            }
            if !replaced || round == ROUNDS {
                let doubtful = self.compare(&samples, &response, &noise);
                return Ok(Learnt { response, noise, doubtful });
            }
        }
        unreachable!("the loop returns after ROUNDS")
    }

    /// The photographs whose times were replaced.
    fn compare(&self, replaced: &Self, response: &Response, noise: &NoiseModel) -> Vec<MeasuredTime> {
        let mut doubtful = Vec::new();
        for (stack, (stated, used)) in self.stacks.iter().zip(&replaced.stacks).enumerate() {
            if stated.exposure_s != used.exposure_s {
                let times = replaced.times_of(stack, response, noise);
                let with_stated = times
                    .into_iter()
                    .zip(&stated.exposure_s)
                    .map(|(time, &stated_s)| MeasuredTime { stated_s, ..time });
                doubtful.extend(with_stated.filter(MeasuredTime::is_doubtful));
            }
        }
        doubtful
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
            .filter(|(_, rows)| rows.len() >= 2)
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

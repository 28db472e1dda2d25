//! Recovery of the response from bracketed photographs.
//!
//! Debevec and Malik, "Recovering High Dynamic Range Radiance Maps from Photographs", SIGGRAPH 97, equation 3:
//! g(level) = ln radiance + ln exposure time, solved for g and for the radiances at once. What differs here:
//! - an observation is the mean exposure of a block of pixels, not one level: noise and texture, which flatten a curve fitted
//!   to single levels, average out before the logarithm is taken. The equation becomes linear in g at the last curve found.
//! - weights are inverse variances from the noise model instead of a hat, taken where the block's radiance says that the level
//!   should be, and large residuals count less.
//! - instead of a penalty on the second derivative, a [`prior`](super::prior) of what cameras' curves look like.
//! - the radiances are eliminated, so that the system has the size of the curve however many pixels are used.
//! - the posterior's covariance stays with the curve.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::prior::{Prior, posterior, priors};
use super::rows::{Camera, Group, KNOTS, MODEL_ERROR, Row, knot_levels, knot_of, rows};
use super::{NoiseModel, Response, Samples};
use crate::{Error, Result};

/// How well the model itself is thought to hold at best, relative; keeps single blocks from ruling.
const LEAST_MODEL_ERROR: f64 = 0.002;
/// Times that noise and response are found from each other, and times that the curve is found in each.
const ROUNDS: usize = 2;
const PASSES: usize = 4;

impl Samples {
    /// The camera's response, per channel, never decreasing, 1 at the middle level.
    ///
    /// # Errors
    /// [`Error::Request`] where no stack had two different exposure times, or where no block was measured twice.
    pub fn response(&self) -> Result<Response> {
        self.response_and_noise().map(|(response, _)| response)
    }

    /// The response, and the noise that [`Samples::noise`] finds with it.
    pub(super) fn response_and_noise(&self) -> Result<(Response, NoiseModel)> {
        if !self.bracketed {
            return Err(Error::request(
                "the response cannot be recovered: no view was photographed with two different exposure times",
                "photograph some views with times one stop apart, or choose the response `srgb` or `linear`",
            ));
        }
        let priors = priors();
        let mut response = Response::srgb(self.white);
        let mut noise = NoiseModel::assumed(&response);
        for _ in 0..ROUNDS {
            let curves: Vec<Curve> = (0..3usize)
                .into_par_iter()
                .map(|channel| self.recover(channel, &response, &noise, &priors))
                .collect::<Result<_>>()?;
            let (tables, covariances): (Vec<_>, Vec<_>) = curves.into_iter().unzip();
            let tables = tables.try_into().expect("three channels were asked for");
            let covariances = covariances.try_into().expect("three channels were asked for");
            response = Response::from_tables(tables).with_covariance(covariances);
            noise = self.noise(&response);
        }
        Ok((response, noise))
    }

    fn recover(
        &self,
        channel: usize,
        response: &Response,
        noise: &NoiseModel,
        priors: &[Prior],
    ) -> Result<Curve> {
        let mut camera = Camera::new(response, noise, channel);
        let groups = self.gather(response.exposure(channel), &camera);
        if groups.is_empty() {
            return Err(Error::request(
                format!(
                    "the response cannot be recovered: no part of the photographs is well exposed twice in channel {channel}"
                ),
                "take exposures at most two stops apart, or choose the response `srgb` or `linear`",
            ));
        }
        let baseline = DVector::from_iterator(KNOTS, knot_levels().map(baseline_at));
        let mut g = baseline.clone();
        let mut precision = DMatrix::zeros(KNOTS, KNOTS);
        let mut mean = DVector::zeros(KNOTS);
        for pass in 0..PASSES {
            let (mut matrix, mut right) = (DMatrix::zeros(KNOTS, KNOTS), DVector::zeros(KNOTS));
            mean.fill(0.0);
            if pass > 0 {
                camera.model_error = model_error(&groups, &g, &camera);
            }
            // Residuals of the baseline say nothing about outliers: the first pass trusts every row.
            let equations: Vec<Equations> = groups
                .par_iter()
                .filter_map(|rows| Group::new(rows, &g, &camera, pass > 0))
                .map(|group| Equations::new(&group, &g))
                .collect();
            equations.iter().for_each(|equations| equations.add(&mut right, &mut mean));
            let columns = matrix.as_mut_slice().par_chunks_mut(KNOTS).enumerate();
            columns.for_each(|(k, column)| equations.iter().for_each(|e| e.add_to_column(k, column)));
            let right = right - &matrix * &baseline;
            let found = posterior(priors, &matrix, &right).ok_or_else(|| unsolved(channel))?;
            g = monotone(&found.precision, &baseline + found.deviation).ok_or_else(|| unsolved(channel))?;
            precision = found.precision;
        }
        let white = response.white();
        let table =
            (0..=usize::from(white)).map(|level| interpolate(g.as_slice(), level, white).exp() as f32);
        let covariance = covariance(precision, &mean).ok_or_else(|| unsolved(channel))?;
        Ok((table.collect(), covariance))
    }
}

/// The prior alone is positive definite: only numbers that are none get here. A curve that nobody measured must not pass for one that
/// somebody did.
fn unsolved(channel: usize) -> Error {
    Error::request(
        format!(
            "the response cannot be recovered: the photographs contradict any curve in channel {channel}"
        ),
        "check that each view's photographs show the same, or choose the response `srgb` or `linear`",
    )
}

/// How many blocks are looked at as one. A curve that is fitted to noisy levels is drawn towards the levels that are frequent;
/// so many pixels together have little noise even where it is dark.
const TOGETHER: usize = 16;

impl Samples {
    /// Blocks about equally bright that are well exposed at the same times, [`TOGETHER`] at a time: the mean over all their
    /// pixels obeys the same equation as each pixel does.
    fn gather(&self, table: &[f32], camera: &Camera) -> Vec<Vec<Row>> {
        let mut blocks: Vec<(Vec<u64>, f64, Vec<Row>)> = self
            .thinned()
            .map(|block| rows(block, self.exposure_s(block), camera))
            .filter(|rows| rows.len() >= 2 && rows[0].ln_time - rows[rows.len() - 1].ln_time > 0.05)
            .map(|rows| {
                let times = rows.iter().map(|row| row.ln_time.to_bits()).collect();
                // The longest exposure has the least noise: order by it favours no level.
                let exposure = |knot: usize| f64::from(table[knot * usize::from(camera.white) / (KNOTS - 1)]);
                let brightness =
                    rows[0].histogram.iter().map(|&(knot, share)| share * exposure(knot)).sum::<f64>();
                (times, brightness.ln() - rows[0].ln_time, rows)
            })
            .collect();
        blocks.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        blocks
            .chunk_by(|a, b| a.0 == b.0)
            .flat_map(|alike| alike.chunks(TOGETHER))
            .map(|chunk| {
                (0..chunk[0].2.len()).map(|i| mean_row(chunk.iter().map(|(_, _, rows)| &rows[i]))).collect()
            })
            .collect()
    }
}

/// One row for the pixels of several.
fn mean_row<'a>(rows: impl Iterator<Item = &'a Row>) -> Row {
    let mut sum = Row { photograph: 0, pixels: 0.0, histogram: vec![], ln_time: 0.0 };
    let mut shares = [0.0; KNOTS];
    for row in rows {
        row.histogram.iter().for_each(|&(knot, share)| shares[knot] += share * row.pixels);
        sum.pixels += row.pixels;
        sum.ln_time = row.ln_time;
    }
    let pixels = sum.pixels;
    sum.histogram = (0..KNOTS).filter(|&k| shares[k] > 0.0).map(|k| (k, shares[k] / pixels)).collect();
    sum
}

/// Exposure per level, and the covariance of its logarithm at the knots.
type Curve = (Vec<f32>, DMatrix<f64>);

/// A group's rows, linear in g, with its ln radiance eliminated: sum of p(k) g(k) = target.
struct Equations {
    /// Weight, p, and target less the mean target.
    rows: Vec<(f64, Knots, f64)>,
    /// The weighted sum of the rows' p, and of the weights.
    sum: Knots,
    total: f64,
}

/// Values at some of the knots, in their order.
type Knots = Vec<(usize, f64)>;

impl Equations {
    fn new(group: &Group, g: &DVector<f64>) -> Self {
        let total: f64 = group.weights.iter().sum();
        let mut rows = Vec::with_capacity(group.rows.len());
        let mut sum: Vec<(usize, f64)> = Vec::new();
        for ((row, ln_exposure), &weight) in group.rows.iter().zip(&group.ln_exposure).zip(&group.weights) {
            let part: Vec<(usize, f64)> =
                row.histogram.iter().map(|&(k, share)| (k, share * (g[k] - ln_exposure).exp())).collect();
            sum.extend(part.iter().map(|&(k, p)| (k, weight * p)));
            let target = row.ln_time - ln_exposure + part.iter().map(|&(k, p)| p * g[k]).sum::<f64>();
            rows.push((weight, part, target));
        }
        let mean = rows.iter().map(|(weight, _, target)| weight * target).sum::<f64>() / total;
        rows.iter_mut().for_each(|(_, _, target)| *target -= mean);
        sum.sort_unstable_by_key(|&(k, _)| k);
        sum.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            if same {
                kept.1 += next.1;
            }
            same
        });
        Self { rows, sum, total }
    }

    /// Adds to the right side of the normal equations for g, and to `mean` how ln radiance depends on g.
    fn add(&self, right: &mut DVector<f64>, mean: &mut DVector<f64>) {
        for (weight, part, target) in &self.rows {
            part.iter().for_each(|&(k, p)| right[k] += weight * p * target);
        }
        self.sum.iter().for_each(|&(k, a)| mean[k] += a / self.total);
    }

    /// Adds to column `k` of their matrix.
    fn add_to_column(&self, k: usize, column: &mut [f64]) {
        let at =
            |terms: &[(usize, f64)]| terms.binary_search_by_key(&k, |term| term.0).ok().map(|at| terms[at].1);
        let Some(b) = at(&self.sum) else { return };
        for (weight, part, _) in &self.rows {
            if let Some(q) = at(part) {
                part.iter().for_each(|&(i, p)| column[i] += weight * p * q);
            }
        }
        self.sum.iter().for_each(|&(i, a)| column[i] -= a * b / self.total);
    }
}

/// What noise leaves unexplained of the groups' contradictions, relative: JPEG, motion, the curve itself.
fn model_error(groups: &[Vec<Row>], g: &DVector<f64>, camera: &Camera) -> f64 {
    let (mut squares, mut noises) = (Vec::new(), Vec::new());
    for group in groups.iter().filter_map(|rows| Group::new(rows, g, camera, true)) {
        let total: f64 = group.weights.iter().sum();
        let says = |i: usize| group.ln_exposure[i] - group.rows[i].ln_time;
        let mean = (0..group.rows.len()).map(|i| group.weights[i] * says(i)).sum::<f64>() / total;
        for (i, &weight) in group.weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
            // A mean is nearer to its heaviest rows.
            let freedom = (1.0 - weight / total).max(0.1);
            squares.push((says(i) - mean).powi(2) / freedom);
            noises.push(1.0 / weight - camera.model_error.powi(2));
        }
    }
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(MODEL_ERROR * MODEL_ERROR)
    };
    // The median of a squared normal number is 0.455 variances.
    let excess = median(&mut squares) / 0.455 - median(&mut noises).max(0.0);
    excess.max(LEAST_MODEL_ERROR.powi(2)).sqrt().min(MODEL_ERROR)
}

/// The covariance of g less its mean over the radiances from which it was learnt: the factor common to all of them is
/// nothing but the unit.
fn covariance(precision: DMatrix<f64>, mean: &DVector<f64>) -> Option<DMatrix<f64>> {
    let covariance = precision.cholesky()?.inverse();
    let mean = mean / mean.sum().max(f64::MIN_POSITIVE);
    let with_mean = &covariance * &mean;
    let of_mean = mean.dot(&with_mean);
    let about = |i: usize, k: usize| covariance[(i, k)] - with_mean[i] - with_mean[k] + of_mean;
    Some(DMatrix::from_fn(KNOTS, KNOTS, about))
}

/// The curve of least cost that grows everywhere: steps that fall are fastened, one set after the other. `None` where the numbers
/// are none; each round fastens a new step of those that there are.
fn monotone(precision: &DMatrix<f64>, free: DVector<f64>) -> Option<DVector<f64>> {
    // The least growth per knot: a curve that is flat would give a level no exposure of its own.
    const LEAST: f64 = 1e-4;
    let firm = precision.diagonal().max() * 1e3;
    let (mut held, mut right) = (precision.clone(), precision * &free);
    let mut g = free;
    for _ in 0..KNOTS {
        let falling: Vec<usize> = (1..KNOTS).filter(|&k| g[k] - g[k - 1] < LEAST / 2.0).collect();
        if falling.is_empty() {
            return g.iter().all(|value| value.is_finite()).then_some(g);
        }
        for k in falling {
            held[(k, k)] += firm;
            held[(k - 1, k - 1)] += firm;
            held[(k, k - 1)] -= firm;
            held[(k - 1, k)] -= firm;
            right[k] += firm * LEAST;
            right[k - 1] -= firm * LEAST;
        }
        g = held.clone().cholesky()?.solve(&right);
    }
    None
}

/// ln of sRGB's exposure; finite at level 0, which stands for half a level.
fn baseline_at(level: f64) -> f64 {
    let level = level.max(0.5 / 255.0);
    if level <= 0.04045 { (level / 12.92).ln() } else { 2.4 * ((level + 0.055) / 1.055).ln() }
}

fn interpolate(g: &[f64], level: usize, white: u16) -> f64 {
    let (knot, part) = knot_of(level, white);
    g[knot] * (1.0 - part) + g[(knot + 1).min(KNOTS - 1)] * part
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{self, CURVES, Curve};
    use super::*;

    fn recovered(curve: Curve, times: &[f64], noise: f64, views: u64) -> Response {
        let mut samples = Samples::default();
        for view in 0..views {
            let scene = simulated::scene(192, 144, view);
            samples.add(&simulated::shoot(&scene, 192, times, curve, noise, 100 + view)).unwrap();
        }
        samples.response().unwrap()
    }

    /// Median relative error over levels 20 to 235 after the median factor, the worst channel.
    fn error(response: &Response, curve: Curve) -> f64 {
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let channels = (0..3).map(|channel| {
            let table = response.exposure(channel);
            let ratio: Vec<f64> =
                (20..=235).map(|z| f64::from(table[z]) / simulated::truth(curve, z)).collect();
            let scale = median(ratio.clone());
            median(ratio.iter().map(|r| (r / scale - 1.0).abs()).collect())
        });
        channels.fold(0.0, f64::max)
    }

    fn grows(response: &Response) -> bool {
        (0..3).all(|c| response.exposure(c).windows(2).all(|pair| pair[0] < pair[1]))
    }

    #[test]
    fn curves_unlike_each_other_are_recovered_from_few_exposures() {
        for (name, curve) in CURVES {
            for (times, views) in
                [(&[4.0, 1.0, 0.25][..], 3), (&[2.0, 1.0], 6), (&[4.0, 2.0, 1.0, 0.5, 0.25], 2)]
            {
                let response = recovered(curve, times, 1.0, views);
                let error = error(&response, curve);
                println!("{name}, {} exposures, {views} views: {:.2} %", times.len(), 100.0 * error);
                assert!(error < 0.02, "{name} {times:?}: {error}");
                assert!(grows(&response), "{name} {times:?}");
            }
        }
    }

    #[test]
    fn the_curve_grows_whatever_the_noise() {
        for (name, curve) in CURVES {
            assert!(grows(&recovered(curve, &[1.0, 0.5], 10.0, 1)), "{name}");
        }
    }

    #[test]
    fn sixteen_bits_are_recovered_like_eight() {
        let (_, curve) = CURVES[0];
        let mut samples = Samples::default();
        for view in 0..3 {
            let scene = simulated::scene(192, 144, view);
            let mut stack = simulated::shoot(&scene, 192, &[4.0, 2.0, 1.0, 0.5], curve, 1.0, view);
            for picture in &mut stack.pictures {
                picture.white = u16::MAX;
                picture.levels.iter_mut().flatten().for_each(|level| *level *= 257);
            }
            samples.add(&stack).unwrap();
        }
        let response = samples.response().unwrap();
        assert_eq!(response.white(), u16::MAX);
        assert!(grows(&response));
        let ratio = |z: usize| f64::from(response.exposure(1)[z * 257]) / simulated::truth(curve, z);
        for z in [30, 60, 90, 180, 230] {
            assert!((ratio(z) / ratio(120) - 1.0).abs() < 0.03, "{z}: {}", ratio(z) / ratio(120));
        }
    }

    #[test]
    fn without_a_bracket_there_is_nothing_to_recover() {
        let scene = simulated::scene(64, 48, 1);
        let mut samples = Samples::default();
        samples.add(&simulated::shoot(&scene, 64, &[1.0], CURVES[0].1, 1.0, 1)).unwrap();
        samples.add(&simulated::shoot(&scene, 64, &[1.0, 1.0], CURVES[0].1, 1.0, 1)).unwrap();
        let message = samples.response().unwrap_err().to_string();
        assert!(message.contains("two different exposure times") && message.contains("srgb"), "{message}");
        // A bracket of nothing but black tells nothing either.
        samples
            .add(&simulated::shoot(&vec![[0.0; 3]; 64 * 48], 64, &[1.0, 2.0], CURVES[0].1, 0.0, 1))
            .unwrap();
        assert!(samples.response().unwrap_err().to_string().contains("well exposed"));
        let mut deep = simulated::shoot(&scene, 64, &[1.0, 2.0], CURVES[0].1, 1.0, 1);
        deep.pictures.iter_mut().for_each(|picture| picture.white = u16::MAX);
        assert!(samples.add(&deep).unwrap_err().to_string().contains("65535"));
    }
}

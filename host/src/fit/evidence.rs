//! Which model a texel needs, by how well each predicts views that its fit has not seen.

use super::fitter::Fitter;
use super::select::{HeldOut, PARTS, predict, split};
use rayon::prelude::*;

use crate::geometry::Texels;
use crate::observation::TexelObservations;

/// What a texel's own views say about the models, each predicting views that its fit has not seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// Per model the mean error |prediction − measured| / (measured + floor); infinite where it cannot be fitted.
    pub error: Vec<f32>,
    /// Per model by how much that exceeds the least of them, and the standard error of this over the views.
    pub excess: Vec<[f32; 2]>,
    /// Per model the part of (prediction + floor) within which 68 % of the measurements lie.
    pub sigma: Vec<f32>,
}

/// Every view of a texel as the others predict it, a fifth of them at a time; `None` where that needs more views.
fn held_out(fitter: &Fitter, texel: &TexelObservations) -> Option<Vec<HeldOut>> {
    let mut all = vec![];
    for part in 0..PARTS {
        let (kept, held) = split(texel, part);
        if !held.is_empty() {
            all.extend(predict(fitter, &kept, &held)?);
        }
    }
    if all.is_empty() { None } else { Some(all) }
}

/// 68.27 % of `values` are at most this.
fn one_sigma(values: &mut [f32]) -> f32 {
    // Of few values the quantile is that of the next larger one: those seen are no upper bound of those to come.
    let rank = (0.6827 * (values.len() as f32 + 1.0)).floor() as usize;
    let rank = rank.min(values.len().saturating_sub(1));
    if values.is_empty() { f32::INFINITY } else { *values.select_nth_unstable_by(rank, f32::total_cmp).1 }
}

impl Evidence {
    /// Compares the models of `fitters` on one texel: every fifth of its views predicted from the others.
    pub fn of(fitters: &[Fitter], texel: &TexelObservations) -> Self {
        let views: Vec<_> = fitters.iter().map(|fitter| held_out(fitter, texel)).collect();
        let errors: Vec<Option<Vec<f32>>> =
            views.iter().map(|views| Some(views.as_ref()?.iter().map(|view| view.error).collect())).collect();
        let mean = |errors: &Option<Vec<f32>>| match errors {
            Some(errors) => errors.iter().sum::<f32>() / errors.len() as f32,
            None => f32::INFINITY,
        };
        let error: Vec<f32> = errors.iter().map(mean).collect();
        let least = (0..error.len()).min_by(|&a, &b| error[a].total_cmp(&error[b]));
        let Some(best) = least.and_then(|best| errors[best].as_ref()) else { return Self::default() };
        let excess = |errors: &Option<Vec<f32>>| {
            let Some(errors) = errors else { return [f32::INFINITY, 0.0] };
            let count = errors.len() as f32;
            let mean = errors.iter().zip(best).map(|(error, best)| error - best).sum::<f32>() / count;
            let squares = errors.iter().zip(best).map(|(error, best)| (error - best - mean).powi(2));
            [mean, (squares.sum::<f32>() / (count - 1.0).max(1.0) / count).sqrt()]
        };
        let sigma = |views: &Option<Vec<HeldOut>>| {
            one_sigma(&mut views.iter().flatten().flat_map(|view| view.relative).collect::<Vec<_>>())
        };
        Self { excess: errors.iter().map(excess).collect(), sigma: views.iter().map(sigma).collect(), error }
    }

    /// The smallest sufficient model (the models are in order of their size), and the smallest of which the views cannot say
    /// that it is worse: where the two differ the choice is open.
    ///
    /// Sufficient is what predicts at most 2 % worse than the best, or within `tolerance`. `None` where no model can be
    /// fitted.
    pub fn choices(&self, tolerance: f32) -> Option<[usize; 2]> {
        let least = self.error.iter().copied().fold(f32::INFINITY, f32::min);
        let enough = |sigmas: f32| {
            let is_enough = |m: &usize| {
                let [excess, sigma] = self.excess[*m];
                excess <= SLACK * least + sigmas * sigma || self.error[*m] <= tolerance
            };
            (0..self.error.len()).filter(|m| self.error[*m].is_finite()).find(is_enough)
        };
        Some([enough(0.0)?, enough(OPEN_SIGMAS)?])
    }

    /// By how much a model predicts worse than the best, relative to that.
    pub fn relative_excess(&self, model: usize) -> f32 {
        let least = self.error.iter().copied().fold(f32::INFINITY, f32::min);
        (self.excess[model][0] / least.max(f32::MIN_POSITIVE)).min(MOST_EXCESS)
    }

    /// The best of the other models.
    pub fn runner_up(&self, choice: usize) -> Option<usize> {
        let others = (0..self.error.len()).filter(|m| *m != choice && self.error[*m].is_finite());
        others.min_by(|&a, &b| self.error[a].total_cmp(&self.error[b]))
    }
}

/// Width of the zenith bands of [`zenith_factors`], degrees.
pub const BAND_DEG: f32 = 15.0;
/// How many there are.
pub const BANDS: usize = 6;
/// Fewer residuals in a band say nothing of it.
const FEWEST_RESIDUALS: usize = 300;

/// Which band a direction is in, by the cosine of its zenith.
pub fn zenith_band(cosine: f32) -> usize {
    ((cosine.clamp(0.0, 1.0).acos().to_degrees() / BAND_DEG) as usize).min(BANDS - 1)
}

/// Per model, by how much its standard deviation differs from the texel's own in each band of zeniths, from the texels of
/// a `sample` that choose it: near the horizon everything is less sure.
pub fn zenith_factors(fitters: &[Fitter], sample: &[TexelObservations], tolerance: f32) -> Vec<[f32; BANDS]> {
    let of_texel = |texel: &TexelObservations| {
        let evidence = Evidence::of(fitters, texel);
        let [model, _] = evidence.choices(tolerance)?;
        let sigma = evidence.sigma[model].max(f32::MIN_POSITIVE);
        let ratios = held_out(&fitters[model], texel)?.into_iter();
        let ratios = ratios.map(|view| (zenith_band(view.cosine), view.relative.map(|r| r / sigma)));
        Some((model, ratios.collect::<Vec<_>>()))
    };
    let found: Vec<_> = sample.par_iter().filter_map(of_texel).collect();
    let factor = |model: usize, band: usize| {
        let views = found.iter().filter(|(of, _)| *of == model).flat_map(|(_, ratios)| ratios);
        let mut ratios: Vec<f32> =
            views.filter(|(of, _)| *of == band).flat_map(|(_, ratios)| *ratios).collect();
        if ratios.len() < FEWEST_RESIDUALS { 1.0 } else { one_sigma(&mut ratios) }
    };
    (0..fitters.len()).map(|model| std::array::from_fn(|band| factor(model, band))).collect()
}

/// A model that predicts so little worse than the best is as good.
const SLACK: f32 = 0.02;
/// A difference below so many standard errors is open.
const OPEN_SIGMAS: f32 = 1.0;
/// A texel's excess counts no more than this among its neighbours'.
const MOST_EXCESS: f32 = 0.2;

/// Why a texel has the model that it has.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// It predicts views that its fit has not seen best, and the next smaller one clearly worse.
    #[default]
    Best = 0,
    /// A larger one predicts them hardly better.
    Sufficient = 1,
    /// It is within the tolerance that was asked for.
    Tolerance = 2,
    /// Its own views leave it open; the texels around it decided.
    Neighbours = 3,
    /// Too few views to fit any other.
    Only = 4,
    /// A larger one predicts better, but by less for its size than elsewhere on the surface.
    Economy = 5,
}

impl Reason {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 6] =
        [Self::Best, Self::Sufficient, Self::Tolerance, Self::Neighbours, Self::Only, Self::Economy];
}

/// The model of every texel (the first of them where its views allow none) and why; `sizes` are those of the models.
///
/// Where a texel's own views leave it open, the smallest model is taken that predicts at most 2 % worse than the best on
/// average over the texel and the eight around it. Then models are made smaller where that costs least, as long as the
/// surface is predicted at most 2 % worse than by the best single model for all of it: what the choice gains is taken as
/// size.
pub fn choose_models(
    evidence: &[Evidence],
    texels: Texels,
    sizes: &[usize],
    tolerance: f32,
) -> Vec<(usize, Reason)> {
    let mut chosen: Vec<(usize, Reason)> = (0..evidence.len())
        .map(|i| choose(evidence, texels, i, tolerance).unwrap_or((0, Reason::Only)))
        .collect();
    let known: Vec<usize> = (0..evidence.len()).filter(|&i| !evidence[i].error.is_empty()).collect();
    let single = |model: usize| known.iter().map(|&i| f64::from(evidence[i].error[model])).sum::<f64>();
    let allowed = (0..sizes.len()).map(single).fold(f64::INFINITY, f64::min) * f64::from(1.0 + SLACK);
    // What one byte must gain, in error of a texel.
    let worth = |price: f64, i: usize| {
        let cost = |m: usize| f64::from(evidence[i].error[m]) + price * sizes[m] as f64;
        (0..=chosen[i].0).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(0)
    };
    let error =
        |price: f64| known.iter().map(|&i| f64::from(evidence[i].error[worth(price, i)])).sum::<f64>();
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if error(middle) <= allowed { low = middle } else { high = middle }
    }
    if error(low) <= allowed {
        let economical: Vec<usize> = known.iter().map(|&i| worth(low, i)).collect();
        for (&i, model) in known.iter().zip(economical) {
            if model != chosen[i].0 {
                chosen[i] = (model, Reason::Economy);
            }
        }
    }
    chosen
}

fn choose(evidence: &[Evidence], texels: Texels, index: usize, tolerance: f32) -> Option<(usize, Reason)> {
    let own = &evidence[index];
    let [sufficient, open] = own.choices(tolerance)?;
    if own.error.iter().filter(|error| error.is_finite()).count() == 1 {
        return Some((sufficient, Reason::Only));
    }
    let best = own.error.iter().copied().fold(f32::INFINITY, f32::min);
    let reason = |choice: usize| match own.error[choice] {
        error if error == best => Reason::Best,
        error if error <= tolerance && own.relative_excess(choice) > SLACK => Reason::Tolerance,
        _ => Reason::Sufficient,
    };
    if sufficient == open {
        return Some((sufficient, reason(sufficient)));
    }
    let (columns, rows) = (texels.columns as usize, texels.rows as usize);
    let (column, row) = (index % columns, index / columns);
    let window = |at: usize, most: usize| at.saturating_sub(1)..(at + 2).min(most);
    let excess = |model: usize| {
        let (mut sum, mut count) = (0.0, 0.0);
        for row in window(row, rows) {
            for column in window(column, columns) {
                let near = &evidence[row * columns + column];
                if near.error.get(model).is_some_and(|error| error.is_finite()) {
                    sum += near.relative_excess(model);
                    count += 1.0;
                }
            }
        }
        sum / count
    };
    let choice = (open..sufficient).find(|&model| own.error[model].is_finite() && excess(model) <= SLACK);
    Some((choice.unwrap_or(sufficient), Reason::Neighbours))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZES: [usize; 3] = [6, 20, 34];

    fn evidence(error: [f32; 3], sigma: f32) -> Evidence {
        let least = error.iter().copied().fold(f32::INFINITY, f32::min);
        Evidence {
            sigma: error.into(),
            error: error.into(),
            excess: error.map(|e| [e - least, if e > least { sigma } else { 0.0 }]).into(),
        }
    }

    fn row(evidence: &[Evidence]) -> Vec<(usize, Reason)> {
        choose_models(evidence, Texels { columns: evidence.len() as u32, rows: 1 }, &SIZES, 0.0)
    }

    #[test]
    fn the_smallest_within_two_percent_of_the_best_suffices() {
        let clear = |error| evidence(error, 1e-4);
        // Beside texels that need the largest, so that there is nothing to economise on.
        let best = clear([0.3, 0.2, 0.1]);
        let chosen = row(&[clear([0.1, 0.0999, 0.1]), best.clone(), clear([0.2, 0.1, 0.099]), best]);
        let models: Vec<usize> = chosen.iter().map(|(model, _)| *model).collect();
        assert_eq!(models, [0, 2, 1, 2]);
        assert_eq!(chosen[0].1, Reason::Sufficient);
        assert_eq!(chosen[1].1, Reason::Best);
    }

    #[test]
    fn what_a_texel_leaves_open_its_neighbours_decide() {
        let (needs, open) = (evidence([0.3, 0.1, 0.1], 1e-4), evidence([0.105, 0.1, 0.1], 0.02));
        let content = evidence([0.1, 0.1, 0.1], 1e-4);
        let among = |around: &Evidence| {
            let row = [around.clone(), open.clone(), around.clone()];
            choose(&row, Texels { columns: 3, rows: 1 }, 1, 0.0)
        };
        assert_eq!(among(&needs), Some((1, Reason::Neighbours)));
        assert_eq!(among(&content), Some((0, Reason::Neighbours)));
    }

    #[test]
    fn a_tolerance_is_enough() {
        let texels = Texels { columns: 1, rows: 1 };
        let one = [evidence([0.018, 0.01, 0.009], 1e-4)];
        assert_eq!(choose_models(&one, texels, &SIZES, 0.02), [(0, Reason::Tolerance)]);
        assert_eq!(choose_models(&one, texels, &SIZES, 0.015)[0].0, 1);
    }

    #[test]
    fn what_the_choice_gains_over_a_single_model_is_taken_as_size_and_no_more() {
        // Half of the texels are best as constants: a large model for all loses there.
        let texel = |i: usize| match i % 2 {
            0 => evidence([0.05, 0.06, 0.07], 1e-4),
            _ => evidence([0.1 + 0.001 * i as f32, 0.08, 0.07], 1e-4),
        };
        let all: Vec<Evidence> = (0..40).map(texel).collect();
        let chosen = row(&all);
        let error = |choice: &dyn Fn(usize) -> usize| (0..40).map(|i| all[i].error[choice(i)]).sum::<f32>();
        let allowed = (0..3).map(|model| error(&|_| model)).fold(f32::INFINITY, f32::min);
        assert!(error(&|i| chosen[i].0) <= allowed * (1.0001 + SLACK));
        let size = chosen.iter().map(|(model, _)| SIZES[*model]).sum::<usize>();
        assert!(size < 40 * 20, "{size}");
        assert!(chosen.iter().any(|(_, reason)| *reason == Reason::Economy));
    }

    #[test]
    fn one_sigma_holds_68_percent_of_what_comes() {
        // The quantile of a few values is exceeded by a new one as often as it should be: ranks are uniform.
        for count in [4, 10, 75] {
            let mut values: Vec<f32> = (1..=count).map(|i| i as f32).collect();
            let covered = one_sigma(&mut values) / (count as f32 + 1.0);
            assert!((covered - 0.6827).abs() < 1.0 / count as f32, "{count}: {covered}");
        }
        assert_eq!(one_sigma(&mut []), f32::INFINITY);
    }

    #[test]
    fn a_texel_without_views_has_the_smallest_model() {
        assert_eq!(row(&[Evidence::default()]), [(0, Reason::Only)]);
        let few = evidence([0.1, f32::INFINITY, f32::INFINITY], 0.0);
        assert_eq!(row(&[few]), [(0, Reason::Only)]);
    }
}

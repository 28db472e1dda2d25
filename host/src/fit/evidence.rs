//! What a texel's own views say about the models.

use super::fitter::Fitter;
use super::held_out::{HeldOut, held_out, held_out_in};
use crate::observation::TexelObservations;

/// How a model predicts a texel's views that its fit has not seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Prediction {
    /// Mean error |prediction − measured| / (measured + floor); infinite where the model cannot be fitted.
    pub error: f32,
    /// By how much that exceeds the least of all models, and the standard error of this over the views.
    pub excess: [f32; 2],
    /// The part of (prediction + floor) within which 68 % of the measurements lie.
    pub sigma: f32,
}

/// What a texel's own views say about the models, each predicting views that its fit has not seen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Evidence {
    /// One for each model, in order of their size; none where no model can be fitted.
    pub(super) of: Vec<Prediction>,
}

/// A model that predicts so little worse than the best is as good.
pub(super) const SLACK: f32 = 0.02;
/// A difference below so many standard errors is open.
const OPEN_SIGMAS: f32 = 1.0;
/// A texel's excess counts no more than this among its neighbours'.
const MOST_EXCESS: f32 = 0.2;

/// 68.27 % of `values` are at most this.
pub(super) fn one_sigma(values: &mut [f32]) -> f32 {
    // Of few values the quantile is that of the next larger one: those seen are no upper bound of those to come.
    let rank = (0.6827 * (values.len() as f32 + 1.0)).floor() as usize;
    let rank = rank.min(values.len().saturating_sub(1));
    if values.is_empty() { f32::INFINITY } else { *values.select_nth_unstable_by(rank, f32::total_cmp).1 }
}

impl Evidence {
    /// Compares the models of `fitters` on texels that lie beside each other: a fifth of each texel's views predicted from the
    /// others, five times.
    pub(super) fn of(fitters: &[Fitter], texels: &[&TexelObservations]) -> Vec<Self> {
        let usable: Vec<_> = texels.iter().map(|texel| texel.usable()).collect();
        let views = held_out(fitters, &usable.iter().map(|texel| &**texel).collect::<Vec<_>>());
        views.iter().map(|views| Self::compare(views)).collect()
    }

    /// Compares them on one texel whose observations are dealt already: `parts`; all of them usable.
    pub(super) fn in_parts(fitters: &[Fitter], texel: &TexelObservations, parts: &[u8]) -> Self {
        let views = held_out_in(fitters, &[texel], &[parts.to_vec()]);
        views.first().map(|views| Self::compare(views)).unwrap_or_default()
    }

    fn compare(views: &[Option<Vec<HeldOut>>]) -> Self {
        let mean = |views: &Option<Vec<HeldOut>>| match views {
            Some(views) => views.iter().map(|view| view.error).sum::<f32>() / views.len() as f32,
            None => f32::INFINITY,
        };
        let error: Vec<f32> = views.iter().map(mean).collect();
        let least = (0..error.len()).min_by(|&a, &b| error[a].total_cmp(&error[b]));
        let Some(best) = least.and_then(|best| views[best].as_ref()) else { return Self::default() };
        let excess = |views: &Option<Vec<HeldOut>>| {
            let Some(views) = views else { return [f32::INFINITY, 0.0] };
            let count = views.len() as f32;
            let more = || views.iter().zip(best).map(|(view, best)| view.error - best.error);
            let mean = more().sum::<f32>() / count;
            let squares = more().map(|more| (more - mean).powi(2)).sum::<f32>();
            [mean, (squares / (count - 1.0).max(1.0) / count).sqrt()]
        };
        let sigma = |views: &Option<Vec<HeldOut>>| {
            one_sigma(&mut views.iter().flatten().flat_map(|view| view.relative).collect::<Vec<_>>())
        };
        let prediction = |(views, error)| Prediction { error, excess: excess(views), sigma: sigma(views) };
        Self { of: views.iter().zip(error).map(prediction).collect() }
    }

    /// The mean error in views that the fits have not seen, model by model in order of their size: |prediction − measured|
    /// / (measured + floor); infinite where there are too few views for a model. Empty where there are too few for any.
    pub fn errors(&self) -> impl ExactSizeIterator<Item = f32> {
        self.of.iter().map(|prediction| prediction.error)
    }

    /// The least error of all.
    pub(super) fn least(&self) -> f32 {
        self.errors().fold(f32::INFINITY, f32::min)
    }

    /// The models that can be fitted.
    pub(super) fn possible(&self) -> impl DoubleEndedIterator<Item = usize> {
        (0..self.of.len()).filter(|&model| self.of[model].error.is_finite())
    }

    /// The smallest sufficient model, and the smallest of which the views cannot say that it is worse: where the two differ
    /// the choice is open.
    ///
    /// Sufficient is what predicts at most 2 % worse than the best, or within `tolerance`. `None` where no model can be
    /// fitted.
    pub(super) fn choices(&self, tolerance: f32) -> Option<[usize; 2]> {
        let least = self.least();
        let enough = |sigmas: f32| {
            self.possible().find(|&model| {
                let Prediction { error, excess: [excess, sigma], .. } = self.of[model];
                excess <= SLACK * least + sigmas * sigma || error <= tolerance
            })
        };
        Some([enough(0.0)?, enough(OPEN_SIGMAS)?])
    }

    /// By how much a model predicts worse than the best, relative to that.
    pub(super) fn relative_excess(&self, model: usize) -> f32 {
        (self.of[model].excess[0] / self.least().max(f32::MIN_POSITIVE)).min(MOST_EXCESS)
    }

    /// The best of the other models.
    pub(super) fn runner_up(&self, choice: usize) -> Option<usize> {
        let others = self.possible().filter(|model| *model != choice);
        others.min_by(|&a, &b| self.of[a].error.total_cmp(&self.of[b].error))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn evidence(error: [f32; 3], sigma: f32) -> Evidence {
        let least = error.iter().copied().fold(f32::INFINITY, f32::min);
        let of = |error: f32| {
            let excess = [error - least, if error > least { sigma } else { 0.0 }];
            Prediction { error, excess, sigma: error }
        };
        Evidence { of: error.map(of).into() }
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
    fn the_runner_up_is_the_best_of_the_others() {
        assert_eq!(evidence([0.3, 0.1, 0.2], 0.0).runner_up(1), Some(2));
        assert_eq!(evidence([0.3, f32::INFINITY, f32::INFINITY], 0.0).runner_up(0), None);
    }
}

//! The model of every texel, from what its own views and those around it say.

use super::evidence::{Evidence, SLACK};
use crate::geometry::Texels;

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
    /// An entry of the palette, which texels that look alike share, predicts them as well as a model of its own.
    Palette = 6,
}

impl Reason {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 7] = [
        Self::Best,
        Self::Sufficient,
        Self::Tolerance,
        Self::Neighbours,
        Self::Only,
        Self::Economy,
        Self::Palette,
    ];
}

/// What a texel has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    /// Number of the model, in order of size.
    pub model: usize,
    /// The best of the others.
    pub runner_up: usize,
    /// Why.
    pub reason: Reason,
}

/// No texel's error grows by more than this, relative, for the size of the surface.
const MOST_LOSS: f64 = 0.5;

/// The model of every texel (the first where its views allow none); `sizes` are those of the models.
///
/// Where a texel's own views leave it open, the smallest model is taken that predicts at most 2 % worse than the best on
/// average over the texel and the eight around it. Then models are made smaller where that costs least, as long as the
/// surface is predicted no worse than by the best single model for all of it, and no texel half as much worse again: what
/// the choice gains is taken as size.
pub(super) fn choose(evidence: &[Evidence], texels: Texels, sizes: &[usize], tolerance: f32) -> Vec<Choice> {
    let mut chosen: Vec<(usize, Reason)> = (0..evidence.len())
        .map(|i| choose_one(evidence, texels, i, tolerance).unwrap_or((0, Reason::Only)))
        .collect();
    economise(evidence, sizes, &mut chosen);
    let runner_up = |(i, (model, reason)): (usize, (usize, Reason))| Choice {
        model,
        runner_up: evidence[i].runner_up(model).unwrap_or(model),
        reason,
    };
    chosen.into_iter().enumerate().map(runner_up).collect()
}

fn economise(evidence: &[Evidence], sizes: &[usize], chosen: &mut [(usize, Reason)]) {
    let known: Vec<usize> = (0..evidence.len()).filter(|&i| !evidence[i].of.is_empty()).collect();
    let error = |i: usize, model: usize| f64::from(evidence[i].of[model].error);
    // A texel with too few views for a model has the largest that it can have.
    let single = |model: usize| {
        let of = |&i: &usize| error(i, evidence[i].possible().rfind(|m| *m <= model).unwrap_or(model));
        known.iter().map(of).sum::<f64>()
    };
    let allowed = (0..sizes.len()).map(single).fold(f64::INFINITY, f64::min);
    // What one byte must gain, in error of a texel.
    let worth = |price: f64, i: usize| {
        let cost = |m: usize| error(i, m) + price * sizes[m] as f64;
        let most = (1.0 + MOST_LOSS) * error(i, chosen[i].0);
        (0..=chosen[i].0)
            .filter(|&m| error(i, m) <= most)
            .min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
            .unwrap_or(0)
    };
    let total = |price: f64| known.iter().map(|&i| error(i, worth(price, i))).sum::<f64>();
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if total(middle) <= allowed { low = middle } else { high = middle }
    }
    if total(low) > allowed {
        return;
    }
    let economical: Vec<usize> = known.iter().map(|&i| worth(low, i)).collect();
    for (&i, model) in known.iter().zip(economical) {
        if model != chosen[i].0 {
            chosen[i] = (model, Reason::Economy);
        }
    }
}

fn choose_one(
    evidence: &[Evidence],
    texels: Texels,
    index: usize,
    tolerance: f32,
) -> Option<(usize, Reason)> {
    let own = &evidence[index];
    let [sufficient, open] = own.choices(tolerance)?;
    if own.possible().count() == 1 {
        return Some((sufficient, Reason::Only));
    }
    let reason = |choice: usize| match own.of[choice].error {
        error if error == own.least() => Reason::Best,
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
                if near.of.get(model).is_some_and(|prediction| prediction.error.is_finite()) {
                    sum += near.relative_excess(model);
                    count += 1.0;
                }
            }
        }
        sum / count
    };
    let choice = own.possible().find(|model| (open..sufficient).contains(model) && excess(*model) <= SLACK);
    Some((choice.unwrap_or(sufficient), Reason::Neighbours))
}

#[cfg(test)]
mod tests {
    use super::super::evidence::tests::evidence;
    use super::*;

    const SIZES: [usize; 3] = [6, 20, 34];

    fn row(evidence: &[Evidence]) -> Vec<(usize, Reason)> {
        let texels = Texels { columns: evidence.len() as u32, rows: 1 };
        choose(evidence, texels, &SIZES, 0.0).iter().map(|choice| (choice.model, choice.reason)).collect()
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
            choose_one(&row, Texels { columns: 3, rows: 1 }, 1, 0.0)
        };
        assert_eq!(among(&needs), Some((1, Reason::Neighbours)));
        assert_eq!(among(&content), Some((0, Reason::Neighbours)));
    }

    #[test]
    fn a_tolerance_is_enough() {
        let texels = Texels { columns: 1, rows: 1 };
        let one = [evidence([0.018, 0.01, 0.009], 1e-4)];
        let within = choose(&one, texels, &SIZES, 0.02)[0];
        assert_eq!((within.model, within.reason), (0, Reason::Tolerance));
        assert_eq!(choose(&one, texels, &SIZES, 0.015)[0].model, 1);
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
        let error =
            |choice: &dyn Fn(usize) -> usize| (0..40).map(|i| all[i].of[choice(i)].error).sum::<f32>();
        let allowed = (0..3).map(|model| error(&|_| model)).fold(f32::INFINITY, f32::min);
        assert!(error(&|i| chosen[i].0) <= allowed * 1.0001);
        let size = chosen.iter().map(|(model, _)| SIZES[*model]).sum::<usize>();
        assert!(size < 40 * 20, "{size}");
        assert!(chosen.iter().any(|(_, reason)| *reason == Reason::Economy));
    }

    #[test]
    fn a_few_texels_do_not_pay_for_the_size_of_all() {
        // The surface as a whole could well afford constants: where one costs little, and where it costs all.
        let gain = evidence([0.05, 0.2, 0.3], 1e-4);
        let mut all = vec![gain; 40];
        all.push(evidence([0.13, 0.1, 0.1], 1e-4));
        all.push(evidence([0.3, 0.1, 0.1], 1e-4));
        let models: Vec<usize> = row(&all).iter().map(|(model, _)| *model).collect();
        assert_eq!(models[40..], [0, 1]);
    }

    #[test]
    fn a_texel_without_views_has_the_smallest_model() {
        assert_eq!(row(&[Evidence::default()]), [(0, Reason::Only)]);
        let few = evidence([0.1, f32::INFINITY, f32::INFINITY], 0.0);
        assert_eq!(row(&[few]), [(0, Reason::Only)]);
    }

    #[test]
    fn one_texel_with_few_views_does_not_make_the_others_constant() {
        let mut all = vec![evidence([0.3, 0.1, 0.1], 1e-4); 20];
        all.push(evidence([0.1, f32::INFINITY, f32::INFINITY], 0.0));
        let chosen = row(&all);
        assert_eq!(chosen.iter().filter(|(model, _)| *model == 1).count(), 20, "{chosen:?}");
    }
}

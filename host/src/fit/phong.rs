//! Lobes by variable projection (Golub and Pereyra 1973, in Kaufman's form of 1975): diffuse and specular radiance are
//! the non-negative least-squares solution for given shininess and directions, so only those three numbers of each
//! lobe are searched, by Levenberg-Marquardt.
//!
//! A lobe started at Ks = 0 has no gradient, and one started beside the highlight finds a smaller one: lobes are added
//! one by one, each from the best of several directions and a ladder of shininesses.
//!
//! The sums over views run in single precision, eight views at once. They are sums of residuals, which shrink as the
//! search goes on, so that what single precision hides is below the rounding of the observations themselves.

mod covariance;
mod explore;
mod found;
mod lanes;
mod layout;
mod refine;
mod start;
#[cfg(test)]
mod tests;
mod views;

use std::cell::RefCell;

use glam::DVec3;

use crate::observation::TexelObservations;
pub(super) use covariance::Covariance;
use found::Found;
use refine::Search;
use views::Views;

/// The most lobes that are fitted to one texel.
pub(super) const MOST_LOBES: usize = 4;

#[derive(Debug, Clone, Copy)]
struct Lobe {
    direction: DVec3,
    shininess: f64,
}

/// What a fit is told.
#[derive(Debug, Clone, Copy)]
pub(super) struct PhongOptions {
    /// 1 to 4.
    pub lobes: usize,
    /// All lobes have the same shininess (thesis, equation 11.2).
    pub shared_shininess: bool,
    /// No lobe is sharper.
    pub shininess_max: f64,
    /// Of the expected error, the part relative to the radiance and the absolute part.
    pub relative_error: f64,
    pub floor: f64,
    /// Views that disagree with the rest count less.
    pub robust: bool,
    /// A lobe counts as identified where it is right (direction within 1 degree, shininess within 20 %) with at least
    /// this probability; `None`: nobody asks, and nobody judges.
    pub identified: Option<f64>,
    /// Lobes that are not identified are left out, and the others fitted without them.
    pub identified_only: bool,
}

/// What a fit found.
#[derive(Debug, Clone)]
pub(super) struct PhongFit {
    /// In the order of `Model::channel_names`, the strongest lobe first.
    pub parameters: Vec<f32>,
    /// A lobe's shininess or direction ended at its bound.
    pub at_bound: bool,
    /// The search ended because nothing got better, not because it ran out of steps.
    pub converged: bool,
    /// Of each lobe that has radiance, the probability that its direction is within 1 degree of the truth and its shininess
    /// within 20 %.
    pub right: Vec<f64>,
    /// Whether all lobes that earned their numbers are identified.
    pub identified: bool,
    /// `None` where there were too few views, or nobody asked for a verdict.
    pub covariance: Option<Box<Covariance>>,
    /// How many views are usable.
    pub views: usize,
    /// Root mean square of residual / expected error.
    pub residual: f64,
}

impl PhongFit {
    /// Predicted standard deviation of the model's radiance toward a unit direction, by the uncertainty of its
    /// coefficients; infinite where nothing is known of it.
    pub fn sigma(&self, direction: DVec3) -> [f64; 3] {
        self.covariance.as_ref().map_or([f64::INFINITY; 3], |covariance| covariance.sigma(direction))
    }
}

thread_local! {
    /// A texel's views are laid out where those of the texel before it were; and those of one lobe alone.
    static VIEWS: RefCell<[Views; 2]> = RefCell::default();
}

/// Fits lobes to a texel; one that does not earn its six numbers is left without radiance. Where there are fewer views than
/// unknowns, a constant.
pub(super) fn fit(texel: &TexelObservations, options: &PhongOptions) -> PhongFit {
    let mut last = None;
    grow(texel, options, &mut |fit| last = Some(fit), &[options.lobes]);
    last.expect("there is one fit for each number of lobes")
}

/// The parameters of fits with up to `lobes` lobes each (ascending), without a verdict; [`PhongOptions::lobes`] is not looked at. What
/// the smaller ones found is the larger ones' beginning.
pub(super) fn nested(texel: &TexelObservations, lobes: &[usize], options: &PhongOptions) -> Vec<Vec<f32>> {
    let mut all = Vec::with_capacity(lobes.len());
    grow(texel, &PhongOptions { identified: None, ..*options }, &mut |fit| all.push(fit.parameters), lobes);
    all
}

/// Adds lobe after lobe, and hands `found` a fit for each of the ascending `numbers` of lobes.
fn grow(
    texel: &TexelObservations,
    options: &PhongOptions,
    found: &mut dyn FnMut(PhongFit),
    numbers: &[usize],
) {
    VIEWS.with_borrow_mut(|[views, alone]| {
        views.fill(texel, options.relative_error, options.floor);
        let coarse = Search { small: 3.0, covariance: false, ..search(options) };
        let mut grown = Found::constant(views);
        let (mut enough, mut lone) = (false, false);
        for (i, &number) in numbers.iter().enumerate() {
            let options = PhongOptions { lobes: number, ..*options };
            if views.count <= 4 * number {
                found(grown.clone().report(views, &options, None));
                continue;
            }
            while !enough && grown.lobes.len() < number.min(MOST_LOBES) {
                grown.leave(views);
                let most = if options.robust { views.largest_left() } else { 0.0 };
                let more = grown.grow(views, &coarse);
                enough = !grown.earns(&more, views, most);
                lone |= enough && grown.earns(&more, views, 0.0);
                if !enough {
                    grown = more;
                }
            }
            let fit = polish(grown.clone(), views, alone, &options);
            found(PhongFit { identified: fit.identified && !lone, ..fit });
            if i + 1 < numbers.len() {
                // The weights are those that the fit has given them.
                views.fill(texel, options.relative_error, options.floor);
            }
        }
    });
}

/// Refines the lobes of `parameters`, in the order of `Model::channel_names`; they do not come, and go only where they are not
/// identified.
pub(super) fn refit(texel: &TexelObservations, parameters: &[f32], options: &PhongOptions) -> PhongFit {
    VIEWS.with_borrow_mut(|[views, alone]| {
        views.fill(texel, options.relative_error, options.floor);
        if views.count <= 4 * options.lobes {
            return Found::constant(views).report(views, options, None);
        }
        let coarse = Search { small: 3.0, covariance: false, ..search(options) };
        let (found, _) = Found::of(parameters, views.unit).again(views, &coarse);
        polish(found, views, alone, options)
    })
}

fn search(options: &PhongOptions) -> Search {
    Search {
        shininess_max: options.shininess_max,
        shared: options.shared_shininess,
        small: 0.1,
        covariance: options.identified.is_some(),
    }
}

/// From lobes that are roughly right to a fit and its verdict.
fn polish(mut found: Found, views: &mut Views, alone: &mut Views, options: &PhongOptions) -> PhongFit {
    let search = search(options);
    found.sort();
    found.scale(views.balance(found.channels));
    let mut changed = false;
    if options.robust && views.count > 1 + 4 * options.lobes {
        found.leave(views);
        changed = views.reweight();
    }
    let mut covariance;
    (found, covariance) = found.again(views, &search);
    for _ in 0..2 {
        if changed {
            found.leave(views);
            changed = views.reweight();
            (found, covariance) = found.again(views, &search);
        }
    }
    let (Some(least), Some(known)) = (options.identified, &covariance) else {
        views.unweight();
        return PhongFit { identified: false, ..found.report(views, options, None) };
    };
    found.right = (0..found.lobes.len()).map(|l| found.judge(l, known, views, alone)).collect();
    let sure = |right: f64| right >= least;
    let identified = found.right.iter().all(|right| sure(*right));
    if options.identified_only && !identified {
        found.keep(sure);
        let right = std::mem::take(&mut found.right);
        (found, covariance) = found.again(views, &search);
        found.right = right;
    }
    views.unweight();
    PhongFit { identified, ..found.report(views, options, covariance) }
}

//! Lobes by variable projection (Golub and Pereyra 1973, in Kaufman's form of 1975): diffuse and specular radiance are
//! the non-negative least-squares solution for given shininess and directions, so only those three numbers of each
//! lobe are searched, by Levenberg-Marquardt.
//!
//! A lobe started at Ks = 0 has no gradient, and one started beside the highlight finds a smaller one: lobes are added
//! one by one, each from the best of several directions and a ladder of shininesses.
//!
//! The sums over views run in single precision, eight views at once. They are sums of residuals, which shrink as the
//! search goes on, so that what single precision hides is below the rounding of the observations themselves.

mod lanes;
mod refine;
mod start;
mod views;

use std::cell::RefCell;

use glam::DVec3;

use super::model::SHININESS;
use crate::observation::TexelObservations;
use refine::{Place, ROUNDING, TERMS, leave, refine};
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
    /// No lobe is sharper.
    pub shininess_max: f64,
    /// Of the expected error, the part relative to the radiance and the absolute part.
    pub relative_error: f64,
    pub floor: f64,
    /// Views that disagree with the rest count less.
    pub robust: bool,
}

/// What a fit found.
pub(super) struct PhongFit {
    /// In the order of `Model::channel_names`.
    pub parameters: Vec<f32>,
    /// A lobe's shininess or direction ended at its bound.
    pub at_bound: bool,
    /// The search ended because nothing got better, not because it ran out of steps.
    pub converged: bool,
    /// How many views are usable.
    pub views: usize,
    /// Root mean square of residual / expected error, and of residual relative to that of the radiance.
    pub residual: f64,
    pub relative_residual: f64,
}

thread_local! {
    /// A texel's views are laid out where those of the texel before it were.
    static VIEWS: RefCell<Views> = RefCell::default();
}

/// Fits lobes to a texel; one that does not earn its six numbers is left without radiance. Where there are fewer views than unknowns,
/// a constant.
pub(super) fn fit(texel: &TexelObservations, options: &PhongOptions) -> PhongFit {
    VIEWS.with_borrow_mut(|views| {
        views.fill(texel, options.relative_error, options.floor);
        let mut found = Found::constant(views);
        if views.count > 4 * options.lobes {
            found = found.with_lobes(views, options);
            if options.robust && views.count > 1 + 4 * options.lobes {
                for _ in 0..3 {
                    found.leave(views);
                    if !found.reweight(views) {
                        break;
                    }
                    found = found.again(views, options.shininess_max);
                }
                views.unweight();
            }
        }
        found.finish(views, options)
    })
}

/// Whether one lobe more lowers the residual by more than its six numbers would by chance (Schwarz's criterion, 1978):
/// needless lobes make foils no better and cloth worse.
fn earned(views: &Views, before: &Found, after: &Found) -> bool {
    let count = 3.0 * views.count as f64;
    // Radiance comes in single precision: what is left below that is rounding.
    let floor = 10.0 * ROUNDING * views.energy;
    before.squares > floor && count * (before.squares / after.squares.max(floor)).ln() > 6.0 * count.ln()
}

/// Adds a lobe to those found before it and refines them together.
fn grow<const L: usize, const R: usize, const K: usize, const S: usize>(
    views: &mut Views,
    before: &Found,
    shininess_max: f64,
) -> Found {
    let starts = start::starts::<K, S>(views, &before.lobes, &before.linear, shininess_max);
    // A second lobe hides in what the first one left: there one start is too few.
    let starts = starts.into_iter().take(if before.lobes.is_empty() { 1 } else { 2 });
    let found = starts.map(|start| {
        let mut lobes = [start; L];
        lobes[..before.lobes.len()].copy_from_slice(&before.lobes);
        Found::from(refine::<L, R>(views, lobes, &before.linear, shininess_max))
    });
    found.min_by(|a, b| a.squares.total_cmp(&b.squares)).unwrap_or_else(|| before.clone())
}

/// A place of the search whose number of lobes is not known when compiled.
#[derive(Debug, Clone)]
struct Found {
    lobes: Vec<Lobe>,
    linear: [[f64; TERMS]; 3],
    squares: f64,
    converged: bool,
}

impl<const L: usize, const R: usize> From<(Place<L, R>, bool)> for Found {
    fn from((place, converged): (Place<L, R>, bool)) -> Self {
        Self { lobes: place.lobes.to_vec(), linear: place.linear, squares: place.squares, converged }
    }
}

impl Found {
    fn constant(views: &mut Views) -> Self {
        let mut linear = [[0.0; TERMS]; 3];
        for (linear, mean) in linear.iter_mut().zip(views.mean) {
            linear[0] = mean;
        }
        Self::from((Place::<0, 4>::new(views, [], &linear), true))
    }

    fn with_lobes(self, views: &mut Views, options: &PhongOptions) -> Self {
        let (mut found, most) = (self, options.shininess_max);
        for count in 1..=options.lobes.min(MOST_LOBES) {
            let more = match count {
                1 => grow::<1, 8, 4, 5>(views, &found, most),
                2 => grow::<2, 12, 5, 6>(views, &found, most),
                3 => grow::<3, 16, 6, 7>(views, &found, most),
                _ => grow::<4, 20, 7, 8>(views, &found, most),
            };
            if !earned(views, &found, &more) {
                break;
            }
            found = more;
        }
        found
    }

    /// Refines with other weights; lobes neither come nor go.
    fn again(&self, views: &mut Views, shininess_max: f64) -> Self {
        match *self.lobes.as_slice() {
            [] => Self::constant(views),
            [a] => Self::from(refine::<1, 8>(views, [a], &self.linear, shininess_max)),
            [a, b] => Self::from(refine::<2, 12>(views, [a, b], &self.linear, shininess_max)),
            [a, b, c] => Self::from(refine::<3, 16>(views, [a, b, c], &self.linear, shininess_max)),
            [a, b, c, d, ..] => Self::from(refine::<4, 20>(views, [a, b, c, d], &self.linear, shininess_max)),
        }
    }

    /// Leaves its residuals in the rows.
    fn leave(&self, views: &mut Views) {
        match self.lobes.len() {
            0 => leave::<4>(views, &self.lobes, &self.linear),
            1 => leave::<5>(views, &self.lobes, &self.linear),
            2 => leave::<6>(views, &self.lobes, &self.linear),
            3 => leave::<7>(views, &self.lobes, &self.linear),
            _ => leave::<8>(views, &self.lobes, &self.linear),
        }
    }

    fn reweight(&self, views: &mut Views) -> bool {
        match self.lobes.len() {
            0 => views.reweight::<4>(),
            1 => views.reweight::<5>(),
            2 => views.reweight::<6>(),
            3 => views.reweight::<7>(),
            _ => views.reweight::<8>(),
        }
    }

    fn misses(&self, views: &mut Views) -> [f64; 3] {
        match self.lobes.len() {
            0 => views.misses::<4>(),
            1 => views.misses::<5>(),
            2 => views.misses::<6>(),
            3 => views.misses::<7>(),
            _ => views.misses::<8>(),
        }
    }

    /// The strongest lobe first, and lobes without radiance up to the number asked for.
    fn finish(self, views: &mut Views, options: &PhongOptions) -> PhongFit {
        let strength = |l: usize| -> f64 { self.linear.iter().map(|v| v[1 + l]).sum() };
        let mut order: Vec<usize> = (0..self.lobes.len()).filter(|l| strength(*l) > 0.0).collect();
        order.sort_by(|a, b| strength(*b).total_cmp(&strength(*a)));
        let mut at_bound = false;
        let mut parameters: Vec<f32> = self.linear.iter().map(|v| (v[0] * views.unit) as f32).collect();
        for l in order {
            let Lobe { direction, shininess } = self.lobes[l];
            at_bound |=
                shininess <= *SHININESS.start() || shininess >= options.shininess_max || direction.z <= 0.0;
            parameters.extend(self.linear.iter().map(|v| (v[1 + l] * views.unit) as f32));
            parameters.push(shininess as f32);
            parameters.extend(direction.as_vec3().to_array());
        }
        while parameters.len() < 3 + 7 * options.lobes {
            parameters.extend([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        }
        self.leave(views);
        let [weighted, squares, energy] = self.misses(views);
        let count = 3.0 * views.count.max(1) as f64;
        PhongFit {
            parameters,
            at_bound,
            converged: self.converged,
            views: views.count,
            residual: (weighted / count).sqrt() / views.error,
            relative_residual: (squares / energy.max(f64::MIN_POSITIVE)).sqrt(),
        }
    }
}

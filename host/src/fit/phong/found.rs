//! A place of the search whose number of lobes is not known when compiled.

use glam::DVec3;

use super::super::model::SHININESS;
use super::covariance::Covariance;
use super::explore::{Alone, DIRECTION_RAD, SHININESS_PART, normal};
use super::refine::{Place, ROUNDING, Search, TERMS, leave, refine};
use super::start::starts;
use super::views::Views;
use super::{Lobe, MOST_LOBES, PhongFit, PhongOptions};

/// Lobes, their radiance (of the constant first), and what they leave.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub lobes: Vec<Lobe>,
    linear: [[f64; TERMS]; 3],
    squares: f64,
    /// The same by channel.
    pub channels: [f64; 3],
    converged: bool,
    /// The probability that each lobe is right, once judged.
    pub right: Vec<f64>,
}

/// Where the covariance gives a lobe no better chance of being right, it is taken at its word.
const HOPELESS: f64 = 0.2;

impl<const L: usize, const N: usize, const R: usize> From<(Place<L, N, R>, bool)> for Found {
    fn from((place, converged): (Place<L, N, R>, bool)) -> Self {
        Self {
            lobes: place.lobes.to_vec(),
            linear: place.linear,
            squares: place.total(),
            channels: place.squares,
            converged,
            right: Vec::new(),
        }
    }
}

impl Found {
    pub fn constant(views: &mut Views) -> Self {
        let mut linear = [[0.0; TERMS]; 3];
        for (linear, mean) in linear.iter_mut().zip(views.mean) {
            linear[0] = mean;
        }
        Self::from((Place::<0, 0, 4>::new(views, [], &linear), true))
    }

    /// The lobes of a model's parameters, those without radiance left out.
    pub fn of(parameters: &[f32], unit: f64) -> Self {
        let linear = [0, 1, 2].map(|c| {
            let mut values = [0.0; TERMS];
            values[0] = f64::from(parameters[c]) / unit;
            values
        });
        let mut found = Self {
            lobes: Vec::new(),
            linear,
            squares: 0.0,
            channels: [0.0; 3],
            converged: true,
            right: Vec::new(),
        };
        let lobes = parameters[3..].chunks_exact(7).filter(|lobe| lobe[..3].iter().any(|ks| *ks > 0.0));
        for lobe in lobes.take(MOST_LOBES) {
            for (values, radiance) in found.linear.iter_mut().zip(lobe) {
                values[1 + found.lobes.len()] = f64::from(*radiance) / unit;
            }
            found.lobes.push(Lobe {
                direction: DVec3::new(lobe[4].into(), lobe[5].into(), lobe[6].into()).normalize_or(DVec3::Z),
                shininess: lobe[3].into(),
            });
        }
        found
    }

    /// With one lobe more, refined together.
    pub fn grow(&self, views: &mut Views, search: &Search) -> Self {
        match self.lobes.len() {
            0 => self.grown::<1, 3, 8, 4, 5>(views, search),
            1 => self.grown::<2, 6, 12, 5, 6>(views, search),
            2 => self.grown::<3, 9, 16, 6, 7>(views, search),
            _ => self.grown::<4, 12, 20, 7, 8>(views, search),
        }
    }

    fn grown<const L: usize, const N: usize, const R: usize, const K: usize, const S: usize>(
        &self,
        views: &mut Views,
        search: &Search,
    ) -> Self {
        let starts = starts::<K, S>(views, &self.lobes, &self.linear, search.shininess_max);
        // A second lobe hides in what the first one left: there one start is too few.
        let starts = starts.into_iter().take(if self.lobes.is_empty() { 1 } else { 2 });
        let found = starts.map(|start| {
            let mut lobes = [start; L];
            lobes[..self.lobes.len()].copy_from_slice(&self.lobes);
            if search.shared {
                lobes[L - 1].shininess = lobes[0].shininess;
            }
            Self::from(refine::<L, N, R>(views, lobes, &self.linear, search))
        });
        found.min_by(|a, b| a.squares.total_cmp(&b.squares)).unwrap_or_else(|| self.clone())
    }

    /// Whether the lobe that `more` has more lowers the residual, of which `lone` does not count, by more than its six numbers
    /// would by chance (Schwarz's criterion, 1978): needless lobes make foils no better and cloth worse.
    ///
    /// With what a single view leaves for `lone`, no lobe rests on one view alone: it may be a passer-by.
    pub fn earns(&self, more: &Self, views: &Views, lone: f64) -> bool {
        let count = 3.0 * views.count as f64;
        // Radiance comes in single precision: what is left below that is rounding.
        let floor = 10.0 * ROUNDING * views.energy;
        let squares = self.squares - lone;
        squares > floor && count * (squares / more.squares.max(floor)).ln() > 6.0 * count.ln()
    }

    /// Refines with other weights, and says how sure the result is if the search asks; lobes neither come nor go.
    pub fn again(&self, views: &mut Views, search: &Search) -> (Self, Option<Box<Covariance>>) {
        match *self.lobes.as_slice() {
            [] => Self::concluded((Place::<0, 0, 4>::new(views, [], &self.linear), true), views, search),
            [a] => Self::concluded(refine::<1, 3, 8>(views, [a], &self.linear, search), views, search),
            [a, b] => Self::concluded(refine::<2, 6, 12>(views, [a, b], &self.linear, search), views, search),
            [a, b, c] => {
                Self::concluded(refine::<3, 9, 16>(views, [a, b, c], &self.linear, search), views, search)
            }
            [a, b, c, d, ..] => {
                Self::concluded(refine::<4, 12, 20>(views, [a, b, c, d], &self.linear, search), views, search)
            }
        }
    }

    fn concluded<const L: usize, const N: usize, const R: usize>(
        (place, converged): (Place<L, N, R>, bool),
        views: &Views,
        search: &Search,
    ) -> (Self, Option<Box<Covariance>>) {
        let found = Self::from((place, converged));
        let scale = views.channels.map(|factor| views.unit / factor);
        let covariance =
            search.covariance.then(|| Covariance::new(&place, search, found.variance(views), scale).into());
        (found, covariance)
    }

    /// Variance of a residual whose weight is 1: what is left says it, and what was stated counts as much as four
    /// observations.
    fn variance(&self, views: &Views) -> f64 {
        let unknowns = 3.0 + 6.0 * self.lobes.len() as f64;
        let freedom = (3.0 * views.count as f64 - unknowns).max(0.0);
        let stated = views.error * views.error;
        // Observations are rounded to single precision.
        (self.squares + 4.0 * stated.min(self.squares)) / (freedom + 4.0) + 1e-15 * views.energy
    }

    /// The probability that a lobe is right: direction within 1 degree, shininess within 20 %.
    ///
    /// The covariance knows nothing of other basins, and little of a valley that bends. Unless it leaves no doubt and
    /// many views see the lobe, everything that explains the views as well is looked for.
    pub fn judge(&self, l: usize, covariance: &Covariance, views: &mut Views, alone: &mut Views) -> f64 {
        let ([wide_rad, narrow_rad], sigma) = covariance.lobe(l);
        let within = |tolerance: f64, sigma: f64| 2.0 * normal(tolerance / sigma) - 1.0;
        let shininess =
            normal((1.0 + SHININESS_PART).ln() / sigma) - normal((1.0 - SHININESS_PART).ln() / sigma);
        let linear = within(DIRECTION_RAD, wide_rad) * within(DIRECTION_RAD, narrow_rad) * shininess;
        let variance = self.variance(views);
        // Least squares are blind to what lies far off only if that far off is hopeless already.
        if linear < HOPELESS || (linear > 0.999 && self.seen(l, views, variance) >= 6) {
            return linear;
        }
        let (mut others, lobe) = (self.clone(), self.lobes[l]);
        for values in &mut others.linear {
            (values[0], values[1 + l]) = (0.0, 0.0);
        }
        others.leave(views);
        // At a third of the shininess the lobe is 2 % of its greatest here.
        let reach = 0.02_f64.powf(1.0 / (lobe.shininess / 3.0).max(1.0)).acos() + 0.15;
        views.isolate(lobe.direction, reach.min(std::f64::consts::PI).cos(), alone);
        let linear_terms = self.linear.map(|values| {
            let mut terms = [0.0; TERMS];
            (terms[0], terms[1]) = (values[0], values[1 + l]);
            terms
        });
        let explored = Alone { views: alone, lobe, linear: linear_terms, variance }.explore();
        // The covariance of several lobes together may be wider than that of one alone.
        explored.right_of(&lobe).min(if self.lobes.len() > 1 { linear.max(0.0).sqrt() } else { 1.0 })
    }

    /// How many views see the lobe above three standard deviations of the noise.
    fn seen(&self, l: usize, views: &mut Views, variance: f64) -> usize {
        let strength = self.linear.iter().map(|values| values[1 + l].powi(2)).sum::<f64>().sqrt();
        let least = (3.0 * variance.sqrt() / strength.max(f64::MIN_POSITIVE)) as f32;
        views.lobe_values(&self.lobes[l]).as_flattened().iter().filter(|value| **value > least).count()
    }

    /// Leaves what it does not explain in `left`.
    pub fn leave(&self, views: &mut Views) {
        leave(views, &self.lobes, &self.linear);
    }

    /// Follows a change of the channels' scale.
    pub fn scale(&mut self, factors: [f64; 3]) {
        for (values, factor) in self.linear.iter_mut().zip(factors) {
            for value in values {
                *value *= factor;
            }
        }
    }

    /// The strongest lobe first; lobes without radiance go.
    pub fn sort(&mut self) {
        let strength = |l: usize| -> f64 { self.linear.iter().map(|values| values[1 + l]).sum() };
        let mut order: Vec<usize> = (0..self.lobes.len()).filter(|l| strength(*l) > 0.0).collect();
        order.sort_by(|a, b| strength(*b).total_cmp(&strength(*a)));
        self.pick(&order);
    }

    /// Lobes whose probability of being right is too small go.
    pub fn keep(&mut self, enough: impl Fn(f64) -> bool) {
        let order: Vec<usize> = (0..self.lobes.len()).filter(|l| enough(self.right[*l])).collect();
        self.pick(&order);
    }

    fn pick(&mut self, order: &[usize]) {
        self.lobes = order.iter().map(|l| self.lobes[*l]).collect();
        if !self.right.is_empty() {
            self.right = order.iter().map(|l| self.right[*l]).collect();
        }
        for values in &mut self.linear {
            let before = *values;
            values[1..].fill(0.0);
            for (to, l) in values[1..].iter_mut().zip(order) {
                *to = before[1 + l];
            }
        }
    }

    /// In the samples' own units, with lobes without radiance up to the number asked for.
    pub fn report(
        self,
        views: &mut Views,
        options: &PhongOptions,
        covariance: Option<Box<Covariance>>,
    ) -> PhongFit {
        let mut at_bound = false;
        let brightest = f64::from(f32::MAX);
        let term = |t: usize| {
            // Unlike `min`, this leaves alone what is not a number.
            [0, 1, 2]
                .map(|c| (self.linear[c][t] * views.unit / views.channels[c]).clamp(0.0, brightest) as f32)
        };
        let mut parameters = Vec::with_capacity(3 + 7 * options.lobes);
        parameters.extend(term(0));
        for (l, Lobe { direction, shininess }) in self.lobes.iter().enumerate() {
            at_bound |=
                *shininess <= *SHININESS.start() || *shininess >= options.shininess_max || direction.z <= 0.0;
            parameters.extend(term(1 + l));
            parameters.push(*shininess as f32);
            parameters.extend(direction.as_vec3().to_array());
        }
        while parameters.len() < 3 + 7 * options.lobes {
            parameters.extend([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        }
        self.leave(views);
        PhongFit {
            parameters,
            at_bound,
            converged: self.converged,
            right: self.right,
            identified: true,
            covariance,
            views: views.count,
            residual: (views.misses() / (3.0 * views.count.max(1) as f64)).sqrt(),
        }
    }
}

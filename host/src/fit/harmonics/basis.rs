//! The harmonics at a direction: one recurrence for single numbers and for eight texels at once.

mod written;

use std::f64::consts::PI;
use std::sync::LazyLock;

use glam::DVec3;

pub(crate) use written::Written;

/// Which functions of the direction there are coefficients for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in super::super) enum Basis {
    /// The real spherical harmonics of degree below `order`: order².
    Sphere,
    /// Those that are even in z: order (order + 1) / 2. They are orthogonal on the hemisphere, and to fit them is to
    /// fit all harmonics to the samples and their mirror images below the horizon (Westin, Arvo, Torrance 1992).
    Mirrored,
    /// Those of the direction stretched over the whole sphere, z to 2z - 1: order² (Gautron et al. 2004), orthonormal
    /// on the hemisphere, all but the zonal ones 0 at the horizon.
    Stretched,
}

/// A number, or eight of them.
pub(super) trait Number: Copy {
    type Scalar: Copy;
    fn splat(value: Self::Scalar) -> Self;
    fn times(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times_plus(self, factor: Self, term: Self) -> Self;
}

impl Number for f64 {
    type Scalar = f64;

    #[inline(always)]
    fn splat(value: f64) -> f64 {
        value
    }

    #[inline(always)]
    fn times(self, other: f64) -> f64 {
        self * other
    }

    #[inline(always)]
    fn minus(self, other: f64) -> f64 {
        self - other
    }

    // Not fused: without run-time dispatch that is a call of a library function.
    #[inline(always)]
    fn times_plus(self, factor: f64, term: f64) -> f64 {
        self * factor + term
    }
}

/// The step from one associated Legendre function to the next of the same m: (a u + s) now + c before, with u = z, or z²
/// where only every second is wanted; and where its products with the cosine and sine of the azimuth go.
#[derive(Debug, Clone, Copy)]
struct Step<S> {
    a: S,
    s: S,
    c: S,
    place: (usize, usize),
}

/// The functions of one m: that of degree m, and the steps from it to the higher degrees.
#[derive(Debug, Clone)]
struct Column<S> {
    start: S,
    place: (usize, usize),
    steps: Vec<Step<S>>,
}

/// How to evaluate a basis.
#[derive(Debug, Clone)]
pub(super) struct Rule<S> {
    squared: bool,
    columns: Vec<Column<S>>,
}

impl Basis {
    /// Number of functions below `order`.
    pub(in super::super) fn count(self, order: usize) -> usize {
        match self {
            Self::Mirrored => order * (order + 1) / 2,
            Self::Sphere | Self::Stretched => order * order,
        }
    }

    /// Degree l and order m of each function, in the order of the coefficients.
    pub(in super::super) fn indices(self, order: usize) -> impl Iterator<Item = (i32, i32)> {
        let step = if self == Self::Mirrored { 2 } else { 1 };
        (0..order as i32).flat_map(move |l| (-l..=l).step_by(step).map(move |m| (l, m)))
    }

    /// The coefficient of the function that is constant, for a radiance of 1.
    pub(in super::super) fn one(self) -> f64 {
        if self == Self::Stretched { (2.0 * PI).sqrt() } else { (4.0 * PI).sqrt() }
    }

    /// The unit vector at which the spherical harmonics are evaluated.
    #[inline(always)]
    pub(super) fn place(self, direction: DVec3) -> DVec3 {
        if self != Self::Stretched {
            return direction;
        }
        let z = direction.z.max(0.0);
        let stretch = (4.0 * z / (1.0 + z)).sqrt();
        DVec3::new(direction.x * stretch, direction.y * stretch, 2.0 * z - 1.0)
    }

    /// How to evaluate the functions below `order`.
    pub(super) fn rule(self, order: usize) -> Rule<f64> {
        let index = |l: usize, m: i32| match self {
            Self::Mirrored => l * (l + 1) / 2 + (l as i32 + m) as usize / 2,
            Self::Sphere | Self::Stretched => l * l + (l as i32 + m) as usize,
        };
        // 1 / (4 pi) on the sphere; a function on the hemisphere alone has twice the square.
        let mut diagonal = 1.0 / self.one();
        let mut columns = Vec::with_capacity(order);
        for m in 0..order {
            if m > 0 {
                diagonal *= ((2 * m + 1) as f64 / (2 * m) as f64).sqrt();
            }
            // z P(l) = alpha(l + 1) P(l + 1) + alpha(l) P(l - 1) for the normalised functions.
            let alpha = |l: usize| {
                let (l, m) = (l as f64, m as f64);
                ((l * l - m * m) / (4.0 * l * l - 1.0)).max(0.0).sqrt()
            };
            let place = |l: usize| (index(l, m as i32), index(l, -(m as i32)));
            let mut steps = Vec::new();
            let stride = if self == Self::Mirrored { 2 } else { 1 };
            for l in (m + stride..order).step_by(stride) {
                let (a, s, c) = if self == Self::Mirrored {
                    let scale = 1.0 / (alpha(l - 1) * alpha(l));
                    let before = if l >= m + 4 { alpha(l - 2) * alpha(l - 3) } else { 0.0 };
                    (scale, -scale * (alpha(l - 1).powi(2) + alpha(l - 2).powi(2)), -scale * before)
                } else {
                    let before = if l >= m + 2 { alpha(l - 1) } else { 0.0 };
                    (1.0 / alpha(l), 0.0, -before / alpha(l))
                };
                steps.push(Step { a, s, c, place: place(l) });
            }
            let start = if m == 0 { diagonal } else { diagonal * std::f64::consts::SQRT_2 };
            columns.push(Column { start, place: place(m), steps });
        }
        Rule { squared: self == Self::Mirrored, columns }
    }

    /// The functions below `order` (at most [`super::ORDERS`]) at a unit vector, in the order of [`Basis::indices`].
    pub(in super::super) fn at(self, order: usize, direction: DVec3, values: &mut [f64]) {
        static RULES: LazyLock<[Rule<f64>; 3]> = LazyLock::new(|| {
            [Basis::Sphere, Basis::Mirrored, Basis::Stretched].map(|basis| basis.rule(super::ORDERS))
        });
        let DVec3 { x, y, z } = self.place(direction);
        RULES[self as usize].fill(order, x, y, z, |i, value| values[i] = value);
    }
}

impl Rule<f64> {
    /// The same in single precision.
    pub(super) fn single(&self) -> Rule<f32> {
        let step = |s: &Step<f64>| Step { a: s.a as f32, s: s.s as f32, c: s.c as f32, place: s.place };
        let column = |c: &Column<f64>| Column {
            start: c.start as f32,
            place: c.place,
            steps: c.steps.iter().map(step).collect(),
        };
        Rule { squared: self.squared, columns: self.columns.iter().map(column).collect() }
    }
}

impl<S: Copy> Rule<S> {
    /// One more than the highest degree.
    pub(super) fn order(&self) -> usize {
        self.columns.len()
    }

    /// Gives every function below `order` to `take`, by its index.
    #[inline(always)]
    pub(super) fn fill<T: Number<Scalar = S>>(
        &self,
        order: usize,
        x: T,
        y: T,
        z: T,
        mut take: impl FnMut(usize, T),
    ) {
        let u = if self.squared { z.times(z) } else { z };
        let (mut re, mut im) = (x, y);
        let stride = if self.squared { 2 } else { 1 };
        for (m, column) in self.columns[..order].iter().enumerate() {
            let mut now = T::splat(column.start);
            let mut before = now;
            let steps = &column.steps[..(order - 1 - m) / stride];
            if m == 0 {
                take(column.place.0, now);
                for step in steps {
                    let factor = u.times_plus(T::splat(step.a), T::splat(step.s));
                    (before, now) = (now, now.times_plus(factor, before.times(T::splat(step.c))));
                    take(step.place.0, now);
                }
                continue;
            }
            take(column.place.0, now.times(re));
            take(column.place.1, now.times(im));
            for step in steps {
                let factor = u.times_plus(T::splat(step.a), T::splat(step.s));
                (before, now) = (now, now.times_plus(factor, before.times(T::splat(step.c))));
                take(step.place.0, now.times(re));
                take(step.place.1, now.times(im));
            }
            // (x + iy)^m carries the azimuth and the power of the sine of the zenith.
            (re, im) = (re.times(x).minus(im.times(y)), re.times_plus(y, im.times(x)));
        }
    }
}

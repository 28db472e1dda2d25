//! Eight numbers at once: one of each of eight texels.
//!
//! Plain arrays that the compiler turns into vector registers inside functions that `multiversion` compiles for them.

use super::basis::Number;

/// How many texels go side by side.
pub(super) const LANES: usize = 8;

/// One number of each of eight texels.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[repr(align(32))]
pub(super) struct Lane(pub [f32; LANES]);

impl Lane {
    pub const ZERO: Self = Self([0.0; LANES]);

    #[inline(always)]
    pub fn of(value: impl Fn(usize) -> f32) -> Self {
        Self(std::array::from_fn(value))
    }

    #[inline(always)]
    pub fn plus(self, other: Self) -> Self {
        Self::of(|i| self.0[i] + other.0[i])
    }
}

impl Number for Lane {
    type Scalar = f32;

    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Self::of(|i| self.0[i] * other.0[i])
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        Self::of(|i| self.0[i] - other.0[i])
    }

    #[inline(always)]
    fn times_plus(self, factor: Self, term: Self) -> Self {
        Self::of(|i| self.0[i].mul_add(factor.0[i], term.0[i]))
    }
}

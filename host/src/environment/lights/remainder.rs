//! What lights leave, as spherical harmonics that are nowhere negative.
//!
//! A quadratic on the sphere is nowhere negative exactly where it is `uᵀ M u` with `u = (x, y, z, 1)` and a positive semidefinite M, a
//! linear one where its slope is no larger than its mean: both are convex, so the fit is a convex one (by Nesterov's accelerated projected gradient, 1983).

use glam::DVec3;
use nalgebra::{DMatrix, DVector, Matrix4};

use super::irradiance::Irradiance;
use crate::environment::lattice::evenly;

/// Directions over which the irradiance of a harmonic is summed.
const DIRECTIONS: usize = 8192;
const STEPS: usize = 300;

/// Radiance that changes smoothly with the direction: real spherical harmonics up to order 2, never negative.
#[derive(Debug, Clone, PartialEq)]
pub struct Remainder {
    coefficients: Vec<[f64; 3]>,
}

impl Remainder {
    /// The highest order: beyond it a matte surface sees next to nothing (Ramamoorthi and Hanrahan 2001).
    pub const MOST_ORDER: usize = 2;

    pub(super) fn none() -> Self {
        Self { coefficients: vec![[0.0; 3]] }
    }

    /// Its order.
    pub fn order(&self) -> usize {
        self.coefficients.len().isqrt() - 1
    }

    /// Red, green and blue radiance coefficients of the 1, 4 or 9 real harmonics in Ramamoorthi's order and signs (2001, equation 3):
    /// 1, y, z, x, xy, yz, 3z² - 1, xz, x² - y², each normalised on the sphere, in the world of environments (y up).
    pub fn coefficients(&self) -> &[[f64; 3]] {
        &self.coefficients
    }

    /// Radiance from a direction (unit vector).
    pub fn radiance(&self, direction: DVec3) -> [f64; 3] {
        self.sum(direction, [1.0; 3])
    }

    /// Irradiance on a surface with this unit normal from which nothing is hidden (Ramamoorthi and Hanrahan 2001, equation 7).
    pub fn irradiance(&self, normal: DVec3) -> [f64; 3] {
        use std::f64::consts::PI;
        self.sum(normal, [PI, 2.0 * PI / 3.0, PI / 4.0])
    }

    fn sum(&self, d: DVec3, factors: [f64; 3]) -> [f64; 3] {
        self.coefficients.iter().zip(harmonics(d)).enumerate().fold([0.0; 3], |sum, (i, (own, value))| {
            let value = value * factors[i.isqrt()];
            // Rounding may leave next to nothing below 0 where the bound is met.
            [0, 1, 2].map(|c| sum[c] + own[c] * value)
        })
    }
}

const NORMS: [f64; 5] = [0.282_094_791_8, 0.488_602_511_9, 1.092_548_430_6, 0.315_391_565_3, 0.546_274_215_3];

fn harmonics(DVec3 { x, y, z }: DVec3) -> [f64; 9] {
    let [flat, slope, cross, axis, saddle] = NORMS;
    [
        flat,
        slope * y,
        slope * z,
        slope * x,
        cross * x * y,
        cross * y * z,
        axis * (3.0 * z * z - 1.0),
        cross * x * z,
        saddle * (x * x - y * y),
    ]
}

/// The irradiance of the harmonics where lights are compared, against which a remainder is fitted.
pub(super) struct Fit {
    /// A row for each value of an [`Irradiance`].
    rows: DMatrix<f64>,
    /// The rows of the functions that a fit adds up: for order 0 and 1 of 1, x, y, z, for order 2 of the products of two of x, y, z, 1.
    orders: [(DMatrix<f64>, DMatrix<f64>); 3],
}

impl Fit {
    pub fn new() -> Self {
        let angle = 4.0 * std::f64::consts::PI / DIRECTIONS as f64;
        // Three harmonics at a time, as if they were colours.
        let columns: Vec<Vec<[f64; 3]>> = (0..3)
            .map(|k| {
                let of = |d: DVec3| (d, [0, 1, 2].map(|c| angle * harmonics(d)[3 * k + c]));
                Irradiance::of((0..DIRECTIONS).map(|i| evenly(i, DIRECTIONS)).map(of)).0
            })
            .collect();
        let rows = DMatrix::from_fn(columns[0].len(), 9, |row, i| columns[i / 3][row][i % 3]);
        let orders = [0, 1, 2].map(|order| {
            let rows = &rows * harmonics_of(order);
            let gram = rows.transpose() * &rows;
            (rows, gram)
        });
        Self { rows, orders }
    }

    /// The remainder of at most this order whose irradiance is nearest to `rest`.
    pub fn remainder(&self, rest: &Irradiance, order: usize) -> Remainder {
        let (rows, gram) = &self.orders[order];
        let steepest = gram.symmetric_eigenvalues().max().max(f64::MIN_POSITIVE);
        let made = [0, 1, 2].map(|c| {
            let wanted = DVector::from_iterator(rows.nrows(), rest.0.iter().map(|value| value[c]));
            let right = rows.transpose() * wanted;
            let mut found = DVector::<f64>::zeros(gram.ncols());
            let (mut ahead, mut momentum) = (found.clone(), 1.0f64);
            for _ in 0..STEPS {
                let mut next = &ahead - (gram * &ahead - &right) / steepest;
                allow(&mut next, order);
                let after = 0.5 * (1.0 + (1.0 + 4.0 * momentum * momentum).sqrt());
                let moved = &next - &found;
                ahead = &next + &moved * ((momentum - 1.0) / after);
                let is_still = moved.norm() <= 1e-6 * next.norm();
                (found, momentum) = (next, after);
                if is_still {
                    break;
                }
            }
            harmonics_of(order) * found
        });
        let count = (order + 1) * (order + 1);
        Remainder { coefficients: (0..count).map(|i| [0, 1, 2].map(|c| made[c][i])).collect() }
    }

    pub fn irradiance(&self, remainder: &Remainder) -> Irradiance {
        let of = |row: usize| {
            remainder
                .coefficients
                .iter()
                .enumerate()
                .fold([0.0; 3], |sum, (i, own)| [0, 1, 2].map(|c| sum[c] + self.rows[(row, i)] * own[c]))
        };
        Irradiance((0..self.rows.nrows()).map(of).collect())
    }
}

/// The harmonics (9 rows) of the functions that a fit of an order adds up.
fn harmonics_of(order: usize) -> DMatrix<f64> {
    let [flat, slope, cross, axis, saddle] = NORMS;
    let count = [1, 4, 16][order];
    let mut matrix = DMatrix::zeros(9, count);
    // Where x, y and z stand among the harmonics, and among the products.
    let slopes = [3, 1, 2];
    if order < 2 {
        matrix[(0, 0)] = 1.0 / flat;
        (1..count).for_each(|i| matrix[(slopes[i - 1], i)] = 1.0 / slope);
        return matrix;
    }
    for i in 0..4 {
        for k in 0..4 {
            let at = 4 * i + k;
            match (i.min(k), i.max(k)) {
                (3, 3) => matrix[(0, at)] = 1.0 / flat,
                (a, 3) => matrix[(slopes[a], at)] = 1.0 / slope,
                (a, b) if a == b => {
                    matrix[(0, at)] = 1.0 / (3.0 * flat);
                    matrix[(6, at)] = if a == 2 { 1.0 / 3.0 } else { -1.0 / 6.0 } / axis;
                    matrix[(8, at)] = [0.5, -0.5, 0.0][a] / saddle;
                }
                (a, b) => {
                    matrix[(
                        if (a, b) == (0, 1) {
                            4
                        } else if b == 2 && a == 1 {
                            5
                        } else {
                            7
                        },
                        at,
                    )] = 1.0 / cross
                }
            }
        }
    }
    matrix
}

/// The nearest sum that is nowhere negative.
fn allow(sum: &mut DVector<f64>, order: usize) {
    match order {
        0 => sum[0] = sum[0].max(0.0),
        1 => {
            let slope = sum.rows(1, 3).norm();
            if slope > sum[0] {
                let mean = (0.5 * (sum[0] + slope)).max(0.0);
                let by = mean / slope;
                sum[0] = mean;
                sum.rows_mut(1, 3).scale_mut(by);
            }
        }
        _ => {
            let mut eigen = Matrix4::from_fn(|i, k| sum[4 * i + k]).symmetric_eigen();
            eigen.eigenvalues.iter_mut().for_each(|value| *value = value.max(0.0));
            let matrix = eigen.recompose();
            (0..16).for_each(|at| sum[at] = matrix[(at / 4, at % 4)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadratics_are_told_as_harmonics_and_never_go_below_zero() {
        let d = DVec3::new(0.48, -0.6, 0.64);
        let u = [d.x, d.y, d.z, 1.0];
        let products = harmonics_of(2).transpose() * DVector::from_row_slice(&harmonics(d));
        for i in 0..16 {
            assert!((products[i] - u[i / 4] * u[i % 4]).abs() < 1e-9, "{i}");
        }
        // One small lamp is what harmonics like least.
        let fit = Fit::new();
        let lamp = Irradiance::of([(d, [1.0, 2.0, 0.0])].into_iter());
        let mut before = f64::INFINITY;
        for order in 0..3 {
            let found = fit.remainder(&lamp, order);
            assert_eq!(found.order(), order);
            for direction in (0..5000).map(|i| evenly(i, 5000)) {
                let radiance = found.radiance(direction);
                assert!(radiance.iter().all(|&value| value > -1e-9), "{order} {radiance:?}");
                assert!((radiance[1] - 2.0 * radiance[0]).abs() < 1e-6 && radiance[2] == 0.0);
            }
            let left = lamp.without(&fit.irradiance(&found)).size();
            assert!(left < 0.95 * before, "{order}: {left}");
            before = left;
        }
    }

    #[test]
    fn a_remainder_within_reach_is_found_and_its_irradiance_is_that_of_its_radiance() {
        let radiance = |d: DVec3| (0.9 + 0.5 * d.x - 0.3 * d.y).powi(2);
        let angle = 4.0 * std::f64::consts::PI / 20_000.0;
        let lights = || (0..20_000).map(|i| evenly(i, 20_000)).map(|d| (d, [angle * radiance(d); 3]));
        let found = Fit::new().remainder(&Irradiance::of(lights()), 2);
        for direction in (0..50).map(|i| evenly(i, 50)) {
            let error = found.radiance(direction)[0] - radiance(direction);
            assert!(error.abs() < 3e-3, "{error}");
            let sum: f64 = lights().map(|(d, light)| d.dot(direction).max(0.0) * light[0]).sum();
            assert!((found.irradiance(direction)[1] / sum - 1.0).abs() < 3e-3);
        }
    }
}

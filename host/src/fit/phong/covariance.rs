//! What the views leave uncertain: the covariance of every coefficient, from the Gauss-Newton matrix in which the
//! radiance is eliminated, and what it means for the radiance toward a direction.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

use glam::DVec3;

use super::super::small::{block, cholesky, substitute};
use super::Lobe;
use super::refine::{Place, Search, TERMS, tie, turns};

/// Covariance of shininess, directions and radiance of some lobes, kept in the parts from which any of it follows.
#[derive(Debug, Clone)]
pub(in super::super) struct Covariance {
    lobes: Vec<Lobe>,
    /// Of each lobe's log shininess and two turns, row by row.
    searched: Vec<f64>,
    /// For the sets of terms that are not held at zero: one, or one for each channel.
    sets: Vec<Set>,
    /// Radiance of constant and lobes, and standard deviation of a residual of weight 1, by channel.
    radiance: [[f64; TERMS]; 3],
    error: [f64; 3],
}

#[derive(Debug, Clone)]
struct Set {
    /// Covariance of constant and lobes' radiance by the noise alone, for error 1, row by row.
    linear: Vec<f64>,
    /// How the radiance of each term follows each searched number, term by term.
    absorbed: Vec<f64>,
}

impl Covariance {
    /// At a place of the search, where a residual of weight 1 has this variance; `scale` takes each channel's radiance
    /// to the samples' own unit.
    pub(super) fn new<const L: usize, const N: usize, const R: usize>(
        place: &Place<L, N, R>,
        search: &Search,
        variance: f64,
        scale: [f64; 3],
    ) -> Self {
        let one = place.active[0] == place.active[1] && place.active[1] == place.active[2];
        let radiance = [0, 1, 2].map(|c| place.linear[c].map(|value| value * scale[c]));
        Self {
            lobes: place.lobes.to_vec(),
            searched: searched(place, search, variance),
            sets: place.active[..if one { 1 } else { 3 }].iter().map(|set| Set::new(place, *set)).collect(),
            radiance,
            error: scale.map(|scale| scale * variance.sqrt()),
        }
    }

    /// Predicted standard deviation of the model's radiance toward a direction, by the coefficients alone.
    pub fn sigma(&self, direction: DVec3) -> [f64; 3] {
        let lobes = self.lobes.len();
        let mut value = vec![1.0; 1 + lobes];
        let mut derived = vec![0.0; 3 * lobes];
        for (l, lobe) in self.lobes.iter().enumerate() {
            let cosine = direction.dot(lobe.direction).clamp(0.0, 1.0);
            let b = cosine.powf(lobe.shininess);
            value[1 + l] = b;
            if b > 0.0 {
                derived[3 * l] = lobe.shininess * cosine.ln() * b;
                for (i, turn) in turns(lobe.direction).iter().enumerate() {
                    derived[3 * l + 1 + i] = lobe.shininess * b / cosine * direction.dot(*turn);
                }
            }
        }
        std::array::from_fn(|c| {
            let set = &self.sets[c.min(self.sets.len() - 1)];
            let slope: Vec<f64> = (0..3 * lobes)
                .map(|j| {
                    let absorbed: f64 = value
                        .iter()
                        .enumerate()
                        .map(|(i, value)| set.absorbed[i * 3 * lobes + j] * value)
                        .sum();
                    self.radiance[c][1 + j / 3] * (derived[j] - absorbed)
                })
                .collect();
            let noise = product(&set.linear, &value) * self.error[c] * self.error[c];
            root(noise + product(&self.searched, &slope))
        })
    }

    /// Standard deviations of a lobe's direction along the main axes of its uncertainty (radians, greatest first) and
    /// of the logarithm of its shininess.
    pub fn lobe(&self, l: usize) -> ([f64; 2], f64) {
        let at = |i: usize, j: usize| self.searched[(3 * l + i) * 3 * self.lobes.len() + 3 * l + j];
        let (a, b, c) = (at(1, 1), at(2, 1), at(2, 2));
        let (middle, half) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
        ([root(middle + half), root(middle - half)], root(at(0, 0)))
    }
}

/// Of a variance; what is no number says that nothing is known.
fn root(variance: f64) -> f64 {
    if variance.is_nan() { f64::INFINITY } else { variance.max(0.0).sqrt() }
}

fn product(matrix: &[f64], vector: &[f64]) -> f64 {
    let rows = matrix.chunks_exact(vector.len().max(1)).zip(vector);
    rows.map(|(row, left)| left * row.iter().zip(vector).map(|(a, b)| a * b).sum::<f64>()).sum()
}

/// The inverse of the leading block; where it is singular, of one with as little added as makes it regular, so that
/// what the views cannot tell has a very large variance.
fn inverse<const N: usize>(matrix: &[[f64; N]; N], n: usize) -> [[f64; N]; N] {
    let mut matrix = *matrix;
    let most = (0..n).map(|i| matrix[i][i]).fold(f64::MIN_POSITIVE, f64::max);
    let mut ridge = 1e-9 * most;
    let mut inverse = [[0.0; N]; N];
    for _ in 0..10 {
        if let Some(lower) = cholesky(&matrix, n) {
            for i in 0..n {
                let mut unit = [0.0; N];
                unit[i] = 1.0;
                inverse[i] = substitute(&lower, &unit, n);
            }
            return inverse;
        }
        for i in 0..n {
            matrix[i][i] += ridge;
        }
        ridge *= 10.0;
    }
    // Nothing is known: the matrix holds what is no number.
    for i in 0..n {
        inverse[i] = [0.0; N];
        inverse[i][i] = f64::INFINITY;
    }
    inverse
}

fn searched<const L: usize, const N: usize, const R: usize>(
    place: &Place<L, N, R>,
    search: &Search,
    variance: f64,
) -> Vec<f64> {
    let (mut hessian, mut gradient) = place.reduced();
    if search.shared {
        tie(&mut hessian, &mut gradient);
    }
    let inverse = inverse(&hessian, N);
    // With one shininess for all, the first one's stands for every lobe's.
    let first = |i: usize| if search.shared && i.is_multiple_of(3) { 0 } else { i };
    (0..N).flat_map(|i| (0..N).map(move |j| inverse[first(i)][first(j)] * variance)).collect()
}

impl Set {
    fn new<const L: usize, const N: usize, const R: usize>(place: &Place<L, N, R>, active: u8) -> Self {
        let (small, index, count) = block(&place.gram, 1 + L, active);
        let inverse = inverse(&small, count);
        let mut set = Self { linear: vec![0.0; (1 + L) * (1 + L)], absorbed: vec![0.0; (1 + L) * N] };
        for a in 0..count {
            for b in 0..count {
                set.linear[index[a] * (1 + L) + index[b]] = inverse[a][b];
                for j in 0..N {
                    set.absorbed[index[a] * N + j] += inverse[a][b] * place.gram[index[b]][1 + L + j];
                }
            }
        }
        set
    }
}

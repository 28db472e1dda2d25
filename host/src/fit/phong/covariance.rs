//! What the views leave uncertain: the covariance of every coefficient, from the Gauss-Newton matrix in which the
//! radiance is eliminated, and what it means for the radiance toward a direction.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

use glam::DVec3;

use super::super::small::{block, cholesky, substitute};
use super::Lobe;
use super::refine::{Place, SEARCHED, Search, TERMS, tie};

/// Covariance of shininess, directions and radiance of some lobes, kept in the parts from which any of it follows.
#[derive(Debug, Clone)]
pub(in super::super) struct Covariance {
    lobes: Vec<Lobe>,
    turns: Vec<[DVec3; 2]>,
    /// Of each lobe's log shininess and two turns.
    searched: [[f64; SEARCHED]; SEARCHED],
    channels: [Channel; 3],
}

#[derive(Debug, Clone, Copy, Default)]
struct Channel {
    /// Of constant and lobes, by the noise alone.
    linear: [[f64; TERMS]; TERMS],
    /// How the radiance follows shininess and turns.
    absorbed: [[f64; TERMS]; SEARCHED],
    /// The lobes' radiance.
    radiance: [f64; TERMS],
}

impl Covariance {
    /// At a place of the search, where a residual of weight 1 has this variance; `scale` takes each channel's radiance to the
    /// samples' own unit.
    pub fn new<const L: usize, const R: usize>(
        place: &Place<L, R>,
        search: &Search,
        variance: f64,
        scale: [f64; 3],
    ) -> Self {
        let channels = std::array::from_fn(|c| Channel::new(place, c, variance, scale[c]));
        Self {
            lobes: place.lobes.to_vec(),
            turns: place.turns.to_vec(),
            searched: searched(place, search, variance),
            channels,
        }
    }

    /// Predicted standard deviation of the model's radiance toward a direction, by the coefficients alone.
    pub fn sigma(&self, direction: DVec3) -> [f64; 3] {
        let n = self.lobes.len();
        let (mut value, mut derived) = ([0.0; TERMS], [0.0; SEARCHED]);
        value[0] = 1.0;
        for (l, (lobe, turns)) in self.lobes.iter().zip(&self.turns).enumerate() {
            let cosine = direction.dot(lobe.direction).clamp(0.0, 1.0);
            let b = cosine.powf(lobe.shininess);
            value[1 + l] = b;
            if b > 0.0 {
                derived[3 * l] = lobe.shininess * cosine.ln() * b;
                for (i, turn) in turns.iter().enumerate() {
                    derived[3 * l + 1 + i] = lobe.shininess * b / cosine * direction.dot(*turn);
                }
            }
        }
        self.channels.map(|channel| {
            let mut slope = [0.0; SEARCHED];
            for j in 0..3 * n {
                let absorbed: f64 = (0..=n).map(|i| channel.absorbed[j][i] * value[i]).sum();
                slope[j] = channel.radiance[1 + j / 3] * (derived[j] - absorbed);
            }
            let linear = product(&channel.linear, &value, 1 + n);
            (linear + product(&self.searched, &slope, 3 * n)).max(0.0).sqrt()
        })
    }

    /// Standard deviations of a lobe's direction along the main axes of its uncertainty (radians, greatest first) and of the
    /// logarithm of its shininess.
    pub fn lobe(&self, l: usize) -> ([f64; 2], f64) {
        let at = |i: usize, j: usize| self.searched[3 * l + i][3 * l + j];
        let (a, b, c) = (at(1, 1), at(2, 1), at(2, 2));
        let (middle, half) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
        ([(middle + half).max(0.0).sqrt(), (middle - half).max(0.0).sqrt()], at(0, 0).max(0.0).sqrt())
    }
}

fn product<const N: usize>(matrix: &[[f64; N]; N], vector: &[f64; N], n: usize) -> f64 {
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..n {
            sum += vector[i] * matrix[i][j] * vector[j];
        }
    }
    sum
}

/// The inverse of the leading block; where it is singular, of one with as little added as makes it regular, so that
/// what the views cannot tell has a very large variance.
fn inverse<const N: usize>(matrix: &[[f64; N]; N], n: usize) -> [[f64; N]; N] {
    let mut matrix = *matrix;
    let most = (0..n).map(|i| matrix[i][i]).fold(f64::MIN_POSITIVE, f64::max);
    let mut ridge = 1e-9 * most;
    let mut inverse = [[0.0; N]; N];
    for _ in 0..8 {
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
    inverse
}

fn searched<const L: usize, const R: usize>(
    place: &Place<L, R>,
    search: &Search,
    variance: f64,
) -> [[f64; SEARCHED]; SEARCHED] {
    let (mut hessian, mut gradient) = place.reduced();
    if search.shared {
        tie(&mut hessian, &mut gradient, L);
    }
    let mut covariance = inverse(&hessian, 3 * L);
    if search.shared {
        for other in (3..3 * L).step_by(3) {
            for k in 0..3 * L {
                covariance[other][k] = covariance[0][k];
            }
        }
        for other in (3..3 * L).step_by(3) {
            for k in 0..3 * L {
                covariance[k][other] = covariance[k][0];
            }
        }
    }
    covariance.map(|row| row.map(|value| value * variance))
}

impl Channel {
    fn new<const L: usize, const R: usize>(place: &Place<L, R>, c: usize, variance: f64, scale: f64) -> Self {
        let (small, index, count) = block(&place.gram, 1 + L, place.active[c]);
        let mut channel = Self::default();
        let inverse = inverse(&small, count);
        for a in 0..count {
            for b in 0..count {
                channel.linear[index[a]][index[b]] = inverse[a][b] * variance * scale * scale;
                for j in 0..3 * L {
                    channel.absorbed[j][index[a]] += inverse[a][b] * place.gram[index[b]][1 + L + j];
                }
            }
        }
        channel.radiance = place.linear[c].map(|value| value * scale);
        channel
    }
}

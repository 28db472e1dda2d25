//! How a texel's lobes may be wrong, and what a view from a direction would tell of it.

use glam::Vec3;

use crate::fit::FitFlags;
use crate::render::expose;

/// A lobe in one brightness instead of three colours: radiance, shininess, direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lobe {
    pub radiance: f32,
    pub shininess: f32,
    pub direction: Vec3,
}

/// What all texels share.
pub(super) struct Surroundings<'a> {
    /// Gamma of the brightness 1 - exp(-gamma L).
    pub gamma: f32,
    /// What no model says exactly, as a part of the radiance, and as a radiance.
    pub relative: f32,
    pub floor: f32,
    /// Lobes of texels all over the surface.
    pub pool: &'a [Lobe],
}

/// A texel's fit and where it was seen from.
pub(super) struct Seen<'a> {
    /// Parameters of a model of lobes.
    pub parameters: &'a [f32],
    pub flags: FitFlags,
    /// Root mean square of residual / expected error.
    pub residual: f32,
    pub directions: &'a [Vec3],
}

/// So many lobes of other texels each texel may have without anybody having seen it.
const HIDDEN: usize = 3;
/// And so strong they may be, as a part of the strength elsewhere.
const HIDDEN_PART: f32 = 0.3;
/// So many lobes it may have that nobody has, somewhere: so strong compared with its diffuse radiance, and so sharp.
const ANYWHERE: usize = 3;
const ANYWHERE_PART: f32 = 0.3;
const ANYWHERE_SHININESS: f32 = 60.0;
/// No residual is trusted to be smaller than this part of the expected error, or larger than its inverse.
const LEAST_RESIDUAL: f32 = 0.5;
/// Noise of a brightness that is never less: a level of 8 bits and a half.
const LEAST_NOISE: f32 = 0.006;

/// The ways in which one texel may be wrong, as changes of brightness toward the candidate directions.
///
/// Each coefficient of its lobes is a way (by so much the coefficient may be off before anything is seen), and so are a few lobes
/// that others have and it may hide. A view measures a sum of ways: the covariance follows by conditioning, which for the
/// coefficients is the inverse of the Gauss-Newton matrix (Fedorov, "Theory of optimal experiments", 1972, chapter 2).
pub(super) struct Doubts {
    count: usize,
    /// Candidate after candidate, way after way.
    toward: Vec<f32>,
    /// Variance of a measured brightness, for each candidate.
    noise: Vec<f32>,
    /// Of the ways, row by row.
    covariance: Vec<f64>,
    /// Mean over the candidates of the product of two ways, row by row.
    overlap: Vec<f64>,
}

impl Doubts {
    /// Of texel number `index`, toward `candidates` (unit vectors from this texel).
    pub fn new(index: usize, seen: &Seen, around: &Surroundings, candidates: &[Vec3]) -> Self {
        let lobes = Lobes::of(seen.parameters);
        let others = lobes.otherwise(index, seen.flags.contains(FitFlags::UNIDENTIFIED), around, candidates);
        let count = others.len();
        let residual = seen.residual.clamp(LEAST_RESIDUAL, LEAST_RESIDUAL.recip());
        let toward = |direction: Vec3| {
            let radiance = lobes.radiance(direction);
            let brightness = expose(radiance, around.gamma);
            let ways =
                others.iter().map(move |other| expose(other.radiance(direction), around.gamma) - brightness);
            let slope = around.gamma * (1.0 - brightness);
            let noise = slope * residual * (around.relative * radiance).hypot(around.floor);
            (ways.collect::<Vec<f32>>(), noise.max(LEAST_NOISE).powi(2))
        };
        let mut covariance = vec![0.0; count * count];
        (0..count).for_each(|i| covariance[i * count + i] = 1.0);
        let mut doubts =
            Self { count, toward: vec![], noise: vec![], covariance, overlap: vec![0.0; count * count] };
        for direction in seen.directions.iter().filter(|direction| direction.is_finite()) {
            let (ways, noise) = toward(*direction);
            doubts.condition(&ways, noise);
        }
        for direction in candidates {
            let (ways, noise) = toward(*direction);
            for (i, a) in ways.iter().enumerate() {
                for (j, b) in ways.iter().enumerate() {
                    doubts.overlap[i * count + j] += f64::from(a * b) / candidates.len() as f64;
                }
            }
            doubts.toward.extend(ways);
            doubts.noise.push(noise);
        }
        doubts
    }

    /// The expected squared error of brightness, mean over the candidates.
    pub fn expected(&self) -> f64 {
        self.covariance.iter().zip(&self.overlap).map(|(a, b)| a * b).sum::<f64>().max(0.0)
    }

    /// Adds by how much a view from each candidate would lower [`Doubts::expected`].
    pub fn add_falls(&self, falls: &mut [f64]) {
        let n = self.count;
        let lowered = product(&product(&self.covariance, &self.overlap, n), &self.covariance, n);
        let views = self.toward.chunks_exact(n.max(1)).zip(&self.noise);
        for (fall, (ways, noise)) in falls.iter_mut().zip(views) {
            let (mut lower, mut variance) = (0.0, f64::from(*noise));
            for (i, a) in ways.iter().enumerate() {
                let (mut with_lowered, mut with_covariance) = (0.0, 0.0);
                for (j, b) in ways.iter().enumerate() {
                    with_lowered += lowered[i * n + j] * f64::from(*b);
                    with_covariance += self.covariance[i * n + j] * f64::from(*b);
                }
                lower += f64::from(*a) * with_lowered;
                variance += f64::from(*a) * with_covariance;
            }
            *fall += lower / variance;
        }
    }

    /// As if the view from a candidate had been taken.
    pub fn see(&mut self, candidate: usize) {
        let ways = self.toward[candidate * self.count..][..self.count].to_vec();
        self.condition(&ways, self.noise[candidate]);
    }

    fn condition(&mut self, ways: &[f32], noise: f32) {
        let n = self.count;
        let row = |i: usize| {
            self.covariance[i * n..][..n].iter().zip(ways).map(|(p, a)| p * f64::from(*a)).sum::<f64>()
        };
        let with: Vec<f64> = (0..n).map(row).collect();
        let variance = with.iter().zip(ways).map(|(p, a)| p * f64::from(*a)).sum::<f64>() + f64::from(noise);
        for i in 0..n {
            for j in 0..n {
                self.covariance[i * n + j] -= with[i] * with[j] / variance;
            }
        }
    }
}

/// Of two square matrices, row by row.
fn product(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut out = vec![0.0; n * n];
    for i in 0..n {
        for k in 0..n {
            for j in 0..n {
                out[i * n + j] += a[i * n + k] * b[k * n + j];
            }
        }
    }
    out
}

/// A constant and lobes.
#[derive(Debug, Clone)]
pub(super) struct Lobes {
    diffuse: f32,
    pub lobes: Vec<Lobe>,
}

impl Lobes {
    /// Those with radiance, of a Phong model's parameters; the mean of the three colours.
    pub fn of(parameters: &[f32]) -> Self {
        let mean = |rgb: &[f32]| (rgb[0] + rgb[1] + rgb[2]) / 3.0;
        let lobe = |l: &[f32]| Lobe {
            radiance: mean(l),
            shininess: l[3].max(1.0),
            direction: Vec3::new(l[4], l[5], l[6]).normalize_or(Vec3::Z),
        };
        let lobes = parameters[3..].chunks_exact(7).map(lobe).filter(|lobe| lobe.radiance > 0.0).collect();
        Self { diffuse: mean(parameters), lobes }
    }

    fn radiance(&self, direction: Vec3) -> f32 {
        let lobe =
            |lobe: &Lobe| lobe.radiance * lobe.direction.dot(direction).clamp(0.0, 1.0).powf(lobe.shininess);
        self.diffuse + self.lobes.iter().map(lobe).sum::<f32>()
    }

    /// What else it might be, one change for each.
    fn otherwise(
        &self,
        index: usize,
        undetermined: bool,
        around: &Surroundings,
        directions: &[Vec3],
    ) -> Vec<Self> {
        let mut others = vec![Self { diffuse: 1.5 * self.diffuse + around.floor, ..self.clone() }];
        // Where the views do not tell, twice as much is open.
        let open = if undetermined { 2.0 } else { 1.0 };
        for (l, lobe) in self.lobes.iter().enumerate() {
            let mut change = |changed: Lobe| {
                let mut other = self.clone();
                other.lobes[l] = changed;
                others.push(other);
            };
            change(Lobe { radiance: lobe.radiance * (1.0 + open), ..*lobe });
            change(Lobe { shininess: lobe.shininess * (1.0 + 0.5 * open), ..*lobe });
            // To the side by half its width.
            let turn = open * (0.5 / lobe.shininess).sqrt().min(0.3);
            let (a, b) = lobe.direction.any_orthonormal_pair();
            for side in [a, b] {
                change(Lobe { direction: (lobe.direction + side * turn).normalize(), ..*lobe });
            }
        }
        let mut hide = |lobe: Lobe| {
            let mut other = self.clone();
            other.lobes.push(lobe);
            others.push(other);
        };
        // Spread over the pool and over the directions, other ones for each texel.
        for hidden in (0..HIDDEN).filter(|_| !around.pool.is_empty()) {
            let lobe = around.pool[(index + hidden * around.pool.len() / HIDDEN) % around.pool.len()];
            hide(Lobe { radiance: HIDDEN_PART * lobe.radiance, ..lobe });
        }
        let radiance = ANYWHERE_PART * self.diffuse.max(around.floor);
        for hidden in (0..ANYWHERE).filter(|_| !directions.is_empty()) {
            let direction =
                directions[(index * 101 + hidden * directions.len() / ANYWHERE) % directions.len()];
            hide(Lobe { radiance, shininess: ANYWHERE_SHININESS, direction });
        }
        others
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lobe about `axis`, seen from a few directions that do not meet it.
    fn doubts(axis: Vec3, candidates: &[Vec3]) -> Doubts {
        let parameters = [0.2, 0.2, 0.2, 2.0, 2.0, 2.0, 40.0, axis.x, axis.y, axis.z];
        let directions = [Vec3::Z, Vec3::new(-0.6, 0.0, 0.8), Vec3::new(0.0, 0.6, 0.8)];
        let seen = Seen {
            parameters: &parameters,
            flags: FitFlags::default(),
            residual: 1.0,
            directions: &directions,
        };
        Doubts::new(
            0,
            &seen,
            &Surroundings { gamma: 2.0, relative: 0.03, floor: 0.01, pool: &[] },
            candidates,
        )
    }

    fn candidates() -> Vec<Vec3> {
        let views = crate::sampling::spiral(200, 1.3).unwrap();
        views.into_iter().map(|view| view.as_vec3()).collect()
    }

    #[test]
    fn a_view_lowers_the_expected_error_by_what_was_foretold() {
        let candidates = candidates();
        for candidate in [0, 57, 120, 199] {
            let mut doubts = doubts(Vec3::new(0.6, 0.0, 0.8), &candidates);
            let mut falls = vec![0.0; candidates.len()];
            doubts.add_falls(&mut falls);
            let before = doubts.expected();
            doubts.see(candidate);
            let fall = before - doubts.expected();
            assert!(fall >= 0.0 && (fall - falls[candidate]).abs() <= 1e-9 * before, "{fall} {falls:?}");
        }
    }

    #[test]
    fn the_most_telling_view_lies_on_the_lobe() {
        let (axis, candidates) = (Vec3::new(0.6, 0.0, 0.8), candidates());
        let mut falls = vec![0.0; candidates.len()];
        doubts(axis, &candidates).add_falls(&mut falls);
        let best = (0..falls.len()).max_by(|&a, &b| falls[a].total_cmp(&falls[b])).unwrap();
        // Its flank tells more than its summit, where brightness hardly moves.
        assert!(candidates[best].dot(axis).powf(40.0) > 0.05, "{}", candidates[best]);
    }
}

//! Where a lobe's search starts.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

use glam::DVec3;

use super::super::small::nonnegative;
use super::{Lobe, Problem};

/// The search for a lobe's start among directions and shininesses.
pub(super) struct Ladder<'a> {
    problem: &'a Problem<'a>,
    known: usize,
    /// The known lobes' values at each sample.
    values: Vec<[f64; 2]>,
    /// What they leave, summed over the channels.
    residual: Vec<f64>,
}

/// Neighbours on the ladder differ by a factor 2: squaring climbs it.
const RUNGS: usize = 10;

impl<'a> Ladder<'a> {
    pub(super) fn new(problem: &'a Problem<'a>, lobes: &[Lobe]) -> Self {
        let samples = problem.samples;
        let known = lobes.len();
        let mut values = vec![[0.0; 2]; samples.len()];
        for (value, direction) in values.iter_mut().zip(&samples.directions) {
            for (value, lobe) in value.iter_mut().zip(lobes) {
                *value = direction.dot(lobe.direction).max(0.0).powf(lobe.shininess);
            }
        }
        let mut ladder = Self { problem, known, values, residual: Vec::new() };
        let (gram, right) = ladder.known_moments();
        let found: [[f64; 4]; 3] = std::array::from_fn(|c| nonnegative(&gram, &right[c], 1 + known).0);
        ladder.residual = samples
            .radiance
            .iter()
            .zip(&ladder.values)
            .map(|(radiance, value)| {
                (0..3)
                    .map(|c| radiance[c] - found[c][0] - found[c][1] * value[0] - found[c][2] * value[1])
                    .sum()
            })
            .collect();
        ladder
    }

    fn known_moments(&self) -> ([[f64; 4]; 4], [[f64; 4]; 3]) {
        let (mut gram, mut right) = ([[0.0; 4]; 4], [[0.0; 4]; 3]);
        gram[0][0] = self.problem.weight;
        for c in 0..3 {
            right[c][0] = self.problem.right[c];
        }
        if self.known > 0 {
            let samples = self.problem.samples;
            for ((value, radiance), weight) in self.values.iter().zip(&samples.radiance).zip(&samples.weights)
            {
                for i in 0..self.known {
                    gram[0][1 + i] += weight * value[i];
                    for j in 0..self.known {
                        gram[1 + i][1 + j] += weight * value[i] * value[j];
                    }
                    for c in 0..3 {
                        right[c][1 + i] += weight * value[i] * radiance[c];
                    }
                }
            }
            for i in 0..self.known {
                gram[1 + i][0] = gram[0][1 + i];
            }
        }
        (gram, right)
    }

    /// Directions that may carry the highlight: the brightest residual, its neighbourhood's centre, the centre of all
    /// that is bright, and the brightest far from the first.
    fn directions(&self) -> Vec<DVec3> {
        let samples = self.problem.samples;
        let brightest = |far_from: Option<DVec3>| {
            let eligible = samples.directions.iter().zip(&self.residual);
            eligible
                .filter(|(d, _)| far_from.is_none_or(|other| d.dot(other) < 0.9))
                .max_by(|a, b| a.1.total_cmp(b.1))
                .map(|(d, _)| *d)
        };
        let centre = |around: Option<DVec3>| {
            let sum: DVec3 = samples
                .directions
                .iter()
                .zip(&self.residual)
                .filter(|(d, r)| **r > 0.0 && around.is_none_or(|other| d.dot(other) > 0.95))
                .map(|(d, r)| *d * *r)
                .sum();
            sum.try_normalize()
        };
        let first = brightest(None);
        [first, first.and_then(|d| centre(Some(d))), centre(None), first.and_then(|d| brightest(Some(d)))]
            .into_iter()
            .flatten()
            .map(|d| d.with_z(d.z.max(0.0)).normalize_or(DVec3::Z))
            .collect()
    }

    /// One start for each direction, with the shininess that leaves least; the best first.
    pub(super) fn starts(&self) -> Vec<Lobe> {
        let (gram, right) = self.known_moments();
        let terms = 2 + self.known;
        let mut starts: Vec<(f64, Lobe)> = Vec::new();
        for direction in self.directions() {
            let mut best: Option<(f64, Lobe)> = None;
            for (rung, sums) in self.climb(direction).iter().enumerate() {
                let mut gram = gram;
                for i in 0..=self.known {
                    gram[terms - 1][i] = sums[i];
                    gram[i][terms - 1] = sums[i];
                }
                gram[terms - 1][terms - 1] = sums[3];
                let gain: f64 = (0..3)
                    .map(|c| {
                        let mut right = right[c];
                        right[terms - 1] = sums[4 + c];
                        nonnegative(&gram, &right, terms).2
                    })
                    .sum();
                if best.is_none_or(|best| gain > best.0) {
                    best = Some((
                        gain,
                        Lobe {
                            direction,
                            shininess: f64::from(1 << (rung + 1)).min(self.problem.shininess_max),
                        },
                    ));
                }
            }
            starts.extend(best);
        }
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        starts.into_iter().map(|(_, lobe)| lobe).collect()
    }

    /// For shininess 2, 4, 8 ...: Σ w b, Σ w b b1, Σ w b b2, Σ w b², Σ w b R, G, B.
    fn climb(&self, direction: DVec3) -> [[f64; 7]; RUNGS] {
        let samples = self.problem.samples;
        let mut sums = [[0.0; 7]; RUNGS];
        for i in 0..samples.len() {
            let mut value = samples.directions[i].dot(direction).max(0.0);
            for sums in &mut sums {
                value *= value;
                if value < 1e-6 {
                    break;
                }
                let weighted = samples.weights[i] * value;
                sums[0] += weighted;
                sums[1] += weighted * self.values[i][0];
                sums[2] += weighted * self.values[i][1];
                sums[3] += weighted * value;
                for c in 0..3 {
                    sums[4 + c] += weighted * samples.radiance[i][c];
                }
            }
        }
        sums
    }
}

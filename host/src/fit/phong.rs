//! Lobes by variable projection (Golub and Pereyra 1973, in Kaufman's form): diffuse and specular radiance are the
//! non-negative least-squares solution for given shininess and directions, so only those three numbers of each lobe
//! are searched, by Levenberg-Marquardt.
//!
//! A lobe started at Ks = 0 has no gradient, and one started beside the highlight finds a smaller one: lobes are added
//! one by one, each from the best of several directions and a ladder of shininesses.
#![expect(clippy::needless_range_loop, reason = "indices name rows and columns of small matrices")]

mod start;

use glam::DVec3;

use super::model::SHININESS;
use super::small::{nonnegative, solve};
use super::weights::Samples;

/// Basis values below exp(-CUT) are zero: nothing to see, and most views of a sharp lobe are skipped.
const CUT: f64 = 18.0;
const MOST_STEPS: usize = 60;

#[derive(Debug, Clone, Copy)]
struct Lobe {
    direction: DVec3,
    shininess: f64,
}

/// What a fit found.
pub(super) struct PhongFit {
    /// In the order of `Model::channel_names`.
    pub parameters: Vec<f32>,
    /// A lobe's shininess or direction ended at its bound.
    pub at_bound: bool,
    /// The search ended because nothing got better, not because it ran out of steps.
    pub converged: bool,
}

/// Fits up to `lobes` (1 to 3) lobes, none sharper than `shininess_max`; a lobe that does not earn its six numbers is
/// left without radiance.
pub(super) fn fit(samples: &Samples, lobes: usize, shininess_max: f64) -> PhongFit {
    let problem = Problem::new(samples, shininess_max);
    let mut found = Found::constant(&problem);
    for count in 1..=lobes {
        let more = match count {
            1 => grow::<1, 5>(&problem, &found.lobes),
            2 => grow::<2, 9>(&problem, &found.lobes),
            _ => grow::<3, 13>(&problem, &found.lobes),
        };
        if !problem.earned(&found, &more) {
            break;
        }
        found = more;
    }
    found.finish(lobes, shininess_max)
}

/// Fits again from what `parameters` say, with other weights: lobes neither come nor go.
pub(super) fn refit(samples: &Samples, parameters: &[f32], shininess_max: f64) -> PhongFit {
    let problem = Problem::new(samples, shininess_max);
    let lobes: Vec<_> = parameters[3..]
        .chunks_exact(7)
        .filter(|lobe| lobe[..3].iter().any(|specular| *specular > 0.0))
        .map(|lobe| Lobe {
            direction: DVec3::new(lobe[4].into(), lobe[5].into(), lobe[6].into()).normalize_or(DVec3::Z),
            shininess: lobe[3].into(),
        })
        .collect();
    let found = match *lobes.as_slice() {
        [] => Found::constant(&problem),
        [a] => refine::<1, 5>(&problem, [a]),
        [a, b] => refine::<2, 9>(&problem, [a, b]),
        [a, b, c, ..] => refine::<3, 13>(&problem, [a, b, c]),
    };
    found.finish(parameters.len() / 7, shininess_max)
}

struct Problem<'a> {
    samples: &'a Samples,
    weight: f64,
    right: [f64; 3],
    energy: f64,
    shininess_max: f64,
}

impl<'a> Problem<'a> {
    fn new(samples: &'a Samples, shininess_max: f64) -> Self {
        let (mut weight, mut right, mut energy) = (0.0, [0.0; 3], 0.0);
        for (w, radiance) in samples.weights.iter().zip(&samples.radiance) {
            weight += w;
            for c in 0..3 {
                right[c] += w * radiance[c];
                energy += w * radiance[c] * radiance[c];
            }
        }
        Self { samples, weight, right, energy, shininess_max }
    }

    /// Whether one lobe more lowers the residual by more than its six numbers would by chance (Schwarz's criterion,
    /// 1978): needless lobes make foils no better and cloth worse.
    fn earned(&self, before: &Found, after: &Found) -> bool {
        let count = 3.0 * self.samples.len() as f64;
        // Radiance comes in single precision: what is left below that is rounding.
        let floor = 1e-12 * self.energy;
        before.linear.squares > floor
            && count * (before.linear.squares / after.linear.squares.max(floor)).ln() > 6.0 * count.ln()
    }
}

/// Weighted inner products of the columns 1, each lobe, and each lobe's derivatives by log shininess and by a turn
/// about two axes (`C` = 1 + 4 `L` columns), with each other and with the three channels.
struct Moments<const C: usize> {
    gram: [[f64; C]; C],
    right: [[f64; 3]; C],
}

fn moments<const L: usize, const C: usize>(problem: &Problem, lobes: &[Lobe; L]) -> Moments<C> {
    let mut sums = Moments { gram: [[0.0; C]; C], right: [[0.0; 3]; C] };
    let axes = lobes.map(|lobe| lobe.direction.any_orthonormal_pair());
    let cosine_cut = lobes.map(|lobe| (-CUT / lobe.shininess).exp());
    let samples = problem.samples;
    for ((direction, radiance), weight) in
        samples.directions.iter().zip(&samples.radiance).zip(&samples.weights)
    {
        let mut column = [0.0; C];
        let mut any = false;
        for l in 0..L {
            let cosine = direction.dot(lobes[l].direction);
            if cosine > cosine_cut[l] {
                any = true;
                let log = cosine.min(1.0).ln();
                let value = (lobes[l].shininess * log).exp();
                let turn = lobes[l].shininess * value / cosine;
                column[1 + l] = value;
                column[1 + L + 3 * l] = lobes[l].shininess * log * value;
                column[2 + L + 3 * l] = turn * direction.dot(axes[l].0);
                column[3 + L + 3 * l] = turn * direction.dot(axes[l].1);
            }
        }
        if !any {
            continue;
        }
        column[0] = 1.0;
        for i in 0..C {
            let weighted = weight * column[i];
            for j in i..C {
                sums.gram[i][j] += weighted * column[j];
            }
            for c in 0..3 {
                sums.right[i][c] += weighted * radiance[c];
            }
        }
    }
    // The constant column also meets the views that no lobe reaches.
    sums.gram[0][0] = problem.weight;
    sums.right[0] = problem.right;
    for i in 0..C {
        for j in 0..i {
            sums.gram[i][j] = sums.gram[j][i];
        }
    }
    sums
}

/// Diffuse and specular radiance of each channel, and the weighted sum of squared residuals that they leave.
struct Linear {
    values: [[f64; 4]; 3],
    active: [u8; 3],
    squares: f64,
}

fn linear<const C: usize>(problem: &Problem, moments: &Moments<C>, terms: usize) -> Linear {
    let mut gram = [[0.0; 4]; 4];
    for i in 0..terms {
        gram[i][..terms].copy_from_slice(&moments.gram[i][..terms]);
    }
    let mut found = Linear { values: [[0.0; 4]; 3], active: [0; 3], squares: problem.energy };
    for c in 0..3 {
        let mut right = [0.0; 4];
        for i in 0..terms {
            right[i] = moments.right[i][c];
        }
        let (values, active, gain) = nonnegative(&gram, &right, terms);
        found.values[c] = values;
        found.active[c] = active;
        found.squares -= gain;
    }
    found
}

struct Found {
    lobes: Vec<Lobe>,
    linear: Linear,
    converged: bool,
}

fn refine<const L: usize, const C: usize>(problem: &Problem, start: [Lobe; L]) -> Found {
    let mut lobes = start;
    let mut current = moments::<L, C>(problem, &lobes);
    let mut found = linear(problem, &current, 1 + L);
    let mut damping = 1e-3;
    let mut converged = false;
    for _ in 0..MOST_STEPS {
        let (hessian, gradient) = search_direction::<L, C>(&current, &found);
        // Rounding hides any further progress.
        if found.squares <= 1e-14 * problem.energy {
            converged = true;
            break;
        }
        let mut damped = hessian;
        for (i, row) in damped.iter_mut().enumerate().take(3 * L) {
            row[i] += damping * row[i] + 1e-12 * problem.energy;
        }
        let Some(step) = solve(&damped, &gradient, 3 * L) else {
            damping *= 10.0;
            continue;
        };
        let moved = apply(&lobes, &step, problem.shininess_max);
        let trial = moments::<L, C>(problem, &moved);
        let trial_found = linear(problem, &trial, 1 + L);
        let gain = found.squares - trial_found.squares;
        if gain > 0.0 {
            let small = gain < 1e-5 * found.squares;
            (lobes, current, found) = (moved, trial, trial_found);
            damping = (damping * 0.1).max(1e-9);
            if small {
                converged = true;
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e6 {
                converged = true;
                break;
            }
        }
    }
    Found { lobes: lobes.into(), linear: found, converged }
}

/// Gauss-Newton matrix and negative gradient of the reduced problem, per lobe: log shininess and two turns.
fn search_direction<const L: usize, const C: usize>(
    moments: &Moments<C>,
    linear: &Linear,
) -> ([[f64; 9]; 9], [f64; 9]) {
    let (mut hessian, mut gradient) = ([[0.0; 9]; 9], [0.0; 9]);
    let gram = &moments.gram;
    for c in 0..3 {
        let active = linear.active[c];
        // The part of each derivative that the linear terms cannot absorb.
        let mut absorbed = [[0.0; 4]; 9];
        for j in 0..3 * L {
            let (mut small, mut right, mut count) = ([[0.0; 4]; 4], [0.0; 4], 0);
            let mut index = [0; 4];
            for i in (0..=L).filter(|i| active & (1 << i) != 0) {
                index[count] = i;
                count += 1;
            }
            for a in 0..count {
                right[a] = gram[index[a]][1 + L + j];
                for b in 0..count {
                    small[a][b] = gram[index[a]][index[b]];
                }
            }
            if let Some(solution) = solve(&small, &right, count) {
                for a in 0..count {
                    absorbed[j][index[a]] = solution[a];
                }
            }
        }
        for j in 0..3 * L {
            let column = 1 + L + j;
            let scale = linear.values[c][1 + j / 3];
            let mut residual = moments.right[column][c];
            for i in 0..=L {
                residual -= gram[column][i] * linear.values[c][i];
            }
            gradient[j] += scale * residual;
            for k in j..3 * L {
                let mut product = gram[column][1 + L + k];
                for i in 0..=L {
                    product -= absorbed[j][i] * gram[i][1 + L + k];
                }
                hessian[j][k] += scale * linear.values[c][1 + k / 3] * product;
            }
        }
    }
    for j in 0..9 {
        for k in 0..j {
            hessian[j][k] = hessian[k][j];
        }
    }
    (hessian, gradient)
}

fn apply<const L: usize>(lobes: &[Lobe; L], step: &[f64; 9], shininess_max: f64) -> [Lobe; L] {
    std::array::from_fn(|l| {
        let (first, second) = lobes[l].direction.any_orthonormal_pair();
        let step = &step[3 * l..3 * l + 3];
        // Far steps leave the region where the derivative means anything.
        let limit = 0.5 / (step[1].hypot(step[2])).max(0.5);
        let turned = lobes[l].direction + (first * step[1] + second * step[2]) * limit;
        // A flat surface reflects light from above to above.
        let mut direction = turned.with_z(turned.z.max(0.0)).normalize_or(DVec3::Z);
        if direction.z <= 0.0 {
            direction.z = 0.0;
        }
        let shininess =
            (lobes[l].shininess * step[0].clamp(-1.0, 1.0).exp()).clamp(*SHININESS.start(), shininess_max);
        Lobe { direction, shininess }
    })
}

/// Adds a lobe to those found before it and refines them together.
fn grow<const L: usize, const C: usize>(problem: &Problem, before: &[Lobe]) -> Found {
    let ladder = start::Ladder::new(problem, before);
    // A second lobe hides in what the first one left: there one start is too few.
    let starts = ladder.starts().into_iter().take(if before.is_empty() { 1 } else { 2 });
    let found = starts.map(|start| {
        let mut lobes = [start; L];
        lobes[..before.len()].copy_from_slice(before);
        refine::<L, C>(problem, lobes)
    });
    found
        .min_by(|a, b| a.linear.squares.total_cmp(&b.linear.squares))
        .unwrap_or_else(|| Found::constant(problem))
}

impl Found {
    fn constant(problem: &Problem) -> Self {
        let mut linear = Linear { values: [[0.0; 4]; 3], active: [1; 3], squares: problem.energy };
        for c in 0..3 {
            linear.values[c][0] = (problem.right[c] / problem.weight).max(0.0);
            linear.squares -= linear.values[c][0] * problem.right[c];
        }
        Self { lobes: Vec::new(), linear, converged: true }
    }

    /// The strongest lobe first, and lobes without radiance up to `lobes`.
    fn finish(self, lobes: usize, shininess_max: f64) -> PhongFit {
        let strength = |l: usize| -> f64 { self.linear.values.iter().map(|v| v[1 + l]).sum() };
        let mut order: Vec<usize> = (0..self.lobes.len()).filter(|l| strength(*l) > 0.0).collect();
        order.sort_by(|a, b| strength(*b).total_cmp(&strength(*a)));
        let mut at_bound = false;
        let mut parameters: Vec<f32> = self.linear.values.iter().map(|v| v[0] as f32).collect();
        for l in order {
            let Lobe { direction, shininess } = self.lobes[l];
            at_bound |= shininess <= *SHININESS.start() || shininess >= shininess_max || direction.z <= 0.0;
            parameters.extend(self.linear.values.iter().map(|v| v[1 + l] as f32));
            parameters.push(shininess as f32);
            parameters.extend(direction.as_vec3().to_array());
        }
        while parameters.len() < 3 + 7 * lobes {
            parameters.extend([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        }
        PhongFit { parameters, at_bound, converged: self.converged }
    }
}

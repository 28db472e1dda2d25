//! All orientations at once: what the pictures say and what was known before, with the lens's focal length and distortion.

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix3x2, Vector3};
use rayon::prelude::*;

use super::features::{Corners, Gray, aligned, matches};
use super::tracked::Pair;
use crate::Result;
use crate::geometry::Lens;
use crate::progress::Progress;

/// So many corners must agree on one rotation for two photographs to count as matched.
const FEWEST: usize = 8;
/// No pair counts with more corners than this.
const MOST: usize = 80;
/// Corners agree on a rotation that are so close, radians; cameras in hands do not turn about one point.
const AGREE_RAD: f64 = 0.004;
/// The same, pixels: a corner's place is not known better.
const AGREE_PX: f64 = 1.5;

/// Photographs that nothing links are looked for so far from where they should be, standard deviation about each axis, radians, and known so well then.
const RESCUE_RAD: f64 = 0.09;
const RESCUED_RAD: f64 = 0.01;

const ROUNDS: usize = 18;

/// What is known before.
#[derive(Clone, Copy)]
pub(super) struct Prior {
    pub turn: DQuat,
    pub sigma_rad: f64,
}

/// How the photographs were turned, and how sure that is.
pub(super) struct Aligned {
    pub turns: Vec<DQuat>,
    /// Per photograph, about each axis, radians.
    pub sigma_rad: Vec<f64>,
    /// Per photograph, how many corners matched.
    pub matched: Vec<usize>,
    pub lens: Lens,
    /// Of the focal length, relative; 0 where it was not asked.
    pub focal_sigma: f64,
    /// Median distance of matched corners, radians; 0 where there are none.
    pub residual_rad: f64,
    /// Whether matches link a photograph with most others that they link.
    pub is_linked: Vec<bool>,
}

/// Tells what is known beforehand anew, with what the photographs told of each other: a tracker's delay, for one.
pub(super) type Refit<'a> = Option<&'a mut dyn FnMut(&Aligned) -> Vec<Prior>>;

struct Match {
    frames: [usize; 2],
    /// Pixels of the gray pictures.
    at: [DVec2; 2],
}

/// Refines orientations and, within `focal_sigma` (relative) and `k1_sigma`, the lens.
pub(super) fn align(
    mut grays: Vec<Gray>,
    corners: &[Corners],
    mut priors: Vec<Prior>,
    (focal_sigma, k1_sigma): (f64, f64),
    mut refit: Refit,
    progress: &dyn Progress,
) -> Result<Aligned> {
    let mut state = Aligned {
        turns: priors.iter().map(|prior| prior.turn).collect(),
        sigma_rad: priors.iter().map(|prior| prior.sigma_rad).collect(),
        matched: vec![0; priors.len()],
        lens: grays[0].lens,
        focal_sigma: 0.0,
        residual_rad: 0.0,
        is_linked: vec![false; priors.len()],
    };
    let start = state.lens;
    // The second search knows better where to look.
    for search in 0..2 {
        let lens = state.lens;
        grays.iter_mut().for_each(|gray| gray.lens = lens);
        let half = DVec2::new(f64::from(lens.width), f64::from(lens.height)) / 2.0;
        let radius = (half.x / lens.fx).hypot(half.y / lens.fy).atan();
        let pairs: Vec<(usize, usize)> = (0..priors.len())
            .flat_map(|i| (i + 1..priors.len()).map(move |j| (i, j)))
            .filter(|&(i, j)| {
                (state.turns[i] * DVec3::Z).angle_between(state.turns[j] * DVec3::Z) < 2.0 * radius
            })
            .collect();
        let total = pairs.len();
        let done = std::sync::atomic::AtomicUsize::new(0);
        let found: Vec<Vec<Match>> = pairs
            .par_iter()
            .map(|&(i, j)| {
                let doubt = state.sigma_rad[i].hypot(state.sigma_rad[j]);
                let reach = (3.0 * doubt).max(8.0 / lens.fx);
                let turn = state.turns[i].inverse() * state.turns[j];
                let pairs = matches((&grays[i], &corners[i]), (&grays[j], &corners[j]), turn, reach);
                let pairs: Vec<[DVec2; 2]> =
                    pairs.iter().map(|&(a, b)| [corners[i].at[a], corners[j].at[b]]).collect();
                let kept = agreeing(&lens, &pairs, turn, 3.5 * doubt + AGREE_RAD);
                let step = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
                progress.step(search * total + step, 2 * total)?;
                // From all over the picture, as corners are counted cell by cell.
                let most = kept.len().min(MOST);
                let kept = (0..most).map(|k| kept[k * kept.len() / most]);
                let exact = |[a, b]: [DVec2; 2]| {
                    // Only from the second search on are the orientations good enough for it.
                    if search == 0 { [a, b] } else { [aligned((&grays[i], a), (&grays[j], b), turn), b] }
                };
                Ok(kept.map(|k| Match { frames: [i, j], at: exact(pairs[k]) }).collect())
            })
            .collect::<Result<_>>()?;
        let all: Vec<Match> = found.into_iter().flatten().collect();
        adjust(&mut state, &priors, &all, &start, (focal_sigma, k1_sigma));
        state.matched.fill(0);
        all.iter().flat_map(|m| m.frames).for_each(|frame| state.matched[frame] += 1);
        state.is_linked = linked(priors.len(), &all);
        if let Some(refit) = &mut refit {
            priors = refit(&state);
            if state.is_linked.iter().all(|linked| *linked) {
                continue;
            }
            for (i, prior) in priors.iter().enumerate().filter(|(i, _)| !state.is_linked[*i]) {
                state.turns[i] = prior.turn;
                state.sigma_rad[i] = prior.sigma_rad;
            }
            if search == 0 {
                rescue(&mut state, &grays, corners);
            } else {
                adjust(&mut state, &priors, &all, &start, (focal_sigma, k1_sigma));
            }
        }
    }
    Ok(state)
}

/// Looks farther around for photographs that nothing links, beside those that were taken just before and after: a tracker near metal is far off.
fn rescue(state: &mut Aligned, grays: &[Gray], corners: &[Corners]) {
    let mut is_found = state.is_linked.clone();
    let count = grays.len();
    // Onwards and back, so that one that was found leads to the next.
    for i in (0..count).chain((0..count).rev()) {
        if is_found[i] {
            continue;
        }
        let beside = [i.checked_sub(1), Some(i + 1), i.checked_sub(2), Some(i + 2)];
        let beside = beside.into_iter().flatten().filter(|&j| j < count && is_found[j]);
        let found = beside.into_iter().find_map(|j| {
            let expected = (state.turns[j].inverse() * state.turns[i], RESCUE_RAD);
            between([&grays[j], &grays[i]], [&corners[j], &corners[i]], [j, i], expected)
        });
        if let Some(pair) = found {
            state.turns[i] = (state.turns[pair.photographs[0]] * pair.turn).normalize();
            state.sigma_rad[i] = RESCUED_RAD;
            is_found[i] = true;
        }
    }
}

/// The turn between two photographs by their corners, where it is `expected` to within `doubt` (standard deviation, radians).
pub(super) fn between(
    grays: [&Gray; 2],
    corners: [&Corners; 2],
    photographs: [usize; 2],
    (expected, doubt): (DQuat, f64),
) -> Option<Pair> {
    let lens = grays[0].lens;
    let reach = (3.0 * doubt).max(8.0 / lens.fx);
    let found = matches((grays[0], corners[0]), (grays[1], corners[1]), expected, reach);
    let found: Vec<[DVec2; 2]> = found.iter().map(|&(a, b)| [corners[0].at[a], corners[1].at[b]]).collect();
    let kept = agreeing(&lens, &found, expected, 3.5 * doubt + AGREE_RAD);
    let seen: Vec<[DVec3; 2]> = kept
        .iter()
        .filter_map(|&i| Some([lens.unproject(found[i][0])?, lens.unproject(found[i][1])?]))
        .collect();
    if seen.len() < FEWEST {
        return None;
    }
    let mut turn = expected;
    let mut squares = 0.0;
    let mut inverse = Matrix3::identity();
    for _ in 0..6 {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        squares = 0.0;
        for [first, second] in &seen {
            let off = *first - turn * *second;
            squares += off.length_squared();
            let by = by_turn(turn, *second);
            normal += by.transpose() * by;
            right += by.transpose() * Vector3::new(off.x, off.y, off.z);
        }
        inverse = normal.try_inverse()?;
        let step = inverse * right;
        turn = (turn * DQuat::from_scaled_axis(DVec3::new(step.x, step.y, step.z))).normalize();
    }
    // Each corner has two angles; cameras in hands add what corners agree on.
    let corner = squares / (2.0 * seen.len() as f64 - 3.0).max(1.0);
    let sigma_rad = (inverse.trace() / 3.0 * corner).sqrt().hypot(AGREE_RAD / 8.0);
    Some(Pair { photographs, turn, sigma_rad })
}

/// Of the groups of photographs that matches link, the largest.
fn linked(count: usize, all: &[Match]) -> Vec<bool> {
    let mut group: Vec<usize> = (0..count).collect();
    fn root(group: &mut [usize], mut i: usize) -> usize {
        while group[i] != i {
            group[i] = group[group[i]];
            i = group[i];
        }
        i
    }
    for m in all {
        let [a, b] = m.frames.map(|frame| root(&mut group, frame));
        group[a] = b;
    }
    let roots: Vec<usize> = (0..count).map(|i| root(&mut group, i)).collect();
    let mut members = vec![0; count];
    roots.iter().for_each(|&root| members[root] += 1);
    let largest = (0..count).max_by_key(|&i| (members[i], count - i)).unwrap_or_default();
    roots.iter().map(|&root| root == largest && members[root] > 1).collect()
}

/// The matches that agree on one rotation, if enough do: the best of the rotations by two matches.
fn agreeing(lens: &Lens, pairs: &[[DVec2; 2]], expected: DQuat, most_rad: f64) -> Vec<usize> {
    let directions: Vec<Option<[DVec3; 2]>> =
        pairs.iter().map(|&[a, b]| Some([lens.unproject(a)?, lens.unproject(b)?])).collect();
    let usable: Vec<usize> = (0..pairs.len()).filter(|&i| directions[i].is_some()).collect();
    if usable.len() < FEWEST {
        return vec![];
    }
    let close = AGREE_RAD.max(AGREE_PX / lens.fx);
    let of = |i: usize| directions[usable[i % usable.len()]].unwrap_or_default();
    let frame = |a: DVec3, b: DVec3| {
        let normal = a.cross(b).normalize_or_zero();
        glam::DMat3::from_cols(a, normal, a.cross(normal))
    };
    let mut best: Vec<usize> = vec![];
    let mut state = 1u64;
    let mut random = || {
        // Knuth's generator; the same matches give the same answer.
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize
    };
    for _ in 0..300 {
        let (one, other) = (of(random()), of(random()));
        if one[0].angle_between(other[0]) < 0.05 || one[1].angle_between(other[1]) < 0.05 {
            continue;
        }
        let turn = frame(one[0], other[0]) * frame(one[1], other[1]).transpose();
        if DQuat::from_mat3(&turn).normalize().angle_between(expected) > most_rad {
            continue;
        }
        let agree: Vec<usize> = usable
            .iter()
            .copied()
            .filter(|&i| directions[i].is_some_and(|[a, b]| a.distance(turn * b) < close))
            .collect();
        if agree.len() > best.len() {
            best = agree;
        }
    }
    if best.len() < FEWEST.max(pairs.len() / 4) { vec![] } else { best }
}

/// Gauss-Newton on all orientations, the focal length and k1, with Cauchy's weights.
fn adjust(
    state: &mut Aligned,
    priors: &[Prior],
    all: &[Match],
    start: &Lens,
    (focal_sigma, k1_sigma): (f64, f64),
) {
    let unknowns = 3 * priors.len() + 2;
    let lens_at = 3 * priors.len();
    // Matches of two photographs agree among themselves; at first they may all be as far off as the orientations are.
    let mut scale = 3.0 * state.sigma_rad.iter().fold(AGREE_RAD, |most, sigma| most.max(*sigma));
    for round in 0..ROUNDS {
        let lens = state.lens;
        let seen: Vec<Option<[DVec3; 2]>> =
            all.par_iter().map(|m| Some([lens.unproject(m.at[0])?, lens.unproject(m.at[1])?])).collect();
        let mut normal = DMatrix::<f64>::zeros(unknowns, unknowns);
        let mut right = DVector::<f64>::zeros(unknowns);
        let mut distances = vec![];
        for (m, seen) in all.iter().zip(&seen) {
            let Some(seen) = seen else { continue };
            let [i, j] = m.frames;
            let error = state.turns[i] * seen[0] - state.turns[j] * seen[1];
            let distance = error.length();
            distances.push(distance);
            let weight = 1.0 / (scale * scale + distance * distance);
            let blocks = [by_turn(state.turns[i], seen[0]), -by_turn(state.turns[j], seen[1])];
            let by_lens = by_lens(state.turns[i], seen[0]) - by_lens(state.turns[j], seen[1]);
            let error = Vector3::new(error.x, error.y, error.z);
            for (a, frame) in m.frames.into_iter().enumerate() {
                let weighed = blocks[a].transpose() * weight;
                for (b, other) in m.frames.into_iter().enumerate() {
                    let mut view = normal.fixed_view_mut::<3, 3>(3 * frame, 3 * other);
                    view += weighed * blocks[b];
                }
                let cross = weighed * by_lens;
                let mut view = normal.fixed_view_mut::<3, 2>(3 * frame, lens_at);
                view += cross;
                let mut view = normal.fixed_view_mut::<2, 3>(lens_at, 3 * frame);
                view += cross.transpose();
                let mut view = right.fixed_rows_mut::<3>(3 * frame);
                view -= weighed * error;
            }
            let weighed = by_lens.transpose() * weight;
            let mut view = normal.fixed_view_mut::<2, 2>(lens_at, lens_at);
            view += weighed * by_lens;
            let mut view = right.fixed_rows_mut::<2>(lens_at);
            view -= weighed * error;
        }
        for (i, prior) in priors.iter().enumerate() {
            let away = (prior.turn.inverse() * state.turns[i]).to_scaled_axis();
            let weight = prior.sigma_rad.powi(-2);
            for c in 0..3 {
                normal[(3 * i + c, 3 * i + c)] += weight;
                right[3 * i + c] -= weight * away[c];
            }
        }
        for (k, (away, sigma)) in
            [((lens.fx / start.fx).ln(), focal_sigma), (lens.k1 - start.k1, k1_sigma)].into_iter().enumerate()
        {
            normal[(lens_at + k, lens_at + k)] += sigma.powi(-2);
            right[lens_at + k] -= away / (sigma * sigma);
        }
        let Some(cholesky) = normal.cholesky() else { return };
        let step = cholesky.solve(&right);
        for (i, turn) in state.turns.iter_mut().enumerate() {
            *turn = (*turn
                * DQuat::from_scaled_axis(DVec3::new(step[3 * i], step[3 * i + 1], step[3 * i + 2])))
            .normalize();
        }
        let grown = step[lens_at].clamp(-0.1, 0.1).exp();
        state.lens.fx *= grown;
        state.lens.fy *= grown;
        state.lens.k1 += step[lens_at + 1].clamp(-0.05, 0.05);
        distances.sort_by(f64::total_cmp);
        state.residual_rad = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
        // Weights are 1 / (s² + d²): about the variance of one corner in a plane.
        scale = state.residual_rad.max(0.2 / lens.fx).max(0.6 * scale);
        if round + 1 == ROUNDS {
            let covariance = cholesky.inverse();
            state.focal_sigma = covariance[(lens_at, lens_at)].sqrt();
            for (i, sigma) in state.sigma_rad.iter_mut().enumerate() {
                let sum: f64 = (0..3).map(|c| covariance[(3 * i + c, 3 * i + c)]).sum();
                *sigma = (sum / 3.0).sqrt();
            }
        }
    }
}

/// How a direction in the world changes with a small turn of the camera (in the camera frame).
fn by_turn(turn: DQuat, d: DVec3) -> Matrix3<f64> {
    let columns = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| turn * axis.cross(d));
    Matrix3::from_fn(|row, column| columns[column][row])
}

/// How it changes with the logarithm of the focal length, and with k1.
fn by_lens(turn: DQuat, d: DVec3) -> Matrix3x2<f64> {
    let at = DVec2::new(d.x, d.y) / d.z;
    let outward = |by: DVec2| {
        let moved = DVec3::new(by.x, by.y, 0.0) * d.z;
        turn * (moved - d * moved.dot(d))
    };
    let columns = [outward(-at), outward(-at * at.length_squared())];
    Matrix3x2::from_fn(|row, column| columns[column][row])
}

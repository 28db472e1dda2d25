//! Where a lobe's search starts.

use glam::{DVec3, Vec3};

use super::super::small::{cholesky, substitute};
use super::Lobe;
use super::lanes;
use super::refine::{TERMS, lane_lobe, leave, turns};
use super::views::Views;

/// Neighbours on the ladder of shininess differ by a factor 2: squaring climbs it.
const RUNGS: usize = 10;

/// Where one more lobe may be, beside those found before it: one start for each direction that may carry it, with the
/// shininess that leaves least; the best first. `R` is 4 and the number of known lobes, `S` one more.
pub(super) fn starts<const R: usize, const S: usize>(
    views: &mut Views,
    known: &[Lobe],
    linear: &[[f64; TERMS]; 3],
    shininess_max: f64,
) -> Vec<Lobe> {
    leave(views, known, linear);
    let directions = directions(views);
    let Views { blocks, rows, left, values, .. } = views;
    rows.resize((R * blocks.len()).max(rows.len()), [0.0; lanes::WIDTH]);
    let rows = &mut rows.as_chunks_mut::<R>().0[..blocks.len()];
    for (l, lobe) in known.iter().enumerate() {
        lanes::values(blocks, &lane_lobe(lobe, &turns(lobe.direction)), rows, 1 + l);
    }
    for ((row, block), left) in rows.iter_mut().zip(blocks.iter()).zip(left.iter()) {
        row[0] = block.root_weight;
        row[R - 3..].copy_from_slice(left);
    }
    let rows = &*rows;
    let mut products = [[0.0; R]; R];
    lanes::products(rows, &mut products);
    let mut terms = [[0.0; R]; R];
    for i in 0..R - 3 {
        for j in 0..=i {
            terms[i][j] = products[j][i];
        }
    }
    // Terms that depend on each other absorb what the constant does.
    let (lower, count) = match cholesky(&terms, R - 3) {
        Some(lower) => (Some(lower), R - 3),
        None => (cholesky(&terms, 1), 1),
    };
    let mut starts: Vec<(f64, Lobe)> = Vec::new();
    for direction in directions {
        lanes::squared_cosine(blocks, direction.to_array(), values);
        let mut gains = [0.0; RUNGS];
        let mut best = 0;
        for rung in 0..RUNGS {
            let sums: [f64; S] = lanes::rung::<R, S>(values, rows, R);
            let mut left = sums[R];
            if let Some(lower) = &lower {
                let mut cross = [0.0; R];
                cross[..count].copy_from_slice(&sums[..count]);
                let absorbed = substitute(lower, &cross, count);
                for i in 0..count {
                    left -= absorbed[i] * cross[i];
                }
            }
            let squares: f64 = sums[R - 3..R].iter().map(|sum| sum.max(0.0).powi(2)).sum();
            // A lobe that no view meets, or that the others say as well, gains nothing.
            gains[rung] = if left > 1e-6 * sums[R] { squares / left } else { 0.0 };
            if gains[rung] > gains[best] {
                best = rung;
            } else if gains[rung] < 0.8 * gains[best] && rung > best + 1 {
                break;
            }
        }
        let shininess = (best as f64 + 1.0 + summit(&gains, best)).exp2();
        let lobe = Lobe { direction: direction.as_dvec3(), shininess: shininess.min(shininess_max) };
        starts.push((gains[best], lobe));
    }
    starts.sort_by(|a, b| b.0.total_cmp(&a.0));
    starts.into_iter().map(|(_, lobe)| lobe).collect()
}

/// Where between the rungs the parabola through the best and its neighbours has its summit.
fn summit(gains: &[f64; RUNGS], best: usize) -> f64 {
    if best == 0 || best + 1 == RUNGS {
        return 0.0;
    }
    let (before, at, after) = (gains[best - 1], gains[best], gains[best + 1]);
    let curvature = before - 2.0 * at + after;
    if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
}

/// Directions that may carry the highlight: the brightest residual, its neighbourhood's centre, the centre of all
/// that is bright, and the brightest far from the first: which may be glare.
fn directions(views: &mut Views) -> Vec<Vec3> {
    let Views { blocks, left, values, .. } = views;
    values.resize(blocks.len(), [0.0; lanes::WIDTH]);
    lanes::brightness(blocks, left, values);
    let centre = |around: [f32; 3], cosine: f32| {
        DVec3::from(lanes::centre(blocks, values, around, cosine)).try_normalize().map(|d| d.as_vec3())
    };
    let first = lanes::brightest(blocks, values, [0.0; 3], 1.0).unwrap_or([0.0, 0.0, 1.0]);
    let second = lanes::brightest(blocks, values, first, 0.9);
    [centre(first, 0.95).or(Some(first.into())), centre([0.0; 3], -1.0), second.map(Vec3::from)]
        .into_iter()
        .flatten()
        .map(|d: Vec3| d.with_z(d.z.max(0.0)).normalize_or(Vec3::Z))
        .collect()
}

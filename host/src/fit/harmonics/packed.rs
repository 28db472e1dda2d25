//! Observations of eight texels laid side by side, weighed, and the directions that they take for theirs.
#![expect(clippy::needless_range_loop, reason = "indices name lanes and channels")]

use glam::DVec3;
use multiversion::multiversion;

use super::basis::{Basis, Rule};
use super::kernel::Rgb;
use super::lanes::{LANES, Lane};
use super::smooth::Weighing;
use crate::observation::TexelObservations;

/// What the views saw of eight texels, view after view. A texel that a view did not measure has weight 0.
pub(super) struct Packed {
    pub x: Vec<Lane>,
    pub y: Vec<Lane>,
    pub z: Vec<Lane>,
    pub weight: Vec<Lane>,
    pub radiance: Vec<Rgb>,
    pub design: Design,
}

impl Packed {
    pub fn new() -> Self {
        let none = Vec::new;
        Self { x: none(), y: none(), z: none(), weight: none(), radiance: Vec::new(), design: Design::Own }
    }

    /// Room for `views` that no texel was measured in.
    fn start(&mut self, views: usize) {
        // Until the observations are weighed, a standard deviation stands for the weight.
        let none = f32::NAN;
        self.clear();
        for (to, value) in
            [(&mut self.x, 0.0), (&mut self.y, 0.0), (&mut self.z, 1.0), (&mut self.weight, none)]
        {
            to.resize(views, Lane([value; LANES]));
        }
        self.radiance.resize(views, [Lane::ZERO; 3]);
    }

    fn clear(&mut self) {
        [&mut self.x, &mut self.y, &mut self.z, &mut self.weight].into_iter().for_each(Vec::clear);
        self.radiance.clear();
    }
}

/// What stands for the views' directions in a group of eight texels.
pub(super) enum Design {
    /// The texels see the views from nearly the same directions: the basis at their means, k x n.
    Shared(Vec<f32>),
    /// Every texel has its own.
    Own,
}

/// Lays the texels of a group side by side: a row for each view that measured any of them.
pub(super) fn pack(group: &[&TexelObservations], packed: &mut Packed, rows: &mut Vec<usize>) {
    match group.try_into() {
        Ok(group) if seen_by_the_same_views(group) => interleave(group, packed),
        _ => pack_each(group, packed, rows),
    }
}

fn seen_by_the_same_views(group: &[&TexelObservations; LANES]) -> bool {
    group.iter().all(|texel| texel.view == group[0].view)
}

/// Texels that different views measured.
fn pack_each(group: &[&TexelObservations], packed: &mut Packed, rows: &mut Vec<usize>) {
    rows.clear();
    for texel in group {
        for view in &texel.view {
            rows.resize(rows.len().max(*view as usize + 1), usize::MAX);
            rows[*view as usize] = 0;
        }
    }
    let mut count = 0;
    for row in rows.iter_mut().filter(|row| **row == 0) {
        *row = count;
        count += 1;
    }
    packed.start(count);
    for (lane, texel) in group.iter().enumerate() {
        let observations = texel.view.iter().zip(&texel.direction).zip(&texel.radiance).zip(&texel.sigma);
        for (((view, direction), radiance), sigma) in observations {
            let row = rows[*view as usize];
            packed.x[row].0[lane] = direction.x;
            packed.y[row].0[lane] = direction.y;
            packed.z[row].0[lane] = direction.z;
            for c in 0..3 {
                packed.radiance[row][c].0[lane] = radiance[c];
            }
            packed.weight[row].0[lane] = *sigma;
        }
    }
}

/// Lays eight texels that the same views measured side by side; standard deviations stand for the weights.
#[multiversion(targets("x86_64+avx2+fma"))]
fn interleave(group: &[&TexelObservations; LANES], packed: &mut Packed) {
    let n = group[0].len();
    let direction = group.map(|texel| &texel.direction[..n]);
    let radiance = group.map(|texel| &texel.radiance[..n]);
    let sigma = group.map(|texel| &texel.sigma[..n]);
    packed.clear();
    for row in 0..n {
        packed.x.push(Lane::of(|i| direction[i][row].x));
        packed.y.push(Lane::of(|i| direction[i][row].y));
        packed.z.push(Lane::of(|i| direction[i][row].z));
        packed.radiance.push([0, 1, 2].map(|c| Lane::of(|i| radiance[i][row][c])));
        packed.weight.push(Lane::of(|i| sigma[i][row]));
    }
}

/// Puts weights where the standard deviations are. What is no number takes no part, and leaves none behind.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn weigh_observations(packed: &mut Packed, weighing: &Weighing) {
    let Packed { x, y, z, weight, radiance, .. } = packed;
    for ((((x, y), z), weight), radiance) in x.iter_mut().zip(y).zip(z).zip(weight).zip(radiance) {
        for i in 0..LANES {
            let seen = [radiance[0].0[i], radiance[1].0[i], radiance[2].0[i]];
            // A sum with anything in it that is not finite is not finite, and 0 times that is no number.
            let finite = 0.0 * (seen[0] + seen[1] + seen[2] + x.0[i] + y.0[i] + z.0[i]) == 0.0;
            let own = weighing.weight(seen, weight.0[i]);
            weight.0[i] = if finite { own } else { 0.0 };
            let used = finite && own > 0.0;
            for channel in radiance.iter_mut() {
                channel.0[i] = if used { channel.0[i] } else { 0.0 };
            }
            x.0[i] = if used { x.0[i] } else { 0.0 };
            y.0[i] = if used { y.0[i] } else { 0.0 };
            z.0[i] = if used { z.0[i] } else { 1.0 };
        }
    }
}

/// Settles the design, once the views are in. A direction that is nearer to the mean of its view's than
/// `shared_within` (chord of the unit sphere) may be taken for it.
#[multiversion(targets("x86_64+avx2+fma"))]
pub(super) fn settle(packed: &mut Packed, basis: Basis, rule: &Rule<f32>, count: usize, shared_within: f32) {
    let n = packed.weight.len();
    let mut means = Vec::with_capacity(n);
    let mut farthest = 0.0_f32;
    for row in 0..n {
        let (x, y, z) = (packed.x[row].0, packed.y[row].0, packed.z[row].0);
        let measured = packed.weight[row].0.map(|weight| if weight > 0.0 { 1.0 } else { 0.0 });
        let total = |lanes: [f32; LANES]| {
            let halves: [f32; 4] =
                std::array::from_fn(|i| lanes[i] * measured[i] + lanes[i + 4] * measured[i + 4]);
            (halves[0] + halves[2]) + (halves[1] + halves[3])
        };
        let mean = DVec3::new(total(x).into(), total(y).into(), total(z).into()).normalize_or(DVec3::Z);
        let (mx, my, mz) = (mean.x as f32, mean.y as f32, mean.z as f32);
        for i in 0..LANES {
            let square = (x[i] - mx).powi(2) + (y[i] - my).powi(2) + (z[i] - mz).powi(2);
            farthest = farthest.max(square * measured[i]);
        }
        means.push(basis.place(mean));
    }
    if farthest > shared_within * shared_within {
        packed.design = Design::Own;
        for row in 0..n {
            for i in 0..LANES {
                let own = DVec3::new(
                    packed.x[row].0[i].into(),
                    packed.y[row].0[i].into(),
                    packed.z[row].0[i].into(),
                );
                let place = basis.place(own);
                (packed.x[row].0[i], packed.y[row].0[i], packed.z[row].0[i]) =
                    (place.x as f32, place.y as f32, place.z as f32);
            }
        }
        return;
    }
    let mut design = match std::mem::replace(&mut packed.design, Design::Own) {
        Design::Shared(design) => design,
        Design::Own => Vec::new(),
    };
    design.resize(n * count, 0.0);
    for (block, places) in means.chunks(LANES).enumerate() {
        let at = |axis: usize| Lane::of(|i| places[i.min(places.len() - 1)][axis] as f32);
        rule.fill(rule.order(), at(0), at(1), at(2), |index, value| {
            let first = index * n + block * LANES;
            if places.len() == LANES {
                design[first..first + LANES].copy_from_slice(&value.0);
            } else {
                design[first..first + places.len()].copy_from_slice(&value.0[..places.len()]);
            }
        });
    }
    packed.design = Design::Shared(design);
}

//! What no map has seen, filled from what is around on the model: means over ever larger cubes, where there is nothing nearer.

use std::collections::HashMap;

use glam::{DVec3, IVec3};

use super::texture::Room;
use crate::environment::EnvironmentMap;

/// Cubes grow up to this many times by two.
const LEVELS: i32 = 20;

type Cube = (IVec3, usize);

impl Room {
    /// Gives texels that no map has seen the mean of those around that face the same way, and flags them.
    pub fn fill(&mut self) {
        let unseen = |flags: u8| flags & EnvironmentMap::UNSEEN != 0;
        let mut waiting: Vec<(usize, DVec3, usize)> = vec![];
        let mut known: Vec<(DVec3, usize, [f32; 3])> = vec![];
        let mut area_m2 = 0.0;
        for texel in 0..self.flags.len() {
            let Some(face) = self.charts.face(texel) else { continue };
            let (place, facing) = (self.place(face, texel), facing(self.model.normal(face)));
            area_m2 += f64::from(self.charts.area_m2[texel]);
            match unseen(self.flags[texel]) {
                true => waiting.push((texel, place, facing)),
                false => known.push((place, facing, self.radiance[texel])),
            }
        }
        if known.is_empty() {
            return;
        }
        let mut side_m = 2.0 * (area_m2 / (known.len() + waiting.len()) as f64).sqrt();
        for level in 0..=LEVELS {
            let mut cubes: HashMap<Cube, [f32; 4]> = HashMap::new();
            for (place, facing, [r, g, b]) in &known {
                // At last whichever way they face.
                let facing = if level == LEVELS { 0 } else { *facing };
                let sum = cubes.entry(((place / side_m).floor().as_ivec3(), facing)).or_default();
                *sum = [sum[0] + r, sum[1] + g, sum[2] + b, sum[3] + 1.0];
            }
            waiting.retain(|&(texel, place, facing)| {
                let facing = if level == LEVELS { 0 } else { facing };
                let Some(mean) = around(&cubes, place / side_m, facing) else { return true };
                self.radiance[texel] = mean;
                self.flags[texel] = self.flags[texel] & !EnvironmentMap::UNSEEN | EnvironmentMap::FILLED;
                false
            });
            if waiting.is_empty() {
                return;
            }
            side_m = if level + 1 == LEVELS { 2.0 * self.model.size_m() } else { 2.0 * side_m };
        }
    }
}

/// The mean of the eight cubes about a place, by its nearness to their centres.
fn around(cubes: &HashMap<Cube, [f32; 4]>, at: DVec3, facing: usize) -> Option<[f32; 3]> {
    let (low, part) = ((at - 0.5).floor(), (at - 0.5) - (at - 0.5).floor());
    let mut sum = [0f32; 4];
    for k in 0..8 {
        let step = IVec3::new(k & 1, k >> 1 & 1, k >> 2);
        let Some(cube) = cubes.get(&(low.as_ivec3() + step, facing)) else { continue };
        let share = |i: usize| if step[i] == 1 { part[i] } else { 1.0 - part[i] };
        let weight = (share(0) * share(1) * share(2)).max(1e-6) as f32;
        (0..4).for_each(|c| sum[c] += weight * cube[c] / cube[3]);
    }
    (sum[3] > 0.0).then(|| [0, 1, 2].map(|c| sum[c] / sum[3]))
}

/// Which of the six axes a normal is nearest to.
fn facing(normal: DVec3) -> usize {
    let axis = normal.abs().max_position();
    2 * axis + usize::from(normal[axis] < 0.0)
}

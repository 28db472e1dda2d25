//! The light sources on the surfaces: what is much brighter than most of the room.

use std::collections::HashMap;
use std::fmt::Write as _;

use glam::{DMat3, DVec3, IVec3};
use nalgebra::Matrix3;

use super::texture::Room;
use crate::environment::EnvironmentMap;

/// A texel shines where it is so many times as bright as half of the room's surface.
const SHINES: f64 = 10.0;
/// Patches with less than this part of the light are not told.
const LEAST: f64 = 0.005;
/// Texels that are no further apart than so many of their sides belong together.
const REACH: f64 = 2.0;
/// The cosine of 25 degrees: texels of a patch face no further away than this from where its brightest one faces.
const SAME_WAY: f64 = 0.906;
/// Much of a patch's power comes from saturated pixels: it is a lower bound.
const BOUND: f64 = 0.01;

/// A part of the surface that shines.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// Its centre, by power, on the surface, metres.
    pub centre_m: DVec3,
    /// Unit vector to where it shines.
    pub normal: DVec3,
    /// The area that is at least half as bright as it is on the whole, square metres.
    pub area_m2: f64,
    /// Length and width of a rectangle that is spread like it, metres.
    pub size_m: [f64; 2],
    /// Mean radiance, red, green and blue.
    pub radiance: [f64; 3],
    /// Power that it gives as a matte emitter: π times radiance times area.
    pub power: [f64; 3],
    /// Its part of the light that leaves all known surfaces.
    pub share: f64,
    /// Whether photographs were saturated there.
    pub is_lower_bound: bool,
}

struct Spot {
    at_m: DVec3,
    normal: DVec3,
    area_m2: f64,
    radiance: [f64; 3],
    is_bound: bool,
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

impl Room {
    /// Parts of the surface, each of one piece that faces one way, that are more than ten times as bright as half of the known surface, the most powerful
    /// first; those with less than 0.5 % of the light are left out.
    pub fn patches(&self) -> Vec<Patch> {
        let known = |texel: &usize| {
            self.charts.area_m2[*texel] > 0.0
                && self.flags[*texel] & (EnvironmentMap::UNSEEN | EnvironmentMap::FILLED | Self::NO_SURFACE)
                    == 0
        };
        let bright = |texel: usize| luminance(self.radiance[texel].map(f64::from));
        let area = |texel: usize| f64::from(self.charts.area_m2[texel]);
        let mut texels: Vec<usize> = (0..self.flags.len()).filter(known).collect();
        texels.sort_by(|&a, &b| bright(a).total_cmp(&bright(b)));
        let all_m2: f64 = texels.iter().map(|&texel| area(texel)).sum();
        let mut below = 0.0;
        let median = texels.iter().find(|&&texel| {
            below += area(texel);
            below >= 0.5 * all_m2
        });
        let level = SHINES * median.map_or(0.0, |&texel| bright(texel));
        let light: f64 = texels.iter().map(|&texel| area(texel) * bright(texel)).sum();
        let spots: Vec<Spot> = texels
            .into_iter()
            .filter(|&texel| bright(texel) > level)
            .filter_map(|texel| {
                let face = self.charts.face(texel)?;
                let behind = self.flags[texel] & Self::BEHIND != 0;
                let normal = self.model.normal(face);
                Some(Spot {
                    at_m: self.place(face, texel),
                    normal: if behind { -normal } else { normal },
                    area_m2: area(texel),
                    radiance: self.radiance[texel].map(f64::from),
                    is_bound: self.flags[texel] & EnvironmentMap::LOWER_BOUND != 0,
                })
            })
            .collect();
        let reach_m = REACH * spots.iter().map(|spot| spot.area_m2.sqrt()).fold(0.0, f64::max);
        let mut patches: Vec<Patch> = groups(&spots, reach_m)
            .into_iter()
            .map(|group| patch(&group, light))
            .filter(|patch| patch.share >= LEAST)
            .collect();
        patches.sort_by(|a, b| b.share.total_cmp(&a.share));
        patches
    }
}

/// Spots, the dimmest first, that hang together and face the same way.
fn groups(spots: &[Spot], reach_m: f64) -> Vec<Vec<&Spot>> {
    let cube = |at: DVec3| (at / reach_m).floor().as_ivec3();
    let mut cubes: HashMap<IVec3, Vec<usize>> = HashMap::new();
    for (i, spot) in spots.iter().enumerate() {
        cubes.entry(cube(spot.at_m)).or_default().push(i);
    }
    let (mut groups, mut taken) = (vec![], vec![false; spots.len()]);
    for start in (0..spots.len()).rev() {
        if std::mem::replace(&mut taken[start], true) {
            continue;
        }
        let (mut waiting, mut group) = (vec![start], vec![]);
        while let Some(i) = waiting.pop() {
            group.push(&spots[i]);
            for k in 0..27 {
                let step = IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
                for &other in cubes.get(&(cube(spots[i].at_m) + step)).into_iter().flatten() {
                    let is_near = spots[other].at_m.distance(spots[i].at_m) <= reach_m;
                    if !taken[other] && is_near && spots[other].normal.dot(spots[start].normal) > SAME_WAY {
                        taken[other] = true;
                        waiting.push(other);
                    }
                }
            }
        }
        groups.push(group);
    }
    groups
}

fn patch(group: &[&Spot], light: f64) -> Patch {
    let own = |spot: &Spot| spot.area_m2 * luminance(spot.radiance);
    let all: f64 = group.iter().map(|spot| own(spot)).sum();
    let power = [0, 1, 2]
        .map(|c| std::f64::consts::PI * group.iter().map(|s| s.area_m2 * s.radiance[c]).sum::<f64>());
    // What a map's pixels spill over the border belongs to the power, not to the extent.
    let usual = group.iter().map(|spot| own(spot) * luminance(spot.radiance)).sum::<f64>() / all;
    let core: Vec<&Spot> = group.iter().copied().filter(|s| luminance(s.radiance) > 0.5 * usual).collect();
    let area_m2: f64 = core.iter().map(|spot| spot.area_m2).sum();
    // The mean of what is bent lies beside it: it goes to the plane of the nearest texel.
    let mean_m = group.iter().map(|spot| own(spot) * spot.at_m).sum::<DVec3>() / all;
    let away = |spot: &Spot| spot.at_m - mean_m;
    let nearest = group.iter().min_by(|a, b| away(a).length_squared().total_cmp(&away(b).length_squared()));
    let centre_m = nearest.map_or(mean_m, |spot| mean_m + away(spot).dot(spot.normal) * spot.normal);
    let middle = core.iter().map(|spot| spot.area_m2 * spot.at_m).sum::<DVec3>() / area_m2;
    let spread = core.iter().fold(DMat3::ZERO, |sum, spot| {
        let away = spot.at_m - middle;
        sum + DMat3::from_cols(away * away.x, away * away.y, away * away.z) * (spot.area_m2 / area_m2)
    });
    let mut spread =
        Matrix3::from_column_slice(&spread.to_cols_array()).symmetric_eigenvalues().as_slice().to_vec();
    spread.sort_by(|a, b| b.total_cmp(a));
    // A side's square is twelve times its variance.
    let side = |i: usize| (12.0 * spread[i].max(0.0)).sqrt();
    let bound: f64 = group.iter().filter(|spot| spot.is_bound).map(|spot| own(spot)).sum();
    Patch {
        centre_m,
        normal: core.iter().map(|spot| own(spot) * spot.normal).sum::<DVec3>().normalize_or_zero(),
        area_m2,
        size_m: [side(0), side(1)],
        radiance: power.map(|power| power / (std::f64::consts::PI * area_m2)),
        power,
        share: all / light,
        is_lower_bound: bound > BOUND * all,
    }
}

/// A table of patches: place, direction, area, extent, radiance, power, share, and whether it is a lower bound.
pub fn patches_csv(patches: &[Patch]) -> String {
    let mut csv = String::from(
        "x_m,y_m,z_m,normal_x,normal_y,normal_z,area_m2,length_m,width_m,radiance_r,radiance_g,radiance_b,power_r,power_g,power_b,share,is_lower_bound\n",
    );
    for Patch { centre_m, normal, area_m2, size_m, radiance, power, share, is_lower_bound } in patches {
        let places = [*centre_m, *normal].map(|v| format!("{:.5},{:.5},{:.5}", v.x, v.y, v.z));
        let colours = [radiance, power].map(|[r, g, b]| format!("{r:.6e},{g:.6e},{b:.6e}"));
        let _ = writeln!(
            csv,
            "{},{area_m2:.6e},{:.5},{:.5},{},{share:.5},{}",
            places.join(","),
            size_m[0],
            size_m[1],
            colours.join(","),
            u8::from(*is_lower_bound)
        );
    }
    csv
}

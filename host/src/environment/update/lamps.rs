//! What has become of each lamp of a map.
//!
//! A lamp's factor is what new photographs show of its power over what the map holds of it, after what lies around it was taken away. It is a lamp's own
//! where it differs from that of everything else by more than its doubt.

use glam::{DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::SIGMAS;
use crate::Result;
use crate::environment::EnvironmentMap;
use crate::environment::lights::{Method, Remainder, lights};
use crate::geometry::LatLong;
use crate::progress::Progress;

/// Lamps are so many times as bright as half of the sphere.
const BRIGHT: f64 = 10.0;
/// What is dimmer than this part of a lamp is its glow; lights between which it is not darker than this part of the dimmer one are one lamp.
const GLOW: f64 = 0.1;
const TOUCHING: f64 = 0.5;
/// The lights that are looked at, and the part of all luminance that one must have.
const MOST: usize = 16;
const LEAST: f64 = 0.01;
const TOLERANCE: f64 = 0.05;
/// Light of a lamp is found so far around it, beside what the two maps may be turned, radians.
const AROUND_RAD: f64 = 0.01;
/// So much of a lamp must be measured in both.
const SHOWN: f64 = 0.5;
/// A lamp's power is not kept better than this when photographs are put on the sphere, relative.
const SAMPLED: f64 = 0.01;
/// A channel with less of the lamp's power tells nothing, and so much of what it held is taken to be left.
const LEAST_LEFT: f64 = 1e-3;

/// What has become of a lamp.
#[derive(Debug, Clone, PartialEq)]
pub struct Lamp {
    /// Unit vector towards it, in the world of environments.
    pub direction: DVec3,
    /// Its part of the luminance from all directions of the map.
    pub share: f64,
    /// Red, green and blue of its power now over before, and their relative standard deviations; `None` where the photographs show less than half of it,
    /// or either is saturated there, or no more of its power, of all colours together, is left than its doubt: it goes with the rest. A colour of which less is left has a thousandth,
    /// with its doubt; one that hardly shone has the factor of the others together.
    pub factor: Option<([f64; 3], [f64; 3])>,
    /// Whether it differs from the rest by more than the threshold and three sigmas: then it was multiplied by its own factor.
    pub is_own: bool,
}

/// The lamps of a map and where they are.
pub(super) struct Lamps {
    /// Direction and share of each.
    found: Vec<(DVec3, f64)>,
    /// Per pixel the lamp that it belongs to, counted from 1, and whether it is as bright as one; 0 elsewhere.
    near: Vec<(u8, bool)>,
}

impl Lamps {
    /// Finds them; `unsure_rad` is how far maps may be turned beside each other.
    ///
    /// # Errors
    /// What `progress` says.
    pub fn of(map: &EnvironmentMap, unsure_rad: f64, progress: &dyn Progress) -> Result<Self> {
        let size = map.size;
        let luminance = |i: usize| {
            let [r, g, b] = map.radiance[i].map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let seen = |i: usize| map.flags.get(i).is_none_or(|flag| flag & EnvironmentMap::UNSEEN == 0);
        let mut some: Vec<(f64, f64)> = (0..size.count())
            .filter(|&i| seen(i))
            .step_by(7)
            .map(|i| (luminance(i), size.solid_angle(i / size.width())))
            .collect();
        some.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (half, mut below) = (0.5 * some.iter().map(|(_, angle)| angle).sum::<f64>(), 0.0);
        let median = some.iter().find(|(_, angle)| {
            below += angle;
            below >= half
        });
        let bright = BRIGHT * median.map_or(f64::INFINITY, |(value, _)| *value);
        let mut none = Self { found: vec![], near: vec![(0, false); size.count()] };
        let core: Vec<usize> = (0..size.count()).filter(|&i| seen(i) && luminance(i) > bright).collect();
        let Ok(lights) = lights(map, Method::Joined(Remainder::MOST_ORDER), TOLERANCE, MOST) else {
            return Ok(none);
        };
        let lights: Vec<DVec3> =
            lights.lights.iter().filter(|light| light.share > LEAST).map(|light| light.direction).collect();
        if core.is_empty() || lights.is_empty() {
            return Ok(none);
        }
        let direction =
            |i: usize| size.direction(DVec2::new((i % size.width()) as f64, (i / size.width()) as f64));
        let nearest = |&i: &usize| {
            let d = direction(i);
            (0..lights.len()).max_by(|a, b| lights[*a].dot(d).total_cmp(&lights[*b].dot(d))).unwrap_or(0)
        };
        let of: Vec<usize> = core.par_iter().map(nearest).collect();
        // Of each light, as bright as its power is in the mean.
        let radiance_of = |of: &[usize]| -> Vec<f64> {
            let mut sums = vec![(0.0, 0.0); lights.len()];
            for (&i, &own) in core.iter().zip(of) {
                let power = luminance(i) * size.solid_angle(i / size.width());
                sums[own].0 += power * luminance(i);
                sums[own].1 += power;
            }
            sums.iter().map(|(square, sum)| square / f64::max(*sum, f64::MIN_POSITIVE)).collect()
        };
        let of = joined(size, (&core, &of), &luminance, &radiance_of(&of));
        let radiance = radiance_of(&of);
        // The glow around a lamp is none of it.
        let (core, of): (Vec<usize>, Vec<usize>) =
            core.into_iter().zip(of).filter(|&(i, own)| luminance(i) > GLOW * radiance[own]).unzip();
        let all: f64 = (0..size.count())
            .filter(|&i| seen(i))
            .map(|i| luminance(i) * size.solid_angle(i / size.width()))
            .sum();
        // Only what was found bright enough by itself is a lamp; its direction is that of its power.
        let mut sums = vec![(DVec3::ZERO, 0.0); lights.len()];
        for (&i, &lamp) in core.iter().zip(&of) {
            let power = luminance(i) * size.solid_angle(i / size.width());
            sums[lamp].0 += power * direction(i);
            sums[lamp].1 += power / all;
        }
        let mut number = vec![0u8; lights.len()];
        for (lamp, (toward, share)) in sums.into_iter().enumerate().filter(|(_, sum)| sum.1 > LEAST) {
            none.found.push((toward.normalize_or(DVec3::Y), share));
            number[lamp] = none.found.len() as u8;
        }
        let mut lamps = none;
        let reach = (AROUND_RAD + 2.0 * unsure_rad) / std::f64::consts::PI * size.height() as f64;
        let rows = reach.ceil() as i64;
        for (&i, &lamp) in core.iter().zip(&of).filter(|(_, lamp)| number[**lamp] > 0) {
            lamps.near[i] = (number[lamp], true);
        }
        // What lies beside a lamp lies beside its edge.
        let is_edge = |i: usize| {
            let (column, row, width) = (i % size.width(), i / size.width(), size.width());
            let aside = [row * width + (column + 1) % width, row * width + (column + width - 1) % width];
            let above = [i.checked_sub(width), Some(i + width).filter(|below| *below < size.count())];
            aside.into_iter().chain(above.into_iter().flatten()).any(|beside| !lamps.near[beside].1)
        };
        let both = core.iter().copied().zip(of.iter().copied());
        let edge: Vec<(usize, usize)> = both.filter(|&(i, lamp)| number[lamp] > 0 && is_edge(i)).collect();
        for (done, &(i, lamp)) in edge.iter().enumerate() {
            progress.step(done, edge.len())?;
            let (column, row) = ((i % size.width()) as i64, (i / size.width()) as i64);
            for to in (row - rows).max(0)..=(row + rows).min(size.height() as i64 - 1) {
                let width = reach / size.latitude(to as f64).cos().max(1e-3);
                let columns = (width.ceil() as i64).min(size.width() as i64 / 2);
                for across in -columns..=columns {
                    let at = (column + across).rem_euclid(size.width() as i64);
                    let near = &mut lamps.near[to as usize * size.width() + at as usize];
                    if near.0 == 0 {
                        *near = (number[lamp], false);
                    }
                }
            }
        }
        Ok(lamps)
    }

    /// Whether a pixel belongs to a lamp or lies beside one.
    pub fn is_near(&self, pixel: usize) -> bool {
        self.near[pixel].0 > 0
    }

    /// What has become of each, beside a rest that has changed by `rest` (factors and their relative sigmas); `scale_sigma` is what all photographs
    /// may be off together, `unsure_rad` how far they may be turned.
    pub fn compared(
        &self,
        (map, now): (&EnvironmentMap, &EnvironmentMap),
        (rest, rest_sigma): ([f64; 3], [f64; 3]),
        (scale_sigma, unsure_rad, threshold): ([f64; 3], f64, f64),
    ) -> Vec<Lamp> {
        let size = map.size;
        let flag = |map: &EnvironmentMap, i: usize| map.flags.get(i).copied().unwrap_or(0);
        let mut members = vec![vec![]; self.found.len()];
        for (i, (number, is_core)) in self.near.iter().enumerate().filter(|(_, near)| near.0 > 0) {
            members[usize::from(*number) - 1].push((i, *is_core));
        }
        let pixel = std::f64::consts::PI / size.height() as f64;
        let by_rad = unsure_rad.hypot(0.25 * pixel);
        let lamp = |(&(direction, share), members): (&(DVec3, f64), &Vec<(usize, bool)>)| {
            let none = Lamp { direction, share, factor: None, is_own: false };
            let (mut whole, mut core, mut ring, mut after, mut noise) =
                (0.0, [0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]);
            // What it would be if the photographs were turned a little, about four axes.
            let mut moved = [[0.0; 3]; 4];
            let (aside, up) = direction.any_orthonormal_pair();
            let turns =
                [aside * by_rad, -aside * by_rad, up * by_rad, -up * by_rad].map(DQuat::from_scaled_axis);
            for &(i, is_core) in members {
                let angle = size.solid_angle(i / size.width());
                let sum = |pixel: [f32; 3]| f64::from(pixel.iter().sum::<f32>());
                if is_core {
                    whole += angle * sum(map.radiance[i]);
                }
                if flag(map, i) != 0 || flag(now, i) != 0 {
                    continue;
                }
                let at = size.direction(DVec2::new((i % size.width()) as f64, (i / size.width()) as f64));
                for c in 0..3 {
                    let before = angle * f64::from(map.radiance[i][c]);
                    if is_core {
                        core[c] += before
                    } else {
                        ring[c] += before
                    }
                    after[c] += angle * f64::from(now.radiance[i][c]);
                    let variance =
                        |map: &EnvironmentMap| f64::from(map.variance.get(i).copied().unwrap_or(0.0));
                    noise[c] += angle * angle * (variance(map) + variance(now));
                }
                for (moved, turn) in moved.iter_mut().zip(&turns) {
                    let (radiance, _, _) = now.toward(*turn * at);
                    (0..3).for_each(|c| moved[c] += angle * radiance[c]);
                }
            }
            let all = core.iter().sum::<f64>();
            if all < SHOWN * whole || all <= 0.0 {
                return none;
            }
            let power = [0, 1, 2].map(|c| after[c] - rest[c] * ring[c]);
            // Beside the rest, what all photographs share does not count.
            let doubt = [0, 1, 2].map(|c| {
                let placed = 0.5 * (moved[0][c] - moved[1][c]).hypot(moved[2][c] - moved[3][c]);
                let bent = 0.5
                    * (0..2)
                        .map(|k| moved[2 * k][c] + moved[2 * k + 1][c] - 2.0 * after[c])
                        .fold(0.0, f64::hypot);
                let around = rest_sigma[c] * rest[c] * ring[c];
                placed.hypot(bent).hypot(around).hypot(noise[c].sqrt())
            });
            // One that was switched off leaves nothing that could be multiplied.
            if power.iter().sum::<f64>() <= doubt.iter().sum::<f64>() {
                return none;
            }
            let left = [0, 1, 2].map(|c| power[c].max(LEAST_LEFT * core[c]));
            // Of a coloured one a channel may hold nothing: it goes with the others.
            let is_lit = core.map(|core| core > LEAST_LEFT * all);
            let sum = |of: &[f64; 3]| (0..3).filter(|&c| is_lit[c]).map(|c| of[c]).sum::<f64>();
            let of = |c: usize| match is_lit[c] {
                true => (left[c] / core[c], doubt[c] / left[c]),
                false => (sum(&left) / sum(&core), sum(&doubt) / sum(&left)),
            };
            let factor = [0, 1, 2].map(|c| of(c).0);
            let own = [0, 1, 2].map(|c| of(c).1.hypot(SAMPLED));
            let is_own = (0..3).filter(|&c| is_lit[c]).any(|c| {
                let off = (factor[c] / rest[c]).ln().abs();
                off > (1.0 + threshold).ln().max(SIGMAS * own[c])
            });
            let sigma = [0, 1, 2].map(|c| own[c].hypot(scale_sigma[c]));
            Lamp { factor: Some((factor, sigma)), is_own, ..none }
        };
        self.found.par_iter().zip(&members).map(lamp).collect()
    }

    /// Multiplies a map by the factor of the rest and those of the lamps that have their own.
    pub fn multiply(&self, map: &mut EnvironmentMap, rest: [f64; 3], lamps: &[Lamp]) {
        let own: Vec<Option<[f64; 3]>> =
            lamps.iter().map(|lamp| lamp.factor.filter(|_| lamp.is_own).map(|(factor, _)| factor)).collect();
        let own_of = |i: usize| match self.near[i] {
            (number, true) => own[usize::from(number) - 1],
            _ => None,
        };
        for i in 0..map.radiance.len() {
            let factor = own_of(i).unwrap_or(rest).map(|factor| factor as f32);
            if factor == [1.0; 3] {
                continue;
            }
            (0..3).for_each(|c| map.radiance[i][c] *= factor[c]);
            if let Some(variance) = map.variance.get_mut(i) {
                *variance *= (factor.iter().sum::<f32>() / 3.0).powi(2);
            }
        }
    }
}

/// Lights that touch where they are bright are parts of one lamp: per pixel of `core` the first of its lamp's lights. `radiance` is that of each light.
fn joined(
    size: LatLong,
    (core, of): (&[usize], &[usize]),
    luminance: &dyn Fn(usize) -> f64,
    radiance: &[f64],
) -> Vec<usize> {
    let mut light = vec![usize::MAX; size.count()];
    core.iter().zip(of).for_each(|(&i, &own)| light[i] = own);
    let mut first: Vec<usize> = (0..radiance.len()).collect();
    for &i in core {
        let (column, row) = (i % size.width(), i / size.width());
        let beside = [
            Some(row * size.width() + (column + 1) % size.width()),
            (row + 1 < size.height()).then_some(i + size.width()),
        ];
        for next in beside.into_iter().flatten().filter(|&next| light[next] != usize::MAX) {
            let (own, other) = (light[i], light[next]);
            if own == other
                || luminance(i).min(luminance(next)) < TOUCHING * radiance[own].min(radiance[other])
            {
                continue;
            }
            let (a, b) = (first[own], first[other]);
            first.iter_mut().filter(|lamp| **lamp == a.max(b)).for_each(|lamp| *lamp = a.min(b));
        }
    }
    of.iter().map(|&own| first[own]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::environment::Unit;
    use crate::progress::Silent;

    struct Stop;

    impl Progress for Stop {
        fn step(&self, _: usize, _: usize) -> Result<()> {
            Err(Error::Interrupted)
        }
    }

    #[test]
    fn what_lies_around_a_lamp_at_the_pole_is_beside_it_and_the_search_can_be_stopped() {
        let (size, radius, unsure) = (LatLong::new(1024, 512).unwrap(), 0.1, 0.02);
        let lamp = DVec3::new(0.05, 1.0, 0.02).normalize();
        let off = |i: usize| {
            let at = DVec2::new((i % size.width()) as f64, (i / size.width()) as f64);
            size.direction(at).angle_between(lamp)
        };
        let radiance = (0..size.count()).map(|i| [if off(i) < radius { 50.0 } else { 0.5 }; 3]);
        let map = EnvironmentMap {
            size,
            radiance: radiance.collect(),
            variance: vec![],
            coverage: vec![],
            flags: vec![],
            unit: Unit::Unknown,
            curve: vec![],
        };
        let lamps = Lamps::of(&map, unsure, &Silent).unwrap();
        assert!(lamps.found.len() == 1 && lamps.found[0].0.angle_between(lamp) < 0.01);
        let (pixel, around) = (std::f64::consts::PI / size.height() as f64, AROUND_RAD + 2.0 * unsure);
        for i in 0..size.count() {
            assert_eq!(lamps.near[i].1, off(i) < radius);
            assert!(lamps.is_near(i) || off(i) > radius + around - 2.0 * pixel, "{i}");
            assert!(!lamps.is_near(i) || off(i) < radius + 2.0 * around + 2.0 * pixel, "{i}");
        }
        assert!(matches!(Lamps::of(&map, unsure, &Stop), Err(Error::Interrupted)));
    }
}

//! The few lights that stand for an environment map.
//!
//! What is brighter than half of the sphere is dealt into regions of equal luminance (median cut, Debevec 2005); regions whose union
//! costs the irradiance least are joined, two by two (Ward 1963, weighted by luminance), and the fewest lights are kept that
//! reproduce the irradiance on all orientations, open and behind walls, to a tolerance. The rest is the same from everywhere.

use std::fmt::Write as _;

use glam::DVec3;
use rayon::prelude::*;

use super::EnvironmentMap;
use crate::{Error, Result};

/// Regions to begin with.
const REGIONS: usize = 512;
/// Columns at which a map is looked at; of each block of pixels the sums count, not the mean.
const COLUMNS: usize = 512;
/// Orientations of a surface on which the irradiance is compared.
const ORIENTATIONS: usize = 128;
/// Walls through the point, each of which hides half of the sphere.
const WALLS: usize = 16;
/// A light is a lower bound where so much of it comes from saturated pixels.
const BOUND: f64 = 0.01;

const COLUMN_NAMES: &str = "kind,longitude_deg,latitude_deg,x,y,z,solid_angle_sr,radiance_r,radiance_g,radiance_b,share,is_lower_bound\n";

/// How lights are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Regions of equal luminance over the whole sphere, nothing beside them (Debevec 2005).
    MedianCut,
    /// Regions above the median radiance, joined where that costs least, and a constant for the rest.
    Joined,
}

/// One light.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Unit vector towards it, in the world of environments.
    pub direction: DVec3,
    /// The solid angle that an even light of its power and sharpness has, steradians.
    pub solid_angle_sr: f64,
    /// Red, green and blue irradiance on a surface that faces it; over the solid angle it is the radiance.
    pub irradiance: [f64; 3],
    /// Its part of the luminance from all directions.
    pub share: f64,
    /// Whether photographs were saturated there: it is at least so bright.
    pub is_lower_bound: bool,
}

/// Lights, and what comes from everywhere alike.
#[derive(Debug, Clone, PartialEq)]
pub struct Lights {
    /// The brightest first.
    pub lights: Vec<Light>,
    /// Radiance from every direction beside them.
    pub ambient: [f64; 3],
    /// Root mean square of the irradiance's error over orientations and walls, relative to that of the irradiance.
    pub error: f64,
    /// The part of the sphere that was never seen, and counts as dark.
    pub unseen: f64,
}

/// Sums over some pixels, of what is brighter than the median.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    irradiance: [f64; 3],
    luminance: f64,
    toward: DVec3,
    square: f64,
    bound: f64,
}

impl Sum {
    fn plus(self, other: Self) -> Self {
        Self {
            irradiance: [0, 1, 2].map(|c| self.irradiance[c] + other.irradiance[c]),
            luminance: self.luminance + other.luminance,
            toward: self.toward + other.toward,
            square: self.square + other.square,
            bound: self.bound + other.bound,
        }
    }

    /// By how much the scatter of luminance over directions grows where the two become one.
    fn cost(&self, other: &Self) -> f64 {
        let apart = self.toward / self.luminance - other.toward / other.luminance;
        self.luminance * other.luminance / (self.luminance + other.luminance) * apart.length_squared()
    }

    fn light(&self, all: f64) -> Light {
        Light {
            direction: self.toward.normalize_or(DVec3::Y),
            solid_angle_sr: self.luminance.powi(2) / self.square,
            irradiance: self.irradiance,
            share: self.luminance / all,
            is_lower_bound: self.bound > BOUND * self.luminance,
        }
    }
}

impl Lights {
    /// As a table: direction, solid angle, radiance, share and whether it is a lower bound; then what comes from everywhere.
    pub fn csv(&self) -> String {
        let mut csv = String::from(COLUMN_NAMES);
        for Light { direction, solid_angle_sr, irradiance, share, is_lower_bound } in &self.lights {
            let (longitude, latitude) = (
                direction.x.atan2(direction.z).to_degrees(),
                direction.y.clamp(-1.0, 1.0).asin().to_degrees(),
            );
            let [r, g, b] = irradiance.map(|value| value / solid_angle_sr);
            let DVec3 { x, y, z } = direction;
            let bound = u8::from(*is_lower_bound);
            let _ = writeln!(
                csv,
                "light,{longitude:.3},{latitude:.3},{x:.6},{y:.6},{z:.6},{solid_angle_sr:.6e},{r:.6e},{g:.6e},{b:.6e},{share:.5},{bound}"
            );
        }
        let [r, g, b] = self.ambient;
        let share = 1.0 - self.lights.iter().map(|light| light.share).sum::<f64>();
        let sphere = 4.0 * std::f64::consts::PI;
        let _ = writeln!(csv, "ambient,,,,,,{sphere:.6e},{r:.6e},{g:.6e},{b:.6e},{:.5},0", share.max(0.0));
        csv
    }
}

/// Finds the fewest lights, at most `most`, whose irradiance is off by no more than `tolerance` (relative, root mean square).
/// Where `most` do not suffice, the [`Lights::error`] is what they leave.
///
/// # Errors
/// [`Error::Request`] for a map without light.
pub fn lights(map: &EnvironmentMap, method: Method, tolerance: f64, most: usize) -> Result<Lights> {
    let blocks = Blocks::of(map, method);
    let all: f64 = blocks.all.iter().map(|(_, luminance)| luminance).sum();
    if !(all > 0.0 && all.is_finite()) {
        return Err(Error::request("the map holds no light", "photograph the room with longer exposures"));
    }
    let most = most.max(1);
    let truth = Irradiance::of(blocks.all.iter().copied());
    let ambient = luminance(blocks.ambient);
    let rest = Irradiance::of(blocks.all_directions.iter().map(|(d, angle)| (*d, angle * ambient)));
    let made = |sums: &[Sum]| {
        let mut lights: Vec<Light> = sums.iter().map(|sum| sum.light(all)).collect();
        lights.sort_by(|a, b| b.share.total_cmp(&a.share));
        let of_lights =
            Irradiance::of(sums.iter().map(|sum| (sum.toward.normalize_or(DVec3::Y), sum.luminance)));
        let error = truth.off(&of_lights, &rest);
        Lights { lights, ambient: blocks.ambient, error, unseen: blocks.unseen }
    };
    let mut best: Option<Lights> = None;
    match method {
        Method::MedianCut => {
            for count in 1..=most {
                let found = made(&blocks.cut(count));
                let is_enough = found.error <= tolerance;
                if best.as_ref().is_none_or(|best| found.error < best.error) {
                    best = Some(found);
                }
                if is_enough {
                    break;
                }
            }
        }
        Method::Joined => {
            let mut sums = blocks.cut(REGIONS);
            loop {
                if sums.len() <= most {
                    let found = made(&sums);
                    if best.is_some() && found.error > tolerance {
                        break;
                    }
                    let is_enough = found.error <= tolerance;
                    best = Some(found);
                    if !is_enough {
                        break;
                    }
                }
                if !join(&mut sums) {
                    break;
                }
            }
        }
    }
    Ok(best.unwrap_or_else(|| made(&[])))
}

/// Joins the two that cost least; `false` where there is nothing left.
fn join(sums: &mut Vec<Sum>) -> bool {
    if sums.is_empty() {
        return false;
    }
    if sums.len() == 1 {
        sums.clear();
        return true;
    }
    let nearest = (0..sums.len() - 1).into_par_iter().map(|i| {
        let costs = (i + 1..sums.len()).map(|k| (sums[i].cost(&sums[k]), i, k));
        costs.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, i, i))
    });
    let Some((_, i, k)) = nearest.min_by(|a, b| a.0.total_cmp(&b.0)) else { return false };
    let joined = sums[i].plus(sums[k]);
    sums.swap_remove(k);
    sums[i] = joined;
    true
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// A map in blocks of pixels.
struct Blocks {
    columns: usize,
    rows: usize,
    /// What is brighter than the median.
    bright: Vec<Sum>,
    /// The direction and luminance of each.
    all: Vec<(DVec3, f64)>,
    /// The direction and solid angle of each.
    all_directions: Vec<(DVec3, f64)>,
    ambient: [f64; 3],
    unseen: f64,
}

impl Blocks {
    fn of(map: &EnvironmentMap, method: Method) -> Self {
        let size = map.size;
        let side = size.width().div_ceil(COLUMNS).max(1);
        let (columns, rows) = (size.width().div_ceil(side), size.height().div_ceil(side));
        let pixels = |block: usize| {
            let (left, top) = (block % columns * side, block / columns * side);
            let rows = top..(top + side).min(size.height());
            rows.flat_map(move |row| (left..(left + side).min(size.width())).map(move |column| (column, row)))
        };
        let seen = |at: usize| map.flags.get(at).is_none_or(|flags| flags & EnvironmentMap::UNSEEN == 0);
        let even = |at: usize| map.radiance[at].map(f64::from);
        let means: Vec<([f64; 3], f64)> = (0..columns * rows)
            .into_par_iter()
            .map(|block| {
                let (mut sum, mut angle) = ([0.0; 3], 0.0);
                for (column, row) in pixels(block) {
                    let (at, own) = (row * size.width() + column, size.solid_angle(row));
                    if seen(at) {
                        (0..3).for_each(|c| sum[c] += own * even(at)[c]);
                        angle += own;
                    }
                }
                (sum.map(|sum| if angle > 0.0 { sum / angle } else { 0.0 }), angle)
            })
            .collect();
        let level = match method {
            Method::MedianCut => [0.0; 3],
            Method::Joined => [0, 1, 2].map(|c| median(means.iter().map(|(mean, angle)| (mean[c], *angle)))),
        };
        let made: Vec<_> = (0..columns * rows)
            .into_par_iter()
            .map(|block| {
                let (mut sum, mut low) = (Sum::default(), [0.0; 3]);
                let (mut toward, mut all, mut angle) = (DVec3::ZERO, 0.0, 0.0);
                for (column, row) in pixels(block) {
                    let (at, own) = (row * size.width() + column, size.solid_angle(row));
                    let direction = size.direction(glam::DVec2::new(column as f64, row as f64));
                    let radiance = even(at);
                    let above = [0, 1, 2].map(|c| (radiance[c] - level[c]).max(0.0));
                    let bright = luminance(above);
                    (0..3).for_each(|c| low[c] += own * radiance[c].min(level[c]));
                    toward += own * direction;
                    angle += own;
                    all += own * luminance(radiance);
                    sum.irradiance = [0, 1, 2].map(|c| sum.irradiance[c] + own * above[c]);
                    sum.luminance += own * bright;
                    sum.toward += own * bright * direction;
                    sum.square += own * bright * bright;
                    if map.flags.get(at).is_some_and(|flags| flags & EnvironmentMap::LOWER_BOUND != 0) {
                        sum.bound += own * bright;
                    }
                }
                (sum, low, (toward.normalize_or(DVec3::Y), all), angle)
            })
            .collect();
        let sphere = 4.0 * std::f64::consts::PI;
        let ambient = [0, 1, 2].map(|c| made.iter().map(|(_, low, ..)| low[c]).sum::<f64>() / sphere);
        Self {
            columns,
            rows,
            bright: made.iter().map(|(sum, ..)| *sum).collect(),
            all: made.iter().map(|(_, _, all, _)| *all).collect(),
            all_directions: made.iter().map(|(_, _, (direction, _), angle)| (*direction, *angle)).collect(),
            ambient,
            unseen: 1.0 - means.iter().map(|(_, angle)| angle).sum::<f64>() / sphere,
        }
    }

    /// So many regions of nearly equal luminance: the brightest is cut in two across its longer side.
    fn cut(&self, count: usize) -> Vec<Sum> {
        let whole = Region { columns: 0..self.columns, rows: 0..self.rows };
        let mut regions = vec![(self.sum(&whole), whole)];
        while regions.len() < count {
            let can = |region: &Region| region.columns.len() * region.rows.len() > 1;
            let brightest = (0..regions.len())
                .filter(|i| can(&regions[*i].1) && regions[*i].0.luminance > 0.0)
                .max_by(|a, b| regions[*a].0.luminance.total_cmp(&regions[*b].0.luminance));
            let Some(brightest) = brightest else { break };
            let (_, region) = regions.swap_remove(brightest);
            regions.extend(self.halves(&region).map(|half| (self.sum(&half), half)));
        }
        regions.into_iter().map(|(sum, _)| sum).filter(|sum| sum.luminance > 0.0).collect()
    }

    fn sum(&self, region: &Region) -> Sum {
        region.rows.clone().fold(Sum::default(), |sum, row| {
            region.columns.clone().fold(sum, |sum, column| sum.plus(self.bright[row * self.columns + column]))
        })
    }

    fn halves(&self, region: &Region) -> [Region; 2] {
        let middle = (region.rows.start + region.rows.end) as f64 / 2.0;
        let shrunk = (std::f64::consts::PI * (middle / self.rows as f64 - 0.5)).cos();
        let across = region.columns.len() as f64 * shrunk > region.rows.len() as f64;
        let upright = region.columns.len() > 1 && (across || region.rows.len() == 1);
        let line = |at: usize| match upright {
            true => Region { columns: at..at + 1, rows: region.rows.clone() },
            false => Region { columns: region.columns.clone(), rows: at..at + 1 },
        };
        let range = if upright { region.columns.clone() } else { region.rows.clone() };
        let lines: Vec<f64> = range.clone().map(|at| self.sum(&line(at)).luminance).collect();
        let (all, mut before) = (lines.iter().sum::<f64>(), 0.0);
        let mut at = range.start + 1;
        for (place, line) in range.clone().zip(&lines) {
            before += line;
            if before >= 0.5 * all {
                // The line in the middle goes to the smaller half.
                at = if before - 0.5 * line > 0.5 * all { place } else { place + 1 };
                break;
            }
        }
        let at = at.clamp(range.start + 1, range.end - 1);
        match upright {
            true => {
                [range.start..at, at..range.end].map(|columns| Region { columns, rows: region.rows.clone() })
            }
            false => {
                [range.start..at, at..range.end].map(|rows| Region { columns: region.columns.clone(), rows })
            }
        }
    }
}

struct Region {
    columns: std::ops::Range<usize>,
    rows: std::ops::Range<usize>,
}

/// The value that half of the weight is below.
fn median(values: impl Iterator<Item = (f64, f64)>) -> f64 {
    let mut values: Vec<(f64, f64)> = values.filter(|(_, weight)| *weight > 0.0).collect();
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (half, mut below) = (0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>(), 0.0);
    let found = values.iter().find(|(_, weight)| {
        below += weight;
        below >= half
    });
    found.map_or(0.0, |(value, _)| *value)
}

/// The irradiance on surfaces of many orientations, open, and then behind each of some walls.
struct Irradiance(Vec<f64>);

impl Irradiance {
    fn of(lights: impl Iterator<Item = (DVec3, f64)>) -> Self {
        let lights: Vec<(DVec3, f64)> = lights.filter(|(_, luminance)| *luminance > 0.0).collect();
        let walls: Vec<DVec3> = lattice(WALLS).collect();
        let normals: Vec<DVec3> = lattice(ORIENTATIONS).collect();
        let of = |normal: &DVec3| {
            let mut sums = [0.0; 1 + WALLS];
            for (direction, luminance) in &lights {
                let from = luminance * normal.dot(*direction).max(0.0);
                sums[0] += from;
                for (sum, wall) in sums[1..].iter_mut().zip(&walls) {
                    *sum += if wall.dot(*direction) > 0.0 { from } else { 0.0 };
                }
            }
            sums
        };
        Self(normals.par_iter().flat_map_iter(of).collect())
    }

    /// How far the sum of two is from this, relative.
    fn off(&self, a: &Self, b: &Self) -> f64 {
        let squares: f64 =
            self.0.iter().zip(a.0.iter().zip(&b.0)).map(|(own, (a, b))| (a + b - own).powi(2)).sum();
        (squares / self.0.iter().map(|own| own * own).sum::<f64>()).sqrt()
    }
}

/// Directions spread evenly over the sphere.
fn lattice(count: usize) -> impl Iterator<Item = DVec3> {
    let golden = std::f64::consts::PI * (1.0 + 5.0_f64.sqrt());
    (0..count).map(move |i| {
        let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
        let (level, (sin, cos)) = ((1.0 - y * y).sqrt(), (golden * i as f64).sin_cos());
        DVec3::new(level * sin, y, level * cos)
    })
}

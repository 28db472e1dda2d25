//! A map in blocks of pixels, and what is bright in it dealt into regions of equal luminance.

use glam::DVec3;
use rayon::prelude::*;

use super::{EnvironmentMap, Light, luminance};

/// Columns at which a map is looked at; of each block of pixels the sums count, not the mean.
const COLUMNS: usize = 512;
/// A light is a lower bound where so much of it comes from saturated pixels.
const BOUND: f64 = 0.01;

/// Sums over some pixels, of what is brighter than the median.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sum {
    pub irradiance: [f64; 3],
    luminance: f64,
    toward: DVec3,
    square: f64,
    bound: f64,
}

impl Sum {
    pub fn plus(self, other: Self) -> Self {
        Self {
            irradiance: [0, 1, 2].map(|c| self.irradiance[c] + other.irradiance[c]),
            luminance: self.luminance + other.luminance,
            toward: self.toward + other.toward,
            square: self.square + other.square,
            bound: self.bound + other.bound,
        }
    }

    /// By how much the scatter of luminance over directions grows where the two become one.
    pub fn cost(&self, other: &Self) -> f64 {
        let apart = self.toward / self.luminance - other.toward / other.luminance;
        self.luminance * other.luminance / (self.luminance + other.luminance) * apart.length_squared()
    }

    /// That of an even light of this power and sharpness.
    pub fn solid_angle_sr(&self) -> f64 {
        self.luminance.powi(2) / self.square
    }

    pub fn light(&self, all: f64) -> Light {
        Light {
            direction: self.toward.normalize_or(DVec3::Y),
            solid_angle_sr: self.solid_angle_sr(),
            irradiance: self.irradiance,
            share: self.luminance / all,
            is_lower_bound: self.bound > BOUND * self.luminance,
        }
    }
}

/// A map in blocks of pixels.
pub(super) struct Blocks {
    columns: usize,
    rows: usize,
    /// What is brighter than the median.
    bright: Vec<Sum>,
    /// The direction of each, and radiance times solid angle.
    pub all: Vec<(DVec3, [f64; 3])>,
    /// The part of the sphere that was never seen.
    pub unseen: f64,
}

impl Blocks {
    /// What is bright is what is above the median of each colour, or everything.
    pub fn of(map: &EnvironmentMap, everything: bool) -> Self {
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
        let level = match everything {
            true => [0.0; 3],
            false => [0, 1, 2].map(|c| median(means.iter().map(|(mean, angle)| (mean[c], *angle)))),
        };
        let made: Vec<_> = (0..columns * rows)
            .into_par_iter()
            .map(|block| {
                let (mut sum, mut toward, mut all) = (Sum::default(), DVec3::ZERO, [0.0; 3]);
                for (column, row) in pixels(block) {
                    let (at, own) = (row * size.width() + column, size.solid_angle(row));
                    let direction = size.direction(glam::DVec2::new(column as f64, row as f64));
                    let radiance = even(at);
                    let above = [0, 1, 2].map(|c| (radiance[c] - level[c]).max(0.0));
                    let bright = luminance(above);
                    toward += own * direction;
                    (0..3).for_each(|c| all[c] += own * radiance[c]);
                    sum.irradiance = [0, 1, 2].map(|c| sum.irradiance[c] + own * above[c]);
                    sum.luminance += own * bright;
                    sum.toward += own * bright * direction;
                    sum.square += own * bright * bright;
                    if map.flags.get(at).is_some_and(|flags| flags & EnvironmentMap::LOWER_BOUND != 0) {
                        sum.bound += own * bright;
                    }
                }
                (sum, (toward.normalize_or(DVec3::Y), all))
            })
            .collect();
        let sphere = 4.0 * std::f64::consts::PI;
        Self {
            columns,
            rows,
            bright: made.iter().map(|(sum, _)| *sum).collect(),
            all: made.iter().map(|(_, all)| *all).collect(),
            unseen: 1.0 - means.iter().map(|(_, angle)| angle).sum::<f64>() / sphere,
        }
    }

    /// So many regions of nearly equal luminance: the brightest is cut in two across its longer side.
    pub fn cut(&self, count: usize) -> Vec<Sum> {
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

//! New photographs of a part of the room bring its map up to date.
//!
//! How the light has changed is told by what both show, one factor for each colour (the AR report's section 8.5); where that is no more than
//! its own doubt or a threshold, the map stays as it is.

use glam::{DQuat, DVec3};
use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;

use super::EnvironmentMap;
use super::lattice::evenly;
use super::mosaic::{Mosaic, Options, mosaic};
use super::shots::Shots;
use crate::progress::Progress;
use crate::{Error, Result};

/// Rows of the cells in which maps are compared, 2 degrees each.
const ROWS: usize = 90;
/// So many cells must show in both.
const FEWEST: usize = 20;
/// A cell has changed by itself where it is off by this factor after the light's own change, and by three times as much as most are.
const CHANGED: f64 = 1.25;
/// A change counts from so many standard deviations on.
const SIGMAS: f64 = 3.0;
/// Neighbouring cells show the same things: so many are one observation.
const ALIKE: f64 = 4.0;
/// Directions by which new photographs are turned to the map, and the furthest that they are.
const DIRECTIONS: usize = 20_000;
const FURTHEST_RAD: f64 = 0.1;

/// What new photographs have changed.
pub struct Updated {
    /// The map as it is now.
    pub map: EnvironmentMap,
    /// Red, green and blue of the light now, over that of before.
    pub factor: [f64; 3],
    /// How sure that is, relative standard deviation.
    pub sigma: [f64; 3],
    /// Whether the light has changed by more than the threshold and three sigmas: then the whole map was multiplied by `factor`.
    pub is_changed: bool,
    /// The part of the sphere that both show.
    pub overlap: f64,
    /// The part of the sphere that shows something else than before, the light's change aside: there the new photographs stand.
    pub replaced: f64,
    /// The part that was not seen or was a lower bound before, and is measured now.
    pub gained: f64,
    /// How far the new photographs were turned to fit the map, radians.
    pub turned_rad: f64,
    /// The new photographs' own map.
    pub new: Mosaic,
}

/// Brings a map up to date with photographs whose exposures are stated, as those of the map were, by the same camera. `options` says how
/// they become a map; its size is the map's. The light has changed where a factor differs from 1 by more than `threshold` and
/// three sigmas in some colour. What was different by itself is replaced, what was unknown is added, and where nothing of this is so,
/// nothing is changed at all.
///
/// # Errors
/// What [`mosaic`] reports; [`Error::Request`] for photographs without stated exposures, or that show next to nothing of what the map shows.
pub fn update(
    map: &EnvironmentMap,
    shots: &Shots,
    options: &Options,
    threshold: f64,
    progress: &dyn Progress,
) -> Result<Updated> {
    if let Some(shot) = shots.shots.iter().find(|shot| shot.exposure.is_none()) {
        return Err(Error::request(
            format!("nothing tells the exposure of {}", shot.name()),
            "state exposure_s of all photographs: without it a darker room and a shorter exposure look alike",
        ));
    }
    let options = Options { size: map.size, fill: false, ..options.clone() };
    let mut new = mosaic(shots, &options, progress)?;
    let mut turned_rad = 0.0;
    if options.refine {
        let turn = turn_to(map, &new.map);
        turned_rad = turn.to_scaled_axis().length();
        if turned_rad > 0.25 * std::f64::consts::PI / map.size.height() as f64 {
            let turned = shots.shots.iter().zip(&new.placed).map(|(shot, placed)| super::Shot {
                world_from_camera: turn * placed.world_from_camera,
                ..shot.clone()
            });
            let turned = Shots { shots: turned.collect(), lens: shots.lens, tracker: None };
            let again = Options { refine: false, lens: Some(new.lens), field_of_view_rad: None, ..options };
            let placed = mosaic(&turned, &again, progress)?;
            new = Mosaic { notes: new.notes, tracker: new.tracker, ..placed };
        }
    }
    // All gains together may be off by what the stated exposures are.
    let count = new.placed.len().max(1) as f64;
    let scale_sigma = (new.placed.iter().map(|placed| placed.gain_sigma.powi(2)).sum::<f64>() / count).sqrt();
    compare(map, new, threshold, (scale_sigma, turned_rad))
}

/// What both measured of a cell: sums of solid angle times radiance.
#[derive(Clone, Copy, Default)]
struct Cell {
    angle: f64,
    before: [f64; 3],
    after: [f64; 3],
}

fn compare(
    map: &EnvironmentMap,
    new: Mosaic,
    threshold: f64,
    (scale_sigma, turned_rad): (f64, f64),
) -> Result<Updated> {
    let (size, now) = (map.size, &new.map);
    let flag = |map: &EnvironmentMap, i: usize| map.flags.get(i).copied().unwrap_or(0);
    let cell_of = |i: usize| {
        let (column, row) = (i % size.width(), i / size.width());
        row * ROWS / size.height() * 2 * ROWS + column * 2 * ROWS / size.width()
    };
    let mut cells = vec![Cell::default(); 2 * ROWS * ROWS];
    for i in (0..size.count()).filter(|&i| flag(map, i) == 0 && flag(now, i) == 0) {
        let (cell, angle) = (&mut cells[cell_of(i)], size.solid_angle(i / size.width()));
        cell.angle += angle;
        (0..3).for_each(|c| cell.before[c] += angle * f64::from(map.radiance[i][c]));
        (0..3).for_each(|c| cell.after[c] += angle * f64::from(now.radiance[i][c]));
    }
    let sphere = 4.0 * std::f64::consts::PI;
    let overlap = cells.iter().map(|cell| cell.angle).sum::<f64>() / sphere;
    let ratio = |cell: &Cell| {
        let logs = [0, 1, 2].map(|c| (cell.after[c] / cell.before[c]).ln());
        logs.iter().all(|log| log.is_finite()).then_some(logs)
    };
    let ratios: Vec<Option<[f64; 3]>> = cells.iter().map(ratio).collect();
    let known: Vec<usize> = (0..cells.len()).filter(|&i| ratios[i].is_some()).collect();
    if known.len() < FEWEST {
        return Err(Error::request(
            format!("the photographs share {:.2} % of the sphere with the map", 100.0 * overlap),
            "take photographs of what the map shows, not saturated",
        ));
    }
    let of = |i: usize, c: usize| ratios[i].map_or(0.0, |ratio| ratio[c]);
    let median = |values: &mut dyn Iterator<Item = (f64, f64)>| {
        let mut values: Vec<(f64, f64)> = values.collect();
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (half, mut below) = (0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>(), 0.0);
        let middle = values.iter().find(|(_, weight)| {
            below += weight;
            below >= half
        });
        middle.map_or(0.0, |(value, _)| *value)
    };
    let logs = [0, 1, 2].map(|c| median(&mut known.iter().map(|&i| (of(i, c), cells[i].angle))));
    let spread = [0, 1, 2]
        .map(|c| 1.4826 * median(&mut known.iter().map(|&i| ((of(i, c) - logs[c]).abs(), cells[i].angle))));
    let sigma = spread.map(|spread| scale_sigma.hypot(1.2533 * spread / (known.len() as f64 / ALIKE).sqrt()));
    let is_changed = (0..3).any(|c| logs[c].abs() > (1.0 + threshold).ln().max(SIGMAS * sigma[c]));
    let factor = logs.map(f64::exp);
    let by = if is_changed { logs } else { [0.0; 3] };
    // Each colour by itself is noisier than what all of them say.
    let is_other: Vec<bool> = (0..cells.len())
        .map(|i| {
            let off = |c: usize| (of(i, c) - by[c]).abs();
            let limit = |c: usize| CHANGED.max(1.0 + threshold).ln().max(SIGMAS * spread[c]);
            ratios[i].is_some() && (0..3).any(|c| off(c) > limit(c))
        })
        .collect();
    let mut out = map.clone();
    let factors = by.map(|log| log.exp() as f32);
    if is_changed {
        out.radiance.iter_mut().for_each(|pixel| (0..3).for_each(|c| pixel[c] *= factors[c]));
        let mean = (factors.iter().sum::<f32>() / 3.0).powi(2);
        out.variance.iter_mut().for_each(|variance| *variance *= mean);
    }
    let (mut replaced, mut gained) = (0.0, 0.0);
    let sum = |pixel: [f32; 3]| f64::from(pixel.iter().sum::<f32>());
    for i in 0..size.count() {
        // Photographs that are saturated still say that it is brighter than before: a lamp that was switched on.
        let is_bound = flag(now, i) == EnvironmentMap::LOWER_BOUND
            && flag(map, i) & EnvironmentMap::LOWER_BOUND == 0
            && sum(now.radiance[i]) > CHANGED * sum(out.radiance[i]);
        if flag(now, i) != 0 && !is_bound {
            continue;
        }
        let angle = size.solid_angle(i / size.width()) / sphere;
        let was_unknown = flag(map, i) != 0;
        if was_unknown {
            gained += angle;
        } else if is_bound || is_other[cell_of(i)] {
            replaced += angle;
        } else {
            continue;
        }
        out.radiance[i] = now.radiance[i];
        if let (Some(to), Some(from)) = (out.variance.get_mut(i), now.variance.get(i)) {
            *to = *from;
        }
        if let (Some(to), Some(from)) = (out.coverage.get_mut(i), now.coverage.get(i)) {
            *to = *from;
        }
        out.flags.resize(size.count(), 0);
        out.flags[i] = flag(now, i);
    }
    Ok(Updated { map: out, factor, sigma, is_changed, overlap, replaced, gained, turned_rad, new })
}

/// The turn that brings a new map to an old one, by the logarithm of their brightness, from coarse to fine.
fn turn_to(map: &EnvironmentMap, new: &EnvironmentMap) -> DQuat {
    let mut turn = DQuat::IDENTITY;
    let finest = map.size.height();
    for rows in
        [64, 128, 256, 512, 1024].into_iter().filter(|rows| *rows <= finest && finest.is_multiple_of(*rows))
    {
        let (old, now) = (Small::new(map, rows), Small::new(new, rows));
        let step = std::f64::consts::PI / rows as f64;
        for _ in 0..8 {
            let sums = (0..DIRECTIONS)
                .into_par_iter()
                .filter_map(|i| {
                    let direction = evenly(i, DIRECTIONS);
                    let here = now.at(direction)?;
                    let to = turn * direction;
                    let mut row = Vector4::new(0.0, 0.0, 0.0, 1.0);
                    for (k, axis) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
                        let moved = step * axis.cross(to);
                        row[k] = (old.at(to + moved)? - old.at(to - moved)?) / (2.0 * step);
                    }
                    Some((row, here - old.at(to)?))
                })
                .collect::<Vec<_>>();
            // What all differ by is the light.
            let mut differences: Vec<f64> = sums.iter().map(|(_, difference)| *difference).collect();
            if differences.len() < 100 {
                return turn;
            }
            differences.sort_by(f64::total_cmp);
            let middle = differences[differences.len() / 2];
            let quartile = |part: f64| differences[(part * (differences.len() - 1) as f64) as usize];
            let scale = (quartile(0.75) - quartile(0.25)).max(1e-4);
            let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
            for (row, difference) in &sums {
                let off = (difference - middle) / scale;
                let weight = 1.0 / (1.0 + off * off);
                normal += weight * row * row.transpose();
                right += weight * (difference - middle) * row;
            }
            // An even wall tells nothing, and nothing is turned.
            (0..3).for_each(|k| normal[(k, k)] += 1e-3 * sums.len() as f64);
            let Some(found) = normal.cholesky().map(|cholesky| cholesky.solve(&right)) else { return turn };
            let by = DVec3::new(found[0], found[1], found[2]);
            turn = (DQuat::from_scaled_axis(by) * turn).normalize();
            if turn.to_scaled_axis().length() > FURTHEST_RAD {
                return DQuat::IDENTITY;
            }
            if by.length() < 0.01 * step {
                break;
            }
        }
    }
    turn
}

/// Logarithms of the brightness of blocks of a map.
struct Small {
    map: EnvironmentMap,
}

impl Small {
    fn new(map: &EnvironmentMap, rows: usize) -> Self {
        let by = (map.size.height() / rows).max(1);
        let size = crate::geometry::LatLong::new(
            (2 * map.size.height() / by) as u32,
            (map.size.height() / by) as u32,
        )
        .unwrap_or(map.size);
        let block = |number: usize| {
            let (left, top) = (number % size.width() * by, number / size.width() * by);
            let (mut sum, mut known) = (0.0, 0);
            for k in 0..by * by {
                let at = (top + k / by) * map.size.width() + left + k % by;
                let brightness = map.radiance[at].iter().sum::<f32>();
                if map.flags.get(at).is_none_or(|flag| *flag == 0) && brightness > 0.0 {
                    sum += brightness;
                    known += 1;
                }
            }
            // More than half of it.
            if 2 * known > by * by {
                ([(sum / known as f32).ln(), 0.0, 0.0], 0)
            } else {
                ([0.0; 3], EnvironmentMap::UNSEEN)
            }
        };
        let (radiance, flags) = (0..size.count()).into_par_iter().map(block).unzip();
        Self { map: EnvironmentMap { size, radiance, variance: vec![], coverage: vec![], flags } }
    }

    fn at(&self, direction: DVec3) -> Option<f64> {
        let (value, known, _) = self.map.toward(direction);
        (known > 0.999).then_some(value[0])
    }
}

//! New photographs of a part of the room bring its map up to date.
//!
//! How the light has changed is told by what both show, one factor for each colour (the AR report's section 8.5), and for each lamp that differs; where
//! that is no more than its own doubt or a threshold, the map stays as it is.

mod lamps;
mod turn;

use glam::DQuat;

use super::EnvironmentMap;
use super::map::Unit;
use super::mosaic::{Mosaic, Options, mosaic};
use super::shots::Shots;
use crate::progress::Progress;
use crate::{Error, Result};
pub use lamps::Lamp;
use lamps::Lamps;
use turn::{Turn, turn_to};

/// Rows of the cells in which maps are compared, 2 degrees each.
const ROWS: usize = 90;
/// So many cells must show in both.
const FEWEST: usize = 20;
/// A cell has changed by itself where it is off by this factor after the light's own change, and by three times as much as most are.
const CHANGED: f64 = 1.25;
/// What saturates photographs at more than so many times the map's radiance was switched on.
const SWITCHED_ON: f64 = 4.0;
/// A change counts from so many standard deviations on.
const SIGMAS: f64 = 3.0;
/// Lamps are looked for no farther around than photographs can be off for, radians.
const UNSURE_RAD: f64 = 0.035;
/// Neighbouring cells show the same things: so many are one observation.
const ALIKE: f64 = 4.0;

/// What new photographs have changed.
pub struct Updated {
    /// The map as it is now.
    pub map: EnvironmentMap,
    /// Red, green and blue of the light now, over that of before, lamps aside.
    pub factor: [f64; 3],
    /// How sure that is, relative standard deviation.
    pub sigma: [f64; 3],
    /// Whether the light has changed by more than the threshold and three sigmas: then the map, but for lamps with a factor of their own, was multiplied by
    /// `factor`.
    pub is_changed: bool,
    /// The part of the sphere that both show.
    pub overlap: f64,
    /// The part of the sphere that shows something else than before, the light's change aside: there the new photographs stand.
    pub replaced: f64,
    /// The part that was not seen or was a lower bound before, and is measured now.
    pub gained: f64,
    /// The part that the map knows and that saturated every new photograph, by no more than four times the map's radiance: it stays.
    pub doubted: f64,
    /// What has become of each lamp of the map.
    pub lamps: Vec<Lamp>,
    /// How far the new photographs were turned to fit the map, radians.
    pub turned_rad: f64,
    /// How sure that is, about the axis of which it is least known, radians; `None` where they were taken as they are, because of the options or, which a
    /// note then says, because they do not tell.
    pub turned_sigma_rad: Option<f64>,
    /// The new photographs' own map.
    pub new: Mosaic,
}

/// Brings a map up to date with photographs whose exposures are stated, as those of the map were, by the same camera. `options` says how
/// they become a map; its size is the map's, whose unit must be that of the photographs. The light has changed where a factor differs from 1 by more than
/// `threshold` and three sigmas in some colour; a lamp that differs so from the rest has its own factor. What was different by itself is
/// replaced, what was unknown is added, and where nothing of this is so, nothing is changed at all.
///
/// # Errors
/// What [`mosaic`] reports; [`Error::Request`] for photographs without stated exposures, for a map in another unit, or one whose unit nothing tells,
/// for photographs that show next to nothing of what the map shows, or fit it only far from where they should.
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
    if map.unit != shots.unit || map.unit == Unit::Unknown {
        return Err(Error::request(
            format!(
                "the map is in {}, what these photographs make in {}",
                map.unit.words(),
                shots.unit.words()
            ),
            "make the map of photographs that state their exposures in the same way, or say --same-unit if you know better",
        ));
    }
    // A few photographs do not tell the camera's curve; without it they would be in another unit.
    let options = Options { size: map.size, fill: false, curve: map.curve.clone(), ..options.clone() };
    let mut new = mosaic(shots, &options, progress)?;
    let mut turned = Turn { turn: DQuat::IDENTITY, sigma_rad: None };
    if options.refine {
        turned = turn_to(map, &new.map)?;
        if turned.sigma_rad.is_none() {
            new.notes.push(
                "how the photographs are turned beside the map cannot be told (they share too little with it, or what they share is even): their own \
                 orientations stand"
                    .into(),
            );
        }
        if turned.turn.to_scaled_axis().length() > 0.25 * std::f64::consts::PI / map.size.height() as f64 {
            let turned = shots.shots.iter().zip(&new.placed).map(|(shot, placed)| super::Shot {
                world_from_camera: turned.turn * placed.world_from_camera,
                ..shot.clone()
            });
            let turned = Shots { shots: turned.collect(), tracker: None, ..shots.clone() };
            let again = Options { refine: false, lens: Some(new.lens), field_of_view_rad: None, ..options };
            let placed = mosaic(&turned, &again, progress)?;
            new = Mosaic { notes: new.notes, tracker: new.tracker, ..placed };
        }
    }
    // All gains together may be off by what the stated exposures are, and a colour by what the camera's white balance moved it from
    // photograph to photograph.
    let count = new.placed.len().max(1) as f64;
    let scale_sigma = (new.placed.iter().map(|placed| placed.gain_sigma.powi(2)).sum::<f64>() / count).sqrt();
    let balance = |c: usize| {
        let moved = new.placed.iter().map(|placed| (placed.gain[c] / placed.gain[1]).ln());
        moved.map(|moved| moved * moved).sum::<f64>().sqrt() / count
    };
    let scale_sigma = [0, 1, 2].map(|c| scale_sigma.hypot(balance(c)));
    compare(map, new, threshold, (scale_sigma, turned), progress)
}

/// What both measured of a cell: sums of solid angle times radiance, and of its standard deviation now.
#[derive(Clone, Copy, Default)]
struct Cell {
    angle: f64,
    before: [f64; 3],
    after: [f64; 3],
    doubt: f64,
}

fn compare(
    map: &EnvironmentMap,
    new: Mosaic,
    threshold: f64,
    (scale_sigma, turned): ([f64; 3], Turn),
    progress: &dyn Progress,
) -> Result<Updated> {
    let (size, now) = (map.size, &new.map);
    let flag = |map: &EnvironmentMap, i: usize| map.flags.get(i).copied().unwrap_or(0);
    let cell_of = |i: usize| {
        let (column, row) = (i % size.width(), i / size.width());
        row * ROWS / size.height() * 2 * ROWS + column * 2 * ROWS / size.width()
    };
    // As sure as the photographs' own orientations where nothing else tells.
    let own_rad = new.placed.iter().map(|placed| placed.sigma_rad).fold(0.0, f64::max);
    let unsure_rad = turned.sigma_rad.unwrap_or(own_rad).min(UNSURE_RAD);
    let lamps = Lamps::of(map, unsure_rad, progress)?;
    let cells_of = |map: &EnvironmentMap, which: &dyn Fn(usize) -> bool| {
        let mut cells = vec![Cell::default(); 2 * ROWS * ROWS];
        for i in (0..size.count()).filter(|&i| flag(map, i) == 0 && flag(now, i) == 0 && which(i)) {
            let (cell, angle) = (&mut cells[cell_of(i)], size.solid_angle(i / size.width()));
            cell.angle += angle;
            (0..3).for_each(|c| cell.before[c] += angle * f64::from(map.radiance[i][c]));
            (0..3).for_each(|c| cell.after[c] += angle * f64::from(now.radiance[i][c]));
            // What is black in one photograph is so in all.
            let variance = |map: &EnvironmentMap| f64::from(map.variance.get(i).copied().unwrap_or(0.0));
            cell.doubt += angle * (variance(map) + variance(now)).sqrt();
        }
        cells
    };
    let ratios_of = |cells: &[Cell]| -> Vec<Option<[f64; 3]>> {
        let ratio = |cell: &Cell| {
            let logs = [0, 1, 2].map(|c| (cell.after[c] / cell.before[c]).ln());
            logs.iter().all(|log| log.is_finite()).then_some(logs)
        };
        cells.iter().map(ratio).collect()
    };
    let sphere = 4.0 * std::f64::consts::PI;
    let overlap = cells_of(map, &|_| true).iter().map(|cell| cell.angle).sum::<f64>() / sphere;
    let cells = cells_of(map, &|i| !lamps.is_near(i));
    let ratios = ratios_of(&cells);
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
    let of_all = 1.2533 / (known.len() as f64 / ALIKE).sqrt();
    let sigma = [0, 1, 2].map(|c| scale_sigma[c].hypot(of_all * spread[c]));
    let is_changed = (0..3).any(|c| logs[c].abs() > (1.0 + threshold).ln().max(SIGMAS * sigma[c]));
    let factor = logs.map(f64::exp);
    let rest = if is_changed { factor } else { [1.0; 3] };
    let told = lamps.compared((map, now), (rest, sigma), (scale_sigma, unsure_rad, threshold));
    let mut out = map.clone();
    lamps.multiply(&mut out, rest, &told);
    // Each colour by itself is noisier than what all of them say.
    let is_other: Vec<bool> = cells_of(&out, &|_| true)
        .iter()
        .map(|cell| {
            (0..3).any(|c| {
                let (before, after) = (cell.before[c], cell.after[c]);
                if before > 0.0 && after > 0.0 {
                    let limit = CHANGED.max(1.0 + threshold).ln().max(SIGMAS * spread[c]);
                    (after / before).ln().abs() > limit
                } else {
                    (after - before).abs() > SIGMAS * cell.doubt
                }
            })
        })
        .collect();
    let (mut replaced, mut gained, mut doubted) = (0.0, 0.0, 0.0);
    let sum = |pixel: [f32; 3]| f64::from(pixel.iter().sum::<f32>());
    for i in 0..size.count() {
        let angle = size.solid_angle(i / size.width()) / sphere;
        // Photographs that are saturated still say that it is brighter than before: a lamp that was switched on. What is hardly brighter may as
        // well be the end of the camera's curve.
        let is_saturated =
            flag(now, i) == EnvironmentMap::LOWER_BOUND && flag(map, i) & EnvironmentMap::LOWER_BOUND == 0;
        let brighter = sum(now.radiance[i]) / sum(out.radiance[i]);
        let is_bound = is_saturated && (flag(map, i) != 0 || brighter > SWITCHED_ON);
        if is_saturated && !is_bound && brighter > CHANGED {
            doubted += angle;
        }
        if flag(now, i) != 0 && !is_bound {
            continue;
        }
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
    Ok(Updated {
        map: out,
        factor,
        sigma,
        is_changed,
        lamps: told,
        overlap,
        replaced,
        gained,
        doubted,
        turned_rad: turned.turn.to_scaled_axis().length(),
        turned_sigma_rad: turned.sigma_rad,
        new,
    })
}

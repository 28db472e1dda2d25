//! How new photographs are turned beside an old map.

use glam::{DQuat, DVec3};
use nalgebra::{Matrix3, Matrix4, Vector4};
use rayon::prelude::*;

use crate::environment::EnvironmentMap;
use crate::environment::lattice::evenly;
use crate::geometry::LatLong;
use crate::{Error, Result};

/// Directions by which new photographs are turned to the map, and the furthest that they are.
const DIRECTIONS: usize = 20_000;
const FURTHEST_RAD: f64 = 0.1;
/// Fewer directions that both show tell nothing.
const FEWEST: usize = 100;
/// Slopes of the brightness's logarithm, squared and per direction, that keep an even wall from turning anything; what shows less than three
/// times as much tells nothing.
const EVEN: f64 = 1e-3;
/// Neighbouring directions show the same things: so many are one observation, and more where they lie closer than the map's blocks.
const ALIKE: f64 = 4.0;
/// Rows of the maps by which it is judged whether they show the same, what counts as a detail of the brightness's logarithm, and from how far
/// off another turn is another place, degrees.
const JUDGED: usize = 128;
const DETAIL: f64 = 0.1;
const ELSEWHERE_DEG: u32 = 10;
/// No block is placed better than to this part of it.
const PART: f64 = 0.1;

/// The turn that brings new photographs to the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turn {
    pub turn: DQuat,
    /// About the axis of which it is least known, radians; `None` where the two show too little in common to tell it.
    pub sigma_rad: Option<f64>,
}

/// The turn that brings a new map to an old one, by the logarithm of their brightness, from coarse to fine.
///
/// # Errors
/// [`Error::Request`] where it is farther than anything near.
pub(super) fn turn_to(map: &EnvironmentMap, new: &EnvironmentMap) -> Result<Turn> {
    let mut found = Turn { turn: DQuat::IDENTITY, sigma_rad: None };
    let finest = map.size.height();
    let nowhere = || {
        Error::request(
            format!(
                "the photographs fit the map nowhere within {:.1} degrees of where their orientations put them",
                FURTHEST_RAD.to_degrees()
            ),
            "check the orientations and the lens, or take both as they are with --no-refine",
        )
    };
    for rows in [finest.min(64), 128, 256, 512, 1024].into_iter().filter(|rows| *rows <= finest) {
        let (old, now) = (Small::new(map, rows), Small::new(new, rows));
        let step = std::f64::consts::PI / rows as f64;
        for _ in 0..8 {
            let Some((by, sigma_rad)) = closer(&old, &now, found.turn, step) else { return Ok(found) };
            if sigma_rad.is_none() {
                return Ok(Turn { turn: DQuat::IDENTITY, sigma_rad });
            }
            found = Turn { turn: (DQuat::from_scaled_axis(by) * found.turn).normalize(), sigma_rad };
            if found.turn.to_scaled_axis().length() > FURTHEST_RAD {
                return Err(nowhere());
            }
            if by.length() < 0.01 * step {
                break;
            }
        }
    }
    let rows = finest.min(JUDGED);
    match found.sigma_rad.and_then(|_| unlike(&Small::new(map, rows), &Small::new(new, rows), found.turn)) {
        // It fits better elsewhere.
        Some(unlike) if unlike > 1.0 => Err(nowhere()),
        _ => Ok(found),
    }
}

/// How far the two differ where the new one has details, by how far they would where they fit best after another turn about the vertical:
/// medians, so that lamps that were switched do not count. Of the same place 0.64 at most
/// (a tour of real photographs), of another 1.5 and more. `None` where nothing can be compared.
fn unlike(old: &Small, now: &Small, turn: DQuat) -> Option<f64> {
    let step = std::f64::consts::PI / old.map.size.height() as f64;
    let detail = |direction: DVec3| {
        let (aside, up) = direction.any_orthonormal_pair();
        let change = |way: DVec3| Some(now.at(direction + step * way)? - now.at(direction - step * way)?);
        // Noise is none, and a lamp's edge no more than one.
        let weight = (change(aside)?.hypot(change(up)?) / DETAIL).powi(2).min(1.0);
        Some((direction, now.at(direction)?, weight))
    };
    let details: Vec<(DVec3, f64, f64)> =
        (0..DIRECTIONS).into_par_iter().filter_map(|i| detail(evenly(i, DIRECTIONS))).collect();
    let median = |mut values: Vec<(f64, f64)>| {
        values.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (half, mut below) = (0.5 * values.iter().map(|(_, weight)| weight).sum::<f64>(), 0.0);
        let middle = values.iter().find(|(_, weight)| {
            below += weight;
            below >= half
        });
        middle.map(|(value, _)| *value)
    };
    // How far apart, and how much was compared.
    let apart = |turn: DQuat| {
        let off = |(direction, here, weight): &(DVec3, f64, f64)| {
            Some((here - old.at(turn * *direction)?, *weight))
        };
        let mut off: Vec<(f64, f64)> = details.iter().filter_map(off).collect();
        let compared: f64 = off.iter().map(|(_, weight)| weight).sum();
        let middle = median(off.clone())?;
        off.iter_mut().for_each(|off| off.0 = (off.0 - middle).abs());
        Some((median(off)?, compared))
    };
    let (here, compared) = apart(turn)?;
    let elsewhere = (ELSEWHERE_DEG..=360 - ELSEWHERE_DEG).into_par_iter().filter_map(|degrees| {
        let (apart, other) = apart(DQuat::from_rotation_y(f64::from(degrees).to_radians()) * turn)?;
        (other > 0.5 * compared).then_some(apart)
    });
    elsewhere.min_by(f64::total_cmp).map(|elsewhere| here / elsewhere)
}

/// A turn that brings them closer, and how sure it is; `None` where the two have too little in common.
fn closer(old: &Small, now: &Small, turn: DQuat, step: f64) -> Option<(DVec3, Option<f64>)> {
    let all = (0..DIRECTIONS)
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
    if all.len() < FEWEST {
        return None;
    }
    // What all differ by is the light.
    let quartiles = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        [0.25, 0.5, 0.75].map(|part| values[(part * (values.len() - 1) as f64) as usize])
    };
    let [low, middle, high] = quartiles(all.iter().map(|(_, difference)| *difference).collect());
    let scale = (high - low).max(1e-4);
    let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for (row, difference) in &all {
        let off = (difference - middle) / scale;
        let weight = 1.0 / (1.0 + off * off);
        normal += weight * row * row.transpose();
        right += weight * (difference - middle) * row;
    }
    let count = all.len() as f64;
    let told = normal;
    (0..3).for_each(|k| normal[(k, k)] += EVEN * count);
    let solved = normal.cholesky()?.solve(&right);
    let [low, _, high] =
        quartiles(all.iter().map(|(row, difference)| difference - middle - row.dot(&solved)).collect());
    // The part of the turn that no change of all brightness could be.
    let axes: Matrix3<f64> = told.fixed_view::<3, 3>(0, 0)
        - told.fixed_view::<3, 1>(0, 3) * told.fixed_view::<1, 3>(3, 0) / told[(3, 3)];
    let least = axes.symmetric_eigenvalues().min();
    let spacing = (4.0 * std::f64::consts::PI / DIRECTIONS as f64).sqrt();
    let alike = ALIKE * (1.0 + (step / spacing).powi(2));
    let left = (high - low) / 1.349;
    let sigma_rad = (left * (alike / least.max(f64::MIN_POSITIVE)).sqrt()).hypot(PART * step);
    let is_told = least > 3.0 * EVEN * count;
    Some((DVec3::new(solved[0], solved[1], solved[2]), is_told.then_some(sigma_rad)))
}

/// Logarithms of the brightness of blocks of a map.
struct Small {
    map: EnvironmentMap,
}

impl Small {
    /// `rows` no more than the map has. Where they do not divide its height, blocks are a pixel more or less, in both maps alike.
    fn new(map: &EnvironmentMap, rows: usize) -> Self {
        let size = LatLong::new(2 * rows as u32, rows as u32).unwrap_or(map.size);
        let height = map.size.height();
        let pixels = |block: usize| block * height / size.height()..(block + 1) * height / size.height();
        let block = |number: usize| {
            let (left, top) = (pixels(number % size.width()), pixels(number / size.width()));
            let (mut sum, mut known) = (0.0, 0);
            for at in top.clone().flat_map(|row| left.clone().map(move |column| row * 2 * height + column)) {
                let brightness = map.radiance[at].iter().sum::<f32>();
                if map.flags.get(at).is_none_or(|flag| *flag == 0) && brightness > 0.0 {
                    sum += brightness;
                    known += 1;
                }
            }
            // More than half of it.
            if 2 * known > top.len() * left.len() {
                ([(sum / known as f32).ln(), 0.0, 0.0], 0)
            } else {
                ([0.0; 3], EnvironmentMap::UNSEEN)
            }
        };
        let (radiance, flags) = (0..size.count()).into_par_iter().map(block).unzip();
        Self {
            map: EnvironmentMap {
                size,
                radiance,
                variance: vec![],
                coverage: vec![],
                flags,
                unit: map.unit,
                curve: vec![],
            },
        }
    }

    fn at(&self, direction: DVec3) -> Option<f64> {
        let (value, known, _) = self.map.toward(direction);
        (known > 0.999).then_some(value[0])
    }
}

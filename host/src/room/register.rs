//! Where in a model a map was taken, and how it is turned: from points of the model that were found in the map.

use std::path::Path;

use glam::{DMat3, DQuat, DVec2, DVec3};
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Vector3, Vector6};
use serde::Deserialize;

use crate::geometry::LatLong;
use crate::{Error, Result};

/// Rounds from a start, and when it is settled.
const ROUNDS: usize = 40;
/// A pair is wrong that is so many times as far off as half of them are, and at least so far.
const WRONG: f64 = 6.0;
const LEAST_WRONG_RAD: f64 = 0.02;
/// A turn that is no better known is none.
const VAGUE_RAD: f64 = 0.5;
/// Clicks are thought to be no better than this.
const CLICK_RAD: f64 = 1e-4;

/// A point of the model and where the map shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// In the model's frame, metres.
    pub point_m: DVec3,
    /// Unit vector towards it, in the map's axes.
    pub direction: DVec3,
}

/// Where a map was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Registered {
    /// The place, in the model's frame, metres.
    pub centre_m: DVec3,
    /// Takes directions of the model's frame to those of the map.
    pub map_from_model: DQuat,
    /// How far each pair is off, radians.
    pub residuals_rad: Vec<f64>,
    /// Pairs that contradict the others and were left out.
    pub wrong: Vec<bool>,
    /// How sure the place is, standard deviation along each axis (root mean square), metres.
    pub centre_sigma_m: f64,
    /// How sure the turn is, about each axis, radians.
    pub turn_sigma_rad: f64,
}

#[derive(Deserialize)]
struct Row {
    px: f64,
    py: f64,
    pz: f64,
    dx: Option<f64>,
    dy: Option<f64>,
    dz: Option<f64>,
    column: Option<f64>,
    row: Option<f64>,
}

/// Reads a table with the columns `px,py,pz` (the model's frame, metres) and either `dx,dy,dz` (a direction in the map's axes) or
/// `column,row` (a pixel of the map, which is of this size; (0, 0) is the centre of the top left one).
///
/// # Errors
/// [`Error::Io`], or [`Error::Input`] that names the line.
pub fn read_pairs(path: &Path, size: LatLong) -> Result<Vec<Pair>> {
    let remedy = "give the columns px,py,pz and dx,dy,dz or column,row";
    let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
    let rows = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes())
        .into_deserialize::<Row>()
        .collect::<Vec<_>>();
    let pair = |(number, row): (usize, csv::Result<Row>)| {
        let refuse = |what: String| Error::input(path, format!("line {}: {what}", number + 2), remedy);
        let row = row.map_err(|error| refuse(error.to_string()))?;
        let direction = match (row.dx, row.dy, row.dz, row.column, row.row) {
            (Some(x), Some(y), Some(z), ..) => DVec3::new(x, y, z),
            (.., Some(column), Some(row)) => {
                let (width, height) = (size.width() as f64, size.height() as f64);
                if !(-0.5..width - 0.5).contains(&column) || !(-0.5..height - 0.5).contains(&row) {
                    return Err(refuse(format!(
                        "pixel {column}, {row} is not in the map of {width}x{height}"
                    )));
                }
                size.direction(DVec2::new(column, row))
            }
            _ => return Err(refuse("it has no direction".into())),
        };
        let point_m = DVec3::new(row.px, row.py, row.pz);
        match direction.try_normalize() {
            Some(direction) if point_m.is_finite() => Ok(Pair { point_m, direction }),
            _ => Err(refuse("it is no point with a direction".into())),
        }
    };
    rows.into_iter().enumerate().map(pair).collect()
}

/// Finds place and turn of a map; with `centre_m` only the turn. One wrong pair, and more where there are many, is found and left out:
/// five pairs (three with the place) are the fewest for that.
///
/// # Errors
/// [`Error::Request`] for fewer than four pairs (two with the place), pairs that are no points with unit directions, or that do not
/// determine what is looked for.
pub fn register(pairs: &[Pair], centre_m: Option<DVec3>) -> Result<Registered> {
    let fewest = if centre_m.is_some() { 2 } else { 4 };
    if pairs.len() < fewest {
        return Err(Error::request(
            format!("{} pairs of points and directions", pairs.len()),
            format!("give at least {fewest}, better eight, all around"),
        ));
    }
    if !pairs.iter().all(|pair| pair.point_m.is_finite() && pair.direction.is_normalized()) {
        return Err(Error::request("a pair is no point with a direction", "give finite numbers"));
    }
    let least = pairs.iter().map(|pair| pair.point_m).fold(DVec3::INFINITY, DVec3::min);
    let most = pairs.iter().map(|pair| pair.point_m).fold(DVec3::NEG_INFINITY, DVec3::max);
    let starts: Vec<DVec3> = match centre_m {
        Some(centre) => vec![centre],
        None => (0..27)
            .map(|k| {
                let part = DVec3::new(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9));
                least + (most - least) * (0.25 + 0.25 * part)
            })
            .collect(),
    };
    let holds = centre_m.is_some();
    let can_leave = pairs.len() > fewest;
    let mut best: Option<(f64, State)> = None;
    for left in (0..pairs.len()).map(Some).chain([None]).filter(|left| left.is_none() || can_leave) {
        let used: Vec<bool> = (0..pairs.len()).map(|i| Some(i) != left).collect();
        for start in &starts {
            let Some(state) = State::new(*start, pairs, &used).settled(pairs, &used, holds) else { continue };
            // By all pairs but the worst, so that all starts are judged alike.
            let mut squares: Vec<f64> = pairs.iter().map(|pair| state.error(pair).length_squared()).collect();
            squares.sort_by(f64::total_cmp);
            let kept = squares.len() - usize::from(can_leave);
            let cost: f64 = squares[..kept].iter().sum();
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, state));
            }
        }
    }
    let undetermined = || {
        Error::request(
            "the pairs do not determine where the map was taken",
            "give points in all directions, not on one line",
        )
    };
    let (_, state) = best.ok_or_else(undetermined)?;
    let off = |state: &State| pairs.iter().map(|pair| state.error(pair).length()).collect::<Vec<f64>>();
    let mut sorted = off(&state);
    sorted.sort_by(f64::total_cmp);
    let limit = (WRONG * sorted[(sorted.len() - 1) / 2]).max(LEAST_WRONG_RAD);
    let used: Vec<bool> = off(&state).iter().map(|off| !can_leave || *off <= limit).collect();
    let kept = used.iter().filter(|used| **used).count();
    if kept < fewest {
        return Err(Error::request(
            format!("{} of {} pairs contradict the others", pairs.len() - kept, pairs.len()),
            "check which point is which",
        ));
    }
    let state = state.settled(pairs, &used, holds).ok_or_else(undetermined)?;
    let residuals_rad = off(&state);
    let (normal, _) = state.normal(pairs, &used, holds);
    let covariance = normal.try_inverse().ok_or_else(undetermined)?;
    let unknowns = if holds { 3 } else { 6 };
    let squares: f64 =
        residuals_rad.iter().zip(&used).filter(|(_, used)| **used).map(|(off, _)| off * off).sum();
    let spare = (2 * kept).saturating_sub(unknowns).max(1) as f64;
    let variance = (squares / spare).max(CLICK_RAD * CLICK_RAD);
    let sigma =
        |at: usize| (variance * (0..3).map(|i| covariance[(at + i, at + i)]).sum::<f64>() / 3.0).sqrt();
    let centre_sigma_m = if holds { 0.0 } else { sigma(3) };
    if centre_sigma_m > (most - least).length() || sigma(0) > VAGUE_RAD {
        return Err(undetermined());
    }
    Ok(Registered {
        centre_m: state.centre,
        map_from_model: state.turn,
        wrong: used.iter().map(|used| !used).collect(),
        turn_sigma_rad: sigma(0),
        centre_sigma_m,
        residuals_rad,
    })
}

#[derive(Clone, Copy)]
struct State {
    centre: DVec3,
    turn: DQuat,
}

impl State {
    /// The turn that fits best (Kabsch 1976) at a place.
    fn new(centre: DVec3, pairs: &[Pair], used: &[bool]) -> Self {
        let sum =
            pairs.iter().zip(used).filter(|(_, used)| **used).fold(Matrix3::zeros(), |sum, (pair, _)| {
                let (to, from) = (pair.direction, (pair.point_m - centre).normalize_or_zero());
                sum + Vector3::new(to.x, to.y, to.z) * Vector3::new(from.x, from.y, from.z).transpose()
            });
        let svd = sum.svd(true, true);
        let turn = match (svd.u, svd.v_t) {
            (Some(u), Some(v)) => {
                let mirrored =
                    Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
                let turn = u * mirrored * v;
                DQuat::from_mat3(&DMat3::from_cols_slice(turn.as_slice())).normalize()
            }
            _ => DQuat::IDENTITY,
        };
        Self { centre, turn }
    }

    fn error(&self, pair: &Pair) -> DVec3 {
        self.turn * (pair.point_m - self.centre).normalize_or_zero() - pair.direction
    }

    /// Normal equations: a small turn in the map's axes, then a shift of the place.
    fn normal(&self, pairs: &[Pair], used: &[bool], holds: bool) -> (Matrix6<f64>, Vector6<f64>) {
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for (pair, _) in pairs.iter().zip(used).filter(|(_, used)| **used) {
            let away = pair.point_m - self.centre;
            let from = away.normalize_or_zero();
            let seen = self.turn * from;
            let mut by = Matrix3x6::zeros();
            for (k, axis) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
                by.set_column(k, &Vector3::from(axis.cross(seen).to_array()));
                let moved = -(axis - from * from.dot(axis)) / away.length().max(1e-9);
                if !holds {
                    by.set_column(3 + k, &Vector3::from((self.turn * moved).to_array()));
                }
            }
            let error = Vector3::from(self.error(pair).to_array());
            normal += by.transpose() * by;
            right -= by.transpose() * error;
        }
        if holds {
            (3..6).for_each(|i| normal[(i, i)] = 1.0);
        }
        (normal, right)
    }

    /// Levenberg and Marquardt's way down.
    fn settled(mut self, pairs: &[Pair], used: &[bool], holds: bool) -> Option<Self> {
        let cost = |state: &Self| {
            pairs
                .iter()
                .zip(used)
                .filter(|(_, used)| **used)
                .map(|(pair, _)| state.error(pair).length_squared())
                .sum::<f64>()
        };
        let (mut damping, mut now) = (1e-3, cost(&self));
        for _ in 0..ROUNDS {
            let (mut normal, right) = self.normal(pairs, used, holds);
            (0..6).for_each(|i| normal[(i, i)] *= 1.0 + damping);
            let step = normal.cholesky()?.solve(&right);
            let next = Self {
                turn: (DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2])) * self.turn)
                    .normalize(),
                centre: self.centre + DVec3::new(step[3], step[4], step[5]),
            };
            let after = cost(&next);
            if after.is_finite() && after <= now {
                let is_settled = now - after <= 1e-12 * now;
                (self, now, damping) = (next, after, (0.2 * damping).max(1e-12));
                if is_settled {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e9 {
                    break;
                }
            }
        }
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    fn truth() -> State {
        State {
            centre: DVec3::new(0.4, 1.5, -0.3),
            turn: DQuat::from_scaled_axis(DVec3::new(0.3, 2.1, -0.4)),
        }
    }

    fn pairs(count: usize, noise_rad: f64, seed: u64) -> Vec<Pair> {
        let mut random = StdRng::seed_from_u64(seed);
        let mut point = |by: f64| DVec3::from_array(std::array::from_fn(|_| random.random_range(-by..=by)));
        (0..count)
            .map(|_| {
                let point_m = point(2.5) + DVec3::new(0.0, 1.2, 0.0);
                let exact = truth().turn * (point_m - truth().centre).normalize();
                Pair { point_m, direction: (exact + point(1.7 * noise_rad)).normalize() }
            })
            .collect()
    }

    #[test]
    fn place_and_turn_come_back_and_a_wrong_pair_is_named() {
        for seed in 0..8 {
            let mut pairs = pairs(8, 0.002, seed);
            let wrong = seed as usize;
            pairs[wrong].direction = DQuat::from_rotation_y(0.5) * pairs[wrong].direction;
            let found = register(&pairs, None).unwrap();
            assert!((0..8).all(|i| found.wrong[i] == (i == wrong)), "{seed}: {:?}", found.wrong);
            let (apart, turned) =
                (found.centre_m.distance(truth().centre), found.map_from_model.angle_between(truth().turn));
            assert!(apart < 0.03 && turned < 0.01, "{seed}: {apart} {turned}");
            assert!(
                apart < 5.0 * found.centre_sigma_m && found.centre_sigma_m < 0.03,
                "{}",
                found.centre_sigma_m
            );
            assert!(found.residuals_rad[wrong] > LEAST_WRONG_RAD && found.turn_sigma_rad < 0.02);
        }
        let exact = register(&pairs(5, 0.0, 1), None).unwrap();
        assert!(exact.centre_m.distance(truth().centre) < 1e-6 && exact.wrong.iter().all(|wrong| !wrong));
        let placed = register(&pairs(2, 0.0, 1), Some(truth().centre)).unwrap();
        assert!(
            placed.map_from_model.angle_between(truth().turn) < 1e-6 && placed.centre_m == truth().centre
        );
    }

    #[test]
    fn too_few_pairs_and_such_that_say_nothing_are_refused() {
        for (pairs, centre) in [
            (pairs(3, 0.0, 1), None),
            (pairs(1, 0.0, 1), Some(DVec3::ZERO)),
            (vec![pairs(1, 0.0, 1)[0]; 6], None),
            (vec![pairs(1, 0.0, 1)[0]; 6], Some(truth().centre)),
        ] {
            let message = register(&pairs, centre).unwrap_err().to_string();
            assert!(message.contains("; "), "{message}");
        }
    }
}

//! A tracker on the camera: what it says of every photograph, and what the photographs say of it.
//!
//! The camera at time t is turned as exp(drift(t)) T(t - delay) mount, T the tracker's path without jitter. Delay and mount come first from
//! turns between consecutive photographs, which do not know drift; then, with the drift, from all photographs once they are placed.

use glam::{DQuat, DVec3};
use nalgebra::{DMatrix, DVector};

use super::align::Prior;
use crate::geometry::world_from_camera;
use crate::tracker::Track;

mod fit;
mod pairs;

pub(super) use pairs::Pair;

/// What is known of a camera's delay before, seconds, and if the user states it.
pub(super) const DELAY_SIGMA_S: f64 = 0.1;
pub(super) const STATED_DELAY_SIGMA_S: f64 = 0.002;
/// What is known of how the receiver sits on the camera, about each axis, radians, and if the user states it.
const MOUNT_SIGMA_RAD: f64 = 0.09;
const STATED_MOUNT_SIGMA_RAD: f64 = 0.004;
/// How far a tracker drifts over a session, about each axis, radians.
const DRIFT_RAD: f64 = 0.035;
/// The drift bends this often, seconds, but not more often than so many times.
const BEND_S: f64 = 5.0;
const BENDS: f64 = 8.0;
/// A jump is over in twice this, seconds.
const JUMP_S: f64 = 0.005;
/// A delay that is not known better than this cannot be told, seconds.
const UNTOLD_S: f64 = 0.02;

/// A tracker's path and the photographs on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracked {
    /// The path.
    pub track: Track,
    /// When each photograph came, seconds by the tracker's clock, in the order of time.
    pub times_s: Vec<f64>,
    /// How long before that it was taken, seconds, if that is known.
    pub delay_s: Option<f64>,
    /// Takes the camera's axes (x right, y up, looking along -z) to the receiver's, if that is known.
    pub mount: Option<DQuat>,
    /// What the user should know of the records.
    pub notes: Vec<String>,
}

/// What photographs told of the tracker on their camera.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerFit {
    /// How long a photograph was taken before its time, seconds.
    pub delay_s: f64,
    /// Standard deviation of that, seconds.
    pub delay_sigma_s: f64,
    /// Takes the camera's axes (x right, y up, looking along -z) to the receiver's.
    pub mount: DQuat,
    /// Standard deviation of that, about each axis, radians.
    pub mount_sigma_rad: f64,
    /// How far the tracker's world turned over the session, at most, radians.
    pub drift_rad: f64,
    /// Jitter of a record about each axis, radians.
    pub noise_rad: f64,
}

/// Delay, mount and drift as they are known.
#[derive(Debug, Clone)]
pub(super) struct Known {
    delay_s: f64,
    /// Takes the camera frame (y down, z forward) to the receiver's axes.
    mount: DQuat,
    /// The drift bends here, seconds.
    bends_s: Vec<f64>,
    drift: Vec<DVec3>,
    /// Of delay, mount (camera frame, about each axis) and drift at every bend.
    covariance: DMatrix<f64>,
    /// Per photograph, how far the tracker was found off there, radians; 0 where it was not.
    off_rad: Vec<f64>,
}

impl Tracked {
    /// Before any photograph was looked at.
    pub(super) fn before(&self) -> Known {
        let times_s = (self.times_s.first(), self.times_s.last());
        let (first_s, last_s) = (times_s.0.copied().unwrap_or(0.0), times_s.1.copied().unwrap_or(0.0));
        let pieces = ((last_s - first_s) / BEND_S).floor().clamp(1.0, BENDS) as usize;
        let bend = |k: usize| first_s + (last_s - first_s) * k as f64 / pieces as f64;
        let mut bends_s: Vec<f64> = (0..=pieces).map(bend).collect();
        // What is not known of a jump is a step.
        let jumps = self.track.jumps.iter().flat_map(|jump| [-JUMP_S, JUMP_S].map(|by| jump.time_s + by));
        bends_s.extend(jumps.filter(|time_s| (first_s..last_s).contains(time_s)));
        bends_s.sort_by(f64::total_cmp);
        let mut covariance = DMatrix::zeros(4 + 3 * bends_s.len(), 4 + 3 * bends_s.len());
        covariance[(0, 0)] = self.delay_sigma_s().powi(2);
        (1..4).for_each(|i| covariance[(i, i)] = self.mount_sigma_rad().powi(2));
        // From the first on, by chance: a turn that all share is none.
        let mut variances = vec![0.0];
        bends_s
            .windows(2)
            .for_each(|pair| variances.push(variances[variances.len() - 1] + self.step_rad2(pair)));
        for (j, _) in variances.iter().enumerate() {
            for (k, _) in variances.iter().enumerate() {
                (0..3).for_each(|c| covariance[(4 + 3 * j + c, 4 + 3 * k + c)] = variances[j.min(k)]);
            }
        }
        Known {
            delay_s: self.delay_s.unwrap_or(0.0),
            mount: world_from_camera(self.mount.unwrap_or(DQuat::IDENTITY)),
            drift: vec![DVec3::ZERO; bends_s.len()],
            bends_s,
            covariance,
            off_rad: vec![0.0; self.times_s.len()],
        }
    }

    fn delay_sigma_s(&self) -> f64 {
        if self.delay_s.is_some() { STATED_DELAY_SIGMA_S } else { DELAY_SIGMA_S }
    }

    fn mount_sigma_rad(&self) -> f64 {
        if self.mount.is_some() { STATED_MOUNT_SIGMA_RAD } else { MOUNT_SIGMA_RAD }
    }

    /// The variance of the drift between two bends, about each axis: its share of the session's, and what jumps between them leave.
    fn step_rad2(&self, bends_s: &[f64]) -> f64 {
        let (first_s, last_s) = (self.times_s[0], self.times_s[self.times_s.len() - 1]);
        let share = (bends_s[1] - bends_s[0]) / (last_s - first_s).max(1e-9);
        let within = |time_s: f64| bends_s[0] <= time_s && time_s < bends_s[1];
        let jumps = self.track.jumps.iter().filter(|jump| within(jump.time_s));
        DRIFT_RAD * DRIFT_RAD * share.clamp(1e-6, 1.0) + jumps.map(|jump| jump.sigma_rad.powi(2)).sum::<f64>()
    }

    /// What the tracker says of a photograph, and how sure that is.
    pub(super) fn place(&self, photograph: usize, known: &Known) -> Prior {
        let taken_s = self.times_s[photograph] - known.delay_s;
        let at = self.track.at(taken_s);
        let bends = known.bends(taken_s);
        let turn = DQuat::from_scaled_axis(known.drift_at(bends)) * at.orientation * known.mount;
        let unsure = jacobian(known, turn, at.rate, bends);
        let variance = (&unsure * &known.covariance * unsure.transpose()).trace() / 3.0;
        let sigma_rad = (variance.max(0.0) + at.sigma_rad.powi(2)).sqrt().hypot(known.off_rad[photograph]);
        Prior { turn: turn.normalize(), sigma_rad }
    }

    /// What was found, in words that the user can use.
    pub(super) fn told(&self, known: &Known, names: &[String]) -> (TrackerFit, Vec<String>) {
        let mount_variance: f64 = (1..4).map(|i| known.covariance[(i, i)]).sum::<f64>() / 3.0;
        let apart = |a: &DVec3| known.drift.iter().map(|b| a.distance(*b)).fold(0.0, f64::max);
        let fit = TrackerFit {
            delay_s: known.delay_s,
            delay_sigma_s: known.covariance[(0, 0)].sqrt(),
            mount: known.mount * world_from_camera(DQuat::IDENTITY).inverse(),
            mount_sigma_rad: mount_variance.sqrt(),
            drift_rad: known.drift.iter().map(apart).fold(0.0, f64::max),
            noise_rad: self.track.noise_rad(),
        };
        let mut notes = self.notes.clone();
        if fit.delay_sigma_s > UNTOLD_S {
            notes.push(format!(
                "the camera's delay behind the tracker cannot be told from these photographs (they show too little, or the camera turned too \
                 evenly): {:.0} ± {:.0} ms stands, and is in the sigmas",
                1e3 * fit.delay_s,
                1e3 * fit.delay_sigma_s
            ));
        }
        let mut from = 0;
        while from < names.len() {
            let length = known.off_rad[from..].iter().take_while(|off| **off > 0.0).count();
            if length > 0 {
                let to = from + length;
                let most = known.off_rad[from..to].iter().fold(0f64, |a, b| a.max(*b)).to_degrees();
                let which = if length == 1 {
                    format!("at {}", names[from])
                } else {
                    format!("from {} to {}", names[from], names[to - 1])
                };
                notes.push(format!(
                    "{which} the tracker is up to {most:.1} degrees off what the other photographs and its own path say (is metal near it?): \
                     photographs decide where they show enough, and the sigmas are as large elsewhere"
                ));
            }
            from += length.max(1);
        }
        (fit, notes)
    }
}

/// The bends before and after a time, and the part of the latter.
type Between = (usize, usize, f64);

impl Known {
    fn bends(&self, time_s: f64) -> Between {
        let after = self.bends_s.partition_point(|bend| *bend <= time_s).clamp(1, self.bends_s.len() - 1);
        let (low, high) = (self.bends_s[after - 1], self.bends_s[after]);
        (after - 1, after, ((time_s - low) / (high - low).max(1e-9)).clamp(0.0, 1.0))
    }

    fn drift_at(&self, (before, after, part): Between) -> DVec3 {
        self.drift[before].lerp(self.drift[after], part)
    }
}

/// How the camera turns (in its frame) with delay, mount and drift.
fn jacobian(known: &Known, turn: DQuat, rate: DVec3, (before, after, part): Between) -> DMatrix<f64> {
    let mut by = DMatrix::zeros(3, 4 + 3 * known.bends_s.len());
    let delayed = -(known.mount.inverse() * rate);
    let back = turn.inverse();
    for c in 0..3 {
        by[(c, 0)] = delayed[c];
        by[(c, 1 + c)] = 1.0;
    }
    for (axis, unit) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
        let turned = back * unit;
        for c in 0..3 {
            by[(c, 4 + 3 * before + axis)] += (1.0 - part) * turned[c];
            by[(c, 4 + 3 * after + axis)] += part * turned[c];
        }
    }
    by
}

/// The rotation vectors by which photographs are off, as a column.
fn column(off: DVec3) -> DVector<f64> {
    DVector::from_column_slice(&off.to_array())
}

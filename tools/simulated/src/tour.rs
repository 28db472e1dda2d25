//! A camera that turns on the spot in a room, a tracker's receiver on it: photographs and records on one clock, and the truth.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use rigel::geometry::{Lens, world_from_camera};
use rigel::tracker::{orientation, rotation_vector};
use rigel::{Error, Result, file};
use rigel_protocol::Orientation;

/// Records per second.
const RATE_HZ: f64 = 60.0;
/// The session begins then, seconds since 1970.
const START_S: f64 = 1.7e9;
/// Records begin so long before the first photograph and end so long after the last, seconds.
const MARGIN_S: f64 = 1.0;

/// How a session goes.
#[derive(Debug, Clone, PartialEq)]
pub struct Tour {
    /// How long it takes, seconds.
    pub duration_s: f64,
    /// How often it goes around.
    pub laps: f64,
    /// How many photographs are taken, at equal intervals.
    pub photographs: usize,
    /// Of the camera; there is no blur.
    pub lens: Lens,
    /// White noise of the tracker about each axis, standard deviation, radians.
    pub jitter_rad: f64,
    /// The tracker's angles come in such steps, radians.
    pub step_rad: f64,
    /// A photograph was taken so long before its time, seconds.
    pub delay_s: f64,
    /// How far the tracker's world turns until the end, radians.
    pub drift_rad: f64,
    /// Takes the camera's axes (y up) to the receiver's.
    pub mount: DQuat,
    /// The share of the horizon, all heights, that is a white wall.
    pub bare: f64,
    /// Every second photograph is upside down.
    pub rolled: bool,
    /// What else is wrong with the tracker.
    pub faults: Vec<Fault>,
    /// Where noise and the room's texture are drawn from.
    pub seed: u64,
}

/// Something that is wrong with a tracker for a while, seconds from the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// It says its world turned by so much.
    Jump {
        /// From when.
        from_s: f64,
        /// Until when.
        to_s: f64,
        /// By how much, radians.
        by_rad: f64,
    },
    /// It says its world turned by so much in the middle, smoothly less before and after.
    Bend {
        /// From when.
        from_s: f64,
        /// Until when.
        to_s: f64,
        /// By how much, radians.
        by_rad: f64,
    },
    /// It says the same again and again.
    Freeze {
        /// From when.
        from_s: f64,
        /// Until when.
        to_s: f64,
    },
    /// It says nothing.
    Silence {
        /// From when.
        from_s: f64,
        /// Until when.
        to_s: f64,
    },
}

impl Default for Tour {
    /// 60 photographs of 67 degrees in 40 s, twice around; jitter of 0.75 degrees in steps of 0.1, a delay of 80 ms, a drift of 2 degrees and a
    /// receiver that sits 7 degrees askew.
    fn default() -> Self {
        let askew = DVec3::new(0.6, -0.5, 0.62).normalize() * 7f64.to_radians();
        Self {
            duration_s: 40.0,
            laps: 2.0,
            photographs: 60,
            lens: Lens::pinhole(320, 240, 240.0),
            jitter_rad: 0.75f64.to_radians(),
            step_rad: 0.1f64.to_radians(),
            delay_s: 0.08,
            drift_rad: 2f64.to_radians(),
            mount: DQuat::from_scaled_axis(askew),
            bare: 0.0,
            rolled: false,
            faults: vec![],
            seed: 1,
        }
    }
}

impl Tour {
    /// How the camera (x right, y up, looking along -z) is turned so many seconds after the start.
    pub fn camera(&self, time_s: f64) -> DQuat {
        let t = time_s;
        let around = TAU * t / self.duration_s;
        // Hands: two speeds at once, and never quite level.
        let azimuth = -self.laps * around + 0.25 * (1.9 * t + 0.4).sin();
        let height = 0.6 * (3.0 * around).sin() + 0.08 * (2.3 * t).sin();
        let roll = 0.1 * (1.1 * t).sin();
        DQuat::from_rotation_y(azimuth) * DQuat::from_rotation_x(height) * DQuat::from_rotation_z(roll)
    }

    /// When each photograph comes, seconds from the start.
    pub fn times_s(&self) -> Vec<f64> {
        let last = self.photographs.saturating_sub(1).max(1) as f64;
        (0..self.photographs).map(|i| self.duration_s * i as f64 / last).collect()
    }

    /// How each photograph was turned: camera frame to the world.
    pub fn truth(&self) -> Vec<DQuat> {
        let turn = |(i, time_s): (usize, f64)| {
            let roll = DQuat::from_rotation_z(if self.rolled && i % 2 == 1 { TAU / 2.0 } else { 0.0 });
            world_from_camera(self.camera(time_s - self.delay_s) * roll)
        };
        self.times_s().into_iter().enumerate().map(turn).collect()
    }

    /// What the tracker says: seconds from the start, receiver's axes to the world's. Whoever rolls the camera rolls the receiver.
    pub fn records(&self) -> Vec<(f64, DQuat)> {
        let mut random = StdRng::seed_from_u64(self.seed);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let count = ((self.duration_s + 2.0 * MARGIN_S) * RATE_HZ) as usize;
        let mut said = DQuat::IDENTITY;
        let mut all = vec![];
        for k in 0..count {
            let time_s = k as f64 / RATE_HZ - MARGIN_S;
            let part = (time_s / self.duration_s).clamp(0.0, 1.0);
            let mut world = DVec3::new(0.5, 0.7, -0.5) * self.drift_rad * (TAU / 4.0 * part).sin();
            let (mut is_stuck, mut is_silent) = (false, false);
            for fault in &self.faults {
                let axis = DVec3::new(0.48, 0.6, 0.64);
                let within = |from_s: f64, to_s: f64| (from_s..to_s).contains(&time_s);
                match *fault {
                    Fault::Jump { from_s, to_s, by_rad } if within(from_s, to_s) => world += axis * by_rad,
                    Fault::Bend { from_s, to_s, by_rad } if within(from_s, to_s) => {
                        let part = (time_s - from_s) / (to_s - from_s);
                        world += axis * by_rad * (TAU / 2.0 * part).sin().powi(2);
                    }
                    Fault::Freeze { from_s, to_s } => is_stuck |= within(from_s, to_s),
                    Fault::Silence { from_s, to_s } => is_silent |= within(from_s, to_s),
                    _ => (),
                }
            }
            let jitter = DVec3::new(normal(), normal(), normal()) * self.jitter_rad;
            if !is_stuck {
                let roll = self.roll_at(time_s + self.delay_s);
                let turn = DQuat::from_scaled_axis(world) * self.camera(time_s) * roll * self.mount.inverse();
                said = self.in_steps(turn * DQuat::from_scaled_axis(jitter));
            }
            if !is_silent {
                all.push((time_s, said));
            }
        }
        all
    }

    /// How the camera is rolled about its axis beside [`Self::camera`]: over within a tenth of the pause between photographs.
    fn roll_at(&self, time_s: f64) -> DQuat {
        if !self.rolled {
            return DQuat::IDENTITY;
        }
        let pause_s = self.duration_s / self.photographs.saturating_sub(1).max(1) as f64;
        let at = time_s / pause_s;
        let ease = |x: f64| x * x * x * (x * (6.0 * x - 15.0) + 10.0);
        let (whole, part) = (at.floor(), ease(((at - at.floor()) * 1.4 - 0.2).clamp(0.0, 1.0)));
        let odd = whole.rem_euclid(2.0);
        DQuat::from_rotation_z(TAU / 2.0 * (odd + part * (1.0 - 2.0 * odd)))
    }

    /// An orientation as the tracker's rounded angles say it.
    fn in_steps(&self, turn: DQuat) -> DQuat {
        if self.step_rad <= 0.0 {
            return turn;
        }
        // World x, y, z is the tracker's Y, -Z, -X.
        let axis = DVec3::new(-turn.z, turn.x, -turn.y);
        let (azimuth, elevation, roll) =
            DQuat::from_xyzw(axis.x, axis.y, axis.z, turn.w).to_euler(glam::EulerRot::ZYX);
        let angles = [azimuth, elevation, roll]
            .map(|angle| ((angle / self.step_rad).round() * self.step_rad.to_degrees() * 1e3).round() as i32);
        orientation(&Orientation::Euler(angles)).unwrap_or(turn)
    }

    /// Radiance from a direction of the world, 0.1 to 0.7.
    pub fn radiance(&self, direction: DVec3) -> f64 {
        let azimuth = direction.x.atan2(direction.z) / TAU + 0.5;
        // The wall begins within two degrees, without an edge that is a corner.
        let wall = ((self.bare - azimuth) * 180.0).clamp(0.0, 1.0) * (azimuth * 180.0).clamp(0.0, 1.0);
        let contrast = if self.bare >= 1.0 { 0.0 } else { 1.0 - wall };
        let spots: f64 = [0.3, 0.1, 0.04].into_iter().map(|size| self.spot(direction / size)).sum();
        0.4 + 0.2 * contrast * spots
    }

    /// Random values on a lattice, linear between, -0.5 to 0.5.
    fn spot(&self, at: DVec3) -> f64 {
        let (low, part) = (at.floor(), at - at.floor());
        let value = |step: [i64; 3]| {
            let mut hash = self.seed;
            for (i, corner) in step.into_iter().enumerate() {
                let cell = (low[i] as i64 + corner) as u64;
                hash = (hash ^ cell.wrapping_mul(0x9e37_79b9_7f4a_7c15)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                hash ^= hash >> 29;
            }
            (hash >> 40) as f64 / (1u64 << 24) as f64 - 0.5
        };
        let corner = |k: i64| {
            let step = [k & 1, k >> 1 & 1, k >> 2];
            let weight = |i: usize| if step[i] == 1 { part[i] } else { 1.0 - part[i] };
            weight(0) * weight(1) * weight(2) * value(step)
        };
        (0..8).map(corner).sum()
    }

    /// Writes `frames.csv` (`file,time_s`), the photographs, and `tracker.jsonl` as a capture writes it.
    ///
    /// # Errors
    /// [`Error::Io`] where a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let mut table = String::from("file,time_s\n");
        for (i, time_s) in self.times_s().iter().enumerate() {
            let _ = writeln!(table, "{i:03}.png,{:.6}", START_S + time_s);
        }
        file::write_bytes(&folder.join("frames.csv"), table.as_bytes())?;
        let mut lines = String::new();
        for (count, (time_s, q)) in self.records().into_iter().enumerate() {
            let _ = writeln!(
                lines,
                r#"{{"at_s":{:.6},"bound_s":0.001,"count":{count},"station":1,"status":32,"position_m":[0.3,0.1,-0.4],"orientation":[{},{},{},{}]}}"#,
                START_S + time_s,
                q.w,
                q.x,
                q.y,
                q.z
            );
        }
        file::write_bytes(&folder.join("tracker.jsonl"), lines.as_bytes())?;
        self.truth().into_par_iter().enumerate().try_for_each(|(i, turn)| {
            let path = folder.join(format!("{i:03}.png"));
            let pixel = |x: u32, y: u32| {
                let ray = self.lens.unproject(DVec2::new(f64::from(x), f64::from(y)));
                let level = self.radiance(turn * ray.unwrap_or(DVec3::Z));
                image::Rgb(
                    [1.0, 0.8, 0.6].map(|c| (255.0 * (1.055 * (c * level).powf(1.0 / 2.4) - 0.055)) as u8),
                )
            };
            image::RgbImage::from_fn(self.lens.width, self.lens.height, pixel)
                .save(&path)
                .map_err(|error| Error::io("write", &path)(std::io::Error::other(error)))
        })
    }
}

/// How far orientations are off the truth, rotation vectors, after the one common turn that makes them best: nobody can see that one.
pub fn apart(found: &[DQuat], truth: &[DQuat]) -> Vec<DVec3> {
    let off = |common: DQuat| -> Vec<DVec3> {
        found
            .iter()
            .zip(truth)
            .map(|(found, truth)| rotation_vector(*truth * (common * *found).inverse()))
            .collect()
    };
    let Some((first, truly)) = found.first().zip(truth.first()) else { return vec![] };
    let mut common = *truly * first.inverse();
    for _ in 0..10 {
        let all = off(common);
        common = DQuat::from_scaled_axis(all.iter().sum::<DVec3>() / all.len() as f64) * common;
    }
    off(common)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tracker_without_faults_says_how_the_camera_is_turned() {
        let tour = Tour { jitter_rad: 0.0, drift_rad: 0.0, ..Tour::default() };
        for (time_s, said) in tour.records() {
            let truth = tour.camera(time_s) * tour.mount.inverse();
            // Half a step about each of three axes that are not square to each other.
            assert!(rotation_vector(truth.inverse() * said).length() < 1.5 * tour.step_rad, "{time_s}");
        }
    }

    #[test]
    fn rolled_photographs_are_upside_down_when_they_are_taken() {
        let tour = Tour { rolled: true, jitter_rad: 0.0, step_rad: 0.0, drift_rad: 0.0, ..Tour::default() };
        for (i, time_s) in tour.times_s().into_iter().enumerate() {
            let there = tour.camera(time_s - tour.delay_s) * tour.roll_at(time_s);
            assert!(world_from_camera(there).angle_between(tour.truth()[i]) < 1e-6, "{i}");
        }
    }

    #[test]
    fn a_common_turn_is_no_error() {
        let truth = Tour::default().truth();
        let turned: Vec<DQuat> = truth.iter().map(|turn| DQuat::from_rotation_x(0.7) * *turn).collect();
        assert!(apart(&turned, &truth).iter().all(|off| off.length() < 1e-9));
    }
}

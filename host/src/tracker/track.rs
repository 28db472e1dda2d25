//! A tracker's whole path: what it said, looked through for stretches that cannot be true, and smoothed.

use glam::{DQuat, DVec3};

use super::smooth::{Smooth, State, rotation_vector, roughness_rad};
use crate::{Error, Result};

/// The fewest records.
const FEWEST: usize = 16;
/// Who says exactly the same for so long is not alive, seconds: a tracker has noise.
const FROZEN_S: f64 = 0.25;
/// Records on either side of a jump from which its size is told.
const BESIDE: usize = 6;
/// No smaller step is called a jump, radians, nor one of so few standard deviations of a record.
const LEAST_JUMP_RAD: f64 = 0.05;
const LEAST_JUMP: f64 = 7.0;
/// Intervals so much longer than usual are gaps.
const GAP_INTERVALS: f64 = 3.0;

/// What a tracker said over a session.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    smooth: Smooth,
    first_s: f64,
    last_s: f64,
    /// How many records there were.
    pub records: usize,
    /// Where it stepped, while the receiver cannot have: near metal, most often. The path goes on as if the step had not been.
    pub jumps: Vec<Jump>,
    /// From when to when it said exactly the same: the path there is what lies before and after.
    pub frozen_s: Vec<(f64, f64)>,
}

/// A step of the tracker, not of the receiver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jump {
    /// When, seconds.
    pub time_s: f64,
    /// How far, radians.
    pub size_rad: f64,
    /// How sure that is, about each axis, radians; the path after it is so much less sure.
    pub sigma_rad: f64,
}

/// How the receiver is turned at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turned {
    /// Takes the receiver's axes to the world's.
    pub orientation: DQuat,
    /// Angular velocity in the receiver's axes, radians per second.
    pub rate: DVec3,
    /// Standard deviation of the orientation about each axis, radians: jitter that is left, and gaps; not drift.
    pub sigma_rad: f64,
}

impl Track {
    /// Of records: seconds on the host's clock, and what the tracker said, in the world's frame. Smoothed without lag by Rauch, Tung and
    /// Striebel's smoother ("Maximum likelihood estimates of linear dynamic systems", AIAA Journal 1965) on rotations; how much, the
    /// records decide.
    ///
    /// # Errors
    /// [`Error::Request`] where there are fewer than 16 records, or one is earlier than the one before.
    pub fn new(records: &[(f64, DQuat)]) -> Result<Self> {
        if records.len() < FEWEST {
            return Err(Error::request(
                format!("{} records of a tracker", records.len()),
                format!("give at least {FEWEST}, over all the time in which photographs were taken"),
            ));
        }
        if let Some(k) = (1..records.len()).find(|&k| records[k].0 < records[k - 1].0) {
            return Err(Error::request(
                format!(
                    "record {} is of {:.4} s, the one before of {:.4} s",
                    k + 1,
                    records[k].0,
                    records[k - 1].0
                ),
                "give records in the order of time, by one clock",
            ));
        }
        let (mut alive, frozen_s) = thaw(records);
        if alive.len() < FEWEST {
            return Err(Error::request(
                format!(
                    "a tracker that says the same in {} of {} records",
                    records.len() - alive.len(),
                    records.len()
                ),
                "check that its receiver is plugged in and near enough",
            ));
        }
        let jumps = stitch(&mut alive);
        let last_s = records[records.len() - 1].0;
        Ok(Self {
            smooth: Smooth::new(&alive),
            first_s: records[0].0,
            last_s,
            records: records.len(),
            jumps,
            frozen_s,
        })
    }

    /// How the receiver is turned at a time; the sigma grows in gaps and outside the records.
    pub fn at(&self, time_s: f64) -> Turned {
        let State { turn, rate, variance } = self.smooth.at(time_s);
        Turned { orientation: turn, rate, sigma_rad: variance[0].sqrt() }
    }

    /// Noise of a record about each axis, radians.
    pub fn noise_rad(&self) -> f64 {
        self.smooth.noise_rad
    }

    /// How many records lie far beside the path, and were left out.
    pub fn outliers(&self) -> usize {
        self.smooth.outliers
    }

    /// The first and the last record's time, seconds.
    pub fn span_s(&self) -> (f64, f64) {
        (self.first_s, self.last_s)
    }
}

/// When, and what.
type Said = (f64, DQuat);

/// The records without those that only repeat what was said, and where that was.
fn thaw(records: &[Said]) -> (Vec<Said>, Vec<(f64, f64)>) {
    let (mut alive, mut frozen) = (vec![], vec![]);
    for same in records.chunk_by(|a, b| a.1 == b.1) {
        let (first, last) = (same[0], same[same.len() - 1]);
        if same.len() > 2 && last.0 - first.0 >= FROZEN_S {
            alive.push(first);
            frozen.push((first.0, last.0));
        } else {
            alive.extend_from_slice(same);
        }
    }
    (alive, frozen)
}

/// Takes steps out that only one interval has: the same speed before and after, another orientation.
fn stitch(records: &mut [(f64, DQuat)]) -> Vec<Jump> {
    let noise = roughness_rad(records).max(1e-4);
    let mut intervals_s: Vec<f64> = records.windows(2).map(|r| r[1].0 - r[0].0).collect();
    let longest_s = {
        let mut sorted = intervals_s.clone();
        sorted.sort_by(f64::total_cmp);
        GAP_INTERVALS * sorted[sorted.len() / 2]
    };
    intervals_s.push(f64::INFINITY);
    let step = |records: &[(f64, DQuat)], k: usize| -> Option<(DVec3, f64)> {
        let from = k.checked_sub(BESIDE)?;
        let around = records.get(from..k + BESIDE)?;
        if intervals_s[from..k + BESIDE - 1].iter().any(|&pause| pause > longest_s) {
            return None;
        }
        let middle = records[k - 1].1;
        let centre_s = (records[k - 1].0 + records[k].0) / 2.0;
        let at: Vec<DVec3> = around.iter().map(|r| rotation_vector(middle.inverse() * r.1)).collect();
        let time: Vec<f64> = around.iter().map(|r| r.0 - centre_s).collect();
        // One speed on both sides: the step is what the two means differ by more than it.
        let mean = |values: &[DVec3]| values.iter().sum::<DVec3>() / BESIDE as f64;
        let mean_s = |values: &[f64]| values.iter().sum::<f64>() / BESIDE as f64;
        let (low, high) = (mean(&at[..BESIDE]), mean(&at[BESIDE..]));
        let (early_s, late_s) = (mean_s(&time[..BESIDE]), mean_s(&time[BESIDE..]));
        let (mut along, mut squares) = (DVec3::ZERO, 0.0);
        for (i, (at, time)) in at.iter().zip(&time).enumerate() {
            let (mean, mean_s) = if i < BESIDE { (low, early_s) } else { (high, late_s) };
            along += (*at - mean) * (time - mean_s);
            squares += (time - mean_s) * (time - mean_s);
        }
        let speed = along / squares.max(1e-12);
        let step = high - low - speed * (late_s - early_s);
        let left = at.iter().zip(&time).enumerate().map(|(i, (at, time))| {
            let (mean, mean_s) = if i < BESIDE { (low, early_s) } else { (high, late_s) };
            (*at - mean - speed * (time - mean_s)).length_squared()
        });
        let left = (left.sum::<f64>() / (3.0 * (2 * BESIDE) as f64 - 9.0)).sqrt();
        // What a hand does fast is smooth, and leaves much more than noise beside such a step.
        let clear = step.length() > LEAST_JUMP_RAD.max(LEAST_JUMP * noise)
            && left < (2.5 * noise).max(step.length() / 25.0);
        clear.then_some((step, left))
    };
    let said = records.to_vec();
    let mut jumps = vec![];
    let mut k = BESIDE;
    while k + BESIDE <= said.len() {
        let size = |k: usize| step(&said, k).map_or(0.0, |(step, _)| step.length());
        let here = size(k);
        if here > 0.0 && (k + 1..k + 4).all(|next| size(next) <= here) {
            let (by, left) = step(&said, k).unwrap_or_default();
            // In the axes of the receiver before it, so in the world's: the orientation before, turned back.
            let before = said[k - 1].1;
            let back = before * DQuat::from_scaled_axis(by).inverse() * before.inverse();
            // What came before the jump is corrected already; the step lies in the uncorrected world.
            let corrected = records[k - 1].1 * before.inverse();
            let whole = corrected * back;
            for (now, said) in records[k..].iter_mut().zip(&said[k..]) {
                now.1 = (whole * said.1).normalize();
            }
            // Two means of six and a slope: 1.2 of a record's noise.
            jumps.push(Jump { time_s: said[k].0, size_rad: by.length(), sigma_rad: 1.2 * left.max(noise) });
            k += BESIDE;
        } else {
            k += 1;
        }
    }
    jumps
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    fn truth(time_s: f64) -> DQuat {
        DQuat::from_rotation_y(0.5 * time_s + 0.3 * (1.7 * time_s).sin())
            * DQuat::from_rotation_x(0.5 * (0.6 * time_s).sin())
    }

    fn records(noise_rad: f64, seed: u64) -> Vec<(f64, DQuat)> {
        let mut random = StdRng::seed_from_u64(seed);
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let record = |k: u32| {
            let off = DVec3::new(normal(), normal(), normal()) * noise_rad;
            (f64::from(k) / 60.0, truth(f64::from(k) / 60.0) * DQuat::from_scaled_axis(off))
        };
        (0..1200).map(record).collect()
    }

    fn off_rad(track: &Track, time_s: f64) -> f64 {
        rotation_vector(truth(time_s).inverse() * track.at(time_s).orientation).length()
    }

    #[test]
    fn a_jump_and_the_jump_back_are_found_and_taken_out() {
        for noise in [0.0005, 0.013] {
            let mut wrong = records(noise, 3);
            let metal = DQuat::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 0.2);
            wrong.iter_mut().filter(|r| (7.0..9.0).contains(&r.0)).for_each(|r| r.1 = metal * r.1);
            let track = Track::new(&wrong).unwrap();
            assert_eq!(track.jumps.len(), 2, "{:?}", track.jumps);
            for (jump, at_s) in track.jumps.iter().zip([7.0, 9.0]) {
                assert!((jump.time_s - at_s).abs() < 0.06, "{jump:?}");
                assert!((jump.size_rad - 0.2).abs() < 3.0 * 2.0 * jump.sigma_rad, "{jump:?}");
            }
            // Off by what the sizes of two jumps are not known.
            assert!(off_rad(&track, 8.0) < 5.0 * track.jumps[0].sigma_rad, "{}", off_rad(&track, 8.0));
            assert!(off_rad(&track, 12.0) < 8.0 * track.jumps[0].sigma_rad, "{}", off_rad(&track, 12.0));
        }
    }

    #[test]
    fn a_hand_that_turns_fast_does_not_jump() {
        // Eighty degrees in a fifth of a second, and back.
        let flick =
            |s: f64| 1.4 / (1.0 + (-(s - 5.0) / 0.03).exp()) - 1.4 / (1.0 + (-(s - 9.0) / 0.03).exp());
        for noise in [0.0005, 0.013] {
            let mut fast = records(noise, 5);
            fast.iter_mut().for_each(|r| r.1 = DQuat::from_rotation_y(flick(r.0)) * r.1);
            let track = Track::new(&fast).unwrap();
            assert!(track.jumps.is_empty(), "{noise}: {:?}", track.jumps);
        }
        assert!(Track::new(&records(0.013, 9)).unwrap().jumps.is_empty());
    }

    #[test]
    fn a_frozen_stretch_is_found_bridged_and_less_sure() {
        let mut wrong = records(0.013, 4);
        let stuck = wrong[420].1;
        wrong[420..480].iter_mut().for_each(|r| r.1 = stuck);
        let track = Track::new(&wrong).unwrap();
        assert_eq!(track.frozen_s.len(), 1);
        assert!((track.frozen_s[0].0 - 7.0).abs() < 0.02 && (track.frozen_s[0].1 - 7.983).abs() < 0.02);
        let (there, beside) = (track.at(7.5), track.at(6.0));
        assert!(there.sigma_rad > 3.0 * beside.sigma_rad);
        assert!(off_rad(&track, 7.5) < 3.0 * 3f64.sqrt() * there.sigma_rad);
    }

    #[test]
    fn what_is_no_path_is_refused() {
        let good = records(0.01, 1);
        assert!(Track::new(&good[..10]).unwrap_err().to_string().contains("10 records"));
        let mut wrong = good.clone();
        wrong[700].0 -= 1.0;
        assert!(Track::new(&wrong).unwrap_err().to_string().contains("record 701"));
        let stuck: Vec<(f64, DQuat)> = good.iter().map(|r| (r.0, DQuat::IDENTITY)).collect();
        assert!(Track::new(&stuck).unwrap_err().to_string().contains("says the same"));
    }
}

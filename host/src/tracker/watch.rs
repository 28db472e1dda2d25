//! How good a tracker's records are: rate, noise, gaps.

use std::collections::VecDeque;
use std::time::SystemTime;

use super::TrackerRecord;

/// How many records of a station the figures are taken over: four seconds of one receiver.
const WINDOW: usize = 240;
/// A record that comes later than so many usual intervals after the one before it leaves a gap.
const GAP_INTERVALS: f64 = 1.5;

/// Looks at records as they come.
#[derive(Debug, Default, Clone)]
pub struct Watch {
    last_count: Option<u32>,
    lost: u64,
    restarts: u64,
    stations: [Station; 2],
}

#[derive(Debug, Default, Clone)]
struct Station {
    records: u64,
    /// Records whose stamp was not after the one before.
    backwards: u64,
    same_since: Option<SystemTime>,
    window: VecDeque<TrackerRecord>,
}

/// How good the records are.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Records that were lost between rig and host, from jumps of the count.
    pub lost: u64,
    /// How often the count began again: the tracker was started anew.
    pub restarts: u64,
    /// Each station that was heard.
    pub stations: Vec<StationSummary>,
}

/// How good one station's records are, over its last 240; 0 where there are too few to tell.
#[derive(Debug, Clone, PartialEq)]
pub struct StationSummary {
    /// The receiver: 1 or 2.
    pub station: u8,
    /// How many records came in all.
    pub records: u64,
    /// Records per second, gaps left out.
    pub rate_hz: f64,
    /// Noise of a coordinate, RMS, metres: motion that is smooth does not count.
    pub position_noise_m: f64,
    /// Noise of the angle about an axis, RMS, radians.
    pub angle_noise_rad: f64,
    /// How many pauses in the window are longer than one and a half usual intervals.
    pub gaps: usize,
    /// The longest interval in the window, seconds.
    pub longest_gap_s: f64,
    /// How many stamps in all were not later than the one before.
    pub backwards: u64,
    /// For how long the pose has been exactly the same, seconds: a live tracker has noise.
    pub same_pose_s: f64,
    /// The last record.
    pub last: TrackerRecord,
}

impl Watch {
    /// Takes a record of station 1 or 2; others are not counted.
    pub fn push(&mut self, record: &TrackerRecord) {
        let Some(station) = usize::from(record.station).checked_sub(1).and_then(|i| self.stations.get_mut(i))
        else {
            return;
        };
        if let Some(last) = self.last_count {
            if record.count > last {
                self.lost += u64::from(record.count - last - 1);
            } else {
                self.restarts += 1;
            }
        }
        self.last_count = Some(record.count);
        station.push(*record);
    }

    /// How good they were so far.
    pub fn summary(&self) -> Summary {
        let stations = self.stations.iter().filter_map(Station::summary).collect();
        Summary { lost: self.lost, restarts: self.restarts, stations }
    }
}

impl Station {
    fn push(&mut self, record: TrackerRecord) {
        self.records += 1;
        let mut same = false;
        if let Some(last) = self.window.back() {
            self.backwards += u64::from(record.at <= last.at);
            same = last.position_m == record.position_m && last.orientation == record.orientation;
        }
        if !same {
            self.same_since = Some(record.at);
        }
        if self.window.len() == WINDOW {
            self.window.pop_front();
        }
        self.window.push_back(record);
    }

    fn summary(&self) -> Option<StationSummary> {
        let last = *self.window.back()?;
        let records: Vec<&TrackerRecord> = self.window.iter().collect();
        let intervals_s: Vec<f64> = records.windows(2).map(|r| seconds(r[0].at, r[1].at)).collect();
        let usual_s = median(&intervals_s);
        let longest_s = GAP_INTERVALS * usual_s;
        let even: Vec<f64> = intervals_s.iter().copied().filter(|&s| s <= longest_s).collect();
        let span_s: f64 = even.iter().sum();
        // Second differences see neither the place nor the speed; independent noise makes them √6 times as large.
        let (mut moved, mut turned, mut count) = (0.0, 0.0, 0.0);
        for (triple, pauses) in records.windows(3).zip(intervals_s.windows(2)) {
            let [a, b, c] = [triple[0], triple[1], triple[2]];
            if pauses.iter().any(|&pause| pause > longest_s) {
                continue;
            }
            moved += (a.position_m - 2.0 * b.position_m + c.position_m).length_squared();
            let turn = |from: &TrackerRecord, to: &TrackerRecord| {
                let between = from.orientation.inverse() * to.orientation;
                // q and -q are one orientation: the short way round.
                if between.w < 0.0 { (-between).to_scaled_axis() } else { between.to_scaled_axis() }
            };
            turned += (turn(b, c) - turn(a, b)).length_squared();
            count += 3.0;
        }
        let rms = |squares: f64| if count > 0.0 { (squares / count / 6.0).sqrt() } else { 0.0 };
        Some(StationSummary {
            station: last.station,
            records: self.records,
            rate_hz: if span_s > 0.0 { even.len() as f64 / span_s } else { 0.0 },
            position_noise_m: rms(moved),
            angle_noise_rad: rms(turned),
            gaps: intervals_s.len() - even.len(),
            longest_gap_s: intervals_s.iter().copied().fold(0.0, f64::max),
            backwards: self.backwards,
            same_pose_s: self.same_since.map_or(0.0, |since| seconds(since, last.at)),
            last,
        })
    }
}

fn seconds(from: SystemTime, to: SystemTime) -> f64 {
    match to.duration_since(from) {
        Ok(later) => later.as_secs_f64(),
        Err(earlier) => -earlier.duration().as_secs_f64(),
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use glam::{DQuat, DVec3};
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    /// Sixty records per second that move and turn, with noise of these sizes.
    fn records(count: u32, position_noise_m: f64, angle_noise_rad: f64) -> Vec<TrackerRecord> {
        let mut random = StdRng::seed_from_u64(4);
        let mut normal = || {
            DVec3::from_array(std::array::from_fn(|_| {
                (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
            }))
        };
        let record = |count: u32| {
            let s = f64::from(count) / 60.0;
            let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 0.8 * s);
            TrackerRecord {
                at: SystemTime::UNIX_EPOCH + Duration::from_secs_f64(s),
                bound_s: 0.001,
                count,
                station: 1,
                status: b' ',
                position_m: DVec3::new(0.4 * s, 0.2 * s.sin(), -0.3 * s.cos()) + normal() * position_noise_m,
                orientation: turn * DQuat::from_scaled_axis(normal() * angle_noise_rad),
            }
        };
        (0..count).map(record).collect()
    }

    fn watched<'a>(records: impl IntoIterator<Item = &'a TrackerRecord>) -> Summary {
        let mut watch = Watch::default();
        records.into_iter().for_each(|record| watch.push(record));
        watch.summary()
    }

    #[test]
    fn noise_is_found_under_motion() {
        for (position_noise_m, angle_noise_rad) in [(1e-4, 1e-3), (5e-4, 2e-4)] {
            let mut records = records(200, position_noise_m, angle_noise_rad);
            // The sign of a quaternion means nothing.
            records.iter_mut().step_by(3).for_each(|r| r.orientation = -r.orientation);
            let summary = watched(&records);
            let station = &summary.stations[0];
            assert!((station.position_noise_m / position_noise_m - 1.0).abs() < 0.15, "{summary:?}");
            assert!((station.angle_noise_rad / angle_noise_rad - 1.0).abs() < 0.15, "{summary:?}");
            assert!((station.rate_hz - 60.0).abs() < 0.01);
            assert_eq!((summary.lost, summary.restarts, station.gaps, station.backwards), (0, 0, 0, 0));
        }
    }

    #[test]
    fn gaps_are_counted_and_change_neither_rate_nor_noise() {
        let all = records(200, 1e-4, 1e-3);
        let summary = watched(all.iter().filter(|r| !(50..60).contains(&r.count) && r.count != 120));
        let station = &summary.stations[0];
        assert_eq!((summary.lost, station.gaps), (11, 2));
        assert!((station.longest_gap_s - 11.0 / 60.0).abs() < 1e-6);
        assert!((station.rate_hz - 60.0).abs() < 0.01);
        assert!((station.position_noise_m / 1e-4 - 1.0).abs() < 0.15);
    }

    #[test]
    fn a_pose_that_never_changes_and_stamps_that_go_back_show() {
        let mut records = records(120, 1e-4, 1e-3);
        let stuck = records[59];
        for record in &mut records[60..] {
            (record.position_m, record.orientation) = (stuck.position_m, stuck.orientation);
        }
        assert!((watched(&records).stations[0].same_pose_s - 1.0).abs() < 1e-6);
        records[30].at = records[28].at;
        let summary = watched(&records);
        assert_eq!(summary.stations[0].backwards, 1);
    }

    #[test]
    fn two_stations_are_told_apart_and_a_new_start_is_no_loss() {
        let mut records = records(100, 1e-4, 1e-3);
        records.iter_mut().step_by(2).for_each(|r| r.station = 2);
        let again: Vec<_> =
            records.iter().map(|r| TrackerRecord { at: r.at + Duration::from_secs(9), ..*r }).collect();
        let summary = watched(records.iter().chain(&again));
        assert_eq!((summary.lost, summary.restarts, summary.stations.len()), (0, 1, 2));
        assert!(summary.stations.iter().all(|s| (s.rate_hz - 30.0).abs() < 0.1 && s.records == 100));
        assert_eq!(watched(&[]).stations, []);
    }
}

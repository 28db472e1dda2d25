//! What good records say about the tracker when they are looked at together.

use rigel_protocol::{Orientation, Record};

/// A live tracker has noise: the very same pose for so long is no measurement.
const STUCK_US: u64 = 5_000_000;
/// A station that says nothing for so long while the tracker runs is missing.
const MISSING_US: u64 = 1_000_000;

/// Looks for a station that is stuck or missing; each is found once until it recovers.
pub(super) struct Watch {
    stations: [Station; 2],
}

#[derive(Clone, Copy)]
struct Station {
    pose: Option<([i32; 3], Orientation)>,
    since_us: u64,
    heard_us: u64,
    stuck: bool,
    missing: bool,
}

impl Watch {
    pub(super) const fn new() -> Self {
        let station = Station { pose: None, since_us: 0, heard_us: 0, stuck: false, missing: false };
        Self { stations: [station; 2] }
    }

    pub(super) fn push(&mut self, record: &Record) {
        let [first, second] = &mut self.stations;
        let station = if record.station == 2 { second } else { first };
        let pose = Some((record.position_um, record.orientation));
        if station.pose != pose {
            *station = Station { pose, since_us: record.at_us, ..*station };
            station.stuck = false;
        }
        station.heard_us = record.at_us;
        station.missing = false;
    }

    /// Something that was not said before, of the first stations; a station that was never heard is not missed.
    pub(super) fn finding(&mut self, stations: u8, now_us: u64) -> Option<&'static str> {
        let texts = [
            [
                "tracker: station 1 says the same pose for 5 s: stuck?",
                "tracker: station 1 is not heard any more",
            ],
            [
                "tracker: station 2 says the same pose for 5 s: stuck?",
                "tracker: station 2 is not heard any more",
            ],
        ];
        for (station, [stuck, missing]) in self.stations.iter_mut().zip(texts).take(usize::from(stations)) {
            if station.pose.is_none() {
                continue;
            }
            if !station.stuck && station.heard_us.saturating_sub(station.since_us) >= STUCK_US {
                station.stuck = true;
                return Some(stuck);
            }
            if !station.missing && now_us.saturating_sub(station.heard_us) >= MISSING_US {
                station.missing = true;
                return Some(missing);
            }
        }
        None
    }
}

//! The tracker's records beside a capture: from a simulated tracker through the firmware's driver to the file.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant, UNIX_EPOCH};

use rigel::capture::{TRACKER_FILE, TrackerLine, TrackerLog};
use rigel::rig::{Format, Output, SerialRig, TrackerState, Tracking};
use rigel::tracker::TrackerRecord;
use rigel_protocol::TrackerStatus;
use rigel_simulated::rig::{RigOptions, SimulatedRig};
use rigel_simulated::tracker::TrackerOptions;

const TRACKING: Tracking = Tracking { stations: 1, format: Format::Binary, output: Output::Quaternion };

fn simulated() -> SimulatedRig {
    let tracker = Some(TrackerOptions::default());
    SimulatedRig::start(RigOptions { tracker, ..Default::default() }).unwrap()
}

fn until(what: &str, mut happened: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happened() {
        assert!(start.elapsed() < Duration::from_secs(30), "{what} did not happen");
        std::thread::sleep(Duration::from_millis(2));
    }
}

fn lines(folder: &Path) -> Vec<TrackerLine> {
    let text = fs::read_to_string(folder.join(TRACKER_FILE)).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn status(rig: &mut SerialRig) -> TrackerStatus {
    rig.tracker().unwrap()
}

#[test]
fn every_record_is_written_in_order_and_the_tracker_is_switched_off_at_the_end() {
    let (simulated, folder) = (simulated(), tempfile::tempdir().unwrap());
    let mut rig = SerialRig::greet(simulated.port_name()).unwrap();
    let records = rig.records();
    rig.track(TRACKING).unwrap();
    let mut log = TrackerLog::start(records, folder.path()).unwrap();
    until("a second of records", || lines(folder.path()).len() >= 60);
    assert_eq!(status(&mut rig).state, TrackerState::Running);
    log.check().unwrap();
    let count = log.finish().unwrap();

    let lines = lines(folder.path());
    assert_eq!(lines.len() as u64, count);
    let after = status(&mut rig);
    assert_eq!(after.state, TrackerState::Off);
    // What was counted stays readable.
    assert_eq!((after.rejected, after.overrun, after.restarts), (0, 0, 0));
    assert!((count..count + 60).contains(&u64::from(after.forwarded)), "{after:?}");
    // It has fifty milliseconds to obey.
    std::thread::sleep(Duration::from_millis(300));
    let said = simulated.position().take_said();
    std::thread::sleep(Duration::from_millis(200));
    assert!(simulated.position().take_said().is_empty(), "it still talks");

    let first = TrackerRecord::new(UNIX_EPOCH, 0.0, &said[0]).unwrap();
    assert!((first.position_m.to_array(), lines[0].count) == (lines[0].position_m, 0));
    for (pair, said) in lines.windows(2).zip(said.windows(2)) {
        assert_eq!(pair[0].count + 1, pair[1].count, "none is lost");
        let (passed_s, truly_s) =
            (pair[1].at_s - pair[0].at_s, (said[1].at_us - said[0].at_us) as f64 * 1e-6);
        assert!(passed_s > 0.0, "{pair:?}");
        assert!((passed_s - truly_s).abs() < pair[0].bound_s + pair[1].bound_s, "{pair:?} {truly_s}");
    }
}

#[test]
fn a_log_that_is_dropped_switches_the_tracker_off_too() {
    let (simulated, folder) = (simulated(), tempfile::tempdir().unwrap());
    let mut rig = SerialRig::greet(simulated.port_name()).unwrap();
    let records = rig.records();
    rig.track(TRACKING).unwrap();
    let log = TrackerLog::start(records, folder.path()).unwrap();
    until("a record", || status(&mut rig).forwarded > 0);
    drop(log);
    until("the end", || status(&mut rig).state == TrackerState::Off);
}

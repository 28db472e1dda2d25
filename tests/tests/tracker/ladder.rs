//! The driver against the simulated tracker, on a simulated clock: nothing here waits.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use rigel_firmware_core::isotrak::{Driver, List, TrackerOutput};
use rigel_protocol::{Fault, Format, Output, Record, TrackerState, Tracking};
use rigel_simulated::tracker::{LineFaults, Mood, Tracker, TrackerOptions, TrackerRunner, gentle};

const S: u64 = 1_000_000;
const ASCII: Tracking = Tracking { stations: 1, format: Format::Ascii, output: Output::Quaternion };
const BINARY: Tracking = Tracking { format: Format::Binary, ..ASCII };

/// Everything that a host may ask for.
const ORDERS: [(Format, Output); 4] = [
    (Format::Ascii, Output::Quaternion),
    (Format::Ascii, Output::Euler),
    (Format::Binary, Output::Quaternion),
    (Format::Binary, Output::Euler),
];

/// A driver and a tracker on a line.
struct Bench {
    driver: Driver,
    tracker: Tracker,
    now_us: u64,
    to_driver: VecDeque<(u64, u8)>,
    records: Vec<Record>,
    said: Vec<Record>,
    states: Vec<(u64, TrackerState)>,
    logs: Vec<&'static str>,
    sent: Vec<(u64, &'static [u8])>,
}

impl Bench {
    fn new(options: TrackerOptions) -> Self {
        Self {
            driver: Driver::new(),
            tracker: Tracker::new(options, gentle()),
            now_us: S,
            to_driver: VecDeque::new(),
            records: Vec::new(),
            said: Vec::new(),
            states: Vec::new(),
            logs: Vec::new(),
            sent: Vec::new(),
        }
    }

    /// A bench whose tracker was asked for and has run for two seconds.
    fn running(options: TrackerOptions, tracking: Tracking) -> Self {
        let mut bench = Self::new(options);
        bench.track(tracking);
        bench.run(4 * S);
        assert_eq!(bench.driver.status().state, TrackerState::Running, "{:?}", bench.logs);
        assert_eq!((bench.driver.status().restarts, bench.logs.len()), (0, 0));
        bench
    }

    fn track(&mut self, tracking: Tracking) {
        assert_eq!(self.driver.track(tracking, 77, self.now_us), Ok(()));
    }

    /// Runs both for so long.
    fn run(&mut self, time_us: u64) {
        let until_us = self.now_us + time_us;
        let mut rounds = 0;
        loop {
            while let Some(output) = self.driver.advance(self.now_us) {
                self.take(output);
            }
            let due = [
                self.driver.next_us(),
                self.tracker.next_us(),
                self.to_driver.front().map(|(at_us, _)| *at_us),
            ];
            let next_us = due.into_iter().flatten().min().unwrap_or(u64::MAX).max(self.now_us);
            if next_us > until_us {
                self.now_us = until_us;
                return;
            }
            // The driver must not want to be called again and again without anything to do.
            rounds = if next_us > self.now_us { 0 } else { rounds + 1 };
            assert!(rounds < 1_000, "the driver is due at {next_us} and does nothing");
            self.now_us = next_us;
            let bytes = self.tracker.advance(next_us);
            self.to_driver.extend(bytes);
            self.said.extend(self.tracker.take_said());
            while let Some((at_us, byte)) =
                self.to_driver.front().copied().filter(|(at_us, _)| *at_us <= next_us)
            {
                self.driver.byte(byte, at_us);
                self.to_driver.pop_front();
            }
        }
    }

    fn take(&mut self, output: TrackerOutput) {
        match output {
            TrackerOutput::Send(bytes) => {
                self.sent.push((self.now_us, bytes));
                for &byte in bytes {
                    let answer = self.tracker.hear(byte, self.now_us);
                    self.to_driver.extend(answer);
                }
            }
            TrackerOutput::Record(record) => self.records.push(record),
            TrackerOutput::Status(status) => self.states.push((self.now_us, status.state)),
            TrackerOutput::Log(text) => {
                assert!(text.len() <= 60);
                self.logs.push(text);
            }
        }
    }

    fn state(&self) -> TrackerState {
        self.driver.status().state
    }

    /// Every record was truly said, and at that time; bytes that came twice or in between have delayed it.
    fn assert_all_true(&self) {
        let mut said = self.said.iter();
        for record in &self.records {
            let same =
                |said: &&Record| Record { count: record.count, at_us: record.at_us, ..**said } == *record;
            let said = said.by_ref().find(same);
            let late_us = said.map(|said| record.at_us - said.at_us);
            assert!(late_us.is_some_and(|us| us < 5_000), "{record:?} was never said");
        }
    }

    fn last_record_after(&self, at_us: u64) -> bool {
        self.records.last().is_some_and(|record| record.at_us > at_us)
    }
}

#[test]
fn every_kind_of_record_comes_complete_and_in_order() {
    for (format, output) in ORDERS {
        for stations in [1, 2] {
            let options = TrackerOptions { receivers: 2, ..Default::default() };
            let mut bench = Bench::running(options, Tracking { stations, format, output });
            bench.run(10 * S);
            bench.assert_all_true();
            let records = &bench.records;
            assert!(records.len() > 700, "{}", records.len());
            assert!(records.windows(2).all(|r| r[0].at_us < r[1].at_us && r[0].count + 1 == r[1].count));
            assert!(records.iter().all(|r| (1..=stations).contains(&r.station)));
            // Nothing that was said is missing but what is still on its way.
            assert!(bench.said.len() <= records.len() + 3, "{} {}", bench.said.len(), records.len());
            let status = bench.driver.status();
            assert_eq!((status.rejected, status.skipped_bytes, status.overrun), (0, 0, 0));
            assert_eq!(status.forwarded as usize, records.len());
            assert_eq!(bench.driver.sequence(), 77);
        }
    }
}

#[test]
fn the_ladder_sets_everything_that_a_record_depends_on() {
    let mut bench = Bench::running(TrackerOptions { receivers: 2, ..Default::default() }, ASCII);
    let heard = bench.tracker.take_heard();
    let position = |command: &[u8]| heard.iter().position(|heard| heard == command);
    let order: Vec<_> =
        [&b"c"[..], b"S", b"R1", b"u", b"H1,1,0,0", b"O2,11,2,11,1", b"l2,0", b"l1", b"F", b"C"]
            .map(|command| {
                position(command).unwrap_or_else(|| panic!("{:?}", String::from_utf8_lossy(command)))
            })
            .into();
    assert!(order.is_sorted(), "{order:?}");
    let states: Vec<_> = bench.states.iter().map(|(_, state)| *state).collect();
    assert_eq!(states, [TrackerState::Starting, TrackerState::Running]);
    // It is off within a breath, and stays so.
    bench.track(Tracking { stations: 0, ..ASCII });
    bench.run(S);
    let count = bench.records.len();
    bench.run(60 * S);
    assert_eq!((bench.records.len(), bench.state()), (count, TrackerState::Off));
    assert_eq!(bench.tracker.next_us(), None);
    assert_eq!(bench.driver.next_us(), None);
    assert_eq!(bench.driver.track(Tracking { stations: 3, ..ASCII }, 5, 0), Err(Fault::Senseless));
    assert_eq!((bench.state(), bench.driver.sequence()), (TrackerState::Off, 77));
}

#[test]
fn a_tracker_in_any_state_is_brought_to_run() {
    // Half a command, suspended, already sending in another format.
    for before in [&b"O2,1"[..], b"\x13", b"fC", b"C", b"UFC\x13", b"H1,"] {
        let mut bench = Bench::new(TrackerOptions::default());
        for byte in before {
            bench.tracker.hear(*byte, 0);
        }
        bench.track(BINARY);
        bench.run(5 * S);
        assert_eq!((bench.state(), bench.driver.status().restarts), (TrackerState::Running, 0), "{before:?}");
        bench.assert_all_true();
    }
}

#[test]
fn a_tracker_that_knows_no_double_list_is_read_with_cosines_or_a_plain_one() {
    for tracking in [ASCII, BINARY] {
        let lists: [&'static [List]; 2] = [&[List::Once, List::Cosines], &[List::Once]];
        for (obeys, restarts) in lists.into_iter().zip(1..) {
            let mut bench = Bench::new(TrackerOptions { obeys, ..Default::default() });
            bench.track(tracking);
            bench.run(20 * S);
            assert_eq!((bench.state(), bench.driver.status().restarts), (TrackerState::Running, restarts));
            bench.assert_all_true();
            assert!(bench.records.len() > 700);
        }
    }
}

#[test]
fn a_silent_tracker_is_noticed_and_tried_again_harder_and_harder() {
    let mut bench = Bench::running(TrackerOptions::default(), ASCII);
    bench.tracker.set_mood(Mood::Silent);
    let since_us = bench.now_us;
    bench.run(2 * S);
    assert_eq!(bench.state(), TrackerState::Silent);
    assert!(
        bench.states.iter().any(|(at_us, s)| *s == TrackerState::Silent && *at_us < since_us + 1_100_000)
    );
    bench.run(300 * S);
    let reset: Vec<u64> = bench.sent.iter().filter(|(_, b)| *b == b"\x19").map(|(at_us, _)| *at_us).collect();
    assert!((5..=20).contains(&reset.len()), "{}", reset.len());
    for at_us in reset {
        // Nothing is said to a tracker that boots.
        assert!(!bench.sent.iter().any(|(at, _)| *at > at_us && *at < at_us + 20 * S));
    }
    assert_eq!(bench.states.last().map(|(_, s)| *s), Some(TrackerState::Silent));
    let restarts = bench.driver.status().restarts;
    assert!((15..100).contains(&restarts), "{restarts}");
    bench.tracker.set_mood(Mood::Good);
    let before_us = bench.now_us;
    bench.run(30 * S);
    assert_eq!(bench.state(), TrackerState::Running);
    assert!(bench.last_record_after(before_us));
    bench.assert_all_true();
}

#[test]
fn a_tracker_that_never_was_there_is_said_to_be_silent() {
    let mut bench = Bench::new(TrackerOptions::default());
    bench.tracker.set_mood(Mood::Silent);
    bench.track(ASCII);
    bench.run(3 * S);
    assert_eq!(bench.state(), TrackerState::Silent);
    assert!(bench.logs.contains(&"tracker: it does not answer"), "{:?}", bench.logs);
}

#[test]
fn a_babbling_tracker_gives_no_record_and_is_started_again() {
    for tracking in [ASCII, BINARY] {
        let mut bench = Bench::running(TrackerOptions::default(), tracking);
        bench.tracker.set_mood(Mood::Babbling);
        let (count, since_us) = (bench.records.len(), bench.now_us);
        bench.run(60 * S);
        assert_eq!((bench.records.len(), bench.state()), (count, TrackerState::Silent));
        let silent_us = bench.states.iter().find(|(_, s)| *s == TrackerState::Silent).unwrap().0;
        assert!(silent_us < since_us + 1_200_000);
        assert!(bench.logs.contains(&"tracker: it talks but no record is whole"), "{:?}", bench.logs);
        assert!(bench.logs.contains(&"tracker: it does not fall silent"), "{:?}", bench.logs);
        bench.tracker.set_mood(Mood::Good);
        bench.run(30 * S);
        assert_eq!(bench.state(), TrackerState::Running);
        bench.assert_all_true();
    }
}

#[test]
fn a_hung_tracker_is_brought_back_by_its_own_restart() {
    let mut bench = Bench::running(TrackerOptions::default(), ASCII);
    bench.tracker.set_mood(Mood::Hung);
    bench.run(40 * S);
    assert_eq!(bench.state(), TrackerState::Running);
    assert_eq!(bench.sent.iter().filter(|(_, bytes)| *bytes == b"\x19").count(), 1);
    bench.assert_all_true();
}

#[test]
fn a_tracker_that_was_switched_off_and_on_runs_again() {
    for boot_s in [0.0, 1.0, 10.0, 45.0] {
        let mut bench = Bench::running(TrackerOptions { boot_s, ..Default::default() }, BINARY);
        let now_us = bench.now_us;
        bench.tracker.restart(now_us);
        bench.run((boot_s as u64 + 40) * S);
        assert_eq!(bench.state(), TrackerState::Running, "{boot_s}");
        assert!(bench.last_record_after(now_us));
        bench.assert_all_true();
    }
}

#[test]
fn out_of_sync_costs_the_records_that_it_hits_and_no_restart() {
    for (format, output) in ORDERS {
        let faults = LineFaults { dropped: 2e-4, doubled: 2e-4, cut: 2e-4, ..Default::default() };
        let mut bench = Bench::running(TrackerOptions::default(), Tracking { stations: 1, format, output });
        bench.tracker.set_faults(faults);
        bench.run(60 * S);
        let status = bench.driver.status();
        assert_eq!((status.state, status.restarts), (TrackerState::Running, 0));
        bench.assert_all_true();
        let lost = bench.said.len() - bench.records.len();
        assert!(lost > 10 && lost < bench.said.len() / 5, "{lost} of {}", bench.said.len());
        assert!(status.skipped_bytes > 0);
    }
}

#[test]
fn stuck_angles_are_said_once_and_forwarded() {
    for tracking in [ASCII, BINARY] {
        let mut bench = Bench::running(TrackerOptions::default(), tracking);
        bench.tracker.set_mood(Mood::Stuck);
        let count = bench.records.len();
        bench.run(30 * S);
        assert_eq!(bench.logs, ["tracker: station 1 says the same pose for 5 s: stuck?"]);
        assert!(bench.records.len() > count + 1_700);
        assert_eq!(bench.state(), TrackerState::Running);
        bench.tracker.set_mood(Mood::Good);
        bench.run(10 * S);
        bench.tracker.set_mood(Mood::Stuck);
        bench.run(10 * S);
        assert_eq!(bench.logs.len(), 2, "{:?}", bench.logs);
    }
}

#[test]
fn a_receiver_that_is_not_there_or_goes_missing_is_said() {
    let two = Tracking { stations: 2, ..ASCII };
    let mut bench = Bench::new(TrackerOptions::default());
    bench.track(two);
    bench.run(10 * S);
    assert_eq!(bench.state(), TrackerState::Running);
    assert_eq!(bench.logs, ["tracker: a receiver that was asked for is not there"]);
    let mut bench = Bench::running(TrackerOptions { receivers: 2, ..Default::default() }, two);
    bench.tracker.set_mood(Mood::OneReceiver);
    bench.run(10 * S);
    assert_eq!(bench.logs, ["tracker: station 2 is not heard any more"]);
    assert_eq!((bench.state(), bench.driver.status().restarts), (TrackerState::Running, 0));
}

#[test]
fn records_that_nobody_fetches_are_counted() {
    let mut bench = Bench::running(TrackerOptions::default(), ASCII);
    let forwarded = bench.driver.status().forwarded;
    // A board that does not come round for a second.
    let end_us = bench.now_us + S;
    while let Some(at_us) = bench.tracker.next_us().filter(|at_us| *at_us < end_us) {
        for (at_us, byte) in bench.tracker.advance(at_us) {
            bench.driver.byte(byte, at_us);
        }
    }
    bench.run(2 * S);
    let status = bench.driver.status();
    assert!((45..=60).contains(&status.overrun), "{status:?}");
    assert!(status.forwarded > forwarded);
    // The gap shows in the count.
    assert!(bench.records.windows(2).any(|r| r[1].count - r[0].count > 40));
    bench.driver.lost();
    assert_eq!(bench.driver.status().overrun, status.overrun + 1);
}

#[test]
fn the_simulated_tracker_runs_on_a_real_line() {
    let (mut rig, far_end) = UnixStream::pair().unwrap();
    rig.set_nonblocking(true).unwrap();
    far_end.set_nonblocking(true).unwrap();
    let runner = TrackerRunner::start(Tracker::new(TrackerOptions::default(), gentle()), far_end);
    let started = Instant::now();
    let mut driver = Driver::new();
    driver.track(ASCII, 1, 0).unwrap();
    let (mut records, mut buffer) = (Vec::new(), [0; 128]);
    while records.len() < 20 && started.elapsed() < Duration::from_secs(20) {
        let count = rig.read(&mut buffer).unwrap_or(0);
        let now_us = started.elapsed().as_micros() as u64;
        driver.bytes(&buffer[..count], now_us);
        while let Some(output) = driver.advance(now_us) {
            match output {
                TrackerOutput::Send(bytes) => rig.write_all(bytes).unwrap(),
                TrackerOutput::Record(record) => records.push(record),
                TrackerOutput::Status(_) | TrackerOutput::Log(_) => {}
            }
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let said = runner.tracker().take_said();
    assert_eq!(records.len(), 20, "{:?}", driver.status());
    let same = |a: &Record, b: &Record| (a.position_um, a.orientation) == (b.position_um, b.orientation);
    assert!(records.iter().all(|record| said.iter().any(|said| same(record, said))));
}

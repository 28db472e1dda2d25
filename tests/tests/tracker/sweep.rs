//! A million records through the parser, with everything that can go wrong on a line without checksums.

use std::collections::VecDeque;

use glam::{DQuat, DVec3, EulerRot};
use rigel_firmware_core::isotrak::{Layout, List, Parser};
use rigel_protocol::{Format, Orientation, Output, Record};
use rigel_simulated::tracker::{LineFaults, Motion, Tracker, TrackerOptions, gentle};

/// Everything for which the driver may ask.
fn layouts() -> impl Iterator<Item = Layout> {
    [Output::Quaternion, Output::Euler].into_iter().flat_map(|output| {
        let kinds = [
            (Format::Ascii, List::Once),
            (Format::Ascii, List::Twice),
            (Format::Ascii, List::Cosines),
            (Format::Binary, List::Once),
            (Format::Binary, List::Twice),
        ];
        kinds.map(|(format, list)| Layout { format, output, list })
    })
}

/// What became of the records of one run.
#[derive(Debug, Default, Clone, Copy)]
struct Tally {
    sent: u32,
    /// Records of which the line changed something.
    damaged: u32,
    /// Accepted as they were sent, damaged or not.
    right: u32,
    /// Of these, those that the line had damaged where it does not matter.
    harmless: u32,
    /// Accepted, but not what was sent …
    wrong: u32,
    /// … of which so many differ from it by more than the tracker's noise.
    wrong_beyond_noise: u32,
    /// Refused by a check, although the line had not touched them.
    refused_unharmed: u32,
    /// The largest difference among the wrong ones: micrometres along an axis, radians.
    worst: (f64, f64),
}

impl Tally {
    fn add(&mut self, other: Self) {
        self.sent += other.sent;
        self.damaged += other.damaged;
        self.right += other.right;
        self.harmless += other.harmless;
        self.wrong += other.wrong;
        self.wrong_beyond_noise += other.wrong_beyond_noise;
        self.refused_unharmed += other.refused_unharmed;
        self.worst = (self.worst.0.max(other.worst.0), self.worst.1.max(other.worst.1));
    }

    /// The share of the records whose content the line had changed that were not accepted.
    fn rejected_share(self) -> f64 {
        let changed = self.damaged - self.harmless;
        1.0 - f64::from(self.wrong) / f64::from(changed.max(1))
    }

    /// The same for records that were changed by more than the tracker's noise (four standard deviations).
    fn seen_share(self) -> f64 {
        let changed = self.damaged - self.harmless - (self.wrong - self.wrong_beyond_noise);
        1.0 - f64::from(self.wrong_beyond_noise) / f64::from(changed.max(1))
    }
}

/// Sends `count` records through a line with `faults` to a parser, as the rig would do it.
fn run(layout: Layout, stations: u8, faults: LineFaults, count: u32, seed: u64) -> Tally {
    let options = TrackerOptions { receivers: stations, faults, seed, ..Default::default() };
    let noise = (4.0 * options.position_noise_m * 1e6, 4.0 * options.angle_noise_rad);
    let mut tracker = Tracker::new(options, gentle());
    tracker.set_layout(layout);
    for byte in b"uC" {
        tracker.hear(*byte, 0);
    }
    let mut parser = Parser::new(layout, stations);
    let mut tally = Tally::default();
    // What was sent lately: the record, whether it was damaged, whether it was seen again.
    let mut recent: VecDeque<(Record, bool, bool)> = VecDeque::new();
    let mut verdicts = Vec::new();
    while tally.sent < count {
        let now_us = tracker.next_us().expect("it talks");
        let bytes = tracker.advance(now_us);
        for said in tracker.take_said() {
            tally.sent += 1;
            tally.damaged += u32::from(tracker.line().damaged);
            recent.push_back((said, tracker.line().damaged, false));
        }
        for (at_us, byte) in bytes {
            verdicts.extend(parser.push(byte, at_us));
        }
        if let Some(due_us) = parser.next_us().filter(|due_us| *due_us <= now_us + 16_000) {
            verdicts.extend(parser.advance(due_us));
        }
        for record in verdicts.drain(..).flatten() {
            tally.judge(&record, &mut recent, noise);
        }
        while recent.len() > 60 {
            let unharmed = recent.pop_front().is_some_and(|(_, damaged, seen)| !damaged && !seen);
            tally.refused_unharmed += u32::from(unharmed);
        }
    }
    tally
}

impl Tally {
    fn judge(&mut self, record: &Record, recent: &mut VecDeque<(Record, bool, bool)>, noise: (f64, f64)) {
        // Bytes that came twice or in between have delayed it.
        let begun = |said: &Record| (0..=5_000).contains(&(record.at_us as i64 - said.at_us as i64));
        let Some((said, damaged, seen)) = recent.iter_mut().find(|(said, ..)| begun(said)) else {
            self.wrong += 1;
            self.wrong_beyond_noise += 1;
            return;
        };
        *seen = true;
        if (Record { at_us: said.at_us, ..*record }) == *said {
            self.right += 1;
            self.harmless += u32::from(*damaged);
            return;
        }
        self.wrong += 1;
        let (moved_um, turned_rad) = difference(record, said);
        let beyond = record.status != said.status
            || record.station != said.station
            || moved_um > noise.0
            || turned_rad > noise.1;
        self.wrong_beyond_noise += u32::from(beyond);
        self.worst = (self.worst.0.max(moved_um), self.worst.1.max(turned_rad));
    }
}

/// How far apart two records are: micrometres along the worst axis, radians.
fn difference(a: &Record, b: &Record) -> (f64, f64) {
    let moved = (0..3).map(|i| (a.position_um[i] - b.position_um[i]).abs()).fold(0, i32::max);
    let turn = |record: &Record| match record.orientation {
        Orientation::Quaternion(q) => {
            let [w, x, y, z] = q.map(f64::from);
            DQuat::from_xyzw(x, y, z, w).normalize()
        }
        Orientation::Euler(angles) => {
            let [a, e, r] = angles.map(|mdeg| (f64::from(mdeg) / 1e3).to_radians());
            DQuat::from_euler(EulerRot::ZYX, a, e, r)
        }
    };
    let between = turn(a).inverse() * turn(b);
    (f64::from(moved), 2.0 * DVec3::new(between.x, between.y, between.z).length().min(1.0).asin())
}

fn percent(part: u32, whole: u32) -> f64 {
    100.0 * f64::from(part) / f64::from(whole.max(1))
}

#[test]
fn a_good_line_loses_nothing() {
    for layout in layouts() {
        for stations in [1, 2] {
            let tally = run(layout, stations, LineFaults::default(), 20_000, 5);
            assert_eq!(
                (tally.damaged, tally.wrong, tally.refused_unharmed),
                (0, 0, 0),
                "{layout:?}: {tally:?}"
            );
            assert!(tally.right + 60 >= tally.sent);
        }
    }
}

/// A receiver that is shaken: three metres per second, three times the gravity, ten radians per second, with pauses, and
/// through the poles of the Euler angles.
fn shaken() -> Motion {
    Box::new(|s, _| {
        let strength = (0.4 * s).sin().max(0.0);
        let swing = strength * (9.0 * s).sin();
        let at_m = DVec3::new(0.5 + 0.33 * swing, 0.1 * (7.0 * s).cos() * strength, -0.1);
        let turn = DQuat::from_rotation_z(1.1 * swing) * DQuat::from_rotation_y(1.5 * (2.0 * s).sin());
        (at_m, turn * DQuat::from_rotation_x(0.5 * swing))
    })
}

/// How many of `count` records of a good line are refused when stamps are late by up to `jitter_us`.
fn refused(layout: Layout, motion: Motion, jitter_us: u64, count: u64) -> usize {
    let mut tracker = Tracker::new(TrackerOptions::default(), motion);
    tracker.set_layout(layout);
    for byte in b"uC" {
        tracker.hear(*byte, 0);
    }
    let mut parser = Parser::new(layout, 1);
    let mut refused = 0;
    for n in 0..count {
        let late_us = n.wrapping_mul(0x9e37_79b9_7f4a_7c15) % (jitter_us + 1);
        for (at_us, byte) in tracker.advance(tracker.next_us().expect("it talks")) {
            refused += parser.push(byte, at_us + late_us).filter(Result::is_err).count();
        }
    }
    refused
}

#[test]
fn a_shaken_receiver_and_late_stamps_lose_nothing() {
    for layout in layouts() {
        let when_shaken = refused(layout, shaken(), 100, 10_000);
        if layout.list == List::Twice {
            assert_eq!(when_shaken, 0, "{layout:?}");
            assert_eq!(refused(layout, gentle(), 6_000, 10_000), 0, "{layout:?}");
            continue;
        }
        println!("{}: {when_shaken} of 10000 refused when shaken", name(layout));
        assert!(when_shaken < 20, "{layout:?}: {when_shaken}");
    }
}

/// Every layout, and how often something goes wrong per byte.
fn everything() -> impl Iterator<Item = (Layout, f64)> {
    layouts().flat_map(|layout| [1e-4, 1e-3, 1e-2, 1e-1].map(|rate| (layout, rate)))
}

fn name(Layout { format, output, list }: Layout) -> String {
    format!("{format:?} {output:?} {list:?}")
}

#[test]
fn lost_doubled_cut_and_babbled_bytes_never_make_a_record() {
    let mut all = Tally::default();
    println!(
        "layout, faults per byte: records damaged; accepted but not sent; undamaged but refused (or lost)"
    );
    for (layout, rate) in everything() {
        // A tenth of the bytes damaged leaves nothing to accept: one in 100 000 says more.
        let rate = if rate > 0.05 { 1e-5 } else { rate };
        let tally = run(layout, 1, LineFaults::all_but_flips(rate), 25_000, 7);
        println!(
            "{}, {rate:.0e}: {:.2} %; {}; {:.2} %",
            name(layout),
            percent(tally.damaged, tally.sent),
            tally.wrong,
            percent(tally.refused_unharmed, tally.sent),
        );
        // Where the copies prove a record good, its neighbours' misfortune is not its own.
        assert!(layout.list != List::Twice || percent(tally.refused_unharmed, tally.sent) < 1.0, "{tally:?}");
        all.add(tally);
    }
    println!("{} records, {} damaged: {} accepted that were not sent", all.sent, all.damaged, all.wrong);
    assert!(all.sent >= 1_000_000);
    assert_eq!(all.wrong, 0);
}

#[test]
fn flipped_bits_are_seen() {
    let (mut once, mut cosines) = (Tally::default(), Tally::default());
    println!(
        "layout, flips per byte: records changed; rejected (all, those beyond noise); undamaged but refused"
    );
    for (layout, rate) in everything() {
        let faults = LineFaults { flipped: rate, ..Default::default() };
        let tally = run(layout, 1, faults, if rate < 1e-3 { 40_000 } else { 10_000 }, 7);
        let (rejected, visible) = (tally.rejected_share(), tally.seen_share());
        println!(
            "{}, {rate:.0e}: {}; {:.2} %, {:.2} %; {:.2} %; accepted wrong: at most {:.2} mm, {:.3}°",
            name(layout),
            tally.damaged - tally.harmless,
            100.0 * rejected,
            100.0 * visible,
            percent(tally.refused_unharmed, tally.sent),
            tally.worst.0 / 1e3,
            tally.worst.1.to_degrees(),
        );
        if layout.list == List::Twice {
            assert!(rejected >= 0.99 && visible >= 0.995, "{}: {tally:?}", name(layout));
        } else if rate < 5e-3 {
            if layout.list == List::Cosines { &mut cosines } else { &mut once }.add(tally);
        } else {
            // A line that flips often gives itself away, and nothing of it is believed.
            assert!(rejected >= 0.95 && visible >= 0.98, "{}: {tally:?}", name(layout));
        }
    }
    // Where something is said once, a flipped low bit cannot be told from noise.
    for (name, tally) in [("said once", once), ("with cosines", cosines)] {
        let changed = tally.damaged - tally.harmless;
        println!(
            "{name}, at most 1e-3: {changed} of {} changed, {:.2} % accepted within the noise, {:.2} % beyond it",
            tally.sent,
            percent(tally.wrong - tally.wrong_beyond_noise, changed),
            percent(tally.wrong_beyond_noise, changed),
        );
    }
    assert!(once.rejected_share() > 0.9 && once.seen_share() > 0.97, "{once:?}");
    assert!(cosines.rejected_share() >= 0.99 && cosines.seen_share() >= 0.995, "{cosines:?}");
}

//! A folder that fills while somebody turns: photographs find their places by a table, by the tracker, by what they show, and the map can be made of
//! what was written.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "live/mishaps.rs"]
mod mishaps;

use std::fs;
use std::path::Path;
use std::time::{Duration, UNIX_EPOCH};

use glam::DQuat;
use image::ImageEncoder;
use image::codecs::png::PngEncoder;
use rigel::camera::exif;
use rigel::environment::{
    Arrival, Live, MergeOptions, Options, Place, Shots, Tracking, Unit, Wanted, mosaic,
};
use rigel::geometry::{LatLong, Lens, world_from_camera};
use rigel::progress::Silent;
use rigel_simulated::tour::{Tour, apart};

const START_S: f64 = 1.7e9;

fn tour() -> Tour {
    Tour {
        photographs: 24,
        laps: 1.0,
        lens: Lens::pinhole(240, 180, 180.0),
        drift_rad: 0.0,
        ..Tour::default()
    }
}

fn options(tour: &Tour) -> Options {
    Options {
        lens: Some(tour.lens),
        merge: MergeOptions { feather: 2, disagreement: Some(0.1) },
        ..Options::new(LatLong::new(64, 32).unwrap())
    }
}

/// Knows how the tracker's receiver sits and how late the camera is.
fn tracking(tour: &Tour) -> Tracking {
    Tracking { delay_s: Some(tour.delay_s), mount: Some(tour.mount), ..Tracking::default() }
}

fn photograph(i: usize) -> String {
    format!("{i:03}.png")
}

/// Puts a photograph there as if it had been written when the tour says.
fn put(from: &Path, to: &Path, i: usize, tour: &Tour) {
    let place = to.join(photograph(i));
    fs::copy(from.join(photograph(i)), &place).unwrap();
    let time = UNIX_EPOCH + Duration::from_secs_f64(START_S + tour.times_s()[i]);
    fs::File::options().write(true).open(place).unwrap().set_modified(time).unwrap();
}

/// The first lines of a session's file: those up to a time after its start, or so many.
fn head(from: &Path, name: &str, keep: impl Fn(usize, &str) -> bool) -> String {
    let text = fs::read_to_string(from.join(name)).unwrap();
    text.lines().enumerate().filter(|(i, line)| keep(*i, line)).map(|(_, line)| format!("{line}\n")).collect()
}

fn records_until(from: &Path, time_s: f64) -> String {
    let at_s = |line: &str| -> f64 { line[8..].split(',').next().unwrap().parse().unwrap() };
    head(from, "tracker.jsonl", |_, line| at_s(line) <= START_S + time_s)
}

/// A line of a table that says how a photograph was turned.
fn turned(name: &str, turn: DQuat) -> String {
    let q = turn * world_from_camera(DQuat::IDENTITY).inverse();
    format!("{name},{},{},{},{}\n", q.w, q.x, q.y, q.z)
}

/// Such a table of the first photographs.
fn table_of(tour: &Tour, count: usize) -> String {
    let lines = (0..count).map(|i| turned(&photograph(i), tour.truth()[i]));
    format!("file,qw,qx,qy,qz\n{}", lines.collect::<String>())
}

/// What has come, in three looks: only a table, and then a photograph, that has not grown since the last one counts. Of many some wait for more looks.
fn come(live: &mut Live) -> Vec<Arrival> {
    let mut all = live.look().unwrap();
    all.extend(live.look().unwrap());
    loop {
        let more = live.look().unwrap();
        if more.is_empty() {
            return all;
        }
        all.extend(more);
    }
}

fn placed(arrivals: &[Arrival]) -> Vec<Place> {
    arrivals.iter().map(|arrival| arrival.place.clone().unwrap()).collect()
}

fn rms_deg(turns: &[DQuat], truth: &[DQuat]) -> f64 {
    let off = apart(turns, truth);
    (off.iter().map(|off| off.length_squared()).sum::<f64>() / off.len() as f64).sqrt().to_degrees()
}

#[test]
fn a_table_and_records_that_grow_place_every_photograph_as_it_comes() {
    let tour = tour();
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    fs::write(to.join("frames.csv"), head(from, "frames.csv", |i, _| i == 0)).unwrap();
    fs::write(to.join("tracker.jsonl"), "").unwrap();
    let mut live = Live::open(to, &tracking(&tour), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let (mut turns, mut seen, mut squares) = (vec![], 0.0, 0.0);
    let truth = tour.truth();
    for (i, expected) in truth.iter().enumerate() {
        put(from, to, i, &tour);
        fs::write(to.join("frames.csv"), head(from, "frames.csv", |k, _| k <= i + 1)).unwrap();
        // Nothing of what comes later is known.
        fs::write(to.join("tracker.jsonl"), records_until(from, tour.times_s()[i] + 0.02)).unwrap();
        let arrivals = come(&mut live);
        assert_eq!(arrivals.len(), 1, "{i}: {arrivals:?}");
        let place = placed(&arrivals)[0];
        turns.push(place.turn);
        seen += place.gained;
        let off = expected.angle_between(place.turn);
        squares += off * off / 3.0 / place.sigma_rad.unwrap().powi(2);
    }
    let (rms, score) = (rms_deg(&turns, &truth), (squares / tour.photographs as f64).sqrt());
    println!("{rms:.2} degrees RMS, {score:.2} sigmas; {:.3} seen", live.coverage().unwrap().seen().0);
    // Jitter of 0.75 degrees about each of three axes would be 1.3.
    assert!(rms < 1.1, "{rms}");
    assert!((0.4..1.6).contains(&score), "{score}");
    assert!((live.coverage().unwrap().seen().0 - seen).abs() < 1e-9);
    assert!(live.finish().unwrap().1.is_empty());
}

#[test]
fn without_a_table_the_time_of_the_file_and_the_tracker_tell_and_the_map_follows() {
    let tour = tour();
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    fs::write(to.join("tracker.jsonl"), records_until(from, 1e9)).unwrap();
    // In any order: the order of time counts.
    (0..tour.photographs).rev().for_each(|i| put(from, to, i, &tour));
    let mut live = Live::open(to, &tracking(&tour), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let arrivals = come(&mut live);
    let turns: Vec<DQuat> = placed(&arrivals).iter().map(|place| place.turn).collect();
    assert!(rms_deg(&turns, &tour.truth()) < 1.1);
    assert!(live.finish().unwrap().1.is_empty());
    let shots = Shots::read(to).unwrap();
    let made = mosaic(&shots, &options(&tour), &Silent).unwrap();
    let refined: Vec<DQuat> = made.placed.iter().map(|placed| placed.world_from_camera).collect();
    let rms = rms_deg(&refined, &tour.truth());
    println!("{rms:.3} degrees RMS");
    assert!(rms < 0.1, "{rms}");
}

#[test]
fn without_a_tracker_photographs_tell_their_own_places_and_late_ones_are_not_lost() {
    let tour = tour();
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    // One from far away comes too early, and finds its place when what lies between has come.
    let order: Vec<usize> = [0, 12].into_iter().chain((1..tour.photographs).filter(|i| *i != 12)).collect();
    let mut turns = vec![DQuat::IDENTITY; tour.photographs];
    let mut unknown = 0;
    for &i in &order {
        put(from, to, i, &tour);
        for arrival in come(&mut live) {
            let number: usize = arrival.name[..3].parse().unwrap();
            match arrival.place {
                Ok(place) => turns[number] = place.turn,
                Err(why) => {
                    assert!(number == 12 && why.contains("too little"), "{number}: {why}");
                    unknown += 1;
                }
            }
        }
    }
    assert_eq!((unknown, live.count()), (1, tour.photographs));
    let rms = rms_deg(&turns, &tour.truth());
    println!("{rms:.2} degrees RMS");
    assert!(rms < 1.5, "{rms}");
    assert!(live.finish().unwrap().1.is_empty());
    let made = mosaic(&Shots::read(to).unwrap(), &options(&tour), &Silent).unwrap();
    let refined: Vec<DQuat> = made.placed.iter().map(|placed| placed.world_from_camera).collect();
    assert!(rms_deg(&refined, &tour.truth()) < 0.1, "{}", rms_deg(&refined, &tour.truth()));
}

#[test]
fn what_is_half_written_waits_and_what_is_no_photograph_is_named() {
    let tour = Tour { photographs: 3, laps: 0.05, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let bytes = fs::read(from.join("000.png")).unwrap();
    fs::write(to.join("000.png"), &bytes[..bytes.len() / 2]).unwrap();
    assert!(come(&mut live).is_empty());
    fs::write(to.join("000.png"), &bytes).unwrap();
    assert_eq!(placed(&come(&mut live)).len(), 1);
    image::RgbImage::new(50, 40).save(to.join("small.png")).unwrap();
    let arrivals = come(&mut live);
    assert!(arrivals[0].place.clone().unwrap_err().contains("50x40"), "{arrivals:?}");
    fs::write(to.join("torn.png"), &bytes[..bytes.len() / 2]).unwrap();
    assert!(come(&mut live).is_empty());
    std::thread::sleep(Duration::from_millis(3100));
    let arrivals = come(&mut live);
    assert!(
        arrivals.len() == 1 && arrivals[0].place.clone().unwrap_err().contains("torn.png"),
        "{arrivals:?}"
    );
}

#[test]
fn a_photograph_that_was_refused_is_read_again_once_its_size_or_its_time_has_changed() {
    let tour = Tour { photographs: 3, laps: 0.05, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    put(from, to, 0, &tour);
    assert_eq!(placed(&come(&mut live)).len(), 1);
    let bytes = [1, 2].map(|i| fs::read(from.join(photograph(i))).unwrap());
    // The one grows, the other has its size from the start.
    fs::write(to.join(photograph(1)), &bytes[0][..bytes[0].len() / 2]).unwrap();
    fs::write(to.join(photograph(2)), vec![0; bytes[1].len()]).unwrap();
    come(&mut live);
    std::thread::sleep(Duration::from_millis(3100));
    assert!(come(&mut live).len() == 2 && live.is_settled() && live.count() == 1);
    assert!(come(&mut live).is_empty(), "once is enough");
    (1..3).for_each(|i| fs::write(to.join(photograph(i)), &bytes[i - 1]).unwrap());
    let arrivals = come(&mut live);
    assert_eq!((placed(&arrivals).len(), live.count()), (2, 3), "{arrivals:?}");
    let (shots, notes) = live.finish().unwrap();
    assert!(shots.shots.len() == 3 && notes.is_empty(), "{notes:?}");
}

#[test]
fn the_next_session_places_all_photographs_anew_and_replaces_its_own_table_only() {
    let tour = tour();
    for is_timed in [false, true] {
        let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (from, to) = (all.path(), folder.path());
        tour.write(from).unwrap();
        if is_timed {
            fs::write(to.join("tracker.jsonl"), records_until(from, 1e9)).unwrap();
        }
        let session = || {
            let open = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour)));
            let mut live = open.unwrap();
            come(&mut live);
            let (shots, notes) = live.finish().unwrap();
            assert_eq!(Shots::read(to).unwrap().shots, shots.shots);
            (shots.shots.len(), notes)
        };
        (0..3).for_each(|i| put(from, to, i, &tour));
        assert_eq!(session(), (3, vec![]));
        (3..5).for_each(|i| put(from, to, i, &tour));
        assert_eq!(session(), (5, vec![]));
        // Whoever takes the mark away, or adds a line, has made it theirs.
        let table = to.join("frames.csv");
        let own = fs::read_to_string(&table).unwrap();
        let theirs = own.replace(",by\n", "\n").replace(",rigel\n", "\n");
        let last = own.lines().last().unwrap().replace("004.png", "005.png").replace(",rigel", ",me");
        put(from, to, 5, &tour);
        for (text, count) in [(theirs, 5), (format!("{own}{last}\n"), 6)] {
            assert_ne!(text, own);
            fs::write(&table, &text).unwrap();
            assert_eq!((session().0, fs::read_to_string(&table).unwrap()), (count, text));
        }
    }
}

#[test]
fn exposures_that_all_photographs_state_stand_in_the_table() {
    let tour = Tour { photographs: 4, laps: 0.15, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let session = || {
        let mut live =
            Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
        come(&mut live);
        live.finish().unwrap().0
    };
    let exposure_s = |i: usize| 0.01 * (i + 1) as f64;
    for i in 0..3 {
        let picture = image::open(from.join(photograph(i))).unwrap().to_rgb8();
        let mut encoder = PngEncoder::new(fs::File::create(to.join(photograph(i))).unwrap());
        encoder.set_exif_metadata(exif::block(exposure_s(i), None)).unwrap();
        let (width, height) = picture.dimensions();
        encoder.write_image(&picture, width, height, image::ExtendedColorType::Rgb8).unwrap();
    }
    let shots = session();
    assert_eq!((shots.shots.len(), shots.unit), (3, Unit::Saturation { iso: false, f_number: false }));
    for shot in &shots.shots {
        let i: usize = shot.name()[..3].parse().unwrap();
        assert!((shot.exposure.unwrap() - exposure_s(i)).abs() < 1e-9, "{}", shot.name());
    }
    // What one does not state would be guessed.
    put(from, to, 3, &tour);
    let shots = session();
    assert_eq!((shots.shots.len(), shots.unit), (4, Unit::MeanPhotograph));
}

#[test]
fn a_tracker_that_was_silent_places_nothing_and_says_so() {
    let tour = Tour { photographs: 6, laps: 0.2, duration_s: 8.0, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    fs::write(to.join("tracker.jsonl"), records_until(from, 4.0)).unwrap();
    (0..tour.photographs).for_each(|i| put(from, to, i, &tour));
    let mut live = Live::open(to, &tracking(&tour), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let mut arrivals = come(&mut live);
    // Records may still come.
    assert_eq!(arrivals.len(), 3);
    std::thread::sleep(Duration::from_millis(1100));
    arrivals.extend(come(&mut live));
    assert_eq!((arrivals.len(), live.count()), (6, 3));
    assert!(arrivals[3..].iter().all(|arrival| arrival.place.clone().unwrap_err().contains("said nothing")));
    let (_, notes) = live.finish().unwrap();
    assert!(notes[0].contains("005.png"), "{notes:?}");
    let table = fs::read_to_string(to.join("frames.csv")).unwrap();
    assert!(table.contains("002.png") && !table.contains("003.png"), "{table}");
}

#[test]
fn a_table_that_comes_later_counts_from_the_beginning_and_is_never_written_over() {
    let tour = Tour { photographs: 4, laps: 0.15, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let open = || Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let mut live = open();
    (0..3).for_each(|i| put(from, to, i, &tour));
    assert_eq!(placed(&come(&mut live)).len(), 3);
    // Who does not look again must not write over it either.
    let table = table_of(&tour, 2);
    fs::write(to.join("frames.csv"), &table).unwrap();
    let (shots, notes) = live.finish().unwrap();
    assert_eq!((shots.shots.len(), fs::read_to_string(to.join("frames.csv")).unwrap()), (2, table));
    assert!(notes[0].contains("002.png") && notes[0].contains("does not list it"), "{notes:?}");
    fs::remove_file(to.join("frames.csv")).unwrap();
    let mut live = open();
    assert_eq!(placed(&come(&mut live)).len(), 3);
    let seen = live.coverage().unwrap().seen().0;
    let table = table_of(&tour, 4);
    fs::write(to.join("frames.csv"), &table).unwrap();
    put(from, to, 3, &tour);
    let arrivals = come(&mut live);
    assert!(arrivals[0].name == "frames.csv" && arrivals[0].place.is_err(), "{arrivals:?}");
    let places = placed(&arrivals[1..]);
    assert_eq!((places.len(), live.count()), (4, 4));
    for (place, truth) in places.iter().zip(tour.truth()) {
        assert!(place.turn.angle_between(truth) < 1e-6);
    }
    // Nothing of where they seemed to be before is left.
    let gained: f64 = places.iter().map(|place| place.gained).sum();
    assert!((live.coverage().unwrap().seen().0 - gained).abs() < 1e-9 && gained > seen);
    assert!(live.finish().unwrap().1.is_empty());
    assert_eq!(fs::read_to_string(to.join("frames.csv")).unwrap(), table);
}

#[test]
fn a_table_without_a_line_throws_nothing_away() {
    let tour = Tour { photographs: 4, laps: 0.15, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let open = || Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let table = to.join("frames.csv");
    for begun in ["", "file,qw,qx,qy,qz\n", "file,qw,qx,qy,qz\n000.png,1,0"] {
        let mut live = open();
        (0..3).for_each(|i| put(from, to, i, &tour));
        assert_eq!(placed(&come(&mut live)).len(), 3);
        fs::write(&table, begun).unwrap();
        assert!(come(&mut live).is_empty());
        put(from, to, 3, &tour);
        assert_eq!((placed(&come(&mut live)).len(), live.count()), (1, 4));
        let (shots, notes) = live.finish().unwrap();
        assert_eq!((shots.shots.len(), notes.len()), (4, 1));
        assert!(notes[0].starts_with("frames.csv") && notes[0].contains("frames-live.csv"), "{notes:?}");
        assert_eq!(fs::read_to_string(&table).unwrap(), begun);
        assert_eq!(Shots::read(&to.join("frames-live.csv")).unwrap().shots, shots.shots);
        fs::remove_file(&table).unwrap();
        fs::remove_file(to.join(photograph(3))).unwrap();
    }
    put(from, to, 3, &tour);
    // One that is there from the start is waited for, and that is said.
    fs::write(&table, "").unwrap();
    let mut live = open();
    assert!(come(&mut live).is_empty());
    std::thread::sleep(Duration::from_millis(3100));
    let arrivals = come(&mut live);
    let said: Vec<String> = arrivals.iter().map(|arrival| arrival.place.clone().unwrap_err()).collect();
    assert!(arrivals[0].name == "frames.csv" && said[0].contains("lists no photograph yet"), "{arrivals:?}");
    fs::write(&table, table_of(&tour, 4)).unwrap();
    assert_eq!(placed(&come(&mut live)).len(), 4);
    assert!(live.finish().unwrap().1.is_empty());
}

#[test]
fn photographs_that_are_taken_away_or_of_another_depth_are_left_out_and_the_map_is_made() {
    let tour = Tour { photographs: 5, laps: 0.2, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    (0..5).for_each(|i| put(from, to, i, &tour));
    assert_eq!(placed(&come(&mut live)).len(), 5);
    image::open(from.join("004.png")).unwrap().to_rgb16().save(to.join("deep.png")).unwrap();
    let arrivals = come(&mut live);
    assert!(arrivals[0].place.clone().unwrap_err().contains("65535"), "{arrivals:?}");
    fs::remove_file(to.join("004.png")).unwrap();
    let (shots, notes) = live.finish().unwrap();
    for (name, why) in [("004.png", "not there any more"), ("deep.png", "65535")] {
        assert!(notes.iter().any(|note| note.starts_with(name) && note.contains(why)), "{name}: {notes:?}");
    }
    assert_eq!(mosaic(&shots, &options(&tour), &Silent).unwrap().placed.len(), 4);
    assert!(!fs::read_to_string(to.join("frames.csv")).unwrap().contains("004.png"));
}

#[test]
fn a_line_with_a_fault_is_left_out_at_once_and_the_others_go_on() {
    let tour = Tour { photographs: 6, laps: 0.2, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    (0..6).for_each(|i| put(from, to, i, &tour));
    let table = to.join("frames.csv");
    let check = |left: &[(usize, &str)], twice: Option<&str>, tracking: &Tracking| {
        let mut live = Live::open(to, tracking, Wanted::default(), |_| Ok(options(&tour))).unwrap();
        let arrivals = come(&mut live);
        for (i, why) in left {
            let arrival = arrivals.iter().find(|arrival| arrival.name == photograph(*i)).unwrap();
            assert!(arrival.place.clone().unwrap_err().contains(why), "{arrivals:?}");
        }
        assert_eq!(live.count(), 6 - left.len(), "{arrivals:?}");
        assert!(live.is_settled());
        let (shots, notes) = live.finish().unwrap();
        assert_eq!((shots.shots.len(), notes.len()), (6 - left.len(), left.len() + twice.iter().len()));
        for (name, why) in left.iter().map(|(i, why)| (photograph(*i), *why)) {
            assert!(notes.iter().any(|note| note.contains(&name) && note.contains(why)), "{notes:?}");
        }
        if let Some(twice) = twice {
            assert!(notes.iter().any(|note| note.starts_with("frames.csv") && note.contains(twice)));
        }
    };
    // How it was turned.
    let turned = |i: usize, more: &str| turned(&photograph(i), tour.truth()[i]).replace('\n', more);
    let lines = [
        turned(0, ",1,\n"),
        turned(1, ",0,\n"),
        turned(2, ",1,\n"),
        turned(0, ",1,\n"),
        turned(3, ",1,-2\n"),
        turned(4, ",1,3\n"),
        turned(5, ",1,\n"),
    ];
    fs::write(&table, format!("file,qw,qx,qy,qz,exposure_s,sigma_deg\n{}", lines.concat())).unwrap();
    let faults = [(1, "exposure_s = 0"), (3, "sigma_deg = -2")];
    check(&faults, Some("lists 000.png twice"), &Tracking::default());
    // When it was taken.
    fs::write(to.join("tracker.jsonl"), records_until(from, 1e9)).unwrap();
    let times = head(from, "frames.csv", |i, _| i > 0);
    let line = |i: usize| format!("{}\n", times.lines().nth(i).unwrap());
    let order: String = [0, 3, 2, 4, 1, 5].map(line).concat();
    fs::write(&table, format!("file,time_s\n{order}")).unwrap();
    check(&[(2, "earlier than 003.png"), (1, "earlier than 004.png")], None, &tracking(&tour));
}

#[test]
fn a_table_of_times_stays_one_when_a_later_line_says_how_the_camera_was_turned() {
    let tour = Tour { photographs: 4, laps: 0.15, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    (0..4).for_each(|i| put(from, to, i, &tour));
    fs::write(to.join("tracker.jsonl"), records_until(from, 1e9)).unwrap();
    let times = head(from, "frames.csv", |i, _| i > 0);
    let lines: Vec<String> = times.lines().map(|line| format!("{line},,,,\n")).collect();
    let table = |lines: &[String]| {
        fs::write(to.join("frames.csv"), format!("file,time_s,qw,qx,qy,qz\n{}", lines.concat())).unwrap();
    };
    table(&lines[..2]);
    let mut live = Live::open(to, &tracking(&tour), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    assert_eq!(placed(&come(&mut live)).len(), 2);
    let turned = lines[2].replace(",,,,", ",1,0,0,0");
    table(&[lines[0].clone(), lines[1].clone(), turned, lines[3].clone()]);
    let (found, not): (Vec<Arrival>, _) = come(&mut live).into_iter().partition(|a| a.place.is_ok());
    assert!(found.len() == 1 && not.len() == 1 && not[0].name == "002.png", "{not:?}");
    let (shots, notes) = live.finish().unwrap();
    assert!(shots.shots.len() == 3 && notes.len() == 1 && notes[0].contains("002.png"), "{notes:?}");
}

#[test]
fn a_map_is_made_of_those_that_have_a_place_and_of_the_others_it_is_said_why() {
    let tour = Tour { photographs: 6, laps: 0.2, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    (0..6).for_each(|i| put(from, to, i, &tour));
    image::RgbImage::new(50, 40).save(to.join("small.png")).unwrap();
    fs::copy(from.join("000.png"), to.join("unsaid.png")).unwrap();
    fs::copy(from.join("000.png"), to.join("unlisted.png")).unwrap();
    fs::write(to.join("half.png"), &fs::read(from.join("000.png")).unwrap()[..500]).unwrap();
    let turn = tour.truth()[0];
    let others: String = ["small.png", "missing.png", "half.png"].map(|name| turned(name, turn)).concat();
    fs::write(to.join("frames.csv"), table_of(&tour, 6) + &others + "unsaid.png,,,,\n").unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    come(&mut live);
    assert!(live.count() == 6 && !live.is_settled(), "one is not whole");
    let (shots, notes) = live.finish().unwrap();
    let names: Vec<String> = shots.shots.iter().map(rigel::environment::Shot::name).collect();
    assert_eq!(names, (0..6).map(photograph).collect::<Vec<_>>());
    for (name, why) in [
        ("small.png", "50x40"),
        ("missing.png", "not there"),
        ("half.png", "complete"),
        ("unsaid.png", "neither how"),
        ("unlisted.png", "does not list"),
    ] {
        assert!(notes.iter().any(|note| note.starts_with(name) && note.contains(why)), "{name}: {notes:?}");
    }
    assert_eq!(notes.len(), 5);
    assert_eq!(mosaic(&shots, &options(&tour), &Silent).unwrap().placed.len(), 6);
}

#[test]
fn what_follows_the_last_line_break_of_a_table_waits_and_so_does_what_cannot_be_read_yet() {
    let tour = Tour { photographs: 3, laps: 0.05, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    (0..3).for_each(|i| put(from, to, i, &tour));
    let open = || Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let (one, two) = (table_of(&tour, 1), table_of(&tour, 2));
    let file = to.join("frames.csv");
    fs::write(&file, &one).unwrap();
    let mut live = open();
    assert_eq!(placed(&come(&mut live)).len(), 1);
    for end in one.len()..two.len() {
        fs::write(&file, &two[..end]).unwrap();
        assert!(come(&mut live).is_empty(), "{end}");
    }
    std::thread::sleep(Duration::from_millis(3100));
    let arrivals = come(&mut live);
    assert!(
        arrivals[0].name == "frames.csv" && arrivals[0].place.clone().unwrap_err().contains("line break")
    );
    // And what has been there for long without a line.
    for (arrival, i) in arrivals[1..].iter().zip([1, 2]) {
        assert!(arrival.name == photograph(i), "{arrivals:?}");
        assert!(arrival.place.clone().unwrap_err().contains("does not list it"), "{arrivals:?}");
    }
    assert_eq!(arrivals.len(), 3);
    assert!(come(&mut live).is_empty(), "once is enough");
    fs::write(&file, &two).unwrap();
    let places = placed(&come(&mut live));
    assert!(places.len() == 1 && places[0].turn.angle_between(tour.truth()[1]) < 1e-6);
    let notes = live.finish().unwrap().1;
    assert!(notes.len() == 1 && notes[0].contains("002.png"), "{notes:?}");
    // The same of a file that is nothing until it is whole.
    fs::remove_file(&file).unwrap();
    let file = to.join("frames.json");
    let json = r#"{"frames": [{"file": "000.png", "yaw_deg": 0, "pitch_deg": 0, "roll_deg": 0}]}"#;
    fs::write(&file, "").unwrap();
    let mut live = open();
    for end in (0..json.len()).step_by(7) {
        fs::write(&file, &json[..end]).unwrap();
        assert!(placed(&come(&mut live)).is_empty() && !live.is_settled(), "{end}");
    }
    fs::write(&file, json).unwrap();
    assert_eq!(placed(&come(&mut live)).len(), 1);
}

#[test]
fn names_are_kept_as_they_are_and_one_that_no_table_can_hold_is_refused() {
    let tour = Tour { photographs: 4, laps: 0.15, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let names = ["a, b.png", "say \"cheese\".png", "#1 ä.png", "\"left, right\".png"];
    for (i, name) in names.iter().enumerate() {
        put(from, to, i, &tour);
        fs::rename(to.join(photograph(i)), to.join(name)).unwrap();
    }
    assert_eq!(placed(&come(&mut live)).len(), 4);
    #[cfg(unix)]
    {
        let name = <std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(b"\xff.png");
        // Some file systems take no such names.
        if fs::copy(from.join("000.png"), to.join(name)).is_ok() {
            let arrivals = come(&mut live);
            assert!(
                arrivals.len() == 1 && arrivals[0].place.clone().unwrap_err().contains("another name"),
                "{arrivals:?}"
            );
        }
    }
    let (shots, _) = live.finish().unwrap();
    let paths = |shots: &Shots| -> Vec<_> { shots.shots.iter().map(|shot| shot.path.clone()).collect() };
    assert_eq!(paths(&shots), names.map(|name| to.join(name)));
    assert_eq!(paths(&Shots::read(to).unwrap()), paths(&shots));
}

#[test]
fn a_first_photograph_that_shows_nothing_holds_nobody_up() {
    let tour = Tour { photographs: 3, laps: 0.1, ..tour() };
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (from, to) = (all.path(), folder.path());
    tour.write(from).unwrap();
    let mut live = Live::open(to, &Tracking::default(), Wanted::default(), |_| Ok(options(&tour))).unwrap();
    let wall = image::RgbImage::from_pixel(tour.lens.width, tour.lens.height, image::Rgb([90; 3]));
    wall.save(to.join("wall.png")).unwrap();
    let arrivals = come(&mut live);
    assert!(arrivals.len() == 1 && arrivals[0].place.clone().unwrap_err().contains("too few details"));
    (0..3).for_each(|i| put(from, to, i, &tour));
    let (found, not): (Vec<Arrival>, _) = come(&mut live).into_iter().partition(|a| a.place.is_ok());
    assert!(found.len() == 3 && not.iter().all(|arrival| arrival.name == "wall.png"), "{not:?}");
    assert!(live.is_settled());
    assert!(live.finish().unwrap().1[0].contains("wall.png"));
}

#[test]
fn a_tracker_that_is_described_must_be_there() {
    let (tour, folder) = (tour(), tempfile::tempdir().unwrap());
    let open = || Live::open(folder.path(), &tracking(&tour), Wanted::default(), |_| Ok(options(&tour)));
    let refused = open().err().unwrap().to_string();
    assert!(refused.contains("tracker.jsonl") && refused.contains("--delay"), "{refused}");
    fs::write(folder.path().join("tracker.jsonl"), "").unwrap();
    fs::write(folder.path().join("frames.csv"), table_of(&tour, 2)).unwrap();
    let mut live = open().unwrap();
    // What says the orientations itself asks no tracker.
    let refused = (0..2).find_map(|_| live.look().err()).unwrap().to_string();
    assert!(refused.contains("frames.csv") && refused.contains("--delay"), "{refused}");
}

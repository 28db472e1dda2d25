//! The command captures with the firmware's image in an emulator, and a simulated tracker on the image's second line.
//!
//! No time is asserted; but the emulator must keep up with a host that expects answers within two seconds.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use image::ImageEncoder;
use rigel::camera::exif;
use rigel::capture::{TRACKER_FILE, TrackerLine};
use rigel::rig::{SerialRig, TrackerState};
use rigel::session::Session;
use rigel::tracker::TrackerRecord;
use rigel_protocol::Record;
use rigel_simulated::tracker::{Tracker, TrackerOptions, TrackerRunner, gentle};
use rigel_tests::image::Image;

mod emulated;

use emulated::{Board, Edges};

const VIEWS: usize = 30;
/// What a contact can expose at the shortest is a sixtieth of a second: two photographs for every view.
const BRACKET_S: [f64; 2] = [1.0 / 30.0, 1.0 / 60.0];
/// As `firmware/board/src/rig.rs` has it.
const STEPS_PER_TURN: f64 = 16_000.0;
/// A rig that hears a record so much later than its neighbours, seconds, may not believe it; QEMU hands bytes over in time
/// unless its machine gives it no time to run.
const STARVED_S: f64 = 0.025;
/// Where more than one record in so many was refused, for being late, what remains shows nothing; records that were heard late
/// and believed all the same, a busy machine's, are no fault of the image.
const MOST_REFUSED: usize = 10;
/// How many records before and after a refused one tell whether the machine was busy then.
const NEIGHBOURS: usize = 8;
/// Within so many records the rig must have found its way into the tracker's.
const FIRST_RECORDS: usize = 60;
/// So many records at most, of sixty in a second, are said after the last that was written.
const LAST_RECORDS: usize = 120;
/// Of the 120 KiB that are free.
const DEEPEST_STACK: usize = 16 * 1024;

#[test]
fn the_image_captures_thirty_views_while_the_tracker_talks() {
    let Some(image) = emulated::image() else { return };
    let (board, tracker_line) = Board::start(&image);
    tracker_line.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let tracker = TrackerRunner::start(Tracker::new(TrackerOptions::default(), gentle()), tracker_line);
    let folder = tempfile::tempdir().unwrap();
    let card = folder.path().join("card");
    fs::create_dir(&card).unwrap();
    let camera = Camera::start(board.watch(), &card);

    let start = Instant::now();
    let [view_count, longest_s] = [VIEWS.to_string(), BRACKET_S[0].to_string()];
    let output = Command::new(env!("CARGO_BIN_EXE_rigel"))
        .current_dir(folder.path())
        .args(["capture", "session", "--rig", &board.port_name, "--camera", "trigger:card", "--tracker"])
        .args(["--sampling", "spiral", "--views", &view_count, "--zenith-limit", "40"])
        .args(["--longest-exposure-time", &longest_s])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let took = start.elapsed();
    let told = [output.stdout, output.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    let edges = board.edges().clone();
    assert!(output.status.success(), "{told:?}\n{edges:?}");
    let said = tracker.tracker().take_said();
    drop(camera);
    // Its counts stay when it is switched off: nothing found no room in the rig.
    let status = SerialRig::greet(&board.port_name).unwrap().tracker().unwrap();
    assert_eq!((status.state, status.overrun), (TrackerState::Off, 0), "{status:?}");

    let frames = check_photographs(&folder.path().join("session"), &board.edges());
    let (records, latest_s) = check_records(&folder.path().join("session"), &said);
    // QEMU's clock goes on while QEMU waits for its machine: to the image the tracker is silent then.
    assert!(
        status.restarts == 0 || latest_s > STARVED_S,
        "the tracker was started again although the machine had time: {status:?}"
    );
    let forwarded = status.forwarded as usize;
    assert!((records..records + LAST_RECORDS).contains(&forwarded), "{records} are written: {status:?}");
    let parts = Image::read(&image).unwrap();
    let stack = parts.deepest_stack(&board.memory(parts.stack_end, parts.stack_start - parts.stack_end));
    println!(
        "{VIEWS} views, {frames} photographs, {records} records in {:.0} s; deepest stack {stack} bytes",
        took.as_secs_f64()
    );
    assert!((1..=DEEPEST_STACK).contains(&stack), "{stack}");
}

/// Every photograph was taken where the session says, standing still; tells how many there are.
fn check_photographs(session: &Path, edges: &Edges) -> usize {
    let session = Session::open(session).unwrap();
    assert_eq!(session.done_views().len(), VIEWS);
    let frames: usize = (0..VIEWS).map(|view| session.photographs(view).len()).sum();
    assert_eq!(frames, VIEWS * BRACKET_S.len());
    assert_eq!(
        (edges.photographs.len(), edges.ended),
        (frames, frames),
        "frames are neither lost nor doubled"
    );
    assert_eq!((edges.blurred, edges.unfocused, edges.enabled), (0, 0, true));

    let step = |degrees: Option<f64>| {
        // What is commanded is a whole number of thousandths of a degree, and the nearest step to that.
        let mdeg = (degrees.unwrap() * 1e3).round();
        (mdeg * STEPS_PER_TURN / 360e3).round() as i64
    };
    let commanded: Vec<[i64; 2]> = (0..VIEWS)
        .flat_map(|view| {
            let count = session.photographs(view).len();
            let view = &session.manifest.views[view];
            std::iter::repeat_n([step(view.pan_deg), step(view.tilt_deg)], count)
        })
        .collect();
    // Where the rig stood when the power came, nobody knows; from then on every step counts.
    let zero = [0, 1].map(|axis| edges.photographs[0].at[axis] - commanded[0][axis]);
    for (photograph, commanded) in edges.photographs.iter().zip(&commanded) {
        assert_eq!([0, 1].map(|axis| photograph.at[axis] - zero[axis]), *commanded);
    }
    let ways = [0, 1].map(|axis| commanded.iter().map(|at| at[axis]).max().unwrap());
    assert!(ways.iter().all(|&way| way > 100), "the views are apart: {ways:?}");
    frames
}

/// Every record is one that the tracker said, unchanged, once and in order; every one that the rig has believed is there, with
/// stamps that grow; and the rig has believed all, unless the machine had no time for it. Tells how many there are, and by how
/// much the latest was heard later than the earliest, seconds.
fn check_records(session: &Path, said: &[Record]) -> (usize, f64) {
    let text = fs::read_to_string(session.join(TRACKER_FILE)).unwrap();
    let lines: Vec<TrackerLine> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let as_line = |said: &Record| {
        let at = std::time::UNIX_EPOCH + Duration::from_micros(said.at_us);
        TrackerLine::from(TrackerRecord::new(at, 0.0, said).expect("no quaternion is zero"))
    };
    let said: Vec<TrackerLine> = said.iter().map(as_line).collect();
    let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    let same = |a: &TrackerLine, b: &TrackerLine| {
        (a.station, a.status) == (b.station, b.status)
            && near(&a.position_m, &b.position_m)
            && near(&a.orientation, &b.orientation)
    };
    assert!(lines.len() > 600, "{} records", lines.len());
    // While the tracker starts, the rig listens in the middle of a record and then doubts what it hears.
    let first = said.iter().take(FIRST_RECORDS).position(|said| same(&lines[0], said));
    let first = first.unwrap_or_else(|| panic!("{:?} is none of the first records", lines[0]));
    // How late each of the tracker's records was heard, from the first on; `None` where the rig refused it.
    let mut delays: Vec<Option<f64>> = vec![];
    let mut before = 0.0;
    for (count, line) in (0..).zip(&lines) {
        assert_eq!(line.count, count, "a record was lost between rig and host");
        assert!(line.at_s > before, "record {count} is stamped before the one before it: {line:?}");
        before = line.at_s;
        let left = &said[first + delays.len()..];
        let skipped = left.iter().position(|said| same(line, said));
        let skipped = skipped.unwrap_or_else(|| panic!("record {count} was not said, or not then: {line:?}"));
        delays.extend(vec![None; skipped]);
        delays.push(Some(line.at_s - left[skipped].at_s));
    }
    let earliest = delays.iter().flatten().fold(f64::MAX, |earliest, delay| earliest.min(*delay));
    let late_s = |delays: &[Option<f64>]| {
        delays.iter().flatten().fold(0.0, |latest: f64, delay| latest.max(delay - earliest))
    };
    let refused: Vec<usize> = (0..delays.len()).filter(|&index| delays[index].is_none()).collect();
    let starved = delays.iter().flatten().filter(|delay| **delay - earliest > STARVED_S).count();
    let latest_s = late_s(&delays);
    let (after, last) = (said.len() - first - delays.len(), &delays[delays.len() - NEIGHBOURS..]);
    assert!(
        after < LAST_RECORDS || late_s(last) > STARVED_S,
        "{after} records were said after the last that was written"
    );
    println!(
        "{} records refused by the rig; {starved} heard late, the latest by {:.0} ms",
        refused.len(),
        1e3 * latest_s
    );
    for &index in &refused {
        let near = &delays[index.saturating_sub(NEIGHBOURS)..delays.len().min(index + NEIGHBOURS)];
        assert!(
            late_s(near) > STARVED_S,
            "record {index} was refused although its machine had time: {near:?}"
        );
    }
    assert!(
        refused.len() <= lines.len() / MOST_REFUSED,
        "the machine is too busy to show anything: {} of {} records were refused",
        refused.len(),
        lines.len()
    );
    (lines.len(), latest_s)
}

/// The camera on the trigger line: whenever its contact has been opened, a photograph appears on its card.
struct Camera {
    ended: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Camera {
    fn start(edges: Arc<Mutex<Edges>>, card: &Path) -> Self {
        let (ended, card) = (Arc::new(AtomicBool::new(false)), card.to_path_buf());
        let thread = {
            let ended = ended.clone();
            std::thread::spawn(move || {
                let mut stored = 0;
                while !ended.load(Ordering::Relaxed) {
                    let next = {
                        let edges = edges.lock().unwrap();
                        (edges.ended > stored).then(|| edges.photographs[stored].time)
                    };
                    let Some(time) = next else {
                        std::thread::sleep(Duration::from_millis(2));
                        continue;
                    };
                    let mut jpeg = Vec::new();
                    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
                    let exposure_s = BRACKET_S[stored % BRACKET_S.len()];
                    encoder.set_exif_metadata(exif::block(exposure_s, Some(time))).unwrap();
                    // The first of a view is overexposed, and no photograph is quite like another.
                    let grey = [255, 160][stored % BRACKET_S.len()];
                    let pixels: Vec<u8> = (0..16 * 16).map(|i| if i < stored { 90 } else { grey }).collect();
                    encoder.write_image(&pixels, 16, 16, image::ExtendedColorType::L8).unwrap();
                    let name = card.join(format!("dsc{stored:04}"));
                    fs::write(&name, jpeg).unwrap();
                    fs::rename(&name, name.with_extension("jpg")).unwrap();
                    stored += 1;
                }
            })
        };
        Self { ended, thread: Some(thread) }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

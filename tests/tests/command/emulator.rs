//! The command captures with the firmware's image in an emulator, and a simulated tracker on the image's second line.

use std::process::Stdio;
use std::time::{Duration, Instant};

use rigel::session::Session;
use rigel_simulated::tracker::{Tracker, TrackerOptions, TrackerRunner, gentle};

mod emulated;

use emulated::Board;

const VIEWS: usize = 30;

#[test]
fn the_image_captures() {
    let Some(image) = emulated::image() else { return };
    let (board, tracker_line) = Board::start(&image);
    tracker_line.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let tracker = TrackerRunner::start(Tracker::new(TrackerOptions::default(), gentle()), tracker_line);
    let folder = tempfile::tempdir().unwrap();
    let start = Instant::now();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_rigel"))
        .current_dir(folder.path())
        .args(["capture", "session", "--rig", &board.port_name, "--sampling", "spiral", "--views", "30"])
        .args(["--zenith-limit", "40"])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    eprintln!(
        "{:?} {}{}",
        start.elapsed(),
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    eprintln!("{:?}", board.edges());
    assert!(output.status.success());
    let session = Session::open(&folder.path().join("session")).unwrap();
    assert_eq!(session.done_views().len(), VIEWS);
    drop(tracker);
}

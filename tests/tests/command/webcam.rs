//! The real command with a webcam: nokhwa's own way to a V4L2 device, which `tools/webcam_shim` answers for. The script
//! `tools/webcam_check` builds that and runs this.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[expect(dead_code, reason = "other tests use the rest")]
mod common;

use std::fs;
use std::path::Path;
use std::process::Output;

use rigel::session::{Photograph, Session};

use common::{assert_refused, rigel};

const VIEWS: usize = 2;
/// The shim's wedge goes from a fifth of its brightest level to this, which is white after so many seconds.
const WHITE_S: f64 = 0.04;
const DARKEST: f64 = 0.2;

/// Captures with the webcam; `faults` are the shim's.
fn capture(folder: &Path, faults: &[(&str, &str)], more: &[&str]) -> Output {
    let shim = std::env::var_os("WEBCAM_SHIM").expect("run tools/webcam_check, which builds the shim");
    let views = VIEWS.to_string();
    let mut arguments = vec!["capture", "session", "--camera", "webcam", "--views", &views];
    arguments.extend(["--sampling", "spiral", "--longest-exposure-time", "0.08"]);
    arguments.extend(more);
    let mut command = rigel(folder, &arguments);
    command.env("LD_PRELOAD", shim).env("WEBCAM_SHIM_LOG", folder.join("log"));
    command.envs(faults.iter().copied()).output().unwrap()
}

fn captured(folder: &Path, faults: &[(&str, &str)], more: &[&str]) -> Vec<Photograph> {
    let output = capture(folder, faults, more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let session = Session::open(&folder.join("session")).unwrap();
    (0..VIEWS).flat_map(|view| session.photographs(view).into_iter().cloned().collect::<Vec<_>>()).collect()
}

/// By how much the mean level of a photograph differs from what the shim shows after the exposure time in the journal.
fn error_of_mean(folder: &Path, photograph: &Photograph) -> f64 {
    let picture = image::open(folder.join("session").join(&photograph.file)).unwrap().to_rgb8();
    let mean = picture.iter().map(|&level| f64::from(level)).sum::<f64>() / picture.len() as f64;
    let expected = (0..picture.width()).map(|x| {
        let brightness = DARKEST + (1.0 - DARKEST) * f64::from(x) / f64::from(picture.width() - 1);
        255.0 * (brightness * photograph.exposure_s.unwrap() / WHITE_S).min(1.0)
    });
    mean - expected.sum::<f64>() / f64::from(picture.width())
}

fn assert_means_follow(folder: &Path, photographs: &[Photograph]) {
    for photograph in photographs {
        let error = error_of_mean(folder, photograph);
        assert!(error.abs() < 1.5, "{} is off by {error} levels", photograph.file);
    }
}

fn exposures_ms(photographs: &[Photograph]) -> Vec<f64> {
    photographs.iter().map(|photograph| (photograph.exposure_s.unwrap() * 1e4).round() / 10.0).collect()
}

#[test]
fn photographs_show_the_exposure_that_the_journal_has() {
    let folder = tempfile::tempdir().unwrap();
    let photographs = captured(folder.path(), &[], &[]);
    assert_eq!(exposures_ms(&photographs), [80.0, 40.0, 20.0, 80.0, 40.0, 20.0]);
    assert_means_follow(folder.path(), &photographs);
    let log = fs::read_to_string(folder.path().join("log")).unwrap();
    for line in
        ["control 0x98090c set 0", "control 0x980912 set 0", "control 0x9a0901 set 1", "exposure 800 set 800"]
    {
        assert!(log.contains(line), "the driver never saw: {line}");
    }
    let journal = fs::read_to_string(folder.path().join("session/journal.jsonl")).unwrap();
    assert!(
        journal.contains("webcam 0 (Simulated webcam), 64x48, Yuyv, gain 0, white balance 4600"),
        "{journal}"
    );
}

#[test]
fn without_throwing_frames_away_the_means_would_not_follow() {
    let folder = tempfile::tempdir().unwrap();
    // A camera that is slower than any: this shows that the check above would notice old frames.
    let photographs = captured(folder.path(), &[("WEBCAM_SHIM_LATENCY", "40")], &[]);
    assert!(photographs.iter().any(|photograph| error_of_mean(folder.path(), photograph).abs() > 10.0));
}

#[test]
fn the_exposure_that_the_driver_really_set_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let photographs = captured(folder.path(), &[("WEBCAM_SHIM_STEP", "30")], &[]);
    assert_eq!(exposures_ms(&photographs), [78.0, 39.0, 18.0, 78.0, 39.0, 18.0]);
    assert_eq!(photographs[0].asked_exposure_s, Some(0.08));
    assert_means_follow(folder.path(), &photographs);
}

#[test]
fn a_driver_that_clamps_the_exposure_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = capture(folder.path(), &[("WEBCAM_SHIM_MOST", "500")], &[]);
    let names = ["webcam 0 (Simulated webcam)", "0.0500 s", "0.0800 s"];
    assert_refused("a clamped exposure", &output, &names);
    assert_eq!(fs::read_dir(folder.path().join("session/photographs")).unwrap().count(), 0);
    assert_eq!(captured(folder.path(), &[], &["--resume"]).len(), 6);
}

#[test]
fn an_exposure_beyond_the_driver_s_range_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = rigel(folder.path(), &["capture", "session", "--camera", "webcam"]);
    command
        .args(["--longest-exposure-time", "3"])
        .env("LD_PRELOAD", std::env::var_os("WEBCAM_SHIM").unwrap());
    assert_refused("3 s", &command.output().unwrap(), &["0.0001 to 1 s", "--longest-exposure-time"]);
}

#[test]
fn a_webcam_that_vanishes_is_an_error_and_the_session_goes_on_when_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let output = capture(folder.path(), &[("WEBCAM_SHIM_VANISH", "25")], &[]);
    assert_refused("a webcam without its cable", &output, &["webcam 0 (Simulated webcam)", "No such device"]);
    let before = Session::open(&folder.path().join("session")).unwrap().photographs(0).len();
    assert!(before > 0, "it took something before");
    let photographs = captured(folder.path(), &[], &["--resume"]);
    assert_eq!(photographs.len(), 6);
    assert_means_follow(folder.path(), &photographs);
}

#[test]
fn a_webcam_that_repeats_a_frame_or_sends_none_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let output = capture(folder.path(), &[("WEBCAM_SHIM_REPEAT", "14")], &[]);
    assert_refused("a stuck webcam", &output, &["webcam 0 (Simulated webcam)", "the same frame again"]);
    let folder = tempfile::tempdir().unwrap();
    let output = capture(folder.path(), &[("WEBCAM_SHIM_STALL", "14")], &[]);
    assert_refused("a silent webcam", &output, &["webcam 0 (Simulated webcam)", "sent nothing for"]);
}

#[test]
fn a_webcam_that_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let output = rigel(folder.path(), &["capture", "session", "--camera", "webcam:7"]).output().unwrap();
    assert_refused("no webcam", &output, &["webcam 7"]);
    assert!(!folder.path().join("session").exists());
}

#[test]
fn what_is_attached_is_listed_by_the_name_that_capture_takes() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = rigel(folder.path(), &["devices"]);
    let output = command.env("LD_PRELOAD", std::env::var_os("WEBCAM_SHIM").unwrap()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let listed = String::from_utf8_lossy(&output.stdout);
    assert!(listed.lines().any(|line| line == "webcam:0: Simulated webcam"), "{listed}");
}

//! Ctrl-C in the middle: exit code 130, one sentence, no half file; and radiance goes on where it stopped.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use std::fs;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use rigel::radiance::RadianceImage;
use rigel::rig::State;
use rigel::session::Session;
use rigel_simulated::rig::{RigOptions, SimulatedRig};

use common::{IMPORT, VIEWS, assert_refused, assert_untouched, rigel, snapshot, succeed, workshop};

/// Starts the command on one thread, so that it does one thing after the other.
fn start(folder: &Path, arguments: &[&str]) -> Child {
    let mut command = rigel(folder, arguments);
    command.env("RAYON_NUM_THREADS", "1").stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// Waits, at most a minute, until something can be had; the command must still be running then.
fn wait_for<T>(child: &mut Child, mut what: impl FnMut(u32) -> Option<T>) -> T {
    for _ in 0..60_000 {
        assert!(child.try_wait().unwrap().is_none(), "the command ended before it was interrupted");
        if let Some(found) = what(child.id()) {
            return found;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    panic!("waited in vain");
}

/// Whether the command has a say in what Ctrl-C does.
fn catches_interrupts(process: u32) -> Option<()> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"))?;
    (u64::from_str_radix(caught.trim(), 16).ok()? & 1 << 1 != 0).then_some(())
}

fn interrupt(child: &Child) {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
}

fn assert_interrupted(output: &Output) {
    assert_eq!(output.status.code(), Some(130), "{output:?}");
    // At once, that it was heard; at the end, what is left.
    let at_once = "rigel: stopping; Ctrl-C again ends it at once\n";
    let stderr = output.stderr.strip_prefix(at_once.as_bytes()).expect("says that it stops").to_vec();
    assert_refused("what was interrupted", &Output { stderr, ..output.clone() }, &["interrupted"]);
}

/// Puts a pipe where a photograph was: whoever reads it waits. Returns the photograph.
fn pipe_in_place_of(photograph: &Path) -> Vec<u8> {
    let bytes = fs::read(photograph).unwrap();
    fs::remove_file(photograph).unwrap();
    assert!(Command::new("mkfifo").arg(photograph).status().unwrap().success());
    bytes
}

/// Interrupts the command while it reads that pipe, then lets it read on.
fn interrupt_at(mut child: Child, pipe: &Path, photograph: &[u8]) -> Output {
    // Opening a pipe without waiting (O_NONBLOCK) fails as long as nobody reads it.
    let open = || fs::OpenOptions::new().write(true).custom_flags(0o4000).open(pipe).ok();
    let mut writer = wait_for(&mut child, |_| open());
    interrupt(&child);
    // The signal is noted on a thread of its own.
    std::thread::sleep(Duration::from_millis(300));
    writer.write_all(photograph).unwrap();
    drop(writer);
    child.wait_with_output().unwrap()
}

/// Makes the session's photographs so large that a view takes longer than a signal.
fn enlarge(folder: &Path) {
    for path in snapshot(&folder.join("session/photographs")).into_keys() {
        let small = image::open(&path).unwrap();
        let (width, height) = (8 * small.width(), 8 * small.height());
        small.resize_exact(width, height, image::imageops::FilterType::Nearest).save(&path).unwrap();
    }
}

/// Interrupts the command when it has written the radiance of a view.
fn interrupt_after_a_view(mut child: Child, radiance: &Path) -> Output {
    wait_for(&mut child, |_| {
        let mut names = fs::read_dir(radiance).ok()?.map(|entry| entry.unwrap().path());
        names.find(|name| name.extension().is_some_and(|end| end == "exr"))
    });
    interrupt(&child);
    child.wait_with_output().unwrap()
}

/// The same files with the same radiance; OpenEXR files by their values, for the order of a header's attributes is open.
fn assert_same_radiance(left: &Path, right: &Path) {
    let (left, right) = (left.join("session/radiance"), right.join("session/radiance"));
    let names = |folder: &Path| -> Vec<_> {
        snapshot(folder).into_keys().map(|name| name.strip_prefix(folder).unwrap().to_owned()).collect()
    };
    assert_eq!(names(&left), names(&right));
    // What it was made from has the photographs' times of change in it.
    for name in names(&left).into_iter().filter(|name| !name.ends_with("made_from.txt")) {
        let [left, right] = [left.join(&name), right.join(&name)];
        let same = match name.extension().is_some_and(|end| end == "exr") {
            true => RadianceImage::read_exr(&left).unwrap() == RadianceImage::read_exr(&right).unwrap(),
            false => fs::read(left).unwrap() == fs::read(right).unwrap(),
        };
        assert!(same, "{} differs", name.display());
    }
}

#[test]
fn a_capture_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("session");
    let mut child = start(folder.path(), &["capture", "session", "--views", "17"]);
    wait_for(&mut child, |_| {
        let journal = fs::read_to_string(session.join("journal.jsonl")).ok()?;
        (journal.matches("view_done").count() >= 2).then_some(())
    });
    interrupt(&child);
    let output = child.wait_with_output().unwrap();
    assert_interrupted(&output);
    let told = String::from_utf8(output.stdout).unwrap();
    assert!(told.contains("rigel capture session --resume"), "{told}");

    let half = Session::open(&session).unwrap();
    let views = half.manifest.views.len();
    let done = half.done_views();
    assert!(done.len() >= 2 && done.len() < views, "{} of {views} views are done", done.len());
    let photographs = done.iter().flat_map(|&view| half.photographs(view));
    let photographs: Vec<_> = photographs.map(|photograph| half.photograph_path(photograph)).collect();
    let read = || photographs.iter().map(|path| fs::read(path).unwrap()).collect::<Vec<_>>();
    let before = read();
    let left = snapshot(folder.path());
    assert!(left.keys().all(|name| !name.to_string_lossy().contains("rigel-tmp")), "{:?}", left.keys());

    let told = succeed(folder.path(), &["capture", "session", "--resume"]);
    assert!(told.contains(&format!("{} view", views - done.len())), "{told}");
    let whole = Session::open(&session).unwrap();
    assert_eq!((&whole.manifest, whole.done_views().len()), (&half.manifest, views));
    assert!(read() == before, "a finished photograph was taken again");
    for view in 0..views {
        assert!(whole.photographs(view).iter().all(|photograph| whole.photograph_path(photograph).is_file()));
    }
}

#[test]
fn an_import_leaves_nothing() {
    let folder = workshop();
    let pipe = folder.path().join("photos/view001_0.png");
    let photograph = pipe_in_place_of(&pipe);
    let before = snapshot(folder.path());
    let child =
        start(folder.path(), &[&["import", "photos", "new", "--csv", "views.csv"], &IMPORT[..]].concat());
    assert_interrupted(&interrupt_at(child, &pipe, &photograph));
    assert_untouched("an interrupted import", &before, &snapshot(folder.path()));
}

/// Before the first view is there, there is nothing to go on from.
#[test]
fn radiance_that_has_not_begun_leaves_nothing() {
    let folder = workshop();
    fs::remove_dir_all(folder.path().join("session/radiance")).unwrap();
    let pipe = folder.path().join("session/photographs/view000_0.png");
    let photograph = pipe_in_place_of(&pipe);
    let before = snapshot(folder.path());
    let child = start(folder.path(), &["radiance", "session", "--response", "srgb"]);
    assert_interrupted(&interrupt_at(child, &pipe, &photograph));
    assert_untouched("radiance that has not begun", &before, &snapshot(folder.path()));
}

#[test]
fn radiance_goes_on_where_it_stopped() {
    let folder = workshop();
    let whole = workshop();
    let measure = ["radiance", "session", "--response", "srgb"];
    for folder in [folder.path(), whole.path()] {
        enlarge(folder);
        fs::remove_dir_all(folder.join("session/radiance")).unwrap();
    }
    succeed(whole.path(), &measure);
    let radiance = folder.path().join("session/radiance");
    assert_interrupted(&interrupt_after_a_view(start(folder.path(), &measure), &radiance));

    let written = |name: &Path| fs::metadata(name).unwrap().modified().unwrap();
    let finished = snapshot(&radiance);
    let views = finished.keys().filter(|name| name.extension().is_some_and(|end| end == "exr"));
    let views: Vec<_> = views.map(|name| (name, written(name))).collect();
    assert!(!views.is_empty() && views.len() < VIEWS, "{} of {VIEWS} views were finished", views.len());
    assert!(views.iter().all(|(name, _)| RadianceImage::read_exr(name).is_ok()), "no file is half");
    assert!(
        finished.keys().all(|name| !name.to_string_lossy().contains("rigel-tmp")),
        "{:?}",
        finished.keys()
    );

    let told = succeed(folder.path(), &measure);
    let counts = format!("{} views now, {} kept", VIEWS - views.len(), views.len());
    assert!(told.contains(&counts), "{told} should say {counts}");
    assert!(views.iter().all(|(name, before)| written(name) == *before), "a finished view was written again");
    assert_same_radiance(folder.path(), whole.path());
}

/// Radiance that is measured anew in another way replaces the old when all of it is there, not before.
#[test]
fn radiance_of_another_response_replaces_the_old_at_the_end() {
    let folder = workshop();
    enlarge(folder.path());
    let old = snapshot(&folder.path().join("session/radiance"));
    let measure = ["radiance", "session", "--response", "linear"];
    let begun = folder.path().join("session/radiance.new");
    assert_interrupted(&interrupt_after_a_view(start(folder.path(), &measure), &begun));
    assert_untouched("the old radiance", &old, &snapshot(&folder.path().join("session/radiance")));

    let told = succeed(folder.path(), &measure);
    assert!(!told.contains(" 0 kept"), "what was finished is kept: {told}");
    assert!(!folder.path().join("session/radiance.new").exists());
    let new = snapshot(&folder.path().join("session/radiance"));
    assert!(new.keys().eq(old.keys()) && new.values().zip(old.values()).all(|(new, old)| new != old));
    let fresh = workshop();
    enlarge(fresh.path());
    fs::remove_dir_all(fresh.path().join("session/radiance")).unwrap();
    succeed(fresh.path(), &measure);
    assert_same_radiance(folder.path(), fresh.path());
}

#[test]
fn an_observation_map_and_a_fit_leave_what_was_there() {
    let folder = workshop();
    succeed(folder.path(), &["observe", "session", "--texels", "160x120"]);
    let before = snapshot(folder.path());

    let mut child = start(folder.path(), &["observe", "session", "--texels", "1024x768"]);
    wait_for(&mut child, |_| {
        let mut names =
            fs::read_dir(folder.path().join("session")).unwrap().map(|entry| entry.unwrap().path());
        names.find(|name| name.extension().is_some_and(|end| end == "rigel-tmp"))
    });
    interrupt(&child);
    assert_interrupted(&child.wait_with_output().unwrap());
    assert_untouched("an interrupted map", &before, &snapshot(folder.path()));

    let fit = ["fit", "session/observations.rigel", "--model", "phong", "--out", "phong.exr"];
    let mut child = start(folder.path(), &fit);
    wait_for(&mut child, catches_interrupts);
    interrupt(&child);
    assert_interrupted(&child.wait_with_output().unwrap());
    assert_untouched("an interrupted fit", &before, &snapshot(folder.path()));
}

#[test]
fn a_rig_that_homes_or_moves_is_told_to_stop_and_stops() {
    let folder = tempfile::tempdir().unwrap();
    let turn = &["move", "--pan", "170", "--tilt", "0"][..];
    for (verb, moving, ends) in
        [(&["home"][..], State::Homing, State::Lost), (turn, State::Moving, State::Still)]
    {
        let simulated = SimulatedRig::start(RigOptions { speed_factor: 3.0, ..Default::default() }).unwrap();
        let position = simulated.position();
        let mut child = start(folder.path(), &[&["rig"], verb, &["--rig", simulated.port_name()]].concat());
        wait_for(&mut child, |_| (position.state() == moving).then_some(()));
        interrupt(&child);
        assert_interrupted(&child.wait_with_output().unwrap());
        // It brakes at the worst; a rig that nobody stopped would be at home or at 170 degrees soon.
        std::thread::sleep(Duration::from_secs(2));
        assert_eq!((position.state(), position.moves().len()), (ends, 0));
    }
}

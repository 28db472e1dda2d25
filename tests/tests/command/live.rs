//! `rigel mosaic --live` as somebody who turns has it: lines, a picture, an end by itself or by Ctrl-C, and then the map.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[expect(dead_code, reason = "each test uses a part of it")]
mod common;

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use rigel::geometry::Lens;
use rigel_simulated::tour::Tour;

use common::{assert_refused, rigel};

const SMALL: [&str; 4] = ["--size", "512x256", "--fov", "67.4"];

fn tour() -> Tour {
    Tour {
        photographs: 30,
        laps: 1.0,
        lens: Lens::pinhole(240, 180, 180.0),
        jitter_rad: 0.0,
        ..Tour::default()
    }
}

fn start(folder: &Path, more: &[&str]) -> (Child, Lines) {
    let arguments = [&["mosaic", "photos", "--live"], &SMALL[..], more].concat();
    let mut child = rigel(folder, &arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = Lines(BufReader::new(child.stdout.take().unwrap()));
    (child, lines)
}

struct Lines(BufReader<std::process::ChildStdout>);

impl Lines {
    /// Reads on until a line has this in it; that line.
    fn until(&mut self, word: &str) -> String {
        let mut all = String::new();
        loop {
            let mut line = String::new();
            assert!(self.0.read_line(&mut line).unwrap() > 0, "{word} was never said: {all}");
            if line.contains(word) {
                return line;
            }
            all += &line;
        }
    }
}

/// The number before a word.
fn number(line: &str, before: &str) -> f64 {
    line.split(before).next().unwrap().split_whitespace().last().unwrap().parse().unwrap()
}

#[test]
fn photographs_that_arrive_are_told_and_ctrl_c_begins_the_map() {
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let tour = tour();
    tour.write(all.path()).unwrap();
    std::fs::create_dir(folder.path().join("photos")).unwrap();
    let (mut child, mut lines) = start(folder.path(), &["--overlap", "40%"]);
    lines.until("waiting for photographs");
    let mut seen = 0.0;
    for i in 0..5 {
        let name = format!("{i:03}.png");
        std::fs::copy(all.path().join(&name), folder.path().join("photos").join(&name)).unwrap();
        let line = lines.until(&name);
        assert!(line.contains("turn ") && number(&line, " % overlap") >= 40.0, "{line}");
        assert!(number(&line, " % seen") > seen, "{line}");
        seen = number(&line, " % seen");
        assert!(image::open(folder.path().join("map-coverage.png")).is_ok());
    }
    // One that comes just before is not lost.
    std::fs::copy(all.path().join("005.png"), folder.path().join("photos/005.png")).unwrap();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    seen = number(&lines.until("005.png"), " % seen");
    lines.until("ended by Ctrl-C: 6 photographs");
    lines.until("wrote map.exr");
    assert!(child.wait().unwrap().success());
    assert!(std::fs::read_to_string(folder.path().join("photos/frames.csv")).unwrap().contains("005.png"));
    let map = rigel::environment::EnvironmentMap::read(&folder.path().join("map.exr")).unwrap();
    let share = map.coverage.iter().enumerate().filter(|(_, count)| **count > 0);
    let share: f64 = share.map(|(i, _)| map.size.solid_angle(i / map.size.width())).sum::<f64>()
        / 0.04
        / std::f64::consts::PI;
    assert!((share - seen).abs() < 1.5, "{share} {seen}");
}

#[test]
fn it_ends_by_itself_when_everything_wanted_was_seen() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    tour().write(&photos).unwrap();
    let (mut child, mut lines) = start(folder.path(), &["--lowest", "-2", "--highest", "2"]);
    assert!(lines.until("orientations").contains("the table and the tracker"));
    assert!(lines.until("tracker, live").contains("no delay at an even speed"));
    let last = lines.until("everything wanted was seen");
    assert!(number(&last, " % of what is wanted") > 99.0, "{last}");
    lines.until("wrote map.exr");
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_backlog_is_read_to_its_end_however_soon_ctrl_c_comes() {
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    let (all, tour) = (tempfile::tempdir().unwrap(), Tour { photographs: 1, ..tour() });
    tour.write(all.path()).unwrap();
    // Large ones, as a camera's: reading all takes longer than what comes late is waited for.
    let small = image::open(all.path().join("000.png")).unwrap().to_rgb8();
    let large = image::imageops::resize(&small, 4800, 3600, image::imageops::FilterType::Nearest);
    large.save(photos.join("000.jpg")).unwrap();
    let count = 60;
    let mut table = "file,qw,qx,qy,qz\n".to_owned();
    for i in 0..count {
        if i > 0 {
            std::fs::hard_link(photos.join("000.jpg"), photos.join(format!("{i:03}.jpg"))).unwrap();
        }
        let half_rad = f64::from(i) * 0.05;
        table += &format!("{i:03}.jpg,{},0,{},0\n", half_rad.cos(), half_rad.sin());
    }
    std::fs::write(photos.join("frames.csv"), table).unwrap();
    let (mut child, mut lines) = start(folder.path(), &[]);
    lines.until("waiting for photographs");
    let ended = std::time::Instant::now();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    lines.until(&format!("ended by Ctrl-C: {count} photographs"));
    println!("{:.1} s", ended.elapsed().as_secs_f64());
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_picture_that_cannot_be_written_is_told_once_and_the_turning_goes_on() {
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    tour().write(all.path()).unwrap();
    let (photos, out) = (folder.path().join("photos"), folder.path().join("out"));
    std::fs::create_dir(&photos).unwrap();
    std::fs::create_dir(&out).unwrap();
    let (mut child, mut lines) = start(folder.path(), &["--out", "out/map.exr"]);
    lines.until("waiting for photographs");
    std::fs::remove_dir(&out).unwrap();
    let mut said = 0;
    for i in 0..3 {
        let name = format!("{i:03}.png");
        std::fs::copy(all.path().join(&name), photos.join(&name)).unwrap();
        let mut line = lines.until("png");
        if line.starts_with("note: ") {
            assert!(line.contains("map-coverage.png") && i == 0, "{line}");
            said += 1;
            line = lines.until("png");
        }
        assert!(line.starts_with(&name), "{line}");
    }
    std::fs::create_dir(&out).unwrap();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert!(!lines.until("ended by Ctrl-C: 3 photographs").contains("coverage"));
    lines.until("wrote out/map.exr");
    assert!(child.wait().unwrap().success() && said == 1);
}

#[test]
fn records_that_break_off_end_the_turning_and_the_table_says_what_has_a_place() {
    let (all, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let tour = tour();
    tour.write(all.path()).unwrap();
    let photos = folder.path().join("photos");
    std::fs::create_dir(&photos).unwrap();
    let mut records = std::fs::read_to_string(all.path().join("tracker.jsonl")).unwrap();
    std::fs::write(photos.join("tracker.jsonl"), &records).unwrap();
    let (child, mut lines) = start(folder.path(), &[]);
    for i in 0..3 {
        let name = format!("{i:03}.png");
        std::fs::copy(all.path().join(&name), photos.join(&name)).unwrap();
        let taken = std::time::UNIX_EPOCH + std::time::Duration::from_secs_f64(1.7e9 + tour.times_s()[i]);
        let photograph = std::fs::File::options().write(true).open(photos.join(&name)).unwrap();
        photograph.set_modified(taken).unwrap();
        lines.until(&format!("{name}: azimuth"));
    }
    records += "{\n";
    std::fs::write(photos.join("tracker.jsonl"), &records).unwrap();
    lines.until("3 photographs found a place");
    let output = child.wait_with_output().unwrap();
    assert_refused("torn records", &output, &["tracker.jsonl", "line"]);
    let made = rigel(folder.path(), &[&["mosaic", "photos"], &SMALL[..]].concat()).output().unwrap();
    let said = String::from_utf8_lossy(&made.stdout);
    assert!(made.status.success() && said.contains(", 3 photographs"), "{said}");
}

#[test]
fn what_is_wrong_with_the_lens_is_said_before_a_rig_is_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    for photos in ["empty", "lensless"] {
        std::fs::create_dir(place(photos)).unwrap();
    }
    std::fs::write(place("lensless/frames.json"), r#"{"frames": []}"#).unwrap();
    std::fs::write(place("torn.toml"), "f = ").unwrap();
    let narrow = "f = 12000.0\ncx = 119.5\ncy = 89.5\nwidth = 240\nheight = 180\n";
    std::fs::write(place("narrow.toml"), narrow).unwrap();
    for (photos, lens, names) in [
        ("empty", &["--fov", "300"][..], &["300", "2 to 170"][..]),
        ("empty", &["--fov", "1.9"], &["1.9", "2 to 170"]),
        ("empty", &["--lens", "none.toml"], &["none.toml"]),
        ("empty", &["--lens", "torn.toml"], &["torn.toml"]),
        ("empty", &["--lens", "narrow.toml"], &["1.15 by 0.86 degrees"]),
        ("lensless", &[], &["lens", "--lens", "--fov", "intrinsics"]),
    ] {
        let arguments = [&["mosaic", photos, "--live", "--rig", "nowhere"], lens].concat();
        let output = rigel(folder.path(), &arguments).output().unwrap();
        assert_refused(&arguments.join(" "), &output, names);
    }
}

#[test]
fn what_cannot_be_followed_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("photos")).unwrap();
    std::fs::write(folder.path().join("photos/tracker.csv"), "time_s,qw,qx,qy,qz\n").unwrap();
    tour().write(&folder.path().join("photos")).unwrap();
    let live = ["mosaic", "photos", "--live"];
    for (more, names) in [
        (&["--lowest", "30", "--highest", "-30"][..], &["30", "-30", "lowest"][..]),
        (&["--lowest", "0", "--highest", "0.3"], &["0.3", "lowest"]),
        (&["--lowest", "95", "--highest", "99"], &["95", "-90 to 90"]),
        (&["--overlap", "97%"], &["97 %"]),
        (&["--tracker", "photos/tracker.csv"], &["tracker.csv", "tracker.jsonl"]),
        (&["--fov", "300"], &["300"]),
    ] {
        let mut arguments = [&live[..], &["--size", "128x64"], more].concat();
        if !more.contains(&"--fov") {
            arguments.extend(["--fov", "67.4"]);
        }
        let output = rigel(folder.path(), &arguments).output().unwrap();
        assert_refused(&arguments.join(" "), &output, names);
    }
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    let lens = rigel(folder.path(), &["mosaic", "empty", "--live"]).output().unwrap();
    assert_refused("no lens", &lens, &["lens", "--lens", "--fov"]);
    let delay = ["mosaic", "empty", "--live", "--fov", "60", "--delay", "0.08"];
    let delay = rigel(folder.path(), &delay).output().unwrap();
    assert_refused("a delay of no tracker", &delay, &["empty", "--delay", "--rig"]);
    std::fs::write(folder.path().join("map-coverage.png"), "mine").unwrap();
    let there = rigel(folder.path(), &["mosaic", "photos", "--live", "--fov", "60"]).output().unwrap();
    assert_refused("a picture", &there, &["map-coverage.png", "--force"]);
    let file = rigel(folder.path(), &["mosaic", "photos/frames.csv", "--live", "--fov", "60", "--force"])
        .output()
        .unwrap();
    assert_refused("a file", &file, &["frames.csv", "folder"]);
    let none =
        rigel(folder.path(), &["mosaic", "none", "--live", "--fov", "60", "--force"]).output().unwrap();
    assert_refused("no folder", &none, &["none"]);
    // Without --live there is nothing to point at.
    let mut text = String::new();
    let output = rigel(folder.path(), &["mosaic", "photos", "--lowest", "-30"]).output().unwrap();
    output.stderr.as_slice().read_to_string(&mut text).unwrap();
    assert!(!output.status.success() && text.contains("--live"), "{text}");
}

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

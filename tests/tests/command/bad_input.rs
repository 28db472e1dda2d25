//! Bad input gets one sentence that names the file, what is wrong and what to do, a non-zero exit, and leaves what was
//! there untouched.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

#[path = "bad_input/import.rs"]
mod import;
#[path = "bad_input/maps.rs"]
mod maps;
#[path = "bad_input/outputs.rs"]
mod outputs;
#[path = "bad_input/room.rs"]
mod room;
#[path = "bad_input/session.rs"]
mod session;
#[path = "bad_input/words.rs"]
mod words;

use std::fs;
use std::path::Path;

use common::{IMPORT, assert_refused, assert_untouched, rigel, snapshot, workshop};

/// What is done to a fresh workshop, what is then asked of the command, and what its answer must name.
struct Case {
    spoil: fn(&Path),
    arguments: &'static [&'static str],
    names: &'static [&'static str],
}

fn hold(cases: &[Case]) {
    for Case { spoil, arguments, names } in cases {
        let folder = workshop();
        spoil(folder.path());
        let mut arguments = arguments.to_vec();
        if arguments.contains(&"--csv") {
            arguments.extend(IMPORT);
        }
        let what = format!("`rigel {}` where it should say {names:?}", arguments.join(" "));
        let before = snapshot(folder.path());
        let output = rigel(folder.path(), &arguments).output().unwrap();
        assert_refused(&what, &output, names);
        assert_untouched(&what, &before, &snapshot(folder.path()));
    }
}

fn nothing(_: &Path) {}

/// Replaces the first `from` in a text file.
fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{} has no {from}", path.display());
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

/// Keeps a part of a file.
fn cut(path: &Path, part: f64) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..(bytes.len() as f64 * part) as usize]).unwrap();
}

/// One line of a table in place of another.
fn row(folder: &Path, from: usize, line: impl FnOnce(&str) -> String) {
    let table = folder.join("views.csv");
    let text = fs::read_to_string(&table).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    lines[from] = line(&lines[from]);
    fs::write(table, lines.join("\n") + "\n").unwrap();
}

const FIT: &[&str] = &["fit", "session/observations.rigel", "--model", "phong", "--out", "phong.exr"];
const RENDER: &[&str] = &["render", "phong.exr", "--size", "40x30", "--out", "picture.png"];
const EVALUATE: &[&str] = &["evaluate", "phong.exr", "--session", "session", "--views", "view001"];

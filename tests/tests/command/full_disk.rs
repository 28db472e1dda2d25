//! A disk that is full: the old files stay byte by byte, and nothing half written is left.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use common::{IMPORT, assert_refused, assert_untouched, rigel, snapshot, succeed, workshop};

/// What is there before, what is asked, and the file that cannot be written.
type Case = (fn(&Path), &'static [&'static str], &'static str);

const EVALUATE: [&str; 6] = ["evaluate", "phong.exr", "--session", "session", "--views", "view001"];

fn nothing(_: &Path) {}

fn one_view_less(folder: &Path) {
    fs::remove_file(folder.join("session/radiance/view003.exr")).unwrap();
}

fn evaluated(folder: &Path) {
    succeed(folder, &EVALUATE);
}

fn pictures(folder: &Path) {
    fs::write(folder.join("picture.png"), "the old one").unwrap();
    fs::write(folder.join("picture.exr"), "the old one").unwrap();
}

const CASES: &[Case] = &[
    (nothing, &["import", "photos", "new", "--csv", "views.csv"], "new"),
    (nothing, &["import", "photos", "new", "--csv", "views.csv", "--flats", "photos/view000_0.png"], "new"),
    (nothing, &["capture", "new"], "new"),
    (one_view_less, &["radiance", "session", "--response", "srgb"], "session/radiance/"),
    (nothing, &["radiance", "session", "--response", "linear"], "session/radiance"),
    (nothing, &["observe", "session", "--texels", "20x15"], "session/observations.rigel"),
    (nothing, &["observe", "session", "--texels", "20x15", "--out", "new.rigel"], "new.rigel"),
    (
        nothing,
        &["fit", "session/observations.rigel", "--model", "constant", "--out", "phong.exr"],
        "phong.exr",
    ),
    (nothing, &["fit", "session/observations.rigel", "--model", "phong", "--out", "new.exr"], "new.exr"),
    (pictures, &["render", "phong.exr", "--size", "80x60", "--out", "picture.png", "--force"], "picture.png"),
    (pictures, &["render", "phong.exr", "--size", "80x60", "--out", "picture.exr", "--force"], "picture.exr"),
    (nothing, &EVALUATE, "phong-errors"),
    (evaluated, &EVALUATE, "phong-errors"),
];

fn hold(case: &Case, folder: &Path, remedy: &str, run: impl Fn(Command) -> Output) {
    let (_, arguments, name) = case;
    let extra = if arguments.contains(&"--csv") { &IMPORT[..] } else { &[] };
    let what = format!("`rigel {}` on a full disk", arguments.join(" "));
    let before = snapshot(folder);
    let output = run(rigel(folder, &[arguments, extra].concat()));
    assert_refused(&what, &output, &[name, remedy]);
    assert_untouched(&what, &before, &snapshot(folder));
}

/// No file may grow beyond a kilobyte: what a full disk does, anywhere and without being root.
#[test]
fn where_files_may_not_grow() {
    for case in CASES {
        let folder = workshop();
        case.0(folder.path());
        hold(case, folder.path(), "ulimit -f", |command| {
            let limit = "trap '' XFSZ; ulimit -f 1; exec \"$0\" \"$@\"";
            let mut limited = Command::new("bash");
            limited.args(["-c", limit]).arg(command.get_program()).args(command.get_args());
            limited.current_dir(folder.path()).output().unwrap()
        });
    }
}

/// A disk in memory, taken off again at the end.
struct Disk<'a>(&'a Path);

impl Drop for Disk<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0).status();
    }
}

#[test]
fn where_the_disk_is_full() {
    for case in CASES {
        let place = tempfile::tempdir().unwrap();
        let mount =
            Command::new("mount").args(["-t", "tmpfs", "-o", "size=8m", "tmpfs"]).arg(place.path()).output();
        if !mount.is_ok_and(|output| output.status.success()) {
            eprintln!("skipped: only root may mount a small disk");
            return;
        }
        let disk = Disk(place.path());
        let copied = Command::new("cp").arg("-a").arg(workshop().path().join(".")).arg(disk.0).status();
        assert!(copied.unwrap().success());
        case.0(disk.0);
        let mut filler = fs::File::create(disk.0.join("filler")).unwrap();
        while filler.write_all(&[1; 4096]).is_ok() {}
        hold(case, disk.0, "free some space", |mut command| command.output().unwrap());
    }
}

const CAPTURE: [&str; 8] =
    ["capture", "session", "--sampling", "spiral", "--views", "3", "--longest-exposure-time", "0.02"];

/// Every photograph of a session, and what is left beside them of half-done work.
fn photographs(folder: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let all = snapshot(&folder.join("session")).into_iter();
    let inside = all.map(|(path, bytes)| (path.strip_prefix(folder).unwrap().to_path_buf(), bytes));
    inside.filter(|(path, _)| !path.ends_with("journal.jsonl") && !path.ends_with("session.toml")).collect()
}

/// Goes on once there is space, and the session is as if there had always been.
fn goes_on(folder: &Path, undisturbed: &BTreeMap<PathBuf, Option<Vec<u8>>>) {
    let begun = folder.join("session/session.toml").exists();
    succeed(folder, if begun { &["capture", "session", "--resume"] } else { &CAPTURE });
    assert_untouched("a resumed capture", undisturbed, &photographs(folder));
}

/// At whatever the disk is full, a photograph, a flat, or the journal: what was taken is kept.
#[test]
fn a_capture_on_a_disk_that_fills_goes_on_when_there_is_space() {
    let whole = tempfile::tempdir().unwrap();
    succeed(whole.path(), &CAPTURE);
    let undisturbed = photographs(whole.path());

    // No file may be larger than eight kilobytes: photographs are.
    let place = tempfile::tempdir().unwrap();
    let mut limited = Command::new("bash");
    limited.args(["-c", "trap '' XFSZ; ulimit -f 8; exec \"$0\" \"$@\""]).arg(env!("CARGO_BIN_EXE_rigel"));
    let output = limited.args(CAPTURE).current_dir(place.path()).output().unwrap();
    assert_refused("a capture of large photographs", &output, &["session", "ulimit -f"]);
    goes_on(place.path(), &undisturbed);

    for room_kib in [12, 28, 44, 60, 76, 92] {
        let place = tempfile::tempdir().unwrap();
        let mount =
            Command::new("mount").args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"]).arg(place.path()).output();
        if !mount.is_ok_and(|output| output.status.success()) {
            eprintln!("skipped: only root may mount a small disk");
            return;
        }
        let disk = Disk(place.path());
        let filler = disk.0.join("filler");
        fs::write(&filler, vec![1; (1024 - room_kib) * 1024]).unwrap();
        let output = rigel(disk.0, &CAPTURE).output().unwrap();
        assert_refused(&format!("a capture with {room_kib} KiB"), &output, &["session", "free some space"]);
        fs::remove_file(filler).unwrap();
        goes_on(disk.0, &undisturbed);
    }
}

/// Found with `rigel fit ... | head -2`: `println!` panics when nobody reads.
#[test]
fn output_that_cannot_be_written_is_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = rigel(folder.path(), &["capture", "s", "--dry-run"]).stdout(full).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("output cannot be written"), "{stderr}");
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = rigel(folder.path(), &["capture", "s", "--dry-run"]).stdout(writer).output().unwrap();
    assert!(
        output.status.success() && output.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

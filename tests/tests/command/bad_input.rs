//! Bad input gets one sentence that names the file, what is wrong and what to do, a non-zero exit, and leaves what was
//! there untouched.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use std::fs;
use std::path::Path;

use common::{IMPORT, assert_refused, assert_untouched, rigel, snapshot, workshop};
use exr::prelude::{FlatSamples, WritableImage, f16, read_first_flat_layer_from_file, write_rgb_file};

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

const CSV: &[&str] = &["import", "photos", "new", "--csv", "views.csv"];
const FOLDER: &[&str] = &["import", "some", "new"];

/// A folder `some` with one picture of a gradient.
fn picture(folder: &Path, name: &str) -> std::path::PathBuf {
    fs::create_dir_all(folder.join("some")).unwrap();
    let path = folder.join("some").join(name);
    match name.ends_with(".exr") {
        true => write_rgb_file(&path, 40, 30, |x, y| (x as f32, y as f32, 1.0f32)).unwrap(),
        false => image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8, y as u8, (x * y % 251) as u8]))
            .save(&path)
            .unwrap(),
    }
    path
}

#[test]
fn photographs_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: |folder| drop(picture(folder, "plain.jpg")),
            arguments: FOLDER,
            names: &["plain.jpg", "exposure time", "--csv"],
        },
        Case {
            spoil: |folder| drop(picture(folder, "other.png")),
            arguments: &["import", "some", "new", "--bracket", "2"],
            names: &["other.png", "exposure time"],
        },
        Case {
            spoil: |folder| {
                let wide = image::RgbImage::new(90, 60);
                wide.save(folder.join("photos/view003_1.png")).unwrap();
            },
            arguments: CSV,
            names: &["view003_1.png", "90x60", "80x60", "view000_0.png"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("photos/view002_0.png")).unwrap(),
            arguments: CSV,
            names: &["view002_0.png", "check the path"],
        },
        Case {
            spoil: |folder| fs::create_dir(folder.join("some")).unwrap(),
            arguments: FOLDER,
            names: &["some", "no photograph"],
        },
        Case { spoil: nothing, arguments: FOLDER, names: &["some", "check the path"] },
        Case {
            spoil: |folder| cut(&folder.join("photos/view001_0.png"), 0.5),
            arguments: &["import", "photos", "new", "--csv", "views.csv", "--flats", "photos/view001_0.png"],
            names: &["view001_0.png", "complete"],
        },
        Case {
            spoil: |folder| {
                fs::copy(folder.join("photos/view001_0.png"), picture(folder, "view000_0.png")).unwrap();
            },
            arguments: &[
                "import",
                "photos",
                "new",
                "--csv",
                "views.csv",
                "--flats",
                "photos/view000_0.png",
                "some/view000_0.png",
            ],
            names: &["some/view000_0.png", "same name", "photos/view000_0.png"],
        },
    ]);
}

#[test]
fn every_kind_of_photograph_cut_short_or_none_at_all() {
    for name in ["a.jpg", "a.png", "a.tif", "a.exr"] {
        for part in [0.0, 0.02, 0.4, 0.7, 0.95] {
            let folder = workshop();
            cut(&picture(folder.path(), name), part);
            refuse_photograph(folder.path(), name, &format!("{name} cut to {part}"));
        }
        let folder = workshop();
        fs::create_dir(folder.path().join("some")).unwrap();
        fs::write(folder.path().join("some").join(name), "once upon a time").unwrap();
        refuse_photograph(folder.path(), name, &format!("{name} of words"));
        // The right beginning and nonsense after it.
        let path = picture(folder.path(), name);
        let mut bytes = fs::read(&path).unwrap();
        bytes.iter_mut().skip(12).step_by(3).for_each(|byte| *byte = byte.wrapping_mul(31) ^ 0x5a);
        fs::write(&path, bytes).unwrap();
        if name != "a.jpg" {
            // A JPEG file has no checksum: what is wrong with it may look like a photograph.
            refuse_photograph(folder.path(), name, &format!("{name} damaged"));
        }
    }
}

fn refuse_photograph(folder: &Path, name: &str, what: &str) {
    let before = snapshot(folder);
    let output = rigel(folder, &["import", "some", "new", "--exposure-times-unknown"]).output().unwrap();
    assert_refused(what, &output, &[name]);
    assert_untouched(what, &before, &snapshot(folder));
}

#[test]
fn tables_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: |folder| row(folder, 0, |line| line.replace("tilt_deg", "slope")),
            arguments: CSV,
            names: &["views.csv", "no column tilt_deg", "name the columns"],
        },
        Case {
            spoil: |folder| row(folder, 4, |line| line.replace(",1,", ",0,")),
            arguments: CSV,
            names: &["views.csv", "line 5", "view 0 is repeated"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "0.03")),
            arguments: CSV,
            names: &["views.csv", "line 3", "view 0 is repeated", "0.03"],
        },
        Case {
            spoil: |folder| row(folder, 3, |line| line.replace("view001_0", "view000_1")),
            arguments: CSV,
            names: &["views.csv", "view000_1.png", "line 3", "line 4"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "a while")),
            arguments: CSV,
            names: &["views.csv", "line 3", "exposure_s", "a while"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "NaN")),
            arguments: CSV,
            names: &["views.csv", "line 3", "NaN"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "-0.01")),
            arguments: CSV,
            names: &["view000_1.png", "-0.01"],
        },
        Case {
            spoil: |folder| row(folder, 1, |line| line.replace(",0,0", ",first,0")),
            arguments: CSV,
            names: &["views.csv", "line 2", "view is 'first'"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.rsplit_once(',').unwrap().0.to_owned()),
            arguments: CSV,
            names: &["views.csv", "line: 3"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("views.csv"), b"file,view\xff\xfe\n\x80,1\n").unwrap(),
            arguments: CSV,
            names: &["views.csv"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("views.csv"), "").unwrap(),
            arguments: CSV,
            names: &["views.csv"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("views.csv")).unwrap(),
            arguments: CSV,
            names: &["views.csv", "check the path"],
        },
        Case {
            spoil: |folder| edit(&folder.join("lens.json"), "fx", "gx"),
            arguments: CSV,
            names: &["lens.json", "focal length"],
        },
        Case { spoil: |folder| cut(&folder.join("lens.json"), 0.5), arguments: CSV, names: &["lens.json"] },
    ]);
}

#[test]
fn sessions_that_are_none_or_damaged() {
    const RADIANCE: &[&str] = &["radiance", "session", "--response", "srgb"];
    const OBSERVE: &[&str] = &["observe", "session", "--texels", "16x12"];
    hold(&[
        Case {
            spoil: nothing,
            arguments: &["radiance", "photos"],
            names: &["photos", "not a session", "import"],
        },
        Case { spoil: nothing, arguments: &["observe", "nowhere"], names: &["nowhere", "not a session"] },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "session", "--csv", "views.csv"],
            names: &["session", "not empty", "choose a new folder"],
        },
        Case {
            spoil: |folder| edit(&folder.join("session/journal.jsonl"), "\"view\":", "\"few\":"),
            arguments: RADIANCE,
            names: &["journal.jsonl", "line 1", "remove that line", "view_done"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/journal.jsonl");
                let mut bytes = fs::read(&path).unwrap();
                let second = bytes.iter().position(|&byte| byte == b'\n').unwrap() + 10;
                bytes[second] = 0xff;
                fs::write(path, bytes).unwrap();
            },
            arguments: OBSERVE,
            names: &["journal.jsonl", "line 2"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/journal.jsonl");
                let text = fs::read_to_string(&path).unwrap().replacen("\"view\":1", "\"view\":99", 1);
                // As if it had been written so, in a journal without checksums.
                let lines = text.lines().map(|line| line.split(",\"crc\"").next().unwrap());
                fs::write(path, lines.map(|line| format!("{line}}}\n")).collect::<String>()).unwrap();
            },
            arguments: RADIANCE,
            names: &["journal.jsonl", "view 99", "restore"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/session.toml"), 0.4),
            arguments: RADIANCE,
            names: &["session.toml"],
        },
        Case {
            spoil: |folder| edit(&folder.join("session/session.toml"), "format = 1", "format = 7"),
            arguments: OBSERVE,
            names: &["session.toml", "format 7"],
        },
        Case {
            spoil: |folder| edit(&folder.join("session/session.toml"), "surface = \"200mmx150mm\"", ""),
            arguments: OBSERVE,
            names: &["session", "--surface"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("session/radiance/view004.exr")).unwrap(),
            arguments: OBSERVE,
            names: &["view004.exr", "missing", "rigel radiance"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/radiance/view002.exr");
                write_rgb_file(path, 80, 60, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
            },
            arguments: OBSERVE,
            names: &["view002.exr", "not Rigel's radiance", "rigel radiance"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/radiance/view002.exr"), 0.6),
            arguments: OBSERVE,
            names: &["view002.exr", "make it again"],
        },
        Case {
            spoil: nothing,
            arguments: &["radiance", "session", "--response", "none.csv"],
            names: &["none.csv", "check the path"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/photographs/view005_1.png"), 0.5),
            arguments: &["radiance", "session", "--response", "linear"],
            names: &["view005_1.png", "complete"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("session/photographs/view005_1.png")).unwrap(),
            arguments: &["radiance", "session", "--response", "linear"],
            names: &["view005_1.png", "check the path"],
        },
    ]);
}

const FIT: &[&str] = &["fit", "session/observations.rigel", "--model", "phong", "--out", "phong.exr"];
const RENDER: &[&str] = &["render", "phong.exr", "--size", "40x30", "--out", "picture.png"];
const EVALUATE: &[&str] = &["evaluate", "phong.exr", "--session", "session", "--views", "view001"];

#[test]
fn maps_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: |folder| cut(&folder.join("session/observations.rigel"), 0.9),
            arguments: FIT,
            names: &["observations.rigel", "cut short", "rigel observe"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/observations.rigel"), 0.003),
            arguments: FIT,
            names: &["observations.rigel", "rigel observe"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("session/observations.rigel"), "").unwrap(),
            arguments: FIT,
            names: &["observations.rigel", "not an observation map"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "phong.exr"],
            names: &["phong.exr", "not an observation map"],
        },
        Case { spoil: nothing, arguments: &["fit", "none.rigel"], names: &["none.rigel", "check the path"] },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--model", "phong2"],
            names: &["observations.rigel", "phong2 needs 9 views", "smaller model"],
        },
        Case {
            spoil: nothing,
            arguments: &[
                "fit",
                "session/observations.rigel",
                "--model",
                "phong",
                "--without",
                "view001,view002,view003",
            ],
            names: &["observations.rigel", "phong needs 5 views", "4"],
        },
        Case {
            spoil: nothing,
            arguments: &[
                "fit",
                "session/observations.rigel",
                "--without",
                "view000,view001,view002,view003,view004,view005,view006",
            ],
            names: &["observations.rigel", "photograph more views"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--model", "blinn"],
            names: &["blinn", "phong"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--without", "view999"],
            names: &["observations.rigel", "view999", "view000"],
        },
        Case { spoil: not_a_number, arguments: RENDER, names: &["phong.exr", "NaN", "rigel fit"] },
        Case { spoil: not_a_number, arguments: EVALUATE, names: &["phong.exr", "NaN", "rigel fit"] },
        Case { spoil: other_exr, arguments: RENDER, names: &["phong.exr", "no parameter map", "rigel fit"] },
        Case {
            spoil: other_exr,
            arguments: EVALUATE,
            names: &["phong.exr", "no parameter map", "rigel fit"],
        },
        Case { spoil: half_map, arguments: RENDER, names: &["phong.exr", "OpenEXR", "rigel fit"] },
        Case { spoil: half_map, arguments: EVALUATE, names: &["phong.exr", "OpenEXR", "rigel fit"] },
        Case {
            spoil: |folder| fs::write(folder.join("phong.exr"), "once upon a time").unwrap(),
            arguments: RENDER,
            names: &["phong.exr", "OpenEXR"],
        },
        Case { spoil: nothing, arguments: &["render", "none.exr"], names: &["none.exr", "check the path"] },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--out", "picture.gif"],
            names: &["picture.gif", "gif", ".png"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--tilt", "95"],
            names: &["not above the surface"],
        },
        Case { spoil: nothing, arguments: &["render", "phong.exr", "--gamma", "0"], names: &["gamma = 0"] },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--camera", "lens.json"],
            names: &["lens.json", "centre"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--references", "none.json"],
            names: &["none.json", "check the path"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("list.json"), "[]").unwrap(),
            arguments: &["evaluate", "phong.exr", "--references", "list.json"],
            names: &["list.json"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("session/radiance/view001.exr")).unwrap(),
            arguments: EVALUATE,
            names: &["view001.exr"],
        },
    ]);
}

fn other_exr(folder: &Path) {
    write_rgb_file(folder.join("phong.exr"), 16, 12, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
}

fn half_map(folder: &Path) {
    cut(&folder.join("phong.exr"), 0.5);
}

fn not_a_number(folder: &Path) {
    let path = folder.join("phong.exr");
    let mut image = read_first_flat_layer_from_file(&path).unwrap();
    let channels = &mut image.layer_data.channel_data.list;
    let channel = channels.iter_mut().find(|channel| channel.name.eq("diffuse.R")).unwrap();
    match &mut channel.sample_data {
        FlatSamples::F16(values) => values[17] = f16::NAN,
        FlatSamples::F32(values) => values[17] = f32::NAN,
        FlatSamples::U32(_) => panic!("a coefficient is no whole number"),
    }
    image.write().to_file(&path).unwrap();
}

#[test]
fn outputs_that_cannot_be_written() {
    fn is_a_file(folder: &Path) {
        fs::write(folder.join("file"), "precious").unwrap();
    }
    fn is_a_folder(folder: &Path) {
        fs::create_dir_all(folder.join("file/precious")).unwrap();
    }
    const OBSERVE: &[&str] = &["observe", "session", "--texels", "16x12", "--out"];
    let to = |verb: &[&'static str], out: &'static str| -> &'static [&'static str] {
        let mut arguments = verb.to_vec();
        if let Some(at) = arguments.iter().position(|word| *word == "--out") {
            arguments.truncate(at);
        }
        arguments.extend(["--out", out]);
        arguments.leak()
    };
    let mut cases = vec![
        Case {
            spoil: is_a_file,
            arguments: &["import", "photos", "file/session", "--csv", "views.csv"],
            names: &["file/session"],
        },
        Case {
            spoil: is_a_file,
            arguments: &["import", "photos", "file", "--csv", "views.csv"],
            names: &["file"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "/proc/session", "--csv", "views.csv"],
            names: &["/proc/session"],
        },
        Case {
            spoil: |folder| {
                fs::remove_dir_all(folder.join("session/radiance")).unwrap();
                fs::write(folder.join("session/radiance"), "precious").unwrap();
            },
            arguments: &["radiance", "session", "--response", "srgb"],
            names: &["session/radiance"],
        },
    ];
    for (verb, in_a_file, in_proc, nowhere) in [
        (OBSERVE, "file/out.rigel", "/proc/out.rigel", "none/out.rigel"),
        (FIT, "file/out.exr", "/proc/out.exr", "none/out.exr"),
        (RENDER, "file/out.png", "/proc/out.png", "none/out.png"),
    ] {
        cases.push(Case { spoil: is_a_file, arguments: to(verb, in_a_file), names: &["file/out"] });
        cases.push(Case { spoil: nothing, arguments: to(verb, in_proc), names: &["/proc/out"] });
        cases.push(Case {
            spoil: nothing,
            arguments: to(verb, nowhere),
            names: &["none/out", "check the path"],
        });
    }
    cases.push(Case { spoil: is_a_file, arguments: to(EVALUATE, "file/out"), names: &["file/out"] });
    cases.push(Case { spoil: nothing, arguments: to(EVALUATE, "/proc/out"), names: &["/proc/out"] });
    cases.push(Case { spoil: is_a_folder, arguments: to(FIT, "file"), names: &["file"] });
    cases.push(Case { spoil: nothing, arguments: to(RENDER, "/proc/out.exr"), names: &["/proc/out.exr"] });
    hold(&cases);
}

#[test]
fn words_that_mean_nothing() {
    hold(&[
        Case { spoil: nothing, arguments: &["develop"], names: &["develop", "rigel --help"] },
        Case {
            spoil: nothing,
            arguments: &["radiance", "session", "--speed", "9"],
            names: &["--speed", "rigel radiance --help"],
        },
        Case { spoil: nothing, arguments: &["radiance"], names: &["SESSION", "rigel radiance --help"] },
        Case { spoil: nothing, arguments: &["fit"], names: &["OBSERVATIONS", "rigel fit --help"] },
        Case {
            spoil: nothing,
            arguments: &["observe", "session", "--texels", "many"],
            names: &["--texels", "many", "512x512"],
        },
        Case {
            spoil: nothing,
            arguments: &["observe", "session", "--texels", "0x5"],
            names: &["--texels", "0x5"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--distance", "900"],
            names: &["--distance", "900", "unit"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--csv", "views.csv", "--colmap", "model"],
            names: &["--csv", "--colmap"],
        },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "new", "--colmap", "model", "--bracket", "2"],
            names: &["--bracket", "--colmap"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--rig", "/dev/null", "--dry-run"],
            names: &["/dev/null", "cannot open the port", "cable"],
        },
        Case {
            spoil: nothing,
            arguments: &["rig", "status", "--rig", "/dev/no-such-port"],
            names: &["/dev/no-such-port", "cannot open the port", "cable"],
        },
        Case {
            spoil: nothing,
            arguments: &["rig", "move", "--rig", "simulated", "--pan", "400"],
            names: &["400.000°", "-180.000° to 180.000°"],
        },
        Case {
            spoil: nothing,
            arguments: &["tracker", "watch", "--rig", "simulated", "--stations", "3"],
            names: &["--stations", "3", "rigel tracker --help"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--views", "0"],
            names: &["no views", "at least one"],
        },
        Case {
            spoil: nothing,
            arguments: &["capture", "new", "--views", "4000000000"],
            names: &["4000000000", "at most"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr"],
            names: &["--references", "rigel evaluate --help"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--session", "session"],
            names: &["--views"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--session", "session", "--views", "view123"],
            names: &["session", "view123", "view000"],
        },
    ]);
}

/// A slip in --out must not cost a session or its observations.
#[test]
fn outputs_that_would_overwrite_inputs() {
    let folder = workshop();
    let folder = folder.path();
    for (arguments, name) in [
        (
            &["fit", "session/observations.rigel", "--model", "phong", "--out", "session/observations.rigel"]
                [..],
            "observations.rigel",
        ),
        (&["observe", "session", "--texels", "8x6", "--out", "session/session.toml"], "session.toml"),
        (
            &["evaluate", "phong.exr", "--session", "session", "--views", "view001", "--out", "session"],
            "session",
        ),
    ] {
        let before = snapshot(folder);
        let output = rigel(folder, arguments).output().unwrap();
        assert_refused(name, &output, &[name]);
        assert_untouched(name, &before, &snapshot(folder));
    }
}

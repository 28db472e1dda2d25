//! Where results are to go.

use std::fs;
use std::path::Path;

use super::common::{assert_refused, assert_untouched, rigel, snapshot, workshop};
use super::*;

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

//! Where results are to go.

use std::fs;
use std::path::Path;

use super::common::{assert_refused, assert_untouched, rigel, snapshot, succeed, workshop};
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

/// Squares cost an hour; a registration without them must not take the place of one with them.
#[test]
fn a_registration_is_replaced_only_if_that_is_wished_or_it_is_of_no_use() {
    let folder = workshop();
    let folder = folder.path();
    let register = ["register", "session"];
    succeed(folder, &register);
    let before = snapshot(folder);
    assert_refused(
        "a second time",
        &rigel(folder, &register).output().unwrap(),
        &["registration.toml", "--force"],
    );
    assert_untouched("a second time", &before, &snapshot(folder));
    succeed(folder, &["register", "session", "--force"]);
    // It belongs to the radiance from which it was made.
    succeed(folder, &["radiance", "session", "--response", "linear"]);
    succeed(folder, &register);
}

#[test]
fn views_that_the_fit_has_seen_are_told() {
    let folder = workshop();
    let folder = folder.path();
    let evaluate = ["evaluate", "phong.exr", "--session", "session", "--views", "view001,view002"];
    assert!(succeed(folder, &evaluate).contains("warning: the fit has seen all of these views"));
    let fit = ["fit", "session/observations.rigel", "--model", "constant", "--out", "phong.exr"];
    succeed(folder, &[&fit[..], &["--without", "view001"]].concat());
    assert!(succeed(folder, &evaluate).contains("the fit has seen view002, so"));
    succeed(folder, &[&fit[..], &["--without", "view001,view002"]].concat());
    assert!(!succeed(folder, &evaluate).contains("warning"));
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

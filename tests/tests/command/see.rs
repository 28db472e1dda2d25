//! `rigel export` and `rigel info` on files as Rigel writes them, and on others.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[allow(dead_code, reason = "each test uses a part of it")]
mod common;
#[path = "see/observations.rs"]
mod observations;

use std::path::Path;
use std::process::{Command, Output};

use rigel::environment::EnvironmentMap;
use rigel::fit::Model;
use rigel::geometry::{LatLong, Surface, Texels};
use rigel::parameter_map::ParameterMap;
use rigel::radiance::{RadianceImage, Response};
use rigel::session::{Manifest, Session};

fn rigel(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rigel")).current_dir(folder).args(arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text).into_owned()).concat()
}

fn map() -> ParameterMap {
    let texels = Texels { columns: 12, rows: 9 };
    ParameterMap {
        surface: Surface { width_m: 0.2, height_m: 0.15 },
        texels,
        models: vec![Model::Phong { lobes: 1 }],
        choice: vec![],
        parameters: [0.2, 0.3, 0.4, 1.0, 0.5, 0.2, 12.0, 0.0, 0.6, 0.8].repeat(texels.count()),
        diagnostics: None,
        uncertainty: None,
    }
}

fn environment() -> EnvironmentMap {
    EnvironmentMap {
        size: LatLong::new(16, 8).unwrap(),
        radiance: vec![[0.5, 1.0, 2.0]; 128],
        variance: vec![],
        coverage: vec![],
        flags: vec![0; 128],
        unit: Default::default(),
        curve: vec![],
    }
}

#[test]
fn a_map_becomes_a_page_and_splats_and_nothing_is_replaced_unasked() {
    let folder = tempfile::tempdir().unwrap();
    map().write(&folder.path().join("phong.exr")).unwrap();
    for (arguments, told) in [
        (["export", "phong.exr", "--web", "out.html"], "of 255"),
        (["export", "phong.exr", "--splats", "out.ply"], "of 255"),
        (["render", "phong.exr", "--out", "out.png"], "800x600 pixels"),
        (["render", "phong.exr", "--out", "out.exr"], "800x600 pixels"),
    ] {
        let first = rigel(folder.path(), &arguments);
        assert!(first.status.success() && said(&first).contains(told), "{}", said(&first));
        let written = std::fs::read(folder.path().join(arguments[3])).unwrap();
        std::fs::write(folder.path().join(arguments[3]), "mine").unwrap();
        let second = rigel(folder.path(), &arguments);
        assert!(!second.status.success() && said(&second).contains("--force"), "{}", said(&second));
        assert_eq!(std::fs::read(folder.path().join(arguments[3])).unwrap(), b"mine");
        let forced = rigel(folder.path(), &[&arguments[..], &["--force"]].concat());
        assert!(forced.status.success(), "{}", said(&forced));
        assert_eq!(std::fs::read(folder.path().join(arguments[3])).unwrap(), written);
    }
}

#[test]
fn what_is_no_map_is_no_page() {
    let folder = tempfile::tempdir().unwrap();
    map().write(&folder.path().join("phong.exr")).unwrap();
    assert!(rigel(folder.path(), &["render", "phong.exr", "--out", "picture.exr"]).status.success());
    environment().write(&folder.path().join("room.exr")).unwrap();
    Session::create(&folder.path().join("session"), Manifest::new("a camera")).unwrap();
    for (arguments, wanted) in [
        (vec!["export", "picture.exr", "--web", "a.html"], "is no parameter map"),
        (
            vec!["export", "room.exr", "--web", "a.html"],
            "is no parameter map but radiance from every direction",
        ),
        (vec!["export", "session", "--web", "a.html"], "is no parameter map but a session"),
        (vec!["export", "none.exr", "--web", "a.html"], "check the path"),
        (vec!["export", "phong.exr", "--web", "a.txt"], ".html"),
        (vec!["export", "phong.exr", "phong.exr", "--splats", "a.ply"], "name one"),
        (vec!["export", "phong.exr"], "--web"),
        (vec!["info", "none"], "check the path"),
    ] {
        let output = rigel(folder.path(), &arguments);
        let text = said(&output);
        assert!(!output.status.success() && text.contains(wanted), "{arguments:?}: {text}");
        assert!(!text.contains("panicked"), "{text}");
    }
    assert!(!folder.path().join("a.html").exists() && !folder.path().join("a.ply").exists());
}

#[test]
fn every_file_says_what_it_is_and_maps_have_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    map().write(&at("phong.exr")).unwrap();
    environment().write(&at("room.exr")).unwrap();
    let bare = EnvironmentMap { flags: vec![], ..environment() };
    bare.write(&at("bare.exr")).unwrap();
    Response::srgb(255).write_csv(&at("response.csv")).unwrap();
    Session::create(&at("session"), Manifest::new("a camera")).unwrap();
    std::fs::write(at("letter.txt"), "Dear reader").unwrap();
    std::fs::write(at("broken.exr"), [0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0, 9]).unwrap();
    for arguments in
        [["export", "phong.exr", "--web", "page.html"], ["export", "phong.exr", "--splats", "splats.ply"]]
    {
        assert!(rigel(folder.path(), &arguments).status.success());
    }
    assert!(rigel(folder.path(), &["render", "phong.exr", "--out", "picture.exr"]).status.success());
    for (name, what, has_picture) in [
        ("phong.exr", "model phong", true),
        ("room.exr", "radiance from every direction", true),
        ("bare.exr", "radiance from every direction", true),
        ("picture.exr", "a picture in OpenEXR", true),
        ("response.csv", "a response", false),
        ("session", "from a camera", false),
        ("page.html", "a page", false),
        ("splats.ply", "made by rigel export", true),
    ] {
        let output = rigel(folder.path(), &["info", name]);
        assert!(output.status.success() && said(&output).contains(what), "{name}: {}", said(&output));
        let png = format!("{name}.png");
        let output = rigel(folder.path(), &["info", name, "--png", &png]);
        assert_eq!(output.status.success(), has_picture, "{name}: {}", said(&output));
        assert_eq!(at(&png).exists(), has_picture, "{name}");
        // Nothing is told before what is wrong.
        assert_eq!(output.stdout.is_empty(), !has_picture, "{name}");
        if has_picture {
            let picture = image::open(at(&png)).unwrap();
            assert!(picture.width().max(picture.height()) <= 384);
        }
    }
    let splats = std::fs::read(at("splats.ply")).unwrap();
    std::fs::write(at("short.ply"), &splats[..splats.len() - 300]).unwrap();
    for name in ["letter.txt", "broken.exr", "short.ply"] {
        let output = rigel(folder.path(), &["info", name]);
        assert!(!output.status.success() && said(&output).contains(name), "{}", said(&output));
        assert!(!said(&output).contains("panicked"));
    }
}

#[test]
fn a_picture_from_below_the_lowest_view_says_that_it_is_extrapolated() {
    let folder = common::workshop();
    let render = |tilt: &str| {
        common::succeed(
            folder.path(),
            &["render", "phong.exr", "--tilt", tilt, "--out", "picture.png", "--force"],
        )
    };
    assert!(render("70").contains("100.0 % of the surface's pixels are extrapolated"));
    assert!(!render("20").contains("extrapolated"));
    assert!(common::succeed(folder.path(), &["info", "phong.exr"]).contains("measured down to zenith"));
}

#[test]
fn what_was_not_measured_does_not_count_for_the_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let (width, height) = (60, 40);
    // A surface in the middle on a dark ground that is two thirds of the picture.
    let shows = |i: usize| (20..40).contains(&(i % 60));
    let radiance = |i: usize| if shows(i) { [0.5 + (i / 60) as f32 / 40.0; 3] } else { [0.001; 3] };
    RadianceImage {
        width,
        height,
        radiance: (0..2400).map(radiance).collect(),
        variance: vec![[1e-6; 3]; 2400],
        mask: (0..2400).map(|i| if shows(i) { 0 } else { RadianceImage::DARK }).collect(),
    }
    .write_exr(&folder.path().join("view.exr"), "srgb")
    .unwrap();
    common::succeed(folder.path(), &["info", "view.exr", "--png", "view.png"]);
    let picture = image::open(folder.path().join("view.png")).unwrap().into_luma8();
    let mut levels: Vec<u8> = (0..2400).filter(|&i| shows(i)).map(|i| picture.as_raw()[i]).collect();
    levels.sort_unstable();
    assert!(levels[400].abs_diff(128) <= 2 && levels[799] < 180, "{} {}", levels[400], levels[799]);
}

#[test]
fn a_map_says_which_views_its_fit_has_not_seen() {
    let folder = common::workshop();
    let fit = ["fit", "session/observations.rigel", "--model", "constant", "--without", "view001,view004"];
    common::succeed(folder.path(), &fit);
    let told = common::succeed(folder.path(), &["info", "session/constant.exr"]);
    let wanted = "the 5 views that the fit has seen: view000, view002 to view003, view005 to view006\n";
    assert!(told.contains(wanted), "{told}");
}

#[test]
fn what_fails_leaves_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    environment().write(&folder.path().join("room.exr")).unwrap();
    std::fs::write(folder.path().join("bad.obj"), "once upon a time").unwrap();
    let before = common::snapshot(folder.path());
    for (arguments, name) in [
        (vec!["cube", "room.exr", "--size", "0", "--out", "a/faces"], "0x0"),
        (vec!["cube", "none.exr", "--out", "faces"], "none.exr"),
        (vec!["room", "bad.obj", "--map", "room.exr", "--centre", "0,0,0", "--out", "a/lit"], "bad.obj"),
    ] {
        let what = arguments.join(" ");
        let output = rigel(folder.path(), &arguments);
        common::assert_refused(&what, &output, &[name]);
        common::assert_untouched(&what, &before, &common::snapshot(folder.path()));
    }
    common::succeed(folder.path(), &["cube", "room.exr", "--size", "4", "--out", "a/faces"]);
    assert!(folder.path().join("a/faces/pz.png").is_file());
}

#[cfg(not(feature = "viewer"))]
#[test]
fn a_build_without_the_viewer_says_how_to_have_it() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["view"][..], &["view", "map.exr", "--pan", "30"], &["view", "--help"]] {
        common::assert_refused("view", &rigel(folder.path(), arguments), &["--features viewer"]);
    }
}

//! COLMAP models: of photographs of another size, and such as cannot be used.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use common::{VIEWS, angles, assert_refused, assert_untouched, lens, rigel, snapshot, succeed, workshop};
use glam::{DQuat, DVec3};
use rigel::geometry::{Lens, Pose};
use rigel::session::Session;

/// Writes what COLMAP would of the workshop's photographs, had it seen them `scale` times as large: in a world of its own,
/// with points on the board.
fn write_model(folder: &Path, scale: f64) {
    fs::create_dir_all(folder).unwrap();
    let Lens { fx, cx, cy, width, height, .. } = lens();
    let camera = format!(
        "# cameras\n3 SIMPLE_PINHOLE {} {} {} {} {}\n",
        f64::from(width) * scale,
        f64::from(height) * scale,
        fx * scale,
        (cx + 0.5) * scale,
        (cy + 0.5) * scale
    );
    fs::write(folder.join("cameras.txt"), camera).unwrap();
    let world_from_surface = DQuat::from_scaled_axis(DVec3::new(0.3, -1.1, 0.7));
    let origin = DVec3::new(2.0, -1.0, 0.5);
    let mut images = String::from("# images\n");
    for view in 0..VIEWS {
        let (pan_rad, tilt_rad) = angles(view);
        let pose = Pose::from_rig(pan_rad, tilt_rad, 0.9);
        let q = pose.camera_from_surface * world_from_surface.inverse();
        let t = -(q * (origin + world_from_surface * pose.centre_m));
        let [qx, qy, qz, qw] = q.to_array();
        let _ = writeln!(
            images,
            "{} {qw} {qx} {qy} {qz} {} {} {} 3 view{view:03}_1.png",
            view + 1,
            t.x,
            t.y,
            t.z
        );
        for point in 0..200 {
            let (radius, turn) = (0.07 * f64::from(point).sqrt() / 14.1, f64::from(point) * 2.4);
            let at = DVec3::new(radius * turn.cos(), radius * turn.sin(), 0.0);
            let pixel = lens().project(pose.to_camera(at)).unwrap();
            let _ = write!(images, "{} {} {point} ", (pixel.x + 0.5) * scale, (pixel.y + 0.5) * scale);
        }
        images.push('\n');
    }
    fs::write(folder.join("images.txt"), images).unwrap();
}

/// Imports the model and goes on to a fit; returns what the import said and how far the fit is from the photographs.
fn whole_road(folder: &Path, session: &str) -> (String, f64) {
    let told = succeed(folder, &["import", "photos", session, "--colmap", "model"]);
    succeed(folder, &["radiance", session, "--response", "srgb"]);
    succeed(folder, &["observe", session, "--texels", "32x32"]);
    let map = format!("{session}/phong.exr");
    succeed(folder, &["fit", &format!("{session}/observations.rigel"), "--model", "phong", "--out", &map]);
    let out = format!("{session}/errors");
    succeed(
        folder,
        &["evaluate", &map, "--session", session, "--views", "view000,view002,view004", "--out", &out],
    );
    let table = fs::read_to_string(folder.join(out).join("errors.csv")).unwrap();
    let errors = table.lines().skip(1).map(|line| line.rsplit_once(',').unwrap().1.parse::<f64>().unwrap());
    (told, errors.sum::<f64>() / 3.0)
}

#[test]
fn a_model_of_larger_photographs_is_scaled_and_the_result_is_right() {
    let folder = workshop();
    write_model(&folder.path().join("model"), 1.0);
    let (told, plain) = whole_road(folder.path(), "plain");
    assert!(!told.contains("scaled"), "{told}");
    write_model(&folder.path().join("model"), 2.0);
    let (told, scaled) = whole_road(folder.path(), "scaled");
    assert!(["160x120", "80x60", "scaled"].iter().all(|word| told.contains(word)), "{told}");

    let session = Session::open(&folder.path().join("scaled")).unwrap();
    let (found, truth) = (session.manifest.lens(0).unwrap(), lens());
    assert_eq!((found.width, found.height), (80, 60));
    for (found, truth) in
        [(found.fx, truth.fx), (found.fy, truth.fy), (found.cx, truth.cx), (found.cy, truth.cy)]
    {
        assert!((found - truth).abs() < 1e-9, "{found} for {truth}");
    }
    println!("median relative error: {plain:.4} at the photographs' size, {scaled:.4} scaled");
    assert!(plain < 0.1 && (scaled - plain).abs() < 1e-4, "{plain} {scaled}");
}

#[test]
fn a_list_of_exposure_times_counts_before_what_the_photographs_say() {
    let folder = workshop();
    write_model(&folder.path().join("model"), 1.0);
    let line = |view: usize| format!("view{view:03}_1.png {}\n", 8 + view);
    let import = ["import", "photos", "new", "--colmap", "model", "--exposure-times", "times.txt"];
    let list = folder.path().join("times.txt");
    for (text, names) in [
        ((1..VIEWS).map(line).collect::<String>(), ["view000_1.png", "list of exposure times"]),
        ((0..VIEWS).chain([3]).map(line).collect(), ["times.txt", "line 8"]),
    ] {
        fs::write(&list, text).unwrap();
        assert_refused("a list with a mistake", &rigel(folder.path(), &import).output().unwrap(), &names);
    }
    fs::write(&list, (0..VIEWS).map(line).collect::<String>()).unwrap();
    succeed(folder.path(), &import);
    let session = Session::open(&folder.path().join("new")).unwrap();
    for view in 0..VIEWS {
        let exposure_s = session.photographs(view)[0].exposure_s.unwrap();
        assert!((exposure_s * (8 + view) as f64 - 1.0).abs() < 1e-12, "{exposure_s}");
    }
}

/// What is done to a model.
type Spoil = Box<dyn Fn(&Path)>;

#[test]
fn models_that_cannot_be_used() {
    let replace = |file: &'static str, from: &'static str, to: &'static str| {
        move |model: &Path| {
            let text = fs::read_to_string(model.join(file)).unwrap();
            assert!(text.contains(from));
            fs::write(model.join(file), text.replacen(from, to, 1)).unwrap();
        }
    };
    let cases: Vec<(Spoil, &[&str])> = vec![
        (
            Box::new(replace("cameras.txt", "SIMPLE_PINHOLE", "OPENCV_FISHEYE")),
            &["cameras.txt", "line 2", "OPENCV_FISHEYE", "SIMPLE_RADIAL"],
        ),
        (Box::new(replace("cameras.txt", " 175 ", " ")), &["cameras.txt", "line 2"]),
        (Box::new(replace("cameras.txt", " 175 ", " -175 ")), &["cameras.txt", "line 2", "positive"]),
        (Box::new(replace("cameras.txt", "3 SIMPLE", "4 SIMPLE")), &["images.txt", "camera 3"]),
        (Box::new(replace("images.txt", "view002_1.png", "")), &["images.txt", "line 6"]),
        (Box::new(replace("images.txt", "view002_1.png", "none.png")), &["none.png", "check the path"]),
        (Box::new(replace("cameras.txt", " 175 ", " 17S ")), &["cameras.txt", "line 2", "number"]),
        (Box::new(replace("images.txt", " 7 ", " seven ")), &["images.txt", "line 3", "points"]),
        (Box::new(replace("images.txt", " 7 ", " ")), &["images.txt", "line 3", "points"]),
        (
            Box::new(|model| fs::remove_file(model.join("images.txt")).unwrap()),
            &["images.txt", "check the path"],
        ),
        (
            Box::new(|model| fs::write(model.join("images.txt"), "# nothing\n").unwrap()),
            &["images.txt", "no image"],
        ),
    ];
    for (spoil, names) in cases {
        let folder = workshop();
        let model = folder.path().join("model");
        write_model(&model, 1.0);
        spoil(&model);
        let before = snapshot(folder.path());
        let output =
            rigel(folder.path(), &["import", "photos", "new", "--colmap", "model"]).output().unwrap();
        let what = format!("a model that should be refused with {names:?}");
        assert_refused(&what, &output, names);
        assert_untouched(&what, &before, &snapshot(folder.path()));
    }
}

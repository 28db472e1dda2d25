//! `rigel observe` where the lamp flickers and nobody photographed flat fields: what it says and does, and what it is told to leave.

use std::fs;
use std::path::Path;

use crate::common::{IMPORT, assert_refused, assert_untouched, lens, rigel, snapshot, succeed};
use rigel::camera::Camera;
use rigel::sampling::{pan_tilt, spiral};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;

const VIEWS: usize = 20;

/// How much longer the shutter was open than anybody says: a lamp that is so much brighter.
fn gain(view: usize) -> f64 {
    // In no step with the direction: neighbours on a spiral are 5, 8 or 13 views apart.
    const GAIN: [f64; VIEWS] = [
        1.0, 1.12, 0.93, 1.05, 0.9, 0.88, 1.02, 1.1, 0.95, 1.07, 1.13, 0.91, 0.99, 0.87, 1.04, 0.96, 1.09,
        1.01, 0.92, 1.11,
    ];
    GAIN[view]
}

/// Photographs, their table and the lens.
fn photograph(folder: &Path) {
    fs::create_dir(folder.join("photos")).unwrap();
    let mut table = String::from("file,view,pan_deg,tilt_deg,exposure_s\n");
    for (view, direction) in spiral(VIEWS, 1.0).unwrap().into_iter().enumerate() {
        let (pan_rad, tilt_rad) = pan_tilt(direction);
        let options = Options { lens: lens(), vignetting: false, jpeg_quality: None, ..Options::default() };
        let mut camera = SimulatedCamera::new(Scene::patchwork(), options, || (pan_rad, tilt_rad));
        for (index, time_s) in [0.04, 0.01, 0.0025].into_iter().enumerate() {
            let name = format!("view{view:03}_{index}");
            camera.photograph(gain(view) * time_s, &folder.join("photos").join(&name)).unwrap();
            let (pan, tilt) = (pan_rad.to_degrees(), tilt_rad.to_degrees());
            table += &format!("{name}.png,{view},{pan},{tilt},{time_s}\n");
        }
    }
    fs::write(folder.join("views.csv"), table).unwrap();
    let json = format!(
        r#"{{"fx": {}, "fy": {}, "cx": {}, "cy": {}, "width": {}, "height": {}}}"#,
        lens().fx,
        lens().fy,
        lens().cx,
        lens().cy,
        lens().width,
        lens().height
    );
    fs::write(folder.join("lens.json"), json).unwrap();
}

#[test]
fn a_flickering_lamp_is_told_removed_and_left_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    photograph(folder);
    succeed(folder, &[&["import", "photos", "session", "--csv", "views.csv"], &IMPORT[..]].concat());
    succeed(folder, &["radiance", "session"]);
    let gains = |arguments: &[&str]| {
        let told = succeed(folder, &[&["observe", "session", "--texels", "16x12"], arguments].concat());
        println!("{arguments:?}: {told}");
        let text = fs::read_to_string(folder.join("session/photometry.toml")).unwrap();
        let numbers = text.lines().filter_map(|line| line.strip_prefix("gain = [")?.split(',').nth(1));
        (told, numbers.map(|number| number.trim().parse().unwrap()).collect::<Vec<f64>>())
    };
    let close = |gains: &[f64], within: f64| {
        let mean = (0..VIEWS).map(|view| gain(view).ln()).sum::<f64>() / VIEWS as f64;
        assert_eq!(gains.len(), VIEWS);
        for (view, found) in gains.iter().enumerate() {
            assert!((found.ln() - gain(view).ln() + mean).abs() < within, "view {view}: {found}");
        }
    };
    // Twenty views alone do not tell a flicker from what the surface does: that is said, with the remedy.
    let (told, found) = gains(&[]);
    assert!(told.contains("no flats") && (told.contains("--reference") || !found.is_empty()), "{told}");
    let (told, found) = gains(&["--reference", "-75mm,37mm,20mm"]);
    assert!(told.contains("the lamp's gain varied by"), "{told}");
    assert!(told.contains("the reference patch is seen in"), "{told}");
    close(&found, 0.02);
    succeed(
        folder,
        &[
            "fit",
            "session/observations.rigel",
            "--model",
            "phong",
            "--without",
            "view003",
            "--out",
            "corrected.exr",
        ],
    );
    let evaluate = ["evaluate", "corrected.exr", "--session", "session", "--views", "view003"];
    assert!(succeed(folder, &evaluate).contains("photometry.toml"));
    let (told, found) = gains(&["--keep-drift", "--keep-vignetting"]);
    assert!(found.is_empty() && !told.contains("lamp") && !told.contains("vignetting"), "{told}");
    let output = rigel(folder, &evaluate).output().unwrap();
    assert_refused("a map of another light", &output, &["corrected.exr", "another lamp", "rigel observe"]);

    // What is refused leaves everything as it was.
    let before = snapshot(folder);
    for (what, reference, names) in [
        ("a patch elsewhere", "3m,0mm,20mm", &["reference patch", "3000.0, 0.0 mm"][..]),
        ("no patch", "3m,0mm", &["not three lengths"]),
    ] {
        let output = rigel(folder, &["observe", "session", "--reference", reference]).output().unwrap();
        match what {
            "no patch" => assert!(String::from_utf8_lossy(&output.stderr).contains(names[0])),
            _ => assert_refused(what, &output, names),
        }
        assert!(!output.status.success());
    }
    assert_untouched("a refused reference", &before, &snapshot(folder));
}

//! A camera that is what it says.

use super::sensor::{FULL_ELECTRONS, FULL_EXPOSURE, READ_ELECTRONS};
use super::*;
use glam::DVec3;
use std::cell::Cell;
use std::fs;
use std::rc::Rc;
use std::time::SystemTime;

fn rig_at(pan_rad: f64, tilt_rad: f64) -> impl Fn() -> (f64, f64) {
    move || (pan_rad, tilt_rad)
}

fn small() -> Options {
    let default = Options::default();
    Options { lens: default.lens.scaled_to(160, 120), ..default }
}

/// Exposure in every pixel and channel, from the truth.
fn exposures<R: Fn() -> (f64, f64)>(camera: &SimulatedCamera<R>, exposure_s: f64) -> Vec<f64> {
    let truth = camera.truth(&camera.pose());
    let at = |i: usize| DVec2::new((i % truth.width as usize) as f64, (i / truth.width as usize) as f64);
    let exposure = |(i, rgb): (usize, &[f32; 3])| {
        let transmission = camera.vignetting(at(i));
        rgb.map(|radiance| f64::from(radiance) * transmission * exposure_s)
    };
    truth.radiance.iter().enumerate().flat_map(exposure).collect()
}

#[test]
fn without_noise_a_level_is_the_response_to_the_true_exposure() {
    let options = Options { noise: false, ..small() };
    let mut camera = SimulatedCamera::new(Scene::patchwork(), options, rig_at(0.4, 0.5));
    let expected = exposures(&camera, 0.03);
    let levels = camera.levels(0.03);
    for (level, exposure) in levels.iter().zip(&expected) {
        assert!((f64::from(*level) - camera.response(*exposure)).abs() <= 0.5 + 1e-6);
    }
    assert!(levels.contains(&255) && levels.contains(&0), "clips at both ends");
    assert!(
        levels.iter().filter(|&&l| l > 20 && l < 250).count() > levels.len() / 10,
        "and measures between"
    );
}

#[test]
fn noise_grows_with_the_signal_as_shot_and_read_noise_do() {
    let mut camera = SimulatedCamera::new(Scene::patchwork(), small(), rig_at(0.0, 0.2));
    let exposure_s = 0.01;
    let expected = exposures(&camera, exposure_s);
    let photographs: Vec<Vec<u8>> = (0..8).map(|_| camera.levels(exposure_s)).collect();
    // (sum of squares, of expected squares, count) for a dark and a bright range of exposures
    let mut ranges = [(0.02, 0.08, 0.0, 0.0, 0.0), (0.4, 0.8, 0.0, 0.0, 0.0)];
    for (i, exposure) in expected.iter().enumerate() {
        let full = exposure / FULL_EXPOSURE;
        for (low, high, squares, model, count) in &mut ranges {
            if (*low..*high).contains(&full) {
                let slope = (response(exposure * 1.001) - response(exposure * 0.999)) / (full * 0.002);
                let variance = (full * FULL_ELECTRONS + READ_ELECTRONS.powi(2)) / FULL_ELECTRONS.powi(2);
                for photograph in &photographs {
                    let error = (f64::from(photograph[i]) - response(*exposure)) / slope;
                    *squares += error * error;
                    // Rounding to whole levels adds 1/12.
                    *model += variance + 1.0 / (12.0 * slope * slope);
                    *count += 1.0;
                }
            }
        }
    }
    let [dark, bright] = ranges;
    assert!(dark.4 > 10_000.0 && bright.4 > 10_000.0, "{ranges:?}");
    for (_, _, squares, model, _) in ranges {
        assert!((squares / model - 1.0).abs() < 0.03, "{ranges:?}");
    }
    assert!(bright.2 / bright.4 > 4.0 * dark.2 / dark.4);
}

#[test]
fn noise_differs_between_photographs_and_not_between_runs() {
    let take = |seed| {
        let options = Options { seed, ..small() };
        let mut camera = SimulatedCamera::new(Scene::one_lobe(), options, rig_at(0.1, 0.2));
        [camera.levels(0.01), camera.levels(0.01)]
    };
    let first = take(1);
    assert_ne!(first[0], first[1]);
    assert_eq!(first, take(1));
    assert_ne!(first[0], take(2)[0]);
}

#[test]
fn a_bracket_renders_once_and_a_turned_rig_again() {
    let angle = Rc::new(Cell::new((0.0, 0.2)));
    let handle = angle.clone();
    let options = Options { noise: false, ..small() };
    let mut camera = SimulatedCamera::new(Scene::one_lobe(), options, move || handle.get());
    let before = camera.levels(0.01);
    assert_eq!(camera.levels(0.01), before);
    angle.set((0.3, 0.2));
    let turned = camera.levels(0.01);
    assert_ne!(turned, before);
    let mut fresh = SimulatedCamera::new(Scene::one_lobe(), options, rig_at(0.3, 0.2));
    assert_eq!(fresh.levels(0.01), turned);
}

#[test]
fn the_edge_of_the_sampled_area_appears_where_the_lens_projects_it() {
    // The white frame's outer edge against the black frame, along all four sides: half of each in the picture.
    let camera = SimulatedCamera::new(Scene::one_lobe(), Options::default(), rig_at(0.3, 0.4));
    let (pose, lens) = (camera.pose(), *camera.lens());
    let truth = camera.truth(&pose);
    let sample = |pixel: DVec2| {
        let (base, f) = (pixel.floor(), pixel.fract());
        let at = |x: f64, y: f64| {
            f64::from(truth.radiance[(base.y + y) as usize * 320 + (base.x + x) as usize][1])
        };
        (at(0.0, 0.0) * (1.0 - f.x) + at(1.0, 0.0) * f.x) * (1.0 - f.y)
            + (at(0.0, 1.0) * (1.0 - f.x) + at(1.0, 1.0) * f.x) * f.y
    };
    let (half_x, half_y) = (0.104, 0.079);
    for side in [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y] {
        let along = DVec3::new(side.y, side.x, 0.0);
        let mean = (-60..=60)
            .map(|i| {
                let edge = (side + along * f64::from(i) / 100.0) * DVec3::new(half_x, half_y, 0.0);
                let at = |offset_m: f64| {
                    let point = edge + side * offset_m;
                    sample(lens.project(pose.to_camera(point)).unwrap())
                };
                let (inner, outer) = (at(-0.002), at(0.002));
                (at(0.0) - outer) / (inner - outer)
            })
            .sum::<f64>()
            / 121.0;
        // A shift by 0.1 pixel would change this by 0.1.
        assert!((mean - 0.5).abs() < 0.05, "{side}: {mean}");
    }
}

#[test]
fn the_truth_is_the_scene_s_radiance_where_it_varies_slowly() {
    let scene = Scene::patchwork();
    let camera = SimulatedCamera::new(scene.clone(), Options::default(), rig_at(-0.7, 0.6));
    let (pose, lens) = (camera.pose(), *camera.lens());
    let truth = camera.truth(&pose);
    let mut compared = 0;
    for x in -9..=9 {
        for y in -6..=6 {
            let point = DVec3::new(f64::from(x) * 0.01, f64::from(y) * 0.01 + 0.004, 0.0);
            let Some(pixel) = lens.project(pose.to_camera(point)) else { continue };
            let ray = pose.direction_to_surface(lens.unproject(pixel.round()).unwrap());
            let seen = scene.surface().intersect(pose.centre_m, ray).unwrap();
            if (point.x.abs() % 0.05).min(0.05 - point.x.abs() % 0.05) < 0.002 {
                continue; // on the border of two patches
            }
            let expected = scene.radiance(seen, -ray);
            let got = truth.radiance[pixel.round().y as usize * 320 + pixel.round().x as usize];
            for c in 0..3 {
                assert!(
                    (f64::from(got[c]) / expected[c] - 1.0).abs() < 0.02,
                    "{point}: {got:?} {expected:?}"
                );
            }
            compared += 1;
        }
    }
    assert!(compared > 150);
}

#[test]
fn a_photograph_is_a_file_that_tells_its_exposure_time() {
    let folder = tempfile::tempdir().unwrap();
    for jpeg_quality in [Some(95), None] {
        let options = Options { jpeg_quality, noise: false, ..small() };
        let mut camera = SimulatedCamera::new(Scene::patchwork(), options, rig_at(0.0, 0.3));
        let taken = camera.photograph(0.012_344, &folder.path().join("view.7")).unwrap().taken().unwrap();
        assert!((taken.exposure_s - 0.01234).abs() < 1e-9);
        let name = taken.file.file_name().unwrap().to_str().unwrap();
        assert_eq!(name, if jpeg_quality.is_some() { "view.7.jpg" } else { "view.7.png" });
        let told = exif::read(&taken.file).unwrap();
        assert!((told.exposure_s.unwrap() - taken.exposure_s).abs() < 1e-9);
        let picture = image::open(&taken.file).unwrap().to_rgb8();
        let mut again = SimulatedCamera::new(Scene::patchwork(), options, rig_at(0.0, 0.3));
        let levels = again.levels(taken.exposure_s);
        let worst: f64 =
            picture.iter().zip(&levels).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
        let rms = (worst / levels.len() as f64).sqrt();
        assert!(rms < if jpeg_quality.is_some() { 4.0 } else { 1e-9 }, "{rms}");
        assert!(fs::metadata(&taken.file).unwrap().len() < camera.file_size_bytes() + 1000);
    }
}

#[test]
fn a_photograph_that_is_taken_again_is_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let photograph = |camera: &mut SimulatedCamera<_>, name: &str| {
        let taken = camera.photograph(0.01, &folder.path().join(name)).unwrap().taken().unwrap();
        fs::read(taken.file).unwrap()
    };
    let mut camera = SimulatedCamera::new(Scene::patchwork(), small(), rig_at(0.0, 0.3));
    let first = photograph(&mut camera, "view000_1");
    assert_ne!(photograph(&mut camera, "view000_2"), first, "another one has other noise");
    assert_eq!(photograph(&mut camera, "view000_1"), first);
}

#[test]
fn a_photograph_of_a_released_camera_tells_its_time_and_shows_its_exposure() {
    let folder = tempfile::tempdir().unwrap();
    let mean = |exposure_s: f64| {
        let path = folder.path().join(format!("{exposure_s}.jpg"));
        let at = SystemTime::UNIX_EPOCH + std::time::Duration::from_millis(1_790_000_000_250);
        write_photograph(&path, exposure_s, at).unwrap();
        let told = exif::read(&path).unwrap();
        assert!((told.exposure_s.unwrap() - exposure_s).abs() < 1e-6);
        assert!((told.taken.unwrap().clock_s - 1_790_000_000.25).abs() < 1e-6);
        let picture = image::open(path).unwrap().to_luma8();
        picture.iter().map(|&level| f64::from(level)).sum::<f64>() / picture.len() as f64
    };
    assert!(mean(0.002) < mean(0.004) && mean(0.004) < mean(0.008));
}

#[test]
fn an_impossible_exposure_time_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut camera = SimulatedCamera::new(Scene::one_lobe(), small(), rig_at(0.0, 0.0));
    for exposure_s in [0.0, -1.0, 5.0, f64::NAN] {
        let error = camera.photograph(exposure_s, &folder.path().join("a")).unwrap_err();
        assert!(error.to_string().contains("choose a time"), "{error}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

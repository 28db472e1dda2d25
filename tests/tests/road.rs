//! The whole road from photographs to predictions, on a board whose truth is a formula.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::fs;
use std::path::Path;

use glam::DVec3;
use rigel::camera::Camera;
use rigel::evaluate::{Reference, evaluate};
use rigel::fit::{FitOptions, Fitter, Model};
use rigel::geometry::{Lens, Pose, Surface, Texels};
use rigel::measure::{self, measure};
use rigel::observation::{self, ObservationMap, TexelObservations, observe};
use rigel::parameter_map::fit_surface;
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::sampling::{pan_tilt, spiral};
use rigel::session::import::{Options, Source, import};
use rigel::session::{Event, Manifest, Photograph, Session, View};
use rigel::view_file::Calibration;
use rigel_simulated::camera;
use rigel_simulated::camera::SimulatedCamera;
use rigel_simulated::scene::Scene;

const PHONG: Model = Model::Phong { lobes: 1 };

/// Pan and tilt of `count` views down to zenith 70 degrees.
fn views(count: usize) -> Vec<(f64, f64)> {
    spiral(count, 70f64.to_radians()).unwrap().into_iter().map(pan_tilt).collect()
}

/// Texels with one observation for each direction, exactly as `radiance` says.
fn exact_texel(directions: &[DVec3], radiance: impl Fn(DVec3) -> [f64; 3]) -> TexelObservations {
    TexelObservations {
        view: (0..directions.len() as u32).collect(),
        direction: directions.iter().map(|d| d.as_vec3()).collect(),
        radiance: directions.iter().map(|&d| radiance(d).map(|l| l as f32)).collect(),
        sigma: vec![0.0; directions.len()],
    }
}

#[test]
fn lobes_come_back_from_exact_radiance_to_a_thousandth() {
    let scene = Scene::one_lobe();
    let surface = scene.surface();
    let texels = Texels { columns: 16, rows: 12 };
    let directions = spiral(73, 70f64.to_radians()).unwrap();
    let points: Vec<DVec3> =
        (0..192).map(|i| surface.texel_centre(texels, i % texels.columns, i / texels.columns)).collect();
    let lobes: Vec<_> = points.iter().map(|&point| scene.lobe(point).unwrap()).collect();
    let data: Vec<_> = lobes.iter().map(|lobe| exact_texel(&directions, |d| lobe.radiance(d))).collect();
    let fitter = Fitter::new(PHONG, &FitOptions::default(), &data).unwrap();
    let mut worst = 0f64;
    for (texel, lobe) in data.iter().zip(&lobes) {
        let found: Vec<f64> = fitter.fit(texel).parameters.into_iter().map(f64::from).collect();
        let truth =
            [&lobe.diffuse[..], &lobe.specular, &[lobe.shininess], &lobe.direction.to_array()].concat();
        for (i, (found, truth)) in found.iter().zip(&truth).enumerate() {
            // Coefficients relative to their size, the direction in radians.
            let error = (found - truth).abs() / if i < 7 { *truth } else { 1.0 };
            worst = worst.max(error);
            assert!(error <= 1e-3, "parameter {i} is {found}, in truth {truth}: {lobe:?}");
        }
    }
    println!("one lobe, exact radiance: worst error of a parameter {worst:.1e}");
}

/// Photographs `scene` at each pan and tilt with times that are halved until no pixel is saturated, and lists them.
fn photograph(
    scene: &Scene,
    options: camera::Options,
    views: &[(f64, f64)],
    folder: &Path,
) -> std::path::PathBuf {
    fs::create_dir(folder.join("photos")).unwrap();
    let mut table = String::from("file,view,pan_deg,tilt_deg,exposure_s\n");
    for (view, &(pan_rad, tilt_rad)) in views.iter().enumerate() {
        let mut camera = SimulatedCamera::new(scene.clone(), options, || (pan_rad, tilt_rad));
        let mut time_s = 0.16;
        loop {
            let stem = folder.join("photos").join(format!("view{view:03}_{time_s}"));
            let taken = camera.photograph(time_s, &stem).unwrap().taken().unwrap();
            let name = taken.file.file_name().unwrap().to_str().unwrap();
            let (pan, tilt) = (pan_rad.to_degrees(), tilt_rad.to_degrees());
            table += &format!("{name},{view},{pan},{tilt},{}\n", taken.exposure_s);
            if Picture::read(&taken.file).unwrap().levels.iter().flatten().all(|&level| level < 250) {
                break;
            }
            time_s /= 2.0;
        }
    }
    fs::write(folder.join("views.csv"), table).unwrap();
    folder.join("views.csv")
}

/// Imports what [`photograph`] left and recovers response and radiance.
fn measured(folder: &Path, table: &Path, lens: &Lens, surface: Surface) -> Session {
    let Lens { fx, fy, cx, cy, k1, k2, p1, p2, .. } = lens;
    let calibration = folder.join("lens.toml");
    let numbers = format!(
        "fx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\nk1 = {k1:?}\nk2 = {k2:?}\np1 = {p1:?}\np2 = {p2:?}\n"
    );
    fs::write(&calibration, numbers).unwrap();
    let options = Options {
        surface: Some(surface),
        distance_m: Some(0.9),
        calibration: Some(Calibration::read(&calibration, 0.0).unwrap()),
        ..Options::default()
    };
    let source = Source::Csv { table: table.into(), photographs: folder.join("photos") };
    let session = import(&source, &folder.join("session"), &options, &Silent).unwrap().session;
    measure(&session, &measure::Options::default(), &Silent).unwrap();
    session
}

/// How far the recovered response is from the camera's, relative, median over levels 20 to 235 after one common scale.
fn response_error(session: &Session, truth: impl Fn(f64) -> f64) -> f64 {
    let path = session.radiance_folder().join("response.csv");
    let response = rigel::radiance::Response::read_csv(&path).unwrap();
    let exposure_of = |level: usize| {
        let (mut low, mut high) = (0.0, 0.02);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if truth(middle) < level as f64 { low = middle } else { high = middle }
        }
        low
    };
    let errors = (0..3).map(|channel| {
        let ratios =
            (20..=235).map(|level| f64::from(response.exposure(channel)[level]) / exposure_of(level));
        let ratios: Vec<f64> = ratios.collect();
        let scale = median(ratios.clone());
        median(ratios.iter().map(|ratio| (ratio / scale - 1.0).abs()).collect())
    });
    errors.fold(0.0, f64::max)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn photographs_of_one_lobe_predict_views_that_nobody_took() {
    let scene = Scene::one_lobe();
    let ideal = camera::Options::default();
    let lens = ideal.lens.scaled_to(240, 180);
    let options = camera::Options { lens, noise: false, vignetting: false, jpeg_quality: None, ..ideal };
    let folder = tempfile::tempdir().unwrap();
    let table = photograph(&scene, options, &views(60), folder.path());
    let session = measured(folder.path(), &table, &lens, scene.surface());
    let camera = SimulatedCamera::new(scene.clone(), options, || (0.0, 0.0));
    let response = response_error(&session, |exposure| camera.response(exposure));
    println!("road: response within {:.2} %", 100.0 * response);
    assert!(response <= 0.02, "{response}");

    let path = session.folder().join("observations.rigel");
    let texels = observation::Options { texels: Texels { columns: 80, rows: 60 } };
    let map = observe(&session, &path, &texels, &Silent).unwrap();
    let fitted = fit_surface(&map, PHONG, &FitOptions::default(), &[], &Silent).unwrap();
    let references: Vec<Reference> = [(0.3, 0.2), (2.0, 0.5), (4.5, 0.8), (5.5, 1.0)]
        .into_iter()
        .map(|(pan_rad, tilt_rad)| {
            let pose = Pose::from_rig(pan_rad, tilt_rad, 0.9);
            Reference {
                name: format!("pan {pan_rad}"),
                lens,
                pose,
                radiance: camera.truth(&pose),
                exposure_time_known: true,
            }
        })
        .collect();
    let evaluation = evaluate(&fitted, &references, &Silent).unwrap();
    println!(
        "road: held-out views within {:.2} % (median), {:.2} of 255, {:.1} dB",
        100.0 * evaluation.median_relative(),
        evaluation.mean_255(),
        evaluation.psnr_db()
    );
    // What is left is the texture between texels and the sharpest lobes between views.
    assert!(evaluation.median_relative() < 0.02 && evaluation.mean_255() < 3.3, "{:?}", evaluation.views);
    assert!(evaluation.psnr_db() > 30.0, "{:?}", evaluation.views);
}

#[test]
fn the_response_comes_back_from_noisy_photographs_of_the_patchwork() {
    let scene = Scene::patchwork();
    let lens = camera::Options::default().lens.scaled_to(160, 120);
    let options = camera::Options { lens, ..camera::Options::default() };
    let folder = tempfile::tempdir().unwrap();
    let table = photograph(&scene, options, &views(12), folder.path());
    let session = measured(folder.path(), &table, &lens, scene.surface());
    let camera = SimulatedCamera::new(scene, options, || (0.0, 0.0));
    let error = response_error(&session, |exposure| camera.response(exposure));
    println!("patchwork, noise and JPEG: response within {:.2} %", 100.0 * error);
    assert!(error <= 0.02, "{error}");
}

/// A session of `views` views with even radiance, without photographs: all that an observation map needs.
fn even_session(folder: &Path, views: usize) -> Session {
    let lens = Lens::pinhole(64, 48, 150.0);
    let mut manifest = Manifest::new("test");
    manifest.surface = Some(Surface { width_m: 0.2, height_m: 0.15 });
    manifest.distance_m = Some(0.9);
    manifest.lenses = vec![lens];
    manifest.views = (0..views)
        .map(|view| View {
            name: format!("view{view:03}"),
            pan_deg: Some(7.3 * view as f64),
            tilt_deg: Some(1.7 * view as f64),
            lens: 0,
            pose: None,
        })
        .collect();
    let mut session = Session::create(folder, manifest).unwrap();
    fs::create_dir(session.radiance_folder()).unwrap();
    let pixels = 64 * 48;
    let image = RadianceImage {
        width: 64,
        height: 48,
        radiance: (0..pixels).map(|i| [0.5, 0.6, 0.4 + i as f32 * 1e-5]).collect(),
        variance: vec![[1e-4; 3]; pixels],
        mask: vec![0; pixels],
    };
    for view in 0..views {
        let file = format!("photographs/{view}.png");
        let photograph = Photograph { view, file, exposure_s: Some(1.0), ..Photograph::default() };
        session.record(Event::Photograph(photograph)).unwrap();
        session.record(Event::ViewDone { view }).unwrap();
        image.write_exr(&session.radiance_path(view), "test").unwrap();
    }
    session
}

#[test]
fn an_observation_map_is_as_large_as_what_it_holds() {
    let folder = tempfile::tempdir().unwrap();
    let views = 12;
    let session = even_session(folder.path(), views);
    let path = folder.path().join("map.rigel");
    for (columns, rows) in [(64, 48), (100, 75), (33, 65), (37, 37), (49, 51), (53, 59), (127, 97), (16, 200)]
    {
        let options = observation::Options { texels: Texels { columns, rows } };
        let map = observe(&session, &path, &options, &Silent).unwrap();
        let bytes = fs::metadata(&path).unwrap().len();
        assert_eq!(bytes, map.header().file_bytes());
        let values = f64::from(columns * rows) * views as f64 * 5.0 * 2.0;
        println!("{columns}x{rows}: {:.1} % more than its values", 100.0 * (bytes as f64 / values - 1.0));
        assert!((bytes as f64) < 1.05 * values, "{columns}x{rows}: {bytes} bytes for {values}");
        // Nothing is lost at the edges of tiles: every texel comes back once.
        let map = ObservationMap::open(&path).unwrap();
        let mut seen = vec![0; (columns * rows) as usize];
        for tile in 0..map.header().tiles().count() {
            for ((column, row), texel) in map.tile(tile).unwrap() {
                seen[(row * columns + column) as usize] += 1;
                assert!(texel.len() > views / 2);
            }
        }
        assert!(seen.iter().all(|&times| times == 1), "{columns}x{rows}");
    }
    // A map of 512x512 texels and 300 views, from its header alone.
    let mut header = ObservationMap::open(&path).unwrap().header().clone();
    header.texels = Texels { columns: 512, rows: 512 };
    header.tile = Texels { columns: 32, rows: 32 };
    header.views = (0..300).map(|view| header.views[view % views].clone()).collect();
    let values = 512.0 * 512.0 * 300.0 * 10.0;
    assert!((header.file_bytes() as f64) < 1.001 * values);
}

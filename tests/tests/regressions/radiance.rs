//! What `radiance` once took for granted.

use std::fmt::Write as _;
use std::path::Path;

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::measure::{self, Measured, ResponseChoice, measure};
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel::radiance::{RadianceImage, Response};
use rigel::session::Session;
use rigel::session::import::{Options, Source, import};

const SIZE: (u32, u32) = (96, 64);
const TIMES_S: [f64; 3] = [1.0, 0.5, 0.25];

fn normal(random: &mut StdRng) -> f64 {
    let (a, b): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

/// A smooth scene, 0.02 to 0.8.
fn scene(x: usize, y: usize) -> f64 {
    0.02 * 40f64.powf(0.5 * x as f64 / f64::from(SIZE.0) + 0.5 * y as f64 / f64::from(SIZE.1))
}

/// Brackets of two views of the scene as `write` stores an exposure, in a session.
fn session(folder: &Path, extension: &str, write: impl Fn(&Path, &dyn Fn(usize, usize) -> f64)) -> Session {
    std::fs::create_dir(folder.join("photos")).unwrap();
    let mut table = String::from("file,view,pan_deg,tilt_deg,exposure_s\n");
    for view in 0..2 {
        for (i, time_s) in TIMES_S.into_iter().enumerate() {
            let name = format!("view{view}_{i}.{extension}");
            write(&folder.join("photos").join(&name), &|x, y| scene(x, y) * time_s);
            let _ = writeln!(table, "{name},{view},0,{view},{time_s}");
        }
    }
    std::fs::write(folder.join("views.csv"), table).unwrap();
    let source = Source::Csv { table: folder.join("views.csv"), photographs: folder.join("photos") };
    import(&source, &folder.join("session"), &Options::default(), &Silent).unwrap().session
}

fn measured(session: &Session, response: ResponseChoice) -> Measured {
    measure(session, &measure::Options { response, ..measure::Options::default() }, &Silent).unwrap()
}

/// Levels in proportion to the exposure with noise of `SIGMA` levels, ten times an ordinary camera's.
const SIGMA: f64 = 6.0;

fn noisy(folder: &Path) -> Session {
    let random = std::cell::RefCell::new(StdRng::seed_from_u64(7));
    session(folder, "png", |path, exposure| {
        let level = |x: u32, y: u32| {
            let exact = 255.0 * exposure(x as usize, y as usize);
            [0; 3].map(|_| (exact + SIGMA * normal(&mut random.borrow_mut())).round().clamp(0.0, 255.0) as u8)
        };
        image::RgbImage::from_fn(SIZE.0, SIZE.1, |x, y| image::Rgb(level(x, y))).save(path).unwrap();
    })
}

#[test]
fn floating_point_photographs_keep_their_exact_response() {
    let folder = tempfile::tempdir().unwrap();
    let random = std::cell::RefCell::new(StdRng::seed_from_u64(3));
    let session = session(folder.path(), "exr", |path, exposure| {
        let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
        let noisy =
            |i: usize| exposure(i % width, i / width) * (1.0 + 0.01 * normal(&mut random.borrow_mut()));
        let pixels: Vec<f32> = (0..width * height).map(|i| noisy(i) as f32).collect();
        exr::prelude::write_rgb_file(path, width, height, |x, y| [pixels[y * width + x]; 3].into()).unwrap();
    });
    let told = measured(&session, ResponseChoice::Recover);
    let used = Response::read_csv(&session.radiance_folder().join("response.csv")).unwrap();
    let exact = Response::linear(Picture::FLOAT_WHITE);
    assert!((0..3).all(|c| used.exposure(c) == exact.exposure(c)));
    assert!(!told.notes.iter().any(|note| note.contains("noise")), "{:?}", told.notes);
    // The unit is that of the photographs, and the noise is theirs: a hundredth of each.
    let image = RadianceImage::read_exr(&session.radiance_path(0)).unwrap();
    let mut scores: Vec<f64> = (0..image.radiance.len())
        .map(|i| {
            let truth = scene(i % SIZE.0 as usize, i / SIZE.0 as usize);
            (f64::from(image.radiance[i][1]) - truth).abs() / f64::from(image.variance[i][1]).sqrt()
        })
        .collect();
    scores.sort_by(f64::total_cmp);
    let within = scores[scores.len() * 683 / 1000];
    assert!((0.6..1.5).contains(&within), "68 % within {within} sigma");
}

#[test]
fn noise_is_learnt_from_brackets_although_the_response_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let session = noisy(folder.path());
    let path = folder.path().join("response.csv");
    Response::linear(255).write_csv(&path).unwrap();
    for choice in [ResponseChoice::File(path), ResponseChoice::Linear] {
        let told = measured(&session, choice.clone());
        assert!(!told.notes.iter().any(|note| note.contains("noise")), "{:?}", told.notes);
        let image = RadianceImage::read_exr(&session.radiance_path(0)).unwrap();
        let mut scores: Vec<f64> = (0..image.radiance.len())
            .filter(|&i| image.mask[i] == 0)
            .map(|i| {
                let truth = scene(i % SIZE.0 as usize, i / SIZE.0 as usize) * 255.0 / 128.0;
                (f64::from(image.radiance[i][1]) - truth).abs() / f64::from(image.variance[i][1]).sqrt()
            })
            .collect();
        scores.sort_by(f64::total_cmp);
        let within = scores[scores.len() * 683 / 1000];
        // A guessed curve is in doubt beside the noise.
        assert!((0.3..1.5).contains(&within), "{choice:?}: 68 % within {within} sigma");
    }
}

#[test]
fn what_is_assumed_is_told() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("photos")).unwrap();
    let even = image::RgbImage::from_pixel(32, 32, image::Rgb([90; 3]));
    even.save(folder.path().join("photos/a.png")).unwrap();
    let options = Options { exposure_times_unknown: true, ..Options::default() };
    let source = Source::Folder(folder.path().join("photos"));
    let session = import(&source, &folder.path().join("session"), &options, &Silent).unwrap().session;
    let notes = measured(&session, ResponseChoice::Srgb).notes;
    assert!(notes.iter().any(|note| note.contains("noise")), "{notes:?}");
    assert!(notes.iter().any(|note| note.contains("no flats: vignetting stays")), "{notes:?}");
}

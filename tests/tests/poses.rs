//! Poses of the patchwork capture from its photographs alone.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "poses/patchwork.rs"]
mod patchwork;

use std::time::Instant;

use glam::DVec2;
use patchwork::{Truth, gauge_free, import_patchwork, lens, squares, summary};
use rigel::calibration::{LensCovariance, RegisterOptions, Registration, register};
use rigel::evaluate::{evaluate, read_references};
use rigel::fit::{FitOptions, Model};
use rigel::geometry::{Lens, Texels};
use rigel::observation::{Options, observe};
use rigel::parameter_map::fit_surface;
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::session::{Session, View};
use rigel_tests::data;

#[test]
fn poses_from_photographs_alone_and_what_is_fitted_with_them() {
    let Some(patchwork) = data("multiview/patchwork") else { return };
    let folder = tempfile::tempdir().unwrap();
    let start = Instant::now();
    let session = import_patchwork(&patchwork, &patchwork.join("views.csv"), &folder.path().join("session"));
    println!("import and radiance in {:.1?}", start.elapsed());
    let start = Instant::now();
    let lens = lens(&patchwork);
    println!("lens in {:.1?}: {:?}", start.elapsed(), lens.0);
    let start = Instant::now();
    let options = RegisterOptions { squares: Some(squares(folder.path())), lens: Some(lens) };
    let registration = register(&session, &options, &Silent).unwrap();
    registration.write(&session).unwrap();
    println!(
        "registered in {:.1?}; noise {:?}, {:?}",
        start.elapsed(),
        registration.noise,
        registration.deviations
    );
    let truth = Truth::read(&patchwork);
    let [median, p95, most, within] = summary(&truth, &registration);
    println!(
        "directions: median {median:.4}, p95 {p95:.4}, maximum {most:.4} degrees; {:.0} % within one sigma",
        100.0 * within
    );
    assert!(registration.dropped.is_empty(), "{:?}", registration.dropped);
    assert_eq!(registration.views.len(), 75);
    assert!(median <= 0.03 && p95 <= 0.1 && most <= 0.2, "{median} {p95} {most}");
    // 68 % would be exact.
    assert!((0.60..=0.76).contains(&within), "{within}");
    // What was written is read back, and belongs to this session.
    assert_eq!(Registration::of(&session).unwrap().unwrap(), registration);

    let columns: u32 = std::env::var("COLUMNS_OF_TEXELS").map_or(384, |n| n.parse().unwrap());
    let texels = Texels { columns, rows: columns * 3 / 4 };
    let path = folder.path().join("observations.rigel");
    let map = observe(&session, &path, &Options { texels }, &Silent).unwrap();
    let fitted = fit_surface(&map, Model::Phong { lobes: 1 }, &FitOptions::default(), &[], &Silent).unwrap();
    let references = read_references(&patchwork.join("truth/eval.json"), 0.5).unwrap();
    let evaluation = evaluate(&fitted, &references, &Silent).unwrap();
    let (mean, psnr) = (evaluation.mean_255(), evaluation.psnr_db());
    println!("one lobe on {columns} columns: mean {mean:.2} of 255, PSNR {psnr:.2} dB");
    // Coarser texels cannot show what the surface has.
    assert!(columns < 384 || (mean <= 5.5 && psnr >= 29.4), "mean {mean:.2} of 255, PSNR {psnr:.2} dB");

    what_was_given_wrongly_is_named(&session, &options);
    bad_views_are_dropped_by_name_and_the_others_stay(&session, &options, &registration, &truth);
    without_squares_texture_aligns_the_views(&session, lens, &truth);
}

/// A square that is 5 mm off in the file, squares of another size, a camera that is elsewhere, signs of angles.
fn what_was_given_wrongly_is_named(session: &Session, options: &RegisterOptions) {
    let refused = |slip: &dyn Fn(&mut Session, &mut RegisterOptions), names: &[&str]| {
        let (mut session, mut options) = (Session::open(session.folder()).unwrap(), options.clone());
        slip(&mut session, &mut options);
        let message = register(&session, &options, &Silent).unwrap_err().to_string();
        println!("{message}");
        assert!(names.iter().all(|name| message.contains(name)), "{message} should name {names:?}");
    };
    fn squares(options: &mut RegisterOptions) -> &mut rigel::calibration::Squares {
        options.squares.as_mut().unwrap()
    }
    refused(&|_, o| squares(o).centres_m[2].x += 0.005, &["square 3", "5.", "measure it again"]);
    let narrower =
        |o: &mut RegisterOptions| squares(o).centres_m.iter_mut().for_each(|c| c.x *= 100.0 / 112.0);
    refused(&|_, o| narrower(o), &["squares", "check the squares file"]);
    refused(&|_, o| squares(o).size_m = 0.016, &["squares of about 12 mm", "not 16.0 mm"]);
    refused(&|s, _| s.manifest.distance_m = Some(0.75), &["camera were about 90", "not 750 mm"]);
    let flip = |s: &mut Session| {
        s.manifest.views.iter_mut().for_each(|view| view.pan_deg = view.pan_deg.map(|pan| -pan));
    };
    refused(&|s, _| flip(s), &["every pan had the other sign", "table of angles"]);
    refused(&|_, o| squares(o).centres_m.truncate(1), &["single square", "four or more"]);
}

/// Two views swapped in the table, one with a wrong angle, one with all its squares in glare and one with two of them.
fn bad_views_are_dropped_by_name_and_the_others_stay(
    session: &Session,
    options: &RegisterOptions,
    good: &Registration,
    truth: &Truth,
) {
    let mut session = Session::open(session.folder()).unwrap();
    let angles = |view: &View| (view.pan_deg, view.tilt_deg);
    let views = &mut session.manifest.views;
    let (a, b) = (angles(&views[10]), angles(&views[40]));
    (views[10].pan_deg, views[10].tilt_deg) = b;
    (views[40].pan_deg, views[40].tilt_deg) = a;
    views[25].tilt_deg = views[25].tilt_deg.map(|tilt| tilt + 5.0);
    let lens = good.lens;
    let full = (41..75).find(|&view| good.views[view].corners == 16).unwrap();
    for (view, hidden) in [(3, 4), (full, 2)] {
        let path = session.radiance_path(view);
        let mut image = RadianceImage::read_exr(&path).unwrap();
        let pose = good.views[view].pose;
        for centre in &options.squares.as_ref().unwrap().centres_m[..hidden] {
            let at = lens.project(pose.to_camera(*centre)).unwrap();
            for (i, radiance) in image.radiance.iter_mut().enumerate() {
                let pixel = DVec2::new((i % 640) as f64, (i / 640) as f64);
                *radiance = radiance.map(|r| r + 30.0 * (-pixel.distance_squared(at) / 200.0).exp() as f32);
            }
        }
        image.write_exr(&path, "with glare").unwrap();
    }
    let found = register(&session, options, &Silent).unwrap();
    for dropped in &found.dropped {
        println!("{} {}", dropped.name, dropped.reason);
    }
    let reason = |name: &str| {
        let view = found.dropped.iter().find(|view| view.name == name);
        view.unwrap_or_else(|| panic!("{name} was not dropped")).reason.clone()
    };
    assert!(reason("view010").contains("swapped") && reason("view010").contains("view040"));
    assert!(reason("view040").contains("swapped") && reason("view040").contains("view010"));
    assert!(reason("view025").contains("tilt"));
    assert_eq!(found.dropped.len(), 3);
    // What the squares of this one do not show its texture does.
    let hidden = found.view("view003").unwrap();
    assert!(hidden.corners == 0 && hidden.patches > 20, "{} {}", hidden.corners, hidden.patches);
    assert!(hidden.direction_error_rad(&truth.pose("view003")).to_degrees() < 0.05);
    let glared = found.view(&good.views[full].name).unwrap();
    assert!(glared.corners <= 8 && glared.corners > 0, "{}", glared.corners);
    assert!(glared.direction_sigma_rad() > good.views[full].direction_sigma_rad());
    let [median, p95, most, _] = summary(truth, &found);
    assert!(median <= 0.03 && p95 <= 0.1 && most <= 0.2, "{median} {p95} {most}");
    // The registration belongs to the table that is in order.
    assert!(Registration::of(&session).unwrap_err().to_string().contains("angles"));
}

/// Nothing but the commanded angles and the surface's texture.
fn without_squares_texture_aligns_the_views(
    session: &Session,
    lens: (Lens, Option<LensCovariance>),
    truth: &Truth,
) {
    let start = Instant::now();
    let options = RegisterOptions { squares: None, lens: Some(lens) };
    let found = register(session, &options, &Silent).unwrap();
    let [median, p95, most, within] = summary(truth, &found);
    println!(
        "texture alone in {:.1?}: median {median:.4}, p95 {p95:.4}, maximum {most:.4} degrees; {:.0} % within one sigma",
        start.elapsed(),
        100.0 * within
    );
    let (free, within) = gauge_free(truth, &found);
    println!(
        "but for the gauge {free:.4?}, {:.0} % within one sigma; {:?} {:?}",
        100.0 * within,
        found.deviations,
        found.notes
    );
    assert!(found.views.len() == 75 && found.views.iter().all(|view| view.corners == 0 && view.patches > 5));
    assert!(free[0] < 0.03 && free[1] < 0.12 && median < 0.08, "{free:?} {median}");
    // All views together are off by what their angles are on average: of that there is one, and it says nothing of how often.
    assert!((0.55..=0.76).contains(&within), "{within}");

    // A session that does not say how large the surface is keeps its commanded angles.
    let mut blank = Session::open(session.folder()).unwrap();
    blank.manifest.surface = None;
    let found = register(&blank, &options, &Silent).unwrap();
    let [median, _, _, within] = summary(truth, &found);
    println!("commanded angles alone: median {median:.3}; {:.0} % within one sigma", 100.0 * within);
    assert!(found.views.len() == 75 && found.views.iter().all(|view| view.corners + view.patches == 0));
    assert!(median < 0.5 && within >= 0.6, "{median} {within}");
    assert!(found.notes.iter().any(|note| note.contains("--surface")));
}

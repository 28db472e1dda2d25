//! Poses of the patchwork capture from its photographs alone.

#[path = "poses/patchwork.rs"]
mod patchwork;

use std::time::Instant;

use patchwork::{Truth, import_patchwork, lens, squares, summary};
use rigel::calibration::{RegisterOptions, Registration, register};
use rigel::evaluate::{evaluate, read_references};
use rigel::fit::{FitOptions, Model};
use rigel::geometry::Texels;
use rigel::observation::{Options, observe};
use rigel::parameter_map::fit_surface;
use rigel::progress::Silent;
use rigel_tests::data;

#[test]
fn poses_from_photographs_alone_and_what_is_fitted_with_them() {
    let Some(patchwork) = data("multiview/patchwork") else { return };
    let folder = tempfile::tempdir().unwrap();
    let start = Instant::now();
    let session = import_patchwork(&patchwork, &patchwork.join("views.csv"), &folder.path().join("session"));
    println!("import and radiance in {:.1?}", start.elapsed());
    let start = Instant::now();
    let options = RegisterOptions { squares: Some(squares(folder.path())), lens: Some((lens(), None)) };
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
    assert!((0.60..=0.76).contains(&within), "{within}");
    // What was written is read back, and belongs to this session.
    assert_eq!(Registration::of(&session).unwrap().unwrap(), registration);

    let columns: u32 = std::env::var("COLUMNS_OF_TEXELS").map_or(192, |n| n.parse().unwrap());
    let texels = Texels { columns, rows: columns * 3 / 4 };
    let path = folder.path().join("observations.rigel");
    let map = observe(&session, &path, &Options { texels }, &Silent).unwrap();
    let fitted = fit_surface(&map, Model::Phong { lobes: 1 }, &FitOptions::default(), &[], &Silent).unwrap();
    let references = read_references(&patchwork.join("truth/eval.json"), 0.5).unwrap();
    let evaluation = evaluate(&fitted, &references, &Silent).unwrap();
    let (mean, psnr) = (evaluation.mean_255(), evaluation.psnr_db());
    println!("one lobe on {columns} columns: mean {mean:.2} of 255, PSNR {psnr:.2} dB");
    assert!(mean <= 6.0 && psnr >= 28.8, "mean {mean:.2} of 255, PSNR {psnr:.2} dB");
}

//! The patchwork capture, rendered by an independent path tracer: 75 views of eight materials, predicted at six others.

use rigel::evaluate::{evaluate, read_references};
use rigel::fit::{FitOptions, Model};
use rigel::geometry::Texels;
use rigel::measure::{self, measure};
use rigel::observation::{Options as ObservationOptions, observe};
use rigel::parameter_map::fit_surface;
use rigel::progress::Silent;
use rigel::session::import::{Options, Source, import};
use rigel::units::parse_surface;
use rigel::view_file::Calibration;
use rigel_tests::data;

#[test]
fn six_views_that_nobody_took_are_predicted() {
    let Some(patchwork) = data("multiview/patchwork") else { return };
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        surface: Some(parse_surface("200mmx150mm").unwrap()),
        // The truth says where the lens and the camera were; its pixel centres are at 0.5.
        calibration: Some(Calibration::read(&patchwork.join("truth/truth.json"), 0.5).unwrap()),
        flats: (0..4).map(|i| patchwork.join(format!("calibration/flat{i}.jpg"))).collect(),
        ..Options::default()
    };
    let source = Source::Csv { table: patchwork.join("views.csv"), photographs: patchwork.join("photos") };
    let session = import(&source, &folder.path().join("session"), &options, &Silent).unwrap().session;
    measure(&session, &measure::Options::default(), &Silent).unwrap();
    let path = folder.path().join("observations.rigel");
    let number = |name: &str, default: u32| std::env::var(name).map_or(default, |n| n.parse().unwrap());
    let columns = number("COLUMNS_OF_TEXELS", 256);
    let texels = Texels { columns, rows: columns * 3 / 4 };
    let map = observe(&session, &path, &ObservationOptions { texels }, &Silent).unwrap();
    let references = read_references(&patchwork.join("truth/eval.json"), 0.5).unwrap();
    let model = Model::Phong { lobes: number("LOBES", 2) as u8 };
    let start = std::time::Instant::now();
    let fitted = fit_surface(&map, model, &FitOptions::default(), &[], &Silent).unwrap();
    println!("{} on {columns} columns of texels: fitted in {:.1?}", model.name(), start.elapsed());
    let evaluation = evaluate(&fitted, &references, &Silent).unwrap();
    let (mean, psnr) = (evaluation.mean_255(), evaluation.psnr_db());
    println!("patchwork: mean {mean:.2} of 255, PSNR {psnr:.2} dB");
    assert!(mean <= 5.7 && psnr >= 29.0, "mean {mean:.2} of 255, PSNR {psnr:.2} dB");
}

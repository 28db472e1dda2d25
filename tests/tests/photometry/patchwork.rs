//! The patchwork capture without its flats, and with a lamp that flickers over its real radiance.

use std::path::Path;

use rigel::calibration::Vignetting;
use rigel::measure::{self, measure};
use rigel::photometry::{Options, find};
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel::radiance::{NoiseModel, RadianceImage, Response};
use rigel::session::Session;
use rigel::session::import::{self, Source, import};
use rigel::units::parse_surface;
use rigel::view_file::Calibration;
use rigel_tests::data;

use super::world::flicker;

/// Lens and poses are given, the flats are not.
fn session(patchwork: &Path, folder: &Path) -> Session {
    let options = import::Options {
        surface: Some(parse_surface("200mmx150mm").unwrap()),
        calibration: Some(Calibration::read(&patchwork.join("truth/truth.json"), 0.5).unwrap()),
        ..import::Options::default()
    };
    let source = Source::Csv { table: patchwork.join("views.csv"), photographs: patchwork.join("photos") };
    let session = import(&source, folder, &options, &Silent).unwrap().session;
    measure(&session, &measure::Options::default(), &Silent).unwrap();
    session
}

#[test]
fn the_patchwork_s_lamp_is_left_alone_its_vignetting_is_that_of_the_flats_and_a_flicker_is_found() {
    let Some(patchwork) = data("multiview/patchwork") else { return };
    let folder = tempfile::tempdir().unwrap();
    let session = session(&patchwork, &folder.path().join("session"));
    let found = find(&session, &Options::default(), &Silent).unwrap();
    println!("{:?}", found.notes);
    assert!(found.views.is_empty());

    let flat = |i: u32| Picture::read(patchwork.join(format!("calibration/flat{i}.jpg"))).unwrap();
    let flats: Vec<Picture> = (0..4).map(flat).collect();
    let response = Response::read_csv(&session.radiance_folder().join("response.csv")).unwrap();
    let truth = Vignetting::fit(&flats, &response, &NoiseModel::assumed(&response)).unwrap();
    let own = found.vignetting.unwrap();
    // In a straight view the surface lies within these.
    let off = |x: f64, y: f64| (own.at(x, y) / truth.at(x, y)).ln();
    let off: Vec<f64> =
        (0..80).map(|i| off(180.0 + f64::from(i % 10) * 31.0, 135.0 + f64::from(i / 10) * 30.0)).collect();
    let mean = off.iter().sum::<f64>() / 80.0;
    let error = (off.iter().map(|off| (off - mean).powi(2)).sum::<f64>() / 80.0).sqrt();
    println!("vignetting differs from that of the flats by {:.2} %", 100.0 * error);
    assert!(error < 0.005, "{error}");

    // A lamp that flickers by 2 % over what was measured.
    let mut truth = vec![];
    for view in session.done_views() {
        let path = session.radiance_path(view);
        let mut image = RadianceImage::read_exr(&path).unwrap();
        let gain = flicker(0.02, view, 9)[0];
        image.radiance.iter_mut().flatten().for_each(|value| *value *= gain as f32);
        image.variance.iter_mut().flatten().for_each(|value| *value *= (gain * gain) as f32);
        image.write_exr(&path, "flickering").unwrap();
        truth.push(gain.ln());
    }
    let found = find(&session, &Options::default(), &Silent).unwrap();
    let mean = truth.iter().sum::<f64>() / truth.len() as f64;
    let off: Vec<(f64, f64)> = truth
        .iter()
        .zip(&found.views)
        .map(|(truth, view)| (view.gain[1].ln() - truth + mean, view.sigma[1]))
        .collect();
    assert_eq!(off.len(), truth.len(), "{:?}", found.notes);
    let count = off.len() as f64;
    let error = (off.iter().map(|(off, _)| off * off).sum::<f64>() / count).sqrt();
    let within = off.iter().filter(|(off, sigma)| off.abs() <= *sigma).count() as f64 / count;
    println!("gains off by {:.2} %, {:.0} % within sigma: {:?}", 100.0 * error, 100.0 * within, found.notes);
    assert!(error < 0.01 && within > 0.5, "{error} {within}");
}

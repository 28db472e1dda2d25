//! Where the error of the patchwork's appearance comes from: the truth put in place of what was found, one at a time.
//!
//! `RIGEL_DATA=... cargo run -p rigel-tests --example registration_share` (the test profile is optimised; some minutes)
//!
//! One lobe per texel on 384 x 288 texels. With poses, lens and response from the photographs: 5.278 of 255, 29.75 dB; with the true
//! poses and lens in their place 5.270 and 29.78 dB. So registration (directions within 0.0072 degrees in the median, 0.0198 at the 95th
//! percentile, 0.0488 at most) makes a sixth of a percent of the error; the other two rows tell radiance's share, and what both truths
//! leave is the model's.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "../tests/poses/patchwork.rs"]
mod patchwork;

use std::path::Path;

use patchwork::{Truth, import_patchwork, lens, squares, summary};
use rigel::calibration::{RegisterOptions, Registration, register};
use rigel::evaluate::{evaluate, read_references};
use rigel::fit::{FitOptions, Model};
use rigel::geometry::Texels;
use rigel::measure::{self, ResponseChoice, measure};
use rigel::observation::{Options, observe};
use rigel::parameter_map::fit_surface;
use rigel::progress::Silent;
use rigel::session::Session;
use rigel_tests::data;

fn main() {
    let Some(patchwork) = data("multiview/patchwork") else { return };
    let folder = tempfile::tempdir().unwrap();
    let session = import_patchwork(&patchwork, &patchwork.join("views.csv"), &folder.path().join("session"));
    let truth = Truth::read(&patchwork);
    let lens = lens(&patchwork);
    let response = folder.path().join("response.csv");
    std::fs::write(&response, true_response(&patchwork)).unwrap();
    println!("{:<34} {:>12} {:>9}", "", "mean of 255", "PSNR dB");
    for (name, response) in [("found", ResponseChoice::Recover), ("true", ResponseChoice::File(response))] {
        measure(&session, &measure::Options { response, ..measure::Options::default() }, &Silent).unwrap();
        let options = RegisterOptions { squares: Some(squares(folder.path())), lens: Some(lens) };
        let found = register(&session, &options, &Silent).unwrap();
        let [median, p95, most, _] = summary(&truth, &found);
        println!("{name} response: directions within {median:.4}, {p95:.4}, {most:.4} degrees");
        let mut exact = found.clone();
        exact.lens = truth.lens();
        for view in &mut exact.views {
            view.pose = truth.pose(&view.name);
            view.covariance_given_lens = [[0.0; 6]; 6];
        }
        for (poses, registration) in [("found", &found), ("true", &exact)] {
            registration.write(&session).unwrap();
            let (mean, psnr) = score(&session, &patchwork);
            println!("{:<34} {mean:>12.3} {psnr:>9.2}", format!("{poses} poses and lens, {name} response"));
        }
        std::fs::remove_file(Registration::path(&session)).unwrap();
    }
}

/// Mean of 255 and PSNR of one lobe on 384 x 288 texels.
fn score(session: &Session, patchwork: &Path) -> (f64, f64) {
    let texels = Texels { columns: 384, rows: 288 };
    let map =
        observe(session, &session.folder().join("observations.rigel"), &Options { texels }, &Silent).unwrap();
    let fitted = fit_surface(&map, Model::Phong { lobes: 1 }, &FitOptions::default(), &[], &Silent).unwrap();
    let references = read_references(&patchwork.join("truth/eval.json"), 0.5).unwrap();
    let evaluation = evaluate(&fitted, &references, &Silent).unwrap();
    (evaluation.mean_255(), evaluation.psnr_db())
}

/// The camera's curve from `truth/truth.json`: a toe, a power and a soft S, inverted.
fn true_response(patchwork: &Path) -> String {
    #[derive(serde::Deserialize)]
    struct File {
        gamma: [f64; 3],
        toe: f64,
    }
    let text = std::fs::read_to_string(patchwork.join("truth/truth.json")).unwrap();
    let File { gamma, toe } = serde_json::from_str(&text).unwrap();
    let level = |x: f64, gamma: f64| {
        let power = |x: f64| x.powf(1.0 / gamma);
        let q = (power(x + toe) - power(toe)) / (power(1.0 + toe) - power(toe));
        q * q * (3.0 - 2.0 * q) * 0.35 + q * 0.65
    };
    let exposure = |z: usize, gamma: f64| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if level(middle, gamma) < z as f64 / 255.0 { low = middle } else { high = middle }
        }
        (low + high) / 2.0
    };
    let rows = (0..256).map(|z| {
        let [r, g, b] = gamma.map(|gamma| exposure(z, gamma) / exposure(127, gamma));
        format!("{z},{r:e},{g:e},{b:e}\n")
    });
    "level,R,G,B\n".to_owned() + &rows.collect::<String>()
}

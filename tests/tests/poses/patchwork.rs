//! The patchwork capture as a user has it: photographs, boards, flat fields, commanded angles. The truth only scores.

#[path = "score.rs"]
#[allow(dead_code, reason = "only those without squares need it")]
mod score;

use std::path::{Path, PathBuf};

use rigel::calibration::{BoardSize, LensCovariance, Registration, Squares, calibrate_photographs};
use rigel::geometry::{Lens, Pose};
use rigel::measure::{self, measure};
use rigel::progress::Silent;
use rigel::session::Session;
use rigel::session::import::{Options, Source, import};
use rigel::units::parse_surface;
use rigel::view_file::Calibration;

/// The capture's layout, which a user knows.
pub const SQUARES: &str = "size = \"12mm\"\ncentres = [[\"-112mm\", \"-87mm\"], [\"-112mm\", \"87mm\"], [\"112mm\", \"-87mm\"], [\"112mm\", \"87mm\"]]\n";

/// The squares, read from a file as a user would write it.
pub fn squares(folder: &Path) -> Squares {
    let path = folder.join("squares.toml");
    std::fs::write(&path, SQUARES).unwrap();
    Squares::read(&path).unwrap()
}

/// Imports the photographs with the commanded angles of `table`.
pub fn import_patchwork(patchwork: &Path, table: &Path, folder: &Path) -> Session {
    let options = Options {
        surface: Some(parse_surface("200mmx150mm").unwrap()),
        distance_m: Some(0.9),
        flats: (0..4).map(|i| patchwork.join(format!("calibration/flat{i}.jpg"))).collect(),
        ..Options::default()
    };
    let source = Source::Csv { table: table.into(), photographs: patchwork.join("photos") };
    let session = import(&source, folder, &options, &Silent).unwrap().session;
    measure(&session, &measure::Options::default(), &Silent).unwrap();
    session
}

/// The lens that the board photographs show, and how sure it is.
pub fn lens(patchwork: &Path) -> (Lens, Option<LensCovariance>) {
    let boards: Vec<PathBuf> =
        (0..14).map(|i| patchwork.join(format!("calibration/board{i:02}.jpg"))).collect();
    let size = BoardSize { columns: 9, rows: 6 };
    let found = calibrate_photographs(&boards, size, 0.018, None, &Silent).unwrap();
    (found.lens, Some(found.covariance))
}

/// The poses to score with.
pub struct Truth(Calibration);

impl Truth {
    pub fn read(patchwork: &Path) -> Self {
        // The truth has pixel centres at 0.5.
        Self(Calibration::read(&patchwork.join("truth/truth.json"), 0.5).unwrap())
    }

    pub fn pose(&self, name: &str) -> Pose {
        self.0.pose(name.trim_start_matches("view").parse().unwrap()).unwrap()
    }

    #[allow(dead_code, reason = "only the swap needs it")]
    pub fn lens(&self) -> Lens {
        self.0.lens(640, 480)
    }
}

/// Median, 95th percentile and maximum of the direction errors (degrees), and the part of the errors within one sigma.
pub fn summary(truth: &Truth, registration: &Registration) -> [f64; 4] {
    let mut errors: Vec<f64> = registration
        .views
        .iter()
        .map(|view| view.direction_error_rad(&truth.pose(&view.name)).to_degrees())
        .collect();
    errors.sort_by(f64::total_cmp);
    let at = |part: f64| errors[(part * (errors.len() - 1) as f64).round() as usize];
    let scores: Vec<f64> =
        registration.views.iter().flat_map(|view| view.direction_scores(&truth.pose(&view.name))).collect();
    let within = scores.iter().filter(|score| score.abs() < 1.0).count() as f64 / scores.len() as f64;
    [at(0.5), at(0.95), at(1.0), within]
}

/// The same of the errors that are left when the views together may be turned, shifted and scaled.
#[allow(dead_code, reason = "only those without squares need it")]
pub fn gauge_free(truth: &Truth, registration: &Registration) -> ([f64; 3], f64) {
    let views = registration.views.iter().map(|view| (view, truth.pose(&view.name)));
    score::gauge_free(&views.collect::<Vec<_>>())
}

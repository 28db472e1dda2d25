//! The lens: how far off it shows things against the number of boards, inside and outside of what they covered.

mod regimes;
mod shift;

use std::path::Path;
use std::time::Duration;

use glam::DVec2;
use rigel::Result;
use rigel::calibration::{BoardView, LensCalibration, LensModel, calibrate_lens};
use rigel::chart::{self, Axis, ChartPoint};
use rigel::geometry::Lens;
use rigel::progress::Progress;
use rigel::report::Report;
use rigel_simulated::board::{Board, strew};

use crate::figures::{figure, marks_and_line, raw, rms};
use crate::machine::cpu_seconds;
use crate::table::Table;
use shift::Shown;

/// Standard deviation of a corner's coordinates, pixels.
const SIGMA_PX: f64 = 0.1;
/// So many calibrations with other boards and other noise make the figures of a setting.
const TRIALS: u64 = 16;
/// So long each calibration is repeated, CPU time.
const ENOUGH: Duration = Duration::from_millis(20);
const BOARDS: [usize; 7] = [3, 4, 5, 6, 8, 14, 20];
/// Which terms of the distortion are estimated.
const MODELS: [(&str, Option<LensModel>); 3] = [
    ("the boards choose (rigel)", None),
    ("k1 k2", Some(LensModel::K1K2)),
    ("k1 k2 p1 p2 k3", Some(LensModel::All)),
];
/// Numbers of boards whose uncertainty is charted across the picture, and the width of a ring there, pixels.
const BANDS: [usize; 3] = [3, 5, 14];
const RING_PX: f64 = 40.0;

/// A lens of a cheap camera: `peers/d_calib.py` has it too.
fn truth() -> Lens {
    let pinhole = Lens::pinhole(640, 480, 540.0);
    Lens { fy: 538.0, cx: 330.0, cy: 236.0, k1: -0.28, k2: 0.09, p1: 0.001, p2: -0.0005, ..pinhole }
}

/// What all trials of a setting gave.
#[derive(Default)]
struct Trials {
    /// Everywhere in the picture, of all trials.
    shown: Vec<Shown>,
    cpu_s: f64,
    models: Vec<&'static str>,
    refused: Option<String>,
}

impl Trials {
    /// Root mean square of the actual and the stated error over some of the places, pixels.
    fn rms(&self, of: impl Fn(&Shown) -> bool) -> (f64, f64) {
        let chosen = || self.shown.iter().filter(|shown| of(shown));
        (rms(chosen().map(|s| s.error.length())), rms(chosen().map(|s| s.sigma.length())))
    }
}

/// Sweeps numbers of boards and models, and the regimes in which something is wrong; charts and tables go to the page, raw
/// figures to `folder`.
///
/// # Errors
/// What drawing or writing reports.
pub fn sweep(folder: &Path, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    let total = BOARDS.len() * MODELS.len() + regimes::STEPS;
    let mut figures = Table::new(&[
        "boards",
        "model",
        "chosen",
        "error_outside_boards_px",
        "stated_outside_px",
        "error_inside_boards_px",
        "stated_inside_px",
        "within_sigma_percent",
        "cpu_ms",
        "refused",
    ]);
    let mut points = vec![];
    let mut by_boards = [const { (vec![], vec![]) }; 2];
    let mut bands = vec![];
    for (index, count) in BOARDS.into_iter().enumerate() {
        for (m, (name, model)) in MODELS.into_iter().enumerate() {
            progress.step(index * MODELS.len() + m, total)?;
            let trials = trials(count, model);
            let places = [trials.rms(|shown| !shown.covered), trials.rms(|shown| shown.covered)];
            let coordinates =
                || trials.shown.iter().flat_map(|s| s.error.to_array().into_iter().zip(s.sigma.to_array()));
            let within = coordinates().filter(|(error, sigma)| error.abs() < *sigma).count() as f64
                / coordinates().count().max(1) as f64;
            let cpu_ms = 1e3 * trials.cpu_s / TRIALS as f64;
            let number = |value: f64| if value.is_finite() { format!("{value:.4}") } else { "-".to_owned() };
            figures.row(vec![
                count.to_string(),
                name.to_owned(),
                most_frequent(&trials.models).to_owned(),
                number(places[0].0),
                number(places[0].1),
                number(places[1].0),
                number(places[1].1),
                format!("{:.0}", 100.0 * within),
                format!("{cpu_ms:.1}"),
                trials.refused.clone().unwrap_or_default(),
            ]);
            if places.iter().any(|(error, sigma)| !(error.is_finite() && sigma.is_finite())) {
                continue;
            }
            points.push(ChartPoint {
                method: name.to_owned(),
                x: cpu_ms,
                y: places[0].0,
                label: count.to_string(),
            });
            if model.is_none() {
                for ((actual, stated), place) in by_boards.iter_mut().zip(places) {
                    actual.push((count as f64, place.0));
                    stated.push((count as f64, place.1));
                }
                if BANDS.contains(&count) {
                    bands.extend(band(count, &trials));
                }
            }
        }
    }
    report.heading("Lens: where things are shown, and what is stated");
    report.text(
        "A simulated wide-angle lens of 640x480 pixels, boards of 9 x 6 corners good to 0.1 px. Errors are those that no turn of the camera makes \
         good. Marks are the actual error (root mean square over sixteen calibrations), lines the standard deviation that is stated.",
    );
    let boards = Axis { label: "photographs of the board", logarithmic: true };
    let pixels = Axis { label: "error of the projection, pixels", logarithmic: true };
    let names = ["where no board was", "where boards were"];
    let series: Vec<_> = names
        .into_iter()
        .zip(by_boards)
        .flat_map(|(name, (actual, stated))| marks_and_line(name, actual, stated))
        .collect();
    figure(
        folder,
        report,
        "lens_boards",
        chart::lines(&series, (boards, pixels))?,
        "Boards against error, terms of the distortion chosen by the boards themselves.",
    )?;
    let radius = Axis { label: "distance from the centre of the picture, pixels", logarithmic: false };
    figure(
        folder,
        report,
        "lens_bands",
        chart::lines(&bands, (radius, pixels))?,
        "The uncertainty across the picture. The corners of the picture are 400 pixels from its centre, and boards hardly reach them.",
    )?;
    let time = Axis { label: "CPU time to calibrate, milliseconds", logarithmic: true };
    let outside = Axis { label: "error where no board was, pixels", logarithmic: true };
    figure(
        folder,
        report,
        "lens_speed",
        chart::scatter(&points, (time, outside))?,
        "Time against error, corners found already; beside each point the number of boards. To choose the terms \
         costs five calibrations more, and spares the user to know the lens.",
    )?;
    raw(folder, report, "lens", &figures)?;
    let before = BOARDS.len() * MODELS.len();
    regimes::sweep(folder, report, &|step| progress.step(before + step, total))?;
    progress.step(total, total)
}

/// Calibrates with strewn boards, again and again.
fn trials(count: usize, model: Option<LensModel>) -> Trials {
    let lens = truth();
    let mut trials = Trials::default();
    for trial in 0..TRIALS {
        let boards = strew(&lens, 9, 6, count, 10 * trial + 1);
        let views = seen(&boards, &lens, SIGMA_PX, trial);
        let (cpu_s, found) = cpu_seconds(ENOUGH, || calibrate_lens(&views, (640, 480), 1.0, model));
        trials.cpu_s += cpu_s;
        match found {
            Ok(found) => {
                trials.models.push(found.model.name());
                trials.shown.extend(shift::shown(&lens, &found));
            }
            Err(refused) => trials.refused = Some(refused.to_string()),
        }
    }
    trials
}

/// The corners of boards as a detector finds them.
fn seen(boards: &[Board], lens: &Lens, sigma_px: f64, seed: u64) -> Vec<BoardView> {
    let view = |(i, board): (usize, &Board)| {
        let corners = board.detected(lens, sigma_px, 1000 * seed + i as u64)?;
        Some(BoardView { path: format!("board{i:02}.jpg").into(), corners })
    };
    boards.iter().enumerate().filter_map(view).collect()
}

/// Actual and stated error by the distance from the centre of the picture.
fn band(count: usize, trials: &Trials) -> [chart::Series; 2] {
    let lens = truth();
    let centre = DVec2::new(f64::from(lens.width), f64::from(lens.height)) / 2.0 - 0.5;
    let rings = (centre.length() / RING_PX).ceil() as usize;
    let (mut actual, mut stated) = (vec![], vec![]);
    for ring in 0..rings {
        let (error, sigma) = trials.rms(|shown| (shown.pixel.distance(centre) / RING_PX) as usize == ring);
        if error.is_finite() && sigma.is_finite() {
            let middle = (ring as f64 + 0.5) * RING_PX;
            actual.push((middle, error));
            stated.push((middle, sigma));
        }
    }
    marks_and_line(&format!("{count} boards"), actual, stated)
}

/// The lens model that was chosen most often.
fn most_frequent(models: &[&'static str]) -> &'static str {
    let count = |model: &&str| models.iter().filter(|other| *other == model).count();
    models.iter().max_by_key(|model| count(model)).copied().unwrap_or("-")
}

/// Whether a place of the picture is inside of one of the boards: of the quadrangle of its outermost corners.
fn covered(calibration: &LensCalibration, pixel: DVec2) -> bool {
    calibration.boards.iter().any(|board| {
        let corners = || board.corners.iter().map(|fitted| &fitted.corner);
        let (columns, rows) = corners().fold((0, 0), |(a, b), c| (a.max(c.column), b.max(c.row)));
        let at = |column: u32, row: u32| {
            corners().find(|c| (c.column, c.row) == (column, row)).map(|corner| corner.pixel)
        };
        let ends = [at(0, 0), at(columns, 0), at(columns, rows), at(0, rows)];
        let [Some(a), Some(b), Some(c), Some(d)] = ends else { return false };
        let sides = [(a, b), (b, c), (c, d), (d, a)].map(|(from, to)| (to - from).perp_dot(pixel - from));
        sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
    })
}

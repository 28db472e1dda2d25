//! The lens where boards are few, parallel, bent or only in the middle: a map of what is stated and what is so, and a sentence.

use std::path::Path;

use glam::{DVec2, DVec3};
use rigel::Result;
use rigel::calibration::{BoardView, LensCalibration, calibrate_lens};
use rigel::chart::{Arrow, field};
use rigel::geometry::Lens;
use rigel::report::Report;
use rigel_simulated::board::{Board, cover, strew};

use super::shift::{COLUMNS, ROWS, Shown, shown};
use super::{SIGMA_PX, seen, truth};
use crate::figures::{figure, rms, table};
use crate::table::Table;

/// What the boards are like: their name, and their corners.
type Regime = (&'static str, fn(&Lens) -> Vec<BoardView>);

const REGIMES: [Regime; 8] = [
    ("14 boards, out to the corners of the picture", |lens| seen(&cover(lens, 1), lens, SIGMA_PX, 1)),
    ("five boards", |lens| strewn(lens, 5)),
    ("three boards", |lens| strewn(lens, 3)),
    ("14 boards, only in the middle", |lens| seen(&placed(14, 24.0, 0.6, 0.45), lens, SIGMA_PX, 1)),
    ("14 boards, all parallel", |lens| seen(&placed(14, 11.0, 2.0, 0.0), lens, SIGMA_PX, 1)),
    ("14 boards out to the corners, found to half a pixel only", |lens| seen(&cover(lens, 1), lens, 0.5, 1)),
    ("14 photographs of a bent board", |lens| {
        let boards = cover(lens, 1);
        let mut views = seen(&boards, lens, SIGMA_PX, 1);
        for (view, board) in views.iter_mut().zip(boards) {
            for corner in &mut view.corners {
                let from_middle = (f64::from(corner.column) - 4.0) / 4.0;
                let point =
                    DVec3::new(f64::from(corner.column), f64::from(corner.row), 0.12 * from_middle.powi(2));
                let flat = board.pixel(lens, f64::from(corner.column), f64::from(corner.row));
                let bent = lens.project(board.rotation * (point * board.square_m) + board.origin_m);
                corner.pixel += bent.unwrap_or_default() - flat.unwrap_or_default();
            }
        }
        views
    }),
    ("two of 14 boards photographed at another zoom", |lens| {
        let zoomed = Lens { fx: 1.08 * lens.fx, fy: 1.08 * lens.fy, ..*lens };
        let boards = cover(lens, 1);
        let mut views = seen(&boards, lens, SIGMA_PX, 1);
        for bad in [4, 9] {
            views[bad].corners = seen(&boards[bad..=bad], &zoomed, SIGMA_PX, 7)[0].corners.clone();
        }
        views
    }),
];

/// Steps of progress that [`sweep`] tells.
pub(super) const STEPS: usize = REGIMES.len();

fn strewn(lens: &Lens, count: usize) -> Vec<BoardView> {
    seen(&strew(lens, 9, 6, count, 1), lens, SIGMA_PX, 1)
}

/// Boards at a distance, with their centres up to `aside` from the camera's axis and tilted by up to `tilt_rad` to all sides; lengths in
/// sides of a square.
fn placed(count: usize, distance: f64, aside: f64, tilt_rad: f64) -> Vec<Board> {
    (0..count)
        .map(|i| {
            let part = i as f64 / count as f64;
            let (around, out) = (DVec2::from_angle(2.4 * i as f64), part.sqrt());
            let turn = DVec3::new(tilt_rad * around.y, tilt_rad * around.x, 0.5 * (part - 0.5));
            let aside = DVec2::from_angle(1.1 * i as f64) * aside * out;
            Board::at(9, 6, 1.0, turn, aside.extend(distance * (1.0 + 0.2 * (part - 0.5))))
        })
        .collect()
}

/// Every regime: a row of the table and a map of the picture.
pub(super) fn sweep(folder: &Path, report: &mut Report, step: &dyn Fn(usize) -> Result<()>) -> Result<()> {
    report.heading("Lens: where boards are bad");
    report.text(
        "The picture, shaded by the standard deviation that is stated; orange dots are the corners of the boards, lines the actual error.",
    );
    let lens = truth();
    let mut rows = Table::new(&[
        "regime",
        "error_px",
        "stated_px",
        "worst_error_px",
        "stated_in_the_corners_px",
        "model",
        "what_is_said",
    ]);
    for (index, (name, boards)) in REGIMES.into_iter().enumerate() {
        step(index)?;
        let views = boards(&lens);
        match calibrate_lens(&views, (lens.width, lens.height), 1.0, None) {
            Ok(found) => {
                let places = shown(&lens, &found);
                let (row, svg) = judged(name, &found, &places);
                let caption = format!("{name}: {}", row[6]);
                rows.row(row);
                figure(folder, report, &format!("lens_regime_{index}"), svg, &caption)?;
            }
            Err(refused) => {
                let said = format!("refused: {refused}");
                let dots: Vec<Arrow> =
                    views.iter().flat_map(|view| &view.corners).map(|c| dot(c.pixel)).collect();
                let svg = field(
                    (lens.width, lens.height),
                    &dots,
                    1.0,
                    (&[], (0, 0)),
                    "no lens: the corners that were seen",
                );
                figure(folder, report, &format!("lens_regime_{index}"), svg, &format!("{name}: {said}"))?;
                rows.refused(&[name], said);
            }
        }
    }
    table(
        folder,
        report,
        "lens_regimes",
        &rows,
        "What is left of accuracy, what is stated, and what the user is told.",
    )
}

/// A row of the table, and the map.
fn judged(name: &str, found: &LensCalibration, places: &[Shown]) -> (Vec<String>, String) {
    let lens = &found.lens;
    let error = rms(places.iter().map(|s| s.error.length()));
    let sigma = rms(places.iter().map(|s| s.sigma.length()));
    let worst = places.iter().map(|s| s.error.length()).fold(0.0, f64::max);
    let (right, bottom) = (f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)].map(DVec2::from);
    let in_corners = corners.map(|corner| found.projection_sigma_px(corner)).into_iter().fold(0.0, f64::max);
    let dropped =
        found.dropped.iter().map(|board| format!("{} not used: {}", board.path.display(), board.reason));
    let said: Vec<String> = dropped.chain([found.verdict.clone()]).collect();
    let row = vec![
        name.to_owned(),
        format!("{error:.3}"),
        format!("{sigma:.3}"),
        format!("{worst:.3}"),
        format!("{in_corners:.3}"),
        found.model.name().to_owned(),
        said.join(" | "),
    ];
    // The longest line is about a cell of the grid.
    let power = 10f64.powf((40.0 / worst.max(1e-6)).log10().floor());
    let magnified =
        [5.0, 2.0, 1.0].map(|m| m * power).into_iter().find(|m| m * worst <= 40.0).unwrap_or(power);
    let lines = places.iter().map(|s| Arrow { at: s.pixel.into(), by: s.error.into(), strong: true });
    let seen = found.boards.iter().flat_map(|board| &board.corners).map(|fitted| dot(fitted.corner.pixel));
    let arrows: Vec<Arrow> = seen.chain(lines).collect();
    let cells = (COLUMNS, ROWS);
    let sigmas = found.projection_sigmas_px(COLUMNS, ROWS);
    let times = if magnified == 1.0 { String::new() } else { format!(", {magnified} times as long") };
    let caption =
        format!("orange: corners of boards; lines: actual error{times}; shades: stated standard deviation");
    (row, field((lens.width, lens.height), &arrows, magnified, (&sigmas, cells), &caption))
}

fn dot(pixel: DVec2) -> Arrow {
    Arrow { at: pixel.into(), by: (0.0, 0.0), strong: false }
}

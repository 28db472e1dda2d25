//! Poses: how far directions are off against squares, boards, noise and views, all views adjusted together and each by itself.

mod regimes;

use std::path::Path;
use std::time::Duration;

use rigel::Result;
use rigel::calibration::{
    BoardCorner, BoardView, LensCovariance, LensModel, Registration, ViewCorners, calibrate_lens,
    register_corners,
};
use rigel::chart::{self, Axis, ChartPoint};
use rigel::geometry::Lens;
use rigel::progress::Progress;
use rigel::report::Report;
use rigel_simulated::board::strew;
use rigel_simulated::squares::{DISTANCE_M, SquaresRig, TrueView};

use crate::figures::{figure, marks_and_line, quantile, raw, rms};
use crate::machine::cpu_seconds;
use crate::table::Table;

/// So many rigs, each with a lens calibration of its own, make the figures of a setting.
const RIGS: u64 = 8;
/// So long each way of registering is repeated, CPU time.
const ENOUGH: Duration = Duration::from_millis(30);
/// Noise of the boards' corners, pixels.
const BOARD_SIGMA_PX: f64 = 0.06;
const METHODS: [&str; 2] = ["all views together", "each view alone"];

/// What a capture is like.
#[derive(Clone, Copy)]
struct Setting {
    squares: usize,
    boards: usize,
    sigma_px: f64,
    views: usize,
}

const USUAL: Setting = Setting { squares: 4, boards: 14, sigma_px: 0.1, views: 40 };

/// One thing is varied: what it is called, its name in files, and the settings with its value in each.
struct Variation {
    axis: Axis<'static>,
    name: &'static str,
    settings: Vec<(f64, Setting)>,
}

fn variations() -> [Variation; 4] {
    let linear = |label| Axis { label, logarithmic: false };
    let squares = |squares: usize| (squares as f64, Setting { squares, ..USUAL });
    let boards = |boards: usize| (boards as f64, Setting { boards, ..USUAL });
    let noise = |sigma_px: f64| (sigma_px, Setting { sigma_px, ..USUAL });
    let views = |views: usize| (views as f64, Setting { views, ..USUAL });
    [
        Variation {
            axis: linear("squares in a view; without any there are the commanded angles"),
            name: "squares",
            settings: [4, 3, 2, 1, 0].map(squares).to_vec(),
        },
        Variation {
            axis: linear("photographs of the board from which the lens is known"),
            name: "boards",
            settings: [3, 5, 8, 14].map(boards).to_vec(),
        },
        Variation {
            axis: Axis { label: "noise of the squares' corners, pixels", logarithmic: true },
            name: "noise",
            settings: [0.02, 0.05, 0.1, 0.2, 0.5].map(noise).to_vec(),
        },
        Variation {
            axis: Axis { label: "views", logarithmic: true },
            name: "views",
            settings: [6, 12, 24, 48, 75].map(views).to_vec(),
        },
    ]
}

/// How far the directions of some views are off, degrees.
#[derive(Default)]
struct Errors {
    /// Of each view, and what was stated for it.
    actual_deg: Vec<f64>,
    stated_deg: Vec<f64>,
    /// Along the covariance's own axes, in standard deviations.
    scores: Vec<f64>,
    dropped: usize,
    cpu_s: f64,
}

/// Sweeps everything that poses depend on, and the regimes in which something is wrong; charts and tables go to the page, raw
/// figures to `folder`.
///
/// # Errors
/// What registering, drawing or writing reports.
pub fn sweep(folder: &Path, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    let variations = variations();
    let settings: usize = variations.iter().map(|variation| variation.settings.len()).sum();
    let total = settings + regimes::STEPS;
    let mut done = 0;
    let mut figures = Table::new(&[
        "varied",
        "value",
        "method",
        "median_error_deg",
        "rms_error_deg",
        "p95_error_deg",
        "rms_stated_sigma_deg",
        "within_sigma_percent",
        "dropped_percent",
        "cpu_ms_per_view",
        "refused",
    ]);
    let mut points = vec![];
    report.heading("Poses: error of the direction, and what is stated");
    report.text(
        "A simulated rig whose axes, camera and surface are a few milliradians and millimetres off, whose views deviate by 0.2 degrees and 2 mm, \
         and a lens that is known from boards. Four squares, 14 boards, corners good to 0.1 px and 40 views where nothing else is said. \
         Marks are the actual error (root mean square over the views of eight rigs), lines the standard deviation that is stated.",
    );
    for Variation { axis, name, settings } in &variations {
        let mut series = METHODS.map(|_| (vec![], vec![]));
        for &(value, setting) in settings {
            progress.step(done, total)?;
            done += 1;
            for ((index, method), (actual, stated)) in METHODS.iter().enumerate().zip(&mut series) {
                let errors = match errors(setting, index == 0) {
                    Ok(errors) => errors,
                    Err(refused) => {
                        figures.refused(&[name, &value.to_string(), method], refused.to_string());
                        continue;
                    }
                };
                let views = errors.actual_deg.len();
                let (rms_deg, stated_deg) = (rms(errors.actual_deg.iter().copied()), rms(errors.stated_deg));
                let within = errors.scores.iter().filter(|score| score.abs() < 1.0).count() as f64;
                let mut sorted = errors.actual_deg;
                let median_deg = quantile(&mut sorted, 0.5);
                let cpu_ms = 1e3 * errors.cpu_s / (views + errors.dropped).max(1) as f64;
                figures.row(vec![
                    (*name).to_owned(),
                    value.to_string(),
                    (*method).to_owned(),
                    format!("{median_deg:.4}"),
                    format!("{rms_deg:.4}"),
                    format!("{:.4}", quantile(&mut sorted, 0.95)),
                    format!("{stated_deg:.4}"),
                    format!("{:.0}", 100.0 * within / errors.scores.len().max(1) as f64),
                    format!("{:.1}", 100.0 * errors.dropped as f64 / (views + errors.dropped).max(1) as f64),
                    format!("{cpu_ms:.2}"),
                    String::new(),
                ]);
                actual.push((value, rms_deg));
                stated.push((value, stated_deg));
                let label = match *name {
                    "squares" => format!("{value} sq."),
                    // By itself a view does not care how many there are.
                    "views" if index == 0 && value != 48.0 => format!("{value} views"),
                    _ => continue,
                };
                points.push(ChartPoint { method: (*method).to_owned(), x: cpu_ms, y: rms_deg, label });
            }
        }
        let series: Vec<_> = METHODS
            .into_iter()
            .zip(series)
            .flat_map(|(method, (actual, stated))| marks_and_line(method, actual, stated))
            .collect();
        let degrees = Axis { label: "error of the direction, degrees", logarithmic: true };
        let svg = chart::lines(&series, (*axis, degrees))?;
        let caption = match *name {
            "squares" => {
                "Squares. One square, all views together, says more than two in a view by itself. Without any there are the \
                 commanded angles, and what is stated for them is too careful by far."
            }
            "boards" => {
                "Boards. The lens is adjusted with the poses: what few boards leave open, 40 views of four squares tell."
            }
            "noise" => {
                "Noise of the corners. Together, the error is half of what it is for each view by itself, or less."
            }
            _ => "Views. Together, more views know the rig better; by itself a view knows what it shows.",
        };
        figure(folder, report, &format!("poses_{name}"), svg, caption)?;
    }
    let axes = (
        Axis { label: "CPU time to adjust, milliseconds per view", logarithmic: true },
        Axis { label: "error of the direction, degrees (root mean square)", logarithmic: true },
    );
    figure(
        folder,
        report,
        "poses_speed",
        chart::scatter(&points, axes)?,
        "Time against error, squares found already: numbers of views (4 squares each), and of squares (40 views).",
    )?;
    raw(folder, report, "poses", &figures)?;
    regimes::sweep(folder, report, &|step| progress.step(done + step, total))?;
    progress.step(total, total)
}

/// The errors of all rigs in one setting, together or each view by itself.
fn errors(setting: Setting, together: bool) -> Result<Errors> {
    let mut all = Errors::default();
    for seed in 1..=RIGS {
        let rig = SquaresRig::new(seed);
        let lens = known_lens(&rig.lens, setting.boards, seed)?;
        let views = rig.views(setting.views, seed);
        let mut shown = rig.detected(&views, setting.sigma_px, 100 + seed);
        // Opposite squares are taken away last.
        let kept = [0, 3, 1, 2];
        for view in &mut shown {
            view.squares.retain(|found| kept[..setting.squares].contains(&found.square));
        }
        let register = |views: &[ViewCorners]| register_corners(&rig.layout, lens, DISTANCE_M, views);
        let (cpu_s, found) = cpu_seconds(ENOUGH, || match together {
            true => register(&shown).map(|found| vec![found]),
            false => shown.iter().map(|view| register(std::slice::from_ref(view))).collect(),
        });
        all.cpu_s += cpu_s;
        for registration in &found? {
            all.add(registration, &views);
        }
    }
    Ok(all)
}

impl Errors {
    fn add(&mut self, registration: &Registration, truth: &[TrueView]) {
        self.dropped += registration.dropped.len();
        for view in &registration.views {
            let Some(truth) = truth.iter().find(|truth| truth.name == view.name) else { continue };
            self.actual_deg.push(view.direction_error_rad(&truth.pose).to_degrees());
            self.stated_deg.push(view.direction_sigma_rad().to_degrees());
            self.scores.extend(view.direction_scores(&truth.pose));
        }
    }
}

/// The lens as boards tell it.
fn known_lens(truth: &Lens, boards: usize, seed: u64) -> Result<(Lens, Option<LensCovariance>)> {
    let views: Vec<BoardView> = strew_before(truth, boards, seed)
        .into_iter()
        .enumerate()
        .map(|(i, corners)| BoardView { path: format!("board{i}.png").into(), corners })
        .collect();
    let size = (truth.width, truth.height);
    let found = calibrate_lens(&views, size, 0.02, Some(LensModel::K1K2P1P2))?;
    Ok((found.lens, Some(found.covariance)))
}

/// Boards of 9 x 6 corners before a long lens.
fn strew_before(lens: &Lens, boards: usize, seed: u64) -> Vec<Vec<BoardCorner>> {
    let near = Lens { fx: 540.0, fy: 540.0, k1: 0.0, k2: 0.0, ..*lens };
    strew(&near, 9, 6, boards, seed)
        .into_iter()
        .enumerate()
        .filter_map(|(i, mut board)| {
            // As large in the picture, by standing further away.
            board.origin_m.z += (lens.fx / near.fx - 1.0) * 12.0;
            board.detected(lens, BOARD_SIGMA_PX, 1000 * seed + i as u64)
        })
        .collect()
}

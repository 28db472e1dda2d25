//! Radiance where brackets are bad: what is left of it, and what the user learns.

use std::path::Path;

use rigel::radiance::{Learnt, RadianceImage, Samples, merge};
use rigel::report::{Picture, Report};
use rigel::{Result, file, render};

use super::{Bracket, Disturb, LONGEST_S, as_it_is, camera, error, scales, shoot};
use crate::figures::{quantile, table};
use crate::table::Table;

/// Brackets in which something is wrong.
struct Regime {
    name: &'static str,
    exposures: u32,
    stops: f64,
    /// The share of the board's pixels that is clipped in the shortest exposure; `None` starts where no more than highlights are.
    clipped: Option<f64>,
    disturb: Disturb,
}

const WELL: Regime =
    Regime { name: "five exposures, all well", exposures: 5, stops: 1.0, clipped: None, disturb: as_it_is };

const REGIMES: [Regime; 8] = [
    WELL,
    Regime { name: "two exposures one stop apart", exposures: 2, ..WELL },
    Regime { name: "three exposures", exposures: 3, ..WELL },
    Regime { name: "three exposures, three stops apart", exposures: 3, stops: 3.0, ..WELL },
    Regime { name: "1 % clipped in the shortest of three", exposures: 3, clipped: Some(0.01), ..WELL },
    Regime {
        name: "one wrong exposure time",
        disturb: |camera, index, time_s| camera.levels(if index == 2 { 1.3 * time_s } else { time_s }),
        ..WELL
    },
    Regime {
        name: "the lamp flickers by a tenth",
        disturb: |camera, index, time_s| {
            camera.levels(time_s * [1.0, 1.1, 0.9, 1.05, 0.95][index as usize % 5])
        },
        ..WELL
    },
    Regime {
        name: "something moves through the picture",
        disturb: |camera, index, time_s| {
            let mut levels = camera.levels(time_s);
            let (width, at) = (camera.lens().width, 60 + 30 * index);
            for (i, level) in levels.chunks_exact_mut(3).enumerate() {
                let (x, y) = (i as u32 % width, i as u32 / width);
                if (at..at + 24).contains(&x) && (90..130).contains(&y) {
                    level.fill(90);
                }
            }
            levels
        },
        ..WELL
    },
];

/// Steps of progress that [`sweep`] tells.
pub(super) const STEPS: usize = REGIMES.len();
/// Which of the directions is shown, and the relative error that is white.
const SHOWN: usize = 1;
const WHITE: f64 = 0.05;
/// Colours of what was not measured.
const SATURATED: [u8; 3] = [0xd5, 0x5e, 0x00];
const DARK: [u8; 3] = [0x00, 0x72, 0xb2];
const MOVED: [u8; 3] = [0x00, 0x9e, 0x73];

/// Every regime: a row of the table and a picture of the errors.
pub(super) fn sweep(folder: &Path, report: &mut Report, step: &dyn Fn(usize) -> Result<()>) -> Result<()> {
    report.heading("Radiance: where brackets are bad");
    let mut rows = Table::new(&[
        "regime",
        "median_error_percent",
        "p95_error_percent",
        "within_sigma_percent",
        "masked_percent",
        "what_is_said",
    ]);
    let mut pictures = vec![];
    for (index, regime) in REGIMES.iter().enumerate() {
        step(index)?;
        match one(regime) {
            Ok((row, picture)) => {
                file::write_bytes(&folder.join(format!("radiance_regime_{index}.png")), &picture.png)?;
                rows.row(row);
                pictures.push(picture);
            }
            Err(refused) => rows.refused(&[regime.name], format!("refused: {refused}")),
        }
    }
    report.pictures(
        pictures,
        "The error of one direction's radiance, from black (none) to white (5 % and more). Orange: saturated in every photograph, known as a lower \
         bound; blue: too dark in every one; green: something moved. Dark blue: beside the board.",
    );
    table(
        folder,
        report,
        "radiance_regimes",
        &rows,
        "What is left of accuracy, what is masked, and what the user is told.",
    )
}

/// The longest exposure time of a regime, seconds.
fn longest_s(regime: &Regime) -> Result<f64> {
    let Some(share) = regime.clipped else { return Ok(LONGEST_S) };
    let camera = camera((0.0, 0.0));
    let (mut low, mut high) = (1e-6, 1e6);
    while high / low > 1.0 + 1e-6 {
        let middle = f64::sqrt(low * high);
        if camera.response(middle) < 254.5 { low = middle } else { high = middle }
    }
    let of_board = shoot(LONGEST_S, 1, 1.0, as_it_is)?;
    let pixels = of_board.iter().flat_map(|bracket| &bracket.truth).filter(|truth| truth[1] > 0.0);
    let mut brightest: Vec<f64> =
        pixels.map(|truth| truth.iter().copied().map(f64::from).fold(0.0, f64::max)).collect();
    let shortest_s = low / quantile(&mut brightest, 1.0 - share);
    Ok(shortest_s * 2f64.powf(regime.stops * f64::from(regime.exposures - 1)))
}

/// A row of the table and a picture: the session as `rigel radiance` would take it, doubtful times replaced by the measured ones.
fn one(regime: &Regime) -> Result<(Vec<String>, Picture)> {
    let brackets = shoot(longest_s(regime)?, regime.exposures, regime.stops, regime.disturb)?;
    let mut samples = Samples::default();
    brackets.iter().try_for_each(|bracket| samples.add(&bracket.stack))?;
    let Learnt { response, noise, doubtful } = samples.learn()?;
    let mut said: Vec<String> = vec![];
    if let Some(time) = doubtful.first() {
        said.push(format!(
            "{} of {} exposure times are wrong: {} was taken with {:.4} s, not the {:.4} s that are stated",
            doubtful.len(),
            brackets.len() * regime.exposures as usize,
            time.path.display(),
            time.measured_s,
            time.stated_s
        ));
    }
    let mut merged = vec![];
    for bracket in &brackets {
        let mut stack = bracket.stack.clone();
        for (picture, exposure_s) in stack.pictures.iter().zip(&mut stack.exposure_s) {
            if let Some(time) = doubtful.iter().find(|time| time.path == picture.path) {
                *exposure_s = time.measured_s;
            }
        }
        merged.push(merge(&stack, &response, &noise)?);
    }
    // Beside the board there is nothing to measure.
    let on_board = || {
        let pixels = |(bracket, image): (&'_ Bracket, &'_ RadianceImage)| {
            let board = bracket.truth.iter().map(|truth| truth[1] > 0.0);
            board.zip(image.mask.clone()).filter(|(on, _)| *on).map(|(_, mask)| mask).collect::<Vec<_>>()
        };
        brackets.iter().zip(&merged).flat_map(pixels)
    };
    let share = |flag| on_board().filter(|mask| mask & flag != 0).count() as f64 / on_board().count() as f64;
    for (flag, word) in [
        (RadianceImage::SATURATED, "saturated"),
        (RadianceImage::DARK, "too dark"),
        (RadianceImage::GHOST, "of something that moved"),
    ] {
        if share(flag) >= 5e-5 {
            said.push(format!("{:.2} % of the pixels are {word}", 100.0 * share(flag)));
        }
    }
    let error = error(&brackets, &merged);
    let row = vec![
        regime.name.to_owned(),
        format!("{:.3}", 100.0 * error.median),
        format!("{:.3}", 100.0 * error.p95),
        format!("{:.1}", 100.0 * error.within_sigma),
        format!("{:.2}", 100.0 * error.masked),
        said.join(" | "),
    ];
    let scales = scales(&brackets, &merged);
    let png = drawn(&brackets[SHOWN], &merged[SHOWN], scales)?;
    let caption = format!(
        "{}: {:.2} % off, {:.1} % masked{}",
        regime.name,
        100.0 * error.median,
        100.0 * error.masked,
        if doubtful.is_empty() { "" } else { "; the times are told to be wrong" }
    );
    Ok((row, Picture { png, caption }))
}

/// The largest relative error of a pixel's channels, and what was flagged.
fn drawn(bracket: &Bracket, image: &RadianceImage, scales: [f64; 3]) -> Result<Vec<u8>> {
    let colour = |i: usize| {
        let (truth, mask) = (bracket.truth[i], image.mask[i]);
        if truth[1] <= 0.0 {
            return [0x14, 0x18, 0x30];
        }
        match mask {
            _ if mask & RadianceImage::SATURATED != 0 => SATURATED,
            _ if mask & RadianceImage::GHOST != 0 => MOVED,
            0 => {
                let off = |c: usize| {
                    let truth = scales[c] * f64::from(truth[c]);
                    ((f64::from(image.radiance[i][c]) - truth) / truth).abs()
                };
                let worst = (0..3).map(off).fold(0.0, f64::max);
                [(255.0 * (worst / WHITE).min(1.0)) as u8; 3]
            }
            _ => DARK,
        }
    };
    let levels: Vec<[u8; 3]> = (0..image.mask.len()).map(colour).collect();
    render::png(image.width, image.height, levels.as_flattened())
}

//! Radiance: error against time and number of exposures for every way of merging, and what happens where brackets are bad.

use std::path::Path;
use std::time::Duration;

use rigel::Result;
use rigel::chart::{self, Axis, ChartPoint};
use rigel::geometry::Lens;
use rigel::picture::Picture;
use rigel::progress::Progress;
use rigel::radiance::{Learnt, RadianceImage, Samples, Stack, merge, others};
use rigel::report::Report;
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;

use crate::machine::cpu_seconds;
use crate::table::Table;

/// Exposure times begin here: the lamps' highlights are saturated, the darkest material is well exposed.
const LONGEST_S: f64 = 0.06;
/// So long each way of merging is repeated, CPU time.
const ENOUGH: Duration = Duration::from_millis(300);
/// Directions from which the brackets are taken (pan, tilt, degrees): from above, in the lobes, grazing.
const POSES_DEG: [(f64, f64); 3] = [(0.0, 0.0), (40.0, 35.0), (200.0, 65.0)];
/// Brackets as numbers of exposures and stops between them.
const BRACKETS: [(u32, f64); 8] =
    [(2, 1.0), (2, 3.0), (3, 1.0), (3, 3.0), (5, 1.0), (5, 2.0), (8, 1.0), (12, 0.66)];

/// A way from photographs to radiance: the brackets of a session make the radiance of each.
type Method = fn(&[Bracket]) -> Result<(f64, Vec<RadianceImage>)>;
const METHODS: [(&str, Method); 3] = [("rigel", rigel), ("debevec", debevec), ("robertson", robertson)];

/// CPU seconds of merging (without recovering the response) and the radiance.
fn rigel(brackets: &[Bracket]) -> Result<(f64, Vec<RadianceImage>)> {
    let mut samples = Samples::default();
    brackets.iter().try_for_each(|bracket| samples.add(&bracket.stack))?;
    let response = samples.response()?;
    let noise = samples.noise(&response);
    let (cpu_s, merged) = cpu_seconds(ENOUGH, || {
        brackets.iter().map(|b| merge(&b.stack, &response, &noise)).collect::<Result<Vec<_>>>()
    });
    Ok((cpu_s, merged?))
}

fn debevec(brackets: &[Bracket]) -> Result<(f64, Vec<RadianceImage>)> {
    let response = others::debevec_response(&brackets[0].stack, 300, 30.0)?;
    without_variance(brackets, |stack| others::debevec_merge(stack, &response, others::hat))
}

fn robertson(brackets: &[Bracket]) -> Result<(f64, Vec<RadianceImage>)> {
    let response = others::robertson_response(&brackets[0].stack)?;
    without_variance(brackets, |stack| others::robertson_merge(stack, &response))
}

/// Methods that state no variance and mask nothing.
fn without_variance(
    brackets: &[Bracket],
    method: impl Fn(&Stack) -> Vec<[f32; 3]>,
) -> Result<(f64, Vec<RadianceImage>)> {
    let (cpu_s, merged) =
        cpu_seconds(ENOUGH, || brackets.iter().map(|b| method(&b.stack)).collect::<Vec<_>>());
    let images = brackets.iter().zip(merged).map(|(bracket, radiance)| {
        let first = &bracket.stack.pictures[0];
        let (variance, mask) = (vec![[f32::NAN; 3]; radiance.len()], vec![0; radiance.len()]);
        RadianceImage { width: first.width, height: first.height, radiance, variance, mask }
    });
    Ok((cpu_s, images.collect()))
}

/// Radiance of one pose, photographed and true.
struct Bracket {
    stack: Stack,
    /// What the camera would measure without noise, behind its vignetting.
    truth: Vec<[f32; 3]>,
}

/// How far merged radiance is from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Error {
    median: f64,
    p95: f64,
    /// Share of the measured values within one predicted standard deviation.
    within_sigma: f64,
    /// Share of the pixels that were not measured.
    masked: f64,
}

/// Sweeps the brackets and adds chart and table to the page; raw figures go to `folder`.
///
/// # Errors
/// What merging, drawing or writing reports.
pub fn sweep(folder: &Path, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    let total = BRACKETS.len() + REGIMES.len();
    let mut table = Table::new(&[
        "method",
        "exposures",
        "stops",
        "cpu_ns_per_pixel_exposure",
        "cpu_ms_per_megapixel",
        "median_error_percent",
        "p95_error_percent",
        "within_sigma_percent",
        "masked_percent",
        "refused",
    ]);
    let mut points = vec![];
    for (index, (count, stops)) in BRACKETS.into_iter().enumerate() {
        progress.step(index, total)?;
        let brackets = shoot(count, stops, as_it_is)?;
        for (name, method) in METHODS {
            let pixels = brackets.iter().map(|b| b.truth.len()).sum::<usize>() as f64;
            let (cpu_s, merged) = match method(&brackets) {
                Ok(done) => done,
                Err(refused) => {
                    let unknown = ["-"; 6].map(str::to_owned);
                    let start = [name.to_owned(), count.to_string(), stops.to_string()];
                    table.row(start.into_iter().chain(unknown).chain([refused.to_string()]).collect());
                    continue;
                }
            };
            let error = error(&brackets, &merged);
            if !error.median.is_finite() {
                let unknown = ["-"; 6].map(str::to_owned);
                let start = [name.to_owned(), count.to_string(), stops.to_string()];
                let why = "gives no number".to_owned();
                table.row(start.into_iter().chain(unknown).chain([why]).collect());
                continue;
            }
            table.row(vec![
                name.to_owned(),
                count.to_string(),
                stops.to_string(),
                format!("{:.2}", cpu_s / pixels / f64::from(count) * 1e9),
                format!("{:.2}", cpu_s / pixels * 1e9),
                format!("{:.3}", 100.0 * error.median),
                format!("{:.3}", 100.0 * error.p95),
                if name == "rigel" { format!("{:.1}", 100.0 * error.within_sigma) } else { "-".to_owned() },
                format!("{:.2}", 100.0 * error.masked),
                String::new(),
            ]);
            points.push(ChartPoint {
                method: name.to_owned(),
                x: cpu_s / pixels * 1e9,
                y: 100.0 * error.median,
                label: format!("{count} x {stops}"),
            });
        }
    }
    report.heading("Radiance: time against error");
    let axes = (
        Axis { label: "CPU time to merge a megapixel, milliseconds", logarithmic: true },
        Axis { label: "median error of radiance, percent", logarithmic: true },
    );
    let svg = chart::scatter(&points, axes)?;
    rigel::file::write_bytes(&folder.join("radiance.svg"), svg.as_bytes())?;
    report.chart(
        svg,
        "Beside each point: number of exposures x stops between them. Response recovered from the same photographs; \
         a simulated camera, three directions; one factor per channel removed.",
    );
    let rows = table.rows().to_vec();
    report.table("The same, raw in radiance.csv.", table.header(), rows);
    table.write(&folder.join("radiance.csv"))?;

    let mut table = Table::new(&[
        "regime",
        "median_error_percent",
        "p95_error_percent",
        "within_sigma_percent",
        "masked_percent",
        "what_is_said",
    ]);
    for (index, (name, count, stops, disturb)) in REGIMES.into_iter().enumerate() {
        progress.step(BRACKETS.len() + index, total)?;
        table.row(match regime(name, &shoot(count, stops, disturb)?) {
            Ok(row) => row,
            Err(refused) => {
                let unknown = ["-"; 4].map(str::to_owned);
                [name.to_owned()].into_iter().chain(unknown).chain([format!("refused: {refused}")]).collect()
            }
        });
    }
    report.heading("Radiance: where brackets are bad");
    let rows = table.rows().to_vec();
    report.table(
        "What is left of accuracy, what is masked, and what the user is told.",
        table.header(),
        rows,
    );
    table.write(&folder.join("radiance_regimes.csv"))?;
    progress.step(total, total)
}

/// What happens to the bracket of one view: the photograph's index, its exposure time and its levels.
type Disturb = fn(&mut SimulatedCamera<At>, u32, f64) -> Vec<u8>;
/// Where the simulated rig stands: pan and tilt, radians.
type At = Box<dyn Fn() -> (f64, f64)>;

/// Brackets in which something is wrong: name, exposures, stops between them, and what is wrong.
const REGIMES: [(&str, u32, f64, Disturb); 7] = [
    ("five exposures, all well", 5, 1.0, as_it_is),
    ("two exposures one stop apart", 2, 1.0, as_it_is),
    ("three exposures", 3, 1.0, as_it_is),
    ("three exposures, three stops apart", 3, 3.0, as_it_is),
    ("one wrong exposure time", 5, 1.0, |camera, index, time_s| {
        camera.levels(if index == 2 { 1.3 * time_s } else { time_s })
    }),
    ("the lamp flickers by a tenth", 5, 1.0, |camera, index, time_s| {
        camera.levels(time_s * [1.0, 1.1, 0.9, 1.05, 0.95][index as usize % 5])
    }),
    ("something moves through the picture", 5, 1.0, |camera, index, time_s| {
        let mut levels = camera.levels(time_s);
        let (width, at) = (camera.lens().width, 60 + 30 * index);
        for (i, level) in levels.chunks_exact_mut(3).enumerate() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            if (at..at + 24).contains(&x) && (90..130).contains(&y) {
                level.fill(90);
            }
        }
        levels
    }),
];

fn as_it_is(camera: &mut SimulatedCamera<At>, _index: u32, time_s: f64) -> Vec<u8> {
    camera.levels(time_s)
}

/// A row of the table: the session as `rigel radiance` would take it, doubtful times replaced by the measured ones.
fn regime(name: &str, brackets: &[Bracket]) -> Result<Vec<String>> {
    let mut samples = Samples::default();
    brackets.iter().try_for_each(|bracket| samples.add(&bracket.stack))?;
    let Learnt { response, noise, doubtful } = samples.learn()?;
    let mut said: Vec<String> = doubtful
        .iter()
        .map(|time| {
            let path = time.path.display();
            format!("{path}: {:.4} s stated; {:.4} s measured", time.stated_s, time.measured_s)
        })
        .collect();
    let mut merged = vec![];
    for bracket in brackets {
        let mut stack = bracket.stack.clone();
        for (picture, exposure_s) in stack.pictures.iter().zip(&mut stack.exposure_s) {
            if let Some(time) = doubtful.iter().find(|time| time.path == picture.path) {
                *exposure_s = time.measured_s;
            }
        }
        merged.push(merge(&stack, &response, &noise)?);
    }
    let flagged =
        |flag| merged.iter().flat_map(|image| &image.mask).filter(|&&mask| mask & flag != 0).count();
    for (flag, word) in [
        (RadianceImage::SATURATED, "saturated"),
        (RadianceImage::DARK, "too dark"),
        (RadianceImage::GHOST, "moved"),
    ] {
        if flagged(flag) > 0 {
            said.push(format!("{} pixels {word}", flagged(flag)));
        }
    }
    let error = error(brackets, &merged);
    Ok(vec![
        name.to_owned(),
        format!("{:.3}", 100.0 * error.median),
        format!("{:.3}", 100.0 * error.p95),
        format!("{:.1}", 100.0 * error.within_sigma),
        format!("{:.2}", 100.0 * error.masked),
        said.join(" | "),
    ])
}

/// Brackets of all poses.
fn shoot(count: u32, stops: f64, disturb: Disturb) -> Result<Vec<Bracket>> {
    let lens = Lens { k1: -0.5, k2: 0.6, ..Lens::pinhole(320, 240, 700.0) };
    let options = Options { lens, ..Options::default() };
    POSES_DEG
        .iter()
        .map(|&(pan, tilt): &(f64, f64)| {
            let at = (pan.to_radians(), tilt.to_radians());
            let mut camera = SimulatedCamera::new(Scene::patchwork(), options, Box::new(move || at) as At);
            let times: Vec<f64> = (0..count).map(|i| LONGEST_S * 2f64.powf(-stops * f64::from(i))).collect();
            let pictures = times.iter().zip(0..).map(|(&time_s, index)| {
                let levels = disturb(&mut camera, index, time_s);
                Picture {
                    path: format!("pan{pan}_tilt{tilt}_{index}.jpg").into(),
                    width: lens.width,
                    height: lens.height,
                    levels: levels.chunks_exact(3).map(|l| [l[0], l[1], l[2]].map(u16::from)).collect(),
                    white: 255,
                }
            });
            let stack = Stack::new(pictures.collect(), times.clone())?;
            let mut truth = camera.truth(&camera.pose()).radiance;
            for (i, rgb) in truth.iter_mut().enumerate() {
                let at = glam::DVec2::new((i % lens.width as usize) as f64, (i / lens.width as usize) as f64);
                let transmission = camera.vignetting(at) as f32;
                rgb.iter_mut().for_each(|value| *value *= transmission);
            }
            Ok(Bracket { stack, truth })
        })
        .collect()
}

/// Over all measured pixels of all brackets, one factor per channel removed: the unit of radiance is free.
fn error(brackets: &[Bracket], merged: &[RadianceImage]) -> Error {
    let (mut errors, mut scores, mut masked, mut pixels) = (vec![], vec![], 0, 0);
    for channel in 0..3 {
        let measured = || {
            brackets.iter().zip(merged).flat_map(move |(bracket, image)| {
                (0..image.mask.len()).filter(move |&i| image.mask[i] == 0).map(move |i| {
                    let [value, variance] = [image.radiance[i][channel], image.variance[i][channel]];
                    [value, variance, bracket.truth[i][channel]].map(f64::from)
                })
            })
        };
        let mut ratios: Vec<f64> = measured().filter(|m| m[2] > 0.0).map(|m| m[0] / m[2]).collect();
        ratios.sort_by(f64::total_cmp);
        let Some(&scale) = ratios.get(ratios.len() / 2) else { continue };
        for [value, variance, truth] in measured().filter(|m| m[2] > 0.0) {
            let difference = (value - scale * truth).abs();
            errors.push(difference / (scale * truth));
            scores.push(difference <= variance.sqrt());
        }
    }
    for (image, bracket) in merged.iter().zip(brackets) {
        // Beside the board there is nothing to measure.
        let board = || image.mask.iter().zip(&bracket.truth).filter(|(_, truth)| truth[1] > 0.0);
        masked += board().filter(|(mask, _)| **mask != 0).count();
        pixels += board().count();
    }
    errors.sort_by(f64::total_cmp);
    let quantile = |q: f64| errors.get((errors.len() as f64 * q) as usize).copied().unwrap_or(f64::NAN);
    Error {
        median: quantile(0.5),
        p95: quantile(0.95),
        within_sigma: scores.iter().filter(|&&s| s).count() as f64 / scores.len().max(1) as f64,
        masked: masked as f64 / pixels.max(1) as f64,
    }
}

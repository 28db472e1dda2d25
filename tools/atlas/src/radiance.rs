//! Radiance: error against time and number of exposures for every way of merging, and what happens where brackets are bad.

mod regimes;

use std::path::Path;
use std::time::Duration;

use rigel::Result;
use rigel::chart::{self, Axis, ChartPoint};
use rigel::geometry::Lens;
use rigel::picture::Picture;
use rigel::progress::Progress;
use rigel::radiance::{RadianceImage, Samples, Stack, merge, others};
use rigel::report::Report;
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;

use crate::figures::{figure, marks_and_line, quantile, raw};
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
    method: impl Fn(&Stack) -> Result<Vec<[f32; 3]>>,
) -> Result<(f64, Vec<RadianceImage>)> {
    let (cpu_s, merged) =
        cpu_seconds(ENOUGH, || brackets.iter().map(|b| method(&b.stack)).collect::<Result<Vec<_>>>());
    let images = brackets.iter().zip(merged?).map(|(bracket, radiance)| {
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
    let total = BRACKETS.len() + regimes::STEPS;
    let mut figures = Table::new(&[
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
    let mut by_exposures = vec![];
    let mut of_methods = METHODS.map(|_| (vec![], vec![]));
    for (index, (count, stops)) in BRACKETS.into_iter().enumerate() {
        progress.step(index, total)?;
        let brackets = shoot(LONGEST_S, count, stops, as_it_is)?;
        for ((name, method), (medians, tails)) in METHODS.into_iter().zip(&mut of_methods) {
            let pixels = brackets.iter().map(|b| b.truth.len()).sum::<usize>() as f64;
            let (cpu_s, merged) = match method(&brackets) {
                Ok(done) => done,
                Err(refused) => {
                    figures.refused(&[name, &count.to_string(), &stops.to_string()], refused.to_string());
                    continue;
                }
            };
            let error = error(&brackets, &merged);
            if !error.median.is_finite() {
                let start = [name, &count.to_string(), &stops.to_string()];
                figures.refused(&start, "gives no number".into());
                continue;
            }
            figures.row(vec![
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
            if stops == 1.0 {
                medians.push((f64::from(count), 100.0 * error.median));
                tails.push((f64::from(count), 100.0 * error.p95));
            }
            points.push(ChartPoint {
                method: name.to_owned(),
                x: cpu_s / pixels * 1e9,
                y: 100.0 * error.median,
                label: format!("{count} x {stops}"),
            });
        }
    }
    for ((name, _), (medians, tails)) in METHODS.into_iter().zip(of_methods) {
        by_exposures.extend(marks_and_line(name, medians, tails));
    }
    report.heading("Radiance: time and exposures against error");
    let axes = (
        Axis { label: "CPU time to merge a megapixel, milliseconds", logarithmic: true },
        Axis { label: "median error of radiance, percent", logarithmic: true },
    );
    figure(
        folder,
        report,
        "radiance",
        chart::scatter(&points, axes)?,
        "Beside each point: number of exposures x stops between them. Response recovered from the same photographs; \
         a simulated camera, three directions; one factor per channel removed.",
    )?;
    let exposures = (
        Axis { label: "exposures, one stop apart", logarithmic: true },
        Axis { label: "error of radiance, percent", logarithmic: true },
    );
    figure(
        folder,
        report,
        "radiance_exposures",
        chart::lines(&by_exposures, exposures)?,
        "Number of exposures against error: marks the median, lines the 95th percentile.",
    )?;
    raw(folder, report, "radiance", &figures)?;
    regimes::sweep(folder, report, &|step| progress.step(BRACKETS.len() + step, total))?;
    progress.step(total, total)
}

/// What happens to the bracket of one view: the photograph's index, its exposure time and its levels.
type Disturb = fn(&mut SimulatedCamera<At>, u32, f64) -> Vec<u8>;
/// Where the simulated rig stands: pan and tilt, radians.
type At = Box<dyn Fn() -> (f64, f64)>;

fn as_it_is(camera: &mut SimulatedCamera<At>, _index: u32, time_s: f64) -> Vec<u8> {
    camera.levels(time_s)
}

/// The simulated camera, and the board at a pan and tilt (radians).
fn camera(at: (f64, f64)) -> SimulatedCamera<At> {
    let lens = Lens { k1: -0.5, k2: 0.6, ..Lens::pinhole(320, 240, 700.0) };
    SimulatedCamera::new(Scene::patchwork(), Options { lens, ..Options::default() }, Box::new(move || at))
}

/// Brackets of all poses.
fn shoot(longest_s: f64, count: u32, stops: f64, disturb: Disturb) -> Result<Vec<Bracket>> {
    POSES_DEG
        .iter()
        .map(|&(pan, tilt): &(f64, f64)| {
            let mut camera = camera((pan.to_radians(), tilt.to_radians()));
            let lens = *camera.lens();
            let times: Vec<f64> = (0..count).map(|i| longest_s * 2f64.powf(-stops * f64::from(i))).collect();
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

/// Measured values of a channel with their variance and truth, of all brackets.
fn measured<'a>(
    brackets: &'a [Bracket],
    merged: &'a [RadianceImage],
    channel: usize,
) -> impl Iterator<Item = [f64; 3]> + 'a {
    brackets.iter().zip(merged).flat_map(move |(bracket, image)| {
        (0..image.mask.len()).filter(move |&i| image.mask[i] == 0 && bracket.truth[i][channel] > 0.0).map(
            move |i| {
                let [value, variance] = [image.radiance[i][channel], image.variance[i][channel]];
                [value, variance, bracket.truth[i][channel]].map(f64::from)
            },
        )
    })
}

/// The unit of radiance is free: one factor per channel, the median over all measured pixels.
fn scales(brackets: &[Bracket], merged: &[RadianceImage]) -> [f64; 3] {
    [0, 1, 2].map(|channel| {
        let mut ratios: Vec<f64> = measured(brackets, merged, channel).map(|m| m[0] / m[2]).collect();
        quantile(&mut ratios, 0.5)
    })
}

/// Over all measured pixels of all brackets, the factors of [`scales`] removed.
fn error(brackets: &[Bracket], merged: &[RadianceImage]) -> Error {
    let (mut errors, mut scores, mut masked, mut pixels) = (vec![], vec![], 0, 0);
    for (channel, scale) in scales(brackets, merged).into_iter().enumerate() {
        for [value, variance, truth] in measured(brackets, merged, channel) {
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
    Error {
        median: quantile(&mut errors, 0.5),
        p95: quantile(&mut errors, 0.95),
        within_sigma: scores.iter().filter(|&&s| s).count() as f64 / scores.len().max(1) as f64,
        masked: masked as f64 / pixels.max(1) as f64,
    }
}

//! Orientations of a tracked camera that turns on the spot: the tracker alone, smoothed, and refined by the photographs.

use std::path::Path;
use std::time::Duration;

use glam::DQuat;
use rigel::chart::{self, Axis, ChartPoint, Drawn, Series};
use rigel::environment::{MergeOptions, Mosaic, Options, Shots, mosaic};
use rigel::geometry::{LatLong, Lens, world_from_camera};
use rigel::progress::{Progress, Silent};
use rigel::report::Report;
use rigel::tracker::{Track, rotation_vector};
use rigel::{Error, Result};
use rigel_simulated::tour::{Fault, Tour, apart};

use crate::figures::{figure, marks_and_line, raw, rms, table};
use crate::machine::cpu_seconds;
use crate::table::{Table, broken};

/// Sessions for each setting; more make it slow.
const SEEDS: u64 = 1;
/// Orientations that are refined are to be as good, degrees.
const BAR_DEG: f64 = 0.1;
const METHODS: [&str; 3] =
    ["tracker alone", "tracker smoothed, delay and mount removed", "refined by photographs"];

/// One thing is varied: its name in files, what it is called, and the tour that has it.
struct Sweep {
    name: &'static str,
    label: &'static str,
    values: &'static [f64],
    tour: fn(f64) -> Tour,
}

/// A session that is quick to adjust.
fn usual() -> Tour {
    Tour { photographs: 44, lens: Lens::pinhole(240, 180, 180.0), ..Tour::default() }
}

const SWEEPS: [Sweep; 5] = [
    Sweep {
        name: "jitter",
        label: "jitter of a record about each axis, degrees",
        values: &[0.1, 0.3, 0.75, 1.5, 3.0, 6.0],
        tour: |value| Tour { jitter_rad: value.to_radians(), ..usual() },
    },
    Sweep {
        name: "delay",
        label: "delay of the camera, milliseconds",
        values: &[0.0, 40.0, 80.0, 160.0, 320.0, 640.0],
        tour: |value| Tour { delay_s: value / 1e3, ..usual() },
    },
    Sweep {
        name: "drift",
        label: "drift until the end, degrees",
        values: &[0.0, 1.0, 2.0, 5.0, 10.0, 20.0],
        tour: |value| Tour { drift_rad: value.to_radians(), ..usual() },
    },
    Sweep {
        name: "texture",
        label: "share of the room that is a white wall, %",
        values: &[0.0, 25.0, 50.0, 75.0, 90.0, 100.0],
        tour: |value| Tour { bare: value / 100.0, ..usual() },
    },
    Sweep {
        name: "overlap",
        label: "overlap of neighbours along the horizon, %",
        values: &[10.0, 25.0, 40.0, 55.0, 70.0, 85.0],
        tour: |value| Tour { laps: 1.0, photographs: photographs(value / 100.0), ..usual() },
    },
];

/// Photographs of one lap, 67 degrees wide, that overlap by such a part.
fn photographs(overlap: f64) -> usize {
    (360.0 / (67.4 * (1.0 - overlap))).round() as usize + 1
}

/// Something wrong with the tracker.
const FAULTS: [(&str, &[Fault]); 6] = [
    ("all well", &[]),
    ("a jump of 11 degrees for 3 s", &[Fault::Jump { from_s: 8.0, to_s: 11.0, by_rad: 0.2 }]),
    ("bent by up to 11 degrees over 3 s", &[Fault::Bend { from_s: 8.0, to_s: 11.0, by_rad: 0.2 }]),
    ("frozen for 0.6 s", &[Fault::Freeze { from_s: 8.0, to_s: 8.6 }]),
    ("frozen for 3 s", &[Fault::Freeze { from_s: 8.0, to_s: 11.0 }]),
    ("silent for 3 s", &[Fault::Silence { from_s: 8.0, to_s: 11.0 }]),
];

/// Sweeps what orientations depend on, and what can be wrong with a tracker; charts and tables go to the page, raw figures to `folder`.
///
/// # Errors
/// What making maps, drawing or writing reports.
pub fn sweep(folder: &Path, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    let total = SWEEPS.iter().map(|sweep| sweep.values.len()).sum::<usize>() + FAULTS.len() + 1;
    let mut done = 0;
    let mut step = || {
        done += 1;
        progress.step(done, total)
    };
    report.heading("Orientations of a tracked camera");
    report.text(
        "A simulated camera of 67 degrees that turns twice around in 40 s, 44 photographs of 240x180 pixels, in a room with texture everywhere; a tracker with jitter of 0.75 degrees \
         about each axis, in steps of 0.1 degrees, 80 ms before the photographs, that drifts by 2 degrees, its receiver 7 degrees askew. One thing is varied at a \
         time. Marks are the error (root mean square over all photographs, after the one turn that all share), lines the standard deviation \
         that is stated (of the rotation's angle). The tracker alone is the report's method: nothing of it knows the photographs.",
    );
    let mut figures = Table::new(&[
        "varied",
        "value",
        "method",
        "rms_error_deg",
        "rms_stated_deg",
        "delay_error_ms",
        "refused",
    ]);
    let mut breaks = Table::new(&["varied", METHODS[1], METHODS[2]]);
    for sweep in &SWEEPS {
        let mut series = METHODS.map(|_| (vec![], vec![]));
        for &value in sweep.values {
            step()?;
            let found = (1..=SEEDS)
                .map(|seed| errors(&Tour { seed, ..(sweep.tour)(value) }))
                .collect::<Result<Vec<_>>>();
            let found = match found {
                Ok(found) => found,
                Err(refused) => {
                    figures.refused(&[sweep.name, &value.to_string()], refused.to_string());
                    continue;
                }
            };
            for (index, (actual, stated)) in series.iter_mut().enumerate() {
                let error_deg = rms(found.iter().map(|errors| errors.actual_deg[index]));
                let stated_deg = rms(found.iter().map(|errors| errors.stated_deg[index]));
                actual.push((value, error_deg));
                if index > 0 {
                    stated.push((value, stated_deg));
                }
                figures.row(vec![
                    sweep.name.into(),
                    value.to_string(),
                    METHODS[index].into(),
                    format!("{error_deg:.4}"),
                    if index > 0 { format!("{stated_deg:.4}") } else { String::new() },
                    format!("{:.2}", rms(found.iter().map(|errors| errors.delay_ms))),
                    String::new(),
                ]);
            }
        }
        let states = |index: usize, most: f64| broken(&series[index].0, most, sweep.values.iter().copied());
        breaks.row(vec![sweep.label.into(), states(1, 1.0), states(2, BAR_DEG)]);
        let mut drawn: Vec<Series> = METHODS
            .into_iter()
            .zip(series)
            .flat_map(|(method, (actual, stated))| marks_and_line(method, actual, stated))
            .filter(|series| !series.points.is_empty())
            .collect();
        let ends = [sweep.values[0], sweep.values[sweep.values.len() - 1]];
        drawn.push(Series {
            name: "refined is broken above".into(),
            points: ends.map(|value| (value, BAR_DEG)).into(),
            drawn: Drawn::Limit,
        });
        let axes = (
            Axis { label: sweep.label, logarithmic: sweep.name == "jitter" },
            Axis { label: "error of the orientation, degrees", logarithmic: true },
        );
        figure(
            folder,
            report,
            &format!("environment_{}", sweep.name),
            chart::lines(&drawn, axes)?,
            sweep.label,
        )?;
    }
    let caption = "Where orientations break: the smoothed tracker above 1 degree, those that photographs refine above 0.1.";
    table(folder, report, "environment_breaks", &breaks, caption)?;
    step()?;
    speed(folder, report)?;
    faults(folder, report, &mut step)?;
    raw(folder, report, "environment", &figures)
}

/// Errors of one session, degrees (root mean squares over the photographs), method by method.
struct Errors {
    actual_deg: [f64; 3],
    stated_deg: [f64; 3],
    delay_ms: f64,
    notes: Vec<String>,
    kept: usize,
}

fn options(tour: &Tour, refine: bool) -> Result<Options> {
    Ok(Options {
        lens: Some(tour.lens),
        sigma_rad: 0.035,
        refine,
        merge: MergeOptions { feather: 2, disagreement: Some(0.1) },
        ..Options::new(LatLong::new(64, 32)?)
    })
}

fn written(tour: &Tour) -> Result<tempfile::TempDir> {
    let folder = tempfile::tempdir().map_err(Error::io("create", std::env::temp_dir()))?;
    tour.write(folder.path())?;
    Ok(folder)
}

fn errors(tour: &Tour) -> Result<Errors> {
    let folder = written(tour)?;
    let made = mosaic(&Shots::read(folder.path())?, &options(tour, true)?, &Silent)?;
    let kept = |i: &usize| made.placed.iter().any(|placed| placed.name == format!("{i:03}.png"));
    let kept: Vec<usize> = (0..tour.photographs).filter(kept).collect();
    let (truth, times_s) = (tour.truth(), tour.times_s());
    let truth: Vec<DQuat> = kept.iter().map(|&i| truth[i]).collect();
    let records = tour.records();
    let alone: Vec<DQuat> = kept.iter().map(|&i| said(&records, times_s[i])).collect();
    let tracked = |made: &Mosaic| made.placed.iter().filter_map(|placed| placed.tracked).collect::<Vec<_>>();
    let tracked = tracked(&made);
    let error = |turns: Vec<DQuat>| rms(apart(&turns, &truth).iter().map(|off| off.length())).to_degrees();
    let stated = |sigmas: &mut dyn Iterator<Item = f64>| 3f64.sqrt() * rms(sigmas).to_degrees();
    let fit = made.tracker.as_ref();
    Ok(Errors {
        actual_deg: [
            error(alone),
            error(tracked.iter().map(|tracked| tracked.0).collect()),
            error(made.placed.iter().map(|placed| placed.world_from_camera).collect()),
        ],
        stated_deg: [
            f64::NAN,
            stated(&mut tracked.iter().map(|tracked| tracked.1)),
            stated(&mut made.placed.iter().map(|placed| placed.sigma_rad)),
        ],
        delay_ms: fit.map_or(f64::NAN, |fit| 1e3 * (fit.delay_s - tour.delay_s)),
        notes: made.notes.clone(),
        kept: kept.len(),
    })
}

/// What the tracker said at a time, between its records: camera frame to the world, were its receiver straight.
fn said(records: &[(f64, DQuat)], time_s: f64) -> DQuat {
    let after = records.partition_point(|record| record.0 <= time_s).clamp(1, records.len() - 1);
    let (from, to) = (records[after - 1], records[after]);
    let part = (time_s - from.0) / (to.0 - from.0);
    world_from_camera(from.1 * DQuat::from_scaled_axis(rotation_vector(from.1.inverse() * to.1) * part))
}

/// Time against error for numbers of photographs.
fn speed(folder: &Path, report: &mut Report) -> Result<()> {
    let mut points = vec![];
    for photographs in [22, 44, 88] {
        let tour = Tour { photographs, ..usual() };
        let errors = errors(&tour)?;
        let (records, times_s) = (tour.records(), tour.times_s());
        let (smooth_s, _) = cpu_seconds(Duration::from_millis(50), || {
            let track = Track::new(&records)?;
            Ok::<_, Error>(times_s.iter().map(|time_s| track.at(*time_s).orientation).collect::<Vec<_>>())
        });
        let written = written(&tour)?;
        let shots = Shots::read(written.path())?;
        let (refined_s, made) =
            cpu_seconds(Duration::from_millis(50), || mosaic(&shots, &options(&tour, true)?, &Silent));
        made?;
        for (method, cpu_s, error_deg) in
            [(METHODS[0], smooth_s, errors.actual_deg[0]), (METHODS[2], refined_s, errors.actual_deg[2])]
        {
            let label = format!("{photographs} photographs");
            points.push(ChartPoint {
                method: method.into(),
                x: 1e3 * cpu_s / photographs as f64,
                y: error_deg,
                label,
            });
        }
    }
    let axes = (
        Axis { label: "CPU time, milliseconds per photograph", logarithmic: true },
        Axis { label: "error of the orientation, degrees (root mean square)", logarithmic: true },
    );
    let caption = "Time against error of the orientations: the tracker's records smoothed, or all of rigel mosaic from 240x180 pixels, a small map included.";
    figure(folder, report, "environment_speed", chart::scatter(&points, axes)?, caption)
}

/// What is left where the tracker is wrong for a while, and what is said.
fn faults(folder: &Path, report: &mut Report, step: &mut dyn FnMut() -> Result<()>) -> Result<()> {
    let mut rows = Table::new(&[
        "tracker",
        "photographs_kept",
        "alone_deg",
        "smoothed_deg",
        "smoothed_stated_deg",
        "refined_deg",
        "delay_error_ms",
        "what_is_said",
    ]);
    for (name, faults) in FAULTS {
        step()?;
        let tour = Tour { faults: faults.to_vec(), ..usual() };
        match errors(&tour) {
            Ok(errors) => rows.row(vec![
                name.into(),
                format!("{} of {}", errors.kept, tour.photographs),
                format!("{:.3}", errors.actual_deg[0]),
                format!("{:.3}", errors.actual_deg[1]),
                format!("{:.3}", errors.stated_deg[1]),
                format!("{:.4}", errors.actual_deg[2]),
                format!("{:.2}", errors.delay_ms),
                errors.notes.join(" | "),
            ]),
            Err(refused) => rows.refused(&[name], format!("refused: {refused}")),
        }
    }
    let caption = "Where the tracker is wrong for a while: what is left, and what the user is told.";
    table(folder, report, "environment_faults", &rows, caption)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_follow_from_their_overlap() {
        assert!(photographs(0.85) > 2 * photographs(0.5) && photographs(0.0) == 6);
    }
}

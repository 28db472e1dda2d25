//! One thing after the other is made worse until each model breaks.

use std::path::Path;

use glam::Vec3;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rigel::Result;
use rigel::chart::{self, Axis, Drawn, Series};
use rigel::report::Report;

use super::texels::{Doubt, Truth, directions, lobes};
use super::{AUTO, Done, ZENITH_RAD, fit, observe_all};
use crate::figures::{figure, table};
use crate::table::{Table, broken};

/// Models whose breaks are looked for.
const MODELS: [&str; 6] = ["constant", "phong", "phong2", "log-quadratic", "msh36", AUTO];
/// A mean error beyond this shows.
const BROKEN: f64 = 0.05;
const EACH: usize = 32;

/// Texels, the views' directions, and what makes them differ from the truth.
type Case = (Vec<Truth>, Vec<Vec3>, Doubt);

/// What one sweep changes.
struct Sweep {
    name: &'static str,
    label: &'static str,
    values: &'static [f32],
    logarithmic: bool,
    make: fn(f32) -> Case,
}

impl Sweep {
    /// What a model does at a value; `None` where it needs more views.
    fn at(&self, value: f32, model: &str) -> Result<Option<Done>> {
        let (truths, toward, doubt) = (self.make)(value);
        fit(model, &truths, &observe_all(&truths, &toward, &doubt))
    }
}

/// The mean error of a model, relative, where the sweep of this name is at `value`; `None` where there is no such sweep, or the model
/// needs more views.
///
/// # Errors
/// [`rigel::Error::Request`] when there is no such model.
pub fn error_at(sweep: &str, value: f32, model: &str) -> Result<Option<f64>> {
    let Some(sweep) = SWEEPS.iter().find(|of| of.name == sweep) else { return Ok(None) };
    Ok(sweep.at(value, model)?.map(|done| done.error))
}

const SWEEPS: [Sweep; 8] = [
    Sweep {
        name: "noise",
        label: "noise, % of the radiance",
        values: &[0.3, 1.0, 3.0, 10.0, 30.0],
        logarithmic: true,
        make: |value| (one_lobe(), views(150), Doubt { relative: value / 100.0, ..Doubt::USUAL }),
    },
    Sweep {
        name: "views",
        label: "views",
        values: &[6.0, 10.0, 17.0, 37.0, 73.0, 150.0, 305.0],
        logarithmic: true,
        make: |value| (one_lobe(), views(value as usize), Doubt::USUAL),
    },
    Sweep {
        name: "zenith",
        label: "largest zenith of the views, degrees",
        values: &[20.0, 30.0, 45.0, 60.0, 75.0],
        logarithmic: false,
        make: |value| (one_lobe(), directions(150, value.to_radians(), 0.0), Doubt::USUAL),
    },
    Sweep {
        name: "shininess",
        label: "shininess of the lobe",
        values: &[3.0, 10.0, 30.0, 100.0, 300.0, 1000.0],
        logarithmic: true,
        make: |value| (sharp(value), views(150), Doubt::USUAL),
    },
    Sweep {
        name: "lamps",
        label: "lamps",
        values: &[0.0, 1.0, 2.0, 3.0, 4.0],
        logarithmic: false,
        make: |value| (several(value as usize), views(150), Doubt::USUAL),
    },
    Sweep {
        name: "lamp_size",
        label: "radius of the lamp, degrees",
        values: &[0.0, 5.0, 10.0, 20.0, 40.0],
        logarithmic: false,
        make: |value| (wide(value.to_radians()), views(150), Doubt::USUAL),
    },
    Sweep {
        name: "clipping",
        label: "clipped above, part of the highlight's height",
        values: &[1.0, 0.8, 0.6, 0.4, 0.2],
        logarithmic: false,
        make: |value| (white(), views(150), Doubt { clip: 0.3 + value, ..Doubt::USUAL }),
    },
    Sweep {
        name: "pose_error",
        label: "error of the directions, degrees",
        values: &[0.0, 0.3, 1.0, 3.0, 10.0],
        logarithmic: false,
        make: |value| (one_lobe(), views(150), Doubt { direction_rad: value.to_radians(), ..Doubt::USUAL }),
    },
];
/// Steps that [`sweep`] reports.
pub const STEPS: usize = SWEEPS.len();

fn views(count: usize) -> Vec<Vec3> {
    directions(count, ZENITH_RAD, 0.0)
}

fn several(count: usize) -> Vec<Truth> {
    (0..EACH).map(|i| lobes(&mut StdRng::seed_from_u64(i as u64), count)).collect()
}

fn one_lobe() -> Vec<Truth> {
    several(1)
}

fn sharp(shininess: f32) -> Vec<Truth> {
    let mut truths = one_lobe();
    truths.iter_mut().for_each(|truth| truth.lobes[0].2 = shininess);
    truths
}

fn white() -> Vec<Truth> {
    let mut truths = sharp(20.0);
    for truth in &mut truths {
        truth.diffuse = Vec3::splat(0.3);
        truth.lobes[0].0 = Vec3::ONE;
    }
    truths
}

/// A lamp of this radius in a glossy surface, as many small ones.
fn wide(radius_rad: f32) -> Vec<Truth> {
    let mut truths = sharp(60.0);
    for truth in &mut truths {
        let (colour, axis, shininess) = truth.lobes[0];
        let (a, b) = axis.any_orthonormal_pair();
        let lamp = |i: usize| {
            let (r, turn) = (radius_rad * ((i as f32 + 0.5) / 80.0).sqrt(), 2.399_963 * i as f32);
            let toward = axis + (a * turn.cos() + b * turn.sin()) * r.tan();
            (colour / 80.0, toward.normalize(), shininess)
        };
        truth.lobes = (0..80).map(lamp).collect();
    }
    truths
}

/// Adds a chart for each sweep and the table of breaks.
pub fn sweep(folder: &Path, report: &mut Report, step: &dyn Fn(usize) -> Result<()>) -> Result<()> {
    report.heading("Where models break");
    report.text(format!(
        "One thing is made worse at a time; everything else is 150 views down to zenith 75 degrees of one lobe with 1 % + 0.002 of noise. A model is broken where its \
         mean error against the truth exceeds {} %.",
        100.0 * BROKEN
    ));
    let mut header = vec!["sweep"];
    header.extend(MODELS);
    let mut breaks = Table::new(&header);
    let mut raw = Table::new(&[
        "sweep",
        "value",
        "model",
        "mean_error_percent",
        "p95_error_percent",
        "cpu_us_per_texel",
    ]);
    for (index, sweep) in SWEEPS.iter().enumerate() {
        step(index)?;
        let mut series: Vec<Series> =
            MODELS.map(|name| Series { name: name.into(), points: vec![], drawn: Drawn::Line }).into();
        for &value in sweep.values {
            for series in &mut series {
                let Some(done) = sweep.at(value, &series.name)? else { continue };
                series.points.push((value.into(), 100.0 * done.error.max(1e-5)));
                raw.row(vec![
                    sweep.name.into(),
                    value.to_string(),
                    series.name.clone(),
                    format!("{:.3}", 100.0 * done.error),
                    format!("{:.3}", 100.0 * done.p95),
                    format!("{:.1}", 1e6 * done.cpu_s),
                ]);
            }
        }
        let mut row = vec![sweep.label.to_owned()];
        row.extend(series.iter().map(|series| {
            broken(&series.points, 100.0 * BROKEN, sweep.values.iter().map(|value| f64::from(*value)))
        }));
        breaks.row(row);
        // The break as a line of its own.
        let ends = [sweep.values[0], sweep.values[sweep.values.len() - 1]];
        series.push(Series {
            name: "broken above".into(),
            points: ends.map(|value| (value.into(), 100.0 * BROKEN)).into(),
            drawn: Drawn::Limit,
        });
        series.retain(|series| !series.points.is_empty());
        let axes = (
            Axis { label: sweep.label, logarithmic: sweep.logarithmic },
            Axis { label: "mean error against the truth, %", logarithmic: true },
        );
        let name = format!("fit_break_{}", sweep.name);
        figure(folder, report, &name, chart::lines(&series, axes)?, sweep.label)?;
    }
    table(folder, report, "fit_breaks", &breaks, "Where each model breaks.")?;
    raw.write(&folder.join("fit_break_raw.csv"))
}

//! Lights: how far the irradiance is off against the number of lights, and what finding them takes.

use std::path::Path;
use std::time::Duration;

use glam::{DVec2, DVec3};
use rigel::Result;
use rigel::chart::{self, Axis, ChartPoint, Drawn, Series};
use rigel::environment::{EnvironmentMap, Lights, Method, Remainder, lights};
use rigel::geometry::LatLong;
use rigel::progress::Progress;
use rigel::report::Report;

use crate::figures::{figure, raw};
use crate::machine::cpu_seconds;
use crate::table::Table;

const COUNTS: [usize; 7] = [1, 2, 4, 8, 16, 32, 64];
const ROWS: u32 = 256;
const METHODS: [(&str, Method); 4] = [
    ("median cut", Method::MedianCut),
    ("joined, constant rest", Method::Joined(0)),
    ("joined, linear rest", Method::Joined(1)),
    ("joined, quadratic rest", Method::Joined(Remainder::MOST_ORDER)),
];

/// Sweeps numbers of lights for each method on a simulated room; charts go to the page, raw figures to `folder`.
///
/// # Errors
/// What finding lights, drawing or writing reports.
pub fn sweep(folder: &Path, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    let map = room()?;
    let mut figures = Table::new(&[
        "method",
        "allowed",
        "lights",
        "order_of_rest",
        "open_error_percent",
        "error_percent",
        "cpu_ms",
    ]);
    let (mut open, mut behind, mut points) = (vec![], vec![], vec![]);
    report.heading("Lights: irradiance from a few of them");
    report.text(
        "A simulated room: three lamps, a window, walls of unlike colours that grow lighter towards the ceiling, and a mottled floor. Error of the irradiance, root \
         mean square over orientations of a surface, relative: nothing hidden, and with walls each of which hides half of the sphere. The rest beside the \
         joined lights are spherical harmonics of order 0, 1 or 2, never negative.",
    );
    let total = METHODS.len() * COUNTS.len();
    for (number, (name, method)) in METHODS.into_iter().enumerate() {
        let mut series = (vec![], vec![]);
        for (k, count) in COUNTS.into_iter().enumerate() {
            progress.step(number * COUNTS.len() + k, total)?;
            let (cpu_s, found) = cpu_seconds(Duration::from_millis(30), || lights(&map, method, 0.0, count));
            let Lights { lights, remainder, error, open_error, .. } = found?;
            figures.row(vec![
                name.to_owned(),
                count.to_string(),
                lights.len().to_string(),
                remainder.order().to_string(),
                format!("{:.3}", 100.0 * open_error),
                format!("{:.3}", 100.0 * error),
                format!("{:.0}", 1e3 * cpu_s),
            ]);
            series.0.push((count as f64, 100.0 * open_error));
            series.1.push((count as f64, 100.0 * error));
            points.push(ChartPoint {
                method: name.to_owned(),
                x: 1e3 * cpu_s,
                y: 100.0 * error,
                label: if [1, 16, 64].contains(&count) { count.to_string() } else { String::new() },
            });
        }
        for (all, points) in [(&mut open, series.0), (&mut behind, series.1)] {
            all.push(Series { name: name.to_owned(), points, drawn: Drawn::Line });
        }
    }
    let count = Axis { label: "lights allowed", logarithmic: true };
    let error = Axis { label: "error of the irradiance, percent", logarithmic: true };
    let caption = "Nothing hidden. A quadratic rest lets a few lights do; without any rest median cut spends its lights on the walls.";
    figure(folder, report, "lights_open", chart::lines(&open, (count, error))?, caption)?;
    let caption = "Open and behind walls. A wall that cuts through a lamp or a window sees a part of it, which one light cannot tell: more lights help.";
    figure(folder, report, "lights_walls", chart::lines(&behind, (count, error))?, caption)?;
    let time = Axis { label: "CPU time to find them, milliseconds", logarithmic: true };
    let caption = "Time against error, open and behind walls, by numbers of lights. Most of the time goes into the irradiance of the whole map, against which lights are judged.";
    figure(folder, report, "lights_speed", chart::scatter(&points, (time, error))?, caption)?;
    raw(folder, report, "lights", &figures)?;
    progress.step(total, total)
}

/// Three lamps, a window, coloured walls and a mottled floor.
fn room() -> Result<EnvironmentMap> {
    let size = LatLong::new(2 * ROWS, ROWS)?;
    let lamps = [
        (DVec3::new(0.1, 0.8, 0.5), 4.0, [80.0; 3]),
        (DVec3::new(0.4, 0.6, -0.7), 3.0, [120.0, 110.0, 80.0]),
        (DVec3::new(-0.9, 0.35, -0.2), 2.0, [60.0; 3]),
        (DVec3::new(-0.5, 0.1, 0.85), 12.0, [8.0, 10.0, 14.0]),
    ];
    let radiance = |i: usize| {
        let d = size.direction(DVec2::new((i % size.width()) as f64, (i / size.width()) as f64));
        let lamp = lamps.iter().find(|(at, radius_deg, _)| d.angle_between(*at).to_degrees() < *radius_deg);
        let tint = [0.1 * d.x, 0.05 * d.z, -0.1 * d.x];
        let mottled = if d.y < -0.5 { 0.1 * ((40.0 * d.x).sin() * (40.0 * d.z).sin()) } else { 0.0 };
        lamp.map_or_else(|| tint.map(|tint| (0.6 + 0.3 * d.y + tint + mottled) as f32), |(_, _, own)| *own)
    };
    let radiance = (0..size.count()).map(radiance).collect();
    Ok(EnvironmentMap {
        size,
        radiance,
        variance: vec![],
        coverage: vec![],
        flags: vec![],
        unit: Default::default(),
        curve: vec![],
    })
}

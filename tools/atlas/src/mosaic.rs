//! Putting photographs on a sphere: what each filter costs and how wrong the map is, against the size of the map.

use std::f64::consts::TAU;
use std::path::Path;
use std::time::Duration;

use glam::{DQuat, DVec2, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::Result;
use rigel::chart::{self, Axis, ChartPoint};
use rigel::environment::{Filter, MergeOptions, Noise, Plate, Sphere, merge};
use rigel::geometry::{LatLong, Lens, world_from_camera};
use rigel::progress::{Progress, Silent};
use rigel::report::Report;

use crate::figures::{figure, table};
use crate::machine::cpu_seconds;
use crate::table::Table;

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
const ACROSS_RAD: f64 = 60.0 * TAU / 360.0;
/// Rows of the maps; the photographs have as many pixels to a degree as one of 960.
const ROWS: [usize; 4] = [256, 512, 1024, 2048];
const FILTERS: [(Filter, &str); 4] = [
    (Filter::Nearest, "nearest"),
    (Filter::Bilinear, "bilinear"),
    (Filter::Bicubic, "bicubic"),
    (Filter::Spline, "spline"),
];
/// So long each is measured, CPU time.
const ENOUGH: Duration = Duration::from_millis(200);

/// A room of plane waves, down to three pixels of a photograph long, the short ones weak: radiance in every direction.
struct Room(Vec<(DVec3, f64, [f64; 3])>);

impl Room {
    fn new() -> Self {
        let mut random = StdRng::seed_from_u64(11);
        let shortest = 3.0 * ACROSS_RAD / f64::from(WIDTH);
        let wave = |i: usize| {
            let per_rad = TAU / shortest * (0.02f64).powf(1.0 - (i as f64 + 0.5) / 24.0);
            let (z, azimuth) = (random.random_range(-1.0..1.0f64), random.random_range(0.0..TAU));
            let across = (1.0 - z * z).sqrt();
            let along = DVec3::new(across * azimuth.cos(), across * azimuth.sin(), z);
            let colour = [(); 3].map(|()| random.random_range(0.3..1.0) * 0.12 * (20.0 / per_rad).powf(0.4));
            (along * per_rad, random.random_range(0.0..TAU), colour)
        };
        Self((0..24).map(wave).collect())
    }

    fn radiance(&self, direction: DVec3) -> [f64; 3] {
        let mut sum = [0.5; 3];
        for (along, phase, colour) in &self.0 {
            let cosine = (along.dot(direction) + phase).cos();
            (0..3).for_each(|c| sum[c] += colour[c] * cosine);
        }
        sum
    }

    /// Its mean over each pixel of a map.
    fn map(&self, size: LatLong) -> Vec<[f64; 3]> {
        let fine = ROWS[3].div_ceil(size.height());
        let at = |i: usize| {
            let (column, row) = ((i % size.width()) as f64, (i / size.width()) as f64);
            let mut sum = [0.0; 3];
            for k in 0..fine * fine {
                let [x, y] = [k % fine, k / fine].map(|k| (k as f64 + 0.5) / fine as f64 - 0.5);
                let seen = self.radiance(size.direction(DVec2::new(column + x, row + y)));
                (0..3).for_each(|c| sum[c] += seen[c] / (fine * fine) as f64);
            }
            sum
        };
        (0..size.count()).map(at).collect()
    }
}

/// Every filter at every size of the map: chart and table on the page, raw figures in `folder`.
///
/// # Errors
/// What merging, drawing or writing reports; [`rigel::Error::Interrupted`].
pub fn sweep(folder: &Path, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    report.heading("Photographs on a sphere");
    let (room, lens) =
        (Room::new(), Lens::pinhole(WIDTH, HEIGHT, f64::from(WIDTH) / 2.0 / (ACROSS_RAD / 2.0).tan()));
    let turns: Vec<DQuat> = [(0.0, 12), (0.7, 10), (-0.7, 10)]
        .into_iter()
        .flat_map(|(pitch, count)| {
            (0..count).map(move |i| {
                let yaw = TAU * f64::from(i) / f64::from(count);
                world_from_camera(DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch))
            })
        })
        .collect();
    let frames: Vec<Vec<[f32; 3]>> = turns.iter().map(|turn| photograph(&room, &lens, *turn)).collect();
    let mut figures = Table::new(&["filter", "columns", "rows", "cpu_ms_per_photograph", "rms_error_of_255"]);
    let mut points = vec![];
    for (step, &rows) in ROWS.iter().enumerate() {
        progress.step(step, ROWS.len())?;
        let size = LatLong::new(2 * rows as u32, rows as u32)?;
        let (truth, sphere) = (room.map(size), Sphere::new(size));
        for (filter, name) in FILTERS {
            let (cpu_s, merged) = cpu_seconds(ENOUGH, || {
                let plate = |(frame, turn): (&Vec<[f32; 3]>, &DQuat)| {
                    let pixel = |i: usize| [frame[i][0], frame[i][1], frame[i][2], 1.0];
                    Plate::new(size, &lens, *turn, pixel, Noise::EVEN, filter)
                };
                let plates = frames.iter().zip(&turns).map(plate).collect::<Result<Vec<_>>>()?;
                let options = MergeOptions { feather: 1, disagreement: None };
                merge(&sphere, &plates, &options, &Silent)
            });
            let merged = merged?;
            let (mut sum, mut count) = (0.0, 0);
            for ((seen, truth), _) in
                merged.radiance.iter().zip(&truth).zip(&merged.coverage).filter(|(_, views)| **views > 0)
            {
                sum += (0..3).map(|c| (f64::from(seen[c]) - truth[c]).powi(2)).sum::<f64>();
                count += 3;
            }
            let (error, cpu_ms) =
                (255.0 * (sum / f64::from(count)).sqrt(), 1e3 * cpu_s / frames.len() as f64);
            figures.row(vec![
                name.to_owned(),
                (2 * rows).to_string(),
                rows.to_string(),
                format!("{cpu_ms:.2}"),
                format!("{error:.2}"),
            ]);
            points.push(ChartPoint {
                method: name.to_owned(),
                x: cpu_ms,
                y: error,
                label: format!("{}x{rows}", 2 * rows),
            });
        }
    }
    let axis = |label| Axis { label, logarithmic: true };
    let chart = chart::scatter(
        &points,
        (
            axis("time to place a photograph, milliseconds of one core"),
            axis("root mean square error, of 255"),
        ),
    )?;
    let caption = format!(
        "{} photographs of {WIDTH}x{HEIGHT} pixels, 60 degrees wide and 8 bits deep, with known orientations, on maps of {} to {} rows: error against the \
         mean radiance of each of the map's pixels.",
        frames.len(),
        ROWS[0],
        ROWS[3],
    );
    figure(folder, report, "mosaic", chart, &caption)?;
    table(folder, report, "mosaic", &figures, "A photograph finer than the map is made smaller first.")?;
    progress.step(ROWS.len(), ROWS.len())
}

/// Eight bits of what a camera sees, averaged over its pixels.
fn photograph(room: &Room, lens: &Lens, turn: DQuat) -> Vec<[f32; 3]> {
    let pixel = |i: u32| {
        let mut sum = [0.0; 3];
        for k in 0..4u32 {
            let offset = |k: u32| f64::from(k) * 0.5 - 0.25;
            let at = DVec2::new(f64::from(i % WIDTH) + offset(k % 2), f64::from(i / WIDTH) + offset(k / 2));
            let direction = lens.unproject(at).unwrap_or(DVec3::Z).normalize();
            let seen = room.radiance(turn * direction);
            (0..3).for_each(|c| sum[c] += seen[c] / 4.0);
        }
        sum.map(|value| ((255.0 * value).round().clamp(0.0, 255.0) / 255.0) as f32)
    };
    (0..WIDTH * HEIGHT).map(pixel).collect()
}

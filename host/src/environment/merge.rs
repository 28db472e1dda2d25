//! Many plates to one map: every pixel is the mean of what the plates measured, weighted by the inverse of their variances; where none
//! measured it, the largest of their lower bounds.
//!
//! The map is worked on in tiles, so that what a tile needs of a photograph stays in a core's own memory however the camera was
//! rolled.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use multiversion::multiversion;
use rayon::prelude::*;

use super::pages::zeros;
use super::plate::{Noise, Plate};
use super::warp::{CHUNK, Places, Sphere, columns, look};
use crate::Result;
use crate::progress::Progress;

/// Rows and columns of a tile.
const TILE: (usize, usize) = (32, 2 * CHUNK);
/// What a plate says is a measurement from this validity on, else a lower bound: beside a lamp that saturates a long exposure, a smaller
/// one would take the dark around it for the lamp.
const MEASURED: f32 = 0.98;

/// How plates are merged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The weight of a pixel falls towards its photograph's border with this power of its distance, so that no seam is seen:
    /// 0 for none. The greater, the narrower are the seams, and the less is blurred where photographs contradict each other.
    pub feather: u32,
    /// Where three photographs or more overlap, those that contradict the others by more than noise and this part of the
    /// radiance count less (Geman and McClure's weights); `None` for a plain mean.
    pub disagreement: Option<f32>,
}

/// A latitude-longitude map of radiance.
pub struct Merged {
    /// Red, green, blue; 0 where nothing was seen.
    pub radiance: Vec<[f32; 3]>,
    /// The variance of each of the three, at their mean; infinite where nothing was measured.
    pub variance: Vec<f32>,
    /// How many photographs show the pixel.
    pub coverage: Vec<u16>,
    /// How much of the weight was measured, 0 to 1: 0 where what is known is a lower bound, else nearly all.
    pub measured: Vec<f32>,
}

/// A tile's output: rows of the map's radiance, variance, coverage and measured part.
type Band<'a> = (((&'a mut [[f32; 3]], &'a mut [f32]), &'a mut [u16]), &'a mut [f32]);

/// Where a plate covers the map: for each row from the first one, arcs of columns.
struct Cover {
    rows: Range<usize>,
    arcs: Vec<Vec<(usize, usize)>>,
}

/// What one plate says of a part of a row.
struct Run {
    /// Pixel of the tile where it begins.
    at: usize,
    /// Where its pixels begin in the tile's store.
    stored: usize,
    count: usize,
}

/// One thread's room for a tile.
struct Room {
    /// Sums of weight times radiance, and of weight.
    sums: Vec<[f32; 4]>,
    /// Sums of squared weight times variance.
    spread: Vec<f32>,
    /// Sums of weight times validity.
    valid: Vec<f32>,
    count: Vec<u16>,
    /// The largest lower bounds.
    bounds: Vec<[f32; 3]>,
    /// The mean about which photographs are judged.
    means: Vec<[f32; 4]>,
    runs: Vec<Run>,
    /// Every run's pixels: weight times radiance and weight, variance and validity.
    store: Vec<[f32; 4]>,
    doubt: Vec<[f32; 2]>,
}

/// Merges plates that were made for maps of this size.
///
/// # Errors
/// [`crate::Error::Interrupted`] where `progress` says so.
pub fn merge(
    sphere: &Sphere,
    plates: &[Plate],
    options: &Options,
    progress: &dyn Progress,
) -> Result<Merged> {
    let (width, height) = (sphere.size.width(), sphere.size.height());
    let mut merged = Merged {
        radiance: zeros(width * height),
        variance: zeros(width * height),
        coverage: zeros(width * height),
        measured: zeros(width * height),
    };
    let covers: Vec<Cover> = plates.par_iter().map(|plate| Cover::new(plate, sphere)).collect();
    let done = AtomicUsize::new(0);
    let band = TILE.0 * width;
    let bands = merged.radiance.par_chunks_mut(band).zip(merged.variance.par_chunks_mut(band));
    let bands = bands.zip(merged.coverage.par_chunks_mut(band)).zip(merged.measured.par_chunks_mut(band));
    bands.enumerate().try_for_each_init(Room::new, |room, (number, mut band)| {
        let first = number * TILE.0;
        let rows = first..(first + TILE.0).min(height);
        let level = sphere.level(&rows);
        for column in (0..sphere.width(level)).step_by(TILE.1) {
            let columns = column..(column + TILE.1).min(sphere.width(level));
            room.clear();
            for (plate, cover) in plates.iter().zip(&covers) {
                room.gather(sphere, plate, cover, (&rows, level, &columns), options);
            }
            if let Some(part) = options.disagreement {
                room.settle(part);
            }
            room.write(&rows, &columns, width, &mut band);
        }
        if level > 0 {
            (0..rows.len()).for_each(|row| widen(row * width..(row + 1) * width, level, &mut band));
        }
        progress.step(done.fetch_add(rows.len(), Ordering::Relaxed) + rows.len(), height)
    })?;
    Ok(merged)
}

impl Cover {
    fn new(plate: &Plate, sphere: &Sphere) -> Self {
        let rows = plate.view.rows(sphere.size);
        let height = sphere.size.height();
        let arcs = rows.clone().map(|row| {
            let first = row / TILE.0 * TILE.0;
            let width = sphere.width(sphere.level(&(first..(first + TILE.0).min(height))));
            columns(&plate.view, sphere.size, row, width)
        });
        let arcs = arcs.collect();
        Self { rows, arcs }
    }
}

impl Room {
    fn new() -> Self {
        let pixels = TILE.0 * TILE.1;
        Self {
            sums: vec![[0.0; 4]; pixels],
            spread: vec![0.0; pixels],
            valid: vec![0.0; pixels],
            count: vec![0; pixels],
            bounds: vec![[0.0; 3]; pixels],
            means: vec![[0.0; 4]; pixels],
            runs: vec![],
            store: vec![],
            doubt: vec![],
        }
    }

    fn clear(&mut self) {
        self.sums.fill([0.0; 4]);
        self.spread.fill(0.0);
        self.valid.fill(0.0);
        self.count.fill(0);
        self.bounds.fill([0.0; 3]);
        self.runs.clear();
        self.store.clear();
        self.doubt.clear();
    }

    fn gather(
        &mut self,
        sphere: &Sphere,
        plate: &Plate,
        cover: &Cover,
        (rows, level, columns): (&Range<usize>, usize, &Range<usize>),
        options: &Options,
    ) {
        let (mut places, mut seen, mut doubt) = (Places::NONE, [[0.0; 4]; CHUNK], [[0.0; 2]; CHUNK]);
        for row in rows.start.max(cover.rows.start)..rows.end.min(cover.rows.end) {
            for &(from, to) in &cover.arcs[row - cover.rows.start] {
                let (from, to) = (from.max(columns.start), to.min(columns.end));
                for first in (from..to).step_by(CHUNK) {
                    let count = CHUNK.min(to - first);
                    look(plate, sphere, (row, level, first..first + count), &mut places, &mut seen);
                    let bounded = weigh(&mut seen, &mut doubt, &places.feather, plate.noise, options.feather);
                    let at = (row - rows.start) * TILE.1 + first - columns.start;
                    let all = at..at + count;
                    if bounded {
                        bound(&mut seen[..count], &doubt, &mut self.bounds[all.clone()]);
                    }
                    add(
                        &seen,
                        &doubt,
                        &mut self.sums[all.clone()],
                        &mut self.spread[all.clone()],
                        &mut self.valid[all.clone()],
                    );
                    let outputs = self.count[all].iter_mut().zip(&places.feather);
                    outputs.for_each(|(n, &feather)| *n += u16::from(feather > 0.0));
                    if options.disagreement.is_some() {
                        self.runs.push(Run { at, stored: self.store.len(), count });
                        self.store.extend_from_slice(&seen[..count]);
                        self.doubt.extend_from_slice(&doubt[..count]);
                    }
                }
            }
        }
    }

    /// Lets photographs that contradict the others count less, more strictly in every round: the mean of the first one
    /// is still that of all.
    fn settle(&mut self, part: f32) {
        if self.count.iter().all(|&count| count < 3) {
            return;
        }
        for strictness in [0.1, 0.3, 1.0] {
            for (mean, sum) in self.means.iter_mut().zip(&self.sums) {
                let inverse = 1.0 / sum[3].max(f32::MIN_POSITIVE);
                *mean = [sum[0] * inverse, sum[1] * inverse, sum[2] * inverse, 0.0];
                mean[3] = part * part / 9.0 * (mean[0] + mean[1] + mean[2]).powi(2);
            }
            self.sums.fill([0.0; 4]);
            self.spread.fill(0.0);
            self.valid.fill(0.0);
            for run in &self.runs {
                let (all, stored) = (run.at..run.at + run.count, run.stored..run.stored + run.count);
                let mut again = [[0.0; 4]; CHUNK];
                judge(
                    &mut again,
                    (&self.store[stored.clone()], &self.doubt[stored.clone()]),
                    (&self.means[all.clone()], &self.count[all.clone()]),
                    strictness,
                );
                add(
                    &again[..run.count],
                    &self.doubt[stored],
                    &mut self.sums[all.clone()],
                    &mut self.spread[all.clone()],
                    &mut self.valid[all],
                );
            }
        }
    }

    fn write(&self, rows: &Range<usize>, columns: &Range<usize>, width: usize, band: &mut Band) {
        let (((radiance, variance), coverage), measured) = band;
        for row in 0..rows.len() {
            let from = row * TILE.1..row * TILE.1 + columns.len();
            let to = row * width + columns.start..row * width + columns.end;
            coverage[to.clone()].copy_from_slice(&self.count[from.clone()]);
            finish(
                &self.sums[from.clone()],
                (&self.spread[from.clone()], &self.valid[from.clone()], &self.bounds[from]),
                &mut radiance[to.clone()],
                (&mut variance[to.clone()], &mut measured[to]),
            );
        }
    }
}

/// Spreads the pixels at the beginning of a row near a pole, every 2^level-th column, over all its columns: by cubic convolution where all
/// four around are seen, else from the nearest.
fn widen(row: Range<usize>, level: usize, (((radiance, variance), coverage), measured): &mut Band) {
    let (step, width) = (1 << level, row.len() >> level);
    let (radiance, variance) = (&mut radiance[row.clone()], &mut variance[row.clone()]);
    let (coverage, measured) = (&mut coverage[row.clone()], &mut measured[row]);
    let few = radiance[..width].to_vec();
    let (doubt, seen, valid) =
        (variance[..width].to_vec(), coverage[..width].to_vec(), measured[..width].to_vec());
    // The weights of the four columns around for each place between two.
    let weights: Vec<[f32; 4]> = (0..step)
        .map(|i| {
            let t = (i as f32 + 0.5) / step as f32;
            let s = 1.0 - t;
            [-0.5 * t * s * s, 1.0 + t * t * (1.5 * t - 2.5), 1.0 + s * s * (1.5 * s - 2.5), -0.5 * s * t * t]
        })
        .collect();
    for left in 0..width {
        let around = [left + width - 1, left, left + 1, left + 2].map(|i| i % width);
        let whole = around.iter().all(|&i| seen[i] > 0);
        for (i, weights) in weights.iter().enumerate() {
            let to = (left * step + step / 2 + i) % radiance.len();
            let nearest = around[if 2 * i < step { 1 } else { 2 }];
            (variance[to], coverage[to], measured[to]) = (doubt[nearest], seen[nearest], valid[nearest]);
            radiance[to] = if whole {
                let [a, b, c, d] = around.map(|i| few[i]);
                [0, 1, 2].map(|k| {
                    (weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k] + weights[3] * d[k]).max(0.0)
                })
            } else {
                few[nearest]
            };
        }
    }
}

/// Turns what a plate shows into weight times radiance and weight, and says its variance and validity; whether lower bounds are among it.
#[multiversion(targets("x86_64+avx2+fma"))]
fn weigh(
    seen: &mut [[f32; 4]; CHUNK],
    doubt: &mut [[f32; 2]; CHUNK],
    feather: &[f32; CHUNK],
    noise: Noise,
    power: u32,
) -> bool {
    let mut soft = feather.map(|feather| if feather > 0.0 { 1.0 } else { 0.0 });
    for _ in 0..power {
        // What is next to nothing stays more than nothing.
        soft.iter_mut()
            .zip(feather)
            .for_each(|(soft, feather)| *soft = (*soft * feather).max(1e-12 * feather));
    }
    let mut bounded = false;
    // Scalars of all pixels first, many at a time.
    for ((soft, seen), doubt) in soft.iter_mut().zip(seen.iter()).zip(doubt) {
        let [r, g, b, valid] = *seen;
        // A filter may go below 0 beside what was not measured.
        let known = valid > 1e-20;
        let variance = if known { noise.variance((r + g + b) / (3.0 * valid)) } else { 1.0 };
        *soft = if known { *soft / variance } else { 0.0 };
        bounded |= *soft > 0.0 && valid < MEASURED;
        *doubt = [variance, valid.clamp(0.0, 1.0)];
    }
    for (seen, factor) in seen.iter_mut().zip(&soft) {
        seen.iter_mut().for_each(|value| *value *= factor);
    }
    bounded
}

/// Takes what was not measured out of what is summed, and keeps the largest: however little a measurement counts, it is one.
fn bound(seen: &mut [[f32; 4]], doubt: &[[f32; 2]], bounds: &mut [[f32; 3]]) {
    for ((seen, doubt), bound) in seen.iter_mut().zip(doubt).zip(bounds) {
        if seen[3] > 0.0 && doubt[1] < MEASURED {
            (0..3).for_each(|c| bound[c] = bound[c].max(seen[c] / seen[3]));
            *seen = [0.0; 4];
        }
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn add(seen: &[[f32; 4]], doubt: &[[f32; 2]], sums: &mut [[f32; 4]], spread: &mut [f32], valid: &mut [f32]) {
    for (sum, seen) in sums.iter_mut().zip(seen) {
        (0..4).for_each(|c| sum[c] += seen[c]);
    }
    for ((spread, valid), (seen, doubt)) in spread.iter_mut().zip(valid).zip(seen.iter().zip(doubt)) {
        // In this order no product leaves what floats can hold.
        *spread += seen[3] * (seen[3] * doubt[0]);
        *valid += seen[3] * doubt[1];
    }
}

/// A row's means from its sums, which a filter may make negative, or its bounds; the variance is infinite where nothing was measured.
#[multiversion(targets("x86_64+avx2+fma"))]
fn finish(
    sums: &[[f32; 4]],
    (spread, valid, bounds): (&[f32], &[f32], &[[f32; 3]]),
    radiance: &mut [[f32; 3]],
    (variance, measured): (&mut [f32], &mut [f32]),
) {
    for ((radiance, sum), bound) in radiance.iter_mut().zip(sums).zip(bounds) {
        let inverse = 1.0 / sum[3].max(f32::MIN_POSITIVE);
        let mean = [0, 1, 2].map(|c| (sum[c] * inverse).max(0.0));
        *radiance = if sum[3] > 0.0 { mean } else { *bound };
    }
    let outputs = variance.iter_mut().zip(measured);
    for ((variance, measured), (sum, (spread, valid))) in
        outputs.zip(sums.iter().zip(spread.iter().zip(valid)))
    {
        let inverse = 1.0 / sum[3].max(f32::MIN_POSITIVE);
        *variance = if sum[3] > 0.0 { spread * inverse * inverse } else { f32::INFINITY };
        *measured = valid * inverse;
    }
}

/// The stored pixels with weights that fall with how much they contradict the mean.
#[multiversion(targets("x86_64+avx2+fma"))]
fn judge(
    again: &mut [[f32; 4]; CHUNK],
    (store, doubt): (&[[f32; 4]], &[[f32; 2]]),
    (means, count): (&[[f32; 4]], &[u16]),
    strictness: f32,
) {
    for ((again, (said, doubt)), (mean, &count)) in
        again.iter_mut().zip(store.iter().zip(doubt)).zip(means.iter().zip(count))
    {
        let inverse = 1.0 / said[3].max(f32::MIN_POSITIVE);
        let away = [said[0] * inverse - mean[0], said[1] * inverse - mean[1], said[2] * inverse - mean[2]];
        let square = (away[0] * away[0] + away[1] * away[1] + away[2] * away[2]) * (1.0 / 3.0);
        // Three standard deviations are still nothing special.
        let ratio = strictness * square / (9.0 * (doubt[0] + mean[3])).max(f32::MIN_POSITIVE);
        let ratio = ratio.min(1e3);
        let trust = if count < 3 { 1.0 } else { 1.0 / ((1.0 + ratio) * (1.0 + ratio)) };
        *again = said.map(|value| value * trust);
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::environment::{EnvironmentMap, Filter};
    use crate::geometry::{LatLong, Lens, world_from_camera};
    use crate::progress::Silent;

    const OPTIONS: Options = Options { feather: 4, disagreement: Some(0.1) };

    fn size() -> LatLong {
        LatLong::new(512, 256).unwrap()
    }

    fn plate(focal: f64, yaw: f64, pixel: impl Fn(usize) -> [f32; 4]) -> Plate {
        let lens = Lens::pinhole(160, 120, focal);
        let turn = world_from_camera(DQuat::from_axis_angle(DVec3::Y, yaw));
        let noise = Noise { constant: 1e-6, linear: 1e-4, square: 1e-5 };
        Plate::new(size(), &lens, turn, pixel, noise, Filter::Bicubic).unwrap()
    }

    #[test]
    fn a_lamp_has_no_black_ring_saturated_or_not_and_the_map_can_be_read() {
        const GROUND: f32 = 0.003;
        // The second and third are made smaller first.
        for focal in [80.0, 150.0, 400.0] {
            for valid in [1.0, 1e-4] {
                let lamp = |i: usize| {
                    let (x, y) = ((i % 160) as f32 - 83.3, (i / 160) as f32 - 57.9);
                    if x * x + y * y < 300.0 { [1.0, 1.0, 1.0, valid] } else { [GROUND, GROUND, GROUND, 1.0] }
                };
                let merged =
                    merge(&Sphere::new(size()), &[plate(focal, 0.3, lamp)], &OPTIONS, &Silent).unwrap();
                let seen = || (0..size().count()).filter(|&i| merged.coverage[i] > 0);
                for i in seen() {
                    let radiance = merged.radiance[i][1];
                    assert!((0.7 * GROUND..1.2).contains(&radiance), "{focal} {valid} {i} {radiance}");
                }
                let bounded = seen().filter(|&i| merged.measured[i] < 0.5).count();
                assert_eq!(bounded > 0, valid < 0.5);
                assert!(seen().any(|i| merged.radiance[i][1] > 0.95));
                let folder = tempfile::tempdir().unwrap();
                let file = folder.path().join("map.exr");
                let map = EnvironmentMap {
                    size: size(),
                    radiance: merged.radiance,
                    variance: merged.variance,
                    coverage: merged.coverage,
                    flags: vec![0; size().count()],
                    unit: Default::default(),
                    curve: vec![],
                };
                map.write(&file).unwrap();
                assert_eq!(EnvironmentMap::read(&file).unwrap().radiance, map.radiance);
            }
        }
    }

    #[test]
    fn what_was_measured_at_a_border_stands_against_any_lower_bound() {
        let flat = |radiance: f32, valid: f32| move |_: usize| [radiance, radiance, radiance, valid];
        let make = |plates: &[Plate]| merge(&Sphere::new(size()), plates, &OPTIONS, &Silent).unwrap();
        let measured = make(&[plate(80.0, 0.6, flat(5.0, 1.0))]);
        let all = make(&[
            plate(80.0, 0.0, flat(2.0, 1e-4)),
            plate(80.0, 0.1, flat(1.0, 1e-4)),
            plate(80.0, 0.6, flat(5.0, 1.0)),
        ]);
        let mut bounds = 0;
        for i in (0..size().count()).filter(|&i| all.coverage[i] > 0) {
            if measured.coverage[i] > 0 {
                assert!((all.radiance[i][0] - 5.0).abs() < 1e-3 && all.measured[i] > 0.99, "{i}");
                assert!(all.variance[i] > 1e-6 && all.variance[i] < 1e-2, "{}", all.variance[i]);
            } else {
                assert!(all.measured[i] == 0.0 && all.variance[i] == f32::INFINITY);
                if all.coverage[i] == 2 {
                    assert!(
                        (all.radiance[i][0] - 2.0).abs() < 1e-3,
                        "the larger bound: {:?}",
                        all.radiance[i]
                    );
                    bounds += 1;
                }
            }
        }
        assert!(bounds > 100);
    }
}

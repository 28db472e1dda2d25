//! What one view shows of the surface, as a map of it.

use glam::{DVec2, DVec3};

use crate::calibration::luminance::Luminance;
use crate::calibration::median;
use crate::calibration::rig_model::Seen;
use crate::geometry::{Lens, Surface};

/// Nodes on a part of the surface's plane, row by row from the lowest x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    pub low_m: DVec2,
    pub spacing_m: f64,
    pub columns: usize,
    pub rows: usize,
}

impl Grid {
    /// Over the surface and a margin of so many nodes around it.
    pub fn over(surface: &Surface, spacing_m: f64, margin: usize) -> Self {
        let nodes = |length_m: f64| (length_m / spacing_m).floor() as usize + 1 + 2 * margin;
        let (columns, rows) = (nodes(surface.width_m), nodes(surface.height_m));
        let extent = DVec2::new((columns - 1) as f64, (rows - 1) as f64) * spacing_m;
        Self { low_m: -extent / 2.0, spacing_m, columns, rows }
    }

    pub fn place_m(&self, node: DVec2) -> DVec3 {
        (self.low_m + node * self.spacing_m).extend(0.0)
    }

    fn node(&self, place_m: DVec3) -> DVec2 {
        (place_m.truncate() - self.low_m) / self.spacing_m
    }

    pub fn count(&self) -> usize {
        self.columns * self.rows
    }
}

/// Numbers on a grid's nodes; NaN where nothing is known.
#[derive(Debug, Clone)]
pub struct Sheet {
    pub grid: Grid,
    pub value: Vec<f32>,
}

impl Sheet {
    /// Between four nodes; NaN unless all are known.
    pub fn at(&self, node: DVec2) -> f32 {
        let (x, y) = (node.x.floor(), node.y.floor());
        let inside =
            x >= 0.0 && y >= 0.0 && x + 1.0 < self.grid.columns as f64 && y + 1.0 < self.grid.rows as f64;
        if !inside {
            return f32::NAN;
        }
        let (fx, fy) = ((node.x - x) as f32, (node.y - y) as f32);
        let first = y as usize * self.grid.columns + x as usize;
        let [a, b] = [self.value[first], self.value[first + 1]];
        let [c, d] = [self.value[first + self.grid.columns], self.value[first + self.grid.columns + 1]];
        (a + fx * (b - a)) * (1.0 - fy) + (c + fx * (d - c)) * fy
    }

    /// Means of 2 x 2 nodes.
    fn halved(&self) -> Self {
        let Grid { low_m, spacing_m, columns, rows } = self.grid;
        let grid = Grid {
            low_m: low_m + spacing_m / 2.0,
            spacing_m: 2.0 * spacing_m,
            columns: columns / 2,
            rows: rows / 2,
        };
        let mean = |i: usize| {
            let first = 2 * (i / grid.columns) * columns + 2 * (i % grid.columns);
            let row = |first: usize| self.value[first] + self.value[first + 1];
            (row(first) + row(first + columns)) / 4.0
        };
        Self { grid, value: (0..grid.count()).map(mean).collect() }
    }
}

/// The logarithm of a view's radiance over the surface and a margin, as a lens and a pose have it.
pub struct Plate {
    /// The finest first, each of half the spacing of the next.
    levels: Vec<Sheet>,
    lens: Lens,
    seen: Seen,
    /// Noise of a pixel relative to its radiance (median).
    pub noise: f32,
}

/// What is less sure than this part of it tells no texture: clipped, too dark.
const DOUBTFUL: f32 = 0.3;
/// Every so many nodes the noise is looked at.
const NOISE_STEP: usize = 37;
/// Between so many nodes where a map leads is interpolated.
const LATTICE: usize = 6;

impl Plate {
    pub fn new(picture: &Luminance, lens: &Lens, seen: Seen, grid: Grid, levels: usize) -> Self {
        // A node that covers several pixels is their mean: else fine texture would alias.
        let across_m = seen.origin_m.z / lens.fx.max(lens.fy);
        let by = ((grid.spacing_m / across_m).round() as usize).max(1);
        let reduced;
        let picture = match by {
            1 => picture,
            _ => {
                reduced = picture.reduced(by);
                &reduced
            }
        };
        let at = lattice(grid, &|place| {
            let at = lens.project(seen.to_camera(place))?;
            Some((at + 0.5) / by as f64 - 0.5)
        });
        let value = at.iter().map(|&at| log_between(picture, at).unwrap_or(f32::NAN)).collect();
        let noise = |at: &DVec2| {
            let inside = at.x >= 0.0 && at.y >= 0.0;
            let (x, y) = (at.x as usize, at.y as usize);
            if !inside || x >= picture.width || y >= picture.height {
                return None;
            }
            let (value, variance) =
                (picture.value[y * picture.width + x], picture.variance[y * picture.width + x]);
            (value > 0.0 && variance.is_finite()).then(|| f64::from(variance.sqrt() / value))
        };
        let noise = median(&at.iter().step_by(NOISE_STEP).filter_map(noise).collect::<Vec<_>>()) as f32;
        let mut sheets = vec![Sheet { grid, value }];
        for level in 1..levels {
            sheets.push(sheets[level - 1].halved());
        }
        Self { levels: sheets, lens: *lens, seen, noise }
    }

    /// Where on the plate's plane lies what another lens and pose have at `place_m`.
    fn place_m(&self, lens: &Lens, seen: &Seen, place_m: DVec3) -> Option<DVec3> {
        let ray = self.lens.unproject(lens.project(seen.to_camera(place_m))?)?;
        let surface_from_camera = self.seen.rotation.transpose();
        let centre_m = -(surface_from_camera * self.seen.origin_m);
        let along = surface_from_camera * ray;
        if along.z >= 0.0 {
            return None;
        }
        Some(centre_m - along * (centre_m.z / along.z))
    }

    /// The plate as a lens and a pose have it, on a grid.
    pub fn seen_from(&self, lens: &Lens, seen: &Seen, grid: Grid) -> Sheet {
        let finest_m = self.levels[0].grid.spacing_m;
        let level = (grid.spacing_m / finest_m).log2().round().max(0.0) as usize;
        let source = &self.levels[level.min(self.levels.len() - 1)];
        let at = lattice(grid, &|place| Some(source.grid.node(self.place_m(lens, seen, place)?)));
        let value = at.iter().map(|&node| source.at(node)).collect();
        Sheet { grid, value }
    }
}

/// A smooth map at all nodes from its values at some; NaN where there is none.
fn lattice(grid: Grid, map: &dyn Fn(DVec3) -> Option<DVec2>) -> Vec<DVec2> {
    let (columns, rows) = (grid.columns.div_ceil(LATTICE) + 1, grid.rows.div_ceil(LATTICE) + 1);
    let corner = |i: usize| {
        let node = DVec2::new((i % columns) as f64, (i / columns) as f64) * LATTICE as f64;
        map(grid.place_m(node)).unwrap_or(DVec2::NAN)
    };
    let corners: Vec<DVec2> = (0..columns * rows).map(corner).collect();
    let mut all = Vec::with_capacity(grid.count());
    for row in 0..grid.rows {
        let first = row / LATTICE * columns;
        let down = (row % LATTICE) as f64 / LATTICE as f64;
        let side = |i: usize| corners[first + i].lerp(corners[first + columns + i], down);
        for i in 0..columns - 1 {
            let (left, right) = (side(i), side(i + 1));
            let until = ((i + 1) * LATTICE).min(grid.columns);
            all.extend(
                (i * LATTICE..until)
                    .map(|column| left.lerp(right, (column - i * LATTICE) as f64 / LATTICE as f64)),
            );
        }
    }
    all
}

/// Logarithm of what lies between four pixels; `None` unless all are well known.
fn log_between(picture: &Luminance, pixel: DVec2) -> Option<f32> {
    let (x, y) = (pixel.x.floor(), pixel.y.floor());
    if x < 0.0 || y < 0.0 || x + 1.0 >= picture.width as f64 || y + 1.0 >= picture.height as f64 {
        return None;
    }
    let (fx, fy) = ((pixel.x - x) as f32, (pixel.y - y) as f32);
    let first = y as usize * picture.width + x as usize;
    let mut sum = 0.0;
    for (index, weight) in [
        (first, (1.0 - fx) * (1.0 - fy)),
        (first + 1, fx * (1.0 - fy)),
        (first + picture.width, (1.0 - fx) * fy),
        (first + picture.width + 1, fx * fy),
    ] {
        let (value, variance) = (picture.value[index], picture.variance[index]);
        if value <= 0.0 || variance > (DOUBTFUL * value).powi(2) {
            return None;
        }
        sum += weight * value;
    }
    Some(sum.ln())
}

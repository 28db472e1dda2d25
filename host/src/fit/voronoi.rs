//! Solid angles of the Voronoi cells of directions on the upper hemisphere.

use std::f64::consts::PI;
use std::sync::OnceLock;

use glam::DVec3;

use super::harmonics::hemisphere;

/// Points at which the cells are counted: a cell's solid angle is right to a few percent for a hundred directions.
const LATTICE: usize = 4096;

/// The solid angle of each direction's Voronoi cell on the upper hemisphere, steradian; they sum to 2π.
///
/// Counted over a fixed lattice on the sphere: measured in the plane and divided by the cosine of the zenith, as in the
/// thesis, cells blow up at the horizon.
pub(super) fn cells_sr(directions: &[DVec3]) -> Vec<f64> {
    let mut closeness = vec![f32::NEG_INFINITY; LATTICE];
    let mut nearest = vec![0u32; LATTICE];
    let [xs, ys, zs] = lattice();
    // The lattice inside, one coordinate after the other: this loop runs on vectors of numbers.
    for (i, direction) in directions.iter().map(|d| d.as_vec3()).enumerate() {
        let points = xs.iter().zip(ys).zip(zs);
        for ((best, nearest), ((x, y), z)) in closeness.iter_mut().zip(&mut nearest).zip(points) {
            let closer = direction.x * x + direction.y * y + direction.z * z;
            *nearest = if closer > *best { i as u32 } else { *nearest };
            *best = closer.max(*best);
        }
    }
    let mut cells = vec![0.0; directions.len()];
    if !directions.is_empty() {
        nearest.iter().for_each(|&i| cells[i as usize] += 2.0 * PI / LATTICE as f64);
    }
    cells
}

fn lattice() -> &'static [Vec<f32>; 3] {
    static POINTS: OnceLock<[Vec<f32>; 3]> = OnceLock::new();
    POINTS.get_or_init(|| [0, 1, 2].map(|axis| hemisphere(LATTICE).map(|point| point[axis] as f32).collect()))
}

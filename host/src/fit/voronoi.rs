//! Solid angles of the Voronoi cells of directions on the upper hemisphere.

use std::f64::consts::PI;

use glam::DVec3;

use super::harmonics::hemisphere;

/// The solid angle of each direction's Voronoi cell on the upper hemisphere, steradian; they sum to 2π.
///
/// Counted over a fixed lattice on the sphere, to a few percent of a cell: measured in the plane and divided by the
/// cosine of the zenith, as in the thesis, cells blow up at the horizon.
pub(super) fn cells_sr(directions: &[DVec3]) -> Vec<f64> {
    let lattice = 8192;
    let mut cells = vec![0.0; directions.len()];
    for point in hemisphere(lattice) {
        let nearest =
            directions.iter().enumerate().map(|(i, d)| (i, d.dot(point))).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((nearest, _)) = nearest {
            cells[nearest] += 2.0 * PI / lattice as f64;
        }
    }
    cells
}

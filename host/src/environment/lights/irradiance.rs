//! The irradiance on which lights are compared.

use glam::DVec3;
use rayon::prelude::*;

use crate::environment::lattice::evenly;

/// Orientations of a surface on which the irradiance is compared.
const ORIENTATIONS: usize = 128;
/// Walls through the point, each of which hides half of the sphere.
const WALLS: usize = 16;
/// An orientation's values: open, and behind each wall.
const VALUES: usize = 1 + WALLS;

/// Red, green and blue irradiance on surfaces of many orientations, open, and then behind each of some walls.
pub(super) struct Irradiance(pub(super) Vec<[f64; 3]>);

impl Irradiance {
    /// Of lights: unit vectors and irradiance on a surface that faces them.
    pub fn of(lights: impl Iterator<Item = (DVec3, [f64; 3])>) -> Self {
        let walls: Vec<DVec3> = (0..WALLS).map(|i| evenly(i, WALLS)).collect();
        let normals: Vec<DVec3> = (0..ORIENTATIONS).map(|i| evenly(i, ORIENTATIONS)).collect();
        let behind = |direction: DVec3| -> [f64; VALUES] {
            std::array::from_fn(|i| if i == 0 || walls[i - 1].dot(direction) > 0.0 { 1.0 } else { 0.0 })
        };
        let lights: Vec<_> = lights.map(|(direction, light)| (direction, light, behind(direction))).collect();
        let of = |normal: &DVec3| {
            let mut sums = [[0.0; 3]; VALUES];
            for (direction, light, open) in &lights {
                let cosine = normal.dot(*direction);
                if cosine <= 0.0 {
                    continue;
                }
                let from = light.map(|value| cosine * value);
                for (sum, open) in sums.iter_mut().zip(open) {
                    (0..3).for_each(|c| sum[c] += open * from[c]);
                }
            }
            sums
        };
        Self(normals.par_iter().flat_map_iter(of).collect())
    }

    pub fn without(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(own, other)| [0, 1, 2].map(|c| own[c] - other[c])).collect())
    }

    /// The root of the sum of squares.
    pub fn size(&self) -> f64 {
        self.0.iter().flatten().map(|value| value * value).sum::<f64>().sqrt()
    }

    /// The same where nothing is hidden.
    pub fn open_size(&self) -> f64 {
        self.0.iter().step_by(VALUES).flatten().map(|value| value * value).sum::<f64>().sqrt()
    }
}

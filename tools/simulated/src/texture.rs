//! What lies between the squares: texture that is the same from all sides, and a lamp's mirror image that is not.

use glam::{DVec2, DVec3};
use rigel::geometry::unit_vector;

/// How the surface's colour varies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Grain {
    /// Not at all.
    Even,
    /// By chance, in spots of 3 to 24 mm.
    Random,
    /// The same, but only where x is negative.
    Half,
    /// By chance, and again after so many metres along x and y.
    Repeated {
        /// After how many.
        period_m: f64,
    },
}

/// A surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Texture {
    /// Its colour.
    pub grain: Grain,
    /// How much brighter than the surface a lamp is mirrored in it.
    pub gloss: f64,
}

/// Radiance of the surface in the middle, and standard deviation of its logarithm (about).
const LEVEL: f64 = 0.35;
const CONTRAST: f64 = 0.3;
/// The lamp's distance in metres, and how sharply it is mirrored.
const LAMP_M: f64 = 0.7;
const SHININESS: f64 = 80.0;

impl Texture {
    /// Radiance of a point of the surface towards the unit vector `viewer`.
    pub fn radiance(&self, point_m: DVec3, viewer: DVec3) -> f64 {
        let p = point_m.truncate();
        let spots = |sizes_m: &[f64], period_m: Option<f64>| -> f64 {
            sizes_m
                .iter()
                .map(|&size_m| spot(p / size_m, period_m.map(|period_m| (period_m / size_m) as i64)))
                .sum()
        };
        let random = || spots(&[0.024, 0.012, 0.006, 0.003], None);
        let grain = match self.grain {
            Grain::Even => 0.0,
            Grain::Random => random(),
            Grain::Half => {
                if p.x < 0.0 {
                    random()
                } else {
                    0.0
                }
            }
            Grain::Repeated { period_m } => spots(&[period_m / 2.0, period_m / 4.0], Some(period_m)),
        };
        let lamp = (unit_vector(2.2, 0.6) * LAMP_M - point_m).normalize();
        let mirrored = DVec3::new(-lamp.x, -lamp.y, lamp.z);
        LEVEL * ((CONTRAST * grain).exp() + self.gloss * mirrored.dot(viewer).max(0.0).powf(SHININESS))
    }
}

/// Smooth chance with a standard deviation of about a half, the same again after `period` steps.
fn spot(at: DVec2, period: Option<i64>) -> f64 {
    let cell = at.floor();
    let ease = (at - cell) * (at - cell) * (3.0 - 2.0 * (at - cell));
    let value = |dx: i64, dy: i64| {
        let wrap = |i: i64| period.map_or(i, |period| i.rem_euclid(period));
        let (x, y) = (wrap(cell.x as i64 + dx) as u64, wrap(cell.y as i64 + dy) as u64);
        // A hash (splitmix64).
        let mut z = x.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ y.wrapping_mul(0xd1b5_4a32_d192_ed03);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
    };
    let row = |dy: i64| value(0, dy) + ease.x * (value(1, dy) - value(0, dy));
    row(0) + ease.y * (row(1) - row(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_texture_repeats_and_random_texture_does_not() {
        let point = DVec3::new(-0.013, 0.021, 0.0);
        let on = DVec3::new(0.01, 0.0, 0.0);
        let differs = |grain: Grain| {
            let texture = Texture { grain, gloss: 0.0 };
            (texture.radiance(point, DVec3::Z) - texture.radiance(point + on, DVec3::Z)).abs()
        };
        assert!(differs(Grain::Repeated { period_m: 0.01 }) < 1e-9);
        assert!(differs(Grain::Random) > 1e-3);
        assert_eq!(differs(Grain::Even), 0.0);
        assert!(differs(Grain::Half) > 1e-3);
    }

    #[test]
    fn a_mirrored_lamp_is_seen_from_one_side() {
        let texture = Texture { grain: Grain::Even, gloss: 10.0 };
        let lamp = unit_vector(2.2, 0.6);
        let mirrored = DVec3::new(-lamp.x, -lamp.y, lamp.z);
        assert!(texture.radiance(DVec3::ZERO, mirrored) > 5.0 * texture.radiance(DVec3::ZERO, lamp));
    }
}

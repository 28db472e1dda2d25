//! From where to look: view directions over the surface, and the order in which a rig visits them.
//!
//! A view is the unit vector from the surface's origin to the camera, in the surface's frame. The schemes are those of
//! chapter 8 of "the thesis" (2007), with its oversampled pole corrected; all of them are deterministic.

use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

use crate::geometry::{azimuth_zenith, unit_vector};
use crate::{Error, Result};

mod table;
mod tour;

pub use table::read_directions;
pub use tour::{Stop, in_order, is_reachable, tour, tour_time_s};

/// The most views of a sampling: the tour's table of all pairs then takes 3 GB.
const MOST_VIEWS: usize = 20_000;

/// Pan and tilt, radians, at which the rig shows the surface to its camera from `direction`: the inverse of
/// [`crate::geometry::Pose::from_rig`]. The pan lies in (-π, π] and is 0 at the pole, the tilt is the zenith.
pub fn pan_tilt(direction: DVec3) -> (f64, f64) {
    let (azimuth_rad, zenith_rad) = azimuth_zenith(direction);
    if zenith_rad == 0.0 {
        return (0.0, 0.0);
    }
    let pan_rad = (FRAC_PI_2 - azimuth_rad).rem_euclid(TAU);
    (if pan_rad > PI { pan_rad - TAU } else { pan_rad }, zenith_rad)
}

/// `count` views on a spiral (thesis 8.1.1) from the pole to `zenith_limit_rad`, each for the same area.
///
/// The thesis lets the zenith grow evenly, which crowds the pole; here its cosine falls evenly, and the turns are as far
/// apart as the views along them.
///
/// # Errors
/// No view at all, more than 20 000, or a limit outside (0, π/2].
pub fn spiral(count: usize, zenith_limit_rad: f64) -> Result<Vec<DVec3>> {
    check(count, zenith_limit_rad)?;
    let cap = 1.0 - zenith_limit_rad.cos();
    let azimuth_per_zenith = TAU / (TAU * cap / count as f64).sqrt();
    Ok((0..count)
        .map(|i| {
            let zenith_rad = zenith_at(cap * i as f64 / (count.max(2) - 1) as f64);
            unit_vector(azimuth_per_zenith * zenith_rad, zenith_rad)
        })
        .collect())
}

/// The vertices of a regular icosahedron whose triangles were divided into four `subdivisions` times (thesis 8.1.2),
/// those above the horizon and up to `zenith_limit_rad`, by zenith. An edge's middle is the pole.
///
/// On the whole hemisphere that makes the thesis's 17, 73 and 305 views for 1, 2 and 3 subdivisions; the vertices in
/// the surface's own plane, from where nothing of it is seen, are not among them.
///
/// # Errors
/// More than 6 subdivisions or 20 000 views, or a limit outside (0, π/2].
pub fn icosphere(subdivisions: u32, zenith_limit_rad: f64) -> Result<Vec<DVec3>> {
    check(1, zenith_limit_rad)?;
    if subdivisions > 6 {
        return Err(Error::request(
            format!("{subdivisions} subdivisions make more views than anybody photographs"),
            "choose at most 6",
        ));
    }
    let (mut vertices, mut faces) = icosahedron();
    for _ in 0..subdivisions {
        let mut middles = HashMap::new();
        let mut finer = Vec::with_capacity(4 * faces.len());
        for [a, b, c] in faces {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(i, j)| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    vertices.push((vertices[i] + vertices[j]).normalize());
                    vertices.len() - 1
                })
            });
            finer.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
        }
        faces = finer;
    }
    vertices.retain(|v| v.z > 1e-9 && azimuth_zenith(*v).1 <= zenith_limit_rad + 1e-9);
    check(vertices.len().max(1), zenith_limit_rad)?;
    let key = |v: &DVec3| {
        let (azimuth_rad, zenith_rad) = azimuth_zenith(*v);
        // Vertices of one ring differ in their last bits.
        ((zenith_rad * 1e9).round() as i64, (azimuth_rad * 1e9).round() as i64)
    };
    vertices.sort_by_key(key);
    Ok(vertices)
}

/// The icosphere whose number of views within the limit comes nearest to `count`.
///
/// # Errors
/// No view at all, more than 20 000, or a limit outside (0, π/2].
pub fn icosphere_near(count: usize, zenith_limit_rad: f64) -> Result<Vec<DVec3>> {
    check(count, zenith_limit_rad)?;
    nearest((0..=5).map(|subdivisions| icosphere(subdivisions, zenith_limit_rad)), count)
}

/// The latitude-longitude views whose number within the limit comes nearest to `count`.
///
/// # Errors
/// No view at all, more than 20 000, or a limit outside (0, π/2].
pub fn latitude_longitude_near(count: usize, zenith_limit_rad: f64) -> Result<Vec<DVec3>> {
    check(count, zenith_limit_rad)?;
    nearest((1..=40).map(|rings| latitude_longitude(rings, zenith_limit_rad)), count)
}

fn nearest(choices: impl Iterator<Item = Result<Vec<DVec3>>>, count: usize) -> Result<Vec<DVec3>> {
    let choices: Vec<Vec<DVec3>> = choices.collect::<Result<_>>()?;
    Ok(choices.into_iter().min_by_key(|views| views.len().abs_diff(count)).unwrap_or_default())
}

/// Rings of views at `rings` even steps of the zenith, the last at `zenith_limit_rad`, and one at the pole (thesis
/// 8.1.3). The number of views in a ring follows the sine of its zenith, so that they are as far apart as the rings.
///
/// # Errors
/// No ring at all, more than 20 000 views, or a limit outside (0, π/2].
pub fn latitude_longitude(rings: usize, zenith_limit_rad: f64) -> Result<Vec<DVec3>> {
    check(rings, zenith_limit_rad)?;
    let step_rad = zenith_limit_rad / rings as f64;
    let mut views = vec![DVec3::Z];
    for ring in 1..=rings {
        let zenith_rad = step_rad * ring as f64;
        let count = ((TAU * zenith_rad.sin() / step_rad).round() as usize).max(3);
        check(views.len() + count, zenith_limit_rad)?;
        // Every other ring is turned by half a step, which leaves smaller holes.
        let turn = 0.5 * (ring % 2) as f64;
        views.extend((0..count).map(|i| unit_vector(TAU * (i as f64 + turn) / count as f64, zenith_rad)));
    }
    Ok(views)
}

/// `count` random views, one in each of `count` cells of equal area and about equal sides (stratified sampling, thesis
/// 8.2), down to `zenith_limit_rad`. The same seed gives the same views in every release.
///
/// # Errors
/// No view at all, more than 20 000, or a limit outside (0, π/2].
pub fn stratified(count: usize, zenith_limit_rad: f64, seed: u64) -> Result<Vec<DVec3>> {
    check(count, zenith_limit_rad)?;
    let cap = 1.0 - zenith_limit_rad.cos();
    let side_rad = (TAU * cap / count as f64).sqrt();
    let rings = ((zenith_limit_rad / side_rad).round() as usize).clamp(1, count);
    let mut random = SplitMix(seed);
    let mut views = Vec::with_capacity(count);
    for ring in 1..=rings {
        // As many cells as fill the cap down to this ring's nominal end; its true end then follows from their area.
        let ideal = count as f64 * (1.0 - (zenith_limit_rad * ring as f64 / rings as f64).cos()) / cap;
        let end = (ideal.round() as usize).clamp(views.len(), count);
        let begin = views.len();
        let cells = end - begin;
        for cell in 0..cells {
            let share = begin as f64 + random.unit() * cells as f64;
            let azimuth_rad = TAU * (cell as f64 + random.unit()) / cells as f64;
            views.push(unit_vector(azimuth_rad, zenith_at(cap * share / count as f64)));
        }
    }
    Ok(views)
}

/// The zenith whose cosine is `1 - fall`; exact at both ends.
fn zenith_at(fall: f64) -> f64 {
    // acos loses half the digits near 1, this does not.
    2.0 * (fall / 2.0).sqrt().min(1.0).asin()
}

fn check(count: usize, zenith_limit_rad: f64) -> Result<()> {
    if count == 0 {
        return Err(Error::request("a sampling of no views", "ask for at least one view"));
    }
    if count > MOST_VIEWS {
        return Err(Error::request(
            format!("a sampling of {count} views"),
            format!("ask for at most {MOST_VIEWS}"),
        ));
    }
    if !(zenith_limit_rad > 0.0 && zenith_limit_rad <= FRAC_PI_2 + 1e-9) {
        return Err(Error::request(
            format!("a zenith limit of {:.3}°", zenith_limit_rad.to_degrees()),
            "choose a limit above 0° and up to 90°",
        ));
    }
    Ok(())
}

/// Corners and triangles of the regular icosahedron that has edges, not corners, at its poles.
fn icosahedron() -> (Vec<DVec3>, Vec<[usize; 3]>) {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut vertices = Vec::new();
    for (long, short) in [(golden, 1.0), (golden, -1.0), (-golden, 1.0), (-golden, -1.0)] {
        vertices.push(DVec3::new(0.0, short, long).normalize());
        vertices.push(DVec3::new(short, long, 0.0).normalize());
        vertices.push(DVec3::new(long, 0.0, short).normalize());
    }
    // Neighbours are as far apart as an edge is long; all others are at least 1.6 times as far.
    let edge = 2.0 / (1.0 + golden * golden).sqrt();
    let near = |a: usize, b: usize| vertices[a].distance(vertices[b]) < 1.1 * edge;
    let mut faces = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    faces.push([a, b, c]);
                }
            }
        }
    }
    (vertices, faces)
}

/// Steele, Lea & Flood, "Fast splittable pseudorandom number generators" (2014): the numbers of a seed never change,
/// which no library of random numbers promises.
struct SplitMix(u64);

impl SplitMix {
    /// The next number in [0, 1).
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    const LIMITS_RAD: [f64; 3] = [FRAC_PI_2, 1.309, 0.4];

    /// Every scheme at a limit, with the largest covering radius that it may have, in units of the best possible one.
    fn schemes(limit_rad: f64) -> Vec<(&'static str, Vec<DVec3>, f64)> {
        vec![
            // Its last turn reaches the limit at one end alone.
            ("spiral", spiral(200, limit_rad).unwrap(), 1.9),
            // It leaves the horizon out.
            ("icosphere", icosphere(3, limit_rad).unwrap(), 1.9),
            ("latitude-longitude", latitude_longitude(9, limit_rad).unwrap(), 1.3),
            ("stratified", stratified(200, limit_rad, 7).unwrap(), 2.2),
        ]
    }

    #[test]
    fn views_are_unit_vectors_within_the_limit_and_no_two_coincide() {
        for limit_rad in LIMITS_RAD {
            for (name, views, _) in schemes(limit_rad) {
                assert!(views.iter().all(|v| (v.length() - 1.0).abs() < 1e-12), "{name}");
                assert!(views.iter().all(|v| azimuth_zenith(*v).1 <= limit_rad + 1e-9), "{name}");
                for (i, a) in views.iter().enumerate() {
                    assert!(views[..i].iter().all(|b| a.distance(*b) > 1e-4), "{name}");
                }
            }
        }
    }

    #[test]
    fn no_hole_is_much_larger_than_it_must_be() {
        for limit_rad in LIMITS_RAD {
            let cap = 1.0 - limit_rad.cos();
            let probes = spiral(20_000, limit_rad).unwrap();
            for (name, views, largest) in schemes(limit_rad) {
                let nearest = |p: &DVec3| views.iter().map(|v| p.dot(*v)).fold(-1.0, f64::max);
                let radius_rad = probes.iter().map(nearest).fold(1.0, f64::min).acos();
                // Hexagons of the same total area: no covering with so many views has smaller holes.
                let best_rad = (2.0 * TAU * cap / (27.0_f64.sqrt() * views.len() as f64)).sqrt();
                let ratio = radius_rad / best_rad;
                assert!(ratio > 0.9 && ratio < largest, "{name} to {limit_rad}: {ratio}");
            }
        }
    }

    #[test]
    fn the_icosphere_has_the_counts_of_the_thesis_and_a_pole() {
        for (subdivisions, count) in [(1, 17), (2, 73), (3, 305)] {
            let views = icosphere(subdivisions, FRAC_PI_2).unwrap();
            assert_eq!(views.len(), count);
            assert!(views[0].distance(DVec3::Z) < 1e-12);
        }
    }

    #[test]
    fn the_spiral_begins_at_the_pole_and_ends_at_the_limit() {
        for limit_rad in LIMITS_RAD {
            let views = spiral(50, limit_rad).unwrap();
            assert_eq!(views[0], DVec3::Z);
            assert!((azimuth_zenith(views[49]).1 - limit_rad).abs() < 1e-12);
        }
        assert_eq!(spiral(1, 1.0).unwrap(), [DVec3::Z]);
    }

    #[test]
    fn stratified_views_have_one_cell_each_and_follow_the_seed() {
        for count in [1, 2, 10, 289] {
            let views = stratified(count, 1.2, 3).unwrap();
            assert_eq!(views.len(), count);
            assert_eq!(views, stratified(count, 1.2, 3).unwrap());
            assert_ne!(views, stratified(count, 1.2, 4).unwrap());
        }
        // Equal areas: the mean height of a cap's points is that of its middle.
        let views = stratified(2000, 1.2, 3).unwrap();
        let mean = views.iter().map(|v| v.z).sum::<f64>() / 2000.0;
        assert!((mean - (1.0 + 1.2_f64.cos()) / 2.0).abs() < 2e-3);
    }

    #[test]
    fn the_rig_shows_the_surface_from_the_view() {
        for (_, views, _) in schemes(FRAC_PI_2) {
            for view in views {
                let (pan_rad, tilt_rad) = pan_tilt(view);
                assert!(Pose::from_rig(pan_rad, tilt_rad, 1.0).centre_m.distance(view) < 1e-12);
                assert!(pan_rad > -PI && pan_rad <= PI && tilt_rad >= 0.0);
            }
        }
    }

    #[test]
    fn what_cannot_be_sampled_is_refused() {
        for limit_rad in [0.0, -1.0, 1.6, f64::NAN] {
            assert!(spiral(10, limit_rad).is_err() && icosphere(1, limit_rad).is_err());
            assert!(latitude_longitude(3, limit_rad).is_err() && stratified(10, limit_rad, 0).is_err());
        }
        assert!(
            spiral(0, 1.0).is_err() && stratified(0, 1.0, 0).is_err() && latitude_longitude(0, 1.0).is_err()
        );
        assert!(icosphere(7, 1.0).is_err() && icosphere(6, FRAC_PI_2).is_err());
        for count in [0, 20_001, usize::MAX] {
            assert!(spiral(count, 1.0).is_err() && stratified(count, 1.0, 0).is_err());
            assert!(icosphere_near(count, 1.0).is_err() && latitude_longitude_near(count, 1.0).is_err());
        }
        assert!(latitude_longitude(1000, 1.0).is_err());
    }
}

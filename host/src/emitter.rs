//! A parameter map as a lamp: what it sends onto a matte white floor before it.
//!
//! The floor is a second plane, along the surface's lower edge and upright on it: y = -height / 2, normal +y, in front of the surface
//! (z > 0). Its irradiance is E = Σ L(texel, towards the point) cos_texel cos_floor A / d² over the surface, and a matte white floor
//! has the radiance E / π in every direction.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use crate::geometry::{Surface, Texels};
use crate::parameter_map::ParameterMap;

/// Columns and rows of points at which the floor is worked out.
const POINTS: (usize, usize) = (32, 24);
/// The surface is divided into so many rectangles along its longer side, or into its texels where these are fewer...
const PARTS: f64 = 32.0;
/// ... and a rectangle further, where its diagonal is more than this part of its distance: there the form factor varies over it.
const NEAR: f64 = 0.35;
/// At most so often: a point on the edge itself would need it for ever.
const DIVISIONS: u32 = 10;

/// Along each side of a rectangle of several texels so many are taken, at places that differ from rectangle to rectangle: an average of
/// all of them takes too long, and always the same places would miss a pattern, or see nothing else.
const TAKEN: u32 = 2;

/// A matte white floor lit by a parameter map.
#[derive(Debug, Clone, PartialEq)]
pub struct Floor {
    /// From left to right (x), metres; its middle is the surface's.
    pub width_m: f64,
    /// From the surface to the front (z), metres.
    pub depth_m: f64,
    /// Columns and rows.
    pub points: (usize, usize),
    /// Linear RGB radiance, row after row from the surface on, each from left to right.
    pub radiance: Vec<[f32; 3]>,
}

impl Floor {
    /// A floor twice as wide as the surface, and one and a half times as deep as it is high. Runs on all cores.
    pub fn lit_by(map: &ParameterMap) -> Self {
        let (width_m, depth_m) = (2.0 * map.surface.width_m, 1.5 * map.surface.height_m);
        let point = |i: usize| {
            let (column, row) = (i % POINTS.0, i / POINTS.0);
            let x = ((column as f64 + 0.5) / POINTS.0 as f64 - 0.5) * width_m;
            let z = (row as f64 + 0.5) / POINTS.1 as f64 * depth_m;
            DVec3::new(x, -map.surface.height_m / 2.0, z)
        };
        let radiance = (0..POINTS.0 * POINTS.1)
            .into_par_iter()
            .map(|i| irradiance(map, point(i), DVec3::Y).map(|value| (value / std::f64::consts::PI) as f32));
        Self { width_m, depth_m, points: POINTS, radiance: radiance.collect() }
    }
}

/// The irradiance that a surface's radiance makes at `point_m` of a plane with this unit normal, surface frame.
pub fn irradiance(map: &ParameterMap, point_m: DVec3, normal: DVec3) -> [f64; 3] {
    let Surface { width_m, height_m } = map.surface;
    let side_m = width_m.max(height_m) / PARTS;
    let parts = |length_m: f64, texels: u32| ((length_m / side_m).ceil() as u32).clamp(1, texels.max(1));
    let (columns, rows) = (parts(width_m, map.texels.columns), parts(height_m, map.texels.rows));
    let size_m = DVec2::new(width_m / f64::from(columns), height_m / f64::from(rows));
    let mut sum = [0.0; 3];
    for row in 0..rows {
        for column in 0..columns {
            let part = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let centre_m = DVec2::new(part.x * size_m.x - width_m / 2.0, height_m / 2.0 - part.y * size_m.y);
            gather(map, (point_m, normal), (centre_m, size_m), DIVISIONS, &mut sum);
        }
    }
    sum
}

/// Adds what a rectangle of the surface sends to a point.
fn gather(
    map: &ParameterMap,
    (point_m, normal): (DVec3, DVec3),
    (centre_m, size_m): (DVec2, DVec2),
    divisions: u32,
    sum: &mut [f64; 3],
) {
    let toward = point_m - centre_m.extend(0.0);
    let distance_m = toward.length();
    if divisions > 0 && size_m.length() > NEAR * distance_m {
        let quarter = size_m / 4.0;
        for sign in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let part = (centre_m + quarter * DVec2::from(sign), size_m / 2.0);
            gather(map, (point_m, normal), part, divisions - 1, sum);
        }
        return;
    }
    let direction = toward / distance_m;
    let cosines = direction.z.max(0.0) * (-direction.dot(normal)).max(0.0);
    if cosines > 0.0 {
        let share = cosines * size_m.x * size_m.y / distance_m.powi(2);
        let (taken, radiance) = radiance(map, (centre_m, size_m), direction.as_vec3());
        *sum = std::array::from_fn(|c| sum[c] + share * radiance[c] / taken);
    }
}

/// How many texels of a rectangle were taken, and the sum of what they send.
fn radiance(map: &ParameterMap, (centre_m, size_m): (DVec2, DVec2), direction: Vec3) -> (f64, [f64; 3]) {
    let Texels { columns, rows } = map.texels;
    let texels = DVec2::new(columns.into(), rows.into());
    let covered = size_m / DVec2::new(map.surface.width_m, map.surface.height_m) * texels;
    let taken = |covered: f64| if covered > 1.0 + 1e-9 { TAKEN } else { 1 };
    let (across, down) = (taken(covered.x), taken(covered.y));
    // Which rectangle it is among those of its size: multiples of irrational numbers fill an interval evenly.
    let number = (centre_m / size_m).floor();
    let place = |count: u32, covered: f64, share: f64| {
        let share = if count == 1 { 0.5 } else { share - share.floor() };
        move |i: u32| covered * ((f64::from(i) + share) / f64::from(count) - 0.5)
    };
    let x = place(across, covered.x, 0.618_034 * number.x + 0.754_878 * number.y);
    let y = place(down, covered.y, 0.569_840 * number.x + 0.414_214 * number.y);
    let centre = map.surface.texel_at(map.texels, centre_m.extend(0.0));
    let mut sum = [0.0; 3];
    for i in 0..across * down {
        let at = (centre + DVec2::new(x(i % across), y(i / across))).round().max(DVec2::ZERO);
        let (model, parameters) = map.texel((at.x as u32).min(columns - 1), (at.y as u32).min(rows - 1));
        let radiance = model.radiance(parameters, direction);
        sum = std::array::from_fn(|c| sum[c] + f64::from(radiance[c]));
    }
    (f64::from(across * down), sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Model;

    fn map(texels: Texels, models: Vec<Model>, parameters: &[f32]) -> ParameterMap {
        ParameterMap {
            surface: Surface { width_m: 0.2, height_m: 0.15 },
            texels,
            models,
            choice: vec![],
            parameters: parameters.repeat(texels.count()),
            diagnostics: None,
            uncertainty: None,
        }
    }

    /// Lambert's formula: irradiance from a polygon of even radiance 1 that lies above the plane of the point.
    fn lambert(corners: &[DVec3], point_m: DVec3, normal: DVec3) -> f64 {
        let rays: Vec<DVec3> = corners.iter().map(|corner| (*corner - point_m).normalize()).collect();
        let edge = |i: usize| {
            let (a, b) = (rays[i], rays[(i + 1) % rays.len()]);
            a.angle_between(b) * a.cross(b).normalize().dot(normal)
        };
        ((0..rays.len()).map(edge).sum::<f64>() / 2.0).abs()
    }

    #[test]
    fn an_even_surface_lights_the_floor_as_lambert_s_formula_says() {
        let corner = |x: f64, y: f64| DVec3::new(0.1 * x, 0.075 * y, 0.0);
        let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        for texels in [Texels { columns: 1, rows: 1 }, Texels { columns: 160, rows: 120 }] {
            let map = map(texels, vec![Model::Constant], &[1.0, 2.0, 0.0]);
            for (x, z) in [(0.0, 0.003), (0.0, 0.05), (0.09, 0.01), (-0.15, 0.1), (0.19, 0.22)] {
                let point = DVec3::new(x, -0.075, z);
                let [r, g, b] = irradiance(&map, point, DVec3::Y);
                let want = lambert(&corners, point, DVec3::Y);
                assert!((r / want - 1.0).abs() < 0.01, "{r} for {want} at {x}, {z}");
                assert!((g / r - 2.0).abs() < 1e-9 && b == 0.0);
            }
        }
    }

    /// Also where a part holds just as many texels as the stripes' period.
    #[test]
    fn stripes_light_the_floor_by_what_they_cover() {
        let point = DVec3::new(0.03, -0.075, 0.08);
        for columns in [96, 150, 288] {
            let mut map = map(Texels { columns, rows: 96 }, vec![Model::Constant], &[1.0; 3]);
            let even = irradiance(&map, point, DVec3::Y)[0];
            for row in map.parameters.chunks_exact_mut(3 * columns as usize) {
                row.chunks_mut(9).for_each(|three| three[..3].fill(0.0));
            }
            let striped = irradiance(&map, point, DVec3::Y)[0];
            assert!((striped / even * 1.5 - 1.0).abs() < 0.03, "{columns}: {striped} of {even}");
        }
    }

    #[test]
    fn a_lobe_lights_the_side_that_it_leans_to_and_its_mirror_image_the_other() {
        // Down onto the floor, and to one side.
        let lit = |side: f32| {
            let axis = glam::Vec3::new(side, -0.5, 0.7).normalize();
            let lobe = [0.01, 0.01, 0.01, 1.0, 1.0, 1.0, 20.0, axis.x, axis.y, axis.z];
            Floor::lit_by(&map(Texels { columns: 16, rows: 12 }, vec![Model::Phong { lobes: 1 }], &lobe))
        };
        let (right, left) = (lit(0.5), lit(-0.5));
        let (columns, rows) = right.points;
        let half = |is_right: bool| {
            let is = |i: &usize| (i % columns >= columns / 2) == is_right;
            (0..columns * rows).filter(is).map(|i| f64::from(right.radiance[i][0])).sum::<f64>()
        };
        assert!(half(true) > 2.0 * half(false), "{} {}", half(true), half(false));
        for i in 0..columns * rows {
            let mirrored = left.radiance[i / columns * columns + columns - 1 - i % columns][0];
            assert!((right.radiance[i][0] - mirrored).abs() <= 1e-4 * mirrored, "{i}");
        }
    }

    #[test]
    fn behind_the_surface_and_below_the_floor_nothing_arrives() {
        let map = map(Texels { columns: 4, rows: 3 }, vec![Model::Constant], &[1.0; 3]);
        assert_eq!(irradiance(&map, DVec3::new(0.0, -0.1, -0.1), DVec3::Y), [0.0; 3]);
        assert_eq!(irradiance(&map, DVec3::new(0.0, -0.1, 0.1), -DVec3::Y), [0.0; 3]);
    }
}

//! Where a model's faces lie in a texture, and which texel is where on the model.

use glam::DVec2;

use super::model::Model;
use crate::{Error, Result};

/// Texels around a chart that repeat its border, so that looking between texels never reaches beyond it.
const BORDER: f64 = 1.0;
/// A texture that serves so much of its texels to several places is not used.
const SHARED: f64 = 0.01;
/// No texel.
const NONE: u32 = u32::MAX;

/// The faces of a model in a square texture. Texel (0, 0) is at the top left; a texel's centre is an integer.
#[derive(Debug, Clone, PartialEq)]
pub struct Charts {
    /// Texels along a side.
    pub size: u32,
    /// Each face's corners, texels.
    pub corners: Vec<[DVec2; 3]>,
    /// The face that a texel shows, at most [`BORDER`] away from it; [`NONE`] where there is none.
    faces: Vec<u32>,
    /// How much of the model a texel shows, square metres: all texels of a face together are its area, those of its border are 0.
    pub area_m2: Vec<f32>,
}

impl Charts {
    /// The model's own texture coordinates where every face has some, inside the unit square and no two over each other; else a chart of
    /// its own for each face. Says, in a sentence, why the model's own were not used.
    ///
    /// # Errors
    /// [`Error::Request`] where the texture is too small for so many faces.
    pub fn new(model: &Model, size: u32) -> Result<(Self, Option<String>)> {
        let mut why = None;
        if !model.uv.is_empty() {
            let within = -1e-6..1.0 + 1e-6;
            let inside = model.uv.iter().flatten().all(|uv| within.contains(&uv.x) && within.contains(&uv.y));
            let to_texel = |uv: DVec2| DVec2::new(uv.x, 1.0 - uv.y) * f64::from(size) - 0.5;
            if inside {
                let (charts, shared) =
                    Self::raster(model, size, model.uv.iter().map(|face| face.map(to_texel)).collect());
                if shared <= SHARED {
                    return Ok((charts, None));
                }
                why = Some(format!(
                    "the model's texture coordinates put several faces at one place ({:.0} % of the texels): each face has a chart of its own instead",
                    100.0 * shared
                ));
            } else {
                why = Some("the model's texture coordinates repeat the texture: each face has a chart of its own instead".into());
            }
        }
        let flat: Vec<[DVec2; 3]> = (0..model.faces.len()).map(|face| flat(model, face)).collect();
        let area: f64 = (0..flat.len()).map(|face| model.area_m2(face)).sum();
        let (mut low, mut high) = (0.0, f64::from(size) / area.sqrt().max(f64::MIN_POSITIVE) * 2.0);
        let mut best = None;
        for _ in 0..24 {
            let density = 0.5 * (low + high);
            match pack(&flat, density, size) {
                Some(corners) => (low, best) = (density, Some(corners)),
                None => high = density,
            }
        }
        let Some(corners) = best else {
            return Err(Error::request(
                format!("{} faces in a texture of {size}x{size}", flat.len()),
                "choose a larger --size, or a model with fewer faces",
            ));
        };
        Ok((Self::raster(model, size, corners).0, why))
    }

    /// The face that a texel shows.
    pub fn face(&self, texel: usize) -> Option<usize> {
        Some(self.faces[texel]).filter(|&face| face != NONE).map(|face| face as usize)
    }

    /// The weights of a face's second and third corner at the place of the face that is nearest to a point of the texture.
    pub fn weights(&self, face: usize, at: DVec2) -> [f64; 2] {
        let [a, b, c] = self.corners[face];
        let (one, other, from) = (b - a, c - a, at - a);
        let area = one.perp_dot(other);
        let (u, v) = (from.perp_dot(other) / area, one.perp_dot(from) / area);
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
            return [u, v];
        }
        let along = |from: DVec2, edge: DVec2| {
            let length = edge.length_squared();
            if length > 0.0 { (from.dot(edge) / length).clamp(0.0, 1.0) } else { 0.0 }
        };
        let (s, t, w) = (along(from, one), along(from, other), along(at - b, c - b));
        [[s, 0.0], [0.0, t], [1.0 - w, w]]
            .into_iter()
            .min_by(|p, q| {
                let far = |[u, v]: &[f64; 2]| (a + *u * one + *v * other).distance_squared(at);
                far(p).total_cmp(&far(q))
            })
            .unwrap_or([0.0; 2])
    }

    /// The point of the texture at a place of a face.
    pub fn at(&self, face: usize, [u, v]: [f64; 2]) -> DVec2 {
        let [a, b, c] = self.corners[face];
        a + u * (b - a) + v * (c - a)
    }

    /// Also says how much of the texels belong to several faces.
    fn raster(model: &Model, size: u32, corners: Vec<[DVec2; 3]>) -> (Self, f64) {
        let side = size as usize;
        let mut charts =
            Self { size, corners, faces: vec![NONE; side * side], area_m2: vec![0.0; side * side] };
        let mut shows = vec![false; side * side];
        let (mut own, mut shared) = (vec![0u32; model.faces.len()], 0usize);
        let around = |face: usize, charts: &Self| {
            let [a, b, c] = charts.corners[face];
            let clamp = |x: f64| (x.max(0.0) as usize).min(side - 1);
            let (least, most) = (a.min(b).min(c) - BORDER, a.max(b).max(c) + BORDER);
            let columns = clamp(least.x.ceil())..clamp(most.x.floor()) + 1;
            (clamp(least.y.ceil())..clamp(most.y.floor()) + 1).flat_map(move |y| {
                columns.clone().map(move |x| (y * side + x, DVec2::new(x as f64, y as f64)))
            })
        };
        for (face, own) in own.iter_mut().enumerate() {
            let [a, b, c] = charts.corners[face];
            let turned = (b - a).perp_dot(c - a).signum();
            for (texel, at) in around(face, &charts) {
                // How deep in the face, texels.
                let depth = |p: DVec2, q: DVec2| turned * (q - p).normalize_or_zero().perp_dot(at - p);
                let depth = depth(a, b).min(depth(b, c)).min(depth(c, a));
                if depth >= 0.0 && charts.faces[texel] == NONE {
                    charts.faces[texel] = face as u32;
                    shows[texel] = true;
                    *own += 1;
                } else if depth > 0.01 {
                    shared += 1;
                }
            }
        }
        let used: usize = own.iter().map(|count| *count as usize).sum();
        for (face, own) in own.iter_mut().enumerate() {
            // A face without a texel's centre in it is shown by those beside it.
            let is_thin = *own == 0;
            for (texel, at) in around(face, &charts) {
                let away = charts.at(face, charts.weights(face, at)).distance(at);
                if charts.faces[texel] == NONE && away <= BORDER * std::f64::consts::SQRT_2 {
                    charts.faces[texel] = face as u32;
                    if is_thin && away < 0.75 {
                        shows[texel] = true;
                        *own += 1;
                    }
                }
            }
        }
        for texel in (0..side * side).filter(|&texel| shows[texel]) {
            let face = charts.faces[texel] as usize;
            charts.area_m2[texel] = (model.area_m2(face) / f64::from(own[face])) as f32;
        }
        (charts, shared as f64 / used.max(1) as f64)
    }
}

/// A face laid flat, metres: its longest edge along x from the origin, the third corner above it.
fn flat(model: &Model, face: usize) -> [DVec2; 3] {
    let corners = model.corners(face);
    let length = |k: usize| corners[k].distance(corners[(k + 1) % 3]);
    let longest = (0..3).max_by(|&a, &b| length(a).total_cmp(&length(b))).unwrap_or(0);
    let [a, b, c] = [0, 1, 2].map(|k| corners[(longest + k) % 3]);
    let along = (b - a).normalize_or_zero();
    let x = (c - a).dot(along);
    let placed = [DVec2::ZERO, DVec2::new(a.distance(b), 0.0), DVec2::new(x, (c - a - x * along).length())];
    let mut all = [DVec2::ZERO; 3];
    (0..3).for_each(|k| all[(longest + k) % 3] = placed[k]);
    all
}

/// Charts in rows, the highest first, with so many texels per metre; `None` where they do not fit.
fn pack(flat: &[[DVec2; 3]], density: f64, size: u32) -> Option<Vec<[DVec2; 3]>> {
    // Two charts' borders never touch, and no texel's centre is on the edge along x.
    let room = 2.0 * BORDER + 2.0;
    let extent = |face: usize| {
        let [a, b, c] = flat[face].map(|corner| density * corner);
        (a.max(b).max(c) + room).ceil()
    };
    let mut order: Vec<usize> = (0..flat.len()).collect();
    order.sort_by(|&a, &b| extent(b).y.total_cmp(&extent(a).y).then(a.cmp(&b)));
    let side = f64::from(size);
    let mut placed = vec![[DVec2::ZERO; 3]; flat.len()];
    let (mut at, mut height) = (DVec2::ZERO, 0.0f64);
    for face in order {
        let own = extent(face);
        if at.x + own.x > side {
            at = DVec2::new(0.0, at.y + height);
            height = 0.0;
        }
        if own.x > side || at.y + own.y > side {
            return None;
        }
        placed[face] = flat[face].map(|corner| density * corner + at + BORDER + 0.5);
        at.x += own.x;
        height = height.max(own.y);
    }
    Some(placed)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn fan(count: u32) -> Model {
        let turn = |i: u32| f64::from(i) / f64::from(count) * std::f64::consts::TAU;
        let mut points_m = vec![DVec3::ZERO];
        points_m.extend((0..count).map(|i| DVec3::new(turn(i).cos(), turn(i).sin(), 0.3 * f64::from(i % 2))));
        let faces = (0..count).map(|i| [0, 1 + i, 1 + (i + 1) % count]).collect();
        Model { points_m, faces, uv: vec![], notes: vec![] }
    }

    #[test]
    fn every_face_has_its_area_in_texels_and_a_border_of_its_own() {
        let model = fan(24);
        let (charts, why) = Charts::new(&model, 256).unwrap();
        assert_eq!(why, None);
        let mut area = [0.0; 24];
        let mut used = 0;
        for texel in 0..256 * 256 {
            let Some(face) = charts.face(texel) else { continue };
            area[face] += f64::from(charts.area_m2[texel]);
            used += 1;
            let at = DVec2::new((texel % 256) as f64, (texel / 256) as f64);
            let weights = charts.weights(face, at);
            assert!(charts.at(face, weights).distance(at) <= 1.5);
            assert!(weights[0] >= 0.0 && weights[1] >= 0.0 && weights[0] + weights[1] <= 1.0 + 1e-12);
            if charts.area_m2[texel] > 0.0 {
                // All four texels between which a place of the face lies show this face.
                for step in [1, 255, 256, 257] {
                    assert_eq!(charts.face(texel + step), Some(face));
                    assert_eq!(charts.face(texel - step), Some(face));
                }
            }
        }
        assert!(used > 256 * 256 / 3, "{used}");
        for (face, area) in area.into_iter().enumerate() {
            assert!((area / model.area_m2(face) - 1.0).abs() < 1e-4);
            // As long in the texture as on the model, by one factor.
            let [a, b, c] = charts.corners[face];
            let [p, q, r] = model.corners(face);
            let ratio = a.distance(b) / p.distance(q);
            assert!((b.distance(c) / q.distance(r) / ratio - 1.0).abs() < 1e-9);
        }
        let message = Charts::new(&fan(20_000), 64).unwrap_err().to_string();
        assert!(message.contains("20000 faces") && message.contains("--size"), "{message}");
    }

    #[test]
    fn a_models_own_coordinates_are_used_unless_they_overlap_or_repeat() {
        let square = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
        let model = |uv: Vec<[DVec2; 3]>| Model {
            points_m: square.map(|p| p.extend(0.0)).to_vec(),
            faces: vec![[0, 1, 2], [0, 2, 3]],
            uv,
            notes: vec![],
        };
        let halves = vec![[square[0], square[1], square[2]], [square[0], square[2], square[3]]];
        let (charts, why) = Charts::new(&model(halves.clone()), 64).unwrap();
        assert_eq!(why, None);
        // v goes up, rows go down: the top left texel shows the second face.
        assert_eq!((charts.face(0), charts.face(64 * 64 - 1)), (Some(1), Some(0)));
        let twice = vec![halves[0], halves[0]];
        assert!(Charts::new(&model(twice), 64).unwrap().1.unwrap().contains("several faces"));
        let beyond = halves.iter().map(|face| face.map(|uv| 3.0 * uv)).collect();
        assert!(Charts::new(&model(beyond), 64).unwrap().1.unwrap().contains("repeat"));
    }
}

//! A flat board of known materials under known lamps: its radiance is a formula, so every estimate has a truth.
//!
//! A point under a small lamp sends out `Kd + Ks max(0, r·d)^m`: Kd from the irradiance it receives, one Phong lobe about
//! the direction `r` in which its normal mirrors the lamp. The lamps stand near enough that `r` differs from point to
//! point. A screen keeps the large lamp's light off the lower half of the board, where most patches are exactly one lobe.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};
use rigel::geometry::{Surface, unit_vector};

/// The parameters of one Phong lobe: `diffuse + specular max(0, direction·d)^shininess`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLobe {
    /// Radiance in all directions, linear RGB (Kd).
    pub diffuse: [f64; 3],
    /// Radiance that the lobe adds at its centre (Ks).
    pub specular: [f64; 3],
    /// Exponent (m).
    pub shininess: f64,
    /// Unit vector of the lobe's centre, surface frame.
    pub direction: DVec3,
}

impl KnownLobe {
    /// Radiance towards the unit vector `direction_to_viewer`.
    pub fn radiance(&self, direction_to_viewer: DVec3) -> [f64; 3] {
        let shape = lobe(self.direction, direction_to_viewer, self.shininess);
        std::array::from_fn(|c| self.diffuse[c] + self.specular[c] * shape)
    }
}

/// A board and its lamps. Radiance is in a unit of its own, in which white paper sends out about 1.
#[derive(Debug, Clone)]
pub struct Scene {
    surface: Surface,
    small: Lamp,
    /// The large lamp, as the small lamps that fill its area; they light the upper half only.
    large: Vec<Lamp>,
    /// Patches row by row from the top left.
    patches: Vec<Material>,
    columns: usize,
    rows: usize,
}

#[derive(Debug, Clone, Copy)]
struct Lamp {
    at_m: DVec3,
    /// Irradiance on a surface that faces the lamp at one metre, per π.
    strength: f64,
}

#[derive(Debug, Clone, Copy)]
struct Material {
    albedo: [f64; 3],
    /// Depth of the texture, 0 to 1.
    texture: f64,
    gloss: f64,
    shininess: f64,
    /// How far the shininess varies over the patch, as a power of this factor.
    shininess_spread: f64,
    /// Largest slope of the crumpled normals.
    crumple: f64,
    /// Gloss and shininess of a second coat.
    second: Option<(f64, f64)>,
}

const PAPER: Material = Material {
    albedo: [0.8, 0.78, 0.72],
    texture: 0.25,
    gloss: 0.0,
    shininess: 1.0,
    shininess_spread: 1.0,
    crumple: 0.0,
    second: None,
};

/// Widths of the white, black and white frames around the sampled area, metres.
const FRAMES_M: [(f64, f64); 3] = [(0.004, 0.85), (0.004, 0.04), (0.010, 0.85)];

impl Scene {
    /// Eight materials in two rows of four on 200 mm x 150 mm. Above, under both lamps: paper, satin, crumpled foil,
    /// gloss. Below, under the small lamp alone: sheen, polish, a varnished cloth with two lobes, crumpled leather.
    pub fn patchwork() -> Self {
        let patches = vec![
            PAPER,
            Material { albedo: [0.55, 0.22, 0.18], gloss: 0.35, shininess: 8.0, ..PAPER },
            Material { albedo: [0.2, 0.2, 0.22], gloss: 1.6, shininess: 24.0, crumple: 0.18, ..PAPER },
            Material { albedo: [0.12, 0.3, 0.5], gloss: 5.0, shininess: 60.0, ..PAPER },
            Material { albedo: [0.5, 0.5, 0.2], texture: 0.5, gloss: 0.3, shininess: 3.0, ..PAPER },
            Material { albedo: [0.1, 0.1, 0.12], gloss: 12.0, shininess: 100.0, ..PAPER },
            Material {
                albedo: [0.16, 0.42, 0.2],
                gloss: 0.4,
                shininess: 6.0,
                second: Some((2.0, 70.0)),
                ..PAPER
            },
            Material {
                albedo: [0.4, 0.26, 0.15],
                texture: 0.4,
                gloss: 0.9,
                shininess: 16.0,
                shininess_spread: 1.6,
                crumple: 0.22,
                ..PAPER
            },
        ];
        Self { patches, columns: 4, rows: 2, large: large_lamp(), ..Self::one_lobe() }
    }

    /// One material, exactly one lobe at every point: colour, gloss, direction and shininess (from 5 to 80) all vary.
    pub fn one_lobe() -> Self {
        let material = Material {
            albedo: [0.35, 0.3, 0.22],
            texture: 0.6,
            gloss: 1.0,
            shininess: 20.0,
            shininess_spread: 4.0,
            crumple: 0.1,
            second: None,
        };
        Self {
            surface: Surface { width_m: 0.2, height_m: 0.15 },
            small: Lamp { at_m: unit_vector(2.2, 0.6) * 0.7, strength: 0.55 },
            large: Vec::new(),
            patches: vec![material],
            columns: 1,
            rows: 1,
        }
    }

    /// The sampled area.
    pub fn surface(&self) -> Surface {
        self.surface
    }

    /// Linear RGB radiance that leaves `point_m` of the plane z = 0 towards the unit vector `direction_to_viewer`;
    /// black from below the plane and outside the board.
    pub fn radiance(&self, point_m: DVec3, direction_to_viewer: DVec3) -> [f64; 3] {
        if direction_to_viewer.z <= 0.0 {
            return [0.0; 3];
        }
        let Some(spot) = self.spot(point_m) else {
            let albedo = self.frame_albedo(point_m);
            // Most of a photograph is black surround, which no lamp makes brighter.
            return if albedo > 0.0 { [albedo * self.irradiance(point_m); 3] } else { [0.0; 3] };
        };
        let (mut irradiance, mut specular) = (0.0, 0.0);
        for light in self.lamps_at(point_m).map(|lamp| lamp.light_at(point_m)) {
            irradiance += light.strength * light.from.z;
            if spot.gloss > 0.0 {
                let mirror = mirrored(light.from, spot.normal);
                let mut height = spot.gloss * lobe(mirror, direction_to_viewer, spot.shininess);
                if let Some((gloss, shininess)) = spot.second {
                    height += gloss * lobe(mirror, direction_to_viewer, shininess);
                }
                specular += light.strength * height;
            }
        }
        spot.albedo.map(|albedo| albedo * irradiance + specular)
    }

    /// The lobe at a point where the truth is exactly one (paper has one of height 0); `None` elsewhere.
    pub fn lobe(&self, point_m: DVec3) -> Option<KnownLobe> {
        let spot = self.spot(point_m)?;
        if spot.second.is_some() || (spot.gloss > 0.0 && self.lamps_at(point_m).count() > 1) {
            return None;
        }
        let (irradiance, small) = (self.irradiance(point_m), self.small.light_at(point_m));
        Some(KnownLobe {
            diffuse: spot.albedo.map(|albedo| albedo * irradiance),
            specular: [spot.gloss * small.strength; 3],
            shininess: spot.shininess,
            direction: mirrored(small.from, spot.normal),
        })
    }

    /// The number of the patch at a point, row by row from the top left; `None` outside the sampled area.
    pub fn patch(&self, point_m: DVec3) -> Option<usize> {
        if !self.surface.contains(point_m) {
            return None;
        }
        let column = (point_m.x / self.surface.width_m + 0.5) * self.columns as f64;
        let row = (0.5 - point_m.y / self.surface.height_m) * self.rows as f64;
        Some((row as usize).min(self.rows - 1) * self.columns + (column as usize).min(self.columns - 1))
    }

    /// What the material is like at one point.
    fn spot(&self, point_m: DVec3) -> Option<Spot> {
        let number = self.patch(point_m)?;
        let material = self.patches[number];
        let p = point_m.truncate();
        let colour = DVec3::from_array(material.albedo);
        let hue = DVec3::new(0.0, 1.0, 2.0).map(|c| (TAU * p.dot(DVec2::from_angle(2.0 * c)) / 0.035).sin());
        let tint = 0.3 * hue + 0.7 * waves(p, 3.0);
        let albedo = (colour * (1.0 - material.texture * (0.5 + 0.5 * tint))).to_array();
        let mut spot = Spot {
            albedo,
            gloss: 0.0,
            shininess: material.shininess,
            normal: DVec3::Z,
            second: material.second,
        };
        // A photograph asks for millions of spots: waves that change nothing are not computed.
        if material.gloss > 0.0 {
            spot.gloss = material.gloss * (1.0 - 0.5 * material.texture * waves(p, 6.0));
        }
        if material.crumple > 0.0 {
            let slope = DVec2::new(waves(p, 4.0), waves(p, 5.0)) * material.crumple;
            spot.normal = slope.extend(1.0).normalize();
        }
        if material.shininess_spread != 1.0 {
            spot.shininess *= material.shininess_spread.powf(waves(p, 7.0));
        }
        Some(spot)
    }

    fn frame_albedo(&self, point_m: DVec3) -> f64 {
        let out = point_m.truncate().abs() - DVec2::new(self.surface.width_m, self.surface.height_m) / 2.0;
        let mut outside_m = out.max_element();
        for (width_m, albedo) in FRAMES_M {
            if outside_m < width_m {
                return albedo;
            }
            outside_m -= width_m;
        }
        0.0
    }

    fn irradiance(&self, point_m: DVec3) -> f64 {
        self.lamps_at(point_m)
            .map(|lamp| lamp.light_at(point_m))
            .map(|light| light.strength * light.from.z)
            .sum()
    }

    /// The lamps that light a point.
    fn lamps_at(&self, point_m: DVec3) -> impl Iterator<Item = &Lamp> {
        let large = if point_m.y >= 0.0 { &self.large[..] } else { &[] };
        std::iter::once(&self.small).chain(large)
    }
}

struct Spot {
    albedo: [f64; 3],
    gloss: f64,
    shininess: f64,
    normal: DVec3,
    second: Option<(f64, f64)>,
}

/// What arrives from a lamp.
struct Light {
    /// Unit vector to the lamp.
    from: DVec3,
    /// Irradiance of a surface that faces the lamp, per π.
    strength: f64,
}

impl Lamp {
    fn light_at(&self, point_m: DVec3) -> Light {
        let to_lamp = self.at_m - point_m;
        let distance2 = to_lamp.length_squared();
        Light { from: to_lamp / distance2.sqrt(), strength: self.strength / distance2 }
    }
}

/// The direction in which `normal` mirrors what comes from the unit vector `from`.
fn mirrored(from: DVec3, normal: DVec3) -> DVec3 {
    2.0 * normal.dot(from) * normal - from
}

/// A window of 0.3 m x 0.3 m that faces the board, as nine lamps.
fn large_lamp() -> Vec<Lamp> {
    let centre = unit_vector(-0.9, 0.75) * 0.9;
    let facing = -centre.normalize();
    let (right, up) = facing.any_orthonormal_pair();
    let lamp = |i: i32| {
        let (x, y) = (f64::from(i % 3 - 1), f64::from(i / 3 - 1));
        Lamp { at_m: centre + (right * x + up * y) * 0.1, strength: 0.35 / 9.0 }
    };
    (0..9).map(lamp).collect()
}

/// `max(0, direction·viewer)^shininess`.
fn lobe(direction: DVec3, viewer: DVec3, shininess: f64) -> f64 {
    let cosine = direction.dot(viewer).max(0.0);
    // A whole power costs a fifth of a general one, and nine lamps take many.
    if shininess.fract() == 0.0 { cosine.powi(shininess as i32) } else { cosine.powf(shininess) }
}

/// A smooth pattern between -1 and 1 with waves of 13 to 40 mm, another one for each `which`.
fn waves(p: DVec2, which: f64) -> f64 {
    let angle = 0.7 + 1.3 * which;
    let along = DVec2::from_angle(angle);
    let coarse = (TAU * p.dot(along) / 0.040 + 2.1 * which).sin();
    let across = (TAU * p.dot(along.perp()) / 0.027 + PI * which).sin();
    let fine = (TAU * (p.x - 0.6 * p.y) / 0.0155 + 1.7 * which).sin();
    0.5 * coarse + 0.35 * across + 0.15 * fine
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigel::geometry::Texels;

    const TEXELS: Texels = Texels { columns: 40, rows: 30 };

    fn points(scene: &Scene) -> impl Iterator<Item = DVec3> {
        let surface = scene.surface();
        (0..TEXELS.rows)
            .flat_map(move |row| (0..TEXELS.columns).map(move |c| surface.texel_centre(TEXELS, c, row)))
    }

    fn directions() -> impl Iterator<Item = DVec3> {
        (0..7).flat_map(|z| (0..9).map(move |a| unit_vector(f64::from(a) * 0.7, f64::from(z) * 0.24)))
    }

    #[test]
    fn where_a_lobe_is_known_the_radiance_is_that_lobe() {
        for scene in [Scene::one_lobe(), Scene::patchwork()] {
            for point in points(&scene) {
                let Some(lobe) = scene.lobe(point) else { continue };
                assert!((lobe.direction.length() - 1.0).abs() < 1e-12 && lobe.direction.z > 0.0);
                for d in directions() {
                    let (a, b) = (scene.radiance(point, d), lobe.radiance(d));
                    assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-12 && a[c] > 0.0), "{point} {d}");
                }
            }
        }
    }

    #[test]
    fn the_scenes_know_their_lobes() {
        let one = Scene::one_lobe();
        assert!(points(&one).all(|p| one.lobe(p).is_some()));
        let shininess: Vec<f64> = points(&one).filter_map(|p| one.lobe(p)).map(|l| l.shininess).collect();
        let (low, high) = shininess.iter().fold((f64::MAX, 0.0f64), |(l, h), &m| (l.min(m), h.max(m)));
        assert!(low < 8.0 && high > 50.0 && low >= 5.0 && high <= 80.0, "{low} to {high}");
        let patchwork = Scene::patchwork();
        let mut known = [0; 8];
        for p in points(&patchwork) {
            known[patchwork.patch(p).unwrap()] += u32::from(patchwork.lobe(p).is_some());
        }
        assert_eq!(known, [150, 0, 0, 0, 150, 150, 0, 150]);
    }

    #[test]
    fn paper_is_the_same_from_all_directions_and_gloss_is_not() {
        let scene = Scene::patchwork();
        let paper = DVec3::new(-0.07, 0.03, 0.0);
        let polish = DVec3::new(-0.03, -0.03, 0.0);
        let straight = scene.radiance(paper, DVec3::Z);
        assert!(directions().all(|d| scene.radiance(paper, d) == straight));
        let centre = scene.lobe(polish).unwrap().direction;
        assert!(scene.radiance(polish, centre)[0] > 10.0 * scene.radiance(polish, unit_vector(2.2, 0.6))[0]);
    }

    #[test]
    fn the_mirror_direction_of_a_level_point_is_the_lamp_s_turned_by_half() {
        let scene = Scene::patchwork();
        let point = DVec3::new(-0.03, -0.03, 0.0);
        let lamp = (scene.small.at_m - point).normalize();
        let expected = DVec3::new(-lamp.x, -lamp.y, lamp.z);
        assert!((scene.lobe(point).unwrap().direction - expected).length() < 1e-12);
    }

    #[test]
    fn the_board_ends_in_frames_and_black() {
        let scene = Scene::patchwork();
        let at = |outside_m: f64| scene.radiance(DVec3::new(0.1 + outside_m, 0.0, 0.0), DVec3::Z)[1];
        assert!(at(0.002) > 0.3 && at(0.012) > 0.3);
        assert!(at(0.006) < 0.1 && at(0.006) > 0.0);
        assert_eq!(at(0.02), 0.0);
        assert_eq!(scene.radiance(DVec3::ZERO, -DVec3::Z), [0.0; 3]);
    }
}

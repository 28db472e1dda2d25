//! Splats read and drawn by a reader that knows only the format's definition.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use std::collections::HashMap;

use common::{fitted, observed};
use glam::{DVec2, Vec3};
use rigel::fit::Model;
use rigel::geometry::Texels;
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render::expose;
use rigel::sampling::spiral;
use rigel::splats::splats;
use rigel_simulated::scene::Scene;

const GAMMA: f32 = 1.5;

/// A PLY file of floats by the names of its properties.
struct Ply {
    names: HashMap<String, usize>,
    rows: Vec<Vec<f32>>,
}

impl Ply {
    fn read(bytes: &[u8]) -> Self {
        let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"), "{header}");
        let count: usize =
            header.lines().find_map(|line| line.strip_prefix("element vertex ")).unwrap().parse().unwrap();
        let properties = header.lines().filter_map(|line| line.strip_prefix("property float "));
        let names: HashMap<String, usize> =
            properties.enumerate().map(|(i, name)| (name.to_owned(), i)).collect();
        assert_eq!(bytes.len() - end, count * names.len() * 4, "{header}");
        let float = |four: &[u8]| f32::from_le_bytes(four.try_into().unwrap());
        let row = |row: &[u8]| row.chunks_exact(4).map(float).collect();
        Self { rows: bytes[end..].chunks_exact(4 * names.len()).map(row).collect(), names }
    }

    fn get(&self, row: usize, name: &str) -> f32 {
        self.rows[row][self.names[name]]
    }
}

/// Associated Legendre functions with the Condon-Shortley phase, from their definition, and from them the format's real harmonics:
/// this is how its renderers' signs come about, written another way than theirs.
fn harmonic(l: i32, m: i32, v: Vec3) -> f64 {
    let (x, sine) = (f64::from(v.z), f64::from(v.truncate().length()));
    let order = m.abs();
    let mut diagonal = 1.0;
    for i in 1..=order {
        diagonal *= -f64::from(2 * i - 1) * sine;
    }
    let (mut before, mut now) = (0.0, diagonal);
    for degree in order + 1..=l {
        let next = (f64::from(2 * degree - 1) * x * now - f64::from(degree + order - 1) * before)
            / f64::from(degree - order);
        (before, now) = (now, next);
    }
    let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
    let norm = (f64::from(2 * l + 1) / (4.0 * std::f64::consts::PI) * factorial(l - order)
        / factorial(l + order))
    .sqrt();
    let azimuth = f64::from(v.y).atan2(f64::from(v.x));
    match m {
        0 => norm * now,
        1.. => 2f64.sqrt() * norm * now * (f64::from(m) * azimuth).cos(),
        _ => 2f64.sqrt() * norm * now * (f64::from(order) * azimuth).sin(),
    }
}

/// The colour of a splat seen along `v`, from the camera to it.
fn colour(ply: &Ply, row: usize, v: Vec3) -> [f64; 3] {
    let mut sum = [0.5; 3];
    for l in 0..4i32 {
        for m in -l..=l {
            let value = harmonic(l, m, v);
            let index = l * (l + 1) + m;
            for (c, sum) in sum.iter_mut().enumerate() {
                let name = if index == 0 {
                    format!("f_dc_{c}")
                } else {
                    format!("f_rest_{}", c as i32 * 15 + index - 1)
                };
                *sum += value * f64::from(ply.get(row, &name));
            }
        }
    }
    sum.map(|level| level.max(0.0))
}

/// What is seen along `v` through a point of the plane: splats in front first, as the format says.
fn seen(ply: &Ply, near: &[usize], point: Vec3, v: Vec3) -> [f64; 3] {
    let mut sorted = near.to_vec();
    let depth = |row: usize| v.dot(Vec3::new(ply.get(row, "x"), ply.get(row, "y"), ply.get(row, "z")));
    sorted.sort_by(|a, b| depth(*a).total_cmp(&depth(*b)));
    let (mut light, mut left) = ([0.0; 3], 1.0);
    for row in sorted {
        assert_eq!([0, 1, 2, 3].map(|i| ply.get(row, &format!("rot_{i}"))), [1.0, 0.0, 0.0, 0.0]);
        let off = [("x", point.x, "scale_0"), ("y", point.y, "scale_1")]
            .map(|(axis, at, scale)| f64::from((at - ply.get(row, axis)) / ply.get(row, scale).exp()));
        let opacity = 1.0 / (1.0 + (-f64::from(ply.get(row, "opacity"))).exp());
        let alpha = (opacity * (-0.5 * (off[0] * off[0] + off[1] * off[1])).exp()).min(0.99);
        if alpha < 1.0 / 255.0 {
            continue;
        }
        for (light, level) in light.iter_mut().zip(colour(ply, row, v)) {
            *light += left * alpha * level;
        }
        left *= 1.0 - alpha;
    }
    light
}

/// Real harmonics up to degree 3 from absolute levels in the directions of `reduced`, by least squares.
struct Reduction {
    directions: Vec<Vec3>,
    /// For each harmonic what a level in each direction adds.
    rows: Vec<Vec<f64>>,
}

/// Degree and order of harmonic number `i`.
fn degree(i: usize) -> (i32, i32) {
    let l = (i as f64).sqrt() as i32;
    (l, i as i32 - l * (l + 1))
}

impl Reduction {
    fn new() -> Self {
        let directions: Vec<Vec3> =
            spiral(160, 80f64.to_radians()).unwrap().iter().map(|d| d.as_vec3()).collect();
        let basis: Vec<[f64; 16]> = directions
            .iter()
            .map(|direction| std::array::from_fn(|i| harmonic(degree(i).0, degree(i).1, -*direction)))
            .collect();
        // Normal equations, with what roughness costs, reduced by Gauss and Jordan.
        let mut rows: Vec<Vec<f64>> = (0..16)
            .map(|i| {
                let roughness = f64::from(degree(i).0 * (degree(i).0 + 1)).powi(2);
                let normal = |j: usize| basis.iter().map(|y| y[i] * y[j]).sum::<f64>();
                let ridge = |j: usize| if i == j { 1e-4 * 160.0 * roughness } else { 0.0 };
                (0..16).map(|j| normal(j) + ridge(j)).chain(basis.iter().map(|y| y[i])).collect()
            })
            .collect();
        for pivot in 0..16 {
            let by = rows[pivot][pivot];
            rows[pivot].iter_mut().for_each(|value| *value /= by);
            let of_pivot = rows[pivot].clone();
            for (_, row) in rows.iter_mut().enumerate().filter(|(i, _)| *i != pivot) {
                let by = row[pivot];
                row.iter_mut().zip(&of_pivot).for_each(|(value, other)| *value -= by * other);
            }
        }
        Self { directions, rows: rows.into_iter().map(|row| row[16..].to_vec()).collect() }
    }

    /// The harmonics of a texel, each colour's.
    fn of(&self, map: &ParameterMap, column: usize, row: usize) -> [[f64; 16]; 3] {
        let at = DVec2::new(column as f64, row as f64);
        let seen = |direction: &Vec3| map.radiance_at(at, *direction);
        let seen: Vec<[f32; 3]> = self.directions.iter().map(seen).collect();
        let level = |k: usize, c: usize| f64::from(expose(seen[k][c], GAMMA)) - 0.5;
        let sum = |i: usize, c: usize| (0..160).map(|k| self.rows[i][k] * level(k, c)).sum();
        std::array::from_fn(|c| std::array::from_fn(|i| sum(i, c)))
    }
}

/// What harmonics show along `v`.
fn level(harmonics: &[f64; 16], v: Vec3) -> f64 {
    let sum: f64 = (0..16).map(|i| harmonics[i] * harmonic(degree(i).0, degree(i).1, v)).sum();
    (0.5 + sum).max(0.0)
}

/// Exactly one lobe at every point: colour, gloss, direction and shininess all vary.
fn one_lobe(texels: Texels) -> ParameterMap {
    let scene = Scene::one_lobe();
    let parameters = |index: u32| {
        let point = scene.surface().texel_centre(texels, index % texels.columns, index / texels.columns);
        let lobe = scene.lobe(point).unwrap();
        let values =
            [&lobe.diffuse[..], &lobe.specular, &[lobe.shininess], &lobe.direction.to_array()].concat();
        values.into_iter().map(|value| value as f32)
    };
    ParameterMap {
        surface: scene.surface(),
        texels,
        models: vec![Model::Phong { lobes: 1 }],
        choice: vec![],
        parameters: (0..texels.count() as u32).flat_map(parameters).collect(),
        diagnostics: None,
        uncertainty: None,
    }
}

/// Draws places at and between texels from ten directions and compares them with the blend of the degree-3 reconstructions of the texels
/// around; and these with the map.
fn compare(map: &ParameterMap, step: usize) -> rigel::splats::Splats {
    let made = splats(map, GAMMA, &Silent).unwrap();
    let ply = Ply::read(&made.ply);
    assert_eq!(ply.rows.len(), made.count);
    let reduction = Reduction::new();
    let [columns, rows] = [map.texels.columns as usize, map.texels.rows as usize];
    let texel_m = [map.surface.width_m / columns as f64, map.surface.height_m / rows as f64];
    let places: Vec<[f32; 2]> = (0..made.count).map(|row| [ply.get(row, "x"), ply.get(row, "y")]).collect();
    let (mut drawn, mut reduced, mut drawn_count, mut reduced_count) = (0.0, 0.0, 0.0, 0.0);
    let views = spiral(10, 65f64.to_radians()).unwrap();
    let interior =
        |&i: &usize| (3..columns - 4).contains(&(i % columns)) && (3..rows - 4).contains(&(i / columns));
    for (number, index) in (0..columns * rows).step_by(step).filter(interior).enumerate() {
        let (column, row) = (index % columns, index / columns);
        let part = DVec2::new(number as f64 * 0.618_034, number as f64 * 0.381_966 + 0.25).fract();
        let centre = map.surface.texel_centre(map.texels, column as u32, row as u32).truncate();
        let point = (centre + DVec2::new(part.x * texel_m[0], -part.y * texel_m[1])).extend(0.0).as_vec3();
        let around = [
            (0, 0, (1.0 - part.x) * (1.0 - part.y)),
            (1, 0, part.x * (1.0 - part.y)),
            (0, 1, (1.0 - part.x) * part.y),
            (1, 1, part.x * part.y),
        ];
        let wanted =
            around.map(|(right, down, share)| (reduction.of(map, column + right, row + down), share));
        let near = |splat: &usize| {
            let [x, y] = places[*splat];
            f64::from((x - point.x).abs()) < 2.6 * texel_m[0]
                && f64::from((y - point.y).abs()) < 2.6 * texel_m[1]
        };
        let near: Vec<usize> = (0..made.count).filter(near).collect();
        for direction in &views {
            let v = -direction.as_vec3();
            let seen = seen(&ply, &near, point, v);
            for c in 0..3 {
                let want: f64 = wanted.iter().map(|(harmonics, share)| share * level(&harmonics[c], v)).sum();
                drawn += 255.0 * (seen[c] - want).abs();
                drawn_count += 1.0;
            }
        }
        for direction in &reduction.directions {
            let truth = map.radiance_at(DVec2::new(column as f64, row as f64), *direction);
            for (harmonics, truth) in wanted[0].0.iter().zip(truth) {
                reduced += 255.0 * (level(harmonics, -*direction) - f64::from(expose(truth, GAMMA))).abs();
                reduced_count += 1.0;
            }
        }
    }
    let (drawn, reduced) = (drawn / drawn_count, reduced / reduced_count);
    let overlap_255 = made.overlap_255.unwrap();
    println!(
        "{columns}x{rows}: {} splats, drawn against the harmonics {drawn:.2} (stated {:.2}), harmonics against the map {reduced:.2} (stated {:.2}) of 255",
        made.count, overlap_255, made.mean_255
    );
    assert!(drawn <= 2.0, "{drawn}");
    // What is stated is true.
    assert!((reduced / made.mean_255 - 1.0).abs() < 0.15, "{reduced} {}", made.mean_255);
    assert!((drawn - overlap_255).abs() < 0.3 * drawn.max(0.5), "{drawn} {overlap_255}");
    made
}

#[test]
fn another_renderer_sees_what_the_harmonics_say() {
    let texels = Texels { columns: 24, rows: 18 };
    let (surface, observed) = observed(texels);
    let made = compare(&fitted(surface, texels, Model::Phong { lobes: 1 }, &observed), 3);
    assert_eq!(made.count, 9 * texels.count());
}

#[test]
fn a_large_map_has_one_splat_for_each_texel_and_is_seen_as_well() {
    let texels = Texels { columns: 512, rows: 300 };
    let made = compare(&one_lobe(texels), 1511);
    assert_eq!(made.count, texels.count());
}

#[test]
fn what_three_degrees_can_say_costs_nothing() {
    let texels = Texels { columns: 6, rows: 4 };
    let (surface, observed) = observed(texels);
    let map = fitted(surface, texels, Model::Constant, &observed);
    let made = splats(&map, GAMMA, &Silent).unwrap();
    assert!(made.mean_255 < 0.05, "{}", made.mean_255);
    assert!(splats(&map, 0.0, &Silent).is_err());
}

#[test]
fn a_map_that_is_nearly_all_border_is_not_said_to_cost_nothing() {
    let made = splats(&one_lobe(Texels { columns: 2, rows: 40 }), GAMMA, &Silent).unwrap();
    assert_eq!(made.overlap_255, None);
}

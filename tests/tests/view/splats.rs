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

fn smooth_map() -> ParameterMap {
    let texels = Texels { columns: 24, rows: 18 };
    let (surface, observed) = observed(texels);
    fitted(surface, texels, Model::Phong { lobes: 1 }, &observed)
}

#[test]
fn another_renderer_sees_what_the_harmonics_say() {
    let map = smooth_map();
    let made = splats(&map, GAMMA, &Silent).unwrap();
    println!("degree 3 costs {:.2} of 255, 95 % within {:.1}", made.mean_255, made.most_255);
    let ply = Ply::read(&made.ply);
    assert_eq!(ply.rows.len(), made.count);
    let places: Vec<[f32; 2]> = (0..made.count).map(|row| [ply.get(row, "x"), ply.get(row, "y")]).collect();
    let texel_m = [map.surface.width_m / 24.0, map.surface.height_m / 18.0].map(|length| length as f32);
    let (mut drawn, mut drawn_count, mut reduced, mut reduced_count) = (0.0, 0.0, 0.0, 0.0);
    let interior = |i: usize| (2..22).contains(&(i % 24)) && (2..16).contains(&(i / 24));
    for index in (0..24 * 18).step_by(5).filter(|&i| interior(i)) {
        let (column, row) = (index % 24, index / 24);
        let point = map.surface.texel_centre(map.texels, column as u32, row as u32).as_vec3();
        let near = |splat: &usize| {
            let [x, y] = places[*splat];
            (x - point.x).abs() < 1.4 * texel_m[0] && (y - point.y).abs() < 1.4 * texel_m[1]
        };
        let near: Vec<usize> = (0..made.count).filter(near).collect();
        let own = near.iter().copied().min_by(|&a, &b| {
            let off = |i: usize| (places[i][0] - point.x).hypot(places[i][1] - point.y);
            off(a).total_cmp(&off(b))
        });
        let own = own.unwrap();
        for direction in spiral(10, 65f64.to_radians()).unwrap() {
            let v = -direction.as_vec3();
            let (own, seen) = (colour(&ply, own, v), seen(&ply, &near, point, v));
            drawn += (0..3).map(|c| 255.0 * (seen[c] - own[c]).abs()).sum::<f64>();
            drawn_count += 3.0;
        }
    }
    // What is stated is true.
    for index in (0..24 * 18).step_by(7) {
        let (column, row) = (index % 24, index / 24);
        for direction in spiral(160, 80f64.to_radians()).unwrap() {
            // All splats of a texel have its colour.
            let own = colour(&ply, index * made.count / (24 * 18), -direction.as_vec3());
            let truth = map.radiance_at(DVec2::new(column as f64, row as f64), direction.as_vec3());
            reduced +=
                (0..3).map(|c| 255.0 * (own[c] - f64::from(expose(truth[c], GAMMA))).abs()).sum::<f64>();
            reduced_count += 3.0;
        }
    }
    let (drawn, reduced) = (drawn / drawn_count, reduced / reduced_count);
    println!("drawn against the harmonics {drawn:.2}, harmonics against the map {reduced:.2} of 255");
    assert!(drawn <= 2.0, "{drawn}");
    assert!((reduced / made.mean_255 - 1.0).abs() < 0.15, "{reduced} {}", made.mean_255);
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

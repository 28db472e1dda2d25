//! A camera for tests: known radiance in, levels out, through shot noise, read noise, a response and rounding.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::Stack;
use crate::picture::Picture;

/// A response as a camera's: level (0 to 1) from exposure (0 to 1).
pub type Curve = fn(f64) -> f64;

/// Curves unlike each other: plain gamma, one with an S, a straight line.
pub const CURVES: [(&str, Curve); 3] = [
    ("gamma", |x| x.powf(1.0 / 2.2)),
    ("sigmoid", |x| {
        let g = x.sqrt();
        g * (1.0 + 0.35 * (1.0 - g) * (std::f64::consts::PI * g).sin())
    }),
    ("linear", |x| x),
];

/// Electrons at white.
pub const WELL: f64 = 20_000.0;
/// Read noise, electrons.
pub const READ: f64 = 8.0;

/// The exposure (0 to 1) that a curve takes to a level.
pub fn truth(curve: Curve, level: usize) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if curve(middle) < level as f64 / 255.0 { low = middle } else { high = middle }
    }
    (low + high) / 2.0
}

/// 5 decades of smooth and textured radiance, its median about 0.2.
pub fn scene(width: usize, height: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = StdRng::seed_from_u64(seed);
    let tiles: Vec<f64> =
        (0..width.div_ceil(16) * height.div_ceil(16)).map(|_| random.random_range(0.6..1.6)).collect();
    let pixels = (0..width * height).map(|i| {
        let (column, row) = (i % width, i / width);
        let (x, y) = (column as f64 / width as f64, row as f64 / height as f64);
        let log = -2.5 + 5.0 * (0.5 * x + 0.5 * (3.0 * x + 5.0 * y).sin().abs());
        let tile = tiles[row / 16 * width.div_ceil(16) + column / 16];
        let radiance = 0.18 * 10f64.powf(log) * tile;
        [radiance * (1.0 + 0.3 * (4.0 * x).sin()), radiance, radiance * (1.0 + 0.3 * (3.0 * y).cos())]
    });
    pixels.collect()
}

/// Photographs a scene; `noise` scales the sensor's noise.
pub fn shoot(
    radiance: &[[f64; 3]],
    width: usize,
    times: &[f64],
    curve: Curve,
    noise: f64,
    seed: u64,
) -> Stack {
    let mut random = StdRng::seed_from_u64(seed);
    let fine: Vec<f64> = (0..=65536).map(|i| 255.0 * curve(f64::from(i) / 65536.0)).collect();
    let pictures = times.iter().map(|time_s| {
        let level = |radiance: f64, random: &mut StdRng| {
            let electrons = (radiance * time_s * WELL).min(1e7);
            let sigma = noise * (electrons + READ * READ).sqrt();
            let x = ((electrons + sigma * normal(random)) / WELL).clamp(0.0, 1.0) * 65536.0;
            let (below, part) = (x as usize, x.fract());
            (fine[below] * (1.0 - part) + fine[(below + 1).min(65536)] * part).round() as u16
        };
        Picture {
            path: "simulated".into(),
            width: width as u32,
            height: (radiance.len() / width) as u32,
            levels: radiance.iter().map(|rgb| rgb.map(|r| level(r, &mut random))).collect(),
            white: 255,
        }
    });
    Stack::new(pictures.collect(), times.to_vec()).unwrap()
}

/// A standard normal number (Box and Muller): the Poisson counts here are large enough to be normal.
pub fn normal(random: &mut StdRng) -> f64 {
    let (a, b): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

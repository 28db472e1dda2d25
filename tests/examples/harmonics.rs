//! How the smooth bases do where the views end at zenith 75 degrees, and what a fit costs.
//!
//! `cargo run --release -p rigel-tests --example harmonics`
//!
//! 289 scattered views down to zenith 75 degrees see a lobe of shininess 15 (then 100) on a constant, with noise of 1 % and
//! 0.002, as in the peers' `b_sh.py`. For every method and order: the condition number of its system, its noise gain (root
//! mean square over the hemisphere of the fitted radiance's standard deviation per standard deviation of an observation;
//! and the greatest), the root mean square error inside zenith 75 and below it, the share of the hemisphere with negative
//! radiance, and the texels whose fit had to be held above zero. `plain` is least squares without penalties on the
//! spherical harmonics, what the peers do; `sh` the same with this program's penalties; `zero` and `lsop` the 2007
//! thesis's. Then the time of a fit from observations in memory: tiles of 32 x 32 texels of a map of 512 x 512 on 0.2 m
//! seen from 0.9 m, 300 views, each texel with its own weights; in processor seconds, which other work on the machine
//! stretches. Reading the observation map is not in it.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::f64::consts::{PI, TAU};
use std::time::Instant;

use glam::{DVec3, Vec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::fit::harmonics::{HarmonicsMethod, Smooth, Weighing};
use rigel::fit::{FitOptions, Fitter, Model};
use rigel::observation::TexelObservations;

const TEXELS: usize = 128;
const PLAIN: Weighing = Weighing { relative_error: 0.0, floor: 1e-6, robust: false };

fn main() {
    for shininess in if std::env::args().len() > 1 { vec![] } else { vec![15, 100] } {
        println!("289 views down to zenith 75 degrees, a lobe of shininess {shininess}");
        println!(
            "{:<10} {:>9} {:>6} {:>8} {:>8} {:>8} {:>10} {:>6}",
            "method", "condition", "gain", "greatest", "inside", "below", "negative", "held"
        );
        accuracy(shininess);
    }
    speed();
}

fn normal(random: &mut StdRng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// Spread evenly down to `zenith_max_rad`.
fn cap(count: usize, zenith_max_rad: f64) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |i| {
        let i = i as f64 + 0.5;
        let z = 1.0 - i / count as f64 * (1.0 - zenith_max_rad.cos());
        let (s, azimuth) = ((1.0 - z * z).sqrt(), PI * (1.0 + 5.0_f64.sqrt()) * i);
        DVec3::new(s * azimuth.cos(), s * azimuth.sin(), z)
    })
}

fn accuracy(shininess: i32) {
    let mut random = StdRng::seed_from_u64(5);
    let mut scatter = |d: DVec3| {
        let off = DVec3::new(normal(&mut random), normal(&mut random), normal(&mut random));
        (d + 1.5_f64.to_radians() * off).normalize()
    };
    let views: Vec<DVec3> = cap(289, 73.5_f64.to_radians()).map(&mut scatter).collect();
    let axes: Vec<DVec3> = (0..TEXELS)
        .map(|_| {
            let (z, azimuth) = (0.5 + 0.5 * random.random::<f64>(), TAU * random.random::<f64>());
            let s = (1.0 - z * z).sqrt();
            DVec3::new(s * azimuth.cos(), s * azimuth.sin(), z)
        })
        .collect();
    let truth = |axis: DVec3, d: DVec3| 0.3 + 0.7 * axis.dot(d).max(0.0).powi(shininess);
    let texels: Vec<TexelObservations> = axes
        .iter()
        .map(|axis| TexelObservations {
            view: (0..289).collect(),
            direction: views.iter().map(|d| d.as_vec3()).collect(),
            radiance: views
                .iter()
                .map(|d| {
                    let seen = truth(*axis, *d);
                    [(); 3].map(|()| {
                        (seen * (1.0 + 0.01 * normal(&mut random)) + 0.002 * normal(&mut random)) as f32
                    })
                })
                .collect(),
            // Equal weights, as the peers have them.
            sigma: vec![0.005; 289],
        })
        .collect();
    let everywhere: Vec<DVec3> = cap(4000, 0.5 * PI).collect();
    let report = |name: &str,
                  stability: &str,
                  method: HarmonicsMethod,
                  order: u8,
                  fits: &[Vec<f32>],
                  held| {
        let (mut inside, mut below, mut negative) = ((0.0, 0), (0.0, 0), 0);
        for (parameters, axis) in fits.iter().zip(&axes) {
            for direction in &everywhere {
                let got = method.radiance(order, parameters, *direction)[0];
                let to = if direction.z >= 75.0_f64.to_radians().cos() { &mut inside } else { &mut below };
                *to = (to.0 + (got - truth(*axis, *direction)).powi(2), to.1 + 1);
                negative += usize::from(got < 0.0);
            }
        }
        let rms = |(sum, count): (f64, i32)| (sum / f64::from(count)).sqrt();
        let share = 100.0 * negative as f64 / (TEXELS * everywhere.len()) as f64;
        println!("{name:<10} {stability} {:>8.4} {:>8.4} {share:>8.3} % {held:>6}", rms(inside), rms(below));
    };
    for method in HarmonicsMethod::ALL {
        for order in method.orders() {
            let name = Model::Harmonics { order, method }.name();
            if matches!(method, HarmonicsMethod::ZeroHemisphere | HarmonicsMethod::Lsop) {
                let options = FitOptions { robust: false, ..FitOptions::default() };
                let fitter = Fitter::new(Model::Harmonics { order, method }, &options, &texels).unwrap();
                let fits: Vec<_> = texels.iter().map(|texel| fitter.fit(texel).parameters).collect();
                report(&name, &format!("{:>9} {:>6} {:>8}", "", "", ""), method, order, &fits, 0);
                continue;
            }
            let direct = method == HarmonicsMethod::Smoothed;
            for (name, penalty) in [(name, None), (format!("plain{}", method.count(order)), Some(0.0))] {
                if penalty.is_some() && !direct {
                    continue;
                }
                let smooth = Smooth::new(method, order, penalty, PLAIN, &texels);
                let stability = smooth.stability(&views);
                let figures = format!(
                    "{:>9.1e} {:>6.3} {:>8.2}",
                    stability.condition, stability.noise_gain, stability.noise_gain_max
                );
                let (fits, held): (Vec<_>, usize) = if direct {
                    (texels.iter().map(|texel| smooth.fit_directly(texel).unwrap()).collect(), 0)
                } else {
                    let fits = smooth.fit_tile(&texels.iter().collect::<Vec<_>>());
                    let held = fits.iter().filter(|fit| fit.held).count();
                    (fits.into_iter().map(|fit| fit.parameters).collect(), held)
                };
                report(&name, &figures, method, order, &fits, held);
            }
        }
    }
}

/// Seconds that this thread has been on a processor; where the system does not say, seconds.
fn busy_s(start: Instant) -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split(' ').next().and_then(|word| word.parse::<f64>().ok());
    nanoseconds.map_or_else(|| start.elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

fn speed() {
    let start = Instant::now();
    let mut random = StdRng::seed_from_u64(6);
    let tile: Vec<TexelObservations> = (0..1024)
        .map(|i| {
            let place = DVec3::new(f64::from(i % 32) - 15.5, f64::from(i / 32) - 15.5, 0.0) * 0.2 / 512.0;
            let (shininess, axis) = (5.0 + 20.0 * i as f32 / 1024.0, Vec3::new(0.4, 0.2, 0.8).normalize());
            let mut texel = TexelObservations::default();
            for (view, toward) in cap(300, 75.0_f64.to_radians()).enumerate() {
                let direction = (0.9 * toward - place).normalize().as_vec3();
                let seen = 0.3 + 0.7 * axis.dot(direction).max(0.0).powf(shininess);
                let sigma = (0.01 * seen).hypot(0.002);
                texel.view.push(view as u32);
                texel.direction.push(direction);
                texel.radiance.push([(); 3].map(|()| seen + sigma * normal(&mut random) as f32));
                texel.sigma.push(sigma);
            }
            texel
        })
        .collect();
    let texels: Vec<_> = tile.iter().collect();
    println!("512 x 512 texels x 300 views x RGB, from memory: the best of five times eight tiles");
    println!("{:<10} {:>16} {:>24}", "method", "us per texel", "s for all, two cores");
    for method in HarmonicsMethod::ALL.into_iter().filter(|method| method.is_on_the_hemisphere()) {
        for order in method.orders() {
            let weighing = Weighing { relative_error: 0.03, floor: 0.015, robust: false };
            let smooth = Smooth::new(method, order, Some(1e-6), weighing, &tile[..64]);
            // Several tiles at once: the system's clock may tick in 4 ms.
            let some = || {
                let before = busy_s(start);
                (0..8).for_each(|_| drop(std::hint::black_box(smooth.fit_tile(&texels))));
                (busy_s(start) - before) / 8.0
            };
            let best = (0..5).map(|_| some()).fold(f64::INFINITY, f64::min) / 1024.0;
            let all_s = best * 512.0 * 512.0 / 2.0;
            println!("{:<10} {:>16.1} {all_s:>24.2}", Model::Harmonics { order, method }.name(), 1e6 * best);
        }
    }
}

//! Texels whose radiance is known, what noisy views measure of them, and maps of them.

use std::path::Path;

use glam::Vec3;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::Result;
use rigel::geometry::{Surface, Texels};
use rigel::observation::{Header, ObservationMap, ObservedView, Sample, TexelObservations};

/// What makes a measurement differ from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Doubt {
    /// Noise as a part of the radiance.
    pub relative: f32,
    /// Noise as a radiance.
    pub absolute: f32,
    /// Radiance beyond which nothing is measured.
    pub clip: f32,
    /// Standard deviation of the directions' error, each of two angles, radians.
    pub direction_rad: f32,
}

impl Doubt {
    /// A good camera: 1 % and 0.002.
    pub const USUAL: Self = Self { relative: 0.01, absolute: 0.002, clip: f32::INFINITY, direction_rad: 0.0 };
}

/// A texel's true radiance: a diffuse colour, lobes, and smooth terms.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Radiance in all directions.
    pub diffuse: Vec3,
    /// Colour, direction, shininess.
    pub lobes: Vec<(Vec3, Vec3, f32)>,
    /// Colour of each of the nine lowest polynomials of the direction.
    pub smooth: [Vec3; 9],
}

impl Truth {
    /// Toward a unit vector.
    pub fn radiance(&self, d: Vec3) -> Vec3 {
        let lobes = self
            .lobes
            .iter()
            .map(|(colour, axis, shininess)| *colour * axis.dot(d).max(0.0).powf(*shininess));
        let terms = [
            d.x,
            d.y,
            d.z,
            d.x * d.y,
            d.y * d.z,
            d.x * d.z,
            d.x * d.x - d.y * d.y,
            d.z * d.z,
            d.z * d.z * d.x,
        ];
        let smooth = self.smooth.iter().zip(terms).map(|(colour, term)| *colour * term);
        self.diffuse + lobes.sum::<Vec3>() + smooth.sum::<Vec3>()
    }
}

fn colour(random: &mut StdRng, low: f32, high: f32) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|_| random.random_range(low..high)))
}

fn direction(random: &mut StdRng, least_z: f32) -> Vec3 {
    let (z, azimuth) = (random.random_range(least_z..1.0), random.random_range(0.0..std::f32::consts::TAU));
    let across = (1.0 - z * z).sqrt();
    Vec3::new(across * azimuth.cos(), across * azimuth.sin(), z)
}

/// Lobes of 5 to 100, 25 degrees apart at least.
pub fn lobes(random: &mut StdRng, count: usize) -> Truth {
    let mut axes: Vec<Vec3> = vec![];
    while axes.len() < count {
        let axis = direction(random, 0.5);
        if axes.iter().all(|other| other.angle_between(axis) > 25f32.to_radians()) {
            axes.push(axis);
        }
    }
    let lobe = |axis| (colour(random, 0.1, 0.9), axis, random.random_range(5f32.ln()..100f32.ln()).exp());
    let lobes = axes.into_iter().map(lobe).collect();
    Truth { diffuse: colour(random, 0.05, 0.6), lobes, smooth: [Vec3::ZERO; 9] }
}

/// A lamp of 10 to 20 degrees radius seen in a glossy surface.
pub fn area_lamps(random: &mut StdRng) -> Truth {
    let axis = direction(random, 0.6);
    let (a, b) = axis.any_orthonormal_pair();
    let (radius, shine) = (random.random_range(0.17..0.35f32), random.random_range(40.0..150.0));
    let light = colour(random, 0.2, 0.9);
    let points = (0..60).map(|i| {
        let (r, turn) = (radius * ((i as f32 + 0.5) / 60.0).sqrt(), 2.399_963 * i as f32);
        (light / 20.0, (axis + (a * turn.cos() + b * turn.sin()) * r.tan()).normalize(), shine)
    });
    Truth { lobes: points.collect(), diffuse: colour(random, 0.05, 0.6), smooth: [Vec3::ZERO; 9] }
}

/// No lobe: a polynomial of the direction.
pub fn smooth(random: &mut StdRng) -> Truth {
    let smooth = std::array::from_fn(|_| colour(random, -0.06, 0.06));
    Truth { diffuse: colour(random, 0.6, 0.9), lobes: vec![], smooth }
}

/// Directions spread evenly down to `zenith_rad`, turned by `offset`.
pub fn directions(count: usize, zenith_rad: f32, offset: f32) -> Vec<Vec3> {
    let least = zenith_rad.cos();
    let of = |i: usize| {
        let z = 1.0 - (1.0 - least) * (i as f32 + 0.5) / count as f32;
        let (azimuth, across) = (2.399_963 * i as f32 + offset, (1.0 - z * z).max(0.0).sqrt());
        Vec3::new(across * azimuth.cos(), across * azimuth.sin(), z)
    };
    (0..count).map(of).collect()
}

fn normal(random: &mut StdRng) -> f32 {
    let (a, b): (f32, f32) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}

/// Radiance as it is measured, and its standard deviation.
pub fn noisy(truth: &Truth, direction: Vec3, doubt: &Doubt, random: &mut StdRng) -> ([f32; 3], f32) {
    let exact = truth.radiance(direction).to_array();
    let sigma = |l: f32| (doubt.relative * l).hypot(doubt.absolute);
    (exact.map(|l| l + sigma(l) * normal(random)), sigma(exact[1]))
}

/// What views from these directions measure; clipped ones are absent.
pub fn observe(truth: &Truth, directions: &[Vec3], doubt: &Doubt, seed: u64) -> TexelObservations {
    let mut random = StdRng::seed_from_u64(seed);
    let mut observed = TexelObservations::default();
    for (view, &direction) in directions.iter().enumerate() {
        let (radiance, sigma) = noisy(truth, direction, doubt, &mut random);
        let (a, b) = direction.any_orthonormal_pair();
        let turn = (a * normal(&mut random) + b * normal(&mut random)) * doubt.direction_rad;
        if radiance.iter().all(|l| *l <= doubt.clip) {
            observed.view.push(view as u32);
            observed.direction.push((direction + turn).normalize());
            observed.radiance.push(radiance);
            observed.sigma.push(sigma);
        }
    }
    observed
}

/// Writes what was measured of each texel, row by row, as the observation map of a surface so small that all its texels are seen
/// from the same directions: those of the views, `toward`.
///
/// # Errors
/// [`rigel::Error::Io`] when the file cannot be written.
pub fn write_map(
    path: &Path,
    texels: Texels,
    toward: &[Vec3],
    observed: &[TexelObservations],
) -> Result<ObservationMap> {
    let surface =
        Surface { width_m: 1e-3, height_m: 1e-3 * f64::from(texels.rows) / f64::from(texels.columns) };
    let view = |(i, direction): (usize, &Vec3)| ObservedView {
        name: format!("view{i:04}"),
        centre_m: direction.as_dvec3(),
        gain: 1.0,
    };
    let header = Header::new(surface, texels, 1.0, toward.iter().enumerate().map(view).collect());
    ObservationMap::create(path, &header, &mut |view| {
        let of = |texel: &TexelObservations| {
            let i = texel.view.iter().position(|of| *of as usize == view)?;
            Some(Sample { radiance: texel.radiance[i], sigma: texel.sigma[i] })
        };
        Ok(observed.iter().map(of).collect())
    })
}

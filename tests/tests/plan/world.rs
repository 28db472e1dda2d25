//! The patchwork seen from chosen directions, and how well a fit predicts all others.

use std::fs;
use std::path::PathBuf;

use glam::DVec3;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use rigel::geometry::{Lens, Pose, Texels};
use rigel::observation::{ObservationMap, Options, TexelObservations, observe};
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render::{expose, gamma_for_median};
use rigel::sampling::{pan_tilt, stratified};
use rigel::session::{Event, Manifest, Photograph, Session, View};
use rigel_simulated::camera::{self, SimulatedCamera};
use rigel_simulated::scene::Scene;
use tempfile::TempDir;

/// Nobody photographs further down, and errors are measured down to there.
pub const ZENITH_RAD: f64 = 1.309;
/// Noise of a pixel's radiance, as a part of it and as a radiance: what halved exposure times leave.
const RELATIVE_NOISE: f32 = 0.013;
const NOISE: f32 = 0.002;
const DISTANCE_M: f64 = 0.9;

/// A board, a camera, and directions in which nobody photographs for the fit.
pub struct World {
    scene: Scene,
    lens: Lens,
    texels: Texels,
    folder: TempDir,
    truth: Vec<TexelObservations>,
    gamma: f32,
}

/// How far predictions are off, of 255.
#[derive(Debug, Clone, Copy)]
pub struct Off {
    /// Mean of the absolute difference.
    pub mean: f64,
    /// Root mean square.
    pub rms: f64,
}

impl World {
    /// The patchwork through a lens of so many columns of pixels, in so many columns of texels, compared in `fresh` directions.
    pub fn new(pixels: u32, columns: u32, fresh: usize) -> Self {
        let lens = camera::Options::default().lens.scaled_to(pixels, pixels * 3 / 4);
        let texels = Texels { columns, rows: columns * 3 / 4 };
        let folder = tempfile::tempdir().unwrap();
        let mut world = Self { scene: Scene::patchwork(), lens, texels, folder, truth: vec![], gamma: 1.0 };
        let map = world.see("truth", &stratified(fresh, ZENITH_RAD, 99).unwrap(), false);
        world.truth = texels_of(&map);
        let all: Vec<f32> =
            world.truth.iter().flat_map(|texel| texel.radiance.as_flattened()).copied().collect();
        world.gamma = gamma_for_median(&all).unwrap();
        world
    }

    /// What noisy photographs from these directions make of the surface.
    pub fn photograph(&self, name: &str, views: &[DVec3]) -> ObservationMap {
        self.see(name, views, true)
    }

    fn see(&self, name: &str, views: &[DVec3], noise: bool) -> ObservationMap {
        let mut manifest = Manifest::new("simulated");
        manifest.surface = Some(self.scene.surface());
        manifest.distance_m = Some(DISTANCE_M);
        manifest.lenses = vec![self.lens];
        let angles: Vec<(f64, f64)> = views.iter().map(|view| pan_tilt(*view)).collect();
        let view = |(i, (pan_rad, tilt_rad)): (usize, &(f64, f64))| View {
            name: format!("view{i:03}"),
            pan_deg: Some(pan_rad.to_degrees()),
            tilt_deg: Some(tilt_rad.to_degrees()),
            lens: 0,
            pose: None,
        };
        manifest.views = angles.iter().enumerate().map(view).collect();
        let folder = self.folder.path().join(name);
        let mut session = Session::create(&folder, manifest).unwrap();
        fs::create_dir(session.radiance_folder()).unwrap();
        let pictures: Vec<PathBuf> = angles.par_iter().map(|&angles| self.picture(angles, noise)).collect();
        for (view, picture) in pictures.iter().enumerate() {
            let file = format!("photographs/{view}.png");
            let photograph = Photograph { view, file, exposure_s: Some(1.0), ..Photograph::default() };
            session.record(Event::Photograph(photograph)).unwrap();
            session.record(Event::ViewDone { view }).unwrap();
            fs::copy(picture, session.radiance_path(view)).unwrap();
        }
        let path = folder.join("observations.rigel");
        observe(&session, &path, &Options { texels: self.texels }, &Silent).unwrap()
    }

    /// The radiance of one view, rendered once.
    fn picture(&self, (pan_rad, tilt_rad): (f64, f64), noise: bool) -> PathBuf {
        let path = self.folder.path().join(format!("{pan_rad:.6},{tilt_rad:.6},{noise}.exr"));
        if path.exists() {
            return path;
        }
        let options = camera::Options { lens: self.lens, ..camera::Options::default() };
        let camera = SimulatedCamera::new(self.scene.clone(), options, || (0.0, 0.0));
        let mut image = camera.truth(&Pose::from_rig(pan_rad, tilt_rad, DISTANCE_M));
        let mut random =
            StdRng::seed_from_u64((pan_rad * 1e6) as i64 as u64 ^ ((tilt_rad * 1e6) as u64) << 32);
        for (radiance, variance) in image.radiance.iter_mut().zip(&mut image.variance) {
            for (value, variance) in radiance.iter_mut().zip(variance) {
                let sigma = (RELATIVE_NOISE * *value).hypot(NOISE);
                *variance = sigma * sigma;
                if noise {
                    *value = (*value + sigma * normal(&mut random)).max(0.0);
                }
            }
        }
        image.write_exr(&path, "simulated").unwrap();
        path
    }

    /// How far a fit's predictions are off in directions that it has not seen.
    pub fn off(&self, map: &ParameterMap) -> Off {
        let (mut mean, mut squares, mut count) = (0.0, 0.0, 0.0);
        for (index, truth) in self.truth.iter().enumerate() {
            let index = index as u32;
            let (model, parameters) = map.texel(index % self.texels.columns, index / self.texels.columns);
            for (direction, measured) in truth.direction.iter().zip(&truth.radiance) {
                for (predicted, measured) in model.radiance(parameters, *direction).iter().zip(measured) {
                    let miss = expose(*predicted, self.gamma) - expose(*measured, self.gamma);
                    mean += f64::from(miss.abs());
                    squares += f64::from(miss * miss);
                    count += 1.0;
                }
            }
        }
        Off { mean: 255.0 * mean / count, rms: 255.0 * (squares / count).sqrt() }
    }
}

fn texels_of(map: &ObservationMap) -> Vec<TexelObservations> {
    let texels = map.header().texels;
    let mut all = vec![TexelObservations::default(); texels.count()];
    for tile in 0..map.header().tiles().count() {
        for ((column, row), texel) in map.tile(tile).unwrap() {
            all[(row * texels.columns + column) as usize] = texel;
        }
    }
    all
}

fn normal(random: &mut StdRng) -> f32 {
    let (a, b): (f32, f32) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}

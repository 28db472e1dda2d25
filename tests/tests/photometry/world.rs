//! The simulated patchwork in radiance, as a rig's camera would have measured it under a lamp and through a lens that are known.

use std::fs;

use glam::{DVec2, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::calibration::Photometry;
use rigel::evaluate::{Reference, evaluate};
use rigel::fit::{FitOptions, Model};
use rigel::geometry::{Lens, Pose, Texels};
use rigel::observation::{self, observe};
use rigel::parameter_map::fit_surface;
use rigel::photometry::{self, Options};
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::rig::RigLimits;
use rigel::sampling::{pan_tilt, spiral, stratified, tour};
use rigel::session::{Event, Manifest, Photograph, Session, View};
use rigel_simulated::camera::{self, SimulatedCamera};
use rigel_simulated::scene::Scene;

const ZENITH_RAD: f64 = 1.2;
const DISTANCE_M: f64 = 0.9;
/// Noise of a pixel's radiance, as a part of it and as a radiance.
const RELATIVE_NOISE: f32 = 0.01;
const NOISE: f32 = 0.002;
const TEXELS: Texels = Texels { columns: 32, rows: 24 };

pub fn normal(random: &mut StdRng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// A lamp that is another one in each view, by `size` (standard deviation).
pub fn flicker(size: f64, view: usize, seed: u64) -> [f64; 3] {
    let mut random = StdRng::seed_from_u64(1000 * seed + view as u64);
    [(size * normal(&mut random)).exp(); 3]
}

/// A lamp that grows brighter by `size` while the views are taken, first quickly.
pub fn warming(size: f64, view: usize, views: usize) -> [f64; 3] {
    let time = view as f64 / (views - 1) as f64;
    [(-size * (-3.0 * time).exp()).exp(); 3]
}

/// What a perfect camera sees.
pub struct World {
    pub camera: SimulatedCamera<fn() -> (f64, f64)>,
    pub lens: Lens,
    directions: Vec<DVec3>,
    truth: Vec<RadianceImage>,
    references: Vec<Reference>,
    surface: rigel::geometry::Surface,
}

pub struct Found {
    pub mean_255: f64,
    pub photometry: Photometry,
    views: usize,
}

impl World {
    /// Seen from so many directions, in the order of a rig's tour.
    pub fn new(views: usize) -> Self {
        let directions = spiral(views, ZENITH_RAD).unwrap();
        let limits = RigLimits {
            pan_rad: [-3.2, 3.2],
            tilt_rad: [-1.6, 1.6],
            speed_rad_s: 0.5,
            acceleration_rad_s2: 1.0,
            settle_s: 0.5,
        };
        let order = tour(&directions, &limits).unwrap();
        Self::of(Scene::patchwork(), order.iter().map(|stop| directions[stop.view]).collect())
    }

    pub fn of(scene: Scene, directions: Vec<DVec3>) -> Self {
        let lens = camera::Options::default().lens.scaled_to(160, 120);
        let options = camera::Options { lens, ..camera::Options::default() };
        let surface = scene.surface();
        let home: fn() -> (f64, f64) = || (0.0, 0.0);
        let camera = SimulatedCamera::new(scene, options, home);
        let pose = |direction: DVec3| {
            let (pan, tilt) = pan_tilt(direction);
            Pose::from_rig(pan, tilt, DISTANCE_M)
        };
        let truth = directions.iter().map(|direction| camera.truth(&pose(*direction))).collect();
        let fresh = stratified(12, ZENITH_RAD, 7).unwrap();
        let reference = |direction: &DVec3| Reference {
            name: format!("{direction}"),
            lens,
            pose: pose(*direction),
            radiance: camera.truth(&pose(*direction)),
            exposure_time_known: true,
        };
        let references = fresh.iter().map(reference).collect();
        Self { camera, lens, directions, truth, references, surface }
    }

    /// A session with radiance under this lamp, with or without vignetting.
    pub fn session(
        &self,
        folder: &std::path::Path,
        gain: &dyn Fn(usize) -> [f64; 3],
        vignetting: bool,
    ) -> Session {
        let mut manifest = Manifest::new("simulated");
        manifest.surface = Some(self.surface);
        manifest.distance_m = Some(DISTANCE_M);
        manifest.lenses = vec![self.lens];
        let view = |(i, direction): (usize, &DVec3)| {
            let (pan_rad, tilt_rad) = pan_tilt(*direction);
            View {
                name: format!("view{i:03}"),
                pan_deg: Some(pan_rad.to_degrees()),
                tilt_deg: Some(tilt_rad.to_degrees()),
                lens: 0,
                pose: None,
            }
        };
        manifest.views = self.directions.iter().enumerate().map(view).collect();
        let mut session = Session::create(folder, manifest).unwrap();
        fs::create_dir(session.radiance_folder()).unwrap();
        fs::write(session.radiance_folder().join("made_from.txt"), "a test").unwrap();
        let mut random = StdRng::seed_from_u64(5);
        for (view, truth) in self.truth.iter().enumerate() {
            let file = format!("photographs/{view}.png");
            let photograph = Photograph { view, file, exposure_s: Some(1.0), ..Photograph::default() };
            session.record(Event::Photograph(photograph)).unwrap();
            session.record(Event::ViewDone { view }).unwrap();
            let (mut image, gain) = (truth.clone(), gain(view));
            for (i, (radiance, variance)) in image.radiance.iter_mut().zip(&mut image.variance).enumerate() {
                let pixel = DVec2::new((i % 160) as f64, (i / 160) as f64);
                let lens = if vignetting { self.camera.vignetting(pixel) } else { 1.0 };
                for c in 0..3 {
                    let seen = radiance[c] * (gain[c] * lens) as f32;
                    let sigma = (RELATIVE_NOISE * seen).hypot(NOISE);
                    radiance[c] = (seen + sigma * normal(&mut random) as f32).max(0.0);
                    variance[c] = sigma * sigma;
                }
            }
            image.write_exr(&session.radiance_path(view), "test").unwrap();
        }
        session
    }

    /// What is found in a session.
    pub fn find(&self, gain: &dyn Fn(usize) -> [f64; 3], options: &Options) -> rigel::Result<Photometry> {
        let folder = tempfile::tempdir().unwrap();
        photometry::find(&self.session(&folder.path().join("session"), gain, false), options, &Silent)
    }

    /// What a fit of two lobes makes of it, in directions that nobody photographed.
    pub fn run(&self, gain: &dyn Fn(usize) -> [f64; 3], vignetting: bool, options: &Options) -> Found {
        let folder = tempfile::tempdir().unwrap();
        let session = self.session(&folder.path().join("session"), gain, vignetting);
        let photometry = photometry::find(&session, options, &Silent).unwrap();
        photometry.write(&session).unwrap();
        let path = session.folder().join("observations.rigel");
        let map = observe(&session, &path, &observation::Options { texels: TEXELS }, &Silent).unwrap();
        let model = Model::Phong { lobes: 2 };
        let fitted = fit_surface(&map, model, &FitOptions::default(), &[], &Silent).unwrap();
        let evaluation = evaluate(&fitted, &self.references, &Silent).unwrap();
        Found { mean_255: evaluation.mean_255(), photometry, views: self.directions.len() }
    }

    /// Where the surface appears, in all pictures.
    fn places(&self) -> Vec<DVec2> {
        let texels = Texels { columns: 9, rows: 7 };
        let points: Vec<DVec3> = (0..63).map(|i| self.surface.texel_centre(texels, i % 9, i / 9)).collect();
        let in_view = |direction: &DVec3| {
            let (pan, tilt) = pan_tilt(*direction);
            let pose = Pose::from_rig(pan, tilt, DISTANCE_M);
            points.iter().filter_map(|point| self.lens.project(pose.to_camera(*point))).collect::<Vec<_>>()
        };
        self.directions.iter().flat_map(in_view).collect()
    }
}

impl Found {
    /// What was found over the truth (logarithms), and its sigma: view by view.
    fn lamp(&self, gain: &dyn Fn(usize) -> [f64; 3], channel: usize) -> Vec<(f64, f64)> {
        let mean = (0..self.views).map(|view| gain(view)[channel].ln()).sum::<f64>() / self.views as f64;
        let one = |view: usize| {
            let (found, sigma) = self.photometry.lamp(&format!("view{view:03}"));
            (found[channel].ln() - gain(view)[channel].ln() + mean, sigma[channel])
        };
        (0..self.views).map(one).collect()
    }

    /// Root mean square of that.
    pub fn lamp_error_of(&self, gain: &dyn Fn(usize) -> [f64; 3], channel: usize) -> f64 {
        let errors = self.lamp(gain, channel);
        (errors.iter().map(|(error, _)| error * error).sum::<f64>() / errors.len() as f64).sqrt()
    }

    pub fn lamp_error(&self, gain: &dyn Fn(usize) -> [f64; 3]) -> f64 {
        self.lamp_error_of(gain, 1)
    }

    pub fn lamp_within_sigma(&self, gain: &dyn Fn(usize) -> [f64; 3]) -> f64 {
        let errors = self.lamp(gain, 1);
        errors.iter().filter(|(error, sigma)| error.abs() <= *sigma).count() as f64 / errors.len() as f64
    }

    /// The fall-off over the true one where the surface was seen, less the mean of that, and how often it is within its sigma there.
    pub fn vignetting_error(&self, world: &World) -> (f64, f64) {
        let Some(vignetting) = &self.photometry.vignetting else { return (f64::INFINITY, 0.0) };
        let places = world.places();
        let off: Vec<f64> = places
            .iter()
            .map(|place| vignetting.at(place.x, place.y).ln() - world.camera.vignetting(*place).ln())
            .collect();
        let count = off.len() as f64;
        let within = off
            .iter()
            .zip(&places)
            .filter(|(off, place)| off.abs() <= vignetting.relative_variance_at(place.x, place.y).sqrt())
            .count() as f64;
        let mean = off.iter().sum::<f64>() / count;
        ((off.iter().map(|off| (off - mean).powi(2)).sum::<f64>() / count).sqrt(), within / count)
    }
}

//! How much time and memory it takes to build and to fit an observation map of 512x512 texels and 300 views:
//!
//! `cargo run --release -p rigel-tests --example surface -- [FOLDER] [MODEL ...]`
//!
//! renders 300 radiance pictures of 320 pixels of the simulated patchwork, builds their map and fits every MODEL (`phong`, `msh66`
//! and `auto`, unless others are named) to it. Says after each step how long it took, by the clock and the processor, and how much
//! memory the process has had resident at most (Linux). FOLDER (default: a new one) keeps pictures and map: a second run there
//! only fits.

use std::fs;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rigel::fit::{FitOptions, Model, candidates};
use rigel::geometry::{Lens, Pose, Texels};
use rigel::observation::{ObservationMap, Options, observe};
use rigel::parameter_map::{Selection, fit_surface, select_surface};
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::render::render;
use rigel::sampling::{pan_tilt, spiral};
use rigel::session::{Event, Manifest, Photograph, Session, View};
use rigel::{Error, Result};
use rigel_atlas::cpu_time;
use rigel_simulated::scene::Scene;

const VIEWS: usize = 300;
const WIDTH: u32 = 320;
const DISTANCE_M: f64 = 0.9;

fn main() -> Result<()> {
    let mut words = std::env::args().skip(1);
    let folder = words.next().map_or_else(|| std::env::temp_dir().join("rigel-surface"), PathBuf::from);
    let mut names: Vec<String> = words.collect();
    if names.is_empty() {
        names = ["phong", "msh66", "auto"].map(String::from).into();
    }
    let path = folder.join("observations.rigel");
    if !path.is_file() {
        let session = match Session::open(&folder) {
            Ok(session) => session,
            Err(_) => make(&folder)?,
        };
        let start = Start::now();
        let texels = Texels { columns: 512, rows: 512 };
        observe(&session, &path, &Options { texels }, &Silent)?;
        start.report(&format!("building from pictures of {WIDTH}x{} pixels", WIDTH * 3 / 4));
    }
    let map = ObservationMap::open(&path)?;
    println!("the map has {:.1} MB", map.header().file_bytes() as f64 / 1e6);
    // From now on it is in the system's cache.
    map.absent()?;
    for name in names {
        let start = Start::now();
        let fitted = match name.as_str() {
            "auto" => select_surface(&map, &candidates(), &Selection::default(), &[], &Silent)?,
            name => fit_surface(&map, Model::parse(name)?, &FitOptions::default(), &[], &Silent)?,
        };
        start.report(&format!("fitting {}", fitted.name()));
        let start = Start::now();
        fitted.write(&folder.join(format!("{name}.exr")))?;
        start.report("and writing it");
    }
    Ok(())
}

fn make(folder: &std::path::Path) -> Result<Session> {
    let scene = Scene::patchwork();
    let mut manifest = Manifest::new("surface");
    let lens = Lens::pinhole(WIDTH, WIDTH * 3 / 4, 700.0);
    manifest.surface = Some(scene.surface());
    manifest.distance_m = Some(DISTANCE_M);
    manifest.lenses = vec![lens];
    let directions = spiral(VIEWS, 75f64.to_radians())?;
    for (view, &direction) in directions.iter().enumerate() {
        let (pan_rad, tilt_rad) = pan_tilt(direction);
        manifest.views.push(View {
            name: format!("view{view:03}"),
            pan_deg: Some(pan_rad.to_degrees()),
            tilt_deg: Some(tilt_rad.to_degrees()),
            lens: 0,
            pose: None,
        });
    }
    let mut session = Session::create(folder, manifest)?;
    fs::create_dir(session.radiance_folder()).map_err(Error::io("create", folder))?;
    for (view, direction) in directions.into_iter().enumerate() {
        let (pan_rad, tilt_rad) = pan_tilt(direction);
        let pose = Pose::from_rig(pan_rad, tilt_rad, DISTANCE_M);
        let seen = |point, toward: glam::Vec3| scene.radiance(point, toward.as_dvec3()).map(|l| l as f32);
        let radiance = render(&scene.surface(), &lens, &pose, seen, &Silent)?.radiance;
        let image = RadianceImage {
            width: lens.width,
            height: lens.height,
            variance: vec![[1e-6; 3]; radiance.len()],
            mask: vec![0; radiance.len()],
            radiance,
        };
        image.write_exr(&session.radiance_path(view), "simulated")?;
        let file = format!("photographs/{view}.png");
        let photograph = Photograph { view, file, exposure_s: Some(1.0), ..Photograph::default() };
        session.record(Event::Photograph(photograph))?;
        session.record(Event::ViewDone { view })?;
    }
    Ok(session)
}

/// When a step began.
struct Start(Instant, Duration);

impl Start {
    fn now() -> Self {
        // Starts the peak anew (Linux 4.0 and later); without it the figures are those of all that came before, too: never too
        // small.
        let _ = fs::write("/proc/self/clear_refs", "5");
        Self(Instant::now(), cpu_time())
    }

    fn report(self, what: &str) {
        let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = |name: &str| {
            let found = status.lines().find_map(|line| line.strip_prefix(name));
            found.map_or_else(|| "unknown".into(), |value| value.trim().to_owned())
        };
        println!(
            "{what}: {:.2} s, {:.2} of the processor; at most {} resident, of which now {}, {} of it anonymous",
            self.0.elapsed().as_secs_f64(),
            (cpu_time() - self.1).as_secs_f64(),
            line("VmHWM:"),
            line("VmRSS:"),
            line("RssAnon:")
        );
    }
}

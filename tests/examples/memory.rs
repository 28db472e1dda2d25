//! How much memory it takes to build and to fit an observation map of 512x512 texels and 300 views:
//!
//! `cargo run --release -p rigel-tests --example memory -- [MODEL] [WIDTH] [FOLDER]`
//!
//! renders 300 radiance pictures of WIDTH pixels (default 320) of the simulated patchwork, builds their map and fits MODEL
//! (default phong) to it, and says after each step how much memory the process has had resident at most (Linux). FOLDER
//! (default: a new one) keeps pictures and map: a second run there with another model only fits.

use std::fs;
use std::path::PathBuf;

use rigel::fit::{FitOptions, Model};
use rigel::geometry::{Lens, Pose, Texels};
use rigel::observation::{ObservationMap, Options, observe};
use rigel::parameter_map::fit_surface;
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::render::render;
use rigel::sampling::{pan_tilt, spiral};
use rigel::session::{Event, Manifest, Photograph, Session, View};
use rigel::{Error, Result};
use rigel_simulated::scene::Scene;

const VIEWS: usize = 300;
const DISTANCE_M: f64 = 0.9;

fn main() -> Result<()> {
    let mut words = std::env::args().skip(1);
    let model = Model::parse(&words.next().unwrap_or_else(|| "phong".into()))?;
    let width: u32 = words.next().and_then(|word| word.parse().ok()).unwrap_or(320);
    let folder = words.next().map_or_else(|| std::env::temp_dir().join("rigel-memory"), PathBuf::from);
    let path = folder.join("observations.rigel");
    if !path.is_file() {
        let session = match Session::open(&folder) {
            Ok(session) => session,
            Err(_) => make(&folder, width)?,
        };
        forget_peak();
        let texels = Texels { columns: 512, rows: 512 };
        observe(&session, &path, &Options { texels }, &Silent)?;
        report(&format!("building from pictures of {width}x{} pixels", width * 3 / 4));
    }
    let map = ObservationMap::open(&path)?;
    println!("the map has {:.1} MB", map.header().file_bytes() as f64 / 1e6);
    forget_peak();
    let fitted = fit_surface(&map, model, &FitOptions::default(), &[], &Silent)?;
    report(&format!("fitting {}", model.name()));
    fitted.write(&folder.join(format!("{}.exr", model.name())))?;
    report("and writing it");
    Ok(())
}

fn make(folder: &std::path::Path, width: u32) -> Result<Session> {
    let scene = Scene::patchwork();
    let mut manifest = Manifest::new("memory");
    let lens = Lens::pinhole(width, width * 3 / 4, 700.0 / 320.0 * f64::from(width));
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

/// Starts the peak anew (Linux 4.0 and later).
fn forget_peak() {
    // Without it the figures are those of all that came before, too: never too small.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

fn report(what: &str) {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = |name: &str| {
        let found = status.lines().find_map(|line| line.strip_prefix(name));
        found.map_or_else(|| "unknown".into(), |value| value.trim().to_owned())
    };
    println!(
        "{what}: at most {} resident, of which now {}, {} of it anonymous",
        line("VmHWM:"),
        line("VmRSS:"),
        line("RssAnon:")
    );
}

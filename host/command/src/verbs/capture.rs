//! `rigel capture`: a rig and a camera make a session.

use glam::DVec3;
use rigel::capture::{self, Plan, add_views, plan};
use rigel::sampling::{Stop, icosphere_near, latitude_longitude_near, spiral, stratified, tour};
use rigel::session::{Manifest, Session};
use rigel::{Error, Result};

use crate::arguments::{Capture, SamplingChoice};
use crate::devices::Devices;
use crate::progress::Bar;
use crate::say::say;

/// `rigel capture`.
pub fn capture(arguments: &Capture) -> Result<()> {
    // First of all: a rig that is opened moves.
    let begun = if arguments.resume { Some(begun(arguments)?) } else { None };
    let mut devices = Devices::open(&arguments.rig, arguments.camera)?;
    let (manifest, done) = match &begun {
        Some(session) => (session.manifest.clone(), session.done_views()),
        None => {
            let directions = directions(arguments)?;
            (new_manifest(&devices, &directions, arguments.longest_exposure_time_s)?.0, vec![])
        }
    };
    let plan = plan(&manifest, &done, devices.rig.as_ref(), devices.camera.as_ref())?;
    if arguments.dry_run {
        say(&plan);
        return Ok(());
    }
    let mut session = match begun {
        Some(session) => session,
        None => Session::create(&arguments.session, manifest)?,
    };
    say(&plan);
    if session.flats()?.is_empty() {
        devices.photograph_flats(&mut session)?;
    }
    capture::capture(&mut session, &mut *devices.rig, &mut *devices.camera, &Bar::new("capturing"))
        .inspect_err(|error| {
            if matches!(error, Error::Interrupted) {
                say!("go on with: rigel capture {} --resume", arguments.session.display());
            }
        })?;
    let photographs: usize = session.done_views().iter().map(|&view| session.photographs(view).len()).sum();
    say!(
        "wrote {}: {} views, {photographs} photographs",
        arguments.session.display(),
        session.done_views().len()
    );
    Ok(())
}

/// The session that is to be completed; nobody else writes into it, and its photographs are those of its journal.
fn begun(arguments: &Capture) -> Result<Session> {
    let mut session = Session::open(&arguments.session)?;
    if !arguments.dry_run {
        session.lock()?;
    }
    for damage in session.verify(arguments.verify, &Bar::new("verifying"))? {
        say!("{damage}: its view is photographed again");
    }
    Ok(session)
}

fn directions(arguments: &Capture) -> Result<Vec<DVec3>> {
    let (count, limit_rad) = (arguments.views, arguments.zenith_limit_deg.to_radians());
    match arguments.sampling {
        SamplingChoice::Spiral => spiral(count, limit_rad),
        SamplingChoice::Icosphere => icosphere_near(count, limit_rad),
        SamplingChoice::LatitudeLongitude => latitude_longitude_near(count, limit_rad),
        SamplingChoice::Stratified => stratified(count, limit_rad, arguments.seed),
    }
}

/// A session of these directions, in the order of a short tour, and that tour.
pub fn new_manifest(
    devices: &Devices,
    directions: &[DVec3],
    longest_exposure_s: f64,
) -> Result<(Manifest, Vec<Stop>)> {
    let mut manifest = Manifest {
        distance_m: Some(devices.distance_m),
        longest_exposure_s: Some(longest_exposure_s),
        surface: Some(devices.surface),
        lenses: vec![devices.lens],
        ..Manifest::new(devices.describe())
    };
    let stops = tour(directions, &devices.rig.limits())?;
    add_views(&mut manifest, &stops);
    Ok((manifest, stops))
}

fn say(plan: &Plan) {
    say!(
        "{} views to photograph: at most {} photographs, {:.0} min and {:.1} MB",
        plan.views,
        plan.most_photographs,
        (plan.most_seconds / 60.0).ceil(),
        plan.most_bytes as f64 / 1e6
    );
}

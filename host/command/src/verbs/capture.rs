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
    let mut devices = Devices::open(&arguments.rig, arguments.camera)?;
    let (manifest, done) = if arguments.resume {
        let session = Session::open(&arguments.session)?;
        (session.manifest.clone(), session.done_views())
    } else {
        let (manifest, _) =
            new_manifest(&devices, &directions(arguments)?, arguments.longest_exposure_time_s)?;
        (manifest, vec![])
    };
    let plan = plan(&manifest, &done, &*devices.rig, &*devices.camera)?;
    if arguments.dry_run {
        say(&plan);
        return Ok(());
    }
    let mut session = if arguments.resume {
        Session::open(&arguments.session)?
    } else {
        Session::create(&arguments.session, manifest)?
    };
    say(&plan);
    if session.flats()?.is_empty() {
        devices.photograph_flats(session.folder())?;
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

//! `rigel capture`: a rig and a camera make a session.

use std::sync::{Mutex, PoisonError};

use glam::DVec3;
use rigel::capture::{self, Plan, TrackerLog, add_views, plan};
use rigel::progress::Progress;
use rigel::radiance::Response;
use rigel::sampling::{
    Stop, icosphere_near, latitude_longitude_near, read_directions, spiral, stratified, tour,
};
use rigel::session::{self, Manifest, Precision, Session};
use rigel::{Error, Result};
use rigel_simulated::rig::rehearse as rehearsed;

use crate::arguments::{CameraChoice, Capture, Collect, SamplingChoice};
use crate::devices::{Devices, With};
use crate::progress::Bar;
use crate::say::{count_of, say};

/// So many doubtful views are told of one by one.
const MOST_TOLD: usize = 5;

/// `rigel capture`.
pub fn capture(arguments: &Capture) -> Result<()> {
    // First of all: whoever may not write into the session need not bother the rig.
    let mut begun = if arguments.resume { Some(begun(arguments)?) } else { None };
    let mut devices = Devices::open(
        &arguments.rig,
        &arguments.camera,
        begun.as_ref(),
        With { tracker: arguments.tracker && !arguments.dry_run, flash_sync: arguments.flash_sync },
    )?;
    if let (Some(session), Some(table)) = (&mut begun, &arguments.directions) {
        let before = session.manifest.views.len();
        let more = capture::with_views(&session.manifest, &read_directions(table)?, &devices.rig.limits())?;
        say!("{} more", count_of(more.views.len() - before, "view"));
        if arguments.dry_run {
            session.manifest = more;
        } else {
            session.replan(more)?;
        }
    }
    let (manifest, done) = match &begun {
        Some(session) => (session.manifest.clone(), session.done_views()),
        None => {
            let directions = directions(arguments)?;
            let mut manifest = new_manifest(&devices, &directions, arguments.longest_exposure_time_s)?.0;
            manifest.precision = precision(arguments)?;
            (manifest, vec![])
        }
    };
    let moving_s = if arguments.dry_run { Some(rehearse(&devices, &manifest, &done)?) } else { None };
    let mut plan = plan(&manifest, &done, devices.rig.as_ref(), devices.camera.as_ref())?;
    if let Some(moving_s) = moving_s {
        let times = capture::bracket(&manifest, devices.camera.as_ref())?;
        let photographing_s = times.iter().map(|&time_s| time_s + devices.camera.overhead_s(time_s));
        plan.most_seconds = moving_s + plan.views as f64 * photographing_s.sum::<f64>();
        say(&plan);
        return Ok(());
    }
    // Read before anything is written.
    let response = arguments.response.as_deref().map(Response::read_csv).transpose()?;
    let mut session = match begun {
        Some(session) => session,
        None => Session::create(&arguments.session, manifest)?,
    };
    if let Some(response) = response {
        response.write_csv(&session.folder().join(capture::RESPONSE_FILE))?;
    }
    say(&plan);
    if session.flats()?.is_empty() {
        devices.photograph_flats(&mut session)?;
    }
    let log =
        devices.records.take().map(|records| TrackerLog::start(records, session.folder())).transpose()?;
    let progress = Watched { bar: Bar::new("capturing"), log: Mutex::new(log) };
    let captured = capture::capture(&mut session, &mut *devices.rig, &mut *devices.camera, &progress);
    let Watched { bar, log } = progress;
    drop(bar);
    let recorded = log.into_inner().unwrap_or_else(PoisonError::into_inner).map(TrackerLog::finish);
    let doubts = captured.as_ref().map_or(&[][..], Vec::as_slice);
    for doubt in doubts.iter().take(MOST_TOLD) {
        say!("{doubt}");
    }
    if doubts.len() > MOST_TOLD {
        say!("and {} views more, of which the journal tells", doubts.len() - MOST_TOLD);
    }
    if let Err(error) = captured {
        if let Some(Err(other)) = recorded {
            say!("the tracker's records, too: {other}");
        }
        if matches!(error, Error::Interrupted) {
            say!("go on with: rigel capture {} --resume", arguments.session.display());
        }
        return Err(error);
    }
    if let Some(count) = recorded.transpose()? {
        say!("{count} records of the tracker");
    }
    let waiting = session.waiting().len();
    if waiting > 0 {
        say!(
            "{waiting} photographs are in the camera: bring them with rigel collect {} FOLDER",
            arguments.session.display()
        );
    }
    let photographs: usize = session.done_views().iter().map(|&view| session.photographs(view).len()).sum();
    say!(
        "wrote {}: {}, {}",
        arguments.session.display(),
        count_of(session.done_views().len(), "view"),
        count_of(photographs, "photograph")
    );
    Ok(())
}

/// Progress of a capture that ends when the tracker's records cannot be written any more.
struct Watched {
    bar: Bar,
    log: Mutex<Option<TrackerLog>>,
}

impl Progress for Watched {
    fn step(&self, done: usize, total: usize) -> Result<()> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).as_mut().map_or(Ok(()), TrackerLog::check)?;
        self.bar.step(done, total)
    }
}

/// What the user wishes of every view.
fn precision(arguments: &Capture) -> Result<Option<Precision>> {
    if arguments.relative_error.is_some() && matches!(arguments.camera, CameraChoice::Folder(_)) {
        return Err(Error::request(
            "whoever fills a folder cannot be told which exposure time comes next",
            "leave out --relative-error",
        ));
    }
    let share = arguments.share;
    Ok(arguments.relative_error.map(|relative_error| Precision { relative_error, share }))
}

/// What the rig's firmware makes of the views: the time of homing and of all moves, settling included, seconds.
fn rehearse(devices: &Devices, manifest: &Manifest, done: &[usize]) -> Result<f64> {
    let (limits, views) = (devices.rig.limits(), capture::to_do(manifest, done)?);
    let targets: Vec<[f64; 2]> = views.iter().map(|view| view.1).collect();
    let rehearsal = rehearsed(&limits, &targets).map_err(|reply| {
        let why = reply.map_or("these are the limits of no rig".into(), |reply| format!("{reply:?}"));
        Error::request(format!("{} cannot be rehearsed: {why}", devices.rig.describe()), "correct its limits")
    })?;
    let (mut seconds, mut refused) = (rehearsal.homing_s, vec![]);
    for ((view, at), outcome) in views.iter().zip(rehearsal.moves) {
        match outcome {
            Ok(move_s) => seconds += move_s,
            Err(_) => {
                let [pan, tilt] = at.map(f64::to_degrees);
                refused.push(format!("{} (pan {pan:.1}°, tilt {tilt:.1}°)", manifest.views[*view].name));
            }
        }
    }
    if refused.is_empty() {
        return Ok(seconds);
    }
    Err(Error::request(
        format!(
            "the rig refuses {} of {} views: {}; it is {}",
            refused.len(),
            views.len(),
            refused.join(", "),
            devices.rig.describe()
        ),
        "choose a smaller --zenith-limit",
    ))
}

/// `rigel collect`.
pub fn collect(arguments: &Collect) -> Result<()> {
    let mut session = Session::open(&arguments.session)?;
    let count = session::collect(&mut session, &arguments.photographs, &Bar::new("collecting"))?;
    say!("collected {count} photographs into {}", arguments.session.display());
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
    if let Some(table) = &arguments.directions {
        return read_directions(table);
    }
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
        distance_m: devices.known.as_ref().map(|known| known.distance_m),
        longest_exposure_s: Some(longest_exposure_s),
        surface: devices.known.as_ref().map(|known| known.surface),
        lenses: devices.known.iter().map(|known| known.lens).collect(),
        ..Manifest::new(devices.describe())
    };
    let stops = tour(directions, &devices.rig.limits())?;
    add_views(&mut manifest, &stops);
    Ok((manifest, stops))
}

fn say(plan: &Plan) {
    say!(
        "{} to photograph: at most {}, {:.0} min and {:.1} MB",
        count_of(plan.views, "view"),
        count_of(plan.most_photographs, "photograph"),
        (plan.most_seconds / 60.0).ceil(),
        plan.most_bytes as f64 / 1e6
    );
}

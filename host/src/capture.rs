//! A capture session: the rig goes from view to view, the camera brackets each until no pixel is saturated, or takes the
//! photographs that a wished precision needs.

use glam::DVec3;

use crate::camera::{Camera, Shot};
use crate::geometry::Pose;
use crate::picture::Picture;
use crate::progress::{Progress, Silent};
use crate::rig::{Rig, RigLimits};
use crate::sampling::{Stop, tour};
use crate::session::{
    self, Content, Event, Exposed, Manifest, Photograph, Place, Run, Session, View, stem_of,
};
use crate::{Error, Result};

pub mod exposure;
mod planned;
mod tracker;

pub use planned::RESPONSE_FILE;
pub use tracker::{Line as TrackerLine, TRACKER_FILE, TrackerLog};

/// How often a view is photographed by a rig that does not stand still meanwhile.
const ATTEMPTS: usize = 3;
/// Directions that differ less than this are one view: a hundred times what a table rounds.
const SAME_VIEW_RAD: f64 = 1e-3;

/// What a capture will take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// How many views are still to be photographed.
    pub views: usize,
    /// At most so many photographs, seconds and bytes.
    pub most_photographs: usize,
    /// See `most_photographs`.
    pub most_seconds: f64,
    /// See `most_photographs`.
    pub most_bytes: u64,
}

/// Appends the stops of a tour to a manifest as views, in this order, with lens 0.
pub fn add_views(manifest: &mut Manifest, stops: &[Stop]) {
    for stop in stops {
        manifest.views.push(View {
            name: format!("view{:03}", manifest.views.len()),
            pan_deg: Some(stop.pan_rad.to_degrees()),
            tilt_deg: Some(stop.tilt_rad.to_degrees()),
            lens: 0,
            pose: None,
        });
    }
}

/// A manifest with more views, in the order of a short tour. Those that it has already are not added again: whoever was interrupted may
/// ask twice.
///
/// # Errors
/// [`Error::Request`] when the manifest is not that of a capture, or the rig cannot show a direction.
pub fn with_views(manifest: &Manifest, directions: &[DVec3], limits: &RigLimits) -> Result<Manifest> {
    if manifest.longest_exposure_s.is_none() {
        return Err(Error::request(
            "views can only be added to a session that a rig captures",
            "start one with `rigel capture` and import nothing into it",
        ));
    }
    let views = 0..manifest.views.len();
    let planned: Vec<[f64; 2]> = views.map(|view| target(manifest, view)).collect::<Result<_>>()?;
    let planned: Vec<DVec3> =
        planned.iter().map(|[pan, tilt]| Pose::from_rig(*pan, *tilt, 1.0).centre_m).collect();
    let is_new = |direction: &&DVec3| planned.iter().all(|other| other.distance(**direction) > SAME_VIEW_RAD);
    let new: Vec<DVec3> = directions.iter().filter(is_new).copied().collect();
    let mut extended = manifest.clone();
    add_views(&mut extended, &tour(&new, limits)?);
    Ok(extended)
}

/// The times of a bracket: the manifest's longest time, halved as often as the camera can follow.
///
/// # Errors
/// [`Error::Request`] when the manifest has no longest time or the camera cannot take it.
pub fn bracket(manifest: &Manifest, camera: &dyn Camera) -> Result<Vec<f64>> {
    let longest_s = manifest.longest_exposure_s.ok_or_else(|| {
        Error::request(
            "the session does not say with which exposure time a view begins",
            "capture into a session that `rigel capture` started",
        )
    })?;
    let [shortest, longest] = camera.exposure_range_s();
    if !(shortest..=longest).contains(&longest_s) {
        return Err(Error::request(
            format!("the camera takes {shortest} to {longest} s, not {longest_s} s"),
            "choose a time in this range with --longest-exposure-time",
        ));
    }
    Ok(std::iter::successors(Some(longest_s), |time| Some(time / 2.0))
        .take_while(|&time| time >= shortest * 0.999)
        .collect())
}

/// The views of a session that are not among `done`, with their pan and tilt in radians, in order.
///
/// # Errors
/// [`Error::Request`] naming a view that has no pan and tilt.
pub fn to_do(manifest: &Manifest, done: &[usize]) -> Result<Vec<(usize, [f64; 2])>> {
    let views = (0..manifest.views.len()).filter(|view| !done.contains(view));
    views.map(|view| Ok((view, target(manifest, view)?))).collect()
}

/// What is still to be done in a session, before anything moves: every view's target is checked against the rig's limits.
///
/// # Errors
/// [`Error::Request`] naming every view that the rig cannot reach, or a time that the camera cannot take.
pub fn plan(manifest: &Manifest, done: &[usize], rig: &dyn Rig, camera: &dyn Camera) -> Result<Plan> {
    let times = bracket(manifest, camera)?;
    let limits = rig.limits();
    let views = to_do(manifest, done)?;
    let beyond: Vec<String> = views
        .iter()
        .filter(|(_, [pan_rad, tilt_rad])| !limits.contains(*pan_rad, *tilt_rad))
        .map(|(view, at)| {
            let [pan, tilt] = at.map(f64::to_degrees);
            format!("{} at pan {pan:.1} and tilt {tilt:.1} degrees", manifest.views[*view].name)
        })
        .collect();
    if !beyond.is_empty() {
        let degrees =
            |range: [f64; 2]| format!("{:.1} to {:.1}", range[0].to_degrees(), range[1].to_degrees());
        return Err(Error::request(
            format!(
                "the rig reaches {} and {} degrees, not {}",
                degrees(limits.pan_rad),
                degrees(limits.tilt_rad),
                beyond.join(", ")
            ),
            "choose a smaller --zenith-limit",
        ));
    }
    let starts = std::iter::once([0.0; 2]).chain(views.iter().map(|view| view.1));
    let travel_s: f64 = starts.zip(&views).map(|(from, (_, to))| limits.travel_time_s(from, *to)).sum();
    let most_photographs = views.len() * times.len();
    Ok(Plan {
        views: views.len(),
        most_photographs,
        most_seconds: travel_s
            + views.len() as f64
                * times.iter().map(|&time_s| time_s + camera.overhead_s(time_s)).sum::<f64>(),
        most_bytes: most_photographs as u64 * camera.file_size_bytes(),
    })
}

/// Photographs every view of a session that is not done yet. A view that was interrupted goes on where it stopped: what the
/// journal has is kept where its file has the hash that the journal has, all else is taken again. Of the views that are
/// done, photographs that are missing or have another size are taken again, and those that [`Session::verify`] found.
///
/// A photograph is written beside its place, brought to the disk, moved to its place, and then told to the journal: whatever
/// ends the capture, at most the last photograph is lost. Of a camera that keeps its files ([`Shot::Later`]) a view's whole
/// bracket is exposed, since no picture tells when it is enough, and [`crate::session::collect`] brings the files.
///
/// A view's exposure time is halved until no pixel is saturated. Where the manifest says how precise the views shall be,
/// that is so until the camera's response and noise are known, from [`RESPONSE_FILE`] or the first views; then
/// [`exposure::Planner`] chooses the times. Returned is a sentence for every view whose photographs are less than what was wished for;
/// the journal has them, too.
///
/// # Errors
/// What the rig, the camera or the disk report; [`Error::Input`] when somebody else writes into the session;
/// [`Error::Interrupted`]. What was recorded until then is kept, and calling this again completes the session.
pub fn capture(
    session: &mut Session,
    rig: &mut dyn Rig,
    camera: &mut dyn Camera,
    progress: &dyn Progress,
) -> Result<Vec<String>> {
    session.lock()?;
    session.verify(false, &Silent)?;
    let times = bracket(&session.manifest, camera)?;
    plan(&session.manifest, &session.done_views(), rig, camera)?;
    let total = session.manifest.views.len();
    let (mut planner, mut doubts) = (None, vec![]);
    if (0..total).all(|view| session.is_done(view)) {
        return progress.step(total, total).map(|()| doubts);
    }
    session.record(Event::Run(Run::now(rig.describe(), camera.describe())))?;
    for view in 0..total {
        progress.step(view, total)?;
        if session.is_done(view) {
            continue;
        }
        if planner.is_none() {
            planner = planned::planner(session, &times)?;
        }
        let exposures = Exposures { times: &times, planner: planner.as_ref() };
        let doubt = capture_view(session, view, rig, camera, exposures, &|| progress.step(view, total))?;
        if let Some(doubt) = doubt {
            session.notice(doubt.clone())?;
            doubts.push(doubt);
        }
        session.record(Event::ViewDone { view })?;
    }
    if session.manifest.precision.is_some() && !session.waiting().is_empty() {
        doubts.push(
            "nobody sees the photographs before they are collected: every view has its whole bracket".into(),
        );
    }
    if let Some(doubt) = planned::unlearnt(session).filter(|_| planner.is_none()) {
        session.notice(doubt.clone())?;
        doubts.push(doubt);
    }
    progress.step(total, total).map(|()| doubts)
}

/// How the times of a view are found.
#[derive(Clone, Copy)]
struct Exposures<'a> {
    /// By halving, of which these are the times …
    times: &'a [f64],
    /// … or by a plan.
    planner: Option<&'a exposure::Planner>,
}

/// Goes to a view and takes its photographs, all of them again when the rig does not stand there any more afterwards.
fn capture_view(
    session: &mut Session,
    view: usize,
    rig: &mut dyn Rig,
    camera: &mut dyn Camera,
    exposures: Exposures,
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<Option<String>> {
    let [pan_rad, tilt_rad] = target(&session.manifest, view)?;
    for _ in 0..ATTEMPTS {
        let reached = rig.move_to(pan_rad, tilt_rad);
        note(session, rig)?;
        let reached = reached?;
        let place = Place {
            commanded_deg: [pan_rad.to_degrees(), tilt_rad.to_degrees()],
            reported_deg: [reached.pan_rad.to_degrees(), reached.tilt_rad.to_degrees()],
            settle_s: reached.settle_s,
        };
        let there = photograph_view(session, view, place, camera, exposures, interrupted)
            .and_then(|doubt| Ok((doubt, rig.is_there(pan_rad, tilt_rad)?)));
        // Also what was told before a failure.
        note(session, rig)?;
        if let (doubt, true) = there? {
            return Ok(doubt);
        }
        // Whoever goes on with the session after a failure must know it, too.
        session.record(Event::ViewMoved { view })?;
    }
    Err(Error::Device {
        device: rig.describe(),
        what: format!(
            "it did not stand still in {ATTEMPTS} attempts to photograph {}",
            session.manifest.views[view].name
        ),
        remedy: "check its power supply and its cable, then start again".into(),
    })
}

/// Tells the journal what the rig has told.
fn note(session: &mut Session, rig: &mut dyn Rig) -> Result<()> {
    rig.take_notices().into_iter().try_for_each(|text| session.notice(text))
}

/// Takes what the plan says or, without one, halves; a sentence where it is not what was wished for.
fn photograph_view(
    session: &mut Session,
    view: usize,
    place: Place,
    camera: &mut dyn Camera,
    Exposures { times, planner }: Exposures,
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<Option<String>> {
    if let Some(planner) = planner {
        match planned::photograph_view(session, view, place, camera, planner, interrupted)? {
            planned::Outcome::Done(doubt) => return Ok(doubt),
            planned::Outcome::Unseen => {}
        }
    }
    halve(session, view, place, camera, times, interrupted).map(|()| None)
}

/// The recursion "halve the time until no pixel is saturated" (thesis, chapter 7).
fn halve(
    session: &mut Session,
    view: usize,
    place: Place,
    camera: &mut dyn Camera,
    times: &[f64],
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<()> {
    // Of photographs that nobody has seen yet, nobody knows which is the last that is needed.
    let mut unseen =
        session.events().iter().any(|event| matches!(event, Event::Exposed(e) if e.view == view));
    for (index, &time) in times.iter().enumerate() {
        interrupted()?;
        let stem = stem(session, view, index);
        if session.waiting().iter().any(|exposed| exposed.stem == stem) {
            continue;
        }
        let picture = match kept(session, view, &stem)? {
            Some(picture) => Some(picture),
            None => take(session, view, &stem, place, camera, time)?,
        };
        unseen |= picture.is_none();
        if !unseen && picture.is_some_and(|picture| !is_saturated(&picture)) {
            break;
        }
    }
    Ok(())
}

/// The name of a view's photograph without its extension, relative to the session's folder.
fn stem(session: &Session, view: usize, index: usize) -> String {
    format!("photographs/{}_{index}", session.manifest.views[view].name)
}

/// Takes a photograph and tells the journal; `None` where its file comes later.
fn take(
    session: &mut Session,
    view: usize,
    stem: &str,
    place: Place,
    camera: &mut dyn Camera,
    asked_exposure_s: f64,
) -> Result<Option<Picture>> {
    let began = session::now();
    let mut later = None;
    let adopted = session.adopt(stem, |path| match camera.photograph(asked_exposure_s, path)? {
        Shot::Later { at, .. } => {
            later = Some(at);
            Ok(None)
        }
        Shot::Taken(taken) => {
            // Reading the file back also proves that the camera wrote it whole.
            let (picture, content) = (Picture::read(&taken.file)?, Content::of(&taken.file)?);
            Ok(Some((taken.file, (picture, content, taken.exposure_s))))
        }
    })?;
    let place = Some(place);
    if let Some(at) = later {
        let stem = stem.to_owned();
        session.record(Event::Exposed(Exposed { view, stem, asked_exposure_s, at, place }))?;
    }
    let Some((file, (picture, content, exposure_s))) = adopted else { return Ok(None) };
    if let Some(other) = recorded(session, view, stem).filter(|other| other.file != file) {
        return Err(Error::input(
            session.folder(),
            format!("{file} cannot take the place of {}", other.file),
            "go on with the camera and the format with which the session began",
        ));
    }
    session.record(Event::Photograph(Photograph {
        view,
        file,
        exposure_s: Some(exposure_s),
        asked_exposure_s: Some(asked_exposure_s),
        at: Some(began),
        place,
        content: Some(content),
    }))?;
    Ok(Some(picture))
}

/// The photograph of that stem which the journal has.
fn recorded(session: &Session, view: usize, stem: &str) -> Option<Photograph> {
    let photographs = session.photographs(view);
    let found = photographs.into_iter().find(|photograph| stem_of(&photograph.file) == stem);
    found.cloned()
}

/// The photograph of that stem which the journal has, unless its file is missing or damaged.
fn kept(session: &Session, view: usize, stem: &str) -> Result<Option<Picture>> {
    let Some(photograph) = recorded(session, view, stem) else { return Ok(None) };
    if !session.is_intact(&photograph)? {
        return Ok(None);
    }
    match Picture::read(session.photograph_path(&photograph)) {
        Ok(picture) => Ok(Some(picture)),
        // An old journal has no hash that would have told.
        Err(Error::Input { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Pan and tilt of a view, radians.
fn target(manifest: &Manifest, view: usize) -> Result<[f64; 2]> {
    let record = &manifest.views[view];
    match (record.pan_deg, record.tilt_deg) {
        (Some(pan), Some(tilt)) => Ok([pan.to_radians(), tilt.to_radians()]),
        _ => Err(Error::request(
            format!("view {} has no pan and tilt", record.name),
            "capture into a session that `rigel capture` started",
        )),
    }
}

/// Whether some pixel is at the top of the camera's range. Compression rings by a few levels around highlights, so the top
/// is the last 2 %.
fn is_saturated(picture: &Picture) -> bool {
    let top = picture.white - picture.white / 50;
    picture.levels.iter().flatten().any(|&level| level >= top)
}

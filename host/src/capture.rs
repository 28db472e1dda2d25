//! A capture session: the rig goes from view to view, the camera brackets each until no pixel is saturated.

use std::path::Path;

use crate::camera::Camera;
use crate::picture::Picture;
use crate::progress::Progress;
use crate::rig::Rig;
use crate::sampling::Stop;
use crate::session::{Event, Manifest, Photograph, Session, View};
use crate::{Error, Result};

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

/// What is still to be done in a session, before anything moves: every view's target is checked against the rig's limits.
///
/// # Errors
/// [`Error::Request`] naming the first view that the rig cannot reach, or a time that the camera cannot take.
pub fn plan(manifest: &Manifest, done: &[usize], rig: &dyn Rig, camera: &dyn Camera) -> Result<Plan> {
    let times = bracket(manifest, camera)?;
    let limits = rig.limits();
    let (mut at, mut travel_s, mut views) = ([0.0; 2], 0.0, 0);
    for index in (0..manifest.views.len()).filter(|index| !done.contains(index)) {
        let to @ [pan_rad, tilt_rad] = target(manifest, index)?;
        if !limits.contains(pan_rad, tilt_rad) {
            let degrees =
                |range: [f64; 2]| format!("{:.1} to {:.1}", range[0].to_degrees(), range[1].to_degrees());
            return Err(Error::request(
                format!(
                    "view {} is at pan {:.1} and tilt {:.1} degrees, the rig reaches {} and {}",
                    manifest.views[index].name,
                    pan_rad.to_degrees(),
                    tilt_rad.to_degrees(),
                    degrees(limits.pan_rad),
                    degrees(limits.tilt_rad)
                ),
                "choose a smaller --zenith-limit",
            ));
        }
        travel_s += limits.travel_time_s(at, to);
        at = to;
        views += 1;
    }
    let most_photographs = views * times.len();
    Ok(Plan {
        views,
        most_photographs,
        most_seconds: travel_s + views as f64 * times.iter().sum::<f64>(),
        most_bytes: most_photographs as u64 * camera.file_size_bytes(),
    })
}

/// Photographs every view of a session that is not done yet. A view that was interrupted goes on where it stopped.
///
/// # Errors
/// What the rig, the camera or the disk report; [`Error::Interrupted`]. What was recorded until then is kept, and calling this
/// again completes the session.
pub fn capture(
    session: &mut Session,
    rig: &mut dyn Rig,
    camera: &mut dyn Camera,
    progress: &dyn Progress,
) -> Result<()> {
    let times = bracket(&session.manifest, camera)?;
    plan(&session.manifest, &session.done_views(), rig, camera)?;
    let total = session.manifest.views.len();
    for view in 0..total {
        progress.step(view, total)?;
        if session.is_done(view) {
            continue;
        }
        let [pan_rad, tilt_rad] = target(&session.manifest, view)?;
        rig.move_to(pan_rad, tilt_rad)?;
        photograph_view(session, view, camera, &times, &|| progress.step(view, total))?;
        session.record(Event::ViewDone { view })?;
    }
    progress.step(total, total)
}

/// The recursion "halve the time until no pixel is saturated" (thesis, chapter 7). What an interrupted view already has is
/// kept; a photograph whose file is missing or damaged is taken again, and its later record then counts.
fn photograph_view(
    session: &mut Session,
    view: usize,
    camera: &mut dyn Camera,
    times: &[f64],
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<()> {
    for (index, &time) in times.iter().enumerate() {
        interrupted()?;
        let stem = format!("photographs/{}_{index}", session.manifest.views[view].name);
        let picture = match kept(session, view, &stem)? {
            Some(picture) => picture,
            None => {
                let shot = camera.photograph(time, &session.folder().join(&stem))?.taken()?;
                // Reading the file back also proves that the camera wrote it whole.
                let picture = Picture::read(&shot.file)?;
                let file = shot.file.strip_prefix(session.folder()).unwrap_or(&shot.file);
                // The journal is the same on every system.
                let file = file.to_string_lossy().replace('\\', "/");
                let exposure_s = Some(shot.exposure_s);
                session.record(Event::Photograph(Photograph { view, file, exposure_s }))?;
                picture
            }
        };
        if !is_saturated(&picture) {
            break;
        }
    }
    Ok(())
}

/// The photograph of that stem which the journal has, unless its file is missing or damaged.
fn kept(session: &Session, view: usize, stem: &str) -> Result<Option<Picture>> {
    let photographs = session.photographs(view);
    let Some(photograph) = photographs
        .iter()
        .find(|photograph| Path::new(&photograph.file).with_extension("") == Path::new(stem))
    else {
        return Ok(None);
    };
    match Picture::read(session.photograph_path(photograph)) {
        Ok(picture) => Ok(Some(picture)),
        Err(Error::Input { .. }) => Ok(None),
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => Ok(None),
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

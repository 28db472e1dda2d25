//! Views whose exposure times are planned instead of halved.

use std::path::PathBuf;

use glam::DVec3;

use super::exposure::{Glimpse, Next, Planner};
use super::{kept, recorded, stem, take, target};
use crate::camera::Camera;
use crate::geometry::Pose;
use crate::picture::Picture;
use crate::radiance::{NoiseModel, Response, Samples, Stack};
use crate::session::{Event, Place, Session};
use crate::{Error, Result};

/// The camera's response in the session's folder, where it was known before.
pub const RESPONSE_FILE: &str = "camera_response.csv";
/// From so many views, whose times were halved, the camera is learnt where it was not known.
const FIRST_VIEWS: usize = 1;
/// So many views more are asked where the first ones do not tell.
const MORE_VIEWS: usize = 8;

/// Plans the views of a session that says how precise they shall be; `None` as long as the camera is not known, which is
/// as long as too few views are done.
///
/// # Errors
/// Those of reading the photographs or the response.
pub(super) fn planner(session: &Session, halvings_s: &[f64]) -> Result<Option<Planner>> {
    let Some(precision) = session.manifest.precision else { return Ok(None) };
    let known: PathBuf = session.folder().join(RESPONSE_FILE);
    let (response, noise) = if known.is_file() {
        let response = Response::read_csv(&known)?;
        let noise = NoiseModel::assumed(&response);
        (response, noise)
    } else {
        let mut views = session.done_views();
        views.retain(|&view| session.photographs(view).len() > 1);
        if views.len() < FIRST_VIEWS {
            return Ok(None);
        }
        let (mut samples, mut found) = (Samples::default(), None);
        for (count, &view) in (1..).zip(views.iter().take(FIRST_VIEWS + MORE_VIEWS)) {
            samples.add(&Stack::of_view(session, view)?)?;
            if count >= FIRST_VIEWS {
                found = samples.response().ok();
            }
            if found.is_some() {
                break;
            }
        }
        let Some(response) = found else { return Ok(None) };
        let noise = samples.noise(&response);
        (response, noise)
    };
    Ok(Some(Planner::new(precision, response, noise, halvings_s.to_vec())))
}

/// What is to be said of a session that was to be planned and was not.
pub(super) fn unlearnt(session: &Session) -> Option<String> {
    let views = session.done_views().len();
    let seen = session.manifest.precision.is_some() && views > FIRST_VIEWS && session.waiting().is_empty();
    seen.then(|| {
        format!(
            "the first {} views do not tell the camera's response: their times were halved, not planned; give --response, or a longest exposure time that saturates some pixels",
            views.min(FIRST_VIEWS + MORE_VIEWS)
        )
    })
}

/// Takes the photographs that a view needs and has not yet.
pub(super) fn photograph_view(
    session: &mut Session,
    view: usize,
    place: Place,
    camera: &mut dyn Camera,
    planner: &Planner,
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<Outcome> {
    let mut taken = Vec::new();
    let mut begin = begin(session, view, planner)?;
    loop {
        interrupted()?;
        let stem = stem(session, view, taken.len());
        if session.waiting().iter().any(|exposed| exposed.stem == stem) {
            return Ok(Outcome::Unseen);
        }
        let picture = match kept(session, view, &stem)? {
            Some(picture) => picture,
            None => match begin.take().map_or_else(|| planner.next(&taken), Next::Expose) {
                Next::Expose(time_s) => match take(session, view, &stem, place, camera, time_s)? {
                    Some(picture) => picture,
                    None => return Ok(Outcome::Unseen),
                },
                Next::Enough(_) => return Ok(Outcome::Done(None)),
                Next::Best { share, clipped } => {
                    return Ok(Outcome::Done(Some(doubt(session, view, share, clipped))));
                }
            },
        };
        planner.check(&picture)?;
        let Some(photograph) = recorded(session, view, &stem) else {
            return Err(Error::input(session.folder(), format!("has no word of {stem}"), "start again"));
        };
        let exposure_s = photograph.exposure_s.unwrap_or(1.0);
        taken.push(Glimpse::new(&picture, photograph.asked_exposure_s.unwrap_or(exposure_s), exposure_s));
    }
}

/// The time with which a view begins that has no photograph yet, by the shortest one of the nearest view that is done; `None`
/// where there is none, or where the camera keeps its photographs: then every view has its whole bracket from the longest on.
fn begin(session: &Session, view: usize, planner: &Planner) -> Result<Option<f64>> {
    let is_kept = |event: &Event| matches!(event, Event::Exposed(_));
    if !session.photographs(view).is_empty() || session.events().iter().any(is_kept) {
        return Ok(None);
    }
    let towards = |view| {
        let [pan_rad, tilt_rad] = target(&session.manifest, view)?;
        Ok::<_, Error>(Pose::from_rig(pan_rad, tilt_rad, 1.0).direction_to_surface(DVec3::Z))
    };
    let here = towards(view)?;
    let mut nearest: Option<(f64, usize)> = None;
    for other in session.done_views() {
        let near = towards(other)?.dot(here);
        if nearest.is_none_or(|(nearer, _)| near > nearer) {
            nearest = Some((near, other));
        }
    }
    let photographs = nearest.map_or(vec![], |(_, other)| session.photographs(other));
    let timed = photographs.into_iter().filter_map(|photograph| Some((photograph.exposure_s?, photograph)));
    let Some((exposure_s, shortest)) = timed.min_by(|a, b| a.0.total_cmp(&b.0)) else { return Ok(None) };
    let picture = Picture::read(session.photograph_path(shortest))?;
    planner.check(&picture)?;
    Ok(Some(planner.first(&Glimpse::new(&picture, exposure_s, exposure_s))))
}

/// How a view went.
pub(super) enum Outcome {
    /// Its photographs are there; a sentence where they are not all that was wished for.
    Done(Option<String>),
    /// The camera keeps its photographs: nobody can tell what is needed.
    Unseen,
}

fn doubt(session: &Session, view: usize, share: f64, clipped: bool) -> String {
    let name = &session.manifest.views[view].name;
    let wish = session.manifest.precision.unwrap_or_default();
    let percent = |part: f64| format!("{} %", (part * 1e4).floor() / 1e2);
    let bright = if clipped { "; some are too bright for the camera's shortest time" } else { "" };
    format!(
        "{name}: a relative error of {} was wished for {} of the pixels and {} have it{bright}",
        percent(wish.relative_error),
        percent(wish.share),
        percent(share)
    )
}

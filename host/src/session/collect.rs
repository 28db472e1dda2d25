//! Photographs that stayed in the camera come into their session.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use super::{Content, Event, Exposed, Photograph, Session};
use crate::camera::matching::{Exposure, matching, photographs};
use crate::progress::Progress;
use crate::{Error, Result};

/// Copies the photographs of `folder` to the views for which they were exposed; the originals are not touched. What is in the
/// session already is passed over, so that this can be done again with the same folder. Returns how many came.
///
/// # Errors
/// [`Error::Input`] when the session waits for no photograph, and when the folder's photographs are not those for which it
/// waits: another number of them, other exposure times, times of day that do not fit (see [`matching`]); then none of them is
/// taken. [`Error::Io`] when the disk is full; what came until then is kept. [`Error::Interrupted`].
pub fn collect(session: &mut Session, folder: &Path, progress: &dyn Progress) -> Result<usize> {
    session.lock()?;
    let waiting: Vec<Exposed> = session.waiting().into_iter().cloned().collect();
    if waiting.is_empty() {
        return Err(Error::input(
            session.folder(),
            "waits for no photographs",
            "capture with a camera that keeps them, such as --camera trigger",
        ));
    }
    let views = 0..session.manifest.views.len();
    let known: BTreeSet<String> = views
        .flat_map(|view| session.photographs(view))
        .filter_map(|photograph| Some(photograph.content.as_ref()?.sha256.clone()))
        .collect();
    let mut files = vec![];
    for file in photographs(folder)? {
        progress.step(0, waiting.len())?;
        if !known.contains(&file.sha256) {
            files.push(file);
        }
    }
    let exposures: Vec<Exposure> = waiting
        .iter()
        .map(|exposed| Exposure { at: exposed.at, exposure_s: exposed.asked_exposure_s })
        .collect();
    matching(&exposures, &files).map_err(|error| error.about(folder))?;
    for (index, (exposed, file)) in waiting.iter().zip(&files).enumerate() {
        progress.step(index, waiting.len())?;
        let exposure_s = file.exposure_near(exposed.asked_exposure_s)?;
        let adopted = session.adopt(&exposed.stem, |stem| {
            let mut copy = stem.as_os_str().to_os_string();
            if let Some(extension) = file.path.extension() {
                copy.push(".");
                copy.push(extension);
            }
            let copy = Path::new(&copy);
            fs::copy(&file.path, copy).map_err(Error::io("write", copy))?;
            Ok(Some((copy.to_path_buf(), Content::of(copy)?)))
        })?;
        let Some((name, content)) = adopted else { continue };
        session.record(Event::Photograph(Photograph {
            view: exposed.view,
            file: name,
            exposure_s: Some(exposure_s),
            asked_exposure_s: Some(exposed.asked_exposure_s),
            at: Some(exposed.at),
            place: exposed.place,
            content: Some(content),
        }))?;
    }
    progress.step(waiting.len(), waiting.len())?;
    Ok(waiting.len())
}

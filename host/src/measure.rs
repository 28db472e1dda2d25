//! From a session's photographs to the radiance of every view, on one scale.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::calibration::Vignetting;
use crate::picture::Picture;
use crate::progress::Progress;
use crate::radiance::{NoiseModel, RadianceImage, Response, Samples, Stack, merge};
use crate::session::Session;
use crate::{Error, Result, file};

/// What a level of the photographs is worth.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum ResponseChoice {
    /// Recovered from the session's brackets.
    #[default]
    Recover,
    /// Recovered before, from a response.csv.
    File(PathBuf),
    /// The sRGB standard's curve.
    Srgb,
    /// Levels proportional to exposure.
    Linear,
}

/// What was measured, to tell the user.
#[derive(Debug)]
pub struct Measured {
    /// How many views' radiance was written now.
    pub written: usize,
    /// How many had been written before, in the same way, and were kept.
    pub kept: usize,
    /// Part of the pixels written now that every photograph saturated.
    pub saturated: f64,
    /// Part of the pixels written now that were too dark in every photograph.
    pub dark: f64,
    /// Residual of the flat fields, relative; `None` when the session has none.
    pub vignetting_residual: Option<f64>,
}

/// The response is learnt from at most so many views, spread over the session.
const VIEWS_FOR_RESPONSE: usize = 40;

/// Writes the radiance of every finished view of the session to its `radiance/` folder, with `response.csv`.
///
/// Photographs of unknown exposure time count as 1 s: [`crate::observation::observe`] then estimates one gain for each view.
/// A run that was interrupted goes on where it stopped, as long as photographs and choices are the same.
///
/// # Errors
/// [`Error::Input`] naming a photograph that cannot be used; [`Error::Request`] when no response can be recovered;
/// [`Error::Io`]; [`Error::Interrupted`].
pub fn measure(session: &Session, choice: &ResponseChoice, progress: &dyn Progress) -> Result<Measured> {
    let views = session.done_views();
    if views.is_empty() {
        return Err(Error::input(
            session.folder(),
            "has no finished view",
            "go on with `rigel capture --resume`",
        ));
    }
    let looked_at = if *choice == ResponseChoice::Recover { views.len().min(VIEWS_FOR_RESPONSE) } else { 0 };
    let total = looked_at + views.len();
    let mut samples = Samples::default();
    for i in 0..looked_at {
        progress.step(i, total)?;
        samples.add(&stack(session, views[i * views.len() / looked_at])?)?;
    }
    let first = Picture::read(session.photograph_path(session.photographs(views[0])[0]))?;
    let response = match choice {
        ResponseChoice::Recover => samples.response()?,
        ResponseChoice::File(path) => Response::read_csv(path)?,
        ResponseChoice::Srgb => Response::srgb(first.white),
        ResponseChoice::Linear => Response::linear(first.white),
    };
    let noise = if looked_at > 0 { samples.noise(&response) } else { NoiseModel::assumed(&response) };
    let vignetting = vignetting(session, &response, &noise)?;

    let folder = session.radiance_folder();
    fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    start_afresh_unless_same(session, &folder, &views, &format!("{choice:?} {noise:?} {vignetting:?}"))?;
    response.write_csv(&folder.join("response.csv"))?;
    let description = format!("{choice:?}");
    let (done, written) = (AtomicUsize::new(looked_at), AtomicUsize::new(0));
    let [pixels, saturated, dark] = [const { AtomicUsize::new(0) }; 3];
    views.par_iter().try_for_each(|&view| {
        let path = session.radiance_path(view);
        if !path.is_file() {
            let mut image = merge(&stack(session, view)?, &response, &noise)?;
            if let Some(vignetting) = &vignetting {
                vignetting.correct(&mut image)?;
            }
            let count = |flag| image.mask.iter().filter(|&&mask| mask & flag != 0).count();
            saturated.fetch_add(count(RadianceImage::SATURATED), Ordering::Relaxed);
            dark.fetch_add(count(RadianceImage::DARK), Ordering::Relaxed);
            pixels.fetch_add(image.mask.len(), Ordering::Relaxed);
            image.write_exr(&path, &description)?;
            written.fetch_add(1, Ordering::Relaxed);
        }
        progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, total)
    })?;
    let written = written.into_inner();
    let pixels = pixels.into_inner().max(1);
    let part = |count: AtomicUsize| count.into_inner() as f64 / pixels as f64;
    Ok(Measured {
        written,
        kept: views.len() - written,
        saturated: part(saturated),
        dark: part(dark),
        vignetting_residual: vignetting.map(|vignetting| vignetting.residual),
    })
}

/// The photographs of a view with their times.
fn stack(session: &Session, view: usize) -> Result<Stack> {
    let photographs = session.photographs(view);
    if photographs.is_empty() {
        return Err(Error::input(
            session.folder(),
            format!("has no photograph of view {}", session.manifest.views[view].name),
            "import or capture it again",
        ));
    }
    let pictures = photographs
        .iter()
        .map(|photograph| Picture::read(session.photograph_path(photograph)))
        .collect::<Result<_>>()?;
    let times = photographs.iter().map(|photograph| photograph.exposure_s.unwrap_or(1.0)).collect();
    Stack::new(pictures, times)
}

fn vignetting(session: &Session, response: &Response, noise: &NoiseModel) -> Result<Option<Vignetting>> {
    let flats = session.flats()?;
    if flats.is_empty() {
        return Ok(None);
    }
    let pictures: Vec<Picture> = flats.iter().map(Picture::read).collect::<Result<_>>()?;
    Vignetting::fit(&pictures, response, noise).map(Some)
}

/// Radiance that was measured in another way or from other photographs must not be mixed with new radiance: it is removed.
fn start_afresh_unless_same(session: &Session, folder: &Path, views: &[usize], choices: &str) -> Result<()> {
    let photographs: Vec<_> = views.iter().flat_map(|&view| session.photographs(view)).collect();
    let now = format!("{choices}\n{photographs:?}\n");
    let path = folder.join("made_from.txt");
    if fs::read_to_string(&path).is_ok_and(|before| before == now) {
        return Ok(());
    }
    for view in 0..session.manifest.views.len() {
        match fs::remove_file(session.radiance_path(view)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(Error::io("remove", folder)(error));
            }
            _ => {}
        }
    }
    file::write_bytes(&path, now.as_bytes())
}

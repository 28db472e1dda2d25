//! From a session's photographs to the radiance of every view, on one scale.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::calibration::Vignetting;
use crate::camera::exif::{self, OneFocalLength};
use crate::picture::Picture;
use crate::progress::Progress;
use crate::radiance::{
    MeasuredTime, NoiseModel, RadianceImage, Response, Samples, Stack, debevec, debevec_response, merge,
};
use crate::session::Session;
use crate::{Error, Result, file};

/// What a level of the photographs is worth.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum ResponseChoice {
    /// Recovered from the session's brackets; photographs of floating-point numbers are exposures already.
    #[default]
    Recover,
    /// Recovered before, from a response.csv.
    File(PathBuf),
    /// The sRGB standard's curve.
    Srgb,
    /// Levels proportional to exposure.
    Linear,
}

/// Whose word is taken for the photographs' exposure times, where they are known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Times {
    /// What was stated (by EXIF, a table, the rig); a photograph whose pixels contradict it is refused.
    #[default]
    Stated,
    /// What was stated, but where the pixels contradict it, what they measure.
    Measured,
}

/// How a view's photographs become its radiance.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Merge {
    /// The mean of least variance.
    #[default]
    Likelihood,
    /// As Debevec and Malik made their published maps, for comparison: the response, where it is to be recovered, is theirs too, and
    /// exposure times are taken as stated.
    Debevec,
}

/// How to measure.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// What a level is worth.
    pub response: ResponseChoice,
    /// How long the exposures were.
    pub times: Times,
    /// How photographs are merged.
    pub merge: Merge,
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
    /// Part of the pixels written now where something moved between the photographs.
    pub moved: f64,
    /// Residual of the flat fields, relative; `None` when the session has none.
    pub vignetting_residual: Option<f64>,
    /// The photographs of the views written now whose measured exposure time was taken in place of the stated one.
    pub corrected: Vec<MeasuredTime>,
    /// What was assumed or left out, one sentence each.
    pub notes: Vec<String>,
}

/// The response is learnt from at most so many views, spread over the session.
const VIEWS_FOR_RESPONSE: usize = 40;

/// Writes the radiance of every finished view of the session to its `radiance/` folder, with `response.csv`.
///
/// Photographs of unknown exposure time count as 1 s: [`crate::observation::observe`] then estimates one gain for each view.
/// A run that was interrupted goes on where it stopped, as long as photographs and choices are the same. Radiance that was
/// measured in another way stays until all of the new is there.
///
/// # Errors
/// [`Error::Input`] naming a photograph that cannot be used, or whose exposure time its pixels contradict (not with
/// [`Times::Measured`]);
/// [`Error::Request`] when no response can be recovered; [`Error::Io`]; [`Error::Interrupted`].
pub fn measure(session: &Session, options: &Options, progress: &dyn Progress) -> Result<Measured> {
    let views = session.done_views();
    if views.is_empty() {
        return Err(Error::input(
            session.folder(),
            "has no finished view",
            "go on with `rigel capture --resume`",
        ));
    }
    if let Some(exposed) = session.waiting().first() {
        return Err(Error::input(
            session.folder(),
            format!(
                "{} photographs from {} on are still in the camera",
                session.waiting().len(),
                exposed.stem
            ),
            "bring them with `rigel collect`",
        ));
    }
    check_times(session, &views)?;
    check_focal_lengths(session, &views, &|| progress.step(0, views.len()))?;
    let white = white(session, views[0])?;
    let choice = match &options.response {
        ResponseChoice::Recover if white == Picture::FLOAT_WHITE => &ResponseChoice::Linear,
        choice => choice,
    };
    // Whatever the response is, brackets tell the noise.
    let bracketed: Vec<usize> = views.iter().copied().filter(|&view| is_bracketed(session, view)).collect();
    let looked_at = bracketed.len().min(VIEWS_FOR_RESPONSE);
    let total = looked_at + views.len();
    let done = AtomicUsize::new(0);
    let step = || progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let some: Vec<usize> = (0..looked_at).map(|i| bracketed[i * bracketed.len() / looked_at]).collect();
    let samples = samples(session, &some, &step)?;
    let mut notes = vec![];
    let (response, noise) = match choice {
        ResponseChoice::Recover if options.merge == Merge::Debevec => {
            // The first of the longest brackets.
            let count = |view: usize| session.photographs(view).len();
            let longest = views
                .iter()
                .copied()
                .reduce(|best, view| if count(view) > count(best) { view } else { best });
            let view = longest.unwrap_or(views[0]);
            let response = debevec_response(&Stack::of_view(session, view)?)?;
            let noise = samples.noise(&response);
            let name = &session.manifest.views[view].name;
            notes.push(format!(
                "the response is Debevec's and Malik's, of view {name}; its own doubt is not in the variance"
            ));
            (response, noise)
        }
        ResponseChoice::Recover => {
            let learnt = samples.learn_unless(&|| progress.step(looked_at, total))?;
            options.times.judge(&learnt.doubtful)?;
            (learnt.response, learnt.noise)
        }
        _ => {
            let response = given(session, choice, white)?;
            let noise = samples.noise(&response);
            (response, noise)
        }
    };
    if bracketed.is_empty() {
        notes.push(
            "no view was photographed with two different exposure times: the noise is taken for that of an ordinary camera"
                .into(),
        );
    }
    progress.step(looked_at, total)?;
    let vignetting = vignetting(session, &response, &noise)?;
    let gains = vignetting.as_ref().map(Vignetting::gains);
    match &vignetting {
        None => notes.push("no flats: vignetting stays in the radiance".into()),
        Some(fitted) if !fitted.settled => notes.push(
            "the fit of the vignetting has not come to rest: take more flats, of an even surface without shadows".into(),
        ),
        Some(_) => {}
    }
    progress.step(looked_at, total)?;

    let heed = || progress.step(looked_at, total);
    let made_from = made_from(session, &views, &response, &noise, vignetting.as_ref(), options, &heed)?;
    let folder = gather_in(session, &made_from)?;
    let description = match choice {
        ResponseChoice::Recover if options.merge == Merge::Debevec => {
            "recovered after Debevec and Malik".into()
        }
        ResponseChoice::Recover => "recovered from the session's brackets".into(),
        ResponseChoice::File(path) => path.display().to_string(),
        ResponseChoice::Srgb => "srgb".into(),
        ResponseChoice::Linear => "linear".into(),
    };
    let written = AtomicUsize::new(0);
    let [pixels, saturated, dark, moved] = [const { AtomicUsize::new(0) }; 4];
    let corrected = Mutex::new(Vec::new());
    let finished = response.write_csv(&folder.join(RESPONSE)).and_then(|()| {
        views.par_iter().try_for_each(|&view| {
            let path = folder.join(session.radiance_path(view).file_name().unwrap_or_default());
            if !path.is_file() {
                let mut stack = Stack::of_view(session, view)?;
                // sRGB is nobody's response exactly, and few 8 bits are linear: what contradicts a guess may be right.
                if options.merge == Merge::Likelihood
                    && !response.is_assumed()
                    && times_are_known(session, view)
                {
                    let times = stack.times(&response, &noise);
                    let doubtful: Vec<MeasuredTime> =
                        times.iter().filter(|time| time.is_doubtful()).cloned().collect();
                    options.times.judge(&doubtful)?;
                    for (time_s, time) in stack.exposure_s.iter_mut().zip(&times) {
                        if time.is_doubtful() {
                            *time_s = time.measured_s;
                        }
                    }
                    corrected.lock().unwrap_or_else(PoisonError::into_inner).extend(doubtful);
                }
                let mut image = match options.merge {
                    Merge::Likelihood => merge(&stack, &response, &noise)?,
                    Merge::Debevec => debevec(&stack, &response, &noise)?,
                };
                if let (Some(vignetting), Some(gains)) = (&vignetting, &gains) {
                    vignetting.correct_by(gains, &mut image)?;
                }
                let count = |flag| image.mask.iter().filter(|&&mask| mask & flag != 0).count();
                saturated.fetch_add(count(RadianceImage::SATURATED), Ordering::Relaxed);
                dark.fetch_add(count(RadianceImage::DARK), Ordering::Relaxed);
                moved.fetch_add(count(RadianceImage::GHOST), Ordering::Relaxed);
                pixels.fetch_add(image.mask.len(), Ordering::Relaxed);
                image.write_exr(&path, &description)?;
                written.fetch_add(1, Ordering::Relaxed);
            }
            step()
        })
    });
    settle(session, &folder, finished)?;
    let written = written.into_inner();
    let pixels = pixels.into_inner().max(1);
    let part = |count: AtomicUsize| count.into_inner() as f64 / pixels as f64;
    let mut corrected = corrected.into_inner().unwrap_or_else(PoisonError::into_inner);
    corrected.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(Measured {
        written,
        kept: views.len() - written,
        saturated: part(saturated),
        dark: part(dark),
        moved: part(moved),
        vignetting_residual: vignetting.map(|vignetting| vignetting.residual),
        corrected,
        notes,
    })
}

impl Times {
    /// Refuses photographs whose times are in doubt, where the stated ones were asked for.
    fn judge(self, doubtful: &[MeasuredTime]) -> Result<()> {
        match (self, doubtful.first()) {
            (Self::Stated, Some(time)) => Err(time.error()),
            _ => Ok(()),
        }
    }
}

/// A response that need not be recovered.
fn given(session: &Session, choice: &ResponseChoice, white: u16) -> Result<Response> {
    match choice {
        ResponseChoice::File(path) => {
            let response = Response::read_csv(path)?;
            if response.white() == white {
                return Ok(response);
            }
            let what = format!("its levels go to {}, those of the photographs to {white}", response.white());
            Err(Error::input(path, what, "recover or choose a response for these photographs"))
        }
        ResponseChoice::Srgb if white == Picture::FLOAT_WHITE => Err(Error::input(
            session.folder(),
            "has photographs of floating-point numbers, to which the sRGB curve does not apply",
            "use --response linear",
        )),
        ResponseChoice::Srgb => Ok(Response::srgb(white)),
        ResponseChoice::Linear | ResponseChoice::Recover => Ok(Response::linear(white)),
    }
}

/// Exposure times are all known or all unknown: one second in place of one among known ones would be a guess. Of unknown times a view
/// has one: nobody knows which of several exposures was the longer.
fn check_times(session: &Session, views: &[usize]) -> Result<()> {
    let several = views.iter().map(|&view| session.photographs(view)).find(|photographs| {
        photographs.len() > 1 && photographs.iter().all(|photograph| photograph.exposure_s.is_none())
    });
    if let Some(photographs) = several {
        return Err(Error::input(
            session.photograph_path(photographs[1]),
            format!(
                "is one of {} photographs of a view whose exposure times nobody knows",
                photographs.len()
            ),
            "import again with the times (--csv, --exposure-times), or one photograph for each view",
        ));
    }
    let photographs = || views.iter().flat_map(|&view| session.photographs(view));
    let unknown = photographs().find(|photograph| photograph.exposure_s.is_none());
    match (unknown, photographs().find(|photograph| photograph.exposure_s.is_some())) {
        (Some(unknown), Some(known)) => Err(Error::input(
            session.photograph_path(unknown),
            format!(
                "has no exposure time, where others have one ({})",
                session.photograph_path(known).display()
            ),
            "import again with the times of all photographs (--csv, --exposure-times), or leave out those that have none",
        )),
        _ => Ok(()),
    }
}

/// Photographs of one lens must have one focal length, as far as they tell it.
fn check_focal_lengths(
    session: &Session,
    views: &[usize],
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<()> {
    let mut of_lenses: BTreeMap<usize, OneFocalLength> = BTreeMap::new();
    for &view in views {
        for photograph in session.photographs(view) {
            interrupted()?;
            let path = session.photograph_path(photograph);
            let focal = of_lenses.entry(session.manifest.views[view].lens).or_default();
            focal.admit(&path, exif::read(&path)?.focal_length_mm)?;
        }
    }
    interrupted()
}

/// The highest level of a view's photographs.
fn white(session: &Session, view: usize) -> Result<u16> {
    match session.photographs(view).first() {
        Some(first) => Ok(Picture::read(session.photograph_path(first))?.white),
        // What is wrong is said there.
        None => Ok(Stack::of_view(session, view)?.white()),
    }
}

fn is_bracketed(session: &Session, view: usize) -> bool {
    let photographs = session.photographs(view);
    photographs.iter().any(|photograph| photograph.exposure_s != photographs[0].exposure_s)
}

fn times_are_known(session: &Session, view: usize) -> bool {
    session.photographs(view).iter().all(|photograph| photograph.exposure_s.is_some())
}

/// Blocks of some views' photographs, in their order.
fn samples(session: &Session, views: &[usize], step: &(dyn Fn() -> Result<()> + Sync)) -> Result<Samples> {
    let each: Vec<Samples> = views
        .par_iter()
        .map(|&view| {
            let mut samples = Samples::default();
            samples.add(&Stack::of_view(session, view)?)?;
            step().map(|()| samples)
        })
        .collect::<Result<_>>()?;
    let mut all = Samples::default();
    each.into_iter().try_for_each(|samples| all.append(samples)).map(|()| all)
}

fn vignetting(session: &Session, response: &Response, noise: &NoiseModel) -> Result<Option<Vignetting>> {
    let flats = session.flats()?;
    if flats.is_empty() {
        return Ok(None);
    }
    let pictures: Vec<Picture> = flats.par_iter().map(Picture::read).collect::<Result<_>>()?;
    Vignetting::fit(&pictures, response, noise).map(Some)
}

/// Everything on which the radiance depends, as text: the response, noise and vignetting, and what every photograph on the disk holds:
/// a copied session is the same.
fn made_from(
    session: &Session,
    views: &[usize],
    response: &Response,
    noise: &NoiseModel,
    vignetting: Option<&Vignetting>,
    options: &Options,
    heed: &(dyn Fn() -> Result<()> + Sync),
) -> Result<String> {
    let Options { times, merge, .. } = options;
    let mut hasher = DefaultHasher::new();
    for channel in 0..3 {
        response.exposure(channel).iter().for_each(|value| value.to_bits().hash(&mut hasher));
    }
    let mut text =
        format!("response {:x}\n{noise:?}\n{vignetting:?}\n{times:?}\n{merge:?}\n", hasher.finish());
    let photographs: Vec<_> = views.iter().flat_map(|&view| session.photographs(view)).collect();
    let hashed = |photograph: &&_| {
        heed()?;
        file::sha256(&session.photograph_path(photograph))
    };
    let contents: Vec<(u64, String)> = photographs.par_iter().map(hashed).collect::<Result<_>>()?;
    for (photograph, (_, sha256)) in photographs.into_iter().zip(contents) {
        let (view, file, exposure_s) = (photograph.view, &photograph.file, photograph.exposure_s);
        let _ = writeln!(text, "{view} {file} {exposure_s:?} {sha256}");
    }
    Ok(text)
}

/// Whether the session's radiance is without the lens's vignetting.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn radiance_is_flattened(session: &Session) -> Result<bool> {
    let path = session.radiance_folder().join(MADE_FROM);
    let text = fs::read_to_string(&path).map_err(Error::io("read", &path))?;
    Ok(text.lines().nth(2).is_some_and(|vignetting| vignetting != "None"))
}

/// What the radiance of a folder was made from: it must not be mixed with radiance that was made in another way.
const MADE_FROM: &str = "made_from.txt";
/// The response that was used.
const RESPONSE: &str = "response.csv";

fn beside(session: &Session) -> PathBuf {
    session.folder().join("radiance.new")
}

/// The folder for radiance that is made like this: its own place where nothing else stands there, otherwise one beside it.
fn gather_in(session: &Session, made_from: &str) -> Result<PathBuf> {
    let same = |folder: &Path| fs::read_to_string(folder.join(MADE_FROM)).is_ok_and(|was| was == made_from);
    let place = session.radiance_folder();
    let occupied = (0..session.manifest.views.len()).any(|view| session.radiance_path(view).exists());
    let folder = if occupied && !same(&place) { beside(session) } else { place };
    if folder != beside(session) && beside(session).exists() {
        // An interrupted change of mind: its radiance is of no use any more.
        fs::remove_dir_all(beside(session)).map_err(Error::io("remove", beside(session)))?;
    }
    if same(&folder) {
        return Ok(folder);
    }
    if folder == beside(session) && folder.exists() {
        fs::remove_dir_all(&folder).map_err(Error::io("remove", &folder))?;
    }
    fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    let written = file::write_bytes(&folder.join(MADE_FROM), made_from.as_bytes());
    if written.is_err() && folder == beside(session) {
        // Best effort: the error that matters is the one returned.
        let _ = fs::remove_dir_all(&folder);
    }
    written.map(|()| folder)
}

/// Radiance that was gathered beside its place moves there when it is complete. After an error it is removed; after Ctrl-C
/// it waits for the next run.
fn settle(session: &Session, folder: &Path, finished: Result<()>) -> Result<()> {
    if folder != beside(session) {
        let is_written = (0..session.manifest.views.len()).any(|view| session.radiance_path(view).exists());
        if finished.is_err() && !is_written {
            // Nothing to go on from. Best effort: the error that matters is the one returned.
            let _ = [MADE_FROM, RESPONSE].map(|name| fs::remove_file(folder.join(name)));
            let _ = fs::remove_dir(folder);
        }
        return finished;
    }
    match finished {
        Ok(()) => {}
        Err(Error::Interrupted) => return finished,
        Err(_) => {
            // Best effort: the error that matters is the one returned.
            let _ = fs::remove_dir_all(folder);
            return finished;
        }
    }
    let place = session.radiance_folder();
    // Without this file a move that stops half way is done again.
    remove(&place.join(MADE_FROM))?;
    (0..session.manifest.views.len()).try_for_each(|view| remove(&session.radiance_path(view)))?;
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let mut names = vec![];
    for entry in entries {
        names.push(entry.map_err(Error::io("read", folder))?.file_name());
    }
    names.sort_by_key(|name| name == MADE_FROM);
    for name in names {
        fs::rename(folder.join(&name), place.join(&name)).map_err(Error::io("write", place.join(&name)))?;
    }
    fs::remove_dir(folder).map_err(Error::io("remove", folder))
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Error::io("remove", path)(error)),
        _ => Ok(()),
    }
}

//! Which photograph belongs to which exposure, where the camera hands its files over by another way than it is released.
//!
//! Photographs and exposures come in the same order; that they do is checked three times: by their number, by each
//! photograph's exposure time, and by the camera's clock, which may be wrong but has to be wrong by the same amount always.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use super::exif::{self, Exif};
use crate::picture::Picture;
use crate::{Error, Result, file};

/// How far the exposure time that a photograph tells may be from what was asked for, stops.
const EXPOSURE_STOPS: f64 = 1.0 / 3.0;
/// How much later than another time a camera may open its shutter, seconds.
const SHUTTER_JITTER_S: f64 = 0.5;
/// How much faster or slower a camera's clock may run: nine seconds a day.
const CLOCK_SKEW: f64 = 1e-4;

/// So many files are looked at in search of those that are too many.
const MOST_STEPS: usize = 20_000;

/// Something the camera was made to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// When it began, by the host's clock.
    pub at: SystemTime,
    /// The exposure time that was asked for, seconds.
    pub exposure_s: f64,
}

/// A file that a camera has written.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFile {
    /// Where it is.
    pub path: PathBuf,
    /// What it says of itself.
    pub exif: Exif,
    /// SHA-256 of its bytes in hexadecimal digits.
    pub sha256: String,
}

impl CameraFile {
    /// Reads a photograph whole.
    ///
    /// # Errors
    /// Those of [`Picture::read`].
    pub fn read(path: &Path) -> Result<Self> {
        Picture::read(path)?;
        Ok(Self { path: path.into(), exif: exif::read(path)?, sha256: file::sha256(path)?.1 })
    }

    /// The photograph's own exposure time, seconds.
    ///
    /// # Errors
    /// [`Error::Input`] when it has none, or one that is further than a third of a stop from `asked_s`.
    pub fn exposure_near(&self, asked_s: f64) -> Result<f64> {
        match self.exif.exposure_s {
            Some(time_s) if time_s > 0.0 && (time_s / asked_s).log2().abs() <= EXPOSURE_STOPS => Ok(time_s),
            Some(time_s) => Err(Error::input(
                &self.path,
                format!("was exposed for {time_s} s where {asked_s} s was asked for"),
                "set the camera to bulb, and see that no photograph is missing or was taken by hand",
            )),
            None => Err(Error::input(
                &self.path,
                "does not tell its exposure time, so nothing shows that it belongs here",
                "let the camera write EXIF",
            )),
        }
    }
}

/// The photographs of a folder and the folders in it, read whole, in the order in which they say that they were taken, then of
/// their names: a camera's numbers begin again after 9999, and it begins new folders. Those that do not say come last.
///
/// # Errors
/// [`Error::Io`] when a folder cannot be read, [`Error::Input`] naming a photograph that is damaged.
pub fn photographs(folder: &Path) -> Result<Vec<CameraFile>> {
    let (mut files, mut folders) = (vec![], vec![folder.to_path_buf()]);
    while let Some(folder) = folders.pop() {
        for path in super::folder::list(&folder)?.0 {
            files.push(CameraFile::read(&path)?);
        }
        for entry in std::fs::read_dir(&folder).map_err(Error::io("read", &folder))? {
            let entry = entry.map_err(Error::io("read", &folder))?;
            // Not through links, which may lead round in a circle.
            if entry.file_type().map_err(Error::io("read", entry.path()))?.is_dir() {
                folders.push(entry.path());
            }
        }
    }
    let time = |file: &CameraFile| file.exif.taken.map_or(f64::INFINITY, |taken| taken.clock_s);
    files.sort_by(|one, other| time(one).total_cmp(&time(other)).then_with(|| one.path.cmp(&other.path)));
    Ok(files)
}

/// Checks that the first of `files` is the photograph of the first exposure, and so on to the end of both.
///
/// # Errors
/// [`Error::Input`] naming the files that are too many, where the others show which these are; [`Error::Request`] when there
/// are more of one than of the other and nothing shows that; [`Error::Input`] naming the first file that does not fit and
/// what is wrong with it: see [`Matcher::accept`].
pub fn matching(exposures: &[Exposure], files: &[CameraFile]) -> Result<()> {
    if files.len() > exposures.len() {
        strangers(exposures, files)?;
    }
    if exposures.len() != files.len() {
        return Err(Error::request(
            format!("{} photographs were taken, but there are {} files", exposures.len(), files.len()),
            "give every photograph of the session and no other",
        ));
    }
    let mut matcher = Matcher::default();
    exposures.iter().zip(files).try_for_each(|(exposure, file)| matcher.accept(exposure, file).map(|_| ()))
}

/// Names the files without which the others are the photographs of the exposures, such as one whose exposure was never
/// written down because the capture was killed at that moment.
fn strangers(exposures: &[Exposure], files: &[CameraFile]) -> Result<()> {
    let mut search = Search { exposures, files, steps: 0, found: vec![] };
    search.go_on(&Matcher::default(), 0, &mut vec![]);
    let mut extra: Vec<usize> = search.found.concat();
    extra.sort_unstable();
    extra.dedup();
    let Some(&first) = extra.first() else { return Ok(()) };
    let more: Vec<String> = extra[1..].iter().map(|&index| files[index].path.display().to_string()).collect();
    let more = if more.is_empty() { String::new() } else { format!(", nor do {}", more.join(", ")) };
    Err(match search.found.len() {
        1 => Error::input(
            &files[first].path,
            format!("fits no exposure of the session by its clock and exposure time{more}"),
            "move it away and collect again",
        ),
        _ => Error::input(
            &files[first].path,
            format!("may be one too many: it does not fit together with all others{more}"),
            "look which of them is not the session's, move it away and collect again",
        ),
    })
}

/// A search for the files that are too many.
struct Search<'a> {
    exposures: &'a [Exposure],
    files: &'a [CameraFile],
    /// Files that were looked at.
    steps: usize,
    /// Which files to leave out, by index, one way after the other: two are enough to know that it is not clear.
    found: Vec<Vec<usize>>,
}

impl Search<'_> {
    /// Places the files from `next` on, without those `left_out`.
    fn go_on(&mut self, matcher: &Matcher, next: usize, left_out: &mut Vec<usize>) {
        let (mut matcher, depth) = (matcher.clone(), left_out.len());
        for index in next..=self.files.len() {
            if index == self.files.len() {
                if index - left_out.len() == self.exposures.len() {
                    self.found.push(left_out.clone());
                }
                break;
            }
            self.steps += 1;
            let exposure = self.exposures.get(index - left_out.len());
            let mut placed = matcher.clone();
            let fits = exposure.is_some_and(|exposure| placed.accept(exposure, &self.files[index]).is_ok());
            let may_leave_out = left_out.len() < self.files.len() - self.exposures.len();
            if fits && may_leave_out && self.found.len() < 2 && self.steps < MOST_STEPS {
                left_out.push(index);
                self.go_on(&matcher, index + 1, left_out);
                left_out.pop();
            }
            match (fits, may_leave_out) {
                (true, _) => matcher = placed,
                (false, true) => left_out.push(index),
                (false, false) => break,
            }
        }
        left_out.truncate(depth);
    }
}

/// Takes exposures and their files one after the other and learns how wrong the camera's clock is.
#[derive(Debug, Clone, Default)]
pub struct Matcher {
    accepted: Vec<(String, PathBuf)>,
    first: Option<Tie>,
    last: Option<Tie>,
}

/// What two clocks showed at one moment.
#[derive(Debug, Clone, Copy)]
struct Tie {
    host_s: f64,
    camera_s: f64,
    step_s: f64,
}

impl Tie {
    /// By how much the camera's clock jumped between two moments, seconds; 0 for what its steps and its drift explain.
    fn jump_s(&self, later: &Self) -> f64 {
        let (host_s, camera_s) = (later.host_s - self.host_s, later.camera_s - self.camera_s);
        let allowed_s = SHUTTER_JITTER_S + self.step_s.max(later.step_s) + CLOCK_SKEW * host_s.abs();
        if (camera_s - host_s).abs() <= allowed_s { 0.0 } else { camera_s - host_s }
    }
}

impl Matcher {
    /// Checks that a file is the photograph of the next exposure, and tells the photograph's own exposure time, seconds.
    ///
    /// # Errors
    /// [`Error::Input`] naming the file when it is a copy of an earlier one, when its exposure time is further than a third of
    /// a stop from what was asked for, when it does not tell its time, or when the camera's clock was then wrong by another
    /// amount than before.
    pub fn accept(&mut self, exposure: &Exposure, file: &CameraFile) -> Result<f64> {
        if let Some((_, earlier)) = self.accepted.iter().find(|(sha256, _)| *sha256 == file.sha256) {
            return Err(Error::input(
                &file.path,
                format!("is the same photograph as {}", earlier.display()),
                "give every photograph once",
            ));
        }
        let exposure_s = file.exposure_near(exposure.exposure_s)?;
        let taken = file.exif.taken.ok_or_else(|| {
            Error::input(
                &file.path,
                "does not tell when it was taken, so nothing shows that it belongs here",
                "let the camera write EXIF",
            )
        })?;
        let host_s = exposure.at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        let tie = Tie { host_s, camera_s: taken.clock_s, step_s: taken.step_s };
        for earlier in self.last.iter().chain(&self.first) {
            let jump_s = earlier.jump_s(&tie);
            if jump_s != 0.0 {
                let than = if jump_s > 0.0 { "later" } else { "earlier" };
                return Err(Error::input(
                    &file.path,
                    format!(
                        "was taken {:.1} s {than} by the camera's clock than its place in the order says",
                        jump_s.abs()
                    ),
                    "see that no photograph is missing, swapped or from elsewhere, and that nobody set the camera's clock",
                ));
            }
        }
        self.first.get_or_insert(tie);
        self.last = Some(tie);
        self.accepted.push((file.sha256.clone(), file.path.clone()));
        Ok(exposure_s)
    }
}

#[cfg(test)]
mod tests;

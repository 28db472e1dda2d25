//! A folder as a camera: somebody else, a person or another program, takes the photographs and puts them there.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::matching::CameraFile;
use super::{Camera, Shot, Taken};
use crate::file::{self, write_bytes};
use crate::{Error, Result};

/// The file types that are taken for photographs: those that [`crate::picture::Picture::read`] can read.
pub const EXTENSIONS: [&str; 6] = ["jpg", "jpeg", "png", "tif", "tiff", "exr"];
/// A photograph of a camera with 24 megapixels at its best JPEG quality, bytes.
const FILE_SIZE_BYTES: u64 = 20_000_000;
/// How often the folder is looked into.
const LOOK: Duration = Duration::from_millis(100);
/// File systems tell when a file was written in steps of up to two seconds (FAT).
const COARSE: Duration = Duration::from_secs(2);
/// What cameras that people hold can be set to, seconds.
const EXPOSURE_RANGE_S: [f64; 2] = [1.0 / 8000.0, 60.0];

/// The photographs in a folder in the order of their names, and how many other things are there.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be read.
pub fn list(folder: &Path) -> Result<(Vec<PathBuf>, usize)> {
    let (mut paths, mut others) = (vec![], 0);
    for entry in std::fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        match EXTENSIONS.contains(&extension.as_str()) {
            true => paths.push(path),
            false => others += 1,
        }
    }
    paths.sort();
    Ok((paths, others))
}

/// A folder that another program fills.
pub(super) struct Inbox {
    pub(super) folder: PathBuf,
    /// What was there before or was handed out.
    known: BTreeSet<PathBuf>,
    /// What was looked at in vain, with its size then.
    incomplete: HashMap<PathBuf, u64>,
}

impl Inbox {
    /// A folder whose present photographs count as new.
    pub(super) fn new(folder: &Path) -> Result<Self> {
        list(folder)?;
        Ok(Self { folder: folder.into(), known: BTreeSet::new(), incomplete: HashMap::new() })
    }

    /// From now on the present photographs are old.
    pub(super) fn ignore_present(&mut self) -> Result<()> {
        self.known.extend(list(&self.folder)?.0);
        Ok(())
    }

    /// What has come and was not handed out, in the order of names.
    pub(super) fn new_files(&self) -> Result<Vec<PathBuf>> {
        let (present, _) = list(&self.folder)?;
        Ok(present.into_iter().filter(|path| !self.known.contains(path)).collect())
    }

    /// Waits for a photograph, until it is there whole. It stays new until it is [taken](Inbox::take).
    ///
    /// # Errors
    /// [`Error::Device`] naming the folder when none comes in time, [`Error::Input`] naming a file that is still not whole
    /// then, or what `choose` says, which picks one of the new files or none.
    pub(super) fn wait(
        &mut self,
        time: Duration,
        choose: impl Fn(Vec<PathBuf>) -> Result<Option<PathBuf>>,
    ) -> Result<CameraFile> {
        let deadline = Instant::now() + time;
        let mut sizes: HashMap<PathBuf, u64> = HashMap::new();
        let mut failure = None;
        loop {
            if let Some(path) = choose(self.new_files()?)? {
                let size = std::fs::metadata(&path).map_or(0, |data| data.len());
                // A file that has just grown is not whole yet; one that was looked at in vain is read again when it grows.
                if size > 0
                    && sizes.insert(path.clone(), size) == Some(size)
                    && self.incomplete.get(&path) != Some(&size)
                {
                    match CameraFile::read(&path) {
                        Ok(file) => return Ok(file),
                        Err(error) => {
                            failure = Some(error);
                            self.incomplete.insert(path, size);
                        }
                    }
                }
            }
            if Instant::now() >= deadline {
                return Err(failure.unwrap_or_else(|| Error::Device {
                    device: self.folder.display().to_string(),
                    what: format!("no photograph came within {:.0} s", time.as_secs_f64()),
                    remedy:
                        "see that the camera is awake and its program writes its photographs into this folder"
                            .into(),
                }));
            }
            std::thread::sleep(LOOK);
        }
    }

    /// Marks a photograph as handed out and copies it to `stem` plus its own extension, byte by byte.
    pub(super) fn take(&mut self, file: &CameraFile, stem: &Path) -> Result<PathBuf> {
        let mut target = stem.as_os_str().to_os_string();
        target.push(".");
        target.push(file.path.extension().unwrap_or_default());
        let target = PathBuf::from(target);
        let bytes = std::fs::read(&file.path).map_err(Error::io("read", &file.path))?;
        write_bytes(&target, &bytes)?;
        self.known.insert(file.path.clone());
        Ok(target)
    }
}

/// A camera whose photographs somebody else takes.
pub struct FolderCamera {
    inbox: Inbox,
    wait: Duration,
    /// What was there at the start: taken in this order, whenever it was written.
    present: BTreeSet<PathBuf>,
    last: Option<CameraFile>,
    /// What was taken, by the SHA-256 of its bytes.
    taken: HashMap<String, PathBuf>,
}

impl FolderCamera {
    /// A folder whose photographs, those that are there and those that will come, are taken in the order of their names. Each
    /// may take `wait` to come. What was `taken` before an interruption, by the SHA-256 of its bytes in hexadecimal digits (see
    /// [`crate::session::Session::taken`]), is not taken again.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder or a file in it cannot be read.
    pub fn open(folder: &Path, taken: HashMap<String, PathBuf>, wait: Duration) -> Result<Self> {
        let mut inbox = Inbox::new(folder)?;
        let present = inbox.new_files()?.into_iter().collect();
        if !taken.is_empty() {
            for path in inbox.new_files()? {
                if taken.contains_key(&file::sha256(&path)?.1) {
                    inbox.known.insert(path);
                }
            }
        }
        Ok(Self { inbox, wait, present, last: None, taken })
    }
}

impl FolderCamera {
    /// Nobody could take a photograph of this view before the rig was there.
    fn check_written_since(&self, asked: SystemTime, path: &Path) -> Result<()> {
        if self.present.contains(path) {
            return Ok(());
        }
        let written =
            std::fs::metadata(path).and_then(|data| data.modified()).map_err(Error::io("read", path))?;
        match asked.duration_since(written) {
            Ok(before) if before > COARSE => Err(Error::input(
                path,
                format!("was written {:.1} s before its photograph was asked for", before.as_secs_f64()),
                "put each photograph there after the rig has arrived, or all of them before the capture starts",
            )),
            _ => Ok(()),
        }
    }
}

impl Camera for FolderCamera {
    fn describe(&self) -> String {
        format!("photographs from the folder {}", self.inbox.folder.display())
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        EXPOSURE_RANGE_S
    }

    /// The next photograph of the folder.
    ///
    /// # Errors
    /// Beside those of every camera, [`Error::Input`] naming the file when its exposure time is further than a third of a stop
    /// from `exposure_s`, when it was taken before the one that came last, when it is a copy of an earlier one, or when it came
    /// after the start and was written before this photograph was asked for: then the rig stood elsewhere.
    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        let asked = SystemTime::now();
        let file = self.inbox.wait(self.wait, |new| Ok(new.into_iter().next()))?;
        self.check_written_since(asked, &file.path)?;
        if let Some(earlier) = self.taken.get(&file.sha256) {
            return Err(Error::input(
                &file.path,
                format!("is the same photograph as {}", earlier.display()),
                "remove the copy",
            ));
        }
        let exposure_s = file.exposure_near(exposure_s)?;
        let time = |file: &CameraFile| file.exif.taken.map(|taken| taken.clock_s);
        if let Some((last, before, now)) =
            self.last.as_ref().and_then(|last| Some((last, time(last)?, time(&file)?)))
            && now < before
        {
            return Err(Error::input(
                &file.path,
                format!("was taken {:.1} s before {}", before - now, last.path.display()),
                "name the photographs in the order in which they were taken",
            ));
        }
        let target = self.inbox.take(&file, stem)?;
        self.taken.insert(file.sha256.clone(), file.path.clone());
        self.last = Some(file);
        Ok(Shot::Taken(Taken { file: target, exposure_s }))
    }

    fn overhead_s(&self, _exposure_s: f64) -> f64 {
        self.wait.as_secs_f64()
    }

    fn file_size_bytes(&self) -> u64 {
        FILE_SIZE_BYTES
    }
}

#[cfg(test)]
pub(super) mod tests;

//! A capture on disk: a folder with a manifest (`session.toml`: what was planned), an append-only journal
//! (`journal.jsonl`: what was photographed) and the camera's own files, untouched, under `photographs/`.

mod begin;
mod collect;
mod content;
mod event;
pub mod import;
mod journal;
mod lock;
mod manifest;
mod time;

use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

pub use collect::collect;
pub use content::Content;
pub use event::{Event, Exposed, Photograph, Place, Run};
pub use journal::Journal;
pub use manifest::{Manifest, Precision, View};

use crate::geometry::Pose;
use crate::picture::Picture;
use crate::progress::Progress;
use crate::{Error, Result, file};
use lock::Lock;

/// Where photographs are until they are complete. Only the holder of the lock touches it.
const TAKING: &str = "taking";

/// An open session.
#[derive(Debug)]
pub struct Session {
    folder: PathBuf,
    /// What was planned: surface, lenses and views.
    pub manifest: Manifest,
    journal: Journal,
    /// Held by whoever writes.
    lock: Option<Lock>,
    /// Photographs, by file, that were found missing or changed.
    damaged: BTreeSet<String>,
}

impl Session {
    /// Starts a session in `folder`, which must not exist or be empty, or hold nothing but what a start that was killed has
    /// left. Nobody else can write into it until it is dropped.
    ///
    /// # Errors
    /// [`Error::Input`] when the folder holds something or somebody else starts there, [`Error::Io`] when it cannot be
    /// written; then it is as it was.
    pub fn create(folder: &Path, manifest: Manifest) -> Result<Self> {
        let lock = begin::begin(folder, &manifest)?;
        let journal = Journal::open(&folder.join("journal.jsonl"))?;
        Ok(Self { folder: folder.into(), manifest, journal, lock: Some(lock), damaged: BTreeSet::new() })
    }

    /// Opens a session to read it or to go on with it; somebody else may be writing into it.
    ///
    /// # Errors
    /// [`Error::Input`] when the folder is not a session or its manifest or journal is damaged.
    pub fn open(folder: &Path) -> Result<Self> {
        let path = folder.join("session.toml");
        if !path.is_file() {
            return Err(Error::input(
                folder,
                "is not a session: it has no session.toml",
                "make one with `rigel capture` or `rigel import`",
            ));
        }
        let manifest = Manifest::read(&path)?;
        let journal = read_journal(folder, &manifest)?;
        Ok(Self { folder: folder.into(), manifest, journal, lock: None, damaged: BTreeSet::new() })
    }

    /// Takes the right to write into the session, until it is dropped, and clears away what a capture that was killed has
    /// left half done. Whoever already has the right keeps it.
    ///
    /// # Errors
    /// [`Error::Input`] when another process writes into it or has damaged it meanwhile; [`Error::Io`].
    pub fn lock(&mut self) -> Result<()> {
        if self.lock.is_some() {
            return Ok(());
        }
        let lock = Lock::take(&self.folder)?;
        // What somebody else has written since this was opened.
        self.journal = read_journal(&self.folder, &self.manifest)?;
        self.lock = Some(lock);
        self.clear_taking()
    }

    /// Replaces the plan, such as by one with more views.
    ///
    /// # Errors
    /// Those of [`Session::lock`]; [`Error::Io`] when it cannot be written: then the session is as it was.
    pub fn replan(&mut self, manifest: Manifest) -> Result<()> {
        self.lock()?;
        manifest.write(&self.folder.join("session.toml"))?;
        self.manifest = manifest;
        Ok(())
    }

    /// Removes what was written half.
    fn clear_taking(&self) -> Result<()> {
        let taking = self.folder.join(TAKING);
        match fs::remove_dir_all(&taking) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::io("remove", taking)(error))
            }
            _ => Ok(()),
        }
    }

    /// Has a file or a folder written and moves it to `name` in the session when it is complete, plus the extension that
    /// `write` has given it. `write` gets the path to write to and returns what it has written, and something more.
    ///
    /// # Errors
    /// Those of `write`, [`Session::lock`] and of the disk; then nothing is left of it.
    pub fn adopt<T>(
        &mut self,
        name: &str,
        write: impl FnOnce(&Path) -> Result<Option<(PathBuf, T)>>,
    ) -> Result<Option<(String, T)>> {
        self.lock()?;
        let (folder, last) = name.rsplit_once('/').map_or(("", name), |(folder, last)| (folder, last));
        let taking = self.folder.join(TAKING);
        fs::create_dir_all(&taking).map_err(Error::io("create", &taking))?;
        let adopted = write(&taking.join(last)).and_then(|written| {
            let Some((path, more)) = written else { return Ok(None) };
            if path.parent() != Some(&taking) {
                // Moved from there, it would be missed by whoever put it there.
                return Err(Error::input(
                    path,
                    format!("was written in place of {}", taking.join(last).display()),
                    "report this as a defect of the camera's driver",
                ));
            }
            let place = self.folder.join(folder).join(path.file_name().unwrap_or_default());
            file::put_in_place(&path, &place)?;
            // The journal is the same on every system.
            let inside = place.strip_prefix(&self.folder).unwrap_or(&place);
            Ok(Some((inside.to_string_lossy().replace('\\', "/"), more)))
        });
        let cleared = self.clear_taking();
        adopted.and_then(|adopted| cleared.map(|()| adopted))
    }

    /// The session's folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder of radiance pictures.
    pub fn radiance_folder(&self) -> PathBuf {
        self.folder.join("radiance")
    }

    /// Where the radiance of a view is kept.
    pub fn radiance_path(&self, view: usize) -> PathBuf {
        self.radiance_folder().join(format!("{}.exr", self.manifest.views[view].name))
    }

    /// The photographs of one view, in the order in which they were taken.
    pub fn photographs(&self, view: usize) -> Vec<&Photograph> {
        self.journal.photographs().filter(|photograph| photograph.view == view).collect()
    }

    /// Columns and rows of the session's photographs: of the first one that is there.
    ///
    /// # Errors
    /// [`Error::Input`] where it has no photograph or that cannot be read; [`Error::Io`].
    pub fn picture_size(&self) -> Result<(u32, u32)> {
        let first = self.journal.photographs().next().ok_or_else(|| {
            Error::input(&self.folder, "has no photograph", "go on with `rigel capture --resume`")
        })?;
        let picture = Picture::read(self.photograph_path(first))?;
        Ok((picture.width, picture.height))
    }

    /// The flat-field photographs of the session, by name; empty where it has none.
    ///
    /// # Errors
    /// [`Error::Io`] when their folder cannot be read.
    pub fn flats(&self) -> Result<Vec<PathBuf>> {
        let folder = self.folder.join("flats");
        if !folder.is_dir() {
            return Ok(vec![]);
        }
        let entries = fs::read_dir(&folder).map_err(Error::io("read", &folder))?;
        let mut paths: Vec<PathBuf> = entries
            .map(|entry| Ok(entry.map_err(Error::io("read", &folder))?.path()))
            .collect::<Result<_>>()?;
        paths.sort();
        Ok(paths)
    }

    /// The absolute path of a photograph.
    pub fn photograph_path(&self, photograph: &Photograph) -> PathBuf {
        self.folder.join(&photograph.file)
    }

    /// Writes an event to the journal; it is on the disk when this returns.
    ///
    /// # Errors
    /// [`Error::Io`] when the disk is full or cannot be written; those of [`Session::lock`].
    pub fn record(&mut self, event: Event) -> Result<()> {
        self.lock()?;
        if let Event::Photograph(photograph) = &event {
            self.damaged.remove(&photograph.file);
        }
        self.journal.append(event)
    }

    /// Everything that the journal remembers, in order.
    pub fn events(&self) -> &[Event] {
        self.journal.events()
    }

    /// Notes that something has happened to a device.
    ///
    /// # Errors
    /// Those of [`Session::record`].
    pub fn notice(&mut self, text: impl Into<String>) -> Result<()> {
        self.record(Event::Notice { at: time::now(), text: text.into() })
    }

    /// The photographs that the camera still has, in the order in which they were exposed.
    pub fn waiting(&self) -> Vec<&Exposed> {
        self.journal.waiting()
    }

    /// Compares the photographs with the journal: their sizes, and with `hashes` every byte of them. What is missing or changed
    /// is remembered, and its view is not done any more. Returns a sentence for each.
    ///
    /// # Errors
    /// [`Error::Io`] when a file is there and cannot be read; [`Error::Interrupted`].
    pub fn verify(&mut self, hashes: bool, progress: &dyn Progress) -> Result<Vec<String>> {
        let photographs: Vec<&Photograph> = self.journal.photographs().collect();
        let (mut damaged, mut sentences) = (BTreeSet::new(), vec![]);
        for (index, photograph) in photographs.iter().enumerate() {
            progress.step(index, photographs.len())?;
            let path = self.photograph_path(photograph);
            if let Some(damage) = Content::damage(photograph.content.as_ref(), &path, hashes)? {
                damaged.insert(photograph.file.clone());
                sentences.push(format!("{} {damage}", photograph.file));
            }
        }
        progress.step(photographs.len(), photographs.len())?;
        self.damaged.extend(damaged);
        Ok(sentences)
    }

    /// The photographs that a capture which goes on does not take again, their paths by the SHA-256 of their bytes: those of
    /// the journal. A file that was moved to its place and not told to the journal is none of them.
    ///
    /// # Errors
    /// [`Error::Io`] when a photograph is there and cannot be read.
    pub fn taken(&self) -> Result<HashMap<String, PathBuf>> {
        let mut taken = HashMap::new();
        for photograph in self.journal.photographs() {
            // In a view that is not done, what does not have its hash is taken again.
            if self.is_done(photograph.view) || self.is_intact(photograph)? {
                let path = self.photograph_path(photograph);
                let sha256 = match &photograph.content {
                    Some(content) => content.sha256.clone(),
                    None => Content::of(&path)?.sha256,
                };
                taken.insert(sha256, path);
            }
        }
        Ok(taken)
    }

    /// Whether a photograph's file is as it was: every byte of it is read.
    pub(crate) fn is_intact(&self, photograph: &Photograph) -> Result<bool> {
        let path = self.photograph_path(photograph);
        Ok(!self.damaged.contains(&photograph.file)
            && Content::damage(photograph.content.as_ref(), &path, true)?.is_none())
    }

    /// Whether the journal says that all photographs of a view were taken, and none of them was found damaged.
    pub fn is_done(&self, view: usize) -> bool {
        self.journal.is_done(view)
            && !(self.damaged.iter().any(|file| self.photographs(view).iter().any(|p| p.file == *file)))
    }

    /// The views of which all photographs were taken, by index.
    pub fn done_views(&self) -> Vec<usize> {
        (0..self.manifest.views.len()).filter(|&view| self.is_done(view)).collect()
    }

    /// The pose of a view: calibrated where it is known, else the rig's nominal one.
    ///
    /// # Errors
    /// [`Error::Input`] when the session has neither.
    pub fn pose(&self, view: usize) -> Result<Pose> {
        let record = &self.manifest.views[view];
        if let Some(pose) = record.pose {
            return Ok(pose);
        }
        match (record.pan_deg, record.tilt_deg, self.manifest.distance_m) {
            (Some(pan), Some(tilt), Some(distance_m)) => {
                Ok(Pose::from_rig(pan.to_radians(), tilt.to_radians(), distance_m))
            }
            (Some(_), Some(_), None) => Err(Error::input(
                self.folder.join("session.toml"),
                format!("view {} has pan and tilt but the camera's distance is not known", record.name),
                "import with --distance 900mm",
            )),
            _ => Err(Error::input(
                self.folder.join("session.toml"),
                format!("view {} has no pose", record.name),
                "import with a CSV of pan and tilt, a COLMAP model or --calibration",
            )),
        }
    }
}

/// Now, as exactly as a journal writes it.
pub(crate) fn now() -> SystemTime {
    time::now()
}

/// A file's name in the journal without its extension.
pub(crate) fn stem_of(file: &str) -> &str {
    journal::stem(file)
}

fn read_journal(folder: &Path, manifest: &Manifest) -> Result<Journal> {
    let path = folder.join("journal.jsonl");
    let journal = Journal::open(&path)?;
    for event in journal.events() {
        let (what, view) = match event {
            Event::Photograph(photograph) => (photograph.file.as_str(), photograph.view),
            Event::Exposed(exposed) => (exposed.stem.as_str(), exposed.view),
            Event::Run(_) | Event::ViewDone { .. } | Event::ViewMoved { .. } | Event::Notice { .. } => {
                continue;
            }
        };
        if view >= manifest.views.len() {
            return Err(Error::input(
                &path,
                format!("{what} belongs to view {view}, which the manifest does not have"),
                "restore session.toml from a copy",
            ));
        }
    }
    Ok(journal)
}

#[cfg(test)]
mod tests;

//! A capture on disk: a folder with a manifest (`session.toml`: what was planned), an append-only journal
//! (`journal.jsonl`: what was photographed) and the camera's own files, untouched, under `photographs/`.

pub mod import;
mod journal;
mod manifest;

use std::fs;
use std::path::{Path, PathBuf};

pub use journal::{Event, Journal, Photograph};
pub use manifest::{Manifest, View};

use crate::geometry::Pose;
use crate::{Error, Result};

/// An open session.
#[derive(Debug)]
pub struct Session {
    folder: PathBuf,
    /// What was planned: surface, lenses and views.
    pub manifest: Manifest,
    journal: Journal,
}

impl Session {
    /// Starts a session in `folder`, which must not exist or be empty.
    ///
    /// # Errors
    /// [`Error::Input`] when the folder holds something, [`Error::Io`] when it cannot be written; then it is as it was.
    pub fn create(folder: &Path, manifest: Manifest) -> Result<Self> {
        refuse_occupied(folder)?;
        let existed = folder.exists();
        if let Err(error) = make(folder, &manifest) {
            // What is left behind would be neither empty nor a session. The error that matters is the first one.
            let _ = fs::remove_file(folder.join("session.toml"));
            let _ = fs::remove_dir(folder.join("photographs"));
            if !existed {
                let _ = fs::remove_dir(folder);
            }
            return Err(error);
        }
        let journal = Journal::open(&folder.join("journal.jsonl"))?;
        Ok(Self { folder: folder.into(), manifest, journal })
    }

    /// Opens a session to read it or to go on with it.
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
        let journal = Journal::open(&folder.join("journal.jsonl"))?;
        let session = Self { folder: folder.into(), manifest, journal };
        for photograph in session.journal.photographs() {
            if photograph.view >= session.manifest.views.len() {
                return Err(Error::input(
                    folder.join("journal.jsonl"),
                    format!(
                        "{} belongs to view {}, which the manifest does not have",
                        photograph.file, photograph.view
                    ),
                    "restore session.toml from a copy",
                ));
            }
        }
        Ok(session)
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
    /// [`Error::Io`] when the disk is full or cannot be written.
    pub fn record(&mut self, event: Event) -> Result<()> {
        self.journal.append(event)
    }

    /// Whether the journal says that all photographs of a view were taken.
    pub fn is_done(&self, view: usize) -> bool {
        self.journal.is_done(view)
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

fn make(folder: &Path, manifest: &Manifest) -> Result<()> {
    fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    manifest.write(&folder.join("session.toml"))?;
    let photographs = folder.join("photographs");
    fs::create_dir(&photographs).map_err(Error::io("create", &photographs))
}

fn refuse_occupied(folder: &Path) -> Result<()> {
    match fs::read_dir(folder) {
        Ok(mut entries) => match entries.next() {
            Some(_) => Err(Error::input(
                folder,
                "is not empty",
                "choose a new folder for the session, or go on with `rigel capture --resume`",
            )),
            None => Ok(()),
        },
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(Error::io("read", folder)(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Manifest {
        let view = |name: &str| View {
            name: name.into(),
            pan_deg: Some(10.0),
            tilt_deg: Some(20.0),
            lens: 0,
            pose: None,
        };
        Manifest { views: vec![view("view000"), view("view001")], ..Manifest::new("test") }
    }

    fn photograph(view: usize, file: &str) -> Event {
        Event::Photograph(Photograph { view, file: file.into(), exposure_s: Some(0.5) })
    }

    #[test]
    fn what_was_recorded_is_there_after_reopening() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = Session::create(folder.path(), manifest()).unwrap();
        session.record(photograph(0, "photographs/a.jpg")).unwrap();
        session.record(Event::ViewDone { view: 0 }).unwrap();
        session.record(photograph(1, "photographs/b.jpg")).unwrap();
        drop(session);
        let session = Session::open(folder.path()).unwrap();
        assert_eq!(session.manifest, manifest());
        assert_eq!(session.done_views(), [0]);
        assert_eq!(session.photographs(1).len(), 1);
    }

    #[test]
    fn a_torn_last_line_is_forgotten_and_the_journal_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = Session::create(folder.path(), manifest()).unwrap();
        session.record(photograph(0, "photographs/a.jpg")).unwrap();
        drop(session);
        let path = folder.path().join("journal.jsonl");
        let mut text = fs::read_to_string(&path).unwrap();
        text.push_str("{\"photograph\":{\"view\":0,\"fi");
        fs::write(&path, text).unwrap();
        let mut session = Session::open(folder.path()).unwrap();
        assert_eq!(session.photographs(0).len(), 1);
        session.record(photograph(0, "photographs/c.jpg")).unwrap();
        drop(session);
        assert_eq!(Session::open(folder.path()).unwrap().photographs(0).len(), 2);
    }

    #[test]
    fn damage_inside_the_journal_is_an_error_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let mut session = Session::create(folder.path(), manifest()).unwrap();
        session.record(photograph(0, "photographs/a.jpg")).unwrap();
        session.record(photograph(0, "photographs/b.jpg")).unwrap();
        drop(session);
        let path = folder.path().join("journal.jsonl");
        let text = fs::read_to_string(&path).unwrap().replacen("photograph", "phot\u{0}graph", 1);
        fs::write(&path, text).unwrap();
        let message = Session::open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("line 1"), "{message}");
    }

    #[test]
    fn views_whose_files_would_meet_or_lie_elsewhere_are_refused() {
        for name in ["view000", "", "../view001", "a\\b"] {
            let folder = tempfile::tempdir().unwrap();
            let mut twice = manifest();
            twice.views[1].name = name.into();
            Session::create(folder.path(), twice).unwrap();
            let message = Session::open(folder.path()).unwrap_err().to_string();
            assert!(message.contains("session.toml") && message.contains(name), "{message}");
        }
    }

    #[test]
    fn an_occupied_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("precious.txt"), "x").unwrap();
        assert!(Session::create(folder.path(), manifest()).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

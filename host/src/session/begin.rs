//! How a session's folder comes to be, so that a start that is killed can be started again.

use std::fs;
use std::path::Path;

use super::lock::{LOCK_FILE, Lock};
use super::manifest::Manifest;
use crate::{Error, Result};

/// Makes a session of `folder`, which is as it was after an error; see [`super::Session::create`].
pub(super) fn begin(folder: &Path, manifest: &Manifest) -> Result<Lock> {
    let existed = folder.exists();
    if !is_unfinished(folder) {
        refuse_occupied(folder)?;
    }
    fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    let lock = Lock::take(folder)?;
    // Somebody else may have finished between the first look and the lock.
    let made = if is_unfinished(folder) { make(folder, manifest) } else { refuse_occupied(folder) };
    if let Err(error) = made {
        drop(lock);
        if is_unfinished(folder) {
            // What is left behind would be neither empty nor a session. The error that matters is the first one.
            let _ = fs::remove_dir(folder.join("photographs"));
            let _ = fs::remove_file(folder.join(LOCK_FILE));
            if !existed {
                let _ = fs::remove_dir(folder);
            }
        }
        return Err(error);
    }
    Ok(lock)
}

/// The manifest comes last: a folder with it is a session.
fn make(folder: &Path, manifest: &Manifest) -> Result<()> {
    let photographs = folder.join("photographs");
    match fs::create_dir(&photographs) {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
            return Err(Error::io("create", &photographs)(error));
        }
        _ => {}
    }
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        if path.extension().is_some_and(|end| end == "rigel-tmp") {
            fs::remove_file(&path).map_err(Error::io("remove", path))?;
        }
    }
    manifest.write(&folder.join("session.toml"))
}

/// Whether a folder is what [`make`] has left that did not come to its end.
fn is_unfinished(folder: &Path) -> bool {
    let Ok(entries) = fs::read_dir(folder) else { return false };
    let mut locked = false;
    for entry in entries {
        let Ok(entry) = entry else { return false };
        let name = entry.file_name().to_string_lossy().into_owned();
        match name.as_str() {
            LOCK_FILE => locked = true,
            "photographs" if fs::read_dir(entry.path()).is_ok_and(|mut inside| inside.next().is_none()) => {}
            _ if name.starts_with("session.toml.") && name.ends_with(".rigel-tmp") => {}
            _ => return false,
        }
    }
    locked
}

pub(super) fn refuse_occupied(folder: &Path) -> Result<()> {
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

//! Files are written beside their place and renamed into it, so that a crash or a full disk never leaves half a file.
//! A folder that is made as a whole is treated in the same way.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::{Error, Result};

/// Calls `write` with a temporary path in the folder of `path` and renames the result, a file or a folder, to `path`.
///
/// # Errors
/// Whatever `write` returns, or the failure to rename; then the temporary file is removed and what stood at `path` is untouched.
pub fn write_beside(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    write_and_move(path, write, |temporary| fs::rename(temporary, path))
}

/// The same for a folder, which replaces a folder at `path`: that is only moved away once the new one is whole, and deleted once
/// the new one is in its place (a process that is killed between the two leaves it as `NAME.PID.rigel-old`). Whoever asks for this has
/// made sure that the old one may go.
///
/// # Errors
/// As [`write_beside`].
pub(crate) fn replace_folder(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let old = beside(path, "rigel-old");
    write_and_move(path, write, |temporary| {
        if !path.exists() {
            return fs::rename(temporary, path);
        }
        fs::rename(path, &old)?;
        // What stood there comes back where the new one does not get there.
        fs::rename(temporary, path).inspect_err(|_| drop(fs::rename(&old, path)))
    })?;
    if old.exists() { fs::remove_dir_all(&old).map_err(Error::io("delete", &old)) } else { Ok(()) }
}

fn write_and_move(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<()>,
    move_to_place: impl FnOnce(&Path) -> std::io::Result<()>,
) -> Result<()> {
    let temporary = temporary_for(path);
    let finished = write(&temporary)
        .and_then(|()| sync(&temporary).map_err(Error::io("write", path)))
        .and_then(|()| move_to_place(&temporary).map_err(Error::io("write", path)))
        .and_then(|()| sync_folder_of(path).map_err(Error::io("write", path)));
    if finished.is_err() {
        remove(&temporary);
    }
    finished.map_err(|error| match error {
        // A message names what the user knows, not the temporary file, which is gone.
        Error::Io { path: at, doing, source } => {
            let at = at.strip_prefix(&temporary).map_or(at.clone(), |rest| named(path, rest));
            Error::Io { path: at, doing, source }
        }
        other => other,
    })
}

/// `path`, and `rest` in it where there is any.
fn named(path: &Path, rest: &Path) -> PathBuf {
    if rest.as_os_str().is_empty() { path.into() } else { path.join(rest) }
}

/// Waits until a file's content is on the disk: after a power cut a renamed file must not be empty.
fn sync(temporary: &Path) -> std::io::Result<()> {
    if temporary.is_file() {
        fs::OpenOptions::new().write(true).open(temporary)?.sync_all()?;
    }
    Ok(())
}

/// Waits until the name of a new file is on the disk. Only Unix lets a program wait for that; elsewhere it is the file
/// system's own business.
pub(crate) fn sync_folder_of(path: &Path) -> std::io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match cfg!(unix).then(|| fs::File::open(folder).and_then(|folder| folder.sync_all())) {
        // Some file systems do not know how.
        Some(Err(error)) if error.kind() != std::io::ErrorKind::InvalidInput => Err(error),
        _ => Ok(()),
    }
}

/// How many bytes a file has, and their SHA-256 in hexadecimal digits.
///
/// # Errors
/// [`Error::Io`] when it cannot be read.
pub(crate) fn sha256(path: &Path) -> Result<(u64, String)> {
    let mut file = fs::File::open(path).map_err(Error::io("read", path))?;
    let (mut hasher, mut bytes, mut buffer) = (Sha256::new(), 0, vec![0; 1 << 16]);
    loop {
        match file.read(&mut buffer) {
            Ok(0) => break,
            Ok(count) => {
                hasher.update(&buffer[..count]);
                bytes += count as u64;
            }
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => return Err(Error::io("read", path)(error)),
        }
    }
    Ok((bytes, hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()))
}

/// Moves a finished file to its place: it is on the disk, under its name, when this returns.
///
/// # Errors
/// [`Error::Io`] when it cannot be written or moved.
pub(crate) fn put_in_place(file: &Path, place: &Path) -> Result<()> {
    sync(file).map_err(Error::io("write", place))?;
    fs::rename(file, place).map_err(Error::io("write", place))?;
    sync_folder_of(place).map_err(Error::io("write", place))
}

/// Best effort: the error that matters is the one that made this necessary.
fn remove(temporary: &Path) {
    let _ = if temporary.is_dir() { fs::remove_dir_all(temporary) } else { fs::remove_file(temporary) };
}

/// Writes `bytes` to `path` by way of a temporary file.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be written or the disk is full.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_beside(path, |temporary| fs::write(temporary, bytes).map_err(Error::io("write", path)))
}

/// The same where nothing is there yet.
///
/// # Errors
/// As [`write_bytes`], and [`Error::Io`] with [`std::io::ErrorKind::AlreadyExists`].
pub(crate) fn write_new(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = |temporary: &Path| fs::write(temporary, bytes).map_err(Error::io("write", path));
    write_and_move(path, write, |temporary| match fs::hard_link(temporary, path) {
        Ok(()) => fs::remove_file(temporary),
        // Some file systems know no second names.
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists && !path.exists() => {
            fs::rename(temporary, path)
        }
        Err(error) => Err(error),
    })
}

/// Writes several files (name, bytes) to `folder`, which is made where it does not exist: all of them or none.
///
/// # Errors
/// [`Error::Io`] when the folder cannot be written or the disk is full; then no file was replaced.
pub fn write_together(folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
    if !folder.exists() {
        let parent = folder.parent().unwrap_or(Path::new(""));
        fs::create_dir_all(parent).map_err(Error::io("create", folder))?;
        return write_beside(folder, |temporary| {
            fs::create_dir(temporary).map_err(Error::io("create", folder))?;
            files.iter().try_for_each(|(name, bytes)| {
                fs::write(temporary.join(name), bytes).map_err(Error::io("write", folder.join(name)))
            })
        });
    }
    let paths: Vec<PathBuf> = files.iter().map(|(name, _)| folder.join(name)).collect();
    let written = paths.iter().zip(files).try_for_each(|(path, (_, bytes))| {
        let temporary = temporary_for(path);
        fs::write(&temporary, bytes).and_then(|()| sync(&temporary)).map_err(Error::io("write", path))
    });
    let finished = written.and_then(|()| {
        paths
            .iter()
            .try_for_each(|path| fs::rename(temporary_for(path), path).map_err(Error::io("write", path)))
    });
    if finished.is_err() {
        paths.iter().for_each(|path| remove(&temporary_for(path)));
    }
    finished
}

fn temporary_for(path: &Path) -> PathBuf {
    beside(path, "rigel-tmp")
}

fn beside(path: &Path, extension: &str) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.{extension}", std::process::id()));
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        write_bytes(&path, b"before").unwrap();
        let failed = write_beside(&path, |temporary| {
            fs::write(temporary, b"half").unwrap();
            Err(Error::Interrupted)
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"before");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_must_be_new_replaces_nothing_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frames.csv");
        write_new(&path, b"first").unwrap();
        let refused = write_new(&path, b"second").unwrap_err();
        assert!(
            matches!(&refused, Error::Io { source, .. } if source.kind() == std::io::ErrorKind::AlreadyExists),
            "{refused}"
        );
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_is_replaced_as_a_whole_or_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("store");
        let make = |name: &'static str| {
            move |temporary: &Path| {
                fs::create_dir(temporary).unwrap();
                fs::write(temporary.join(name), name).unwrap();
                Ok(())
            }
        };
        let held =
            || fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().file_name()).collect::<Vec<_>>();
        replace_folder(&path, make("first")).unwrap();
        let failed = replace_folder(&path, |temporary| {
            make("second")(temporary)?;
            Err(Error::Interrupted)
        });
        assert!(failed.is_err());
        assert_eq!(held(), ["first"]);
        replace_folder(&path, make("third")).unwrap();
        assert_eq!(held(), ["third"]);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_failed_folder_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let failed = write_beside(&folder.path().join("session"), |temporary| {
            fs::create_dir(temporary).unwrap();
            fs::write(temporary.join("half"), b"half").unwrap();
            fs::write(temporary.join("none/half"), b"")
                .map_err(Error::io("write", temporary.join("none/half")))
        });
        assert!(failed.unwrap_err().to_string().contains("session/none/half"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn files_that_belong_together_are_all_written_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("errors");
        let file = |name: &str, text: &str| (name.to_owned(), text.as_bytes().to_vec());
        write_together(&out, &[file("a", "1"), file("b", "1")]).unwrap();
        assert!(write_together(&out, &[file("a", "2"), file("none/b", "2")]).is_err());
        assert_eq!(fs::read(out.join("a")).unwrap(), b"1");
        assert_eq!(fs::read_dir(&out).unwrap().count(), 2);
        write_together(&out, &[file("b", "2"), file("c", "2")]).unwrap();
        assert_eq!(fs::read(out.join("b")).unwrap(), b"2");
        assert!(write_together(&folder.path().join("new"), &[file("none/b", "2")]).is_err());
        assert!(!folder.path().join("new").exists());
    }
}

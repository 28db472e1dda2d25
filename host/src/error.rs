//! One error type for the library: every variant says what is wrong, with which value, and what to do.

use std::path::{Path, PathBuf};

/// What can go wrong, as one sentence each.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file holds something that cannot be used.
    #[error("{}: {what}; {remedy}", path.display())]
    Input {
        /// The file at fault.
        path: PathBuf,
        /// What is wrong, with the value.
        what: String,
        /// What the user can do.
        remedy: String,
    },
    /// What was asked for contradicts itself or the data.
    #[error("{what}; {remedy}")]
    Request {
        /// What is wrong, with the value.
        what: String,
        /// What the user can do.
        remedy: String,
    },
    /// The operating system refused to read or write a file.
    #[error("{}: cannot {doing}: {source}; {}", path.display(), remedy_for(source))]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was attempted, as a verb: "read", "write".
        doing: &'static str,
        /// What the operating system said.
        #[source]
        source: std::io::Error,
    },
    /// A device did not do what it should.
    #[error("{device}: {what}; {remedy}")]
    Device {
        /// Which device: its port or name.
        device: String,
        /// What happened.
        what: String,
        /// What the user can do.
        remedy: String,
    },
    /// The user asked to stop.
    #[error("interrupted; nothing is half written, and what was finished is kept")]
    Interrupted,
}

/// The library's results.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A file at fault: what is wrong with it and what to do.
    pub fn input(path: impl AsRef<Path>, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Input { path: path.as_ref().into(), what: what.into(), remedy: remedy.into() }
    }

    /// A request at fault: what is wrong with it and what to do.
    pub fn request(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Request { what: what.into(), remedy: remedy.into() }
    }

    /// The same, of a file: a [`Error::Request`] becomes an [`Error::Input`] that names `path`, others stay as they are.
    pub fn about(self, path: impl AsRef<Path>) -> Self {
        match self {
            Self::Request { what, remedy } => Self::input(path, what, remedy),
            other => other,
        }
    }

    /// Turns an operating system's error into one that names the file: `.map_err(Error::io("read", path))`.
    pub fn io(doing: &'static str, path: impl AsRef<Path>) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.as_ref().to_path_buf();
        move |source| Self::Io { path, doing, source }
    }
}

fn remedy_for(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind::*;
    match source.kind() {
        NotFound => "check the path",
        PermissionDenied | ReadOnlyFilesystem => {
            "choose a folder that you may write, or change its permissions"
        }
        StorageFull | QuotaExceeded => "free some space and run the command again",
        AlreadyExists => "choose another name or remove it first",
        NotADirectory => "choose a path whose folders are folders",
        IsADirectory => "name a file, not a folder",
        FileTooLarge => "choose a disk that holds larger files, or raise the limit (`ulimit -f`)",
        InvalidData => "give a text file in UTF-8",
        _ => "check the disk and run the command again",
    }
}

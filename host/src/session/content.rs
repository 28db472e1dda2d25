//! What a photograph's file holds, so that a damaged or exchanged one is noticed.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Size and hash of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Content {
    /// How many bytes it has.
    pub bytes: u64,
    /// SHA-256 of them in hexadecimal digits, as `sha256sum` prints it.
    pub sha256: String,
}

impl Content {
    /// The content of a file, read whole.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read.
    pub fn of(path: &Path) -> Result<Self> {
        let (bytes, sha256) = crate::file::sha256(path)?;
        Ok(Self { bytes, sha256 })
    }

    /// What is wrong with the file at `path`, in words; `None` when it is as it was. Without `whole` only its size is looked
    /// at, which costs nothing.
    ///
    /// # Errors
    /// [`Error::Io`] when it is there and cannot be read.
    pub(super) fn damage(known: Option<&Self>, path: &Path, whole: bool) -> Result<Option<String>> {
        let bytes = match std::fs::metadata(path) {
            Ok(metadata) => metadata.len(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Ok(Some("is missing".into()));
            }
            Err(error) => return Err(Error::io("read", path)(error)),
        };
        Ok(match known {
            None if bytes == 0 => Some("is empty".into()),
            Some(known) if bytes != known.bytes => Some(format!("has {bytes} bytes and had {}", known.bytes)),
            Some(known) if whole && Self::of(path)? != *known => {
                Some("does not have the content that it had".into())
            }
            _ => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_the_one_of_the_standard() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        // FIPS 180-4's examples: "abc" and a million times "a".
        for (bytes, sha256) in [
            (b"abc".to_vec(), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"),
            (vec![b'a'; 1_000_000], "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0"),
        ] {
            std::fs::write(&path, &bytes).unwrap();
            let content = Content::of(&path).unwrap();
            assert_eq!((content.bytes, content.sha256.as_str()), (bytes.len() as u64, sha256));
        }
    }

    #[test]
    fn damage_is_said_in_words() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "as it was").unwrap();
        let known = Content::of(&path).unwrap();
        let damage = |known: Option<&Content>, whole| {
            Content::damage(known, &path, whole).unwrap().unwrap_or_default()
        };
        assert_eq!((damage(Some(&known), true), damage(None, true)), (String::new(), String::new()));
        std::fs::write(&path, "as it is.").unwrap();
        assert_eq!(damage(Some(&known), false), "");
        assert!(damage(Some(&known), true).contains("content"));
        std::fs::write(&path, "").unwrap();
        assert!(damage(Some(&known), false).contains("0 bytes") && damage(None, false).contains("empty"));
        std::fs::remove_file(&path).unwrap();
        assert!(damage(Some(&known), false).contains("missing") && damage(None, false).contains("missing"));
    }
}

//! What the tests that cross a boundary share.

use std::path::PathBuf;

pub mod image;

/// The folder of real test data: `RIGEL_DATA`, or `../shared/data` beside the checkout.
///
/// Returns `None`, after saying so in one line, where `part` is not there; with `CI` set that is a failure.
pub fn data(part: &str) -> Option<PathBuf> {
    let root = std::env::var_os("RIGEL_DATA")
        .map(PathBuf::from)
        .unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"));
    let path = root.join(part);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing: set RIGEL_DATA", path.display());
    eprintln!("skipped: {} is missing: set RIGEL_DATA to the folder of test data", path.display());
    None
}

//! Photographs as files: which there are, and whether they still grow.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, UNIX_EPOCH};

use glam::DQuat;

use crate::Result;
use crate::camera::folder::list;

/// A file that cannot be read and has not grown for so long is no photograph, or a table with a fault.
const BROKEN: Duration = Duration::from_secs(3);

/// Sizes of files when they were last looked at, and since when.
#[derive(Default)]
pub(super) struct Sizes(BTreeMap<PathBuf, (u64, Instant)>);

impl Sizes {
    /// Whether a file is there and has not grown since it was last looked at.
    pub fn is_whole(&mut self, path: &Path) -> bool {
        let Ok(size) = fs::metadata(path).map(|data| data.len()) else { return false };
        let before = self.0.get(path).map(|(size, _)| *size);
        if before != Some(size) {
            self.0.insert(path.into(), (size, Instant::now()));
        }
        before == Some(size)
    }

    /// Whether a file of at least so many bytes has not grown for long.
    pub fn has_stayed(&self, path: &Path, bytes: u64) -> bool {
        self.0.get(path).is_some_and(|(size, since)| *size >= bytes && since.elapsed() > BROKEN)
    }
}

/// A photograph as the table, or the folder, has it.
pub(super) struct Line {
    pub path: PathBuf,
    pub turn: Option<DQuat>,
    pub sigma_rad: Option<f64>,
    pub time_s: Option<f64>,
}

/// The photographs of a folder that are not known yet, in the order in which they were written.
pub(super) fn by_time(folder: &Path, known: &BTreeSet<PathBuf>) -> Result<Vec<Line>> {
    let mut lines = vec![];
    for path in list(folder)?.0.into_iter().filter(|path| !known.contains(path)) {
        // Between two looks another program may take its file away again.
        let Ok(written) = fs::metadata(&path).and_then(|data| data.modified()) else { continue };
        let time_s = written.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        lines.push(Line { path, turn: None, sigma_rad: None, time_s: Some(time_s) });
    }
    lines.sort_by(|a, b| {
        let time_s = |line: &Line| line.time_s.unwrap_or(0.0);
        time_s(a).total_cmp(&time_s(b)).then_with(|| a.path.cmp(&b.path))
    });
    Ok(lines)
}

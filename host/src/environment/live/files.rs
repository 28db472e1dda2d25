//! Photographs as files: which there are, and whether they still grow.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use glam::DQuat;

use crate::Result;
use crate::camera::folder::list;
use crate::environment::shots::Frame;

/// A file that cannot be read and has not grown for so long is no photograph, or a table with a fault.
const BROKEN: Duration = Duration::from_secs(3);

/// Sizes of files and when they were written, when they were last looked at, and since when.
#[derive(Default)]
pub(super) struct Sizes(BTreeMap<PathBuf, ((u64, Option<SystemTime>), Instant)>);

impl Sizes {
    /// Whether a file is there and has not grown, nor been written, since it was last looked at.
    pub fn is_whole(&mut self, path: &Path) -> bool {
        let Ok(now) = fs::metadata(path).map(|data| (data.len(), data.modified().ok())) else { return false };
        let before = self.0.get(path).map(|(before, _)| *before);
        if before != Some(now) {
            self.0.insert(path.into(), (now, Instant::now()));
        }
        before == Some(now)
    }

    /// Whether a file was ever looked at.
    pub fn was_there(&self, path: &Path) -> bool {
        self.0.contains_key(path)
    }

    /// Whether a file of at least so many bytes has not grown for long.
    pub fn has_stayed(&self, path: &Path, bytes: u64) -> bool {
        self.0.get(path).is_some_and(|((size, _), since)| *size >= bytes && since.elapsed() > BROKEN)
    }
}

/// A photograph as the table, or the folder, has it.
pub(super) struct Line {
    pub path: PathBuf,
    pub turn: Option<DQuat>,
    pub sigma_rad: Option<f64>,
    pub time_s: Option<f64>,
}

impl Line {
    /// Of a table, whose turns count, or, with a tracker, its times.
    pub fn of(path: PathBuf, frame: &Frame, is_tracked: bool) -> Self {
        Self {
            path,
            turn: frame.orientation().filter(|_| !is_tracked),
            sigma_rad: frame.sigma_deg.map(f64::to_radians),
            time_s: frame.time_s.filter(|time_s| is_tracked && time_s.is_finite()),
        }
    }
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

//! The tracker's records of a capture, beside the session's journal.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::rig::Records;
use crate::tracker::TrackerRecord;
use crate::{Error, Result};

/// The file in the session's folder: a [`Line`] of JSON for every record.
pub const TRACKER_FILE: &str = "tracker.jsonl";

/// How long the end may be waited for.
const LOOK: Duration = Duration::from_millis(100);

/// A record as it stands in the file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// When its first byte came, by the host's clock, seconds since 1970.
    pub at_s: f64,
    /// By how much `at_s` can be wrong at most, seconds.
    pub bound_s: f64,
    /// Counts the records since the tracker was started: a gap was lost on the way.
    pub count: u32,
    /// The receiver: 1 or 2.
    pub station: u8,
    /// The tracker's status character.
    pub status: u8,
    /// Where the receiver is, world axes, metres.
    pub position_m: [f64; 3],
    /// How it is turned: w, x, y, z, world axes.
    pub orientation: [f64; 4],
}

impl From<TrackerRecord> for Line {
    fn from(record: TrackerRecord) -> Self {
        let q = record.orientation;
        Self {
            at_s: record.at.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64(),
            bound_s: record.bound_s,
            count: record.count,
            station: record.station,
            status: record.status,
            position_m: record.position_m.to_array(),
            orientation: [q.w, q.x, q.y, q.z],
        }
    }
}

/// Writes records as they come, in a thread of its own.
pub struct TrackerLog {
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<u64>>>,
}

impl TrackerLog {
    /// Appends to [`TRACKER_FILE`] in this folder; a line that was cut when an earlier capture died is taken away first.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn start(records: Records, folder: &Path) -> Result<Self> {
        let path = folder.join(TRACKER_FILE);
        let file = whole_lines(&path).map_err(Error::io("write", &path))?;
        let ended = Arc::new(AtomicBool::new(false));
        let thread = {
            let ended = ended.clone();
            std::thread::spawn(move || {
                let written = write(|time| records.next(time), file, &path, &ended);
                // Also where the disk is full: nobody hears it any more.
                records.switch_off();
                written
            })
        };
        Ok(Self { ended, thread: Some(thread) })
    }

    /// Tells whether records are still written: a thread that has ended by itself has failed.
    ///
    /// # Errors
    /// [`Error::Io`], once, when a record could not be written.
    pub fn check(&mut self) -> Result<()> {
        match self.thread.take_if(|thread| thread.is_finished()) {
            Some(thread) => thread.join().unwrap_or(Ok(0)).map(|_| ()),
            None => Ok(()),
        }
    }

    /// Ends when all that has come is written and on the disk; tells how many records were written.
    ///
    /// # Errors
    /// [`Error::Io`] when one could not be written; what came after it is not there.
    pub fn finish(mut self) -> Result<u64> {
        self.ended.store(true, Ordering::Relaxed);
        // A thread that has panicked has told so itself.
        self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or(Ok(0))
    }
}

impl Drop for TrackerLog {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
    }
}

/// Writes records until it has ended and no more come; tells how many.
fn write(
    mut next: impl FnMut(Duration) -> Option<TrackerRecord>,
    mut file: File,
    path: &Path,
    ended: &AtomicBool,
) -> Result<u64> {
    let mut count = 0;
    loop {
        // Looked at first: what came before the end was told is still written.
        let last = ended.load(Ordering::Relaxed);
        let Some(record) = next(if last { Duration::ZERO } else { LOOK }) else {
            if last {
                break;
            }
            continue;
        };
        let mut line = serde_json::to_vec(&Line::from(record)).unwrap_or_default();
        line.push(b'\n');
        file.write_all(&line).map_err(Error::io("write", path))?;
        count += 1;
    }
    file.sync_data().map_err(Error::io("write", path))?;
    Ok(count)
}

/// Opens a file of lines for appending, without the end that is no line.
fn whole_lines(path: &Path) -> std::io::Result<File> {
    let mut file = OpenOptions::new().read(true).append(true).create(true).open(path)?;
    let mut text = Vec::new();
    file.read_to_end(&mut text)?;
    let whole = text.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
    file.set_len(whole as u64)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use std::time::Instant;

    fn record(count: u32) -> TrackerRecord {
        let (position_m, orientation) = (DVec3::ZERO, DQuat::IDENTITY);
        TrackerRecord {
            at: UNIX_EPOCH,
            bound_s: 0.0,
            count,
            station: 1,
            status: b' ',
            position_m,
            orientation,
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_ends_the_log_and_is_told_once() {
        let ended = Arc::new(AtomicBool::new(false));
        let thread = {
            let ended = ended.clone();
            std::thread::spawn(move || {
                let full = OpenOptions::new().write(true).open("/dev/full").unwrap();
                let mut count = 0;
                let next = |_| {
                    count += 1;
                    Some(record(count))
                };
                write(next, full, Path::new("tracker.jsonl"), &ended)
            })
        };
        let mut log = TrackerLog { ended, thread: Some(thread) };
        let start = Instant::now();
        let error = loop {
            if let Err(error) = log.check() {
                break error.to_string();
            }
            assert!(start.elapsed() < Duration::from_secs(10), "it never says so");
            std::thread::yield_now();
        };
        assert!(error.contains("tracker.jsonl") && error.contains("free some space"), "{error}");
        assert!(log.check().is_ok());
        assert_eq!(log.finish().unwrap(), 0);
    }

    #[test]
    fn what_came_before_the_end_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(TRACKER_FILE);
        let mut left = vec![record(2), record(1), record(0)];
        let ended = AtomicBool::new(true);
        assert_eq!(write(|_| left.pop(), whole_lines(&path).unwrap(), &path, &ended).unwrap(), 3);
        assert_eq!(std::fs::read_to_string(&path).unwrap().lines().count(), 3);
    }

    #[test]
    fn a_torn_line_is_taken_away_and_whole_ones_stay() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(TRACKER_FILE);
        for (before, after) in [("", "c\n"), ("a\nb\n", "a\nb\nc\n"), ("a\nb", "a\nc\n"), ("b", "c\n")] {
            std::fs::write(&path, before).unwrap();
            whole_lines(&path).unwrap().write_all(b"c\n").unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), after);
        }
    }
}

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
        let mut file = whole_lines(&path).map_err(Error::io("write", &path))?;
        let ended = Arc::new(AtomicBool::new(false));
        let thread = {
            let ended = ended.clone();
            std::thread::spawn(move || {
                let mut count = 0;
                loop {
                    // Looked at first: what came before the end was told is still written.
                    let last = ended.load(Ordering::Relaxed);
                    let record = records.next(if last { Duration::ZERO } else { LOOK });
                    let Some(record) = record else {
                        if last {
                            break;
                        }
                        continue;
                    };
                    let mut line = serde_json::to_vec(&Line::from(record)).unwrap_or_default();
                    line.push(b'\n');
                    file.write_all(&line).map_err(Error::io("write", &path))?;
                    count += 1;
                }
                records.switch_off();
                file.sync_data().map_err(Error::io("write", &path))?;
                Ok(count)
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

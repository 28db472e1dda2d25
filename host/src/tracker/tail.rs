//! A tracker's records while they are written: the end of a growing `tracker.jsonl`.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use glam::DQuat;

use super::records::lines;
use crate::{Error, Result};

/// Where the records of a file that grows were last read to.
#[derive(Debug, Clone)]
pub struct Tail {
    path: PathBuf,
    receiver: Option<u8>,
    /// The receiver that was heard, where none was named: there must be no other.
    heard: Option<u8>,
    /// Bytes and lines that were read.
    read: u64,
    lines: usize,
    last_s: f64,
}

impl Tail {
    /// Of a file as a capture writes it, which need not be there yet; of one receiver, else of the only one.
    pub fn new(path: &Path, receiver: Option<u8>) -> Self {
        Self { path: path.into(), receiver, heard: None, read: 0, lines: 0, last_s: f64::NEG_INFINITY }
    }

    /// What was added since it was last asked: seconds on the host's clock, and how the receiver was turned. A line that is not whole yet is left for
    /// the next time.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] that names the line: no record, earlier than the one before, or of a second receiver.
    pub fn take(&mut self) -> Result<Vec<(f64, DQuat)>> {
        let mut file = match File::open(&self.path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(vec![]),
            opened => opened.map_err(Error::io("read", &self.path))?,
        };
        let mut bytes = vec![];
        let read = file.seek(SeekFrom::Start(self.read)).and_then(|_| file.read_to_end(&mut bytes));
        read.map_err(Error::io("read", &self.path))?;
        let Some(end) = bytes.iter().rposition(|&byte| byte == b'\n') else { return Ok(vec![]) };
        bytes.truncate(end + 1);
        let wrong = |line: usize, what: String| {
            let remedy = "give the tracker.jsonl of a capture, which grows in the order of time";
            Error::input(&self.path, format!("line {line} {what}"), remedy)
        };
        let text = String::from_utf8(bytes).map_err(|_| wrong(self.lines + 1, "is no text".into()))?;
        let records = lines(&text).map_err(|(line, what)| wrong(self.lines + line, what))?;
        let mut taken = vec![];
        let mut last_s = self.last_s;
        let mut heard = self.heard;
        for record in records {
            if self.receiver.is_some_and(|receiver| receiver != record.station) {
                continue;
            }
            if *heard.get_or_insert(record.station) != record.station {
                let what = "is of a second receiver: say with --receiver 1 or 2 which is the camera's";
                return Err(wrong(self.lines + record.line, what.into()));
            }
            if record.time_s < last_s {
                let what = format!("is {:.4} s earlier than the record before", last_s - record.time_s);
                return Err(wrong(self.lines + record.line, what));
            }
            last_s = record.time_s;
            taken.push((record.time_s, record.turn));
        }
        (self.last_s, self.heard) = (last_s, heard);
        self.read += text.len() as u64;
        self.lines += text.lines().count();
        Ok(taken)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn line(k: usize, station: u8) -> String {
        format!(
            r#"{{"at_s":{},"bound_s":0.001,"count":{k},"station":{station},"status":32,"position_m":[0,0,0],"orientation":[1,0,0,0]}}"#,
            k as f64 / 60.0
        )
    }

    #[test]
    fn records_come_once_and_whole_whenever_it_is_asked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tracker.jsonl");
        let mut tail = Tail::new(&path, None);
        assert!(tail.take().unwrap().is_empty());
        let text: String = (0..50).map(|k| line(k, 1) + "\n").collect();
        let mut file = File::create(&path).unwrap();
        let mut times = vec![];
        for piece in text.as_bytes().chunks(37) {
            file.write_all(piece).unwrap();
            times.extend(tail.take().unwrap().into_iter().map(|(time_s, _)| time_s));
        }
        assert_eq!(times, (0..50).map(|k| k as f64 / 60.0).collect::<Vec<_>>());
        // Who names a receiver may have two.
        std::fs::write(&path, format!("{text}{}\n", line(60, 2))).unwrap();
        assert_eq!(Tail::new(&path, Some(2)).take().unwrap().len(), 1);
        for (wrong, word) in
            [(line(20, 1), "line 51"), (line(60, 2), "second receiver"), ("{".into(), "line 51")]
        {
            let mut tail = tail.clone();
            std::fs::write(&path, format!("{text}{wrong}\n")).unwrap();
            let message = tail.take().unwrap_err().to_string();
            assert!(message.contains(word) && message.contains("; "), "{message}");
        }
    }
}

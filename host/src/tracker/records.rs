//! A tracker's records from a file: as `capture --tracker` writes them, or a table of times and quaternions.

use std::path::Path;

use glam::DQuat;
use serde::Deserialize;

use super::Track;
use crate::{Error, Result};

/// What is read of a line that a capture wrote.
#[derive(Deserialize)]
struct Line {
    at_s: f64,
    station: u8,
    orientation: [f64; 4],
}

#[derive(Deserialize)]
struct Row {
    time_s: f64,
    qw: f64,
    qx: f64,
    qy: f64,
    qz: f64,
}

const COLUMNS: &str = "give the columns time_s,qw,qx,qy,qz, or the tracker.jsonl of a capture";

impl Track {
    /// Reads a `tracker.jsonl` as captures write it, or a table (`.csv`) with the columns `time_s,qw,qx,qy,qz`: seconds on the clock of the
    /// photographs, and the quaternion that takes the receiver's axes (x right, y up, looking along -z) to those of the world (y up).
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] that names the line: no record, no unit quaternion, earlier than the line before; or records of two
    /// receivers where `receiver` does not say which is the camera's; or what [`Track::new`] refuses.
    pub fn read(path: &Path, receiver: Option<u8>) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        let is_table = path.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("csv"));
        let all = if is_table { table(&text) } else { lines(&text) };
        let all = all.map_err(|(line, what)| Error::input(path, format!("line {line} {what}"), COLUMNS))?;
        let mut heard: Vec<u8> = all.iter().map(|record| record.station).collect();
        heard.sort_unstable();
        heard.dedup();
        let receiver = match (receiver, heard.as_slice()) {
            (Some(receiver), heard) if heard.contains(&receiver) => receiver,
            (Some(receiver), _) => {
                let what = format!("holds no record of receiver {receiver}");
                return Err(Error::input(
                    path,
                    what,
                    "give --receiver as it was plugged in, or leave it out",
                ));
            }
            (None, [only]) => *only,
            (None, []) => return Err(Error::input(path, "holds no record", COLUMNS)),
            (None, _) => {
                let what = "holds records of two receivers";
                return Err(Error::input(path, what, "say with --receiver 1 or 2 which is the camera's"));
            }
        };
        let own: Vec<Record> = all.into_iter().filter(|record| record.station == receiver).collect();
        if let Some(pair) = own.windows(2).find(|pair| pair[1].time_s < pair[0].time_s) {
            let what = format!(
                "line {} is of {:.4} s, {:.4} s earlier than the record before",
                pair[1].line,
                pair[1].time_s,
                pair[0].time_s - pair[1].time_s
            );
            return Err(Error::input(path, what, "give records whose time never runs backwards"));
        }
        let records: Vec<(f64, DQuat)> = own.iter().map(|record| (record.time_s, record.turn)).collect();
        Self::new(&records).map_err(|error| error.about(path))
    }
}

pub(super) struct Record {
    pub line: usize,
    pub time_s: f64,
    pub station: u8,
    pub turn: DQuat,
}

/// A line's number and what is wrong with it.
pub(super) type Wrong = (usize, String);

fn record(
    line: usize,
    time_s: f64,
    station: u8,
    [w, x, y, z]: [f64; 4],
) -> std::result::Result<Record, Wrong> {
    let turn = DQuat::from_xyzw(x, y, z, w);
    let length = turn.length();
    if !(length.is_finite() && (length - 1.0).abs() < 0.01) {
        return Err((line, format!("has the quaternion {w}, {x}, {y}, {z}, which is none of a rotation")));
    }
    if !time_s.is_finite() {
        return Err((line, format!("has the time {time_s}")));
    }
    Ok(Record { line, time_s, station, turn: turn.normalize() })
}

/// The records of the lines that a capture wrote.
pub(super) fn lines(text: &str) -> std::result::Result<Vec<Record>, Wrong> {
    let all = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    all.map(|(i, line)| {
        let line: Line =
            serde_json::from_str(line).map_err(|error| (i + 1, format!("is no record ({error})")))?;
        record(i + 1, line.at_s, line.station, line.orientation)
    })
    .collect()
}

fn table(text: &str) -> std::result::Result<Vec<Record>, Wrong> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().cloned().map_err(|error| (1, format!("is no header ({error})")))?;
    let mut all = vec![];
    for row in reader.records() {
        let line_of = |position: Option<&csv::Position>| position.map_or(1, |at| at.line() as usize);
        let row = row.map_err(|error| (line_of(error.position()), format!("is no record ({error})")))?;
        let line = line_of(row.position());
        let Row { time_s, qw, qx, qy, qz } =
            row.deserialize(Some(&header)).map_err(|error| (line, format!("is no record ({error})")))?;
        all.push(record(line, time_s, 1, [qw, qx, qy, qz])?);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_and_a_capture_say_the_same_and_what_is_wrong_is_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, lines: &[String]| {
            let path = folder.path().join(name);
            std::fs::write(&path, lines.join("\n")).unwrap();
            path
        };
        let turn = |k: usize| DQuat::from_rotation_y(0.01 * k as f64 + 0.001 * (k % 3) as f64);
        let row = |k: usize| {
            let q = turn(k);
            format!("{},{},{},{},{}", k as f64 / 60.0, q.w, q.x, q.y, q.z)
        };
        let json = |k: usize, station: u8| {
            let q = turn(k);
            format!(
                r#"{{"at_s":{},"bound_s":0.001,"count":{k},"station":{station},"status":32,"position_m":[0,0,0],"orientation":[{},{},{},{}]}}"#,
                k as f64 / 60.0,
                q.w,
                q.x,
                q.y,
                q.z
            )
        };
        let header = || std::iter::once("time_s,qw,qx,qy,qz".to_owned());
        let rows: Vec<String> = header().chain((0..60).map(row)).collect();
        let lines: Vec<String> = (0..60).map(|k| json(k, 1)).collect();
        let table = Track::read(&write("tracker.csv", &rows), None).unwrap();
        let captured = Track::read(&write("tracker.jsonl", &lines), None).unwrap();
        assert_eq!(table, captured);
        assert!(table.at(0.5).orientation.angle_between(turn(30)) < 0.01);

        let refused = |name: &str, lines: &[String], receiver: Option<u8>, word: &str| {
            let message = Track::read(&write(name, lines), receiver).unwrap_err().to_string();
            assert!(message.contains(word) && message.contains(name) && message.contains("; "), "{message}");
        };
        let mut backwards = rows.clone();
        backwards.swap(20, 40);
        refused("a.csv", &backwards, None, "line 22");
        let mut none = rows.clone();
        none[5] = "0.1,0,0,0,0".into();
        refused("b.csv", &none, None, "line 6");
        none[5] = "0.1,1,0".into();
        refused("c.csv", &none, None, "line 6");
        refused("d.csv", &rows[..1], None, "no record");
        refused("e.csv", &["a,b".into(), "1,2".into()], None, "time_s");
        let two: Vec<String> = (0..60).map(|k| json(k, 1 + (k % 2) as u8)).collect();
        refused("f.jsonl", &two, None, "--receiver");
        refused("g.jsonl", &lines, Some(2), "receiver 2");
        assert_eq!(Track::read(&write("h.jsonl", &two), Some(2)).unwrap().records, 30);
        let mut cut = lines.clone();
        cut[59].truncate(40);
        refused("i.jsonl", &cut, None, "line 60");
    }
}

//! The table of photographs: somebody else's while it is written, or one's own at the end.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use glam::DQuat;

use super::views::SUREST_RAD;
use crate::camera::exif::{self, Exif};
use crate::environment::shots::{Frame, TABLES, read_frames};
use crate::geometry::{Lens, world_from_camera};
use crate::{Error, Result, file};

/// One's own where somebody else's `frames.csv` lists nothing.
const SECOND: &str = "frames-live.csv";
/// The last column of one's own table, and what each of its lines has there.
const OWN: [&str; 2] = ["by", "rigel"];

/// A photograph that has its place: camera frame to the world, how surely, radians, and when it was taken.
pub(super) struct Row {
    pub path: PathBuf,
    pub turn: DQuat,
    pub sigma_rad: f64,
    pub time_s: Option<f64>,
}

/// Somebody else's tables in a folder.
fn tables(folder: &Path) -> impl Iterator<Item = PathBuf> {
    TABLES.iter().map(|name| folder.join(name)).filter(|table| table.exists() && !is_own(table))
}

/// Somebody else's table in a folder, where there is one.
pub(super) fn table_in(folder: &Path) -> Option<PathBuf> {
    tables(folder).next()
}

/// Somebody else's table in a folder, once it lists a photograph.
pub(super) fn begun(folder: &Path) -> Option<PathBuf> {
    tables(folder).find(|table| ended(table).is_ok_and(|ended| !ended.frames.is_empty()))
}

/// Whether an earlier [`write`] made a table, and nobody has added a line of another kind.
fn is_own(table: &Path) -> bool {
    let Ok(mut csv) = csv::Reader::from_path(table) else { return false };
    let is_marked = csv.headers().is_ok_and(|head| head.iter().next_back() == Some(OWN[0]));
    let has_mark =
        |line: csv::Result<csv::StringRecord>| line.is_ok_and(|line| line.iter().next_back() == Some(OWN[1]));
    is_marked && csv.into_records().all(has_mark)
}

/// The ended lines of a table.
pub(super) struct Ended {
    /// Each photograph once.
    pub frames: Vec<Frame>,
    pub lens: Option<Lens>,
    /// What is wrong with it as a whole.
    pub wrong: Option<String>,
}

/// Reads the ended lines of a table.
pub(super) fn ended(table: &Path) -> Result<Ended> {
    let text = fs::read_to_string(table).map_err(Error::io("read", table))?;
    let has_lines = table.extension().is_some_and(|kind| kind == "csv");
    let end = if has_lines { text.rfind('\n').map_or(0, |at| at + 1) } else { text.len() };
    let (mut frames, lens) = read_frames(table, &text[..end])?;
    let (mut files, mut wrong) = (BTreeSet::new(), vec![]);
    if frames.is_empty() {
        wrong.push("lists no photograph yet".to_owned());
    }
    frames.retain(|frame| {
        let is_first = files.insert(frame.file.clone());
        if !is_first {
            wrong.push(format!("lists {} twice: its first line counts", frame.file.display()));
        }
        is_first
    });
    if end < text.len() {
        wrong.push("what follows its last line break is left out, as it may be half written".into());
    }
    Ok(Ended { frames, lens, wrong: (!wrong.is_empty()).then(|| wrong.join("; ")) })
}

/// Of each line of a table what is wrong with it, beside those before it; `is_tracked` by times, `has_records` where turns do not count.
pub(super) fn faults<'a>(
    frames: &'a [Frame],
    is_tracked: bool,
    has_records: bool,
    table: &Path,
) -> Vec<Option<String>> {
    let table = name(table);
    let mut last: Option<(f64, &'a Path)> = None;
    let mut fault = |frame: &'a Frame| {
        if let Some(fault) = frame.fault() {
            return Some(format!("{table} has for it {fault}: give a positive number, or leave it out"));
        }
        if !is_tracked {
            return None;
        }
        if !has_records && frame.orientation().is_some() {
            return Some(format!("{table} says how it was turned, of those before only when"));
        }
        let time_s = frame.time_s.filter(|time_s| time_s.is_finite())?;
        if let Some((last_s, before)) = last.filter(|(last_s, _)| *last_s > time_s) {
            let (by_s, before) = (last_s - time_s, before.display());
            return Some(format!(
                "{table} has it at {time_s:.4} s, {by_s:.4} s earlier than {before} before it"
            ));
        }
        last = Some((time_s, &frame.file));
        None
    };
    frames.iter().map(&mut fault).collect()
}

/// Writes `frames.csv` in the order of time, with times on the tracker's clock or with turns, and the exposures that all photographs state;
/// `frames-live.csv` where somebody else's is there. One's own of an earlier session is replaced.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn write(folder: &Path, rows: &mut [Row], is_timed: bool) -> Result<PathBuf> {
    rows.sort_by(|a, b| {
        a.time_s.unwrap_or(0.0).total_cmp(&b.time_s.unwrap_or(0.0)).then_with(|| a.path.cmp(&b.path))
    });
    let path = folder.join(TABLES[1]);
    let failed = |error: csv::Error| Error::io("write", &path)(error.into());
    let head: &[&str] =
        if is_timed { &["file", "time_s"] } else { &["file", "qw", "qx", "qy", "qz", "sigma_deg"] };
    let stated = exposures(rows)?;
    let mut csv = csv::Writer::from_writer(vec![]);
    let words = stated.iter().map(|(word, _)| *word);
    csv.write_record(head.iter().copied().chain(words).chain([OWN[0]])).map_err(failed)?;
    for (i, Row { path, turn, sigma_rad, time_s }) in rows.iter().enumerate() {
        let mut line = vec![name(path)];
        match time_s.filter(|_| is_timed) {
            Some(time_s) => line.push(format!("{time_s:.6}")),
            None => {
                let q = *turn * world_from_camera(DQuat::IDENTITY).inverse();
                line.extend([q.w, q.x, q.y, q.z].map(|part| format!("{part:.9}")));
                line.push(format!("{:.3}", sigma_rad.max(SUREST_RAD).to_degrees()));
            }
        }
        line.extend(stated.iter().map(|(_, numbers)| numbers[i].to_string()));
        line.push(OWN[1].into());
        csv.write_record(line).map_err(failed)?;
    }
    let csv = csv.into_inner().map_err(|error| Error::io("write", &path)(error.into_error()))?;
    if is_own(&path) {
        return file::write_bytes(&path, &csv).map(|()| path);
    }
    match file::write_new(&path, &csv) {
        Err(Error::Io { source, .. }) if source.kind() == ErrorKind::AlreadyExists => {
            let path = folder.join(SECOND);
            file::write_bytes(&path, &csv).map(|()| path)
        }
        written => written.map(|()| path),
    }
}

/// What all photographs state of their exposure in their EXIF blocks, by the table's columns: what only some state would be guessed of the others.
fn exposures(rows: &[Row]) -> Result<Vec<(&'static str, Vec<f64>)>> {
    let told = rows.iter().map(|row| exif::read(&row.path)).collect::<Result<Vec<_>>>()?;
    let column = |of: fn(&Exif) -> Option<f64>| {
        let numbers = told.iter().map(of).map(|number| number.filter(|n| n.is_finite() && *n > 0.0));
        numbers.collect::<Option<Vec<f64>>>()
    };
    let Some(exposures_s) = column(|told| told.exposure_s) else { return Ok(vec![]) };
    let more = [("iso", column(|told| told.iso)), ("f_number", column(|told| told.f_number))];
    let more = more.into_iter().filter_map(|(word, numbers)| Some((word, numbers?)));
    Ok([("exposure_s", exposures_s)].into_iter().chain(more).collect())
}

/// A line for each reason why photographs were left out, and for what is wrong with a table.
pub(super) fn notes(left: BTreeMap<PathBuf, String>) -> Vec<String> {
    let mut notes: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (path, why) in left {
        notes.entry(words(&path, &why)).or_default().push(name(&path));
    }
    notes.into_iter().map(|(why, names)| format!("{}: {why}", names.join(", "))).collect()
}

/// What is wrong with a table, or why a photograph is left out.
pub(super) fn words(path: &Path, why: &str) -> String {
    if TABLES.contains(&name(path).as_str()) { why.into() } else { format!("left out: {why}") }
}

/// A file's name, for messages.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

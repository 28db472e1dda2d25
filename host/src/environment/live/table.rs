//! The table of photographs: somebody else's while it is written, or one's own at the end.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use glam::DQuat;

use super::ended::ended;
use super::views::SUREST_RAD;
use crate::camera::exif::{self, Exif};
use crate::environment::shots::TABLES;
use crate::geometry::{Lens, world_from_camera};
use crate::{Error, Result, file};

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

/// The lens that a `frames.json` beside photographs says.
pub(super) fn lens_beside(folder: &Path) -> Option<Lens> {
    ended(&folder.join(TABLES[0])).ok()?.lens
}

/// Whether an earlier [`write`] made a table, and nobody has added a line of another kind.
fn is_own(table: &Path) -> bool {
    let Ok(mut csv) = csv::Reader::from_path(table) else { return false };
    let is_marked = csv.headers().is_ok_and(|head| head.iter().next_back() == Some(OWN[0]));
    let has_mark =
        |line: csv::Result<csv::StringRecord>| line.is_ok_and(|line| line.iter().next_back() == Some(OWN[1]));
    is_marked && csv.into_records().all(has_mark)
}

/// Writes `frames.csv` in the order of time, with times on the tracker's clock or with turns, and the exposures that all photographs state;
/// `frames-live.csv` (or with a number) where somebody else's is there. One's own of an earlier session is replaced.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn write(folder: &Path, rows: &mut [Row], is_timed: bool) -> Result<PathBuf> {
    rows.sort_by(|a, b| {
        a.time_s.unwrap_or(0.0).total_cmp(&b.time_s.unwrap_or(0.0)).then_with(|| a.path.cmp(&b.path))
    });
    let mut path = folder.join(TABLES[1]);
    let failed = |error: csv::Error| Error::io("write", folder)(error.into());
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
    let csv = csv.into_inner().map_err(|error| Error::io("write", folder)(error.into_error()))?;
    let mut tried = 1;
    loop {
        if is_own(&path) {
            return file::write_bytes(&path, &csv).map(|()| path);
        }
        match file::write_new(&path, &csv) {
            Err(Error::Io { source, .. }) if source.kind() == ErrorKind::AlreadyExists => {
                let number = if tried > 1 { format!("-{tried}") } else { String::new() };
                path = folder.join(format!("frames-live{number}.csv"));
                tried += 1;
            }
            written => return written.map(|()| path),
        }
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

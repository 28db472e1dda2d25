//! The table of photographs: somebody else's while it is written, or one's own at the end.

use std::collections::BTreeSet;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use glam::DQuat;

use super::views::SUREST_RAD;
use crate::environment::shots::{Frame, TABLES, read_frames};
use crate::geometry::{Lens, world_from_camera};
use crate::{Error, Result, file};

/// One's own where somebody else's `frames.csv` lists nothing.
const SECOND: &str = "frames-live.csv";

/// A photograph that has its place: camera frame to the world, how surely, radians, and when it was taken.
pub(super) struct Row {
    pub path: PathBuf,
    pub turn: DQuat,
    pub sigma_rad: f64,
    pub time_s: Option<f64>,
}

/// The table of a folder, where there is one.
pub(super) fn table_in(folder: &Path) -> Option<PathBuf> {
    TABLES.iter().map(|name| folder.join(name)).find(|table| table.exists())
}

/// The table of a folder, once it lists a photograph.
pub(super) fn begun(folder: &Path) -> Option<PathBuf> {
    let mut tables = TABLES.iter().map(|name| folder.join(name));
    tables.find(|table| ended(table).is_ok_and(|ended| !ended.frames.is_empty()))
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

/// Writes `frames.csv` in the order of time, with times on the tracker's clock or with turns; `frames-live.csv` where somebody else's is there.
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
    let mut csv = csv::Writer::from_writer(vec![]);
    csv.write_record(head).map_err(failed)?;
    for Row { path, turn, sigma_rad, time_s } in rows.iter() {
        let name = name(path);
        let written = match time_s.filter(|_| is_timed) {
            Some(time_s) => csv.write_record([name, format!("{time_s:.6}")]),
            None => {
                let q = *turn * world_from_camera(DQuat::IDENTITY).inverse();
                let [w, x, y, z] = [q.w, q.x, q.y, q.z].map(|part| format!("{part:.9}"));
                let sigma_deg = sigma_rad.max(SUREST_RAD).to_degrees();
                csv.write_record([name, w, x, y, z, format!("{sigma_deg:.3}")])
            }
        };
        written.map_err(failed)?;
    }
    let csv = csv.into_inner().map_err(|error| Error::io("write", &path)(error.into_error()))?;
    match file::write_new(&path, &csv) {
        Err(Error::Io { source, .. }) if source.kind() == ErrorKind::AlreadyExists => {
            let path = folder.join(SECOND);
            file::write_bytes(&path, &csv).map(|()| path)
        }
        written => written.map(|()| path),
    }
}

/// What is wrong with a table, or why a photograph is left out.
pub(super) fn words(path: &Path, why: &str) -> String {
    if TABLES.contains(&name(path).as_str()) { why.into() } else { format!("left out: {why}") }
}

/// A file's name, for messages.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

//! The table of photographs: somebody else's while it is written, or one's own at the end.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use glam::DQuat;

use super::views::SUREST_RAD;
use crate::environment::shots::{TABLES, Table, read_frames};
use crate::geometry::world_from_camera;
use crate::{Error, Result, file};

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

/// The ended lines of a table with its lens, and whether another one is begun.
pub(super) fn ended(table: &Path) -> Result<(Table, bool)> {
    let text = fs::read_to_string(table).map_err(Error::io("read", table))?;
    let has_lines = table.extension().is_some_and(|kind| kind == "csv");
    let end = if has_lines { text.rfind('\n').map_or(0, |at| at + 1) } else { text.len() };
    Ok((read_frames(table, &text[..end])?, end < text.len()))
}

/// Writes `frames.csv` in the order of time, with times on the tracker's clock or with turns.
///
/// # Errors
/// [`Error::Io`], also where somebody else's is there.
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
    // Fails where another program has just put its own there.
    File::create_new(&path).map_err(Error::io("write", &path))?;
    let written = file::write_bytes(&path, &csv).inspect_err(|_| drop(fs::remove_file(&path)));
    written.map(|()| path.clone())
}

/// A file's name, for messages.
pub(super) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

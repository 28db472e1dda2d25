//! From photographs of a board to a lens.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::{BoardView, DroppedBoard, LensCalibration, LensModel, calibrate_lens};
use crate::calibration::chessboard::{BoardCorner, BoardSize, Sighting, find_board};
use crate::camera::exif::{self, OneFocalLength};
use crate::picture::Picture;
use crate::progress::Progress;
use crate::{Error, Result};

/// A part of a board counts when it has at least this share of the corners.
const LEAST_PART: f64 = 0.25;

/// What one photograph gave.
struct Seen {
    size: (u32, u32),
    focal_length_mm: Option<f64>,
    sighting: Sighting,
    /// Why there may be no board.
    light: &'static str,
}

/// Finds the board in every photograph and calibrates the lens ([`calibrate_lens`]); photographs in which it cannot be used are
/// named in [`LensCalibration::dropped`].
///
/// # Errors
/// [`Error::Input`] when a photograph cannot be read, differs from the others in size or focal length (by EXIF), or the
/// boards are of another size than `board` or do not tell the lens; [`Error::Interrupted`].
pub fn calibrate_photographs(
    paths: &[PathBuf],
    board: BoardSize,
    square_m: f64,
    model: Option<LensModel>,
    progress: &dyn Progress,
) -> Result<LensCalibration> {
    let Some(first) = paths.first() else {
        return Err(Error::request(
            "there is no photograph to calibrate with",
            "give photographs of a chessboard",
        ));
    };
    let done = AtomicUsize::new(0);
    let seen: Vec<Seen> = paths
        .par_iter()
        .map(|path| {
            let seen = look(path, board)?;
            progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, paths.len())?;
            Ok(seen)
        })
        .collect::<Result<_>>()?;
    let mut focal = OneFocalLength::default();
    for (path, one) in paths.iter().zip(&seen) {
        agree(path, one, first, &seen[0])?;
        focal.admit(path, one.focal_length_mm)?;
    }
    let whole = seen.iter().filter(|one| matches!(one.sighting, Sighting::Whole(_))).count();
    let others = seen.iter().filter(|one| matches!(one.sighting, Sighting::Other(_))).count();
    // A board of another size that is partly hidden passes for a whole one.
    if whole < others || whole == 0 {
        refuse_size(paths, &seen, board)?;
    }
    let (mut views, mut dropped) = (vec![], vec![]);
    for (path, one) in paths.iter().zip(&seen) {
        match usable(one, board) {
            Ok(corners) => views.push(BoardView { path: path.clone(), corners }),
            Err(reason) => dropped.push(DroppedBoard { path: path.clone(), reason }),
        }
    }
    let mut calibration = match (views.is_empty(), dropped.first()) {
        (true, Some(DroppedBoard { path, reason })) => {
            let (what, remedy) = reason.split_once("; ").unwrap_or((reason, "photograph the board again"));
            return Err(Error::input(path, what, remedy));
        }
        _ => calibrate_lens(&views, seen[0].size, square_m, model)?,
    };
    dropped.append(&mut calibration.dropped);
    calibration.dropped = dropped;
    Ok(calibration)
}

fn look(path: &Path, board: BoardSize) -> Result<Seen> {
    let picture = Picture::read(path)?;
    let share = |test: &dyn Fn(u16) -> bool| {
        let count = picture.levels.iter().filter(|level| test(level[1])).count();
        count as f64 / picture.levels.len() as f64
    };
    let (white, dark) = (picture.white, picture.white / 8);
    let light = if share(&|level| level >= white - white / 100) > 0.3 {
        "much of the photograph is clipped; expose it less"
    } else if share(&|level| level < dark) > 0.95 {
        "the photograph is dark; expose it longer"
    } else {
        "it may be blurred, hidden or cut off; photograph it again, sharp and whole"
    };
    let size = (picture.width, picture.height);
    let focal_length_mm = exif::read(path)?.focal_length_mm;
    Ok(Seen { size, focal_length_mm, sighting: find_board(&picture, board), light })
}

/// Photographs of one lens have one size.
fn agree(path: &Path, one: &Seen, first: &Path, other: &Seen) -> Result<()> {
    if one.size == other.size {
        return Ok(());
    }
    let ((a, b), (c, d)) = (one.size, other.size);
    Err(Error::input(
        path,
        format!("has {a}x{b} pixels where {} has {c}x{d}", first.display()),
        "calibrate photographs of one size",
    ))
}

/// So many photographs (or a fifth of them) that show a grid of the same size do not err.
const AGREEING: usize = 3;

/// Where hardly any photograph shows the whole board, most of them may show another one. Its size is the largest that several show:
/// boards that are partly hidden show less of it.
fn refuse_size(paths: &[PathBuf], seen: &[Seen], board: BoardSize) -> Result<()> {
    let found = |one: &Seen| match &one.sighting {
        Sighting::Other(size) => Some(*size),
        Sighting::Part(corners) => Some(extent(corners)),
        _ => None,
    };
    let sizes: Vec<(usize, BoardSize)> =
        seen.iter().enumerate().filter_map(|(i, one)| Some((i, found(one)?))).collect();
    let votes = |size: BoardSize| sizes.iter().filter(|(_, other)| *other == size).count();
    let enough = AGREEING.min(sizes.len().div_ceil(5));
    let largest = sizes.iter().filter(|(_, size)| votes(*size) >= enough);
    let Some(&(at, size)) = largest.max_by_key(|(i, size)| (size.count(), std::cmp::Reverse(*i))) else {
        return Ok(());
    };
    let path = &paths[at];
    let what = format!("found a grid of {size} corners, {board} were asked for");
    if votes(size) >= AGREEING {
        let what = format!("{what}: these boards have {size} corners");
        return Err(Error::input(path, what, format!("give --board {size}, or photograph the whole board")));
    }
    Err(Error::input(path, format!("{what}, and no photograph shows them all"), "photograph the whole board"))
}

/// Columns and rows that a part of a board covers, the longer side first.
fn extent(corners: &[BoardCorner]) -> BoardSize {
    let columns = 1 + corners.iter().map(|corner| corner.column).max().unwrap_or(0);
    let rows = 1 + corners.iter().map(|corner| corner.row).max().unwrap_or(0);
    BoardSize { columns: columns.max(rows), rows: columns.min(rows) }
}

/// The corners of a photograph, or why they cannot be used.
fn usable(one: &Seen, board: BoardSize) -> std::result::Result<Vec<BoardCorner>, String> {
    match &one.sighting {
        Sighting::Whole(corners) => Ok(corners.clone()),
        Sighting::Part(corners) if corners.len() as f64 >= LEAST_PART * board.count() as f64 => {
            Ok(corners.clone())
        }
        Sighting::Part(corners) => {
            Err(format!("only {} of {} corners were found: {}", corners.len(), board.count(), one.light))
        }
        Sighting::Other(size) => Err(format!(
            "found a grid of {size} corners, {board} were asked for; give --board {size}, or photograph one board at a time"
        )),
        Sighting::Nothing => Err(format!("no chessboard was found: {}", one.light)),
    }
}

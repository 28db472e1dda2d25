//! Chessboards in pictures: which corner is where, to a few hundredths of a pixel.
//!
//! Saddle points with alternating surroundings are linked into grids ([`grid`]), at several sizes of the picture until the whole board is
//! seen, and every corner is then fitted by two crossing edges ([`saddle`]).

mod corner;
mod grey;
mod grid;
mod saddle;

use glam::DVec2;

use self::corner::Search;
use self::grey::Grey;
use self::grid::{Grid, Place};
pub use crate::geometry::BoardSize;
use crate::picture::Picture;

/// A corner that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardCorner {
    /// Its column on the board, from 0.
    pub column: u32,
    /// Its row on the board, from 0.
    pub row: u32,
    /// Where it is in the picture; a pixel's centre is an integer.
    pub pixel: DVec2,
    /// Standard deviation of either coordinate as the picture around the corner tells it, pixels; it knows nothing of a
    /// board that is bent. A calibration weighs the corner by it.
    pub sigma_px: f64,
    /// How blurred the picture is there: standard deviation, pixels.
    pub blur_px: f64,
}

/// What was seen of a board in a picture.
///
/// Columns and rows turn as the picture's x and y do. Where the size allows both ways round, the square inside corner
/// (0, 0) is dark; where that does not decide either, and for a part of a board, which does not tell which part it is, the
/// labelling is one of several that are consistent. For a calibration they are all the same: a board that is shifted or
/// turned in its plane, or mirrored (it is then seen from behind), only has another pose.
#[derive(Debug, Clone, PartialEq)]
pub enum Sighting {
    /// Every corner.
    Whole(Vec<BoardCorner>),
    /// A part: at least three columns and rows.
    Part(Vec<BoardCorner>),
    /// A grid of another size, which the board that was asked for cannot show.
    Other(BoardSize),
    /// No grid.
    Nothing,
}

/// Fewer corners than this are no board: any texture has some.
const LEAST: usize = 9;
/// Narrower pictures show no board.
const NARROWEST_PX: usize = 32;
/// The largest side, pixels, at which corners are first searched for.
const COMFORTABLE_PX: usize = 900;
/// Radius of the fit around a corner: share of the distance to its neighbours, and limits in pixels.
const RADIUS: f64 = 0.42;
const RADIUS_PX: (f64, f64) = (2.6, 9.0);

/// Searches for a board.
pub fn find_board(picture: &Picture, size: BoardSize) -> Sighting {
    if picture.width < NARROWEST_PX as u32 || picture.height < NARROWEST_PX as u32 {
        return Sighting::Nothing;
    }
    let mut levels = vec![Grey::of(picture)];
    let too_large = |grey: &Grey| {
        grey.width.max(grey.height) > COMFORTABLE_PX && grey.width.min(grey.height) >= 2 * NARROWEST_PX
    };
    while levels.last().is_some_and(too_large) {
        levels.extend(levels.last().map(Grey::halved));
    }
    let comfortable = levels.len() - 1;
    // Boards that are blurred or very large are found where the picture is smaller, small ones where it is larger.
    if levels[comfortable].width.min(levels[comfortable].height) >= 128 {
        levels.push(levels[comfortable].halved());
    }
    let mut order = vec![comfortable];
    order.extend((0..levels.len()).rev().filter(|level| *level != comfortable));
    let mut best: Option<Seen> = None;
    for level in order {
        let search = Search::new(&levels[level]);
        let corners = search.corners();
        for grid in grid::grids(&search, &corners, LEAST) {
            let Some(seen) = Seen::new(grid, size, level) else { continue };
            if best.as_ref().is_none_or(|best| seen.better_than(best)) {
                best = Some(seen);
            }
        }
        if best.as_ref().is_some_and(|best| best.whole()) {
            break;
        }
    }
    best.map_or(Sighting::Nothing, |best| best.sighting(&levels[0]))
}

/// A grid and how it lies on the board.
struct Seen {
    grid: Grid,
    level: usize,
    asked: BoardSize,
    columns: (i32, i32),
    rows: (i32, i32),
    fit: Option<Turned>,
}

/// Whether the grid's columns are the board's rows.
#[derive(Clone, Copy, PartialEq)]
enum Turned {
    No,
    Quarter,
}

impl Seen {
    /// `None` for grids that are no board at all.
    fn new(mut grid: Grid, asked: BoardSize, level: usize) -> Option<Self> {
        let fits = |(columns, rows): (u32, u32)| {
            if columns <= asked.columns && rows <= asked.rows {
                Some(Turned::No)
            } else if columns <= asked.rows && rows <= asked.columns {
                Some(Turned::Quarter)
            } else {
                None
            }
        };
        loop {
            let (columns, rows) = bounds(&grid)?;
            let across = ((columns.1 - columns.0 + 1) as u32, (rows.1 - rows.0 + 1) as u32);
            if across.0 < 3 || across.1 < 3 {
                return None;
            }
            let fit = fits(across);
            // Something beside the board that looks like a corner makes a row of its own, which is nearly empty.
            if fit.is_none() && drop_sparse_side(&mut grid, columns, rows) {
                continue;
            }
            return Some(Self { grid, level, asked, columns, rows, fit });
        }
    }

    fn whole(&self) -> bool {
        self.fit.is_some() && self.grid.len() == self.asked.count()
    }

    fn better_than(&self, other: &Self) -> bool {
        (self.whole(), self.worth()) > (other.whole(), other.worth())
    }

    /// A part of the board that was asked for is better than somewhat more of another one.
    fn worth(&self) -> usize {
        self.grid.len() * if self.fit.is_some() { 3 } else { 2 }
    }

    fn sighting(&self, full: &Grey) -> Sighting {
        let (c, r) = (self.columns, self.rows);
        let Some(turned) = self.fit else {
            let (a, b) = ((c.1 - c.0 + 1) as u32, (r.1 - r.0 + 1) as u32);
            return Sighting::Other(BoardSize { columns: a.max(b), rows: a.min(b) });
        };
        // Half a turn more where the square inside the first corner is not dark.
        let ways: [usize; 2] = if turned == Turned::No { [0, 2] } else { [1, 3] };
        let way = ways.into_iter().find(|&way| self.dark_at_origin(way)).unwrap_or(ways[0]);
        let scale = f64::from(1u32 << self.level);
        let mut corners = vec![];
        for (place, cell) in &self.grid {
            let start = (cell.corner.at + 0.5) * scale - 0.5;
            let radius_px = (RADIUS * self.room(*place) * scale).clamp(RADIUS_PX.0, RADIUS_PX.1);
            let edges = [cell.corner.edges[0], cell.corner.edges[1]];
            let found = saddle::refine(full, start, edges, cell.corner.contrast, radius_px);
            if let Some(found) = found {
                let (column, row) = self.label(*place, way);
                let saddle::Saddle { at: pixel, sigma_px, blur_px } = found;
                corners.push(BoardCorner { column, row, pixel, sigma_px, blur_px });
            }
        }
        corners.sort_by_key(|corner| (corner.row, corner.column));
        match corners.len() {
            all if all == self.asked.count() => Sighting::Whole(corners),
            LEAST.. => Sighting::Part(corners),
            _ => Sighting::Nothing,
        }
    }

    /// The column and row of a place when the board is turned by `way` quarters.
    fn label(&self, place: Place, way: usize) -> (u32, u32) {
        let (c, r) = (self.columns, self.rows);
        let (column, row) = match way {
            0 => (place.0 - c.0, place.1 - r.0),
            1 => (place.1 - r.0, c.1 - place.0),
            2 => (c.1 - place.0, r.1 - place.1),
            _ => (r.1 - place.1, place.0 - c.0),
        };
        (column as u32, row as u32)
    }

    /// Whether the square inside the corner that is labelled (0, 0) is dark.
    fn dark_at_origin(&self, way: usize) -> bool {
        // The parity of column, row and the corner's turn is the same all over a grid.
        self.grid.iter().next().is_some_and(|(place, cell)| {
            let (column, row) = self.label(*place, way);
            let quarters = cell.turn + way;
            (column as usize + row as usize + quarters).is_multiple_of(2)
        })
    }

    /// The distance from a corner to the nearest edge of a neighbour, pixels of the grid's level.
    fn room(&self, place: Place) -> f64 {
        let at = |dx: i32, dy: i32| self.grid.get(&(place.0 + dx, place.1 + dy)).map(|cell| cell.corner.at);
        let Some(here) = at(0, 0) else { return 0.0 };
        let edges = self.grid[&place].corner.edges;
        let sine = edges[0].perp_dot(edges[1]).abs();
        let distances = [(1, 0), (0, 1), (-1, 0), (0, -1)].into_iter().filter_map(|(dx, dy)| at(dx, dy));
        distances.map(|other| other.distance(here)).fold(f64::INFINITY, f64::min).min(1e6) * sine
    }
}

/// The first and last column and row; `None` for an empty grid.
fn bounds(grid: &Grid) -> Option<((i32, i32), (i32, i32))> {
    let range = |pick: fn(&Place) -> i32| Some((grid.keys().map(pick).min()?, grid.keys().map(pick).max()?));
    Some((range(|place| place.0)?, range(|place| place.1)?))
}

/// Drops the emptiest of the four outermost columns and rows if it is less than half as full as the one inside it.
fn drop_sparse_side(grid: &mut Grid, columns: (i32, i32), rows: (i32, i32)) -> bool {
    let column = |at: i32| grid.keys().filter(|place| place.0 == at).count();
    let row = |at: i32| grid.keys().filter(|place| place.1 == at).count();
    let sides = [
        (column(columns.0), column(columns.0 + 1), true, columns.0),
        (column(columns.1), column(columns.1 - 1), true, columns.1),
        (row(rows.0), row(rows.0 + 1), false, rows.0),
        (row(rows.1), row(rows.1 - 1), false, rows.1),
    ];
    let emptiest = sides.into_iter().min_by_key(|side| side.0);
    let Some((_, _, is_column, at)) = emptiest.filter(|(here, inside, ..)| 2 * here < *inside) else {
        return false;
    };
    grid.retain(|place, _| if is_column { place.0 != at } else { place.1 != at });
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_strip_shows_no_board_and_is_no_reason_to_panic() {
        for (width, height) in [(32, 4000), (4000, 32), (63, 2000), (65, 7300), (32, 32)] {
            let dark = |i: u32| (i % width / 8 + i / width / 8).is_multiple_of(2);
            let levels = (0..width * height).map(|i| [if dark(i) { 20 } else { 230 }; 3]).collect();
            let picture = Picture { path: "strip.png".into(), width, height, levels, white: 255 };
            let sighting = find_board(&picture, BoardSize { columns: 9, rows: 6 });
            assert!(!matches!(sighting, Sighting::Whole(_)), "{width}x{height}");
        }
    }
}

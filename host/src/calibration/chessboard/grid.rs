//! From corners to a board: neighbours are linked, links grow into a grid, the grid looks for what it lacks.
//!
//! An edge that is dark on its right where it leaves one corner is dark on its left where it leaves the next, and is one of
//! the two edges of both. Neighbours that fit so, with the edge between them seen, are hardly ever wrong.

use std::collections::{HashMap, VecDeque};

use glam::DVec2;

use super::corner::{Corner, Search};

/// How far a neighbour may lie off an edge, and its edge off the line to it: sines.
const ASIDE: f64 = 0.26;
const TURNED: f64 = 0.42;

/// A column and a row, from any origin.
pub(super) type Place = (i32, i32);

const STEPS: [Place; 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// A corner in the grid.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub corner: Corner,
    /// Edge `k` of the corner leads along step `(k + turn) % 4`.
    pub turn: usize,
}

impl Cell {
    /// The edge that leads along a step.
    fn edge(&self, step: usize) -> usize {
        (step + 4 - self.turn) % 4
    }
}

/// Corners by their place.
pub(super) type Grid = HashMap<Place, Cell>;

/// All grids of at least `least` corners, the largest first.
pub(super) fn grids(search: &Search, corners: &[Corner], least: usize) -> Vec<Grid> {
    let links: Vec<[Option<usize>; 4]> =
        (0..corners.len()).map(|i| std::array::from_fn(|edge| neighbour(search, corners, i, edge))).collect();
    let mutual = |i: usize, edge: usize| {
        let other = links[i][edge]?;
        let back = (0..4).find(|&back| links[other][back] == Some(i))?;
        Some((other, back))
    };
    let mut taken = vec![false; corners.len()];
    let mut found = vec![];
    for seed in 0..corners.len() {
        if taken[seed] {
            continue;
        }
        let mut places: HashMap<Place, (usize, usize)> = HashMap::from([((0, 0), (seed, 0))]);
        let mut queue = VecDeque::from([((0, 0), seed, 0)]);
        taken[seed] = true;
        while let Some((place, i, turn)) = queue.pop_front() {
            for edge in 0..4 {
                let Some((other, back)) = mutual(i, edge) else { continue };
                let step = (edge + turn) % 4;
                let next = (place.0 + STEPS[step].0, place.1 + STEPS[step].1);
                if taken[other] || places.contains_key(&next) {
                    continue;
                }
                taken[other] = true;
                let turned = (step + 6 - back) % 4;
                places.insert(next, (other, turned));
                queue.push_back((next, other, turned));
            }
        }
        if places.len() >= 4 {
            let mut grid: Grid = places
                .into_iter()
                .map(|(place, (i, turn))| (place, Cell { corner: corners[i], turn }))
                .collect();
            drop_misfits(&mut grid);
            grow(search, &mut grid);
            drop_misfits(&mut grid);
            if grid.len() >= least {
                found.push(grid);
            }
        }
    }
    found.sort_by_key(|grid| std::cmp::Reverse(grid.len()));
    found
}

/// The corner to which an edge leads.
fn neighbour(search: &Search, corners: &[Corner], from: usize, edge: usize) -> Option<usize> {
    let corner = &corners[from];
    let mut near: [(f64, usize); 3] = [(f64::INFINITY, 0); 3];
    for (i, other) in corners.iter().enumerate() {
        let way = other.at - corner.at;
        let square = way.length_squared();
        if square < near[2].0 && i != from && fits(corner, edge, other).is_some() {
            near[2] = (square, i);
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
    }
    near.iter()
        .take_while(|(square, _)| square.is_finite())
        .find(|(_, i)| edge_between(search, corner, edge, &corners[*i]))
        .map(|(_, i)| *i)
}

/// The edge of `other` that leads back, where `other` can be the neighbour of `corner` along `edge`.
fn fits(corner: &Corner, edge: usize, other: &Corner) -> Option<usize> {
    let way = other.at - corner.at;
    let along = way.dot(corner.edges[edge]);
    if along < 4.0 || way.perp_dot(corner.edges[edge]).abs() > ASIDE * along {
        return None;
    }
    // Dark and bright change sides: the first edge of one is the second of the other.
    let back = [(edge + 1) % 4, (edge + 3) % 4].into_iter().find(|&k| way.dot(other.edges[k]) < 0.0)?;
    let ratio = other.contrast / corner.contrast;
    let length = way.length();
    (way.perp_dot(other.edges[back]).abs() < TURNED * length && (0.25..4.0).contains(&ratio)).then_some(back)
}

/// Whether the picture shows an edge all the way, dark on the side where it is dark at the corner.
fn edge_between(search: &Search, corner: &Corner, edge: usize, other: &Corner) -> bool {
    let way = other.at - corner.at;
    let length = way.length();
    let aside = way.perp() / length * (0.13 * length).max(1.5).min(0.3 * length);
    let dark = if edge.is_multiple_of(2) { aside } else { -aside };
    let least = 0.25 * corner.contrast.min(other.contrast);
    [0.3, 0.5, 0.7].into_iter().all(|part| {
        let at = corner.at + part * way;
        let (dark, bright) = (at + dark, at - dark);
        search.smooth.sample(bright.x, bright.y) - search.smooth.sample(dark.x, dark.y) > least
    })
}

/// Where a place should be, by continuing the rows and columns that lead there, and how wide its squares are.
fn predict(grid: &Grid, place: Place) -> Option<(DVec2, f64)> {
    let at = |dx: i32, dy: i32| grid.get(&(place.0 + dx, place.1 + dy)).map(|cell| cell.corner.at);
    let (mut sum, mut weight, mut spacing) = (DVec2::ZERO, 0.0, f64::INFINITY);
    let mut add = |guess: DVec2, sure: f64, wide: f64| {
        sum += sure * guess;
        weight += sure;
        spacing = spacing.min(wide);
    };
    for (dx, dy) in STEPS {
        if let (Some(a), Some(b)) = (at(dx, dy), at(2 * dx, 2 * dy)) {
            match at(3 * dx, 3 * dy) {
                Some(c) => add(3.0 * (a - b) + c, 1.5, a.distance(b)),
                None => add(2.0 * a - b, 1.0, a.distance(b)),
            }
        }
        if let (Some(a), Some(b)) = (at(dx, dy), at(-dx, -dy)) {
            add(0.5 * (a + b), 2.0, 0.5 * a.distance(b));
        }
        let (ex, ey) = (-dy, dx);
        if let (Some(a), Some(b), Some(c)) = (at(dx, dy), at(ex, ey), at(dx + ex, dy + ey)) {
            add(a + b - c, 1.0, a.distance(c));
        }
    }
    (weight > 0.0).then(|| (sum / weight, spacing))
}

/// Adds corners around the grid and in its holes as long as there are any where they should be.
fn grow(search: &Search, grid: &mut Grid) {
    let mut tried: HashMap<Place, usize> = HashMap::new();
    loop {
        let around: Vec<Place> = grid
            .keys()
            .flat_map(|place| STEPS.map(|step| (place.0 + step.0, place.1 + step.1)))
            .filter(|place| !grid.contains_key(place))
            .collect();
        let mut added = false;
        for place in around {
            let neighbours =
                STEPS.iter().filter(|s| grid.contains_key(&(place.0 + s.0, place.1 + s.1))).count();
            // A place is asked again only when it has got more neighbours.
            if grid.contains_key(&place) || tried.get(&place).is_some_and(|before| *before >= neighbours) {
                continue;
            }
            tried.insert(place, neighbours);
            if let Some(cell) = look(search, grid, place) {
                grid.insert(place, cell);
                added = true;
            }
        }
        if !added || grid.len() > 4000 {
            return;
        }
    }
}

/// The corner at an empty place, if one is there that fits one of its neighbours.
fn look(search: &Search, grid: &Grid, place: Place) -> Option<Cell> {
    let (at, spacing) = predict(grid, place)?;
    let corner = search.corner_near(at, (0.28 * spacing).clamp(1.5, 12.0))?;
    let known = |cell: &&Cell| cell.corner.at.distance(corner.at) < 0.4 * spacing;
    if grid.values().find(known).is_some() {
        return None;
    }
    STEPS.iter().enumerate().find_map(|(step, (dx, dy))| {
        let neighbour = grid.get(&(place.0 - dx, place.1 - dy))?;
        let edge = neighbour.edge(step);
        let back = fits(&neighbour.corner, edge, &corner)?;
        edge_between(search, &neighbour.corner, edge, &corner)
            .then_some(Cell { corner, turn: (step + 6 - back) % 4 })
    })
}

/// Drops corners that lie far from where their neighbours on both sides have them, the worst first.
fn drop_misfits(grid: &mut Grid) {
    loop {
        let misfit = |place: &Place| {
            let at = |dx: i32, dy: i32| grid.get(&(place.0 + dx, place.1 + dy)).map(|cell| cell.corner.at);
            let mut worst = 0f64;
            for (dx, dy) in [(1, 0), (0, 1)] {
                if let (Some(a), Some(b), Some(c)) = (at(-dx, -dy), at(0, 0), at(dx, dy)) {
                    worst = worst.max(b.distance(0.5 * (a + c)) / (0.5 * a.distance(c)).max(1e-9));
                }
            }
            worst
        };
        let worst = grid.keys().map(|place| (misfit(place), *place)).max_by(|a, b| a.0.total_cmp(&b.0));
        match worst {
            Some((amount, place)) if amount > 0.35 => drop(grid.remove(&place)),
            _ => return,
        }
    }
}

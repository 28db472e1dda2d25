//! Photographs of a chessboard through a known lens, and where its corners truly are.

use glam::{DMat3, DVec2, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use rigel::calibration::BoardCorner;
use rigel::geometry::Lens;
use rigel::picture::Picture;

/// Sub-samples along either side of a pixel that an edge crosses.
const FINE: usize = 16;

/// A chessboard in front of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Board {
    /// Inner corners along x.
    pub columns: u32,
    /// Inner corners along y.
    pub rows: u32,
    /// Side of a square, metres.
    pub square_m: f64,
    /// Turns the board's frame (origin in the first inner corner, x along the columns, y along the rows) into the camera's.
    pub rotation: DMat3,
    /// The first inner corner in the camera's frame, metres.
    pub origin_m: DVec3,
}

/// What the photograph of a board is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Levels of dark and bright squares, and of what surrounds the board.
    pub levels: [f64; 3],
    /// Standard deviation of the blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of the noise, levels.
    pub noise: f64,
    /// A factor on the levels; what is then beyond 0 to 255 is cut.
    pub exposure: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Look {
    /// As `peers/d_calib.py` has it: 30, 215 and 200 levels, a blur of 0.6 pixels, a noise of 2 levels.
    fn default() -> Self {
        Self { levels: [30.0, 215.0, 200.0], blur_px: 0.6, noise: 2.0, exposure: 1.0, seed: 1 }
    }
}

impl Board {
    /// A board of this size whose centre is at `centre_m`, turned by `turn` (axis times angle, radians) from facing the camera upright.
    pub fn at(columns: u32, rows: u32, square_m: f64, turn: DVec3, centre_m: DVec3) -> Self {
        let rotation = DMat3::from_quat(glam::DQuat::from_scaled_axis(turn));
        let middle = DVec3::new(f64::from(columns) - 1.0, f64::from(rows) - 1.0, 0.0) * (0.5 * square_m);
        Self { columns, rows, square_m, rotation, origin_m: centre_m - rotation * middle }
    }

    /// Where a corner appears, pixels; `column` and `row` may lie beyond the inner corners.
    pub fn pixel(&self, lens: &Lens, column: f64, row: f64) -> Option<DVec2> {
        let point = self.rotation * (DVec3::new(column, row, 0.0) * self.square_m) + self.origin_m;
        lens.project(point)
    }

    /// Where the inner corners appear, row by row; `None` where one is not before the lens.
    pub fn corners(&self, lens: &Lens) -> Option<Vec<DVec2>> {
        let (columns, rows) = (self.columns, self.rows);
        (0..rows)
            .flat_map(|row| (0..columns).map(move |column| (f64::from(column), f64::from(row))))
            .map(|(column, row)| self.pixel(lens, column, row))
            .collect()
    }

    /// The inner corners in the picture as a detector with noise of `sigma_px` finds them; `None` where one is not before the lens.
    pub fn detected(&self, lens: &Lens, sigma_px: f64, seed: u64) -> Option<Vec<BoardCorner>> {
        let mut random = StdRng::seed_from_u64(seed);
        let end = DVec2::new(f64::from(lens.width), f64::from(lens.height)) - 1.0;
        let corners = self.corners(lens)?.into_iter().enumerate().map(|(i, pixel)| BoardCorner {
            column: i as u32 % self.columns,
            row: i as u32 / self.columns,
            pixel: pixel + sigma_px * DVec2::new(normal(&mut random), normal(&mut random)),
            sigma_px,
            blur_px: 0.6,
        });
        let inside = |at: DVec2| at.cmpge(DVec2::ZERO).all() && at.cmple(end).all();
        Some(corners.filter(|corner| inside(corner.pixel)).collect())
    }

    /// Whether the whole board with half a square around it is in the picture.
    pub fn is_inside(&self, lens: &Lens) -> bool {
        let (right, bottom) = (f64::from(self.columns) + 0.5, f64::from(self.rows) + 0.5);
        let ends = [(-1.5, -1.5), (right, -1.5), (-1.5, bottom), (right, bottom)];
        ends.into_iter().all(|(column, row)| {
            self.pixel(lens, column, row).is_some_and(|p| {
                p.x > 5.0
                    && p.y > 5.0
                    && p.x < f64::from(lens.width) - 6.0
                    && p.y < f64::from(lens.height) - 6.0
            })
        })
    }

    /// Photographs the board: a border of one square's width of bright paper surrounds it.
    pub fn photograph(&self, lens: &Lens, look: &Look) -> Picture {
        let (width, height) = (lens.width as usize, lens.height as usize);
        let inverse = self.rotation.transpose();
        let eye = inverse * -self.origin_m;
        // In squares from the first inner corner; nothing where the pixel does not look at the board's plane.
        let on_board = |pixel: DVec2| {
            let ray = inverse * lens.unproject(pixel)?;
            let along = -eye.z / ray.z;
            (along.is_finite() && along > 0.0).then(|| (eye + along * ray).truncate() / self.square_m)
        };
        let brightness = |at: DVec2| {
            let (column, row) = (at.x.floor(), at.y.floor());
            let inside =
                |k: f64, count: u32, border: f64| k >= -1.0 - border && k < f64::from(count) + border;
            if !(inside(column, self.columns, 1.0) && inside(row, self.rows, 1.0)) {
                return look.levels[2];
            }
            let printed = inside(column, self.columns, 0.0) && inside(row, self.rows, 0.0);
            if printed && (column + row).rem_euclid(2.0) < 1.0 { look.levels[0] } else { look.levels[1] }
        };
        let at_corners: Vec<Option<DVec2>> = (0..(width + 1) * (height + 1))
            .into_par_iter()
            .map(|i| on_board(DVec2::new((i % (width + 1)) as f64 - 0.5, (i / (width + 1)) as f64 - 0.5)))
            .collect();
        let sharp: Vec<f64> = (0..width * height)
            .into_par_iter()
            .map(|i| {
                let at = i / width * (width + 1) + i % width;
                let [Some(a), Some(b), Some(c), Some(d)] =
                    [at, at + 1, at + width + 1, at + width + 2].map(|corner| at_corners[corner])
                else {
                    return look.levels[2];
                };
                if [b, c, d].iter().all(|other| other.floor() == a.floor()) {
                    return brightness(a);
                }
                // Within a pixel the board is as good as evenly stretched.
                let part = |k: usize| (k as f64 + 0.5) / FINE as f64;
                let fine = (0..FINE * FINE).map(|k| {
                    brightness(a.lerp(b, part(k % FINE)).lerp(c.lerp(d, part(k % FINE)), part(k / FINE)))
                });
                fine.sum::<f64>() / (FINE * FINE) as f64
            })
            .collect();
        let blurred = blur(&sharp, width, height, look.blur_px);
        let mut random = StdRng::seed_from_u64(look.seed);
        let levels = blurred.into_iter().map(|level| {
            let seen = look.exposure * level + look.noise * normal(&mut random);
            [seen.round().clamp(0.0, 255.0) as u16; 3]
        });
        Picture {
            path: std::path::PathBuf::new(),
            width: lens.width,
            height: lens.height,
            levels: levels.collect(),
            white: 255,
        }
    }
}

/// Boards as `peers/d_calib.py` strews them: tilted by up to half a radian, wholly in the picture.
pub fn strew(lens: &Lens, columns: u32, rows: u32, count: usize, seed: u64) -> Vec<Board> {
    let mut random = StdRng::seed_from_u64(seed);
    let mut boards = vec![];
    while boards.len() < count {
        let mut between = |least: f64, most: f64| random.random_range(least..most);
        let turn = DVec3::new(between(-0.5, 0.5), between(-0.5, 0.5), between(-0.3, 0.3));
        let centre = DVec3::new(between(-2.0, 2.0), between(-1.5, 1.5), between(9.0, 15.0));
        let board = Board::at(columns, rows, 1.0, turn, centre);
        if board.is_inside(lens) {
            boards.push(board);
        }
    }
    boards
}

/// Fourteen boards of 9 x 6 corners that tell a lens well: six strewn ones, and two in each corner of the picture, tilted to all sides and
/// partly outside.
pub fn cover(lens: &Lens, seed: u64) -> Vec<Board> {
    let half = DVec2::new(f64::from(lens.width) / lens.fx, f64::from(lens.height) / lens.fy) / 2.0;
    let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
    let in_corner = |(x, y): (f64, f64)| {
        [(10.0, 0.4), (12.0, -0.35)].map(|(distance, tilt): (f64, f64)| {
            let centre = (half * DVec2::new(4.4 * x, 5.0 * y)).extend(distance);
            Board::at(9, 6, 1.0, DVec3::new(tilt * y, -tilt * x, 0.1 * x), centre)
        })
    };
    strew(lens, 9, 6, 6, seed).into_iter().chain(corners.into_iter().flat_map(in_corner)).collect()
}

/// A Gaussian of standard deviation `sigma_px` over a picture, by rows and columns; the border is continued.
fn blur(levels: &[f64], width: usize, height: usize, sigma_px: f64) -> Vec<f64> {
    if sigma_px <= 0.0 {
        return levels.to_vec();
    }
    let reach = (4.0 * sigma_px).ceil() as i64;
    let weights: Vec<f64> = (-reach..=reach).map(|k| (-0.5 * (k as f64 / sigma_px).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let pass = |levels: &[f64], along: usize, size: usize| -> Vec<f64> {
        (0..levels.len())
            .into_par_iter()
            .map(|i| {
                let at = (i / along % size) as i64;
                let level = |k: i64| {
                    let other = (at + k).clamp(0, size as i64 - 1);
                    levels[(i as i64 + (other - at) * along as i64) as usize]
                };
                weights.iter().zip(-reach..).map(|(weight, k)| weight * level(k)).sum::<f64>() / sum
            })
            .collect()
    };
    pass(&pass(levels, 1, width), width, height)
}

/// A normally distributed number (Box and Muller).
pub fn normal(random: &mut StdRng) -> f64 {
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

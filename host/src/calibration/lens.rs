//! A lens from photographs of a chessboard, with what is known of its accuracy.

mod adjust;
mod choose;
mod doubt;
mod file;
mod fit;
mod photographs;
mod project;
mod start;
mod verdict;

use std::path::PathBuf;

use glam::DVec2;
use nalgebra::{SMatrix, SVector};

pub use self::fit::{BoardView, calibrate_lens};
pub use self::photographs::calibrate_photographs;

use self::project::{LENS, project};
use super::chessboard::BoardCorner;
use super::median;
use crate::geometry::Lens;
pub use crate::geometry::LensCovariance;
use crate::{Error, Result};

/// The names of a lens's numbers, in the order of [`LensCovariance`].
pub const LENS_NAMES: [&str; LENS] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];

/// Which terms of the distortion a lens has; each model has those of the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LensModel {
    /// None.
    Pinhole,
    /// k1.
    K1,
    /// k1 k2.
    K1K2,
    /// k1 k2 p1 p2.
    K1K2P1P2,
    /// k1 k2 p1 p2 k3.
    All,
}

impl LensModel {
    /// From the smallest to the largest.
    pub const LADDER: [Self; 5] = [Self::Pinhole, Self::K1, Self::K1K2, Self::K1K2P1P2, Self::All];

    /// How it is called at the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pinhole => "none",
            Self::K1 => "k1",
            Self::K1K2 => "k1k2",
            Self::K1K2P1P2 => "k1k2p1p2",
            Self::All => "k1k2p1p2k3",
        }
    }

    /// The model of a name.
    ///
    /// # Errors
    /// [`Error::Request`] when there is none.
    pub fn parse(name: &str) -> Result<Self> {
        Self::LADDER.into_iter().find(|model| model.name() == name).ok_or_else(|| {
            let names: Vec<&str> = Self::LADDER.into_iter().map(Self::name).collect();
            Error::request(
                format!("there is no lens model '{name}'"),
                format!("choose among auto, {}", names.join(", ")),
            )
        })
    }

    /// Which numbers of a lens it estimates, in the order of [`LENS_NAMES`]; the others are held at 0.
    pub fn estimated(self) -> [bool; LENS] {
        let terms = [0, 1, 2, 4, 5][self as usize];
        std::array::from_fn(|k| k < 4 + terms)
    }
}

/// A corner and how far it was seen from where the calibrated lens shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedCorner {
    /// As it was found.
    pub corner: BoardCorner,
    /// Found minus predicted, pixels.
    pub residual: DVec2,
    /// Whether it took part: one that is far off everything else does not.
    pub used: bool,
}

/// A board that took part.
#[derive(Debug, Clone, PartialEq)]
pub struct BoardFit {
    /// Its photograph.
    pub path: PathBuf,
    /// Root of the mean squared distance of its used corners, pixels.
    pub rms_px: f64,
    /// Its corners.
    pub corners: Vec<FittedCorner>,
    /// The angle between the board's normal and the camera's axis, radians.
    pub tilt_rad: f64,
}

/// A board that did not.
#[derive(Debug, Clone, PartialEq)]
pub struct DroppedBoard {
    /// Its photograph.
    pub path: PathBuf,
    /// What is wrong and what to do, as "it is blurred; photograph it again".
    pub reason: String,
}

/// A lens with its uncertainty.
#[derive(Debug, Clone, PartialEq)]
pub struct LensCalibration {
    /// The lens.
    pub lens: Lens,
    /// Covariance of its numbers. Terms that the model leaves out are zero but not known to be: they have the variance that the
    /// boards and what is usual for lenses leave them, and the others carry what that means for them.
    pub covariance: LensCovariance,
    /// The terms that were estimated.
    pub model: LensModel,
    /// Root of the mean squared distance of the used corners from where the lens shows them, pixels.
    pub rms_px: f64,
    /// By how much boards pull more than the noise of their corners explains (a board that is bent, say): this factor, at least
    /// 1, is in the covariance.
    pub excess: f64,
    /// The boards that took part.
    pub boards: Vec<BoardFit>,
    /// The boards that did not.
    pub dropped: Vec<DroppedBoard>,
    /// What was achieved and what would improve it, one sentence.
    pub verdict: String,
}

impl BoardFit {
    /// The median distance of its used corners from where the lens shows them, pixels.
    pub fn typical_px(&self) -> f64 {
        let used = self.corners.iter().filter(|corner| corner.used);
        median(&used.map(|corner| corner.residual.length()).collect::<Vec<_>>())
    }
}

impl LensCalibration {
    /// What is doubtful of one of the boards, and what to do, as a clause that goes on from its name; `None` where it is like the others.
    pub fn doubt_about(&self, board: &BoardFit) -> Option<String> {
        verdict::doubt_about(self, board)
    }

    /// The covariance of the pixel where a direction of the camera frame appears, the direction that `pixel` shows; `None` where
    /// the lens shows nothing.
    pub fn projection_covariance(&self, pixel: DVec2) -> Option<[[f64; 2]; 2]> {
        let by_lens = by_lens(&self.lens, pixel)?;
        Some(spread(&self.covariance, &by_lens))
    }

    /// Standard deviation, in its worst direction, of where the lens shows a thing at `pixel`, after the camera was turned so that
    /// things all over the picture are where they should be on the average: what no pose can make good. Pixels; infinite where the lens
    /// shows nothing.
    pub fn projection_sigma_px(&self, pixel: DVec2) -> f64 {
        self.sigma_at(pixel, &self.turn())
    }

    /// [`Self::projection_sigma_px`] at `columns` x `rows` pixels from edge to edge of the picture, row by row.
    pub fn projection_sigmas_px(&self, columns: usize, rows: usize) -> Vec<f64> {
        let turn = self.turn();
        grid(&self.lens, columns, rows).into_iter().map(|pixel| self.sigma_at(pixel, &turn)).collect()
    }

    fn sigma_at(&self, pixel: DVec2, turn: &SMatrix<f64, 3, LENS>) -> f64 {
        let (Some(by_lens), Some(by_turn)) = (by_lens(&self.lens, pixel), by_turn(&self.lens, pixel)) else {
            return f64::INFINITY;
        };
        let [[a, b], [_, d]] = spread(&self.covariance, &(by_lens - by_turn * turn));
        (0.5 * (a + d) + (0.25 * (a - d) * (a - d) + b * b).sqrt()).max(0.0).sqrt()
    }

    /// The turn of the camera that best mimics each number of the lens over the picture.
    fn turn(&self) -> SMatrix<f64, 3, LENS> {
        let mut normal = SMatrix::<f64, 3, 3>::zeros();
        let mut right = SMatrix::<f64, 3, LENS>::zeros();
        for pixel in grid(&self.lens, 9, 7) {
            if let (Some(by_lens), Some(by_turn)) = (by_lens(&self.lens, pixel), by_turn(&self.lens, pixel)) {
                normal += by_turn.transpose() * by_turn;
                right += by_turn.transpose() * by_lens;
            }
        }
        normal.cholesky().map_or_else(SMatrix::zeros, |factor| factor.solve(&right))
    }

    /// Standard deviations of the lens's numbers, in the order of [`LENS_NAMES`].
    pub fn sigmas(&self) -> [f64; LENS] {
        std::array::from_fn(|k| self.covariance[k][k].max(0.0).sqrt())
    }
}

/// Pixels from edge to edge of the picture.
fn grid(lens: &Lens, columns: usize, rows: usize) -> Vec<DVec2> {
    let at = |k: usize, count: usize, size: u32| {
        (f64::from(size) - 1.0) * if count > 1 { k as f64 / (count - 1) as f64 } else { 0.5 }
    };
    (0..rows)
        .flat_map(|row| (0..columns).map(move |column| (column, row)))
        .map(|(column, row)| DVec2::new(at(column, columns, lens.width), at(row, rows, lens.height)))
        .collect()
}

/// How a pixel moves with the numbers of the lens.
fn by_lens(lens: &Lens, pixel: DVec2) -> Option<SMatrix<f64, 2, LENS>> {
    let (_, by_lens, _) = project(lens, lens.unproject(pixel)?)?;
    Some(SMatrix::from_fn(|i, k| by_lens[k][i]))
}

/// How a pixel moves when what is seen turns around the camera.
fn by_turn(lens: &Lens, pixel: DVec2) -> Option<SMatrix<f64, 2, 3>> {
    let direction = lens.unproject(pixel)?;
    let (_, _, [x, y, z]) = project(lens, direction)?;
    let by_point = SMatrix::<f64, 2, 3>::from_columns(&[x, y, z].map(|v| SVector::from([v.x, v.y])));
    let d = direction;
    // w x d, by w.
    let cross = SMatrix::<f64, 3, 3>::new(0.0, d.z, -d.y, -d.z, 0.0, d.x, d.y, -d.x, 0.0);
    Some(by_point * cross)
}

fn spread(covariance: &LensCovariance, by: &SMatrix<f64, 2, LENS>) -> [[f64; 2]; 2] {
    let covariance = SMatrix::<f64, LENS, LENS>::from_fn(|i, j| covariance[i][j]);
    let spread = by * covariance * by.transpose();
    [[spread[(0, 0)], spread[(0, 1)]], [spread[(1, 0)], spread[(1, 1)]]]
}

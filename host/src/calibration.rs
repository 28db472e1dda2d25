//! What belongs to the camera and the rig rather than to a photograph: vignetting, the lens, chessboards.

pub mod chessboard;
pub mod lens;
pub mod vignetting;

pub use chessboard::{BoardCorner, BoardSize, Sighting, find_board};
pub use lens::{
    BoardView, LensCalibration, LensCovariance, LensModel, calibrate_lens, calibrate_photographs,
};
pub use vignetting::Vignetting;

//! What belongs to the camera and the rig rather than to a photograph: vignetting, the lens, and where each view was taken
//! from.

mod adjust;
pub mod chessboard;
mod corners;
mod edge;
pub mod lens;
mod look;
mod luminance;
mod misplaced;
mod photometry;
mod refine;
mod register;
mod registration;
mod rig_model;
mod square;
mod squares;
mod suspect;
mod texture;
pub mod vignetting;

pub use chessboard::{BoardCorner, BoardSize, Sighting, find_board};
pub use corners::{SquareCorners, ViewCorners, register_corners};
pub use lens::{
    BoardView, LensCalibration, LensCovariance, LensModel, calibrate_lens, calibrate_photographs,
};
pub use photometry::{Photometry, ViewGain};
pub use register::{RegisterOptions, register};
pub use registration::{DeviationSigma, DroppedView, RegisteredView, Registration, view_geometry};
pub use rig_model::RigModel;
pub use squares::Squares;
pub use vignetting::Vignetting;

/// The middle of some numbers, the upper one of two; 0 of none.
fn median(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

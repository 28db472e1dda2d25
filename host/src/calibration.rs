//! What belongs to the camera and the rig rather than to a photograph: vignetting, and where each view was taken from.

mod adjust;
mod edge;
mod luminance;
mod register;
mod registration;
mod rig_model;
mod square;
mod squares;
pub mod vignetting;

pub use register::{RegisterOptions, register};
pub use registration::{DeviationSigma, DroppedView, RegisteredView, Registration, view_geometry};
pub use rig_model::RigModel;
pub use squares::Squares;
pub use vignetting::Vignetting;

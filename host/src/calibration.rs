//! What belongs to the camera and the rig rather than to a photograph: vignetting.

pub mod vignetting;

pub use vignetting::Vignetting;

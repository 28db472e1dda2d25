//! Rigel: from photographs to a surface that looks right.
//!
//! Each module is a room on the road that the data takes, and imports only rooms upstream of it:
//! `geometry` → `rig`, `camera`, `sampling` → `session` → `radiance`, `calibration` → `observation` → `fit`,
//! `parameter_map` → `render` → `evaluate`, `chart`, `report`.

pub mod error;
pub mod file;
pub mod fit;
pub mod geometry;
pub mod observation;
pub mod parameter_map;
pub mod progress;
pub mod radiance;
pub mod rig;
pub mod sampling;

pub use error::{Error, Result};

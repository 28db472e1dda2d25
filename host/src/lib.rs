//! Rigel: from photographs to a surface that looks right.
//!
//! Each module is a room on the road that the data takes, and imports only rooms upstream of it:
//! `geometry` → `rig`, `camera`, `sampling` → `session` → `radiance`, `calibration` → `observation` → `fit`,
//! `photometry`, `parameter_map` → `render` → `evaluate`, `plan`, `chart`, `report`; from `radiance` and `tracker` to `environment` → `room`;
//! from `parameter_map` to `shader` → `web` and to `emitter`, from `render` to `splats`; `info` knows them all.

mod calendar;
pub mod calibration;
pub mod camera;
pub mod capture;
pub mod chart;
pub mod compare;
pub mod emitter;
pub mod environment;
pub mod error;
pub mod evaluate;
pub mod file;
pub mod fit;
pub mod geometry;
pub mod info;
pub mod measure;
pub mod observation;
pub mod parameter_map;
pub mod photometry;
pub mod picture;
pub mod plan;
pub mod progress;
pub mod radiance;
pub mod render;
pub mod report;
pub mod rig;
pub mod room;
pub mod sampling;
pub mod session;
pub mod shader;
pub mod splats;
pub mod tracker;
pub mod units;
pub mod view_file;
pub mod web;

pub use error::{Error, Result};

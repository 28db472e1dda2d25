//! A simulated rig, camera and surface with a known truth.

pub mod board;
pub mod camera;
pub mod rig;
pub mod scene;
pub mod squares;
pub mod texture;
pub mod tour;
pub mod tracker;

//! From maps of a room to its surfaces.
//!
//! The road: a [`Model`] (OBJ, glTF) and, for each map, where it was taken and how it is turned ([`register`], from pairs of points);
//! [`texture`] lets every texel look at the maps through the capture points, unless something is in between, which makes a [`Room`]; its [`Patch`]es
//! are the light sources, [`Room::look`] is what a camera elsewhere would see.

mod charts;
mod fill;
mod gltf_file;
mod model;
mod patches;
mod register;
mod texture;
mod tree;
mod write;

pub use charts::Charts;
pub use model::Model;
pub use patches::{Patch, patches_csv};
pub use register::{Pair, Registered, read_pairs, register};
pub use texture::{Capture, Room, texture};
pub use tree::{Hit, Tree};
pub use write::FILES;

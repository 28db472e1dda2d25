//! From photographs taken on the spot, with their orientations, to a map of the radiance from every direction.
//!
//! The road: [`Shots`] say which photographs there are and how the camera was turned; corners found in several photographs refine
//! that, and what overlaps tells their gains; as [`Plate`]s, radiance at the map's own scale, they are put on the sphere ([`merge`]),
//! which makes an [`EnvironmentMap`]. [`mosaic`] goes the whole road.

mod align;
mod coverage;
mod cube;
mod features;
mod fill;
mod gain;
pub(crate) mod lattice;
mod lights;
mod live;
mod map;
mod merge;
mod mosaic;
mod pages;
mod plate;
mod reduce;
mod shots;
mod tracked;
mod update;
mod warp;

pub use coverage::{Coverage, Next, Pointing, Wanted};
pub use cube::Cube;
pub use lights::{Light, Lights, Method, Remainder, lights};
pub use live::{Arrival, Live, MEMORY_S, Place};
pub use map::{EnvironmentMap, Flag, Unit};
pub(crate) use map::{tone_mapped, write_exr};
pub use merge::{Merged, Options as MergeOptions, merge};
pub use mosaic::{Mosaic, Options, Placed, mosaic};
pub use plate::{Noise, Plate};
pub use shots::{Shot, Shots, Tracking};
pub use tracked::{Tracked, TrackerFit};
pub use update::{Lamp, Updated, update};
pub use warp::{Filter, Sphere};

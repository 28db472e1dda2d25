//! From photographs taken on the spot, with their orientations, to a map of the radiance from every direction.
//!
//! The road: photographs and how the camera was turned ([`Shot`]) become [`Plate`]s, radiance at the map's own scale; [`merge`]
//! puts them on the sphere.

mod merge;
mod plate;
mod reduce;
mod warp;

pub use merge::{Merged, Options as MergeOptions, merge};
pub use plate::{Noise, Plate};
pub use warp::{Filter, Sphere};

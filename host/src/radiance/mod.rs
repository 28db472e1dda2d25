//! From bracketed photographs to radiance with its variance, on one scale for a whole session.

mod image;

pub use image::{Mask, RadianceImage};

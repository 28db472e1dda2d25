//! Parameter maps for a graphics processor: coefficients as it reads them, and the program that shows them.
//!
//! One WGSL text serves the window and, translated, the page. It evaluates radiance and blends that, as
//! [`ParameterMap::radiance_at`] does; coefficients are never interpolated.

mod detail;
mod packed;
mod source;
#[cfg(test)]
mod tests;

pub use detail::{SMOOTH, sharpness};
pub use packed::{Packed, Stored};
pub use source::{Look, camera_numbers, false_colour, plain_source, source};

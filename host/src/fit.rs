//! Fitting a model of radiance against direction to the observations of a texel.
//!
//! Per texel the smallest model that reproduces what the views measured is wanted. [`Model`] names the choices and
//! evaluates them, [`Fitter`] fits one of them, [`Selector`] chooses by how well they predict views that the fit has not seen.

mod choice;
mod evidence;
mod fitter;
pub mod harmonics;
mod held_out;
mod log_quadratic;
mod model;
mod palette;
mod phong;
mod pooled;
mod selector;
mod small;
mod surface;
#[cfg(test)]
mod tests;
mod voronoi;
mod weights;

pub use choice::{Choice, Reason};
pub use evidence::Evidence;
pub use fitter::{FitFlags, FitOptions, Fitter, TexelFit};
pub use harmonics::HarmonicsMethod;
pub use model::{Model, Toward};
pub use palette::{Entry, Palette};
pub use selector::{BANDS, Selector, ZenithRatios, candidates, zenith_band};

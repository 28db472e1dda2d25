//! Fitting a model of radiance against direction to the observations of a texel.
//!
//! Per texel the smallest model that reproduces what the views measured is wanted. [`Model`] names the choices and
//! evaluates them, [`Fitter`] fits one of them, [`choose_model`] ranks several by how well they predict views that the
//! fit has not seen, [`Evidence`] does so for each texel.

mod evidence;
mod fitter;
pub mod harmonics;
mod log_quadratic;
mod model;
mod phong;
mod select;
mod small;
#[cfg(test)]
mod tests;
mod voronoi;
mod weights;

pub use evidence::{BANDS, Evidence, Reason, choose_models, zenith_band, zenith_factors};
pub use fitter::{FitFlags, FitOptions, Fitter, TexelFit};
pub use harmonics::HarmonicsMethod;
pub use model::{Model, Toward};
pub use select::{Candidate, candidates, choose_model};

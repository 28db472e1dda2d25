//! The parameter map: a model's coefficients for every texel, in a file that other programs open.

use crate::fit::Model;
use crate::geometry::{Surface, Texels};

/// Coefficients of one model for every texel of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterMap {
    /// The sampled area.
    pub surface: Surface,
    /// How finely it is divided.
    pub texels: Texels,
    /// What the coefficients mean.
    pub model: Model,
    /// Texel after texel from the top-left one, `model.parameter_count()` values each.
    pub parameters: Vec<f32>,
}

//! Fitting a model of radiance against direction to the observations of a texel.

/// A model of the radiance that leaves a texel, as a function of the direction to the viewer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// One RGB radiance for all directions.
    Constant,
}

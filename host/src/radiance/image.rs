//! A view's radiance: what every pixel measured, how sure it is, and which pixels could not be measured.

/// What was wrong with a pixel; 0 means nothing.
pub type Mask = u8;

/// Radiance, variance and mask of one view, row by row from the top-left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct RadianceImage {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Linear RGB radiance in the session's unit. Where the mask says saturated, a lower bound.
    pub radiance: Vec<[f32; 3]>,
    /// Variance of each channel, in the square of that unit.
    pub variance: Vec<[f32; 3]>,
    /// Per pixel, a combination of [`RadianceImage::SATURATED`], [`RadianceImage::DARK`] and [`RadianceImage::GHOST`], or 0.
    pub mask: Vec<Mask>,
}

impl RadianceImage {
    /// At least one channel was saturated in every photograph.
    pub const SATURATED: Mask = 1;
    /// At least one channel was too dark in every photograph.
    pub const DARK: Mask = 2;
    /// Something moved between the photographs: the radiance is what most of them agree on, where the variance is finite;
    /// where it is infinite, none do.
    pub const GHOST: Mask = 4;
}

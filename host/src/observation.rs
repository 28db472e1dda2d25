//! The observation map: per texel, every view's radiance against direction.

use glam::Vec3;

/// What the views measured of one texel: only the views that measured it, in the order of the views.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TexelObservations {
    /// Index of the view in the observation map's header.
    pub view: Vec<u32>,
    /// Unit vector from the texel to the camera, surface frame.
    pub direction: Vec<Vec3>,
    /// Linear RGB radiance.
    pub radiance: Vec<[f32; 3]>,
    /// Standard deviation of the radiance (root mean square over the channels), same unit.
    pub sigma: Vec<f32>,
}

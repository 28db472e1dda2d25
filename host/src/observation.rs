//! The observation map: per texel, every view's radiance against direction.

mod build;
mod gain;
mod map;
mod place;
mod sample;

use glam::Vec3;

pub use build::{Options, observe};
pub use map::{Header, ObservationMap, ObservedView};

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

impl TexelObservations {
    /// How many views measured the texel.
    pub fn len(&self) -> usize {
        self.view.len()
    }

    /// Whether no view measured the texel.
    pub fn is_empty(&self) -> bool {
        self.view.is_empty()
    }

    /// The same without some views.
    pub fn without(&self, views: &[u32]) -> Self {
        let mut rest = Self::default();
        for i in (0..self.len()).filter(|&i| !views.contains(&self.view[i])) {
            rest.view.push(self.view[i]);
            rest.direction.push(self.direction[i]);
            rest.radiance.push(self.radiance[i]);
            rest.sigma.push(self.sigma[i]);
        }
        rest
    }
}

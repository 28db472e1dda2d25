//! The observation map: per texel, every view's radiance against direction.

mod build;
mod cut;
pub(crate) mod exr_file;
mod gain;
mod map;
mod place;
mod sample;
pub(crate) mod zarr;

use std::borrow::Cow;

use glam::Vec3;

pub(crate) use build::{Area, sample_area};
pub use build::{Options, observe, observe_under};
pub use cut::Cut;
pub use map::{Header, ObservationMap, ObservedView};
pub use sample::Sample;

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

    /// Forgets everything and keeps the memory.
    fn clear(&mut self) {
        self.view.clear();
        self.direction.clear();
        self.radiance.clear();
        self.sigma.clear();
    }

    /// Makes room for so many more.
    fn reserve(&mut self, views: usize) {
        self.view.reserve(views);
        self.direction.reserve(views);
        self.radiance.reserve(views);
        self.sigma.reserve(views);
    }

    /// The same without some views.
    pub fn without(&self, views: &[u32]) -> Self {
        self.only(|i| !views.contains(&self.view[i]))
    }

    /// The observations in which everything is finite: the others say nothing.
    pub fn usable(&self) -> Cow<'_, Self> {
        let is_usable = |i: usize| {
            let [direction, radiance] = [self.direction[i].to_array(), self.radiance[i]];
            self.sigma[i].is_finite() && direction.into_iter().chain(radiance).all(f32::is_finite)
        };
        if (0..self.len()).all(is_usable) { Cow::Borrowed(self) } else { Cow::Owned(self.only(is_usable)) }
    }

    /// The observations whose index is wanted.
    pub(crate) fn only(&self, is_wanted: impl Fn(usize) -> bool) -> Self {
        let mut rest = Self::default();
        rest.reserve(self.len());
        for i in (0..self.len()).filter(|&i| is_wanted(i)) {
            rest.view.push(self.view[i]);
            rest.direction.push(self.direction[i]);
            rest.radiance.push(self.radiance[i]);
            rest.sigma.push(self.sigma[i]);
        }
        rest
    }
}

//! Does what a parameter map says of its own doubt hold for views that its fit has not seen?

use super::ParameterMap;
use crate::Result;
use crate::fit::{BANDS, zenith_band};
use crate::observation::ObservationMap;
use crate::progress::Progress;

/// How many measurements lie within one predicted standard deviation, and how many there are.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Within {
    /// Within.
    pub within: u64,
    /// Of these.
    pub all: u64,
}

impl Within {
    /// As a share of 1.
    pub fn share(self) -> f64 {
        self.within as f64 / self.all.max(1) as f64
    }

    fn add(&mut self, other: Self) {
        self.within += other.within;
        self.all += other.all;
    }
}

/// Counts the measurements (three for each texel and view) that `views` of `observations`, of which `fitted` was made without them,
/// hold: for each model of the map, in each of the bands of zeniths. Texels whose doubt is not known do not count.
///
/// # Errors
/// [`crate::Error::Io`] when the observation map cannot be read; [`crate::Error::Interrupted`].
pub fn coverage(
    fitted: &ParameterMap,
    observations: &ObservationMap,
    views: &[u32],
    progress: &dyn Progress,
) -> Result<Vec<[Within; BANDS]>> {
    let mut counts = vec![[Within::default(); BANDS]; fitted.models.len()];
    let (tiles, mut texels) = (observations.header().tiles().count(), vec![]);
    for tile in 0..tiles {
        progress.step(tile, tiles)?;
        observations.read_tile(tile, &mut texels)?;
        for ((column, row), texel) in &texels {
            let (model, parameters) = fitted.texel(*column, *row);
            let index = *row as usize * fitted.texels.columns as usize + *column as usize;
            for i in (0..texel.len()).filter(|&i| views.contains(&texel.view[i])) {
                let (direction, measured) = (texel.direction[i], texel.radiance[i]);
                let Some(sigma) = fitted.sigma(*column, *row, direction) else { continue };
                let predicted = model.radiance(parameters, direction);
                let within = (0..3).filter(|&c| (predicted[c] - measured[c]).abs() <= sigma[c]).count();
                counts[fitted.choice_at(index)][zenith_band(direction.z)]
                    .add(Within { within: within as u64, all: 3 });
            }
        }
    }
    progress.step(tiles, tiles)?;
    Ok(counts)
}

/// The counts of several bands or models together.
pub fn together<'a>(counts: impl IntoIterator<Item = &'a Within>) -> Within {
    counts.into_iter().fold(Within::default(), |mut sum, count| {
        sum.add(*count);
        sum
    })
}

//! What some texels say of the surface that they are from.

use super::model::SHININESS;
use crate::observation::TexelObservations;

/// So many texels, and of each so many views, tell the spacing of the views.
const TEXELS: usize = 8;
const VIEWS: usize = 256;

/// The greatest shininess that the views can tell from a single bright pixel: the lobe's half width at half maximum
/// is a third of the spacing between neighbouring views.
pub(super) fn sharpest(sample: &[TexelObservations]) -> f64 {
    let mut nearest: Vec<f32> = Vec::new();
    for texel in sample.iter().step_by(sample.len().div_ceil(TEXELS).max(1)) {
        for i in (0..texel.len()).step_by(texel.len().div_ceil(VIEWS).max(1)) {
            let a = texel.direction[i];
            let others = texel.direction.iter().enumerate().filter(|(j, _)| *j != i);
            nearest.extend(others.map(|(_, b)| a.distance_squared(*b)).min_by(f32::total_cmp));
        }
    }
    nearest.retain(|squared| squared.is_finite());
    if nearest.is_empty() {
        return *SHININESS.end();
    }
    let middle = nearest.len() / 2;
    let chord = f64::from(*nearest.select_nth_unstable_by(middle, f32::total_cmp).1).sqrt();
    let half_width_rad = 2.0 * (0.5 * chord).min(1.0).asin() / 3.0;
    let shininess = std::f64::consts::LN_2 / -half_width_rad.cos().ln().min(-f64::MIN_POSITIVE);
    shininess.clamp(*SHININESS.start(), *SHININESS.end())
}

/// The median over views of the mean of their channels; where most are black, the mean; 1 where all are.
pub(super) fn typical_radiance(sample: &[TexelObservations]) -> f64 {
    let mean = |[r, g, b]: &[f32; 3]| (f64::from(*r) + f64::from(*g) + f64::from(*b)) / 3.0;
    let mut all: Vec<f64> = sample.iter().flat_map(|texel| texel.radiance.iter().map(mean)).collect();
    all.retain(|value| value.is_finite());
    let average = all.iter().sum::<f64>() / all.len() as f64;
    let middle = all.len() / 2;
    let median = if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(middle, f64::total_cmp).1 };
    [median, average].into_iter().find(|value| *value > 0.0).unwrap_or(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texel(radiance: &[[f32; 3]]) -> [TexelObservations; 1] {
        [TexelObservations { radiance: radiance.to_vec(), ..TexelObservations::default() }]
    }

    #[test]
    fn a_red_surface_and_one_with_few_highlights_have_a_radiance() {
        assert!((typical_radiance(&texel(&[[0.6, 0.0, 0.0]; 9])) - 0.2).abs() < 1e-6);
        let mut mostly_black = [[0.0; 3]; 9];
        mostly_black[4] = [9.0; 3];
        assert!((typical_radiance(&texel(&mostly_black)) - 1.0).abs() < 1e-6);
        for nothing in [&[[0.0; 3]; 9][..], &[], &[[f32::NAN; 3]]] {
            assert_eq!(typical_radiance(&texel(nothing)), 1.0);
        }
    }
}

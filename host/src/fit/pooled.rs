//! Would coarser texels do? A block of texels fitted as one, against each of them fitted alone.

use super::fitter::Fitter;
use super::held_out::{deal, each_part, predict};
use crate::observation::TexelObservations;

/// Sums over a block's texels and views of the error in views that the fit has not seen, by each of `fitters`: where the block
/// is fitted as one, and where each texel is fitted alone. `None` where too few views saw all of it.
pub(super) fn errors(fitters: &[Fitter], block: &[&TexelObservations]) -> Option<Vec<[f64; 2]>> {
    let (pooled, alone) = pool(block);
    let most = fitters.iter().map(|fitter| fitter.model().unknowns()).max()?;
    // A fifth of the views is left out at a time.
    if 4 * pooled.len() < 5 * (most + 1) {
        return None;
    }
    let parts = deal(&pooled.view);
    let mut sums = vec![[0.0; 2]; fitters.len()];
    for part in each_part() {
        let of = |texel: &TexelObservations, held: bool| texel.only(|i| (parts[i] == part) == held);
        let kept: Vec<TexelObservations> =
            std::iter::once(&pooled).chain(&alone).map(|texel| of(texel, false)).collect();
        let fits = Fitter::parameters(fitters, &kept.iter().collect::<Vec<_>>());
        for (texel, index) in alone.iter().zip(1..) {
            let held = of(texel, true);
            for ((fitter, fits), sums) in fitters.iter().zip(&fits).zip(&mut sums) {
                for (sum, parameters) in sums.iter_mut().zip([&fits[0], &fits[index]]) {
                    let errors = predict(fitter, |_| parameters, &held).map(|view| view.error);
                    *sum += errors.map(f64::from).sum::<f64>();
                }
            }
        }
    }
    Some(sums)
}

/// The mean over a block of what each view measured that saw all of it, and the block's texels with these views only.
fn pool(block: &[&TexelObservations]) -> (TexelObservations, Vec<TexelObservations>) {
    let sees = |texel: &TexelObservations, view: u32| texel.view.binary_search(&view).is_ok();
    let in_all = |view: u32| block.iter().all(|texel| sees(texel, view));
    let alone: Vec<TexelObservations> =
        block.iter().map(|texel| texel.only(|i| in_all(texel.view[i]))).collect();
    let Some(first) = alone.first() else { return Default::default() };
    let (mut pooled, share) = (first.clone(), 1.0 / alone.len() as f32);
    for i in 0..pooled.len() {
        pooled.direction[i] =
            alone.iter().map(|texel| texel.direction[i]).sum::<glam::Vec3>().normalize_or_zero();
        pooled.radiance[i] =
            [0, 1, 2].map(|c| share * alone.iter().map(|texel| texel.radiance[i][c]).sum::<f32>());
        // Their noise is their own.
        let variance: f32 = alone.iter().map(|texel| texel.sigma[i].powi(2)).sum();
        pooled.sigma[i] = share * variance.sqrt();
    }
    (pooled, alone)
}

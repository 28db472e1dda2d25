//! How well models predict views that their fits have not seen.

use super::fitter::Fitter;
use crate::observation::TexelObservations;

/// The views are dealt into this many parts, each predicted from the others.
const PARTS: u8 = 5;

/// How well a view was predicted that the fit has not seen.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldOut {
    /// |prediction − measured| / (measured + floor) and 1 at most, mean of the channels: a lobe that only the views left out
    /// show is missed by all models, and by how much says nothing.
    pub error: f32,
    /// |prediction − measured| / (prediction + floor) of each channel.
    pub relative: [f32; 3],
    /// Cosine of the view's zenith.
    pub cosine: f32,
}

/// Every view of each texel as each of `fitters` predicts it from the others, a fifth of the views at a time: texel by
/// texel, fitter by fitter. `None` where the fitter needs more views. Observations that are not finite must have been left out.
pub(super) fn held_out(fitters: &[Fitter], texels: &[&TexelObservations]) -> Vec<Vec<Option<Vec<HeldOut>>>> {
    let parts: Vec<Vec<u8>> = texels.iter().map(|texel| deal(&texel.view)).collect();
    held_out_in(fitters, texels, &parts)
}

/// [`held_out`] with views dealt already: the part of each observation of each texel.
pub(super) fn held_out_in(
    fitters: &[Fitter],
    texels: &[&TexelObservations],
    parts: &[Vec<u8>],
) -> Vec<Vec<Option<Vec<HeldOut>>>> {
    let mut found: Vec<Vec<Option<Vec<HeldOut>>>> = texels
        .iter()
        .map(|texel| fitters.iter().map(|_| Some(Vec::with_capacity(texel.len()))).collect())
        .collect();
    for part in each_part() {
        let of =
            |texel: &TexelObservations, parts: &[u8], held: bool| texel.only(|i| (parts[i] == part) == held);
        let kept: Vec<_> = texels.iter().zip(parts).map(|(texel, parts)| of(texel, parts, false)).collect();
        let fits = Fitter::parameters(fitters, &kept.iter().collect::<Vec<_>>());
        for (t, (texel, parts)) in texels.iter().zip(parts).enumerate() {
            let held = of(texel, parts, true);
            if held.is_empty() {
                continue;
            }
            for (f, fitter) in fitters.iter().enumerate() {
                if kept[t].len() < fitter.model().unknowns() {
                    found[t][f] = None;
                } else if let Some(views) = &mut found[t][f] {
                    views.extend(predict(fitter, |_| &fits[f][t], &held));
                }
            }
        }
    }
    found.iter_mut().flatten().for_each(|views| *views = views.take().filter(|views| !views.is_empty()));
    found
}

/// The parts' numbers.
pub(super) fn each_part() -> std::ops::Range<u8> {
    0..PARTS
}

/// Which part each of a texel's views belongs to: neighbours, and what repeats itself, are torn apart, and the parts are
/// equally large.
pub(super) fn deal(views: &[u32]) -> Vec<u8> {
    // Steele, Lea and Flood 2014: SplitMix, the last steps.
    let shuffled = |view: u32| {
        let mut bits = (u64::from(view) + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        bits ^ (bits >> 31)
    };
    let mut order: Vec<(u64, usize)> =
        views.iter().enumerate().map(|(i, view)| (shuffled(*view), i)).collect();
    order.sort_unstable();
    let mut parts = vec![0; views.len()];
    for (rank, (_, i)) in order.into_iter().enumerate() {
        parts[i] = (rank % usize::from(PARTS)) as u8;
    }
    parts
}

/// What a fit predicts of `held`: `parameters` by the number of the view.
pub(super) fn predict<'a, 'p>(
    fitter: &'a Fitter,
    parameters: impl Fn(u32) -> &'p [f32] + 'a,
    held: &'a TexelObservations,
) -> impl Iterator<Item = HeldOut> + 'a {
    let (model, floor) = (fitter.model(), fitter.floor() as f32);
    let views = held.view.iter().zip(&held.direction).zip(&held.radiance);
    views.map(move |((view, direction), measured)| {
        let predicted = model.radiance(parameters(*view), *direction);
        let miss = |c: usize| (predicted[c] - measured[c]).abs();
        let error = |c: usize| (miss(c) / (measured[c].max(0.0) + floor)).min(1.0);
        HeldOut {
            error: (error(0) + error(1) + error(2)) / 3.0,
            relative: [0, 1, 2].map(|c| miss(c) / (predicted[c] + floor)),
            cosine: direction.z,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_are_equally_large_whichever_views_there_are() {
        let every_fifth: Vec<u32> = (0..60).step_by(5).collect();
        for views in [(0..60).collect::<Vec<_>>(), every_fifth, vec![7], vec![]] {
            let parts = deal(&views);
            let sizes: Vec<usize> =
                (0..PARTS).map(|part| parts.iter().filter(|p| **p == part).count()).collect();
            assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1, "{sizes:?}");
        }
    }

    #[test]
    fn neighbours_do_not_go_together() {
        let parts = deal(&(0..1000).collect::<Vec<_>>());
        let together = parts.windows(2).filter(|pair| pair[0] == pair[1]).count();
        assert!((150..250).contains(&together), "{together}");
        let period = parts.iter().zip(&parts[5..]).filter(|(a, b)| a == b).count();
        assert!((150..250).contains(&period), "{period}");
    }
}

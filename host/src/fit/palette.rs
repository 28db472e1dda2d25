//! Fits that many texels share: what a surface of few materials needs.

use rayon::prelude::*;

use super::evidence::{Evidence, SLACK, one_sigma};
use super::fitter::TexelFit;
use super::held_out::{HeldOut, deal, each_part, predict};
use super::selector::{Selector, ZenithRatios};
use crate::Result;
use crate::observation::TexelObservations;

/// A texel may be like another whose fit, found from that one texel alone, predicts it so much worse than its own; the fit that
/// both will share is surer.
const ALIKE: f32 = 0.1;
/// So many texels that look alike are fitted together.
const TOGETHER: usize = 12;
/// An entry serves at least this share of the surface.
const LEAST_SHARE: f64 = 0.01;
/// A palette serves at least this share of the surface, or there is none.
const LEAST_SERVED: f64 = 0.05;
/// No more entries: with the models they are told apart by one byte.
const MOST_ENTRIES: usize = 64;
/// So many views are enough to see that an entry is none for a texel: it predicts them worse by this factor.
const GLANCE: (usize, f32) = (12, 2.0);

/// Fits for texels that look alike.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Palette {
    entries: Vec<Entry>,
}

/// A fit that texels share.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Number of its model, in order of size.
    pub model: usize,
    /// The fit to some of the texels together.
    pub fit: TexelFit,
    /// Parameters of fits to the same texels without a part of the views each.
    without: Vec<Vec<f32>>,
    /// Which part each view is in, by its number.
    part: Vec<u8>,
}

impl Entry {
    /// What a fit says that has not seen this view, of whichever texel.
    fn unseen(&self, view: u32) -> &[f32] {
        let part = self.part.get(view as usize);
        part.and_then(|part| self.without.get(usize::from(*part))).unwrap_or(&self.fit.parameters)
    }
}

impl Palette {
    /// Its fits.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }
}

impl Selector {
    /// Finds which of `sample`, texels spread over the surface, look so much alike that one fit does for them: greedily, the fit
    /// that serves most of those first that no other serves. `go_on` is asked again and again.
    ///
    /// # Errors
    /// What `go_on` says.
    pub fn palette(
        &self,
        sample: &[TexelObservations],
        go_on: &(dyn Fn() -> Result<()> + Sync),
    ) -> Result<Palette> {
        let texels: Vec<TexelObservations> = sample.iter().map(|texel| texel.usable().into_owned()).collect();
        let texels: Vec<&TexelObservations> = texels.iter().filter(|texel| !texel.is_empty()).collect();
        let own = self.own(&texels, go_on)?;
        let like: Vec<Vec<usize>> = own
            .par_iter()
            .map(|candidate| {
                go_on()?;
                let Some(Own { model, parameters, .. }) = candidate else { return Ok(vec![]) };
                let serves = |i: &usize| {
                    let Some(Own { error, .. }) = &own[*i] else { return false };
                    self.error(*model, |_| parameters, texels[*i], (1.0 + ALIKE) * error).is_some()
                };
                Ok((0..texels.len()).filter(serves).collect())
            })
            .collect::<Result<_>>()?;
        let least = ((LEAST_SHARE * texels.len() as f64).ceil() as usize).max(2);
        let mut palette = Palette::default();
        let mut unserved = vec![true; texels.len()];
        let mut left: Vec<usize> = (0..texels.len()).collect();
        while palette.entries.len() < MOST_ENTRIES {
            go_on()?;
            let count = |candidate: &usize| like[*candidate].iter().filter(|i| unserved[**i]).count();
            let Some(best) = left.iter().copied().max_by_key(count).filter(|best| count(best) >= least)
            else {
                break;
            };
            left.retain(|candidate| *candidate != best);
            let members: Vec<usize> = like[best].iter().copied().filter(|i| unserved[*i]).collect();
            let step = members.len().div_ceil(TOGETHER);
            let some: Vec<&TexelObservations> = members.iter().step_by(step).map(|i| texels[*i]).collect();
            let Some(entry) = self.together(&some) else { continue };
            let is_served = |i: &usize| {
                let Some(Own { error, .. }) = &own[*i] else { return false };
                let unseen = |view| entry.unseen(view);
                unserved[*i] && self.error(entry.model, unseen, texels[*i], self.enough(*error)).is_some()
            };
            let served: Vec<usize> = (0..texels.len()).filter(is_served).collect();
            if served.len() >= least {
                served.into_iter().for_each(|i| unserved[i] = false);
                palette.entries.push(entry);
            }
        }
        let served = unserved.iter().filter(|unserved| !**unserved).count() as f64;
        Ok(if served < LEAST_SERVED * texels.len() as f64 { Palette::default() } else { palette })
    }

    /// The entry that predicts a texel best, if one does so as well as the texel's own model, whose mean error in unseen views is
    /// `own_error`.
    pub fn entry(&self, palette: &Palette, texel: &TexelObservations, own_error: f32) -> Option<usize> {
        let usable = texel.usable();
        let mut most = self.enough(own_error);
        let mut best = None;
        for (index, entry) in palette.entries.iter().enumerate() {
            if let Some(error) = self.error(entry.model, |view| entry.unseen(view), &usable, most) {
                (most, best) = (error, Some(index));
            }
        }
        best.filter(|_| !usable.is_empty() && own_error.is_finite())
    }

    /// The fit of an entry, as that of one texel, with what [`Selector::sigma`] and [`Selector::zenith_ratios`] say of a texel's
    /// own model: from fits that have not seen the view, of whichever texel.
    pub fn shared_fit(&self, entry: &Entry, texel: &TexelObservations) -> (TexelFit, f32, ZenithRatios) {
        let fitter = &self.fitters()[entry.model];
        let (residual, views) = fitter.residual_of(texel, &entry.fit.parameters);
        let usable = texel.usable();
        let predicted: Vec<HeldOut> = predict(fitter, |view| entry.unseen(view), &usable).collect();
        let sigma = one_sigma(&mut predicted.iter().flat_map(|view| view.relative).collect::<Vec<_>>());
        let ratios = ZenithRatios::of(entry.model, &predicted, sigma);
        (TexelFit { residual, views, ..entry.fit.clone() }, sigma, ratios)
    }

    /// An error that is as good as a texel's own.
    fn enough(&self, own_error: f32) -> f32 {
        ((1.0 + SLACK) * own_error).max(self.tolerance())
    }

    /// The smallest sufficient model of each texel.
    fn own(
        &self,
        texels: &[&TexelObservations],
        go_on: &(dyn Fn() -> Result<()> + Sync),
    ) -> Result<Vec<Option<Own>>> {
        let own = |texel: &&TexelObservations| {
            go_on()?;
            let evidence = Evidence::of(self.fitters(), &[texel]).pop().unwrap_or_default();
            let Some([model, _]) = evidence.choices(self.tolerance()) else { return Ok(None) };
            let parameters = self.fitters()[model].fit(texel).parameters;
            Ok(Some(Own { model, parameters, error: evidence.of[model].error }))
        };
        texels.par_iter().map(own).collect()
    }

    /// One fit for all of `texels`, by the smallest model that suffices for them together. What one view shows of all of them is
    /// left out at once: they see it from nearly the same direction.
    fn together(&self, texels: &[&TexelObservations]) -> Option<Entry> {
        let mut views: Vec<u32> = texels.iter().flat_map(|texel| texel.view.iter().copied()).collect();
        views.sort_unstable();
        views.dedup();
        let numbers = views.last()? + 1;
        let mut part = vec![0; numbers as usize];
        views.iter().zip(deal(&views)).for_each(|(view, of)| part[*view as usize] = of);
        // Each observation counts as a view of its own.
        let mut all = TexelObservations::default();
        let mut parts = vec![];
        for (first, texel) in (0..).step_by(numbers as usize).zip(texels) {
            parts.extend(texel.view.iter().map(|view| part[*view as usize]));
            all.view.extend(texel.view.iter().map(|view| first + view));
            all.direction.extend(&texel.direction);
            all.radiance.extend(&texel.radiance);
            all.sigma.extend(&texel.sigma);
        }
        let [model, _] = Evidence::in_parts(self.fitters(), &all, &parts).choices(self.tolerance())?;
        let fitter = &self.fitters()[model];
        if views.len() < fitter.model().unknowns() {
            return None;
        }
        let without =
            each_part().map(|part| fitter.fit(&all.only(|i| parts[i] != part)).parameters).collect();
        Some(Entry { model, fit: fitter.fit(&all), without, part })
    }

    /// The mean error of what a model predicts of a texel's views, as [`Evidence::errors`]; `None` above `most`.
    fn error<'a>(
        &'a self,
        model: usize,
        parameters: impl Fn(u32) -> &'a [f32] + Copy + 'a,
        texel: &TexelObservations,
        most: f32,
    ) -> Option<f32> {
        let fitter = &self.fitters()[model];
        let (few, factor) = GLANCE;
        let step = texel.len().div_ceil(few).max(1);
        let some = texel.only(|i| i % step == 0);
        let mean = |texel: &TexelObservations| {
            let errors = predict(fitter, parameters, texel).map(|view| view.error);
            errors.sum::<f32>() / texel.len() as f32
        };
        (mean(&some) <= factor * most).then(|| mean(texel)).filter(|error| *error <= most)
    }
}

/// A texel's own model.
struct Own {
    model: usize,
    parameters: Vec<f32>,
    /// Mean, in unseen views.
    error: f32,
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::fit::harmonics::HarmonicsMethod;
    use crate::fit::{FitOptions, Model, candidates};

    /// Sixty directions to zenith 60 degrees.
    fn directions() -> impl Iterator<Item = Vec3> {
        (0..60).map(|i| {
            let z = 1.0 - 0.5 * (i as f32 + 0.5) / 60.0;
            let (sine, azimuth) = ((1.0 - z * z).sqrt(), 2.4 * i as f32);
            Vec3::new(sine * azimuth.cos(), sine * azimuth.sin(), z)
        })
    }

    /// A texel of one lobe on a colour, its noise by `seed`.
    fn texel(colour: [f32; 3], shininess: f32, seed: u32) -> TexelObservations {
        let mut texel = TexelObservations::default();
        for (view, direction) in directions().enumerate() {
            let lobe = 0.5 * direction.z.powf(shininess);
            let noise = |c: u32| {
                let bits =
                    (seed * 60 + view as u32).wrapping_mul(3).wrapping_add(c).wrapping_mul(2_654_435_761);
                1.0 + 0.02 * ((bits >> 8) as f32 / 8_388_608.0 - 1.0)
            };
            texel.view.push(view as u32);
            texel.direction.push(direction);
            texel.radiance.push([0, 1, 2].map(|c| (colour[c as usize] + lobe) * noise(c)));
            texel.sigma.push(0.01);
        }
        texel
    }

    #[test]
    fn few_materials_have_an_entry_each_and_what_is_like_none_has_its_own() {
        let [red, grey] = [([0.4, 0.05, 0.05], 8.0), ([0.2, 0.2, 0.2], 20.0)];
        let sample: Vec<TexelObservations> = (0..60)
            .map(|i| match i % 3 {
                0 => texel(red.0, red.1, i),
                1 => texel(grey.0, grey.1, i),
                // No two alike.
                _ => texel([0.1 + 0.01 * i as f32, 0.3, 0.7 - 0.01 * i as f32], 5.0, i),
            })
            .collect();
        let options = FitOptions::default();
        let selector = Selector::new(&candidates(), &options, 0.0, &sample, &|| Ok(())).unwrap();
        let palette = selector.palette(&sample, &|| Ok(())).unwrap();
        assert_eq!(palette.entries().len(), 2);
        let fresh =
            [texel(red.0, red.1, 1000), texel(grey.0, grey.1, 1001), texel([0.1, 0.5, 0.1], 5.0, 1002)];
        let evidence = selector.evidence(&fresh.iter().collect::<Vec<_>>());
        let found: Vec<_> = fresh
            .iter()
            .zip(&evidence)
            .map(|(texel, evidence)| selector.entry(&palette, texel, evidence.least()))
            .collect();
        assert!(found[0].is_some() && found[1].is_some() && found[0] != found[1], "{found:?}");
        assert_eq!(found[2], None);
        // Fitted to many it is surer than to one.
        let entry = &palette.entries()[found[0].unwrap()];
        let truth = |direction: Vec3| red.0.map(|colour| colour + 0.5 * direction.z.powf(red.1));
        let error = |parameters: &[f32], model: usize| {
            let model = selector.models()[model];
            let miss = |d: Vec3| (model.radiance(parameters, d)[0] - truth(d)[0]).abs();
            directions().map(miss).sum::<f32>()
        };
        let alone = selector.own(&[&fresh[0]], &|| Ok(())).unwrap().pop().flatten().unwrap();
        assert!(error(&entry.fit.parameters, entry.model) < 0.7 * error(&alone.parameters, alone.model));
    }

    /// No lobe, and the noise of a texel in `seed`.
    fn cushion(seed: u32) -> TexelObservations {
        let mut texel = texel([0.0; 3], 8.0, seed);
        for (direction, radiance) in texel.direction.iter().zip(&mut texel.radiance) {
            let noise = radiance[1] / (0.5 * direction.z.powf(8.0));
            *radiance = [noise * (0.3 + 0.3 * direction.x * direction.y + 0.1 * direction.x); 3];
        }
        texel
    }

    #[test]
    fn harmonics_that_texels_share_are_fitted_to_all_of_them_and_say_how_sure_they_are() {
        let sample: Vec<TexelObservations> = (0..40).map(cushion).collect();
        let msh15 = Model::Harmonics { order: 5, method: HarmonicsMethod::Mirrored };
        let selector = Selector::new(&[msh15], &FitOptions::default(), 0.0, &sample, &|| Ok(())).unwrap();
        let palette = selector.palette(&sample, &|| Ok(())).unwrap();
        assert!((1..5).contains(&palette.entries().len()), "{}", palette.entries().len());
        let entry = &palette.entries()[0];
        let miss = |parameters: &[f32]| {
            let truth = |d: Vec3| 0.3 + 0.3 * d.x * d.y + 0.1 * d.x;
            let miss = |d: Vec3| (msh15.radiance(parameters, d)[0] - truth(d)).powi(2);
            directions().map(miss).sum::<f32>().sqrt()
        };
        let alone = selector.fitters()[0].fit(&sample[0]).parameters;
        assert!(
            miss(&entry.fit.parameters) < 0.6 * miss(&alone),
            "{} {}",
            miss(&entry.fit.parameters),
            miss(&alone)
        );
        // Of texels that it was not made of, in views that it was not made of.
        let fresh: Vec<TexelObservations> = (100..140).map(cushion).collect();
        let (mut inside, mut all) = (0.0, 0.0);
        let sigma = selector.shared_fit(entry, &sample[0]).1;
        for texel in &fresh {
            for view in predict(&selector.fitters()[0], |_| &entry.fit.parameters, texel) {
                inside += view.relative.iter().filter(|miss| **miss <= sigma).count() as f32;
                all += 3.0;
            }
        }
        assert!((0.5..0.85).contains(&(inside / all)), "{}", inside / all);
    }

    #[test]
    fn where_no_two_texels_are_alike_there_is_no_palette() {
        let colour = |i: u32| [0.1 + 0.02 * i as f32, 0.3, 0.9 - 0.02 * i as f32];
        let sample: Vec<TexelObservations> = (0..40).map(|i| texel(colour(i), 5.0, i)).collect();
        let selector =
            Selector::new(&candidates(), &FitOptions::default(), 0.0, &sample, &|| Ok(())).unwrap();
        assert_eq!(selector.palette(&sample, &|| Ok(())).unwrap(), Palette::default());
        let nothing = TexelObservations::default();
        assert_eq!(selector.entry(&Palette::default(), &nothing, 0.1), None);
    }
}

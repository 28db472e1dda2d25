//! The merge of a published method as radiance that the rest of the road can use: with flags, and a variance.

use rayon::prelude::*;

use super::{NoiseModel, RadianceImage, Response, Stack, merge, others};
use crate::Result;

/// Pixels and smoothness of the response with which the published map of the memorial church is met (`tests/tests/radiance.rs`).
const PIXELS: usize = 70;
const SMOOTHNESS: f64 = 10.0;

/// The response after Debevec and Malik, of one stack: [`others::debevec_response`] as their published map was made.
///
/// # Errors
/// Those of [`others::debevec_response`].
pub fn debevec_response(stack: &Stack) -> Result<Response> {
    others::debevec_response(stack, PIXELS, SMOOTHNESS)
}

/// The radiance after Debevec and Malik with the weights that made their published map ([`others::rise`]), for comparison.
///
/// The method itself states no variance and flags nothing. The variance here is that of the noise under its weights, and the square of
/// what the likeliest radiance ([`merge`]) is off it: saturated photographs count in it, and draw highlights down. The response's own
/// doubt is not in it. Flags, and infinite variances where nothing was measured, are those of [`merge`].
///
/// # Errors
/// Those of [`others::debevec_merge`] and [`merge`].
pub fn debevec(stack: &Stack, response: &Response, noise: &NoiseModel) -> Result<RadianceImage> {
    let mut radiance = others::debevec_merge(stack, response, others::rise)?;
    let mut image = merge(stack, response, noise)?;
    for ((to, from), (variance, mask)) in
        radiance.iter_mut().zip(&image.radiance).zip(image.variance.iter().zip(&image.mask))
    {
        for c in (0..3).filter(|c| mask & RadianceImage::DARK != 0 && variance[*c].is_infinite()) {
            // Levels of weight 0 say nothing: the bound that the noise tells stays.
            to[c] = from[c];
        }
    }
    let says = [0, 1, 2].map(|channel| {
        let table = response.exposure(channel);
        let say = |level: usize| Level {
            weight: others::rise(level),
            variance: noise.relative_variance(response, channel, level),
        };
        (0..table.len()).map(say).collect::<Vec<Level>>()
    });
    image.variance.par_iter_mut().enumerate().for_each(|(pixel, variance)| {
        for (c, variance) in variance.iter_mut().enumerate().filter(|(_, variance)| variance.is_finite()) {
            let levels = stack.pictures.iter().map(|picture| &says[c][usize::from(picture.levels[pixel][c])]);
            let (merged, likely) = (radiance[pixel][c], image.radiance[pixel][c]);
            *variance = merged * merged * relative_variance(levels) as f32 + (merged - likely).powi(2);
        }
    });
    Ok(RadianceImage { radiance, ..image })
}

/// What one level of one channel says.
struct Level {
    weight: f64,
    /// Relative, of the exposure.
    variance: f64,
}

/// The noise's, of exp(weighted mean).
fn relative_variance<'a>(levels: impl Iterator<Item = &'a Level>) -> f64 {
    let (total, noise) = levels.fold((0.0, 0.0), |(total, noise), level| {
        (total + level.weight, noise + level.weight.powi(2) * level.variance)
    });
    if total == 0.0 { f64::INFINITY } else { noise / (total * total) }
}

#[cfg(test)]
mod tests {
    use super::super::Samples;
    use super::super::simulated::{self, CURVES};
    use super::*;

    #[test]
    fn a_channel_that_every_photograph_shows_black_keeps_its_bound() {
        let (_, curve) = CURVES[0];
        let scene: Vec<[f64; 3]> =
            simulated::scene(128, 96, 1).into_iter().map(|[r, g, _]| [r, g, 0.0]).collect();
        let table: Vec<f32> = (0..256).map(|z| simulated::truth(curve, z) as f32).collect();
        let response = Response::from_tables([table.clone(), table.clone(), table]);
        let stack = simulated::shoot(&scene, 128, &[4.0, 1.0, 0.25], curve, 0.0, 2);
        let mut samples = Samples::default();
        samples.add(&stack).unwrap();
        let noise = samples.noise(&response);
        let ours = merge(&stack, &response, &noise).unwrap();
        let image = debevec(&stack, &response, &noise).unwrap();
        let is_black = |i: &usize| stack.pictures.iter().all(|picture| picture.levels[*i][2] == 0);
        let black: Vec<usize> = (0..scene.len()).filter(is_black).collect();
        assert!(!black.is_empty() && black.iter().all(|&i| image.radiance[i][2] == ours.radiance[i][2]));
    }

    /// Where no photograph is saturated the method is sound and its variance true; where some are, it is drawn down, and says so.
    #[test]
    fn the_variance_covers_what_the_saturated_photographs_do() {
        let (_, curve) = CURVES[0];
        let scene = simulated::scene(256, 192, 1);
        let table: Vec<f32> = (0..256).map(|z| simulated::truth(curve, z) as f32).collect();
        let response = Response::from_tables([table.clone(), table.clone(), table]);
        let unit = simulated::truth(curve, 128);
        let stack = simulated::shoot(&scene, 256, &[4.0, 2.0, 1.0, 0.5], curve, 1.0, 2);
        let mut samples = Samples::default();
        samples.add(&stack).unwrap();
        let image = debevec(&stack, &response, &samples.noise(&response)).unwrap();
        // Part within so many standard deviations, and the mean error in per cent, over a range of the longest photograph's exposure.
        let within = |sigmas: f64, range: std::ops::Range<f64>| {
            let (mut inside, mut all, mut off) = (0.0, 0.0, 0.0);
            for (i, truth) in scene.iter().enumerate().filter(|(i, _)| image.mask[*i] == 0) {
                for (c, truth) in
                    truth.iter().enumerate().filter(|(_, truth)| range.contains(&(*truth * 4.0)))
                {
                    let error = f64::from(image.radiance[i][c]) * unit / truth - 1.0;
                    let sigma = f64::from(image.variance[i][c]).sqrt() * unit / truth;
                    inside += f64::from(u8::from(error.abs() <= sigmas * sigma));
                    off += error;
                    all += 1.0;
                }
            }
            println!(
                "{range:?}: {:.1} % within {sigmas} sigma, mean error {:.2} %",
                100.0 * inside / all,
                100.0 * off / all
            );
            (inside / all, off / all)
        };
        let (sound, _) = within(1.0, 0.05..0.5);
        // Nearly all of the error is of one sign, and sigma is its size: within one it would be half of them.
        let (drawn, off) = within(1.1, 2.0..4.0);
        assert!((0.6..0.9).contains(&sound), "{sound}");
        assert!(off < -0.1 && drawn > 0.9, "{off} {drawn}");
    }
}

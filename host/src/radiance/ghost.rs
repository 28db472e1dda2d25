//! What moved while a stack was photographed.
//!
//! Single pixels beyond noise are found everywhere, for noise has tails; many of them side by side are not noise.
//! (What others do: Tursun et al., "The State of the Art in HDR Deghosting", Eurographics 2015.)

use std::collections::BTreeSet;

use rayon::prelude::*;

use super::weights::{AGREE, Channel, Measured, Says, is_filling};
use super::{Mask, RadianceImage};

/// While a picture is merged: the photographs of this pixel differ by more than noise.
pub(super) const ODD: Mask = 128;
/// An odd pixel is a ghost where at least so many pixels are odd within so far of it, itself included: the corner of a
/// square that moved has nine.
const REACH: usize = 2;
const LEAST: usize = 8;
/// A pixel that is not odd is a ghost where so many of its eight neighbours are: by chance it looks alike before and after.
const SURROUNDED: usize = 5;
/// Means are taken for cells of so many pixels a side and so far around their middle, about a block of JPEG's; by how much
/// two photographs' must differ beyond noise, relative.
const CELL: usize = 4;
const MEAN_REACH: usize = 4;
const COHERENT: f32 = 0.05;

/// Turns the pixels marked [`ODD`] into ghosts or forgives them. `pictures` and `channels`: the longest exposure first.
pub(super) fn settle(image: &mut RadianceImage, pictures: &[&[[u16; 3]]], channels: &[Channel; 3]) {
    let (width, height) = (image.width as usize, image.height as usize);
    let odd: Vec<usize> = (0..image.mask.len()).filter(|&i| image.mask[i] & ODD != 0).collect();
    let around = |i: usize, reach: usize| {
        let (x, y) = (i % width, i / width);
        let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
        (y.saturating_sub(reach)..(y + reach + 1).min(height))
            .flat_map(move |row| columns.clone().map(move |column| row * width + column))
    };
    let mask = &image.mask;
    let crowded = |&i: &usize| around(i, REACH).filter(|&k| mask[k] & ODD != 0).count() >= LEAST;
    let crowded: Vec<usize> = odd.iter().copied().filter(crowded).collect();
    // Means are compared once for the pixels of a cell.
    let cell = |i: usize| (i / width / CELL, i % width / CELL);
    let cells: BTreeSet<(usize, usize)> = crowded.iter().map(|&i| cell(i)).collect();
    let differing: BTreeSet<(usize, usize)> = cells
        .into_par_iter()
        .filter(|&(row, column)| {
            let (y, x) = (row * CELL + CELL / 2, column * CELL + CELL / 2);
            let near: Vec<usize> = around(y.min(height - 1) * width + x.min(width - 1), MEAN_REACH).collect();
            differ(&near, pictures, channels)
        })
        .collect();
    let mut ghosts: Vec<usize> = crowded.into_iter().filter(|&i| differing.contains(&cell(i))).collect();
    odd.iter().for_each(|&i| image.mask[i] &= !ODD);
    ghosts.iter().for_each(|&i| image.mask[i] |= RadianceImage::GHOST);
    let mask = &image.mask;
    let is_ghost = |i: usize| mask[i] & RadianceImage::GHOST != 0;
    let inside: BTreeSet<usize> = ghosts
        .iter()
        .flat_map(|&i| around(i, 1))
        .filter(|&i| !is_ghost(i) && around(i, 1).filter(|&k| is_ghost(k)).count() >= SURROUNDED)
        .collect();
    ghosts.extend(inside);
    let measured: Vec<[Measured; 3]> = ghosts.par_iter().map(|&i| agreed(i, pictures, channels)).collect();
    for (i, measured) in ghosts.into_iter().zip(measured) {
        image.mask[i] = measured.iter().fold(RadianceImage::GHOST, |mask, m| mask | m.flags);
        image.radiance[i] = measured.map(|m| m.radiance);
        image.variance[i] = measured.map(|m| m.variance);
    }
}

/// What most photographs say of a pixel; of infinite variance where no majority agrees.
fn agreed(i: usize, pictures: &[&[[u16; 3]]], channels: &[Channel; 3]) -> [Measured; 3] {
    let levels: Vec<[u16; 3]> = pictures.iter().map(|picture| picture[i]).collect();
    let (agreeing, most) = majority(&levels, channels);
    [0, 1, 2].map(|c| {
        let measured = channels[c].careful(agreeing.iter().copied(), |j| levels[j][c], |_| true);
        let variance = if most { measured.variance } else { f32::INFINITY };
        Measured { variance, ..measured }
    })
}

/// Whether photographs differ in their means over some pixels: what JPEG adds at edges goes up and down and leaves the
/// mean alone, what moves does not. Photographs next to each other in time are compared over the pixels that both measure, or
/// that one measures and the other bounds: a bound that is kept says nothing, one that is broken says by how much at least.
fn differ(near: &[usize], pictures: &[&[[u16; 3]]], channels: &[Channel; 3]) -> bool {
    let pair = |a: usize, b: usize, c: usize| {
        let (mut sums, mut variance, mut count) = ([0.0; 2], 0.0, 0);
        for &i in near.iter().filter(|&&i| ![a, b].iter().any(|&j| is_filling(channels, pictures[j][i]))) {
            let (one, other) =
                (channels[c].says(a, pictures[a][i][c]), channels[c].says(b, pictures[b][i][c]));
            let kept = one.agrees_with(other);
            let (x, y, v) = match (one, other) {
                (Says::Value(x, vx), Says::Value(y, vy)) => (x, y, vx + vy),
                (Says::Value(x, v), Says::AtLeast(y) | Says::AtMost(y)) => (x, if kept { x } else { y }, v),
                (Says::AtLeast(x) | Says::AtMost(x), Says::Value(y, v)) => (if kept { y } else { x }, y, v),
                (Says::AtLeast(x), Says::AtMost(y)) | (Says::AtMost(x), Says::AtLeast(y)) if !kept => {
                    (x, y, 0.0)
                }
                _ => continue,
            };
            sums = [sums[0] + x, sums[1] + y];
            variance += v;
            count += 1;
        }
        2 * count > near.len()
            && (sums[0] - sums[1]).abs() > AGREE * variance.sqrt() + COHERENT * sums[0].min(sums[1])
    };
    (1..pictures.len()).any(|b| (0..3).any(|c| pair(b - 1, b, c)))
}

/// The largest set of photographs that agree with one of them, and whether they are most of those that measure the pixel.
fn majority(levels: &[[u16; 3]], channels: &[Channel; 3]) -> (Vec<usize>, bool) {
    let says: Vec<[Says; 3]> = levels
        .iter()
        .enumerate()
        .map(|(j, level)| [0, 1, 2].map(|c| channels[c].says(j, level[c])))
        .collect();
    let measures = |j: &usize| says[*j].iter().any(|s| matches!(s, Says::Value(..)));
    let agreeing = |a: usize| -> Vec<usize> {
        (0..says.len()).filter(|&b| (0..3).all(|c| says[a][c].agrees_with(says[b][c]))).collect()
    };
    let count = |set: &[usize]| set.iter().filter(|j| measures(j)).count();
    // Of sets of one size that of the longest exposure, which has the least noise.
    let best =
        (0..says.len()).filter(measures).map(agreeing).rev().max_by_key(|set| count(set)).unwrap_or_default();
    let (agree, all) = (count(&best), (0..says.len()).filter(measures).count());
    (best, agree >= 2 && 2 * agree > all)
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{self, CURVES};
    use super::super::{NoiseModel, Response, Samples, Stack, merge};
    use super::*;

    const WIDTH: usize = 256;
    const TIMES: [f64; 5] = [4.0, 2.0, 1.0, 0.5, 0.25];

    fn learnt(stack: &Stack) -> (Response, NoiseModel) {
        let mut samples = Samples::default();
        samples.add(stack).unwrap();
        let response = samples.response().unwrap();
        let noise = samples.noise(&response);
        (response, noise)
    }

    fn part(mask: &[Mask]) -> f64 {
        mask.iter().filter(|&&m| m & RadianceImage::GHOST != 0).count() as f64 / mask.len() as f64
    }

    #[test]
    fn noise_alone_is_no_ghost() {
        for (seed, (_, curve)) in CURVES.iter().enumerate() {
            for times in [&TIMES[..], &[8.0, 1.0, 0.125]] {
                let scene = simulated::scene(WIDTH, 192, seed as u64);
                let stack = simulated::shoot(&scene, WIDTH, times, *curve, 1.0, 7);
                let (response, noise) = learnt(&stack);
                let part = part(&merge(&stack, &response, &noise).unwrap().mask);
                assert!(part < 1e-3, "{part}");
            }
        }
    }

    /// A square of side 24 that is `factor` times as bright as what it hides, in one photograph.
    fn with_a_patch(stack: &Stack, other: &Stack, photograph: usize) -> (Stack, Vec<usize>) {
        let inside: Vec<usize> = (0..24 * 24).map(|i| (80 + i / 24) * WIDTH + 100 + i % 24).collect();
        let mut moved = stack.clone();
        for &i in &inside {
            moved.pictures[photograph].levels[i] = other.pictures[photograph].levels[i];
        }
        (moved, inside)
    }

    #[test]
    fn a_patch_that_moved_is_found_and_the_others_measure_what_is_behind_it() {
        let (_, curve) = CURVES[0];
        let scene = vec![[0.06; 3]; WIDTH * 192];
        let bright: Vec<[f64; 3]> = scene.iter().map(|rgb| rgb.map(|r| 1.4 * r)).collect();
        let still = simulated::shoot(&scene, WIDTH, &TIMES, curve, 1.0, 3);
        let other = simulated::shoot(&bright, WIDTH, &TIMES, curve, 1.0, 4);
        let (response, noise) =
            learnt(&simulated::shoot(&simulated::scene(WIDTH, 192, 1), WIDTH, &TIMES, curve, 1.0, 5));
        let before = merge(&still, &response, &noise).unwrap();
        for photograph in 0..3 {
            let (moved, inside) = with_a_patch(&still, &other, photograph);
            let merged = merge(&moved, &response, &noise).unwrap();
            let found = inside.iter().filter(|&&i| merged.mask[i] & RadianceImage::GHOST != 0).count();
            assert!(found * 100 > inside.len() * 95, "photograph {photograph}: {found} of {}", inside.len());
            let outside = part(&merged.mask) * merged.mask.len() as f64 - found as f64;
            assert!(outside <= 60.0, "photograph {photograph}: {outside}");
            // What is left of the patch is less than noise.
            let mut measured = 0;
            for &i in &inside {
                for c in 0..3 {
                    if merged.variance[i][c].is_finite() {
                        measured += 1;
                        let sigma = (merged.variance[i][c] + before.variance[i][c]).sqrt();
                        let off = (merged.radiance[i][c] - before.radiance[i][c]).abs();
                        assert!(off < 5.0 * sigma, "photograph {photograph}: {off} {sigma}");
                    }
                }
            }
            assert!(measured > 2 * inside.len(), "{measured}");
        }
    }

    #[test]
    fn two_photographs_that_contradict_each_other_measure_nothing() {
        let (_, curve) = CURVES[0];
        let times = [1.0, 0.5];
        let shoot = |radiance: f64, seed| {
            simulated::shoot(&[[radiance; 3]; WIDTH * 192], WIDTH, &times, curve, 1.0, seed)
        };
        let (response, noise) =
            learnt(&simulated::shoot(&simulated::scene(WIDTH, 192, 1), WIDTH, &times, curve, 1.0, 5));
        let (moved, inside) = with_a_patch(&shoot(0.2, 1), &shoot(0.4, 2), 1);
        let merged = merge(&moved, &response, &noise).unwrap();
        for &i in &inside {
            assert_eq!(merged.mask[i], RadianceImage::GHOST);
            assert!(merged.variance[i].iter().all(|v| v.is_infinite()));
        }
    }

    #[test]
    fn an_object_that_saturates_or_blackens_one_photograph_is_a_ghost() {
        let (_, curve) = CURVES[0];
        let times = [1.0, 0.5];
        let shoot = |radiance: f64, seed| {
            simulated::shoot(&[[radiance; 3]; WIDTH * 192], WIDTH, &times, curve, 1.0, seed)
        };
        let (response, noise) =
            learnt(&simulated::shoot(&simulated::scene(WIDTH, 192, 1), WIDTH, &times, curve, 1.0, 5));
        // The surface, the object, and the photograph that the object is in: saturated, black, and a hand before a highlight that the
        // longer photograph saturates.
        for (surface, object, photograph) in
            [(0.2, 50.0, 0), (0.2, 0.0, 1), (0.2, 0.0, 0), (1.3, 0.2, 1), (50.0, 0.0, 0)]
        {
            let (moved, inside) = with_a_patch(&shoot(surface, 1), &shoot(object, 2), photograph);
            let merged = merge(&moved, &response, &noise).unwrap();
            let found = inside.iter().filter(|&&i| merged.mask[i] & RadianceImage::GHOST != 0).count();
            assert!(found * 100 > inside.len() * 95, "{surface} {object} {photograph}: {found}");
            for &i in inside.iter().filter(|&&i| merged.mask[i] & RadianceImage::GHOST != 0) {
                assert!(
                    merged.variance[i].iter().all(|v| v.is_infinite()),
                    "{surface} {object} {photograph}"
                );
            }
            let outside = part(&merged.mask) * merged.mask.len() as f64 - found as f64;
            assert!(outside <= 60.0, "{surface} {object} {photograph}: {outside}");
        }
    }
}

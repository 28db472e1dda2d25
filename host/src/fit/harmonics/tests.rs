//! Properties of the bases and of the fits on them.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use nalgebra::{DMatrix, DVector};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::observation::TexelObservations;

const PLAIN: Weighing = Weighing { relative_error: 0.0, floor: 1e-4, robust: false };
const GOOD: [HarmonicsMethod; 2] = [HarmonicsMethod::Mirrored, HarmonicsMethod::Hemispherical];

/// Spread evenly down to `zenith_max_rad`.
fn cap(count: usize, zenith_max_rad: f64) -> Vec<DVec3> {
    let within = |z: f64| 1.0 - (1.0 - z) * (1.0 - zenith_max_rad.cos());
    hemisphere(count)
        .map(|d| {
            let z = within(d.z);
            let wide = DVec3::new(d.x, d.y, 0.0).normalize_or_zero() * (1.0 - z * z).sqrt();
            DVec3::new(wide.x, wide.y, z)
        })
        .collect()
}

fn normal(random: &mut StdRng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

/// A lobe on a constant, its axis within 60 degrees of the normal.
fn lobe(random: &mut StdRng, shininess: f64, base: f64) -> impl Fn(DVec3) -> f64 + use<> {
    let (z, azimuth) = (0.5 + 0.5 * random.random::<f64>(), 2.0 * PI * random.random::<f64>());
    let s = (1.0 - z * z).sqrt();
    let axis = DVec3::new(s * azimuth.cos(), s * azimuth.sin(), z);
    move |d| base + 0.7 * axis.dot(d).max(0.0).powf(shininess)
}

/// Seen with 1 % and 0.002 of noise by `views`; `shift` turns the directions as for a texel that lies that far off, in
/// units of the distance.
fn observe(
    views: &[DVec3],
    shift: DVec3,
    truth: impl Fn(DVec3) -> f64,
    random: &mut StdRng,
) -> TexelObservations {
    let mut texel = TexelObservations::default();
    for (view, centre) in views.iter().enumerate() {
        let direction = (*centre - shift).normalize();
        let seen = truth(direction);
        let sigma = (0.01 * seen).hypot(0.002);
        texel.view.push(view as u32);
        texel.direction.push(direction.as_vec3());
        texel.radiance.push([1.0, 0.8, 0.5].map(|c| (c * (seen + sigma * normal(random))) as f32));
        texel.sigma.push(sigma as f32);
    }
    texel
}

#[test]
fn the_hemispheres_functions_are_orthogonal_on_it_and_as_many_as_their_indices() {
    for (method, own) in [(HarmonicsMethod::Mirrored, 0.5), (HarmonicsMethod::Hemispherical, 1.0)] {
        for order in method.orders() {
            let k = method.count(order);
            assert_eq!(method.basis().indices(usize::from(order)).count(), k);
            let (mut gram, mut row, count) = (DMatrix::zeros(k, k), DVector::zeros(k), 20_000);
            for direction in hemisphere(count) {
                method.basis().at(usize::from(order), direction, row.as_mut_slice());
                gram.ger(2.0 * PI / count as f64, &row, &row, 1.0);
            }
            let worst = (gram - own * DMatrix::<f64>::identity(k, k)).amax();
            assert!(worst < 3e-3, "{method:?} {order}: {worst}");
        }
    }
}

#[test]
fn mirrored_harmonics_are_those_spherical_ones_that_are_even_in_z() {
    let (mut all, mut even) = (vec![0.0; 169], vec![0.0; 91]);
    for direction in hemisphere(50) {
        Basis::Sphere.at(13, direction, &mut all);
        Basis::Mirrored.at(13, direction, &mut even);
        for ((l, m), value) in Basis::Mirrored.indices(13).zip(&even) {
            let same = all[(l * (l + 1) + m) as usize];
            assert!((value - same).abs() < 1e-10, "l {l} m {m}: {value}, not {same}");
        }
    }
}

/// The promise of the search: what sharing a tile's system costs is a small part of what the noise costs.
#[test]
fn a_tile_is_fitted_as_each_of_its_texels_alone() {
    let mut random = StdRng::seed_from_u64(1);
    let views = cap(150, 1.3);
    // Half of the tile is a shiny material; far apart texels need a direction each, near ones share theirs.
    for (spacing, allowed) in [(0.02, 0.25), (2e-4, 0.35)] {
        let weighing = Weighing { relative_error: 0.03, floor: 0.02, robust: false };
        let texels: Vec<_> = (0..24)
            .map(|i| {
                let truth = lobe(&mut random, if i < 12 { 3.0 } else { 12.0 }, 0.3);
                let shift = DVec3::new(spacing * f64::from(i), 0.0, 0.0);
                // Some views are missing, others in each texel.
                let missing: Vec<u32> = (0..150).filter(|view| (view * 7 + i) % 9 == 0).collect();
                observe(&views, shift, truth, &mut random).without(&missing)
            })
            .collect();
        for method in GOOD {
            let order = method.orders()[1];
            let smooth = Smooth::new(method, order, Some(1e-5), weighing, &texels);
            let fits = smooth.fit_tile(&texels.iter().collect::<Vec<_>>());
            for (fit, texel) in fits.iter().zip(&texels) {
                assert!(fit.converged);
                let alone = smooth.fit_directly(texel).unwrap();
                let (mut apart, mut noise) = (0.0, 0.0);
                for direction in &texel.direction {
                    let direction = direction.as_dvec3();
                    let [a, b] = [&fit.parameters, &alone].map(|p| method.radiance(order, p, direction)[0]);
                    apart += (a - b).powi(2);
                    noise += fit.sigma(direction)[0].powi(2);
                }
                let share = (apart / noise).sqrt();
                assert!(share < allowed, "{method:?}, {spacing} apart: {share} of the noise");
            }
        }
    }
}

#[test]
fn no_radiance_is_negative_where_nothing_was_measured_or_all_is_dark() {
    let mut random = StdRng::seed_from_u64(2);
    let everywhere: Vec<_> = hemisphere(4000).collect();
    for method in GOOD {
        for order in method.orders() {
            let mut held = 0;
            let views = cap(120, 1.1);
            let texels: Vec<_> = (0..16)
                .map(|i| {
                    let shininess = [2.0, 15.0, 60.0, 200.0][i % 4];
                    let truth = lobe(&mut random, shininess, if i < 8 { 0.01 } else { 0.1 });
                    observe(&views, DVec3::ZERO, truth, &mut random)
                })
                .collect();
            let smooth = Smooth::new(method, order, Some(1e-9), PLAIN, &texels);
            for (fit, texel) in smooth.fit_tile(&texels.iter().collect::<Vec<_>>()).iter().zip(&texels) {
                held += usize::from(fit.held);
                let mean = texel.radiance.iter().map(|l| f64::from(l[0])).sum::<f64>() / 120.0;
                let lowest = everywhere
                    .iter()
                    .map(|d| method.radiance(order, &fit.parameters, *d)[0])
                    .fold(f64::INFINITY, f64::min);
                assert!(lowest >= 0.0, "{method:?} {order}: {lowest} where the mean is {mean}");
            }
            assert!(held > 0, "{method:?} {order}: nothing had to be held, so nothing was tested");
        }
    }
}

/// The design's table: 289 views that end at zenith 75 degrees.
#[test]
fn noise_is_not_amplified_where_nothing_was_measured() {
    let mut random = StdRng::seed_from_u64(3);
    let views = cap(289, 73.5_f64.to_radians());
    let texels: Vec<_> =
        (0..16).map(|_| observe(&views, DVec3::ZERO, lobe(&mut random, 15.0, 0.3), &mut random)).collect();
    for method in GOOD {
        let order = method.orders()[3];
        let stability = Smooth::new(method, order, None, PLAIN, &texels).stability(&views);
        assert!(stability.noise_gain <= 1.0 && stability.condition < 1e4, "{method:?}: {stability:?}");
        // Plain least squares on the same views is what the penalties are for.
        let plain = Smooth::new(method, order, Some(0.0), PLAIN, &texels).stability(&views);
        assert!(plain.noise_gain > 2.0 * stability.noise_gain, "{method:?}: {plain:?} without penalties");
    }
    // Where everything was measured there is no hole to bridge.
    let smooth = Smooth::new(HarmonicsMethod::Mirrored, 8, Some(1e-30), PLAIN, &texels);
    let everywhere = Smooth::new(
        HarmonicsMethod::Mirrored,
        8,
        Some(1e-30),
        PLAIN,
        &[observe(&hemisphere(289).collect::<Vec<_>>(), DVec3::ZERO, |_| 1.0, &mut random)],
    );
    assert!(everywhere.prior.norm() < 0.1 * smooth.prior.norm());
}

#[test]
fn the_predicted_standard_deviation_holds_the_truth_as_often_as_it_says() {
    let mut random = StdRng::seed_from_u64(4);
    let views = cap(200, 1.3);
    let weighing = Weighing { relative_error: 0.0, floor: 0.002, robust: false };
    let truths: Vec<_> = (0..48).map(|_| lobe(&mut random, 4.0, 0.3)).collect();
    let texels: Vec<_> =
        truths.iter().map(|truth| observe(&views, DVec3::ZERO, truth, &mut random)).collect();
    let smooth = Smooth::new(HarmonicsMethod::Mirrored, 11, None, weighing, &texels);
    let (mut within, mut all) = (0, 0);
    for (fit, truth) in smooth.fit_tile(&texels.iter().collect::<Vec<_>>()).iter().zip(&truths) {
        for direction in cap(40, 1.25) {
            let got = HarmonicsMethod::Mirrored.radiance(11, &fit.parameters, direction);
            let sigma = fit.sigma(direction);
            within += usize::from((got[0] - truth(direction)).abs() <= sigma[0]);
            all += 1;
        }
    }
    let share = f64::from(within as u32) / f64::from(all);
    assert!((0.6..0.8).contains(&share), "{share} of the truths are within one standard deviation");
}

#[test]
fn wrong_missing_and_infinite_observations_do_no_harm() {
    let mut random = StdRng::seed_from_u64(5);
    let views = cap(100, 1.3);
    let weighing = Weighing { relative_error: 0.03, floor: 0.02, robust: true };
    let good = observe(&views, DVec3::ZERO, |d| 0.3 + 0.2 * d.x, &mut random);
    let mut passer_by = good.clone();
    passer_by.radiance[37] = [5.0; 3];
    let mut broken = good.clone();
    broken.radiance[3] = [f32::NAN, 1.0, 1.0];
    broken.sigma[4] = f32::NAN;
    broken.radiance[5] = [f32::INFINITY; 3];
    broken.direction[6] = Vec3::NAN;
    let empty = TexelObservations::default();
    let one = good.without(&(1..100).collect::<Vec<_>>());
    for method in GOOD {
        let order = method.orders()[1];
        let smooth = Smooth::new(method, order, None, weighing, std::slice::from_ref(&good));
        let fits = smooth.fit_tile(&[&good, &passer_by, &broken, &empty, &one]);
        assert_eq!(fits.iter().map(|fit| fit.views).collect::<Vec<_>>(), [100, 100, 96, 0, 1]);
        assert!(fits.iter().all(|fit| fit.parameters.iter().all(|value| value.is_finite())));
        assert!(fits[3].parameters.iter().all(|value| *value == 0.0));
        for direction in cap(30, 1.2) {
            let seen = |fit: &SmoothFit| method.radiance(order, &fit.parameters, direction)[0];
            let clean = seen(&fits[0]);
            assert!((seen(&fits[1]) - clean).abs() < 0.02, "{method:?}: {} for {clean}", seen(&fits[1]));
            assert!((seen(&fits[2]) - clean).abs() < 0.01, "{method:?}: {} for {clean}", seen(&fits[2]));
        }
        assert!(smooth.fit_tile(&[]).is_empty());
        assert_eq!(smooth.fit_tile(&[&empty])[0].views, 0);
    }
}

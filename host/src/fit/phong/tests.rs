//! The loops against plain arithmetic, the derivatives against differences, the covariance against repeated fits, the
//! verdict on both sides of its break.

use glam::{DVec3, Vec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::lanes::{self, Lane};
use super::refine::{Place, TERMS, lane_lobe, turns};
use super::views::Views;
use super::{Lobe, PhongFit, PhongOptions, fit, refit};
use crate::observation::TexelObservations;

const OPTIONS: PhongOptions = PhongOptions {
    lobes: 1,
    shared_shininess: false,
    shininess_max: 2000.0,
    relative_error: 0.01,
    floor: 0.002,
    robust: false,
    identified: Some(0.95),
    identified_only: false,
};

/// Directions spread evenly over the hemisphere.
fn directions(count: usize) -> Vec<Vec3> {
    let golden = std::f64::consts::PI * (1.0 + 5.0_f64.sqrt());
    let direction = |i: usize| {
        let (z, azimuth) = (1.0 - (i as f64 + 0.5) / count as f64, golden * (i as f64 + 0.5));
        let s = (1.0 - z * z).sqrt();
        DVec3::new(s * azimuth.cos(), s * azimuth.sin(), z).as_vec3()
    };
    (0..count).map(direction).collect()
}

/// Diffuse, and lobes of radiance, shininess and direction, with `noise` times 1 % and 0.002 of noise.
fn observe(
    directions: &[Vec3],
    lobes: &[([f64; 3], f64, DVec3)],
    noise: f64,
    random: &mut StdRng,
) -> TexelObservations {
    let mut texel = TexelObservations::default();
    let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    for (index, direction) in directions.iter().enumerate() {
        let mut radiance = [0.3, 0.2, 0.1];
        for (strength, shininess, lobe) in lobes {
            let value = direction.as_dvec3().dot(lobe.normalize()).max(0.0).powf(*shininess);
            radiance.iter_mut().zip(strength).for_each(|(radiance, strength)| *radiance += strength * value);
        }
        let noisy = radiance.map(|l| (l * (1.0 + 0.01 * noise * normal()) + 0.002 * noise * normal()) as f32);
        texel.view.push(index as u32);
        texel.direction.push(*direction);
        texel.radiance.push(noisy);
        texel.sigma.push(0.0);
    }
    texel
}

const STRONG: [f64; 3] = [0.5, 0.7, 0.4];

fn lobe(fit: &PhongFit, l: usize) -> (f64, DVec3) {
    let at = |i: usize| f64::from(fit.parameters[3 + 7 * l + i]);
    (at(3), DVec3::new(at(4), at(5), at(6)))
}

fn right(fit: &PhongFit, l: usize, shininess: f64, direction: DVec3) -> bool {
    let found = lobe(fit, l);
    found.1.angle_between(direction) < 1.0_f64.to_radians() && (found.0 / shininess - 1.0).abs() < 0.2
}

/// What [`Place`] has summed, view by view in double precision.
fn plain(texel: &TexelObservations, lobe: &Lobe, linear: &[[f64; TERMS]; 3], views: &Views) -> [[f64; 8]; 8] {
    let turns = turns(lobe.direction);
    let mut gram = [[0.0; 8]; 8];
    for i in 0..texel.direction.len() {
        let direction = texel.direction[i].as_dvec3();
        let radiance = texel.radiance[i].map(f64::from);
        let sum: f64 = radiance.iter().sum();
        let root = views.error * views.unit / (OPTIONS.relative_error * sum / 3.0).hypot(OPTIONS.floor);
        let cosine = direction.dot(lobe.direction);
        let mut row = [0.0; 8];
        row[0] = 1.0;
        if cosine > 0.0 {
            let value = cosine.powf(lobe.shininess);
            row[1] = value;
            row[2] = lobe.shininess * cosine.ln() * value;
            row[3] = lobe.shininess * value / cosine * direction.dot(turns[0]);
            row[4] = lobe.shininess * value / cosine * direction.dot(turns[1]);
        }
        for c in 0..3 {
            row[5 + c] = radiance[c] / views.unit - linear[c][0] - linear[c][1] * row[1];
        }
        for a in 0..8 {
            for b in 0..8 {
                gram[a][b] += root * root * row[a] * row[b];
            }
        }
    }
    gram
}

#[test]
fn sums_in_lanes_are_those_of_plain_arithmetic() {
    let mut random = StdRng::seed_from_u64(1);
    // Neither a multiple of the lanes nor less than one chunk of them.
    for count in [13, 61, 333] {
        let texel =
            observe(&directions(count), &[(STRONG, 30.0, DVec3::new(0.4, 0.1, 0.9))], 1.0, &mut random);
        let mut views = Views::default();
        views.fill(&texel, OPTIONS.relative_error, OPTIONS.floor);
        let lobe = Lobe { direction: DVec3::new(0.45, 0.1, 0.9).normalize(), shininess: 25.0 };
        let mut linear = [[0.0; TERMS]; 3];
        for (c, values) in linear.iter_mut().enumerate() {
            values[..2].copy_from_slice(&[0.25, 0.1 + 0.25 * c as f64]);
        }
        let want = plain(&texel, &lobe, &linear, &views);
        let place = Place::<1, 3, 8>::new(&mut views, [lobe], &linear);
        for i in 0..5 {
            for j in 0..5 {
                let scale = (want[i][i] * want[j][j]).sqrt();
                assert!((place.gram[i][j] - want[i][j]).abs() < 2e-6 * scale, "{count}: {i} {j}");
            }
        }
        for (got, want) in place.gram.iter().zip(&want).enumerate().skip(5).map(|(i, (a, b))| (a[i], b[i])) {
            assert!((got - want).abs() < 1e-5 * want, "{count}: residual {got} {want}");
        }
    }
}

#[test]
fn derivatives_are_the_limits_of_differences() {
    let texel = observe(&directions(40), &[], 0.0, &mut StdRng::seed_from_u64(2));
    let mut views = Views::default();
    views.fill(&texel, 0.0, 1.0);
    let at = |direction: DVec3, shininess: f64| -> Vec<f64> {
        let lobe = Lobe { direction: direction.normalize(), shininess };
        let mut rows: Vec<[Lane; 1]> = vec![[[0.0; lanes::WIDTH]]; views.blocks.len()];
        lanes::values(&views.blocks, &lane_lobe(&lobe, &turns(lobe.direction)), &mut rows, 0);
        rows.as_flattened().as_flattened().iter().map(|value| f64::from(*value)).collect()
    };
    for shininess in [1.5, 12.0, 90.0] {
        let lobe = Lobe { direction: DVec3::new(0.3, -0.4, 0.8).normalize(), shininess };
        let turns = turns(lobe.direction);
        let mut rows: Vec<[Lane; 4]> = vec![[[0.0; lanes::WIDTH]; 4]; views.blocks.len()];
        lanes::columns(&views.blocks, &lane_lobe(&lobe, &turns), &mut rows, 0, 1);
        let h = 2e-3 / shininess.sqrt();
        let pairs = [
            (at(lobe.direction, shininess * h.exp()), at(lobe.direction, shininess * (-h).exp())),
            (at(lobe.direction + turns[0] * h, shininess), at(lobe.direction - turns[0] * h, shininess)),
            (at(lobe.direction + turns[1] * h, shininess), at(lobe.direction - turns[1] * h, shininess)),
        ];
        for (column, (after, before)) in pairs.iter().enumerate() {
            let derived = rows.iter().flat_map(|row| row[1 + column]);
            for (i, (got, (after, before))) in derived.zip(after.iter().zip(before)).enumerate() {
                let want = (after - before) / (2.0 * h);
                assert!(
                    (f64::from(got) - want).abs() < 2e-3 * shininess.sqrt(),
                    "{shininess} {column} {i}: {got} {want}"
                );
            }
        }
    }
}

#[test]
fn the_covariance_is_that_of_400_fits() {
    let (directions, truth) = (directions(120), DVec3::new(0.4, 0.2, 0.8));
    let mut random = StdRng::seed_from_u64(3);
    let toward =
        [truth.normalize(), DVec3::new(0.7, 0.2, 0.7).normalize(), DVec3::new(-0.5, 0.5, 0.5).normalize()];
    let (mut logs, mut radiance, mut predicted) = (Vec::new(), vec![Vec::new(); 3], Vec::new());
    for _ in 0..400 {
        let texel = observe(&directions, &[([0.2, 0.25, 0.15], 25.0, truth)], 2.0, &mut random);
        let fit = fit(&texel, &OPTIONS);
        let covariance = fit.covariance.as_ref().unwrap();
        let (shininess, direction) = lobe(&fit, 0);
        logs.push([shininess.ln(), direction.dot(turns(truth.normalize())[0]), covariance.lobe(0).1]);
        for (all, toward) in radiance.iter_mut().zip(toward) {
            let value = direction.dot(toward).max(0.0).powf(shininess);
            all.push(f64::from(fit.parameters[1]) + f64::from(fit.parameters[4]) * value);
        }
        predicted.push(toward.map(|toward| fit.sigma(toward)[1]));
    }
    let spread = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt()
    };
    let shininess = spread(&logs.iter().map(|log| log[0]).collect::<Vec<_>>());
    let said = logs.iter().map(|log| log[2]).sum::<f64>() / 400.0;
    assert!((said / shininess - 1.0).abs() < 0.15, "log shininess: {said} said, {shininess} found");
    for (i, all) in radiance.iter().enumerate() {
        let (found, said) = (spread(all), predicted.iter().map(|p| p[i]).sum::<f64>() / 400.0);
        assert!((said / found - 1.0).abs() < 0.2, "toward {}: {said} said, {found} found", toward[i]);
    }
}

#[test]
fn a_lobe_is_identified_where_views_are_dense_and_not_where_it_is_sharper_than_their_spacing() {
    let mut random = StdRng::seed_from_u64(4);
    let truth = DVec3::new(0.4, 0.25, 0.87);
    let broad = fit(&observe(&directions(289), &[(STRONG, 60.0, truth)], 1.0, &mut random), &OPTIONS);
    assert!(broad.identified && broad.right[0] > 0.99 && right(&broad, 0, 60.0, truth), "{:?}", broad.right);
    // Half width 1.5 degrees, 8 degrees between views: a bright view or two say nothing of it.
    for view in [40, 90, 140] {
        let truth = directions(289)[view].as_dvec3() + DVec3::new(0.01, 0.005, 0.0);
        let sharp = fit(&observe(&directions(289), &[(STRONG, 2000.0, truth)], 1.0, &mut random), &OPTIONS);
        assert!(!sharp.identified && sharp.right.len() == 1, "{:?} {:?}", sharp.right, sharp.parameters);
    }
}

#[test]
fn a_lobe_outside_the_photographed_cone_is_not_identified_and_falls_back() {
    let mut random = StdRng::seed_from_u64(5);
    let cone: Vec<Vec3> = directions(900).into_iter().filter(|d| d.z > 0.85).collect();
    let options = PhongOptions { identified_only: true, ..OPTIONS };
    let outside = DVec3::new(0.95, 0.0, 0.3);
    let texel = observe(&cone, &[(STRONG, 12.0, outside)], 1.0, &mut random);
    assert!(!fit(&texel, &OPTIONS).identified);
    let fallen = fit(&texel, &options);
    assert!(!fallen.identified && fallen.parameters[3..6] == [0.0; 3], "{:?}", fallen.parameters);
    let inside = DVec3::new(0.2, 0.0, 0.9);
    let kept = fit(&observe(&cone, &[(STRONG, 40.0, inside)], 1.0, &mut random), &options);
    assert!(kept.identified && right(&kept, 0, 40.0, inside));
}

/// The verdict's promise, on lobes of which views see much, little and nothing.
#[test]
fn of_lobes_reported_as_identified_nearly_all_are_right() {
    let mut random = StdRng::seed_from_u64(6);
    let directions = directions(70);
    let (mut reported, mut wrong, mut all) = (0, 0, 0);
    for _ in 0..400 {
        let shininess = (2.0_f64.ln() + random.random::<f64>() * 500.0_f64.ln()).exp();
        let (z, azimuth) =
            (0.5 + 0.5 * random.random::<f64>(), std::f64::consts::TAU * random.random::<f64>());
        let s = (1.0 - z * z).sqrt();
        let truth = DVec3::new(s * azimuth.cos(), s * azimuth.sin(), z);
        let strength = [(); 3].map(|()| 0.02 + 0.5 * random.random::<f64>());
        let fit = fit(&observe(&directions, &[(strength, shininess, truth)], 1.0, &mut random), &OPTIONS);
        all += usize::from(!fit.right.is_empty() && right(&fit, 0, shininess, truth));
        if fit.identified && !fit.right.is_empty() {
            reported += 1;
            wrong += usize::from(!right(&fit, 0, shininess, truth));
        }
    }
    assert!(wrong * 50 <= reported && reported * 100 >= 80 * all, "{wrong} of {reported} wrong, {all} right");
}

#[test]
fn three_and_four_lobes_are_found_and_one_shininess_is_shared_where_asked() {
    let mut random = StdRng::seed_from_u64(7);
    let directions = directions(400);
    let lobes = [
        ([0.5, 0.5, 0.4], 40.0, DVec3::new(0.6, 0.0, 0.8)),
        ([0.4, 0.3, 0.4], 40.0, DVec3::new(-0.5, 0.5, 0.7)),
        ([0.3, 0.3, 0.2], 40.0, DVec3::new(-0.1, -0.6, 0.8)),
        ([0.2, 0.2, 0.2], 40.0, DVec3::new(0.0, 0.1, 1.0)),
    ];
    for count in [3, 4] {
        let texel = observe(&directions, &lobes[..count], 1.0, &mut random);
        for shared_shininess in [false, true] {
            let fit = fit(&texel, &PhongOptions { lobes: count, shared_shininess, ..OPTIONS });
            assert!(fit.identified && fit.right.len() == count, "{:?}", fit.right);
            for (_, shininess, direction) in &lobes[..count] {
                let direction = direction.normalize();
                assert!((0..count).any(|l| right(&fit, l, *shininess, direction)), "{:?}", fit.parameters);
            }
            let first = lobe(&fit, 0).0;
            let same = (1..count).all(|l| lobe(&fit, l).0 == first);
            assert_eq!(same, shared_shininess);
        }
    }
}

#[test]
fn a_refit_from_the_truth_is_the_fit() {
    let truth = DVec3::new(0.4, 0.25, 0.87).normalize();
    let texel = observe(&directions(200), &[(STRONG, 35.0, truth)], 1.0, &mut StdRng::seed_from_u64(8));
    let [x, y, z] = truth.as_vec3().to_array();
    let again = refit(&texel, &[0.3, 0.2, 0.1, 0.5, 0.7, 0.4, 35.0, x, y, z], &OPTIONS);
    for (a, b) in again.parameters.iter().zip(fit(&texel, &OPTIONS).parameters) {
        assert!((a - b).abs() < 2e-3 * a.abs().max(0.1), "{a} {b}");
    }
}

/// Whatever is observed: within bounds, finite, and radiance not negative.
#[test]
fn parameters_stay_within_bounds() {
    let mut random = StdRng::seed_from_u64(9);
    for round in 0..300 {
        let count = 1 + random.random_range(0..40);
        let mut texel = TexelObservations::default();
        let scale = 10.0_f32.powi(random.random_range(-30..30));
        for view in 0..count {
            let direction =
                Vec3::new(random.random::<f32>() - 0.5, random.random::<f32>() - 0.5, random.random());
            let spiky = if random.random_range(0..10) == 0 { 1e4 } else { 1.0 };
            let value = || random.random::<f32>() * 1.1 - 0.1;
            let mut value = value;
            texel.view.push(view);
            texel.direction.push(if round % 7 == 0 { Vec3::Z } else { direction.normalize_or(Vec3::Z) });
            texel.radiance.push([value() * spiky * scale, value() * scale, value() * scale]);
            texel.sigma.push(value().abs() * scale * 0.01);
        }
        if round % 5 == 0 {
            texel.radiance[0][1] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][round % 3];
        }
        for (lobes, shared_shininess, robust) in [(1, false, true), (2, true, false), (4, false, true)] {
            let floor = 0.01 * f64::from(scale);
            let options =
                PhongOptions { lobes, shared_shininess, robust, floor, shininess_max: 300.0, ..OPTIONS };
            let fit = fit(&texel, &options);
            assert_eq!(fit.parameters.len(), 3 + 7 * lobes);
            assert!(fit.parameters.iter().all(|value| value.is_finite()), "{round}: {:?}", fit.parameters);
            assert!(fit.residual.is_finite(), "{round}");
            assert!(fit.parameters[..3].iter().all(|value| *value >= 0.0));
            for lobe in fit.parameters[3..].chunks_exact(7) {
                assert!(lobe[..3].iter().all(|value| *value >= 0.0) && lobe[6] >= 0.0, "{round}: {lobe:?}");
                assert!((1.0..=300.0).contains(&lobe[3]), "{round}: {lobe:?}");
                assert!(
                    (Vec3::new(lobe[4], lobe[5], lobe[6]).length() - 1.0).abs() < 1e-5,
                    "{round}: {lobe:?}"
                );
            }
            assert!(fit.right.iter().all(|right| (-1e-6..=1.0 + 1e-6).contains(right)), "{:?}", fit.right);
        }
    }
}

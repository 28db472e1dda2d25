//! The lights of maps whose lamps are known.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use glam::{DVec2, DVec3};
use rigel::environment::{EnvironmentMap, Lights, Method, Remainder, lights};
use rigel::geometry::LatLong;

const MOST: usize = 64;
const JOINED: Method = Method::Joined(Remainder::MOST_ORDER);

/// Radiance by direction.
fn map(rows: u32, radiance: impl Fn(DVec3) -> [f32; 3]) -> EnvironmentMap {
    let size = LatLong::new(2 * rows, rows).unwrap();
    let at = |i: usize| DVec2::new((i % size.width()) as f64, (i / size.width()) as f64);
    let radiance = (0..size.count()).map(|i| radiance(size.direction(at(i)))).collect();
    EnvironmentMap {
        size,
        radiance,
        variance: vec![],
        coverage: vec![],
        flags: vec![],
        unit: Default::default(),
        curve: vec![],
    }
}

fn direction(longitude_deg: f64, latitude_deg: f64) -> DVec3 {
    let (sin, cos) = longitude_deg.to_radians().sin_cos();
    let (up, level) = latitude_deg.to_radians().sin_cos();
    DVec3::new(sin * level, up, cos * level)
}

/// A disk of half this angle.
fn is_in(d: DVec3, centre: DVec3, radius_deg: f64) -> bool {
    d.dot(centre) > radius_deg.to_radians().cos()
}

fn disk_sr(radius_deg: f64) -> f64 {
    std::f64::consts::TAU * (1.0 - radius_deg.to_radians().cos())
}

fn found(map: &EnvironmentMap, method: Method, tolerance: f64) -> Lights {
    let found = lights(map, method, tolerance, MOST).unwrap();
    println!("{method:?}: {} lights, {:.2} % off", found.lights.len(), 100.0 * found.error);
    found
}

#[test]
fn a_white_furnace_needs_no_light() {
    let found = found(&map(64, |_| [1.0, 2.0, 3.0]), JOINED, 0.01);
    assert!(found.lights.is_empty() && found.error < 3e-3, "{}", found.error);
    for (c, expected) in [1.0, 2.0, 3.0].into_iter().enumerate() {
        assert!((found.remainder.radiance(DVec3::X)[c] / expected - 1.0).abs() < 3e-3);
    }
}

#[test]
fn one_lamp_is_one_light_where_it_is_as_large_and_as_bright_wherever_it_hangs() {
    for (longitude, latitude) in [(20.0, 30.0), (179.9, -10.0), (-60.0, 82.0)] {
        let lamp = direction(longitude, latitude);
        let map = map(512, |d| if is_in(d, lamp, 3.0) { [100.0, 90.0, 50.0] } else { [0.5, 0.5, 0.5] });
        let found = found(&map, JOINED, 0.03);
        assert_eq!(found.lights.len(), 1);
        let light = &found.lights[0];
        assert!(light.direction.angle_between(lamp).to_degrees() < 0.1);
        assert!((light.solid_angle_sr / disk_sr(3.0) - 1.0).abs() < 0.02, "{}", light.solid_angle_sr);
        let expected = [99.5, 89.5, 49.5].map(|radiance| radiance * disk_sr(3.0));
        for (own, expected) in light.irradiance.iter().zip(expected) {
            assert!((own / expected - 1.0).abs() < 0.02, "{own} {expected}");
        }
        assert!(!light.is_lower_bound && found.error < 0.03);
        assert!(found.csv().lines().count() == 3);
    }
}

/// Brighter toward one side and above, with a horizon, and nothing that is a lamp.
fn sky(d: DVec3) -> [f32; 3] {
    let up = 1.0 / (1.0 + (-12.0 * d.y).exp());
    let side = 0.6 + 0.3 * d.x + 0.1 * (5.0 * d.z).sin();
    [0.5, 0.7, 1.0].map(|colour| (0.15 + colour * up * side) as f32)
}

#[test]
fn a_smooth_sky_needs_no_light_and_more_that_are_allowed_make_nothing_worse() {
    let map = map(128, sky);
    let of = |tolerance: f64, most: usize| lights(&map, JOINED, tolerance, most).unwrap();
    let enough = of(0.05, MOST);
    assert!(enough.lights.is_empty() && enough.worst() <= 0.05, "{}", enough.worst());
    for tolerance in [0.0, 0.01, 0.05] {
        let mut before = f64::INFINITY;
        for most in [1, 2, 3, 5, 8, 16, 40] {
            let found = of(tolerance, most);
            println!(
                "{tolerance}, at most {most}: {} lights, open {:.2} %, with walls {:.2} %",
                found.lights.len(),
                100.0 * found.open_error,
                100.0 * found.error
            );
            assert!(found.lights.len() <= most && found.worst() <= before);
            before = found.worst();
            // With one less than were found it is worse, and worse than asked for.
            if found.lights.len() > 1 {
                let fewer = of(tolerance, found.lights.len() - 1);
                assert!(fewer.worst() > found.worst() && fewer.worst() > tolerance);
            }
        }
    }
}

/// Lamps of unlike power, a window, and a floor darker than the ceiling.
fn room(d: DVec3) -> [f32; 3] {
    let lamps = [(10.0, 60.0, 4.0, 80.0), (150.0, 40.0, 3.0, 120.0), (-100.0, 20.0, 2.0, 60.0)];
    for (longitude, latitude, radius, radiance) in lamps {
        if is_in(d, direction(longitude, latitude), radius) {
            return [radiance; 3];
        }
    }
    let window = direction(-30.0, 5.0);
    if is_in(d, window, 12.0) {
        return [8.0, 10.0, 14.0];
    }
    [(0.6 + 0.3 * d.y) as f32; 3]
}

#[test]
fn fewer_lights_than_by_median_cut_do_for_a_room() {
    let map = map(256, room);
    let (ours, cut) = (found(&map, JOINED, 0.05), found(&map, Method::MedianCut, 0.05));
    // The lamps and the window; what is wide and dim the rest may take.
    assert!(ours.error <= 0.05 && (3..=4).contains(&ours.lights.len()));
    assert!(cut.error > 0.05 || cut.lights.len() >= 16);
}

#[test]
fn a_closer_tolerance_needs_no_fewer_lights_and_none_is_lost() {
    let map = map(256, room);
    let mut before = 0;
    for tolerance in [0.3, 0.1, 0.05] {
        let found = found(&map, JOINED, tolerance);
        assert!(found.lights.len() >= before);
        before = found.lights.len();
        let size = map.size;
        let all: f64 = (0..size.count())
            .map(|i| size.solid_angle(i / size.width()) * f64::from(map.radiance[i][1]))
            .sum();
        let kept = found.lights.iter().map(|light| light.irradiance[1]).sum::<f64>()
            + found.remainder.coefficients()[0][1] * (4.0 * std::f64::consts::PI).sqrt();
        assert!((kept / all - 1.0).abs() < tolerance, "{kept} {all}");
    }
}

#[test]
fn saturated_lamps_are_lower_bounds_and_darkness_is_an_error() {
    let lamp = direction(0.0, 45.0);
    let mut bright = map(128, |d| if is_in(d, lamp, 4.0) { [50.0; 3] } else { [0.1; 3] });
    bright.flags =
        bright.radiance.iter().map(|p| if p[0] > 1.0 { EnvironmentMap::LOWER_BOUND } else { 0 }).collect();
    assert!(found(&bright, JOINED, 0.05).lights[0].is_lower_bound);
    let message = lights(&map(32, |_| [0.0; 3]), JOINED, 0.05, MOST).unwrap_err().to_string();
    assert!(message.contains("no light") && message.contains("; "), "{message}");
    // Too few allowed: the best of that many, and what they leave.
    let few = lights(&map(128, room), JOINED, 0.001, 2).unwrap();
    assert!(few.lights.len() <= 2 && few.error > 0.001);
}

/// The irradiance's error on orientations that were not looked at when the lights were chosen, from every pixel of the map.
fn error_on_other_orientations(map: &EnvironmentMap, found: &Lights) -> f64 {
    let size = map.size;
    let pixels: Vec<(DVec3, [f64; 3])> = (0..size.count())
        .map(|i| {
            let (column, row) = (i % size.width(), i / size.width());
            let angle = size.solid_angle(row);
            let light = map.radiance[i].map(|value| angle * f64::from(value));
            (size.direction(DVec2::new(column as f64, row as f64)), light)
        })
        .collect();
    let (mut off, mut all) = (0.0, 0.0);
    for k in 0..50 {
        let normal = direction(f64::from(k) * 137.5, (f64::from(2 * k) / 50.0 - 0.98).asin().to_degrees());
        let mut truth = [0.0; 3];
        for (to, light) in &pixels {
            let cosine = to.dot(normal).max(0.0);
            (0..3).for_each(|c| truth[c] += cosine * light[c]);
        }
        for (own, truth) in found.irradiance(normal).into_iter().zip(truth) {
            assert!(own >= 0.0);
            off += (own - truth).powi(2);
            all += truth * truth;
        }
    }
    (off / all).sqrt()
}

#[test]
fn sixteen_lights_and_a_smooth_remainder_light_all_orientations_of_rooms() {
    let mut maps = vec![("simulated", map(256, room))];
    for name in ["studio.hdr", "workshop.hdr", "StageEnvLatLong.exr"] {
        let Some(path) = rigel_tests::data(&format!("environment/{name}")) else { return };
        maps.push((name, EnvironmentMap::read(&path).unwrap()));
    }
    for (name, map) in &maps {
        for method in [Method::MedianCut, JOINED] {
            let found = lights(map, method, 0.0, 16).unwrap();
            let other = error_on_other_orientations(map, &found);
            println!(
                "{name}, {method:?}: {} lights, order {}, open {:.2} % ({:.2} % on other orientations), with walls {:.2} %",
                found.lights.len(),
                found.remainder.order(),
                100.0 * found.open_error,
                100.0 * other,
                100.0 * found.error
            );
            assert!((other - found.open_error).abs() < 0.005);
            if method == JOINED {
                assert!(found.lights.len() <= 16 && other < 0.03);
            }
        }
    }
}

#[test]
fn the_smallest_remainder_that_suffices_is_taken_and_written_to_the_table() {
    let lamp = direction(30.0, 40.0);
    // A constant, a slope, and what only a quadratic tells.
    let rest: [fn(DVec3) -> f64; 3] = [|_| 1.0, |d| 1.0 + 0.9 * d.y, |d| 0.3 + 2.0 * d.x * d.x];
    for (order, rest) in rest.into_iter().enumerate() {
        let lit = map(128, |d| [if is_in(d, lamp, 3.0) { 200.0 } else { rest(d) as f32 }; 3]);
        let found = found(&lit, JOINED, 0.03);
        assert_eq!((found.remainder.order(), found.lights.len()), (order, 1));
        assert_eq!(found.csv().lines().count(), 2 + (order + 1) * (order + 1));
    }
}

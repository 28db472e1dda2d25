//! The lights of maps whose lamps are known.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use glam::{DVec2, DVec3};
use rigel::environment::{EnvironmentMap, Lights, Method, lights};
use rigel::geometry::LatLong;

const MOST: usize = 64;

/// Radiance by direction.
fn map(rows: u32, radiance: impl Fn(DVec3) -> [f32; 3]) -> EnvironmentMap {
    let size = LatLong::new(2 * rows, rows).unwrap();
    let at = |i: usize| DVec2::new((i % size.width()) as f64, (i / size.width()) as f64);
    let radiance = (0..size.count()).map(|i| radiance(size.direction(at(i)))).collect();
    EnvironmentMap { size, radiance, variance: vec![], coverage: vec![], flags: vec![] }
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
    let found = found(&map(64, |_| [1.0, 2.0, 3.0]), Method::Joined, 0.01);
    assert!(found.lights.is_empty() && found.error < 1e-3);
    for (c, expected) in [1.0, 2.0, 3.0].into_iter().enumerate() {
        assert!((found.ambient[c] / expected - 1.0).abs() < 1e-3);
    }
}

#[test]
fn one_lamp_is_one_light_where_it_is_as_large_and_as_bright_wherever_it_hangs() {
    for (longitude, latitude) in [(20.0, 30.0), (179.9, -10.0), (-60.0, 82.0)] {
        let lamp = direction(longitude, latitude);
        let map = map(512, |d| if is_in(d, lamp, 3.0) { [100.0, 90.0, 50.0] } else { [0.5, 0.5, 0.5] });
        let found = found(&map, Method::Joined, 0.03);
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
    let (ours, cut) = (found(&map, Method::Joined, 0.1), found(&map, Method::MedianCut, 0.1));
    // The lamps and the window.
    assert!(ours.error <= 0.1 && ours.lights.len() == 4);
    assert!(cut.error > 0.1 || cut.lights.len() >= 16);
}

#[test]
fn a_closer_tolerance_needs_no_fewer_lights_and_none_is_lost() {
    let map = map(256, room);
    let mut before = 0;
    for tolerance in [0.3, 0.1, 0.05, 0.02] {
        let found = found(&map, Method::Joined, tolerance);
        assert!(found.lights.len() >= before);
        before = found.lights.len();
        let size = map.size;
        let all: f64 = (0..size.count())
            .map(|i| size.solid_angle(i / size.width()) * f64::from(map.radiance[i][1]))
            .sum();
        let kept = found.lights.iter().map(|light| light.irradiance[1]).sum::<f64>()
            + found.ambient[1] * 4.0 * std::f64::consts::PI;
        assert!((kept / all - 1.0).abs() < 1e-3, "{kept} {all}");
    }
}

#[test]
fn saturated_lamps_are_lower_bounds_and_darkness_is_an_error() {
    let lamp = direction(0.0, 45.0);
    let mut bright = map(128, |d| if is_in(d, lamp, 4.0) { [50.0; 3] } else { [0.1; 3] });
    bright.flags =
        bright.radiance.iter().map(|p| if p[0] > 1.0 { EnvironmentMap::LOWER_BOUND } else { 0 }).collect();
    assert!(found(&bright, Method::Joined, 0.05).lights[0].is_lower_bound);
    let message = lights(&map(32, |_| [0.0; 3]), Method::Joined, 0.05, MOST).unwrap_err().to_string();
    assert!(message.contains("no light") && message.contains("; "), "{message}");
    // Too few allowed: the best of that many, and what they leave.
    let few = lights(&map(128, room), Method::Joined, 0.001, 2).unwrap();
    assert!(few.lights.len() == 2 && few.error > 0.001);
}

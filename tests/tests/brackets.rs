//! Rooms photographed with exposure brackets: the map holds their power, and where no exposure is short enough it says so.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use rigel::environment::{
    EnvironmentMap, Light, Method, Mosaic, Options, Remainder, Shot, Shots, Unit, lights, mosaic,
};
use rigel::geometry::{Lens, world_from_camera};
use rigel::progress::Silent;

/// Times alone are stated.
const UNIT: Unit = Unit::Saturation { iso: false, f_number: false };

/// Photographs of a map all around, each direction with all exposure times: 8 bits, sRGB, with shot noise and a dark one.
fn photographs(folder: &Path, room: &EnvironmentMap, times_s: &[f64]) -> Shots {
    let lens = Lens::pinhole(256, 192, 180.0);
    let mut turns = vec![];
    for (pitch, count) in [(-75.0f64, 3), (-40.0, 8), (0.0, 9), (40.0, 8), (75.0, 3)] {
        for i in 0..count {
            let yaw = std::f64::consts::TAU * (f64::from(i) + 0.3) / f64::from(count);
            turns.push(world_from_camera(
                DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch.to_radians()),
            ));
        }
    }
    let shot = |number: usize| {
        let (turn, time_s) = (turns[number / times_s.len()], times_s[number % times_s.len()]);
        let mut random = StdRng::seed_from_u64(number as u64);
        let path = folder.join(format!("{number:03}.png"));
        let picture = image::RgbImage::from_fn(lens.width, lens.height, |x, y| {
            let direction = turn * lens.unproject(DVec2::new(f64::from(x), f64::from(y))).unwrap();
            image::Rgb(room.toward(direction).0.map(|radiance| {
                let exposure = radiance * time_s;
                // About 10,000 electrons at white; the sum of four is as good as normal.
                let normal: f64 = (0..4).map(|_| random.random_range(-0.866..0.866)).sum();
                let sigma = (exposure.min(1.0) / 1e4 + 2e-4f64.powi(2)).sqrt();
                let exposure = (exposure + sigma * normal).clamp(0.0, 1.0);
                let encoded = if exposure <= 0.0031308 {
                    12.92 * exposure
                } else {
                    1.055 * exposure.powf(1.0 / 2.4) - 0.055
                };
                (255.0 * encoded).round() as u8
            }))
        });
        picture.save(&path).unwrap();
        Shot { path, world_from_camera: turn, sigma_rad: Some(1e-4), exposure: Some(time_s) }
    };
    let shots = (0..turns.len() * times_s.len()).into_par_iter().map(shot).collect();
    Shots { shots, lens: Some(lens), tracker: None, unit: UNIT }
}

fn made(room: &EnvironmentMap, times_s: &[f64]) -> Mosaic {
    let folder = tempfile::tempdir().unwrap();
    let options = Options { sigma_rad: 0.035, refine: false, ..Options::new(room.size) };
    mosaic(&photographs(folder.path(), room, times_s), &options, &Silent).unwrap()
}

/// Irradiance from everywhere within an angle of a direction.
fn power(map: &EnvironmentMap, about: DVec3, angle_deg: f64) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (i, radiance) in map.radiance.iter().enumerate() {
        let (column, row) = (i % map.size.width(), i / map.size.width());
        if map.size.direction(DVec2::new(column as f64, row as f64)).angle_between(about).to_degrees()
            <= angle_deg
        {
            (0..3).for_each(|c| sum[c] += map.size.solid_angle(row) * f64::from(radiance[c]));
        }
    }
    sum
}

fn brightest(map: &EnvironmentMap) -> (usize, DVec3) {
    let sum = |i: &usize| map.radiance[*i].iter().sum::<f32>();
    let at = (0..map.size.count()).max_by(|a, b| sum(a).total_cmp(&sum(b))).unwrap();
    (at, map.size.direction(DVec2::new((at % map.size.width()) as f64, (at / map.size.width()) as f64)))
}

#[test]
fn a_room_seen_through_brackets_keeps_its_power_and_that_of_its_lamp() {
    for name in ["studio.hdr", "workshop.hdr"] {
        let Some(path) = rigel_tests::data(&format!("environment/{name}")) else { return };
        let room = EnvironmentMap::read(&path).unwrap();
        // Each eight times as long as the one before; the shortest does not saturate on the brightest lamp.
        let times_s = [0.125f64.powi(4), 0.125f64.powi(3), 0.125f64.powi(2), 0.125, 1.0, 8.0];
        let made = made(&room, &times_s);
        let (_, lamp) = brightest(&room);
        for (what, angle_deg, most) in [("all", 180.0, 0.02), ("lamp", 5.0, 0.05)] {
            let (own, truth) = (power(&made.map, lamp, angle_deg), power(&room, lamp, angle_deg));
            let off = [0, 1, 2].map(|c| own[c] / truth[c] - 1.0);
            println!(
                "{name}, {what}: {:.2} {:.2} {:.2} % off",
                100.0 * off[0],
                100.0 * off[1],
                100.0 * off[2]
            );
            assert!(off.iter().all(|off| off.abs() < most), "{name} {what} {off:?}");
        }
        let bounds = made.map.flags.iter().filter(|flag| **flag & EnvironmentMap::LOWER_BOUND != 0).count();
        println!("{name}: {bounds} pixels are lower bounds");
    }
}

#[test]
fn a_lamp_that_saturates_every_exposure_is_a_lower_bound() {
    let Some(path) = rigel_tests::data("environment/studio.hdr") else { return };
    let room = EnvironmentMap::read(&path).unwrap();
    let made = made(&room, &[0.125f64.powi(2), 0.125, 1.0, 8.0]);
    let (at, lamp) = brightest(&room);
    assert_eq!(made.map.flags[at], EnvironmentMap::LOWER_BOUND);
    let (own, truth) = (power(&made.map, lamp, 5.0)[1], power(&room, lamp, 5.0)[1]);
    assert!(own < truth, "{own} {truth}");
    // What was measured is right all the same.
    let (mut own, mut truth) = (0.0, 0.0);
    for i in (0..room.size.count()).filter(|&i| made.map.flags[i] == 0 && room.radiance[i][1] < 30.0) {
        let angle = room.size.solid_angle(i / room.size.width());
        own += angle * f64::from(made.map.radiance[i][1]);
        truth += angle * f64::from(room.radiance[i][1]);
    }
    println!("measured: {:.2} % off", 100.0 * (own / truth - 1.0));
    assert!((own / truth - 1.0).abs() < 0.02);
    let found = lights(&made.map, Method::Joined(Remainder::MOST_ORDER), 0.03, 16).unwrap();
    // What saturates looks alike however bright it is, so that the brightest of the room need not be the first found.
    let apart_deg = |light: &&Light| light.direction.angle_between(lamp).to_degrees();
    let nearest = found.lights.iter().min_by(|a, b| apart_deg(a).total_cmp(&apart_deg(b))).unwrap();
    println!("{:.1} degrees from the lamp: {nearest:?}", apart_deg(&nearest));
    assert!(nearest.is_lower_bound && apart_deg(&nearest) < 5.0);
}

//! A map is brought up to date by photographs of a part of the room.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use rigel::environment::{EnvironmentMap, MergeOptions, Options, Shot, Shots, Unit, Updated, mosaic, update};
use rigel::geometry::{LatLong, Lens, world_from_camera};
use rigel::progress::Silent;

/// Times alone are stated.
const UNIT: Unit = Unit::Saturation { iso: false, f_number: false };

/// What is to be seen in a direction, 0.15 to 0.75.
fn wall(d: DVec3) -> f64 {
    let wave = |by: f64, x: f64| (by * x).sin();
    0.45 + 0.1 * wave(9.0, d.x + 0.3 * d.z) + 0.1 * wave(11.0, d.y) + 0.1 * wave(23.0, d.z - d.x * d.y)
}

fn map(seen: impl Fn(DVec3) -> bool) -> EnvironmentMap {
    map_of(256, seen)
}

fn map_of(rows: u32, seen: impl Fn(DVec3) -> bool) -> EnvironmentMap {
    let size = LatLong::new(2 * rows, rows).unwrap();
    let at = |i: usize| size.direction(DVec2::new((i % size.width()) as f64, (i / size.width()) as f64));
    let flags: Vec<u8> =
        (0..size.count()).map(|i| if seen(at(i)) { 0 } else { EnvironmentMap::UNSEEN }).collect();
    let radiance = (0..size.count()).map(|i| if flags[i] == 0 { [wall(at(i)) as f32; 3] } else { [0.0; 3] });
    EnvironmentMap {
        size,
        radiance: radiance.collect(),
        variance: vec![1e-5; size.count()],
        coverage: vec![3; size.count()],
        flags,
        unit: UNIT,
        curve: vec![],
    }
}

/// Five photographs of the part before the camera, told to be turned by `off_rad` about the vertical from what they are.
fn photographs(folder: &Path, radiance: impl Fn(DVec3) -> [f64; 3], off_rad: f64) -> Shots {
    let lens = Lens::pinhole(320, 240, 240.0);
    let shot = |i: usize| {
        let yaw = 0.35 * (i as f64 - 2.0);
        let turn = world_from_camera(DQuat::from_rotation_y(yaw));
        let time_s = [0.5, 1.0][i % 2];
        let path = folder.join(format!("{i}.png"));
        let picture = image::RgbImage::from_fn(lens.width, lens.height, |x, y| {
            let direction = turn * lens.unproject(DVec2::new(f64::from(x), f64::from(y))).unwrap();
            image::Rgb(radiance(direction).map(|radiance| {
                let x = (radiance * time_s).min(1.0);
                (255.0 * if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }).round()
                    as u8
            }))
        });
        picture.save(&path).unwrap();
        let world_from_camera = DQuat::from_rotation_y(off_rad) * turn;
        Shot { path, world_from_camera, sigma_rad: Some(0.02), exposure: Some(time_s) }
    };
    Shots { shots: (0..5).map(shot).collect(), lens: Some(lens), tracker: None, unit: UNIT }
}

fn made(map: &EnvironmentMap, shots: &Shots, refine: bool) -> rigel::Result<Updated> {
    let options = Options {
        sigma_rad: 0.035,
        refine,
        merge: MergeOptions { feather: 2, disagreement: Some(0.1) },
        ..Options::new(map.size)
    };
    update(map, shots, &options, 0.02, &Silent)
}

#[test]
fn a_change_of_light_is_found_for_the_whole_room_with_its_sigma() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(|_| true);
    let truth = [0.8, 0.7, 0.6];
    let shots = photographs(folder.path(), |d| truth.map(|factor| factor * wall(d)), 0.0);
    let made = made(&map, &shots, false).unwrap();
    println!(
        "{:?} ± {:?}, {:.3} overlap, {:.4} replaced",
        made.factor, made.sigma, made.overlap, made.replaced
    );
    assert!(made.is_changed && made.overlap > 0.1 && made.replaced < 0.002 && made.gained == 0.0);
    for (c, truth) in truth.into_iter().enumerate() {
        assert!((made.factor[c] / truth - 1.0).abs() < 3.0 * made.sigma[c] && made.sigma[c] < 0.05);
        assert!((made.factor[c] / truth - 1.0).abs() < 0.02);
    }
    // Also where no new photograph was taken: behind.
    let behind = 128 * 512 + 256;
    assert!(
        (f64::from(made.map.radiance[behind][0] / map.radiance[behind][0]) / made.factor[0] - 1.0).abs()
            < 1e-5
    );
}

#[test]
fn below_the_threshold_nothing_changes_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let map = map(|_| true);
    let shots = photographs(folder.path(), |d| [1.01 * wall(d); 3], 0.0);
    let made = made(&map, &shots, false).unwrap();
    println!("{:?} ± {:?}, {:.4} replaced", made.factor, made.sigma, made.replaced);
    assert!(!made.is_changed && made.replaced == 0.0);
    assert_eq!(made.map, map);
}

#[test]
fn what_has_changed_by_itself_is_replaced_and_what_was_unknown_added() {
    let folder = tempfile::tempdir().unwrap();
    let (picture, hole) = (DVec3::new(0.3, 0.1, -1.0).normalize(), DVec3::new(-0.4, 0.0, -1.0).normalize());
    let map = map(|d| d.angle_between(hole) > 0.1);
    let radiance = |d: DVec3| [if d.angle_between(picture) < 0.15 { 0.08 } else { wall(d) }; 3];
    let made = made(&map, &photographs(folder.path(), radiance, 0.0), false).unwrap();
    let disk = |angle: f64| 0.5 * (1.0 - angle.cos());
    println!(
        "{:.5} of {:.5} replaced, {:.5} of {:.5} gained",
        made.replaced,
        disk(0.15),
        made.gained,
        disk(0.1)
    );
    assert!(!made.is_changed);
    assert!((0.8..1.4).contains(&(made.replaced / disk(0.15))), "{}", made.replaced);
    assert!((made.gained / disk(0.1) - 1.0).abs() < 0.05);
    assert!(made.map.flags.iter().all(|flag| *flag == 0));
    for (at, truth) in [(picture, 0.08), (hole, wall(hole))] {
        assert!((made.map.toward(at).0[1] / truth - 1.0).abs() < 0.1, "{truth}");
    }
}

#[test]
fn photographs_that_are_a_degree_off_are_turned_to_the_map() {
    let folder = tempfile::tempdir().unwrap();
    // Also where rows are no multiple of blocks.
    for rows in [256, 250, 100] {
        let map = map_of(rows, |_| true);
        let made = made(&map, &photographs(folder.path(), |d| [wall(d); 3], 0.02), true).unwrap();
        let sigma = made.turned_sigma_rad.unwrap();
        println!("{rows}: turned by {:.4} ± {sigma:.4}, {:.4} replaced", made.turned_rad, made.replaced);
        assert!((made.turned_rad - 0.02).abs() < 0.004 && !made.is_changed && made.replaced < 0.001);
        assert!((made.turned_rad - 0.02).abs() < 3.0 * sigma && sigma < 0.006);
    }
    // And where there are fewer rows than blocks.
    let small =
        made(&map_of(50, |_| true), &photographs(folder.path(), |d| [wall(d); 3], 0.02), true).unwrap();
    println!("50: turned by {:.4} ± {:?}", small.turned_rad, small.turned_sigma_rad);
    assert!((small.turned_rad - 0.02).abs() < 3.0 * small.turned_sigma_rad.unwrap());
}

#[test]
fn a_lamp_that_was_switched_off_leaves_what_the_photographs_show() {
    let folder = tempfile::tempdir().unwrap();
    let mut map = map(|_| true);
    let lamp = DVec3::new(0.2, 0.1, -1.0).normalize();
    let at = |i: usize| DVec2::new((i % 512) as f64, (i / 512) as f64);
    let off = |i: usize| LatLong::new(512, 256).unwrap().direction(at(i)).angle_between(lamp);
    // With a glow around it that goes with it.
    for i in 0..map.radiance.len() {
        let own = if off(i) < 0.06 {
            40.0
        } else if off(i) < 0.12 {
            3.5
        } else {
            0.0
        };
        map.radiance[i] = map.radiance[i].map(|wall| wall + own);
    }
    // It shows the wall then, or is as black as its room.
    for dark in [1.0, 0.0] {
        let truth = |d: DVec3| wall(d) * if d.angle_between(lamp) < 0.06 { dark } else { 1.0 };
        let made = made(&map, &photographs(folder.path(), |d| [truth(d); 3], 0.0), false).unwrap();
        println!("{:?}, {:.4} replaced", made.lamps, made.replaced);
        assert!(made.lamps.len() == 1 && made.lamps[0].direction.angle_between(lamp) < 0.01);
        assert!(!made.lamps[0].is_own && made.lamps[0].factor.is_none());
        // But for the edge, between pixels of both.
        for i in (0..map.radiance.len()).filter(|&i| off(i) < 0.1 && (off(i) - 0.06).abs() > 0.015) {
            let (truth, now) = (truth(map.size.direction(at(i))), f64::from(made.map.radiance[i][1]));
            assert!((now - truth).abs() < 0.15 * truth.max(0.1), "{now} {truth} at {}", off(i));
        }
    }
    // Where it was black, and is not: but for cells that were so in part.
    let holed = |d: DVec3| if d.angle_between(lamp) < 0.06 { 0.0 } else { wall(d) as f32 };
    for i in 0..map.radiance.len() {
        map.radiance[i] = [holed(map.size.direction(at(i))); 3];
    }
    let made = made(&map, &photographs(folder.path(), |d| [wall(d); 3], 0.0), false).unwrap();
    for i in (0..map.radiance.len()).filter(|&i| off(i) < 0.04) {
        let (truth, now) = (wall(map.size.direction(at(i))), f64::from(made.map.radiance[i][1]));
        assert!((now / truth - 1.0).abs() < 0.15, "{now} {truth} at {}", off(i));
    }
}

#[test]
fn a_lamp_of_one_colour_has_its_factor() {
    let folder = tempfile::tempdir().unwrap();
    let lamp = DVec3::new(0.2, 0.1, -1.0).normalize();
    // Red, with little blue or none, in a room that is dim beside it.
    for (blue, by) in [(5e-4, 0.5), (0.0, 0.5), (5e-4, 1.0), (0.0, 1.0)] {
        let radiance = |d: DVec3, factor: f64| match d.angle_between(lamp) < 0.2 {
            true => [1.6, 0.4, blue].map(|lamp| factor * lamp),
            false => [0.04 * wall(d); 3],
        };
        let mut map = map(|_| true);
        let at = |i: usize| DVec2::new((i % 512) as f64, (i / 512) as f64);
        for i in 0..map.radiance.len() {
            map.radiance[i] = radiance(map.size.direction(at(i)), 1.0).map(|value| value as f32);
        }
        map.variance.fill(1e-7);
        let made = made(&map, &photographs(folder.path(), |d| radiance(d, by), 0.0), false).unwrap();
        println!("{:?}", made.lamps);
        assert!(made.lamps.len() == 1 && made.lamps[0].is_own == (by != 1.0));
        let (factor, sigma) = made.lamps[0].factor.unwrap();
        for c in 0..3 {
            assert!((factor[c] / by - 1.0).abs() < 3.0 * sigma[c] && sigma[c] < 0.1);
        }
        let now = made.map.toward(lamp).0;
        let is_now = |c: usize, before: f64| (now[c] / (by * before) - 1.0).abs() < 0.05;
        assert!(is_now(0, 1.6) && is_now(1, 0.4), "{now:?}");
        assert!(now[2] < 0.01, "{now:?}");
    }
}

#[test]
fn where_photographs_cannot_be_turned_to_the_map_that_is_said_and_no_part_of_a_turn_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let mut even = map(|_| true);
    even.radiance.iter_mut().for_each(|pixel| *pixel = [0.4; 3]);
    let made_even = made(&even, &photographs(folder.path(), |_| [0.4; 3], 0.02), true).unwrap();
    assert_eq!((made_even.turned_rad, made_even.turned_sigma_rad), (0.0, None));
    assert!(
        made_even.new.notes.iter().any(|note| note.contains("cannot be told")),
        "{:?}",
        made_even.new.notes
    );
    // Stripes along the horizon tell two of three angles.
    let stripe = |d: DVec3| 0.4 + 0.2 * (12.0 * d.y).sin();
    let mut striped = map(|_| true);
    for i in 0..striped.radiance.len() {
        let at = DVec2::new((i % 512) as f64, (i / 512) as f64);
        striped.radiance[i] = [stripe(striped.size.direction(at)) as f32; 3];
    }
    let made_striped = made(&striped, &photographs(folder.path(), |d| [stripe(d); 3], 0.02), true).unwrap();
    assert_eq!((made_striped.turned_rad, made_striped.turned_sigma_rad), (0.0, None));
    // Nine degrees off.
    let refused = made(&map(|_| true), &photographs(folder.path(), |d| [wall(d); 3], 0.16), true);
    let is_said = match &refused {
        Err(error) => error.to_string().contains("fit the map nowhere"),
        Ok(made) => made.turned_sigma_rad.is_none(),
    };
    assert!(is_said, "{:?}", refused.map(|made| (made.turned_rad, made.turned_sigma_rad)));
}

#[test]
fn maps_in_another_unit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let shots = photographs(folder.path(), |d| [wall(d); 3], 0.0);
    for unit in [Unit::Unknown, Unit::MeanPhotograph, Unit::Saturation { iso: true, f_number: false }] {
        let other = EnvironmentMap { unit, ..map(|_| true) };
        let message = made(&other, &shots, false).err().unwrap().to_string();
        assert!(message.contains(unit.words()) && message.contains("--same-unit"), "{message}");
        // A file keeps it.
        let file = folder.path().join("map.exr");
        other.write(&file).unwrap();
        assert_eq!(EnvironmentMap::read(&file).unwrap().unit, unit);
    }
}

/// Bracketed photographs of a room around some directions, each with all exposure times: 8 bits, sRGB, with shot noise and a dark one.
fn bracketed(folder: &Path, room: &EnvironmentMap, turns: &[DQuat], seed: u64) -> Shots {
    let lens = Lens::pinhole(256, 192, 180.0);
    let times_s = [0.125f64.powi(4), 0.125f64.powi(3), 0.125f64.powi(2), 0.125, 1.0];
    let shot = |number: usize| {
        let (turn, time_s) = (turns[number / times_s.len()], times_s[number % times_s.len()]);
        let mut random = StdRng::seed_from_u64(1000 * seed + number as u64);
        let path = folder.join(format!("{seed}_{number:03}.png"));
        let picture = image::RgbImage::from_fn(lens.width, lens.height, |x, y| {
            let direction = turn * lens.unproject(DVec2::new(f64::from(x), f64::from(y))).unwrap();
            image::Rgb(room.toward(direction).0.map(|radiance| {
                let exposure = radiance * time_s;
                let normal: f64 = (0..4).map(|_| random.random_range(-0.866..0.866)).sum();
                let sigma = (exposure.min(1.0) / 1e4 + 2e-4f64.powi(2)).sqrt();
                let x = (exposure + sigma * normal).clamp(0.0, 1.0);
                (255.0 * if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }).round()
                    as u8
            }))
        });
        picture.save(&path).unwrap();
        Shot { path, world_from_camera: turn, sigma_rad: Some(1e-4), exposure: Some(time_s) }
    };
    let shots = (0..turns.len() * times_s.len()).into_par_iter().map(shot).collect();
    Shots { shots, lens: Some(lens), tracker: None, unit: UNIT }
}

fn luminance(pixel: [f32; 3]) -> f32 {
    0.2126 * pixel[0] + 0.7152 * pixel[1] + 0.0722 * pixel[2]
}

/// The pixels that hang together with one and are brighter than this.
fn connected(map: &EnvironmentMap, from: usize, bright: f32) -> Vec<usize> {
    let (width, height) = (map.size.width(), map.size.height());
    let (mut open, mut is_in) = (vec![from], vec![false; map.size.count()]);
    is_in[from] = true;
    let mut found = vec![];
    while let Some(at) = open.pop() {
        found.push(at);
        let (x, y) = (at % width, at / width);
        let beside = [y * width + (x + 1) % width, y * width + (x + width - 1) % width];
        for next in
            beside.into_iter().chain((y > 0).then(|| at - width)).chain((y + 1 < height).then(|| at + width))
        {
            if !is_in[next] && luminance(map.radiance[next]) > bright {
                is_in[next] = true;
                open.push(next);
            }
        }
    }
    found
}

#[test]
fn one_lamp_that_was_dimmed_is_told_from_the_others_and_from_the_room() {
    let Some(path) = rigel_tests::data("environment/studio.hdr") else { return };
    let room = EnvironmentMap::read(&path).unwrap();
    let at = |i: usize| DVec2::new((i % room.size.width()) as f64, (i / room.size.width()) as f64);
    let brightest = (0..room.size.count())
        .max_by(|a, b| luminance(room.radiance[*a]).total_cmp(&luminance(room.radiance[*b])))
        .unwrap();
    let lamp = room.size.direction(at(brightest));
    let pixels = connected(&room, brightest, 0.1 * luminance(room.radiance[brightest]));
    let folder = tempfile::tempdir().unwrap();
    let options = |refine: bool| Options { sigma_rad: 0.035, refine, ..Options::new(room.size) };
    // All around for the map; around the lamps afterwards.
    let mut around = vec![];
    for (pitch, count) in [(-75.0f64, 3), (-40.0, 8), (0.0, 9), (40.0, 8), (75.0, 3)] {
        for i in 0..count {
            let yaw = std::f64::consts::TAU * (f64::from(i) + 0.3) / f64::from(count);
            let turn = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch.to_radians());
            around.push(world_from_camera(turn));
        }
    }
    let before = mosaic(&bracketed(folder.path(), &room, &around, 1), &options(false), &Silent).unwrap().map;
    // The other lamps of the studio are on the other side.
    let is_near = |turn: &DQuat| [lamp, -lamp].iter().any(|to| (*turn * DVec3::Z).angle_between(*to) < 1.1);
    let shifted: Vec<DQuat> =
        around.iter().filter(|turn| is_near(turn)).map(|turn| DQuat::from_rotation_y(0.13) * *turn).collect();
    for (seed, (lamp_factor, rest_factor)) in [(0.5, 1.0), (1.0, 1.0), (0.6, 0.8)].into_iter().enumerate() {
        let mut now = room.clone();
        now.radiance.iter_mut().for_each(|pixel| *pixel = pixel.map(|value| value * rest_factor as f32));
        for &i in &pixels {
            now.radiance[i] = room.radiance[i].map(|value| value * lamp_factor as f32);
        }
        let shots = bracketed(folder.path(), &now, &shifted, 2 + seed as u64);
        let made = update(&before, &shots, &options(false), 0.02, &Silent).unwrap();
        println!("truth {lamp_factor} {rest_factor}: rest {:?} ± {:?}", made.factor, made.sigma);
        for lamp in &made.lamps {
            println!("  {:?}", lamp);
        }
        let (mut dimmed, mut others) = (0, 0);
        for found in &made.lamps {
            let Some((factor, sigma)) = found.factor else { continue };
            let is_it =
                pixels.iter().any(|&i| room.size.direction(at(i)).angle_between(found.direction) < 0.02);
            let truth = if is_it { lamp_factor } else { rest_factor };
            (0..3).for_each(|c| {
                let off = (factor[c] - truth).abs() / (truth * sigma[c]);
                assert!(off < 2.0, "{off} sigmas: {found:?}");
                assert!(sigma[c] < 0.1);
            });
            if is_it {
                dimmed += 1
            } else {
                others += 1
            }
            assert_eq!(found.is_own, is_it && lamp_factor != rest_factor, "{found:?}");
        }
        assert!(dimmed == 1 && others > 0, "{dimmed} {others}");
        for c in 0..3 {
            assert!(
                (made.factor[c] / rest_factor - 1.0).abs() < 2.0 * made.sigma[c].max(0.005),
                "{:?}",
                made.factor
            );
        }
        assert_eq!(made.is_changed, rest_factor != 1.0);
        // The map holds the lamp as it is now.
        let power = |map: &EnvironmentMap| -> f64 {
            pixels
                .iter()
                .map(|&i| {
                    room.size.solid_angle(i / room.size.width()) * f64::from(luminance(map.radiance[i]))
                })
                .sum()
        };
        let kept = power(&made.map) / power(&before);
        assert!((kept / lamp_factor - 1.0).abs() < 0.04, "{kept} {lamp_factor}");
    }
}

#[test]
fn without_exposures_or_overlap_it_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut shots = photographs(folder.path(), |d| [wall(d); 3], 0.0);
    let behind = map(|d| d.z > 0.9);
    let message = made(&behind, &shots, false).err().unwrap().to_string();
    assert!(message.contains("0.00 % of the sphere"), "{message}");
    shots.shots[2].exposure = None;
    let message = made(&map(|_| true), &shots, false).err().unwrap().to_string();
    assert!(message.contains("2.png") && message.contains("; "), "{message}");
}

#[test]
fn photographs_of_another_part_of_the_room_fit_nowhere() {
    let folder = tempfile::tempdir().unwrap();
    let whole = map(|_| true);
    for turned_deg in [25.0f64, 60.0, 140.0] {
        let turn = DQuat::from_rotation_y(turned_deg.to_radians());
        let shots = photographs(folder.path(), |d| [wall(turn * d); 3], 0.0);
        let refused = made(&whole, &shots, true).map(|made| (made.turned_rad, made.replaced));
        let error = refused.unwrap_err().to_string();
        assert!(error.contains("fit the map nowhere"), "{turned_deg}: {error}");
    }
}

/// A camera whose white balance moves from photograph to photograph, with a white sky at the end of its curve.
#[test]
fn photographs_of_which_a_map_was_made_change_next_to_nothing_of_it() {
    let Some(folder) = rigel_tests::data("panorama/durlach_hugin") else { return };
    let all = Shots::read(&folder).unwrap();
    let options = Options::new(LatLong::new(1024, 512).unwrap());
    let whole = mosaic(&all, &options, &Silent).unwrap().map;
    for first in [3, 7, 11, 15, 19] {
        let some = Shots { shots: all.shots[first..first + 4].to_vec(), ..all.clone() };
        let made = update(&whole, &some, &options, 0.02, &Silent).unwrap();
        println!(
            "{}: {:?} ± {:?}, {:.4} replaced, {:.4} doubted",
            some.shots[0].name(),
            made.factor,
            made.sigma,
            made.replaced,
            made.doubted
        );
        assert!(!made.is_changed, "{:?} ± {:?}", made.factor, made.sigma);
        let bounds = |map: &EnvironmentMap| map.share(EnvironmentMap::LOWER_BOUND);
        assert!(bounds(&made.map) < bounds(&whole) + 0.002, "{}", bounds(&made.map));
        // Turned away, they are those of another place.
        let mut away = some.clone();
        for shot in &mut away.shots {
            shot.world_from_camera = DQuat::from_rotation_y(1.4) * shot.world_from_camera;
        }
        let refused = update(&whole, &away, &options, 0.02, &Silent).map(|made| made.turned_rad);
        assert!(refused.unwrap_err().to_string().contains("fit the map nowhere"));
    }
}

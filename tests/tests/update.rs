//! A map is brought up to date by photographs of a part of the room.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use rigel::environment::{EnvironmentMap, MergeOptions, Options, Shot, Shots, Updated, update};
use rigel::geometry::{LatLong, Lens, world_from_camera};
use rigel::progress::Silent;

/// What is to be seen in a direction, 0.15 to 0.75.
fn wall(d: DVec3) -> f64 {
    let wave = |by: f64, x: f64| (by * x).sin();
    0.45 + 0.1 * wave(9.0, d.x + 0.3 * d.z) + 0.1 * wave(11.0, d.y) + 0.1 * wave(23.0, d.z - d.x * d.y)
}

fn map(seen: impl Fn(DVec3) -> bool) -> EnvironmentMap {
    let size = LatLong::new(512, 256).unwrap();
    let at = |i: usize| size.direction(DVec2::new((i % 512) as f64, (i / 512) as f64));
    let flags: Vec<u8> =
        (0..size.count()).map(|i| if seen(at(i)) { 0 } else { EnvironmentMap::UNSEEN }).collect();
    let radiance = (0..size.count()).map(|i| if flags[i] == 0 { [wall(at(i)) as f32; 3] } else { [0.0; 3] });
    EnvironmentMap {
        size,
        radiance: radiance.collect(),
        variance: vec![1e-5; size.count()],
        coverage: vec![3; size.count()],
        flags,
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
    Shots { shots: (0..5).map(shot).collect(), lens: Some(lens), tracker: None }
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
    let map = map(|_| true);
    let made = made(&map, &photographs(folder.path(), |d| [wall(d); 3], 0.02), true).unwrap();
    println!("turned by {:.4}, {:.4} replaced", made.turned_rad, made.replaced);
    assert!((made.turned_rad - 0.02).abs() < 0.004 && !made.is_changed && made.replaced < 0.001);
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

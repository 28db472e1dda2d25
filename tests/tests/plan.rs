//! Planned views against uniform ones, on a board whose truth is a formula.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "plan/world.rs"]
mod world;

use std::f64::consts::FRAC_PI_2;

use glam::DVec3;
use rigel::fit::{FitOptions, Model};
use rigel::geometry::unit_vector;
use rigel::observation::ObservationMap;
use rigel::parameter_map::fit_surface;
use rigel::plan::{candidates, plan_views};
use rigel::progress::Silent;
use rigel::rig::RigLimits;
use rigel::sampling::{icosphere, read_directions, spiral};
use world::{Off, World, ZENITH_RAD};

fn off(world: &World, map: &ObservationMap) -> Off {
    let model = Model::Phong { lobes: 2 };
    world.off(&fit_surface(map, model, &FitOptions::default(), &[], &Silent).unwrap())
}

#[test]
fn fewer_than_a_hundred_planned_views_are_as_good_as_305_uniform_ones() {
    let world = World::new(96, 24, 60);
    let uniform = off(&world, &world.photograph("uniform", &icosphere(3, FRAC_PI_2).unwrap()));
    let mut views = spiral(20, ZENITH_RAD).unwrap();
    let coarse = world.photograph("coarse", &views);
    let before = off(&world, &coarse);
    let all = candidates(None, ZENITH_RAD).unwrap();
    let first = plan_views(&coarse, &all, 20, &Silent).unwrap();
    let expected = first.expected.clone().unwrap();
    views.extend(&first.directions);
    let second = world.photograph("second", &views);
    let next = plan_views(&second, &all, 30, &Silent).unwrap();
    views.extend(&next.directions);
    let planned = off(&world, &world.photograph("planned", &views));
    println!("{} planned views: {planned:?}; 305 uniform: {uniform:?}; 20 uniform: {before:?}", views.len());
    assert!(views.len() <= 100 && planned.mean <= uniform.mean, "{planned:?} against {uniform:?}");
    assert!(planned.rms <= 1.15 * uniform.rms, "{planned:?} against {uniform:?}");
    // What was promised is falling, and of the size of what came.
    assert!(expected.removable.windows(2).all(|pair| pair[1] <= pair[0] + 1e-9));
    let (promised, came) = (255.0 * expected.error(0), before.rms);
    assert!(promised > 0.4 * came && promised < 2.5 * came, "promised {promised}, came {came}");
    // No direction comes twice, nor one that was photographed.
    for (i, a) in views.iter().enumerate() {
        assert!(views[..i].iter().all(|b| a.distance(*b) > 0.02));
    }
}

/// Views of the scene that show little: enough for everything but the errors.
fn small(views: &[DVec3]) -> (World, ObservationMap) {
    let world = World::new(48, 8, 4);
    let map = world.photograph("few", views);
    (world, map)
}

#[test]
fn too_few_views_for_a_fit_are_filled_up_evenly_and_it_is_said() {
    let taken = [DVec3::Z, unit_vector(1.0, 1.0)];
    let (_world, map) = small(&taken);
    let plan = plan_views(&map, &candidates(None, ZENITH_RAD).unwrap(), 12, &Silent).unwrap();
    assert!(plan.expected.is_none());
    let mut views = taken.to_vec();
    for direction in plan.directions {
        let nearest = views.iter().map(|view| view.angle_between(direction)).fold(9.0, f64::min);
        assert!(nearest > 0.45, "{nearest}");
        views.push(direction);
    }
}

#[test]
fn a_plan_keeps_to_the_rig_s_reach_and_its_table_to_the_plan() {
    let limits = RigLimits {
        pan_rad: [-0.5, 1.0],
        tilt_rad: [0.1, 0.8],
        speed_rad_s: 1.0,
        acceleration_rad_s2: 1.0,
        settle_s: 0.1,
    };
    let reach = candidates(Some(&limits), ZENITH_RAD).unwrap();
    let (_world, map) = small(&spiral(14, ZENITH_RAD).unwrap());
    let plan = plan_views(&map, &reach, 5, &Silent).unwrap();
    assert_eq!(plan.directions.len(), 5);
    assert!(plan.directions.iter().all(|view| rigel::sampling::is_reachable(*view, &limits)));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("next.csv");
    plan.write_csv(&file).unwrap();
    let read = read_directions(&file).unwrap();
    assert!(read.iter().zip(&plan.directions).all(|(a, b)| a.distance(*b) < 3e-5));

    for (count, says) in [(0, "no views"), (reach.len() + 1, "ask for at most")] {
        let error = plan_views(&map, &reach, count, &Silent).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let beyond = RigLimits { tilt_rad: [1.5, 1.5], ..limits };
    assert!(candidates(Some(&beyond), ZENITH_RAD).unwrap_err().to_string().contains("no direction"));
}

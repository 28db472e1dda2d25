//! A lamp that drifts and a lens that darkens towards its corners, found from overlapping views and removed: how well, how surely,
//! and where it cannot be done.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "photometry/world.rs"]
mod world;

use rigel::photometry::{Options, Patch};
use world::{Found, World, flicker, warming};

const NOTHING: Options = Options { lamp: false, vignetting: false, reference: None };

fn steady(_: usize) -> [f64; 3] {
    [1.0; 3]
}

#[test]
fn a_drifting_lamp_is_found_within_its_sigma_and_its_harm_undone() {
    let world = World::new(60);
    let none = world.run(&steady, false, &NOTHING);
    println!("steady: {:.3} of 255", none.mean_255);
    for (name, size) in [("10 %", 0.1), ("2 %", 0.02)] {
        let (mut within, mut all) = (0.0, 0.0);
        for seed in 0..2 {
            let gain = |view: usize| flicker(size, view, seed);
            let drifted = world.run(&gain, false, &NOTHING);
            let found = world.run(&gain, false, &Options::default());
            let share = found.lamp_within_sigma(&gain);
            println!(
                "flicker {name}: {:.3} of 255, corrected {:.3}; gains off by {:.2} %, {:.0} % within sigma: {:?}",
                drifted.mean_255,
                found.mean_255,
                100.0 * found.lamp_error(&gain),
                100.0 * share,
                found.photometry.notes
            );
            within += share;
            all += 1.0;
        }
        println!("{}", within / all);
    }
    let gain = |view: usize| warming(0.1, view, 60);
    let drifted = world.run(&gain, false, &NOTHING);
    let found = world.run(&gain, false, &Options::default());
    println!(
        "warming: {:.3} of 255, corrected {:.3}; gains off by {:.2} %, {:.0} % within sigma: {:?}",
        drifted.mean_255,
        found.mean_255,
        100.0 * found.lamp_error(&gain),
        100.0 * found.lamp_within_sigma(&gain),
        found.photometry.notes
    );
}

#[test]
fn a_steady_lamp_is_left_alone() {
    for views in [60, 30] {
        let world = World::new(views);
        let found = world.run(&steady, false, &Options::default());
        println!("{views}: {:?}", found.photometry.notes);
    }
}

#[test]
fn vignetting_is_found_without_flats() {
    let world = World::new(60);
    let none = world.run(&steady, false, &NOTHING);
    let dark = world.run(&steady, true, &NOTHING);
    let found = world.run(&steady, true, &Options::default());
    println!(
        "{:.3} of 255, with vignetting {:.3}, found {:.3}: {:?}",
        none.mean_255, dark.mean_255, found.mean_255, found.photometry.notes
    );
    found.print_vignetting(&world);
    let gain = |view: usize| flicker(0.05, view, 3);
    let both = world.run(&gain, true, &Options::default());
    println!("both: {:.3}: gains off by {:.2} %, {:?}", both.mean_255, 100.0 * both.lamp_error(&gain), both.photometry.notes);
    both.print_vignetting(&world);
}

//! Views aligned by the surface's texture, on simulated surfaces whose truth is known.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "poses/score.rs"]
mod score;

use rigel::calibration::{RegisterOptions, RegisteredView, Registration, Squares, register};
use rigel::progress::Silent;
use rigel::session::Session;
use rigel_simulated::squares::{Look, SquaresRig, TrueView};
use rigel_simulated::texture::{Grain, Texture};

const VIEWS: usize = 14;

/// A rig with small pictures whose surface is where the rig says: what a rig alone can tell.
fn rig(grain: Grain, gloss: f64) -> SquaresRig {
    let mut rig = SquaresRig::new(3);
    rig.lens = rig.lens.scaled_to(320, 240);
    rig.rig.surface_turn_rad[2] = 0.0;
    rig.rig.surface_shift_m[..2].fill(0.0);
    rig.rig.camera_shift_m[2] = 0.0;
    rig.texture = Some(Texture { grain, gloss });
    rig
}

/// Views that are off and noisy each in its own way, as `seed` has it.
fn views(rig: &SquaresRig, count: usize, seed: u64) -> Vec<(TrueView, Look)> {
    let look = |(view, truth)| (truth, Look { seed: 1000 * seed + view as u64, ..Look::default() });
    rig.views(count, seed).into_iter().enumerate().map(look).collect()
}

fn registered(rig: &SquaresRig, session: &Session, squares: Option<&Squares>) -> Registration {
    // The lens is known: what is scored is what the texture says.
    let covariance = [3e-3, 3e-3, 3e-3, 3e-3, 1e-5, 5e-5, 5e-7, 5e-7, 0.0].map(|sigma: f64| sigma * sigma);
    let covariance =
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { covariance[i] } else { 0.0 }));
    let options = RegisterOptions { squares: squares.cloned(), lens: Some((rig.lens, Some(covariance))) };
    register(session, &options, &Silent).unwrap()
}

fn alone(rig: &SquaresRig, views: &[(TrueView, Look)]) -> Registration {
    let folder = tempfile::tempdir().unwrap();
    registered(rig, &rig.session(&folder.path().join("session"), views).unwrap(), None)
}

fn truth<'a>(views: &'a [(TrueView, Look)], view: &RegisteredView) -> &'a TrueView {
    &views.iter().find(|(truth, _)| truth.name == view.name).unwrap().0
}

/// Median, p95 and maximum of the direction errors in degrees, but for what only marks on the surface tell, and the part of them
/// within one sigma.
fn score(found: &Registration, views: &[(TrueView, Look)]) -> ([f64; 3], f64) {
    let pairs: Vec<_> = found.views.iter().map(|view| (view, truth(views, view).pose)).collect();
    let result = score::gauge_free(&pairs);
    println!("{result:.4?}, patches {:?}", found.views.iter().map(|view| view.patches).collect::<Vec<_>>());
    result
}

#[test]
fn texture_alone_aligns_the_views_as_well_as_it_says() {
    let mut within = vec![];
    for seed in 0..4 {
        let rig = rig(Grain::Random, 0.0);
        let views = views(&rig, VIEWS, seed);
        let found = alone(&rig, &views);
        let (but_for_gauge, part) = score(&found, &views);
        assert!(found.dropped.is_empty(), "{:?}", found.dropped);
        assert!(found.views.iter().all(|view| view.patches > 20), "{:?}", found.notes);
        // The commanded angles are off by 0.25 degrees.
        assert!(but_for_gauge[0] < 0.03 && but_for_gauge[2] < 0.12, "{but_for_gauge:?}");
        within.push(part);
    }
    let within = within.iter().sum::<f64>() / within.len() as f64;
    // 68 % would be exact: a little is alike in all patches of a view, and no residual shows it.
    assert!((0.5..0.8).contains(&within), "{within}");
}

#[test]
fn a_surface_without_texture_keeps_the_commanded_angles_and_says_so() {
    let mut rig = rig(Grain::Even, 0.0);
    rig.layout.centres_m.clear();
    let views = views(&rig, 8, 1);
    let found = alone(&rig, &views);
    println!("{:?}", found.notes);
    assert!(found.views.len() == 8 && found.views.iter().all(|view| view.patches == 0));
    assert!(found.notes.iter().any(|note| note.contains("shows hardly any") || note.contains("hardly any")));
    let sigma = found.views[4].direction_sigma_rad().to_degrees();
    assert!(sigma > 0.3, "{sigma}");
}

#[test]
fn repeated_texture_is_not_taken_for_another_of_its_periods() {
    let mut rig = rig(Grain::Repeated { period_m: 0.014 }, 0.0);
    rig.layout.centres_m.clear();
    let views = views(&rig, 8, 2);
    let found = alone(&rig, &views);
    println!("{:?}", found.notes);
    assert!(found.views.len() == 8 && found.views.iter().all(|view| view.patches == 0));
    assert!(found.notes.iter().any(|note| note.contains("the same again")));
}

#[test]
fn highlights_that_wander_with_the_view_do_not_lead_it_astray() {
    let rig = rig(Grain::Random, 6.0);
    let views = views(&rig, VIEWS, 4);
    let found = alone(&rig, &views);
    let (but_for_gauge, _) = score(&found, &views);
    assert!(found.dropped.is_empty(), "{:?}", found.dropped);
    assert!(but_for_gauge[0] < 0.04 && but_for_gauge[2] < 0.15, "{but_for_gauge:?}");
}

#[test]
fn texture_on_half_of_the_surface_suffices_and_is_less_sure() {
    let whole = rig(Grain::Random, 0.0);
    let half = SquaresRig { texture: Some(Texture { grain: Grain::Half, gloss: 0.0 }), ..whole.clone() };
    let views = views(&whole, VIEWS, 5);
    let (all, part) = (alone(&whole, &views), alone(&half, &views));
    let (but_for_gauge, _) = score(&part, &views);
    assert!(but_for_gauge[0] < 0.08, "{but_for_gauge:?}");
    let sigma = |found: &Registration| found.views[9].direction_sigma_rad();
    assert!(sigma(&part) > sigma(&all));
    assert!(part.views[9].patches < all.views[9].patches);
}

#[test]
fn a_view_with_another_s_angles_is_left_out_by_name() {
    let rig = rig(Grain::Random, 0.0);
    let mut views = views(&rig, VIEWS, 6);
    views[5].0.pan_rad += 1.0;
    let found = alone(&rig, &views);
    println!("{:?}", found.dropped);
    assert_eq!(found.dropped.len(), 1);
    assert!(found.dropped[0].name == "view005" && found.dropped[0].reason.contains("not that of the others"));
}

#[test]
fn a_view_whose_squares_are_hidden_is_placed_by_its_texture() {
    let rig = rig(Grain::Random, 0.0);
    let mut views = views(&rig, VIEWS, 7);
    views[6].1.glare = vec![0, 1, 2, 3];
    let folder = tempfile::tempdir().unwrap();
    let session = rig.session(&folder.path().join("session"), &views).unwrap();
    let found = registered(&rig, &session, Some(&rig.layout));
    println!("{:?} {:?}", found.dropped, found.notes);
    let view = found.view("view006").unwrap();
    assert!(view.corners == 0 && view.patches > 20);
    let error = view.direction_error_rad(&truth(&views, view).pose);
    println!("{error} {}", view.direction_sigma_rad());
    assert!(error < 3.0 * view.direction_sigma_rad() && error.to_degrees() < 0.1);
}

#[test]
fn squares_on_a_surface_without_texture_are_left_as_they_are() {
    let rig = rig(Grain::Even, 0.0);
    let views = views(&rig, 8, 8);
    let folder = tempfile::tempdir().unwrap();
    let mut session = rig.session(&folder.path().join("session"), &views).unwrap();
    let with = registered(&rig, &session, Some(&rig.layout));
    // Nobody looks for texture on a surface whose size nobody has said.
    session.manifest.surface = None;
    let without = registered(&rig, &session, Some(&rig.layout));
    assert!(with.views.iter().all(|view| view.patches == 0));
    assert_eq!(with.views, without.views);
}

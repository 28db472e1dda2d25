//! What happens where a capture is bad: accuracy goes, and it is said. `rigel chart` draws these.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use glam::{DVec2, DVec3, Vec3};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rigel::calibration::{
    BoardView, LensCalibration, RegisterOptions, RegisteredView, Registration, calibrate_lens, register,
    register_corners,
};
use rigel::fit::{FitFlags, FitOptions, Fitter, Model};
use rigel::geometry::Lens;
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel::radiance::{RadianceImage, Samples, Stack, merge};
use rigel_atlas::error_at;
use rigel_atlas::texels::{Doubt, directions, lobes, observe};
use rigel_simulated::board::{Board, cover};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;
use rigel_simulated::squares::{DISTANCE_M, Look, SquaresRig, TrueView};

const SIGMA_PX: f64 = 0.1;

fn wide() -> Lens {
    Lens { k1: -0.28, k2: 0.09, ..Lens::pinhole(640, 480, 540.0) }
}

fn calibrated(boards: &[Board]) -> LensCalibration {
    let views = boards.iter().enumerate().map(|(i, board)| BoardView {
        path: format!("board{i}.jpg").into(),
        corners: board.detected(&wide(), SIGMA_PX, i as u64).unwrap(),
    });
    calibrate_lens(&views.collect::<Vec<_>>(), (640, 480), 1.0, None).unwrap()
}

#[test]
fn boards_only_in_the_middle_leave_the_corners_unknown_and_say_so() {
    let whole = calibrated(&cover(&wide(), 1));
    let middle: Vec<Board> = (0..14)
        .map(|i| {
            let around = DVec2::from_angle(2.4 * f64::from(i));
            let turn = DVec3::new(0.45 * around.y, 0.45 * around.x, 0.0);
            Board::at(9, 6, 1.0, turn, (0.5 * around).extend(24.0 + 0.2 * f64::from(i)))
        })
        .collect();
    let found = calibrated(&middle);
    let corner = DVec2::new(639.0, 479.0);
    println!("{}\n{}", whole.verdict, found.verdict);
    assert!(!whole.verdict.contains("not covered"), "{}", whole.verdict);
    assert!(found.verdict.contains("the corners of the picture were not covered: tilt the board there"));
    let (sure, unsure) = (whole.projection_sigma_px(corner), found.projection_sigma_px(corner));
    assert!(unsure > 4.0 * sure && unsure > 0.25, "{sure} {unsure}");
    // In the middle, where the boards were, nothing is lost.
    assert!(found.projection_sigma_px(DVec2::new(330.0, 250.0)) < 0.25);
    // What is stated for the corners is no exaggeration and no understatement.
    let direction = wide().unproject(corner).unwrap();
    let off = found.lens.project(direction).unwrap().distance(corner);
    let [[xx, _], [_, yy]] = found.projection_covariance(corner).unwrap();
    assert!(off < 3.0 * (xx + yy).sqrt(), "{off} px off, {} stated", (xx + yy).sqrt());
}

fn session_of(views: &[(TrueView, Look)], rig: &SquaresRig) -> Registration {
    let folder = tempfile::tempdir().unwrap();
    let session = rig.session(&folder.path().join("session"), views).unwrap();
    let options = RegisterOptions { squares: Some(rig.layout.clone()), lens: Some((rig.lens, None)) };
    register(&session, &options, &Silent).unwrap()
}

fn error_deg(found: &RegisteredView, truth: &TrueView) -> f64 {
    found.pose.centre_m.angle_between(truth.pose.centre_m).to_degrees()
}

#[test]
fn glare_on_two_squares_makes_a_view_less_sure_and_leaves_the_others() {
    const GLARED: [usize; 2] = [2, 6];
    let rig = SquaresRig::new(3);
    let truth = rig.views(10, 3);
    let mut views: Vec<(TrueView, Look)> =
        truth.iter().zip(0..).map(|(view, seed)| (view.clone(), Look { seed, ..Look::default() })).collect();
    let clean = session_of(&views, &rig);
    for glared in GLARED {
        views[glared].1.glare = vec![0, 3];
    }
    let found = session_of(&views, &rig);
    assert!(clean.dropped.is_empty() && found.dropped.is_empty(), "{:?}", found.dropped);
    for (index, (truth, (before, after))) in
        truth.iter().zip(clean.views.iter().zip(&found.views)).enumerate()
    {
        let (error, sigma) = (error_deg(after, truth), after.direction_sigma_rad().to_degrees());
        println!("{}: {} corners, {error:.4} degrees off, {sigma:.4} stated", after.name, after.corners);
        assert!(error < 3.0 * sigma && error < 0.15, "{}: {error} {sigma}", after.name);
        if GLARED.contains(&index) {
            assert_eq!((before.corners, after.corners), (16, 8));
            assert!(after.direction_sigma_rad() > before.direction_sigma_rad());
        } else {
            assert_eq!(after.corners, 16);
        }
    }
}

#[test]
fn fewer_squares_are_less_accurate_and_say_so() {
    let rig = SquaresRig::new(2);
    let truth = rig.views(24, 2);
    let mut before = (0.0, 0.0);
    for squares in [4, 1, 0] {
        let mut shown = rig.detected(&truth, SIGMA_PX, 5);
        shown.iter_mut().for_each(|view| view.squares.truncate(squares));
        let found = register_corners(&rig.layout, (rig.lens, None), DISTANCE_M, &shown).unwrap();
        assert_eq!(found.views.len(), 24);
        let rms = |of: &dyn Fn(usize) -> f64| ((0..24).map(|i| of(i).powi(2)).sum::<f64>() / 24.0).sqrt();
        let error = rms(&|i| error_deg(&found.views[i], &truth[i]));
        let stated = rms(&|i| found.views[i].direction_sigma_rad().to_degrees());
        println!("{squares} squares: {error:.4} degrees off, {stated:.4} stated");
        assert!(error > before.0 && stated > before.1, "{squares}: {error} {stated}");
        // Without squares nothing tells how far off the rig is: what is stated then is on the safe side.
        let least = if squares == 0 { 0.0 } else { 0.3 };
        assert!((least..3.0).contains(&(error / stated)), "{squares}: {error} {stated}");
        before = (error, stated);
    }
}

/// Three exposures of the patchwork in the shortest of which about a hundredth of the board is clipped.
#[test]
fn what_is_clipped_is_a_lower_bound_and_the_rest_is_measured() {
    let at = (40f64.to_radians(), 35f64.to_radians());
    let options = Options { vignetting: false, ..Options::default() };
    let mut camera = SimulatedCamera::new(Scene::patchwork(), options, move || at);
    let truth = camera.truth(&camera.pose()).radiance;
    let on_board = |i: &usize| truth[*i][1] > 0.0;
    let brightest = |i: usize| truth[i].into_iter().fold(0.0, f32::max);
    let mut sorted: Vec<f32> = (0..truth.len()).filter(on_board).map(brightest).collect();
    sorted.sort_by(f32::total_cmp);
    let limit = f64::from(sorted[sorted.len() * 99 / 100]);
    let mut saturating = 1e-4;
    while camera.response(saturating) < 254.5 {
        saturating *= 1.001;
    }
    let times: Vec<f64> = (0..3).map(|i| saturating / limit * 2f64.powi(2 - i)).collect();
    let pictures = times.iter().map(|&time_s| Picture {
        path: format!("{time_s}.jpg").into(),
        width: 320,
        height: 240,
        levels: camera.levels(time_s).chunks_exact(3).map(|l| [l[0], l[1], l[2]].map(u16::from)).collect(),
        white: 255,
    });
    let stack = Stack::new(pictures.collect(), times.clone()).unwrap();
    let mut samples = Samples::default();
    samples.add(&stack).unwrap();
    let response = samples.response().unwrap();
    let merged = merge(&stack, &response, &samples.noise(&response)).unwrap();

    let saturated = |i: usize| merged.mask[i] & RadianceImage::SATURATED != 0;
    let count = (0..truth.len()).filter(|&i| saturated(i)).count();
    let share = count as f64 / sorted.len() as f64;
    println!("{:.2} % of the board are saturated", 100.0 * share);
    // What is nearly white is not trusted either.
    assert!((0.01..0.06).contains(&share), "{share}");
    for channel in 0..3 {
        let ratio = |i: usize| f64::from(merged.radiance[i][channel] / truth[i][channel]);
        let mut ratios: Vec<f64> =
            (0..truth.len()).filter(|i| on_board(i) && merged.mask[*i] == 0).map(ratio).collect();
        ratios.sort_by(f64::total_cmp);
        let scale = ratios[ratios.len() / 2];
        let mut errors: Vec<f64> = ratios.iter().map(|ratio| (ratio / scale - 1.0).abs()).collect();
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        assert!(median < 0.02, "channel {channel}: {median}");
        for i in (0..truth.len()).filter(|&i| saturated(i)) {
            // Where this channel was not the one that was clipped it is as good as any other.
            let bound = merged.variance[i][channel].is_infinite();
            assert!(
                ratio(i) <= scale * if bound { 1.05 } else { 1.25 },
                "{i} {channel}: {}",
                ratio(i) / scale
            );
        }
    }
    // Nothing that was clipped passes as measured.
    assert!((0..truth.len()).all(|i| f64::from(brightest(i)) < 1.02 * limit || saturated(i)));
}

/// Each row: what is made worse, a model, a value that it stands, and the next one, that it does not; `rigel chart` draws the curves
/// between. Broken is a mean error above 5 %, or no fit.
#[test]
fn models_of_a_texel_break_where_the_atlas_says() {
    let broken = |sweep: &str, value: f32, model: &str| {
        let error = error_at(sweep, value, model).unwrap();
        println!("{model} with {sweep} {value}: {error:.4?}");
        error.is_none_or(|error| error > 0.05)
    };
    for (sweep, model, stands, breaks) in [
        ("views", "phong", 10.0, 6.0),
        ("views", "auto", 17.0, 6.0),
        ("views", "msh36", 37.0, 17.0),
        ("zenith", "phong", 45.0, 20.0),
        ("zenith", "msh36", 60.0, 30.0),
        ("shininess", "constant", 30.0, 3.0),
        ("shininess", "log-quadratic", 100.0, 10.0),
        ("lamps", "phong", 1.0, 3.0),
        ("lamps", "phong2", 2.0, 4.0),
        ("noise", "msh36", 3.0, 30.0),
        ("pose_error", "phong", 1.0, 10.0),
        ("pose_error", "phong2", 0.3, 10.0),
    ] {
        assert!(!broken(sweep, stands, model), "{model} breaks at {sweep} {stands}");
        assert!(broken(sweep, breaks, model), "{model} stands {sweep} {breaks}");
    }
    // The choice stands everything but too few views.
    for (sweep, hardest) in [
        ("noise", 30.0),
        ("zenith", 20.0),
        ("shininess", 1000.0),
        ("lamps", 4.0),
        ("lamp_size", 40.0),
        ("clipping", 0.2),
    ] {
        assert!(!broken(sweep, hardest, "auto"), "auto breaks at {sweep} {hardest}");
    }
}

/// And what breaks is said: most of the texels whose lobe any view saw are flagged, where before hardly one is. (A lobe that no view saw
/// is nobody's to tell.)
#[test]
fn texels_that_break_are_flagged() {
    let flagged = |shininess: f32, views: usize| {
        let toward = directions(views, 1.309, 0.0);
        let (mut truths, mut texels) = (vec![], vec![]);
        for seed in 0..60 {
            let mut truth = lobes(&mut StdRng::seed_from_u64(seed), 1);
            truth.lobes[0].2 = shininess;
            texels.push(observe(&truth, &toward, &Doubt::USUAL, seed));
            truths.push(truth);
        }
        let fitter = Fitter::new(Model::Phong { lobes: 1 }, &FitOptions::default(), &texels).unwrap();
        let (mut seen, mut said) = (0, 0);
        for (truth, texel) in truths.iter().zip(&texels) {
            let above = |d: &Vec3| (truth.radiance(*d) - truth.diffuse).max_element();
            if toward.iter().any(|d| above(d) > 0.05) {
                seen += 1;
                said += usize::from(fitter.fit(texel).flags != FitFlags::default());
            }
        }
        println!("m {shininess}, {views} views: {said} of {seen} flagged");
        assert!(seen > 5);
        said as f64 / f64::from(seen)
    };
    assert!(flagged(30.0, 150) < 0.1);
    assert!(flagged(1000.0, 150) > 0.9, "sharper than the views' spacing");
    assert!(flagged(30.0, 8) > 0.9, "few views");
}

use super::*;
use crate::calibration::median;
use crate::calibration::misplaced::{blamed, misplaced};
use crate::calibration::square::{Corners, vector};
use glam::DVec3;
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

fn normal(random: &mut StdRng) -> f64 {
    let (a, b): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
}

fn layout() -> Squares {
    let places = [(-0.112, -0.087), (-0.112, 0.087), (0.112, -0.087), (0.112, 0.087)];
    Squares { size_m: 0.012, ground_m: 0.003, centres_m: places.map(|(x, y)| DVec3::new(x, y, 0.0)).to_vec() }
}

fn frame(layout: &Squares) -> Frame<'_> {
    let sigma: [f64; LENS] = [2.0, 2.0, 3.0, 3.0, 0.02, 0.1, 5e-4, 5e-4, 0.0];
    Frame {
        layout,
        lens: Lens { k1: -0.6, k2: 0.9, ..Lens::pinhole(640, 480, 1350.0) },
        lens_covariance: SMatrix::from_diagonal(&SVector::from(sigma.map(|s| s * s))),
        distance_m: 0.9,
        points_m: vec![],
        is_rig_s: false,
    }
}

/// Views of a rig whose pan, tilt and picture's place vary and whose axes, roll and distance do not; and where they truly are.
fn simulate(frame: &Frame, views: usize, sigma_px: f64, random: &mut StdRng) -> (Vec<ViewData>, Vec<Seen>) {
    let mut numbers = [0.0; RIG];
    numbers.iter_mut().enumerate().for_each(|(i, n)| *n = normal(random) * if i < 7 { 0.003 } else { 0.002 });
    let rig = RigModel::from_numbers(0.9, &numbers);
    let mut lens = frame.lens;
    lens.fx += 2.0 * normal(random);
    lens.fy += 2.0 * normal(random);
    lens.cx += 3.0 * normal(random);
    let mut data = vec![];
    let mut truth = vec![];
    for view in 0..views {
        let (pan_rad, tilt_rad) = (2.4 * view as f64, 1.25 * ((view as f64 + 0.5) / views as f64));
        let deviation = [0.004, 0.003, 0.0, 0.002, 0.0015, 0.0].map(|sigma| sigma * normal(random));
        let seen = rig.see(pan_rad, tilt_rad, &deviation);
        let squares = (0..4).map(|square| {
            let corners = frame.corners(square, &seen, &lens, 0.0, 0.0).unwrap();
            let noise = Corners::from_fn(|_, _| sigma_px * normal(random));
            let covariance = CornerCovariance::identity() * sigma_px.powi(2);
            MeasuredSquare { square, corners: vector(&corners) + noise, covariance }
        });
        data.push(ViewData { pan_rad, tilt_rad, squares: squares.collect(), points: vec![] });
        truth.push(seen);
    }
    (data, truth)
}

fn direction_error_rad(a: &Seen, b: &Seen) -> f64 {
    a.pose().centre_m.angle_between(b.pose().centre_m)
}

#[test]
fn what_varies_is_told_from_what_does_not() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(1));
    let frame = frame(&layout);
    let (data, _) = simulate(&frame, 60, 0.05, &mut random);
    let found = adjust(&frame, &data).unwrap();
    assert!(found.settled);
    for (k, truth) in [0.004, 0.003, 0.0, 0.002, 0.0015, 0.0].into_iter().enumerate() {
        let sigma = found.sigma[k];
        // 60 views tell a standard deviation to 9 %.
        match truth {
            0.0 => assert!(sigma < 4e-4, "{k}: {sigma}"),
            _ => assert!((sigma / truth - 1.0).abs() < 0.3, "{k}: {sigma} {truth}"),
        }
    }
    // What a view's residuals are worth is the common factor times its own.
    let own =
        found.view_noise.iter().map(|noise| noise[0] * noise[0]).sum::<f64>() / found.view_noise.len() as f64;
    let noise = [found.noise[0], found.noise[1]].map(|noise| noise * own.sqrt());
    // The views' own factors follow their luck and take some of the common one with them.
    assert!(noise.iter().all(|noise| (0.8..1.1).contains(noise)), "{noise:?} {:?}", found.noise);
}

#[test]
fn the_stated_covariance_is_the_error_s() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(2));
    let frame = frame(&layout);
    let mut scores = vec![];
    for _ in 0..6 {
        let (data, truth) = simulate(&frame, 24, 0.08, &mut random);
        let found = adjust(&frame, &data).unwrap();
        for (view, (data, truth)) in data.iter().zip(&truth).enumerate() {
            let [covariance, given_lens] = found.covariance(&frame, view, data);
            let error = found.seen(&frame, view, data).difference(truth);
            scores.extend((0..6).map(|i| error[i] / covariance[i][i].sqrt()));
            assert!((0..6).all(|i| given_lens[i][i] <= covariance[i][i] * (1.0 + 1e-6)));
        }
    }
    let within = scores.iter().filter(|z| z.abs() < 1.0).count() as f64 / scores.len() as f64;
    println!("{:.1} % of {} errors within one sigma", 100.0 * within, scores.len());
    assert!((0.62..0.75).contains(&within), "{within}");
}

#[test]
fn together_is_better_than_one_by_one() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(3));
    let frame = frame(&layout);
    let (data, truth) = simulate(&frame, 60, 0.1, &mut random);
    let found = adjust(&frame, &data).unwrap();
    let nominal = RigModel::nominal(0.9);
    let alone = data.iter().zip(&truth).map(|(view, truth)| {
        let (deviation, _) = solo(&frame, view).unwrap();
        direction_error_rad(&nominal.see(view.pan_rad, view.tilt_rad, &deviation), truth)
    });
    let together: Vec<f64> =
        (0..60).map(|i| direction_error_rad(&found.seen(&frame, i, &data[i]), &truth[i])).collect();
    let (alone, together) = (median(&alone.collect::<Vec<_>>()).to_degrees(), median(&together).to_degrees());
    println!("direction error: alone {alone:.4}, together {together:.4} degrees");
    assert!(together < 0.75 * alone && together < 0.03, "{alone} {together}");
}

#[test]
fn a_square_that_is_elsewhere_hardly_counts() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(4));
    let frame = frame(&layout);
    let (mut data, truth) = simulate(&frame, 30, 0.05, &mut random);
    for view in [3, 11, 20] {
        data[view].squares[2].corners.add_scalar_mut(3.0);
    }
    let found = adjust(&frame, &data).unwrap();
    for view in [3, 11, 20] {
        assert!(found.misfit[view][2][0] > 50.0, "{:?}", found.misfit[view]);
        let error = direction_error_rad(&found.seen(&frame, view, &data[view]), &truth[view]);
        assert!(error.to_degrees() < 0.1, "{view}: {}", error.to_degrees());
        let (_, misfit) = solo(&frame, &data[view]).unwrap();
        assert!((0..4).all(|i| misfit[i] <= misfit[2]), "{misfit:?}");
    }
}

/// What the file says is wrong by 5 mm; the views show the squares where they are, each view with an error of its own.
#[test]
fn a_square_that_the_file_has_elsewhere_is_named() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(6));
    let (data, _) = simulate(&frame(&layout), 12, 0.1, &mut random);
    assert_eq!(misplaced(&frame(&layout), &data), None);
    for (square, by_m) in [(1, DVec2::new(0.005, 0.0)), (2, DVec2::new(-0.0008, 0.0006))] {
        let mut wrong = layout.clone();
        wrong.centres_m[square] -= by_m.extend(0.0);
        let found = misplaced(&frame(&wrong), &data).unwrap();
        // A small error may be another one's, which is then said; a large one is not.
        let blamed = blamed(&frame(&wrong), &data);
        let own = blamed[..2].iter().find(|blamed| blamed.square == square).unwrap();
        assert!(own.by_m.distance(by_m) < 2e-4, "{} {by_m}", own.by_m);
        assert!(found.square == square || (by_m.length() < 0.002 && !found.is_certain), "{found:?}");
    }
}

#[test]
fn a_view_without_squares_is_where_the_rig_puts_it_and_as_sure_as_the_others_deviate() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(5));
    let frame = frame(&layout);
    let (mut data, _) = simulate(&frame, 40, 0.05, &mut random);
    data[7].squares.clear();
    let found = adjust(&frame, &data).unwrap();
    assert_eq!(found.deviations[7], [0.0; DEVIATIONS]);
    let [covariance, _] = found.covariance(&frame, 7, &data[7]);
    let [others, _] = found.covariance(&frame, 8, &data[8]);
    assert!(covariance[3][3] + covariance[4][4] > 20.0 * (others[3][3] + others[4][4]));
    assert_eq!(found.rms_px(&frame, 7, &data[7]), 0.0);
}

/// Points in no known place, no squares: the rig alone says where the surface is.
#[test]
fn the_covariance_of_poses_from_points_alone_is_the_error_s() {
    let (layout, mut random) = (layout(), StdRng::seed_from_u64(7));
    let points: Vec<DVec3> = (0..24)
        .map(|i| DVec3::new(0.03 * f64::from(i % 6) - 0.075, 0.03 * f64::from(i / 6) - 0.045, 0.0))
        .collect();
    let (mut scores, mut relative) = (vec![], vec![]);
    for _ in 0..5 {
        let mut frame = frame(&layout);
        let mut numbers = [0.0; RIG];
        for (i, number) in numbers.iter_mut().enumerate().filter(|(i, _)| ![6, 9, 11, 12].contains(i)) {
            *number = normal(&mut random) * if i < 7 { 0.003 } else { 0.002 };
        }
        let rig = RigModel::from_numbers(0.9, &numbers);
        let (mut data, mut truth) = (vec![], vec![]);
        for view in 0..24 {
            let (pan_rad, tilt_rad) = (2.4 * f64::from(view), 1.25 * (f64::from(view) + 0.5) / 24.0);
            let deviation = [0.004, 0.003, 0.0, 0.002, 0.0015, 0.0].map(|sigma| sigma * normal(&mut random));
            let seen = rig.see(pan_rad, tilt_rad, &deviation);
            let measured = |(point, place): (usize, &DVec3)| {
                let noise = DVec2::new(normal(&mut random), normal(&mut random)) * 0.1;
                let at = frame.lens.project(seen.to_camera(*place)).unwrap() + noise;
                MeasuredPoint { point, at, covariance: Matrix2::identity() * 0.01 }
            };
            let points = points.iter().enumerate().map(measured).collect();
            data.push(ViewData { pan_rad, tilt_rad, squares: vec![], points });
            truth.push(seen);
        }
        let off = |random: &mut StdRng| DVec3::new(normal(random), normal(random), 0.0) * 0.002;
        frame.points_m = points.iter().map(|&point| point + off(&mut random)).collect();
        frame.is_rig_s = true;
        let found = adjust(&frame, &data).unwrap();
        assert!(found.settled && found.height_m < 1e-4, "{}", found.height_m);
        for (view, (data, truth)) in data.iter().zip(&truth).enumerate() {
            let [covariance, of_picture] = found.covariance(&frame, view, data);
            let error = found.seen(&frame, view, data).difference(truth);
            scores.extend((0..6).map(|i| error[i] / covariance[i][i].sqrt()));
            relative.push(of_picture[3][3] / covariance[3][3]);
        }
    }
    let within = scores.iter().filter(|z| z.abs() < 1.0).count() as f64 / scores.len() as f64;
    println!("{:.1} % of {} errors within one sigma", 100.0 * within, scores.len());
    assert!((0.55..0.8).contains(&within), "{within}");
    // Where the surface is altogether is no doubt of one view against the others.
    assert!(relative.iter().all(|part| *part < 1.0 + 1e-6) && median(&relative) < 0.9, "{relative:?}");
}

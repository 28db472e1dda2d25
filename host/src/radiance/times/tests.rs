use super::super::simulated::{self, CURVES, Curve};
use super::*;
use crate::picture::Picture;

/// Stacks whose photographs were really exposed `factors` times as long as they say.
fn stacks(curve: Curve, times: &[f64], factors: &[f64], views: u64) -> Vec<Stack> {
    let really: Vec<f64> = times.iter().zip(factors).map(|(t, factor)| t * factor).collect();
    let shoot = |view: u64| {
        let scene = simulated::scene(256, 192, view);
        // Only the first view is wrong.
        let really = if view == 0 { &really[..] } else { times };
        let mut stack = simulated::shoot(&scene, 256, really, curve, 1.0, 50 + view);
        stack.exposure_s = times.to_vec();
        let name = |(j, picture): (usize, &mut Picture)| picture.path = format!("view{view}_{j}.jpg").into();
        stack.pictures.iter_mut().enumerate().for_each(name);
        stack
    };
    (0..views).map(shoot).collect()
}

fn learn(stacks: &[Stack]) -> Learnt {
    let mut samples = Samples::default();
    stacks.iter().for_each(|stack| samples.add(stack).unwrap());
    samples.learn().unwrap()
}

fn stops(n: i32, apart: i32) -> Vec<f64> {
    (0..n).map(|j| 2f64.powi(2 - apart * (n / 2 - j))).collect()
}

#[test]
fn right_times_are_not_doubted() {
    for (_, curve) in CURVES {
        for (times, views) in [(stops(9, 1), 1), (stops(3, 3), 1), (stops(2, 1), 3)] {
            let stacks = stacks(curve, &times, &vec![1.0; times.len()], views);
            let learnt = learn(&stacks);
            assert_eq!(learnt.doubtful, []);
            for time in stacks[0].times(&learnt.response, &learnt.noise) {
                assert!((time.measured_s / time.stated_s).ln().abs() < 0.02, "{times:?}: {time:?}");
            }
        }
    }
}

#[test]
fn a_wrong_time_and_a_lamp_that_flickered_are_named_and_measured() {
    // One stack with steps of one stop, first and middle wrong; three photographs of each view, two stops apart.
    for ((_, curve), times, views, wrong, factor) in [
        (CURVES[0], stops(9, 1), 1, 4, 1.3),
        (CURVES[1], stops(9, 1), 1, 0, 0.5),
        (CURVES[1], stops(9, 1), 1, 8, 0.94),
        (CURVES[0], stops(3, 2), 4, 1, 1.3),
        (CURVES[1], stops(3, 2), 4, 2, 0.9),
    ] {
        let mut factors = vec![1.0; times.len()];
        factors[wrong] = factor;
        let learnt = learn(&stacks(curve, &times, &factors, views));
        println!("{} x {views}, {wrong} is {factor}: {:?}", times.len(), learnt.doubtful);
        let [time] = &learnt.doubtful[..] else { panic!("{:?}", learnt.doubtful) };
        let name = format!("view0_{wrong}.jpg");
        assert!(time.path.ends_with(&name), "{time:?} instead of {name}");
        assert!((time.measured_s / time.stated_s / factor).ln().abs() < 0.02, "{time:?}");
        let message = time.error().to_string();
        assert!(message.contains(&name) && message.contains("--exposure-times measured"), "{message}");
    }
}

/// As the memorial church's, which were refused: what a stop is worth, the response may say as well.
#[test]
fn a_power_of_all_times_is_no_wrong_time() {
    for (_, curve) in CURVES {
        let times = stops(9, 1);
        for power in [0.9, 1.1] {
            let factors: Vec<f64> = times.iter().map(|time| time.powf(power - 1.0)).collect();
            let learnt = learn(&stacks(curve, &times, &factors, 1));
            assert_eq!(learnt.doubtful, []);
        }
    }
    let time = |measured_s: f64, stated_s: f64| MeasuredTime {
        path: PathBuf::new(),
        stated_s,
        measured_s,
        sigma: 0.001,
    };
    // And beside it one that is wrong.
    let stated = stops(16, 1);
    let off = |j: usize| if j == 3 { 1.3 } else { 1.0 };
    let mut times: Vec<_> =
        stated.iter().enumerate().map(|(j, &s)| time(off(j) * 1.7 * s.powf(0.87), s)).collect();
    among_all(&mut times, &stated);
    assert!(times.iter().enumerate().all(|(j, time)| time.is_doubtful() == (j == 3)));
    for (j, time) in times.iter().enumerate() {
        assert!((time.measured_s / time.stated_s / off(j)).ln().abs() < 1e-9, "{time:?}");
    }
}

#[test]
fn where_all_scatter_none_is_wrong() {
    let stated = stops(16, 1);
    let time = |(j, &stated_s): (usize, &f64)| MeasuredTime {
        path: PathBuf::new(),
        stated_s,
        measured_s: stated_s * (0.1 * (1.3 * j as f64).sin()).exp(),
        sigma: 0.006,
    };
    let mut times: Vec<_> = stated.iter().enumerate().map(time).collect();
    assert!(times.iter().any(MeasuredTime::is_doubtful));
    among_all(&mut times, &stated);
    assert!(!times.iter().any(MeasuredTime::is_doubtful), "{times:?}");
}

#[test]
fn no_time_is_replaced_that_is_not_told() {
    let times = stops(5, 1);
    for factor in [1.028, 1.036] {
        let stacks = stacks(CURVES[0].1, &times, &[1.0, 1.0, factor, 1.0, 1.0], 2);
        let learnt = learn(&stacks);
        let mut samples = Samples::default();
        for mut stack in stacks {
            for (picture, time_s) in stack.pictures.iter().zip(&mut stack.exposure_s) {
                let told = learnt.doubtful.iter().find(|time| time.path == picture.path);
                *time_s = told.map_or(*time_s, |time| time.measured_s);
            }
            samples.add(&stack).unwrap();
        }
        let expected = samples.response().unwrap();
        let most = (0..3)
            .flat_map(|c| learnt.response.exposure(c)[20..].iter().zip(&expected.exposure(c)[20..]))
            .map(|(a, b)| (a / b).ln().abs())
            .fold(0.0, f32::max);
        println!("{factor}: {} told, response differs by {most}", learnt.doubtful.len());
        assert!(most < 2e-3, "{factor}: {most}, {:?}", learnt.doubtful);
    }
}

#[test]
fn of_two_photographs_one_is_named_where_other_views_tell_the_response() {
    let stacks = stacks(CURVES[0].1, &[2.0, 1.0], &[1.0, 1.2], 4);
    let learnt = learn(&stacks);
    assert_eq!(learnt.doubtful.len(), 1);
    let off = learnt.doubtful[0].measured_s / learnt.doubtful[0].stated_s;
    assert!((off - 1.2).abs() < 0.03, "{off}");
}

/// Of the longest photographs nothing is measured but what compression leaves in the black beside what they saturate.
#[test]
fn the_dirt_in_the_black_is_no_clock() {
    let (times, width) = (stops(8, 1), 256);
    for (_, curve) in CURVES {
        let mut stacks = vec![];
        for view in 0..2 {
            let mut scene = simulated::scene(width, 192, view);
            for (i, radiance) in scene.iter_mut().enumerate() {
                // Bright to the left, black to the right.
                *radiance = radiance.map(|r| if i % width < width / 2 { r.max(0.05) } else { 0.0 });
            }
            let mut stack = simulated::shoot(&scene, width, &times, curve, 1.0, view);
            for picture in &mut stack.pictures {
                for (i, level) in picture.levels.iter_mut().enumerate() {
                    if i % width >= width / 2 {
                        *level = [6 + (i % 3 + i / width % 5) as u16; 3];
                    }
                }
            }
            stacks.push(stack);
        }
        let learnt = learn(&stacks);
        assert_eq!(learnt.doubtful, []);
        let times = stacks[0].times(&learnt.response, &learnt.noise);
        assert!(times.iter().all(|time| !time.is_doubtful()), "{times:?}");
    }
}

#[test]
fn photographs_that_share_nothing_are_not_judged() {
    let black = vec![[1e-9; 3]; 64 * 48];
    let stack = simulated::shoot(&black, 64, &[2.0, 1.0], CURVES[0].1, 1.0, 1);
    let response = Response::srgb(255);
    let times = stack.times(&response, &NoiseModel::assumed(&response));
    assert!(times.iter().all(|time| !time.is_doubtful()), "{times:?}");
}

/// Four of nine photographs were black and said nothing; the five others, whose times are a power of the stated ones, were taken to be wrong.
#[test]
fn what_measured_nothing_has_no_say_in_the_power_of_all_times() {
    let stated_s = stops(9, 1);
    let time = |(j, &stated_s): (usize, &f64)| {
        let is_told = j < 5;
        let measured_s = if is_told { stated_s * stated_s.powf(-0.1) } else { stated_s };
        let sigma = if is_told { 0.002 } else { f64::INFINITY };
        MeasuredTime { path: format!("{j}.png").into(), stated_s, measured_s, sigma }
    };
    let mut times: Vec<MeasuredTime> = stated_s.iter().enumerate().map(time).collect();
    among_all(&mut times, &stated_s);
    for (time, stated_s) in times.iter().zip(&stated_s).take(5) {
        assert!((time.measured_s / stated_s - 1.0).abs() < 1e-9 && !time.is_doubtful(), "{time:?}");
    }
}

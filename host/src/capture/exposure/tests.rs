//! What a planner asks for, on scenes whose every pixel is known.

use super::*;

const LONGEST_S: f64 = 1.0;

/// The times of a bracket: sixteen, down to 1/32768 s.
fn halvings() -> Vec<f64> {
    (0..16).map(|k| LONGEST_S * f64::from(-k).exp2()).collect()
}

fn planner(relative_error: f64, share: f64) -> Planner {
    let response = Response::srgb(255);
    let noise = NoiseModel::assumed(&response);
    Planner::new(Precision { relative_error, share }, response, noise, halvings())
}

/// A photograph without noise of pixels that fill the middle level with radiance 1 in a second.
fn photograph(scene: &[f64], exposure_s: f64) -> Picture {
    let response = Response::srgb(255);
    let table = response.exposure(1);
    let level = |&radiance: &f64| {
        let exposure = (radiance * exposure_s) as f32;
        let above = table.partition_point(|&x| x < exposure);
        let nearer = above > 0 && (above == 256 || exposure - table[above - 1] < table[above] - exposure);
        [(above - usize::from(nearer)) as u16; 3]
    };
    let levels: Vec<[u16; 3]> = scene.iter().map(level).collect();
    Picture { path: "scene".into(), width: levels.len() as u32, height: 1, levels, white: 255 }
}

/// The times that a view needs, and how it ends.
fn take(planner: &Planner, scene: &[f64]) -> (Vec<f64>, Next) {
    take_from(planner, None, scene)
}

/// The same for a view that begins with this time.
fn take_from(planner: &Planner, mut begin: Option<f64>, scene: &[f64]) -> (Vec<f64>, Next) {
    let (mut times, mut taken) = (vec![], vec![]);
    loop {
        assert!(times.len() <= 17, "it never ends: {times:?}");
        match begin.take().map_or_else(|| planner.next(&taken), Next::Expose) {
            Next::Expose(time_s) => {
                assert!(time_s <= LONGEST_S && time_s >= halvings()[15] * 0.999, "{time_s}");
                taken.push(Glimpse::new(&photograph(scene, time_s), time_s, time_s));
                times.push(time_s);
            }
            end => return (times, end),
        }
    }
}

/// What halving takes, and the error that it reaches.
fn halve(scene: &[f64], share: f64) -> (usize, f64) {
    let mut taken = vec![];
    for time_s in halvings() {
        let picture = photograph(scene, time_s);
        taken.push(Glimpse::new(&picture, time_s, time_s));
        if !is_saturated(&picture) {
            break;
        }
    }
    let planner = planner(0.5, share);
    let bins: Vec<usize> = taken.iter().map(|glimpse| bins_below(glimpse.asked_s, LONGEST_S)).collect();
    (taken.len(), Search::new(&planner.curves, &planner.look(&taken), share).error(&bins))
}

/// Pixels of which most are spread over so many stops below the middle level and a few lie above it.
fn scene(below_stops: f64, above_stops: f64, bright_share: f64) -> Vec<f64> {
    const PIXELS: usize = 4000;
    let bright = (PIXELS as f64 * bright_share) as usize;
    (0..PIXELS)
        .map(|i| {
            if i < bright {
                (above_stops * (i + 1) as f64 / bright as f64).exp2()
            } else {
                (-below_stops * (i - bright) as f64 / (PIXELS - bright) as f64).exp2()
            }
        })
        .collect()
}

fn scenes() -> Vec<Vec<f64>> {
    let mut scenes = vec![];
    for below_stops in [0.5, 2.0, 4.0] {
        for above_stops in [0.0, 1.3, 3.7, 6.0, 9.5] {
            for bright_share in [0.002, 0.05, 0.6] {
                scenes.push(scene(below_stops, above_stops, bright_share));
            }
        }
    }
    scenes
}

#[test]
fn whoever_wishes_for_less_gets_no_more_photographs() {
    for scene in scenes() {
        let counts: Vec<usize> = [0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.08, 0.12, 0.2, 0.4]
            .iter()
            .map(|&relative_error| take(&planner(relative_error, 0.99), &scene).0.len())
            .collect();
        assert!(counts.windows(2).all(|pair| pair[0] >= pair[1]), "{counts:?}");
    }
}

#[test]
fn what_halving_reaches_never_takes_more_and_mostly_less() {
    let (mut planned, mut halved) = (0, 0);
    for share in [0.9, 0.99] {
        for scene in scenes() {
            let (most, error) = halve(&scene, share);
            if error >= 1.0 {
                continue;
            }
            let (times, end) = take(&planner(error * 1.0001, share), &scene);
            assert!(matches!(end, Next::Enough(_)), "{end:?} after {times:?} where halving reaches {error}");
            assert!(times.len() <= most, "{times:?} where halving takes {most}");
            (planned, halved) = (planned + times.len(), halved + most);
        }
    }
    println!("{planned} photographs where halving takes {halved}");
    assert!(planned * 6 < halved * 5, "{planned} of {halved}");
}

/// The shortest photograph of a view nearby that is so many stops brighter.
fn nearby(scene: &[f64], stops: f64) -> Glimpse {
    let other: Vec<f64> = scene.iter().map(|radiance| radiance * stops.exp2()).collect();
    let mut shots = halvings().into_iter().map(|time_s| (photograph(&other, time_s), time_s));
    let last = shots.clone().find(|(picture, _)| !is_saturated(picture)).or(shots.next_back());
    last.map(|(picture, time_s)| Glimpse::new(&picture, time_s, time_s)).unwrap()
}

#[test]
fn a_view_that_begins_like_its_neighbour_takes_fewer_and_reaches_the_same() {
    let planner = planner(0.015, 0.99);
    let (mut cold, mut most, mut warm) = (0, 0, [0; 6]);
    for mut scene in scenes() {
        // The longest time is far too long for most.
        scene.iter_mut().for_each(|radiance| *radiance *= 20.0);
        let (times, end) = take(&planner, &scene);
        let all = halvings().into_iter().map(|time_s| (photograph(&scene, time_s), time_s));
        let all: Vec<Glimpse> = all.map(|(picture, t)| Glimpse::new(&picture, t, t)).collect();
        let halved = halve(&scene, 0.99).0;
        (cold, most) = (cold + times.len(), most + halved);
        for (warm, stops) in warm.iter_mut().zip([0.0, -0.3, 1.0, -1.0, 8.0, -8.0]) {
            let begin = planner.first(&nearby(&scene, stops));
            let (begun, reached) = take_from(&planner, Some(begin), &scene);
            *warm += begun.len();
            let context = format!("{stops}: {begun:?} {reached:?}, {times:?} {end:?}, {halved} by halving");
            match reached {
                Next::Enough(_) => {
                    // Whoever knows every pixel's brightness says so, too.
                    let bins: Vec<usize> = begun.iter().map(|&t| bins_below(t, LONGEST_S)).collect();
                    let truly = Search::new(&planner.curves, &planner.look(&all), 0.99).error(&bins);
                    assert!(truly < 1.1 * 0.015, "{context}: {truly}");
                }
                // What begins quite differently may spend what halving takes on finding out, and then says so.
                _ => assert!(stops.abs() > 0.5 || !matches!(end, Next::Enough(_)), "{context}"),
            }
            let too_short = begun.iter().any(|&time_s| time_s < 0.75 * halvings()[halved - 1]);
            assert!(begun.len() <= halved + usize::from(too_short), "{context}");
        }
    }
    println!("{warm:?} photographs, {cold} without a neighbour, {most} by halving");
    assert!(warm[0] < cold && warm[1] < cold);
}

#[test]
fn what_no_time_shows_costs_a_view_that_begins_like_its_neighbour_one_photograph() {
    let mut scene = scene(1.0, 1.0, 0.1);
    let planner = planner(0.1, 0.99);
    let begin = Some(planner.first(&nearby(&scene, 0.0)));
    let (times, end) = take_from(&planner, begin, &scene);
    scene.extend([1e-9; 400]);
    let (again, with_dark) = take_from(&planner, begin, &scene);
    assert!(matches!(end, Next::Enough(_)) && matches!(with_dark, Next::Enough(_)), "{end:?} {with_dark:?}");
    assert!(again.contains(&LONGEST_S) && again.len() <= times.len() + 1, "{times:?} {again:?}");
}

#[test]
fn highlights_get_a_short_time_or_are_flagged() {
    for above_stops in [1.0, 4.0, 8.0, 14.0, 20.0] {
        for relative_error in [0.02, 0.3] {
            let scene = scene(2.0, above_stops, 0.001);
            let (times, end) = take(&planner(relative_error, 0.99), &scene);
            let shortest_s = times.iter().copied().fold(f64::MAX, f64::min);
            let seen = !is_saturated(&photograph(&scene, shortest_s));
            let flagged = matches!(end, Next::Best { clipped: true, .. });
            assert_eq!(seen, !flagged, "{above_stops} stops: {times:?} {end:?}");
            assert_eq!(flagged, above_stops > 14.5);
        }
    }
}

#[test]
fn an_impossible_wish_ends_with_what_can_be_had() {
    for scene in scenes() {
        let (times, end) = take(&planner(1e-4, 0.99), &scene);
        assert_eq!(end, Next::Best { share: 0.0, clipped: false });
        assert_eq!(times.len(), halve(&scene, 0.99).0, "{times:?}");
    }
}

#[test]
fn pixels_that_are_too_dark_cost_no_photographs_and_are_told() {
    let mut scene = scene(1.0, 1.0, 0.1);
    let planner = planner(0.1, 0.99);
    let (times, end) = take(&planner, &scene);
    assert!(matches!(end, Next::Enough(_)), "{end:?}");
    scene.extend([1e-9; 400]);
    assert_eq!(
        take(&planner, &scene),
        (times.clone(), end),
        "what the longest time does not show does not count"
    );
    let level = usize::from(planner.noise.dark_level[1]) + 2;
    scene.extend([f64::from(planner.response.exposure(1)[level]); 400]);
    let (again, end) = take(&planner, &scene);
    assert_eq!(again, times);
    assert!(matches!(end, Next::Best { share, clipped: false } if share > 0.85 && share < 0.95), "{end:?}");
}

#[test]
fn a_camera_that_rounds_its_times_is_followed() {
    // Every time is a third of a stop longer than asked for: the shortest one, too.
    let scene = scene(1.0, 20.0, 0.1);
    let planner = planner(0.05, 0.8);
    let mut taken = vec![];
    while let Next::Expose(time_s) = planner.next(&taken) {
        taken.push(Glimpse::new(&photograph(&scene, time_s * 1.25), time_s, time_s * 1.25));
        assert!(taken.len() <= 16, "it never ends");
    }
    assert!(matches!(planner.next(&taken), Next::Best { clipped: true, .. }));
}

#[test]
fn photographs_of_another_depth_are_refused() {
    let deep = Picture { white: u16::MAX, ..photograph(&[1.0], 1.0) };
    let message = planner(0.01, 0.99).check(&deep).unwrap_err().to_string();
    assert!(message.contains("scene") && message.contains("65535") && message.contains("255"), "{message}");
}

//! The promises of the motion, held against the real trapezoid.

use super::*;

/// Slow and fast, with ramps of no step to a thousand, and intervals and ramps that come out even and do not.
fn paces() -> Vec<Pace> {
    [
        (60_000, 120_000, 60_000),
        (60_000, 120_000, 9_600),
        (1_000, 5_000_000, 3_600),
        (1_000_000, 5_000_000, 30_011),
        (7_777, 3_333, 77_777),
        (300_000, 50_000, 100_000),
        (49_999, 120_000, 20_000),
    ]
    .into_iter()
    .map(|(speed, acceleration, steps)| Pace::new(speed, acceleration, steps).unwrap())
    .collect()
}

/// Short and long ways, and those on which full speed is just reached.
fn lengths(pace: Pace) -> impl Iterator<Item = u32> {
    let both_ramps = (pace.rise_us2 / (pace.interval_us * pace.interval_us)) as u32;
    let just = both_ramps.saturating_sub(4)..both_ramps + 4;
    (0..70).chain((1..12).flat_map(|n| [(1 << n) * 41, (1 << n) * 41 + 1])).chain(just)
}

/// When the real trapezoid from standstill crosses the middle before a step, microseconds from its start.
fn crossing_us(pace: Pace, steps: u32, step: u32) -> f64 {
    let (k, c) = (pace.rise_us2 as f64, pace.interval_us as f64);
    let nearer = f64::from(2 * step.min(steps + 1 - step) - 1);
    let time = if nearer * c * c <= k { (nearer * k).sqrt() } else { nearer * c / 2.0 + k / (2.0 * c) };
    if 2 * step <= steps + 1 { time } else { whole_us(pace, steps) - time }
}

fn whole_us(pace: Pace, steps: u32) -> f64 {
    let (k, c, n) = (pace.rise_us2 as f64, pace.interval_us as f64, f64::from(steps));
    if n * c * c >= k { n * c + k / c } else { 2.0 * (n * k).sqrt() }
}

/// The two promises of the module.
fn check(profile: &Profile) {
    let Profile { steps, pace, end_us, .. } = *profile;
    let late_us = end_us as f64 - whole_us(pace, steps);
    assert!((-1e-3..2.001).contains(&late_us), "{late_us} {profile:?}");
    let mut before = None;
    for step in 1..=steps {
        let time_us = profile.time_us(step);
        let off_us = time_us as f64 - crossing_us(pace, steps, step) - late_us / 2.0;
        assert!(off_us.abs() < 1.001, "step {step} is {off_us} us off: {profile:?}");
        if let Some(before) = before {
            assert!(time_us >= before + pace.interval_us, "step {step} is too fast: {profile:?}");
        }
        before = Some(time_us);
    }
    assert!(before.is_none_or(|last| last <= end_us));
}

#[test]
fn every_step_is_within_one_microsecond_of_a_trapezoid_within_the_limits() {
    for pace in paces() {
        lengths(pace).for_each(|steps| check(&Profile::new(steps, pace)));
    }
}

#[test]
fn paces_never_exceed_the_limits_that_they_come_from() {
    for (speed, acceleration, steps) in
        [(60_000, 120_000, 60_000), (59_999, 119_999, 9_601), (7, 3, 4_194_304)]
    {
        let pace = Pace::new(speed, acceleration, steps).unwrap();
        let (speed, acceleration) =
            (u64::from(speed) * u64::from(steps), u64::from(acceleration) * u64::from(steps));
        // Steps per second are 1e6 / interval and speed / 360 000.
        assert!(
            pace.interval_us * speed >= 360_000_000_000 && (pace.interval_us - 1) * speed < 360_000_000_000
        );
        let inverse = 360_000_000_000_000_000;
        assert!(pace.rise_us2 * acceleration >= inverse && (pace.rise_us2 - 1) * acceleration < inverse);
    }
    assert_eq!(Pace::new(0, 1, 1), None);
    assert_eq!(Pace::new(1, 0, 1), None);
}

#[test]
fn braking_from_any_step_has_the_same_past_and_the_same_promises() {
    for pace in paces() {
        for steps in lengths(pace).filter(|&steps| steps < 3_000) {
            let whole = Profile::new(steps, pace);
            for done in (0..=steps).step_by(1 + steps as usize / 97) {
                let braked = whole.braked(done);
                assert!(braked.steps <= steps && braked.steps >= done);
                assert!(u64::from(braked.steps - done) <= pace.braking_steps());
                if done == 0 {
                    assert_eq!((braked.steps, braked.end_us), (0, 0));
                    continue;
                }
                assert_eq!(braked.time_us(done), whole.time_us(done), "{done} of {whole:?}");
                if braked.steps > done {
                    // Whoever tells it to brake may do so at any time until then.
                    assert_eq!(braked.time_us(done + 1), whole.time_us(done + 1), "{done} of {whole:?}");
                }
                check(&braked);
                assert_eq!(braked.braked(done).steps, braked.steps, "told twice");
            }
        }
    }
}

/// The edges of a motion: when, and which axes step.
fn edges(mut motion: Motion) -> Vec<(u64, [i32; 2])> {
    let mut all = Vec::new();
    while !motion.is_done() {
        let time_us = motion.next_us();
        all.push((time_us, motion.step()));
    }
    assert_eq!(motion.step(), [0; 2]);
    all
}

#[test]
fn both_axes_keep_to_the_line_and_to_their_own_speed_and_end_on_one_edge() {
    let fine = Pace::new(60_000, 120_000, 30_000).unwrap();
    let coarse = Pace::new(60_000, 120_000, 8_000).unwrap();
    for paces in [[fine, fine], [fine, coarse], [coarse, fine]] {
        for way in
            [[900, 0], [0, -3], [7, 7], [-900, 1], [1_000, -999], [301, 900], [-1_000, 333], [2_000, 1_001]]
        {
            let edges = edges(Motion::new(way, paces));
            let mut at = [0_i64; 2];
            let mut last_us = [None; 2];
            for (time_us, step) in &edges {
                for axis in 0..2 {
                    at[axis] += i64::from(step[axis]);
                    if step[axis] != 0
                        && let Some(last) = last_us[axis].replace(*time_us)
                    {
                        assert!(time_us - last >= paces[axis].interval_us, "{way:?} {paces:?}");
                    }
                }
                // The cross product is the distance from the line times the length of the way.
                let off = at[0] * i64::from(way[1]) - at[1] * i64::from(way[0]);
                assert!(
                    off.abs() < i64::from(way[0].abs().max(way[1].abs())),
                    "{way:?} off the line at {at:?}"
                );
            }
            assert_eq!(at, way.map(i64::from));
            if way.iter().all(|&way| way != 0) {
                assert_eq!(last_us[0], last_us[1], "the last steps of both are one edge");
            }
        }
    }
}

#[test]
fn the_follower_keeps_to_its_own_acceleration() {
    // An axis with fine steps leads one with coarse steps whose limits are the narrower ones.
    let fine = Pace::new(60_000, 120_000, 60_000).unwrap();
    let coarse = Pace::new(60_000, 120_000, 6_000).unwrap();
    let motion = Motion::new([6_000, 3_000], [fine, coarse]);
    let pace = motion.profile.pace;
    // 3000 coarse steps are 180 degrees, 6000 fine ones 36: the follower goes five times as far.
    assert!(pace.rise_us2 * 6_000 >= coarse.rise_us2 * 3_000 && pace.rise_us2 > fine.rise_us2);
    assert!(pace.interval_us * 2 >= coarse.interval_us);
}

#[test]
fn the_duration_is_that_of_a_trapezoid_or_a_triangle() {
    // 90 degrees at 60/s and 120/s²: half a second up, half a second down, a second at full speed between.
    let pace = Pace::new(60_000, 120_000, 60_000).unwrap();
    assert_eq!(Profile::new(15_000, pace).end_us, 2_000_000);
    // 1.2 degrees: full speed is never reached, 2 sqrt(1.2 / 120) seconds.
    assert_eq!(Profile::new(200, pace).end_us, 200_000);
}

#[test]
fn the_longest_ways_that_a_rig_may_have_do_not_overflow() {
    // Eight turns of the finest steps, and the slowest pace that goes with them.
    let steps = 8 << 22;
    let slow = Pace { interval_us: 1_000_000, rise_us2: (1 << 62) / (18 << 22) };
    for interval_us in [10, 1_000, 1_000_000] {
        let pace = Pace { interval_us, ..slow };
        let profile = Profile::new(steps, pace);
        let times: Vec<u64> = (0..=200).map(|i| profile.time_us(1 + (steps - 1) / 200 * i)).collect();
        assert!(times.windows(2).all(|times| times[0] < times[1]));
        assert!(times[200] <= profile.end_us && profile.braked(steps / 3).end_us <= profile.end_us);
        let mut motion = Motion::new([steps as i32, -(steps as i32)], [pace; 2]);
        assert_eq!((motion.step(), motion.end_us()), ([1, -1], profile.end_us));
    }
}

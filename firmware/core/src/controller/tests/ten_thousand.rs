//! Ten thousand random moves, edge by edge.

use super::*;

/// Whether the edges of a leg keep to the limits of the rig.
///
/// Between two windows of edges the mean speed may change by no more than the acceleration times the time between their
/// middles: that is so on every course within the limit. An edge may be a microsecond off either way.
pub fn check(leg: &Leg, mechanics: &Mechanics) {
    let Limits { speed_mdeg_s, acceleration_mdeg_s2, .. } = mechanics.limits;
    let lead = usize::from(leg.edges_us[1].len() > leg.edges_us[0].len());
    for (axis, edges_us) in leg.edges_us.iter().enumerate() {
        let steps_per_turn = f64::from(mechanics.steps_per_turn[axis]);
        let [speed, acceleration] =
            [speed_mdeg_s, acceleration_mdeg_s2].map(|mdeg| f64::from(mdeg) * steps_per_turn / 360e3);
        for edges in edges_us.windows(2) {
            assert!((edges[1] - edges[0]) as f64 >= 1e6 / speed, "faster than the limit");
        }
        if axis != lead {
            // Every edge of the follower is one of the leader's.
            let mut leader = leg.edges_us[lead].iter();
            assert!(edges_us.iter().all(|edge| leader.any(|other| other == edge)));
            continue;
        }
        for width in [1, 7, 50, 300] {
            for i in (0..edges_us.len().saturating_sub(2 * width)).step_by(width) {
                let [first, middle, last] = [0, width, 2 * width].map(|j| edges_us[i + j] as f64);
                let steps = width as f64 * 1e6;
                let slower = |window_us: f64| steps / (window_us + 2.0);
                let faster = |window_us: f64| steps / (window_us - 2.0);
                let change = (slower(last - middle) - faster(middle - first))
                    .max(slower(middle - first) - faster(last - middle));
                let allowed = acceleration * ((last - first) / 2.0 + 2.0) * 1e-6;
                assert!(change <= allowed, "{change} steps/s instead of {allowed} over {width} steps");
            }
        }
    }
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn between(&mut self, min: i32, max: i32) -> i32 {
        min + self.below((max - min + 1) as u64) as i32
    }
}

#[test]
fn ten_thousand_random_moves_are_exact_smooth_and_end_together() {
    let mut bench = Bench::homed();
    let mut random = Random(7);
    let mut at = [0; 2];
    let mut edges = 0;
    for n in 0..10_000 {
        let near = |centre: i32, way: i32, min: i32, max: i32, random: &mut Random| {
            (centre + random.between(-way, way)).clamp(min, max)
        };
        let way = [400_000, 20_000, 3_000, 100][random.below(4) as usize];
        at = [
            near(at[0], way, -170_000, 170_000, &mut random),
            near(at[1], way, -10_000, 90_000, &mut random),
        ];
        bench.go(at[0], at[1]);
        let there = nearest(at[0], at[1]);
        assert_eq!((bench.wires.motor, bench.rig.steps()), (there, there), "move {n}");
        assert_eq!(bench.wires.surface, there, "the play is taken up");
        for (axis, half_step_mdeg) in [(0, 18.75), (1, 15.0)] {
            let off_mdeg = f64::from(bench.rig.position_mdeg()[axis] - at[axis]).abs();
            assert!(off_mdeg <= half_step_mdeg + 0.5, "{off_mdeg}");
        }
        // The last leg ends the move for both axes that moved.
        let legs = std::mem::replace(&mut bench.wires.legs, vec![Leg::default()]);
        legs.iter().for_each(|leg| check(leg, &MECHANICS));
        let last = |axis: usize| legs.iter().rev().find_map(|leg| leg.edges_us[axis].last());
        if let (Some(pan), Some(tilt)) = (last(0), last(1)) {
            assert_eq!(pan, tilt, "both axes end on one edge");
        }
        edges += legs.iter().flat_map(|leg| &leg.edges_us).map(Vec::len).sum::<usize>();
    }
    assert!(edges > 10_000_000, "{edges}");
    bench.go(0, 0);
    bench = bench.home();
    assert_eq!(bench.status().lost_steps, [0; 2]);
}

#[test]
fn the_same_angle_is_always_the_same_step_and_comes_back_within_half_a_step() {
    for axis in [Axis::Pan, Axis::Tilt] {
        let steps_per_turn = MECHANICS.steps_per_turn[axis as usize];
        let mut before = i32::MIN;
        for mdeg in -180_000..=180_000 {
            let step = MECHANICS.step(axis, mdeg);
            assert!(step >= before, "monotone");
            before = step;
            let off_mdeg = f64::from(step) * 360e3 / f64::from(steps_per_turn) - f64::from(mdeg);
            assert!(off_mdeg.abs() <= 180e3 / f64::from(steps_per_turn));
            assert_eq!(MECHANICS.step(axis, MECHANICS.mdeg(axis, step)), step, "and back");
        }
    }
}

#[test]
fn a_fast_and_fine_rig_keeps_its_limits_too() {
    let mechanics = Mechanics { steps_per_turn: [60_000, 48_000], backlash_steps: [40, 9], ..MECHANICS };
    let mut bench = Bench::with(mechanics);
    bench.wires.switches = [(-30_833, true), (12_667, false)];
    bench.ask(hello(1));
    bench = bench.home();
    for [pan, tilt] in [[170_000, 90_000], [-1_234, 5_678], [-170_000, 5_679], [0, 0]] {
        bench.go(pan, tilt);
        bench.wires.legs.drain(..).for_each(|leg| check(&leg, &mechanics));
        bench.wires.legs = vec![Leg::default()];
        assert_eq!(bench.wires.motor, bench.rig.steps());
    }
}

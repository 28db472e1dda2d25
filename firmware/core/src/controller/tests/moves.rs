//! Moves, limits, backlash, stopping.

use super::*;

#[test]
fn a_lost_rig_refuses_to_move() {
    let mut bench = Bench::new();
    assert_eq!(bench.ask(move_to(1, 1)), Reply::Refused(Fault::NotHomed));
    assert_eq!((bench.rig.state(), bench.rig.next_us()), (State::Lost, None));
}

#[test]
fn a_move_arrives_when_it_was_promised_and_not_before_it_has_settled() {
    let mut bench = Bench::homed();
    let start_us = bench.wires.now_us;
    let Reply::Accepted { duration_ms } = bench.ask(move_to(90_000, 45_000)) else { panic!() };
    assert_eq!(bench.rig.state(), State::Moving);
    assert_eq!(bench.ask(move_to(0, 0)), Reply::Refused(Fault::Busy));
    assert_eq!(bench.ask(Command::Home), Reply::Refused(Fault::Busy));
    bench.sequence -= 2;
    bench.wait_us(2_010_000);
    assert_eq!((bench.rig.state(), bench.rig.position_mdeg()), (State::Settling, [90_000, 45_000]));
    bench.sequence += 2;
    assert_eq!(bench.ask(move_to(0, 0)), Reply::Refused(Fault::Busy), "not while it swings");
    bench.sequence -= 3;
    let answer = bench.event();
    assert_eq!(answer.reply, Reply::Arrived { pan_mdeg: 90_000, tilt_mdeg: 45_000 });
    assert_eq!(answer.sequence, bench.sequence);
    let swung_us = bench.wires.now_us - bench.wires.last_edge_us();
    assert!(swung_us >= 300_000, "{swung_us}");
    let took_us = bench.wires.now_us - start_us;
    assert!((0..=1_000).contains(&(u64::from(duration_ms) * 1_000 - took_us)), "{took_us} {duration_ms}");
    assert_eq!((bench.rig.state(), bench.rig.next_us()), (State::Still, None), "told once");
}

#[test]
fn a_move_to_where_it_is_arrives_all_the_same() {
    let mut bench = Bench::homed();
    bench.go(12_345, 6_789);
    let edges = bench.wires.edges();
    bench.go(12_345, 6_789);
    assert_eq!(bench.wires.edges(), edges);
}

#[test]
fn limits_are_errors_with_the_value_and_nothing_moves() {
    let mut bench = Bench::homed();
    let (min_mdeg, max_mdeg) = (-180_000, 180_000);
    for asked_mdeg in [180_001, -180_001, i32::MAX, i32::MIN] {
        let fault = Fault::PanOutside { asked_mdeg, min_mdeg, max_mdeg };
        assert_eq!(bench.ask(move_to(asked_mdeg, 0)), Reply::Refused(fault));
    }
    for asked_mdeg in [170_001, -170_001, 180_000] {
        let fault = Fault::Winding { asked_mdeg, limit_mdeg: 170_000 };
        assert_eq!(bench.ask(move_to(asked_mdeg, 0)), Reply::Refused(fault));
    }
    for asked_mdeg in [-10_001, 90_001, i32::MIN, i32::MAX] {
        let fault = Fault::TiltOutside { asked_mdeg, min_mdeg: -10_000, max_mdeg: 90_000 };
        assert_eq!(bench.ask(move_to(0, asked_mdeg)), Reply::Refused(fault));
    }
    assert_eq!((bench.rig.state(), bench.wires.edges()), (State::Still, 0));
    bench.go(-170_000, 90_000);
    bench.go(170_000, -10_000);
}

#[test]
fn every_target_is_reached_from_below_and_the_play_is_taken_up() {
    let mut bench = Bench::homed();
    let there = nearest(20_000, 30_000);
    for [pan, tilt] in
        [[0, 0], [50_000, 60_000], [19_999, 30_001], [20_040, 30_000], [20_000, 0], [-170_000, -10_000]]
    {
        bench.go(pan, tilt);
        assert_eq!(bench.wires.surface, nearest(pan, tilt));
        bench.go(20_000, 30_000);
        assert_eq!((bench.wires.surface, bench.wires.motor), (there, there), "from {pan} {tilt}");
        assert_eq!(bench.rig.steps(), there);
        // Whatever moved went up last.
        assert!(bench.wires.rising.iter().all(|&rising| rising));
    }
}

#[test]
fn at_the_lower_limit_the_shaft_goes_beyond_by_the_backlash_and_the_surface_by_less_than_a_step_more_than_none()
 {
    let mut bench = Bench::homed();
    bench.ask(move_to(-170_000, -10_000));
    let (limit, mut lowest, mut lowest_surface) = (nearest(-170_000, -10_000), [0; 2], [0; 2]);
    while bench.next().is_none() {
        for axis in 0..2 {
            lowest[axis] = lowest[axis].min(bench.wires.motor[axis]);
            lowest_surface[axis] = lowest_surface[axis].min(bench.wires.surface[axis]);
        }
    }
    assert_eq!(lowest, [limit[0] - 5, limit[1] - 3]);
    // The firmware allows for one step more than the play there is.
    assert_eq!(lowest_surface, [limit[0] - 1, limit[1] - 1]);
    assert_eq!(bench.wires.surface, limit);
}

#[test]
fn stop_brakes_on_the_way_and_keeps_the_position() {
    let mut bench = Bench::homed();
    bench.ask(move_to(90_000, 45_000));
    let moving = bench.sequence;
    bench.wait_us(1_000_000);
    let [before, _] = bench.rig.position_mdeg();
    let Reply::Accepted { duration_ms } = bench.ask(Command::Stop) else { panic!() };
    assert!(duration_ms.abs_diff(500 + 300) <= 2, "{duration_ms}");
    assert_eq!(bench.rig.state(), State::Braking);
    assert!(matches!(bench.ask(Command::Stop), Reply::Accepted { .. }));
    let answer = bench.event();
    assert_eq!(answer.sequence, moving);
    let Reply::Stopped { pan_mdeg, tilt_mdeg } = answer.reply else { panic!("{answer:?}") };
    // 15 degrees is v² / 2a.
    assert!((pan_mdeg - before - 15_000).abs() <= 60, "{before} {pan_mdeg}");
    assert!((pan_mdeg - 2 * tilt_mdeg).abs() <= 60, "on the line");
    assert_eq!(bench.rig.steps(), bench.wires.motor);
    assert_eq!(bench.ask(Command::Stop), Reply::Accepted { duration_ms: 0 });
    assert_eq!(bench.status().state, State::Still);
    bench.go(10_000, 10_000);
    assert_eq!(bench.wires.surface, nearest(10_000, 10_000));
}

#[test]
fn stop_at_any_moment_keeps_to_the_deceleration_and_loses_nothing() {
    let mut bench = Bench::homed();
    for (n, after_us) in (0..900_000).step_by(17_321).enumerate() {
        let (pan, tilt) = if n.is_multiple_of(2) { (25_000, -6_000) } else { (-1_000, 3_000) };
        bench.wires.legs = vec![Leg::default()];
        bench.ask(move_to(pan, tilt));
        bench.wait_us(after_us);
        bench.ask(Command::Stop);
        let reply = bench.event().reply;
        assert!(matches!(reply, Reply::Stopped { .. } | Reply::Arrived { .. }));
        bench.wires.legs.iter().for_each(|leg| ten_thousand::check(leg, &MECHANICS));
        assert_eq!(bench.rig.steps(), bench.wires.motor);
    }
}

#[test]
fn after_a_stop_on_the_way_down_the_play_is_taken_up_however_near_the_next_target_is() {
    for above in [0, 1, 4, 30] {
        let mut bench = Bench::homed();
        bench.ask(move_to(-90_000, -9_000));
        bench.wait_us(700_000);
        bench.ask(Command::Stop);
        assert!(matches!(bench.event().reply, Reply::Stopped { .. }));
        let at = bench.rig.steps();
        let goal = [0, 1].map(|axis| {
            let step = at[axis] as i32 + above;
            MECHANICS.mdeg([Axis::Pan, Axis::Tilt][axis], step)
        });
        bench.go(goal[0], goal[1]);
        assert_eq!(bench.wires.surface, at.map(|step| step + i64::from(above)));
    }
}

#[test]
fn stop_while_it_settles_changes_nothing() {
    let mut bench = Bench::homed();
    bench.ask(move_to(3_000, 0));
    let moving = bench.sequence;
    while bench.rig.state() != State::Settling {
        bench.next();
    }
    bench.ask(Command::Stop);
    let answer = bench.event();
    assert!(answer.sequence == moving && matches!(answer.reply, Reply::Arrived { .. }));
}

#[test]
fn a_board_that_was_late_once_goes_on_as_planned() {
    let edges = |late_at: usize| {
        let mut bench = Bench::homed();
        bench.ask(move_to(0, 40_000));
        let mut n = 0;
        loop {
            bench.wires.now_us = bench.rig.next_us().unwrap() + if n == late_at { 50_000 } else { 0 };
            if bench.rig.advance(bench.wires.now_us, &mut bench.wires).is_some() {
                break bench.wires.legs.remove(0).edges_us[1].clone();
            }
            n += 1;
        }
    };
    let gaps = |edges: Vec<u64>| edges.windows(2).map(|edges| edges[1] - edges[0]).collect::<Vec<_>>();
    let planned = gaps(edges(usize::MAX));
    for late_at in [1, 20, 200, 1_300] {
        let kept = gaps(edges(late_at));
        assert!(kept.iter().zip(&planned).all(|(kept, planned)| *kept >= planned - planned / 8));
        assert!(kept.iter().sum::<u64>() <= planned.iter().sum::<u64>() + 50_000, "and nothing is slower");
    }
}

#[test]
fn a_late_board_delays_the_steps_and_never_hurries_them() {
    let mut bench = Bench::homed();
    bench.ask(move_to(40_000, -5_000));
    let mut late_us = 1_u64;
    loop {
        late_us = late_us * 75 % 65_537;
        let due_us = bench.rig.next_us().unwrap();
        bench.wires.now_us = due_us + late_us % 700;
        if let Some(answer) = bench.rig.advance(bench.wires.now_us, &mut bench.wires) {
            assert!(matches!(answer.reply, Reply::Arrived { .. }), "{answer:?}");
            break;
        }
    }
    for leg in &bench.wires.legs {
        for (edges, shortest_us) in leg.edges_us.iter().zip([625, 500]) {
            assert!(edges.windows(2).all(|edges| edges[1] - edges[0] >= shortest_us));
        }
    }
    assert_eq!(bench.wires.motor, nearest(40_000, -5_000));
}

#[test]
fn the_widest_and_slowest_rigs_do_not_overflow() {
    for (speed_mdeg_s, acceleration_mdeg_s2) in [(1_000_000, 5_000_000), (100, 100), (1_000_000, 100)] {
        let (pan_min_mdeg, pan_max_mdeg, winding_mdeg) = (-720_000, 720_000, 720_000);
        let limits =
            Limits { pan_min_mdeg, pan_max_mdeg, winding_mdeg, speed_mdeg_s, acceleration_mdeg_s2, ..LIMITS };
        let mechanics = Mechanics {
            limits,
            steps_per_turn: [3_600; 2],
            backlash_steps: [225; 2],
            switch_mdeg: [-760_000, 130_000],
            seek_mdeg_s: speed_mdeg_s.min(1_000),
            approach_mdeg_s: 100,
            back_off_mdeg: 10_000,
            longest_way_mdeg: [2_880_000; 2],
        };
        let mut bench = Bench::with(mechanics);
        bench.wires.switches = [(-7_600, true), (1_300, false)];
        (bench.wires.motor, bench.wires.surface) = ([0; 2], [0; 2]);
        bench.ask(hello(1));
        for command in [Command::Home, move_to(-720_000, 0), move_to(720_000, 90_000)] {
            assert!(matches!(bench.ask(command), Reply::Accepted { .. }));
            let answer = bench.event();
            assert!(matches!(answer.reply, Reply::Arrived { .. }), "{answer:?}");
        }
        assert_eq!((bench.rig.position_mdeg(), bench.wires.motor), ([720_000, 90_000], [7_200, 900]));
    }
}

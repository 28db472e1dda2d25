//! Homing, and what it finds out.

use super::*;

#[test]
fn zero_is_found_from_anywhere_even_from_the_switches() {
    for motor in [[0, 0], [4_700, -300], [-4_900, 3_100], [-4_933, 3_167], [-4_990, 3_200], [-4_826, 3_034]] {
        let mut bench = Bench::new();
        (bench.wires.motor, bench.wires.surface) = (motor, motor);
        assert_eq!(bench.rig.state(), State::Lost);
        let Reply::Accepted { duration_ms } = bench.ask(Command::Home) else { panic!() };
        let start_us = bench.wires.now_us;
        assert_eq!(bench.rig.state(), State::Homing);
        let arrived = Reply::Arrived { pan_mdeg: 0, tilt_mdeg: 0 };
        assert_eq!(bench.event(), Answer { sequence: bench.sequence, reply: arrived });
        assert_eq!(
            (bench.wires.motor, bench.wires.surface),
            ([0; 2], [0; 2]),
            "the true zero, from {motor:?}"
        );
        assert!(bench.wires.now_us - start_us <= u64::from(duration_ms) * 1_000, "in the time that was told");
        let status = bench.status();
        assert_eq!((status.state, status.halt, status.lost_steps), (State::Still, None, [0; 2]));
    }
}

#[test]
fn the_search_is_fast_and_the_measurement_slow() {
    let mut bench = Bench::new();
    bench.ask(Command::Home);
    bench.event();
    let shortest_us = |leg: &Leg, axis: usize| {
        leg.edges_us[axis].windows(2).map(|edges| edges[1] - edges[0]).min().unwrap_or(u64::MAX)
    };
    // Seek, back off, approach and depart of the pan, then of the tilt, then the way to zero and the take-up.
    assert_eq!(bench.wires.legs.len(), 10);
    for (axis, steps_per_mdeg_s) in [(0, 37_500_000), (1, 30_000_000)] {
        for (leg, speed_mdeg_s) in [(0, 20_000), (1, 20_000), (2, 2_000), (3, 20_000)] {
            let leg = &bench.wires.legs[4 * axis + leg];
            assert!(leg.edges_us[1 - axis].is_empty(), "one axis at a time");
            assert_eq!(shortest_us(leg, axis), steps_per_mdeg_s / speed_mdeg_s);
        }
    }
}

#[test]
fn homing_again_tells_the_lost_steps() {
    let mut bench = Bench::homed();
    bench.go(30_000, 20_000);
    for lost in [[-7, 12], [0, 0], [40, -1]] {
        for (axis, lost) in lost.into_iter().enumerate() {
            bench.wires.motor[axis] -= lost;
            bench.wires.surface[axis] -= lost;
        }
        bench = bench.home();
        assert_eq!(bench.status().lost_steps.map(i64::from), lost);
        assert_eq!(bench.wires.surface, [0; 2]);
    }
}

#[test]
fn steps_lost_in_a_halt_are_told_too() {
    let mut bench = Bench::homed();
    bench.ask(move_to(90_000, 0));
    bench.wait_us(1_000_000);
    bench.wires.blocked = true;
    bench.wait_us(200_000);
    bench.wires.blocked = false;
    bench.wires.stuck[0] = true;
    assert!(matches!(bench.event().reply, Reply::Halted { halt: Halt::Switch(Axis::Pan), .. }));
    bench.wires.stuck[0] = false;
    bench = bench.home();
    let [pan, tilt] = bench.status().lost_steps;
    assert!((300..=325).contains(&pan) && tilt == 0, "200 ms at full speed: {pan}");
}

#[test]
fn a_stuck_switch_is_told_and_nothing_can_move_before_it_is_repaired() {
    for (i, axis) in [(0, Axis::Pan), (1, Axis::Tilt)] {
        let mut bench = Bench::homed();
        bench.wires.stuck[i] = true;
        bench.ask(Command::Home);
        let Answer { sequence, reply: Reply::Halted { halt, .. } } = bench.event() else { panic!() };
        assert_eq!((sequence, halt), (bench.sequence, Halt::StuckSwitch(axis)));
        let edges = bench.wires.edges();
        assert_eq!(bench.rig.next_us(), None);
        let status = bench.status();
        assert_eq!((status.state, status.halt), (State::Lost, Some(halt)), "remembered");
        assert_eq!(bench.ask(move_to(0, 0)), Reply::Refused(Fault::NotHomed));
        assert_eq!(bench.wires.edges(), edges, "the motors stand");
        bench.wires.stuck[i] = false;
        assert_eq!(bench.home().status().halt, None);
    }
}

#[test]
fn a_switch_that_sticks_when_it_has_closed_is_told() {
    for (i, axis) in [(0, Axis::Pan), (1, Axis::Tilt)] {
        let mut bench = Bench::new();
        bench.ask(Command::Home);
        let (edge, _) = bench.wires.switches[i];
        while (bench.wires.motor[i] - edge).abs() > 2 {
            assert_eq!(bench.next(), None);
        }
        bench.wires.stuck[i] = true;
        assert!(matches!(bench.event().reply, Reply::Halted { halt, .. } if halt == Halt::StuckSwitch(axis)));
    }
}

#[test]
fn a_switch_that_never_closes_is_told_after_the_longest_way() {
    for (i, axis) in [(0, Axis::Pan), (1, Axis::Tilt)] {
        let mut bench = Bench::homed();
        bench.wires.dead[i] = true;
        bench.ask(Command::Home);
        assert!(matches!(bench.event().reply, Reply::Halted { halt, .. } if halt == Halt::NoSwitch(axis)));
        let way = bench.wires.motor[i];
        let longest = [10_133, 4_000][i];
        assert_eq!(way.abs(), longest);
        assert_eq!(bench.rig.state(), State::Lost);
        bench.wires.dead[i] = false;
        (bench.wires.motor, bench.wires.surface) = (START, START);
        assert_eq!(
            bench.home().status().lost_steps,
            [0; 2],
            "what was counted on such a way is worth nothing"
        );
    }
}

#[test]
fn homing_that_is_stopped_leaves_the_rig_lost() {
    for after_us in [10_000, 4_000_000, 11_500_000, 14_000_000] {
        let mut bench = Bench::homed();
        bench.ask(Command::Home);
        let homing = bench.sequence;
        bench.wait_us(after_us);
        assert_eq!(bench.rig.state(), State::Homing, "after {after_us}");
        bench.ask(Command::Stop);
        assert_eq!(bench.rig.state(), State::Braking);
        let event = bench.event();
        assert!(event.sequence == homing && matches!(event.reply, Reply::Stopped { .. }), "{event:?}");
        assert_eq!(bench.rig.state(), State::Lost);
        assert_eq!(bench.home().status().lost_steps, [0; 2]);
    }
}

#[test]
fn a_burst_of_noise_in_the_measurement_is_not_taken_for_the_switch() {
    let mut bench = Bench::new();
    bench.ask(Command::Home);
    while bench.wires.legs.len() < 3 || bench.wires.legs[2].edges_us[0].len() < 30 {
        assert_eq!(bench.next(), None);
    }
    bench.wires.noise = 5;
    assert!(matches!(bench.event().reply, Reply::Arrived { .. }));
    assert_eq!(bench.wires.motor, [0; 2]);
    assert_eq!(bench.wires.legs.len(), 10 + 4, "left, sought, backed off and measured once more");
}

#[test]
fn noise_on_a_switch_moves_no_zero() {
    let mut bench = Bench::new();
    bench.ask(Command::Home);
    let mut n = 0_u32;
    while bench.next().is_none() {
        n += 1;
        // Two wrong readings are noise; a third would be believed.
        bench.wires.noise = if n.is_multiple_of(97) && bench.rig.state() == State::Homing { 2 } else { 0 };
    }
    assert!(bench.wires.motor.iter().all(|steps| steps.abs() <= 2), "{:?}", bench.wires.motor);
}

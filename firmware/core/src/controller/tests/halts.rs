//! What makes the rig stop by itself.

use super::*;

#[test]
fn a_limit_switch_that_closes_in_a_move_stops_the_motors_at_once() {
    for (i, axis) in [(0, Axis::Pan), (1, Axis::Tilt)] {
        let mut bench = Bench::homed();
        bench.ask(move_to(60_000, 30_000));
        bench.wait_us(800_000);
        let before = bench.wires.motor;
        bench.wires.stuck[i] = true;
        let answer = bench.event();
        let Reply::Halted { halt, pan_mdeg, tilt_mdeg } = answer.reply else { panic!("{answer:?}") };
        assert_eq!((answer.sequence, halt), (bench.sequence, Halt::Switch(axis)));
        assert_eq!([pan_mdeg, tilt_mdeg], bench.rig.position_mdeg());
        assert!((0..2).all(|i| bench.wires.motor[i] - before[i] <= 3), "three readings");
        assert_eq!((bench.rig.state(), bench.rig.next_us()), (State::Lost, None), "not trusted any more");
        assert_eq!(bench.ask(move_to(0, 0)), Reply::Refused(Fault::NotHomed));
        let status = bench.status();
        assert_eq!((status.halt, status.state), (Some(Halt::Switch(axis)), State::Lost), "and says why");
    }
}

#[test]
fn nothing_is_photographed_while_it_swings_after_a_halt() {
    let mut bench = Bench::homed();
    bench.ask(move_to(60_000, 30_000));
    let moving = bench.sequence;
    bench.wait_us(800_000);
    bench.wires.stuck[0] = true;
    while bench.rig.state() == State::Moving {
        assert_eq!(bench.next(), None);
    }
    let halted_us = bench.wires.now_us;
    let status = bench.status();
    assert_eq!((status.state, status.halt), (State::Settling, Some(Halt::Switch(Axis::Pan))));
    let one = || Command::Trigger(trigger::bracket(0, &[1_000], 0, 0));
    assert_eq!(bench.ask(one()), Reply::Refused(Fault::Busy));
    bench.wait_us(299_999);
    assert_eq!(bench.ask(one()), Reply::Refused(Fault::Busy));
    assert_eq!(bench.ask(Command::Stop), Reply::Accepted { duration_ms: 1 });
    let answer = bench.event();
    assert!(matches!(answer.reply, Reply::Halted { halt: Halt::Switch(Axis::Pan), .. }), "{answer:?}");
    assert_eq!((answer.sequence, bench.wires.now_us), (moving, halted_us + 300_000));
    assert_eq!(bench.rig.state(), State::Lost);
    assert!(matches!(bench.ask(one()), Reply::Accepted { .. }));
}

#[test]
fn a_wrong_reading_stops_nothing() {
    let mut bench = Bench::homed();
    bench.ask(move_to(60_000, 30_000));
    let mut n = 0_u32;
    let answer = loop {
        n += 1;
        bench.wires.noise = u32::from(n.is_multiple_of(50)) * 4;
        if let Some(answer) = bench.next() {
            break answer;
        }
    };
    assert!(matches!(answer.reply, Reply::Arrived { .. }), "{answer:?}");
}

#[test]
fn an_axis_that_does_not_move_may_stand_on_its_switch() {
    let mut bench = Bench::homed();
    bench.wires.stuck[1] = true;
    bench.go(10_000, 0);
    bench.ask(move_to(10_000, 1_000));
    assert!(matches!(bench.event().reply, Reply::Halted { halt: Halt::Switch(Axis::Tilt), .. }));
}

#[test]
fn a_move_that_takes_too_long_is_stopped() {
    for braking in [false, true] {
        let mut bench = Bench::homed();
        let Reply::Accepted { duration_ms } = bench.ask(move_to(60_000, 30_000)) else { panic!() };
        let start_us = bench.wires.now_us;
        if braking {
            bench.wait_us(900_000);
            bench.ask(Command::Stop);
            bench.sequence -= 1;
        }
        // A board that is so slow that the steps take three times as long.
        let answer = loop {
            bench.wires.now_us = bench.rig.next_us().unwrap() + if braking { 20_000 } else { 1_500 };
            if let Some(answer) = bench.rig.advance(bench.wires.now_us, &mut bench.wires) {
                break answer;
            }
        };
        assert!(matches!(answer.reply, Reply::Halted { halt: Halt::TooLong, .. }), "{answer:?}");
        assert_eq!(answer.sequence, bench.sequence);
        assert!(bench.wires.now_us - start_us < u64::from(duration_ms) * 1_000 * 3);
        bench.sequence += 1;
        assert_eq!((bench.status().state, bench.rig.next_us()), (State::Lost, None));
    }
}

#[test]
fn a_silent_host_stops_a_move_within_the_deceleration_and_is_told_why() {
    let mut bench = Bench::homed();
    assert_eq!(bench.ask(Command::DeadMan { silence_ms: 400 }), Reply::Accepted { duration_ms: 0 });
    bench.ask(move_to(160_000, 80_000));
    let moving = bench.sequence;
    // Whoever says anything at all is not silent.
    for _ in 0..5 {
        bench.wait_us(390_000);
        bench.ask(Command::Ping);
        assert_eq!(bench.rig.state(), State::Moving);
    }
    let last_word_us = bench.wires.now_us;
    bench.wait_us(400_000);
    assert_eq!(bench.rig.state(), State::Braking);
    let answer = bench.event();
    assert!(
        matches!(answer.reply, Reply::Halted { halt: Halt::SilentHost, .. }) && answer.sequence == moving
    );
    assert!(bench.wires.last_edge_us() - last_word_us <= 910_000);
    assert!(bench.wires.now_us - last_word_us <= 1_210_000, "half a second of braking, then it settles");
    bench.wires.legs.iter().for_each(|leg| ten_thousand::check(leg, &MECHANICS));
    let status = bench.status();
    assert_eq!((status.state, status.halt), (State::Lost, Some(Halt::SilentHost)));
    assert_eq!(bench.rig.steps(), bench.wires.motor, "no step was lost");
    bench.ask(Command::DeadMan { silence_ms: 0 });
    assert_eq!(bench.home().status().halt, None);
}

#[test]
fn a_silent_host_stops_homing_too() {
    let mut bench = Bench::new();
    bench.ask(Command::DeadMan { silence_ms: 1_000 });
    bench.ask(Command::Home);
    assert!(matches!(bench.event().reply, Reply::Halted { halt: Halt::SilentHost, .. }));
    assert_eq!(bench.rig.state(), State::Lost);
}

#[test]
fn nobody_is_missed_while_nothing_moves_or_when_nobody_asked_for_it() {
    let mut bench = Bench::homed();
    bench.go(170_000, 0);
    bench.ask(Command::DeadMan { silence_ms: 5 });
    assert_eq!(bench.rig.next_us(), None);
    bench.wait_us(10_000_000);
    // A bracket does not move, and it has its end.
    bench.ask(Command::Trigger(trigger::bracket(0, &[100_000], 0, 0)));
    bench.wait_us(100_000 - 1);
    assert!(matches!(bench.event().reply, Reply::Exposed { .. }));
    assert!(matches!(bench.event().reply, Reply::Triggered { .. }));
    bench.ask(Command::DeadMan { silence_ms: 0 });
    bench.go(0, 0);
    // The next host does not know what this one has set.
    bench.ask(Command::DeadMan { silence_ms: 5 });
    bench.ask(hello(2));
    bench.go(10_000, 0);
}

//! Brackets.

use super::*;

pub fn bracket(half_press_ms: u16, pulses_us: &[u32], pause_ms: u16, confirm_ms: u16) -> Bracket {
    Bracket { half_press_ms, pulses_us: pulses_us.iter().copied().collect(), pause_ms, confirm_ms }
}

/// Times and states of a contact, counted from `start_us`.
fn contact(bench: &Bench, start_us: u64, shutter: bool) -> Vec<(u64, bool)> {
    let changes = bench.wires.contacts.iter().filter(|(_, which, _)| *which == shutter);
    changes.map(|(at_us, _, closed)| (at_us - start_us, *closed)).collect()
}

#[test]
fn a_bracket_keeps_its_times_to_the_microsecond() {
    let mut bench = Bench::homed();
    let start_us = bench.wires.now_us;
    let reply = bench.ask(Command::Trigger(bracket(250, &[1_234, 30_000_001, 7], 40, 0)));
    assert_eq!(reply, Reply::Accepted { duration_ms: 250 + 30_002 + 3 * 40 });
    assert_eq!(bench.rig.state(), State::Exposing);
    let mut exposed = Vec::new();
    let end = loop {
        let answer = bench.event();
        assert_eq!(answer.sequence, bench.sequence);
        match answer.reply {
            Reply::Exposed { index, at_us, confirmed } => {
                assert!(!confirmed && !bench.wires.shutter);
                exposed.push((index, at_us - start_us));
            }
            reply => break reply,
        }
    };
    assert_eq!(end, Reply::Triggered { exposed: 3, confirmed: 0 });
    let starts_us = [250_000, 250_000 + 1_234 + 40_000, 250_000 + 1_234 + 40_000 + 30_000_001 + 40_000];
    assert_eq!(exposed, [(0, starts_us[0]), (1, starts_us[1]), (2, starts_us[2])]);
    let pulses: Vec<(u64, bool)> = starts_us
        .into_iter()
        .zip([1_234, 30_000_001, 7])
        .flat_map(|(start, pulse)| [(start, true), (start + pulse, false)])
        .collect();
    assert_eq!(contact(&bench, start_us, true), pulses);
    assert_eq!(
        contact(&bench, start_us, false),
        [(0, true), (starts_us[2] + 7 + 40_000, false)],
        "held throughout"
    );
    let status = bench.status();
    assert_eq!((status.state, status.exposed, status.confirmed), (State::Still, 3, 0));
}

#[test]
fn a_bracket_ends_a_pause_after_its_last_contact_and_nothing_moves_before() {
    // Without a flash-sync, with one that is over before the pause, and with one that is not.
    for (confirm_ms, end_us) in [(0, 1_000 + 500_000), (300, 1_000 + 500_000), (800, 800_000)] {
        let mut bench = Bench::homed();
        let start_us = bench.wires.now_us;
        let reply = bench.ask(Command::Trigger(bracket(0, &[1_000], 500, confirm_ms)));
        let triggering = bench.sequence;
        assert_eq!(reply, Reply::Accepted { duration_ms: (end_us / 1_000) as u32 });
        assert!(matches!(bench.event().reply, Reply::Exposed { index: 0, .. }));
        if confirm_ms < 500 {
            bench.wait_us(start_us + end_us - 1 - bench.wires.now_us);
        }
        assert_eq!(bench.status().state, State::Exposing);
        assert_eq!(bench.ask(move_to(10_000, 0)), Reply::Refused(Fault::Busy));
        let reply = Reply::Triggered { exposed: 1, confirmed: 0 };
        assert_eq!(bench.event(), Answer { sequence: triggering, reply });
        assert_eq!(bench.wires.now_us, start_us + end_us);
        assert!(matches!(bench.ask(move_to(10_000, 0)), Reply::Accepted { .. }));
    }
}

#[test]
fn without_half_press_it_is_not_touched_and_a_rig_that_is_lost_can_photograph() {
    let mut bench = Bench::new();
    bench.ask(Command::Trigger(bracket(0, &[10], 0, 0)));
    assert!(matches!(bench.event().reply, Reply::Exposed { index: 0, .. }));
    assert_eq!(bench.rig.state(), State::Exposing, "until its end is told");
    assert!(matches!(bench.event().reply, Reply::Triggered { exposed: 1, .. }));
    assert_eq!(contact(&bench, 0, false), []);
    assert_eq!(bench.rig.state(), State::Lost);
}

#[test]
fn the_flash_sync_confirms_its_own_photograph_and_no_other() {
    for (pulse_us, flash_us, confirmed) in [
        // While the contact is closed, after it, at the end of its time, too late, never.
        (50_000, Some(20_000), true),
        (5_000, Some(20_000), true),
        (5_000, Some(99_000), true),
        (200_000, Some(101_500), false),
        (500_000, Some(300_000), false),
        (5_000, None, false),
    ] {
        let mut bench = Bench::homed();
        // A flash from before confirms nothing.
        bench.wires.flash = true;
        bench.ask(Command::Trigger(bracket(0, &[pulse_us, pulse_us], 10, 100)));
        let start_us = bench.wires.now_us;
        let mut exposed = Vec::new();
        let end = loop {
            let due_us = bench.rig.next_us().unwrap();
            if let Some(flash_us) = flash_us
                && (bench.wires.now_us..due_us).contains(&(start_us + flash_us))
            {
                bench.wires.flash = true;
            }
            match bench.next().map(|answer| answer.reply) {
                Some(Reply::Exposed { confirmed, .. }) => exposed.push(confirmed),
                Some(reply) => break reply,
                None => {}
            }
        };
        assert_eq!(exposed, [confirmed, false], "pulse {pulse_us}, flash {flash_us:?}");
        assert_eq!(end, Reply::Triggered { exposed: 2, confirmed: confirmed.into() });
        assert_eq!(bench.status().confirmed, u8::from(confirmed));
        let changes = contact(&bench, start_us, true);
        let second_us = changes[2].0;
        let seen_us = if confirmed { flash_us.unwrap_or(0) } else { 100_000 };
        let expected_us = (pulse_us as u64 + 10_000).max(seen_us);
        assert!((expected_us..expected_us + 1_001).contains(&second_us), "{second_us} {expected_us}");
        assert!(
            changes.chunks(2).all(|c| c[1].0 - c[0].0 == u64::from(pulse_us)),
            "the pulses are not touched"
        );
    }
}

#[test]
fn stop_opens_the_contacts_at_once() {
    // Waking up; the first, between, the second; the pause after it. With a flash-sync that never comes and without.
    let cases = [(5_000, 0), (30_000, 1), (130_000, 1), (150_000, 2), (245_000, 2)];
    for (confirm_ms, (wait_us, exposed)) in [0, 115].into_iter().flat_map(|ms| cases.map(|case| (ms, case))) {
        let mut bench = Bench::homed();
        bench.ask(Command::Trigger(bracket(20, &[100_000, 100_000], 20, confirm_ms)));
        let triggering = bench.sequence;
        let end_us = bench.wires.now_us + wait_us;
        while bench.rig.next_us().is_some_and(|due_us| due_us <= end_us) {
            bench.next();
        }
        bench.wires.now_us = end_us;
        for _ in 0..2 {
            assert_eq!(bench.ask(Command::Stop), Reply::Accepted { duration_ms: 0 });
        }
        assert!(!bench.wires.shutter && !bench.wires.half_press);
        let answer = bench.event();
        assert_eq!(answer.reply, Reply::Stopped { pan_mdeg: 0, tilt_mdeg: 0 });
        assert_eq!((answer.sequence, bench.wires.now_us), (triggering, end_us));
        let status = bench.status();
        assert_eq!((status.state, status.exposed, status.confirmed), (State::Still, exposed, 0));
    }
}

#[test]
fn a_photograph_that_is_stopped_is_counted_with_its_flash() {
    let mut bench = Bench::homed();
    bench.ask(Command::Trigger(bracket(0, &[100_000, 100_000], 20, 50)));
    bench.wait_us(10_500);
    bench.wires.flash = true;
    bench.ask(Command::Stop);
    assert!(matches!(bench.event().reply, Reply::Stopped { .. }));
    let status = bench.status();
    assert_eq!((status.exposed, status.confirmed), (1, 1));
}

#[test]
fn photographs_and_moves_exclude_each_other() {
    let mut bench = Bench::homed();
    let one = || Command::Trigger(bracket(0, &[1_000_000], 0, 0));
    bench.ask(one());
    bench.wait_us(10);
    for command in [move_to(1, 1), Command::Home, one()] {
        assert_eq!(bench.ask(command), Reply::Refused(Fault::Busy));
    }
    assert_eq!(bench.wires.edges(), 0);
    bench.ask(Command::Stop);
    bench.event();
    for command in [move_to(30_000, 1), Command::Home] {
        bench.ask(command);
        let begun = bench.sequence;
        let mut seen = Vec::new();
        loop {
            let state = bench.rig.state();
            if seen.last() != Some(&state) {
                seen.push(state);
                assert_eq!(bench.ask(one()), Reply::Refused(Fault::Busy), "{state:?}");
            }
            if let Some(answer) = bench.next() {
                assert_eq!(answer.sequence, begun);
                break;
            }
        }
        assert_eq!(seen.last(), Some(&State::Settling), "never while it swings");
        assert!(!bench.wires.shutter && bench.wires.contacts.len() == 2);
    }
    assert!(matches!(bench.ask(one()), Reply::Accepted { .. }));
}

#[test]
fn a_bracket_without_photographs_is_senseless() {
    let mut bench = Bench::homed();
    for pulses in [&[][..], &[0], &[1_000, 0, 1_000]] {
        let reply = bench.ask(Command::Trigger(bracket(10, pulses, 0, 0)));
        assert_eq!(reply, Reply::Refused(Fault::Senseless));
    }
    assert!(bench.wires.contacts.is_empty() && bench.rig.state() == State::Still);
}

#[test]
fn the_longest_bracket_does_not_overflow() {
    let mut bench = Bench::homed();
    let pulses = [u32::MAX; rigel_protocol::LONGEST_BRACKET];
    let reply = bench.ask(Command::Trigger(bracket(u16::MAX, &pulses, u16::MAX, 0)));
    assert!(matches!(reply, Reply::Accepted { duration_ms: 52_000_000.. }), "{reply:?}");
    for index in 0..12 {
        assert!(matches!(bench.event().reply, Reply::Exposed { index: i, .. } if i == index));
    }
    assert_eq!(bench.event().reply, Reply::Triggered { exposed: 12, confirmed: 0 });
}

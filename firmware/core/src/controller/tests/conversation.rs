//! Who may speak, and that every request is executed once.

use rigel_protocol::{Format, Output, Tracking};

use super::*;

#[test]
fn nothing_is_obeyed_before_a_matching_hello() {
    let mut bench = Bench::with(MECHANICS);
    assert_eq!(bench.ask(Command::Home), Reply::Refused(Fault::NoHello));
    assert_eq!(bench.ask(Command::Ping), Reply::Refused(Fault::NoHello));
    for (version, schema) in [(VERSION + 1, SCHEMA), (VERSION, !SCHEMA)] {
        let Reply::Hello(hello) = bench.ask(Command::Hello { version, schema, conversation: 9 }) else {
            panic!()
        };
        assert_eq!((hello.version, hello.schema), (VERSION, SCHEMA), "the rig names its own");
        assert_eq!(bench.ask(Command::Home), Reply::Refused(Fault::NoHello));
    }
    let Reply::Hello(said) = bench.ask(hello(9)) else { panic!() };
    assert_eq!((said.board.as_str(), said.limits, said.restart), ("bench", LIMITS, Restart::Watchdog));
    assert!(matches!(bench.ask(Command::Home), Reply::Accepted { .. }));
    // Whoever does not fit is told so, and disturbs nobody.
    let other = Command::Hello { version: VERSION + 1, schema: SCHEMA, conversation: 10 };
    assert!(matches!(bench.say(1, other), Reply::Hello(_)));
    assert_eq!(bench.status().state, State::Homing);
}

#[test]
fn a_repeated_request_is_executed_once_and_answered_again() {
    let mut bench = Bench::homed();
    let first = bench.ask(move_to(30_000, 0));
    let moving = bench.sequence;
    bench.wait_us(200_000);
    assert_eq!(bench.say(moving, move_to(30_000, 0)), first, "not busy: the same request");
    assert!(bench.event().sequence == moving);
    assert_eq!(bench.say(moving, move_to(30_000, 0)), first, "not again");
    assert_eq!((bench.rig.state(), bench.rig.next_us()), (State::Still, None));
    let refused = bench.ask(move_to(200_000, 0));
    assert!(matches!(refused, Reply::Refused(Fault::PanOutside { .. })));
    assert_eq!(bench.say(bench.sequence, move_to(200_000, 0)), refused, "answered as the first time");
}

#[test]
fn an_older_request_is_too_late() {
    let mut bench = Bench::homed();
    let old = bench.sequence;
    bench.ask(Command::Ping);
    for command in [Command::Home, move_to(1, 1), Command::Stop, Command::Status, Command::Ping] {
        assert_eq!(bench.say(old, command), Reply::Refused(Fault::Stale));
    }
    assert_eq!(bench.rig.state(), State::Still);
    assert_eq!(bench.say(bench.sequence.wrapping_sub(32_000), Command::Home), Reply::Refused(Fault::Stale));
    // Numbers that were left out are no reason to refuse: their requests were lost on the way.
    bench.sequence += 1_000;
    assert!(matches!(bench.ask(Command::Home), Reply::Accepted { .. }));
}

#[test]
fn the_count_goes_round() {
    let mut bench = Bench::homed();
    for sequence in [30_000, 60_000, u16::MAX] {
        bench.sequence = sequence - 1;
        bench.ask(Command::Ping);
    }
    assert_eq!(bench.sequence, u16::MAX);
    assert!(matches!(bench.say(0, move_to(1_000, 0)), Reply::Accepted { .. }));
    assert_eq!(bench.event().sequence, 0);
    assert_eq!(bench.say(u16::MAX, Command::Home), Reply::Refused(Fault::Stale));
}

#[test]
fn questions_are_answered_anew() {
    let mut bench = Bench::homed();
    let first = bench.ask(Command::Ping);
    assert_eq!(first, Reply::Pong { at_us: bench.wires.now_us });
    bench.wait_us(1_000);
    let again = bench.say(bench.sequence, Command::Ping);
    assert_eq!(again, Reply::Pong { at_us: bench.wires.now_us });
}

#[test]
fn the_hello_of_the_same_conversation_resets_nothing_and_another_one_does() {
    let mut bench = Bench::homed();
    let first = bench.ask(move_to(30_000, 0));
    let moving = bench.sequence;
    assert!(matches!(bench.say(1, hello(1)), Reply::Hello(_)), "a copy that was on its way");
    assert_eq!(bench.say(moving, move_to(30_000, 0)), first);
    assert_eq!(bench.say(moving - 1, Command::Home), Reply::Refused(Fault::Stale));
    // A host that found the rig again says hello in the same conversation, with its next number.
    assert!(matches!(bench.ask(hello(1)), Reply::Hello(_)));
    assert_eq!(bench.say(moving, move_to(30_000, 0)), Reply::Refused(Fault::Stale));
    assert_eq!(bench.say(bench.sequence, Command::Home), Reply::Refused(Fault::Stale), "that was the hello");
    // Another host counts from 1 again; what goes on is not of its conversation.
    bench.sequence = 0;
    bench.ask(hello(2));
    let stopped = bench.ask(Command::Stop);
    assert!(matches!(stopped, Reply::Accepted { .. }));
    let answer = bench.event();
    assert!(answer.sequence == 0 && matches!(answer.reply, Reply::Stopped { .. }), "{answer:?}");
    // A late copy of the first host's hello does not bring it back.
    assert!(matches!(bench.say(1, hello(1)), Reply::Hello(_)));
    assert_eq!(bench.say(2, Command::Stop), stopped);
    assert_eq!(bench.say(1, move_to(5_000, 0)), Reply::Refused(Fault::Stale));
    assert_eq!(bench.rig.state(), State::Still);
}

#[test]
fn the_tracker_is_asked_once_and_its_reply_is_remembered() {
    let mut bench = Bench::new();
    let tracking = Tracking { stations: 1, format: Format::Ascii, output: Output::Euler };
    let track = Request { sequence: 2, command: Command::Track(tracking) };
    assert_eq!(bench.rig.handle(&track, 0, &mut bench.wires), Handled::Tracker);
    let answer = bench.rig.remember(Reply::Accepted { duration_ms: 7 });
    assert_eq!(answer, Answer { sequence: 2, reply: Reply::Accepted { duration_ms: 7 } });
    assert_eq!(bench.rig.handle(&track, 0, &mut bench.wires), Handled::Answer(answer));
    // How the tracker is can be asked again and again.
    let ask = Request { sequence: 3, command: Command::Tracker };
    for _ in 0..2 {
        assert_eq!(bench.rig.handle(&ask, 0, &mut bench.wires), Handled::Tracker);
        assert_eq!(bench.rig.remember(Reply::Pong { at_us: 1 }).sequence, 3);
    }
    // A reply that takes its time is still that request's, and no other's.
    let track = Request { sequence: 4, ..track };
    let stop = Request { sequence: 5, command: Command::Stop };
    assert_eq!(bench.rig.handle(&track, 0, &mut bench.wires), Handled::Tracker);
    assert_eq!(bench.rig.handle(&track, 0, &mut bench.wires), Handled::Tracker, "not yet answered");
    let stopped = bench.rig.handle(&stop, 0, &mut bench.wires);
    assert_eq!(bench.rig.remember(Reply::Pong { at_us: 2 }).sequence, 4);
    assert_eq!(bench.rig.handle(&stop, 0, &mut bench.wires), stopped);
    let stale = Answer { sequence: 4, reply: Reply::Refused(Fault::Stale) };
    assert_eq!(bench.rig.handle(&track, 0, &mut bench.wires), Handled::Answer(stale));
}

#[test]
fn damaged_frames_are_counted() {
    let mut bench = Bench::new();
    for _ in 0..3 {
        bench.rig.bad_frame();
    }
    assert_eq!(bench.status().bad_frames, 3);
}

#[test]
fn whatever_a_line_loses_doubles_and_delays_every_command_is_executed_once() {
    let mut bench = Bench::homed();
    bench.wires.contacts.clear();
    let mut chance = 1_u64;
    let mut below = |n: u64| {
        chance = chance.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (chance >> 33) % n
    };
    // What is on the way, each way; what is late stays in front of what is said after it.
    let (mut to_rig, mut to_host): (Vec<Request>, Vec<Answer>) = (Vec::new(), Vec::new());
    let commands = 5_000;
    for _ in 0..commands {
        bench.sequence = bench.sequence.wrapping_add(1);
        let command = Command::Trigger(trigger::bracket(0, &[1], 0, 0));
        let request = Request { sequence: bench.sequence, command };
        let answered = |answer: &Answer| {
            answer.sequence == request.sequence && matches!(answer.reply, Reply::Accepted { .. })
        };
        for said in 0.. {
            assert!(said < 1_000, "never answered");
            (0..below(3)).for_each(|_| to_rig.push(request.clone()));
            while !to_rig.is_empty() && below(4) > 0 {
                let heard = to_rig.remove(below(to_rig.len() as u64) as usize);
                let Handled::Answer(answer) = bench.rig.handle(&heard, bench.wires.now_us, &mut bench.wires)
                else {
                    panic!()
                };
                let busy = matches!(answer.reply, Reply::Refused(Fault::Busy));
                assert!(!busy, "only one is said at a time");
                (0..below(3)).for_each(|_| to_host.push(answer.clone()));
            }
            // A photograph and its end.
            while bench.rig.next_us().is_some() {
                bench.next();
            }
            while to_host.len() > 3 {
                to_host.remove(below(to_host.len() as u64) as usize);
            }
            if to_host.iter().any(answered) {
                break;
            }
        }
    }
    let closed = bench.wires.contacts.iter().filter(|(_, shutter, closed)| *shutter && *closed).count();
    assert_eq!(closed, commands);
}

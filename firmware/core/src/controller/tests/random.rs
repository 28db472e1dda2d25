//! Anything at any time: what must always be so.

use super::*;

struct Random(u64);

impl Random {
    fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }

    fn command(&mut self) -> Command {
        let mut angle = |most: u64| self.below(2 * most) as i32 - most as i32;
        match angle(15) + 15 {
            0..10 => move_to(angle(15_000), angle(8_000)),
            10..12 => move_to(angle(190_000), angle(100_000)),
            12..15 => Command::Home,
            15..18 => Command::Stop,
            18 => Command::DeadMan { silence_ms: self.below(4) as u32 * 3_000 },
            19..24 => {
                let pulses: Vec<u32> = (0..self.below(4)).map(|_| self.below(200_000) as u32).collect();
                let [half_press, pause, confirm] = [50, 30, 120].map(|ms| self.below(ms) as u16);
                Command::Trigger(trigger::bracket(half_press, &pulses, pause, confirm))
            }
            24 => hello(self.below(5) as u32),
            25 => Command::Hello { version: VERSION + 1, schema: SCHEMA, conversation: 77 },
            26 => Command::Ping,
            _ => Command::Status,
        }
    }
}

/// The bench, and what is known of it from outside.
struct Watch {
    bench: Bench,
    /// What was accepted and has not ended: its sequence number.
    begun: Option<u16>,
    conversations: [u32; 2],
    /// Between these the motors must stay: limits, or where the move began.
    bounds: Option<[[i64; 2]; 2]>,
    seen: Vec<State>,
    ends: [usize; 4],
    last_edge_us: [Option<u64>; 2],
    /// Where the last homing has put the zero.
    off: Option<[i64; 2]>,
}

impl Watch {
    fn ask(&mut self, sequence: u16, command: Command) {
        let edges = self.bench.wires.edges();
        let before = self.bench.rig.state();
        let reply = self.bench.say(sequence, command.clone());
        assert_eq!(self.bench.wires.edges(), edges, "a request makes no step");
        let begins = matches!(command, Command::Home | Command::MoveTo { .. } | Command::Trigger(_));
        let repeated = sequence == self.bench.sequence;
        if let Command::Hello { version: VERSION, conversation, .. } = command
            && !self.conversations.contains(&conversation)
        {
            self.conversations = [self.conversations[1], conversation];
            self.bench.sequence = sequence;
            self.begun = self.begun.map(|_| 0);
        } else if !matches!(reply, Reply::Refused(Fault::Stale)) && !matches!(command, Command::Hello { .. })
        {
            self.bench.sequence = sequence;
        }
        let accepted = matches!(reply, Reply::Accepted { .. });
        if begins && accepted && !repeated && matches!(before, State::Still | State::Lost) {
            assert_eq!(self.begun, None);
            assert!(!matches!(self.bench.rig.state(), State::Still | State::Lost), "{command:?}");
            self.begun = Some(sequence);
            self.off = self.off.filter(|_| command != Command::Home);
            let at = self.bench.rig.steps();
            let limits = [[-4_800 - 5, -334 - 3], [4_800, 3_000]];
            self.bounds = matches!(command, Command::MoveTo { .. }).then(|| {
                [0, 1].map(|i| {
                    [0, 1].map(|axis| {
                        if i == 0 { limits[0][axis].min(at[axis]) } else { limits[1][axis].max(at[axis]) }
                    })
                })
            });
            if let Command::MoveTo { .. } = command {
                assert_eq!(before, State::Still, "whoever is lost does not move");
            }
        }
        self.check();
    }

    fn next(&mut self, late_us: u64) {
        let Some(due_us) = self.bench.rig.next_us() else {
            self.bench.wires.now_us += late_us;
            return;
        };
        let before = self.bench.rig.state();
        self.bench.wires.now_us = self.bench.wires.now_us.max(due_us) + late_us;
        let (edges, position) = (self.bench.wires.edges(), self.bench.rig.steps());
        let answer = self.bench.rig.advance(self.bench.wires.now_us, &mut self.bench.wires);
        if self.bench.wires.edges() > edges {
            assert!(
                matches!(before, State::Homing | State::Moving | State::Braking),
                "a step while {before:?}"
            );
        } else {
            let moved = self.bench.rig.steps() != position;
            assert!(!moved || before == State::Homing, "it only counts otherwise when it finds a switch");
        }
        for (axis, shortest_us) in [(0, 625), (1, 500)] {
            let last = self.bench.wires.legs.last().and_then(|leg| leg.edges_us[axis].last()).copied();
            if let (Some(last), Some(before)) = (last, self.last_edge_us[axis])
                && last != before
            {
                assert!(last - before >= shortest_us, "too fast");
            }
            self.last_edge_us[axis] = last.or(self.last_edge_us[axis]);
        }
        self.bench.wires.legs = vec![Leg::default()];
        if let Some([first, last]) = self.bounds {
            let at = self.bench.rig.steps();
            assert!(
                (0..2).all(|axis| (first[axis]..=last[axis]).contains(&at[axis])),
                "{at:?} beyond the limits"
            );
        }
        let Some(answer) = answer else { return self.check() };
        let end = match answer.reply {
            Reply::Arrived { .. } => 0,
            Reply::Stopped { .. } => 1,
            Reply::Halted { .. } => 2,
            Reply::Triggered { .. } => 3,
            Reply::Exposed { .. } => {
                assert_eq!(Some(answer.sequence), self.begun);
                return self.check();
            }
            reply => panic!("{reply:?} is no event"),
        };
        self.ends[end] += 1;
        assert_eq!(Some(answer.sequence), self.begun.take(), "what began ends once");
        assert!(matches!(before, State::Settling | State::Exposing), "{before:?}");
        if before == State::Settling {
            let last_edge_us = self.last_edge_us.into_iter().flatten().max().unwrap_or(0);
            assert!(self.bench.wires.now_us - last_edge_us >= 300_000, "not before it has settled");
        }
        if end == 0 {
            let off = [0, 1].map(|axis| self.bench.wires.motor[axis] - self.bench.rig.steps()[axis]);
            assert!(off.iter().all(|off| off.abs() <= 10), "noise has moved the switch by {off:?}");
            assert_eq!(*self.off.get_or_insert(off), off, "never a step lost");
        }
        self.check();
    }

    fn check(&mut self) {
        let state = self.bench.rig.state();
        if !self.seen.contains(&state) {
            self.seen.push(state);
        }
        let wires = &self.bench.wires;
        assert!(state == State::Exposing || !wires.shutter && !wires.half_press, "closed while {state:?}");
        let stands = matches!(state, State::Still | State::Lost);
        assert_eq!(stands, self.begun.is_none(), "{state:?}");
        assert_eq!(stands, self.bench.rig.next_us().is_none(), "{state:?}");
    }
}

#[test]
fn whatever_is_said_and_however_the_switches_chatter_it_is_in_one_state_and_within_its_limits() {
    for seed in 0..4 {
        let mut random = Random(seed);
        let mut watch = Watch {
            bench: Bench::new(),
            begun: None,
            conversations: [u32::MAX, 1],
            bounds: None,
            seen: Vec::new(),
            ends: [0; 4],
            last_edge_us: [None; 2],
            off: None,
        };
        for _ in 0..60_000 {
            // In runs, so that homing has a chance to come to its end.
            for _ in 0..[0, 1, 10, 100, 3_000][random.below(5) as usize] {
                watch.next(if random.below(50) == 0 { random.below(2_000) } else { 0 });
                if random.below(3_000) == 0 {
                    // One wrong reading is nothing; a burst is a pressed switch.
                    watch.bench.wires.noise = [1, 2, 30][random.below(3) as usize];
                }
            }
            watch.bench.wires.flash |= random.below(3) == 0;
            let sequence = match random.below(10) {
                0 => watch.bench.sequence,
                1 => watch.bench.sequence.wrapping_sub(random.below(50) as u16),
                _ => watch.bench.sequence.wrapping_add(1),
            };
            watch.ask(sequence, random.command());
            if watch.ends.iter().all(|&n| n > 60) {
                break;
            }
        }
        let all = [
            State::Lost,
            State::Still,
            State::Homing,
            State::Moving,
            State::Braking,
            State::Settling,
            State::Exposing,
        ];
        assert!(all.iter().all(|state| watch.seen.contains(state)), "{:?}", watch.seen);
        assert!(watch.ends.iter().all(|&n| n > 20), "{:?}", watch.ends);
    }
}

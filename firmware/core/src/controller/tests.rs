//! The state machine, with motors and switches that remember everything.

use rigel_protocol::{
    Answer, Axis, Bracket, Command, Fault, Halt, Limits, Reply, Request, Restart, SCHEMA, State, Status,
    VERSION,
};

use super::{Controller, Handled};
use crate::{Mechanics, Pins};

mod conversation;
mod halts;
mod homing;
mod moves;
mod random;
mod ten_thousand;
mod trigger;

const LIMITS: Limits = Limits {
    pan_min_mdeg: -180_000,
    pan_max_mdeg: 180_000,
    winding_mdeg: 170_000,
    tilt_min_mdeg: -10_000,
    tilt_max_mdeg: 90_000,
    speed_mdeg_s: 60_000,
    acceleration_mdeg_s2: 120_000,
    settle_ms: 300,
};

/// The switches lie at opposite ends and the gears differ.
const MECHANICS: Mechanics = Mechanics {
    limits: LIMITS,
    steps_per_turn: [9_600, 12_000],
    backlash_steps: [5, 3],
    switch_mdeg: [-185_000, 95_000],
    seek_mdeg_s: 20_000,
    approach_mdeg_s: 2_000,
    back_off_mdeg: 4_000,
    longest_way_mdeg: [380_000, 120_000],
};

/// A rig can be made where everything is known beforehand.
static CONSTANT: Option<Controller> = Controller::new("constant", MECHANICS, Restart::Power);

/// Where the motors of a rig that was switched on stand: steps from its true zero.
const START: [i64; 2] = [700, 1_500];

/// Motors, switches and contacts.
struct Wires {
    /// Where the motors truly are, steps from the true zero.
    motor: [i64; 2],
    /// Where the surface truly is, behind the play of the gears.
    surface: [i64; 2],
    rising: [bool; 2],
    /// Edges of the switches, and whether they are pressed beyond them with falling steps.
    switches: [(i64, bool); 2],
    /// Switches that are always pressed, and such that never are.
    stuck: [bool; 2],
    dead: [bool; 2],
    /// The next so many readings of any switch are wrong.
    noise: u32,
    /// The motors do not turn.
    blocked: bool,
    shutter: bool,
    half_press: bool,
    flash: bool,
    now_us: u64,
    legs: Vec<Leg>,
    /// When the contacts changed: (time, is it the shutter, closed).
    contacts: Vec<(u64, bool, bool)>,
}

/// Edges between two times at which a direction was set.
#[derive(Debug, Default)]
struct Leg {
    edges_us: [Vec<u64>; 2],
}

impl Wires {
    fn new() -> Self {
        Self {
            motor: START,
            surface: START,
            rising: [true; 2],
            switches: [(-4_933, true), (3_167, false)],
            stuck: [false; 2],
            dead: [false; 2],
            noise: 0,
            blocked: false,
            shutter: false,
            half_press: false,
            flash: false,
            now_us: 0,
            legs: vec![Leg::default()],
            contacts: Vec::new(),
        }
    }

    fn edges(&self) -> usize {
        self.legs.iter().flat_map(|leg| &leg.edges_us).map(Vec::len).sum()
    }

    fn last_edge_us(&self) -> u64 {
        self.legs.iter().flat_map(|leg| &leg.edges_us).flatten().copied().max().unwrap_or(0)
    }
}

impl Pins for Wires {
    fn step(&mut self, axis: Axis) {
        let i = axis as usize;
        if !self.blocked {
            self.motor[i] += if self.rising[i] { 1 } else { -1 };
            let play = i64::from(MECHANICS.backlash_steps[i]) - 1;
            self.surface[i] = self.surface[i].clamp(self.motor[i], self.motor[i] + play);
        }
        self.legs.last_mut().unwrap().edges_us[i].push(self.now_us);
    }

    fn set_direction(&mut self, axis: Axis, positive: bool) {
        self.rising[axis as usize] = positive;
        if self.legs.last().unwrap().edges_us.iter().any(|edges| !edges.is_empty()) {
            self.legs.push(Leg::default());
        }
    }

    fn is_switch_pressed(&mut self, axis: Axis) -> bool {
        let i = axis as usize;
        let (edge, falling) = self.switches[i];
        let beyond = if falling { self.motor[i] <= edge } else { self.motor[i] >= edge };
        let wrong = self.noise > 0;
        self.noise = self.noise.saturating_sub(1);
        (self.stuck[i] || beyond && !self.dead[i]) != wrong
    }

    fn set_half_press(&mut self, closed: bool) {
        if self.half_press != closed {
            self.contacts.push((self.now_us, false, closed));
        }
        self.half_press = closed;
    }

    fn set_shutter(&mut self, closed: bool) {
        if self.shutter != closed {
            self.contacts.push((self.now_us, true, closed));
        }
        self.shutter = closed;
    }

    fn take_flash_sync(&mut self) -> bool {
        std::mem::take(&mut self.flash)
    }
}

/// A rig and a host that talks to it, on a clock that runs when told.
struct Bench {
    rig: Controller,
    wires: Wires,
    sequence: u16,
}

impl Bench {
    fn with(mechanics: Mechanics) -> Self {
        let rig = Controller::new("bench", mechanics, Restart::Watchdog).unwrap();
        let mut bench = Self { rig, wires: Wires::new(), sequence: 0 };
        bench.wires.now_us = 5_000;
        bench
    }

    /// In conversation.
    fn new() -> Self {
        let mut bench = Self::with(MECHANICS);
        bench.ask(hello(1));
        bench
    }

    fn homed() -> Self {
        Self::new().home()
    }

    fn home(mut self) -> Self {
        self.ask(Command::Home);
        assert_eq!(self.event().reply, Reply::Arrived { pan_mdeg: 0, tilt_mdeg: 0 });
        self.wires.legs = vec![Leg::default()];
        self
    }

    fn ask(&mut self, command: Command) -> Reply {
        self.sequence += 1;
        self.say(self.sequence, command)
    }

    fn say(&mut self, sequence: u16, command: Command) -> Reply {
        match self.rig.handle(&Request { sequence, command }, self.wires.now_us, &mut self.wires) {
            Handled::Answer(answer) => {
                assert_eq!(answer.sequence, sequence);
                answer.reply
            }
            Handled::Tracker => panic!("not a question for the tracker"),
        }
    }

    fn status(&mut self) -> Status {
        match self.ask(Command::Status) {
            Reply::Status(status) => status,
            reply => panic!("{reply:?}"),
        }
    }

    /// Does the next thing that is due.
    fn next(&mut self) -> Option<Answer> {
        let due_us = self.rig.next_us().expect("something is due");
        self.wires.now_us = self.wires.now_us.max(due_us);
        self.rig.advance(self.wires.now_us, &mut self.wires)
    }

    /// Goes on to the next event.
    fn event(&mut self) -> Answer {
        (0..10_000_000).find_map(|_| self.next()).expect("an event")
    }

    /// Goes on for so long.
    fn wait_us(&mut self, us: u64) {
        let end_us = self.wires.now_us + us;
        while self.rig.next_us().is_some_and(|due_us| due_us <= end_us) {
            assert_eq!(self.next(), None, "nothing is told meanwhile");
        }
        self.wires.now_us = end_us;
    }

    fn go(&mut self, pan_mdeg: i32, tilt_mdeg: i32) {
        let reply = self.ask(move_to(pan_mdeg, tilt_mdeg));
        assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
        let event = self.event();
        assert_eq!(event.sequence, self.sequence);
        assert!(matches!(event.reply, Reply::Arrived { .. }), "{event:?}");
    }
}

fn hello(conversation: u32) -> Command {
    Command::Hello { version: VERSION, schema: SCHEMA, conversation }
}

fn move_to(pan_mdeg: i32, tilt_mdeg: i32) -> Command {
    Command::MoveTo { pan_mdeg, tilt_mdeg }
}

/// The steps nearest to two angles.
fn nearest(pan_mdeg: i32, tilt_mdeg: i32) -> [i64; 2] {
    let [pan_steps, tilt_steps] = MECHANICS.steps_per_turn.map(f64::from);
    [(pan_mdeg, pan_steps), (tilt_mdeg, tilt_steps)]
        .map(|(mdeg, steps)| (f64::from(mdeg) * steps / 360_000.0 + 0.5).floor() as i64)
}

#[test]
fn a_rig_can_be_made_beforehand() {
    assert!(CONSTANT.is_some());
}

#[test]
fn rigs_that_cannot_be_are_refused() {
    let good = MECHANICS;
    let limits = |limits| Mechanics { limits, ..good };
    let bad = [
        limits(Limits { speed_mdeg_s: 0, ..LIMITS }),
        limits(Limits { acceleration_mdeg_s2: 0, ..LIMITS }),
        limits(Limits { acceleration_mdeg_s2: u32::MAX, ..LIMITS }),
        limits(Limits { pan_min_mdeg: 1, ..LIMITS }),
        limits(Limits { tilt_max_mdeg: 720_001, ..LIMITS }),
        limits(Limits { speed_mdeg_s: u32::MAX, ..LIMITS }),
        limits(Limits { winding_mdeg: -1, ..LIMITS }),
        Mechanics { steps_per_turn: [0, 12_000], ..good },
        Mechanics { steps_per_turn: [9_600, u32::MAX], ..good },
        Mechanics { backlash_steps: [5, 1_000], ..good },
        // Within the limits, within the backlash, beyond the longest way.
        Mechanics { switch_mdeg: [0, 95_000], ..good },
        Mechanics { switch_mdeg: [-180_100, 95_000], ..good },
        Mechanics { longest_way_mdeg: [364_000, 120_000], ..good },
        Mechanics { longest_way_mdeg: [i32::MAX, 120_000], ..good },
        Mechanics { seek_mdeg_s: 0, approach_mdeg_s: 0, ..good },
        Mechanics { approach_mdeg_s: 20_001, ..good },
        Mechanics { seek_mdeg_s: 60_001, ..good },
        // The overrun of the search is longer.
        Mechanics { seek_mdeg_s: 40_000, ..good },
        Mechanics { back_off_mdeg: 0, ..good },
        // Faster than any board steps, and slower than its clock.
        Mechanics { steps_per_turn: [1_000_000, 12_000], ..good },
        Mechanics { approach_mdeg_s: 1, ..good },
    ];
    for mechanics in bad {
        assert!(Controller::new("bad", mechanics, Restart::Power).is_none(), "{mechanics:?}");
    }
    assert!(Controller::new("bench", good, Restart::Power).is_some());
    assert!(Controller::new("a name that is too long for it", good, Restart::Power).is_none());
}

//! The simulated board: the firmware's own core, on a clock of its own, between motors and switches that are not there.

use std::collections::VecDeque;
use std::time::Instant;

use rigel_firmware_core::{Controller, Handled, Mechanics, Pins};
use rigel_protocol::{
    Answer, Axis, Command, Limits, Record, Reply, Request, Restart, State, TrackerState, TrackerStatus,
};

use super::second_line::SecondLine;
use super::{Move, Photograph, RigOptions};
use crate::tracker::{Tracker, gentle};

/// 200 steps of 16 microsteps and a gear of 75 to 4: a step is 6 thousandths of a degree.
const STEPS_PER_TURN: u32 = 60_000;
/// The play in the gears, and what the firmware is told about it, steps.
const PLAY_STEPS: i64 = 3;
const BACKLASH_STEPS: u32 = 4;
/// How far the switches lie beyond the lower limits, and how far homing backs off.
const OVERRUN_MDEG: i32 = 5_000;
/// Where the rig happens to stand when it is switched on, steps.
const START_STEPS: [i64; 2] = [3_000, 1_200];

/// What is known of a tracker that is not plugged in.
const NO_TRACKER: TrackerStatus = TrackerStatus {
    state: TrackerState::Off,
    forwarded: 0,
    rejected: 0,
    skipped_bytes: 0,
    overrun: 0,
    restarts: 0,
};

/// What a simulated rig with these limits is made of.
///
/// The switches lie five degrees beyond the lower limits, and homing searches so fast that it can brake within half of
/// that; the gears have a play of three steps and the firmware takes up four.
pub fn mechanics(limits: Limits) -> Mechanics {
    let Limits { pan_min_mdeg, pan_max_mdeg, tilt_min_mdeg, tilt_max_mdeg, .. } = limits;
    let seek_mdeg_s = (u64::from(limits.acceleration_mdeg_s2) * OVERRUN_MDEG as u64).isqrt() as u32;
    let longest = |min: i32, max: i32| max.saturating_sub(min).saturating_add(2 * OVERRUN_MDEG);
    Mechanics {
        limits,
        steps_per_turn: [STEPS_PER_TURN; 2],
        backlash_steps: [BACKLASH_STEPS; 2],
        switch_mdeg: [pan_min_mdeg, tilt_min_mdeg].map(|min| min.saturating_sub(OVERRUN_MDEG)),
        seek_mdeg_s: seek_mdeg_s.min(limits.speed_mdeg_s),
        approach_mdeg_s: 2_000.min(seek_mdeg_s).min(limits.speed_mdeg_s),
        back_off_mdeg: OVERRUN_MDEG,
        longest_way_mdeg: [longest(pan_min_mdeg, pan_max_mdeg), longest(tilt_min_mdeg, tilt_max_mdeg)],
    }
}

/// The board: the firmware's core and its clock.
pub(super) struct Board {
    controller: Controller,
    bench: Bench,
    second_line: Option<SecondLine>,
    /// What the core has said and nobody has sent.
    pub said: VecDeque<Answer>,
    /// When the move that goes on began.
    began_us: Option<u64>,
    moves: Vec<Move>,
    switched_on: Instant,
    speed_factor: f64,
    mechanics: Mechanics,
}

impl Board {
    /// `None` when there can be no rig with these limits.
    pub fn new(options: &RigOptions) -> Option<Self> {
        let mechanics = mechanics(options.limits);
        let bench =
            Bench { stuck: options.stuck_switch, flash_wired: options.flash_sync, ..Bench::new(&mechanics) };
        Some(Self {
            controller: Controller::new("simulated rig", mechanics, Restart::Power)?,
            bench,
            second_line: options
                .tracker
                .clone()
                .map(|tracker| SecondLine::new(Tracker::new(tracker, gentle()))),
            said: VecDeque::new(),
            began_us: None,
            moves: Vec::new(),
            switched_on: Instant::now(),
            speed_factor: options.speed_factor,
            mechanics,
        })
    }

    /// Starts the program anew: it has forgotten everything, and the motors stand where they happened to be.
    pub fn restart(&mut self, why: Restart) {
        self.catch_up();
        if let Some(controller) = Controller::new("simulated rig", self.mechanics, why) {
            self.controller = controller;
        }
        self.said.clear();
        self.bench.set_shutter(false);
        self.switched_on = Instant::now();
        self.bench.now_us = 0;
    }

    fn now_us(&self) -> u64 {
        (self.switched_on.elapsed().as_secs_f64() * self.speed_factor * 1e6) as u64
    }

    /// Does everything that was due until now, each thing at its own time.
    pub fn catch_up(&mut self) -> u64 {
        let now_us = self.now_us();
        while let Some(due_us) = self.controller.next_us().filter(|&due_us| due_us <= now_us) {
            self.bench.now_us = self.bench.now_us.max(due_us);
            let event = self.controller.advance(self.bench.now_us, &mut self.bench);
            if let Some(Answer { reply: Reply::Arrived { .. }, .. }) = event
                && let Some(began_us) = self.began_us.take()
            {
                self.moves.push(Move { began_us, settled_us: self.bench.now_us });
            }
            self.said.extend(event);
        }
        self.bench.now_us = now_us;
        if let Some(line) = &mut self.second_line {
            line.catch_up(now_us, &mut self.said);
        }
        now_us
    }

    /// The records that the tracker has truly said since this was last asked.
    pub fn take_said(&mut self) -> Vec<Record> {
        self.catch_up();
        self.second_line.as_mut().map_or(vec![], SecondLine::take_said)
    }

    /// Hears a request.
    pub fn hear(&mut self, request: &Request) {
        let now_us = self.catch_up();
        let mut request = request.clone();
        if let Command::DeadMan { silence_ms } = &mut request.command {
            // The host's silence passes in the host's time, which does not run as fast.
            *silence_ms = (f64::from(*silence_ms) * self.speed_factor) as u32;
        }
        let answer = match self.controller.handle(&request, now_us, &mut self.bench) {
            Handled::Answer(answer) => answer,
            Handled::Tracker => {
                let reply = match &mut self.second_line {
                    Some(line) => line.reply(&request, now_us),
                    None => Reply::Tracker(NO_TRACKER),
                };
                self.controller.remember(reply)
            }
        };
        if matches!(request.command, Command::MoveTo { .. }) && self.controller.state() == State::Moving {
            self.began_us.get_or_insert(now_us);
        }
        self.said.push_back(answer);
    }

    /// Hears noise.
    pub fn bad_frame(&mut self) {
        self.controller.bad_frame();
    }

    pub fn state(&self) -> State {
        self.controller.state()
    }

    /// Where the surface is by its gears, radians.
    pub fn surface_rad(&self) -> [f64; 2] {
        self.bench.surface.map(|steps| steps as f64 * std::f64::consts::TAU / f64::from(STEPS_PER_TURN))
    }

    pub fn moves(&self) -> Vec<Move> {
        self.moves.clone()
    }

    pub fn photographs(&self) -> Vec<Photograph> {
        self.bench.photographs.clone()
    }

    /// Turns the surface by hand, past the motors.
    pub fn slip(&mut self, steps: [i64; 2]) {
        for (axis, slipped) in steps.into_iter().enumerate() {
            self.bench.motor[axis] += slipped;
            self.bench.surface[axis] += slipped;
        }
    }
}

/// Motors, gears, switches and contacts.
pub(super) struct Bench {
    /// Where the motors truly are.
    motor: [i64; 2],
    /// Where the surface truly is, behind the play of the gears.
    surface: [i64; 2],
    rising: [bool; 2],
    /// At and below these steps a switch is pressed.
    switches: [i64; 2],
    stuck: Option<Axis>,
    flash_wired: bool,
    flashed: bool,
    /// When the shutter's contact closed.
    closed: Option<u64>,
    photographs: Vec<Photograph>,
    /// The time of what happens next.
    pub(super) now_us: u64,
}

impl Bench {
    /// A rig as it stands when it is switched on, without a flash-sync.
    pub(super) fn new(mechanics: &Mechanics) -> Self {
        let switch_mdeg = mechanics.switch_mdeg.map(i64::from);
        Self {
            motor: START_STEPS,
            surface: START_STEPS,
            rising: [true; 2],
            switches: switch_mdeg.map(|mdeg| mdeg * i64::from(STEPS_PER_TURN) / 360_000),
            stuck: None,
            flash_wired: false,
            flashed: false,
            closed: None,
            photographs: Vec::new(),
            now_us: 0,
        }
    }
}

impl Pins for Bench {
    fn step(&mut self, axis: Axis) {
        let i = axis as usize;
        self.motor[i] += if self.rising[i] { 1 } else { -1 };
        self.surface[i] = self.surface[i].clamp(self.motor[i], self.motor[i] + PLAY_STEPS);
    }

    fn set_direction(&mut self, axis: Axis, positive: bool) {
        self.rising[axis as usize] = positive;
    }

    fn is_switch_pressed(&mut self, axis: Axis) -> bool {
        let i = axis as usize;
        self.stuck == Some(axis) || self.motor[i] <= self.switches[i]
    }

    fn set_half_press(&mut self, _closed: bool) {}

    fn set_shutter(&mut self, closed: bool) {
        if closed {
            self.closed = Some(self.now_us);
            self.flashed = self.flash_wired;
        } else if let Some(closed_us) = self.closed.take() {
            self.photographs.push(Photograph { closed_us, opened_us: self.now_us });
        }
    }

    fn take_flash_sync(&mut self) -> bool {
        std::mem::take(&mut self.flashed)
    }
}

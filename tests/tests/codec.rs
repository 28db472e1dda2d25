//! A million frames and every kind of damage; and a rig that obeys once, whatever becomes of what it hears and says.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::rig::{Contact, Ends, Place, Rig, SerialRig, Timing};
use rigel_firmware_core::{Controller, Handled, Pins};
use rigel_protocol::{
    Answer, Axis, Decoder, LARGEST_FRAME, Orientation, Record, Reply, Request, Restart, State, Status,
    encode, frame,
};
use rigel_simulated::rig::{RigOptions, mechanics};

/// Faults per byte.
const RATES: [f64; 5] = [1e-5, 1e-4, 1e-3, 1e-2, 1e-1];
const FRAMES_PER_RATE: u32 = 200_000;

/// The message of that number: its kind and all its content follow from it.
fn message(number: u32) -> Answer {
    let mixed = number.wrapping_mul(0x9e37_79b9);
    let [a, b, c] = [mixed as i32, mixed.rotate_left(7) as i32, -(number as i32)];
    let reply = match number % 4 {
        0 => Reply::Pong { at_us: u64::from(number) },
        1 => Reply::Record(Record {
            count: number,
            at_us: u64::from(mixed) << 20,
            station: 1,
            status: mixed as u8,
            position_um: [a, b, c],
            orientation: Orientation::Quaternion([c, b, a, 0]),
        }),
        2 => Reply::Log { text: format!("{number} {mixed}").as_str().try_into().unwrap() },
        _ => Reply::Status(Status {
            state: State::Still,
            pan_mdeg: a,
            tilt_mdeg: b,
            halt: None,
            lost_steps: [c, a],
            exposed: 0,
            confirmed: 0,
            bad_frames: number,
        }),
    };
    Answer { sequence: number as u16, reply }
}

/// The number of a message.
fn number(answer: &Answer) -> Option<u32> {
    match &answer.reply {
        Reply::Pong { at_us } => u32::try_from(*at_us).ok(),
        Reply::Record(record) => Some(record.count),
        Reply::Log { text } => text.split(' ').next()?.parse().ok(),
        Reply::Status(status) => Some(status.bad_frames),
        _ => None,
    }
}

/// Spoils bytes, each with a probability of `rate`; how many.
fn spoil(bytes: &[u8], rate: f64, random: &mut StdRng, out: &mut Vec<u8>) -> u64 {
    let mut faults = 0;
    for &byte in bytes {
        if !random.random_bool(rate) {
            out.push(byte);
            continue;
        }
        faults += 1;
        match random.random_range(0..4) {
            0 => out.push(byte ^ 1 << random.random_range(0..8)),
            1 => {}
            2 => out.extend([byte, byte]),
            _ => out.extend([byte, random.random()]),
        }
    }
    faults
}

#[test]
fn no_wrong_message_is_accepted_and_a_fault_costs_one_frame_at_most() {
    for (seed, rate) in (1..).zip(RATES) {
        let mut random = StdRng::seed_from_u64(seed);
        let (mut decoder, mut heard) = (Decoder::new(), vec![false; FRAMES_PER_RATE as usize]);
        let (mut faults, mut refused, mut line) = (0_u64, 0_u64, Vec::new());
        let (mut buffer, mut late) = ([0; LARGEST_FRAME], None::<Vec<u8>>);
        for sent in 0..FRAMES_PER_RATE {
            line.clear();
            let frame = encode(&message(sent), &mut buffer).unwrap();
            // Whole frames fare as badly as bytes do.
            let fate = if random.random_bool(rate) { random.random_range(1..5) } else { 0 };
            faults += u64::from(fate > 0);
            let overtaken = late.take();
            match fate {
                // Cut anywhere.
                1 => {
                    faults +=
                        spoil(&frame[..random.random_range(0..frame.len())], rate, &mut random, &mut line)
                }
                2 => {
                    faults += spoil(frame, rate, &mut random, &mut line);
                    faults += spoil(frame, rate, &mut random, &mut line);
                }
                // Overtaken by the next.
                3 if sent + 1 < FRAMES_PER_RATE => late = Some(frame.to_vec()),
                // Dropped.
                4 => {}
                _ => faults += spoil(frame, rate, &mut random, &mut line),
            }
            if let Some(frame) = overtaken {
                faults += spoil(&frame, rate, &mut random, &mut line);
            }
            for &byte in &line {
                match decoder.push(byte).map(|found| found.and_then(frame::decode::<Answer>)) {
                    None => {}
                    Some(Err(_)) => refused += 1,
                    Some(Ok(answer)) => {
                        let found = number(&answer).expect("a message that nobody says");
                        assert!(found <= sent && answer == message(found), "a wrong message: {answer:?}");
                        heard[found as usize] = true;
                    }
                }
            }
        }
        let lost = heard.iter().filter(|&&heard| !heard).count() as u64;
        println!(
            "{rate:.0e} per byte: {FRAMES_PER_RATE} frames, {faults} faults, {lost} lost, {refused} refused, 0 wrong"
        );
        assert!(lost <= faults, "{lost} frames lost to {faults} faults");
        assert!(faults > 0 && lost > 0, "nothing was tried");
    }
}

/// A rig in memory, behind a line that spoils, repeats and delays; it works when it is spoken to.
struct Rigged {
    controller: Controller,
    bench: Bench,
    now_us: u64,
    rate: f64,
    random: StdRng,
    decoder: Decoder,
    /// What the rig will hear again, later.
    echo: Vec<u8>,
    /// What the host has not read yet.
    said: VecDeque<u8>,
}

#[derive(Default)]
struct Bench {
    photographs: u32,
}

impl Pins for Bench {
    fn step(&mut self, _: Axis) {}
    fn set_direction(&mut self, _: Axis, _: bool) {}
    fn is_switch_pressed(&mut self, _: Axis) -> bool {
        false
    }
    fn set_half_press(&mut self, _: bool) {}
    fn set_shutter(&mut self, closed: bool) {
        self.photographs += u32::from(closed);
    }
    fn take_flash_sync(&mut self) -> bool {
        false
    }
}

impl Rigged {
    fn hear(&mut self, bytes: &[u8]) {
        let mut line = Vec::new();
        spoil(bytes, self.rate, &mut self.random, &mut line);
        if self.random.random_bool(self.rate) {
            line.extend(&self.echo);
        }
        if self.random.random_bool((10.0 * self.rate).min(0.5)) {
            self.echo = bytes.to_vec();
        }
        for byte in line {
            let request = match self.decoder.push(byte) {
                None => continue,
                Some(found) => found.and_then(frame::decode::<Request>),
            };
            let Ok(request) = request else { continue };
            match self.controller.handle(&request, self.now_us, &mut self.bench) {
                Handled::Answer(answer) => self.say(&answer),
                Handled::Tracker => unreachable!("nobody asks for a tracker"),
            }
        }
        self.now_us += 20_000;
        while self.controller.next_us().is_some_and(|due_us| due_us <= self.now_us) {
            if let Some(event) = self.controller.advance(self.now_us, &mut self.bench) {
                self.say(&event);
            }
        }
    }

    fn say(&mut self, answer: &Answer) {
        let mut line = Vec::new();
        let mut buffer = [0; LARGEST_FRAME];
        let frame = encode(answer, &mut buffer).unwrap();
        let times = if self.random.random_bool(self.rate) { 2 } else { 1 };
        for _ in 0..times {
            spoil(frame, self.rate, &mut self.random, &mut line);
        }
        self.said.extend(line);
    }
}

#[derive(Clone)]
struct InMemory(Arc<(Mutex<Rigged>, Condvar)>);

impl InMemory {
    fn new(rate: f64, seed: u64) -> Self {
        let limits = RigOptions::default().limits;
        let rigged = Rigged {
            controller: Controller::new("memory", mechanics(limits), Restart::Power).unwrap(),
            bench: Bench::default(),
            now_us: 0,
            rate,
            random: StdRng::seed_from_u64(seed),
            decoder: Decoder::new(),
            echo: vec![],
            said: VecDeque::new(),
        };
        Self(Arc::new((Mutex::new(rigged), Condvar::new())))
    }
}

impl Place for InMemory {
    fn name(&self) -> String {
        "memory".into()
    }

    fn open(&mut self) -> Result<Ends, String> {
        Ok(Ends { reader: Box::new(self.clone()), writer: Box::new(self.clone()) })
    }
}

impl Read for InMemory {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let (rigged, news) = &*self.0;
        let mut rigged = rigged.lock().unwrap();
        if rigged.said.is_empty() {
            rigged = news.wait_timeout(rigged, Duration::from_millis(10)).unwrap().0;
        }
        if rigged.said.is_empty() { Err(ErrorKind::TimedOut.into()) } else { rigged.said.read(buffer) }
    }
}

impl Write for InMemory {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let (rigged, news) = &*self.0;
        rigged.lock().unwrap().hear(bytes);
        news.notify_all();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn every_command_is_executed_exactly_once_whatever_the_line_does() {
    for ((seed, rate), brackets) in (1..).zip(RATES).zip([800, 800, 500, 200, 8]) {
        let memory = InMemory::new(rate, seed);
        let timing = Timing { reply: Duration::from_millis(1), attempts: 100_000, ..Timing::default() };
        let rig = SerialRig::greet_at(Box::new(memory.clone()), timing).unwrap();
        let mut line = rig.trigger_line();
        line.contact = Contact { half_press_s: 0.0, pause_s: 0.0, confirm_s: 0.0 };
        let mut asked = 0;
        for bracket in 0..brackets {
            let count = bracket % 3 + 1;
            asked += count as u32;
            assert_eq!(line.expose(&[0.001, 0.002, 0.003][..count]).unwrap().len(), count);
            // Not once too few and not once too often, at any moment.
            assert_eq!(memory.0.0.lock().unwrap().bench.photographs, asked, "bracket {bracket} at {rate}");
        }
        assert!(rig.describe().contains("memory"));
    }
}

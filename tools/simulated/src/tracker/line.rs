//! The line from the tracker to the rig, and what goes wrong on it.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

/// What goes wrong on the line: how often per byte, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LineFaults {
    /// A byte is lost.
    pub dropped: f64,
    /// A byte comes twice.
    pub doubled: f64,
    /// One bit of a byte is wrong.
    pub flipped: f64,
    /// The line is cut for the time of 1 to 150 bytes, in which at least so many are lost.
    pub cut: f64,
    /// One to forty bytes of anything come in between.
    pub babbled: f64,
}

impl LineFaults {
    /// Lost, doubled, cut and babbled, each at this rate per byte.
    pub fn all_but_flips(rate: f64) -> Self {
        Self { dropped: rate, doubled: rate, flipped: 0.0, cut: rate, babbled: rate }
    }
}

/// The time of ten bits at 115 200 baud, in ninths of a microsecond.
const BYTE_NINTHS_US: u64 = 781;

/// A serial line at 115 200 baud. A byte that is lost takes its time nevertheless.
pub struct Line {
    /// What goes wrong; may be changed at any time.
    pub faults: LineFaults,
    /// When the first byte of what was last sent went out (or would have, had it not been lost).
    pub started_us: u64,
    /// Whether the line has changed anything of what was last sent.
    pub damaged: bool,
    random: StdRng,
    /// When the line is free, in ninths of a microsecond.
    free_ninths: u64,
    /// How many of the next bytes are lost.
    cut: u32,
    /// How many bytes go by until the next fault of each kind.
    until: [f64; 5],
    armed: Option<LineFaults>,
}

impl Line {
    /// A line with these faults, drawn from `seed`.
    pub fn new(faults: LineFaults, seed: u64) -> Self {
        Self {
            faults,
            started_us: 0,
            damaged: false,
            random: StdRng::seed_from_u64(seed),
            free_ninths: 0,
            cut: 0,
            until: [0.0; 5],
            armed: None,
        }
    }

    /// Sends bytes, not before `at_us` nor before those of earlier calls; returns those that arrive, with their times.
    pub fn send(&mut self, bytes: &[u8], at_us: u64) -> Vec<(u64, u8)> {
        self.arm();
        self.free_ninths = self.free_ninths.max(at_us * 9);
        self.started_us = self.free_ninths / 9;
        self.damaged = false;
        let mut arrived = Vec::with_capacity(bytes.len() + 8);
        for &byte in bytes {
            self.cut = self.cut.saturating_sub(1);
            if self.due(3) {
                self.cut = self.random.random_range(1..=150);
            }
            if self.due(4) {
                self.damaged = true;
                for _ in 0..self.random.random_range(1..=40) {
                    let noise = self.random.random();
                    self.put(&mut arrived, noise);
                }
            }
            let mut byte = byte;
            if self.due(2) {
                self.damaged = true;
                byte ^= 1 << self.random.random_range(0..8);
            }
            if self.due(0) || self.cut > 0 {
                self.damaged = true;
                self.free_ninths += BYTE_NINTHS_US;
                continue;
            }
            self.put(&mut arrived, byte);
            if self.due(1) {
                self.damaged = true;
                self.put(&mut arrived, byte);
            }
        }
        arrived
    }

    fn put(&mut self, arrived: &mut Vec<(u64, u8)>, byte: u8) {
        arrived.push((self.free_ninths / 9, byte));
        self.free_ninths += BYTE_NINTHS_US;
    }

    fn rates(&self) -> [f64; 5] {
        let LineFaults { dropped, doubled, flipped, cut, babbled } = self.faults;
        [dropped, doubled, flipped, cut, babbled]
    }

    /// Draws the first fault of each kind after the rates have changed.
    fn arm(&mut self) {
        if self.armed != Some(self.faults) {
            self.armed = Some(self.faults);
            self.until = self.rates().map(|rate| self.draw(rate));
        }
    }

    /// How many bytes go by until the next fault of this rate.
    fn draw(&mut self, rate: f64) -> f64 {
        if rate > 0.0 {
            (self.random.random::<f64>().max(1e-300).ln() / (-rate).ln_1p()).floor()
        } else {
            f64::MAX
        }
    }

    fn due(&mut self, kind: usize) -> bool {
        if self.until[kind] > 0.0 {
            self.until[kind] -= 1.0;
            return false;
        }
        self.until[kind] = self.draw(self.rates()[kind]);
        true
    }
}

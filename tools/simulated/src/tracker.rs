//! An Isotrak II that is not there: bytes in, bytes out, on a clock that the caller owns; what it said is kept.

use glam::{DQuat, DVec3};
use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel_firmware_core::isotrak::{Layout, List};
use rigel_protocol::{Format, Output, Record};

mod line;
mod run;
mod say;

pub use line::{Line, LineFaults};
pub use run::TrackerRunner;
pub use say::Teller;

/// Where receivers are: seconds and station (1 or 2) to position (metres) and orientation, both in the transmitter's
/// axes.
pub type Motion = Box<dyn FnMut(f64, u8) -> (DVec3, DQuat) + Send>;

/// What kind of tracker is simulated.
#[derive(Debug, Clone)]
pub struct TrackerOptions {
    /// How many receivers are plugged in: 1 or 2.
    pub receivers: u8,
    /// Records per second; two receivers share them.
    pub rate_hz: f64,
    /// Standard deviation of a coordinate, metres.
    pub position_noise_m: f64,
    /// Standard deviation of the angle about each axis, radians.
    pub angle_noise_rad: f64,
    /// Which lists it obeys; another one leaves the list as it is.
    pub obeys: &'static [List],
    /// How long it is deaf and mute after it was switched on or reinitialised, seconds.
    pub boot_s: f64,
    /// What goes wrong on its line towards the rig.
    pub faults: LineFaults,
    /// Where its noise and the faults are drawn from.
    pub seed: u64,
}

impl Default for TrackerOptions {
    /// One receiver, 60 records per second, noise of 0.05 mm and 0.03°, 10 s to boot (it is on already), no faults.
    fn default() -> Self {
        Self {
            receivers: 1,
            rate_hz: 60.0,
            position_noise_m: 5e-5,
            angle_noise_rad: 5e-4,
            obeys: &[List::Once, List::Twice, List::Cosines],
            boot_s: 10.0,
            faults: LineFaults::default(),
            seed: 1,
        }
    }
}

/// How the tracker behaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mood {
    /// As it should.
    Good,
    /// It says nothing and obeys nothing.
    Silent,
    /// It says anything but records, and obeys nothing.
    Babbling,
    /// It says the same pose again and again.
    Stuck,
    /// Its program hangs, talking nonsense, until it is reinitialised.
    Hung,
    /// Its second receiver's records are missing.
    OneReceiver,
}

/// The tracker.
pub struct Tracker {
    options: TrackerOptions,
    motion: Motion,
    mood: Mood,
    teller: Teller,
    line: Line,
    noise: StdRng,
    command: Vec<u8>,
    continuous: bool,
    suspended: bool,
    active: [bool; 2],
    inches: bool,
    next_us: u64,
    turn: u8,
    deaf_until_us: u64,
    said: Vec<Record>,
    heard: Vec<Vec<u8>>,
}

/// A gentle motion: a few centimetres and tens of degrees within ten seconds.
pub fn gentle() -> Motion {
    Box::new(|s, station| {
        let phase = f64::from(station);
        let at_m = DVec3::new(
            0.4 + 0.05 * (0.6 * s + phase).sin(),
            0.1 * phase + 0.04 * (0.5 * s).cos(),
            -0.1 + 0.03 * (0.7 * s + phase).sin(),
        );
        let axis = DVec3::new((0.1 * s).cos(), (0.13 * s + phase).sin(), 0.8).normalize();
        (at_m, DQuat::from_axis_angle(axis, 0.7 * (0.5 * s + phase).sin()))
    })
}

impl Tracker {
    /// A tracker that has been on for long, with its settings after switching on: silent, ASCII, inches, `O2,4,1`.
    pub fn new(options: TrackerOptions, motion: Motion) -> Self {
        let line = Line::new(options.faults, options.seed ^ 0x11e);
        let noise = StdRng::seed_from_u64(options.seed);
        let teller = Teller::new(Layout { format: Format::Ascii, output: Output::Euler, list: List::Once });
        Self {
            motion,
            mood: Mood::Good,
            teller,
            line,
            noise,
            command: Vec::new(),
            continuous: false,
            suspended: false,
            active: [true, options.receivers > 1],
            inches: true,
            next_us: 0,
            turn: 2,
            deaf_until_us: 0,
            said: Vec::new(),
            heard: Vec::new(),
            options,
        }
    }

    /// Changes its behaviour.
    pub fn set_mood(&mut self, mood: Mood) {
        self.mood = mood;
    }

    /// Changes what goes wrong on its line.
    pub fn set_faults(&mut self, faults: LineFaults) {
        self.line.faults = faults;
    }

    /// Makes it write in this layout, as `F`, `f` and `O` would.
    pub fn set_layout(&mut self, layout: Layout) {
        self.teller.layout = layout;
    }

    /// The line on which it talks.
    pub fn line(&self) -> &Line {
        &self.line
    }

    /// Switches it off and on again: it forgets its settings and boots.
    pub fn restart(&mut self, now_us: u64) {
        self.forget();
        self.deaf_until_us = now_us + (self.options.boot_s * 1e6) as u64;
    }

    /// The records that it has truly said since this was last asked, with the time of their first byte.
    pub fn take_said(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.said)
    }

    /// The commands that it has obeyed since this was last asked, without their returns.
    pub fn take_heard(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.heard)
    }

    /// When it wants to say something by itself.
    pub fn next_us(&self) -> Option<u64> {
        let talks = self.continuous && !self.suspended || matches!(self.mood, Mood::Babbling | Mood::Hung);
        talks.then(|| self.next_us.max(self.deaf_until_us))
    }

    /// Hears a byte; returns what it answers, each byte with its time.
    pub fn hear(&mut self, byte: u8, now_us: u64) -> Vec<(u64, u8)> {
        if now_us < self.deaf_until_us || matches!(self.mood, Mood::Silent | Mood::Babbling) {
            return Vec::new();
        }
        if byte == 0x19 {
            self.heard.push(vec![byte]);
            if self.mood == Mood::Hung {
                self.mood = Mood::Good;
            }
            self.restart(now_us);
            return Vec::new();
        }
        if self.mood == Mood::Hung {
            return Vec::new();
        }
        match byte {
            0x13 => self.suspended = true,
            0x11 => self.suspended = false,
            b'\r' => {
                let command = std::mem::take(&mut self.command);
                return self.obey(&command, now_us);
            }
            _ if !self.command.is_empty() => self.command.push(byte),
            b'c' | b'C' | b'F' | b'f' | b'U' | b'u' | b'S' | b'P' => return self.obey(&[byte], now_us),
            _ => self.command.push(byte),
        }
        Vec::new()
    }

    /// Says what is due, each byte with its time: bytes follow each other at the line's speed.
    pub fn advance(&mut self, now_us: u64) -> Vec<(u64, u8)> {
        if self.next_us().is_none_or(|due_us| now_us < due_us) {
            return Vec::new();
        }
        let period_us = (1e6 / self.options.rate_hz) as u64;
        let at_us = self.next_us.max(self.deaf_until_us);
        // A caller that was late is not flooded with what it missed.
        self.next_us = if now_us > at_us + 20 * period_us { now_us } else { at_us } + period_us;
        match self.mood {
            Mood::Silent => Vec::new(),
            Mood::Babbling | Mood::Hung => {
                let nonsense: Vec<u8> = (0..40).map(|_| self.noise.random()).collect();
                self.line.send(&nonsense, at_us)
            }
            _ => self.say(at_us),
        }
    }

    /// Says the next active station's record.
    fn say(&mut self, at_us: u64) -> Vec<(u64, u8)> {
        let both = self.active == [true, true];
        self.turn = 3 - self.turn;
        let station = match (both, self.active[1]) {
            (true, _) => self.turn,
            (false, true) => 2,
            (false, false) => 1,
        };
        if self.mood == Mood::OneReceiver && station == 2 {
            return Vec::new();
        }
        let seconds = if self.mood == Mood::Stuck { 0.0 } else { at_us as f64 / 1e6 };
        let (mut at_m, mut orientation) = (self.motion)(seconds, station);
        if self.mood != Mood::Stuck {
            at_m += normal(&mut self.noise) * self.options.position_noise_m;
            orientation *= DQuat::from_scaled_axis(normal(&mut self.noise) * self.options.angle_noise_rad);
        }
        if self.inches {
            at_m /= 2.54;
        }
        let (record, wire) = self.teller.say(station, b' ', at_m, orientation);
        let bytes = self.line.send(&wire, at_us);
        self.said.push(Record { at_us: self.line.started_us, ..record });
        bytes
    }

    fn obey(&mut self, command: &[u8], now_us: u64) -> Vec<(u64, u8)> {
        if command.is_empty() {
            return Vec::new();
        }
        self.heard.push(command.to_vec());
        match command {
            b"c" => self.continuous = false,
            b"C" => (self.continuous, self.next_us) = (true, now_us + 5_000),
            b"F" => self.teller.layout.format = Format::Ascii,
            b"f" => self.teller.layout.format = Format::Binary,
            b"U" => self.inches = true,
            b"u" => self.inches = false,
            b"S" => return self.line.send(b"21S 0 RIGEL SIM 1.0\r\n", now_us),
            b"P" => return self.say(now_us),
            [b'O', list @ ..] => self.list(list),
            [b'l', station] => {
                let flags = self.active.map(|active| b'0' + u8::from(active));
                return self.line.send(&[b'2', *station, b'l', flags[0], flags[1], b'\r', b'\n'], now_us);
            }
            [b'l', station, b',', flag] => {
                let station = usize::from(station.wrapping_sub(b'1'));
                if station < usize::from(self.options.receivers) {
                    self.active[station] = *flag == b'1';
                }
            }
            // Alignment, boresight and hemisphere change nothing here: the motion is given in the axes that they leave.
            _ => {}
        }
        Vec::new()
    }

    /// Obeys an output list that it knows; another one leaves the list as it is.
    fn list(&mut self, list: &[u8]) {
        let items: Vec<&[u8]> = list.split(|&b| b == b',').filter(|item| *item != b"1").collect();
        let output = match items.get(1) {
            Some(&b"11") => Output::Quaternion,
            Some(&b"4") => Output::Euler,
            _ => return,
        };
        let list = match &items[2..] {
            [] => List::Once,
            again if *again == items[..2] => List::Twice,
            [b"5", b"6", b"7"] => List::Cosines,
            _ => return,
        };
        if items[0] == b"2" && self.options.obeys.contains(&list) {
            (self.teller.layout.output, self.teller.layout.list) = (output, list);
        }
    }

    fn forget(&mut self) {
        self.teller.layout = Layout { format: Format::Ascii, output: Output::Euler, list: List::Once };
        (self.continuous, self.suspended, self.inches) = (false, false, true);
        self.active = [true, self.options.receivers > 1];
        self.command.clear();
    }
}

/// Three numbers of a normal distribution (the sum of twelve uniform ones, less six).
fn normal(random: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0))
}

//! A rig that is not there: the firmware's own core behind a pseudo-terminal, with a known true position.

use std::io::{ErrorKind, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rigel_firmware_core::Controller;
use rigel_protocol::{Answer, Decoder, LARGEST_FRAME, Limits, Reply, State, encode, frame};
use serialport::{SerialPort, TTYPort};

const RAD_PER_UDEG: f64 = std::f64::consts::PI / 180e6;

/// How often the simulated board looks at its line and its clock.
const ROUND: Duration = Duration::from_millis(1);

/// What kind of rig is simulated.
#[derive(Debug, Clone)]
pub struct RigOptions {
    /// What the rig says that it can do.
    pub limits: Limits,
    /// How much faster than a real clock its own runs: a move that it announces as 2 s takes 2 s / `speed_factor`.
    pub speed_factor: f64,
    /// The largest difference between where the rig believes to be and where it is, per axis, radians: mounts are never
    /// square. A third of a degree is 0.005.
    pub mount_error_rad: f64,
    /// What goes wrong on the line.
    pub faults: Faults,
}

impl Default for RigOptions {
    /// Pan ±180°, tilt -10° to 90°, 60°/s, 120°/s², 0.3 s to settle, in real time, perfectly mounted, without faults.
    fn default() -> Self {
        let limits = Limits {
            pan_min_mdeg: -180_000,
            pan_max_mdeg: 180_000,
            winding_mdeg: 180_000,
            tilt_min_mdeg: -10_000,
            tilt_max_mdeg: 90_000,
            speed_mdeg_s: 60_000,
            acceleration_mdeg_s2: 120_000,
            settle_ms: 300,
        };
        Self { limits, speed_factor: 1.0, mount_error_rad: 0.0, faults: Faults::default() }
    }
}

/// What goes wrong on the line; 0 and `None`: nothing. Frames of both directions are counted together, from 1.
#[derive(Debug, Clone, Copy, Default)]
pub struct Faults {
    /// Every n-th frame is lost.
    pub drop_every: u32,
    /// Every n-th frame has one wrong bit.
    pub corrupt_every: u32,
    /// After so many frames the rig is unplugged.
    pub unplug_after: Option<u32>,
    /// The rig says hello with this protocol version.
    pub version: Option<u16>,
}

/// Where the surface truly is, at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruePosition {
    /// True pan, radians.
    pub pan_rad: f64,
    /// True tilt, radians.
    pub tilt_rad: f64,
    /// Whether it still moves or swings: a photograph would be blurred.
    pub moving: bool,
}

/// Tells where the surface truly is at the moment of asking, for instance to a simulated camera. Cheap to clone.
#[derive(Clone)]
pub struct RigPosition(Arc<Mutex<Board>>);

impl RigPosition {
    /// The true position now.
    pub fn now(&self) -> TruePosition {
        let board = lock(&self.0);
        let now_us = board.now_us();
        let [pan_rad, tilt_rad] =
            board.controller.position_udeg(now_us).map(|udeg| udeg as f64 * RAD_PER_UDEG);
        let [pan_error_rad, tilt_error_rad] = mount_error(pan_rad, tilt_rad, board.mount_error_rad);
        TruePosition {
            pan_rad: pan_rad + pan_error_rad,
            tilt_rad: tilt_rad + tilt_error_rad,
            moving: matches!(board.controller.state(now_us), State::Moving | State::Settling),
        }
    }
}

/// A simulated rig; it is unplugged when this value is dropped.
pub struct SimulatedRig {
    port_name: String,
    board: Arc<Mutex<Board>>,
    unplug: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SimulatedRig {
    /// Starts a rig behind a new pseudo-terminal.
    ///
    /// # Errors
    /// When the limits are not those of a rig (see [`Controller::new`]), the speed factor is not positive, or the
    /// operating system gives no pseudo-terminal.
    pub fn start(options: RigOptions) -> rigel::Result<Self> {
        let controller = Controller::new("simulated rig", options.limits).ok_or_else(|| {
            rigel::Error::request(
                format!("no rig can have the limits {:?}", options.limits),
                "include 0 in both ranges and choose a speed and an acceleration above 0",
            )
        })?;
        if !(options.speed_factor > 0.0 && options.speed_factor.is_finite()) {
            return Err(rigel::Error::request(
                format!("a rig cannot run {} times as fast", options.speed_factor),
                "choose a factor above 0",
            ));
        }
        let (line, far_end) = open_line().map_err(|e| rigel::Error::Device {
            device: "simulated rig".into(),
            what: format!("no pseudo-terminal can be had: {e}"),
            remedy: "mount /dev/pts or simulate on another machine".into(),
        })?;
        let port_name = far_end.name().unwrap_or_default();
        let board = Arc::new(Mutex::new(Board {
            controller,
            switched_on: Instant::now(),
            speed_factor: options.speed_factor,
            mount_error_rad: options.mount_error_rad,
        }));
        let unplug = Arc::new(AtomicBool::new(false));
        let thread = {
            let (board, unplug, faults) = (board.clone(), unplug.clone(), options.faults);
            std::thread::spawn(move || {
                // While this end stays open the line survives a host that comes and goes.
                let _far_end = far_end;
                let mut wire = Wire { line, faults, frames: 0 };
                // An error here is the line's end, like an unplugged cable.
                let _ = serve(&board, &mut wire, &unplug);
            })
        };
        Ok(Self { port_name, board, unplug, thread: Some(thread) })
    }

    /// The name of the port at which a host finds the rig.
    pub fn port_name(&self) -> &str {
        &self.port_name
    }

    /// A handle that tells the true position, also after the rig was unplugged.
    pub fn position(&self) -> RigPosition {
        RigPosition(self.board.clone())
    }

    /// Pulls the cable; returns once it is out.
    pub fn unplug(&mut self) {
        self.unplug.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for SimulatedRig {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// The board: the firmware's core and its clock.
struct Board {
    controller: Controller,
    switched_on: Instant,
    speed_factor: f64,
    mount_error_rad: f64,
}

impl Board {
    fn now_us(&self) -> u64 {
        (self.switched_on.elapsed().as_secs_f64() * self.speed_factor * 1e6) as u64
    }
}

/// The cable, with its faults.
struct Wire {
    line: TTYPort,
    faults: Faults,
    frames: u32,
}

impl Wire {
    /// Counts a frame; tells which bit of it to spoil, or that it is lost.
    fn fate(&mut self) -> Fate {
        self.frames += 1;
        let every = |n: u32, frames: u32| n > 0 && frames.is_multiple_of(n);
        if self.faults.unplug_after.is_some_and(|last| self.frames > last) {
            Fate::Unplugged
        } else if every(self.faults.drop_every, self.frames) {
            Fate::Lost
        } else if every(self.faults.corrupt_every, self.frames) {
            Fate::Spoilt
        } else {
            Fate::Whole
        }
    }

    fn send(&mut self, mut answer: Answer) -> std::io::Result<()> {
        if let (Reply::Hello(hello), Some(version)) = (&mut answer.reply, self.faults.version) {
            hello.version = version;
        }
        let mut buffer = [0; LARGEST_FRAME];
        let mut bytes = encode(&answer, &mut buffer).map_err(std::io::Error::other)?.to_vec();
        match self.fate() {
            Fate::Unplugged => return Err(ErrorKind::BrokenPipe.into()),
            Fate::Lost => return Ok(()),
            Fate::Spoilt => {
                let bit = self.frames as usize * 7 % (bytes.len() * 8);
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            Fate::Whole => {}
        }
        match self.line.write_all(&bytes) {
            // Nobody reads: what does not fit is lost, as on a real line.
            Err(e) if e.kind() == ErrorKind::TimedOut => Ok(()),
            outcome => outcome,
        }
    }
}

enum Fate {
    Whole,
    Lost,
    Spoilt,
    Unplugged,
}

fn open_line() -> serialport::Result<(TTYPort, TTYPort)> {
    let (mut line, far_end) = TTYPort::pair()?;
    line.set_timeout(ROUND)?;
    Ok((line, far_end))
}

/// The board's loop: what a real board does between its interrupts.
fn serve(board: &Mutex<Board>, wire: &mut Wire, unplug: &AtomicBool) -> std::io::Result<()> {
    let mut decoder = Decoder::new();
    let mut buffer = [0; 256];
    while !unplug.load(Ordering::Relaxed) {
        let count = match wire.line.read(&mut buffer) {
            Ok(count) => count,
            Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => 0,
            Err(e) => return Err(e),
        };
        for &byte in &buffer[..count] {
            let Some(Ok(payload)) = decoder.push(byte) else { continue };
            let Ok(request) = frame::decode(payload) else { continue };
            match wire.fate() {
                Fate::Unplugged => return Err(ErrorKind::BrokenPipe.into()),
                // The board hears nothing of a spoilt request: its checksum is wrong.
                Fate::Lost | Fate::Spoilt => continue,
                Fate::Whole => {}
            }
            let answer = {
                let mut board = lock(board);
                let now_us = board.now_us();
                board.controller.handle(request, now_us)
            };
            wire.send(answer)?;
        }
        let event = {
            let mut board = lock(board);
            let now_us = board.now_us();
            board.controller.tick(now_us)
        };
        if let Some(event) = event {
            wire.send(event)?;
        }
    }
    Ok(())
}

/// A panic elsewhere leaves nothing half done in here: every change of the board is one call.
fn lock(board: &Mutex<Board>) -> MutexGuard<'_, Board> {
    board.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a mount that is not square adds to each axis: an offset and a part that goes round with the pan and the tilt,
/// never more than `largest_rad`.
fn mount_error(pan_rad: f64, tilt_rad: f64, largest_rad: f64) -> [f64; 2] {
    [0.5 + 0.5 * (pan_rad + 0.7).sin(), -0.4 + 0.6 * (pan_rad - 2.0 * tilt_rad).cos()]
        .map(|e| e * largest_rad)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mount_error_stays_below_its_bound_and_is_not_constant() {
        let errors: Vec<[f64; 2]> = (0..1000)
            .map(|i| mount_error(f64::from(i) * 0.0063 - 3.0, f64::from(i % 37) * 0.04, 0.005))
            .collect();
        assert!(errors.iter().flatten().all(|e| e.abs() <= 0.005));
        for axis in 0..2 {
            let largest = errors.iter().map(|e| e[axis]).fold(f64::MIN, f64::max);
            let smallest = errors.iter().map(|e| e[axis]).fold(f64::MAX, f64::min);
            assert!(largest - smallest > 0.004);
        }
    }

    #[test]
    fn impossible_options_are_refused() {
        let still = Limits { speed_mdeg_s: 0, ..RigOptions::default().limits };
        assert!(SimulatedRig::start(RigOptions { limits: still, ..Default::default() }).is_err());
        for speed_factor in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(SimulatedRig::start(RigOptions { speed_factor, ..Default::default() }).is_err());
        }
    }
}

//! A rig that is not there: the firmware's own core behind a pseudo-terminal, with a known true position.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use rigel_protocol::{Axis, Limits, Record, Restart, State};
use serialport::SerialPort;

use crate::tracker::TrackerOptions;

use board::Board;
use wire::Wire;

mod board;
mod rehearsal;
mod second_line;
mod wire;

pub use board::mechanics;
pub use rehearsal::{Rehearsal, rehearse};

/// What kind of rig is simulated.
#[derive(Debug, Clone)]
pub struct RigOptions {
    /// What the rig says that it can do; see [`mechanics`] for what else it is made of.
    pub limits: Limits,
    /// How much faster than a real clock its own runs: a move that it announces as 2 s takes 2 s / `speed_factor`.
    pub speed_factor: f64,
    /// The largest difference between where the rig believes to be and where it is, per axis, radians: mounts are never
    /// square. A third of a degree is 0.005.
    pub mount_error_rad: f64,
    /// A limit switch that is always pressed.
    pub stuck_switch: Option<Axis>,
    /// Whether the camera's flash-sync is wired; it comes as the contact closes.
    pub flash_sync: bool,
    /// The tracker, whose time passes as fast as the rig's; `None`: none is plugged in.
    pub tracker: Option<TrackerOptions>,
    /// What goes wrong on the line.
    pub faults: Faults,
}

impl Default for RigOptions {
    /// Pan ±180°, tilt -10° to 90°, 60°/s, 120°/s², 0.3 s to settle, in real time, perfectly mounted, with a flash-sync,
    /// without tracker and faults.
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
        Self {
            limits,
            speed_factor: 1.0,
            mount_error_rad: 0.0,
            stuck_switch: None,
            flash_sync: true,
            tracker: None,
            faults: Faults::default(),
        }
    }
}

/// What goes wrong on the line; 0 and `None`: nothing. Frames of both directions are counted together, from 1.
#[derive(Debug, Clone, Copy, Default)]
pub struct Faults {
    /// Every n-th frame is lost.
    pub drop_every: u32,
    /// Every n-th frame has one wrong bit.
    pub corrupt_every: u32,
    /// Every n-th frame comes twice.
    pub duplicate_every: u32,
    /// Every n-th frame is overtaken by the next one of its direction.
    pub reorder_every: u32,
    /// Every answer comes so much later, real milliseconds.
    pub delay_ms: u32,
    /// After so many frames neither side hears the other.
    pub silent_after: Option<u32>,
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

/// When the shutter's contact was closed, by the rig's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Photograph {
    /// When it closed, microseconds.
    pub closed_us: u64,
    /// When it opened, microseconds.
    pub opened_us: u64,
}

/// When the rig moved, by its own clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Move {
    /// When it was told to, microseconds.
    pub began_us: u64,
    /// When it had arrived and settled, microseconds.
    pub settled_us: u64,
}

/// Tells where the surface truly is at the moment of asking, for instance to a simulated camera. Cheap to clone.
#[derive(Clone)]
pub struct RigPosition {
    board: Arc<Mutex<Board>>,
    mount_error_rad: f64,
}

impl RigPosition {
    /// The true position now.
    pub fn now(&self) -> TruePosition {
        let mut board = lock(&self.board);
        board.catch_up();
        let [pan_rad, tilt_rad] = board.surface_rad();
        let [pan_error_rad, tilt_error_rad] = mount_error(pan_rad, tilt_rad, self.mount_error_rad);
        TruePosition {
            pan_rad: pan_rad + pan_error_rad,
            tilt_rad: tilt_rad + tilt_error_rad,
            moving: matches!(board.state(), State::Homing | State::Moving | State::Braking | State::Settling),
        }
    }

    /// What the rig is doing.
    pub fn state(&self) -> State {
        let mut board = lock(&self.board);
        board.catch_up();
        board.state()
    }

    /// Every move that has ended where it should.
    pub fn moves(&self) -> Vec<Move> {
        let mut board = lock(&self.board);
        board.catch_up();
        board.moves()
    }

    /// Every photograph whose contact has closed and opened.
    pub fn photographs(&self) -> Vec<Photograph> {
        let mut board = lock(&self.board);
        board.catch_up();
        board.photographs()
    }

    /// The records that the tracker has truly said since this was last asked, at the rig's time.
    pub fn take_said(&self) -> Vec<Record> {
        lock(&self.board).take_said()
    }

    /// Turns the axes by so many steps past their motors: the rig does not notice before it homes again.
    pub fn slip(&self, steps: [i64; 2]) {
        lock(&self.board).slip(steps);
    }
}

/// A simulated rig; it is unplugged when this value is dropped.
pub struct SimulatedRig {
    port_name: String,
    board: Arc<Mutex<Board>>,
    mount_error_rad: f64,
    faults: Faults,
    unplug: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SimulatedRig {
    /// Starts a rig behind a new pseudo-terminal.
    ///
    /// # Errors
    /// When the limits are not those of a rig (see [`rigel_firmware_core::Controller::new`]), the speed factor is not
    /// positive, or the operating system gives no pseudo-terminal.
    pub fn start(options: RigOptions) -> rigel::Result<Self> {
        let board = Board::new(&options).ok_or_else(|| {
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
        let mut rig = Self {
            port_name: String::new(),
            board: Arc::new(Mutex::new(board)),
            mount_error_rad: options.mount_error_rad,
            faults: options.faults,
            unplug: Arc::default(),
            thread: None,
        };
        rig.plug_in(options.faults)?;
        Ok(rig)
    }

    /// The name of the port at which a host finds the rig.
    pub fn port_name(&self) -> &str {
        &self.port_name
    }

    /// A handle that tells the true position, also after the rig was unplugged.
    pub fn position(&self) -> RigPosition {
        RigPosition { board: self.board.clone(), mount_error_rad: self.mount_error_rad }
    }

    /// Pulls the cable; returns once it is out. The rig itself goes on, and nobody hears it.
    pub fn unplug(&mut self) {
        self.unplug.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }

    /// Pulls the cable, if it is in, and plugs it in again: the port has a new name, which is returned. The rig knows
    /// everything that it knew, and its faults but `unplug_after` and `silent_after` go on.
    ///
    /// # Errors
    /// When the operating system gives no pseudo-terminal.
    pub fn replug(&mut self) -> rigel::Result<&str> {
        self.unplug();
        {
            let mut board = lock(&self.board);
            board.catch_up();
            board.said.clear();
        }
        self.plug_in(Faults { unplug_after: None, silent_after: None, ..self.faults })?;
        Ok(&self.port_name)
    }

    /// Restarts the rig's program: it has forgotten the conversation and where it stands.
    pub fn restart(&mut self, why: Restart) {
        lock(&self.board).restart(why);
    }

    fn plug_in(&mut self, faults: Faults) -> rigel::Result<()> {
        let no_line = |e: serialport::Error| rigel::Error::Device {
            device: "simulated rig".into(),
            what: format!("no pseudo-terminal can be had: {e}"),
            remedy: "mount /dev/pts or simulate on another machine".into(),
        };
        let mut ends = wire::open_line().map_err(no_line)?;
        if ends.1.name().as_ref() == Some(&self.port_name) {
            // While the first is open, the second has another name.
            ends = wire::open_line().map_err(no_line)?;
        }
        let (line, far_end) = ends;
        self.port_name = far_end.name().unwrap_or_default();
        self.unplug = Arc::default();
        let (board, unplug) = (self.board.clone(), self.unplug.clone());
        self.thread = Some(std::thread::spawn(move || {
            // While this end stays open the line survives a host that comes and goes.
            let _far_end = far_end;
            // An error here is the line's end, like an unplugged cable.
            let _ = Wire::new(line, faults).serve(&board, &unplug);
        }));
        Ok(())
    }
}

impl Drop for SimulatedRig {
    fn drop(&mut self) {
        self.unplug();
    }
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

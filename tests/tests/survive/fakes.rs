//! A rig and a camera that do what a test wants.

use std::cell::Cell;
use std::path::Path;
use std::time::{Duration, SystemTime};

use rigel::Result;
use rigel::camera::{Camera, Shot};
use rigel::capture::capture;
use rigel::geometry::Lens;
use rigel::progress::Silent;
use rigel::rig::{Reached, Rig, RigLimits};
use rigel::session::{Manifest, Session, View};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;

/// A rig that is where it is sent, but for the brackets in which it restarts.
pub struct Bench<'a> {
    at: &'a Cell<(f64, f64)>,
    /// For every bracket to come, the last first: whether it restarts in it.
    restarts: Vec<bool>,
    /// How often it has homed.
    pub homings: usize,
    homed: bool,
    notices: Vec<String>,
}

impl<'a> Bench<'a> {
    pub fn new(at: &'a Cell<(f64, f64)>, restarts: &[bool]) -> Self {
        let restarts = restarts.iter().rev().copied().collect();
        Self { at, restarts, homings: 0, homed: false, notices: vec![] }
    }
}

/// What it tells when asked.
pub const CABLE: &str = "the cable was out";
/// What it tells when it has restarted.
pub const RESTARTED: &str = "the rig has restarted";

impl Rig for Bench<'_> {
    fn limits(&self) -> RigLimits {
        RigLimits {
            pan_rad: [-3.2, 3.2],
            tilt_rad: [0.0, 1.5],
            speed_rad_s: 1.0,
            acceleration_rad_s2: 1.0,
            settle_s: 0.25,
        }
    }

    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached> {
        self.homings += usize::from(!self.homed);
        self.homed = true;
        self.at.set((pan_rad, tilt_rad));
        Ok(Reached { pan_rad, tilt_rad, settle_s: 0.25 })
    }

    fn is_there(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<bool> {
        if self.restarts.pop().unwrap_or(false) {
            self.homed = false;
            self.notices.push(RESTARTED.into());
        }
        Ok(self.homed && self.at.get() == (pan_rad, tilt_rad))
    }

    fn describe(&self) -> String {
        "a bench".into()
    }

    fn take_notices(&mut self) -> Vec<String> {
        let told = self.notices.drain(..);
        told.chain([CABLE.into()]).collect()
    }
}

/// A small camera that counts its photographs; those that come later stay with it.
pub struct Counting<'a> {
    pub eye: SimulatedCamera<Box<dyn Fn() -> (f64, f64) + 'a>>,
    pub taken: &'a Cell<usize>,
    pub later: bool,
}

impl Camera for Counting<'_> {
    fn describe(&self) -> String {
        self.eye.describe()
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        [0.002, 2.0]
    }

    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        self.taken.set(self.taken.get() + 1);
        if self.later {
            let at = SystemTime::UNIX_EPOCH + Duration::from_secs(2_000_000_000 + self.taken.get() as u64);
            return Ok(Shot::Later { exposure_s, at });
        }
        self.eye.photograph(exposure_s, stem)
    }

    fn file_size_bytes(&self) -> u64 {
        self.eye.file_size_bytes()
    }
}

pub fn manifest() -> Manifest {
    let view = |index: usize| View {
        name: format!("view{index:03}"),
        pan_deg: Some(40.0 * index as f64),
        tilt_deg: Some(20.0 * index as f64),
        lens: 0,
        pose: None,
    };
    Manifest {
        views: (0..3).map(view).collect(),
        longest_exposure_s: Some(0.02),
        distance_m: Some(0.9),
        ..Manifest::new("test")
    }
}

/// Where a capture waits for the disk, and there is no disk to wait for.
pub fn fast() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// What looks at the patchwork from there.
pub fn eye(at: &Cell<(f64, f64)>) -> SimulatedCamera<Box<dyn Fn() -> (f64, f64) + '_>> {
    let options = Options { lens: Lens::pinhole(16, 12, 35.0), jpeg_quality: None, ..Options::default() };
    SimulatedCamera::new(Scene::patchwork(), options, Box::new(|| at.get()))
}

/// Completes a session; returns how many photographs that took.
pub fn complete(session: &mut Session, later: bool) -> Result<usize> {
    complete_with(session, later, &[])
}

/// The same with a rig that restarts in these brackets.
pub fn complete_with(session: &mut Session, later: bool, restarts: &[bool]) -> Result<usize> {
    let (at, taken) = (Cell::new((0.0, 0.0)), Cell::new(0));
    let eye = eye(&at);
    capture(session, &mut Bench::new(&at, restarts), &mut Counting { eye, taken: &taken, later }, &Silent)?;
    Ok(taken.get())
}

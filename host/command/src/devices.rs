//! The rig and the camera that the user named.

use std::path::Path;

use rigel::camera::Camera;
use rigel::geometry::{Lens, Surface};
use rigel::rig::{Rig, SerialRig};
use rigel::{Error, Result};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::rig::{RigOptions, SimulatedRig};
use rigel_simulated::scene::Scene;

use crate::arguments::CameraChoice;

/// How much faster than a real one the simulated rig moves: nobody wants to wait for what is not there.
const SPEED_FACTOR: f64 = 40.0;
/// The simulated mount is not quite square, radians: a fortieth of a degree.
const MOUNT_ERROR_RAD: f64 = 0.0004;
/// Exposure time that puts the even sheet of the simulated camera in the middle of its range, seconds.
const FLAT_EXPOSURE_S: f64 = 0.004;

/// A rig and a camera, and what is known of them.
pub struct Devices {
    pub rig: SerialRig,
    pub camera: SimulatedCamera<Box<dyn Fn() -> (f64, f64)>>,
    pub lens: Lens,
    pub surface: Surface,
    pub distance_m: f64,
    /// The simulated rig is unplugged when this is dropped.
    _simulated: SimulatedRig,
}

impl Devices {
    /// Opens the rig, `simulated`, and a camera. A rig at a port is refused until there is a camera that can see it.
    ///
    /// # Errors
    /// [`Error::Device`] when the rig does not answer, [`Error::Request`] when rig and camera do not go together.
    pub fn open(rig: &str, camera: CameraChoice) -> Result<Self> {
        let CameraChoice::Simulated = camera;
        if rig != "simulated" {
            // Before the port is opened: a rig that is opened moves to its home.
            return Err(Error::request(
                format!("the only camera so far is the simulated one, which cannot see the rig at {rig}"),
                "capture with --rig simulated",
            ));
        }
        let options = RigOptions {
            speed_factor: SPEED_FACTOR,
            mount_error_rad: MOUNT_ERROR_RAD,
            ..RigOptions::default()
        };
        let simulated = SimulatedRig::start(options)?;
        let position = simulated.position();
        let where_it_is: Box<dyn Fn() -> (f64, f64)> = Box::new(move || {
            let now = position.now();
            (now.pan_rad, now.tilt_rad)
        });
        let (scene, options) = (Scene::patchwork(), Options::default());
        let surface = scene.surface();
        Ok(Self {
            rig: SerialRig::open(simulated.port_name())?,
            camera: SimulatedCamera::new(scene, options, where_it_is),
            lens: options.lens,
            surface,
            distance_m: options.distance_m,
            _simulated: simulated,
        })
    }

    /// What the session's manifest says of them.
    pub fn describe(&self) -> String {
        format!("{}; {}", self.rig.describe(), self.camera.describe())
    }

    /// Photographs an even sheet for the vignetting, into the session's folder.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be written.
    pub fn photograph_flats(&mut self, session: &Path) -> Result<()> {
        let folder = session.join("flats");
        std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
        for index in 0..3 {
            self.camera.photograph_even_sheet(FLAT_EXPOSURE_S, &folder.join(format!("flat{index}")))?;
        }
        Ok(())
    }
}

//! The rig and the camera that the user named.

use std::cell::Cell;
use std::collections::HashMap;
use std::rc::Rc;
use std::time::Duration;

use rigel::camera::Camera;
use rigel::camera::folder::FolderCamera;
use rigel::camera::trigger::{Shutter, TriggerCamera};
use rigel::geometry::{Lens, Surface};
use rigel::rig::{Format, Output, Reached, Records, Rig, RigLimits, SerialRig, Tracking, TriggerLine};
use rigel::session::Session;
use rigel::{Error, Result};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::rig::{RigOptions, SimulatedRig};
use rigel_simulated::scene::Scene;

use crate::arguments::CameraChoice;
use crate::bench::greet;

/// How much faster than a real one the simulated rig moves: nobody wants to wait for what is not there.
const SPEED_FACTOR: f64 = 40.0;
/// The simulated mount is not quite square, radians: a fortieth of a degree.
const MOUNT_ERROR_RAD: f64 = 0.0004;
/// Exposure time that puts the even sheet of the simulated camera in the middle of its range, seconds.
const FLAT_EXPOSURE_S: f64 = 0.004;

/// How long a camera and its program may take to store a photograph.
const STORING: Duration = Duration::from_secs(20);
/// How long somebody may take for the next photograph.
const BY_HAND: Duration = Duration::from_secs(120);

/// How long after its contact closed a camera's flash-sync may come, seconds.
const CONFIRM_S: f64 = 0.5;

/// Where the surface is, pan and tilt in radians, as the simulated camera sees it.
type Position = Box<dyn Fn() -> (f64, f64)>;

/// What is wired to the rig beside its motors, and wanted.
#[derive(Debug, Clone, Copy, Default)]
pub struct With {
    /// The tracker is to be recorded.
    pub tracker: bool,
    /// The flash-sync of the camera on the trigger line confirms every photograph.
    pub flash_sync: bool,
}

/// A rig and a camera, and what is known of them.
pub struct Devices {
    pub rig: Box<dyn Rig>,
    pub camera: Box<dyn Camera>,
    /// Of the simulated camera alone the place and the lens are known before they are measured.
    pub known: Option<Known>,
    /// Where the tracker's records arrive, where they were asked for.
    pub records: Option<Records>,
    /// The simulated rig is unplugged when this is dropped.
    _simulated: Option<SimulatedRig>,
}

/// What is known of a simulated camera and the surface before it.
pub struct Known {
    pub lens: Lens,
    pub surface: Surface,
    pub distance_m: f64,
    /// Photographs the even sheet.
    sheet: SimulatedCamera<Position>,
}

impl Devices {
    /// Opens the rig, `simulated` or at a port, and a camera; of the session that goes on, what it has is not taken again.
    /// Nothing moves yet: the first move homes the rig. In front of a real rig the simulated camera sees the surface where the rig reports to be.
    ///
    /// # Errors
    /// [`Error::Request`] for a flash-sync of another camera than one on the trigger line, [`Error::Device`] when the rig or the
    /// camera does not answer, [`Error::Io`] when a camera's folder cannot be read.
    pub fn open(rig: &str, camera: &CameraChoice, session: Option<&Session>, with: With) -> Result<Self> {
        let tracker = with.tracker;
        if with.flash_sync && !matches!(camera, CameraChoice::Trigger(_)) {
            return Err(Error::request(
                "only a camera that the rig releases has a flash-sync at the rig",
                "choose --camera trigger or trigger:FOLDER, or leave out --flash-sync",
            ));
        }
        let opened = match camera {
            CameraChoice::Webcam(index) => Some(webcam(*index)?),
            CameraChoice::Folder(folder) => {
                let taken = session.map_or(Ok(HashMap::new()), Session::taken)?;
                Some(Box::new(FolderCamera::open(folder, taken, BY_HAND)?) as Box<dyn Camera>)
            }
            _ => None,
        };
        let line: TriggerLine;
        let records: Option<Records>;
        let (rig, position, simulated): (Box<dyn Rig>, Position, _) = if rig == "simulated" {
            let simulated = simulated_rig()?;
            let position = simulated.position();
            let mut rig = greet(simulated.port_name())?;
            line = rig.trigger_line();
            records = tracker.then(|| track(&mut rig)).transpose()?;
            let where_it_is = move || {
                let now = position.now();
                (now.pan_rad, now.tilt_rad)
            };
            (Box::new(rig), Box::new(where_it_is), Some(simulated))
        } else {
            let mut rig = Reporting { rig: greet(rig)?, at: Rc::default() };
            let at = rig.at.clone();
            line = rig.rig.trigger_line();
            records = tracker.then(|| track(&mut rig.rig)).transpose()?;
            (Box::new(rig), Box::new(move || at.get()), None)
        };
        let (camera, known): (Box<dyn Camera>, _) = match (camera, opened) {
            (_, Some(camera)) => (camera, None),
            (CameraChoice::Trigger(folder), _) => (
                Box::new(TriggerCamera::new(shutter(line, with.flash_sync), folder.as_deref(), STORING)?),
                None,
            ),
            _ => {
                let (camera, known) = simulated_camera(position);
                (Box::new(camera), Some(known))
            }
        };
        Ok(Self { rig, camera, known, records, _simulated: simulated })
    }

    /// What the session's manifest says of them.
    pub fn describe(&self) -> String {
        format!("{}; {}", self.rig.describe(), self.camera.describe())
    }

    /// Photographs an even sheet for the vignetting, into the session's folder: all of them or none. Before a real camera
    /// nobody has put one.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be written.
    pub fn photograph_flats(&mut self, session: &mut Session) -> Result<()> {
        let Some(known) = &mut self.known else { return Ok(()) };
        session.adopt("flats", |folder| {
            std::fs::create_dir(folder).map_err(Error::io("create", folder))?;
            for index in 0..3 {
                let stem = folder.join(format!("flat{index}"));
                known.sheet.photograph_even_sheet(FLAT_EXPOSURE_S, &stem)?;
            }
            Ok(Some((folder.to_path_buf(), ())))
        })?;
        Ok(())
    }
}

fn simulated_camera(position: Position) -> (SimulatedCamera<Position>, Known) {
    let (scene, options) = (Scene::patchwork(), Options::default());
    let sheet = Options { seed: options.seed + 1, ..options };
    let known = Known {
        lens: options.lens,
        surface: scene.surface(),
        distance_m: options.distance_m,
        sheet: SimulatedCamera::new(Scene::patchwork(), sheet, Box::new(|| (0.0, 0.0))),
    };
    (SimulatedCamera::new(scene, options, position), known)
}

#[cfg(feature = "webcam")]
fn webcam(index: u32) -> Result<Box<dyn Camera>> {
    Ok(Box::new(rigel::camera::webcam::Webcam::open(index)?))
}

#[cfg(not(feature = "webcam"))]
fn webcam(_: u32) -> Result<Box<dyn Camera>> {
    Err(Error::request("this rigel was built without webcams", "build it with `--features webcam`"))
}

/// Starts the tracker, one receiver.
fn track(rig: &mut SerialRig) -> Result<Records> {
    let records = rig.records();
    rig.track(Tracking { stations: 1, format: Format::Binary, output: Output::Quaternion })?;
    Ok(records)
}

/// The rig's contact, as a camera knows it. With `flash_sync` a photograph counts only when the camera has confirmed it.
fn shutter(mut line: TriggerLine, flash_sync: bool) -> Shutter {
    if flash_sync {
        line.contact.confirm_s = CONFIRM_S;
    }
    Box::new(move |exposure_s| {
        let exposed = line.expose(&[exposure_s])?;
        let exposed = exposed.first().ok_or_else(|| {
            Error::request("the rig tells of no photograph", "start again, and report this if it comes again")
        })?;
        if flash_sync && !exposed.confirmed {
            return Err(Error::Device {
                device: "camera on the trigger line".into(),
                what: format!("its flash-sync did not confirm the photograph of {exposure_s} s"),
                remedy: "see that the camera is awake and in bulb mode and that the flash-sync is wired, then start again, or \
                         leave out --flash-sync"
                    .into(),
            });
        }
        Ok(exposed.at)
    })
}

/// A rig that is not there.
///
/// # Errors
/// [`Error::Device`] where no pseudo-terminal can be had.
pub fn simulated_rig() -> Result<SimulatedRig> {
    SimulatedRig::start(RigOptions {
        speed_factor: SPEED_FACTOR,
        mount_error_rad: MOUNT_ERROR_RAD,
        ..RigOptions::default()
    })
}

/// A rig that remembers where it reported to be.
struct Reporting {
    rig: SerialRig,
    at: Rc<Cell<(f64, f64)>>,
}

impl Rig for Reporting {
    fn limits(&self) -> RigLimits {
        self.rig.limits()
    }

    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached> {
        let reached = self.rig.move_to(pan_rad, tilt_rad)?;
        self.at.set((reached.pan_rad, reached.tilt_rad));
        Ok(reached)
    }

    fn is_there(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<bool> {
        self.rig.is_there(pan_rad, tilt_rad)
    }

    fn describe(&self) -> String {
        self.rig.describe()
    }

    fn take_notices(&mut self) -> Vec<String> {
        self.rig.take_notices()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_photograph_that_the_flash_sync_did_not_confirm_is_an_error() {
        for (wired, wanted, counts) in
            [(true, true, true), (true, false, true), (false, false, true), (false, true, false)]
        {
            let options = RigOptions { flash_sync: wired, ..Default::default() };
            let simulated = SimulatedRig::start(options).unwrap();
            let rig = greet(simulated.port_name()).unwrap();
            let outcome = shutter(rig.trigger_line(), wanted)(0.01);
            assert_eq!(simulated.position().photographs().len(), 1);
            match outcome {
                Ok(_) => assert!(counts, "flash-sync wired {wired}, wanted {wanted}"),
                Err(error) => {
                    let told = error.to_string();
                    assert!(
                        !counts && told.contains("did not confirm") && told.contains("--flash-sync"),
                        "{told}"
                    );
                }
            }
        }
    }
}

//! A webcam of the operating system, through nokhwa, which only `driver` knows. So far V4L2 alone gives a program the
//! exposure time in seconds, so this works on Linux.

mod driver;
mod frame;

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, SystemTime};

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

pub use driver::{Attached, list};
use driver::{Facts, Order};
use frame::Frame;

use super::{Camera, Shot, Taken, exif};
use crate::file::write_bytes;
use crate::{Error, Result};

/// The unit of V4L2's `V4L2_CID_EXPOSURE_ABSOLUTE`, seconds.
const UNIT_S: f64 = 1e-4;
/// How far the exposure time that the driver set may be from what it was asked for, stops. Within this its own value counts.
const CLAMP_STOPS: f64 = 1.0 / 3.0;
/// Frames that are thrown away before each photograph: nokhwa keeps a queue of four, and a camera takes a few more until it
/// follows a new exposure time. They may also show how the rig came here.
const STALE_FRAMES: usize = 8;
/// A frame takes as long as its exposure and, at the ten frames per second of a slow webcam, at least so long, seconds.
const FRAME_S: f64 = 0.1;
/// Frames older than the order may come after those; a camera that sends nothing else is not to be trusted.
const MOST_FRAMES: usize = 60;
/// A camera that sends no frame for so long, and four exposure times, is gone.
const SILENCE: Duration = Duration::from_secs(5);

/// A webcam whose exposure time, gain, white balance and focus stay where they are put.
pub struct Webcam {
    facts: Facts,
    orders: Sender<Order>,
    frames: Receiver<std::result::Result<Frame, String>>,
    exposures: Receiver<std::result::Result<i64, String>>,
    /// What the last photograph showed.
    last: Option<Frame>,
}

impl Webcam {
    /// Opens a webcam by its number and switches off all that changes a picture by itself.
    ///
    /// # Errors
    /// [`Error::Device`] when there is no such webcam, another program has it, its exposure time cannot be set, or something
    /// automatic cannot be switched off.
    pub fn open(index: u32) -> Result<Self> {
        let (orders, inbox) = channel();
        let (frames_out, frames) = channel();
        let (exposures_out, exposures) = channel();
        let (ready_out, ready) = channel();
        // The driver waits for a frame for ever: it has a thread of its own, which is left behind when it does not return.
        std::thread::spawn(move || driver::serve(index, &ready_out, &inbox, &exposures_out, &frames_out));
        let device = format!("webcam {index}");
        let facts = match ready.recv_timeout(SILENCE) {
            Ok(facts) => facts.map_err(|what| Error::Device {
                device,
                what,
                remedy: "see `rigel devices`, close other programs that use it, or take another webcam"
                    .into(),
            })?,
            Err(_) => return Err(gone(&device, "does not answer")),
        };
        Ok(Self { facts, orders, frames, exposures, last: None })
    }

    /// Sets the exposure time and tells what the driver made of it, seconds.
    fn set_exposure(&self, exposure_s: f64) -> Result<f64> {
        let asked = (exposure_s / UNIT_S).round() as i64;
        let _ = self.orders.send(Order::Expose(asked));
        let set = self.answer(&self.exposures, SILENCE)?;
        let set_s = set as f64 * UNIT_S;
        // Not further than rounding to the unit explains.
        if set <= 0 || (set as f64 / asked as f64).log2().abs() > CLAMP_STOPS {
            return Err(Error::Device {
                device: self.facts.name.clone(),
                what: format!(
                    "its driver set an exposure time of {set_s:.4} s where {exposure_s:.4} s was asked for"
                ),
                remedy: "choose --longest-exposure-time within what the webcam really does".into(),
            });
        }
        Ok(set_s)
    }

    fn answer<T>(&self, from: &Receiver<std::result::Result<T, String>>, time: Duration) -> Result<T> {
        match from.recv_timeout(time) {
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(what)) => Err(gone(&self.facts.name, &what)),
            Err(RecvTimeoutError::Timeout) => {
                Err(gone(&self.facts.name, &format!("sent nothing for {:.0} s", time.as_secs_f64())))
            }
            Err(RecvTimeoutError::Disconnected) => Err(gone(&self.facts.name, "its driver gave up")),
        }
    }
}

impl Camera for Webcam {
    fn describe(&self) -> String {
        self.facts.describe()
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        self.facts.exposure_units.map(|units| units as f64 * UNIT_S)
    }

    /// A photograph as PNG with the exposure time that the driver really set.
    ///
    /// # Errors
    /// Beside those of every camera, [`Error::Device`] naming the webcam when the driver set a time that is further than a
    /// third of a stop from what was asked for, when the webcam is gone, and when it sends the same frame again.
    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        let [shortest, longest] = self.exposure_range_s();
        if !(shortest * 0.999..=longest * 1.001).contains(&exposure_s) {
            return Err(Error::request(
                format!("{} cannot expose for {exposure_s} s", self.facts.name),
                format!("choose a time from {shortest} s to {longest} s"),
            ));
        }
        let exposure_s = self.set_exposure(exposure_s)?;
        let ordered = SystemTime::now();
        let time = SILENCE + Duration::from_secs_f64(4.0 * exposure_s);
        let frame = fresh(ordered, self.last.as_ref(), || {
            let _ = self.orders.send(Order::Frame);
            self.answer(&self.frames, time)
        })
        .map_err(|error| match error {
            Stale::Repeated => gone(&self.facts.name, "sent the same frame again"),
            Stale::Old => gone(&self.facts.name, "sends only frames from before the exposure"),
            Stale::Failed(error) => error,
        })?;
        let rgb = frame.rgb().map_err(|what| gone(&self.facts.name, &what))?;
        let file = png_path(stem);
        write_bytes(&file, &png(&frame, &rgb, exposure_s, ordered)?)?;
        self.last = Some(frame);
        Ok(Shot::Taken(Taken { file, exposure_s }))
    }

    /// The frames that are thrown away, and the one that had begun.
    fn overhead_s(&self, exposure_s: f64) -> f64 {
        (STALE_FRAMES + 1) as f64 * exposure_s.max(FRAME_S)
    }

    fn file_size_bytes(&self) -> u64 {
        u64::from(self.facts.width) * u64::from(self.facts.height) * 3
    }
}

/// Why there is no fresh frame.
enum Stale {
    Repeated,
    Old,
    Failed(Error),
}

/// The first frame that shows nothing from before `ordered`.
fn fresh(
    ordered: SystemTime,
    last: Option<&Frame>,
    mut next: impl FnMut() -> Result<Frame>,
) -> std::result::Result<Frame, Stale> {
    let mut before: Option<Frame> = None;
    for count in 0..MOST_FRAMES {
        let frame = next().map_err(Stale::Failed)?;
        // A driver that does not tell when a frame was taken is trusted with the number alone.
        if count < STALE_FRAMES || frame.at.is_some_and(|at| at < ordered) {
            before = Some(frame);
            continue;
        }
        // The noise of two frames is never the same, unless both show nothing but black or white.
        if before.iter().chain(last).any(|other| other.is_same(&frame)) && !frame.is_uniform() {
            return Err(Stale::Repeated);
        }
        return Ok(frame);
    }
    Err(Stale::Old)
}

fn gone(device: &str, what: &str) -> Error {
    Error::Device {
        device: device.into(),
        what: what.into(),
        remedy: "see to its cable, plug it in again, and go on with --resume".into(),
    }
}

/// `with_extension` would cut a stem such as "view.3" short.
fn png_path(stem: &Path) -> PathBuf {
    let mut file = stem.as_os_str().to_os_string();
    file.push(".png");
    file.into()
}

fn png(frame: &Frame, rgb: &[u8], exposure_s: f64, at: SystemTime) -> Result<Vec<u8>> {
    let mut bytes = vec![];
    let mut encoder = PngEncoder::new(&mut bytes);
    let written = encoder
        .set_exif_metadata(exif::block(exposure_s, Some(at)))
        .map_err(image::ImageError::Unsupported)
        .and_then(|()| encoder.write_image(rgb, frame.width, frame.height, ExtendedColorType::Rgb8));
    written.map_err(|error| {
        Error::request(
            format!("a frame of {}x{} pixels cannot be written ({error})", frame.width, frame.height),
            "choose another webcam",
        )
    })?;
    Ok(bytes)
}

#[cfg(test)]
mod tests;

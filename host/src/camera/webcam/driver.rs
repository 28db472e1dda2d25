//! The thread that talks with nokhwa.

use std::sync::mpsc::{Receiver, Sender};
use std::time::SystemTime;

use nokhwa::utils::{
    ApiBackend, CameraControl, CameraFormat, CameraIndex, ControlValueDescription, ControlValueSetter,
    FrameFormat, KnownCameraControl, RequestedFormat, RequestedFormatType,
};
use nokhwa::{Camera, NokhwaError};

use super::frame::{Frame, Layout};

/// V4L2's numbers for controls, for which nokhwa has no names (its `Exposure` is another one).
const EXPOSURE_AUTO: u128 = 0x009a_0901;
const EXPOSURE_ABSOLUTE: u128 = 0x009a_0902;
/// The choice of `EXPOSURE_AUTO` that leaves the exposure time alone.
const EXPOSURE_MANUAL: i64 = 1;
/// What changes a picture by itself.
const AUTOMATICS: [(u128, &str); 3] =
    [(0x0098_090c, "white balance"), (0x0098_0912, "gain"), (0x009a_090c, "focus")];
/// What an automatic leaves behind, which is different each time.
const LEFT_BEHIND: [(KnownCameraControl, &str); 2] =
    [(KnownCameraControl::Gain, "gain"), (KnownCameraControl::WhiteBalance, "white balance")];

/// A webcam that the operating system knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attached {
    /// Its number, for `webcam:NUMBER`.
    pub index: u32,
    /// What it calls itself.
    pub name: String,
}

/// The webcams that are attached.
pub fn list() -> Vec<Attached> {
    // Where webcams cannot be listed there are none that could be used.
    let mut found: Vec<Attached> = nokhwa::query(ApiBackend::Auto)
        .unwrap_or_default()
        .iter()
        .filter_map(|info| Some(Attached { index: info.index().as_index().ok()?, name: info.human_name() }))
        .collect();
    found.sort_by_key(|webcam| webcam.index);
    found
}

/// What the thread is to do.
pub(super) enum Order {
    /// Set the exposure time, in the driver's units.
    Expose(i64),
    /// Give the next frame.
    Frame,
}

/// What is known of a webcam once it is open.
pub(super) struct Facts {
    /// Number and name.
    pub(super) name: String,
    pub(super) width: u32,
    pub(super) height: u32,
    layout: Layout,
    /// Shortest and longest exposure time, in the driver's units.
    pub(super) exposure_units: [i64; 2],
    /// What gain and white balance are put to.
    fixed: String,
}

impl Facts {
    pub(super) fn describe(&self) -> String {
        format!("{}, {}x{}, {:?}{}", self.name, self.width, self.height, self.layout, self.fixed)
    }
}

/// Opens a webcam, tells about it, and obeys orders until nobody is left to give them.
pub(super) fn serve(
    index: u32,
    ready: &Sender<Result<Facts, String>>,
    orders: &Receiver<Order>,
    exposures: &Sender<Result<i64, String>>,
    frames: &Sender<Result<Frame, String>>,
) {
    let (mut camera, layout) = match open(index) {
        Ok((camera, facts)) => {
            let layout = facts.layout;
            let _ = ready.send(Ok(facts));
            (camera, layout)
        }
        Err(what) => {
            let _ = ready.send(Err(what));
            return;
        }
    };
    for order in orders {
        // Who has ordered may have given up meanwhile.
        let _ = match order {
            Order::Expose(units) => {
                exposures.send(set(&mut camera, EXPOSURE_ABSOLUTE, units)).map_err(|_| ())
            }
            Order::Frame => frames.send(frame(&mut camera, layout)).map_err(|_| ()),
        };
    }
}

fn open(index: u32) -> Result<(Camera, Facts), String> {
    let layouts: Vec<FrameFormat> = Layout::BEST_FIRST.iter().map(|&layout| format(layout)).collect();
    let any = RequestedFormat::with_formats(RequestedFormatType::None, &layouts);
    let mut camera = Camera::new(CameraIndex::Index(index), any).map_err(words)?;
    let all = camera.compatible_camera_formats().map_err(words)?;
    let best = Layout::BEST_FIRST.into_iter().find_map(|layout| {
        let area = |shape: &&CameraFormat| u64::from(shape.width()) * u64::from(shape.height());
        let of_layout = all.iter().filter(|shape| shape.format() == format(layout));
        Some((layout, *of_layout.max_by_key(|shape| (area(shape), shape.frame_rate()))?))
    });
    let (layout, shape) = best.ok_or("sends no frames that can be read")?;
    let wanted = [format(layout)];
    let exact = RequestedFormat::with_formats(RequestedFormatType::Exact(shape), &wanted);
    camera.set_camera_requset(exact).map_err(words)?;
    let exposure_units = prepare(&mut camera)?;
    let mut fixed = String::new();
    for (control, what) in LEFT_BEHIND {
        let Ok(found) = camera.camera_control(control) else { continue };
        let ControlValueDescription::IntegerRange { default, .. } = found.description() else { continue };
        // Where this is refused, the value that it has now is the one that it keeps.
        let _ = camera.set_camera_control(control, ControlValueSetter::Integer(*default));
        if let Some(value) = camera.camera_control(control).ok().as_ref().and_then(value_of) {
            fixed += &format!(", {what} {value}");
        }
    }
    camera.open_stream().map_err(words)?;
    let name = format!("webcam {index} ({})", camera.info().human_name());
    let facts = Facts { name, width: shape.width(), height: shape.height(), layout, exposure_units, fixed };
    Ok((camera, facts))
}

/// Switches off what is automatic and tells the range of the exposure time.
fn prepare(camera: &mut Camera) -> Result<[i64; 2], String> {
    if set(camera, EXPOSURE_AUTO, EXPOSURE_MANUAL)? != EXPOSURE_MANUAL {
        return Err("does not leave its exposure time alone".into());
    }
    for (id, what) in AUTOMATICS {
        let control = KnownCameraControl::Other(id);
        if camera.camera_control(control).is_ok() {
            let set = camera.set_camera_control(control, ControlValueSetter::Boolean(false));
            set.map_err(|error| format!("does not switch off its automatic {what} ({error})"))?;
        }
    }
    let control = camera
        .camera_control(KnownCameraControl::Other(EXPOSURE_ABSOLUTE))
        .map_err(|_| "has no exposure time that can be set")?;
    match control.description() {
        ControlValueDescription::IntegerRange { min, max, .. } if *max > 0 => Ok([(*min).max(1), *max]),
        _ => Err("does not tell the range of its exposure time".into()),
    }
}

/// Sets a control and tells what the driver made of it: nokhwa calls it an error when that is something else.
fn set(camera: &mut Camera, id: u128, value: i64) -> Result<i64, String> {
    let control = KnownCameraControl::Other(id);
    let done = camera.set_camera_control(control, ControlValueSetter::Integer(value));
    match camera.camera_control(control).as_ref().map(value_of) {
        Ok(Some(now)) => Ok(now),
        Ok(None) => Err(format!("control {id:#x} is no number")),
        Err(error) => Err(words(done.err().unwrap_or_else(|| error.clone()))),
    }
}

fn value_of(control: &CameraControl) -> Option<i64> {
    match control.value() {
        ControlValueSetter::Integer(value) => Some(value),
        _ => None,
    }
}

fn frame(camera: &mut Camera, layout: Layout) -> Result<Frame, String> {
    let buffer = camera.frame().map_err(words)?;
    let size = buffer.resolution();
    let at = buffer.capture_timestamp().map(|since| SystemTime::UNIX_EPOCH + since);
    Frame::new(layout, size.width(), size.height(), buffer.buffer(), at)
}

fn format(layout: Layout) -> FrameFormat {
    match layout {
        Layout::Rgb => FrameFormat::RAWRGB,
        Layout::Bgr => FrameFormat::RAWBGR,
        Layout::Yuyv => FrameFormat::YUYV,
        Layout::Nv12 => FrameFormat::NV12,
        Layout::Grey => FrameFormat::GRAY,
        Layout::Jpeg => FrameFormat::MJPEG,
    }
}

fn words(error: NokhwaError) -> String {
    error.to_string()
}

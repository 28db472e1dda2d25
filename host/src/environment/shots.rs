//! Which photographs were taken, and how the camera was turned: `frames.json`, or a table with quaternions.

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::map::Unit;
use super::tracked::Tracked;
use crate::geometry::{Lens, world_from_camera};
use crate::tracker::Track;
use crate::{Error, Result};

/// A photograph and what is known of it beforehand.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// The photograph.
    pub path: PathBuf,
    /// Takes the camera frame (x right, y down, z forward) to the world of environments.
    pub world_from_camera: DQuat,
    /// How sure that is about each axis, standard deviation, radians; `None` where the file does not say.
    pub sigma_rad: Option<f64>,
    /// Exposure time times sensitivity over the squared f-number, up to a factor that all share; `None` where it is unknown.
    pub exposure: Option<f64>,
}

impl Shot {
    /// Its file's name, for messages.
    pub fn name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }
}

/// All photographs of one map, and the lens if the file says it.
#[derive(Debug, Clone, PartialEq)]
pub struct Shots {
    /// In the file's order.
    pub shots: Vec<Shot>,
    /// The lens that the file names.
    pub lens: Option<Lens>,
    /// The tracker from which the orientations come, where they do.
    pub tracker: Option<Tracked>,
    /// What a map of them is counted in where their exposures are stated.
    pub unit: Unit,
}

/// A tracker whose receiver was on the camera: where its records are, and what is known of it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tracking {
    /// Its records; else those beside the photographs, where their table says no orientations.
    pub file: Option<PathBuf>,
    /// The receiver: 1 or 2; else the one that there is.
    pub receiver: Option<u8>,
    /// How long before its time a photograph was taken, seconds; else the photographs tell.
    pub delay_s: Option<f64>,
    /// Takes the camera's axes (x right, y up, looking along -z) to the receiver's; else the photographs tell, if it is small.
    pub mount: Option<DQuat>,
}

/// A line of the table of photographs.
#[derive(Deserialize)]
pub(super) struct Frame {
    pub file: PathBuf,
    exposure_s: Option<f64>,
    iso: Option<f64>,
    f_number: Option<f64>,
    #[serde(rename = "R_world_from_cam")]
    turn: Option<[[f64; 3]; 3]>,
    yaw_deg: Option<f64>,
    pitch_deg: Option<f64>,
    roll_deg: Option<f64>,
    qw: Option<f64>,
    qx: Option<f64>,
    qy: Option<f64>,
    qz: Option<f64>,
    pub sigma_deg: Option<f64>,
    pub time_s: Option<f64>,
}

/// The lines of a table, and its lens if it says one.
pub(super) type Table = (Vec<Frame>, Option<Lens>);

#[derive(Deserialize)]
struct Intrinsics {
    f: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
}

const REMEDY: &str = "give for each file yaw_deg, pitch_deg and roll_deg, R_world_from_cam, the quaternion qw, qx, qy, qz, or time_s and a tracker";
/// Tables beside photographs.
pub(super) const TABLES: [&str; 2] = ["frames.json", "frames.csv"];
/// Records beside photographs.
const RECORDS: [&str; 2] = ["tracker.jsonl", "tracker.csv"];
/// Orientations of the tracker that are less sure, about each axis, tell nothing, radians.
const UNKNOWN_RAD: f64 = 0.17;

impl Shots {
    /// Reads a folder with `frames.json` or `frames.csv`, or such a file; photographs are relative to its folder.
    ///
    /// `frames.json` holds `frames`, each with `file` and either `R_world_from_cam` or `yaw_deg`, `pitch_deg`, `roll_deg`, which
    /// stand for R = Ry(yaw) Rx(pitch) Rz(roll) in a world whose axes are the camera's (x right, y down, z forward) when nothing is
    /// turned, the map's centre before it; and `intrinsics_WIDTHxHEIGHT` with `f`, `cx`, `cy`, `k1`, `k2`. A table has the columns
    /// `file,qw,qx,qy,qz`: the quaternion that takes the axes of the camera (x right, y up, looking along -z) to those of the world (y up),
    /// as the tracker's records have it. Both may have `exposure_s`, `iso`, `f_number` and `sigma_deg`.
    ///
    /// # Errors
    /// See [`Self::read_tracked`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_tracked(path, &Tracking::default())
    }

    /// The same with a tracker: instead of orientations there may be `time_s`, seconds on the clock of a tracker's records ([`Track::read`]), in `tracker.jsonl` or
    /// `tracker.csv` beside the photographs or where `tracking` says. A photograph of whose time they know nothing is left out, and named
    /// in the notes.
    ///
    /// # Errors
    /// [`Error::Io`] or [`Error::Input`] that names the photograph whose orientation is missing or is none, or whose time is earlier than that of
    /// the one before, or a table with orientations although a tracker was described; or what [`Track::read`] refuses.
    pub fn read_tracked(path: &Path, tracking: &Tracking) -> Result<Self> {
        let file = if path.is_dir() {
            TABLES.iter().map(|name| path.join(name)).find(|file| file.exists()).ok_or_else(|| {
                Error::input(
                    path,
                    "holds neither frames.json nor frames.csv",
                    "name the file with the orientations, or let `rigel mosaic --live` find them by what the photographs show",
                )
            })?
        } else {
            path.to_path_buf()
        };
        let text = std::fs::read_to_string(&file).map_err(Error::io("read", &file))?;
        Self::of(read_frames(&file, &text)?, &file, tracking)
    }

    /// The same of lines of a table, and its lens.
    pub(super) fn of((frames, lens): Table, file: &Path, tracking: &Tracking) -> Result<Self> {
        let folder = file.parent().unwrap_or(Path::new(""));
        let exposed = || frames.iter().filter(|frame| frame.exposure_s.is_some());
        // What only some of them say would be guessed of the others.
        let all_say = (exposed().all(|f| f.iso.is_some()), exposed().all(|f| f.f_number.is_some()));
        let mut files: Vec<&PathBuf> = frames.iter().map(|frame| &frame.file).collect();
        files.sort_unstable();
        if let Some(pair) = files.windows(2).find(|pair| pair[0] == pair[1]) {
            let what = format!("lists {} twice", pair[0].display());
            return Err(Error::input(file, what, "list each photograph once"));
        }
        let unit = match exposed().next() {
            Some(_) => Unit::Saturation { iso: all_say.0, f_number: all_say.1 },
            None => Unit::MeanPhotograph,
        };
        let tracker = is_tracked(&frames, file, tracking)?.then(|| tracked(&frames, file, folder, tracking));
        let mut tracker = tracker.transpose()?;
        let start = tracker.as_ref().map(Tracked::before);
        let mut shots = frames
            .iter()
            .enumerate()
            .map(|(i, frame)| {
                let name = frame.file.display().to_string();
                let tracked =
                    tracker.as_ref().zip(start.as_ref()).map(|(tracker, start)| tracker.place(i, start));
                let turn =
                    tracked.map(|prior| prior.turn).or_else(|| frame.orientation()).ok_or_else(|| {
                        Error::input(file, format!("has no usable orientation of {name}"), REMEDY)
                    })?;
                if let Some(fault) = frame.fault() {
                    let what = format!("has for {name} {fault}");
                    return Err(Error::input(file, what, "give a positive number, or leave it out"));
                }
                let exposure = frame.exposure_s.map(|time_s| {
                    let iso = frame.iso.filter(|_| all_say.0).unwrap_or(1.0);
                    time_s * iso / frame.f_number.filter(|_| all_say.1).unwrap_or(1.0).powi(2)
                });
                Ok(Shot {
                    path: folder.join(&frame.file),
                    world_from_camera: turn,
                    sigma_rad: tracked.map(|prior| prior.sigma_rad).or(frame.sigma_deg.map(f64::to_radians)),
                    exposure,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        if shots.is_empty() {
            return Err(Error::input(file, "lists no photograph", "list at least two that overlap"));
        }
        if let Some(tracker) = &mut tracker {
            leave_out(&mut shots, tracker);
            if shots.is_empty() {
                let what = "was taken at no time of which the tracker's records know";
                return Err(Error::input(file, what, "give times and records by one clock, in seconds"));
            }
        }
        Ok(Self { shots, lens, tracker, unit })
    }
}

/// Reads a table's text; the file's name says its format.
pub(super) fn read_frames(file: &Path, text: &str) -> Result<Table> {
    if file.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("csv")) {
        let frames =
            csv::Reader::from_reader(text.as_bytes()).deserialize().collect::<std::result::Result<_, _>>();
        return Ok((
            frames.map_err(|error| Error::input(file, format!("cannot be used ({error})"), REMEDY))?,
            None,
        ));
    }
    json(text).map_err(|what| Error::input(file, format!("cannot be used ({what})"), REMEDY))
}

/// Whether a tracker says how the camera was turned, as the table does not.
///
/// # Errors
/// [`Error::Input`] where the table says it although a tracker was described.
pub(super) fn is_tracked(frames: &[Frame], file: &Path, tracking: &Tracking) -> Result<bool> {
    if frames.is_empty() {
        return Ok(false);
    }
    let is_timed = |frame: &Frame| frame.time_s.is_some() && frame.orientation().is_none();
    if tracking.file.is_some() || frames.iter().all(is_timed) {
        return Ok(true);
    }
    if *tracking == Tracking::default() {
        return Ok(false);
    }
    Err(Error::input(
        file,
        "says the orientations itself, so that no tracker is looked at",
        "name the tracker's records with --tracker, or leave --receiver, --delay and --mount out",
    ))
}

/// The tracker of frames with times.
fn tracked(frames: &[Frame], file: &Path, folder: &Path, tracking: &Tracking) -> Result<Tracked> {
    let name = |frame: &Frame| frame.file.display().to_string();
    let mut times_s: Vec<f64> = vec![];
    for frame in frames {
        let Some(time_s) = frame.time_s.filter(|time| time.is_finite()) else {
            let what = format!("has no time_s of {}", name(frame));
            return Err(Error::input(file, what, "give every photograph its time on the tracker's clock"));
        };
        if let Some(before) = times_s.last().filter(|before| **before > time_s) {
            let what = format!(
                "has {} at {time_s:.4} s, {:.4} s earlier than the photograph before",
                name(frame),
                before - time_s
            );
            return Err(Error::input(
                file,
                what,
                "list photographs as they were taken, with times that never run backwards",
            ));
        }
        times_s.push(time_s);
    }
    let records = match &tracking.file {
        Some(records) => records.clone(),
        None => RECORDS.iter().map(|name| folder.join(name)).find(|records| records.exists()).ok_or_else(|| {
            let what = "has times and no orientations, and there is neither tracker.jsonl nor tracker.csv beside it";
            Error::input(file, what, "name the tracker's records with --tracker")
        })?,
    };
    let track = Track::read(&records, tracking.receiver)?;
    Ok(Tracked { track, times_s, delay_s: tracking.delay_s, mount: tracking.mount, notes: vec![] })
}

/// Leaves out photographs of which the tracker knows nothing, and notes what is wrong with its records.
fn leave_out(shots: &mut Vec<Shot>, tracker: &mut Tracked) {
    let (first_s, last_s) = tracker.track.span_s();
    let delay_s = tracker.delay_s.unwrap_or(0.0);
    let names = |which: &dyn Fn(f64) -> bool| -> Vec<String> {
        let both = shots.iter().zip(&tracker.times_s);
        both.filter(|(_, time_s)| which(**time_s - delay_s)).map(|(shot, _)| shot.name()).collect()
    };
    let unknown = |time_s: f64| tracker.track.at(time_s).sigma_rad > UNKNOWN_RAD;
    let is_outside = |time_s: f64| time_s < first_s || time_s > last_s;
    let mut notes = vec![];
    let mut tell = |names: Vec<String>, what: &str| {
        if !names.is_empty() {
            notes.push(format!("{}: {what}", names.join(", ")));
        }
    };
    tell(
        names(&|time_s| is_outside(time_s) && unknown(time_s)),
        "taken when the tracker recorded nothing, left out",
    );
    tell(
        names(&|time_s| is_outside(time_s) && !unknown(time_s)),
        "taken a little before or after the tracker's records: other photographs decide how they were turned",
    );
    tell(
        names(&|time_s| !is_outside(time_s) && unknown(time_s)),
        "taken in a long gap of the tracker's records, left out",
    );
    for jump in &tracker.track.jumps {
        let near = names(&|time_s| (time_s - jump.time_s).abs() < 1.0).join(", ");
        notes.push(format!(
            "the tracker jumped by {:.1} degrees at {:.3} s, {:.1} s after its first record{}: it was taken out to ± {:.1} degrees (is metal near it?)",
            jump.size_rad.to_degrees(),
            jump.time_s,
            jump.time_s - first_s,
            if near.is_empty() { String::new() } else { format!(", near {near}") },
            jump.sigma_rad.to_degrees()
        ));
    }
    for &(from_s, to_s) in &tracker.track.frozen_s {
        let within = names(&|time_s| (from_s..to_s).contains(&time_s)).join(", ");
        notes.push(format!(
            "the tracker said the same for {:.2} s, {:.1} s after its first record{}: what lies before and after stands there, less sure",
            to_s - from_s,
            from_s - first_s,
            if within.is_empty() { String::new() } else { format!(", in {within}") },
        ));
    }
    if tracker.track.outliers() > 0 {
        notes.push(format!(
            "{} of the tracker's {} records lie far beside its path and were left out",
            tracker.track.outliers(),
            tracker.track.records
        ));
    }
    let known: Vec<bool> = tracker.times_s.iter().map(|time_s| !unknown(time_s - delay_s)).collect();
    let mut keep = known.iter();
    shots.retain(|_| *keep.next().unwrap_or(&true));
    let mut keep = known.iter();
    tracker.times_s.retain(|_| *keep.next().unwrap_or(&true));
    tracker.notes = notes;
}

/// Frames and lens of a `frames.json`.
fn json(text: &str) -> std::result::Result<(Vec<Frame>, Option<Lens>), String> {
    let file: serde_json::Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let frames = file.get("frames").cloned().ok_or("it has no frames")?;
    let frames = serde_json::from_value(frames).map_err(|error| error.to_string())?;
    let entry = file.as_object().and_then(|all| all.iter().find(|(name, _)| name.starts_with("intrinsics_")));
    let Some((name, numbers)) = entry else { return Ok((frames, None)) };
    let size = name.trim_start_matches("intrinsics_").split_once('x');
    let size = size.and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    let (width, height) = size.ok_or_else(|| format!("{name} does not say the picture's size"))?;
    let numbers: Intrinsics = serde_json::from_value(numbers.clone()).map_err(|error| error.to_string())?;
    let Intrinsics { f, cx, cy, k1, k2 } = numbers;
    if ![f, cx, cy, k1, k2].iter().all(|number| number.is_finite()) || f <= 0.0 || width == 0 || height == 0 {
        return Err(format!("{name} holds what is no lens"));
    }
    Ok((frames, Some(Lens { cx, cy, k1, k2, ..Lens::pinhole(width, height, f) })))
}

impl Frame {
    /// A number that must be positive and is not.
    pub(super) fn fault(&self) -> Option<String> {
        let stated = [
            ("exposure_s", self.exposure_s),
            ("iso", self.iso),
            ("f_number", self.f_number),
            ("sigma_deg", self.sigma_deg),
        ];
        let is_wrong = |number: &f64| !(number.is_finite() && *number > 0.0);
        stated
            .iter()
            .find_map(|(word, number)| number.filter(is_wrong).map(|number| format!("{word} = {number}")))
    }

    /// How it says the camera was turned: camera frame to the world.
    pub(super) fn orientation(&self) -> Option<DQuat> {
        if let (Some(w), Some(x), Some(y), Some(z)) = (self.qw, self.qx, self.qy, self.qz) {
            let turn = DQuat::from_xyzw(x, y, z, w);
            let length = turn.length();
            return (length.is_finite() && (length - 1.0).abs() < 0.01)
                .then(|| world_from_camera(turn.normalize()));
        }
        // From x right, y down, z forward to the world of environments, whose z is at the map's centre.
        let world = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
        let turn = match (self.turn, self.yaw_deg, self.pitch_deg, self.roll_deg) {
            (Some(rows), ..) => DMat3::from_cols_array_2d(&rows).transpose(),
            (None, Some(yaw), Some(pitch), Some(roll)) => {
                let [yaw, pitch, roll] = [yaw, pitch, roll].map(f64::to_radians);
                DMat3::from_rotation_y(yaw) * DMat3::from_rotation_x(pitch) * DMat3::from_rotation_z(roll)
            }
            _ => return None,
        };
        let off = (turn * turn.transpose() - DMat3::IDENTITY)
            .to_cols_array()
            .iter()
            .fold(0f64, |a, b| a.max(b.abs()));
        (turn.is_finite() && off < 0.01 && turn.determinant() > 0.0)
            .then(|| DQuat::from_mat3(&(world * turn)).normalize())
    }
}

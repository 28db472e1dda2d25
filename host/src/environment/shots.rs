//! Which photographs were taken, and how the camera was turned: `frames.json`, or a table with quaternions.

use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use crate::geometry::{Lens, world_from_camera};
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
}

#[derive(Deserialize)]
struct Frame {
    file: PathBuf,
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
    sigma_deg: Option<f64>,
}

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

const REMEDY: &str =
    "give for each file yaw_deg, pitch_deg and roll_deg, R_world_from_cam, or the quaternion qw, qx, qy, qz";

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
    /// [`Error::Io`] or [`Error::Input`] that names the photograph whose orientation is missing or is none.
    pub fn read(path: &Path) -> Result<Self> {
        let names = ["frames.json", "frames.csv"];
        let file = if path.is_dir() {
            names.iter().map(|name| path.join(name)).find(|file| file.exists()).ok_or_else(|| {
                Error::input(
                    path,
                    "holds neither frames.json nor frames.csv",
                    "name the file with the orientations",
                )
            })?
        } else {
            path.to_path_buf()
        };
        let text = std::fs::read_to_string(&file).map_err(Error::io("read", &file))?;
        let (frames, lens) = if file.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("csv")) {
            let frames = csv::Reader::from_reader(text.as_bytes())
                .deserialize()
                .collect::<std::result::Result<_, _>>();
            (frames.map_err(|error| Error::input(&file, format!("cannot be used ({error})"), REMEDY))?, None)
        } else {
            json(&text).map_err(|what| Error::input(&file, format!("cannot be used ({what})"), REMEDY))?
        };
        let folder = file.parent().unwrap_or(Path::new(""));
        let frames: Vec<Frame> = frames;
        let exposed = || frames.iter().filter(|frame| frame.exposure_s.is_some());
        // What only some of them say would be guessed of the others.
        let all_say = (exposed().all(|f| f.iso.is_some()), exposed().all(|f| f.f_number.is_some()));
        let mut files: Vec<&PathBuf> = frames.iter().map(|frame| &frame.file).collect();
        files.sort_unstable();
        if let Some(pair) = files.windows(2).find(|pair| pair[0] == pair[1]) {
            let what = format!("lists {} twice", pair[0].display());
            return Err(Error::input(&file, what, "list each photograph once"));
        }
        let shots = frames
            .iter()
            .map(|frame| {
                let name = frame.file.display().to_string();
                let turn = frame.orientation().ok_or_else(|| {
                    Error::input(&file, format!("has no usable orientation of {name}"), REMEDY)
                })?;
                let stated = [
                    ("exposure_s", frame.exposure_s),
                    ("iso", frame.iso),
                    ("f_number", frame.f_number),
                    ("sigma_deg", frame.sigma_deg),
                ];
                if let Some((word, number)) =
                    stated.iter().find(|(_, n)| n.is_some_and(|n| !(n.is_finite() && n > 0.0)))
                {
                    let what = format!("has for {name} {word} = {}", number.unwrap_or_default());
                    return Err(Error::input(&file, what, "give a positive number, or leave it out"));
                }
                let exposure = frame.exposure_s.map(|time_s| {
                    let iso = frame.iso.filter(|_| all_say.0).unwrap_or(1.0);
                    time_s * iso / frame.f_number.filter(|_| all_say.1).unwrap_or(1.0).powi(2)
                });
                Ok(Shot {
                    path: folder.join(&frame.file),
                    world_from_camera: turn,
                    sigma_rad: frame.sigma_deg.map(f64::to_radians),
                    exposure,
                })
            })
            .collect::<Result<Vec<_>>>()?;
        if shots.is_empty() {
            return Err(Error::input(&file, "lists no photograph", "list at least two that overlap"));
        }
        Ok(Self { shots, lens })
    }
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
    fn orientation(&self) -> Option<DQuat> {
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

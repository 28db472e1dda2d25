//! Lenses, poses and reference views in files (TOML or JSON) that people or other programs wrote.
//!
//! Fields: `fx fy` (or `f`) `cx cy k1 k2 p1 p2 k3` as in OpenCV, `width height`; a pose is `centre` (mm), `forward` and `up`,
//! all in the surface's frame; a reference view also has the `file` of its radiance. A lens is also read from the YAML or XML that
//! OpenCV's `FileStorage` writes, and from COLMAP's `cameras.txt`.

pub(crate) mod colmap;
mod opencv;

use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::geometry::{Lens, LensCovariance, Pose};
use crate::{Error, Result};

/// The longest side of a picture.
const MOST_PIXELS: u32 = 65535;

/// A lens, and poses of views, that somebody else found.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    lens: LensFile,
    covariance: Option<LensCovariance>,
    views: Vec<(u32, Pose)>,
}

/// A view to compare with: a camera and the file of the radiance it saw.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceFile {
    /// The picture of its radiance.
    pub file: PathBuf,
    /// Its pose.
    pub pose: Pose,
    lens: LensFile,
}

#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
struct LensFile {
    f: Option<f64>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: f64,
    cy: f64,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
    #[serde(default)]
    k3: f64,
    width: Option<u32>,
    height: Option<u32>,
}

#[derive(Deserialize)]
struct PoseFile {
    centre: DVec3,
    forward: DVec3,
    up: DVec3,
}

impl Calibration {
    /// Reads a lens and, where the file has them, its `covariance` and the poses of `views` by number. `pixel_centre` says where the
    /// file has the centre of the first pixel: 0 (OpenCV) or 0.5; COLMAP's has it at 0.5 whatever is said here.
    ///
    /// # Errors
    /// [`Error::Input`] when the file is damaged or lacks a field.
    pub fn read(path: &Path, pixel_centre: f64) -> Result<Self> {
        #[derive(Deserialize)]
        struct Numbered {
            view: u32,
            #[serde(flatten)]
            pose: PoseFile,
        }
        #[derive(Deserialize)]
        struct File {
            #[serde(flatten)]
            lens: LensFile,
            covariance: Option<LensCovariance>,
            #[serde(default)]
            views: Vec<Numbered>,
        }
        let text = read(path)?;
        if let Some((lens, pixel_centre)) = foreign(path, &text, pixel_centre)? {
            return Ok(Self { lens: lens.check(path, pixel_centre)?, covariance: None, views: vec![] });
        }
        let file: File = parse_text(path, &text, A_LENS)?;
        let views = file
            .views
            .into_iter()
            .map(|entry| Ok((entry.view, entry.pose.check(path)?)))
            .collect::<Result<_>>()?;
        if let Some(covariance) = &file.covariance {
            check_covariance(path, covariance)?;
        }
        Ok(Self { lens: file.lens.check(path, pixel_centre)?, covariance: file.covariance, views })
    }

    /// How sure the lens is, where the file says so; for the picture size of the file.
    pub fn covariance(&self) -> Option<LensCovariance> {
        self.covariance
    }

    /// The lens; for a picture of `width` x `height` pixels where the file does not say its size.
    pub fn lens(&self, width: u32, height: u32) -> Lens {
        self.lens.sized(width, height)
    }

    /// How many poses the calibration has.
    pub fn poses(&self) -> usize {
        self.views.len()
    }

    /// The pose of a view by its number.
    pub fn pose(&self, view: u32) -> Option<Pose> {
        self.views.iter().find(|(number, _)| *number == view).map(|(_, pose)| *pose)
    }
}

impl ReferenceFile {
    /// Reads a list of reference views, `views` in TOML or JSON or a bare JSON array; their files are relative to the list's
    /// folder.
    ///
    /// # Errors
    /// [`Error::Input`] when the list is damaged, empty, or lacks a field.
    pub fn read_list(path: &Path, pixel_centre: f64) -> Result<Vec<Self>> {
        #[derive(Deserialize)]
        struct Entry {
            file: PathBuf,
            #[serde(flatten)]
            lens: LensFile,
            #[serde(flatten)]
            pose: PoseFile,
        }
        #[derive(Deserialize)]
        struct List {
            views: Vec<Entry>,
        }
        let text = read(path)?;
        let entries: Vec<Entry> = match text.trim_start().starts_with('[') && is_json(&text) {
            true => parse_text(path, &text, REFERENCES)?,
            false => parse_text::<List>(path, &text, REFERENCES)?.views,
        };
        if entries.is_empty() {
            return Err(Error::input(path, "lists no reference view", "list at least one"));
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let complete = |entry: Entry| {
            Ok(Self {
                file: folder.join(entry.file),
                pose: entry.pose.check(path)?,
                lens: entry.lens.check(path, pixel_centre)?,
            })
        };
        entries.into_iter().map(complete).collect()
    }

    /// The lens; for a picture of `width` x `height` pixels where the file does not say its size.
    pub fn lens(&self, width: u32, height: u32) -> Lens {
        self.lens.sized(width, height)
    }
}

/// Reads one camera to render with: a lens with its size, and a pose.
///
/// # Errors
/// [`Error::Input`] when the file is damaged or lacks a field.
pub fn read_camera(path: &Path, pixel_centre: f64) -> Result<(Lens, Pose)> {
    #[derive(Deserialize)]
    struct File {
        #[serde(flatten)]
        lens: LensFile,
        #[serde(flatten)]
        pose: PoseFile,
    }
    let file: File = parse_text(path, &read(path)?, A_CAMERA)?;
    let (Some(width), Some(height)) = (file.lens.width, file.lens.height) else {
        return Err(Error::input(path, "does not say the picture's size", "add width and height in pixels"));
    };
    Ok((file.lens.check(path, pixel_centre)?.sized(width, height), file.pose.check(path)?))
}

impl LensFile {
    fn of(lens: &Lens) -> Self {
        let Lens { width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3 } = *lens;
        let (width, height) = (Some(width), Some(height));
        Self { f: None, fx: Some(fx), fy: Some(fy), cx, cy, k1, k2, p1, p2, k3, width, height }
    }

    fn check(mut self, path: &Path, pixel_centre: f64) -> Result<Self> {
        if !(pixel_centre == 0.0 || pixel_centre == 0.5) {
            return Err(Error::request(
                format!("a first pixel whose centre is at {pixel_centre}"),
                "choose 0 (as OpenCV) or 0.5",
            ));
        }
        let Self { cx, cy, k1, k2, p1, p2, k3, .. } = self;
        for (name, number) in
            [("cx", cx), ("cy", cy), ("k1", k1), ("k2", k2), ("p1", p1), ("p2", p2), ("k3", k3)]
        {
            if !number.is_finite() {
                return Err(Error::input(path, format!("{name} is {number}"), "write a number there"));
            }
        }
        for (name, pixels) in [("width", self.width), ("height", self.height)] {
            if pixels.is_some_and(|pixels| !(1..=MOST_PIXELS).contains(&pixels)) {
                return Err(Error::input(
                    path,
                    format!("{name} is {} pixels", pixels.unwrap_or_default()),
                    format!("write a number from 1 to {MOST_PIXELS}"),
                ));
            }
        }
        for (name, at, side) in [("cx", cx, self.width), ("cy", cy, self.height)] {
            let most = f64::from(side.unwrap_or(MOST_PIXELS));
            if at < -most || at > 2.0 * most {
                return Err(Error::input(
                    path,
                    format!("{name} is {at}, far beside a picture of {most} pixels"),
                    "write where the lens's axis meets the picture, in pixels",
                ));
            }
        }
        self.fx = self.fx.or(self.f);
        self.fy = self.fy.or(self.f);
        self.cx -= pixel_centre;
        self.cy -= pixel_centre;
        let usable = |focal: Option<f64>| focal.is_some_and(|focal| focal.is_finite() && focal > 0.0);
        if !(usable(self.fx) && usable(self.fy)) {
            return Err(Error::input(path, "has no positive focal length", "add fx and fy, or f, in pixels"));
        }
        Ok(self)
    }

    fn sized(&self, width: u32, height: u32) -> Lens {
        let Self { cx, cy, k1, k2, p1, p2, k3, .. } = *self;
        let (fx, fy) = (self.fx.unwrap_or_default(), self.fy.unwrap_or_default());
        Lens {
            width: self.width.unwrap_or(width),
            height: self.height.unwrap_or(height),
            fx,
            fy,
            cx,
            cy,
            k1,
            k2,
            p1,
            p2,
            k3,
        }
    }
}

impl PoseFile {
    fn check(&self, path: &Path) -> Result<Pose> {
        let sine = self.forward.normalize_or_zero().cross(self.up.normalize_or_zero()).length();
        if !(sine > 1e-6 && self.centre.is_finite()) {
            return Err(Error::input(
                path,
                format!(
                    "has a pose with forward {} and up {}, which are parallel or zero",
                    self.forward, self.up
                ),
                "correct the pose",
            ));
        }
        Ok(Pose::from_axes(self.centre * 1e-3, self.forward, self.up))
    }
}

/// A lens in a file of another program, and where its first pixel's centre is; `None` for TOML and JSON.
fn foreign(path: &Path, text: &str, pixel_centre: f64) -> Result<Option<(LensFile, f64)>> {
    if opencv::is_storage(text) {
        return Ok(Some((opencv::read(path, text)?, pixel_centre)));
    }
    if path.file_name().is_some_and(|name| name == "cameras.txt") {
        let mut lenses: Vec<Lens> = colmap::read_cameras(path)?.into_values().collect();
        lenses.dedup();
        return match lenses[..] {
            [lens] => Ok(Some((LensFile::of(&lens), 0.0))),
            [] => Err(Error::input(path, "has no camera", "export the model again with COLMAP (as text)")),
            _ => {
                Err(Error::input(path, format!("has {} cameras", lenses.len()), "keep the one that is meant"))
            }
        };
    }
    Ok(None)
}

fn check_covariance(path: &Path, covariance: &LensCovariance) -> Result<()> {
    let usable = |i: usize, j: usize| {
        let (a, b) = (covariance[i][j], covariance[j][i]);
        a.is_finite() && (a - b).abs() <= 1e-6 * (covariance[i][i] * covariance[j][j]).sqrt()
    };
    let broken = (0..9).flat_map(|i| (0..9).map(move |j| (i, j))).find(|&(i, j)| !usable(i, j));
    match broken {
        None => Ok(()),
        Some((i, j)) => Err(Error::input(
            path,
            format!(
                "covariance has {} at row {} column {}, which no covariance has",
                covariance[i][j],
                i + 1,
                j + 1
            ),
            "write it again with `rigel calibrate`, or remove it",
        )),
    }
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(Error::io("read", path))
}

/// What to do about a file that is none.
const A_LENS: &str =
    "give a lens as `rigel calibrate` or OpenCV writes it: TOML, JSON, YAML or XML with fx, fy, cx and cy";
const A_CAMERA: &str = "give TOML or JSON with fx, fy, cx, cy, width, height, centre (mm), forward and up";
const REFERENCES: &str =
    "give TOML or JSON with `views`, each with file, fx, fy, cx, cy, centre (mm), forward and up";

fn parse_text<T: DeserializeOwned>(path: &Path, text: &str, remedy: &str) -> Result<T> {
    let parsed = match is_json(text) {
        true => serde_json::from_str(text).map_err(|error| error.to_string()),
        false => toml::from_str(text).map_err(|error: toml::de::Error| error.message().to_owned()),
    };
    parsed.map_err(|what| Error::input(path, format!("cannot be used ({what})"), remedy))
}

/// Whether a text is JSON rather than TOML, which may begin with a bracket too, but never with one before a brace.
fn is_json(text: &str) -> bool {
    let mut signs = text.chars().filter(|sign| !sign.is_whitespace());
    match signs.next() {
        Some('{') => true,
        Some('[') => matches!(signs.next(), Some('{' | ']')),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    #[test]
    fn toml_and_json_say_the_same() {
        let toml = file(
            "f = 500.0\ncx = 320.0\ncy = 240.0\nwidth = 640\nheight = 480\ncentre = [0.0, 0.0, 900.0]\nforward = [0.0, 0.0, -1.0]\nup = [0.0, 1.0, 0.0]\n",
        );
        let json = file(
            r#"{"fx": 500, "fy": 500, "cx": 320, "cy": 240, "width": 640, "height": 480,
            "centre": [0, 0, 900], "forward": [0, 0, -1], "up": [0, 1, 0]}"#,
        );
        let (lens, pose) = read_camera(toml.path(), 0.5).unwrap();
        assert_eq!((lens, pose), read_camera(json.path(), 0.5).unwrap());
        assert_eq!(lens.cx, 319.5);
        assert!((pose.to_camera(DVec3::new(0.1, 0.0, 0.0)) - DVec3::new(0.1, 0.0, 0.9)).length() < 1e-12);
    }

    #[test]
    fn a_covariance_is_read_and_checked() {
        let head = "f = 500.0\ncx = 320.0\ncy = 240.0\n";
        let rows = |change: f64| {
            let row = |i: usize| {
                let row: Vec<String> = (0..9)
                    .map(|j| {
                        if i == j { "4.0".into() } else { format!("{:?}", if j > i { 0.5 } else { change }) }
                    })
                    .collect();
                format!("[{}]", row.join(", "))
            };
            format!("covariance = [{}]\n", (0..9).map(row).collect::<Vec<_>>().join(", "))
        };
        let good = Calibration::read(file(&format!("{head}{}", rows(0.5))).path(), 0.0).unwrap();
        assert_eq!(good.covariance().unwrap()[3][2], 0.5);
        assert_eq!(Calibration::read(file(head).path(), 0.0).unwrap().covariance(), None);
        for bad in [rows(0.6), rows(f64::NAN), "covariance = [[1.0]]\n".into()] {
            let message =
                Calibration::read(file(&format!("{head}{bad}")).path(), 0.0).unwrap_err().to_string();
            assert!(message.contains("; "), "{message}");
        }
    }

    #[test]
    fn what_is_missing_is_named() {
        let without_focal = file("cx = 1.0\ncy = 1.0\n");
        let message = Calibration::read(without_focal.path(), 0.0).unwrap_err().to_string();
        assert!(message.contains("focal length"), "{message}");
        let parallel = file(
            "f = 1.0\ncx = 1.0\ncy = 1.0\nwidth = 2\nheight = 2\ncentre = [0.0, 0.0, 9.0]\nforward = [0.0, 1.0, 0.0]\nup = [0.0, 2.0, 0.0]\n",
        );
        assert!(read_camera(parallel.path(), 0.0).unwrap_err().to_string().contains("parallel"));
    }

    const VIEW: &str = r#"{"file": "a.exr", "f": 500, "cx": 320, "cy": 240, "centre": [0, 0, 900],
        "forward": [0, 0, -1], "up": [0, 1, 0]}"#;
    const TOML_VIEW: &str = "file = \"a.exr\"\nf = 500\ncx = 320\ncy = 240\ncentre = [0, 0, 900]\nforward = [0, 0, -1]\nup = [0, 1, 0]\n";

    #[test]
    fn a_list_of_references_is_an_array_or_views() {
        let array = ReferenceFile::read_list(file(&format!(" [ {VIEW} ]")).path(), 0.0).unwrap();
        assert_eq!(array.len(), 1);
        let inline = VIEW.replace("\": ", "\" = ").replace('\n', "");
        for text in [
            format!("{{\"views\": [{VIEW}]}}"),
            format!("[[views]]\n{TOML_VIEW}"),
            format!("# a comment\nviews = [{inline}]"),
        ] {
            let list = file(&text);
            let read = ReferenceFile::read_list(list.path(), 0.0).unwrap();
            assert_eq!((read[0].pose, read[0].lens), (array[0].pose, array[0].lens), "{text}");
            assert_eq!(read[0].file, list.path().with_file_name("a.exr"));
        }
        for text in ["[]", "views = []", "[[view]]", "[", "[{]"] {
            assert!(ReferenceFile::read_list(file(text).path(), 0.0).is_err(), "{text}");
        }
    }

    #[test]
    fn numbers_that_no_picture_has_are_refused() {
        let good = format!("width = 640\nheight = 480\n{TOML_VIEW}");
        read_camera(file(&good).path(), 0.0).unwrap();
        for (from, to) in [
            ("width = 640", "width = 0"),
            ("width = 640", "width = 65536"),
            ("height = 480", "height = 4294967295"),
            ("f = 500", "f = inf"),
            ("f = 500", "f = nan"),
            ("cx = 320", "cx = nan"),
            ("cx = 320", "cx = 320\nk1 = inf"),
            ("0, 900", "0, inf"),
            ("0, -1", "0, nan"),
        ] {
            assert!(good.contains(from));
            let damaged = file(&good.replacen(from, to, 1));
            assert!(read_camera(damaged.path(), 0.0).is_err(), "{to}");
            if !from.contains("0,") {
                assert!(Calibration::read(damaged.path(), 0.0).is_err(), "{to}");
            }
        }
        for pixel_centre in [0.25, -0.5, f64::NAN] {
            let message = read_camera(file(&good).path(), pixel_centre).unwrap_err().to_string();
            assert!(message.contains("0.5"), "{message}");
        }
    }
}

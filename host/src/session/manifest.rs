//! The manifest of a session: what was planned. People may read and edit it.

use std::collections::BTreeSet;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::geometry::{Lens, LensCovariance, Pose, Surface};
use crate::units::length;
use crate::{Error, Result, file};

/// The only version of the session folder so far.
const FORMAT: u32 = 1;

/// What a session consists of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the session folder.
    pub format: u32,
    /// Where the photographs come from: a rig and camera, or an import.
    pub source: String,
    /// Distance from the rig's centre to the camera.
    #[serde(rename = "distance", default, skip_serializing_if = "Option::is_none", with = "optional_length")]
    pub distance_m: Option<f64>,
    /// The first exposure time of each view, seconds, where a capture takes the photographs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub longest_exposure_s: Option<f64>,
    /// The sampled area.
    #[serde(default, skip_serializing_if = "Option::is_none", with = "surface")]
    pub surface: Option<Surface>,
    /// How sure the lens is, where it came with a covariance of its numbers and all views have one lens.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens_covariance: Option<LensCovariance>,
    /// How precisely every view shall be measured, where exposure times are not simply halved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub precision: Option<Precision>,
    /// The lenses with which the views were photographed.
    #[serde(rename = "lens", default, skip_serializing_if = "Vec::is_empty")]
    pub lenses: Vec<Lens>,
    /// The views.
    #[serde(rename = "view", default)]
    pub views: Vec<View>,
}

/// How precisely a view is measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Precision {
    /// The standard deviation of a pixel's radiance in a channel, relative to the radiance.
    pub relative_error: f64,
    /// The share of the pixels, each channel by itself, that are measured so well or better; of those that the longest
    /// exposure time shows at all.
    pub share: f64,
}

impl Default for Precision {
    /// A hundredth, for 99 of 100 pixels.
    fn default() -> Self {
        Self { relative_error: 0.01, share: 0.99 }
    }
}

/// One direction from which the surface is photographed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct View {
    /// Its name: the start of its file names.
    pub name: String,
    /// Commanded pan, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pan_deg: Option<f64>,
    /// Commanded tilt, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tilt_deg: Option<f64>,
    /// Index of its lens.
    #[serde(default)]
    pub lens: usize,
    /// Its calibrated pose, where known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<Pose>,
}

impl Manifest {
    /// A manifest without views.
    pub fn new(source: impl Into<String>) -> Self {
        Self {
            format: FORMAT,
            source: source.into(),
            distance_m: None,
            longest_exposure_s: None,
            precision: None,
            surface: None,
            lens_covariance: None,
            lenses: vec![],
            views: vec![],
        }
    }

    /// Writes the manifest as TOML.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = toml::to_string(self).expect("a manifest is plain data");
        file::write_bytes(path, text.as_bytes())
    }

    /// Reads a manifest.
    ///
    /// # Errors
    /// [`Error::Input`] when it is damaged, of another version, names a lens that it does not have, or a view has the name
    /// of another one or one that names no file.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        Self::parse(&text, path)
    }

    /// The manifest of this text; `path` is named in errors.
    ///
    /// # Errors
    /// Those of [`Manifest::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let damaged = |error: toml::de::Error| {
            Error::input(path, error.message().to_owned(), "correct the line or restore the file from a copy")
        };
        let table = text.parse().map_err(damaged)?;
        if let Some(number) = no_number(&toml::Value::Table(table)) {
            return Err(Error::input(path, format!("has the number {number}"), "give a finite one"));
        }
        let manifest: Self = toml::from_str(text).map_err(damaged)?;
        if manifest.format != FORMAT {
            return Err(Error::input(
                path,
                format!("has format {}, this is a reader of format {FORMAT}", manifest.format),
                "use the version of rigel that wrote it",
            ));
        }
        if let Some(view) =
            manifest.views.iter().find(|view| view.lens > 0 && view.lens >= manifest.lenses.len())
        {
            return Err(Error::input(
                path,
                format!("view {} has lens {}, but there are {}", view.name, view.lens, manifest.lenses.len()),
                "correct the number",
            ));
        }
        if let Some(Precision { relative_error, share }) = manifest.precision
            && ![relative_error, share].iter().all(|&part| part > 0.0 && part <= 1.0)
        {
            return Err(Error::input(
                path,
                format!(
                    "wishes for a relative error of {relative_error} in a share of {share} of the pixels"
                ),
                "give numbers above 0, 1 at most",
            ));
        }
        let mut names = BTreeSet::new();
        for View { name, .. } in &manifest.views {
            let what = if name.is_empty() || name.contains(['/', '\\']) {
                format!("names a view '{name}', which cannot begin a file's name")
            } else if !names.insert(name) {
                format!("names two views {name}")
            } else {
                continue;
            };
            return Err(Error::input(path, what, "correct the name or restore the file from a copy"));
        }
        Ok(manifest)
    }

    /// The lens of a view.
    ///
    /// # Errors
    /// [`Error::Request`] when the session has none.
    pub fn lens(&self, view: usize) -> Result<&Lens> {
        self.lenses.get(self.views[view].lens).ok_or_else(|| {
            Error::request("the session has no lens", "import with --calibration FILE or from a COLMAP model")
        })
    }

    /// The sampled area.
    ///
    /// # Errors
    /// [`Error::Request`] when the session does not know it.
    pub fn surface(&self) -> Result<Surface> {
        self.surface.ok_or_else(|| {
            Error::request(
                "the session does not know the size of the sampled area",
                "import with --surface 200mmx150mm",
            )
        })
    }
}

/// A number in `value` that is none, or infinite: TOML knows them, no rig and no lens does.
fn no_number(value: &toml::Value) -> Option<f64> {
    match value {
        toml::Value::Float(number) => (!number.is_finite()).then_some(*number),
        toml::Value::Array(values) => values.iter().find_map(no_number),
        toml::Value::Table(table) => table.values().find_map(no_number),
        _ => None,
    }
}

mod optional_length {
    use super::*;
    use serde::{Deserializer, Serializer};

    pub fn serialize<S: Serializer>(
        metres: &Option<f64>,
        serializer: S,
    ) -> std::result::Result<S::Ok, S::Error> {
        length::serialize(&metres.unwrap_or_default(), serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> std::result::Result<Option<f64>, D::Error> {
        length::deserialize(deserializer).map(Some)
    }
}

mod surface {
    use super::*;
    use crate::units::{format_length, parse_surface};
    use serde::{Deserializer, Serializer};

    pub fn serialize<S: Serializer>(
        surface: &Option<Surface>,
        serializer: S,
    ) -> std::result::Result<S::Ok, S::Error> {
        let Some(surface) = surface else { return serializer.serialize_none() };
        serializer.serialize_str(&format!(
            "{}x{}",
            format_length(surface.width_m),
            format_length(surface.height_m)
        ))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> std::result::Result<Option<Surface>, D::Error> {
        let text = String::deserialize(deserializer)?;
        parse_surface(&text).map(Some).map_err(serde::de::Error::custom)
    }
}

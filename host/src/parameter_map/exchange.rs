//! Parameter maps as OpenEXR files: one named channel for each coefficient, and what they mean as attributes.

use std::path::Path;

use exr::image::read::read_first_flat_layer_from_file;
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Encoding, FlatSamples, Image, Layer, LayerAttributes, Text,
    WritableImage,
};
use half::f16;

use super::{Diagnostics, ParameterMap};
use crate::error::{Error, Result};
use crate::file::write_beside;
use crate::fit::{FitFlags, Model};
use crate::geometry::{Surface, Texels};

const MODEL: &str = "rigelModel";
const VERSION: &str = "rigelVersion";
const WIDTH: &str = "rigelSurfaceWidthM";
const HEIGHT: &str = "rigelSurfaceHeightM";
const RESIDUAL: &str = "fit.residual";
const VIEWS: &str = "fit.views";
const FLAGS: &str = "fit.flags";
const UNIT: &str = "the radiance of the session's pictures; metres, of a COLMAP model its own unit of length";
const MAKE_AGAIN: &str = "fit the observation map again with `rigel fit`";

impl ParameterMap {
    /// Writes the map as OpenEXR: a channel for each of [`Model::channel_names`], without loss beyond the samples'
    /// precision. A channel is stored in half floats where that changes no value by more than 1/1000 of the channel's
    /// largest, else in single precision; logarithms always in single precision.
    ///
    /// # Errors
    /// [`Error::Request`] when a value is not finite or the lengths disagree, [`Error::Io`] or [`Error::Input`] when
    /// the file cannot be written; what stood there is then untouched.
    pub fn write(&self, path: &Path) -> Result<()> {
        let (count, texels) = (self.model.parameter_count(), self.texels.count());
        if texels == 0 || self.parameters.len() != count * texels {
            return Err(Error::request(
                format!("{} values are not {count} for each of {texels} texels", self.parameters.len()),
                MAKE_AGAIN,
            ));
        }
        if let Some(wrong) = self.parameters.iter().position(|value| !value.is_finite()) {
            return Err(Error::request(
                format!("texel {} has the coefficient {}", wrong / count, self.parameters[wrong]),
                MAKE_AGAIN,
            ));
        }
        let mut channels = Vec::new();
        for (i, name) in self.model.channel_names().iter().enumerate() {
            let values: Vec<f32> = self.parameters.iter().skip(i).step_by(count).copied().collect();
            let samples = match self.model {
                Model::LogQuadratic => FlatSamples::F32(values),
                _ => small_enough(values),
            };
            channels.push(AnyChannel::new(name.as_str(), samples));
        }
        if let Some(diagnostics) = &self.diagnostics {
            channels.push(AnyChannel::new(RESIDUAL, FlatSamples::F32(diagnostics.residual.clone())));
            channels.push(AnyChannel::new(VIEWS, FlatSamples::U32(diagnostics.views.clone())));
            let flags = diagnostics.flags.iter().map(|flags| u32::from(flags.0)).collect();
            channels.push(AnyChannel::new(FLAGS, FlatSamples::U32(flags)));
        }
        let mut attributes =
            LayerAttributes { comments: Some(self.meaning().as_str().into()), ..Default::default() };
        attributes.other.extend([
            (Text::from(MODEL), AttributeValue::Text(self.model.name().as_str().into())),
            (Text::from(VERSION), AttributeValue::Text(env!("CARGO_PKG_VERSION").into())),
            (Text::from(WIDTH), AttributeValue::F64(self.surface.width_m)),
            (Text::from(HEIGHT), AttributeValue::F64(self.surface.height_m)),
            (Text::from("rigelUnit"), AttributeValue::Text(UNIT.into())),
        ]);
        let size = (self.texels.columns as usize, self.texels.rows as usize);
        let layer = Layer::new(
            size,
            attributes,
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(channels.into_iter().collect()),
        );
        write_beside(path, |temporary| {
            Image::from_layer(layer).write().to_file(temporary).map_err(|error| match error {
                exr::error::Error::Io(source) => Error::io("write", path)(source),
                other => Error::input(path, format!("OpenEXR refuses the map: {other}"), MAKE_AGAIN),
            })
        })
    }

    /// Reads a map that [`ParameterMap::write`] wrote; unknown channels and attributes are ignored.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Input`] that names what is missing when it is no OpenEXR
    /// file, no parameter map, or holds a value that is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let image = read_first_flat_layer_from_file(path).map_err(|error| match error {
            exr::error::Error::Io(source) if source.kind() != std::io::ErrorKind::UnexpectedEof => {
                Error::io("read", path)(source)
            }
            other => Error::input(path, format!("is no complete OpenEXR file ({other})"), MAKE_AGAIN),
        })?;
        let layer = &image.layer_data;
        let attribute = |name: &'static str| {
            let found = layer
                .attributes
                .other
                .get(&Text::from(name))
                .or(image.attributes.other.get(&Text::from(name)));
            let missing = || {
                Error::input(
                    path,
                    format!("is no parameter map: its attribute {name} is missing"),
                    MAKE_AGAIN,
                )
            };
            found.ok_or_else(missing)
        };
        let length = |name: &'static str| match attribute(name)? {
            AttributeValue::F64(value) if value.is_finite() && *value > 0.0 => Ok(*value),
            other => Err(Error::input(
                path,
                format!("its attribute {name} is {other:?}, no length in metres"),
                MAKE_AGAIN,
            )),
        };
        let model = match attribute(MODEL)? {
            AttributeValue::Text(name) => Model::parse(&name.to_string()).map_err(|error| {
                Error::input(path, format!("its attribute {MODEL} is wrong: {error}"), MAKE_AGAIN)
            })?,
            other => {
                return Err(Error::input(
                    path,
                    format!("its attribute {MODEL} is {other:?}, no name"),
                    MAKE_AGAIN,
                ));
            }
        };
        let surface = Surface { width_m: length(WIDTH)?, height_m: length(HEIGHT)? };
        let texels = Texels { columns: layer.size.0 as u32, rows: layer.size.1 as u32 };
        let channel = |name: &str| layer.channel_data.list.iter().find(|channel| channel.name.eq(name));
        let count = model.parameter_count();
        let mut parameters = vec![0.0; count * texels.count()];
        for (i, name) in model.channel_names().iter().enumerate() {
            let missing = || {
                Error::input(
                    path,
                    format!("the channel {name} of its model {} is missing", model.name()),
                    MAKE_AGAIN,
                )
            };
            let samples = &channel(name).ok_or_else(missing)?.sample_data;
            for (texel, value) in samples.values_as_f32().enumerate() {
                if !value.is_finite() {
                    return Err(Error::input(
                        path,
                        format!("channel {name} holds {value} at texel {texel}"),
                        MAKE_AGAIN,
                    ));
                }
                parameters[texel * count + i] = value;
            }
        }
        let diagnostics = match [RESIDUAL, VIEWS, FLAGS].map(channel) {
            [Some(residual), Some(views), Some(flags)] => Some(Diagnostics {
                residual: residual.sample_data.values_as_f32().collect(),
                views: views.sample_data.values_as_f32().map(|value| value as u32).collect(),
                flags: flags.sample_data.values_as_f32().map(|value| FitFlags(value as u8)).collect(),
            }),
            _ => None,
        };
        Ok(Self { surface, texels, model, parameters, diagnostics })
    }

    /// For whoever finds the file without this program.
    fn meaning(&self) -> String {
        let formula = match self.model {
            Model::Constant => "L = radiance",
            Model::Phong { .. } => {
                "L(d) = diffuse + sum over lobes of specular * max(0, dot(lobe, d))^shininess"
            }
            Model::LogQuadratic => {
                "L(d) = exp(min(log.most, log.1 + log.x x + log.y y + log.xx x^2 + log.xy x y + log.yy y^2)), d = (x, y, z)"
            }
            Model::Harmonics { .. } => {
                "L(d) = max(0, sum over l, m of c_lm Y_lm(d)), Y real orthonormal spherical harmonics without \
                 Condon-Shortley phase, m < 0 with sin(|m| azimuth)"
            }
        };
        format!(
            "Radiance (linear RGB) leaving each texel toward the unit vector d of the viewer. {formula}. Frame: x right, \
             y up, z out of the surface. Blend the radiance of neighbouring texels, not their coefficients."
        )
    }
}

/// Half floats where they are good enough.
fn small_enough(values: Vec<f32>) -> FlatSamples {
    let most = values.iter().fold(0.0_f32, |most, value| most.max(value.abs()));
    let halves: Vec<f16> = values.iter().map(|value| f16::from_f32(*value)).collect();
    let close = |(half, value): (&f16, &f32)| (half.to_f32() - value).abs() <= 1e-3 * most;
    if halves.iter().zip(&values).all(close) { FlatSamples::F16(halves) } else { FlatSamples::F32(values) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(model: Model, scale: f32) -> ParameterMap {
        let texels = Texels { columns: 5, rows: 3 };
        let count = model.parameter_count() * texels.count();
        let parameters = (0..count).map(|i| scale * ((i * 37 % 101) as f32 - 20.0) / 50.0).collect();
        let diagnostics = Diagnostics {
            residual: (0..15).map(|i| i as f32 / 7.0).collect(),
            views: (0..15).collect(),
            flags: (0..15).map(FitFlags).collect(),
        };
        let surface = Surface { width_m: 0.2, height_m: 0.15 };
        ParameterMap { surface, texels, model, parameters, diagnostics: Some(diagnostics) }
    }

    #[test]
    fn a_map_comes_back_from_its_file_at_any_scale_of_radiance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        for model in Model::all() {
            for scale in [1e-9, 1.0, 1e6] {
                let map = map(model, scale);
                map.write(&path).unwrap();
                let back = ParameterMap::read(&path).unwrap();
                assert_eq!((back.surface, back.texels, back.model), (map.surface, map.texels, map.model));
                assert_eq!(back.diagnostics, map.diagnostics);
                for (got, want) in back.parameters.iter().zip(&map.parameters) {
                    assert!((got - want).abs() <= 2e-3 * scale, "{}: {got} for {want}", model.name());
                }
            }
        }
    }

    #[test]
    fn a_value_that_is_not_a_number_is_refused_and_the_old_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let mut map = map(Model::Constant, 1.0);
        map.write(&path).unwrap();
        let before = std::fs::read(&path).unwrap();
        map.parameters[7] = f32::NAN;
        assert!(map.write(&path).unwrap_err().to_string().contains("texel 2"));
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }

    #[test]
    fn another_file_is_no_parameter_map_and_the_message_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("photograph.exr");
        exr::prelude::write_rgb_file(&path, 4, 4, |_, _| (0.5_f32, 0.5_f32, 0.5_f32)).unwrap();
        let message = ParameterMap::read(&path).unwrap_err().to_string();
        assert!(
            message.contains("photograph.exr") && message.contains(MODEL) && message.contains("rigel fit"),
            "{message}"
        );
        std::fs::write(&path, b"not at all").unwrap();
        assert!(ParameterMap::read(&path).unwrap_err().to_string().contains("no complete OpenEXR"));
        let missing = ParameterMap::read(&folder.path().join("missing.exr")).unwrap_err();
        assert!(matches!(missing, Error::Io { .. }), "{missing}");
        let whole = folder.path().join("whole.exr");
        map(Model::Phong { lobes: 1 }, 1.0).write(&whole).unwrap();
        let bytes = std::fs::read(&whole).unwrap();
        std::fs::write(&whole, &bytes[..bytes.len() / 2]).unwrap();
        assert!(ParameterMap::read(&whole).is_err(), "half a file is no map");
    }
}

//! Parameter maps as OpenEXR files: one named channel for each coefficient, and what they mean as attributes.

use std::path::Path;

use exr::image::read::read_first_flat_layer_from_file;
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Encoding, FlatSamples, Image, Layer, LayerAttributes, Text,
    WritableImage,
};
use half::f16;

use super::{Diagnostics, ParameterMap, Uncertainty};
use crate::error::{Error, Result};
use crate::file::write_beside;
use crate::fit::{BANDS, FitFlags, HarmonicsMethod, Model, Reason};
use crate::geometry::{Surface, Texels};

const MODEL: &str = "rigelModel";
const VERSION: &str = "rigelVersion";
const WIDTH: &str = "rigelSurfaceWidthM";
const HEIGHT: &str = "rigelSurfaceHeightM";
const RESIDUAL: &str = "fit.residual";
const VIEWS: &str = "fit.views";
const FLAGS: &str = "fit.flags";
const CHOICE: &str = "fit.model";
const RUNNER_UP: &str = "fit.runnerUp";
const REASON: &str = "fit.reason";
const PALETTE: &str = "fit.palette";
const SIGMA: &str = "fit.sigma";
const FLOOR: &str = "rigelSigmaFloor";
const SEEN: &str = "rigelViews";
const MEASURED_ZENITH: &str = "rigelMeasuredZenithDeg";
const PHOTOMETRY: &str = "rigelPhotometry";
const ZENITH: &str = "rigelSigmaZenith";
const UNIT: &str = "the radiance of the session's pictures; metres, of a COLMAP model its own unit of length";
const MAKE_AGAIN: &str = "fit the observation map again with `rigel fit`";
const GIVE: &str = "give a parameter map as `rigel fit` writes it";

impl ParameterMap {
    /// Writes the map as OpenEXR: a channel for each of [`Model::channel_names`], without loss beyond the samples'
    /// precision. A channel is stored in half floats where that changes no value by more than 1/1000 of the channel's
    /// largest, else in single precision; logarithms always in single precision.
    ///
    /// # Errors
    /// [`Error::Request`] when a value is not finite or the lengths disagree, [`Error::Io`] or [`Error::Input`] when
    /// the file cannot be written; what stood there is then untouched.
    pub fn write(&self, path: &Path) -> Result<()> {
        let (count, texels) = (self.stride(), self.texels.count());
        let is_chosen = |choice: &u8| usize::from(*choice) < self.models.len();
        let choices = if self.models.len() == 1 { 0 } else { texels };
        if self.choice.len() != choices || !self.choice.iter().all(is_chosen) {
            return Err(Error::request(
                format!(
                    "{} choices among {} models are not one for each of {texels} texels",
                    self.choice.len(),
                    self.models.len()
                ),
                MAKE_AGAIN,
            ));
        }
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
        if let Some(Diagnostics { residual, views, flags, runner_up, reason, sigma, .. }) = &self.diagnostics
        {
            let lengths = [residual.len(), views.len(), flags.len()];
            let choices = [runner_up.len(), reason.len(), sigma.len(), self.palette().len()];
            if lengths != [texels; 3] || choices.iter().any(|length| ![0, texels].contains(length)) {
                return Err(Error::request("the diagnostics are not one for each texel", MAKE_AGAIN));
            }
            if let Some(wrong) = residual.iter().position(|value| !value.is_finite()) {
                return Err(Error::request(
                    format!("texel {wrong} has the residual {}", residual[wrong]),
                    MAKE_AGAIN,
                ));
            }
        }
        let mut channels = Vec::new();
        for (name, is_logarithm) in self.channels() {
            let places = self.places(&name);
            let value = |texel: usize| {
                places[self.choice_at(texel)].map_or(0.0, |place| self.parameters[texel * count + place])
            };
            let values: Vec<f32> = (0..texels).map(value).collect();
            let samples = if is_logarithm { FlatSamples::F32(values) } else { small_enough(values) };
            channels.push(AnyChannel::new(name.as_str(), samples));
        }
        let numbers =
            |values: &[u8]| FlatSamples::U32(values.iter().map(|value| u32::from(*value)).collect());
        if !self.choice.is_empty() {
            channels.push(AnyChannel::new(CHOICE, numbers(&self.choice)));
        }
        if let Some(diagnostics) = &self.diagnostics {
            channels.push(AnyChannel::new(RESIDUAL, FlatSamples::F32(diagnostics.residual.clone())));
            channels.push(AnyChannel::new(VIEWS, FlatSamples::U32(diagnostics.views.clone())));
            let flags: Vec<u8> = diagnostics.flags.iter().map(|flags| flags.0).collect();
            channels.push(AnyChannel::new(FLAGS, numbers(&flags)));
            if !diagnostics.runner_up.is_empty() {
                let reasons: Vec<u8> = diagnostics.reason.iter().map(|reason| *reason as u8).collect();
                channels.push(AnyChannel::new(RUNNER_UP, numbers(&diagnostics.runner_up)));
                channels.push(AnyChannel::new(REASON, numbers(&reasons)));
            }
            if !diagnostics.palette.is_empty() {
                channels.push(AnyChannel::new(PALETTE, numbers(&diagnostics.palette)));
            }
            if self.uncertainty.is_some() {
                channels.push(AnyChannel::new(SIGMA, FlatSamples::F32(diagnostics.sigma.clone())));
            }
        }
        let mut attributes =
            LayerAttributes { comments: Some(self.meaning().as_str().into()), ..Default::default() };
        attributes.other.extend([
            (Text::from(MODEL), AttributeValue::Text(self.name().as_str().into())),
            (Text::from(VERSION), AttributeValue::Text(env!("CARGO_PKG_VERSION").into())),
            (Text::from(WIDTH), AttributeValue::F64(self.surface.width_m)),
            (Text::from(HEIGHT), AttributeValue::F64(self.surface.height_m)),
            (Text::from("rigelUnit"), AttributeValue::Text(UNIT.into())),
        ]);
        if let Some(diagnostics) =
            self.diagnostics.as_ref().filter(|diagnostics| !diagnostics.seen.is_empty())
        {
            let names = Text::new_or_none(diagnostics.seen.join(",")).ok_or_else(|| {
                let what = "the views' names have letters that OpenEXR cannot hold";
                Error::input(path, what, "rename the views in the session")
            })?;
            attributes.other.insert(Text::from(SEEN), AttributeValue::Text(names));
        }
        if let Some(zenith_rad) = self.diagnostics.as_ref().and_then(|diagnostics| diagnostics.zenith_rad) {
            let zenith_deg = AttributeValue::F64(zenith_rad.to_degrees());
            attributes.other.insert(Text::from(MEASURED_ZENITH), zenith_deg);
        }
        if let Some(hash) =
            self.diagnostics.as_ref().and_then(|diagnostics| diagnostics.photometry.as_deref())
        {
            attributes.other.insert(Text::from(PHOTOMETRY), AttributeValue::Text(hash.into()));
        }
        if let Some(uncertainty) = &self.uncertainty {
            let text = |factors: &[f32; BANDS]| factors.map(|factor| factor.to_string()).join(" ");
            let zenith: Vec<String> = uncertainty.zenith.iter().map(text).collect();
            attributes.other.extend([
                (Text::from(FLOOR), AttributeValue::F64(uncertainty.floor.into())),
                (Text::from(ZENITH), AttributeValue::Text(zenith.join("; ").as_str().into())),
            ]);
        }
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
            other => Error::input(path, format!("is no complete OpenEXR file ({other})"), GIVE),
        })?;
        let layer = &image.layer_data;
        let attribute = |name: &'static str| {
            let found = layer
                .attributes
                .other
                .get(&Text::from(name))
                .or(image.attributes.other.get(&Text::from(name)));
            let missing =
                || Error::input(path, format!("is no parameter map: its attribute {name} is missing"), GIVE);
            found.ok_or_else(missing)
        };
        let positive = |name: &'static str| match attribute(name)? {
            AttributeValue::F64(value) if value.is_finite() && *value > 0.0 => Ok(*value),
            other => Err(Error::input(
                path,
                format!("its attribute {name} is {other:?}, not a number above 0"),
                MAKE_AGAIN,
            )),
        };
        let models = match attribute(MODEL)? {
            AttributeValue::Text(names) => {
                let models: Result<Vec<Model>> = names.to_string().split(' ').map(Model::parse).collect();
                models.map_err(|error| {
                    Error::input(path, format!("its attribute {MODEL} is wrong: {error}"), MAKE_AGAIN)
                })?
            }
            other => {
                return Err(Error::input(
                    path,
                    format!("its attribute {MODEL} is {other:?}, no name"),
                    MAKE_AGAIN,
                ));
            }
        };
        let surface = Surface { width_m: positive(WIDTH)?, height_m: positive(HEIGHT)? };
        let texels = Texels { columns: layer.size.0 as u32, rows: layer.size.1 as u32 };
        let channel = |name: &str| layer.channel_data.list.iter().find(|channel| channel.name.eq(name));
        let numbers = |name: &str, below: usize| -> Result<Option<Vec<u8>>> {
            let Some(channel) = channel(name) else { return Ok(None) };
            let values: Vec<f32> = channel.sample_data.values_as_f32().collect();
            match values.iter().position(|value| !(0.0..below as f32).contains(value)) {
                Some(wrong) => Err(Error::input(
                    path,
                    format!(
                        "channel {name} holds {} at texel {wrong}, not a number below {below}",
                        values[wrong]
                    ),
                    MAKE_AGAIN,
                )),
                None => Ok(Some(values.into_iter().map(|value| value as u8).collect())),
            }
        };
        let choice = match models.len() {
            1 => vec![],
            count => numbers(CHOICE, count)?.ok_or_else(|| {
                Error::input(
                    path,
                    format!("the channel {CHOICE} is missing, which says what model a texel has"),
                    MAKE_AGAIN,
                )
            })?,
        };
        let mut map = Self {
            surface,
            texels,
            models,
            choice,
            parameters: vec![],
            diagnostics: None,
            uncertainty: None,
        };
        let count = map.stride();
        map.parameters = vec![0.0; count * texels.count()];
        for (name, _) in map.channels() {
            let missing = || {
                Error::input(
                    path,
                    format!("the channel {name} of its model {} is missing", map.name()),
                    MAKE_AGAIN,
                )
            };
            let samples = &channel(&name).ok_or_else(missing)?.sample_data;
            let places = map.places(&name);
            for (texel, value) in samples.values_as_f32().enumerate() {
                if !value.is_finite() {
                    return Err(Error::input(
                        path,
                        format!("channel {name} holds {value} at texel {texel}"),
                        MAKE_AGAIN,
                    ));
                }
                if let Some(place) = places[map.choice_at(texel)] {
                    map.parameters[texel * count + place] = value;
                }
            }
        }
        map.diagnostics = match [RESIDUAL, VIEWS, FLAGS].map(channel) {
            [Some(residual), Some(views), Some(flags)] => Some(Diagnostics {
                residual: residual.sample_data.values_as_f32().collect(),
                views: views.sample_data.values_as_f32().map(|value| value as u32).collect(),
                flags: flags.sample_data.values_as_f32().map(|value| FitFlags(value as u8)).collect(),
                runner_up: numbers(RUNNER_UP, map.models.len())?.unwrap_or_default(),
                reason: numbers(REASON, Reason::ALL.len())?
                    .unwrap_or_default()
                    .into_iter()
                    .map(|reason| Reason::ALL[usize::from(reason)])
                    .collect(),
                palette: numbers(PALETTE, 256)?.unwrap_or_default(),
                sigma: channel(SIGMA)
                    .map_or_else(Vec::new, |sigma| sigma.sample_data.values_as_f32().collect()),
                seen: match attribute(SEEN) {
                    Ok(AttributeValue::Text(names)) => {
                        names.to_string().split(',').map(str::to_owned).collect()
                    }
                    _ => vec![],
                },
                zenith_rad: match attribute(MEASURED_ZENITH) {
                    Ok(AttributeValue::F64(zenith_deg)) => Some(zenith_deg.to_radians()),
                    _ => None,
                },
                photometry: match attribute(PHOTOMETRY) {
                    Ok(AttributeValue::Text(hash)) => Some(hash.to_string()),
                    _ => None,
                },
            }),
            _ => None,
        };
        if let (Ok(AttributeValue::Text(zenith)), Some(_)) = (attribute(ZENITH), channel(SIGMA)) {
            let floor = positive(FLOOR)? as f32;
            let factors = |text: &str| {
                let numbers: Vec<f32> = text.split(' ').filter_map(|number| number.parse().ok()).collect();
                <[f32; BANDS]>::try_from(numbers).ok()
            };
            let zenith: Option<Vec<_>> = zenith.to_string().split("; ").map(factors).collect();
            let zenith = zenith.filter(|zenith| zenith.len() == map.models.len()).ok_or_else(|| {
                let what = format!("its attribute {ZENITH} does not hold {BANDS} numbers for each model");
                Error::input(path, what, MAKE_AGAIN)
            })?;
            map.uncertainty = Some(Uncertainty { floor, zenith });
        }
        Ok(map)
    }

    /// Every channel of the models that texels have once, and whether it holds logarithms.
    fn channels(&self) -> Vec<(String, bool)> {
        let mut channels: Vec<(String, bool)> = vec![];
        let is_used = |i: usize| self.choice.is_empty() || self.choice.iter().any(|c| usize::from(*c) == i);
        for (_, model) in self.models.iter().enumerate().filter(|(i, _)| is_used(*i)) {
            for name in model.channel_names() {
                if !channels.iter().any(|(known, _)| *known == name) {
                    channels.push((name, *model == Model::LogQuadratic));
                }
            }
        }
        channels
    }

    /// Where each of the models has the channel of this name.
    fn places(&self, name: &str) -> Vec<Option<usize>> {
        let place = |model: &Model| model.channel_names().iter().position(|known| known == name);
        self.models.iter().map(place).collect()
    }

    /// For whoever finds the file without this program.
    fn meaning(&self) -> String {
        let formula = |model: &Model| match model {
            Model::Constant => "L = radiance",
            Model::Phong { .. } | Model::SharedPhong { .. } => {
                "L(d) = diffuse + sum over lobes of specular * max(0, dot(lobe, d))^shininess"
            }
            Model::LogQuadratic => {
                "L(d) = exp(min(log.most, log.1 + log.x x + log.y y + log.xx x^2 + log.xy x y + log.yy y^2)), d = (x, y, z)"
            }
            Model::Harmonics { method: HarmonicsMethod::Hemispherical, .. } => {
                "L(d) = max(0, sum over l, m of c_lm sqrt(2) Y_lm(sqrt(4 z / (1 + z)) x, sqrt(4 z / (1 + z)) y, 2 z - 1)), \
                 d = (x, y, z), Y real orthonormal spherical harmonics without Condon-Shortley phase, m < 0 with \
                 sin(|m| azimuth)"
            }
            Model::Harmonics { .. } => {
                "L(d) = max(0, sum over l, m of c_lm Y_lm(d)), Y real orthonormal spherical harmonics without \
                 Condon-Shortley phase, m < 0 with sin(|m| azimuth)"
            }
        };
        let formula = match self.models.as_slice() {
            [model] => formula(model).to_owned(),
            models => {
                let each = models.iter().enumerate();
                let each: Vec<_> = each.map(|(i, m)| format!("{i} ({}): {}", m.name(), formula(m))).collect();
                format!("The channel {CHOICE} says which formula a texel has: {}", each.join("; "))
            }
        };
        format!(
            "Radiance (linear RGB) leaving each texel toward the unit vector d of the viewer. {formula}. Frame: x right, \
             y up, z out of the surface. Blend the radiance of neighbouring texels, not their coefficients. {FLAGS}, added up: 1 fewer views than \
             the model has unknowns, 2 none, 4 a parameter at its bound, 8 not converged, 16 a lobe that the views do not determine, 32 \
             held above zero. {REASON}: 0 best, 1 a larger model is hardly better, 2 within the tolerance, 3 the texels around, 4 too few \
             views for another, 5 not worth a larger one, 6 shared. {PALETTE}: texels with the same number above 0 share their coefficients."
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
    use glam::Vec3;

    use super::*;

    fn map(model: Model, scale: f32) -> ParameterMap {
        let texels = Texels { columns: 5, rows: 3 };
        let count = model.parameter_count() * texels.count();
        let parameters: Vec<f32> =
            (0..count).map(|i| scale * ((i * 37 % 101) as f32 - 20.0) / 50.0).collect();
        let diagnostics = Diagnostics {
            residual: (0..15).map(|i| i as f32 / 7.0).collect(),
            views: (0..15).collect(),
            flags: (0..15).map(FitFlags).collect(),
            ..Diagnostics::default()
        };
        let surface = Surface { width_m: 0.2, height_m: 0.15 };
        let (models, choice) = (vec![model], vec![]);
        let diagnostics = Some(diagnostics);
        ParameterMap { surface, texels, models, choice, parameters, diagnostics, uncertainty: None }
    }

    #[test]
    fn a_map_of_several_models_comes_back_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let models = vec![Model::Constant, Model::Phong { lobes: 1 }, Model::Phong { lobes: 2 }];
        let mut mixed = map(models[2], 1.0);
        mixed.choice = (0..15).map(|texel| texel % 3).collect();
        for (texel, choice) in mixed.choice.iter().enumerate() {
            let unused = models[usize::from(*choice)].parameter_count()..17;
            mixed.parameters[17 * texel..17 * (texel + 1)][unused].fill(0.0);
        }
        mixed.models = models;
        let diagnostics = mixed.diagnostics.as_mut().unwrap();
        diagnostics.runner_up = (0..15).map(|texel| (texel + 1) % 3).collect();
        diagnostics.reason = (0..15).map(|texel| Reason::ALL[texel % 7]).collect();
        diagnostics.palette = (0..15).map(|texel| [0, 0, 0, 1, 2, 3][texel % 6]).collect();
        diagnostics.zenith_rad = Some(1.0);
        diagnostics.sigma = (0..15).map(|texel| 0.01 * texel as f32).collect();
        let zenith = (0..3).map(|model| [1.0, 0.9, 0.8, 1.1, 1.5, model as f32]).collect();
        mixed.uncertainty = Some(Uncertainty { floor: 0.25, zenith });
        mixed.write(&path).unwrap();
        let back = ParameterMap::read(&path).unwrap();
        assert_eq!((&back.models, &back.choice), (&mixed.models, &mixed.choice));
        assert_eq!(back.diagnostics, mixed.diagnostics);
        // OpenEXR's text is Latin-1.
        mixed.diagnostics.as_mut().unwrap().seen = vec!["Ωmega".into()];
        assert!(mixed.write(&path).is_err_and(|error| error.to_string().contains("names")));
        assert_eq!(back.uncertainty, mixed.uncertainty);
        let direction = Vec3::new(0.0, 0.6, 0.8);
        let (model, parameters) = mixed.texel(1, 0);
        let expected = 0.01 * 0.8 * (model.radiance(parameters, direction)[0] + 0.25);
        assert!((mixed.sigma(1, 0, direction).unwrap()[0] / expected - 1.0).abs() < 1e-5);
        assert!(back.parameters.iter().zip(&mixed.parameters).all(|(a, b)| (a - b).abs() <= 2e-3));
        // Nine texels have a model of their own, six share three entries.
        assert!((mixed.bytes_per_texel() - (1.0 + 4.0 * (6.0 + 20.0 + 34.0) / 15.0)).abs() < 1e-12);
        mixed.choice[4] = 3;
        assert!(mixed.write(&path).unwrap_err().to_string().contains("choices"));
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
                assert_eq!((back.surface, back.texels, &back.models), (map.surface, map.texels, &map.models));
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

//! A map of the radiance from every direction, and its OpenEXR file.

use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, WritableImage,
    attribute::{AttributeValue, EnvironmentMap as Projection},
};
use glam::DVec3;

use crate::geometry::LatLong;
use crate::picture::Picture;
use crate::{Error, Result, file};

/// The attribute of a map that Rigel wrote, and those that say its unit and its camera's curve.
const MARK: &str = "rigelEnvironment";
const UNIT: &str = "rigelUnit";
const CURVE: &str = "rigelCurve";
/// Knots of a camera's curve, and what none of them reaches: a factor of 20000.
pub(super) const KNOTS: usize = 13;
const MOST_BENT: f64 = 10.0;
const SOFTWARE: &str = concat!("rigel ", env!("CARGO_PKG_VERSION"));

/// What is special about a pixel; 0 is nothing.
pub type Flag = u8;

/// What a map's radiance is counted in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Unit {
    /// Nothing says it: a map of another program.
    #[default]
    Unknown,
    /// That of the mean photograph: no exposure was stated.
    MeanPhotograph,
    /// 1 saturates a photograph whose exposure is 1: its time in seconds, times its sensitivity where the photographs state it, over the square of
    /// its f-number where they state that.
    Saturation {
        /// Sensitivities were stated.
        iso: bool,
        /// F-numbers were stated.
        f_number: bool,
    },
}

impl Unit {
    const ALL: [(Self, &str, &str); 6] = [
        (Self::Unknown, "unknown", "a unit that nothing tells"),
        (Self::MeanPhotograph, "mean photograph", "a unit of its own (exposures were not stated)"),
        (
            Self::Saturation { iso: false, f_number: false },
            "saturation s",
            "what saturates a photograph of 1 s",
        ),
        (
            Self::Saturation { iso: true, f_number: false },
            "saturation s iso",
            "what saturates a photograph of 1 s at ISO 1",
        ),
        (
            Self::Saturation { iso: false, f_number: true },
            "saturation s/f2",
            "what saturates a photograph of 1 s at f/1",
        ),
        (
            Self::Saturation { iso: true, f_number: true },
            "saturation s iso/f2",
            "what saturates a photograph of 1 s at ISO 1 and f/1",
        ),
    ];

    /// In words, after "in".
    pub fn words(self) -> &'static str {
        Self::ALL.iter().find(|(unit, ..)| *unit == self).map_or("", |(_, _, words)| words)
    }

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(unit, ..)| *unit == self).map_or("", |(_, name, _)| name)
    }

    fn named(name: &str) -> Self {
        Self::ALL.iter().find(|(_, known, _)| *known == name).map_or(Self::Unknown, |(unit, ..)| *unit)
    }
}

/// Radiance from every direction.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentMap {
    /// Its size.
    pub size: LatLong,
    /// Linear red, green and blue; 0 where nothing was seen.
    pub radiance: Vec<[f32; 3]>,
    /// The variance of each of them (green's, at their mean); infinite where nothing was measured. Empty for a map of another program.
    pub variance: Vec<f32>,
    /// How many photographs show a pixel. Empty for a map of another program.
    pub coverage: Vec<u16>,
    /// [`Self::LOWER_BOUND`], [`Self::UNSEEN`] or [`Self::FILLED`]. Empty for a map of another program.
    pub flags: Vec<Flag>,
    /// What the radiance is counted in.
    pub unit: Unit,
    /// What the photographs' stated exposures told of the camera's curve: ln of exposure over that of sRGB, at 13 exposures even in the root
    /// 2.2 of their part of white. Empty where they told nothing.
    pub curve: Vec<f64>,
}

impl EnvironmentMap {
    /// Every photograph that shows the pixel was saturated there: the largest of what they say.
    pub const LOWER_BOUND: Flag = 1;
    /// No photograph shows the pixel.
    pub const UNSEEN: Flag = 2;
    /// No photograph shows it, and it was filled from what is around.
    pub const FILLED: Flag = 4;

    /// The part of the sphere, 0 to 1, that has any of these flags.
    pub fn share(&self, flags: Flag) -> f64 {
        let width = self.size.width();
        let row = |(row, line): (usize, &[Flag])| {
            line.iter().filter(|flag| **flag & flags != 0).count() as f64 * self.size.solid_angle(row)
        };
        self.flags.chunks_exact(width).enumerate().map(row).sum::<f64>() / (4.0 * std::f64::consts::PI)
    }

    /// Writes OpenEXR with the `latlong` attribute: `R G B`, `variance`, `coverage` and `flags`.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written; what stood there then stays.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut channels = SmallVec::new();
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            let plane = self.radiance.iter().map(|pixel| pixel[c]).collect();
            channels.push(AnyChannel::new(name, FlatSamples::F32(plane)));
        }
        if !self.variance.is_empty() {
            channels.push(AnyChannel::new("variance", FlatSamples::F32(self.variance.clone())));
        }
        let numbers = |numbers: &mut dyn Iterator<Item = u32>| FlatSamples::U32(numbers.collect());
        if !self.coverage.is_empty() {
            channels.push(AnyChannel::new("coverage", numbers(&mut self.coverage.iter().map(|&n| n.into()))));
        }
        if !self.flags.is_empty() {
            channels.push(AnyChannel::new("flags", numbers(&mut self.flags.iter().map(|&n| n.into()))));
        }
        let comments = "Radiance from every direction (linear RGB), y up: the map's centre is +z, +x is a quarter to its left. A pixel's \
             centre lies half a pixel inside the map's border. flags: 1 a lower bound (saturated), 2 never seen, 4 never seen and filled; \
             variance is that of G, taken for all three at their mean, infinite where nothing was measured; coverage counts photographs.";
        let mut attributes = LayerAttributes {
            software_name: Some(SOFTWARE.into()),
            comments: Some(comments.into()),
            environment_map: Some(Projection::LatitudeLongitude),
            ..Default::default()
        };
        attributes.other.insert(MARK.into(), AttributeValue::I32(1));
        attributes.other.insert(UNIT.into(), AttributeValue::Text(self.unit.name().into()));
        if !self.curve.is_empty() {
            let knots: Vec<String> = self.curve.iter().map(|value| format!("{value:.6}")).collect();
            attributes.other.insert(CURVE.into(), AttributeValue::Text(knots.join(",").as_str().into()));
        }
        let size = (self.size.width(), self.size.height());
        let layer = Layer::new(size, attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(channels));
        write_layer(path, layer)
    }

    /// Reads a latitude-longitude map: Rigel's, or any OpenEXR or Radiance HDR picture twice as wide as high.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] where it is no such picture or holds a negative or infinite pixel.
    pub fn read(path: &Path) -> Result<Self> {
        let Pixels { size: (width, height), radiance, variance, coverage, flags, unit, curve } = read(path)?;
        let size = LatLong::new(width, height).map_err(|error| error.about(path))?;
        let wrong =
            radiance.iter().position(|pixel| !pixel.iter().all(|value| value.is_finite() && *value >= 0.0));
        if let Some(at) = wrong {
            let what = format!(
                "holds {:?} at column {}, row {}",
                radiance[at],
                at % size.width(),
                at / size.width()
            );
            return Err(Error::input(path, what, "give a map of radiance, which is finite and not negative"));
        }
        Ok(Self { size, radiance, variance, coverage, flags, unit, curve })
    }

    /// The radiance from a direction of any length, linear between pixels; how much of it was seen (0 to 1); and what is special
    /// about the pixels around.
    pub fn toward(&self, direction: DVec3) -> ([f64; 3], f64, Flag) {
        let at = self.size.pixel(direction);
        let (low, part) = (at.floor(), at - at.floor());
        let (width, height) = (self.size.width() as i64, self.size.height() as i64);
        let (mut sum, mut all, mut flags) = ([0.0; 3], 0.0, 0);
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (column, row) = (low.x as i64 + i, low.y as i64 + j);
            // Beyond a pole the map goes on at the other side.
            let over = if (0..height).contains(&row) { 0 } else { width / 2 };
            let row = if row < 0 { -1 - row } else { row.min(2 * height - 1 - row) };
            let pixel = (row * width + (column + over).rem_euclid(width)) as usize;
            let share = |part: f64, step: i64| if step == 1 { part } else { 1.0 - part };
            let weight = share(part.x, i) * share(part.y, j);
            let flag = self.flags.get(pixel).copied().unwrap_or(0);
            if flag & Self::UNSEEN == 0 && weight > 0.0 {
                (0..3).for_each(|c| sum[c] += weight * f64::from(self.radiance[pixel][c]));
                all += weight;
                flags |= flag;
            }
        }
        (sum.map(|sum| if all > 0.0 { sum / all } else { 0.0 }), all, flags)
    }

    /// Writes its [`tone_mapped`] levels as PNG, at most `most` pixels wide.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written.
    pub fn write_png(&self, path: &Path, most: u32) -> Result<()> {
        let (width, height) = (self.size.width() as u32, self.size.height() as u32);
        let picture = image::RgbImage::from_raw(width, height, tone_mapped(&self.radiance))
            .ok_or_else(|| Error::request("a map without pixels", "make it again"))?;
        let by = width.div_ceil(most).max(1);
        let small =
            image::imageops::resize(&picture, width / by, height / by, image::imageops::FilterType::Triangle);
        let mut bytes = std::io::Cursor::new(vec![]);
        let written = if by > 1 {
            small.write_to(&mut bytes, image::ImageFormat::Png)
        } else {
            picture.write_to(&mut bytes, image::ImageFormat::Png)
        };
        written.map_err(|error| Error::io("write", path)(std::io::Error::other(error.to_string())))?;
        file::write_bytes(path, &bytes.into_inner())
    }
}

/// Writes a square picture of radiance as OpenEXR: `R G B` and `flags`.
pub(crate) fn write_exr(
    path: &Path,
    side: usize,
    (radiance, flags): (&[[f32; 3]], &[Flag]),
    comments: &str,
) -> Result<()> {
    let mut channels = SmallVec::new();
    for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
        let plane = radiance.iter().map(|pixel| pixel[c]).collect();
        channels.push(AnyChannel::new(name, FlatSamples::F32(plane)));
    }
    let flags = flags.iter().map(|&flag| flag.into()).collect();
    channels.push(AnyChannel::new("flags", FlatSamples::U32(flags)));
    let attributes = LayerAttributes {
        software_name: Some(SOFTWARE.into()),
        comments: Some(comments.into()),
        ..Default::default()
    };
    write_layer(
        path,
        Layer::new((side, side), attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(channels)),
    )
}

fn write_layer(path: &Path, layer: Layer<AnyChannels<FlatSamples>>) -> Result<()> {
    file::write_beside(path, |temporary| {
        Image::from_layer(layer).write().to_file(temporary).map_err(|error| match error {
            exr::error::Error::Io(source) => Error::io("write", path)(source),
            other => Error::io("write", path)(std::io::Error::other(other.to_string())),
        })
    })
}

/// Radiance as sRGB levels, half grey for its median, for a look.
pub(crate) fn tone_mapped(radiance: &[[f32; 3]]) -> Vec<u8> {
    let mut brightness: Vec<f32> =
        radiance.iter().map(|p| (p[0] + p[1] + p[2]) / 3.0).filter(|b| *b > 0.0).step_by(17).collect();
    brightness.sort_by(f32::total_cmp);
    let median = brightness.get(brightness.len() / 2).copied().unwrap_or(1.0);
    let gamma = 0.25 / median;
    let level = |value: f32| {
        let y = 1.0 - (-gamma * value).exp();
        let encoded = if y <= 0.0031308 { 12.92 * y } else { 1.055 * y.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded).round() as u8
    };
    radiance.iter().flat_map(|pixel| pixel.map(level)).collect()
}

struct Pixels {
    size: (u32, u32),
    radiance: Vec<[f32; 3]>,
    variance: Vec<f32>,
    coverage: Vec<u16>,
    flags: Vec<Flag>,
    unit: Unit,
    curve: Vec<f64>,
}

fn read(path: &Path) -> Result<Pixels> {
    let remedy = "give a complete OpenEXR or Radiance HDR map";
    let start = std::fs::read(path).map_err(Error::io("read", path))?;
    if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        use exr::prelude::{ReadChannels, ReadLayers};
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(std::io::Cursor::new(&start))
            .map_err(|error| Error::input(path, format!("cannot be read as OpenEXR ({error})"), remedy))?;
        let layer = image.layer_data;
        let plane = |name: &str| layer.channel_data.list.iter().find(|channel| channel.name.eq(name));
        let mut radiance = vec![[0.0; 3]; layer.size.area()];
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            let channel = plane(name)
                .ok_or_else(|| Error::input(path, format!("the channel {name} is missing"), remedy))?;
            radiance
                .iter_mut()
                .zip(channel.sample_data.values_as_f32())
                .for_each(|(pixel, value)| pixel[c] = value);
        }
        // Another program's channel of such a name says something else.
        let own = layer.attributes.other.contains_key(&exr::meta::attribute::Text::from(MARK));
        let unit = match layer.attributes.other.get(&exr::meta::attribute::Text::from(UNIT)) {
            Some(AttributeValue::Text(name)) if own => Unit::named(&name.to_string()),
            _ => Unit::Unknown,
        };
        let curve = match layer.attributes.other.get(&exr::meta::attribute::Text::from(CURVE)) {
            Some(AttributeValue::Text(knots)) if own => {
                let knots: std::result::Result<Vec<f64>, _> =
                    knots.to_string().split(',').map(str::parse::<f64>).collect();
                let is_usable = |knots: &Vec<f64>| {
                    knots.len() == KNOTS && knots.iter().all(|knot| knot.abs() < MOST_BENT)
                };
                knots.ok().filter(is_usable).ok_or_else(|| {
                    Error::input(
                        path,
                        format!("its attribute {CURVE} is no list of {KNOTS} small numbers"),
                        remedy,
                    )
                })?
            }
            _ => vec![],
        };
        let values = |name: &str| {
            let channel = plane(name).filter(|_| own);
            channel.map_or_else(Vec::new, |channel| channel.sample_data.values_as_f32().collect())
        };
        return Ok(Pixels {
            size: (layer.size.width() as u32, layer.size.height() as u32),
            radiance,
            variance: values("variance"),
            coverage: values("coverage").into_iter().map(|value| value as u16).collect(),
            flags: values("flags").into_iter().map(|value| value as Flag).collect(),
            unit,
            curve,
        });
    }
    let picture = Picture::read(path)?;
    if picture.white != Picture::FLOAT_WHITE {
        return Err(Error::input(path, "is a picture of levels, not of radiance", remedy));
    }
    let number = |bits: u16| half::f16::from_bits(bits).to_f32();
    Ok(Pixels {
        size: (picture.width, picture.height),
        radiance: picture.levels.iter().map(|pixel| pixel.map(number)).collect(),
        variance: vec![],
        coverage: vec![],
        flags: vec![],
        unit: Unit::Unknown,
        curve: vec![],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_no_camera_has_is_refused_by_the_map_s_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.exr");
        let with = |curve: Vec<f64>| {
            let map = EnvironmentMap {
                size: LatLong::new(4, 2).unwrap(),
                radiance: vec![[1.0; 3]; 8],
                variance: vec![],
                coverage: vec![],
                flags: vec![],
                unit: Unit::Unknown,
                curve,
            };
            map.write(&path).unwrap();
            EnvironmentMap::read(&path).map(|read| read.curve)
        };
        for curve in [vec![], vec![0.25; KNOTS]] {
            assert_eq!(with(curve.clone()).unwrap(), curve);
        }
        for curve in [vec![0.0; 3], vec![1e300; KNOTS], vec![f64::NAN; KNOTS]] {
            let error = with(curve).unwrap_err().to_string();
            assert!(error.contains("map.exr") && error.contains("13 small numbers"), "{error}");
        }
    }
}

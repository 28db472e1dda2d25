//! A map of the radiance from every direction, and its OpenEXR file.

use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, SmallVec, WritableImage,
    attribute::{AttributeValue, EnvironmentMap as Projection},
};

use crate::geometry::LatLong;
use crate::picture::Picture;
use crate::{Error, Result, file};

/// What is special about a pixel; 0 is nothing.
pub type Flag = u8;

/// Radiance from every direction.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentMap {
    /// Its size.
    pub size: LatLong,
    /// Linear red, green and blue; 0 where nothing was seen.
    pub radiance: Vec<[f32; 3]>,
    /// The variance of their mean; infinite where nothing was measured. Empty for a map of another program.
    pub variance: Vec<f32>,
    /// How many photographs show a pixel. Empty for a map of another program.
    pub coverage: Vec<u16>,
    /// [`Self::LOWER_BOUND`], [`Self::UNSEEN`] or [`Self::FILLED`]. Empty for a map of another program.
    pub flags: Vec<Flag>,
}

impl EnvironmentMap {
    /// Every photograph that shows the pixel was saturated there: the largest of what they say.
    pub const LOWER_BOUND: Flag = 1;
    /// No photograph shows the pixel.
    pub const UNSEEN: Flag = 2;
    /// No photograph shows it, and it was filled from what is around.
    pub const FILLED: Flag = 4;

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
             variance is that of the mean of R, G and B, infinite where nothing was measured; coverage counts photographs.";
        let mut attributes = LayerAttributes {
            software_name: Some(concat!("rigel ", env!("CARGO_PKG_VERSION")).into()),
            comments: Some(comments.into()),
            environment_map: Some(Projection::LatitudeLongitude),
            ..Default::default()
        };
        attributes.other.insert("rigelEnvironment".into(), AttributeValue::I32(1));
        let size = (self.size.width(), self.size.height());
        let layer = Layer::new(size, attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(channels));
        file::write_beside(path, |temporary| {
            Image::from_layer(layer).write().to_file(temporary).map_err(|error| match error {
                exr::error::Error::Io(source) => Error::io("write", path)(source),
                other => Error::io("write", path)(std::io::Error::other(other.to_string())),
            })
        })
    }

    /// Reads a latitude-longitude map: Rigel's, or any OpenEXR or Radiance HDR picture twice as wide as high.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] where it is no such picture or holds a negative or infinite pixel.
    pub fn read(path: &Path) -> Result<Self> {
        let (width, height, radiance, flags) = read(path)?;
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
        Ok(Self { size, radiance, variance: vec![], coverage: vec![], flags })
    }

    /// The picture as sRGB levels, half grey for its median, for a look.
    pub fn tone_mapped(&self) -> Vec<u8> {
        let mut brightness: Vec<f32> = self
            .radiance
            .iter()
            .map(|p| (p[0] + p[1] + p[2]) / 3.0)
            .filter(|b| *b > 0.0)
            .step_by(17)
            .collect();
        brightness.sort_by(f32::total_cmp);
        let median = brightness.get(brightness.len() / 2).copied().unwrap_or(1.0);
        let gamma = 0.25 / median;
        let level = |value: f32| {
            let y = 1.0 - (-gamma * value).exp();
            let encoded = if y <= 0.0031308 { 12.92 * y } else { 1.055 * y.powf(1.0 / 2.4) - 0.055 };
            (255.0 * encoded).round() as u8
        };
        self.radiance.iter().flat_map(|pixel| pixel.map(level)).collect()
    }

    /// Writes [`Self::tone_mapped`] as PNG, at most `most` pixels wide.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written.
    pub fn write_png(&self, path: &Path, most: u32) -> Result<()> {
        let (width, height) = (self.size.width() as u32, self.size.height() as u32);
        let picture = image::RgbImage::from_raw(width, height, self.tone_mapped())
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

type Pixels = (u32, u32, Vec<[f32; 3]>, Vec<Flag>);

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
        let flags = plane("flags").map_or_else(Vec::new, |channel| {
            channel.sample_data.values_as_f32().map(|value| value as Flag).collect()
        });
        return Ok((layer.size.width() as u32, layer.size.height() as u32, radiance, flags));
    }
    let picture = Picture::read(path)?;
    if picture.white != Picture::FLOAT_WHITE {
        return Err(Error::input(path, "is a picture of levels, not of radiance", remedy));
    }
    let number = |bits: u16| half::f16::from_bits(bits).to_f32();
    Ok((
        picture.width,
        picture.height,
        picture.levels.iter().map(|pixel| pixel.map(number)).collect(),
        vec![],
    ))
}

//! Radiance in OpenEXR: channels `R G B`, `variance.R variance.G variance.B` and `mask`, which any EXR viewer opens.

use std::path::Path;

use exr::meta::MetaData;
use exr::meta::header::Header;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
    LineOrder, SmallVec, WritableImage, attribute::AttributeValue, read_all_flat_layers_from_file,
};

use super::{Mask, RadianceImage};
use crate::{Error, Result, file};

/// The attribute that tells Rigel's radiance from other pictures, and its version.
const KIND: &str = "rigelRadiance";
const VERSION: i32 = 1;
const COLOURS: [&str; 3] = ["R", "G", "B"];
const VARIANCES: [&str; 3] = ["variance.R", "variance.G", "variance.B"];
/// Noise hardly compresses: ZIP saves a third of the bytes for more work than all else that a view costs, run lengths a
/// seventh, the mask, for a sixth of it. Lines in order, so that a file's bytes are always the same.
const ENCODING: Encoding = Encoding {
    compression: Compression::Uncompressed,
    blocks: Blocks::ScanLines,
    line_order: LineOrder::Increasing,
};

impl RadianceImage {
    /// Writes the view as OpenEXR: 32-bit floats, the mask as unsigned integers, uncompressed.
    /// `response` says in words which response fixed the unit, and is kept as an attribute.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written; what stood there before then stays.
    pub fn write_exr(&self, path: &Path, response: &str) -> Result<()> {
        let plane = |pixels: &[[f32; 3]], c: usize| FlatSamples::F32(pixels.iter().map(|p| p[c]).collect());
        let mut channels = SmallVec::new();
        for c in 0..3 {
            channels.push(AnyChannel::new(COLOURS[c], plane(&self.radiance, c)));
            channels.push(AnyChannel::new(VARIANCES[c], plane(&self.variance, c)));
        }
        let mask = FlatSamples::U32(self.mask.iter().map(|&m| u32::from(m)).collect());
        channels.push(AnyChannel::new("mask", mask));

        let software_name = Some(concat!("rigel ", env!("CARGO_PKG_VERSION")).into());
        let mut attributes = LayerAttributes { software_name, ..Default::default() };
        let unit = "what makes the response's exposure 1 in one second (its middle level, or a number 1); variance in its square";
        for (name, value) in [
            (KIND, AttributeValue::I32(VERSION)),
            ("rigelUnit", AttributeValue::Text(unit.into())),
            ("rigelResponse", AttributeValue::Text(response.into())),
            (
                "rigelMask",
                AttributeValue::Text(
                    "1 saturated (lower bound), 2 dark (upper bound), 4 moved (infinite variance: unknown)"
                        .into(),
                ),
            ),
        ] {
            attributes.other.insert(name.into(), value);
        }
        let size = (self.width as usize, self.height as usize);
        let layer = Layer::new(size, attributes, ENCODING, AnyChannels::sort(channels));
        file::write_beside(path, |temporary| {
            // The views are written side by side already.
            Image::from_layer(layer).write().non_parallel().to_file(temporary).map_err(|e| match e {
                exr::error::Error::Io(source) => Error::io("write", path)(source),
                other => Error::io("write", path)(std::io::Error::other(other.to_string())),
            })
        })
    }

    /// Whether a file says that it is Rigel's radiance, be it damaged or newer.
    pub(crate) fn is_at(path: &Path) -> bool {
        let names_itself =
            |header: &Header| header.own_attributes.other.iter().any(|(name, _)| name.eq(KIND));
        MetaData::read_from_file(path, false).is_ok_and(|data| data.headers.iter().any(names_itself))
    }

    /// Reads what [`RadianceImage::write_exr`] wrote, bit by bit the same.
    ///
    /// # Errors
    /// [`Error::Io`] where the file is not there; [`Error::Input`] where it is damaged or another kind of EXR.
    pub fn read_exr(path: &Path) -> Result<Self> {
        let remedy = "give a radiance file that `rigel radiance` wrote, or make it again";
        let image = read_all_flat_layers_from_file(path).map_err(|e| match e {
            exr::error::Error::Io(source) if source.kind() != std::io::ErrorKind::UnexpectedEof => {
                Error::io("read", path)(source)
            }
            other => Error::input(path, format!("cannot be read as OpenEXR ({other})"), remedy),
        })?;
        let layer = image.layer_data.into_iter().next();
        let mut layer = layer.ok_or_else(|| Error::input(path, "it has no layer", remedy))?;
        match layer.attributes.other.get(KIND.as_bytes()) {
            Some(AttributeValue::I32(VERSION)) => {}
            Some(other) => {
                let what = format!("its version of radiance is {other:?}, this program reads {VERSION}");
                return Err(Error::input(path, what, "use the program that wrote it, or make it again"));
            }
            None => return Err(Error::input(path, "an OpenEXR file, but not Rigel's radiance", remedy)),
        }
        let channels = &mut layer.channel_data.list;
        // Taken out one by one: a picture of many megapixels is not held twice.
        let mut samples = |name: &str| {
            let at = channels.iter().position(|channel| channel.name.eq(name));
            at.map(|at| channels.remove(at).sample_data)
                .ok_or_else(|| Error::input(path, format!("the channel {name} is missing"), remedy))
        };
        let area = layer.size.area();
        let mask = samples("mask")?.values_as_f32().map(|m| m as Mask).collect();
        let mut planes = |names: [&str; 3]| -> Result<Vec<[f32; 3]>> {
            let mut pixels = vec![[0.0; 3]; area];
            for (c, name) in names.into_iter().enumerate() {
                let FlatSamples::F32(plane) = samples(name)? else {
                    return Err(Error::input(
                        path,
                        format!("the channel {name} is not 32-bit float"),
                        remedy,
                    ));
                };
                pixels.iter_mut().zip(plane).for_each(|(pixel, value)| pixel[c] = value);
            }
            Ok(pixels)
        };
        let (width, height) = (layer.size.width() as u32, layer.size.height() as u32);
        Ok(Self { width, height, radiance: planes(COLOURS)?, variance: planes(VARIANCES)?, mask })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> RadianceImage {
        let value = |i: usize, c: usize| 1.1f32.powi(i as i32 - 300) * (c + 1) as f32;
        let pixels = |scale: f32| (0..37 * 19).map(|i| [0, 1, 2].map(|c| scale * value(i, c))).collect();
        let mut image = RadianceImage {
            width: 37,
            height: 19,
            radiance: pixels(1.0),
            variance: pixels(1e-3),
            mask: vec![0; 37 * 19],
        };
        image.mask[40] = RadianceImage::SATURATED | RadianceImage::DARK;
        image.variance[40] = [f32::INFINITY, 1e-30, 0.0];
        image
    }

    #[test]
    fn a_written_view_reads_back_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        image().write_exr(&path, "response.csv").unwrap();
        assert_eq!(RadianceImage::read_exr(&path).unwrap(), image());
        // Any reader of OpenEXR sees an RGB picture.
        let picture = crate::picture::Picture::read(&path).unwrap();
        assert_eq!((picture.width, picture.height), (37, 19));
    }

    #[test]
    fn what_is_not_rigels_radiance_is_refused_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        exr::prelude::write_rgb_file(&path, 4, 4, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
        let message = RadianceImage::read_exr(&path).unwrap_err().to_string();
        assert!(message.contains("view.exr") && message.contains("not Rigel's radiance"), "{message}");
        image().write_exr(&path, "srgb").unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for kept in [0, 10, 400, bytes.len() - 100] {
            std::fs::write(&path, &bytes[..kept]).unwrap();
            let error = RadianceImage::read_exr(&path).unwrap_err();
            assert!(matches!(error, Error::Input { .. }), "{kept}: {error}");
        }
        let missing = RadianceImage::read_exr(&folder.path().join("none.exr")).unwrap_err();
        assert!(missing.to_string().contains("check the path"));
    }
}

//! Photographs as the camera wrote them: levels, before any meaning is given to them.

use std::path::{Path, PathBuf};

use ::image::{DynamicImage, ImageReader};
use half::f16;

use crate::{Error, Result};

/// One photograph's levels, row by row from the top-left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The file it was read from, to name it in messages; empty for a picture made in memory.
    pub path: PathBuf,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Red, green and blue levels, `width * height` of them, 0 to `white`.
    pub levels: Vec<[u16; 3]>,
    /// The highest level: 255 or 65535, or [`Picture::FLOAT_WHITE`] where the levels are the bits of half floats.
    pub white: u16,
}

impl Picture {
    /// The highest level of a picture of floating-point numbers: the bits of the largest finite half float. The bits of
    /// positive half floats are ordered as the numbers are, so they serve as levels with 11 significant bits over
    /// 9 decades, and [`Response::linear`](crate::radiance::Response::linear) turns them back into numbers.
    pub const FLOAT_WHITE: u16 = 0x7bff;

    /// Reads a JPEG, PNG, TIFF, Radiance HDR (either signature) or OpenEXR picture. Levels are taken as they stand: EXIF orientation and
    /// colour profiles are ignored, since lens and response belong to the sensor. Grey pictures get three equal channels.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be read, [`Error::Input`] where it is not a picture or is cut short.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut bytes = std::fs::read(path).map_err(Error::io("read", path))?;
        if bytes.starts_with(b"#?RGBE") {
            // The other signature of Radiance pictures, which the decoder does not know.
            bytes.splice(2..6, *b"RADIANCE");
        }
        if bytes.starts_with(&[0xff, 0xd8]) && !jpeg_is_complete(&bytes) {
            // The decoder would fill what is missing with grey.
            return Err(Error::input(path, "the photograph is cut short", "copy it from the camera again"));
        }
        if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            return read_exr(path, &bytes);
        }
        let decoded = ImageReader::new(std::io::Cursor::new(&bytes))
            .with_guessed_format()
            .map_err(Error::io("read", path))?
            .decode()
            .map_err(|e| {
                let remedy = "give a complete JPEG, PNG, TIFF, HDR or EXR photograph";
                Error::input(path, format!("cannot be decoded as a picture ({e})"), remedy)
            })?;
        let (width, height) = (decoded.width(), decoded.height());
        let (levels, white) = match decoded {
            DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_) => {
                (decoded.into_rgb32f().pixels().map(|p| p.0.map(half_level)).collect(), Self::FLOAT_WHITE)
            }
            DynamicImage::ImageLuma8(_)
            | DynamicImage::ImageLumaA8(_)
            | DynamicImage::ImageRgb8(_)
            | DynamicImage::ImageRgba8(_) => {
                (decoded.into_rgb8().pixels().map(|p| p.0.map(u16::from)).collect(), 255)
            }
            _ => (decoded.into_rgb16().pixels().map(|p| p.0).collect(), u16::MAX),
        };
        Ok(Self { path: path.into(), width, height, levels, white })
    }
}

fn half_level(value: f32) -> u16 {
    // A comparison, not `max`: what is not a number becomes 0, which every merge takes as too dark.
    if value > 0.0 { f16::from_f32(value).to_bits().min(Picture::FLOAT_WHITE) } else { 0 }
}

fn read_exr(path: &Path, bytes: &[u8]) -> Result<Picture> {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| (size.width(), vec![[0u16; 3]; size.area()]),
            |(width, levels): &mut (usize, Vec<[u16; 3]>), at, (r, g, b): (f32, f32, f32)| {
                levels[at.y() * *width + at.x()] = [r, g, b].map(half_level);
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(std::io::Cursor::new(bytes))
        .map_err(|e| {
            let what = format!("cannot be decoded as an OpenEXR picture ({e})");
            Error::input(path, what, "give a complete OpenEXR file with channels R, G and B")
        })?;
    let size = image.layer_data.size;
    let (width, height) = (size.width() as u32, size.height() as u32);
    let levels = image.layer_data.channel_data.pixels.1;
    Ok(Picture { path: path.into(), width, height, levels, white: Picture::FLOAT_WHITE })
}

/// Whether the scan of a JPEG file is followed by its end marker; a thumbnail's own end marker does not count.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    let mut at = 2;
    while let Some(&[marker, kind, high, low]) = bytes.get(at..at + 4) {
        if marker != 0xff {
            return false;
        }
        if kind == 0xda {
            return bytes[at..].windows(2).any(|pair| pair == [0xff, 0xd9]);
        }
        // A marker may be preceded by fill bytes.
        at += if kind == 0xff { 1 } else { 2 + usize::from(u16::from_be_bytes([high, low])) };
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient() -> ::image::RgbImage {
        ::image::RgbImage::from_fn(40, 30, |x, y| ::image::Rgb([x as u8, y as u8, (x * y % 251) as u8]))
    }

    #[test]
    fn lossless_pictures_keep_their_levels() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.tiff"] {
            let path = folder.path().join(name);
            gradient().save(&path).unwrap();
            let picture = Picture::read(&path).unwrap();
            assert_eq!((picture.width, picture.height, picture.white), (40, 30, 255));
            assert_eq!(picture.levels[12 * 40 + 7], [7, 12, 84]);
        }
        let path = folder.path().join("deep.png");
        let deep =
            ::image::ImageBuffer::from_fn(3, 2, |x, _| ::image::Rgb([x as u16 * 20000, 513u16, 65535]));
        DynamicImage::ImageRgb16(deep).save(&path).unwrap();
        let picture = Picture::read(&path).unwrap();
        assert_eq!((picture.white, picture.levels[2]), (65535, [40000, 513, 65535]));
    }

    #[test]
    fn float_pictures_keep_eleven_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let value = |x: usize, y: usize| 1e-3 * 1.37f32.powi((x + 5 * y) as i32);
        exr::prelude::write_rgb_file(&path, 8, 6, |x, y| (value(x, y), 2.0 * value(x, y), -1.0f32)).unwrap();
        let picture = Picture::read(&path).unwrap();
        for y in 0..6 {
            for x in 0..8 {
                let level = picture.levels[y * 8 + x];
                assert!((f16::from_bits(level[0]).to_f32() / value(x, y) - 1.0).abs() < 5e-4);
                assert_eq!(level[2], 0);
            }
        }
    }

    #[test]
    fn radiance_pictures_are_read_under_both_signatures() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdr");
        let value = |x: u32, y: u32| 1e-3 * 1.5f32.powi((x + 3 * y) as i32);
        let image =
            ::image::Rgb32FImage::from_fn(12, 5, |x, y| ::image::Rgb([value(x, y), 0.0, value(x, y)]));
        image.save(&path).unwrap();
        let picture = Picture::read(&path).unwrap();
        assert_eq!((picture.width, picture.height, picture.white), (12, 5, Picture::FLOAT_WHITE));
        for y in 0..5 {
            for x in 0..12 {
                let [r, g, _] = picture.levels[(y * 12 + x) as usize];
                assert!((f16::from_bits(r).to_f32() / value(x, y) - 1.0).abs() < 0.01 && g == 0);
            }
        }
        let bytes = std::fs::read(&path).unwrap();
        let signature = b"#?RADIANCE";
        assert!(bytes.starts_with(signature));
        std::fs::write(&path, [b"#?RGBE", &bytes[signature.len()..]].concat()).unwrap();
        assert_eq!(Picture::read(&path).unwrap(), picture);
    }

    #[test]
    fn what_is_no_complete_picture_is_named_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.jpg", "a.png", "a.tiff"] {
            let path = folder.path().join(name);
            gradient().save(&path).unwrap();
            Picture::read(&path).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            for kept in [0, 3, 100, bytes.len() * 2 / 3] {
                std::fs::write(&path, &bytes[..kept]).unwrap();
                let message = Picture::read(&path).unwrap_err().to_string();
                assert!(message.contains(name) && message.contains("; "), "{kept}: {message}");
            }
        }
        let missing = Picture::read(folder.path().join("none.jpg")).unwrap_err().to_string();
        assert!(missing.contains("none.jpg") && missing.contains("check the path"));
    }
}

//! Levels as files.

use std::path::Path;
use std::time::SystemTime;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rigel::camera::exif;
use rigel::file::write_bytes;
use rigel::{Error, Result};

use super::Options;
use super::sensor::response;

/// A file's extension and content.
pub(super) fn encode(options: &Options, levels: &[u8], exif: Vec<u8>) -> Result<(&'static str, Vec<u8>)> {
    let (width, height) = (options.lens.width, options.lens.height);
    let mut bytes = Vec::new();
    let written = match options.jpeg_quality {
        Some(quality) => {
            encode_with(JpegEncoder::new_with_quality(&mut bytes, quality), exif, levels, width, height)
        }
        None => encode_with(PngEncoder::new(&mut bytes), exif, levels, width, height),
    };
    written.map_err(|error| {
        Error::request(
            format!("a picture of {width}x{height} pixels cannot be encoded ({error})"),
            "choose another picture size",
        )
    })?;
    Ok((if options.jpeg_quality.is_some() { ".jpg" } else { ".png" }, bytes))
}

/// A number for the photograph of that stem: FNV-1a of its file's name.
pub(super) fn number_of(stem: &Path) -> u64 {
    let name = stem.file_name().unwrap_or_default().as_encoded_bytes();
    name.iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}

/// Writes a small JPEG photograph of a grey wedge as a camera does that is released by a contact: with its exposure time and
/// when the exposure began, by the camera's clock, in its EXIF block.
///
/// # Errors
/// [`Error::Io`] when it cannot be written.
pub fn write_photograph(path: &Path, exposure_s: f64, at: SystemTime) -> Result<()> {
    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 48;
    let level = |x: u32| response(f64::from(x + 1) / f64::from(WIDTH) * exposure_s).round() as u8;
    let levels: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(|pixel| [level(pixel % WIDTH); 3]).collect();
    let mut bytes = vec![];
    let exif = exif::block(exposure_s, Some(at));
    encode_with(JpegEncoder::new_with_quality(&mut bytes, 95), exif, &levels, WIDTH, HEIGHT)
        .map_err(|error| Error::request(format!("cannot be encoded ({error})"), "report this").about(path))?;
    write_bytes(path, &bytes)
}

fn encode_with(
    mut encoder: impl ImageEncoder,
    exif: Vec<u8>,
    levels: &[u8],
    width: u32,
    height: u32,
) -> image::ImageResult<()> {
    encoder.set_exif_metadata(exif).map_err(image::ImageError::Unsupported)?;
    encoder.write_image(levels, width, height, ExtendedColorType::Rgb8)
}

//! What a photograph's EXIF block says of its exposure, and the smallest block that says it.

use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use exif::{DateTime, Field, In, Rational, Reader, Tag, Value};

use crate::calendar::{civil, days};
use crate::{Error, Result};

/// Focal lengths that differ by less, relative, are the same.
const SAME_ZOOM: f64 = 1e-3;

/// What a photograph says of its exposure; `None` for what it does not say.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Exif {
    /// The exposure time as it stands there, seconds: whoever uses it checks that it is a positive number.
    pub exposure_s: Option<f64>,
    /// The sensitivity (ISO 12232).
    pub iso: Option<f64>,
    /// The f-number.
    pub f_number: Option<f64>,
    /// When the exposure began.
    pub taken: Option<CameraTime>,
    /// The focal length, millimetres.
    pub focal_length_mm: Option<f64>,
}

/// A moment by a camera's clock, which knows no time zone and is right to a minute or so.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraTime {
    /// Since 1970 as the camera's clock shows it, seconds.
    pub clock_s: f64,
    /// The clock's smallest step, seconds: the moment is up to so much later.
    pub step_s: f64,
}

/// Reads a photograph's EXIF block. A file without one says nothing.
///
/// # Errors
/// [`Error::Io`] when the file cannot be opened.
pub fn read(path: &Path) -> Result<Exif> {
    let file = std::fs::File::open(path).map_err(Error::io("read", path))?;
    let Ok(block) = Reader::new().read_from_container(&mut BufReader::new(file)) else {
        return Ok(Exif::default());
    };
    let number = |tag| match block.get_field(tag, In::PRIMARY).map(|field| &field.value) {
        Some(Value::Rational(numbers)) => numbers.first().map(Rational::to_f64),
        _ => None,
    };
    let exposure_s = number(Tag::ExposureTime);
    // A lens that does not tell says 0, or 0/0.
    let told = |number: &f64| number.is_finite() && *number > 0.0;
    let f_number = number(Tag::FNumber).filter(told);
    let focal_length_mm = number(Tag::FocalLength).filter(told);
    let iso = block.get_field(Tag::PhotographicSensitivity, In::PRIMARY);
    let iso = iso.and_then(|field| field.value.get_uint(0)).map(f64::from).filter(told);
    let taken = block.get_field(Tag::DateTimeOriginal, In::PRIMARY).and_then(text).and_then(|date| {
        let fraction = block.get_field(Tag::SubSecTimeOriginal, In::PRIMARY).and_then(text);
        camera_time(date, fraction.unwrap_or_default())
    });
    Ok(Exif { exposure_s, iso, f_number, taken, focal_length_mm })
}

/// The first of a lens's photographs that tells a focal length: a zoom that was touched makes every lens and vignetting wrong,
/// so the others must tell the same, as far as they tell it.
#[derive(Debug, Default)]
pub struct OneFocalLength(Option<(PathBuf, f64)>);

impl OneFocalLength {
    /// Takes another photograph and what it tells.
    ///
    /// # Errors
    /// [`Error::Input`] naming it where it was taken at another focal length.
    pub fn admit(&mut self, path: &Path, length_mm: Option<f64>) -> Result<()> {
        let Some(length_mm) = length_mm else { return Ok(()) };
        let (first, before_mm) = self.0.get_or_insert_with(|| (path.to_owned(), length_mm));
        if (length_mm / *before_mm - 1.0).abs() <= SAME_ZOOM {
            return Ok(());
        }
        let what = format!("was taken at {length_mm:.1} mm, but {} at {before_mm:.1} mm", first.display());
        Err(Error::input(path, what, "use photographs of one focal length, and do not zoom"))
    }
}

/// An EXIF block that tells an exposure time and, if known, when the exposure began, in UTC to a millisecond.
pub fn block(exposure_s: f64, at: Option<SystemTime>) -> Vec<u8> {
    let [ascii, long, rational] = [2, 4, 5];
    const MICRO: f64 = 1e6;
    let date = at.map(|at| {
        let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
        let (days, second) = ((since.as_secs() / 86_400) as i64, since.as_secs() % 86_400);
        let (year, month, day) = civil(days);
        let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
        let date = format!("{year:04}:{month:02}:{day:02} {hour:02}:{minute:02}:{second:02}\0");
        (date.into_bytes(), format!("{:03}\0", since.subsec_millis()).into_bytes())
    });
    let entry = |tag: u16, kind: u16, count: u32, value: [u8; 4]| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value].concat()
    };
    let directory = |entries: &[Vec<u8>]| {
        [(entries.len() as u16).to_le_bytes().to_vec(), entries.concat(), vec![0; 4]].concat()
    };
    // The header and a directory whose only entry points to the EXIF directory, which follows.
    let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
    bytes.extend(directory(&[entry(0x8769, long, 1, 26u32.to_le_bytes())]));
    let entries = if date.is_some() { 3 } else { 1 };
    let values = bytes.len() as u32 + 2 + entries * 12 + 4;
    let mut list = vec![entry(0x829a, rational, 1, values.to_le_bytes())];
    if let Some((date, fraction)) = &date {
        list.push(entry(0x9003, ascii, date.len() as u32, (values + 8).to_le_bytes()));
        list.push(entry(0x9291, ascii, 4, [fraction[0], fraction[1], fraction[2], fraction[3]]));
    }
    bytes.extend(directory(&list));
    bytes.extend(((exposure_s * MICRO).round() as u32).to_le_bytes());
    bytes.extend((MICRO as u32).to_le_bytes());
    bytes.extend(date.map(|(date, _)| date).unwrap_or_default());
    bytes
}

fn text(field: &Field) -> Option<&[u8]> {
    match &field.value {
        Value::Ascii(texts) => texts.first().map(Vec::as_slice),
        _ => None,
    }
}

fn camera_time(date: &[u8], fraction: &[u8]) -> Option<CameraTime> {
    let date = DateTime::from_ascii(date).ok()?;
    if !(1..=12).contains(&date.month) {
        return None;
    }
    let days = days(i64::from(date.year), i64::from(date.month), i64::from(date.day));
    let whole =
        days * 86_400 + i64::from(date.hour) * 3600 + i64::from(date.minute) * 60 + i64::from(date.second);
    let digits: String =
        fraction.iter().map(|&byte| char::from(byte)).take_while(char::is_ascii_digit).take(9).collect();
    let step_s = 10f64.powi(-(digits.len() as i32));
    let fraction_s = digits.parse().unwrap_or(0.0) * step_s;
    Some(CameraTime { clock_s: whole as f64 + fraction_s, step_s })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn write(exposure_s: f64, at: Option<SystemTime>) -> tempfile::NamedTempFile {
        use image::ImageEncoder;
        let file = tempfile::Builder::new().suffix(".jpg").tempfile().unwrap();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(file.as_file());
        encoder.set_exif_metadata(block(exposure_s, at)).unwrap();
        encoder.write_image(&[7; 12], 2, 2, image::ExtendedColorType::Rgb8).unwrap();
        file
    }

    #[test]
    fn what_is_written_is_read() {
        for (seconds, millis) in [(0, 0), (951_782_399, 999), (1_709_164_800, 1), (4_102_444_799, 250)] {
            let at = UNIX_EPOCH + Duration::from_millis(seconds * 1000 + millis);
            for exposure_s in [1e-5, 0.012_34, 1.0 / 8.0, 30.0, 900.0] {
                let exif = read(write(exposure_s, Some(at)).path()).unwrap();
                assert!((exif.exposure_s.unwrap() - exposure_s).abs() < 1e-9);
                let taken = exif.taken.unwrap();
                assert!(
                    (taken.clock_s - (seconds as f64 + millis as f64 / 1000.0)).abs() < 1e-6,
                    "{taken:?}"
                );
                assert!((taken.step_s - 1e-3).abs() < 1e-12);
            }
        }
        assert_eq!(read(write(0.5, None).path()).unwrap(), Exif { exposure_s: Some(0.5), ..Exif::default() });
    }

    #[test]
    fn the_focal_length_the_f_number_and_the_sensitivity_are_read_where_they_are_told() {
        use exif::experimental::Writer;
        for (length, expected) in [((500, 10), Some(50.0)), ((0, 1), None), ((0, 0), None)] {
            let value = Value::Rational(vec![Rational { num: length.0, denom: length.1 }]);
            let field = |tag| Field { tag, ifd_num: In::PRIMARY, value: value.clone() };
            let iso = Value::Short(vec![length.0 as u16 / 10]);
            let iso = Field { tag: Tag::PhotographicSensitivity, ifd_num: In::PRIMARY, value: iso };
            let fields = [field(Tag::FocalLength), field(Tag::FNumber), iso];
            let mut writer = Writer::new();
            fields.iter().for_each(|field| writer.push_field(field));
            let mut block = std::io::Cursor::new(vec![]);
            writer.write(&mut block, true).unwrap();
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), block.into_inner()).unwrap();
            let told = read(file.path()).unwrap();
            assert_eq!([told.focal_length_mm, told.f_number, told.iso], [expected; 3]);
        }
    }

    #[test]
    fn a_zoom_is_noticed_although_the_first_photograph_does_not_tell() {
        let mut focal = OneFocalLength::default();
        focal.admit(Path::new("1.jpg"), None).unwrap();
        focal.admit(Path::new("2.jpg"), Some(24.0)).unwrap();
        focal.admit(Path::new("3.jpg"), None).unwrap();
        let message = focal.admit(Path::new("4.jpg"), Some(50.0)).unwrap_err().to_string();
        assert!(
            ["4.jpg", "50.0 mm", "2.jpg", "24.0 mm"].iter().all(|name| message.contains(name)),
            "{message}"
        );
    }

    #[test]
    fn a_clock_without_fractions_says_so_and_a_blank_one_says_nothing() {
        let time = |date: &str, fraction: &str| camera_time(date.as_bytes(), fraction.as_bytes());
        assert_eq!(time("1970:01:02 00:00:01", ""), Some(CameraTime { clock_s: 86_401.0, step_s: 1.0 }));
        assert_eq!(time("1970:01:01 00:00:00", "25 "), Some(CameraTime { clock_s: 0.25, step_s: 0.01 }));
        assert_eq!(time("0000:00:00 00:00:00", ""), None);
        assert_eq!(time("    :  :     :  :  ", ""), None);
        assert_eq!(read(tempfile::NamedTempFile::new().unwrap().path()).unwrap(), Exif::default());
        assert!(read(Path::new("/nonexistent.jpg")).unwrap_err().to_string().contains("nonexistent"));
    }
}

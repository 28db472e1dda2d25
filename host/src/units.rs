//! Lengths and sizes as people write them: `200mm`, `512x512`.

use serde::{Deserialize, Deserializer, Serializer};

use glam::{DQuat, DVec2};

use crate::geometry::{BoardSize, Surface, Texels};
use crate::{Error, Result};

/// Reads a length with its unit (`900mm`, `20cm`, `0.9m`) in metres.
///
/// # Errors
/// [`Error::Request`] when the number or the unit is missing, or the length is not positive.
pub fn parse_length_m(text: &str) -> Result<f64> {
    let text = text.trim();
    let (number, metres) = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)]
        .into_iter()
        .find_map(|(unit, metres)| text.strip_suffix(unit).map(|number| (number, metres)))
        .ok_or_else(|| {
            let unit = text.trim_start_matches(|c: char| !c.is_alphabetic());
            let what = match unit {
                "" => format!("the length '{text}' has no unit"),
                unit => format!("the length '{text}' has an unknown unit, '{unit}'"),
            };
            Error::request(what, "write it as 200mm, 20cm or 0.2m")
        })?;
    match number.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value * metres),
        _ => {
            Err(Error::request(format!("the length '{text}' is not a positive number"), "write it as 200mm"))
        }
    }
}

/// A square patch of a plane: `-75mm,37mm,20mm` is its centre (x right, y up) and its side, metres.
///
/// # Errors
/// [`Error::Request`] for anything else.
pub fn parse_patch(text: &str) -> Result<(DVec2, f64)> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, side] = parts[..] else {
        return Err(Error::request(
            format!("the patch '{text}' is not three lengths"),
            "write its centre and its side as -75mm,37mm,20mm",
        ));
    };
    let coordinate = |text: &str| match text.strip_prefix('-') {
        Some(rest) => parse_length_m(rest).map(|length_m| -length_m),
        None if text.trim_end_matches(|c: char| c.is_alphabetic()).trim().parse() == Ok(0.0) => Ok(0.0),
        None => parse_length_m(text),
    };
    Ok((DVec2::new(coordinate(x)?, coordinate(y)?), parse_length_m(side)?))
}

/// Reads a surface's extent, `200mmx150mm` or `200x150mm`: width, then height.
///
/// # Errors
/// [`Error::Request`] when it is not two lengths.
pub fn parse_surface(text: &str) -> Result<Surface> {
    let Some((width, height)) = text.split_once('x') else {
        return Err(Error::request(
            format!("the surface '{text}' is not two lengths"),
            "write it as 200mmx150mm",
        ));
    };
    let unit = height.trim_start_matches(|c: char| !c.is_alphabetic());
    let width = if width.ends_with('m') { width.to_owned() } else { format!("{width}{unit}") };
    Ok(Surface { width_m: parse_length_m(&width)?, height_m: parse_length_m(height)? })
}

/// Reads a rotation as its unit quaternion, `w,x,y,z`.
///
/// # Errors
/// [`Error::Request`] when it is not four numbers whose squares add up to 1 (to 2 %).
pub fn parse_quaternion(text: &str) -> Result<DQuat> {
    // What is no number makes the sum of squares none.
    let numbers: Vec<f64> = text.split(',').map(|part| part.trim().parse().unwrap_or(f64::NAN)).collect();
    match numbers[..] {
        [w, x, y, z] if ((w * w + x * x + y * y + z * z) - 1.0).abs() < 0.02 => {
            Ok(DQuat::from_xyzw(x, y, z, w).normalize())
        }
        _ => Err(Error::request(
            format!("'{text}' is not the quaternion of a rotation"),
            "write w,x,y,z, as 1,0,0,0 for no rotation at all",
        )),
    }
}

/// Reads a number of texels, `512x512`: columns, then rows.
///
/// # Errors
/// [`Error::Request`] when it is not two positive whole numbers, or more than 16384 on a side.
pub fn parse_texels(text: &str) -> Result<Texels> {
    columns_and_rows(text, "texels")
}

/// The same of a picture's pixels.
///
/// # Errors
/// Those of [`parse_texels`].
pub fn parse_pixels(text: &str) -> Result<Texels> {
    columns_and_rows(text, "pixels")
}

fn columns_and_rows(text: &str, of: &str) -> Result<Texels> {
    let parts =
        text.split_once('x').and_then(|(c, r)| Some((c.trim().parse().ok()?, r.trim().parse().ok()?)));
    match parts {
        Some((columns, rows)) if (1..=16384).contains(&columns) && (1..=16384).contains(&rows) => {
            Ok(Texels { columns, rows })
        }
        _ => Err(Error::request(
            format!("'{text}' is not a number of {of}"),
            "write columns and rows as 512x512, at most 16384 each",
        )),
    }
}

/// Reads a texel's column and row, `12,34`; the top-left one is 0,0.
///
/// # Errors
/// [`Error::Request`] when it is not two whole numbers.
pub fn parse_texel(text: &str) -> Result<(u32, u32)> {
    let parts =
        text.split_once(',').and_then(|(c, r)| Some((c.trim().parse().ok()?, r.trim().parse().ok()?)));
    parts.ok_or_else(|| {
        Error::request(
            format!("'{text}' is not a texel"),
            "write its column and row as 12,34; the top-left one is 0,0",
        )
    })
}

/// Reads a board's inner corners, `9x6`.
///
/// # Errors
/// [`Error::Request`] when it is not two whole numbers from 3 to 100.
pub fn parse_board(text: &str) -> Result<BoardSize> {
    let parts =
        text.split_once('x').and_then(|(c, r)| Some((c.trim().parse().ok()?, r.trim().parse().ok()?)));
    match parts {
        Some((columns, rows)) if (3..=100).contains(&columns) && (3..=100).contains(&rows) => {
            Ok(BoardSize { columns, rows })
        }
        _ => Err(Error::request(
            format!("'{text}' is not a board"),
            "write its inner corners (where four squares meet) as 9x6, from 3 to 100 each",
        )),
    }
}

/// Reads an angle in degrees, such as `-12.5`.
///
/// # Errors
/// [`Error::Request`] when it is not a finite number.
pub fn parse_degrees(text: &str) -> Result<f64> {
    match text.trim().parse::<f64>() {
        Ok(degrees) if degrees.is_finite() => Ok(degrees),
        _ => {
            Err(Error::request(format!("'{text}' is not an angle in degrees"), "write a number such as 12.5"))
        }
    }
}

/// Reads a part of something, above 0 and 1 at most: `1%`, `0.01`.
///
/// # Errors
/// [`Error::Request`] for anything else.
pub fn parse_part(text: &str) -> Result<f64> {
    let (number, unit) = text.strip_suffix('%').map_or((text, 1.0), |number| (number, 100.0));
    match number.trim().parse::<f64>() {
        Ok(number) if number > 0.0 && number <= unit => Ok(number / unit),
        _ => Err(Error::request(
            format!("'{text}' is not a part between nothing and all"),
            "give a percentage such as 2%, or 0.02; above 0% and up to 100%",
        )),
    }
}

/// Writes metres so that [`parse_length_m`] reads the same number: in millimetres where that is so, else in metres.
pub fn format_length(metres: f64) -> String {
    let millimetres = (metres * 1e6).round() / 1e3;
    if millimetres * 1e-3 == metres { format!("{millimetres}mm") } else { format!("{metres}m") }
}

/// Serde: a length in metres stands in files as text with its unit.
pub mod length {
    use super::*;

    /// Writes metres as text with a unit.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(metres: &f64, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.serialize_str(&format_length(*metres))
    }

    /// Reads text with a unit as metres.
    ///
    /// # Errors
    /// Those of the deserializer, or a length without unit.
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> std::result::Result<f64, D::Error> {
        let text = String::deserialize(deserializer)?;
        parse_length_m(&text).map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_in_a_unit_that_is_not_known_is_not_one_without() {
        assert!(parse_length_m("9in").unwrap_err().to_string().contains("unknown unit, 'in'"));
        assert!(parse_length_m("9").unwrap_err().to_string().contains("no unit"));
    }

    #[test]
    fn angles_are_numbers() {
        assert_eq!(parse_degrees("-12.5").unwrap(), -12.5);
        for bad in ["nan", "inf", "12deg", ""] {
            assert!(parse_degrees(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn lengths_carry_a_unit() {
        assert_eq!(parse_length_m("900mm").unwrap(), 0.9);
        assert_eq!(parse_length_m("0.9 m").unwrap(), 0.9);
        for bad in ["900", "mm", "-3mm", "nanm", ""] {
            assert!(parse_length_m(bad).is_err(), "{bad}");
        }
        assert_eq!((format_length(0.2).as_str(), format_length(0.15).as_str()), ("200mm", "150mm"));
        for metres in [0.9, 0.123_456, 0.123_456_789_012, 1e-9, 1e-300, 1.0 / 3.0, 1e306] {
            assert_eq!(parse_length_m(&format_length(metres)).unwrap(), metres);
        }
    }

    #[test]
    fn a_part_is_a_percentage_or_a_fraction() {
        assert_eq!((parse_part("1%").unwrap(), parse_part("99 %").unwrap()), (0.01, 0.99));
        assert_eq!((parse_part("0.01").unwrap(), parse_part("100%").unwrap()), (0.01, 1.0));
        for bad in ["0", "0%", "-1%", "101%", "1.5", "%", "nan", "inf%", ""] {
            assert!(parse_part(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_surface_is_width_by_height() {
        for text in ["200mmx150mm", "200x150mm", "20cmx0.15m"] {
            let surface = parse_surface(text).unwrap();
            assert!(
                (surface.width_m - 0.2).abs() < 1e-12 && (surface.height_m - 0.15).abs() < 1e-12,
                "{text}"
            );
        }
        assert!(parse_surface("200mm").is_err());
    }

    #[test]
    fn a_board_has_two_sides() {
        assert_eq!(parse_board("9x6").unwrap(), BoardSize { columns: 9, rows: 6 });
        for bad in ["9", "9x", "2x6", "9x101", "-9x6", "9x6mm"] {
            assert!(parse_board(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_patch_is_a_place_and_a_side() {
        assert_eq!(parse_patch("-75mm, 37mm,2cm").unwrap(), (DVec2::new(-0.075, 0.037), 0.02));
        assert_eq!(parse_patch("0,0mm,20mm").unwrap(), (DVec2::ZERO, 0.02));
        for bad in ["", "1mm,2mm", "1mm,2mm,-3mm", "1,2mm,3mm", "--1mm,2mm,3mm", "1mm,2mm,3mm,4mm"] {
            assert!(parse_patch(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn texels_are_two_positive_numbers() {
        assert_eq!(parse_texels("512x256").unwrap(), Texels { columns: 512, rows: 256 });
        for bad in ["512", "0x3", "axb", "99999x1", "-1x2"] {
            assert!(parse_texels(bad).is_err(), "{bad}");
        }
    }
}

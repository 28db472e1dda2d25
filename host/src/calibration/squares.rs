//! Black squares on a bright ground in known places of the surface: what poses are measured from.

use std::path::Path;

use glam::DVec3;
use serde::Deserialize;

use crate::units::parse_length_m;
use crate::{Error, Result};

/// Where the squares are, in the surface's frame; their sides are parallel to its axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Squares {
    /// Side of each square, metres.
    pub size_m: f64,
    /// Width of the even ground that surrounds each, metres; what lies beyond is not looked at.
    pub ground_m: f64,
    /// Their centres on the plane z = 0, metres.
    pub centres_m: Vec<DVec3>,
}

/// What people are asked to write.
const REMEDY: &str =
    "write size = \"12mm\" and centres = [[\"-112mm\", \"-87mm\"], ...], in the surface's frame";

impl Squares {
    /// Reads a squares file: TOML with `size`, `centres` and, if it is not a quarter of the size, `ground`, the width of
    /// the even ground around each square.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be read; [`Error::Input`] where it is damaged, has no square, or squares overlap.
    pub fn read(path: &Path) -> Result<Self> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            size: String,
            ground: Option<String>,
            centres: Vec<[String; 2]>,
        }
        let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
        let file: File = toml::from_str(&text).map_err(|error| {
            Error::input(path, format!("is no list of squares ({})", error.message()), REMEDY)
        })?;
        let of_file = |error: Error| error.about(path);
        let size_m = parse_length_m(&file.size).map_err(of_file)?;
        let ground_m = file.ground.map_or(Ok(size_m / 4.0), |text| parse_length_m(&text)).map_err(of_file)?;
        let centres_m = file
            .centres
            .iter()
            .map(|[x, y]| Ok(DVec3::new(signed_m(x)?, signed_m(y)?, 0.0)))
            .collect::<Result<Vec<_>>>()
            .map_err(of_file)?;
        if centres_m.is_empty() {
            return Err(Error::input(path, "lists no square", REMEDY));
        }
        for (i, a) in centres_m.iter().enumerate() {
            if centres_m[..i].iter().any(|b| (*a - *b).abs().max_element() < size_m) {
                let what = format!("the square at {}, {} m overlaps another one", a.x, a.y);
                return Err(Error::input(path, what, "correct the centres or the size"));
            }
        }
        Ok(Self { size_m, ground_m, centres_m })
    }

    /// What such a layout tells less well than others; `None` where it is a good one.
    ///
    /// # Errors
    /// [`Error::Request`] where there are fewer than two squares.
    pub(super) fn weakness(&self) -> Result<Option<String>> {
        let [first, .., last] = self.centres_m[..] else {
            return Err(Error::request(
                "a single square tells no pose that could be checked",
                "put squares around the surface, four or more, and list them all",
            ));
        };
        let furthest = |from: DVec3| {
            let by_distance = |a: &&DVec3, b: &&DVec3| a.distance(from).total_cmp(&b.distance(from));
            self.centres_m.iter().max_by(by_distance).copied().unwrap_or(from)
        };
        let (a, b) = (furthest(first), furthest(last));
        let (from, to) = if a.distance(furthest(a)) > b.distance(furthest(b)) {
            (a, furthest(a))
        } else {
            (b, furthest(b))
        };
        let along = (to - from).normalize_or_zero();
        let off = |centre: &DVec3| (*centre - from).cross(along).length();
        let widest = self.centres_m.iter().map(off).fold(0.0, f64::max);
        Ok((widest < self.size_m).then(|| {
            "the squares lie in one line: turns about it are known from their own small size only; add a square beside the line"
                .into()
        }))
    }

    /// The corners of a square (an index of the centres) in the surface's frame, metres: counter-clockwise from the one with the
    /// smallest coordinates, grown by `by_m` on each side.
    pub fn corners_m(&self, square: usize, by_m: f64) -> [DVec3; 4] {
        let half = self.size_m / 2.0 + by_m;
        [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(x, y)| self.centres_m[square] + DVec3::new(x, y, 0.0))
    }
}

/// A coordinate: a length that may be negative or zero.
fn signed_m(text: &str) -> Result<f64> {
    let text = text.trim();
    let (sign, magnitude) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    let digits = magnitude.trim_end_matches(char::is_alphabetic).trim();
    match digits.parse::<f64>() {
        Ok(0.0) => Ok(0.0),
        _ => Ok(sign * parse_length_m(magnitude)?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Squares> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        Squares::read(file.path())
    }

    #[test]
    fn a_layout_is_read_in_any_unit() {
        let squares =
            read("size = \"12mm\"\ncentres = [[\"-112mm\", \"8.7cm\"], [\"0mm\", \"-0.1m\"]]").unwrap();
        assert_eq!(squares.size_m, 0.012);
        assert_eq!(squares.ground_m, 0.003);
        assert!((squares.centres_m[0] - DVec3::new(-0.112, 0.087, 0.0)).length() < 1e-12);
        assert!((squares.centres_m[1] - DVec3::new(0.0, -0.1, 0.0)).length() < 1e-12);
        let corners = squares.corners_m(1, 0.001);
        assert!((corners[2] - DVec3::new(0.007, -0.093, 0.0)).length() < 1e-12);
    }

    #[test]
    fn squares_in_a_line_and_single_ones_are_told() {
        let weakness =
            |places: &str| read(&format!("size = \"12mm\"\ncentres = [{places}]")).unwrap().weakness();
        let corners = r#"["-112mm", "-87mm"], ["112mm", "87mm"]"#;
        assert!(weakness(corners).unwrap().unwrap().contains("one line"));
        assert!(weakness(&format!("{corners}, [\"0mm\", \"5mm\"]")).unwrap().is_some());
        assert_eq!(weakness(&format!("{corners}, [\"0mm\", \"50mm\"]")).unwrap(), None);
        assert!(weakness(r#"["0mm", "0mm"]"#).unwrap_err().to_string().contains("single square"));
    }

    #[test]
    fn what_is_no_layout_is_refused_with_a_remedy() {
        for text in [
            "",
            "size = \"12mm\"\ncentres = []",
            "size = \"12\"\ncentres = [[\"1mm\", \"1mm\"]]",
            "size = \"12mm\"\ncentres = [[\"1\", \"1mm\"]]",
            "size = \"12mm\"\ncentres = [[\"--1mm\", \"1mm\"]]",
            "size = \"-12mm\"\ncentres = [[\"1mm\", \"1mm\"]]",
            "size = \"12mm\"\ncentres = [[\"0mm\", \"0mm\"], [\"11mm\", \"0mm\"]]",
        ] {
            let error = read(text).unwrap_err();
            assert!(matches!(error, Error::Input { .. }), "{text}: {error}");
        }
    }
}

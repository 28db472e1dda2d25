//! View directions from a table that people may write.

use std::path::Path;

use glam::DVec3;

use super::MOST_VIEWS;
use crate::geometry::unit_vector;
use crate::{Error, Result};

const COLUMNS: [&str; 2] = ["azimuth_deg", "zenith_deg"];

/// Views (unit vectors, surface frame) from a CSV with the columns `azimuth_deg` and `zenith_deg`, such as `rigel plan` writes; other
/// columns are passed over.
///
/// # Errors
/// [`Error::Input`] naming the column that is missing or the line that is no direction of the upper hemisphere, when there is no row
/// or there are more than 20 000, or when a direction comes twice; [`Error::Io`].
pub fn read_directions(path: &Path) -> Result<Vec<DVec3>> {
    let text = std::fs::read(path).map_err(Error::io("read", path))?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_slice());
    let strange = |what: String| {
        Error::input(
            path,
            what,
            format!("write comma-separated values with the header line {}", COLUMNS.join(",")),
        )
    };
    let damaged = |error: csv::Error| strange(format!("is not a table ({error})"));
    let headers = reader.headers().map_err(damaged)?.clone();
    let mut at = [0; 2];
    for (column, name) in at.iter_mut().zip(COLUMNS) {
        *column = headers
            .iter()
            .position(|header| header == name)
            .ok_or_else(|| strange(format!("has no column {name}")))?;
    }
    let mut found: Vec<DVec3> = vec![];
    for record in reader.records() {
        let record = record.map_err(damaged)?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column: usize, range: std::ops::RangeInclusive<f64>| {
            let text = &record[at[column]];
            text.parse::<f64>().ok().filter(|value| range.contains(value)).ok_or_else(|| {
                Error::input(
                    path,
                    format!("line {line}: {} is '{text}'", COLUMNS[column]),
                    format!("write degrees from {} to {}", range.start(), range.end()),
                )
            })
        };
        let (azimuth_deg, zenith_deg) = (number(0, -360.0..=360.0)?, number(1, 0.0..=90.0)?);
        let direction = unit_vector(azimuth_deg.to_radians(), zenith_deg.to_radians());
        if found.iter().any(|other| other.distance(direction) < 1e-6) {
            return Err(Error::input(
                path,
                format!(
                    "line {line}: azimuth {azimuth_deg}, zenith {zenith_deg} is the direction of another line"
                ),
                "remove one of them",
            ));
        }
        found.push(direction);
        if found.len() > MOST_VIEWS {
            return Err(Error::input(
                path,
                format!("has more than {MOST_VIEWS} rows"),
                "split it into several sessions",
            ));
        }
    }
    if found.is_empty() {
        return Err(Error::input(path, "has no row", "write one direction on each line"));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<DVec3>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("next.csv");
        std::fs::write(&path, text).unwrap();
        read_directions(&path)
    }

    #[test]
    fn directions_are_read_by_the_names_of_their_columns() {
        let found = read("order,zenith_deg, azimuth_deg\n1,30,90\n2,0,12\n3,90,-90\n").unwrap();
        let truth = [DVec3::new(0.0, 0.5, 0.75f64.sqrt()), DVec3::Z, DVec3::new(0.0, -1.0, 0.0)];
        assert!(found.iter().zip(truth).all(|(a, b)| a.distance(b) < 1e-12), "{found:?}");
    }

    #[test]
    fn what_is_no_direction_is_named_with_its_line() {
        for (text, says) in [
            ("", "azimuth_deg"),
            ("azimuth_deg\n3\n", "zenith_deg"),
            ("azimuth_deg,zenith_deg\n", "no row"),
            ("azimuth_deg,zenith_deg\n1,91\n", "line 2: zenith_deg is '91'"),
            ("azimuth_deg,zenith_deg\n1,2\nnan,2\n", "line 3: azimuth_deg is 'nan'"),
            ("azimuth_deg,zenith_deg\n1,2\n3\n", "not a table"),
            ("azimuth_deg,zenith_deg\n1,2\n361,2\n", "line 3: azimuth_deg is '361'"),
            ("azimuth_deg,zenith_deg\n350,2\n-10,2\n", "line 3"),
            ("azimuth_deg,zenith_deg\n1,0\n2,0\n", "line 3"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(says) && error.contains("next.csv"), "{text:?}: {error}");
        }
    }
}

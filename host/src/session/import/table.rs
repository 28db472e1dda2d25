//! A table of photographs: file, view, pan_deg, tilt_deg, exposure_s.

use std::collections::BTreeMap;
use std::path::Path;

use super::Found;
use crate::session::{Manifest, View};
use crate::{Error, Result};

const COLUMNS: [&str; 5] = ["file", "view", "pan_deg", "tilt_deg", "exposure_s"];

/// Reads the table; its files are relative to `photographs`.
pub(super) fn read(table: &Path, photographs: &Path) -> Result<(Manifest, Vec<Found>)> {
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_path(table)
        .map_err(|error| damaged(table, &error))?;
    let headers = reader.headers().map_err(|error| damaged(table, &error))?.clone();
    let mut at = [0; 5];
    for (column, name) in at.iter_mut().zip(COLUMNS) {
        *column = headers.iter().position(|header| header == name).ok_or_else(|| {
            Error::input(
                table,
                format!("has no column {name} (it has: {})", headers.iter().collect::<Vec<_>>().join(", ")),
                format!("name the columns {}", COLUMNS.join(",")),
            )
        })?;
    }
    let mut views: BTreeMap<u32, (f64, f64, Vec<f64>)> = BTreeMap::new();
    let mut rows = vec![];
    let mut files = BTreeMap::new();
    for record in reader.records() {
        let record = record.map_err(|error| damaged(table, &error))?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |column: usize| -> Result<f64> {
            record[at[column]].parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(|| {
                Error::input(
                    table,
                    format!("line {line}: {} is '{}'", COLUMNS[column], &record[at[column]]),
                    "write a number there",
                )
            })
        };
        let file = record[at[0]].to_owned();
        let number_of_view: u32 = record[at[1]].parse().map_err(|_| {
            Error::input(
                table,
                format!("line {line}: view is '{}'", &record[at[1]]),
                "number the views 0, 1, 2, ...",
            )
        })?;
        let (pan_deg, tilt_deg, exposure_s) = (number(2)?, number(3)?, number(4)?);
        if let Some(other) = files.insert(file.clone(), line) {
            return Err(Error::input(
                table,
                format!("{file} is on line {other} and on line {line}"),
                "remove one of them",
            ));
        }
        let (pan, tilt, times) = views.entry(number_of_view).or_insert((pan_deg, tilt_deg, vec![]));
        if (*pan, *tilt) != (pan_deg, tilt_deg) {
            return Err(Error::input(
                table,
                format!(
                    "line {line}: view {number_of_view} is repeated with pan {pan_deg} and tilt {tilt_deg} after {pan} and {tilt}"
                ),
                "give every direction a view number of its own",
            ));
        }
        if times.contains(&exposure_s) {
            return Err(Error::input(
                table,
                format!(
                    "line {line}: view {number_of_view} is repeated with the same exposure time, {exposure_s} s"
                ),
                "remove one of the two photographs or correct its view",
            ));
        }
        times.push(exposure_s);
        rows.push((file, number_of_view, exposure_s));
    }
    if rows.is_empty() {
        return Err(Error::input(table, "has no row", "list one photograph on each line"));
    }
    let index: BTreeMap<u32, usize> =
        views.keys().enumerate().map(|(index, &number)| (number, index)).collect();
    let found = rows
        .into_iter()
        .map(|(file, view, exposure_s)| Found {
            path: photographs.join(file),
            view: index[&view],
            exposure_s: Some(exposure_s),
        })
        .collect();
    let views = views
        .into_iter()
        .map(|(number, (pan, tilt, _))| View {
            name: format!("view{number:03}"),
            pan_deg: Some(pan),
            tilt_deg: Some(tilt),
            lens: 0,
            pose: None,
        })
        .collect();
    Ok((Manifest { views, ..Manifest::new("table") }, found))
}

fn damaged(table: &Path, error: &csv::Error) -> Error {
    match error.kind() {
        csv::ErrorKind::Io(source) => {
            Error::io("read", table)(std::io::Error::new(source.kind(), source.to_string()))
        }
        _ => Error::input(
            table,
            format!("is not a table ({error})"),
            "write comma-separated values with one header line",
        ),
    }
}

//! Raw figures of a sweep: what a chart was drawn from.

use std::fmt::Write as _;
use std::path::Path;

use rigel::{Result, file};

use crate::machine;

/// The values at which something is worse than `most`, in words; `points` are value and error, one that was refused is worse.
pub fn broken(points: &[(f64, f64)], most: f64, values: impl Iterator<Item = f64>) -> String {
    let is_good = |value: f64| points.iter().any(|(x, error)| *x == value && *error <= most);
    let states: Vec<(f64, bool)> = values.map(|value| (value, is_good(value))).collect();
    let last = states.last().map(|state| state.0);
    let runs = states.chunk_by(|a, b| a.1 == b.1).filter(|run| !run[0].1);
    let told = runs.map(|run| match (run[0].0, run[run.len() - 1].0) {
        (from, to) if from == states[0].0 && Some(to) == last => "everywhere".into(),
        (from, to) if from == states[0].0 => format!("up to {to}"),
        (from, to) if Some(to) == last => format!("from {from} on"),
        (from, to) if from == to => format!("at {from}"),
        (from, to) => format!("{from} to {to}"),
    });
    let told: Vec<String> = told.collect();
    if told.is_empty() { "nowhere".into() } else { told.join(", ") }
}

/// Rows of one sweep, written as CSV with the machine and the versions in front.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table with these columns.
    pub fn new(header: &[&'static str]) -> Self {
        Self { header: header.to_vec(), rows: vec![] }
    }

    /// Adds a row: as many cells as there are columns.
    pub fn row(&mut self, cells: Vec<String>) {
        assert_eq!(cells.len(), self.header.len(), "a row has a cell for each column");
        self.rows.push(cells);
    }

    /// Adds a row of something that was refused: what it was, no figures, and why.
    pub fn refused(&mut self, start: &[&str], why: String) {
        self.row(refused_row(self.header.len(), start, why));
    }

    /// The columns' names.
    pub fn header(&self) -> &[&'static str] {
        &self.header
    }

    /// The rows.
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    /// Writes it; lines that begin with # name the machine.
    ///
    /// # Errors
    /// [`rigel::Error::Io`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut text = String::new();
        for (name, value) in machine::facts() {
            let _ = writeln!(text, "# {name}: {value}");
        }
        let _ = writeln!(text, "{}", self.header.join(","));
        for row in &self.rows {
            let cells: Vec<String> = row.iter().map(|cell| cell.replace(',', ";")).collect();
            let _ = writeln!(text, "{}", cells.join(","));
        }
        file::write_bytes(path, text.as_bytes())
    }
}

/// [`Table::refused`]'s row for a table of so many columns.
pub fn refused_row(columns: usize, start: &[&str], why: String) -> Vec<String> {
    let mut row: Vec<String> = start.iter().map(|cell| (*cell).to_owned()).collect();
    row.resize(columns - 1, "-".into());
    row.push(why);
    row
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_break_is_every_value_where_the_error_is_high() {
        let values = [1.0, 2.0, 3.0, 4.0];
        let at = |errors: [f64; 4]| {
            let points: Vec<(f64, f64)> = values.into_iter().zip(errors).collect();
            broken(&points, 1.0, values.into_iter())
        };
        assert_eq!(at([0.1, 0.1, 0.1, 1.0]), "nowhere");
        assert_eq!(at([0.1, 9.0, 9.0, 9.0]), "from 2 on");
        assert_eq!(at([9.0, 0.1, 0.1, 0.1]), "up to 1");
        assert_eq!(at([9.0, 9.0, 0.1, f64::NAN]), "up to 2, from 4 on");
        assert_eq!(at([9.0; 4]), "everywhere");
        // Not hidden by a lucky value beyond.
        assert_eq!(at([0.1, 9.0, 9.0, 0.1]), "2 to 3");
        assert_eq!(at([0.1, 9.0, 0.1, 9.0]), "at 2, from 4 on");
        assert_eq!(broken(&[(3.0, 0.1)], 1.0, values.into_iter()), "up to 2, from 4 on");
    }
}

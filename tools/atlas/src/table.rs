//! Raw figures of a sweep: what a chart was drawn from.

use std::fmt::Write as _;
use std::path::Path;

use rigel::{Result, file};

use crate::machine;

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

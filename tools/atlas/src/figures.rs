//! What the rooms share: numbers of many, and figures on the page with their files beside it.

use std::path::Path;

use rigel::chart::{Drawn, Series};
use rigel::report::Report;
use rigel::{Result, file};

use crate::table::Table;

/// A chart on the page, and as a file of this name.
pub fn figure(folder: &Path, report: &mut Report, name: &str, svg: String, caption: &str) -> Result<()> {
    file::write_bytes(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
    report.chart(svg, caption);
    Ok(())
}

/// A table on the page, and as a file of this name.
pub fn table(folder: &Path, report: &mut Report, name: &str, table: &Table, caption: &str) -> Result<()> {
    // With spaces, so that the words of a column's name may stand below each other.
    let header: Vec<String> = table.header().iter().map(|name| name.replace('_', " ")).collect();
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    report.table(format!("{caption} Raw in {name}.csv."), &header, table.rows().to_vec());
    table.write(&folder.join(format!("{name}.csv")))
}

/// All figures of a sweep as a file of this name; the page has its charts.
pub fn raw(folder: &Path, report: &mut Report, name: &str, table: &Table) -> Result<()> {
    report.text(format!("All figures are in {name}.csv."));
    table.write(&folder.join(format!("{name}.csv")))
}

/// Marks and a line that belong together, under one name: what was measured and what was stated.
pub fn marks_and_line(name: &str, marks: Vec<(f64, f64)>, line: Vec<(f64, f64)>) -> [Series; 2] {
    [(marks, Drawn::Marks), (line, Drawn::Line)].map(|(points, drawn)| Series {
        name: name.to_owned(),
        points,
        drawn,
    })
}

/// The value that a share of the values does not exceed; not a number without values.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1) as f64;
    values.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
}

/// Root of the mean square; not a number without values.
pub fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    f64::sqrt(sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_many_numbers() {
        assert_eq!(quantile(&mut [3.0, 1.0, 2.0], 0.5), 2.0);
        assert_eq!(quantile(&mut [3.0, 1.0, 2.0], 1.0), 3.0);
        assert!(quantile(&mut [], 0.5).is_nan() && rms([]).is_nan());
        assert_eq!(rms([1.0, 7.0]), 5.0);
    }
}

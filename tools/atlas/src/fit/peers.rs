//! What other programs do with the same texels: the tables that they are given, and what they say.

use std::fmt::Write as _;
use std::path::Path;

use glam::Vec3;
use rigel::fit::{FitOptions, Model, Selector};
use rigel::{Error, Result, file};

use super::{Done, fresh, mixture, observe_all, views};
use crate::fit::texels::Doubt;

/// Writes the texels of the charts into `folder`: `views.csv` and `fresh.csv` (directions), `measured.csv` (red, green, blue and their
/// standard deviation, view by view for each texel), `truth.csv` (radiance toward the fresh directions, texel by texel) and
/// `floor.csv` (what is added to a radiance before an error is divided by it).
///
/// # Errors
/// [`Error::Io`] where a file cannot be written.
pub fn hand_over(folder: &Path) -> Result<()> {
    let (truths, toward, fresh) = (mixture(), views(), fresh());
    let observed = observe_all(&truths, &toward, &Doubt::USUAL);
    let floor =
        Selector::new(&[Model::Constant], &FitOptions::default(), 0.0, &observed, &|| Ok(()))?.floor();
    let write = |name: &str, header: &str, rows: &mut dyn Iterator<Item = Vec<f32>>| {
        let mut text = format!("{header}\n");
        for row in rows {
            let cells: Vec<String> = row.iter().map(f32::to_string).collect();
            let _ = writeln!(text, "{}", cells.join(","));
        }
        file::write_bytes(&folder.join(name), text.as_bytes())
    };
    let directions = |all: &[Vec3]| all.iter().map(|d| d.to_array().to_vec()).collect::<Vec<_>>();
    write("views.csv", "x,y,z", &mut directions(&toward).into_iter())?;
    write("fresh.csv", "x,y,z", &mut directions(&fresh).into_iter())?;
    let rows = observed.iter().flat_map(|texel| {
        texel.radiance.iter().zip(&texel.sigma).map(|(rgb, sigma)| [rgb.as_slice(), &[*sigma]].concat())
    });
    write("measured.csv", "r,g,b,sigma", &mut rows.into_iter())?;
    let rows = truths.iter().flat_map(|truth| fresh.iter().map(|d| truth.radiance(*d).to_array().to_vec()));
    write("truth.csv", "r,g,b", &mut rows.into_iter())?;
    write("floor.csv", "floor", &mut std::iter::once(vec![floor as f32]))
}

/// What other programs did with the texels of the charts: names, and what each did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Peers(pub(super) Vec<(String, Done)>);

impl Peers {
    /// The rows of a `fit_peers.csv` of `tools/peers/texels.py`.
    ///
    /// # Errors
    /// [`Error::Io`] where it cannot be read, [`Error::Input`] where it is no such table.
    pub fn read(path: &Path) -> Result<Self> {
        rows(path).map(Self)
    }
}

fn rows(path: &Path) -> Result<Vec<(String, Done)>> {
    let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
    let wrong = |line: usize| {
        Error::input(
            path,
            format!(
                "line {line} is not a row of name, microseconds, mean and 95th percentile of the error in percent, bytes"
            ),
            "make it with tools/peers/texels.py",
        )
    };
    let rows = text.lines().enumerate().filter(|(_, line)| !line.starts_with('#')).skip(1);
    let rows = rows.map(|(i, line)| {
        let (name, numbers) = line.split_once(',').ok_or_else(|| wrong(i + 1))?;
        let numbers: Vec<f64> = numbers.split(',').map_while(|cell| cell.trim().parse().ok()).collect();
        let &[cpu_us, mean, p95, bytes] = numbers.as_slice() else { return Err(wrong(i + 1)) };
        if !numbers.iter().all(|number| *number > 0.0 && number.is_finite()) {
            return Err(wrong(i + 1));
        }
        Ok((name.to_owned(), Done { cpu_s: 1e-6 * cpu_us, error: mean / 100.0, p95: p95 / 100.0, bytes }))
    });
    let rows: Vec<_> = rows.collect::<Result<_>>()?;
    if rows.is_empty() { Err(wrong(1)) } else { Ok(rows) }
}

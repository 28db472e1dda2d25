//! The file of a calibrated lens.

use std::path::Path;

use serde::Serialize;

use super::{FittedCorner, LENS_NAMES, LensCalibration, LensCovariance};
use crate::file::write_bytes;
use crate::{Error, Result};

#[derive(Serialize)]
struct LensToml<'a> {
    width: u32,
    height: u32,
    #[serde(flatten)]
    numbers: toml::Table,
    model: &'a str,
    rms_px: f64,
    excess: f64,
    boards_used: usize,
    verdict: &'a str,
    covariance: LensCovariance,
    sigma: toml::Table,
    boards: Vec<BoardToml>,
    dropped: Vec<DroppedToml<'a>>,
}

#[derive(Serialize)]
struct BoardToml {
    file: String,
    corners: usize,
    outliers: usize,
    rms_px: f64,
    tilt_deg: f64,
}

#[derive(Serialize)]
struct DroppedToml<'a> {
    file: String,
    reason: &'a str,
}

impl LensCalibration {
    /// The lens and all that is known of it as TOML, which [`crate::view_file::Calibration`] reads: OpenCV's names, then the model, the errors, the
    /// verdict, `covariance` (in the order fx fy cx cy k1 k2 p1 p2 k3), `sigma` and the boards.
    ///
    /// # Errors
    /// [`Error::Request`] when a number is none that TOML can hold.
    pub fn to_toml(&self) -> Result<String> {
        let table = |values: &[f64]| {
            LENS_NAMES.iter().zip(values).map(|(name, value)| ((*name).to_owned(), (*value).into())).collect()
        };
        let boards = self
            .boards
            .iter()
            .map(|board| BoardToml {
                file: board.path.display().to_string(),
                corners: board.corners.len(),
                outliers: board.corners.iter().filter(|corner| !corner.used).count(),
                rms_px: board.rms_px,
                tilt_deg: board.tilt_rad.to_degrees(),
            })
            .collect();
        let file = LensToml {
            width: self.lens.width,
            height: self.lens.height,
            numbers: table(&self.lens.numbers()),
            model: self.model.name(),
            rms_px: self.rms_px,
            excess: self.excess,
            boards_used: self.boards.len(),
            verdict: &self.verdict,
            covariance: self.covariance,
            sigma: table(&self.sigmas()),
            boards,
            dropped: self
                .dropped
                .iter()
                .map(|board| DroppedToml { file: board.path.display().to_string(), reason: &board.reason })
                .collect(),
        };
        toml::to_string(&file).map_err(|error| {
            Error::request(format!("the lens cannot be written ({error})"), "photograph more boards")
        })
    }

    /// Every corner with its residual as CSV: `file,column,row,x_px,y_px,dx_px,dy_px,used`.
    pub fn residuals_csv(&self) -> String {
        let mut table = csv::Writer::from_writer(vec![]);
        let header = ["file", "column", "row", "x_px", "y_px", "dx_px", "dy_px", "used"].map(String::from);
        let rows = self.boards.iter().flat_map(|board| {
            let name = board.path.file_name().unwrap_or_default().to_string_lossy();
            board.corners.iter().map(move |FittedCorner { corner, residual, used }| {
                let [x, y, dx, dy] =
                    [corner.pixel.x, corner.pixel.y, residual.x, residual.y].map(|px| format!("{px:.4}"));
                let (column, row) = (corner.column.to_string(), corner.row.to_string());
                [name.to_string(), column, row, x, y, dx, dy, used.to_string()]
            })
        });
        for row in std::iter::once(header).chain(rows) {
            table.write_record(row).expect("rows of one length go into memory");
        }
        let bytes = table.into_inner().expect("memory takes all that is written");
        String::from_utf8(bytes).expect("text was written")
    }

    /// Writes [`Self::to_toml`].
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_bytes(path, self.to_toml()?.as_bytes())
    }
}

//! From photographs of a chessboard to a lens: `calibrate`.

use std::path::Path;

use rigel::Result;
use rigel::calibration::lens::LENS_NAMES;
use rigel::calibration::{LensCalibration, LensModel, calibrate_photographs};
use rigel::chart::{Arrow, field};
use rigel::file::write_together;

use crate::arguments::Calibrate;
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::{require_extension, require_place};

/// How much longer than they are residuals are drawn; columns and rows of the uncertainty.
const MAGNIFIED: f64 = 100.0;
const CELLS: (usize, usize) = (32, 24);

/// `rigel calibrate`.
pub fn calibrate(arguments: &Calibrate) -> Result<()> {
    let bar = Bar::new("searching");
    require_extension(&arguments.out, "toml")?;
    require_place(&arguments.out, arguments.force)?;
    if let Some(folder) = arguments.residuals.as_ref().filter(|folder| !folder.is_dir()) {
        require_place(folder, false)?;
    }
    let model = match arguments.model.as_str() {
        "auto" => None,
        name => Some(LensModel::parse(name)?),
    };
    let calibration =
        calibrate_photographs(&arguments.photographs, arguments.board, arguments.square_m, model, &bar)?;
    tell(&calibration);
    calibration.write(&arguments.out)?;
    say!("wrote {}: {}", arguments.out.display(), calibration.verdict);
    if let Some(folder) = &arguments.residuals {
        write_residuals(&calibration, folder)?;
        say!("wrote {}: residuals.csv, residuals.svg and sigma.svg", folder.display());
    }
    Ok(())
}

fn tell(calibration: &LensCalibration) {
    for board in &calibration.dropped {
        say!("{}: not used: {}", board.path.display(), board.reason);
    }
    for board in &calibration.boards {
        let outliers = board.corners.iter().filter(|corner| !corner.used);
        let names: Vec<String> =
            outliers.map(|c| format!("column {} row {}", c.corner.column, c.corner.row)).collect();
        if !names.is_empty() {
            say!("{}: left out as far off: {}", board.path.display(), names.join(", "));
        }
        if let Some(doubt) = calibration.doubt_about(board) {
            say!("{}: {doubt}", board.path.display());
        }
    }
    let numbers = calibration.lens.numbers();
    let sigmas = calibration.sigmas().into_iter().zip(calibration.model.estimated());
    for ((name, number), (sigma, estimated)) in LENS_NAMES.iter().zip(numbers).zip(sigmas) {
        match estimated {
            true => say!("{name:>4} {number:>12.5} ± {sigma:.5}"),
            false => say!("{name:>4} {number:>12.5} fixed"),
        }
    }
    say!(
        "model {}; {} boards; RMS {:.3} px",
        calibration.model.name(),
        calibration.boards.len(),
        calibration.rms_px
    );
}

fn write_residuals(calibration: &LensCalibration, folder: &Path) -> Result<()> {
    let arrows: Vec<Arrow> = calibration
        .boards
        .iter()
        .flat_map(|board| &board.corners)
        .map(|fitted| Arrow {
            at: fitted.corner.pixel.into(),
            by: fitted.residual.into(),
            strong: fitted.used,
        })
        .collect();
    let size = (calibration.lens.width, calibration.lens.height);
    let caption = format!("residuals, {MAGNIFIED} times as long; RMS {:.3} px", calibration.rms_px);
    let residuals = field(size, &arrows, MAGNIFIED, (&[], (0, 0)), &caption);
    let sigmas = calibration.projection_sigmas_px(CELLS.0, CELLS.1);
    let (least, most) = sigmas.iter().fold((f64::MAX, 0f64), |(a, b), s| (a.min(*s), b.max(*s)));
    let caption =
        format!("standard deviation of the projection: {least:.3} px (light) to {most:.3} px (dark)");
    let dots: Vec<Arrow> = arrows.iter().map(|arrow| Arrow { by: (0.0, 0.0), ..*arrow }).collect();
    let sigma = field(size, &dots, 1.0, (&sigmas, CELLS), &caption);
    let files =
        [("residuals.csv", calibration.residuals_csv()), ("residuals.svg", residuals), ("sigma.svg", sigma)];
    let files: Vec<(String, Vec<u8>)> =
        files.into_iter().map(|(name, text)| (name.into(), text.into_bytes())).collect();
    write_together(folder, &files)
}

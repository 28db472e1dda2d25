//! COLMAP's cameras.txt (colmap.github.io/format.html): lenses by number. Its pixel centres are at 0.5.

use std::collections::BTreeMap;
use std::path::Path;

use crate::geometry::Lens;
use crate::{Error, Result};

/// Reads the cameras of a text model.
///
/// # Errors
/// [`Error::Input`] when the file is damaged or has a camera whose model is none of ours.
pub(crate) fn read_cameras(path: &Path) -> Result<BTreeMap<u32, Lens>> {
    let text = std::fs::read_to_string(path).map_err(Error::io("read", path))?;
    let mut cameras = BTreeMap::new();
    for (index, line) in data_lines(&text).filter(|(_, line)| !line.trim().is_empty()) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let wrong = |what: &str| {
            Error::input(
                path,
                format!("line {index}: {what}"),
                "export the model again with COLMAP (as text)",
            )
        };
        let [id, model, width, height, parameters @ ..] = &words[..] else {
            return Err(wrong("is cut short"));
        };
        let numbers: Option<Vec<f64>> = parameters.iter().map(|word| finite(word)).collect();
        let (Ok(id), Ok(width), Ok(height), Some(numbers)) =
            (id.parse(), width.parse(), height.parse(), numbers)
        else {
            return Err(wrong("a number cannot be read"));
        };
        let zero = Lens { width, height, ..Lens::pinhole(1, 1, 1.0) };
        let lens = match (*model, &numbers[..]) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => Lens { fx: f, fy: f, cx, cy, ..zero },
            ("PINHOLE", &[fx, fy, cx, cy]) => Lens { fx, fy, cx, cy, ..zero },
            ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => Lens { fx: f, fy: f, cx, cy, k1, ..zero },
            ("RADIAL", &[f, cx, cy, k1, k2]) => Lens { fx: f, fy: f, cx, cy, k1, k2, ..zero },
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => Lens { fx, fy, cx, cy, k1, k2, p1, p2, ..zero },
            _ => {
                return Err(Error::input(
                    path,
                    format!(
                        "line {index}: the camera model {model} with {} parameters is not supported",
                        numbers.len()
                    ),
                    "reconstruct with SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV",
                ));
            }
        };
        if !(lens.fx > 0.0 && lens.fy > 0.0 && width > 0 && height > 0) {
            return Err(wrong("the focal length and size must be positive"));
        }
        cameras.insert(id, Lens { cx: lens.cx - 0.5, cy: lens.cy - 0.5, ..lens });
    }
    Ok(cameras)
}

/// A finite number.
pub(crate) fn finite(word: &str) -> Option<f64> {
    word.parse().ok().filter(|number: &f64| number.is_finite())
}

/// Numbered lines, from 1, without comments.
pub(crate) fn data_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(index, line)| (index + 1, line)).filter(|(_, line)| !line.starts_with('#'))
}

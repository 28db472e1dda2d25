//! A lens as OpenCV's `FileStorage` writes it, YAML or XML: `camera_matrix`, `distortion_coefficients` and, as its samples write them,
//! `image_width` and `image_height`. The few fields that are wanted are searched for by name; the rest of the file may be anything.

use std::path::Path;

use super::LensFile;
use crate::{Error, Result};

/// What the samples and ROS call the matrix of focal lengths and principal point, and the distortion.
const MATRIX: [&str; 3] = ["camera_matrix", "Camera_Matrix", "cameraMatrix"];
const DISTORTION: [&str; 3] = ["distortion_coefficients", "Distortion_Coefficients", "distCoeffs"];

/// Whether a text is such a file.
pub(super) fn is_storage(text: &str) -> bool {
    let text = text.trim_start();
    ["%YAML", "<?xml", "<opencv_storage"].iter().any(|start| text.starts_with(start))
}

/// Reads the lens.
pub(super) fn read(path: &Path, text: &str) -> Result<LensFile> {
    let remedy = "write camera_matrix and distortion_coefficients with OpenCV's FileStorage";
    let wrong = |what: &str| Error::input(path, what, remedy);
    let matrix = numbers_of(text, &MATRIX).ok_or_else(|| wrong("has no camera_matrix of numbers"))?;
    let &[fx, skew, cx, _, fy, cy, ..] = &matrix[..] else {
        return Err(wrong("has a camera_matrix of fewer than nine numbers"));
    };
    if matrix.len() != 9 || skew != 0.0 {
        return Err(wrong("has a camera_matrix that is not 3 x 3 without skew"));
    }
    let distortion =
        numbers_of(text, &DISTORTION).ok_or_else(|| wrong("has no distortion_coefficients of numbers"))?;
    if let Some(beyond) = distortion.iter().skip(5).position(|number| *number != 0.0) {
        return Err(Error::input(
            path,
            format!(
                "has {} distortion_coefficients, and number {} is not zero",
                distortion.len(),
                beyond + 6
            ),
            "calibrate with k1 k2 p1 p2 k3 only",
        ));
    }
    let term = |k: usize| distortion.get(k).copied().unwrap_or(0.0);
    let pixels = |names: [&str; 2]| names.iter().find_map(|name| scalar(text, name));
    Ok(LensFile {
        f: None,
        fx: Some(fx),
        fy: Some(fy),
        cx,
        cy,
        k1: term(0),
        k2: term(1),
        p1: term(2),
        p2: term(3),
        k3: term(4),
        width: pixels(["image_width", "image_Width"]),
        height: pixels(["image_height", "image_Height"]),
    })
}

/// What follows the key or tag of a name.
fn after<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.match_indices(name).find_map(|(at, _)| {
        let before = text[..at].chars().next_back();
        let rest = &text[at + name.len()..];
        let begins = before.is_none_or(|sign| sign.is_whitespace() || sign == '<');
        (begins && rest.starts_with([':', '>', ' '])).then_some(rest)
    })
}

/// The numbers of a matrix: those of `data` behind its name.
fn numbers_of(text: &str, names: &[&str]) -> Option<Vec<f64>> {
    let matrix = names.iter().find_map(|name| after(text, name))?;
    let data = after(matrix, "data")?.trim_start_matches([':', '>', ' ', '[', '\n', '\r']);
    let end = data.find([']', '<'])?;
    let words = data[..end].split(|sign: char| sign.is_whitespace() || sign == ',');
    words.filter(|word| !word.is_empty()).map(|word| word.parse().ok()).collect()
}

fn scalar(text: &str, name: &str) -> Option<u32> {
    let rest = after(text, name)?.trim_start_matches([':', '>', ' ']);
    rest[..rest.find(|sign: char| !sign.is_ascii_digit())?].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const YAML: &str = "%YAML 1.2\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 536.07000000000005, 0., 342.37, 0., 536.01999999999998,\n       235.53999999999999, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ -0.26500000000000001, -0.046699999999999998, 0.00183,\n       -0.00031, 0.252 ]\n";
    const XML: &str = "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>640</image_width>\n<image_height>480</image_height>\n<camera_matrix type_id=\"opencv-matrix\">\n  <rows>3</rows>\n  <cols>3</cols>\n  <dt>d</dt>\n  <data>\n    536.07000000000005 0. 342.37 0. 536.01999999999998\n    235.53999999999999 0. 0. 1.</data></camera_matrix>\n<distortion_coefficients type_id=\"opencv-matrix\">\n  <rows>1</rows>\n  <cols>5</cols>\n  <dt>d</dt>\n  <data>\n    -0.26500000000000001 -0.046699999999999998 0.00183 -0.00031 0.252</data></distortion_coefficients>\n</opencv_storage>\n";

    #[test]
    fn yaml_and_xml_say_the_same() {
        for text in [YAML, XML] {
            assert!(is_storage(text));
            let lens = read(Path::new("a"), text).unwrap();
            assert_eq!((lens.fx, lens.fy, lens.cx, lens.cy), (Some(536.07), Some(536.02), 342.37, 235.54));
            assert_eq!(
                (lens.k1, lens.k2, lens.p1, lens.p2, lens.k3),
                (-0.265, -0.0467, 0.00183, -0.00031, 0.252)
            );
            assert_eq!((lens.width, lens.height), (Some(640), Some(480)));
        }
        assert!(!is_storage("fx = 500.0\n") && !is_storage("{\"fx\": 500}"));
    }

    #[test]
    fn any_number_of_coefficients_is_read_if_those_beyond_five_are_zero() {
        let with = |numbers: &str| {
            let start = YAML.rfind("data: [").unwrap();
            read(Path::new("a"), &format!("{}data: [ {numbers} ]\n", &YAML[..start]))
        };
        let terms = |numbers: &str| with(numbers).map(|lens| [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]);
        assert_eq!(terms("-0.2, 0.1, 1e-3, -2e-3").unwrap(), [-0.2, 0.1, 1e-3, -2e-3, 0.0]);
        assert_eq!(terms("-0.2, 0.1, 1e-3, -2e-3, 0.3").unwrap(), [-0.2, 0.1, 1e-3, -2e-3, 0.3]);
        assert_eq!(terms("-0.2, 0.1, 1e-3, -2e-3, 0.3, 0., 0., 0.").unwrap(), [-0.2, 0.1, 1e-3, -2e-3, 0.3]);
        for (numbers, which) in [
            ("-0.2, 0.1, 0., 0., 0.3, 0.4, 0., 0.", "number 6"),
            ("0., 0., 0., 0., 0., 0., 0., 1e-9", "number 8"),
        ] {
            let message = with(numbers).unwrap_err().to_string();
            assert!(message.contains("8 distortion_coefficients") && message.contains(which), "{message}");
        }
    }

    #[test]
    fn what_cannot_be_meant_is_refused() {
        for (from, to) in
            [("camera_matrix", "matrix"), (" 1. ]", " ]"), ("0.252", "0.252, 0.1"), ("536.07", "five")]
        {
            assert!(YAML.contains(from));
            let message = read(Path::new("a"), &YAML.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(message.starts_with("a: ") && message.contains("; "), "{message}");
        }
    }
}

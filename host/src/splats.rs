//! A parameter map as Gaussian splats, in the PLY format of Kerbl et al. 2023 ("3D Gaussian Splatting"): flat splats for each texel,
//! its colour in spherical harmonics up to degree 3.
//!
//! The format's colour is 0.5 + Σ c Y(v) with v from the camera to the splat, and real harmonics whose odd orders are negated
//! (the Condon-Shortley phase); colours are levels of a picture, not radiance, so that the harmonics are fitted to exposed
//! levels. Lengths are metres, in the surface's frame.

use glam::{DVec2, Vec3};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::geometry::Texels;
use crate::parameter_map::ParameterMap;
use crate::progress::Progress;
use crate::render::expose;
use crate::sampling::spiral;
use crate::{Error, Result};

/// Functions up to degree 3.
const FUNCTIONS: usize = 16;
/// To so many directions each texel's harmonics are fitted, down to this zenith angle.
const DIRECTIONS: usize = 160;
const ZENITH_LIMIT_DEG: f64 = 80.0;
/// What roughness costs: below the horizon nothing holds the harmonics.
const RIDGE: f64 = 1e-4;
/// The standard deviation of a splat, of the distance between two: no gaps and little blur.
const SIGMA: f64 = 0.7;
/// Texels are divided into 2 x 2 or 3 x 3 splats, so that neighbours blur them less, as long as there are no more than these.
const MOST_SPLATS: usize = 600_000;
/// Its thickness, of its width.
const FLATNESS: f64 = 0.01;
/// The logit of 0.995: renderers clip at 0.99.
const OPACITY_LOGIT: f32 = 5.3;
/// Of the function of degree 0.
const Y0: f32 = 0.282_094_8;

/// Splats, and how far they are from the map.
#[derive(Debug, Clone, PartialEq)]
pub struct Splats {
    /// The content of the PLY file.
    pub ply: Vec<u8>,
    /// How many splats it holds.
    pub count: usize,
    /// Mean absolute difference between the map's exposed levels and the harmonics', of 255, over directions down to zenith 80 degrees.
    pub mean_255: f64,
    /// What 95 % of the levels are within.
    pub most_255: f64,
}

/// The real spherical harmonics up to degree 3 with the format's signs, of a unit vector.
fn functions(v: Vec3) -> [f32; FUNCTIONS] {
    let Vec3 { x, y, z } = v;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        Y0,
        -0.488_602_52 * y,
        0.488_602_52 * z,
        -0.488_602_52 * x,
        1.092_548_4 * x * y,
        -1.092_548_4 * y * z,
        0.315_391_57 * (2.0 * zz - xx - yy),
        -1.092_548_4 * x * z,
        0.546_274_2 * (xx - yy),
        -0.590_043_6 * y * (3.0 * xx - yy),
        2.890_611_4 * x * y * z,
        -0.457_045_8 * y * (4.0 * zz - xx - yy),
        0.373_176_34 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_8 * x * (4.0 * zz - xx - yy),
        1.445_305_7 * z * (xx - yy),
        -0.590_043_6 * x * (xx - 3.0 * yy),
    ]
}

/// From levels in the directions to coefficients.
fn solver(basis: &DMatrix<f32>) -> Result<DMatrix<f32>> {
    let basis = basis.map(f64::from);
    let mut normal = basis.transpose() * &basis;
    for i in 0..FUNCTIONS {
        let degree = (i as f64).sqrt().floor();
        normal[(i, i)] += RIDGE * DIRECTIONS as f64 * (degree * (degree + 1.0)).powi(2);
    }
    let inverse = normal.try_inverse().ok_or_else(|| {
        Error::request("the directions of the splats determine nothing", "report this as a bug")
    })?;
    Ok((inverse * basis.transpose()).map(|value| value as f32))
}

/// Makes splats of a map as it looks when exposed with `gamma` (1 - exp(-gamma radiance)). `progress` counts rows of texels.
///
/// # Errors
/// [`Error::Request`] when `gamma` is not a positive number; [`Error::Interrupted`].
pub fn splats(map: &ParameterMap, gamma: f32, progress: &dyn Progress) -> Result<Splats> {
    if !gamma.is_finite() || gamma <= 0.0 {
        return Err(Error::request(format!("gamma = {gamma} exposes nothing"), "give a positive number"));
    }
    let directions: Vec<Vec3> = spiral(DIRECTIONS, ZENITH_LIMIT_DEG.to_radians())?
        .iter()
        .map(|direction| direction.as_vec3())
        .collect();
    // The renderer looks from the camera to the splat.
    let rows: Vec<_> = directions.iter().map(|direction| functions(-*direction)).collect();
    let basis = DMatrix::from_fn(directions.len(), FUNCTIONS, |i, j| rows[i][j]);
    let solver = solver(&basis)?;
    let (columns, lines) = (map.texels.columns, map.texels.rows);
    let parts =
        (1..=3usize).rev().find(|parts| parts * parts * map.texels.count() <= MOST_SPLATS).unwrap_or(1);
    let count = parts * parts * map.texels.count();
    let mut ply = header(count).into_bytes();
    let (mut sum, mut histogram) = (0.0, vec![0u64; 2551]);
    let scale = [
        (SIGMA * map.surface.width_m / (f64::from(columns) * parts as f64)).ln() as f32,
        (SIGMA * map.surface.height_m / (f64::from(lines) * parts as f64)).ln() as f32,
    ];
    let thin = scale[0].min(scale[1]) + FLATNESS.ln() as f32;
    for row in 0..lines {
        progress.step(row as usize, lines as usize)?;
        let of_row: Vec<(Vec<f32>, Vec<f32>)> = (0..columns)
            .into_par_iter()
            .map(|column| {
                let at = DVec2::new(column.into(), row.into());
                let levels = |direction: &Vec3| map.radiance_at(at, *direction).map(|l| expose(l, gamma));
                let levels: Vec<[f32; 3]> = directions.iter().map(levels).collect();
                let levels = DMatrix::from_fn(levels.len(), 3, |i, c| levels[i][c] - 0.5);
                let found = &solver * &levels;
                // A level is never negative in the renderer.
                let off = (&basis * &found).zip_map(&levels, |a, b| 255.0 * (a.max(-0.5) - b).abs());
                let mut values = vec![0.0, 0.0, 1.0];
                values.extend((0..3).map(|c| found[(0, c)]));
                // All of red, then green, then blue.
                values.extend((0..3).flat_map(|c| (1..FUNCTIONS).map(move |i| (i, c))).map(|at| found[at]));
                values.extend([OPACITY_LOGIT, scale[0], scale[1], thin, 1.0, 0.0, 0.0, 0.0]);
                (values, off.iter().copied().collect())
            })
            .collect();
        let fine = Texels { columns: columns * parts as u32, rows: lines * parts as u32 };
        for (column, (values, off)) in of_row.into_iter().enumerate() {
            for part in 0..parts * parts {
                let [x, y] = [column * parts + part % parts, row as usize * parts + part / parts];
                let point = map.surface.texel_centre(fine, x as u32, y as u32).as_vec3().to_array();
                ply.extend(point.iter().chain(&values).flat_map(|value| value.to_le_bytes()));
            }
            for off in off {
                sum += f64::from(off);
                histogram[((10.0 * off) as usize).min(2550)] += 1;
            }
        }
    }
    progress.step(lines as usize, lines as usize)?;
    let levels: u64 = histogram.iter().sum();
    let mut seen = 0;
    let within = histogram.iter().position(|bin| {
        seen += bin;
        seen as f64 >= 0.95 * levels as f64
    });
    Ok(Splats {
        ply,
        count,
        mean_255: sum / levels as f64,
        most_255: (within.unwrap_or(2550) + 1) as f64 / 10.0,
    })
}

fn header(count: usize) -> String {
    let names = ["x", "y", "z", "nx", "ny", "nz"].map(str::to_owned).into_iter();
    let names = names
        .chain((0..3).map(|i| format!("f_dc_{i}")))
        .chain((0..45).map(|i| format!("f_rest_{i}")))
        .chain(["opacity".to_owned()])
        .chain((0..3).map(|i| format!("scale_{i}")))
        .chain((0..4).map(|i| format!("rot_{i}")));
    let properties: String = names.map(|name| format!("property float {name}\n")).collect();
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment made by Rigel; metres, x right, y up, z out of the surface\nelement vertex {count}\n{properties}end_header\n"
    )
}

#[cfg(test)]
mod tests {
    use nalgebra::SMatrix;

    use super::*;

    #[test]
    fn the_functions_are_orthonormal() {
        let directions = spiral(20_000, std::f64::consts::PI / 2.0).unwrap();
        let mut gram = SMatrix::<f64, FUNCTIONS, FUNCTIONS>::zeros();
        for direction in &directions {
            // Both hemispheres.
            for v in [direction.as_vec3(), -direction.as_vec3()] {
                let row = nalgebra::SVector::<f64, FUNCTIONS>::from_iterator(functions(v).map(f64::from));
                gram += row * row.transpose();
            }
        }
        gram *= 4.0 * std::f64::consts::PI / (2.0 * directions.len() as f64);
        let off = (gram - SMatrix::identity()).abs().max();
        assert!(off < 5e-3, "{off}");
    }
}

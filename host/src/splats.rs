//! A parameter map as Gaussian splats, in the PLY format of Kerbl et al. 2023 ("3D Gaussian Splatting"): flat splats for each texel,
//! its colour in spherical harmonics up to degree 3. Neighbours overlap, and their colours make up for it.
//!
//! The format's colour is 0.5 + Σ c Y(v) with v from the camera to the splat, and real harmonics whose odd orders are negated
//! (the Condon-Shortley phase); colours are levels of a picture, not radiance, so that the harmonics are fitted to exposed
//! levels. Lengths are metres, in the surface's frame.

mod overlap;

use glam::{DVec2, Vec3};
use nalgebra::DMatrix;
use overlap::{Harmonics, Overlap, blend};
use rayon::prelude::*;

use crate::geometry::Texels;
use crate::parameter_map::ParameterMap;
use crate::parameter_map::memory::require;
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
/// The standard deviation of a splat, of the distance between two: the largest blurs texels, the smallest leaves gaps.
const SIGMA: f64 = 0.67;
/// Texels are divided into 2 x 2 or 3 x 3 splats, which blur them less, as long as there are no more than these (a file of 150 MB);
/// a larger map has one for each texel.
const MOST_SPLATS: usize = 600_000;
/// Its thickness, of its width.
const FLATNESS: f64 = 0.01;
/// The logit of 0.995: renderers clip at 0.99.
const OPACITY_LOGIT: f32 = 5.3;
const CLIP: f64 = 0.99;
/// The level that the format adds to the harmonics.
const MIDDLE: f32 = 0.5;
/// So many splats at the border are not judged, and so many along each side are.
const BORDER: u32 = 4;
const TRIED: usize = 128;
/// The bytes of a splat in the file: 62 numbers.
const RECORD: usize = 4 * 62;
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
    /// What overlap costs beside: mean absolute difference between the harmonics' levels and those that overlapping splats show, of
    /// 255, at and between the texels; `None` where the map is too narrow to judge it.
    pub overlap_255: Option<f64>,
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
/// [`Error::Request`] when `gamma` is not a positive number, or the memory does not suffice; [`Error::Interrupted`].
pub fn splats(map: &ParameterMap, gamma: f32, progress: &dyn Progress) -> Result<Splats> {
    if !gamma.is_finite() || gamma <= 0.0 {
        return Err(Error::request(format!("gamma = {gamma} exposes nothing"), "give a positive number"));
    }
    let parts = (1..=3u32)
        .rev()
        .find(|parts| (parts * parts) as usize * map.texels.count() <= MOST_SPLATS)
        .unwrap_or(1);
    let each = size_of::<Harmonics>();
    require(map.texels, each + (parts * parts) as usize * (each + RECORD))?;
    let directions: Vec<Vec3> = spiral(DIRECTIONS, ZENITH_LIMIT_DEG.to_radians())?
        .iter()
        .map(|direction| direction.as_vec3())
        .collect();
    // The renderer looks from the camera to the splat.
    let rows: Vec<_> = directions.iter().map(|direction| functions(-*direction)).collect();
    let basis = DMatrix::from_fn(directions.len(), FUNCTIONS, |i, j| rows[i][j]);
    let solver = solver(&basis)?;
    let (columns, lines) = (map.texels.columns, map.texels.rows);
    let (mut sum, mut histogram, mut wanted) =
        (0.0, vec![0u64; 2551], Vec::with_capacity(map.texels.count()));
    for row in 0..lines {
        progress.step(row as usize, 2 * lines as usize)?;
        let of_row: Vec<(Harmonics, Vec<f32>)> = (0..columns)
            .into_par_iter()
            .map(|column| {
                let at = DVec2::new(column.into(), row.into());
                let levels = |direction: &Vec3| map.radiance_at(at, *direction).map(|l| expose(l, gamma));
                let levels: Vec<[f32; 3]> = directions.iter().map(levels).collect();
                let levels = DMatrix::from_fn(levels.len(), 3, |i, c| levels[i][c] - MIDDLE);
                let found = &solver * &levels;
                // A level is never negative in the renderer.
                let off = (&basis * &found).zip_map(&levels, |a, b| 255.0 * (a.max(-MIDDLE) - b).abs());
                let mut absolute = Harmonics::from_fn(|i, c| found[(i, c)]);
                absolute.row_mut(0).add_scalar_mut(MIDDLE / Y0);
                (absolute, off.iter().copied().collect())
            })
            .collect();
        for (harmonics, off) in of_row {
            wanted.push(harmonics);
            for off in off {
                sum += f64::from(off);
                histogram[((10.0 * off) as usize).min(2550)] += 1;
            }
        }
    }
    let levels: u64 = histogram.iter().sum();
    let mut seen = 0;
    let within = histogram.iter().position(|bin| {
        seen += bin;
        seen as f64 >= 0.95 * levels as f64
    });
    let grid = Grid { texels: map.texels, parts, wanted };
    let fine = grid.fine();
    let pitch_m = DVec2::new(map.surface.width_m, map.surface.height_m)
        / DVec2::new(fine.columns.into(), fine.rows.into());
    let overlap = Overlap::new(pitch_m, &directions)?;
    let mut splats = Vec::with_capacity(fine.count());
    for row in 0..fine.rows as i32 {
        let done = lines as usize + row as usize / parts as usize;
        progress.step(done, 2 * lines as usize)?;
        let of_row = (0..fine.columns as i32).into_par_iter();
        let of_row = of_row.map(|column| overlap.made_up(|step| grid.at(column + step[0], row + step[1])));
        splats.par_extend(of_row);
    }
    let overlap_255 = grid.difference_255(&splats, &overlap, &directions);
    let scale = pitch_m.to_array().map(|pitch_m| (SIGMA * pitch_m).ln() as f32);
    let thin = scale[0].min(scale[1]) + FLATNESS.ln() as f32;
    let mut ply = header(splats.len()).into_bytes();
    ply.reserve_exact(RECORD * splats.len());
    for (index, harmonics) in splats.iter().enumerate() {
        let (column, row) = (index as u32 % fine.columns, index as u32 / fine.columns);
        let mut values = map.surface.texel_centre(fine, column, row).as_vec3().to_array().to_vec();
        values.extend([0.0, 0.0, 1.0]);
        values.extend((0..3).map(|c| harmonics[(0, c)] - MIDDLE / Y0));
        // All of red, then green, then blue.
        values.extend((0..3).flat_map(|c| (1..FUNCTIONS).map(move |i| (i, c))).map(|at| harmonics[at]));
        values.extend([OPACITY_LOGIT, scale[0], scale[1], thin, 1.0, 0.0, 0.0, 0.0]);
        ply.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    progress.step(2 * lines as usize, 2 * lines as usize)?;
    Ok(Splats {
        ply,
        count: splats.len(),
        mean_255: sum / levels as f64,
        most_255: (within.unwrap_or(2550) + 1) as f64 / 10.0,
        overlap_255,
    })
}

/// The harmonics that are to be seen at the texels, with levels from black on.
struct Grid {
    texels: Texels,
    /// How many splats a texel has along each side.
    parts: u32,
    wanted: Vec<Harmonics>,
}

impl Grid {
    fn fine(&self) -> Texels {
        Texels { columns: self.texels.columns * self.parts, rows: self.texels.rows * self.parts }
    }

    /// Those at a splat: texels are blended, and continue beyond the border.
    fn at(&self, column: i32, row: i32) -> Harmonics {
        let last = DVec2::new(f64::from(self.texels.columns - 1), f64::from(self.texels.rows - 1));
        let at = (DVec2::new(column.into(), row.into()) + 0.5) / f64::from(self.parts) - 0.5;
        let at = at.clamp(DVec2::ZERO, last);
        let texel = |step: [i32; 2]| {
            let [x, y] = (at.floor() + DVec2::new(step[0].into(), step[1].into())).min(last).to_array();
            self.wanted[y as usize * self.texels.columns as usize + x as usize]
        };
        if self.parts == 1 {
            return texel([0, 0]);
        }
        blend(at.fract()).into_iter().map(|(step, share)| texel(step) * share as f32).sum()
    }

    /// Mean absolute difference between what is to be seen and what the splats show, of 255, where the surface goes on all
    /// around; `None` where it does so nowhere.
    fn difference_255(&self, splats: &[Harmonics], overlap: &Overlap, directions: &[Vec3]) -> Option<f64> {
        let fine = self.fine();
        let inner = |side: u32| (BORDER..side.saturating_sub(BORDER)).step_by((side as usize / TRIED).max(1));
        let (mut sum, mut count) = (0.0, 0);
        for (column, row) in inner(fine.rows).flat_map(|row| inner(fine.columns).map(move |c| (c, row))) {
            // Another place and direction each time.
            let direction = directions[count % directions.len()];
            let at = DVec2::new(count as f64 * 0.618_034, count as f64 * 0.754_878).fract();
            let y = functions(-direction);
            let level = |harmonics: Harmonics| {
                [0, 1, 2].map(|c| (0..FUNCTIONS).map(|i| y[i] * harmonics[(i, c)]).sum::<f32>().max(0.0))
            };
            let (column, row) = (column as i32, row as i32);
            let mixed = |weights: Vec<([i32; 2], f64)>, of: &dyn Fn(i32, i32) -> Harmonics| {
                weights.into_iter().fold([0.0; 3], |sum, (step, weight)| {
                    let levels = level(of(column + step[0], row + step[1]));
                    [0, 1, 2].map(|c| sum[c] + weight * f64::from(levels[c]))
                })
            };
            let shown = |x: i32, y: i32| splats[y as usize * fine.columns as usize + x as usize];
            let seen = mixed(overlap.weights(direction, at), &shown);
            let wanted = mixed(blend(at), &|x, y| self.at(x, y));
            sum += (0..3).map(|c| 255.0 * (seen[c] - wanted[c]).abs()).sum::<f64>() / 3.0;
            count += 1;
        }
        (count > 0).then(|| sum / count as f64)
    }
}

/// How long a file is that begins so, bytes.
pub(crate) fn length(start: &[u8]) -> Option<u64> {
    let said = std::str::from_utf8(&start[..start_of_records(start)?]).ok()?;
    let count: u64 = said.lines().find_map(|line| line.strip_prefix("element vertex "))?.parse().ok()?;
    (said.len() as u64).checked_add(count.checked_mul(RECORD as u64)?)
}

fn start_of_records(ply: &[u8]) -> Option<usize> {
    let end = b"end_header\n";
    Some(ply.windows(end.len()).position(|bytes| bytes == end)? + end.len())
}

/// Columns, rows and levels of the splats that [`splats()`] wrote, as seen from straight above, each for itself; `None` for others.
pub(crate) fn front(ply: &[u8]) -> Option<(u32, u32, Vec<[u8; 3]>)> {
    let (said, records) = ply.split_at(start_of_records(ply)?);
    let (records, rest) = records.as_chunks::<RECORD>();
    if said != header(records.len()).as_bytes() || !rest.is_empty() {
        return None;
    }
    let number = |record: &[u8; RECORD], i: usize| {
        f32::from_le_bytes(std::array::from_fn(|byte| record[4 * i + byte]))
    };
    // A row has one y.
    let columns = records.iter().take_while(|record| number(record, 1) == number(&records[0], 1)).count();
    let y = functions(-Vec3::Z);
    let levels = records.iter().map(|record| {
        std::array::from_fn(|c| {
            let rest: f32 = (1..FUNCTIONS).map(|i| y[i] * number(record, 8 + (FUNCTIONS - 1) * c + i)).sum();
            (255.0 * (MIDDLE + y[0] * number(record, 6 + c) + rest)).round() as u8
        })
    });
    (columns > 0 && records.len() % columns == 0)
        .then(|| (columns as u32, (records.len() / columns) as u32, levels.collect()))
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

//! A small picture of what a file holds.

use std::path::Path;

use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Rgb, RgbImage};

use super::{Kind, info};
use crate::environment::EnvironmentMap;
use crate::geometry::{Lens, Pose};
use crate::observation::{ObservationMap, zarr};
use crate::parameter_map::ParameterMap;
use crate::picture::Picture;
use crate::progress::Silent;
use crate::radiance::RadianceImage;
use crate::render::{expose, gamma_for_median, png, render};
use crate::session::Session;
use crate::splats;
use crate::{Error, Result};

/// The longer side, pixels.
const SIDE: u32 = 384;

/// The content of a PNG file, at most 384 pixels wide and high: a session's first view, a map or its splats from the front, what
/// observations are on average, radiance exposed with half grey for the median of what was measured.
///
/// # Errors
/// Those of [`info()`]; [`Error::Input`] for a file that shows nothing, such as a table.
pub fn thumbnail(path: &Path) -> Result<Vec<u8>> {
    let (width, height, radiance) = match info(path)?.kind {
        Kind::Session => return of_session(path),
        Kind::ParameterMap => front(&ParameterMap::read(path)?)?,
        Kind::Radiance => return of_view(&RadianceImage::read_exr(path)?),
        Kind::Environment => {
            let map = EnvironmentMap::read(path)?;
            let (width, height) = (map.size.width() as u32, map.size.height() as u32);
            return exposed(width, height, &map.radiance, |i| {
                map.flags.get(i).is_none_or(|flag| flag & EnvironmentMap::UNSEEN == 0)
            });
        }
        // Of exported observations the mean.
        Kind::Exchange if path.is_dir() => zarr::mean(path)?,
        Kind::Splats => return of_splats(path),
        Kind::Picture | Kind::Exchange => {
            let Picture { width, height, levels, .. } = Picture::read(path)?;
            let number = |bits: u16| half::f16::from_bits(bits).to_f32();
            (width, height, levels.into_iter().map(|pixel| pixel.map(number)).collect())
        }
        Kind::Observations => average(&ObservationMap::open(path)?)?,
        _ => return Err(Error::input(path, "shows nothing that could be a picture", "leave --png out")),
    };
    exposed(width, height, &radiance, |_| true)
}

/// Half grey is the median of what `was_measured`.
fn exposed(
    width: u32,
    height: u32,
    radiance: &[[f32; 3]],
    was_measured: impl Fn(usize) -> bool,
) -> Result<Vec<u8>> {
    let measured =
        radiance.iter().enumerate().filter(|(i, _)| was_measured(*i)).flat_map(|(_, pixel)| *pixel);
    let seen: Vec<f32> = measured.filter(|l| l.is_finite() && *l > 0.0).collect();
    let gamma = if seen.is_empty() { 1.0 } else { gamma_for_median(&seen)? };
    let level = |l: f32| (255.0 * expose(if l.is_nan() { 0.0 } else { l }, gamma)).round() as u8;
    smaller(width, height, radiance.iter().flat_map(|pixel| pixel.map(level)).collect())
}

fn smaller(width: u32, height: u32, levels: Vec<u8>) -> Result<Vec<u8>> {
    let picture: RgbImage = ImageBuffer::<Rgb<u8>, _>::from_raw(width, height, levels).ok_or_else(|| {
        Error::request(format!("a picture of {width}x{height} pixels is incomplete"), "make the file again")
    })?;
    if width.max(height) <= SIDE {
        return png(width, height, picture.as_raw());
    }
    let by = f64::from(SIDE) / f64::from(width.max(height));
    let side = |of: u32| ((f64::from(of) * by).round() as u32).max(1);
    let small = resize(&picture, side(width), side(height), FilterType::Triangle);
    png(small.width(), small.height(), small.as_raw())
}

fn of_view(image: &RadianceImage) -> Result<Vec<u8>> {
    exposed(image.width, image.height, &image.radiance, |i| image.mask[i] == 0)
}

fn of_splats(path: &Path) -> Result<Vec<u8>> {
    let ply = std::fs::read(path).map_err(Error::io("read", path))?;
    let (columns, rows, levels) = splats::front(&ply).ok_or_else(|| {
        Error::input(path, "holds splats that this version of Rigel has not written", "leave --png out")
    })?;
    smaller(columns, rows, levels.concat())
}

fn of_session(path: &Path) -> Result<Vec<u8>> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new(".")) };
    let session = Session::open(folder)?;
    let views = session.manifest.views.len();
    if let Some(view) = (0..views).find(|&view| session.radiance_path(view).exists()) {
        return of_view(&RadianceImage::read_exr(&session.radiance_path(view))?);
    }
    // The photograph in the middle of the bracket is mostly the one that shows most.
    let photographs =
        (0..views).map(|view| session.photographs(view)).find(|photographs| !photographs.is_empty());
    let photograph = photographs.as_ref().and_then(|photographs| photographs.get(photographs.len() / 2));
    let photograph =
        photograph.ok_or_else(|| Error::input(path, "has no photograph yet", "leave --png out"))?;
    let picture = Picture::read(session.photograph_path(photograph))?;
    let level = |level: u16| (255.0 * f64::from(level) / f64::from(picture.white)).round() as u8;
    smaller(picture.width, picture.height, picture.levels.iter().flat_map(|pixel| pixel.map(level)).collect())
}

type Seen = (u32, u32, Vec<[f32; 3]>);

/// A map from straight above, a little larger than itself.
fn front(map: &ParameterMap) -> Result<Seen> {
    let (width_m, height_m) = (map.surface.width_m, map.surface.height_m);
    let distance_m = 4.0 * width_m.max(height_m);
    let focal_px = f64::from(SIDE) * distance_m / width_m.max(height_m);
    let side = |length_m: f64| ((focal_px * length_m / distance_m).round() as u32).clamp(1, SIDE);
    let lens = Lens::pinhole(side(width_m), side(height_m), focal_px);
    let radiance = |point, direction| map.radiance_at(map.surface.texel_at(map.texels, point), direction);
    let picture = render(&map.surface, &lens, &Pose::from_rig(0.0, 0.0, distance_m), radiance, &Silent)?;
    Ok((picture.width, picture.height, picture.radiance))
}

/// What the views measured on average.
fn average(map: &ObservationMap) -> Result<Seen> {
    let texels = map.header().texels;
    let mut means = vec![[0.0; 3]; texels.count()];
    for tile in 0..map.header().tiles().count() {
        for ((column, row), texel) in map.tile(tile)? {
            let sum = texel.radiance.iter().fold([0.0; 3], |sum, l| std::array::from_fn(|c| sum[c] + l[c]));
            let mean = &mut means[row as usize * texels.columns as usize + column as usize];
            *mean = sum.map(|sum: f32| sum / texel.len().max(1) as f32);
        }
    }
    Ok((texels.columns, texels.rows, means))
}

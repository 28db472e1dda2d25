//! From radiance and poses to the observation map, one view at a time.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use glam::DVec3;
use half::f16;
use rayon::prelude::*;

use super::gain;
use super::map::{Header, ObservationMap, ObservedView, VALUES};
use super::place::PlaceError;
use super::sample::{Sample, ViewSampler};
use crate::calibration::{Photometry, Registration, view_geometry};
use crate::geometry::{Surface, Texels};
use crate::progress::Progress;
use crate::radiance::RadianceImage;
use crate::session::Session;
use crate::{Error, Result, file};

/// How to build an observation map.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// How finely the sampled area is divided.
    pub texels: Texels,
}

/// Texels on a side for the first look, which finds the unit and the gains.
const COARSE: u32 = 48;

/// Builds the observation map of a session at `path`. A registered session's poses, lens and doubts are used, and the views that
/// the registration has dropped are left out; any other has the poses of its manifest. Where the session has its [`Photometry`], the lamp's
/// drift and the vignetting that it tells are removed, and its doubts are in the observations' sigma. Memory: one radiance picture and
/// one view of the map.
///
/// # Errors
/// [`Error::Input`] when the session lacks radiance, poses, a lens or the surface's size; [`Error::Request`] when no texel was
/// measured by any view; those of [`Registration::of`] and [`Photometry::of`]; [`Error::Io`] when the disk is full.
pub fn observe(
    session: &Session,
    path: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<ObservationMap> {
    observe_under(session, Photometry::of(session)?.as_ref(), path, options, progress)
}

/// The same with a photometry that the session does not keep (yet).
///
/// # Errors
/// Those of [`observe`].
pub fn observe_under(
    session: &Session,
    photometry: Option<&Photometry>,
    path: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<ObservationMap> {
    let surface = session.manifest.surface()?;
    let registration = Registration::of(session)?;
    let mut views = session.done_views();
    if let Some(registration) = &registration {
        views.retain(|&view| registration.view(&session.manifest.views[view].name).is_some());
    }
    let total = 2 * views.len();
    let sample = |view: usize, texels: Texels| {
        let area = Area { surface, centre_m: DVec3::ZERO, texels };
        sample_area(session, registration.as_ref(), photometry, view, &area)
    };
    let mut observed = vec![];
    let mut coarse: Vec<Vec<Option<Sample>>> = vec![];
    for (step, &view) in views.iter().enumerate() {
        progress.step(step, total)?;
        let texels = Texels { columns: COARSE, rows: COARSE };
        coarse.push(sample(view, texels)?);
        let (_, pose) = view_geometry(session, registration.as_ref(), view)?;
        observed.push(ObservedView {
            name: session.manifest.views[view].name.clone(),
            centre_m: pose.centre_m,
            gain: 1.0,
        });
    }
    let unit = median_radiance(&coarse).ok_or_else(|| {
        Error::request(
            "no texel of the sampled area was measured in any view",
            "check the poses, the lens and the size of the surface (--surface)",
        )
    })?;
    let names: Vec<String> = observed.iter().map(|view| view.name.clone()).collect();
    if views
        .iter()
        .any(|&view| session.photographs(view).iter().any(|photograph| photograph.exposure_s.is_none()))
    {
        for (view, gain) in observed.iter_mut().zip(gain::estimate(&logarithms(&coarse), &names)?) {
            view.gain = gain;
        }
    }
    drop(coarse);
    let mut header = Header::new(surface, options.texels, unit, observed);
    header.photometry = photometry.and_then(Photometry::hash);
    let map = ObservationMap::create(path, &header, &mut |index| {
        progress.step(views.len() + index, total)?;
        sample(views[index], options.texels)
    })?;
    progress.step(total, total)?;
    Ok(map)
}

impl ObservationMap {
    /// Writes a map view by view: `samples` of a view are one for each texel, row by row from the top-left one; `None` where
    /// the view did not measure the texel.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be written, and what `samples` says; what stood there is then untouched.
    pub fn create(
        path: &Path,
        header: &Header,
        samples: &mut dyn FnMut(usize) -> Result<Vec<Option<Sample>>>,
    ) -> Result<Self> {
        file::write_beside(path, |temporary| {
            let mut out = File::create(temporary).map_err(Error::io("write", path))?;
            let start = header.start(&mut out).map_err(Error::io("write", path))?;
            for view in 0..header.views.len() {
                let samples = samples(view)?;
                write_view(&mut out, start, header, view, &samples).map_err(Error::io("write", path))?;
            }
            out.sync_all().map_err(Error::io("write", path))
        })?;
        Self::open(path)
    }
}

/// A rectangle in the surface's plane.
pub(crate) struct Area {
    /// Its size.
    pub surface: Surface,
    /// Where its centre is, surface frame.
    pub centre_m: DVec3,
    /// How finely it is divided.
    pub texels: Texels,
}

/// What one view measured of each texel of an area, row by row.
pub(crate) fn sample_area(
    session: &Session,
    registration: Option<&Registration>,
    photometry: Option<&Photometry>,
    view: usize,
    area: &Area,
) -> Result<Vec<Option<Sample>>> {
    let Area { surface, texels, .. } = *area;
    let (path, name) = (session.radiance_path(view), &session.manifest.views[view].name);
    if !path.is_file() {
        return Err(Error::input(path, "is missing", "run `rigel radiance` first"));
    }
    let mut image = RadianceImage::read_exr(&path)?;
    let (lens, mut pose) = view_geometry(session, registration, view)?;
    if (lens.width, lens.height) != (image.width, image.height) {
        return Err(Error::input(
            &path,
            format!(
                "is {}x{} pixels but its lens is for {}x{}",
                image.width, image.height, lens.width, lens.height
            ),
            "run `rigel radiance` again, or give the lens of these photographs",
        ));
    }
    if let Some(photometry) = photometry {
        photometry.correct(name, &mut image)?;
    }
    // As seen from the area's centre.
    pose.centre_m -= area.centre_m;
    let registered = registration.and_then(|all| all.view(name)).filter(|_| area.centre_m == DVec3::ZERO);
    let place = registered.map(|view| PlaceError::of(view, &lens, &surface));
    let sampler =
        ViewSampler { image: &image, lens: &lens, pose: &pose, place: place.as_ref(), surface, texels };
    let sample = |index: usize| {
        let (column, row) = (index as u32 % texels.columns, index as u32 / texels.columns);
        let sample = sampler.sample(column, row)?;
        let Some(photometry) = photometry else { return Some(sample) };
        let pixel = lens.project(pose.to_camera(surface.texel_centre(texels, column, row)))?;
        let doubt = photometry.relative_variance(name, pixel) as f32 / 3.0;
        let squares = sample.radiance.iter().map(|value| value * value).sum::<f32>();
        Some(Sample { sigma: (sample.sigma * sample.sigma + doubt * squares).sqrt(), ..sample })
    };
    Ok((0..texels.count()).into_par_iter().map(sample).collect())
}

/// Writes one view into every tile.
fn write_view(
    out: &mut File,
    start: u64,
    header: &Header,
    view: usize,
    samples: &[Option<Sample>],
) -> std::io::Result<()> {
    let scale = (1.0 / (header.unit * header.views[view].gain)) as f32;
    let views = header.views.len() as u64;
    let mut block = Vec::with_capacity(header.block_bytes() as usize);
    let mut out = BufWriter::with_capacity(header.block_bytes() as usize, out);
    for tile in 0..header.tiles().count() {
        block.clear();
        for slot in header.slots(tile) {
            let sample =
                slot.and_then(|(column, row)| samples[(row * header.texels.columns + column) as usize]);
            let values: [f32; VALUES] = match sample {
                Some(Sample { radiance: [r, g, b], sigma }) => {
                    [r * scale, g * scale, b * scale, sigma * scale, 0.0]
                }
                None => [0.0, 0.0, 0.0, 0.0, 1.0],
            };
            // Beyond a half float's range there is nothing to store: absent, as a saturated pixel is.
            let fits = values.iter().all(|value| value.is_finite() && value.abs() <= f32::from(f16::MAX));
            let values = if fits { values } else { [0.0, 0.0, 0.0, 0.0, 1.0] };
            block.extend(values.iter().flat_map(|&value| f16::from_f32(value).to_le_bytes()));
        }
        out.seek(SeekFrom::Start(start + (tile as u64 * views + view as u64) * header.block_bytes()))?;
        out.write_all(&block)?;
    }
    out.flush()
}

fn median_radiance(coarse: &[Vec<Option<Sample>>]) -> Option<f64> {
    let mut values: Vec<f32> = coarse
        .iter()
        .flatten()
        .flatten()
        .map(|sample| sample.radiance[1])
        .filter(|&value| value > 0.0)
        .collect();
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1))
}

/// Per texel and view, the logarithm of the mean over the channels; NaN where absent or not positive.
fn logarithms(coarse: &[Vec<Option<Sample>>]) -> Vec<Vec<f32>> {
    let log = |sample: &Option<Sample>| match sample {
        Some(sample) if sample.radiance.iter().sum::<f32>() > 0.0 => {
            (sample.radiance.iter().sum::<f32>() / 3.0).ln()
        }
        _ => f32::NAN,
    };
    (0..coarse[0].len()).map(|texel| coarse.iter().map(|view| log(&view[texel])).collect()).collect()
}

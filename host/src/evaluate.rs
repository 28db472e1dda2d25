//! How far a parameter map is from views that it has not seen.
//!
//! The score: every reference view is rendered; over the pixels whose surface point lies in the sampled area (and that the
//! reference measured) the per-channel scale is median(truth / prediction) over all views together; both go through
//! 1 - exp(-gamma L) with gamma = ln 2 / median(truth); what counts is the mean absolute difference times 255, and the PSNR.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

use half::f16;

use crate::calibration::{Photometry, Registration, view_geometry};
use crate::geometry::{Lens, Pose};
use crate::parameter_map::ParameterMap;
use crate::picture::Picture;
use crate::progress::{Progress, Silent};
use crate::radiance::{Mask, RadianceImage};
use crate::render::{self, expose, gamma_for_median, render};
use crate::session::Session;
use crate::view_file::ReferenceFile;
use crate::{Error, Result, file};

/// A view to compare with.
#[derive(Debug, Clone)]
pub struct Reference {
    /// Its name in tables.
    pub name: String,
    /// Its lens.
    pub lens: Lens,
    /// Its pose.
    pub pose: Pose,
    /// What was really seen; masked pixels do not count.
    pub radiance: RadianceImage,
    /// Whether its exposure time is known. Otherwise its radiance is on a scale of its own, and one gain (the median of
    /// truth / prediction) is taken out first.
    pub exposure_time_known: bool,
}

/// The error of one view.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewError {
    /// The view's name.
    pub name: String,
    /// How many pixels were compared.
    pub pixels: usize,
    /// Mean absolute difference, of 255.
    pub mean_255: f64,
    /// Peak signal to noise ratio, decibels.
    pub psnr_db: f64,
    /// Median over pixels and channels of |truth - scale x prediction| / truth.
    pub median_relative: f64,
}

/// One view as pictures: pixels outside the sampled area are black in all three.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The view's name.
    pub name: String,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// What was seen, exposed to 8 bits.
    pub truth: Vec<[u8; 3]>,
    /// What the map says.
    pub prediction: Vec<[u8; 3]>,
    /// Four times (prediction - truth) around middle grey.
    pub difference: Vec<[u8; 3]>,
}

/// The errors of all views.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// What the prediction was multiplied by, per channel.
    pub scale: [f32; 3],
    /// The exposure of the comparison.
    pub gamma: f32,
    /// View by view.
    pub views: Vec<ViewError>,
    /// The same as pictures.
    pub comparisons: Vec<Comparison>,
}

impl Comparison {
    /// One of its pictures as a PNG file.
    ///
    /// # Errors
    /// [`Error::Request`] when `levels` is not a picture of this size.
    pub fn png(&self, levels: &[[u8; 3]]) -> Result<Vec<u8>> {
        render::png(self.width, self.height, levels.as_flattened())
    }

    /// Truth, prediction and difference side by side as a PNG file.
    ///
    /// # Errors
    /// [`Error::Request`] when the picture is too large.
    pub fn side_by_side_png(&self) -> Result<Vec<u8>> {
        let width = self.width as usize;
        let rows = (0..self.height as usize).map(|row| row * width..(row + 1) * width);
        let levels: Vec<[u8; 3]> = rows
            .flat_map(|row| {
                [&self.truth[row.clone()], &self.prediction[row.clone()], &self.difference[row]].concat()
            })
            .collect();
        render::png(3 * self.width, self.height, levels.as_flattened())
    }
}

impl Evaluation {
    /// Mean over the views of the mean absolute difference, of 255.
    pub fn mean_255(&self) -> f64 {
        self.mean(|view| view.mean_255)
    }

    /// Mean over the views of the PSNR, decibels.
    pub fn psnr_db(&self) -> f64 {
        self.mean(|view| view.psnr_db)
    }

    /// Mean over the views of the median relative error.
    pub fn median_relative(&self) -> f64 {
        self.mean(|view| view.median_relative)
    }

    fn mean(&self, value: impl Fn(&ViewError) -> f64) -> f64 {
        self.views.iter().map(value).sum::<f64>() / self.views.len() as f64
    }

    /// Writes errors.csv and, for each view, truth, prediction and difference side by side as a PNG. Pictures of other views
    /// that an errors.csv there names are removed: they belong to another map.
    ///
    /// # Errors
    /// [`Error::Io`] when `folder` cannot be written or the disk is full; then it is as it was.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let mut files = vec![("errors.csv".into(), self.csv().into_bytes())];
        for comparison in &self.comparisons {
            files.push((format!("{}.png", comparison.name), comparison.side_by_side_png()?));
        }
        let before = std::fs::read_to_string(folder.join("errors.csv")).unwrap_or_default();
        file::write_together(folder, &files)?;
        let mut lines = before.lines();
        // A table that somebody else wrote names nothing of ours.
        let ours = lines.next() == Some(COLUMNS);
        let pictures =
            lines.filter(|_| ours).filter_map(|line| Some(format!("{}.png", line.split_once(',')?.0)));
        for stale in pictures.filter(|name| files.iter().all(|(new, _)| new != name)) {
            let path = folder.join(&stale);
            // Gone already, or elsewhere.
            if path.is_file() && path.file_name() == Some(stale.as_ref()) {
                std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
            }
        }
        Ok(())
    }

    /// The table as CSV.
    pub fn csv(&self) -> String {
        let mut csv = format!("{COLUMNS}\n");
        for ViewError { name, pixels, mean_255, psnr_db, median_relative } in &self.views {
            let _ = writeln!(csv, "{name},{pixels},{mean_255:.4},{psnr_db:.3},{median_relative:.5}");
        }
        csv
    }
}

/// The reference views of a list (see [`crate::view_file`]).
///
/// # Errors
/// [`Error::Input`] naming the list or a picture that cannot be used.
pub fn read_references(list: &Path, pixel_centre: f64) -> Result<Vec<Reference>> {
    let load = |entry: ReferenceFile| {
        let radiance = reference_picture(&entry.file)?;
        let lens = entry.lens(radiance.width, radiance.height);
        check_size(&entry.file, &radiance, &lens, "correct width and height in the list")?;
        let name = entry.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Reference { name, lens, pose: entry.pose, radiance, exposure_time_known: true })
    };
    let references: Vec<Reference> =
        ReferenceFile::read_list(list, pixel_centre)?.into_iter().map(load).collect::<Result<_>>()?;
    let names: BTreeSet<&str> = references.iter().map(|reference| reference.name.as_str()).collect();
    if names.len() < references.len() {
        return Err(Error::input(
            list,
            "names two files that differ only in folder or extension",
            "rename one of them",
        ));
    }
    Ok(references)
}

fn check_size(path: &Path, radiance: &RadianceImage, lens: &Lens, remedy: &str) -> Result<()> {
    if (lens.width, lens.height) == (radiance.width, radiance.height) {
        return Ok(());
    }
    let what = format!(
        "is {}x{} pixels, its camera {}x{}",
        radiance.width, radiance.height, lens.width, lens.height
    );
    Err(Error::input(path, what, remedy))
}

/// Radiance that Rigel measured, with its mask, or a picture of linear radiance that somebody else made: there every pixel
/// counts as measured that is within the range of half floats.
fn reference_picture(path: &Path) -> Result<RadianceImage> {
    if RadianceImage::is_at(path) {
        return RadianceImage::read_exr(path);
    }
    let picture = Picture::read(path)?;
    if picture.white != Picture::FLOAT_WHITE {
        return Err(Error::input(
            path,
            "does not hold linear radiance",
            "give an OpenEXR or Radiance HDR picture",
        ));
    }
    Ok(RadianceImage {
        width: picture.width,
        height: picture.height,
        variance: vec![[0.0; 3]; picture.levels.len()],
        mask: picture.levels.iter().map(beyond_range).collect(),
        radiance: picture
            .levels
            .into_iter()
            .map(|pixel| pixel.map(|bits| f16::from_bits(bits).to_f32()))
            .collect(),
    })
}

/// Of errors.csv.
const COLUMNS: &str = "view,pixels,mean_of_255,psnr_db,median_relative";

/// Infinite numbers arrive as the largest half float.
fn beyond_range(levels: &[u16; 3]) -> Mask {
    if levels.contains(&Picture::FLOAT_WHITE) { RadianceImage::SATURATED } else { 0 }
}

/// The views of a session that [`session_references`] can give: done, measured, and placed by the registration if there is one.
///
/// # Errors
/// [`Error::Input`] when the registration cannot be read, or there is no such view.
pub fn comparable_views(session: &Session) -> Result<Vec<usize>> {
    let registration = Registration::of(session)?;
    let mut views = session.done_views();
    views.retain(|&view| {
        let name = &session.manifest.views[view].name;
        session.radiance_path(view).exists()
            && registration.as_ref().is_none_or(|registration| registration.view(name).is_some())
    });
    if views.is_empty() {
        return Err(Error::input(
            session.folder(),
            "has no view with radiance and a place",
            "run `rigel radiance`, and `rigel register` where the poses are not known",
        ));
    }
    Ok(views)
}

/// Views of a session as references, by index; from where they were registered, if the session was, and on one scale, as far as
/// the session's [`Photometry`] tells it.
///
/// # Errors
/// [`Error::Input`] when a view's radiance, lens or pose is missing, or the lens is for pictures of another size.
pub fn session_references(session: &Session, views: &[usize]) -> Result<Vec<Reference>> {
    let registration = Registration::of(session)?;
    let photometry = Photometry::of(session)?;
    let load = |&view: &usize| {
        let (lens, pose) = view_geometry(session, registration.as_ref(), view)?;
        let path = session.radiance_path(view);
        let mut radiance = RadianceImage::read_exr(&path)?;
        check_size(&path, &radiance, &lens, "register again with the lens of these photographs")?;
        let name = session.manifest.views[view].name.clone();
        if let Some(photometry) = &photometry {
            photometry.correct(&name, &mut radiance)?;
        }
        Ok(Reference {
            name,
            lens,
            pose,
            radiance,
            exposure_time_known: session.photographs(view).iter().all(|photo| photo.exposure_s.is_some()),
        })
    };
    views.iter().map(load).collect()
}

/// Renders every reference view and compares.
///
/// # Errors
/// [`Error::Request`] when no pixel can be compared; [`Error::Interrupted`].
pub fn evaluate(map: &ParameterMap, references: &[Reference], progress: &dyn Progress) -> Result<Evaluation> {
    let mut seen = vec![];
    for (index, reference) in references.iter().enumerate() {
        progress.step(index, references.len())?;
        let radiance = |point, direction| map.radiance_at(map.surface.texel_at(map.texels, point), direction);
        let mut rendering = render(&map.surface, &reference.lens, &reference.pose, radiance, &Silent)?;
        let counts = |&i: &usize| rendering.inside[i] && reference.radiance.mask[i] == 0;
        let pixels: Vec<usize> = (0..rendering.inside.len()).filter(counts).collect();
        if pixels.is_empty() {
            return Err(Error::request(
                format!("reference view {} shows nothing of the sampled area", reference.name),
                "check its pose and lens, or leave it out",
            ));
        }
        if !reference.exposure_time_known {
            let pairs = pixels.iter().map(|&i| (reference.radiance.radiance[i], rendering.radiance[i]));
            let gain = median(pairs.flat_map(|(t, p)| [0, 1, 2].map(|c| t[c] / p[c].max(1e-9))).collect());
            rendering.radiance.iter_mut().flatten().for_each(|value| *value *= gain);
        }
        seen.push((pixels, rendering.radiance));
    }
    progress.step(references.len(), references.len())?;
    let scale = [0, 1, 2].map(|channel| {
        let ratios = seen.iter().zip(references).flat_map(|((pixels, prediction), reference)| {
            pixels
                .iter()
                .map(move |&i| reference.radiance.radiance[i][channel] / prediction[i][channel].max(1e-9))
        });
        median(ratios.collect())
    });
    let truth = references
        .iter()
        .zip(&seen)
        .flat_map(|(reference, (pixels, _))| pixels.iter().flat_map(|&i| reference.radiance.radiance[i]));
    let gamma = gamma_for_median(&truth.collect::<Vec<f32>>())?;
    let (views, comparisons) = references
        .iter()
        .zip(&seen)
        .map(|(reference, (pixels, prediction))| compare(reference, pixels, prediction, scale, gamma))
        .unzip();
    Ok(Evaluation { scale, gamma, views, comparisons })
}

fn compare(
    reference: &Reference,
    pixels: &[usize],
    prediction: &[[f32; 3]],
    scale: [f32; 3],
    gamma: f32,
) -> (ViewError, Comparison) {
    let size = prediction.len();
    let mut comparison = Comparison {
        name: reference.name.clone(),
        width: reference.lens.width,
        height: reference.lens.height,
        truth: vec![[0; 3]; size],
        prediction: vec![[0; 3]; size],
        difference: vec![[0; 3]; size],
    };
    let (mut absolute, mut squared, mut relative) = (0.0, 0.0, vec![]);
    for &i in pixels {
        for channel in 0..3 {
            let (truth, predicted) =
                (reference.radiance.radiance[i][channel], prediction[i][channel] * scale[channel]);
            let (a, b) = (expose(truth, gamma), expose(predicted, gamma));
            absolute += f64::from((a - b).abs());
            squared += f64::from((a - b).powi(2));
            if truth > 0.0 {
                relative.push((predicted - truth).abs() / truth);
            }
            comparison.truth[i][channel] = (a * 255.0).round() as u8;
            comparison.prediction[i][channel] = (b * 255.0).round() as u8;
            comparison.difference[i][channel] = (128.0 + 4.0 * 255.0 * (b - a)).round() as u8;
        }
    }
    let count = (3 * pixels.len()) as f64;
    let error = ViewError {
        name: reference.name.clone(),
        pixels: pixels.len(),
        mean_255: 255.0 * absolute / count,
        psnr_db: -10.0 * (squared / count).log10(),
        median_relative: f64::from(median(relative)),
    };
    (error, comparison)
}

fn median(mut values: Vec<f32>) -> f32 {
    if values.is_empty() {
        return f32::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_picture_of_an_earlier_comparison_stays() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str| {
            let error = ViewError {
                name: name.into(),
                pixels: 1,
                mean_255: 1.0,
                psnr_db: 40.0,
                median_relative: 0.1,
            };
            let comparison = Comparison {
                name: name.into(),
                width: 1,
                height: 1,
                truth: vec![[1; 3]],
                prediction: vec![[2; 3]],
                difference: vec![[3; 3]],
            };
            Evaluation { scale: [1.0; 3], gamma: 1.0, views: vec![error], comparisons: vec![comparison] }
        };
        of("view001").write(folder.path()).unwrap();
        std::fs::write(folder.path().join("mine.png"), b"").unwrap();
        of("view002").write(folder.path()).unwrap();
        let there = |name: &str| folder.path().join(name).exists();
        assert!(!there("view001.png") && there("view002.png") && there("mine.png"));
    }

    #[test]
    fn a_damaged_or_newer_radiance_is_no_picture_without_a_mask() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("view.exr");
        let image = RadianceImage {
            width: 64,
            height: 48,
            radiance: vec![[1.0; 3]; 64 * 48],
            variance: vec![[0.1; 3]; 64 * 48],
            mask: vec![1; 64 * 48],
        };
        image.write_exr(&path, "test").unwrap();
        assert_eq!(reference_picture(&path).unwrap(), image);
        let bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(13).position(|name| name == b"rigelRadiance").unwrap();
        // Name, type and length, each as the format has them; then the version.
        let version = at + "rigelRadiance\0int\0".len() + 4;
        let mut newer = bytes.clone();
        newer[version] = 2;
        std::fs::write(&path, newer).unwrap();
        assert!(reference_picture(&path).unwrap_err().to_string().contains("version"));
        // Rigel's, but the mask has another name.
        let mut unmasked = bytes.clone();
        let at = bytes.windows(5).position(|name| name == b"mask\0").unwrap();
        unmasked[at + 3] = b'c';
        std::fs::write(&path, unmasked).unwrap();
        assert!(reference_picture(&path).unwrap_err().to_string().contains("mask is missing"));
        exr::prelude::write_rgb_file(&path, 4, 4, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
        assert_eq!(reference_picture(&path).unwrap().mask, [0; 16]);
    }
}

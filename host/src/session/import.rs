//! Photographs that somebody else took become a session: from a folder, a CSV or a COLMAP model.

mod colmap;
mod folder;
mod plane;
mod table;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::lock::LOCK_FILE;
use super::{Content, Event, Manifest, Photograph, Session};
use crate::camera::exif;
use crate::geometry::Surface;
use crate::picture::Picture;
use crate::progress::Progress;
use crate::view_file::Calibration;
use crate::{Error, Result, file};

/// Where the photographs and what is known of them come from.
#[derive(Debug, Clone)]
pub enum Source {
    /// A folder of photographs; exposure times from EXIF.
    Folder(PathBuf),
    /// A table with the columns file, view, pan_deg, tilt_deg, exposure_s; files relative to the folder beside it.
    Csv {
        /// The table.
        table: PathBuf,
        /// Where its files are.
        photographs: PathBuf,
    },
    /// A COLMAP text model: a folder with cameras.txt and images.txt, and the folder of its images.
    Colmap {
        /// The folder of the model.
        model: PathBuf,
        /// Where its images are.
        photographs: PathBuf,
    },
}

/// What the photographs do not say themselves.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The sampled area. Of a COLMAP model, by default, what its points cover.
    pub surface: Option<Surface>,
    /// Distance from the rig's centre to the camera, metres.
    pub distance_m: Option<f64>,
    /// A lens, and poses of views, from elsewhere.
    pub calibration: Option<Calibration>,
    /// Flat-field photographs (an even surface), from which the vignetting is found.
    pub flats: Vec<PathBuf>,
    /// A list "file 1/t" per line, as OpenCV's samples have it, in place of EXIF.
    pub exposure_times: Option<PathBuf>,
    /// How many photographs of a folder make a view; by default a view starts where an exposure time comes again.
    pub bracket: Option<usize>,
    /// Photographs without exposure time are taken: `observe` then estimates one gain for each view.
    pub exposure_times_unknown: bool,
}

/// What an import made, and what the user should know about it.
#[derive(Debug)]
pub struct Imported {
    /// The new session.
    pub session: Session,
    /// One sentence for everything that was decided for the user.
    pub notes: Vec<String>,
}

/// A photograph to be imported: where it is, its view, its exposure time if known.
#[derive(Debug, Clone, PartialEq)]
struct Found {
    path: PathBuf,
    view: usize,
    exposure_s: Option<f64>,
}

/// Checks the photographs, copies them into a new session in `session_folder` and records what is known of them. The originals
/// are not touched; after an error there is no session.
///
/// # Errors
/// [`Error::Input`] naming the file when a photograph cannot be read, has no exposure time or another size than the
/// others of its lens; when a table or model is damaged; [`Error::Io`] when the disk is full or cannot be written.
pub fn import(
    source: &Source,
    session_folder: &Path,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Imported> {
    // First, for the photographs may take minutes to read.
    super::begin::refuse_occupied(session_folder)?;
    let mut notes = vec![];
    let (mut manifest, mut found) = match source {
        Source::Folder(path) => folder::read(path, options, &mut notes)?,
        Source::Csv { table, photographs } => table::read(table, photographs)?,
        Source::Colmap { model, photographs } => {
            let (manifest, mut found) = colmap::read(model, photographs, options.surface, &mut notes)?;
            if let Some(list) = &options.exposure_times {
                let times = folder::read_exposure_times(list)?;
                for photograph in &mut found {
                    photograph.exposure_s = Some(folder::listed_s(&times, &photograph.path)?);
                }
            }
            (manifest, found)
        }
    };
    manifest.surface = options.surface.or(manifest.surface);
    manifest.distance_m = options.distance_m.or(manifest.distance_m);
    let sizes = check(&mut found, options, progress)?;
    if let Some(calibration) = &options.calibration {
        apply(calibration, &mut manifest, sizes[0], &mut notes);
    }
    check_sizes(&found, &sizes, &mut manifest, &mut notes)?;
    file::write_beside(session_folder, |folder| {
        fill(&found, manifest, folder, progress)?;
        copy_flats(&options.flats, folder)
    })?;
    Ok(Imported { session: Session::open(session_folder)?, notes })
}

/// Reads every photograph whole, so that a truncated one is found now and not after hours; completes the times.
fn check(found: &mut [Found], options: &Options, progress: &dyn Progress) -> Result<Vec<(u32, u32)>> {
    let (total, done) = (2 * found.len(), AtomicUsize::new(0));
    let check = |photograph: &mut Found| -> Result<(u32, u32)> {
        progress.step(done.fetch_add(1, Ordering::Relaxed), total)?;
        let picture = Picture::read(&photograph.path)?;
        if photograph.exposure_s.is_none() {
            photograph.exposure_s = exif_exposure_s(&photograph.path);
        }
        match photograph.exposure_s {
            None if !options.exposure_times_unknown => Err(Error::input(
                &photograph.path,
                "has no exposure time",
                "give the times with --csv or --exposure-times, or let `observe` estimate one gain for each view with --exposure-times-unknown",
            )),
            Some(time) if !(time.is_finite() && time > 0.0) => Err(Error::input(
                &photograph.path,
                format!("has an exposure time of {time} s"),
                "correct it: a time is a positive number of seconds",
            )),
            _ => Ok((picture.width, picture.height)),
        }
    };
    // Of several that cannot be used the first is named.
    let checked: Vec<Result<(u32, u32)>> = found.par_iter_mut().map(check).collect();
    let sizes = checked.into_iter().collect::<Result<_>>()?;
    let total = found.len();
    let known = found.iter().filter(|photograph| photograph.exposure_s.is_some()).count();
    if known > 0 && known < total {
        let without = found.iter().find(|photograph| photograph.exposure_s.is_none()).expect("counted above");
        return Err(Error::input(
            &without.path,
            format!("has no exposure time although {known} of {total} photographs have one"),
            "give all times or none",
        ));
    }
    Ok(sizes)
}

/// Gives every view the calibrated lens, and its pose where the calibration has one of its number.
fn apply(
    calibration: &Calibration,
    manifest: &mut Manifest,
    (width, height): (u32, u32),
    notes: &mut Vec<String>,
) {
    manifest.lenses = vec![calibration.lens(width, height)];
    manifest.lens_covariance = calibration.covariance();
    let mut calibrated = 0;
    for view in &mut manifest.views {
        view.lens = 0;
        let number = view.name.trim_start_matches("view").parse().ok();
        if let Some(pose) = number.and_then(|number| calibration.pose(number)) {
            view.pose = Some(pose);
            calibrated += 1;
        }
    }
    let (poses, views) = (calibration.poses(), manifest.views.len());
    if poses > 0 && calibrated < views.max(poses) {
        notes.push(format!(
            "{calibrated} of {views} views have one of the calibration's {poses} poses; the others stay where pan and tilt or the model put them"
        ));
    }
}

/// All photographs of a lens have one size; a lens calibrated at another size is scaled to them.
fn check_sizes(
    found: &[Found],
    sizes: &[(u32, u32)],
    manifest: &mut Manifest,
    notes: &mut Vec<String>,
) -> Result<()> {
    let mut first: BTreeMap<usize, usize> = BTreeMap::new();
    for (index, photograph) in found.iter().enumerate() {
        let lens = manifest.views[photograph.view].lens;
        let reference = *first.entry(lens).or_insert(index);
        let ((width, height), (w, h)) = (sizes[reference], sizes[index]);
        if (width, height) != (w, h) {
            return Err(Error::input(
                &photograph.path,
                format!("is {w}x{h} pixels, but {} is {width}x{height}", found[reference].path.display()),
                "import photographs of one size only",
            ));
        }
    }
    let mut scaled = BTreeMap::new();
    for (&lens, &index) in &first {
        let Some(record) = manifest.lenses.get_mut(lens) else { continue };
        let (width, height) = sizes[index];
        let before = (record.width, record.height);
        if before != (width, height) {
            if let Some(covariance) = &mut manifest.lens_covariance {
                *covariance = record.scaled_covariance(covariance, width, height);
            }
            *record = record.scaled_to(width, height);
            *scaled.entry((before, (width, height))).or_insert(0) += 1;
        }
    }
    for (((w, h), (width, height)), count) in scaled {
        notes.push(format!(
            "{count} lens(es) are for {w}x{h} pixels but the photographs have {width}x{height}: scaled, each axis by itself"
        ));
    }
    Ok(())
}

fn exif_exposure_s(path: &Path) -> Option<f64> {
    exif::read(path).ok()?.exposure_s
}

/// The name of a file that is copied to where the files of `names` already are.
fn unused_name<'a>(path: &'a Path, names: &mut BTreeMap<String, &'a Path>) -> Result<String> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match names.insert(name.clone(), path) {
        None => Ok(name),
        Some(other) => {
            Err(Error::input(path, format!("has the same name as {}", other.display()), "rename one of them"))
        }
    }
}

fn copy_flats(flats: &[PathBuf], folder: &Path) -> Result<()> {
    let target = folder.join("flats");
    if !flats.is_empty() {
        fs::create_dir(&target).map_err(Error::io("create", &target))?;
    }
    let mut names = BTreeMap::new();
    for path in flats {
        Picture::read(path)?;
        let copy = target.join(unused_name(path, &mut names)?);
        fs::copy(path, &copy).map_err(Error::io("write", &copy))?;
    }
    Ok(())
}

fn fill(found: &[Found], manifest: Manifest, folder: &Path, progress: &dyn Progress) -> Result<()> {
    let mut session = Session::create(folder, manifest)?;
    let (mut names, done) = (BTreeMap::new(), AtomicUsize::new(found.len()));
    let files: Vec<String> = found
        .iter()
        .map(|photograph| Ok(format!("photographs/{}", unused_name(&photograph.path, &mut names)?)))
        .collect::<Result<_>>()?;
    let copy = |(photograph, file): (&Found, &String)| {
        progress.step(done.fetch_add(1, Ordering::Relaxed), 2 * found.len())?;
        // The photograph was read before: what fails now is the copy.
        let copy = folder.join(file);
        fs::copy(&photograph.path, &copy).map_err(Error::io("write", &copy))?;
        Content::of(&copy)
    };
    let contents: Vec<Content> = found.par_iter().zip(&files).map(copy).collect::<Result<_>>()?;
    for ((photograph, file), content) in found.iter().zip(files).zip(contents) {
        session.record(Event::Photograph(Photograph {
            view: photograph.view,
            file,
            exposure_s: photograph.exposure_s,
            content: Some(content),
            ..Photograph::default()
        }))?;
    }
    (0..session.manifest.views.len()).try_for_each(|view| session.record(Event::ViewDone { view }))?;
    drop(session);
    // Nobody else knows of this folder yet.
    let lock = folder.join(LOCK_FILE);
    fs::remove_file(&lock).map_err(Error::io("remove", lock))?;
    progress.step(2 * found.len(), 2 * found.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::View;

    #[test]
    fn the_covariance_of_an_imported_lens_is_kept() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let row =
            |i: usize| (0..9).map(|j| if i == j { "4.0" } else { "0.5" }).collect::<Vec<_>>().join(", ");
        let rows: Vec<String> = (0..9).map(|i| format!("[{}]", row(i))).collect();
        let text = format!(
            "width = 640\nheight = 480\nf = 500.0\ncx = 320.0\ncy = 240.0\ncovariance = [{}]\n",
            rows.join(", ")
        );
        fs::write(file.path(), text).unwrap();
        let calibration = Calibration::read(file.path(), 0.0).unwrap();
        let view = View { name: "view000".into(), pan_deg: None, tilt_deg: None, lens: 0, pose: None };
        let mut manifest = Manifest { views: vec![view], ..Manifest::new("test") };
        apply(&calibration, &mut manifest, (320, 240), &mut vec![]);
        let found = [Found { path: "a.jpg".into(), view: 0, exposure_s: None }];
        check_sizes(&found, &[(320, 240)], &mut manifest, &mut vec![]).unwrap();
        let path = file.path().with_extension("session");
        manifest.write(&path).unwrap();
        let kept = Manifest::read(&path).unwrap().lens_covariance.unwrap();
        fs::remove_file(&path).unwrap();
        // Half as many pixels; the distortion has none.
        assert_eq!([kept[0][0], kept[0][1], kept[0][4], kept[4][4]], [1.0, 0.125, 0.25, 4.0]);
    }

    #[test]
    fn views_that_a_calibration_does_not_know_are_counted() {
        let pose = |view: u32| {
            format!(r#"{{"view": {view}, "centre": [0, 0, 900], "forward": [0, 0, -1], "up": [0, 1, 0]}}"#)
        };
        let note = |numbers: &[u32]| {
            let file = tempfile::NamedTempFile::new().unwrap();
            let poses: Vec<String> = numbers.iter().map(|&view| pose(view)).collect();
            let text = format!(r#"{{"f": 500, "cx": 320, "cy": 240, "views": [{}]}}"#, poses.join(","));
            fs::write(file.path(), text).unwrap();
            let calibration = Calibration::read(file.path(), 0.0).unwrap();
            let view = |number: u32| View {
                name: format!("view{number:03}"),
                pan_deg: Some(0.0),
                tilt_deg: Some(0.0),
                lens: 0,
                pose: None,
            };
            let mut manifest = Manifest { views: (0..3).map(view).collect(), ..Manifest::new("test") };
            let mut notes = vec![];
            apply(&calibration, &mut manifest, (640, 480), &mut notes);
            let posed = manifest.views.iter().filter(|view| view.pose.is_some()).count();
            assert_eq!(posed, numbers.iter().filter(|&&number| number < 3).count());
            notes.join("; ")
        };
        assert_eq!(note(&[]), "");
        assert_eq!(note(&[2, 0, 1]), "");
        assert!(note(&[0, 2]).contains("2 of 3 views"));
        assert!(note(&[0, 1, 2, 7]).contains("3 of 3 views have one of the calibration's 4 poses"));
    }
}

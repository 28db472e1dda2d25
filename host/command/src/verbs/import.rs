//! From photographs to an observation map: `import`, `radiance`, `observe`.

use std::path::PathBuf;

use rigel::calibration::Registration;
use rigel::info::Kind;
use rigel::measure::{Merge, Options as MeasureOptions, ResponseChoice, Times, measure};
use rigel::observation::{self, observe_under};
use rigel::photometry::{self, Patch};
use rigel::session::Session;
use rigel::session::import::{Options, Source, import as run};
use rigel::view_file::Calibration;
use rigel::{Error, Result};

use crate::arguments::{ExposureTimes, Import, MergeChoice, Observe, Radiance};
use crate::progress::Bar;
use crate::say::{count_of, say};
use crate::verbs::{require_extension, require_place_of};

/// More absent observations than this part are no accident.
const MOSTLY_ABSENT: f64 = 0.6;

/// `rigel import`.
pub fn import(arguments: &Import) -> Result<()> {
    let photographs = arguments.photographs.clone();
    let source = match (&arguments.csv, &arguments.colmap) {
        (Some(table), _) => Source::Csv { table: table.clone(), photographs },
        (None, Some(model)) => Source::Colmap { model: model.clone(), photographs },
        (None, None) => Source::Folder(photographs),
    };
    let calibration = arguments
        .calibration
        .as_ref()
        .map(|path| Calibration::read(path, arguments.pixel_centre))
        .transpose()?;
    let options = Options {
        surface: arguments.surface,
        distance_m: arguments.distance_m,
        calibration,
        flats: arguments.flats.clone(),
        exposure_times: arguments.exposure_times.clone(),
        bracket: arguments.bracket,
        exposure_times_unknown: arguments.exposure_times_unknown,
    };
    let imported = run(&source, &arguments.session, &options, &Bar::new("importing"))?;
    for note in &imported.notes {
        say!("note: {note}");
    }
    let manifest = &imported.session.manifest;
    if manifest.surface.is_none() || manifest.lenses.is_empty() {
        say!(
            "note: `rigel observe` will need the size of the surface (--surface) and the lens (--calibration): import again with them"
        );
    }
    let views = manifest.views.len();
    let photographs: usize = (0..views).map(|view| imported.session.photographs(view).len()).sum();
    say!(
        "wrote {}: {}, {}",
        arguments.session.display(),
        count_of(views, "view"),
        count_of(photographs, "photograph")
    );
    Ok(())
}

/// Whether a view has photographs whose exposure times could contradict each other.
fn is_bracketed(session: &Session) -> bool {
    let timed = |view| session.photographs(view).iter().filter(|photo| photo.exposure_s.is_some()).count();
    (0..session.manifest.views.len()).any(|view| timed(view) > 1)
}

/// `rigel radiance`.
pub fn radiance(arguments: &Radiance) -> Result<()> {
    let bar = Bar::new("radiance");
    let session = Session::open(&arguments.session)?;
    let choice = match arguments.response.as_str() {
        "recover" => ResponseChoice::Recover,
        "srgb" => ResponseChoice::Srgb,
        "linear" => ResponseChoice::Linear,
        path => ResponseChoice::File(PathBuf::from(path)),
    };
    let times = match arguments.exposure_times {
        ExposureTimes::Stated => Times::Stated,
        ExposureTimes::Measured => Times::Measured,
    };
    if choice != ResponseChoice::Recover && arguments.exposure_times == ExposureTimes::Measured {
        return Err(Error::request(
            "--exposure-times measured says nothing beside --response: times are measured only where the response is recovered with them",
            "leave one of the two out",
        ));
    }
    if choice != ResponseChoice::Recover && is_bracketed(&session) {
        say!("note: the exposure times are taken as stated: with --response nothing checks them");
    }
    if arguments.merge == MergeChoice::Debevec && arguments.exposure_times == ExposureTimes::Measured {
        return Err(Error::request(
            "--exposure-times measured says nothing to --merge debevec, which takes the times as they are stated",
            "leave one of the two out",
        ));
    }
    let merge = match arguments.merge {
        MergeChoice::Likelihood => Merge::Likelihood,
        MergeChoice::Debevec => Merge::Debevec,
    };
    let options = MeasureOptions { response: choice, times, merge };
    let measured = measure(&session, &options, &bar).map_err(|error| error.about(session.folder()))?;
    for note in &measured.notes {
        say!("note: {note}");
    }
    for time in &measured.corrected {
        say!(
            "note: {} was exposed for {:.4} s by its pixels, not for {:.4} s",
            time.path.display(),
            time.measured_s,
            time.stated_s
        );
    }
    if measured.moved > 0.0 {
        say!("note: something moved in {:.3} % of the new pixels", 100.0 * measured.moved);
    }
    if let Some(residual) = measured.vignetting_residual {
        say!("vignetting: flat fields agree with the model within {:.2} %", 100.0 * residual);
    }
    say!(
        "wrote {}: {} views now, {} kept; of the new pixels {:.2} % are saturated and {:.2} % too dark in every photograph",
        session.radiance_folder().display(),
        measured.written,
        measured.kept,
        100.0 * measured.saturated,
        100.0 * measured.dark
    );
    Ok(())
}

/// `rigel observe`.
pub fn observe(arguments: &Observe) -> Result<()> {
    let session = Session::open(&arguments.session)?;
    let out = arguments.out.clone().unwrap_or_else(|| session.folder().join("observations.rigel"));
    require_extension(&out, "rigel")?;
    require_place_of(&out, Kind::Observations)?;
    let options = photometry::Options {
        lamp: !arguments.keep_drift,
        vignetting: !arguments.keep_vignetting,
        reference: arguments.reference.map(|(centre_m, side_m)| Patch { centre_m, side_m }),
    };
    let photometry = photometry::find(&session, &options, &Bar::new("comparing views"))
        .map_err(|error| error.about(session.folder()))?;
    let texels = observation::Options { texels: arguments.texels };
    let map = observe_under(&session, Some(&photometry), &out, &texels, &Bar::new("observing"))
        .map_err(|error| error.about(session.folder()))?;
    // Not before: an error leaves everything as it was.
    photometry.write(&session)?;
    for note in &photometry.notes {
        say!("{note}");
    }
    match Registration::of(&session)? {
        Some(registration) => {
            for view in &registration.dropped {
                say!("warning: {} is left out: it {}", view.name, view.reason);
            }
        }
        None if session.manifest.views.iter().any(|view| view.pose.is_none()) => {
            say!(
                "note: nothing is registered: the rig is taken to stand where it was told to (see `rigel register`)"
            );
        }
        None => {}
    }
    let header = map.header();
    if header.views.iter().any(|view| view.gain != 1.0) {
        let gains: Vec<String> =
            header.views.iter().map(|view| format!("{} {:.3}", view.name, view.gain)).collect();
        say!("note: exposure times are unknown; gains: {}", gains.join(", "));
    }
    let absent = map.absent()?;
    if absent > MOSTLY_ABSENT {
        say!(
            "warning: most of the surface is not seen by most views: its size (--surface), the distance (--distance), the lens or the poses may be wrong"
        );
    }
    say!(
        "wrote {}: {}x{} texels, {} views, {:.1} MB; {:.2} % of the observations are absent",
        out.display(),
        header.texels.columns,
        header.texels.rows,
        header.views.len(),
        header.file_bytes() as f64 / 1e6,
        100.0 * absent
    );
    Ok(())
}

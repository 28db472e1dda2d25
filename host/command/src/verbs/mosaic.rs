//! From photographs with orientations to a map of the room: `mosaic`.

use std::path::Path;

use rigel::environment::{EnvironmentMap, Options, Shot, Shots, TrackerFit, Tracking, mosaic as make};
use rigel::geometry::LatLong;
use rigel::picture::Picture;
use rigel::view_file::Calibration;
use rigel::{Error, Result};

use crate::arguments::{Mosaic, Photographs};
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::live::turn;
use crate::verbs::{require_extension, require_place};

/// The widest PNG.
const LOOK: u32 = 2048;

/// `rigel mosaic`.
pub fn mosaic(arguments: &Mosaic) -> Result<()> {
    require_extension(&arguments.out, "exr")?;
    require_place(&arguments.out, arguments.force)?;
    let size = LatLong::new(arguments.size.columns, arguments.size.rows)?;
    let picture = arguments.png.then(|| arguments.out.with_extension("png"));
    if let Some(picture) = &picture {
        require_place(picture, arguments.force)?;
    }
    arguments.photographs.require()?;
    if let Some(delay_s) = arguments.delay_s.filter(|delay_s| delay_s.is_nan() || delay_s.abs() > 10.0) {
        return Err(Error::request(
            format!("--delay {delay_s} is no delay of a camera"),
            "give seconds, such as 0.08",
        ));
    }
    let tracking = Tracking {
        file: arguments.tracker.clone(),
        receiver: arguments.receiver,
        delay_s: arguments.delay_s,
        mount: arguments.mount,
    };
    let shots = if arguments.live {
        turn(arguments, &tracking, size)?
    } else {
        Shots::read_tracked(&arguments.shots, &tracking)?
    };
    let bar = Bar::new("mosaic");
    for place in [Some(&arguments.out), picture.as_ref()].into_iter().flatten() {
        require_no_photograph(place, &shots)?;
    }
    let options =
        Options { fill: arguments.fill, ..arguments.photographs.options(&shots.shots[0].path, size)? };
    let made = make(&shots, &options, &bar).map_err(|error| error.about(&arguments.shots))?;
    if made.placed.iter().any(|placed| placed.matched > 0) {
        say!(
            "orientations: as sure as the room's own frame is, which all share; each beside the others to a few hundredths of a degree where corners match. \
             gains: over what the stated exposures (or 1, where none is) let expect"
        );
    }
    let stated: Vec<f64> = shots.shots.iter().filter_map(|shot| shot.exposure).map(f64::ln).collect();
    let mean = (stated.iter().sum::<f64>() / stated.len().max(1) as f64).exp();
    for (placed, shot) in made.placed.iter().zip(&shots.shots) {
        let expected = shot.exposure.map_or(1.0, |exposure| exposure / mean);
        let [r, g, b] = placed.gain.map(|gain| gain / expected);
        say!(
            "{}: orientation ± {:.3} degrees, {} corners; gain {r:.3} {g:.3} {b:.3} ± {:.1} %",
            placed.name,
            placed.sigma_rad.to_degrees(),
            placed.matched,
            100.0 * placed.gain_sigma
        );
    }
    if let Some(fit) = &made.tracker {
        tell_tracker(fit, arguments);
    }
    for note in &made.notes {
        say!("note: {note}");
    }
    made.map.write(&arguments.out)?;
    if let Some(picture) = &picture {
        made.map.write_png(picture, LOOK)?;
    }
    let apart = match made.placed.iter().any(|placed| placed.matched > 0) {
        true => format!("matched corners {:.3} degrees apart", made.residual_rad.to_degrees()),
        false => "no corners compared".into(),
    };
    say!(
        "wrote {}: {}x{}, {} photographs, focal length {:.1} px, {apart}; of the sphere {:.1} % were never seen{}, {:.2} % are lower bounds",
        arguments.out.display(),
        size.width(),
        size.height(),
        made.placed.len(),
        made.lens.fx,
        100.0 * made.map.share(EnvironmentMap::UNSEEN | EnvironmentMap::FILLED),
        if arguments.fill { " and filled" } else { "" },
        100.0 * made.map.share(EnvironmentMap::LOWER_BOUND)
    );
    Ok(())
}

impl Photographs {
    /// Refuses before the work what is no number of degrees.
    pub(super) fn require(&self) -> Result<()> {
        if self.sigma_deg.is_finite() && self.sigma_deg > 0.0 {
            return Ok(());
        }
        Err(Error::request(
            format!("--sigma {} is no standard deviation", self.sigma_deg),
            "give degrees above 0, or --no-refine for orientations that are right",
        ))
    }

    /// The same as options of a map of this size, of photographs as large as the first one.
    pub(super) fn options(&self, first: &Path, size: LatLong) -> Result<Options> {
        let lens = match &self.lens {
            None => None,
            Some(path) => {
                let first = Picture::read(first)?;
                Some(Calibration::read(path, 0.0)?.lens(first.width, first.height))
            }
        };
        let response = self.response.as_str();
        Ok(Options {
            lens,
            field_of_view_rad: self.fov_deg.map(f64::to_radians),
            sigma_rad: self.sigma_deg.to_radians(),
            refine: !self.no_refine,
            response: (!["srgb", "linear"].contains(&response)).then(|| response.into()),
            linear: response == "linear",
            ..Options::new(size)
        })
    }
}

/// What was found of the tracker, or taken for granted.
fn tell_tracker(fit: &TrackerFit, arguments: &Mosaic) {
    let askew = fit.mount.to_axis_angle().1;
    let askew = askew.min(std::f64::consts::TAU - askew);
    say!(
        "tracker: jitter {:.2} degrees, photographs {:.1} ± {:.1} ms late, receiver {:.2} ± {:.2} degrees askew (--mount {:.5},{:.5},{:.5},{:.5}), drift {}",
        fit.noise_rad.to_degrees(),
        1e3 * fit.delay_s,
        1e3 * fit.delay_sigma_s,
        askew.to_degrees(),
        fit.mount_sigma_rad.to_degrees(),
        fit.mount.w,
        fit.mount.x,
        fit.mount.y,
        fit.mount.z,
        match arguments.photographs.no_refine {
            true => "not looked for".into(),
            false => format!("{:.2} degrees", fit.drift_rad.to_degrees()),
        }
    );
}

/// Originals are never written over, `--force` or not.
pub(super) fn require_no_photograph(place: &Path, shots: &Shots) -> Result<()> {
    let own = place.canonicalize().ok();
    let is_own = |shot: &Shot| own.is_some() && shot.path.canonicalize().ok() == own;
    match shots.shots.iter().any(is_own) {
        true => Err(Error::input(place, "is one of the photographs", "choose another name")),
        false => Ok(()),
    }
}

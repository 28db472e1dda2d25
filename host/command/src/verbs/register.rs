//! Where each view was taken from: `register`.

use rigel::calibration::{RegisterOptions, Registration, Squares, register as find};
use rigel::session::Session;
use rigel::view_file::Calibration;
use rigel::{Error, Result};

use crate::arguments::Register;
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::require_place;

/// `rigel register`.
pub fn register(arguments: &Register) -> Result<()> {
    let bar = Bar::new("registering");
    let session = Session::open(&arguments.session)?;
    // One that belongs to other radiance is of no use to anybody.
    let force = arguments.force || matches!(Registration::of(&session), Err(Error::Input { .. }));
    require_place(&Registration::path(&session), force)?;
    let squares = arguments.squares.as_ref().map(|path| Squares::read(path)).transpose()?;
    let lens = match &arguments.lens {
        Some(path) => {
            let calibration = Calibration::read(path, 0.0)?;
            let (width, height) = session.picture_size()?;
            Some((calibration.lens(width, height), calibration.covariance()))
        }
        None => None,
    };
    let registration = find(&session, &RegisterOptions { squares, lens }, &bar)
        .map_err(|error: Error| error.about(session.folder()))?;
    registration.write(&session)?;
    summarise(&registration, arguments.squares.is_some());
    say!("wrote {}", Registration::path(&session).display());
    Ok(())
}

fn summarise(registration: &Registration, measured: bool) {
    for note in &registration.notes {
        say!("warning: {note}");
    }
    for view in &registration.dropped {
        say!("warning: {} is left out: it {}", view.name, view.reason);
    }
    let by_texture = registration.views.iter().filter(|view| view.patches > 0).count();
    if measured || by_texture > 0 {
        let sigma = &registration.deviations;
        say!(
            "rig: pan and tilt are off by {:.3} and {:.3} degrees, the picture by {:.2}, {:.2} and {:.2} mm (standard deviations over the views)",
            sigma.pan_rad.to_degrees(),
            sigma.tilt_rad.to_degrees(),
            1e3 * sigma.shift_m[0],
            1e3 * sigma.shift_m[1],
            1e3 * sigma.shift_m[2]
        );
    }
    match (measured, by_texture) {
        (false, 0) => say!(
            "warning: without squares or texture nothing was measured: the views are where their commanded angles put them"
        ),
        (false, _) => say!(
            "{by_texture} of {} views are aligned by the surface's texture: with each other, and on the surface as the rig's axes have it",
            registration.views.len()
        ),
        (true, 0) => {}
        (true, _) => say!(
            "the surface's texture refines {by_texture} of {} views: squares that are left out are foretold better with it",
            registration.views.len()
        ),
    }
    let mut directions: Vec<f64> =
        registration.views.iter().map(|view| view.direction_sigma_rad().to_degrees()).collect();
    directions.sort_by(f64::total_cmp);
    if let (Some(middle), Some(worst)) = (directions.get(directions.len() / 2), directions.last()) {
        say!(
            "{} views registered: directions are sure to {middle:.3} degrees (median), {worst:.3} at worst",
            directions.len()
        );
    }
}

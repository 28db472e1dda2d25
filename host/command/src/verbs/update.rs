//! New photographs of a part of the room bring its map up to date: `update`.

use rigel::Result;
use rigel::environment::{EnvironmentMap, Pointing, Shots, update as bring_up};

use crate::arguments::Update;
use crate::progress::Bar;
use crate::say::{count_of, say};
use crate::verbs::mosaic::require_no_photograph;
use crate::verbs::{require_extension, require_place};

/// `rigel update`.
pub fn update(arguments: &Update) -> Result<()> {
    require_extension(&arguments.out, "exr")?;
    require_place(&arguments.out, arguments.force)?;
    arguments.photographs.require()?;
    let mut map = EnvironmentMap::read(&arguments.map)?;
    let shots = Shots::read(&arguments.shots)?;
    if arguments.same_unit {
        map.unit = shots.unit;
    }
    require_no_photograph(&arguments.out, &shots)?;
    let options = arguments.photographs.options(&shots.shots[0].path, map.size)?;
    let made = bring_up(&map, &shots, &options, arguments.threshold, &Bar::new("update"))
        .map_err(|error| error.about(&arguments.shots))?;
    for note in &made.new.notes {
        say!("note: {note}");
    }
    let change = |factor: [f64; 3], sigma: [f64; 3]| {
        let one =
            |c: usize| format!("{:+.2} ± {:.2} %", 100.0 * (factor[c] - 1.0), 100.0 * sigma[c] * factor[c]);
        [0, 1, 2].map(one).join(", ")
    };
    say!(
        "light, red, green and blue: {}; {}",
        change(made.factor, made.sigma),
        match made.is_changed {
            true => "the map was multiplied by it".into(),
            false => format!(
                "no more than {:.1} % or three standard deviations, so it was left as it is",
                100.0 * arguments.threshold
            ),
        }
    );
    for lamp in &made.lamps {
        let at = Pointing::of(lamp.direction);
        say!(
            "lamp at azimuth {:.0}, elevation {:.0}, {:.1} % of the map's light: {}",
            at.azimuth_rad.to_degrees(),
            at.elevation_rad.to_degrees(),
            100.0 * lamp.share,
            match lamp.factor {
                Some((factor, sigma)) => format!(
                    "{}; {}",
                    change(factor, sigma),
                    if lamp.is_own {
                        "multiplied by itself"
                    } else {
                        "not told apart from the rest, with which it goes"
                    }
                ),
                None =>
                    "not shown by half, saturated, or no brighter now than its doubt: it goes with the rest, and what was measured there stands where it differs"
                        .into(),
            }
        );
    }
    if made.doubted > 5e-4 {
        say!(
            "note: {:.1} % of the sphere saturated every photograph, though the map knows them darker; the map stands there: a shorter exposure would tell",
            100.0 * made.doubted
        );
    }
    made.map.write(&arguments.out)?;
    say!(
        "wrote {}: {}, {}, show {:.1} % of the sphere that were known; {:.1} % look different and were replaced, {:.1} % are new",
        arguments.out.display(),
        count_of(made.new.placed.len(), "photograph"),
        match made.turned_sigma_rad {
            Some(sigma) => format!(
                "turned by {:.2} ± {:.2} degrees to fit",
                made.turned_rad.to_degrees(),
                sigma.to_degrees()
            ),
            None => "as they were turned".into(),
        },
        100.0 * made.overlap,
        100.0 * made.replaced,
        100.0 * made.gained
    );
    Ok(())
}

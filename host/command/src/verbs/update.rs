//! New photographs of a part of the room bring its map up to date: `update`.

use rigel::Result;
use rigel::environment::{EnvironmentMap, Shots, update as bring_up};

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
    let map = EnvironmentMap::read(&arguments.map)?;
    let shots = Shots::read(&arguments.shots)?;
    require_no_photograph(&arguments.out, &shots)?;
    let options = arguments.photographs.options(&shots.shots[0].path, map.size)?;
    let made = bring_up(&map, &shots, &options, arguments.threshold, &Bar::new("update"))
        .map_err(|error| error.about(&arguments.shots))?;
    for note in &made.new.notes {
        say!("note: {note}");
    }
    let change =
        [0, 1, 2].map(|c| format!("{:+.2} ± {:.2} %", 100.0 * (made.factor[c] - 1.0), 100.0 * made.sigma[c]));
    say!(
        "light, red, green and blue: {}; {}",
        change.join(", "),
        match made.is_changed {
            true => "the whole map was multiplied by it".into(),
            false => format!(
                "no more than {:.1} % or three standard deviations, so it was left as it is",
                100.0 * arguments.threshold
            ),
        }
    );
    made.map.write(&arguments.out)?;
    say!(
        "wrote {}: {}, turned by {:.2} degrees to fit, show {:.1} % of the sphere that were known; {:.1} % look different and were replaced, {:.1} % are new",
        arguments.out.display(),
        count_of(made.new.placed.len(), "photograph"),
        made.turned_rad.to_degrees(),
        100.0 * made.overlap,
        100.0 * made.replaced,
        100.0 * made.gained
    );
    Ok(())
}

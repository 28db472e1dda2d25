//! From a map of the room to the few lights that matter: `lights`.

use rigel::environment::{EnvironmentMap, Method, Remainder, lights as find};
use rigel::{Result, file};

use crate::arguments::{LightMethod, Lights};
use crate::say::{count_of, say};
use crate::verbs::{require_extension, require_place};

/// `rigel lights`.
pub fn lights(arguments: &Lights) -> Result<()> {
    let name = format!("{}-lights.csv", arguments.map.file_stem().unwrap_or_default().to_string_lossy());
    let out = arguments.out.clone().unwrap_or_else(|| arguments.map.with_file_name(name));
    require_extension(&out, "csv")?;
    require_place(&out, arguments.force)?;
    let map = EnvironmentMap::read(&arguments.map)?;
    let method = match arguments.method {
        LightMethod::Joined => Method::Joined(Remainder::MOST_ORDER),
        LightMethod::MedianCut => Method::MedianCut,
    };
    let found = find(&map, method, arguments.tolerance, usize::from(arguments.most))
        .map_err(|error| error.about(&arguments.map))?;
    for light in &found.lights {
        let latitude = light.direction.y.clamp(-1.0, 1.0).asin().to_degrees();
        say!(
            "longitude {:7.2}, latitude {latitude:6.2} degrees: {:.5} sr, {:.1} % of the light{}",
            light.direction.x.atan2(light.direction.z).to_degrees(),
            light.solid_angle_sr,
            100.0 * light.share,
            if light.is_lower_bound { ", at least: photographs were saturated there" } else { "" }
        );
    }
    if found.unseen > 0.001 {
        say!("warning: {:.1} % of the sphere was never seen and counts as dark", 100.0 * found.unseen);
    }
    let is_open = found.open_error > found.error;
    if found.worst() > arguments.tolerance {
        say!(
            "warning: with {} the irradiance is {:.1} % off {}, more than the {:.1} % asked for, and no other number up to {} leaves less; allow more (--most){}",
            count_of(found.lights.len(), "light"),
            100.0 * found.worst(),
            if is_open { "where nothing is hidden" } else { "with walls" },
            100.0 * arguments.tolerance,
            arguments.most,
            if let LightMethod::Joined = arguments.method { ", or try --method median-cut" } else { "" }
        );
    }
    file::write_bytes(&out, found.csv().as_bytes())?;
    say!(
        "wrote {}: {} and a smooth remainder (harmonics of order {}), irradiance to {:.1} % where nothing is hidden, {:.1} % with walls ({} decides, {:.1} % asked for)",
        out.display(),
        count_of(found.lights.len(), "light"),
        found.remainder.order(),
        100.0 * found.open_error,
        100.0 * found.error,
        if is_open { "the former" } else { "the latter" },
        100.0 * arguments.tolerance
    );
    Ok(())
}

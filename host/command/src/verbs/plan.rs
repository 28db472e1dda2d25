//! `rigel plan`: which views next.

use rigel::geometry::azimuth_zenith;
use rigel::observation::ObservationMap;
use rigel::plan::{Expected, ViewPlan, candidates, plan_views};
use rigel::rig::Rig;
use rigel::{Error, Result};

use crate::arguments::Plan;
use crate::bench::greet_named;
use crate::progress::Bar;
use crate::say::{count_of, say};
use crate::verbs::require_extension;

/// A share of the error below which more views are not worth their time.
const LITTLE: f64 = 0.02;

/// `rigel plan`.
pub fn plan(arguments: &Plan) -> Result<()> {
    let map = ObservationMap::open(&arguments.observations)?;
    let out = arguments.out.clone().unwrap_or_else(|| arguments.observations.with_file_name("next.csv"));
    require_extension(&out, "csv")?;
    let is_plan = |out: &std::path::Path| {
        let first = std::fs::read_to_string(out).unwrap_or_default();
        first.starts_with("azimuth_deg,zenith_deg")
    };
    if out.exists() && !is_plan(&out) {
        return Err(Error::input(
            &out,
            "is there already, and is no plan",
            "choose another name, or delete it",
        ));
    }
    let limits = arguments.rig.as_deref().map(greet_named).transpose()?.map(|(rig, _)| rig.limits());
    let candidates = candidates(limits.as_ref(), arguments.zenith_limit_deg.to_radians())?;
    let mut plan = plan_views(&map, &candidates, arguments.views, &Bar::new("planning"))?;
    let taken = map.header().views.len();
    match &plan.expected {
        None => {
            say!(
                "warning: no lobe can be fitted to what {taken} views measured, so nothing is known of the error: these fill the largest gaps"
            );
        }
        Some(expected) => {
            say_expected(&plan, expected, taken);
            if let Some(tolerance) = arguments.tolerance {
                let enough = expected.sufficient(tolerance);
                say_enough(expected, enough, tolerance);
                plan.directions.truncate(enough.unwrap_or(arguments.views));
            }
        }
    }
    if plan.directions.is_empty() {
        let before = if out.exists() { "; the one that is there is of an earlier plan" } else { "" };
        say!("no further view is needed: wrote no {}{before}", out.display());
        return Ok(());
    }
    plan.write_csv(&out)?;
    say!(
        "wrote {}: {}; photograph with rigel capture SESSION --resume --directions {}",
        out.display(),
        count_of(plan.directions.len(), "view"),
        out.display()
    );
    Ok(())
}

/// A part of white, as `evaluate` tells errors.
fn of_255(part: f64) -> String {
    format!("{:.2}", 255.0 * part)
}

fn say_expected(plan: &ViewPlan, expected: &Expected, taken: usize) {
    let (now, after) = (expected.error(0), expected.error(plan.directions.len()));
    say!(
        "expected error of {}, root mean square: {} of 255 with the {} that there are, {} with {} more; {} of it no view removes (noise, and what the model does not say)",
        expected.model.name(),
        of_255(now),
        count_of(taken, "view"),
        of_255(after),
        plan.directions.len(),
        of_255(expected.lasting)
    );
    if expected.undetermined > 0.0 {
        say!(
            "{:.1} % of the texels have a lobe that the views do not determine: the plan probes around it",
            100.0 * expected.undetermined
        );
    }
    if now - after < LITTLE * now {
        say!(
            "more views would gain hardly anything: these lower the error by {:.1} %",
            100.0 * (1.0 - after / now)
        );
        return;
    }
    match expected.halving() {
        Some(count) => {
            let thickest = plan.thickest(count).filter(|(_, near)| *near > 1);
            let place = thickest.map_or(String::new(), |(centre, near)| {
                let (azimuth_rad, zenith_rad) = azimuth_zenith(centre);
                let (azimuth, zenith) = (azimuth_rad.to_degrees().rem_euclid(360.0), zenith_rad.to_degrees());
                format!(", {near} of them near azimuth {azimuth:.0}, zenith {zenith:.0},")
            });
            say!("{}{place} more would halve what views can remove", count_of(count, "view"));
        }
        None => {
            say!("more than {} more views would halve what views can remove", expected.removable.len() - 1);
        }
    }
}

fn say_enough(expected: &Expected, enough: Option<usize>, tolerance: f64) {
    let wished = of_255(tolerance);
    match enough {
        Some(count) => {
            say!("an error of {wished} of 255 needs {} more", count_of(count, "view"));
        }
        None if expected.lasting > tolerance => say!(
            "warning: no number of views brings the error to {wished} of 255: what remains is noise, and what the model does not say"
        ),
        None => say!(
            "warning: {} more views do not suffice for an error of {wished} of 255; plan again after these",
            expected.removable.len() - 1
        ),
    }
}

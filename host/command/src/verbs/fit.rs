//! From an observation map to pictures and errors: `fit`, `render`, `evaluate`.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec3;
use rigel::calibration::Photometry;
use rigel::evaluate::{evaluate as score, read_references, session_references};
use rigel::fit::{BANDS, FitFlags, FitOptions, Model, Reason, candidates};
use rigel::geometry::Texels;
use rigel::info::Kind;
use rigel::observation::ObservationMap;
use rigel::parameter_map::{
    Coarser, Diagnostics, ParameterMap, Selection, Within, coarser, coverage, fit_surface, select_surface,
    together,
};
use rigel::render::render as draw;
use rigel::session::Session;
use rigel::{Error, Result};

use crate::arguments::{Evaluate, Fit, Render};
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::{
    read_map, require_extension, require_place, require_place_of, session_views, views_by_name,
};

/// `rigel fit`.
pub fn fit(arguments: &Fit) -> Result<()> {
    let map = ObservationMap::open(&arguments.observations)?;
    let options = FitOptions { identified_only: arguments.identified_only, ..FitOptions::default() };
    let names = map.header().views.iter().map(|view| view.name.as_str());
    let without: Vec<u32> =
        views_by_name(names, &arguments.without, &arguments.observations.display().to_string())?
            .into_iter()
            .map(|view| view as u32)
            .collect();
    if (0..map.header().views.len() as u32).all(|view| without.contains(&view)) {
        return Err(Error::input(
            &arguments.observations,
            format!("has {} views, and --without leaves none of them", map.header().views.len()),
            "leave fewer out",
        ));
    }
    let model = single_model(arguments)?;
    let name = model.map_or_else(|| "auto".into(), |model| model.name());
    let out =
        arguments.out.clone().unwrap_or_else(|| arguments.observations.with_file_name(format!("{name}.exr")));
    require_extension(&out, "exr")?;
    require_place_of(&out, Kind::ParameterMap)?;
    let fitted = match model {
        Some(model) => fit_surface(&map, model, &options, &without, &Bar::new("fitting"))?,
        None => {
            let selection = Selection { fit: options, tolerance: arguments.tolerance.unwrap_or(0.0) as f32 };
            select_surface(&map, &candidates(), &selection, &without, &Bar::new("choosing and fitting"))?
        }
    };
    fitted.write(&out)?;
    say!("wrote {}: {}, {:.1} bytes per texel", out.display(), fitted.name(), fitted.bytes_per_texel());
    summarise(&fitted, arguments.identified_only);
    if model.is_none() {
        let selection = Selection { fit: options, tolerance: 0.0 };
        say_texels(&coarser(&map, &selection, &without, &Bar::new("trying coarser texels"))?);
    }
    if fitted.uncertainty.is_some() && !without.is_empty() {
        say_coverage(&fitted, &coverage(&fitted, &map, &without, &Bar::new("comparing"))?);
    }
    Ok(())
}

/// The model that is asked for; `None`: one for each texel.
fn single_model(arguments: &Fit) -> Result<Option<Model>> {
    let name = &arguments.model;
    if name == "auto" {
        return Ok(None);
    }
    let model = Model::parse(name).map_err(|error| match error {
        Error::Request { what, remedy } => {
            Error::Request { what, remedy: remedy.replace("choose one of", "choose auto or one of") }
        }
        other => other,
    })?;
    if arguments.tolerance.is_some() {
        return Err(Error::request(
            format!("--tolerance says nothing to --model {name}"),
            "leave it out, or let --model auto choose",
        ));
    }
    if arguments.identified_only && !matches!(model, Model::Phong { .. } | Model::SharedPhong { .. }) {
        return Err(Error::request(
            format!("--identified-only says nothing to --model {name}, which has no lobes"),
            "leave it out, or fit phong to phong4 or auto",
        ));
    }
    Ok(Some(model))
}

/// How fine texels the data support.
fn say_texels(coarser: &[Coarser]) {
    let name = |texels: Texels| format!("{}x{}", texels.columns, texels.rows);
    if let Some(enough) = coarser.iter().rfind(|coarser| coarser.suffices()) {
        say!("{} texels would predict unseen views as well", name(enough.texels));
    }
    if let Some(few) = coarser.iter().find(|coarser| !coarser.suffices()) {
        say!(
            "with {} texels the error in unseen views grows by {:.0} %",
            name(few.texels),
            100.0 * few.growth
        );
    }
}

/// Whether the stated doubt holds in the views that were left out.
fn say_coverage(fitted: &ParameterMap, counts: &[[Within; BANDS]]) {
    let percent = |within: Within| format!("{:.1} %", 100.0 * within.share());
    let all = together(counts.iter().flatten());
    say!(
        "of {} measurements in the views left out {} lie within one predicted standard deviation (68 % should)",
        all.all,
        percent(all)
    );
    let bands = (0..BANDS).map(|band| (band, together(counts.iter().map(|counts| &counts[band]))));
    let bands = bands.filter(|(_, within)| within.all > 0);
    let bands = bands.map(|(band, within)| format!("{}-{}: {}", 15 * band, 15 * band + 15, percent(within)));
    say!("  by zenith, degrees: {}", bands.collect::<Vec<_>>().join(", "));
    let models = fitted.models.iter().zip(counts).map(|(model, counts)| (model, together(counts)));
    let models = models.filter(|(_, within)| within.all > 0);
    let models = models.map(|(model, within)| format!("{}: {}", model.name(), percent(within)));
    say!("  by model: {}", models.collect::<Vec<_>>().join(", "));
}

/// What was chosen and why.
fn say_choices(fitted: &ParameterMap, diagnostics: &Diagnostics) {
    let count = fitted.choice.len() as f64;
    for (index, model) in fitted.models.iter().enumerate() {
        let chosen = fitted.choice.iter().filter(|choice| usize::from(**choice) == index).count();
        let share = 100.0 * chosen as f64 / count;
        say!("{:>14}: {share:5.1} % of the texels, {} bytes each", model.name(), model.bytes_per_texel());
    }
    let because = |wanted: Reason| {
        let texels = diagnostics.reason.iter().filter(|reason| **reason == wanted).count();
        100.0 * texels as f64 / count
    };
    say!(
        "why: {:.0} % predict unseen views best, {:.0} % hardly worse than a larger model, {:.0} % not worth a larger one, {:.0} % within the tolerance, {:.0} % as the texels around, {:.0} % have too few views for another",
        because(Reason::Best),
        because(Reason::Sufficient),
        because(Reason::Economy),
        because(Reason::Tolerance),
        because(Reason::Neighbours),
        because(Reason::Only)
    );
}

fn summarise(fitted: &ParameterMap, identified_only: bool) {
    let Some(diagnostics) = &fitted.diagnostics else { return };
    if !fitted.choice.is_empty() {
        say_choices(fitted, diagnostics);
    }
    if let Some(entries) = fitted.palette().iter().max() {
        let sharing = fitted.palette().iter().filter(|entry| **entry > 0).count();
        say!(
            "a palette of {entries} serves {:.0} % of the texels, which look alike",
            100.0 * sharing as f64 / fitted.palette().len() as f64
        );
    }
    let mut residuals = diagnostics.residual.clone();
    residuals.sort_by(f32::total_cmp);
    say!(
        "residual over expected error: median {:.2}, 95 % of the texels below {:.2}",
        residuals[residuals.len() / 2],
        residuals[residuals.len() * 95 / 100]
    );
    for (flag, meaning) in [
        (FitFlags::NO_VIEWS, "were not measured by any view and are black"),
        (
            FitFlags::TOO_FEW_VIEWS,
            "were measured by fewer views than the model has unknowns and are constant",
        ),
        (FitFlags::AT_BOUND, "have a parameter at its bound"),
        (FitFlags::NOT_CONVERGED, "did not converge"),
        (FitFlags::HELD, "would have had negative radiance somewhere and were held above zero"),
        (
            FitFlags::UNIDENTIFIED,
            if identified_only {
                "had a highlight that their views do not determine: it is left out there"
            } else {
                "have a highlight that their views do not determine: what lies between the views is a guess there"
            },
        ),
    ] {
        let count = diagnostics.flags.iter().filter(|flags| flags.contains(flag)).count();
        if count > 0 {
            say!("warning: {count} of {} texels {meaning} (see the channel `fit.flags`)", residuals.len());
        }
    }
}

/// The views' zenith angles are those from the surface's centre; a place beside it sees them a little lower.
const BEYOND_RAD: f64 = 0.05;

/// `rigel render`.
pub fn render(arguments: &Render) -> Result<()> {
    let extension = extension(&arguments.out);
    if !["exr", "png"].contains(&extension.as_str()) {
        return Err(Error::input(
            &arguments.out,
            format!("'{extension}' is no picture format that this writes"),
            "name a .png or .exr file",
        ));
    }
    require_place(&arguments.out, arguments.force)?;
    let map = read_map(&arguments.map)?;
    let (lens, pose) = arguments.camera.place(&map.surface)?;
    let lowest_rad = map.diagnostics.as_ref().and_then(|diagnostics| diagnostics.zenith_rad);
    let lowest_z = lowest_rad.map_or(0.0, |zenith_rad| (zenith_rad + BEYOND_RAD).cos() as f32);
    let (drawn, beyond) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let radiance = |point, direction: Vec3| {
        drawn.fetch_add(1, Ordering::Relaxed);
        beyond.fetch_add(usize::from(direction.z < lowest_z), Ordering::Relaxed);
        map.radiance_at(map.surface.texel_at(map.texels, point), direction)
    };
    let rendering = draw(&map.surface, &lens, &pose, radiance, &Bar::new("rendering"))?;
    if extension == "exr" {
        rendering.write_exr(&arguments.out)?;
    } else {
        let gamma = arguments.camera.gamma_for(&rendering, &arguments.out)?;
        rendering.write_png(&arguments.out, gamma)?;
    }
    say!("wrote {}: {}x{} pixels", arguments.out.display(), lens.width, lens.height);
    if let (Some(lowest_rad), beyond @ 1..) = (lowest_rad, beyond.into_inner()) {
        say!(
            "warning: {:.1} % of the surface's pixels are extrapolated: they look from farther down than any view did (zenith {:.1} degrees)",
            100.0 * beyond as f64 / drawn.into_inner() as f64,
            lowest_rad.to_degrees()
        );
    }
    Ok(())
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// What is to be said of a map that was fitted to some of the views with which it is now compared.
fn seen_by_fit(map: &ParameterMap, session: &Session, references: &[usize]) -> Option<String> {
    let seen = &map.diagnostics.as_ref()?.seen;
    if seen.is_empty() {
        return Some("the map does not say which views its fit has seen".into());
    }
    let names = references.iter().map(|&view| &session.manifest.views[view].name);
    let both: Vec<&str> = names.filter(|name| seen.contains(name)).map(String::as_str).collect();
    let which = match both.as_slice() {
        [] => return None,
        all if all.len() == references.len() => "all of these views".into(),
        some => some.join(", "),
    };
    Some(format!("the fit has seen {which}, so the errors flatter it; fit --without them"))
}

/// The light by which the references are divided must be that of the views that were fitted.
fn require_the_same_light(arguments: &Evaluate, map: &ParameterMap, session: &Session) -> Result<()> {
    let of_map = map.diagnostics.as_ref().map(|diagnostics| &diagnostics.photometry);
    let of_session = Photometry::of(session)?.and_then(|photometry| photometry.hash());
    match of_map {
        Some(of_map) if *of_map != of_session => Err(Error::input(
            &arguments.map,
            format!(
                "was fitted under another lamp or vignetting than the session's {} tells",
                Photometry::path(session).display()
            ),
            "run `rigel observe` with the same options as for this map again, or fit again",
        )),
        _ => Ok(()),
    }
}

/// `rigel evaluate`.
pub fn evaluate(arguments: &Evaluate) -> Result<()> {
    let stem = arguments.map.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let out = arguments.out.clone().unwrap_or_else(|| arguments.map.with_file_name(format!("{stem}-errors")));
    if out.join("session.toml").exists() {
        return Err(Error::input(&out, "is a session", "choose a folder of its own for the errors"));
    }
    if out.is_file() {
        return Err(Error::input(&out, "is a file", "name a folder for the errors"));
    }
    require_place(&if out.is_dir() { out.join("errors.csv") } else { out.clone() }, true)?;
    let map = read_map(&arguments.map)?;
    let mut seen = None;
    let references = match (&arguments.references, &arguments.session) {
        (Some(list), _) => read_references(list, arguments.pixel_centre)?,
        (None, Some(folder)) => {
            let session = Session::open(folder)?;
            let views = session_views(&session, &arguments.views)?;
            seen = seen_by_fit(&map, &session, &views);
            let references = session_references(&session, &views).map_err(|error| error.about(folder))?;
            require_the_same_light(arguments, &map, &session)?;
            references
        }
        (None, None) => {
            return Err(Error::request(
                "there is nothing to compare with",
                "give --references LIST or --session FOLDER",
            ));
        }
    };
    let evaluation = score(&map, &references, &Bar::new("evaluating"))?;
    say!("{:<16} {:>8} {:>12} {:>8} {:>16}", "view", "pixels", "mean of 255", "PSNR dB", "median relative");
    for view in &evaluation.views {
        say!(
            "{:<16} {:>8} {:>12.2} {:>8.2} {:>14.2} %",
            view.name,
            view.pixels,
            view.mean_255,
            view.psnr_db,
            100.0 * view.median_relative
        );
    }
    say!(
        "{:<16} {:>8} {:>12.2} {:>8.2} {:>14.2} %",
        "mean",
        "",
        evaluation.mean_255(),
        evaluation.psnr_db(),
        100.0 * evaluation.median_relative()
    );
    if let Some(seen) = seen {
        say!("warning: {seen}");
    } else if arguments.references.is_none()
        && map.diagnostics.as_ref().is_some_and(|diagnostics| diagnostics.photometry.is_some())
    {
        say!(
            "note: the lamp's gain in each of these views, or the vignetting, was found with their help (photometry.toml)"
        );
    }
    evaluation.write(&out)?;
    say!("wrote {}: errors.csv and a picture for each view (seen, predicted, difference x 4)", out.display());
    Ok(())
}

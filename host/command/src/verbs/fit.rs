//! From an observation map to pictures and errors: `fit`, `render`, `evaluate`.

use std::path::Path;

use rigel::evaluate::{evaluate as score, read_references, session_references};
use rigel::fit::{FitFlags, FitOptions, Model, candidates, choose_model};
use rigel::geometry::{Lens, Pose};
use rigel::observation::ObservationMap;
use rigel::parameter_map::{ParameterMap, fit_surface};
use rigel::render::{gamma_for_median, render as draw};
use rigel::session::Session;
use rigel::view_file::read_camera;
use rigel::{Error, Result};

use crate::arguments::{Evaluate, Fit, Render};
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::{require_extension, session_views, views_by_name};

/// `rigel fit`.
pub fn fit(arguments: &Fit) -> Result<()> {
    let map = ObservationMap::open(&arguments.observations)?;
    let options = FitOptions::default();
    let names = map.header().views.iter().map(|view| view.name.as_str());
    let without: Vec<u32> =
        views_by_name(names, &arguments.without, &arguments.observations.display().to_string())?
            .into_iter()
            .map(|view| view as u32)
            .collect();
    let model = match arguments.model.as_str() {
        "auto" => choose(&map, &without, &options)?,
        name => Model::parse(name)?,
    };
    let out = arguments
        .out
        .clone()
        .unwrap_or_else(|| arguments.observations.with_file_name(format!("{}.exr", model.name())));
    require_extension(&out, "exr")?;
    let fitted = fit_surface(&map, model, &options, &without, &Bar::new("fitting"))?;
    fitted.write(&out)?;
    say!("wrote {}: {}, {} bytes per texel", out.display(), model.name(), model.bytes_per_texel());
    summarise(&fitted);
    Ok(())
}

/// The smallest model that predicts held-out views about as well as the best one, and says why.
fn choose(map: &ObservationMap, without: &[u32], options: &FitOptions) -> Result<Model> {
    let ranking = choose_model(&map.sample(without)?, &candidates(), options, &Bar::new("choosing"))
        .map_err(|error| error.about(map.path()))?;
    for candidate in &ranking {
        say!(
            "{:>14}: predicts held-out views within {:.2} %, {} bytes per texel",
            candidate.model.name(),
            100.0 * candidate.held_out_error,
            candidate.bytes_per_texel
        );
    }
    Ok(ranking[0].model)
}

fn summarise(fitted: &ParameterMap) {
    let Some(diagnostics) = &fitted.diagnostics else { return };
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
    ] {
        let count = diagnostics.flags.iter().filter(|flags| flags.contains(flag)).count();
        if count > 0 {
            say!("warning: {count} of {} texels {meaning} (see the channel `fit.flags`)", residuals.len());
        }
    }
}

/// `rigel render`.
pub fn render(arguments: &Render) -> Result<()> {
    let map = ParameterMap::read(&arguments.map)?;
    let (lens, pose) = match &arguments.camera {
        Some(path) => read_camera(path, arguments.pixel_centre)?,
        None => {
            let (width, height) = (map.surface.width_m, map.surface.height_m);
            let distance_m = arguments.distance.unwrap_or(4.0 * width.max(height));
            // The surface's diagonal fits the picture's shorter side, however it is turned.
            let pixels = f64::from(arguments.size.columns.min(arguments.size.rows));
            let focal_px = 0.95 * pixels * distance_m / width.hypot(height);
            let lens = Lens::pinhole(arguments.size.columns, arguments.size.rows, focal_px);
            (lens, Pose::from_rig(arguments.pan.to_radians(), arguments.tilt.to_radians(), distance_m))
        }
    };
    let radiance = |point, direction| map.radiance_at(map.surface.texel_at(map.texels, point), direction);
    let rendering = draw(&map.surface, &lens, &pose, radiance, &Bar::new("rendering"))?;
    match extension(&arguments.out).as_str() {
        "exr" => rendering.write_exr(&arguments.out)?,
        "png" => {
            let inside = rendering.inside.iter().zip(&rendering.radiance).filter(|(inside, _)| **inside);
            let values: Vec<f32> = inside.flat_map(|(_, radiance)| *radiance).collect();
            let gamma = arguments.gamma.map_or_else(|| gamma_for_median(&values), Ok)?;
            rendering.write_png(&arguments.out, gamma)?;
        }
        other => {
            return Err(Error::input(
                &arguments.out,
                format!("'{other}' is no picture format that this writes"),
                "name a .png or .exr file",
            ));
        }
    }
    say!("wrote {}: {}x{} pixels", arguments.out.display(), lens.width, lens.height);
    Ok(())
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// `rigel evaluate`.
pub fn evaluate(arguments: &Evaluate) -> Result<()> {
    let map = ParameterMap::read(&arguments.map)?;
    let references = match (&arguments.references, &arguments.session) {
        (Some(list), _) => read_references(list, arguments.pixel_centre)?,
        (None, Some(folder)) => {
            let session = Session::open(folder)?;
            let views = session_views(&session, &arguments.views)?;
            session_references(&session, &views).map_err(|error| error.about(folder))?
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
    let stem = arguments.map.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let out = arguments.out.clone().unwrap_or_else(|| arguments.map.with_file_name(format!("{stem}-errors")));
    if out.join("session.toml").exists() {
        return Err(Error::input(&out, "is a session", "choose a folder of its own for the errors"));
    }
    evaluation.write(&out)?;
    say!("wrote {}: errors.csv and a picture for each view (seen, predicted, difference x 4)", out.display());
    Ok(())
}

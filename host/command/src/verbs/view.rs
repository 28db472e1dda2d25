//! `rigel view`: maps on a graphics device.

use std::path::Path;

use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render;
use rigel::shader::Look;
use rigel::{Error, Result, file};
use rigel_view::{Graphics, PICTURE, Scene, Shading};

use crate::arguments::{ShadingChoice, View};
use crate::say::say;
use crate::verbs::{require_extension, require_place};

/// `rigel view`.
pub fn view(arguments: &View) -> Result<()> {
    if let Some(out) = &arguments.screenshot {
        require_extension(out, "png")?;
        require_place(out, arguments.force)?;
    }
    let maps: Vec<ParameterMap> =
        arguments.maps.iter().map(|path| ParameterMap::read(path)).collect::<Result<_>>()?;
    let view = first_view(arguments, &maps[0])?;
    match &arguments.screenshot {
        Some(out) => screenshot(&maps[0], &view, out),
        None => Err(Error::request("no window is built in yet", "give --headless --screenshot FILE")),
    }
}

fn first_view(arguments: &View, map: &ParameterMap) -> Result<rigel_view::View> {
    let (lens, pose) = arguments.camera.place(&map.surface)?;
    let shading = match arguments.shading {
        ShadingChoice::Automatic => Shading::Automatic,
        ShadingChoice::ByPixel => Shading::ByPixel,
        ShadingChoice::ByTexel => Shading::ByTexel,
    };
    let gamma = match arguments.camera.gamma {
        Some(gamma) => gamma,
        None => {
            // A small picture has the same median.
            let by = (lens.width.max(lens.height) / 200).max(1);
            let small = lens.scaled_to((lens.width / by).max(1), (lens.height / by).max(1));
            let radiance =
                |point, direction| map.radiance_at(map.surface.texel_at(map.texels, point), direction);
            let rendering = render::render(&map.surface, &small, &pose, radiance, &Silent)?;
            let out = arguments.screenshot.as_deref().unwrap_or(&arguments.maps[0]);
            arguments.camera.gamma_for(&rendering, out)?
        }
    };
    let look = Look { gamma, false_colour: arguments.false_colour, beside: [0.0; 3] };
    Ok(rigel_view::View { lens, pose, look, shading })
}

fn screenshot(map: &ParameterMap, view: &rigel_view::View, out: &Path) -> Result<()> {
    let graphics = Graphics::open()?;
    let scene = Scene::new(&graphics, map, PICTURE)?;
    let levels = scene.picture(&graphics, view)?;
    let png = render::png(view.lens.width, view.lens.height, levels.as_flattened())?;
    file::write_bytes(out, &png)?;
    let how = if scene.is_by_texel(view) { "by texel" } else { "by pixel" };
    say!(
        "wrote {}: {}x{} pixels, shaded {how} on {}",
        out.display(),
        view.lens.width,
        view.lens.height,
        graphics.name()
    );
    Ok(())
}

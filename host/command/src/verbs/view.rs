//! `rigel view`: maps on a graphics device.

use std::path::Path;

use rigel::evaluate::session_references;
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render;
use rigel::session::Session;
use rigel::shader::Look;
use rigel::{Error, Result, file};
use rigel_view::{Graphics, KEYS, PICTURE, Scene, Shading, Show, open};

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
    if let Some(out) = arguments.screenshot.as_ref().filter(|_| arguments.headless) {
        return screenshot(&maps[0], &view, out);
    }
    let session = arguments.session.as_deref().map(Session::open).transpose()?;
    let seen = session.as_ref().map_or_else(Vec::new, Session::done_views);
    let names =
        arguments.maps.iter().map(|path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned());
    KEYS.iter().for_each(|line| say!("{line}"));
    open(Show {
        maps: names.zip(maps).collect(),
        view,
        photographs: seen.len(),
        photograph: Box::new(move |index| {
            let session = session
                .as_ref()
                .ok_or_else(|| Error::request("no session to step through", "give --session"))?;
            let mut reference = session_references(session, &seen[index..=index])?;
            reference
                .pop()
                .ok_or_else(|| Error::request("the view has no photograph", "run `rigel radiance`"))
        }),
        screenshot: arguments.screenshot.clone().unwrap_or_else(|| "rigel-view.png".into()),
        at_once: arguments.screenshot.is_some(),
    })
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

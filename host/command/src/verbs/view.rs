//! `rigel view`: maps on a graphics device.

use std::path::Path;

use rigel::calibration::{Registration, view_geometry};
use rigel::evaluate::{Reference, comparable_views, session_references};
use rigel::geometry::azimuth_zenith;
use rigel::observation::ObservationMap;
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::render;
use rigel::session::Session;
use rigel::shader::Look;
use rigel::{Error, Result, file};
use rigel_view::{
    FAR_PX, Graphics, KEYS, PANEL, PICTURE, Profile, Raster, Scene, Shading, Shift, Show, open,
};

use crate::arguments::{ShadingChoice, View};
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::{read_map, require_extension, require_place};

/// Columns of a contact sheet.
const COLUMNS: usize = 10;

/// `rigel view`.
pub fn view(arguments: &View) -> Result<()> {
    for out in arguments.screenshot.iter().chain(&arguments.contact_sheet) {
        require_extension(out, "png")?;
        require_place(out, arguments.force)?;
    }
    let maps: Vec<ParameterMap> = arguments.maps.iter().map(|path| read_map(path)).collect::<Result<_>>()?;
    if let Some((column, row)) = arguments.texel {
        let texels = maps[0].texels;
        if column >= texels.columns || row >= texels.rows {
            return Err(Error::input(
                &arguments.maps[0],
                format!("has {}x{} texels and none at {column},{row}", texels.columns, texels.rows),
                format!("give --texel from 0,0 to {},{}", texels.columns - 1, texels.rows - 1),
            ));
        }
    }
    let view = first_view(arguments, &maps[0])?;
    let session = arguments.session.as_deref().map(Session::open).transpose()?;
    if let (Some(out), Some(session)) = (&arguments.contact_sheet, &session) {
        return contact_sheet(&maps[0], session, &view, out);
    }
    let observations = session.as_ref().map(observations).transpose()?.flatten();
    if let Some(out) = arguments.screenshot.as_ref().filter(|_| arguments.headless) {
        let profile =
            arguments.texel.map(|texel| Profile::new(&maps[0], texel, observations.as_ref())).transpose()?;
        return screenshot(&maps[0], &view, arguments.texel.zip(profile.as_ref()), out);
    }
    let views = session.as_ref().map(comparable_views).transpose()?.unwrap_or_default();
    let names =
        arguments.maps.iter().map(|path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned());
    KEYS.iter().for_each(|(key, what)| say!("{key:<13}{what}"));
    open(Show {
        maps: names.zip(maps).collect(),
        view,
        photographs: views.len(),
        photograph: Box::new(move |index| {
            let session = session
                .as_ref()
                .ok_or_else(|| Error::request("no session to step through", "give --session"))?;
            reference(session, views[index])
        }),
        observations,
        texel: arguments.texel,
        screenshot: arguments.screenshot.clone().unwrap_or_else(|| "rigel-view.png".into()),
        at_once: arguments.screenshot.is_some(),
    })
}

/// What the session's views measured of each texel, where `rigel observe` has gathered it.
fn observations(session: &Session) -> Result<Option<ObservationMap>> {
    let path = session.folder().join("observations.rigel");
    path.exists().then(|| ObservationMap::open(&path)).transpose()
}

fn reference(session: &Session, view: usize) -> Result<Reference> {
    let reference = session_references(session, &[view])?.pop();
    reference.ok_or_else(|| Error::request("the view has no photograph", "run `rigel radiance`"))
}

fn contact_sheet(map: &ParameterMap, session: &Session, view: &rigel_view::View, out: &Path) -> Result<()> {
    let graphics = Graphics::open()?;
    let views = comparable_views(session)?;
    let registration = Registration::of(session)?;
    let zenith_deg = |&view: &usize| {
        let (_, pose) = view_geometry(session, registration.as_ref(), view)?;
        Ok(azimuth_zenith(pose.centre_m).1.to_degrees())
    };
    let zeniths_deg: Vec<f64> = views.iter().map(zenith_deg).collect::<Result<_>>()?;
    let chosen = rigel_view::spread(&zeniths_deg, COLUMNS);
    let references = chosen.iter().map(|&index| reference(session, views[index]));
    let sheet = rigel_view::contact_sheet(&graphics, map, references, view, &Bar::new("drawing"))?;
    write(&sheet.picture, out)?;
    for flipped in &sheet.views {
        let shift = match flipped.shift_px {
            Shift::By(shift) => format!("shifted by {:+.2}, {:+.2} pixels", shift.x, shift.y),
            Shift::Far => format!("shifted by more than {FAR_PX:.0} pixels"),
            Shift::Untold => "its shift cannot be told".into(),
        };
        let unseen = if flipped.was_seen == Some(false) { ", which the fit has not seen" } else { "" };
        say!(
            "{}, zenith {:.0} degrees{unseen}: {:.2} of 255, {shift}",
            flipped.name,
            flipped.zenith_deg,
            flipped.mean_255
        );
    }
    say!("wrote {}: {}x{} pixels", out.display(), sheet.picture.width, sheet.picture.height);
    Ok(())
}

fn write(picture: &Raster, out: &Path) -> Result<()> {
    let png = render::png(picture.width, picture.height, picture.levels().as_flattened())?;
    file::write_bytes(out, &png)
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
            let named = arguments.screenshot.as_deref().or(arguments.contact_sheet.as_deref());
            let out = named.unwrap_or(&arguments.maps[0]);
            arguments.camera.gamma_for(&rendering, out)?
        }
    };
    let look = Look { gamma, false_colour: arguments.false_colour, beside: [0.0; 3] };
    Ok(rigel_view::View { lens, pose, look, shading, halvings: 0 })
}

fn screenshot(
    map: &ParameterMap,
    view: &rigel_view::View,
    beside: Option<((u32, u32), &Profile)>,
    out: &Path,
) -> Result<()> {
    let graphics = Graphics::open()?;
    let scene = Scene::new(&graphics, map, PICTURE)?;
    let levels = scene.picture(&graphics, view)?;
    let size = (view.lens.width, view.lens.height);
    let panel = beside.map_or((0, 0), |_| PANEL);
    let mut picture = Raster::new(size.0 + panel.0, size.1.max(panel.1));
    picture.picture((0, 0), size, &levels, size);
    if let Some(((column, row), profile)) = beside {
        if let Some(place) = view.place_of(map.surface.texel_centre(map.texels, column, row)) {
            picture.ring(place, 1);
        }
        picture.place((size.0 as i32, 0), &profile.draw((PANEL.0, picture.height), 1));
    }
    write(&picture, out)?;
    let how = if scene.is_by_texel(view) { "by texel" } else { "by pixel" };
    say!(
        "wrote {}: {}x{} pixels, shaded {how} on {}",
        out.display(),
        picture.width,
        picture.height,
        graphics.name()
    );
    Ok(())
}

//! Maps of the simulated patchwork for every model, and the cameras of the patchwork capture's evaluation views.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use glam::DVec3;
use rigel::fit::{FitOptions, Fitter, Model};
use rigel::geometry::{Lens, Pose, Surface, Texels};
use rigel::observation::TexelObservations;
use rigel::parameter_map::{Diagnostics, ParameterMap};
use rigel::sampling::spiral;
use rigel::view_file::ReferenceFile;
use rigel_simulated::scene::Scene;

/// Directions enough for a hundred coefficients.
const DIRECTIONS: usize = 160;

/// What every texel shows in many directions.
pub fn observed(texels: Texels) -> (Surface, Vec<TexelObservations>) {
    let (scene, directions) = (Scene::patchwork(), spiral(DIRECTIONS, 75f64.to_radians()).unwrap());
    let surface = scene.surface();
    let look = |index: u32| {
        let point = surface.texel_centre(texels, index % texels.columns, index / texels.columns);
        TexelObservations {
            view: (0..directions.len() as u32).collect(),
            direction: directions.iter().map(|d| d.as_vec3()).collect(),
            radiance: directions.iter().map(|&d| scene.radiance(point, d).map(|l| l as f32)).collect(),
            sigma: vec![0.0; directions.len()],
        }
    };
    (surface, (0..texels.count() as u32).map(look).collect())
}

/// A model fitted to every texel.
pub fn fitted(
    surface: Surface,
    texels: Texels,
    model: Model,
    observed: &[TexelObservations],
) -> ParameterMap {
    let sample: Vec<_> = observed.iter().step_by(7).cloned().collect();
    let fitter = Fitter::new(model, &FitOptions::default(), &sample).unwrap();
    let fits: Vec<_> =
        observed.chunks(256).flat_map(|some| fitter.fit_tile(&some.iter().collect::<Vec<_>>())).collect();
    ParameterMap {
        surface,
        texels,
        models: vec![model],
        choice: vec![],
        parameters: fits.iter().flat_map(|fit| fit.parameters.clone()).collect(),
        diagnostics: None,
        uncertainty: None,
    }
}

/// The same with every texel divided into `parts` x `parts`: as much to draw, and less to fit.
#[allow(dead_code, reason = "not every test needs it")]
pub fn finer(map: &ParameterMap, parts: u32) -> ParameterMap {
    let texels = Texels { columns: map.texels.columns * parts, rows: map.texels.rows * parts };
    let index = |i: u32| (i % texels.columns / parts, i / texels.columns / parts);
    let of = |i: u32| map.texel(index(i).0, index(i).1).1.to_vec();
    ParameterMap { texels, parameters: (0..texels.count() as u32).flat_map(of).collect(), ..map.clone() }
}

#[allow(dead_code, reason = "not every test needs it")]
/// One map whose texels have a model each, in turn; the first row's texels share a palette entry.
pub fn mixed(maps: &[ParameterMap]) -> ParameterMap {
    let models: Vec<Model> = maps.iter().map(|map| map.models[0]).collect();
    let texels = maps[0].texels;
    let stride = models.iter().map(Model::parameter_count).max().unwrap();
    let (mut choice, mut parameters) = (vec![], vec![0.0; stride * texels.count()]);
    let in_palette = |index: usize| index < texels.columns as usize;
    for index in 0..texels.count() {
        let of = if in_palette(index) { 1 } else { (index + index / texels.columns as usize) % maps.len() };
        let from = if in_palette(index) { 0 } else { index as u32 };
        let (_, own) = maps[of].texel(from % texels.columns, from / texels.columns);
        parameters[index * stride..][..own.len()].copy_from_slice(own);
        choice.push(of as u8);
    }
    let palette = (0..texels.count()).map(|index| u8::from(in_palette(index))).collect();
    let diagnostics = Diagnostics { palette, ..Diagnostics::default() };
    ParameterMap {
        surface: maps[0].surface,
        texels,
        models,
        choice,
        parameters,
        diagnostics: Some(diagnostics),
        uncertainty: None,
    }
}

#[allow(dead_code, reason = "not every test needs it")]
/// The patchwork's evaluation cameras.
pub fn cameras() -> Option<Vec<(Lens, Pose)>> {
    let list = rigel_tests::data("multiview/patchwork")?.join("truth/eval.json");
    let views = ReferenceFile::read_list(&list, 0.5).unwrap();
    Some(views.into_iter().map(|view| (view.lens(640, 480), view.pose)).collect())
}

/// A camera that sees all of the patchwork and is no photograph's.
#[allow(dead_code, reason = "not every test needs it")]
pub fn oblique() -> (Lens, Pose) {
    let lens = Lens { k1: -0.2, k2: 0.1, p1: 1e-3, p2: -5e-4, ..Lens::pinhole(320, 240, 600.0) };
    (lens, Pose::from_axes(DVec3::new(0.2, -0.35, 0.3), DVec3::new(-0.2, 0.35, -0.3), DVec3::Z))
}

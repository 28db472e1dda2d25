//! What the graphics processor draws is what the processor draws, for every model.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;

use common::{cameras, finer, fitted, mixed, oblique, observed};
use rigel::emitter::Floor;
use rigel::evaluate::Reference;
use rigel::fit::Model;
use rigel::geometry::{Lens, Pose, Surface, Texels};
use rigel::parameter_map::ParameterMap;
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::render::{Rendering, gamma_for_median, render};
use rigel::shader::Look;
use rigel_view::{Graphics, PICTURE, Scene, Shading, View, contact_sheet};

const TEXELS: Texels = Texels { columns: 20, rows: 15 };

fn graphics() -> Option<Graphics> {
    match Graphics::open() {
        Ok(graphics) => Some(graphics),
        Err(error) => {
            assert!(std::env::var_os("CI").is_none(), "{error}");
            eprintln!("skipped: {error}");
            None
        }
    }
}

fn truth(map: &ParameterMap, lens: &Lens, pose: &Pose) -> Rendering {
    let radiance = |point, direction| map.radiance_at(map.surface.texel_at(map.texels, point), direction);
    render(&map.surface, lens, pose, radiance, &Silent).unwrap()
}

fn look(truth: &Rendering) -> Look {
    let inside = truth.inside.iter().zip(&truth.radiance).filter(|(inside, _)| **inside);
    let values: Vec<f32> = inside.flat_map(|(_, radiance)| *radiance).collect();
    Look { gamma: gamma_for_median(&values).unwrap(), false_colour: false, beside: [0.0; 3] }
}

/// Mean and largest difference of 255, over the pixels that are not beside the edge of the surface.
fn difference(truth: &Rendering, gamma: f32, picture: &[[u8; 3]]) -> (f64, f64) {
    let width = truth.width as usize;
    let (mut sum, mut count, mut most) = (0.0, 0.0, 0f64);
    for (i, pixel) in picture.iter().enumerate().take(picture.len() - width - 1).skip(width + 1) {
        if [i, i - 1, i + 1, i - width, i + width].iter().all(|&j| truth.inside[j]) {
            for (radiance, seen) in truth.radiance[i].iter().zip(pixel) {
                let level = (255.0 * rigel::render::expose(*radiance, gamma)).round();
                let off = f64::from((level - f32::from(*seen)).abs());
                (sum, count, most) = (sum + off, count + 1.0, most.max(off));
            }
        }
    }
    assert!(count > 10_000.0, "{count} levels");
    (sum / count, most)
}

#[test]
fn every_model_looks_as_the_processor_draws_it() {
    let (Some(graphics), Some(cameras)) = (graphics(), cameras()) else { return };
    println!("on {}", graphics.name());
    let (surface, observed) = observed(TEXELS);
    let mut maps: Vec<ParameterMap> =
        Model::all().into_iter().map(|model| finer(&fitted(surface, TEXELS, model, &observed), 4)).collect();
    maps.push(mixed(&maps));
    let mut bad = vec![];
    for (i, map) in maps.iter().enumerate() {
        let (lens, pose) = cameras[i % cameras.len()];
        let truth = truth(map, &lens, &pose);
        let look = look(&truth);
        let scene = Scene::new(&graphics, map, PICTURE).unwrap();
        for shading in [Shading::ByPixel, Shading::ByTexel] {
            let picture = scene.picture(&graphics, &View { lens, pose, look, shading, halvings: 0 }).unwrap();
            let (mean, most) = difference(&truth, look.gamma, &picture);
            let name = if map.models.len() == 1 { map.name() } else { "mixed, with a palette".into() };
            println!("{name:>22} {shading:?}: mean {mean:.3}, maximum {most} of 255");
            if mean > 0.5 || most > 4.0 {
                bad.push(format!("{name} {shading:?}: mean {mean:.3}, maximum {most}"));
            }
        }
    }
    assert!(bad.is_empty(), "{bad:#?}");
}

#[test]
fn a_lens_that_bends_lines_bends_them_alike() {
    let Some(graphics) = graphics() else { return };
    let (surface, observed) = observed(TEXELS);
    let map = fitted(surface, TEXELS, Model::Phong { lobes: 1 }, &observed);
    let (lens, pose) = oblique();
    let truth = truth(&map, &lens, &pose);
    let look = look(&truth);
    let scene = Scene::new(&graphics, &map, PICTURE).unwrap();
    let picture =
        scene.picture(&graphics, &View { lens, pose, look, shading: Shading::ByPixel, halvings: 0 }).unwrap();
    let (mean, most) = difference(&truth, look.gamma, &picture);
    assert!(mean <= 0.5 && most <= 4.0, "mean {mean}, maximum {most}");
    // Beside the surface nothing is seen, and the same pixels are beside it.
    let wrong =
        truth.inside.iter().zip(&picture).filter(|(inside, pixel)| !**inside && **pixel != [0; 3]).count();
    assert!(wrong <= 8, "{wrong} pixels beside the surface are not black");
}

#[test]
fn from_below_and_edge_on_nothing_is_seen() {
    let Some(graphics) = graphics() else { return };
    let (surface, observed) = observed(Texels { columns: 4, rows: 3 });
    let map = fitted(surface, Texels { columns: 4, rows: 3 }, Model::Constant, &observed);
    let scene = Scene::new(&graphics, &map, PICTURE).unwrap();
    let lens = Lens::pinhole(64, 48, 80.0);
    let look = Look { gamma: 1.0, false_colour: false, beside: [1.0, 0.0, 0.0] };
    for centre in [glam::DVec3::new(0.0, -0.3, -0.2), glam::DVec3::new(0.0, -0.5, 0.0)] {
        let pose = Pose::from_axes(centre, -centre, glam::DVec3::Z);
        for shading in [Shading::ByPixel, Shading::ByTexel] {
            let picture = scene.picture(&graphics, &View { lens, pose, look, shading, halvings: 0 }).unwrap();
            assert!(picture.iter().all(|pixel| *pixel == [255, 0, 0]), "{centre}");
        }
    }
}

#[test]
fn far_away_a_surface_has_its_mean_colour_and_does_not_flicker() {
    let Some(graphics) = graphics() else { return };
    let map = chessboard();
    let scene = Scene::new(&graphics, &map, PICTURE).unwrap();
    let lens = Lens::pinhole(64, 64, 64.0);
    let pose = Pose::from_rig(0.2, 0.1, 0.5);
    let look = Look { gamma: 1.0, false_colour: false, beside: [0.0; 3] };
    let picture =
        scene.picture(&graphics, &View { lens, pose, look, shading: Shading::ByTexel, halvings: 0 }).unwrap();
    let middle = (28..36).flat_map(|row| (28..36).map(move |column| row * 64 + column));
    let grey = (255.0 * rigel::render::expose(1.0, 1.0)).round() as i32;
    for i in middle {
        assert!((i32::from(picture[i][0]) - grey).abs() <= 3, "{:?} is not {grey}", picture[i]);
    }
}

#[test]
fn false_colours_are_the_processor_s() {
    let Some(graphics) = graphics() else { return };
    let (surface, observed) = observed(TEXELS);
    let map = fitted(surface, TEXELS, Model::Phong { lobes: 1 }, &observed);
    let (lens, pose) = oblique();
    let truth = truth(&map, &lens, &pose);
    let look = Look { false_colour: true, ..look(&truth) };
    let scene = Scene::new(&graphics, &map, PICTURE).unwrap();
    let view = View { lens, pose, look, shading: Shading::ByPixel, halvings: 0 };
    let picture = scene.picture(&graphics, &view).unwrap();
    let width = truth.width as usize;
    let inner = |i: &usize| {
        *i > width
            && *i + width < picture.len()
            && [0, 1, width, 2 * width].iter().all(|o| truth.inside[i + o - width])
    };
    let (mut most, mut count) = (0, 0);
    for i in (0..picture.len()).filter(inner) {
        let want = look.levels(truth.radiance[i]);
        most = (0..3).map(|c| want[c].abs_diff(picture[i][c])).fold(most, u8::max);
        count += 1;
    }
    // The scale of colours is up to five times as steep as levels are.
    assert!(count > 10_000 && most <= 8, "{most} of 255 over {count} pixels");
}

/// A chessboard of single texels, black and white.
fn chessboard() -> ParameterMap {
    let texels = Texels { columns: 256, rows: 256 };
    let white = |i: u32| if (i % 256 + i / 256).is_multiple_of(2) { 2.0 } else { 0.0 };
    ParameterMap {
        surface: rigel::geometry::Surface { width_m: 0.2, height_m: 0.2 },
        texels,
        models: vec![Model::Constant],
        choice: vec![],
        parameters: (0..256 * 256).flat_map(|i| [white(i); 3]).collect(),
        diagnostics: None,
        uncertainty: None,
    }
}

#[test]
fn coarser_texels_have_the_mean_radiance_of_those_that_they_replace() {
    let Some(graphics) = graphics() else { return };
    let scene = Scene::new(&graphics, &chessboard(), PICTURE).unwrap();
    // So near that single texels are seen.
    let (lens, pose) = (Lens::pinhole(64, 64, 640.0), Pose::from_rig(0.0, 0.0, 0.1));
    let look = Look { gamma: 1.0, false_colour: false, beside: [0.0; 3] };
    let draw = |halvings| {
        let view = View { lens, pose, look, shading: Shading::Automatic, halvings };
        scene.picture(&graphics, &view).unwrap()
    };
    let levels = draw(0);
    assert!(levels.iter().any(|pixel| pixel[0] < 10) && levels.iter().any(|pixel| pixel[0] > 200));
    let grey = (255.0 * rigel::render::expose(1.0, 1.0)).round() as i32;
    for halvings in [1, 3, 100] {
        for pixel in draw(halvings) {
            assert!((i32::from(pixel[0]) - grey).abs() <= 1, "{pixel:?} is not {grey} after {halvings}");
        }
    }
}

#[test]
fn a_floor_shows_what_the_map_sends_onto_it_until_it_is_taken_away() {
    let Some(graphics) = graphics() else { return };
    let (surface, observed) = observed(TEXELS);
    let map = fitted(surface, TEXELS, Model::Phong { lobes: 1 }, &observed);
    let floor = Floor::lit_by(&map);
    let centre = glam::DVec3::new(0.15, 0.25, 0.6);
    let pose = Pose::from_axes(centre, glam::DVec3::new(0.0, -0.05, 0.05) - centre, glam::DVec3::Y);
    let lens = Lens::pinhole(320, 240, 400.0);
    let look = Look { gamma: 2.0, false_colour: false, beside: [0.0; 3] };
    let mut scene = Scene::new(&graphics, &map, PICTURE).unwrap();
    let view = View { lens, pose, look, shading: Shading::ByPixel, halvings: 0 };
    let before = scene.picture(&graphics, &view).unwrap();
    scene.set_floor(&graphics, Some(&floor));
    let lit = scene.picture(&graphics, &view).unwrap();
    let (columns, rows) = floor.points;
    let (mut off, mut seen) = (0, 0);
    for i in 0..columns * rows {
        let point = glam::DVec3::new(
            ((i % columns) as f64 + 0.5) / columns as f64 * floor.width_m - floor.width_m / 2.0,
            -surface.height_m / 2.0,
            ((i / columns) as f64 + 0.5) / rows as f64 * floor.depth_m,
        );
        let pixel = lens.project(pose.to_camera(point)).unwrap().round();
        if pixel.cmpge(glam::DVec2::ZERO).all() && pixel.x < 320.0 && pixel.y < 240.0 {
            let shown = lit[pixel.y as usize * 320 + pixel.x as usize];
            let want = look.levels(floor.radiance[i]);
            off += (0..3).map(|c| u32::from(shown[c].abs_diff(want[c]))).sum::<u32>();
            seen += 1;
        }
    }
    // Beside its own point a pixel shows a little of the next.
    assert!(
        10 * seen > 9 * columns * rows && f64::from(off) / (3.0 * seen as f64) < 1.0,
        "{off} over {seen} points"
    );
    assert!(lit.iter().any(|pixel| pixel[0] > 40) && lit != before);
    // Where the floor is not, nothing changes.
    let above = (0..40 * 320).filter(|i| before[*i] != lit[*i]).count();
    assert_eq!(above, 0);
    assert_eq!(scene.map_alone(&graphics, &view).unwrap(), before);
    scene.set_floor(&graphics, None);
    assert_eq!(scene.picture(&graphics, &view).unwrap(), before);
}

/// A sheet's rows are at least as high as what is written beside them.
#[test]
fn a_thin_surface_and_a_narrow_one_have_a_contact_sheet() {
    let Some(graphics) = graphics() else { return };
    let (lens, pose) = (Lens::pinhole(320, 240, 400.0), Pose::from_rig(0.3, 0.4, 0.4));
    let (_, observed) = observed(TEXELS);
    for (width_m, height_m) in [(0.2, 0.004), (0.004, 0.2)] {
        let map = fitted(Surface { width_m, height_m }, TEXELS, Model::Constant, &observed);
        let seen = truth(&map, &lens, &pose);
        let count = seen.inside.len();
        let mask = seen.inside.iter().map(|inside| u8::from(!inside)).collect();
        let view = View { lens, pose, look: look(&seen), shading: Shading::ByPixel, halvings: 0 };
        let radiance = RadianceImage {
            width: lens.width,
            height: lens.height,
            radiance: seen.radiance,
            variance: vec![[0.0; 3]; count],
            mask,
        };
        let reference = Reference { name: "view".into(), lens, pose, radiance, exposure_time_known: true };
        let sheet = contact_sheet(&graphics, &map, [Ok(reference)].into_iter(), &view, &Silent).unwrap();
        assert!(sheet.views[0].mean_255 < 1.0, "{:?}", sheet.views);
    }
}

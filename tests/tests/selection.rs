//! The smallest sufficient model for each texel, from a map on disk to a map on disk.

use glam::Vec3;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rigel::fit::{FitFlags, FitOptions, Model, candidates};
use rigel::geometry::Texels;
use rigel::observation::TexelObservations;
use rigel::parameter_map::{
    ParameterMap, Selection, coarser, coverage, fit_surface, select_surface, together,
};
use rigel::progress::Silent;
use rigel_atlas::texels::{Doubt, directions, lobes, observe, write_map};

const TEXELS: Texels = Texels { columns: 24, rows: 20 };
const VIEWS: usize = 90;
/// Columns from here on have one lobe, and two.
const BORDERS: [usize; 2] = [8, 16];
/// Texels with a fault, none beside another.
const BLACK: usize = 1;
const THREE_VIEWS: usize = 3;
/// In the part that has one lobe.
const EVERY_FIFTH: usize = 9;

fn only(texel: &TexelObservations, views: impl Fn(u32) -> bool) -> TexelObservations {
    texel.without(&texel.view.iter().copied().filter(|view| !views(*view)).collect::<Vec<_>>())
}

/// Three materials, and a few texels with a fault.
fn surface() -> Vec<TexelObservations> {
    let toward = directions(VIEWS, 1.3, 0.0);
    let texel = |i: usize| {
        let column = i % TEXELS.columns as usize;
        let kind = BORDERS.iter().filter(|border| column >= **border).count();
        let truth = lobes(&mut StdRng::seed_from_u64(40 + kind as u64), kind);
        observe(&truth, &toward, &Doubt::USUAL, 1000 + i as u64)
    };
    let mut all: Vec<TexelObservations> = (0..TEXELS.count()).map(texel).collect();
    all[BLACK].radiance.fill([0.0; 3]);
    all[THREE_VIEWS] = only(&all[THREE_VIEWS], |view| view < 3);
    all[EVERY_FIFTH] = only(&all[EVERY_FIFTH], |view| view % 5 == 0);
    all
}

fn chosen(fitted: &ParameterMap, index: usize) -> Model {
    fitted.texel(index as u32 % TEXELS.columns, index as u32 / TEXELS.columns).0
}

#[test]
fn every_material_gets_its_model_and_a_faulty_texel_harms_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let toward = directions(VIEWS, 1.3, 0.0);
    let map = write_map(&folder.path().join("map.rigel"), TEXELS, &toward, &surface()).unwrap();
    let fitted = select_surface(&map, &candidates(), &Selection::default(), &[], &Silent).unwrap();
    let file = folder.path().join("auto.exr");
    fitted.write(&file).unwrap();
    let fitted = ParameterMap::read(&file).unwrap();
    println!("{}: {:.1} bytes", fitted.name(), fitted.bytes_per_texel());

    let wanted = [Model::Constant, Model::Phong { lobes: 1 }, Model::Phong { lobes: 2 }];
    for (kind, wanted) in wanted.into_iter().enumerate() {
        let of_kind = |i: &usize| {
            let column = i % TEXELS.columns as usize;
            BORDERS.iter().filter(|border| column >= **border).count() == kind
        };
        let texels: Vec<usize> = (0..TEXELS.count()).filter(of_kind).collect();
        let right = texels.iter().filter(|i| chosen(&fitted, **i) == wanted).count();
        println!("{}: {right} of {}", wanted.name(), texels.len());
        assert!(right * 100 >= 95 * texels.len(), "{}: {right} of {}", wanted.name(), texels.len());
    }

    let diagnostics = fitted.diagnostics.as_ref().unwrap();
    assert!(diagnostics.residual.iter().all(|residual| residual.is_finite()));
    assert!(fitted.texel(BLACK as u32, 0).1.iter().take(3).all(|l| *l == 0.0));
    assert_eq!(diagnostics.views[THREE_VIEWS], 3);
    assert_eq!(chosen(&fitted, THREE_VIEWS), Model::Constant);
    assert_eq!(chosen(&fitted, EVERY_FIFTH), Model::Phong { lobes: 1 });
}

#[test]
fn what_is_said_of_views_left_out_holds() {
    let folder = tempfile::tempdir().unwrap();
    let toward = directions(VIEWS, 1.3, 0.0);
    let map = write_map(&folder.path().join("map.rigel"), TEXELS, &toward, &surface()).unwrap();
    let without: Vec<u32> = (0..VIEWS as u32).step_by(9).collect();
    let fitted = select_surface(&map, &candidates(), &Selection::default(), &without, &Silent).unwrap();
    let counts = coverage(&fitted, &map, &without, &Silent).unwrap();
    for (model, counts) in fitted.models.iter().zip(&counts) {
        let share = 100.0 * together(counts).share();
        println!("{}: {share:.1} % within one sigma", model.name());
        assert!((64.0..=72.0).contains(&share), "{}: {share}", model.name());
    }
    // The faulty texels have fewer; of three views nothing is known.
    let all = together(counts.iter().flatten()).all;
    let most = 3 * (without.len() * TEXELS.count()) as u64;
    assert!((most - 90..most).contains(&all), "{all} of {most}");
}

#[test]
fn a_small_material_keeps_its_model() {
    let folder = tempfile::tempdir().unwrap();
    let texels = Texels { columns: 20, rows: 20 };
    let toward = directions(VIEWS, 1.3, 0.0);
    let [matt, shiny] = [0, 1].map(|count| lobes(&mut StdRng::seed_from_u64(7), count));
    // 1.5 %, in a corner.
    let is_shiny = |i: usize| i % 20 < 3 && i / 20 < 2;
    let observed: Vec<TexelObservations> = (0..400)
        .map(|i| observe(if is_shiny(i) { &shiny } else { &matt }, &toward, &Doubt::USUAL, i as u64))
        .collect();
    let map = write_map(&folder.path().join("map.rigel"), texels, &toward, &observed).unwrap();
    let fitted = select_surface(&map, &candidates(), &Selection::default(), &[], &Silent).unwrap();
    let with_lobes = |i: &usize| fitted.texel(*i as u32 % 20, *i as u32 / 20).0 != Model::Constant;
    let found: Vec<usize> = (0..400).filter(with_lobes).collect();
    assert!((0..400).filter(|i| is_shiny(*i)).all(|i| found.contains(&i)), "{found:?}");
    assert!(found.len() < 20, "{found:?}");
}

#[test]
fn a_black_texel_can_be_fitted_and_written_in_every_model() {
    let folder = tempfile::tempdir().unwrap();
    let toward: Vec<Vec3> = directions(VIEWS, 1.3, 0.0);
    let observed: Vec<TexelObservations> = surface().into_iter().take(24).collect();
    let texels = Texels { columns: 24, rows: 1 };
    let map = write_map(&folder.path().join("map.rigel"), texels, &toward, &observed).unwrap();
    for model in Model::all().into_iter().filter(|model| model.unknowns() <= VIEWS) {
        let fitted = fit_surface(&map, model, &FitOptions::default(), &[], &Silent).unwrap();
        fitted.write(&folder.path().join("one.exr")).unwrap();
        let diagnostics = fitted.diagnostics.unwrap();
        assert!(diagnostics.residual.iter().all(|residual| residual.is_finite()), "{}", model.name());
        let few = diagnostics.flags[THREE_VIEWS];
        assert_eq!(few.contains(FitFlags::TOO_FEW_VIEWS), model.unknowns() > 3, "{}", model.name());
    }
}

/// The truth has fields of 4 x 4 texels: so coarse texels would do, and none that are coarser.
#[test]
fn texels_that_are_too_fine_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let texels = Texels { columns: 32, rows: 32 };
    let toward = directions(VIEWS, 1.3, 0.0);
    let texel = |i: usize| {
        let field = i % 32 / 4 + i / 32 / 4 * 8;
        let truth = lobes(&mut StdRng::seed_from_u64(field as u64), 1);
        observe(&truth, &toward, &Doubt::USUAL, i as u64)
    };
    let observed: Vec<TexelObservations> = (0..texels.count()).map(texel).collect();
    let map = write_map(&folder.path().join("map.rigel"), texels, &toward, &observed).unwrap();
    let tried = coarser(&map, &Selection::default(), &[], &Silent).unwrap();
    println!("{tried:?}");
    let suffices: Vec<(u32, bool)> = tried.iter().map(|of| (of.texels.columns, of.suffices())).collect();
    assert_eq!(suffices, [(16, true), (8, true), (4, false)]);
}

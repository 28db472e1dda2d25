use super::draw::unused;
use super::*;
use crate::flip::tests::{map as even, reference};
use crate::raster::Raster;
use crate::scene::Shading;
use rigel::geometry::Texels;
use rigel::shader::Look;
use winit::keyboard::{Key, NamedKey};

const TEXELS: Texels = Texels { columns: 16, rows: 12 };

fn map() -> ParameterMap {
    even([0.5; 3])
}

/// Darker, too.
fn coarse() -> ParameterMap {
    let texels = Texels { columns: 4, rows: 3 };
    ParameterMap { texels, parameters: vec![0.25; 3 * texels.count()], ..map() }
}

fn app(pose: Pose) -> App {
    let lens = Lens { k1: -0.1, ..Lens::pinhole(320, 240, 380.0) };
    let look = Look { gamma: 1.0, false_colour: false, beside: [0.0; 3] };
    App::new(Show {
        maps: vec![("a".into(), map()), ("b".into(), coarse())],
        view: View { lens, pose, look, shading: Shading::Automatic, halvings: 0 },
        photographs: 3,
        photograph: Box::new(|index| {
            Ok(Reference {
                name: format!("view{index}"),
                pose: Pose::from_rig(0.1 * index as f64, 0.2, 0.6),
                exposure_time_known: false,
                ..reference([3.0; 3])
            })
        }),
        observations: None,
        texel: None,
        screenshot: "rigel-view.png".into(),
        at_once: false,
    })
}

fn press(app: &mut App, keys: &str) {
    for key in keys.chars() {
        let key = match key {
            ' ' => Key::Named(NamedKey::Space),
            other => Key::Character(other.to_string().into()),
        };
        app.key(&key).unwrap();
    }
}

#[test]
fn the_first_pose_is_kept_whole_and_zero_brings_it_back() {
    let tilted = Pose::from_rig(0.3, 0.5, 0.8);
    let rolled = glam::DQuat::from_rotation_z(0.4) * tilted.camera_from_surface;
    let pose = Pose { camera_from_surface: rolled, ..tilted };
    let mut app = app(pose);
    assert_eq!((app.view().pose, app.view().lens), (pose, app.show.view.lens));
    app.key(&Key::Named(NamedKey::ArrowLeft)).unwrap();
    press(&mut app, "+n");
    assert_ne!(app.view().pose, pose);
    press(&mut app, "0");
    assert_eq!(app.view().pose, pose);
}

#[test]
fn keys_change_what_the_text_says() {
    let mut app = app(Pose::from_rig(0.0, 0.4, 0.8));
    let text = |app: &App| app.seen().join("\n");
    assert!(text(&app).contains("zenith 22.9"), "{}", text(&app));
    press(&mut app, "n ");
    assert!(text(&app).contains("difference x 4 view0 (1 of 3)"), "{}", text(&app));
    press(&mut app, "pf ");
    assert!(text(&app).contains("photograph view2 (3 of 3)") && text(&app).contains("false"));
    // Coarser texels are shaded by texel whatever is chosen, and no floor lies before a photograph.
    press(&mut app, "rrxl");
    assert_eq!(app.seen().last().unwrap(), "shaded by texel, texels / 4");
    press(&mut app, "0rr");
    assert_eq!(app.seen().last().unwrap(), "shaded by pixel, floor lit");
    assert!(!app.key(&Key::Character("q".into())).unwrap());
}

/// Every line of the notes must be found again in the picture, letter by letter.
#[test]
fn the_facts_and_the_keys_are_written_until_they_are_hidden() {
    let mut app = app(Pose::from_rig(0.0, 0.4, 0.8));
    let written = |app: &App| {
        let mut over = Raster::new(640, 480);
        app.write(&mut over);
        over
    };
    let mut lines = words::facts("a", &app.show.maps[0].1);
    lines.extend(words::keys());
    let (picture, ink) = (written(&app), crate::raster::INK);
    let has = |line: &str| {
        let mut alone = Raster::new(picture.width, crate::font::LINE);
        alone.text((7, 0), 1, line, ink);
        let dots: Vec<(u32, u32)> = (0..alone.height)
            .flat_map(|y| (0..alone.width).map(move |x| (x, y)))
            .filter(|(x, y)| alone.pixels[(y * alone.width + x) as usize] == ink)
            .collect();
        !dots.is_empty()
            && (0..picture.height - alone.height).any(|top| {
                dots.iter().all(|(x, y)| picture.pixels[((top + y) * picture.width + x) as usize] == ink)
            })
    };
    for line in &lines {
        assert!(has(line), "{line:?} is not written");
    }
    assert!(!has("no such line"));
    press(&mut app, "h");
    assert_eq!(written(&app), Raster::new(640, 480));
}

#[test]
fn a_click_finds_the_texel_that_is_seen_there() {
    let mut app = app(Pose::from_rig(0.3, 0.5, 0.8));
    let where_is = |app: &App, column, row| {
        let view = app.view();
        let centre = map().surface.texel_centre(TEXELS, column, row);
        view.lens.project(view.pose.to_camera(centre)).unwrap()
    };
    // The panel that opens beside it may move the picture.
    let is_marked = |app: &App| {
        let place = app.place_of_texel().unwrap();
        assert_eq!(app.texel_at((place.x.into(), place.y.into())), app.show.texel);
    };
    for (column, row) in [(0, 0), (15, 11), (7, 3)] {
        let pixel = where_is(&app, column, row);
        app.pointer = (pixel.x + 0.5, pixel.y + 0.5);
        app.click().unwrap();
        assert_eq!(app.show.texel, Some((column, row)));
        assert!(app.profile.is_some());
        is_marked(&app);
    }
    // In a photographed view's picture, which is enlarged in the window: 160 x 100 to 320 x 200, 20 pixels from the top.
    press(&mut app, "n");
    let pixel = where_is(&app, 4, 9);
    app.pointer = (2.0 * pixel.x + 1.0, 2.0 * pixel.y + 21.0);
    app.click().unwrap();
    assert_eq!(app.show.texel, Some((4, 9)));
    is_marked(&app);
    app.pointer = (0.0, 0.0);
    app.click().unwrap();
    assert!(app.show.texel.is_none() && app.profile.is_none());
}

#[test]
fn the_next_map_shows_the_same_place() {
    let mut app = app(Pose::from_rig(0.3, 0.5, 0.8));
    app.show.texel = Some((15, 6));
    press(&mut app, "rrrm");
    assert_eq!(app.show.texel, Some((3, 1)));
    assert!(app.profile.is_some());
    assert_eq!(app.facts, words::facts("b", &coarse()));
    // It has fewer texels that can become coarser.
    assert!(app.seen().last().unwrap().ends_with("texels / 4"), "{:?}", app.seen());
}

#[test]
fn a_photograph_of_unknown_exposure_follows_the_map() {
    let mut app = app(Pose::from_rig(0.3, 0.5, 0.8));
    press(&mut app, "n");
    for level in [0.5, 0.25, 0.5] {
        let (index, shown) = app.step.as_ref().unwrap();
        let off = (shown.radiance.radiance[50 * 160 + 80][0] - level).abs();
        assert!(*index == 0 && off < 1e-6, "{off} from {level}");
        press(&mut app, "m");
    }
}

#[test]
fn a_screenshot_replaces_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let first = folder.path().join("rigel-view.png");
    for name in ["rigel-view.png", "rigel-view-2.png", "rigel-view-3.png"] {
        let path = unused(&first);
        assert_eq!(path, folder.path().join(name));
        std::fs::write(path, "a picture").unwrap();
    }
}

//! Rooms that are lit by maps of themselves, and models and maps that are none.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use glam::{DQuat, DVec2, DVec3};
use rigel::environment::EnvironmentMap;
use rigel::geometry::LatLong;
use rigel::progress::Silent;
use rigel::room::{Capture, Model, Pair, Room, Tree, register, texture};

fn size(rows: u32) -> LatLong {
    LatLong::new(2 * rows, rows).unwrap()
}

/// The map of a model whose surfaces have this radiance by face and place; what meets none is black.
fn map(
    model: &Model,
    centre: DVec3,
    rows: u32,
    turn: DQuat,
    radiance: impl Fn(usize, DVec3) -> [f64; 3],
) -> EnvironmentMap {
    let (tree, size) = (Tree::new(model), size(rows));
    let radiance = (0..size.count())
        .map(|i| {
            let at = DVec2::new((i % size.width()) as f64, (i / size.width()) as f64);
            // Four rays across a pixel, as a camera's pixel has an extent.
            let mut sum = [0.0; 3];
            for k in 0..4 {
                let at = at + DVec2::new(f64::from(k % 2) - 0.5, f64::from(k / 2) - 0.5) * 0.5;
                let direction = turn.inverse() * size.direction(at);
                if let Some(hit) = tree.hit(centre, direction, f64::INFINITY) {
                    let own = radiance(hit.face, centre + hit.distance * direction);
                    (0..3).for_each(|c| sum[c] += 0.25 * own[c]);
                }
            }
            sum.map(|sum| sum as f32)
        })
        .collect();
    EnvironmentMap {
        size,
        radiance,
        variance: vec![],
        coverage: vec![],
        flags: vec![],
        unit: Default::default(),
        curve: vec![],
    }
}

/// A box with its corners in two opposite points, seen from inside or from outside.
fn cuboid(least: DVec3, most: DVec3, inward: bool) -> Model {
    let corner =
        |k: u32| DVec3::from_array(std::array::from_fn(|i| if k >> i & 1 == 1 { most[i] } else { least[i] }));
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces = quads.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let faces = faces.map(|[a, b, c]| if inward { [a, c, b] } else { [a, b, c] });
    Model { points_m: (0..8).map(corner).collect(), faces: faces.collect(), uv: vec![], notes: vec![] }
}

fn joined(a: &Model, b: &Model) -> Model {
    let first = a.points_m.len() as u32;
    let mut all = a.clone();
    all.points_m.extend(&b.points_m);
    all.faces.extend(b.faces.iter().map(|face| face.map(|i| i + first)));
    all
}

/// A room of 4 x 2.5 x 5 metres with a box on the floor.
fn furnished() -> Model {
    let room = cuboid(DVec3::new(-2.0, 0.0, -2.5), DVec3::new(2.0, 2.5, 2.5), true);
    joined(&room, &cuboid(DVec3::new(0.6, 0.0, -1.8), DVec3::new(1.4, 1.0, -1.0), false))
}

fn paint(_: usize, place: DVec3) -> [f64; 3] {
    [1.0 + 0.5 * (2.0 * place.x).sin(), 1.0 + 0.4 * (3.0 * place.y).cos(), 1.2 + 0.5 * (2.0 * place.z).sin()]
}

fn capture(map: &EnvironmentMap, centre_m: DVec3) -> Capture<'_> {
    Capture { map, centre_m, map_from_model: DQuat::IDENTITY }
}

fn relative(own: [f32; 3], truth: [f32; 3]) -> f64 {
    (0..3).map(|c| f64::from((own[c] - truth[c]).abs() / truth[c].max(1e-3))).fold(0.0, f64::max)
}

/// Median and 95th percentile.
fn spread(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[values.len() / 2], values[values.len() * 95 / 100])
}

#[test]
fn every_texel_of_a_closed_room_is_seen_or_marked_and_what_is_seen_is_right() {
    let (model, centre) = (furnished(), DVec3::new(-0.5, 1.4, 0.3));
    let map = map(&model, centre, 256, DQuat::IDENTITY, paint);
    let mut room = texture(model.clone(), &[capture(&map, centre)], 256, &Silent).unwrap();
    assert!(room.notes.is_empty(), "{:?}", room.notes);
    let tree = Tree::new(&model);
    let mut errors = vec![];
    let (mut unseen, mut texels, mut doubtful) = (0, 0, 0);
    for texel in 0..256 * 256 {
        let flags = room.flags[texel];
        let Some(face) = room.charts.face(texel) else {
            assert_eq!(flags, Room::NO_SURFACE);
            continue;
        };
        assert!(flags == 0 || flags == EnvironmentMap::UNSEEN, "{flags}");
        assert_eq!(flags == 0, room.radiance[texel] != [0.0; 3]);
        if room.charts.area_m2[texel] == 0.0 {
            continue;
        }
        let at = DVec2::new((texel % 256) as f64, (texel / 256) as f64);
        let [a, b, c] = model.corners(face);
        let [u, v] = room.charts.weights(face, at);
        let place = a + u * (b - a) + v * (c - a);
        let away = place + 1e-4 * model.normal(face) - centre;
        let hidden = tree.hit(centre, away, 1.0 - 1e-6).is_some() || away.dot(model.normal(face)) > 0.0;
        texels += 1;
        // On the border of a shadow a texel is both.
        doubtful += usize::from(hidden == (flags == 0));
        if flags == EnvironmentMap::UNSEEN {
            unseen += 1;
        } else {
            errors.push(relative(room.radiance[texel], paint(face, place).map(|value| value as f32)));
        }
    }
    assert!(doubtful < texels / 50, "{doubtful} of {texels}");
    let (median, most) = spread(errors);
    println!(
        "texels: median {median:.4}, 95 % {most:.4}; {unseen} unseen, {:.2} % of the area",
        100.0 * room.share(EnvironmentMap::UNSEEN)
    );
    assert!(median < 0.005 && most < 0.03, "{median} {most}");
    // The box's bottom and two sides, what it stands on, and its shadow.
    assert!((0.03..0.15).contains(&room.share(EnvironmentMap::UNSEEN)));
    room.fill();
    assert_eq!(room.share(EnvironmentMap::UNSEEN), 0.0);
    assert!(room.share(EnvironmentMap::FILLED) > 0.03);
    assert!(
        (0..256 * 256)
            .filter(|&i| room.flags[i] & EnvironmentMap::FILLED != 0)
            .all(|i| room.radiance[i].iter().all(|v| *v > 0.4))
    );
}

#[test]
fn two_maps_see_what_one_does_not_and_agree_on_one_scale() {
    let (model, near, far) = (furnished(), DVec3::new(-0.5, 1.4, 0.3), DVec3::new(1.7, 1.6, -2.2));
    let first = map(&model, near, 192, DQuat::IDENTITY, paint);
    let turn = DQuat::from_scaled_axis(DVec3::new(0.2, 1.1, -0.3));
    let mut second = map(&model, far, 192, turn, paint);
    second.radiance.iter_mut().for_each(|pixel| *pixel = pixel.map(|value| 3.0 * value));
    let alone = texture(model.clone(), &[capture(&first, near)], 192, &Silent).unwrap();
    let captures = [capture(&first, near), Capture { map: &second, centre_m: far, map_from_model: turn }];
    let both = texture(model.clone(), &captures, 192, &Silent).unwrap();
    assert!(both.share(EnvironmentMap::UNSEEN) < 0.6 * alone.share(EnvironmentMap::UNSEEN));
    assert!(both.notes.iter().any(|note| note.contains("multiplied by 0.33")), "{:?}", both.notes);
    assert!(both.share(Room::CONTRARY) < 0.01, "{}", both.share(Room::CONTRARY));
    let (median, most) = spread(
        (0..192 * 192)
            .filter(|&i| alone.flags[i] == 0 && both.flags[i] == 0)
            .map(|i| relative(both.radiance[i], alone.radiance[i]))
            .collect(),
    );
    assert!(median < 0.01 && most < 0.06, "{median} {most}");
}

/// Kd and Ke by the order of the objects in the file, as its materials say: floor, ceiling, back, right, left, short box, tall box, light.
fn cornell_paint(model: &Model) -> impl Fn(usize, DVec3) -> [f64; 3] {
    let lamp = model.faces.len() - 2;
    move |face, place| {
        if face >= lamp {
            return [17.0, 12.0, 4.0];
        }
        let lit = 0.4 / (0.3 + (place - DVec3::new(0.0, 1.9, 0.0)).length_squared());
        let albedo = match face {
            6..8 => [0.14, 0.45, 0.091],
            8..10 => [0.63, 0.065, 0.05],
            _ => [0.725, 0.71, 0.68],
        };
        albedo.map(|albedo| albedo * lit)
    }
}

#[test]
fn the_cornell_box_lit_by_a_map_of_itself_returns_that_map_and_its_lamp() {
    let Some(path) = rigel_tests::data("meshes/CornellBox-Original.obj") else { return };
    let model = Model::read(&path).unwrap();
    let centre = DVec3::new(0.0, 1.0, 0.3);
    let map = map(&model, centre, 256, DQuat::IDENTITY, cornell_paint(&model));
    let room = texture(model.clone(), &[capture(&map, centre)], 1024, &Silent).unwrap();
    println!("{:?}", room.notes);
    assert!(room.notes.iter().any(|note| note.contains("holes")), "its front is open: {:?}", room.notes);
    assert!(
        (0..1024 * 1024).all(|i| room.charts.face(i).is_some() == (room.flags[i] & Room::NO_SURFACE == 0))
    );
    let back = room.look(centre, map.size, &Silent).unwrap();
    let (mut errors, mut lost, mut power, mut all) = (vec![], 0.0, [0.0; 2], 0.0);
    for i in 0..map.size.count() {
        let angle = map.size.solid_angle(i / map.size.width());
        let truth = map.radiance[i];
        power[0] += angle * f64::from(truth[1]);
        power[1] += angle * f64::from(back.radiance[i][1]);
        if truth[1] > 0.0 {
            all += angle;
            match back.flags[i] {
                0 => errors.push(relative(back.radiance[i], truth)),
                _ => lost += angle,
            }
        }
    }
    let (median, most) = spread(errors);
    println!(
        "map of itself: median {median:.4}, 95 % {most:.4}, unseen {:.3} %, power {:.4}",
        100.0 * lost / all,
        power[1] / power[0]
    );
    assert!(median < 0.005 && most < 0.05, "{median} {most}");
    assert!(lost < 0.005 * all && (power[1] / power[0] - 1.0).abs() < 0.02);
    // The lamp: 0.47 x 0.38 metres below the ceiling.
    let patches = room.patches();
    println!("{patches:?}");
    assert_eq!(patches.len(), 1);
    let (lamp, last) = (&patches[0], model.faces.len());
    let area_m2 = model.area_m2(last - 1) + model.area_m2(last - 2);
    let middle = [last - 2, last - 1].iter().flat_map(|&face| model.corners(face)).sum::<DVec3>() / 6.0;
    assert!((lamp.area_m2 / area_m2 - 1.0).abs() < 0.05 && lamp.centre_m.distance(middle) < 0.02);
    assert!(lamp.normal.y < -0.99 && (lamp.radiance[0] / 17.0 - 1.0).abs() < 0.05);
    assert!((lamp.size_m[0] * lamp.size_m[1] / area_m2 - 1.0).abs() < 0.1);
    let expected = std::f64::consts::PI * 17.0 * area_m2;
    assert!((lamp.power[0] / expected - 1.0).abs() < 0.03, "{} {expected}", lamp.power[0]);
}

#[test]
fn every_light_of_a_box_lies_on_a_wall_and_faces_away_from_it() {
    let (least, most) = (DVec3::new(-3.0, 0.0, -4.0), DVec3::new(3.0, 2.8, 4.0));
    let (model, centre) = (cuboid(least, most, true), DVec3::new(0.2, 1.5, -0.4));
    // One that hangs over the edge between ceiling and wall, one in a corner, one on a wall.
    let lamps = [
        (DVec3::new(3.0, 2.8, 1.0), 0.6),
        (DVec3::new(-3.0, 0.0, -4.0), 0.8),
        (DVec3::new(1.0, 1.2, 4.0), 0.4),
    ];
    let lit = |_: usize, place: DVec3| {
        [if lamps.iter().any(|(lamp, radius)| lamp.distance(place) < *radius) { 50.0 } else { 0.5 }; 3]
    };
    // The three shine on two, three and one walls.
    let mut maps = vec![(6, map(&model, centre, 192, DQuat::IDENTITY, lit))];
    if let Some(path) = rigel_tests::data("environment/studio.hdr") {
        maps.push((1, EnvironmentMap::read(&path).unwrap()));
    }
    for (fewest, map) in &maps {
        let room = texture(model.clone(), &[capture(map, centre)], 256, &Silent).unwrap();
        let patches = room.patches();
        assert!(patches.len() >= *fewest, "{}", patches.len());
        for patch in &patches {
            println!("{} facing {}: {:.1} %", patch.centre_m, patch.normal, 100.0 * patch.share);
            // Off the wall that it shines away from.
            let off = (0..3).map(|i| {
                let (at, normal) = (patch.centre_m[i], patch.normal[i]);
                let to_wall = if normal > 0.0 { at - least[i] } else { most[i] - at };
                if normal.abs() > 0.999 { to_wall.abs() } else { f64::INFINITY }
            });
            let off = off.fold(f64::INFINITY, f64::min);
            assert!(off < 1e-3, "{off} m off: {patch:?}");
            let within = patch.centre_m.cmpge(least - 1e-3) & patch.centre_m.cmple(most + 1e-3);
            assert!(within.all());
        }
    }
}

#[test]
fn a_map_is_registered_by_clicked_corners_one_of_them_wrong() {
    let (model, centre) = (furnished(), DVec3::new(-0.5, 1.4, 0.3));
    let turn = DQuat::from_scaled_axis(DVec3::new(0.1, 2.0, -0.1));
    let map = map(&model, centre, 256, turn, paint);
    let mut pairs: Vec<Pair> = model.points_m[..10]
        .iter()
        .map(|&point_m| {
            // To the pixel.
            let pixel = map.size.pixel(turn * (point_m - centre)).round();
            Pair { point_m, direction: map.size.direction(pixel) }
        })
        .collect();
    pairs[4].direction = -pairs[4].direction;
    let found = register(&pairs, None).unwrap();
    assert!((0..10).all(|i| found.wrong[i] == (i == 4)), "{:?}", found.wrong);
    let apart = found.centre_m.distance(centre);
    println!("{apart:.4} m apart, stated {:.4}", found.centre_sigma_m);
    assert!(apart < 0.03 && apart < 4.0 * found.centre_sigma_m);
    let capture = Capture { map: &map, centre_m: found.centre_m, map_from_model: found.map_from_model };
    let room = texture(model.clone(), &[capture], 128, &Silent).unwrap();
    assert!(room.share(EnvironmentMap::UNSEEN) < 0.15);
}

#[test]
fn models_with_holes_and_flipped_faces_are_used_and_noted() {
    let (closed, centre) = (furnished(), DVec3::new(-0.5, 1.4, 0.3));
    let map = map(&closed, centre, 128, DQuat::IDENTITY, paint);
    let mut open = closed.clone();
    open.faces.remove(0);
    let room = texture(open, &[capture(&map, centre)], 128, &Silent).unwrap();
    assert!(room.notes.iter().any(|note| note.contains("3 edges")), "{:?}", room.notes);
    assert!(room.notes.iter().any(|note| note.contains("holes")), "{:?}", room.notes);
    let mut flipped = closed.clone();
    flipped.faces[3].swap(0, 1);
    let room = texture(flipped, &[capture(&map, centre)], 128, &Silent).unwrap();
    assert!(room.notes.iter().any(|note| note.contains("from behind")), "{:?}", room.notes);
    let share = closed.area_m2(3) / (0..closed.faces.len()).map(|face| closed.area_m2(face)).sum::<f64>();
    assert!((room.share(Room::BEHIND) / share - 1.0).abs() < 0.05);
}

#[test]
fn what_cannot_light_a_room_is_refused_in_a_sentence() {
    let (model, centre) = (furnished(), DVec3::new(-0.5, 1.4, 0.3));
    let good = map(&model, centre, 16, DQuat::IDENTITY, paint);
    let with = |at: usize, value: f32| {
        let mut map = good.clone();
        map.radiance[at][1] = value;
        map
    };
    let dark = EnvironmentMap { radiance: vec![[0.0; 3]; good.size.count()], ..good.clone() };
    let empty = Model { faces: vec![], ..model.clone() };
    for (model, maps, size, centre, part) in [
        (model.clone(), vec![with(7, -1.0)], 64, centre, "-1"),
        (model.clone(), vec![with(7, f32::INFINITY)], 64, centre, "inf"),
        (model.clone(), vec![with(7, f32::NAN)], 64, centre, "NaN"),
        (model.clone(), vec![dark], 64, centre, "no light"),
        (model.clone(), vec![], 64, centre, "no map"),
        (empty, vec![good.clone()], 64, centre, "no face"),
        (model.clone(), vec![good.clone()], 1, centre, "1x1"),
        (model.clone(), vec![good.clone()], 64, DVec3::NAN, "NaN"),
    ] {
        let captures: Vec<Capture> = maps.iter().map(|map| capture(map, centre)).collect();
        let message = texture(model, &captures, size, &Silent).map(|_| ()).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("; "), "{message}");
    }
}

#[test]
fn a_room_is_written_and_its_model_read_again_with_the_texture_in_place() {
    let (model, centre) = (furnished(), DVec3::new(-0.5, 1.4, 0.3));
    let map = map(&model, centre, 64, DQuat::IDENTITY, paint);
    let room = texture(model, &[capture(&map, centre)], 128, &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    room.write(folder.path()).unwrap();
    for name in rigel::room::FILES {
        assert!(folder.path().join(name).metadata().unwrap().len() > 0, "{name}");
    }
    let again = Model::read(&folder.path().join("room.obj")).unwrap();
    let back = texture(again, &[capture(&map, centre)], 128, &Silent).unwrap();
    for (own, back) in room.charts.corners.iter().flatten().zip(back.charts.corners.iter().flatten()) {
        assert!(own.distance(*back) < 1e-3);
    }
}

//! Observation maps and parameter maps.

use std::path::Path;

use exr::prelude::{FlatSamples, WritableImage, f16, read_first_flat_layer_from_file, write_rgb_file};

use super::*;

#[test]
fn maps_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: |folder| cut(&folder.join("session/observations.rigel"), 0.9),
            arguments: FIT,
            names: &["observations.rigel", "cut short", "rigel observe"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/observations.rigel"), 0.003),
            arguments: FIT,
            names: &["observations.rigel", "rigel observe"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("session/observations.rigel"), "").unwrap(),
            arguments: FIT,
            names: &["observations.rigel", "not an observation map"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "phong.exr"],
            names: &["phong.exr", "not an observation map"],
        },
        Case { spoil: nothing, arguments: &["fit", "none.rigel"], names: &["none.rigel", "check the path"] },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--model", "phong2"],
            names: &["observations.rigel", "phong2 needs 9 views", "smaller model"],
        },
        Case {
            spoil: nothing,
            arguments: &[
                "fit",
                "session/observations.rigel",
                "--model",
                "phong",
                "--without",
                "view001,view002,view003",
            ],
            names: &["observations.rigel", "phong needs 5 views", "4"],
        },
        Case {
            spoil: nothing,
            arguments: &[
                "fit",
                "session/observations.rigel",
                "--without",
                "view000,view001,view002,view003,view004,view005,view006",
            ],
            names: &["observations.rigel", "leave fewer out"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--model", "blinn"],
            names: &["blinn", "phong"],
        },
        Case {
            spoil: nothing,
            arguments: &["fit", "session/observations.rigel", "--without", "view999"],
            names: &["observations.rigel", "view999", "view000"],
        },
        Case { spoil: not_a_number, arguments: RENDER, names: &["phong.exr", "NaN", "rigel fit"] },
        Case { spoil: not_a_number, arguments: EVALUATE, names: &["phong.exr", "NaN", "rigel fit"] },
        Case { spoil: other_exr, arguments: RENDER, names: &["phong.exr", "no parameter map", "rigel fit"] },
        Case {
            spoil: other_exr,
            arguments: EVALUATE,
            names: &["phong.exr", "no parameter map", "rigel fit"],
        },
        Case { spoil: half_map, arguments: RENDER, names: &["phong.exr", "OpenEXR", "rigel fit"] },
        Case { spoil: half_map, arguments: EVALUATE, names: &["phong.exr", "OpenEXR", "rigel fit"] },
        Case {
            spoil: |folder| fs::write(folder.join("phong.exr"), "once upon a time").unwrap(),
            arguments: RENDER,
            names: &["phong.exr", "OpenEXR"],
        },
        Case { spoil: nothing, arguments: &["render", "none.exr"], names: &["none.exr", "check the path"] },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--out", "picture.gif"],
            names: &["picture.gif", "gif", ".png"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--tilt", "95"],
            names: &["not above the surface"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--gamma", "0"],
            names: &["'0' for '--gamma"],
        },
        Case {
            spoil: nothing,
            arguments: &["render", "phong.exr", "--camera", "lens.json"],
            names: &["lens.json", "centre"],
        },
        Case {
            spoil: nothing,
            arguments: &["evaluate", "phong.exr", "--references", "none.json"],
            names: &["none.json", "check the path"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("list.json"), "[]").unwrap(),
            arguments: &["evaluate", "phong.exr", "--references", "list.json"],
            names: &["list.json"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("session/radiance/view001.exr")).unwrap(),
            arguments: EVALUATE,
            names: &["view001.exr"],
        },
    ]);
}

fn other_exr(folder: &Path) {
    write_rgb_file(folder.join("phong.exr"), 16, 12, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
}

fn half_map(folder: &Path) {
    cut(&folder.join("phong.exr"), 0.5);
}

fn not_a_number(folder: &Path) {
    let path = folder.join("phong.exr");
    let mut image = read_first_flat_layer_from_file(&path).unwrap();
    let channels = &mut image.layer_data.channel_data.list;
    let channel = channels.iter_mut().find(|channel| channel.name.eq("diffuse.R")).unwrap();
    match &mut channel.sample_data {
        FlatSamples::F16(values) => values[17] = f16::NAN,
        FlatSamples::F32(values) => values[17] = f32::NAN,
        FlatSamples::U32(_) => panic!("a coefficient is no whole number"),
    }
    image.write().to_file(&path).unwrap();
}

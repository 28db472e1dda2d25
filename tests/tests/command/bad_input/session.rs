//! Sessions that are none, or damaged.

use std::fs;

use exr::prelude::write_rgb_file;

use super::common::succeed;
use super::*;

#[test]
fn sessions_that_are_none_or_damaged() {
    const RADIANCE: &[&str] = &["radiance", "session", "--response", "srgb"];
    const OBSERVE: &[&str] = &["observe", "session", "--texels", "16x12"];
    hold(&[
        Case {
            spoil: nothing,
            arguments: &["radiance", "photos"],
            names: &["photos", "not a session", "import"],
        },
        Case { spoil: nothing, arguments: &["observe", "nowhere"], names: &["nowhere", "not a session"] },
        Case {
            spoil: nothing,
            arguments: &["import", "photos", "session", "--csv", "views.csv"],
            names: &["session", "not empty", "choose a new folder"],
        },
        Case {
            spoil: |folder| edit(&folder.join("session/journal.jsonl"), "\"view\":", "\"few\":"),
            arguments: RADIANCE,
            names: &["journal.jsonl", "line 1", "remove that line", "view_done"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/journal.jsonl");
                let mut bytes = fs::read(&path).unwrap();
                let second = bytes.iter().position(|&byte| byte == b'\n').unwrap() + 10;
                bytes[second] = 0xff;
                fs::write(path, bytes).unwrap();
            },
            arguments: OBSERVE,
            names: &["journal.jsonl", "line 2"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/journal.jsonl");
                let text = fs::read_to_string(&path).unwrap().replacen("\"view\":1", "\"view\":99", 1);
                // As if it had been written so, in a journal without checksums.
                let lines = text.lines().map(|line| line.split(",\"crc\"").next().unwrap());
                fs::write(path, lines.map(|line| format!("{line}}}\n")).collect::<String>()).unwrap();
            },
            arguments: RADIANCE,
            names: &["journal.jsonl", "view 99", "restore"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/journal.jsonl");
                let text = fs::read_to_string(&path).unwrap();
                let at = text.find("view002_1").unwrap();
                let text = text[..at].to_owned()
                    + &text[at..].replacen("\"exposure_s\":0.01", "\"exposure_s\":null", 1);
                let lines = text.lines().map(|line| line.split(",\"crc\"").next().unwrap());
                fs::write(path, lines.map(|line| format!("{line}}}\n")).collect::<String>()).unwrap();
            },
            arguments: RADIANCE,
            names: &["view002_1.png", "has no exposure time", "view000_0.png", "import again"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/session.toml"), 0.4),
            arguments: RADIANCE,
            names: &["session.toml"],
        },
        Case {
            spoil: |folder| edit(&folder.join("session/session.toml"), "format = 1", "format = 7"),
            arguments: OBSERVE,
            names: &["session.toml", "format 7"],
        },
        Case {
            spoil: |folder| edit(&folder.join("session/session.toml"), "surface = \"200mmx150mm\"", ""),
            arguments: OBSERVE,
            names: &["session", "--surface"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("session/radiance/view004.exr")).unwrap(),
            arguments: OBSERVE,
            names: &["view004.exr", "missing", "rigel radiance"],
        },
        Case {
            spoil: |folder| {
                let path = folder.join("session/radiance/view002.exr");
                write_rgb_file(path, 80, 60, |_, _| (1.0f32, 1.0f32, 1.0f32)).unwrap();
            },
            arguments: OBSERVE,
            names: &["view002.exr", "not Rigel's radiance", "rigel radiance"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/radiance/view002.exr"), 0.6),
            arguments: OBSERVE,
            names: &["view002.exr", "make it again"],
        },
        Case {
            spoil: nothing,
            arguments: &["radiance", "session", "--response", "none.csv"],
            names: &["none.csv", "check the path"],
        },
        Case {
            spoil: |folder| cut(&folder.join("session/photographs/view005_1.png"), 0.5),
            arguments: &["radiance", "session", "--response", "linear"],
            names: &["view005_1.png", "complete"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("session/photographs/view005_1.png")).unwrap(),
            arguments: &["radiance", "session", "--response", "linear"],
            names: &["view005_1.png", "check the path"],
        },
    ]);
}

#[test]
fn photographs_of_unknown_times_are_no_bracket() {
    fn unknown(folder: &Path) {
        fs::create_dir(folder.join("some")).unwrap();
        for i in 0..6u8 {
            let even = image::RgbImage::from_pixel(8, 8, image::Rgb([20 << (i % 3); 3]));
            even.save(folder.join(format!("some/{i}.png"))).unwrap();
        }
        succeed(folder, &["import", "some", "new", "--bracket", "3", "--exposure-times-unknown"]);
    }
    let names = &["1.png", "one of 3 photographs", "nobody knows", "--exposure-times"];
    hold(&[
        Case { spoil: unknown, arguments: &["radiance", "new", "--response", "srgb"], names },
        Case { spoil: unknown, arguments: &["radiance", "new", "--response", "linear"], names },
        Case { spoil: unknown, arguments: &["radiance", "new"], names },
    ]);
}

#[test]
fn a_lens_for_pictures_of_another_size_is_refused_without_squares() {
    hold(&[
        Case {
            spoil: |folder| edit(&folder.join("lens.json"), "\"width\": 80", "\"width\": 160"),
            arguments: &["register", "session", "--lens", "lens.json"],
            names: &["view000.exr", "80x60", "160x60", "--lens"],
        },
        Case {
            spoil: |folder| {
                succeed(folder, &["register", "session"]);
                edit(&folder.join("session/registration.toml"), "width = 80", "width = 160");
                // It tells by itself that it is of other poses.
                std::fs::remove_file(folder.join("session/photometry.toml")).unwrap();
            },
            arguments: EVALUATE,
            names: &["view001.exr", "80x60", "160x60", "register again"],
        },
        Case {
            // Another version's, which has no such entries.
            spoil: |folder| fs::write(folder.join("session/registration.toml"), "format = 1\n").unwrap(),
            arguments: EVALUATE,
            names: &["registration.toml", "has format 1", "rigel register"],
        },
    ]);
}

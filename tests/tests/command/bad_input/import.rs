//! What `rigel import` is given.

use std::fs;
use std::path::Path;

use exr::prelude::write_rgb_file;

use super::common::{assert_refused, assert_untouched, rigel, snapshot, workshop};
use super::*;

const CSV: &[&str] = &["import", "photos", "new", "--csv", "views.csv"];
const FOLDER: &[&str] = &["import", "some", "new"];

/// A folder `some` with one picture of a gradient.
fn picture(folder: &Path, name: &str) -> std::path::PathBuf {
    fs::create_dir_all(folder.join("some")).unwrap();
    let path = folder.join("some").join(name);
    match name.ends_with(".exr") {
        true => write_rgb_file(&path, 40, 30, |x, y| (x as f32, y as f32, 1.0f32)).unwrap(),
        false => image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([x as u8, y as u8, (x * y % 251) as u8]))
            .save(&path)
            .unwrap(),
    }
    path
}

#[test]
fn photographs_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: |folder| drop(picture(folder, "plain.jpg")),
            arguments: FOLDER,
            names: &["plain.jpg", "exposure time", "--csv"],
        },
        Case {
            spoil: |folder| drop(picture(folder, "other.png")),
            arguments: &["import", "some", "new", "--bracket", "2"],
            names: &["other.png", "exposure time"],
        },
        Case {
            spoil: |folder| {
                let wide = image::RgbImage::new(90, 60);
                wide.save(folder.join("photos/view003_1.png")).unwrap();
            },
            arguments: CSV,
            names: &["view003_1.png", "90x60", "80x60", "view000_0.png"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("photos/view002_0.png")).unwrap(),
            arguments: CSV,
            names: &["view002_0.png", "check the path"],
        },
        Case {
            spoil: |folder| fs::create_dir(folder.join("some")).unwrap(),
            arguments: FOLDER,
            names: &["some", "no photograph"],
        },
        Case { spoil: nothing, arguments: FOLDER, names: &["some", "check the path"] },
        Case {
            spoil: |folder| cut(&folder.join("photos/view001_0.png"), 0.5),
            arguments: &["import", "photos", "new", "--csv", "views.csv", "--flats", "photos/view001_0.png"],
            names: &["view001_0.png", "complete"],
        },
        Case {
            spoil: |folder| {
                fs::copy(folder.join("photos/view001_0.png"), picture(folder, "view000_0.png")).unwrap();
            },
            arguments: &[
                "import",
                "photos",
                "new",
                "--csv",
                "views.csv",
                "--flats",
                "photos/view000_0.png",
                "some/view000_0.png",
            ],
            names: &["some/view000_0.png", "same name", "photos/view000_0.png"],
        },
    ]);
}

#[test]
fn every_kind_of_photograph_cut_short_or_none_at_all() {
    for name in ["a.jpg", "a.png", "a.tif", "a.exr"] {
        for part in [0.0, 0.02, 0.4, 0.7, 0.95] {
            let folder = workshop();
            cut(&picture(folder.path(), name), part);
            refuse_photograph(folder.path(), name, &format!("{name} cut to {part}"));
        }
        let folder = workshop();
        fs::create_dir(folder.path().join("some")).unwrap();
        fs::write(folder.path().join("some").join(name), "once upon a time").unwrap();
        refuse_photograph(folder.path(), name, &format!("{name} of words"));
        // The right beginning and nonsense after it.
        let path = picture(folder.path(), name);
        let mut bytes = fs::read(&path).unwrap();
        bytes.iter_mut().skip(12).step_by(3).for_each(|byte| *byte = byte.wrapping_mul(31) ^ 0x5a);
        fs::write(&path, bytes).unwrap();
        if name != "a.jpg" {
            // A JPEG file has no checksum: what is wrong with it may look like a photograph.
            refuse_photograph(folder.path(), name, &format!("{name} damaged"));
        }
    }
}

fn refuse_photograph(folder: &Path, name: &str, what: &str) {
    let before = snapshot(folder);
    let output = rigel(folder, &["import", "some", "new", "--exposure-times-unknown"]).output().unwrap();
    assert_refused(what, &output, &[name]);
    assert_untouched(what, &before, &snapshot(folder));
}

#[test]
fn tables_that_cannot_be_used() {
    hold(&[
        Case {
            spoil: |folder| row(folder, 0, |line| line.replace("tilt_deg", "slope")),
            arguments: CSV,
            names: &["views.csv", "no column tilt_deg", "name the columns"],
        },
        Case {
            spoil: |folder| row(folder, 4, |line| line.replace(",1,", ",0,")),
            arguments: CSV,
            names: &["views.csv", "line 5", "view 0 is repeated"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "0.03")),
            arguments: CSV,
            names: &["views.csv", "line 3", "view 0 is repeated", "0.03"],
        },
        Case {
            spoil: |folder| row(folder, 3, |line| line.replace("view001_0", "view000_1")),
            arguments: CSV,
            names: &["views.csv", "view000_1.png", "line 3", "line 4"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "a while")),
            arguments: CSV,
            names: &["views.csv", "line 3", "exposure_s", "a while"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "NaN")),
            arguments: CSV,
            names: &["views.csv", "line 3", "NaN"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.replace("0.01000", "-0.01")),
            arguments: CSV,
            names: &["view000_1.png", "-0.01"],
        },
        Case {
            spoil: |folder| row(folder, 1, |line| line.replace(",0,0", ",first,0")),
            arguments: CSV,
            names: &["views.csv", "line 2", "view is 'first'"],
        },
        Case {
            spoil: |folder| row(folder, 2, |line| line.rsplit_once(',').unwrap().0.to_owned()),
            arguments: CSV,
            names: &["views.csv", "line: 3"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("views.csv"), b"file,view\xff\xfe\n\x80,1\n").unwrap(),
            arguments: CSV,
            names: &["views.csv"],
        },
        Case {
            spoil: |folder| fs::write(folder.join("views.csv"), "").unwrap(),
            arguments: CSV,
            names: &["views.csv"],
        },
        Case {
            spoil: |folder| fs::remove_file(folder.join("views.csv")).unwrap(),
            arguments: CSV,
            names: &["views.csv", "check the path"],
        },
        Case {
            spoil: |folder| edit(&folder.join("lens.json"), "fx", "gx"),
            arguments: CSV,
            names: &["lens.json", "focal length"],
        },
        Case { spoil: |folder| cut(&folder.join("lens.json"), 0.5), arguments: CSV, names: &["lens.json"] },
    ]);
}

//! `rigel calibrate`: what it writes, and what it says of boards that it cannot use.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[expect(dead_code, reason = "each test uses a part of it")]
mod common;

use std::fs;
use std::path::Path;

use common::{assert_refused, assert_untouched, rigel, snapshot, succeed};
use glam::DVec3;
use rigel::calibration::LensModel;
use rigel::geometry::Lens;
use rigel::picture::Picture;
use rigel::view_file::Calibration;
use rigel_simulated::board::{Board, Look, strew};

fn lens() -> Lens {
    Lens { k1: -0.2, k2: 0.05, ..Lens::pinhole(320, 240, 270.0) }
}

fn save(picture: &Picture, path: &Path) {
    let (width, height) = (picture.width, picture.height);
    let level = |x: u32, y: u32| image::Luma([picture.levels[(y * width + x) as usize][0] as u8]);
    image::GrayImage::from_fn(width, height, level).save(path).unwrap();
}

fn photograph(folder: &Path, name: &str, board: &Board, look: &Look) {
    save(&board.photograph(&lens(), look), &folder.join(name));
}

/// A folder with eight photographs of a board of 7 x 5 inner corners.
fn boards() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (i, board) in strew(&lens(), 7, 5, 8, 3).iter().enumerate() {
        photograph(folder.path(), &format!("b{i}.png"), board, &Look { seed: i as u64, ..Look::default() });
    }
    folder
}

/// The arguments of a calibration with all photographs of a folder.
fn arguments<'a>(names: &'a [String], board: &'a str) -> Vec<&'a str> {
    let mut all = vec!["calibrate"];
    all.extend(names.iter().map(String::as_str));
    all.extend(["--board", board, "--square", "30mm", "--out", "lens.toml"]);
    all
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| name.ends_with(".png") || name.ends_with(".jpg"));
    names.sort();
    names
}

/// What is done to the folder, what is asked, what the refusal must name.
type Refused = (fn(&Path), &'static str, &'static [&'static str]);

#[test]
fn what_is_written_is_read_back() {
    let folder = boards();
    let names = names(folder.path());
    let mut arguments = arguments(&names, "7x5");
    arguments.extend(["--residuals", "residuals"]);
    let said = succeed(folder.path(), &arguments);
    assert!(said.contains("calibrated"), "{said}");
    let read = Calibration::read(&folder.path().join("lens.toml"), 0.0).unwrap();
    let (found, covariance) = (read.lens(0, 0), read.covariance().unwrap());
    assert_eq!((found.width, found.height), (320, 240));
    let sigma = covariance[0][0].sqrt();
    assert!((found.fx - 270.0).abs() < 5.0 * sigma && sigma < 2.0, "{} ± {sigma}", found.fx);
    for name in ["residuals.csv", "residuals.svg", "sigma.svg"] {
        assert!(folder.path().join("residuals").join(name).exists(), "{name}");
    }
    // A lens that bends as this one does is no pinhole: that model is refused.
    for model in LensModel::LADDER.into_iter().skip(1) {
        let mut arguments = arguments[..arguments.len() - 2].to_vec();
        arguments.extend(["--model", model.name(), "--force"]);
        assert!(succeed(folder.path(), &arguments).contains(&format!("model {};", model.name())));
    }
}

#[test]
fn a_lens_is_replaced_only_if_that_is_wished_and_its_folder_is_looked_at_first() {
    let folder = boards();
    let names = names(folder.path());
    let arguments = arguments(&names, "7x5");
    fs::write(folder.path().join("lens.toml"), "precious").unwrap();
    let before = snapshot(folder.path());
    let output = rigel(folder.path(), &arguments).output().unwrap();
    assert_refused("a lens that is there", &output, &["lens.toml", "--force"]);
    let elsewhere = [&arguments[..arguments.len() - 1], &["none/lens.toml"]].concat();
    assert_refused(
        "no folder",
        &rigel(folder.path(), &elsewhere).output().unwrap(),
        &["none/lens.toml", "path"],
    );
    assert_untouched("a refused calibration", &before, &snapshot(folder.path()));
    succeed(folder.path(), &[&arguments[..], &["--force"]].concat());
    assert!(Calibration::read(&folder.path().join("lens.toml"), 0.0).is_ok());
}

/// A comma in a file's name, terms that are not estimated, and fewer boards than one would rely on.
#[test]
fn what_is_told_is_what_is_known() {
    let folder = boards();
    (4..8).for_each(|i| fs::remove_file(folder.path().join(format!("b{i}.png"))).unwrap());
    fs::rename(folder.path().join("b0.png"), folder.path().join("b0,1 \"x\".png")).unwrap();
    let names = names(folder.path());
    let mut arguments = arguments(&names, "7x5");
    arguments.extend(["--model", "k1", "--residuals", "residuals"]);
    let said = succeed(folder.path(), &arguments);
    let line = |name: &str| said.lines().find(|line| line.trim_start().starts_with(name)).unwrap_or_default();
    assert!(line("k1 ").contains('±') && line("k3 ").ends_with("0.00000 fixed"), "{said}");
    assert!(said.contains("calibrated roughly, from too few boards (4;"), "{said}");
    let table = fs::read_to_string(folder.path().join("residuals/residuals.csv")).unwrap();
    assert_eq!(table.lines().count(), 1 + 4 * 35);
    assert!(table.contains("\n\"b0,1 \"\"x\"\".png\",0,0,"), "{}", &table[..200]);
}

#[test]
fn boards_that_cannot_be_used_are_named_and_the_others_calibrate() {
    let folder = boards();
    let board = strew(&lens(), 7, 5, 9, 3)[8];
    let look = Look::default();
    photograph(folder.path(), "blurred.png", &board, &Look { blur_px: 16.0, ..look });
    photograph(folder.path(), "clipped.png", &board, &Look { exposure: 40.0, ..look });
    photograph(folder.path(), "dark.png", &board, &Look { exposure: 0.02, ..look });
    let other = Board::at(9, 8, 0.8, DVec3::new(0.3, 0.2, 0.0), DVec3::new(0.0, 0.0, 11.0));
    photograph(folder.path(), "other.png", &other, &look);
    let hidden = board.photograph(&lens(), &look);
    let corner = board.pixel(&lens(), 1.6, 0.0).unwrap();
    let levels = hidden
        .levels
        .iter()
        .enumerate()
        .map(|(i, level)| if (i % 320) as f64 > corner.x { [150; 3] } else { *level });
    save(&Picture { levels: levels.collect(), ..hidden }, &folder.path().join("hidden.png"));
    let said = succeed(folder.path(), &arguments(&names(folder.path()), "7x5"));
    for (name, reason) in [
        ("blurred.png", "blurred"),
        ("clipped.png", "clipped"),
        ("dark.png", "dark"),
        ("other.png", "9x8 corners, 7x5 were asked for"),
        ("hidden.png", "hidden"),
    ] {
        let line = said.lines().find(|line| line.starts_with(name)).unwrap_or_default();
        assert!(line.contains("not used") && line.contains(reason) && line.contains("; "), "{name}: {said}");
    }
    assert!(said.contains("8 boards"), "{said}");
}

#[test]
fn what_makes_no_lens_is_refused_in_a_sentence() {
    let all: &[Refused] = &[
        (
            |_| {},
            "6x4",
            &[
                "b0.png",
                "found a grid of 7x5 corners",
                "6x4 were asked for",
                "these boards have 7x5",
                "--board 7x5",
            ],
        ),
        (
            |_| {},
            "8x6",
            &[
                "b0.png",
                "found a grid of 7x5 corners",
                "8x6 were asked for",
                "these boards have 7x5",
                "--board 7x5",
            ],
        ),
        (|_| {}, "7x4", &["found a grid of 7x5 corners", "7x4 were asked for", "these boards have 7x5"]),
        (|_| {}, "7", &["7", "9x6"]),
        (
            |folder| (1..8).for_each(|i| fs::remove_file(folder.join(format!("b{i}.png"))).unwrap()),
            "7x5",
            &["b0.png", "only 1 usable", "ten positions"],
        ),
        (
            |folder| {
                for i in 0..8 {
                    let shift =
                        DVec3::new(0.1 * f64::from(i) - 0.4, 0.05 * f64::from(i), 9.5 + 0.2 * f64::from(i));
                    let board = Board::at(7, 5, 1.0, DVec3::ZERO, shift);
                    photograph(folder, &format!("b{i}.png"), &board, &Look::default());
                }
            },
            "7x5",
            &["b0.png", "parallel", "tilt the board"],
        ),
        (
            |folder| drop(image::GrayImage::new(200, 100).save(folder.join("c.png"))),
            "7x5",
            &["c.png", "200x100", "320x240", "b0.png", "one size"],
        ),
        (
            |folder| zoom(folder, 0, [18, 35]),
            "7x5",
            &["b1.jpg", "35.0 mm", "18.0 mm", "b0.jpg", "do not zoom"],
        ),
        // The first photograph does not tell.
        (
            |folder| zoom(folder, 1, [24, 50]),
            "7x5",
            &["b2.jpg", "50.0 mm", "24.0 mm", "b1.jpg", "do not zoom"],
        ),
        (|folder| fs::write(folder.join("b3.png"), b"no picture").unwrap(), "7x5", &["b3.png", "complete"]),
    ];
    for (spoil, board, says) in all {
        let folder = boards();
        spoil(folder.path());
        let before = snapshot(folder.path());
        let output = rigel(folder.path(), &arguments(&names(folder.path()), board)).output().unwrap();
        assert_refused(&format!("{says:?}"), &output, says);
        assert_untouched(&format!("{says:?}"), &before, &snapshot(folder.path()));
    }
}

/// Two of the boards as photographs that tell their focal lengths.
fn zoom(folder: &Path, first: usize, focal_mm: [u32; 2]) {
    for (i, focal_mm) in (first..).zip(focal_mm) {
        let picture = image::open(folder.join(format!("b{i}.png"))).unwrap();
        fs::remove_file(folder.join(format!("b{i}.png"))).unwrap();
        let file = fs::File::create(folder.join(format!("b{i}.jpg"))).unwrap();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(file);
        image::ImageEncoder::set_exif_metadata(&mut encoder, focal_length(focal_mm)).unwrap();
        encoder.encode_image(&picture).unwrap();
    }
}

/// An EXIF block that tells a focal length only.
fn focal_length(millimetres: u32) -> Vec<u8> {
    let directory = |tag: u16, kind: u16, value: u32| {
        let mut bytes = vec![1, 0];
        bytes.extend(tag.to_le_bytes());
        bytes.extend(kind.to_le_bytes());
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(value.to_le_bytes());
        bytes.extend([0; 4]);
        bytes
    };
    let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
    bytes.extend(directory(0x8769, 4, 26));
    bytes.extend(directory(0x920a, 5, 44));
    bytes.extend(millimetres.to_le_bytes());
    bytes.extend(1u32.to_le_bytes());
    bytes
}

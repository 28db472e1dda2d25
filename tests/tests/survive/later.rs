//! Cameras that keep their photographs until they are collected.

use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use image::ImageEncoder;
use rigel::camera::exif;
use rigel::capture::capture;
use rigel::measure::{self, measure};
use rigel::progress::Silent;
use rigel::session::{Event, Exposed, Manifest, Precision, Session, collect};

use super::fakes::{Bench, Counting, complete, complete_with, eye, fast, manifest};
use super::{content, files};

#[test]
fn a_camera_that_keeps_its_photographs_exposes_the_whole_bracket_once() {
    let folder = fast();
    let path = folder.path().join("s");
    let mut session = Session::create(&path, manifest()).unwrap();
    // 0.02 s, halved three times.
    assert_eq!(complete(&mut session, true).unwrap(), 3 * 4);
    drop(session);
    let journal = fs::read(path.join("journal.jsonl")).unwrap();
    for cut in (0..=journal.len()).step_by(7) {
        fs::write(path.join("journal.jsonl"), &journal[..cut]).unwrap();
        let mut session = Session::open(&path).unwrap();
        let before = session.waiting().len();
        assert_eq!(complete(&mut session, true).unwrap(), 12 - before, "cut at byte {cut}");
        let stems: Vec<&str> = session.waiting().iter().map(|exposed| exposed.stem.as_str()).collect();
        assert_eq!(stems.len(), 12);
        assert!(stems[0] == "photographs/view000_0" && stems[11] == "photographs/view002_3", "{stems:?}");
        let error = measure(&session, &measure::Options::default(), &Silent);
        assert!(error.unwrap_err().to_string().contains("12 photographs"), "they are not measured yet");
    }
}

/// The files of a camera whose clock is an hour and a quarter of a second late.
fn develop(exposed: &[Exposed], folder: &Path) {
    fs::create_dir(folder).unwrap();
    for (index, exposed) in exposed.iter().enumerate() {
        let at = exposed.at + Duration::from_millis(3_600_250);
        let mut bytes = vec![];
        let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        encoder.set_exif_metadata(exif::block(exposed.asked_exposure_s, Some(at))).unwrap();
        encoder.write_image(&[index as u8 * 15; 12], 2, 2, image::ExtendedColorType::Rgb8).unwrap();
        fs::write(folder.join(format!("dsc{index:04}.png")), bytes).unwrap();
    }
}

#[test]
fn what_a_camera_kept_is_collected_whatever_interrupts_it() {
    let folder = fast();
    let (path, card) = (folder.path().join("s"), folder.path().join("card"));
    let mut session = Session::create(&path, manifest()).unwrap();
    complete(&mut session, true).unwrap();
    let exposed: Vec<Exposed> = session.waiting().into_iter().cloned().collect();
    develop(&exposed, &card);
    let originals = files(&card);
    // One is missing: it cannot be known which, so nothing comes.
    let journal = fs::read(path.join("journal.jsonl")).unwrap();
    fs::rename(card.join("dsc0005.png"), folder.path().join("missing.png")).unwrap();
    let message = collect(&mut session, &card, &Silent).unwrap_err().to_string();
    assert!(message.contains("12 photographs") && message.contains("11 files"), "{message}");
    assert_eq!(fs::read(path.join("journal.jsonl")).unwrap(), journal);
    assert_eq!(fs::read_dir(path.join("photographs")).unwrap().count(), 0);
    fs::rename(folder.path().join("missing.png"), card.join("dsc0005.png")).unwrap();

    assert_eq!(collect(&mut session, &card, &Silent).unwrap(), 12);
    drop(session);
    assert!(files(&card) == originals, "the originals are as they were");
    let whole = content(&path);
    assert_eq!(whole.1.len(), 12);
    for (index, original) in originals.values().enumerate() {
        let copy = format!("photographs/view{:03}_{}.png", index / 4, index % 4);
        assert_eq!(whole.0[Path::new(&copy)], *original);
    }
    let all = fs::read(path.join("journal.jsonl")).unwrap();
    for cut in (journal.len()..all.len()).step_by(101) {
        fs::write(path.join("journal.jsonl"), &all[..cut]).unwrap();
        let mut session = Session::open(&path).unwrap();
        let waiting = session.waiting().len();
        assert_eq!(collect(&mut session, &card, &Silent).unwrap(), waiting);
        assert_eq!(complete(&mut session, true).unwrap(), 0, "nothing is exposed again");
        drop(session);
        assert!(content(&path) == whole, "cut at byte {cut}");
    }
    let message = collect(&mut Session::open(&path).unwrap(), &card, &Silent).unwrap_err().to_string();
    assert!(message.contains("waits for no photographs"), "{message}");
}

#[test]
fn a_wish_for_precision_changes_nothing_where_nobody_sees_the_photographs_and_that_is_told() {
    let (folder, at, taken) = (fast(), Cell::new((0.0, 0.0)), Cell::new(0));
    let manifest = Manifest { precision: Some(Precision::default()), ..manifest() };
    let mut session = Session::create(&folder.path().join("s"), manifest).unwrap();
    let mut camera = Counting { eye: eye(&at), taken: &taken, later: true };
    let doubts = capture(&mut session, &mut Bench::new(&at, &[]), &mut camera, &Silent).unwrap();
    assert_eq!((session.waiting().len(), taken.get()), (12, 12));
    assert!(doubts.len() == 1 && doubts[0].contains("whole bracket"), "{doubts:?}");
}

/// Whoever takes a view again exposes twice, and the camera keeps both.
#[test]
fn a_view_that_was_taken_again_is_collected_without_its_first_photographs() {
    let folder = fast();
    let (path, card) = (folder.path().join("s"), folder.path().join("card"));
    let mut session = Session::create(&path, manifest()).unwrap();
    assert_eq!(complete_with(&mut session, true, &[false, true]).unwrap(), 16, "four of them twice");
    assert_eq!(session.waiting().len(), 12);
    // All that the camera has exposed, the second view's first photographs too.
    let exposed = session.events().iter().filter_map(|event| match event {
        Event::Exposed(exposed) => Some(exposed.clone()),
        _ => None,
    });
    let exposed: Vec<Exposed> = exposed.collect();
    assert_eq!(exposed.len(), 16);
    develop(&exposed, &card);
    let message = collect(&mut session, &card, &Silent).unwrap_err().to_string();
    let strays: Vec<PathBuf> = (4..8).map(|index| card.join(format!("dsc{index:04}.png"))).collect();
    assert!(strays.iter().all(|stray| message.contains(stray.to_str().unwrap())), "{message}");
    assert!(!message.contains("dsc0003") && !message.contains("dsc0008"), "{message}");
    for stray in strays {
        fs::remove_file(stray).unwrap();
    }
    let rest = files(&card);
    assert_eq!(collect(&mut session, &card, &Silent).unwrap(), 12);
    drop(session);
    let whole = content(&path);
    for (index, original) in rest.values().enumerate() {
        let copy = format!("photographs/view{:03}_{}.png", index / 4, index % 4);
        assert_eq!(whole.0[Path::new(&copy)], *original);
    }
    // And from the journal alone.
    assert_eq!(complete(&mut Session::open(&path).unwrap(), true).unwrap(), 0);
}

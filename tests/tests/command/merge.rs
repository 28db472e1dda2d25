//! `rigel radiance --merge debevec`: a published method by its name, to compare with.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

mod common;
#[path = "merge/lamp.rs"]
mod lamp;

use std::fs;
use std::path::Path;

use common::{assert_refused, rigel, succeed, workshop};
use rigel::picture::Picture;
use rigel::radiance::{RadianceImage, Response};
use rigel_tests::data;

/// How many pixels agree in luminance with the published map within a quarter stop, the median factor removed.
fn within_a_quarter_stop(image: &RadianceImage, reference: &Path) -> f64 {
    let picture = Picture::read(reference).unwrap();
    let numbers = Response::linear(picture.white);
    let luminance = |c: [f64; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    let pairs = picture.levels.iter().zip(&image.radiance).filter_map(|(levels, ours)| {
        let theirs = levels.map(|level| f64::from(numbers.exposure(1)[usize::from(level)]));
        (theirs[1] > 0.0).then(|| (luminance(ours.map(f64::from)) / luminance(theirs)).log2())
    });
    let mut stops: Vec<f64> = pairs.collect();
    stops.sort_by(f64::total_cmp);
    let middle = stops[stops.len() / 2];
    stops.iter().filter(|stop| (*stop - middle).abs() <= 0.25).count() as f64 / stops.len() as f64
}

#[test]
fn the_memorial_church_comes_out_as_published_where_the_published_method_is_asked_for() {
    let Some(memorial) = data("hdr/memorial") else { return };
    let folder = tempfile::tempdir().unwrap();
    let (photographs, times) = (folder.path().join("photographs"), memorial.join("memorial.txt"));
    fs::create_dir(&photographs).unwrap();
    for line in fs::read_to_string(&times).unwrap().lines() {
        let Some((name, _)) = line.split_once(' ') else { continue };
        fs::copy(memorial.join(name), photographs.join(name)).unwrap();
    }
    succeed(
        folder.path(),
        &["import", "photographs", "session", "--exposure-times", times.to_str().unwrap()],
    );
    let reference = memorial.join("memorial_debevec_reference.hdr");
    let radiance = |merge: &[&str]| {
        let told = succeed(folder.path(), &[&["radiance", "session"], merge].concat());
        let files = fs::read_dir(folder.path().join("session/radiance")).unwrap();
        let is_exr = |path: &std::path::PathBuf| path.extension().is_some_and(|e| e == "exr");
        let path = files.map(|entry| entry.unwrap().path()).find(is_exr).unwrap();
        let image = RadianceImage::read_exr(&path).unwrap();
        let share = within_a_quarter_stop(&image, &reference);
        println!("memorial {merge:?}: {:.2} % within a quarter stop", 100.0 * share);
        (told, share, image)
    };
    let (told, published, image) = radiance(&["--merge", "debevec"]);
    assert!(told.contains("Debevec") && published >= 0.97, "{published}: {told}");
    // What could not be measured is flagged all the same, and what was has a variance.
    let flagged = image.mask.iter().filter(|&&mask| mask != 0).count();
    assert!(flagged > 0 && image.variance.iter().flatten().all(|v| *v > 0.0));
    // The same again is kept, another merge is not.
    assert!(radiance(&["--merge", "debevec"]).0.contains("0 views now, 1 kept"));
    // Its times were once refused: a power of all of them is no wrong time.
    let (told, ours, _) = radiance(&[]);
    assert!(told.contains("1 views now, 0 kept") && ours < published, "{ours}: {told}");
}

#[test]
fn a_published_method_is_not_asked_for_what_it_cannot_do() {
    let folder = workshop();
    let output = rigel(folder.path(), &["radiance", "session", "--merge", "robertson"]).output().unwrap();
    assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains("debevec"));
    // Photographs of one exposure time each have no response to recover.
    let table = fs::read_to_string(folder.path().join("views.csv")).unwrap();
    let one: Vec<&str> = table.lines().filter(|line| !line.contains("_0.png")).collect();
    let one: Vec<&str> = one.into_iter().filter(|line| !line.contains("_2.png")).collect();
    fs::write(folder.path().join("one.csv"), one.join("\n")).unwrap();
    succeed(
        folder.path(),
        &[&["import", "photos", "single", "--csv", "one.csv"], &common::IMPORT[..]].concat(),
    );
    let output = rigel(folder.path(), &["radiance", "single", "--merge", "debevec"]).output().unwrap();
    assert_refused("a single exposure", &output, &["all the same"]);
}

#[test]
fn a_copied_session_is_not_measured_again_and_an_exchanged_photograph_is() {
    // A copy, all of whose files are newer.
    let folder = workshop();
    let radiance = ["radiance", "session", "--response", "srgb"];
    assert!(succeed(folder.path(), &radiance).contains("0 views now, 7 kept"));
    let photographs = folder.path().join("session/photographs");
    let (one, other) = (photographs.join("view000_0.png"), photographs.join("view001_0.png"));
    let changed = fs::metadata(&one).unwrap().modified().unwrap();
    fs::copy(other, &one).unwrap();
    fs::File::options().write(true).open(&one).unwrap().set_modified(changed).unwrap();
    let output = rigel(folder.path(), &radiance).output().unwrap();
    assert!(!String::from_utf8_lossy(&output.stdout).contains("7 kept"));
}

use std::time::Duration;

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

use super::*;
use crate::camera::exif::CameraTime;

/// A session's exposures and the files of a camera whose clock is wrong, drifts and shows steps of `step_s`.
fn session(rng: &mut StdRng, step_s: f64) -> (Vec<Exposure>, Vec<CameraFile>) {
    let offset_s = f64::from(rng.random_range(-14..14)) * 3600.0 + rng.random_range(-300.0..300.0);
    let skew = rng.random_range(-CLOCK_SKEW..CLOCK_SKEW) / 2.0;
    let start_s = 1_790_000_000.0 + rng.random_range(0.0..1e6);
    let (mut exposures, mut files) = (vec![], vec![]);
    let mut at_s = start_s;
    for view in 0..rng.random_range(2..9) {
        for index in 0..rng.random_range(2..6) {
            let exposure_s = 2.0 / f64::from(1 << index);
            exposures.push(Exposure { at: UNIX_EPOCH + Duration::from_secs_f64(at_s), exposure_s });
            let lag_s = rng.random_range(0.03..0.3);
            let shown_s = at_s + lag_s + offset_s + (at_s - start_s) * skew;
            let clock_s = (shown_s / step_s).floor() * step_s;
            let exif = Exif {
                exposure_s: Some(exposure_s * 2f64.powf(rng.random_range(-0.3..0.3))),
                taken: Some(CameraTime { clock_s, step_s }),
                ..Exif::default()
            };
            let path = format!("dsc{view:02}_{index}.jpg").into();
            files.push(CameraFile { path, exif, sha256: content(rng) });
            at_s += exposure_s + 0.4;
        }
        at_s += rng.random_range(2.0..20.0);
    }
    (exposures, files)
}

/// A content that no other file has.
fn content(rng: &mut StdRng) -> String {
    rng.random::<u64>().to_string()
}

fn many(mut check: impl FnMut(&mut StdRng, Vec<Exposure>, Vec<CameraFile>)) {
    for seed in 0..400 {
        let mut rng = StdRng::seed_from_u64(seed);
        let step_s = [1.0, 0.1, 0.01, 0.001][seed as usize % 4];
        let (exposures, files) = session(&mut rng, step_s);
        check(&mut rng, exposures, files);
    }
}

#[test]
fn a_camera_with_any_constant_error_of_its_clock_is_matched() {
    many(|_, exposures, files| matching(&exposures, &files).unwrap());
}

#[test]
fn a_missing_or_an_extra_file_is_refused_wherever_it_is() {
    many(|rng, exposures, files| {
        let mut missing = files.clone();
        missing.remove(rng.random_range(0..files.len()));
        assert!(matching(&exposures, &missing).unwrap_err().to_string().contains("files"));
        let mut extra = files.clone();
        let stranger = CameraFile { sha256: content(rng), ..files[rng.random_range(0..files.len())].clone() };
        extra.insert(rng.random_range(0..=files.len()), stranger);
        assert!(matching(&exposures, &extra).is_err());
        // One is missing and something else makes up the number.
        let index = rng.random_range(0..files.len());
        for end in [0, files.len() - 1] {
            let mut both = files.clone();
            let mut stranger = both.remove(index);
            stranger.sha256 = content(rng);
            if let Some(taken) = &mut stranger.exif.taken {
                taken.clock_s += if end == 0 { -1e4 } else { 1e4 };
            }
            both.insert(end, stranger);
            let error = matching(&exposures, &both).unwrap_err().to_string();
            assert!(error.contains("dsc") && error.contains(" s "), "{error}");
        }
    });
}

#[test]
fn an_extra_file_within_seconds_of_one_of_the_session_is_named() {
    let mut alone = 0;
    many(|rng, exposures, mut files| {
        // The capture was killed when the contact had closed, and exposed again when it went on.
        let index = rng.random_range(0..files.len());
        let mut extra = files[index].clone();
        (extra.path, extra.sha256) = ("extra.jpg".into(), content(rng));
        if let Some(taken) = &mut extra.exif.taken {
            taken.clock_s += [-1.0, 1.0][rng.random_range(0..2)] * rng.random_range(2.5..9.0);
        }
        files.push(extra);
        files.sort_by(|one, other| {
            let time = |file: &CameraFile| file.exif.taken.unwrap().clock_s;
            time(one).total_cmp(&time(other))
        });
        let error = matching(&exposures, &files).unwrap_err().to_string();
        assert!(error.contains("extra.jpg") && error.contains("collect again"), "{error}");
        alone += usize::from(error.contains("fits no exposure") && !error.contains("dsc"));
    });
    // A few could as well be that of the next view, by a slow clock.
    assert!(alone > 360, "{alone} of 400");
}

#[test]
fn files_are_in_the_order_of_their_clock_whatever_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["100CANON/DSC_9998.jpg", "100CANON/DSC_9999.jpg", "101CANON/DSC_0001.jpg", "DSC_0000.jpg"];
    std::fs::create_dir(folder.path().join("100CANON")).unwrap();
    std::fs::create_dir(folder.path().join("101CANON")).unwrap();
    for (index, name) in names.iter().enumerate() {
        let at = UNIX_EPOCH + Duration::from_secs(1_790_000_000 + index as u64);
        let bytes = crate::camera::folder::tests::photograph(0.5, at, index as u8);
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let found = photographs(folder.path()).unwrap();
    let found: Vec<&Path> = found.iter().map(|f| f.path.strip_prefix(folder.path()).unwrap()).collect();
    assert_eq!(found, names.map(Path::new));
}

#[test]
fn swapped_files_are_refused() {
    many(|rng, exposures, files| {
        let (one, other) = (rng.random_range(0..files.len()), rng.random_range(0..files.len()));
        let mut swapped = files.clone();
        swapped.swap(one, other);
        assert_eq!(matching(&exposures, &swapped).is_ok(), one == other, "{one} {other}");
    });
}

#[test]
fn a_doubled_file_is_refused_whether_it_adds_or_replaces() {
    many(|rng, exposures, files| {
        let (from, to) = (rng.random_range(0..files.len()), rng.random_range(0..files.len()));
        let mut added = files.clone();
        added.insert(to, files[from].clone());
        assert!(matching(&exposures, &added).is_err());
        if from != to {
            let mut replaced = files.clone();
            replaced[to] = files[from].clone();
            assert!(matching(&exposures, &replaced).is_err());
        }
    });
}

#[test]
fn a_clock_that_is_set_in_between_is_refused_and_the_file_is_named() {
    many(|rng, exposures, mut files| {
        let from = rng.random_range(1..files.len());
        let hours = [-1.0, 1.0][rng.random_range(0..2)];
        for file in &mut files[from..] {
            if let Some(taken) = &mut file.exif.taken {
                taken.clock_s += hours * 3600.0;
            }
        }
        let error = matching(&exposures, &files).unwrap_err().to_string();
        assert!(error.contains(&files[from].path.display().to_string()), "{error}");
        assert!(error.contains(if hours > 0.0 { "s later" } else { "s earlier" }), "{error}");
    });
}

#[test]
fn a_wrong_exposure_time_or_a_silent_file_is_refused_by_name() {
    many(|rng, exposures, files| {
        let index = rng.random_range(0..files.len());
        let refused = |change: &dyn Fn(&mut Exif), what: &str| {
            let mut files = files.clone();
            change(&mut files[index].exif);
            let error = matching(&exposures, &files).unwrap_err().to_string();
            assert!(error.contains(&files[index].path.display().to_string()), "{error}");
            assert!(error.contains(what), "{error}");
        };
        let asked_s = exposures[index].exposure_s;
        refused(&|exif| exif.exposure_s = Some(asked_s * 1.3), "was exposed for");
        refused(&|exif| exif.exposure_s = Some(asked_s / 1.3), "was exposed for");
        refused(&|exif| exif.exposure_s = Some(f64::NAN), "was exposed for");
        refused(&|exif| exif.exposure_s = Some(-asked_s), "was exposed for");
        refused(&|exif| exif.exposure_s = None, "exposure time");
        refused(&|exif| exif.taken = None, "when it was taken");
    });
}

#[test]
fn nothing_matches_nothing() {
    matching(&[], &[]).unwrap();
}

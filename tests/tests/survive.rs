//! What a session survives: a journal cut at any byte, damage, strays, a second writer, an old release.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use image::ImageEncoder;
use rigel::camera::{Camera, Shot, exif};
use rigel::capture::capture;
use rigel::geometry::Lens;
use rigel::progress::Silent;
use rigel::rig::{Reached, Rig, RigLimits};
use rigel::session::{Event, Manifest, Session, View, collect};
use rigel::{Error, Result};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::scene::Scene;

/// A rig that is where it is sent.
struct Bench<'a>(&'a Cell<(f64, f64)>);

impl Rig for Bench<'_> {
    fn limits(&self) -> RigLimits {
        RigLimits {
            pan_rad: [-3.2, 3.2],
            tilt_rad: [0.0, 1.5],
            speed_rad_s: 1.0,
            acceleration_rad_s2: 1.0,
            settle_s: 0.25,
        }
    }

    fn move_to(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<Reached> {
        self.0.set((pan_rad, tilt_rad));
        Ok(Reached { pan_rad, tilt_rad, settle_s: 0.25 })
    }

    fn is_there(&mut self, pan_rad: f64, tilt_rad: f64) -> Result<bool> {
        Ok(self.0.get() == (pan_rad, tilt_rad))
    }

    fn describe(&self) -> String {
        "a bench".into()
    }

    fn take_notices(&mut self) -> Vec<String> {
        vec!["the cable was out".into()]
    }
}

/// A small camera that counts its photographs; those that come later stay with it.
struct Counting<'a> {
    eye: SimulatedCamera<Box<dyn Fn() -> (f64, f64) + 'a>>,
    taken: &'a Cell<usize>,
    later: bool,
}

impl Camera for Counting<'_> {
    fn describe(&self) -> String {
        self.eye.describe()
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        [0.002, 2.0]
    }

    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        self.taken.set(self.taken.get() + 1);
        if self.later {
            let at = SystemTime::UNIX_EPOCH + Duration::from_secs(2_000_000_000 + self.taken.get() as u64);
            return Ok(Shot::Later { exposure_s, at });
        }
        self.eye.photograph(exposure_s, stem)
    }

    fn file_size_bytes(&self) -> u64 {
        self.eye.file_size_bytes()
    }
}

fn manifest() -> Manifest {
    let view = |index: usize| View {
        name: format!("view{index:03}"),
        pan_deg: Some(40.0 * index as f64),
        tilt_deg: Some(20.0 * index as f64),
        lens: 0,
        pose: None,
    };
    Manifest {
        views: (0..3).map(view).collect(),
        longest_exposure_s: Some(0.02),
        distance_m: Some(0.9),
        ..Manifest::new("test")
    }
}

/// Where a capture waits for the disk, and there is no disk to wait for.
fn fast() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// Completes a session; returns how many photographs that took.
fn complete(session: &mut Session, later: bool) -> Result<usize> {
    let (at, taken) = (Cell::new((0.0, 0.0)), Cell::new(0));
    let options = Options { lens: Lens::pinhole(16, 12, 35.0), jpeg_quality: None, ..Options::default() };
    let eye = SimulatedCamera::new(Scene::patchwork(), options, Box::new(|| at.get()) as Box<_>);
    capture(session, &mut Bench(&at), &mut Counting { eye, taken: &taken, later }, &Silent)?;
    Ok(taken.get())
}

/// An undisturbed session.
fn undisturbed() -> tempfile::TempDir {
    let folder = fast();
    let mut session = Session::create(&folder.path().join("s"), manifest()).unwrap();
    complete(&mut session, false).unwrap();
    folder
}

fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            found.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    found
}

/// What a session holds: every file but the journal, and what the journal says of every photograph but when it was taken.
fn content(folder: &Path) -> (BTreeMap<PathBuf, Vec<u8>>, Vec<String>) {
    let session = Session::open(folder).unwrap();
    assert_eq!(session.done_views().len(), session.manifest.views.len());
    let photographs = (0..session.manifest.views.len()).flat_map(|view| session.photographs(view));
    let said = photographs.map(|p| format!("{:?}", rigel::session::Photograph { at: None, ..p.clone() }));
    let mut files: BTreeMap<_, _> = files(folder)
        .into_iter()
        .map(|(path, bytes)| (path.strip_prefix(folder).unwrap().to_path_buf(), bytes))
        .collect();
    files.remove(Path::new("journal.jsonl"));
    (files, said.collect())
}

fn restore(folder: &Path, files: &BTreeMap<PathBuf, Vec<u8>>, journal: &[u8]) {
    for (path, bytes) in files {
        fs::write(folder.join(path), bytes).unwrap();
    }
    fs::write(folder.join("journal.jsonl"), journal).unwrap();
}

#[test]
fn a_journal_cut_at_any_byte_resumes_to_the_same_content() {
    let folder = undisturbed();
    let folder = folder.path().join("s");
    let (files, said) = content(&folder);
    let journal = fs::read(folder.join("journal.jsonl")).unwrap();
    assert!(said.len() > 4, "{said:?}");
    for cut in 0..journal.len() {
        restore(&folder, &files, &journal[..cut]);
        let kept = journal[..cut]
            .split_inclusive(|&b| b == b'\n')
            .filter(|line| line.starts_with(b"{\"photograph\"") && line.ends_with(b"\n"));
        let kept = kept.count();
        // What the journal does not have any more may be half or something else.
        for path in files.keys().filter(|path| path.starts_with("photographs")).skip(kept) {
            fs::write(folder.join(path), &journal[..cut % 100]).unwrap();
        }
        let mut session = Session::open(&folder).unwrap();
        assert_eq!(complete(&mut session, false).unwrap(), said.len() - kept, "cut at byte {cut}");
        drop(session);
        assert!(content(&folder) == (files.clone(), said.clone()), "cut at byte {cut}");
    }
}

#[test]
fn damage_at_any_byte_of_a_journal_is_an_error_with_its_line() {
    let folder = undisturbed();
    let folder = folder.path().join("s");
    let journal = fs::read(folder.join("journal.jsonl")).unwrap();
    let mut line = 1;
    for at in 0..journal.len() - 1 {
        let mut damaged = journal.clone();
        damaged[at] = 0xff;
        let hold = |damaged: &[u8]| {
            fs::write(folder.join("journal.jsonl"), damaged).unwrap();
            let message = Session::open(&folder).unwrap_err().to_string();
            let named = format!("journal.jsonl: line {line} is damaged");
            assert!(message.contains(&named), "byte {at}: {message}");
        };
        hold(&damaged);
        for bit in 0..8 {
            damaged[at] = journal[at] ^ (1 << bit);
            hold(&damaged);
        }
        line += usize::from(journal[at] == b'\n');
    }
}

#[test]
fn a_damaged_photograph_is_taken_again_and_only_that() {
    let folder = undisturbed();
    let folder = folder.path().join("s");
    let whole = content(&folder);
    let path = folder.join("photographs/view001_0.png");
    let good = fs::read(&path).unwrap();
    let mut flipped = good.clone();
    *flipped.last_mut().unwrap() ^= 1;
    for (damage, hashes, found) in [
        (None, false, "photographs/view001_0.png is missing"),
        (Some(&good[..good.len() - 1]), false, "bytes and had"),
        (Some(&flipped[..]), true, "content"),
    ] {
        match damage {
            Some(bytes) => fs::write(&path, bytes).unwrap(),
            None => fs::remove_file(&path).unwrap(),
        }
        let mut session = Session::open(&folder).unwrap();
        let said = session.verify(hashes, &Silent).unwrap();
        assert!(said.len() == 1 && said[0].contains(found), "{said:?}");
        assert_eq!(session.done_views(), [0, 2]);
        assert_eq!(complete(&mut session, false).unwrap(), 1);
        assert_eq!(session.done_views(), [0, 1, 2]);
        drop(session);
        assert!(content(&folder) == whole);
        let mut session = Session::open(&folder).unwrap();
        assert!(session.verify(true, &Silent).unwrap().is_empty());
        assert_eq!(complete(&mut session, false).unwrap(), 0, "nothing is left to do");
    }
}

#[test]
fn a_photograph_tells_how_it_was_taken() {
    let folder = undisturbed();
    let session = Session::open(&folder.path().join("s")).unwrap();
    let Event::Run(run) = &session.events()[0] else { panic!("{:?}", session.events()[0]) };
    assert_eq!((run.rigel.as_str(), run.protocol), (env!("CARGO_PKG_VERSION"), rigel_protocol::VERSION));
    assert_eq!(run.schema, format!("{:08x}", rigel_protocol::SCHEMA));
    assert!(run.rig == "a bench" && run.camera.contains("16x12"), "{run:?}");
    let notices = session.events().iter().filter(|event| match event {
        Event::Notice { at, text } => text == "the cable was out" && *at >= run.at,
        _ => false,
    });
    assert_eq!(notices.count(), 6, "one for each move and one for each bracket");
    let mut before = run.at;
    for view in 0..3 {
        for (index, photograph) in session.photographs(view).iter().enumerate() {
            let place = photograph.place.unwrap();
            assert!((place.commanded_deg[0] - 40.0 * view as f64).abs() < 1e-9);
            assert_eq!((place.reported_deg, place.settle_s), (place.commanded_deg, 0.25));
            assert_eq!(photograph.asked_exposure_s, Some(0.02 / f64::from(1 << index)));
            assert!(photograph.at.unwrap() >= before && photograph.at.unwrap() <= SystemTime::now());
            before = photograph.at.unwrap();
            let bytes = fs::metadata(session.photograph_path(photograph)).unwrap().len();
            assert_eq!(photograph.content.as_ref().unwrap().bytes, bytes);
        }
    }
}

#[test]
fn a_session_has_one_writer() {
    let folder = fast();
    let path = folder.path().join("s");
    let mut first = Session::create(&path, manifest()).unwrap();
    let mut second = Session::open(&path).unwrap();
    let refused = |outcome: Result<usize>| {
        let message = outcome.unwrap_err().to_string();
        assert!(message.contains("another rigel") && message.contains(path.to_str().unwrap()), "{message}");
    };
    refused(complete(&mut second, false));
    complete(&mut first, false).unwrap();
    drop(first);
    let lines = fs::read(path.join("journal.jsonl")).unwrap();
    // What the first has written since the second was opened is not taken again.
    assert_eq!(complete(&mut second, false).unwrap(), 0);
    assert_eq!(fs::read(path.join("journal.jsonl")).unwrap(), lines);
    refused(Session::open(&path).and_then(|mut third| third.lock()).map(|()| 0));
}

#[test]
fn a_start_that_was_killed_starts_again_and_anything_else_is_not_touched() {
    let folder = fast();
    let path = folder.path().join("s");
    drop(Session::create(&path, manifest()).unwrap());
    fs::remove_file(path.join("session.toml")).unwrap();
    fs::write(path.join("session.toml.77.rigel-tmp"), "format =").unwrap();
    let mut session = Session::create(&path, manifest()).unwrap();
    complete(&mut session, false).unwrap();
    drop(session);
    assert!(!path.join("session.toml.77.rigel-tmp").exists());
    let before = files(&path);
    assert!(Session::create(&path, manifest()).unwrap_err().to_string().contains("not empty"));
    assert!(files(&path) == before);
}

/// What the first release has written.
#[test]
fn an_old_journal_is_read_and_gone_on_with() {
    let folder = undisturbed();
    let folder = folder.path().join("s");
    let (whole, _) = content(&folder);
    let old = "{\"photograph\":{\"view\":0,\"file\":\"photographs/view000_0.png\",\"exposure_s\":0.02}}\n\
               {\"photograph\":{\"view\":0,\"file\":\"photographs/view000_1.png\",\"exposure_s\":0.01}}\n\
               {\"view_done\":{\"view\":0}}\n\
               {\"photograph\":{\"view\":1,\"file\":\"photographs/view001_0.png\",\"exposure_s\":0.02}}\n";
    restore(&folder, &whole, old.as_bytes());
    let mut session = Session::open(&folder).unwrap();
    assert_eq!(session.done_views(), [0]);
    assert!(
        session.photographs(0).iter().all(|p| p.content.is_none() && p.at.is_none() && p.place.is_none())
    );
    let again = complete(&mut session, false).unwrap();
    let all = (1..3).map(|view| session.photographs(view).len()).sum::<usize>();
    assert_eq!(again, all - 1, "the photograph of the interrupted view is kept");
    assert!(content(&folder).0 == whole);
}

/// A camera whose file lies elsewhere: it is somebody's, and stays.
#[test]
fn a_file_that_a_camera_left_elsewhere_is_not_moved() {
    struct Elsewhere(PathBuf);
    impl Camera for Elsewhere {
        fn describe(&self) -> String {
            "elsewhere".into()
        }
        fn exposure_range_s(&self) -> [f64; 2] {
            [0.01, 1.0]
        }
        fn photograph(&mut self, exposure_s: f64, _stem: &Path) -> Result<Shot> {
            Ok(Shot::Taken(rigel::camera::Taken { file: self.0.clone(), exposure_s }))
        }
        fn file_size_bytes(&self) -> u64 {
            1
        }
    }
    let folder = undisturbed();
    let precious = folder.path().join("s/photographs/view000_0.png");
    let at = Cell::new((0.0, 0.0));
    let mut session = Session::create(&folder.path().join("other"), manifest()).unwrap();
    let error =
        capture(&mut session, &mut Bench(&at), &mut Elsewhere(precious.clone()), &Silent).unwrap_err();
    assert!(matches!(&error, Error::Input { path, .. } if *path == precious), "{error}");
    assert!(precious.is_file());
}

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
        let error = rigel::measure::measure(&session, &rigel::measure::ResponseChoice::Recover, &Silent);
        assert!(error.unwrap_err().to_string().contains("12 photographs"), "they are not measured yet");
    }
}

/// The files of a camera whose clock is an hour and a quarter of a second late.
fn develop(session: &Session, folder: &Path) {
    fs::create_dir(folder).unwrap();
    for (index, exposed) in session.waiting().iter().enumerate() {
        let at = exposed.at + Duration::from_millis(3_600_250);
        let mut bytes = vec![];
        let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        encoder.set_exif_metadata(exif::block(exposed.asked_exposure_s, Some(at))).unwrap();
        encoder.write_image(&[index as u8 * 20; 12], 2, 2, image::ExtendedColorType::Rgb8).unwrap();
        fs::write(folder.join(format!("dsc{index:04}.png")), bytes).unwrap();
    }
}

#[test]
fn what_a_camera_kept_is_collected_whatever_interrupts_it() {
    let folder = fast();
    let (path, card) = (folder.path().join("s"), folder.path().join("card"));
    let mut session = Session::create(&path, manifest()).unwrap();
    complete(&mut session, true).unwrap();
    develop(&session, &card);
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

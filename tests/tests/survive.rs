//! What a session survives: a journal cut at any byte, damage, strays, a second writer, an old release.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

#[path = "survive/fakes.rs"]
mod fakes;
#[path = "survive/later.rs"]
mod later;
#[path = "survive/restless.rs"]
mod restless;

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rigel::camera::{Camera, Shot};
use rigel::capture::capture;
use rigel::progress::Silent;
use rigel::session::{Event, Session};
use rigel::{Error, Result};

use fakes::{Bench, CABLE, complete, fast, manifest};

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
        Event::Notice { at, text } => text == CABLE && *at >= run.at,
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
    let error = capture(&mut session, &mut Bench::new(&at, &[]), &mut Elsewhere(precious.clone()), &Silent)
        .unwrap_err();
    assert!(matches!(&error, Error::Input { path, .. } if *path == precious), "{error}");
    assert!(precious.is_file());
}

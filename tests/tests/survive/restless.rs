//! A rig that does not stand still.

use std::cell::Cell;
use std::path::Path;

use rigel::camera::{Camera, Shot, Taken};
use rigel::capture::capture;
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel::session::{Event, Manifest, Session};
use rigel::{Error, Result};

use super::fakes::{Bench, RESTARTED, fast, manifest};

/// A camera whose photographs are told apart, each darker than the one before; it fails where it is told to.
struct Counter {
    taken: u8,
    fails_at: Option<u8>,
}

impl Camera for Counter {
    fn describe(&self) -> String {
        "a counter".into()
    }

    fn exposure_range_s(&self) -> [f64; 2] {
        [0.01, 1.0]
    }

    fn photograph(&mut self, exposure_s: f64, stem: &Path) -> Result<Shot> {
        self.taken += 1;
        if self.fails_at == Some(self.taken) {
            return Err(Error::request("no film", "load one"));
        }
        let file = stem.with_extension("png");
        // The first bracket has three photographs, and all others have two.
        let saturated = exposure_s > 0.6 || (exposure_s > 0.3 && self.taken < 3);
        let level = if saturated { 255 } else { self.taken };
        image::RgbImage::from_pixel(4, 4, image::Rgb([level; 3])).save(&file).unwrap();
        Ok(Shot::Taken(Taken { file, exposure_s }))
    }

    fn file_size_bytes(&self) -> u64 {
        100
    }
}

/// Two views.
fn session(folder: &Path) -> Session {
    let views = manifest().views[..2].to_vec();
    let manifest = Manifest { views, longest_exposure_s: Some(1.0), ..Manifest::new("test") };
    Session::create(&folder.join("s"), manifest).unwrap()
}

/// How often the journal says that the rig has restarted.
fn restarts(session: &Session) -> usize {
    let told = |event: &&Event| matches!(event, Event::Notice { text, .. } if text == RESTARTED);
    session.events().iter().filter(told).count()
}

#[test]
fn a_view_in_which_the_rig_restarts_is_taken_again() {
    let (folder, at) = (fast(), Cell::new((0.0, 0.0)));
    let mut session = session(folder.path());
    let (mut rig, mut camera) = (Bench::new(&at, &[true, true]), Counter { taken: 0, fails_at: None });
    capture(&mut session, &mut rig, &mut camera, &Silent).unwrap();
    assert_eq!((rig.homings, restarts(&session)), (3, 2));
    // Three photographs, then two, then the two that count; and two of the other view.
    assert_eq!(camera.taken, 9);
    let session = Session::open(&folder.path().join("s")).unwrap();
    assert_eq!(session.done_views(), [0, 1]);
    let photographs = session.photographs(0);
    assert_eq!(photographs.len(), 2, "the third of the first bracket counts no longer");
    let last = Picture::read(session.photograph_path(photographs[1])).unwrap();
    assert_eq!(last.levels[0], [7; 3]);
}

#[test]
fn a_rig_that_never_stands_still_is_an_error_and_its_photographs_do_not_count() {
    let (folder, at) = (fast(), Cell::new((0.0, 0.0)));
    let mut session = session(folder.path());
    let (mut rig, mut camera) = (Bench::new(&at, &[true; 3]), Counter { taken: 0, fails_at: None });
    let error = capture(&mut session, &mut rig, &mut camera, &Silent).unwrap_err().to_string();
    assert!(error.contains("view000") && error.contains("a bench"), "{error}");
    assert!(session.photographs(0).is_empty() && session.done_views().is_empty());
    let mut camera = Counter { taken: 100, fails_at: None };
    capture(&mut session, &mut Bench::new(&at, &[]), &mut camera, &Silent).unwrap();
    assert_eq!((session.done_views().len(), camera.taken), (2, 104));
}

#[test]
fn what_a_rig_told_before_a_failure_is_in_the_journal() {
    let (folder, at) = (fast(), Cell::new((0.0, 0.0)));
    let mut session = session(folder.path());
    let mut rig = Bench::new(&at, &[true]);
    let mut camera = Counter { taken: 0, fails_at: Some(4) };
    assert!(capture(&mut session, &mut rig, &mut camera, &Silent).is_err());
    assert_eq!(restarts(&session), 1);
}

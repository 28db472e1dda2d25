//! A rig that does not stand still.

use super::*;
use crate::camera::Taken;
use crate::rig::{Reached, RigLimits};
use std::path::Path;

/// A rig that restarts in the brackets that it is told to.
struct Restless {
    /// For every bracket to come: whether it restarts in it.
    restarts: Vec<bool>,
    notices: Vec<String>,
    homings: usize,
    homed: bool,
}

impl Restless {
    fn new(restarts: &[bool]) -> Self {
        let restarts = restarts.iter().rev().copied().collect();
        Self { restarts, notices: vec![], homings: 0, homed: false }
    }
}

impl Rig for Restless {
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
        self.homings += usize::from(!self.homed);
        self.homed = true;
        Ok(Reached { pan_rad, tilt_rad, settle_s: 0.25 })
    }

    fn is_there(&mut self, _pan_rad: f64, _tilt_rad: f64) -> Result<bool> {
        if self.restarts.pop().unwrap_or(false) {
            self.homed = false;
            self.notices.push("the rig has restarted".into());
        }
        Ok(self.homed)
    }

    fn describe(&self) -> String {
        "a restless rig".into()
    }

    fn take_notices(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notices)
    }
}

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

fn session(folder: &Path) -> Session {
    let view = |index: usize| View {
        name: format!("view{index:03}"),
        pan_deg: Some(10.0 * index as f64),
        tilt_deg: Some(20.0),
        lens: 0,
        pose: None,
    };
    let views = (0..2).map(view).collect();
    let manifest = Manifest { views, longest_exposure_s: Some(1.0), ..Manifest::new("test") };
    Session::create(&folder.join("s"), manifest).unwrap()
}

fn notices(session: &Session) -> usize {
    session.events().iter().filter(|event| matches!(event, Event::Notice { .. })).count()
}

#[test]
fn a_view_in_which_the_rig_restarts_is_taken_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = session(folder.path());
    let (mut rig, mut camera) = (Restless::new(&[true, true]), Counter { taken: 0, fails_at: None });
    capture(&mut session, &mut rig, &mut camera, &Silent).unwrap();
    assert_eq!((rig.homings, notices(&session)), (3, 2));
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
    let folder = tempfile::tempdir().unwrap();
    let mut session = session(folder.path());
    let (mut rig, mut camera) = (Restless::new(&[true; 3]), Counter { taken: 0, fails_at: None });
    let error = capture(&mut session, &mut rig, &mut camera, &Silent).unwrap_err().to_string();
    assert!(error.contains("view000") && error.contains("a restless rig"), "{error}");
    assert!(session.photographs(0).is_empty() && session.done_views().is_empty());
    let mut camera = Counter { taken: 100, fails_at: None };
    capture(&mut session, &mut Restless::new(&[]), &mut camera, &Silent).unwrap();
    assert_eq!((session.done_views().len(), camera.taken), (2, 104));
}

#[test]
fn what_a_rig_told_before_a_failure_is_in_the_journal() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = session(folder.path());
    let mut rig = Restless::new(&[true]);
    let mut camera = Counter { taken: 0, fails_at: Some(4) };
    assert!(capture(&mut session, &mut rig, &mut camera, &Silent).is_err());
    assert_eq!(notices(&session), 1);
}

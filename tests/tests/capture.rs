//! Capture sessions on the simulated rig and camera: interrupted, unplugged, resumed.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use rigel::camera::Camera;
use rigel::capture::{add_views, bracket, capture, plan};
use rigel::geometry::Lens;
use rigel::picture::Picture;
use rigel::progress::{Progress, Silent};
use rigel::rig::{Rig, SerialPlace, SerialRig, Timing};
use rigel::sampling::{icosphere, tour};
use rigel::session::{Event, Journal, Manifest, Session};
use rigel::{Error, Result};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::rig::{Faults, RigOptions, SimulatedRig};
use rigel_simulated::scene::Scene;

const LONGEST_S: f64 = 0.1;
const VIEWS: usize = 13;

/// A rig in a hurry.
fn rig(faults: Faults) -> SimulatedRig {
    SimulatedRig::start(RigOptions { speed_factor: 200.0, faults, ..RigOptions::default() }).unwrap()
}

fn camera(rig: &SimulatedRig) -> SimulatedCamera<impl Fn() -> (f64, f64) + use<>> {
    let position = rig.position();
    let options = Options { lens: Lens::pinhole(64, 48, 140.0), ..Options::default() };
    SimulatedCamera::new(Scene::patchwork(), options, move || {
        (position.now().pan_rad, position.now().tilt_rad)
    })
}

fn manifest(rig: &dyn Rig) -> Manifest {
    let mut manifest =
        Manifest { distance_m: Some(0.9), longest_exposure_s: Some(LONGEST_S), ..Manifest::new("simulated") };
    let directions = icosphere(1, 1.2).unwrap();
    add_views(&mut manifest, &tour(&directions, &rig.limits()).unwrap());
    assert_eq!(manifest.views.len(), VIEWS);
    manifest
}

/// The content of every photograph of finished views.
fn finished(session: &Session) -> BTreeMap<String, Vec<u8>> {
    let done = session.done_views();
    let photographs = done.iter().flat_map(|&view| session.photographs(view));
    photographs.map(|p| (p.file.clone(), std::fs::read(session.photograph_path(p)).unwrap())).collect()
}

/// Resumes with a fresh rig and checks that the session is then complete and nothing finished was touched.
fn resume_and_check(folder: &Path, before: &BTreeMap<String, Vec<u8>>) {
    let simulated = rig(Faults::default());
    let mut serial = SerialRig::open(simulated.port_name()).unwrap();
    let mut session = Session::open(folder).unwrap();
    capture(&mut session, &mut serial, &mut camera(&simulated), &Silent).unwrap();
    let session = Session::open(folder).unwrap();
    assert_eq!(session.done_views().len(), VIEWS);
    let after = finished(&session);
    assert!(before.iter().all(|(file, bytes)| after[file] == *bytes), "a finished photograph was touched");
    for view in 0..VIEWS {
        let times: Vec<f64> = session.photographs(view).iter().map(|p| p.exposure_s.unwrap()).collect();
        assert!(times.windows(2).all(|pair| (pair[0] / pair[1] - 2.0).abs() < 1e-2), "{times:?}");
    }
}

#[test]
fn a_bracket_ends_with_the_first_photograph_that_is_not_saturated() {
    let folder = tempfile::tempdir().unwrap();
    let simulated = rig(Faults::default());
    let mut serial = SerialRig::open(simulated.port_name()).unwrap();
    let mut session = Session::create(&folder.path().join("s"), manifest(&serial)).unwrap();
    capture(&mut session, &mut serial, &mut camera(&simulated), &Silent).unwrap();
    for view in 0..VIEWS {
        let photographs = session.photographs(view);
        let saturated =
            |file| Picture::read(file).unwrap().levels.iter().flatten().any(|&level| level >= 250);
        for (index, photograph) in photographs.iter().enumerate() {
            let last = index + 1 == photographs.len();
            assert_eq!(
                saturated(session.photograph_path(photograph)),
                !last,
                "view {view} photograph {index}"
            );
        }
    }
}

#[test]
fn an_unplugged_rig_is_named_and_the_session_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("s");
    let simulated = rig(Faults { unplug_after: Some(30), ..Faults::default() });
    let timing = Timing { return_time: Duration::from_millis(200), ..Timing::default() };
    // Another test's rig may take over the name of a port that is gone.
    let place = Box::new(SerialPlace::among(simulated.port_name(), Vec::new));
    let mut serial = SerialRig::greet_at(place, timing).unwrap();
    let mut session = Session::create(&folder, manifest(&serial)).unwrap();
    let error = capture(&mut session, &mut serial, &mut camera(&simulated), &Silent).unwrap_err();
    assert!(error.to_string().contains(simulated.port_name()), "{error}");
    let before = finished(&session);
    assert!(!before.is_empty() && session.done_views().len() < VIEWS);
    drop(session);
    resume_and_check(&folder, &before);
}

/// Ctrl-C after so many steps.
struct InterruptAfter(AtomicUsize);

impl Progress for InterruptAfter {
    fn step(&self, _done: usize, _total: usize) -> Result<()> {
        if self.0.fetch_sub(1, Ordering::Relaxed) == 1 { Err(Error::Interrupted) } else { Ok(()) }
    }
}

#[test]
fn an_interrupt_at_any_step_leaves_a_session_that_resumes() {
    for step in [1, 2, 5, 12, 20] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("s");
        let simulated = rig(Faults::default());
        let mut serial = SerialRig::open(simulated.port_name()).unwrap();
        let mut session = Session::create(&folder, manifest(&serial)).unwrap();
        let progress = InterruptAfter(AtomicUsize::new(step));
        let error = capture(&mut session, &mut serial, &mut camera(&simulated), &progress).unwrap_err();
        assert!(matches!(error, Error::Interrupted));
        let before = finished(&session);
        drop((session, serial, simulated));
        resume_and_check(&folder, &before);
    }
}

/// After a power cut the last photograph may be empty although the journal has it.
#[test]
fn a_photograph_that_is_missing_or_damaged_is_taken_again() {
    for (from_last, damage) in [(0, None), (0, Some("")), (1, Some("half")), (2, None)] {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("s");
        let simulated = rig(Faults::default());
        let mut serial = SerialRig::open(simulated.port_name()).unwrap();
        let mut session = Session::create(&folder, manifest(&serial)).unwrap();
        capture(&mut session, &mut serial, &mut camera(&simulated), &Silent).unwrap();
        let view = (0..VIEWS).max_by_key(|&view| session.photographs(view).len()).unwrap();
        let count = session.photographs(view).len();
        assert!(count >= 3, "{count}");
        let path = session.photograph_path(session.photographs(view)[count - 1 - from_last]);
        drop((session, serial, simulated));
        // The view is as it is when the capture ends before it is done.
        let journal = folder.join("journal.jsonl");
        let text = std::fs::read_to_string(&journal).unwrap();
        let done = Journal::line(&Event::ViewDone { view });
        assert!(text.contains(&done));
        std::fs::write(&journal, text.replace(&done, "")).unwrap();
        match damage {
            Some(content) => std::fs::write(&path, content).unwrap(),
            None => std::fs::remove_file(&path).unwrap(),
        }
        let before = finished(&Session::open(&folder).unwrap());
        resume_and_check(&folder, &before);
        let session = Session::open(&folder).unwrap();
        assert_eq!(session.photographs(view).len(), count);
        assert!(session.photographs(view).iter().all(|p| Picture::read(session.photograph_path(p)).is_ok()));
    }
}

#[test]
fn what_cannot_be_done_is_refused_before_anything_moves() {
    let simulated = rig(Faults::default());
    let serial = SerialRig::open(simulated.port_name()).unwrap();
    let camera = camera(&simulated);
    let mut beyond = manifest(&serial);
    beyond.views[3].tilt_deg = Some(120.0);
    let error = plan(&beyond, &[], &serial, &camera).unwrap_err().to_string();
    assert!(error.contains("view003") && error.contains("120.0"), "{error}");
    let long = Manifest { longest_exposure_s: Some(99.0), ..manifest(&serial) };
    let error = bracket(&long, &camera).unwrap_err().to_string();
    assert!(error.contains("99 s"), "{error}");
    let all = plan(&manifest(&serial), &[], &serial, &camera).unwrap();
    let rest = plan(&manifest(&serial), &[0, 1, 2], &serial, &camera).unwrap();
    assert_eq!((all.views, rest.views), (VIEWS, VIEWS - 3));
    assert!(rest.most_seconds < all.most_seconds && rest.most_bytes < all.most_bytes);
    assert_eq!(all.most_bytes, all.most_photographs as u64 * camera.file_size_bytes());
}

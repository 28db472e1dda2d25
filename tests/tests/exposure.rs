//! Planned exposure times against halving: the same views of the simulated rig and camera both ways, and what truly comes out.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use rigel::capture::{add_views, capture};
use rigel::geometry::Lens;
use rigel::measure::{self, measure};
use rigel::progress::{Progress, Silent};
use rigel::radiance::RadianceImage;
use rigel::rig::{Rig, SerialRig};
use rigel::sampling::{icosphere, tour};
use rigel::session::{Manifest, Precision, Session};
use rigel::{Error, Result};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::rig::{RigOptions, SimulatedRig};
use rigel_simulated::scene::Scene;

/// The share of the values that is looked at.
const SHARE: f64 = 0.99;

/// How many views a session has.
const VIEWS: usize = 12;

/// What `rigel capture` begins with.
const LONGEST_S: f64 = 1.0;

/// What came out of a session.
struct Outcome {
    photographs: usize,
    doubts: Vec<String>,
    values: Vec<Value>,
}

/// A pixel's radiance in a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Value {
    truth: f64,
    measured: f64,
    /// Standard deviation, as its variance tells it; infinite where it is flagged.
    sigma: f64,
}

impl Outcome {
    /// The relative error that the share of the values has at most: as the variances tell it, and truly. A value's true
    /// error is the root of the mean square of all that are about as bright.
    fn errors(&self) -> [f64; 2] {
        let values = || self.values.iter();
        let told = quantile(values().map(|value| value.sigma / value.measured).collect(), SHARE);
        // The unit of radiance is the session's own.
        let unit = quantile(values().map(|value| value.measured / value.truth).collect(), 0.5);
        let mut classes = BTreeMap::<i32, Vec<f64>>::new();
        for value in values() {
            let class = (4.0 * value.truth.log2()).floor() as i32;
            classes.entry(class).or_default().push(value.measured / value.truth / unit - 1.0);
        }
        let root =
            |errors: &Vec<f64>| (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let truly = classes.values().flat_map(|errors| std::iter::repeat_n(root(errors), errors.len()));
        [told, quantile(truly.collect(), SHARE)]
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).ceil() as usize]
}

/// Ctrl-C after so many steps.
struct InterruptAfter(AtomicUsize);

impl Progress for InterruptAfter {
    fn step(&self, _done: usize, _total: usize) -> Result<()> {
        if self.0.fetch_sub(1, Ordering::Relaxed) == 1 { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// Captures a session, interrupted after so many steps again and again, and measures it.
fn photograph(
    folder: &Path,
    jpeg_quality: Option<u8>,
    precision: Option<Precision>,
    steps: usize,
) -> Outcome {
    let simulated = SimulatedRig::start(RigOptions { speed_factor: 200.0, ..RigOptions::default() }).unwrap();
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    let position = simulated.position();
    let options = Options {
        lens: Lens::pinhole(160, 120, 1400.0),
        vignetting: false,
        jpeg_quality,
        ..Options::default()
    };
    let mut camera = SimulatedCamera::new(Scene::patchwork(), options, move || {
        (position.now().pan_rad, position.now().tilt_rad)
    });
    let mut manifest = Manifest {
        distance_m: Some(0.9),
        longest_exposure_s: Some(LONGEST_S),
        precision,
        ..Manifest::new("simulated")
    };
    add_views(&mut manifest, &tour(&icosphere(2, 0.6).unwrap(), &rig.limits()).unwrap()[..VIEWS]);
    let mut session = Session::create(folder, manifest).unwrap();
    let mut starts = 0;
    let doubts = loop {
        starts += 1;
        assert!(starts < 200, "it does not get on");
        match capture(&mut session, &mut rig, &mut camera, &InterruptAfter(steps.into())) {
            Err(Error::Interrupted) => session = Session::open(folder).unwrap(),
            outcome => break outcome.unwrap(),
        }
    };
    measure(&session, &measure::Options::default(), &Silent).unwrap();

    let (mut photographs, mut values) = (0, vec![]);
    for view in 0..session.manifest.views.len() {
        let taken = session.photographs(view);
        photographs += taken.len();
        let times: Vec<f64> = taken.iter().map(|photograph| photograph.exposure_s.unwrap()).collect();
        println!("{}: {times:?}", session.manifest.views[view].name);
        let [pan_deg, tilt_deg] = taken[0].place.unwrap().reported_deg;
        rig.move_to(pan_deg.to_radians(), tilt_deg.to_radians()).unwrap();
        let truth = camera.truth(&camera.pose());
        values.extend(compare(&RadianceImage::read_exr(&session.radiance_path(view)).unwrap(), &truth));
    }
    Outcome { photographs, doubts, values }
}

fn compare(image: &RadianceImage, truth: &RadianceImage) -> Vec<Value> {
    let values = image.radiance.iter().zip(&image.variance).zip(&truth.radiance);
    values
        .flat_map(|((radiance, variance), truth)| {
            [0, 1, 2].map(|c| Value {
                truth: truth[c].into(),
                measured: radiance[c].into(),
                sigma: f64::from(variance[c]).sqrt(),
            })
        })
        .collect()
}

/// Halving takes as many photographs whatever is wished for; a plan only those that reach it. Both truly reach it.
#[test]
fn a_stated_error_is_reached_with_fewer_photographs() {
    let folder = tempfile::tempdir().unwrap();
    let wish = Precision { relative_error: 0.03, share: SHARE };
    for jpeg_quality in [None, Some(95)] {
        let take = |name: &str, precision| {
            photograph(
                &folder.path().join(format!("{name} {jpeg_quality:?}")),
                jpeg_quality,
                precision,
                usize::MAX,
            )
        };
        let halved = take("halved", None);
        let reached = Precision { relative_error: halved.errors()[0], share: SHARE };
        let (planned, equal) = (take("planned", Some(wish)), take("equal", Some(reached)));
        for (name, outcome) in [("halved", &halved), ("planned", &planned), ("as halved", &equal)] {
            let [told, truly] = outcome.errors().map(|error| 100.0 * error);
            let count = outcome.photographs;
            println!("{jpeg_quality:?}: {name}: {count} photographs, {told:.2} % told and {truly:.2} % true");
        }
        assert_eq!(planned.doubts, [""; 0]);
        // A plan goes by the first view's noise; JPEG's differs from place to place.
        let (slack, as_halved) = if jpeg_quality.is_some() { (1.2, 1.2) } else { (1.05, 1.1) };
        for outcome in [&halved, &planned] {
            let [told, truly] = outcome.errors();
            assert!(
                told <= slack * wish.relative_error && truly <= slack * wish.relative_error,
                "{told} {truly}"
            );
        }
        assert!(planned.photographs * 10 <= halved.photographs * 6, "{}", planned.photographs);
        // Also where as much is wished for as halving itself reaches.
        assert!(equal.photographs * 10 <= halved.photographs * 6, "{}", equal.photographs);
        let ([told, truly], [_, halved_truly]) = (equal.errors(), halved.errors());
        assert!(told <= 1.02 * reached.relative_error && truly <= as_halved * halved_truly, "{told} {truly}");
    }
}

/// Of photographs that saturate nothing there is one for each view, and no response can be learnt.
#[test]
fn a_camera_that_cannot_be_learnt_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let simulated = SimulatedRig::start(RigOptions { speed_factor: 200.0, ..RigOptions::default() }).unwrap();
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    let position = simulated.position();
    let options = Options { lens: Lens::pinhole(160, 120, 1400.0), ..Options::default() };
    let mut camera = SimulatedCamera::new(Scene::patchwork(), options, move || {
        (position.now().pan_rad, position.now().tilt_rad)
    });
    let mut manifest = Manifest {
        longest_exposure_s: Some(2e-4),
        precision: Some(Precision { relative_error: 0.03, share: SHARE }),
        ..Manifest::new("simulated")
    };
    add_views(&mut manifest, &tour(&icosphere(2, 0.5).unwrap(), &rig.limits()).unwrap()[..3]);
    let mut session = Session::create(&folder.path().join("session"), manifest).unwrap();
    let doubts = capture(&mut session, &mut rig, &mut camera, &Silent).unwrap();
    assert!(
        doubts.iter().any(|doubt| doubt.contains("halved, not planned") && doubt.contains("--response")),
        "{doubts:?}"
    );
}

#[test]
fn a_planned_capture_that_is_interrupted_goes_on_as_if_nothing_had_been() {
    let folder = tempfile::tempdir().unwrap();
    let wish = Some(Precision { relative_error: 0.02, share: 0.95 });
    let [whole, resumed] = [usize::MAX, 17]
        .map(|steps| photograph(&folder.path().join(format!("after {steps}")), None, wish, steps));
    assert_eq!(resumed.photographs, whole.photographs);
    assert!(resumed.values == whole.values);
}

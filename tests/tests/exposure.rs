//! Planned exposure times against halving: the same views of the simulated rig and camera both ways, and what truly comes out.

#![expect(clippy::unwrap_used, reason = "a test's helpers panic as a test does")]

use std::path::Path;

use rigel::capture::{add_views, capture};
use rigel::geometry::Lens;
use rigel::measure::{ResponseChoice, measure};
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::rig::{Rig, SerialRig};
use rigel::sampling::{icosphere, tour};
use rigel::session::{Manifest, Precision, Session};
use rigel_simulated::camera::{Options, SimulatedCamera};
use rigel_simulated::rig::{RigOptions, SimulatedRig};
use rigel_simulated::scene::Scene;

/// The share of the values that is looked at.
const SHARE: f64 = 0.99;

/// What came out of a session.
struct Outcome {
    photographs: usize,
    doubts: Vec<String>,
    /// The relative error of every value against the truth, and the one that its variance tells; infinite where it is flagged.
    /// By view.
    errors: Vec<Vec<[f64; 2]>>,
}

impl Outcome {
    /// The relative error that the share of all values has at most: true and told.
    fn at_share(&self) -> [f64; 2] {
        let all: Vec<[f64; 2]> = self.errors.concat();
        [0, 1].map(|kind| quantile(all.iter().map(|error| error[kind]).collect(), SHARE))
    }

    fn median(&self) -> f64 {
        quantile(self.errors.concat().iter().map(|error| error[0]).collect(), 0.5)
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).ceil() as usize]
}

fn photograph(folder: &Path, precision: Option<Precision>) -> Outcome {
    let simulated = SimulatedRig::start(RigOptions { speed_factor: 200.0, ..RigOptions::default() }).unwrap();
    let mut rig = SerialRig::open(simulated.port_name()).unwrap();
    let position = simulated.position();
    let options = Options { lens: Lens::pinhole(160, 120, 350.0), vignetting: false, ..Options::default() };
    let mut camera = SimulatedCamera::new(Scene::patchwork(), options, move || {
        (position.now().pan_rad, position.now().tilt_rad)
    });
    let mut manifest = Manifest {
        distance_m: Some(0.9),
        longest_exposure_s: Some(0.1),
        precision,
        ..Manifest::new("simulated")
    };
    add_views(&mut manifest, &tour(&icosphere(1, 1.3).unwrap(), &rig.limits()).unwrap());
    let mut session = Session::create(folder, manifest).unwrap();
    let doubts = capture(&mut session, &mut rig, &mut camera, &Silent).unwrap();
    measure(&session, &ResponseChoice::Recover, &Silent).unwrap();

    let (mut photographs, mut errors) = (0, vec![]);
    for view in 0..session.manifest.views.len() {
        let taken = session.photographs(view);
        photographs += taken.len();
        let times: Vec<f64> = taken.iter().map(|photograph| photograph.exposure_s.unwrap()).collect();
        println!("{}: {times:?}", session.manifest.views[view].name);
        let [pan_deg, tilt_deg] = taken[0].place.unwrap().reported_deg;
        rig.move_to(pan_deg.to_radians(), tilt_deg.to_radians()).unwrap();
        let truth = camera.truth(&camera.pose());
        errors.push(compare(&RadianceImage::read_exr(&session.radiance_path(view)).unwrap(), &truth));
    }
    // The unit of radiance is the session's own.
    let mut outcome = Outcome { photographs, doubts, errors };
    let all = outcome.errors.concat();
    let ratios: Vec<f64> = all.iter().map(|error| error[0]).filter(|ratio| ratio.is_finite()).collect();
    let unit = quantile(ratios, 0.5);
    outcome.errors.iter_mut().flatten().for_each(|error| error[0] = (error[0] / unit - 1.0).abs());
    outcome
}

/// Ratio to the truth, and relative standard deviation, of every value.
fn compare(image: &RadianceImage, truth: &RadianceImage) -> Vec<[f64; 2]> {
    let values = image.radiance.iter().zip(&image.variance).zip(&truth.radiance);
    values
        .flat_map(|((radiance, variance), truth)| {
            [0, 1, 2].map(|c| {
                let (radiance, variance) = (f64::from(radiance[c]), f64::from(variance[c]));
                if variance.is_finite() {
                    [radiance / f64::from(truth[c]), variance.sqrt() / radiance]
                } else {
                    [f64::INFINITY; 2]
                }
            })
        })
        .collect()
}

#[test]
fn the_same_error_with_fewer_photographs() {
    let folder = tempfile::tempdir().unwrap();
    let halved = photograph(&folder.path().join("halved"), None);
    let [truly, told] = halved.at_share();
    println!(
        "halved: {} photographs, {:.2} % of error ({:.2} % told), median {:.2} %",
        halved.photographs,
        100.0 * truly,
        100.0 * told,
        100.0 * halved.median()
    );
    let precision = Precision { relative_error: told, share: SHARE };
    let planned = photograph(&folder.path().join("planned"), Some(precision));
    let [truly_planned, told_planned] = planned.at_share();
    println!(
        "planned: {} photographs, {:.2} % of error ({:.2} % told), median {:.2} %, {:?}",
        planned.photographs,
        100.0 * truly_planned,
        100.0 * told_planned,
        100.0 * planned.median(),
        planned.doubts
    );
    assert!(truly_planned <= 1.05 * truly, "{truly_planned} where halving has {truly}");
    assert!(
        planned.photographs * 10 <= halved.photographs * 6,
        "{} of {}",
        planned.photographs,
        halved.photographs
    );
}

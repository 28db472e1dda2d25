//! Poses where squares are hidden, bright or elsewhere: found in the radiance of whole views, as `rigel register` does.

use std::path::Path;

use glam::{DVec2, DVec3};
use rigel::calibration::{RegisterOptions, Registration, register};
use rigel::geometry::{Lens, Pose};
use rigel::progress::Silent;
use rigel::radiance::RadianceImage;
use rigel::report::{Picture, Report};
use rigel::{Error, Result, file, render};
use rigel_simulated::squares::{Look, SquaresRig, TrueView};

use super::known_lens;
use crate::figures::{rms, table};
use crate::table::{Table, refused_row};

/// A session of so many views; so many of them are made bad.
const VIEWS: usize = 16;
const BAD: [usize; 4] = [1, 5, 9, 13];

/// What is wrong with a session: its name, what happens to the looks and the commanded angles, and which views are bad.
struct Regime {
    name: &'static str,
    disturb: fn(&mut [(TrueView, Look)]),
    bad: &'static [usize],
    /// Whether the squares file is given.
    squares: bool,
}

const REGIMES: [Regime; 8] = [
    Regime { name: "all well", disturb: |_| (), bad: &BAD, squares: true },
    Regime {
        name: "glare on two squares of four views",
        disturb: |views| BAD.iter().for_each(|&bad| views[bad].1.glare = vec![0, 3]),
        bad: &BAD,
        squares: true,
    },
    Regime {
        name: "glare on all squares of one view",
        disturb: |views| views[5].1.glare = vec![0, 1, 2, 3],
        bad: &[5],
        squares: true,
    },
    Regime {
        name: "the ground saturated in four views",
        disturb: |views| BAD.iter().for_each(|&bad| views[bad].1.saturated = 0.6),
        bad: &BAD,
        squares: true,
    },
    Regime {
        name: "four views dark and noisy",
        disturb: |views| BAD.iter().for_each(|&bad| views[bad].1.noise = 0.25),
        bad: &BAD,
        squares: true,
    },
    Regime {
        name: "two views swapped in the table",
        disturb: |views| {
            let angles = |view: &TrueView| (view.pan_rad, view.tilt_rad);
            let (a, b) = (angles(&views[3].0), angles(&views[10].0));
            (views[3].0.pan_rad, views[3].0.tilt_rad) = b;
            (views[10].0.pan_rad, views[10].0.tilt_rad) = a;
        },
        bad: &[3, 10],
        squares: true,
    },
    Regime {
        name: "a tilt 5 degrees wrong",
        disturb: |views| views[8].0.tilt_rad += 5f64.to_radians(),
        bad: &[8],
        squares: true,
    },
    Regime { name: "no squares: the commanded angles", disturb: |_| (), bad: &BAD, squares: false },
];

/// Steps of progress that [`sweep`] tells.
pub(super) const STEPS: usize = REGIMES.len();

/// Every regime: a row of the table, and a picture of a view that is bad with the squares where the found pose puts them.
pub(super) fn sweep(folder: &Path, report: &mut Report, step: &dyn Fn(usize) -> Result<()>) -> Result<()> {
    report.heading("Poses: where squares are bad");
    let mut rows = Table::new(&[
        "regime",
        "views_kept",
        "bad_views_error_deg",
        "bad_views_stated_deg",
        "other_views_error_deg",
        "other_views_stated_deg",
        "what_is_said",
    ]);
    let mut pictures = vec![];
    for (index, regime) in REGIMES.iter().enumerate() {
        step(index)?;
        let (row, picture) = one(regime)?;
        file::write_bytes(&folder.join(format!("poses_regime_{index}.png")), &picture.png)?;
        rows.row(row);
        pictures.push(picture);
    }
    report.pictures(
        pictures,
        "One bad view of each session of 16: the squares found in its radiance, and in orange where the pose puts them; without orange the \
         view was dropped.",
    );
    table(
        folder,
        report,
        "poses_regimes",
        &rows,
        "What is left of accuracy, what is stated, and what the user is told.",
    )
}

fn one(regime: &Regime) -> Result<(Vec<String>, Picture)> {
    let rig = SquaresRig::new(1);
    let truth = rig.views(VIEWS, 1);
    let looked = truth.iter().zip(0..).map(|(view, seed)| (view.clone(), Look { seed, ..Look::default() }));
    let mut views: Vec<(TrueView, Look)> = looked.collect();
    (regime.disturb)(&mut views);
    let folder = tempfile::tempdir().map_err(Error::io("create", std::env::temp_dir()))?;
    let session = rig.session(&folder.path().join("session"), &views)?;
    let squares = regime.squares.then(|| rig.layout.clone());
    let options = RegisterOptions { squares, lens: Some(known_lens(&rig.lens, 14, 1)?) };
    let shown = regime.bad[0];
    let image = RadianceImage::read_exr(&session.radiance_path(shown))?;
    let found = match register(&session, &options, &Silent) {
        Ok(found) => found,
        Err(refused) => {
            let said = format!("refused: {refused}");
            let row = refused_row(7, &[regime.name], said.clone());
            let caption = format!("{}: {said}", regime.name);
            return Ok((row, Picture { png: drawn(&image, &rig, None)?, caption }));
        }
    };
    let pose = found.view(&truth[shown].name).map(|view| (view.pose, found.lens));
    let [bad, others] = [true, false].map(|bad| figures(&found, &truth, |i| regime.bad.contains(&i) == bad));
    let said = said(&found, &truth, regime.bad);
    let number = |value: f64| if value.is_finite() { format!("{value:.4}") } else { "-".to_owned() };
    let row = vec![
        regime.name.to_owned(),
        format!("{} of {VIEWS}", found.views.len()),
        number(bad.0),
        number(bad.1),
        number(others.0),
        number(others.1),
        said,
    ];
    let caption = match bad.0.is_finite() {
        true => format!("{}: {:.3} degrees off, {:.3} stated", regime.name, bad.0, bad.1),
        false => format!("{}: dropped by name; the others {:.3} degrees off", regime.name, others.0),
    };
    Ok((row, Picture { png: drawn(&image, &rig, pose)?, caption }))
}

/// Root mean squares of the actual and the stated error over some of the views, degrees.
fn figures(found: &Registration, truth: &[TrueView], of: impl Fn(usize) -> bool) -> (f64, f64) {
    let chosen: Vec<(f64, f64)> = truth
        .iter()
        .enumerate()
        .filter(|(i, _)| of(*i))
        .filter_map(|(_, truth)| {
            let view = found.view(&truth.name)?;
            let off_rad = view.direction_error_rad(&truth.pose);
            Some((off_rad.to_degrees(), view.direction_sigma_rad().to_degrees()))
        })
        .collect();
    (rms(chosen.iter().map(|c| c.0)), rms(chosen.iter().map(|c| c.1)))
}

/// What the user learns of the views that are bad.
fn said(found: &Registration, truth: &[TrueView], bad: &[usize]) -> String {
    let mut said: Vec<String> =
        found.dropped.iter().map(|view| format!("{} {}", view.name, view.reason)).collect();
    let corners = |&i: &usize| found.view(&truth[i].name).map(|view| view.corners);
    let few: Vec<String> = bad.iter().filter_map(corners).map(|corners| corners.to_string()).collect();
    if !few.is_empty() {
        said.push(format!("corners used in the bad views: {}", few.join(" ")));
    }
    said.join(" | ")
}

/// A view at half its size; the squares where a pose puts them in orange.
fn drawn(image: &RadianceImage, rig: &SquaresRig, pose: Option<(Pose, Lens)>) -> Result<Vec<u8>> {
    let (width, height) = (image.width as usize / 2, image.height as usize / 2);
    let level = |x: usize, y: usize| {
        let block = [(0, 0), (1, 0), (0, 1), (1, 1)];
        let sum: f32 =
            block.iter().map(|(i, j)| image.radiance[(2 * y + j) * 2 * width + 2 * x + i][1]).sum();
        (255.0 * render::expose(sum / 4.0, 2.0)) as u8
    };
    let mut levels: Vec<[u8; 3]> = (0..width * height).map(|i| [level(i % width, i / width); 3]).collect();
    let Some((pose, lens)) = pose else {
        return render::png(width as u32, height as u32, levels.as_flattened());
    };
    let mut dot = |at: DVec2| {
        let at = ((at + 0.5) / 2.0).floor();
        if at.cmpge(DVec2::ZERO).all() && at.x < width as f64 && at.y < height as f64 {
            levels[at.y as usize * width + at.x as usize] = [0xd5, 0x5e, 0x00];
        }
    };
    for square in 0..rig.layout.centres_m.len() {
        // A little outside, so that the square itself stays to be seen.
        let corners = rig.layout.corners_m(square, 0.2 * rig.layout.size_m);
        for i in 0..4 {
            let (a, b): (DVec3, DVec3) = (corners[i], corners[(i + 1) % 4]);
            (0..=60)
                .filter_map(|k| lens.project(pose.to_camera(a.lerp(b, f64::from(k) / 60.0))))
                .for_each(&mut dot);
        }
    }
    render::png(width as u32, height as u32, levels.as_flattened())
}

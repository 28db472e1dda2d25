//! How far a session's registered poses are from the truth: `pose_score SESSION PATCHWORK [LENS [SQUARES]]`; with
//! `COLUMNS_OF_TEXELS` also what one lobe per texel makes of them.

#![expect(clippy::unwrap_used, reason = "a tool for the bench")]

#[path = "../tests/poses/patchwork.rs"]
#[allow(dead_code, reason = "the test needs the rest")]
mod patchwork;

use std::path::{Path, PathBuf};
use std::time::Instant;

use patchwork::{Truth, gauge_free, summary};
use rigel::calibration::{RegisterOptions, Squares, register};
use rigel::evaluate::{evaluate, read_references};
use rigel::fit::{FitOptions, Model};
use rigel::geometry::Texels;
use rigel::observation::{Options, observe};
use rigel::parameter_map::fit_surface;
use rigel::progress::Silent;
use rigel::session::Session;
use rigel::view_file::Calibration;

fn main() {
    let arguments: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    let session = Session::open(&arguments[0]).unwrap();
    let lens = arguments.get(2).map(|path| {
        let lens = Calibration::read(path, 0.0).unwrap();
        (lens.lens(640, 480), lens.covariance())
    });
    let squares = arguments.get(3).map(|path| Squares::read(Path::new(path)).unwrap());
    let start = Instant::now();
    let found = register(&session, &RegisterOptions { squares, lens }, &Silent).unwrap();
    println!("registered in {:.1?}", start.elapsed());
    for note in &found.notes {
        println!("note: {note}");
    }
    for view in &found.dropped {
        println!("{} {}", view.name, view.reason);
    }
    println!("noise {:?} {:?} {:?}", found.noise, found.deviations, found.rig);
    let truth = Truth::read(&arguments[1]);
    let mut stated: Vec<f64> = found.views.iter().map(|v| v.direction_sigma_rad().to_degrees()).collect();
    stated.sort_by(f64::total_cmp);
    println!("stated: median {:.4}, worst {:.4}", stated[stated.len() / 2], stated[stated.len() - 1]);
    println!("as they are (median, p95, max, within one sigma): {:.4?}", summary(&truth, &found));
    println!("but for the gauge (median, p95, max; within one sigma): {:.4?}", gauge_free(&truth, &found));
    if std::env::var("VIEWS").is_ok() {
        for view in &found.views {
            println!(
                "{} {} {:.4} stated {:.4}",
                view.name,
                view.corners,
                view.direction_error_rad(&truth.pose(&view.name)).to_degrees(),
                view.direction_sigma_rad().to_degrees()
            );
        }
    }
    let Ok(columns) = std::env::var("COLUMNS_OF_TEXELS").map(|n| n.parse::<u32>().unwrap()) else { return };
    found.write(&session).unwrap();
    let texels = Texels { columns, rows: columns * 3 / 4 };
    let map =
        observe(&session, &session.folder().join("scored.rigel"), &Options { texels }, &Silent).unwrap();
    let fitted = fit_surface(&map, Model::Phong { lobes: 1 }, &FitOptions::default(), &[], &Silent).unwrap();
    let references = read_references(&arguments[1].join("truth/eval.json"), 0.5).unwrap();
    let evaluation = evaluate(&fitted, &references, &Silent).unwrap();
    println!(
        "one lobe on {columns} columns: mean {:.2} of 255, PSNR {:.2} dB",
        evaluation.mean_255(),
        evaluation.psnr_db()
    );
}

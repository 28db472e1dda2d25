//! `rigel demo`: the whole road on simulated devices, and a page to look at.

use std::fs;
use std::path::Path;
use std::time::Instant;

use rigel::compare::{compare, describe};
use rigel::evaluate::session_references;
use rigel::geometry::Texels;
use rigel::measure::{self, measure};
use rigel::observation::{self, observe};
use rigel::report::Report;
use rigel::sampling::{icosphere_near, stratified};
use rigel::session::Session;
use rigel::{Error, Result, capture, file};

use super::capture::new_manifest;
use crate::arguments::{CameraChoice, Demo};
use crate::devices::{Devices, With};
use crate::progress::Bar;
use crate::say::say;

/// Written first: only a folder that has it is replaced by the next demo.
const MARK: &str = "rigel-demo.txt";
const ZENITH_LIMIT_DEG: f64 = 75.0;
/// Views that no fit sees, photographed within a zenith where their neighbours can predict them.
const HELD_OUT: usize = 6;
const HELD_OUT_LIMIT_DEG: f64 = 60.0;
const LONGEST_EXPOSURE_S: f64 = 0.25;
const TEXELS: Texels = Texels { columns: 128, rows: 96 };
const MODELS: [&str; 12] = [
    "constant",
    "log-quadratic",
    "phong",
    "phong2",
    "phong3",
    "msh15",
    "msh36",
    "sh16-zero",
    "sh36-zero",
    "sh16-lsop",
    "sh36-lsop",
    "auto",
];

/// `rigel demo`.
pub fn demo(arguments: &Demo) -> Result<()> {
    let start = Instant::now();
    let out = &arguments.out;
    prepare(out)?;
    let mut devices = Devices::open("simulated", &CameraChoice::Simulated, None, With::default())?;
    let mut directions = icosphere_near(73, ZENITH_LIMIT_DEG.to_radians())?;
    let seen = directions.len();
    directions.extend(stratified(HELD_OUT, HELD_OUT_LIMIT_DEG.to_radians(), 1)?);
    let (manifest, stops) = new_manifest(&devices, &directions, LONGEST_EXPOSURE_S)?;
    let held_out: Vec<usize> = (0..stops.len()).filter(|&stop| stops[stop].view >= seen).collect();

    let mut session = Session::create(&out.join("session"), manifest)?;
    devices.photograph_flats(&mut session)?;
    capture::capture(&mut session, &mut *devices.rig, &mut *devices.camera, &Bar::new("capturing"))?;
    let photographs: usize = session.done_views().iter().map(|&view| session.photographs(view).len()).sum();
    say!("captured {seen} views and {HELD_OUT} that no fit will see: {photographs} photographs");

    let measured = measure(&session, &measure::Options::default(), &Bar::new("radiance"))?;
    let path = session.folder().join("observations.rigel");
    let observations =
        observe(&session, &path, &observation::Options { texels: TEXELS }, &Bar::new("observing"))?;
    say!(
        "gathered {}x{} texels: {:.1} MB",
        TEXELS.columns,
        TEXELS.rows,
        observations.header().file_bytes() as f64 / 1e6
    );

    let without: Vec<u32> = held_out.iter().map(|&view| view as u32).collect();
    let references = session_references(&session, &held_out)?;
    let compared = compare(&observations, &MODELS, &without, &references, &Bar::new("fitting"))?;
    for one in &compared {
        let name = &one.name;
        one.map.write(&out.join(format!("{name}.exr")))?;
        say!(
            "{name:>14}: {:5.2} of 255 on held-out views, {:6.2} s to fit",
            one.evaluation.mean_255(),
            one.fit_s
        );
    }

    let mut report = Report::new("Rigel: a simulated surface, captured and reconstructed");
    report.text(
        "A simulated rig turned a patchwork of eight materials under a small and a large lamp; a simulated camera with a distorting, vignetting lens, noise and 8 bits photographed it. Everything below was found from the photographs, the rig's commanded angles and the lens.",
    );
    report.facts([
        ("source", session.manifest.source.clone()),
        ("views", format!("{seen}, and {HELD_OUT} held out")),
        ("photographs", photographs.to_string()),
        (
            "observations absent (saturated, dark or outside the picture)",
            format!("{:.2} %", 100.0 * observations.absent()?),
        ),
        (
            "flat fields against the vignetting model",
            format!("{:.2} %", 100.0 * measured.vignetting_residual.unwrap_or_default()),
        ),
        ("texels", format!("{}x{}", TEXELS.columns, TEXELS.rows)),
        ("version", env!("CARGO_PKG_VERSION").to_string()),
    ]);
    describe(&mut report, &compared, &observations)?;
    let page = out.join("report.html");
    file::write_bytes(&page, report.to_html().as_bytes())?;
    say!(
        "wrote {} in {:.0} s: open {} in a browser",
        out.display(),
        start.elapsed().as_secs_f64(),
        page.display()
    );
    Ok(())
}

/// Makes room for a new demo; refuses to remove anything that no demo made.
fn prepare(out: &Path) -> Result<()> {
    if out.exists() {
        if !out.join(MARK).is_file() {
            return Err(Error::input(
                out,
                "exists and was not made by the demo",
                "choose another folder with --out",
            ));
        }
        fs::remove_dir_all(out).map_err(Error::io("remove", out))?;
    }
    fs::create_dir_all(out).map_err(Error::io("create", out))?;
    file::write_bytes(
        &out.join(MARK),
        b"Everything here was made by `rigel demo`, which replaces it when it runs again.\n",
    )
}

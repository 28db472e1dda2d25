//! How many views `rigel plan` saves on the simulated patchwork.
//!
//! `cargo run --release -p rigel-tests --example plan [FOLDER [PIXELS [COLUMNS]]]`
//!
//! Uniform views (a spiral down to zenith 75 degrees; the thesis's icosphere over the whole hemisphere), and coarse passes to which
//! `plan_views` adds in rounds, are photographed with 1.3 % + 0.002 of noise, observed and fitted; the error is that of 200 other directions
//! down to zenith 75 degrees, against the truth. Writes `plan.csv` and `plan.svg` to FOLDER (default: here).

#![expect(clippy::unwrap_used, reason = "an example panics as a test does")]

#[path = "../tests/plan/world.rs"]
mod world;

use std::f64::consts::FRAC_PI_2;
use std::path::PathBuf;

use glam::DVec3;
use rigel::Result;
use rigel::chart::{Axis, Drawn, Series, lines};
use rigel::file::write_bytes;
use rigel::fit::{FitOptions, Model, candidates as models};
use rigel::observation::ObservationMap;
use rigel::parameter_map::{Selection, fit_surface, select_surface};
use rigel::plan::{candidates, plan_views};
use rigel::progress::Silent;
use rigel::sampling::{icosphere, spiral};
use world::{World, ZENITH_RAD};

/// Views of a coarse pass, and how many each round adds.
const PASSES: [(usize, &[usize]); 2] = [(20, &[10, 10, 10, 10, 20, 20]), (40, &[10, 10, 20, 20])];
const UNIFORM: [usize; 7] = [20, 40, 60, 80, 100, 200, 305];

struct Curve {
    world: World,
    csv: String,
    series: Vec<Series>,
}

impl Curve {
    /// Fits and notes the errors of one set of views.
    fn note(&mut self, method: &str, map: &ObservationMap) -> Result<()> {
        let views = map.header().views.len();
        let one = fit_surface(map, Model::Phong { lobes: 1 }, &FitOptions::default(), &[], &Silent)?;
        let auto = select_surface(map, &models(), &Selection::default(), &[], &Silent)?;
        for (model, fitted) in [("phong", one), ("auto", auto)] {
            let off = self.world.off(&fitted);
            let line = format!("{method},{views},{model},{:.3},{:.3}\n", off.mean, off.rms);
            print!("{line}");
            self.csv += &line;
            if model == "auto" {
                for drawn in [Drawn::Marks, Drawn::Line] {
                    let found = self.series.iter_mut().find(|s| s.name == method && s.drawn == drawn);
                    let point = (views as f64, off.mean);
                    match found {
                        Some(series) => series.points.push(point),
                        None => self.series.push(Series { name: method.into(), points: vec![point], drawn }),
                    }
                }
            }
        }
        Ok(())
    }
}

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().unwrap_or_else(|| ".".into()));
    let mut number = |default| arguments.next().map_or(default, |text| text.parse().unwrap());
    let (pixels, columns) = (number(320), number(64));
    let csv = String::from("method,views,model,mean_255,rms_255\n");
    print!("{csv}");
    let mut curve = Curve { world: World::new(pixels, columns, 200), csv, series: vec![] };
    for count in UNIFORM {
        let map = curve.world.photograph(&format!("uniform{count}"), &spiral(count, ZENITH_RAD)?);
        curve.note("uniform", &map)?;
    }
    for subdivisions in [2, 3] {
        let views = icosphere(subdivisions, FRAC_PI_2)?;
        let map = curve.world.photograph(&format!("icosphere{subdivisions}"), &views);
        curve.note("icosphere to the horizon", &map)?;
    }
    for (coarse, rounds) in PASSES {
        let method = format!("{coarse} uniform, then planned");
        let mut views: Vec<DVec3> = spiral(coarse, ZENITH_RAD)?;
        let mut map = curve.world.photograph(&format!("pass{coarse}"), &views);
        for &more in rounds {
            let plan = plan_views(&map, &candidates(None, ZENITH_RAD)?, more, &Silent)?;
            views.extend(plan.directions);
            map = curve.world.photograph(&format!("pass{coarse}to{}", views.len()), &views);
            curve.note(&method, &map)?;
        }
    }
    let axes = (
        Axis { label: "views", logarithmic: true },
        Axis { label: "mean error in other directions, of 255", logarithmic: true },
    );
    write_bytes(&folder.join("plan.svg"), lines(&curve.series, axes)?.as_bytes())?;
    write_bytes(&folder.join("plan.csv"), curve.csv.as_bytes())
}

//! The thesis's own tests repeated, with its figures beside these.

use std::path::Path;

use glam::Vec3;
use rigel::Result;
use rigel::report::Report;
use rigel::sampling::icosphere;

use super::texels::{Doubt, Truth};
use super::{fit, observe_all};
use crate::figures::table;
use crate::table::Table;

/// Steps that [`sweep`] reports.
pub const STEPS: usize = 6;

/// The thesis's figure 11.5: a red surface of 1000 x 1000 sampled at 8 x 8 points.
const RED: Vec3 = Vec3::new(0.578, 0.0048, 0.0048);
const SIDE: usize = 8;
const LAMP: Vec3 = Vec3::new(1500.0, 1500.0, 2000.0);
/// Its sampling: an icosahedron's 305 directions.
const VIEWS: u32 = 3;
/// Its pictures come from a renderer: no noise but that of eight bits.
const DOUBT: Doubt = Doubt { relative: 0.0, absolute: 0.0011, clip: f32::INFINITY, direction_rad: 0.0 };

/// The surface under lamps (place, intensity), with this shininess.
fn surface(lamps: &[(Vec3, f32)], shininess: f32) -> Vec<Truth> {
    let texel = |i: usize| {
        let at = |i: usize| 1000.0 * ((i as f32 + 0.5) / SIDE as f32 - 0.5);
        let place = Vec3::new(at(i % SIDE), at(i / SIDE), 0.0);
        let mut truth = Truth { diffuse: Vec3::ZERO, lobes: vec![], smooth: [Vec3::ZERO; 9] };
        for (lamp, intensity) in lamps {
            let toward = (lamp - place).normalize();
            truth.diffuse += RED * *intensity * toward.z;
            let mirrored = Vec3::new(-toward.x, -toward.y, toward.z);
            truth.lobes.push((Vec3::splat(0.4 * intensity), mirrored, shininess));
        }
        truth
    };
    (0..SIDE * SIDE).map(texel).collect()
}

fn grid(subdivisions: u32) -> Result<Vec<Vec3>> {
    Ok(icosphere(subdivisions, std::f64::consts::FRAC_PI_2)?.iter().map(|d| d.as_vec3()).collect())
}

/// Runs the tests and adds a table of them.
pub fn sweep(folder: &Path, report: &mut Report, step: &dyn Fn(usize) -> Result<()>) -> Result<()> {
    report.heading("The thesis's tests");
    let mut rows = Table::new(&["test", "case", "model", "mean_error_percent", "thesis"]);
    let mut add =
        |test: &str, case: &str, truths: &[Truth], toward: &[Vec3], of: &[(&str, &str)]| -> Result<()> {
            let observed = observe_all(truths, toward, &DOUBT);
            for (model, thesis) in of {
                let error = fit(model, truths, &observed)?
                    .map_or_else(|| "needs more views".into(), |done| format!("{:.2}", 100.0 * done.error));
                rows.row(vec![test.into(), case.into(), (*model).into(), error, (*thesis).into()]);
            }
            Ok(())
        };
    let all = grid(VIEWS)?;
    step(0)?;
    let point = surface(&[(LAMP, 1.0)], 10.0);
    add("11.3.1", "point light", &point, &all, &[("phong", "0.94, 2.34, 2.34 (R, G, B)"), ("auto", "")])?;
    let around: Vec<(Vec3, f32)> = (0..9)
        .map(|i| (LAMP + Vec3::new((i % 3) as f32 - 1.0, (i / 3) as f32 - 1.0, 0.0) * 300.0, 1.0 / 9.0))
        .collect();
    let area = surface(&around, 10.0);
    add("11.3.1", "area light of nine", &area, &all, &[("phong", "0.69, 4.30, 4.30"), ("auto", "")])?;
    step(1)?;
    for (place, thesis) in
        [(450.0, "0.00, 9.89, 9.89"), (-450.0, "0.00, 20.58, 20.58"), (-1500.0, "0.00, 22.07, 22.07")]
    {
        let two = surface(&[(LAMP, 1.0), (Vec3::new(place, place, 2000.0), 0.7)], 10.0);
        let case = format!("second lamp at {place}");
        add("11.3.2", &case, &two, &all, &[("phong", thesis), ("phong2", ""), ("auto", "")])?;
    }
    step(2)?;
    let unequal = surface(&[(LAMP, 1.2), (Vec3::new(-1500.0, -1500.0, 2000.0), 0.4)], 10.0);
    let harmonics = [
        ("msh15", ""),
        ("sh16-zero", "small highlight not seen"),
        ("sh16-lsop", ""),
        ("msh36", ""),
        ("sh36-zero", "small highlight not seen"),
        ("sh36-lsop", "small highlight seen"),
        ("msh66", ""),
        ("sh64-zero", "small highlight seen"),
        ("sh64-lsop", "acceptable"),
        ("msh91", ""),
        ("sh100-zero", "residuals to 40 %"),
        ("sh100-lsop", "residuals to 40 %, ringing"),
        ("phong2", ""),
    ];
    add("12.5.1", "number of coefficients", &unequal, &all, &harmonics)?;
    step(3)?;
    for shininess in [2.0, 5.0, 15.0, 40.0, 100.0] {
        let case = format!("shininess {shininess}");
        let thesis = if shininess <= 15.0 { "sufficient" } else { "not sufficient" };
        let shiny = surface(&[(LAMP, 1.0)], shininess);
        add("13.1", &case, &shiny, &all, &[("phong", "sufficient"), ("sh36-lsop", thesis), ("msh36", "")])?;
    }
    step(4)?;
    for (subdivisions, thesis) in [(1, "sufficient"), (2, "sufficient"), (3, "sufficient")] {
        let toward = grid(subdivisions)?;
        let case = format!("{} directions", toward.len());
        let lsop = if subdivisions == 3 { "sufficient" } else { "not sufficient" };
        add("13.2", &case, &point, &toward, &[("phong", thesis), ("sh36-lsop", lsop), ("msh36", "")])?;
    }
    step(5)?;
    let mirrored = Vec3::new(-LAMP.x, -LAMP.y, LAMP.z).normalize();
    let mut near: Vec<Vec3> = grid(4)?;
    near.sort_by(|a, b| b.dot(mirrored).total_cmp(&a.dot(mirrored)));
    let concentrated: Vec<Vec3> = grid(2)?.into_iter().chain(near.into_iter().take(81)).collect();
    let case = format!("{} directions, 81 of them around the highlight", concentrated.len());
    let models = [("phong", "no difference to 305"), ("sh36-lsop", "diffuse part worse"), ("msh36", "")];
    add("13.3", &case, &point, &concentrated, &models)?;
    add("13.3", "305 directions", &point, &all, &models)?;
    table(
        folder,
        report,
        "thesis",
        &rows,
        "The thesis gives mean residuals in percent where it gives numbers, and words from looking at pictures elsewhere; ours is the mean relative error in directions between \
         the views against the truth.",
    )
}

//! Several models on one observation map: what each costs and how well it predicts views that it has not seen.

use std::time::Instant;

use crate::Result;
use crate::chart::{self, Axis, ChartPoint, Drawn, Series};
use crate::evaluate::{Evaluation, Reference, evaluate};
use crate::fit::{FitOptions, Model, candidates};
use crate::observation::{Cut, ObservationMap, TexelObservations};
use crate::parameter_map::{ParameterMap, Selection, fit_surface, select_surface};
use crate::progress::{Progress, Silent};
use crate::report::{Picture, Report};

/// One way of fitting, and what came of it.
pub struct Compared {
    /// The model, or `auto` where every texel has its own.
    pub name: String,
    /// Its coefficients.
    pub map: ParameterMap,
    /// Wall-clock time of the fit on all cores, seconds.
    pub fit_s: f64,
    /// Its errors on the reference views.
    pub evaluation: Evaluation,
}

/// Fits without the views `without` each of `names`, models or `auto` for the smallest that suffices for each texel, and evaluates it
/// on `references`.
///
/// # Errors
/// Those of [`Model::parse`], [`fit_surface`], [`select_surface`] and [`evaluate`].
pub fn compare(
    observations: &ObservationMap,
    names: &[&str],
    without: &[u32],
    references: &[Reference],
    progress: &dyn Progress,
) -> Result<Vec<Compared>> {
    let one = |(index, &name): (usize, &&str)| {
        progress.step(index, names.len())?;
        let start = Instant::now();
        let map = match name {
            "auto" => select_surface(observations, &candidates(), &Selection::default(), without, &Silent)?,
            name => fit_surface(observations, Model::parse(name)?, &FitOptions::default(), without, &Silent)?,
        };
        let fit_s = start.elapsed().as_secs_f64();
        let evaluation = evaluate(&map, references, &Silent)?;
        Ok(Compared { name: name.to_owned(), map, fit_s, evaluation })
    };
    let compared = names.iter().enumerate().map(one).collect::<Result<_>>()?;
    progress.step(names.len(), names.len())?;
    Ok(compared)
}

/// Puts the comparison on a page: the best model's pictures, the table, the charts, and a few texels' radiance against direction.
///
/// # Errors
/// What drawing or reading the observation map reports.
pub fn describe(report: &mut Report, compared: &[Compared], observations: &ObservationMap) -> Result<()> {
    let Some(best) =
        compared.iter().min_by(|a, b| a.evaluation.mean_255().total_cmp(&b.evaluation.mean_255()))
    else {
        return Ok(());
    };
    report.heading("Views that the fit has not seen");
    report.text(format!(
        "Left: photographed. Middle: reconstructed by {}. Right: four times the difference, around grey. All exposed by 1 - exp(-gamma x).",
        best.name
    ));
    for (comparison, error) in best.evaluation.comparisons.iter().zip(&best.evaluation.views) {
        let pictures = [
            ("photograph", &comparison.truth),
            ("reconstruction", &comparison.prediction),
            ("difference x 4", &comparison.difference),
        ];
        let pictures = pictures
            .into_iter()
            .map(|(caption, levels)| Ok(Picture { png: comparison.png(levels)?, caption: caption.into() }))
            .collect::<Result<_>>()?;
        report.pictures(
            pictures,
            format!(
                "{}: mean difference {:.2} of 255, PSNR {:.1} dB",
                error.name, error.mean_255, error.psnr_db
            ),
        );
    }
    report.heading("Models compared");
    let texels = observations.header().texels.count() as f64;
    let row = |c: &Compared| {
        vec![
            c.name.clone(),
            format!("{:.2}", c.evaluation.mean_255()),
            format!("{:.1}", c.evaluation.psnr_db()),
            format!("{:.3}", c.fit_s),
            format!("{:.0}", texels / c.fit_s),
            format!("{:.1}", c.map.bytes_per_texel()),
        ]
    };
    report.table(
        "Mean over the held-out views; the fit on all cores.",
        &["model", "error of 255", "PSNR dB", "fit s", "texels per s", "bytes per texel"],
        compared.iter().map(row).collect(),
    );
    let error = Axis { label: "mean error on held-out views, of 255", logarithmic: false };
    let points = |x: &dyn Fn(&Compared) -> f64| -> Vec<ChartPoint> {
        let point = |c: &Compared| {
            let (method, label) = (c.name.clone(), c.name.clone());
            ChartPoint { method, x: x(c), y: c.evaluation.mean_255(), label }
        };
        compared.iter().map(point).collect()
    };
    let time = Axis { label: "time to fit one texel, microseconds on all cores", logarithmic: true };
    report.chart(
        chart::scatter(&points(&|c| c.fit_s / texels * 1e6), (time, error))?,
        "Speed against accuracy: the filled points are not beaten on both.",
    );
    let bytes = Axis { label: "bytes per texel (half floats)", logarithmic: true };
    report.chart(
        chart::scatter(&points(&|c| c.map.bytes_per_texel()), (bytes, error))?,
        "Size against accuracy.",
    );
    report.heading("Radiance against direction");
    for ((column, row), texel) in chosen_texels(observations)? {
        let caption = format!(
            "Texel ({column}, {row}), green: measured views within 10 degrees of the plane through the normal and the brightest view, and the models in that plane."
        );
        report.chart(profile(column, row, &texel, compared)?, caption);
    }
    Ok(())
}

/// The middle texels of four tiles spread over the surface.
fn chosen_texels(observations: &ObservationMap) -> Result<Vec<((u32, u32), TexelObservations)>> {
    let tiles = observations.header().tiles();
    let mut chosen = vec![];
    for (x, y) in [(1, 1), (3, 1), (1, 3), (3, 3)] {
        let tile =
            observations.tile((y * tiles.rows / 4 * tiles.columns + x * tiles.columns / 4) as usize)?;
        let seen = tile.into_iter().filter(|(_, texel)| texel.len() >= 3);
        let seen: Vec<_> = seen.collect();
        let middle = seen.len() / 2;
        chosen.extend(seen.into_iter().nth(middle));
    }
    Ok(chosen)
}

/// Models drawn beside the measurement.
const DRAWN: [&str; 5] = ["phong", "phong2", "msh36", "log-quadratic", "auto"];

fn profile(column: u32, row: u32, texel: &TexelObservations, compared: &[Compared]) -> Result<String> {
    let green = |i: &usize| texel.radiance[*i][1];
    let brightest = (0..texel.len()).max_by(|a, b| green(a).total_cmp(&green(b))).unwrap_or_default();
    let cut = Cut::through(texel.direction[brightest].as_dvec3());
    let measured = (0..texel.len()).filter_map(|i| {
        let degrees = cut.from_normal_deg(texel.direction[i].as_dvec3())?;
        Some((degrees, f64::from(texel.radiance[i][1])))
    });
    let mut series =
        vec![Series { name: "measured".into(), points: measured.collect(), drawn: Drawn::Marks }];
    for compared in compared.iter().filter(|c| DRAWN.contains(&c.name.as_str())) {
        let value = |degrees: i32| {
            let (model, parameters) = compared.map.texel(column, row);
            let radiance = model.radiance(parameters, cut.direction(f64::from(degrees)).as_vec3());
            (f64::from(degrees), f64::from(radiance[1]))
        };
        series.push(Series {
            name: compared.name.clone(),
            points: (-75..=75).map(value).collect(),
            drawn: Drawn::Line,
        });
    }
    let angle =
        Axis { label: "degrees from the normal, in the plane of the brightest view", logarithmic: false };
    chart::lines(&series, (angle, Axis { label: "radiance", logarithmic: false }))
}

//! Models of a texel: what each costs in time and memory, how well it predicts, and where it breaks.

pub(crate) mod breaks;
mod peers;
pub mod texels;
mod thesis;

use std::path::Path;
use std::time::Duration;

use glam::Vec3;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rigel::Result;
use rigel::chart::{self, Axis, ChartPoint};
use rigel::fit::{Choice, FitOptions, Fitter, Model, Reason, Selector, candidates};
use rigel::geometry::Texels;
use rigel::observation::TexelObservations;
use rigel::progress::Progress;
use rigel::report::Report;

use crate::figures::{figure, quantile, table};
use crate::machine::cpu_seconds;
use crate::table::Table;
pub use peers::{Peers, hand_over};
use texels::{Doubt, Truth, area_lamps, directions, lobes, observe, smooth};

/// Errors are measured in so many directions between the views.
const FRESH: usize = 300;
/// No view is taken from further down.
const ZENITH_RAD: f32 = 1.309;
/// So long each model is fitted again and again, CPU time.
const ENOUGH: Duration = Duration::from_millis(150);
/// Texels of each kind.
const EACH: usize = 24;
/// The name of the choice for each texel.
const AUTO: &str = "auto";

/// What one way of fitting does on some texels.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Done {
    /// CPU seconds for a texel; the choice for `auto` included.
    cpu_s: f64,
    /// Mean over texels of the mean |prediction - truth| / (truth + 5 % of the median radiance).
    error: f64,
    /// The same, of nineteen in twenty texels at most.
    p95: f64,
    bytes: f64,
}

/// A way of fitting by its name; `None` where it needs more views.
fn fit(name: &str, truths: &[Truth], observed: &[TexelObservations]) -> Result<Option<Done>> {
    let options = FitOptions::default();
    let models = if name == AUTO { candidates() } else { vec![Model::parse(name)?] };
    if Fitter::new(models[0], &options, observed).is_err() {
        return Ok(None);
    }
    let all: Vec<&TexelObservations> = observed.iter().collect();
    let selector = Selector::new(&models, &options, 0.0, observed, &|| Ok(()))?;
    let (models, floor) = (selector.models(), selector.floor() as f32);
    let sizes: Vec<usize> = models.iter().map(Model::bytes_per_texel).collect();
    let only = Choice { model: 0, runner_up: 0, reason: Reason::Only };
    let (cpu_s, fitted) = cpu_seconds(if name == AUTO { Duration::ZERO } else { ENOUGH }, || {
        let chosen = match name {
            AUTO => selector.choose(&selector.evidence(&all), Texels { columns: all.len() as u32, rows: 1 }),
            _ => vec![only; all.len()],
        };
        let fits = selector.fit(&all, &chosen).into_iter().zip(chosen);
        fits.map(|(fit, choice)| (fit.parameters, choice.model)).collect::<Vec<_>>()
    });
    let toward = fresh();
    let error = |(truth, (parameters, choice)): (&Truth, &(Vec<f32>, usize))| {
        let model = models[*choice];
        let miss = |direction: &Vec3| {
            let (exact, predicted) = (truth.radiance(*direction), model.radiance(parameters, *direction));
            (0..3).map(|c| f64::from((predicted[c] - exact[c]).abs() / (exact[c] + floor))).sum::<f64>() / 3.0
        };
        toward.iter().map(miss).sum::<f64>() / FRESH as f64
    };
    let mut errors: Vec<f64> = truths.iter().zip(&fitted).map(error).collect();
    let bytes = fitted.iter().map(|(_, choice)| sizes[*choice]).sum::<usize>() as f64 / fitted.len() as f64;
    Ok(Some(Done {
        cpu_s: cpu_s / observed.len() as f64,
        error: errors.iter().sum::<f64>() / errors.len() as f64,
        p95: quantile(&mut errors, 0.95),
        bytes: if name == AUTO { bytes + 1.0 } else { bytes },
    }))
}

/// Where the views are taken from.
fn views() -> Vec<Vec3> {
    directions(150, ZENITH_RAD, 0.0)
}

/// Where errors are measured.
fn fresh() -> Vec<Vec3> {
    directions(FRESH, ZENITH_RAD, 1.3)
}

fn row(name: &str, done: &Done) -> Vec<String> {
    vec![
        name.to_owned(),
        format!("{:.1}", 1e6 * done.cpu_s),
        format!("{:.2}", 100.0 * done.error),
        format!("{:.2}", 100.0 * done.p95),
        format!("{:.1}", done.bytes),
    ]
}

/// Texels of every kind that the models are made for, and of some that they are not.
fn mixture() -> Vec<Truth> {
    let kinds: [fn(&mut StdRng) -> Truth; 6] = [
        |random| lobes(random, 0),
        |random| lobes(random, 1),
        |random| lobes(random, 2),
        |random| lobes(random, 3),
        area_lamps,
        smooth,
    ];
    let of_kind = |(k, kind): (usize, &fn(&mut StdRng) -> Truth)| -> Vec<Truth> {
        (0..EACH).map(|i| kind(&mut StdRng::seed_from_u64((1000 * k + i) as u64))).collect()
    };
    kinds.iter().enumerate().flat_map(of_kind).collect()
}

fn observe_all(truths: &[Truth], toward: &[Vec3], doubt: &Doubt) -> Vec<TexelObservations> {
    truths.iter().enumerate().map(|(i, truth)| observe(truth, toward, doubt, 77_000 + i as u64)).collect()
}

/// Every way of fitting on one mixture, where each breaks, and the thesis's own tests: charts and tables on the page, raw
/// figures in `folder`. `peers` join the charts.
///
/// # Errors
/// What fitting, drawing or writing reports; [`rigel::Error::Interrupted`].
pub fn sweep(folder: &Path, peers: &Peers, report: &mut Report, progress: &dyn Progress) -> Result<()> {
    let names: Vec<String> = Model::all().iter().map(Model::name).chain([AUTO.to_owned()]).collect();
    let total = names.len() + breaks::STEPS + thesis::STEPS;
    report.heading("Models of a texel");
    let truths = mixture();
    let observed = observe_all(&truths, &views(), &Doubt::USUAL);
    let mut figures = Table::new(&[
        "model",
        "cpu_us_per_texel",
        "mean_error_percent",
        "p95_error_percent",
        "bytes_per_texel",
    ]);
    let mut points = vec![];
    for (index, name) in names.iter().enumerate() {
        progress.step(index, total)?;
        let Some(done) = fit(name, &truths, &observed)? else { continue };
        figures.row(row(name, &done));
        points.push((name.clone(), done));
    }
    for (name, done) in &peers.0 {
        figures.row(row(name, done));
    }
    let scatter = |x: &dyn Fn(&Done) -> f64, label: &str| {
        let point = |method: String, name: &str, done: &Done| ChartPoint {
            method,
            x: x(done),
            y: 100.0 * done.error,
            label: name.to_owned(),
        };
        // Orders and numbers of lobes of one kind share a colour.
        let kind = |name: &str| name.chars().filter(|letter| !letter.is_ascii_digit()).collect();
        let ours = points.iter().map(|(name, done)| point(kind(name), name, done));
        let others = peers.0.iter().map(|(name, done)| point("other programs".into(), name, done));
        let points: Vec<ChartPoint> = ours.chain(others).collect();
        let error = Axis { label: "mean error between the views, %", logarithmic: true };
        chart::scatter(&points, (Axis { label, logarithmic: true }, error))
    };
    let caption = format!(
        "{} texels (constant, one to three lobes, area lamps, smooth) from 150 views down to zenith 75 degrees, with 1 % + 0.002 of noise: {}",
        truths.len(),
        "the filled points are beaten by none in both."
    );
    let speed =
        scatter(&|done| (1e6 * done.cpu_s).max(0.1), "time to fit a texel, microseconds of one core")?;
    figure(folder, report, "fit_speed", speed, &caption)?;
    figure(folder, report, "fit_bytes", scatter(&|done| done.bytes, "bytes for a texel")?, &caption)?;
    table(folder, report, "fit", &figures, "Errors are those against the truth, not against noisy views.")?;
    breaks::sweep(folder, report, &|step| progress.step(names.len() + step, total))?;
    thesis::sweep(folder, report, &|step| progress.step(names.len() + breaks::STEPS + step, total))?;
    progress.step(total, total)
}

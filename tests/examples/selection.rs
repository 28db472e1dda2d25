//! Selection of models on texels of which the answer is known, under noise that is known.
//!
//! `cargo run --release -p rigel-tests --example selection [TEXELS [VIEWS]]`
//!
//! 32 x 8 texels of each kind (constant, one to three lobes, area lamps, smooth), lit by 1 % + 0.002 of noise. Prints for each kind how
//! often the chosen model is right or equivalent (its error in 300 fresh directions within 2 % of the best), how often fresh
//! noise leads to the same choice, and which models were chosen; then how many residuals in fresh directions lie
//! within one predicted standard deviation.

use std::collections::BTreeMap;

use rand::SeedableRng;
use rand::rngs::StdRng;
use rayon::prelude::*;
use rigel::Result;
use rigel::fit::{
    BANDS, Choice, Evidence, FitOptions, Fitter, Selector, ZenithRatios, candidates, zenith_band,
};
use rigel::geometry::Texels;
use rigel::observation::TexelObservations;
use rigel_atlas::texels::{Doubt, Truth, area_lamps, directions, lobes, noisy, observe, smooth};

const DOUBT: Doubt = Doubt::USUAL;
/// No view is taken from further down.
const ZENITH_RAD: f32 = 1.309;

/// Makes one texel.
type Kind = fn(&mut StdRng) -> Truth;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1).filter_map(|text| text.parse().ok());
    let (count, views) = (arguments.next().unwrap_or(256), arguments.next().unwrap_or(150));
    let models = candidates();
    let kinds: [(&str, Kind); 6] = [
        ("constant", |random| lobes(random, 0)),
        ("one lobe", |random| lobes(random, 1)),
        ("two lobes", |random| lobes(random, 2)),
        ("three lobes", |random| lobes(random, 3)),
        ("area lamps", area_lamps),
        ("smooth", smooth),
    ];
    println!("{count} texels of each kind, {views} views to zenith 75 degrees");
    println!("{:<12} {:>10} {:>10}  chosen", "", "right %", "same %");
    let options = FitOptions {
        relative_error: DOUBT.relative.into(),
        floor: Some(DOUBT.absolute.into()),
        ..FitOptions::default()
    };
    let texels = Texels { columns: 16, rows: (count as u32).div_ceil(16) };
    let toward = directions(views, ZENITH_RAD, 0.0);
    let mut all = vec![];
    for (name, kind) in kinds {
        // A patch of one material: its radiance varies from texel to texel, its kind does not.
        let truths: Vec<Truth> =
            (0..texels.count()).map(|i| kind(&mut StdRng::seed_from_u64(1000 + i as u64))).collect();
        let one = |noise: u64| -> Vec<TexelObservations> {
            let texel =
                |(i, truth): (usize, &Truth)| observe(truth, &toward, &DOUBT, noise * 1_000_003 + i as u64);
            truths.iter().enumerate().map(texel).collect()
        };
        let (first, second) = (one(1), one(2));
        let selector = Selector::new(&models, &options, 0.0, &first, &|| Ok(()))?;
        let all_of = |observed: &[TexelObservations]| {
            let evidence = selector.evidence(&observed.iter().collect::<Vec<_>>());
            let chosen = selector.choose(&evidence, texels);
            (evidence, chosen)
        };
        let [(evidence, chosen), (_, again)] = [&first, &second].map(|observed| all_of(observed));
        let fitters: Vec<Fitter> =
            selector.models().iter().filter_map(|&m| Fitter::new(m, &options, &first).ok()).collect();
        let right = (0..truths.len()).into_par_iter().filter(|&i| {
            let errors: Vec<f32> =
                fitters.iter().map(|fitter| fresh_error(&truths[i], fitter, &first[i])).collect();
            let best = errors.iter().copied().fold(f32::INFINITY, f32::min);
            errors[chosen[i].model] <= 1.02 * best
        });
        let right = right.count();
        let same = (0..truths.len()).filter(|&i| chosen[i].model == again[i].model).count();
        let mut shares = BTreeMap::new();
        for choice in &chosen {
            *shares.entry(fitters[choice.model].model().name()).or_insert(0) += 1;
        }
        let percent = |n: usize| 100.0 * n as f64 / truths.len() as f64;
        println!("{name:<12} {:>10.1} {:>10.1}  {shares:?}", percent(right), percent(same));
        all.push((percent(right), percent(same)));
        coverage(name, &selector, &truths, &first, (&evidence, &chosen));
    }
    let n = all.len() as f64;
    let [right, same] = [all.iter().map(|a| a.0).sum::<f64>() / n, all.iter().map(|a| a.1).sum::<f64>() / n];
    println!("{:<12} {right:>10.1} {same:>10.1}", "all");
    Ok(())
}

/// How many measurements in fresh directions lie within one predicted standard deviation, by zenith.
fn coverage(
    name: &str,
    selector: &Selector,
    truths: &[Truth],
    observed: &[TexelObservations],
    (evidence, chosen): (&[Evidence], &[Choice]),
) {
    let sigma: Vec<f32> =
        evidence.iter().zip(chosen).map(|(evidence, choice)| selector.sigma(evidence, choice)).collect();
    let mut ratios = ZenithRatios::default();
    for ((texel, sigma), choice) in observed.iter().zip(&sigma).zip(chosen) {
        ratios.extend(selector.zenith_ratios(texel, *sigma, choice));
    }
    let models = selector.models();
    let factors = ratios.factors(models.len());
    let fits = selector.fit(&observed.iter().collect::<Vec<_>>(), chosen);
    let mut bands = [(0, 0); BANDS];
    for (i, (truth, fit)) in truths.iter().zip(&fits).enumerate() {
        let mut random = StdRng::seed_from_u64(3_000_000 + i as u64);
        for direction in directions(300, ZENITH_RAD, 1.3) {
            let band = zenith_band(direction.z);
            let (measured, _) = noisy(truth, direction, &DOUBT, &mut random);
            let predicted = models[chosen[i].model].radiance(&fit.parameters, direction);
            for (predicted, measured) in predicted.into_iter().zip(measured) {
                let within =
                    sigma[i] * factors[chosen[i].model][band] * (predicted + selector.floor() as f32);
                bands[band].0 += u32::from((predicted - measured).abs() <= within);
                bands[band].1 += 1;
            }
        }
    }
    let bands = bands.iter().filter(|(_, all)| *all > 0);
    let shares: Vec<String> =
        bands.map(|(in_, all)| format!("{:.1}", 100.0 * f64::from(*in_) / f64::from(*all))).collect();
    println!("{:<12} within one sigma, by zenith in steps of 15 degrees: {} %", name, shares.join(" "));
}

/// The mean relative error of a fit in fresh directions, noise of the measurement included.
fn fresh_error(truth: &Truth, fitter: &Fitter, texel: &TexelObservations) -> f32 {
    let fit = fitter.fit(texel);
    let mut random = StdRng::seed_from_u64(5);
    let floor = fitter.floor() as f32;
    let error = |direction| -> f32 {
        let (measured, _) = noisy(truth, direction, &DOUBT, &mut random);
        let predicted = fitter.model().radiance(&fit.parameters, direction);
        (0..3).map(|c| (predicted[c] - measured[c]).abs() / (measured[c].max(0.0) + floor)).sum::<f32>() / 3.0
    };
    directions(300, ZENITH_RAD, 1.3).into_iter().map(error).sum::<f32>() / 300.0
}

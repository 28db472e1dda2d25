//! Speed, accuracy and honesty of the lobe fits on the peers' data.
//!
//! `cargo run --release -p rigel-tests --example lobes -- a_obs.bin as_two.bin ...` with the files that
//! `shared/peers/a_data.py` and `a_stress_gen.py` write. One thread; to compare, run `a_ceres ceres grid 1` (one lobe)
//! and `a_ceres2 two greedy 2 1` (two) beside it: on a shared machine only the ratio means anything.
//!
//! Of each file it prints, with equal weights (as the peers fit) and with weights by the noise (1 % and 0.002):
//! texels per CPU second; the share whose lobes are all right (direction within 1 degree, shininess within 20 %); that
//! of a fit started at the truth; RMSE over noise floor; the share reported as identified (nothing flagged, no parameter at its bound),
//! and how many of those are right.

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use rigel::fit::{FitFlags, FitOptions, Fitter, Model, TexelFit};
use rigel::observation::TexelObservations;

struct Case {
    lobes: usize,
    texels: Vec<TexelObservations>,
    /// In the order of the model's parameters.
    truth: Vec<Vec<f32>>,
}

fn main() {
    let files: Vec<_> = std::env::args().skip(1).collect();
    assert!(!files.is_empty(), "name the peers' files, such as a_obs.bin and as_two.bin");
    for file in files {
        let case = read(Path::new(&file));
        for (name, relative_error, floor) in [("equal weights", 0.0, 0.004), ("by the noise", 0.01, 0.002)] {
            let options =
                FitOptions { relative_error, floor: Some(floor), robust: false, ..FitOptions::default() };
            let model = Model::Phong { lobes: case.lobes as u8 };
            let fitter = Fitter::new(model, &options, &case.texels).expect("enough views");
            println!("{file}, {name}: {}", measure(&case, &fitter, model));
        }
    }
}

fn measure(case: &Case, fitter: &Fitter, model: Model) -> String {
    let count = case.texels.len() as f64;
    let mut rate = 0.0_f64;
    let mut fits: Vec<TexelFit> = Vec::new();
    for _ in 0..3 {
        let start = cpu_s();
        fits = case.texels.iter().map(|texel| fitter.fit(texel)).collect();
        rate = rate.max(count / (cpu_s() - start));
    }
    let from_truth = case.texels.iter().zip(&case.truth).map(|(texel, truth)| fitter.fit_from(texel, truth));
    let from_truth = from_truth.zip(&case.truth).filter(|(fit, truth)| right(&fit.parameters, truth)).count();
    let identified = |fit: &TexelFit| {
        let all = fit.parameters[3..].chunks_exact(7).all(|lobe| lobe[..3].iter().any(|ks| *ks > 0.0));
        all && !fit.flags.contains(FitFlags::UNIDENTIFIED) && !fit.flags.contains(FitFlags::AT_BOUND)
    };
    let (mut all_right, mut reported, mut reported_right) = (0, 0, 0);
    let mut ratios = Vec::new();
    for ((fit, truth), texel) in fits.iter().zip(&case.truth).zip(&case.texels) {
        let right = right(&fit.parameters, truth);
        all_right += usize::from(right);
        reported += usize::from(identified(fit));
        reported_right += usize::from(identified(fit) && right);
        ratios.push(rms(model, &fit.parameters, texel) / rms(model, truth, texel));
    }
    ratios.sort_by(f64::total_cmp);
    let percent = |part: usize| 100.0 * part as f64 / count;
    format!(
        "{rate:.0} texels per CPU second; right {:.2} %, from the truth {:.2} %; RMSE/floor median {:.3}, p99 {:.3}; \
         reported {:.2} %, of those right {:.2} %",
        percent(all_right),
        percent(from_truth),
        ratios[ratios.len() / 2],
        ratios[ratios.len() * 99 / 100],
        percent(reported),
        100.0 * reported_right as f64 / reported.max(1) as f64,
    )
}

/// Whether each true lobe has a found one near it.
fn right(found: &[f32], truth: &[f32]) -> bool {
    truth[3..].chunks_exact(7).all(|truth| {
        found[3..].chunks_exact(7).any(|found| {
            let direction = |lobe: &[f32]| Vec3::new(lobe[4], lobe[5], lobe[6]).as_dvec3();
            found[..3].iter().any(|ks| *ks > 0.0)
                && direction(found).angle_between(direction(truth)) < 1.0_f64.to_radians()
                && (found[3] / truth[3] - 1.0).abs() < 0.2
        })
    })
}

fn rms(model: Model, parameters: &[f32], texel: &TexelObservations) -> f64 {
    let squares = texel.direction.iter().zip(&texel.radiance).flat_map(|(direction, radiance)| {
        let got = model.radiance(parameters, *direction);
        got.into_iter().zip(*radiance).map(|(a, b)| f64::from(a - b).powi(2)).collect::<Vec<_>>()
    });
    squares.sum::<f64>().sqrt()
}

/// CPU time of this thread so far; wall time where the system does not tell.
fn cpu_s() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let wall = START.get_or_init(Instant::now).elapsed().as_secs_f64();
    let schedule = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let on_cpu = schedule.and_then(|text| text.split(' ').next()?.parse::<f64>().ok());
    on_cpu.map_or(wall, |nanoseconds| nanoseconds * 1e-9)
}

/// int32 texels, views (and lobes, unless there is one); then doubles: views × 3 directions, texels × views × 3 radiance, truth.
fn read(path: &Path) -> Case {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let integer =
        |i: usize| i32::from_le_bytes(bytes[4 * i..4 * i + 4].try_into().expect("four bytes")) as usize;
    let (count, views) = (integer(0), integer(1));
    let one_lobe = bytes.len() == 8 + 8 * (3 * views + 3 * views * count + 10 * count);
    let (lobes, start) = if one_lobe { (1, 8) } else { (integer(2), 12) };
    let numbers: Vec<f64> = bytes[start..]
        .chunks_exact(8)
        .map(|bytes| f64::from_le_bytes(bytes.try_into().expect("eight bytes")))
        .collect();
    let triple = |at: usize| [0, 1, 2].map(|i| numbers[at + i] as f32);
    let direction: Vec<Vec3> = (0..views).map(|view| Vec3::from(triple(3 * view))).collect();
    let texels = (0..count)
        .map(|texel| TexelObservations {
            view: (0..views as u32).collect(),
            direction: direction.clone(),
            radiance: (0..views).map(|view| triple(3 * (views + texel * views + view))).collect(),
            sigma: vec![0.0; views],
        })
        .collect();
    let known = 3 + 7 * lobes;
    let truth = numbers[3 * views * (1 + count)..].chunks_exact(known).map(|truth| {
        // One lobe alone has its shininess first; else it comes after the diffuse radiance.
        let (diffuse, rest) = if one_lobe {
            (&truth[1..4], [&truth[..1], &truth[4..]].concat())
        } else {
            (&truth[..3], truth[3..].to_vec())
        };
        let lobes = rest
            .chunks_exact(7)
            .flat_map(|lobe| [lobe[1], lobe[2], lobe[3], lobe[0], lobe[4], lobe[5], lobe[6]]);
        diffuse.iter().copied().chain(lobes).map(|value| value as f32).collect()
    });
    Case { lobes, texels, truth: truth.collect() }
}

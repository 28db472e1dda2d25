//! Real photographs to radiance, against the values that others found.

use std::collections::BTreeMap;
use std::path::Path;

use rigel::calibration::Vignetting;
use rigel::radiance::{Picture, RadianceImage, Samples, Stack, merge};
use rigel_tests::data;

/// The 16 photographs of the memorial church; `memorial.txt` lists one over the exposure time.
fn memorial(folder: &Path) -> Stack {
    let list = std::fs::read_to_string(folder.join("memorial.txt")).unwrap();
    let lines: Vec<(&str, f64)> = list
        .lines()
        .filter_map(|line| line.split_once(' '))
        .map(|(name, inverse)| (name, 1.0 / inverse.trim().parse::<f64>().unwrap()))
        .collect();
    let pictures = lines.iter().map(|(name, _)| Picture::read(folder.join(name)).unwrap()).collect();
    Stack::new(pictures, lines.iter().map(|(_, time_s)| *time_s).collect()).unwrap()
}

/// A Radiance picture whose first line is `#?RGBE`, as the authors' own is.
fn reference(path: &Path) -> image::Rgb32FImage {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let decoder = image::codecs::hdr::HdrDecoder::new_nonstrict(file).unwrap();
    image::DynamicImage::from_decoder(decoder).unwrap().to_rgb32f()
}

#[test]
fn the_memorial_church_agrees_with_its_authors_radiance_map() {
    let Some(folder) = data("hdr/memorial") else { return };
    let stack = memorial(&folder);
    let mut samples = Samples::default();
    samples.add(&stack);
    let response = samples.response().unwrap();
    let noise = samples.noise(&response);
    println!("{noise:?}");
    let merged = merge(&stack, &response, &noise).unwrap();
    let reference = reference(&folder.join("memorial_debevec_reference.hdr"));
    assert_eq!((merged.width, merged.height), reference.dimensions());
    let luminance = |c: [f32; 3]| 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
    let stops: Vec<f32> = merged
        .radiance
        .iter()
        .zip(reference.pixels())
        .map(|(ours, theirs)| (luminance(*ours) / luminance(theirs.0)).log2())
        .collect();
    let mut sorted = stops.clone();
    sorted.sort_by(f32::total_cmp);
    let median = sorted[sorted.len() / 2];
    let within = stops.iter().filter(|s| (*s - median).abs() <= 0.25).count() as f64 / stops.len() as f64;
    let masked = merged.mask.iter().filter(|&&m| m != 0).count();
    println!("memorial: {:.2} % within a quarter stop, {masked} pixels flagged", 100.0 * within);
    assert!(within >= 0.96, "{within}");
}

/// The views of the patchwork capture: file names with their times.
fn patchwork(folder: &Path) -> BTreeMap<u32, Vec<(String, f64)>> {
    let mut views = BTreeMap::<u32, Vec<(String, f64)>>::new();
    for line in std::fs::read_to_string(folder.join("views.csv")).unwrap().lines().skip(1) {
        let field: Vec<&str> = line.split(',').collect();
        let entry = (field[0].to_string(), field[4].parse().unwrap());
        views.entry(field[1].parse().unwrap()).or_default().push(entry);
    }
    views
}

fn load(folder: &Path, view: &[(String, f64)]) -> Stack {
    let pictures =
        view.iter().map(|(file, _)| Picture::read(folder.join("photos").join(file)).unwrap()).collect();
    Stack::new(pictures, view.iter().map(|(_, time_s)| *time_s).collect()).unwrap()
}

/// Level (0 to 255) to exposure of the simulated camera, from `truth.json`.
fn true_response(truth: &serde_json::Value, channel: usize) -> Vec<f64> {
    let gamma = truth["gamma"][channel].as_f64().unwrap();
    let toe = truth["toe"].as_f64().unwrap();
    let black = toe.powf(1.0 / gamma);
    let level = |x: f64| {
        let q = ((x + toe).powf(1.0 / gamma) - black) / ((1.0 + toe).powf(1.0 / gamma) - black);
        0.35 * q * q * (3.0 - 2.0 * q) + 0.65 * q
    };
    let invert = |target: f64| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if level(middle) < target { low = middle } else { high = middle }
        }
        low
    };
    (0..256).map(|z| invert(f64::from(z) / 255.0)).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn the_patchwork_camera_is_recovered_from_its_photographs() {
    let Some(folder) = data("multiview/patchwork") else { return };
    let views = patchwork(&folder);
    let mut samples = Samples::default();
    // Every sixth view: all of them give the same within a tenth of a per cent and take six times as long.
    for view in views.values().step_by(6) {
        samples.add(&load(&folder, view));
    }
    let response = samples.response().unwrap();
    let noise = samples.noise(&response);
    println!("{noise:?}");
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("truth/truth.json")).unwrap()).unwrap();
    for channel in 0..3 {
        let truth = true_response(&truth, channel);
        let ratio: Vec<f64> =
            (20..=235).map(|z| f64::from(response.exposure(channel)[z]) / truth[z]).collect();
        let scale = median(ratio.clone());
        let error = median(ratio.iter().map(|r| (r / scale - 1.0).abs()).collect());
        println!(
            "patchwork: channel {channel}: response within {:.2} % (median over levels 20 to 235)",
            100.0 * error
        );
        if std::env::var_os("CURVE").is_some() {
            for z in (5..256).step_by(10) {
                println!("{z} {:.4}", f64::from(response.exposure(channel)[z]) / truth[z] / scale);
            }
        }
        assert!(error <= 0.02, "channel {channel}: {error}");
    }

    let flats: Vec<Picture> =
        (0..4).map(|i| Picture::read(folder.join(format!("calibration/flat{i}.jpg"))).unwrap()).collect();
    let vignetting = Vignetting::fit(&flats, &response, &noise).unwrap();
    println!("{vignetting:?}");
    assert!(vignetting.residual < 0.01, "{}", vignetting.residual);
    assert!((0.5..0.7).contains(&vignetting.at(0.0, 0.0)));

    let stack = load(&folder, &views[&0]);
    let mut merged = merge(&stack, &response, &noise).unwrap();
    vignetting.correct(&mut merged).unwrap();
    for ((radiance, variance), mask) in merged.radiance.iter().zip(&merged.variance).zip(&merged.mask) {
        assert!(radiance.iter().all(|r| r.is_finite() && *r >= 0.0));
        assert_eq!(variance.iter().any(|v| v.is_infinite()), *mask != 0);
    }
    let saturated = merged.mask.iter().filter(|&&m| m & RadianceImage::SATURATED != 0).count();
    println!("view 0: {saturated} pixels saturated in all of {} photographs", stack.pictures.len());
}
#[test]
fn dbg_mem() {
    let folder = data("hdr/memorial").unwrap();
    let stack = memorial(&folder);
    let mut samples = Samples::default();
    samples.add(&stack);
    let t = std::time::Instant::now();
    let response = samples.response().unwrap();
    println!("solve {:?}", t.elapsed());
    let noise = samples.noise(&response);
    let t = std::time::Instant::now();
    let merged = merge(&stack, &response, &noise).unwrap();
    println!("merge {:?}", t.elapsed());
    merged.write_exr(Path::new("/tmp/rad_scratch/mem.exr"), "x").unwrap();
    response.write_csv(Path::new("/tmp/rad_scratch/mem.csv")).unwrap();
}

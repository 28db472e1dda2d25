//! Error, honesty and speed of response recovery and merge on the stacks of `tools/peers/stack.py`, which starts this:
//!
//! `cargo run --release -p rigel-tests --example stack -- FOLDER`
//!
//! FOLDER holds `E.npy` (the true radiance) and for each stack `NAME_ims.npy` and `NAME_t.npy`. A row for each stack: the
//! median and the 95th percentile of the relative error over pixels that one exposure at least shows between levels 20 and
//! 235 in every channel, after the median factor of each channel is removed; how many errors are within one predicted
//! standard deviation; millions of pixel-exposures merged per second of processor time.

use std::fs;
use std::path::Path;

use rigel::picture::Picture;
use rigel::radiance::{RadianceImage, Samples, Stack, merge};
use rigel::{Error, Result};

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| ".".into());
    let folder = Path::new(&folder);
    let (shape, truth) = read_npy(&folder.join("E.npy"), floats)?;
    let (height, width) = (shape[0], shape[1]);
    println!(
        "{:>12} {:>8} {:>8} {:>12} {:>10} {:>10}",
        "stack", "median", "p95", "within sigma", "response", "merge"
    );
    println!("{:>12} {:>8} {:>8} {:>12} {:>10} {:>10}", "", "%", "%", "%", "CPU s", "M/CPU s");
    for name in ["gamma_16", "gamma_5", "sigmoid_16", "sigmoid_5"] {
        let (_, times) = read_npy(&folder.join(format!("{name}_t.npy")), floats)?;
        let (_, levels) = read_npy(&folder.join(format!("{name}_ims.npy")), |bytes| bytes.to_vec())?;
        let pictures = levels.chunks_exact(3 * width * height).map(|levels| Picture {
            path: name.into(),
            width: width as u32,
            height: height as u32,
            levels: levels.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2]].map(u16::from)).collect(),
            white: 255,
        });
        let stack = Stack::new(pictures.collect(), times.iter().map(|&t| f64::from(t)).collect())?;

        let start = processor_s();
        let mut samples = Samples::default();
        samples.add(&stack)?;
        let response = samples.response()?;
        let noise = samples.noise(&response);
        let response_s = processor_s() - start;

        let (start, mut runs) = (processor_s(), 0);
        let mut merged = merge(&stack, &response, &noise)?;
        while processor_s() - start < 1.0 {
            merged = merge(&stack, &response, &noise)?;
            runs += 1;
        }
        let each_s = (processor_s() - start) / f64::from(runs + 1);
        let speed = (stack.pictures.len() * width * height) as f64 / each_s / 1e6;
        let (median, p95, within) = score(&stack, &merged, &truth);
        println!(
            "{name:>12} {:8.3} {:8.3} {:12.1} {response_s:10.2} {speed:10.0}",
            100.0 * median,
            100.0 * p95,
            100.0 * within
        );
    }
    Ok(())
}

/// Median and 95th percentile of the relative error, and how many are within one predicted standard deviation.
fn score(stack: &Stack, merged: &RadianceImage, truth: &[f32]) -> (f64, f64, f64) {
    let well_exposed: Vec<usize> = (0..merged.radiance.len())
        .filter(|&i| stack.pictures.iter().any(|p| p.levels[i].iter().all(|z| (20..=235).contains(z))))
        .collect();
    let (mut errors, mut within) = (Vec::new(), 0);
    for c in 0..3 {
        let ratio = |i: usize| f64::from(merged.radiance[i][c]) / f64::from(truth[3 * i + c]);
        let mut ratios: Vec<f64> = well_exposed.iter().map(|&i| ratio(i)).collect();
        ratios.sort_by(f64::total_cmp);
        let scale = ratios[ratios.len() / 2];
        for &i in &well_exposed {
            let error = (ratio(i) / scale - 1.0).abs();
            let sigma = f64::from(merged.variance[i][c]).sqrt() / f64::from(merged.radiance[i][c]);
            within += usize::from(error <= sigma);
            errors.push(error);
        }
    }
    errors.sort_by(f64::total_cmp);
    let at = |q: f64| errors[(q * errors.len() as f64) as usize];
    (at(0.5), at(0.95), within as f64 / errors.len() as f64)
}

/// Processor time of all threads of this process so far, seconds (Linux).
fn processor_s() -> f64 {
    let threads = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let nanoseconds = threads.filter_map(|thread| {
        let text = fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<f64>().ok()
    });
    nanoseconds.sum::<f64>() / 1e9
}

/// Shape and content of an array that NumPy has saved in C order.
fn read_npy<T>(path: &Path, content: impl Fn(&[u8]) -> Vec<T>) -> Result<(Vec<usize>, Vec<T>)> {
    let bytes = fs::read(path).map_err(Error::io("read", path))?;
    let damaged =
        || Error::input(path, "is not an array of NumPy, version 1", "make it with tools/peers/stack.py");
    let length = bytes.get(8..10).map(|b| usize::from(b[0]) + 256 * usize::from(b[1])).ok_or_else(damaged)?;
    let header = bytes.get(10..10 + length).map(String::from_utf8_lossy).ok_or_else(damaged)?;
    let shape =
        header.split_once("'shape': (").and_then(|(_, rest)| rest.split_once(')')).ok_or_else(damaged)?.0;
    let shape = shape.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    Ok((shape, content(&bytes[10 + length..])))
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

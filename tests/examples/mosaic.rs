//! Speed and error of warping and merging on the frames of `tools/peers/e_gen.py`:
//!
//! `cargo run --release -p rigel-tests --example mosaic -- FOLDER`
//!
//! FOLDER holds `e_env.png` (the truth), `e_frames/f00.png` ... and `e_poses.npy` (yaw, pitch and roll, degrees, 50 degrees wide).
//! A row for each filter, width of the seams and size of the map, as CSV: frames per second of processor time, from 8-bit levels in memory to the
//! finished map; the share of the map that is covered; root mean square error in levels of 255 against the truth, averaged
//! over a pixel's area where the map is smaller. The last rows decode the files too.

use std::fs;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use rigel::environment::{Filter, MergeOptions, Merged, Noise, Plate, Sphere, merge};
use rigel::geometry::{LatLong, Lens};
use rigel::picture::Picture;
use rigel::progress::Silent;
use rigel::{Error, Result};

fn main() -> Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| ".".into());
    let folder = Path::new(&folder);
    let turns = orientations(&folder.join("e_poses.npy"))?;
    let files: Vec<_> = (0..turns.len()).map(|i| folder.join(format!("e_frames/f{i:02}.png"))).collect();
    let frames: Vec<Picture> = files.iter().map(Picture::read).collect::<Result<_>>()?;
    let truth = Picture::read(folder.join("e_env.png"))?;
    println!("filter,feather,outlier,size,frames_per_cpu_s,covered_percent,rmse_of_255");
    let size = LatLong::new(4096, 2048)?;
    let quick = std::env::args().nth(2).is_some();
    for filter in [Filter::Nearest, Filter::Bilinear, Filter::Bicubic, Filter::Spline] {
        if quick && filter != Filter::Bicubic {
            continue;
        }
        for feather in [0, 1, 4] {
            measure((filter, feather, None), size, &frames, &turns, &truth)?;
        }
    }
    measure((Filter::Bicubic, 4, Some(0.05)), size, &frames, &turns, &truth)?;
    if quick {
        return Ok(());
    }
    for height in [256, 512, 1024, 4096] {
        for filter in [Filter::Nearest, Filter::Bilinear, Filter::Bicubic, Filter::Spline] {
            measure((filter, 1, None), LatLong::new(2 * height, height)?, &frames, &turns, &truth)?;
        }
    }
    let start = processor_s();
    let frames: Vec<Picture> = files.iter().map(Picture::read).collect::<Result<_>>()?;
    println!("decoding alone,,,,{:.0},,", frames.len() as f64 / (processor_s() - start));
    Ok(())
}

fn measure(
    (filter, feather, disagreement): (Filter, u32, Option<f32>),
    size: LatLong,
    frames: &[Picture],
    turns: &[DQuat],
    truth: &Picture,
) -> Result<()> {
    let options = MergeOptions { feather, disagreement };
    let lens = Lens::pinhole(640, 480, 320.0 / 25f64.to_radians().tan());
    let run = || -> Result<Merged> {
        let plate = |(picture, turn): (&Picture, &DQuat)| {
            let pixel = |i: usize| {
                let [r, g, b] = picture.levels[i];
                [r.into(), g.into(), b.into(), 1.0]
            };
            Plate::new(size, &lens, *turn, pixel, Noise::EVEN, filter)
        };
        let plates: Vec<Plate> = frames.iter().zip(turns).map(plate).collect::<Result<_>>()?;
        merge(&Sphere::new(size), &plates, &options, &Silent)
    };
    let mut merged = run()?;
    let mut fastest = f64::INFINITY;
    for _ in 0..3 {
        let start = processor_s();
        merged = run()?;
        fastest = fastest.min(processor_s() - start);
    }
    let (mut sum, mut count) = (0.0, 0);
    let scale = truth.height as f64 / size.height() as f64;
    for (i, (pixel, _)) in
        merged.radiance.iter().zip(&merged.coverage).enumerate().filter(|(_, (_, n))| **n > 0)
    {
        let (x, y) = (i % size.width(), i / size.width());
        for (c, value) in pixel.iter().enumerate() {
            sum += (f64::from(*value) - at(truth, scale, x, y, c)).powi(2);
        }
        count += 1;
    }
    println!(
        "{filter:?},{feather},{},{}x{},{:.0},{:.2},{:.3}",
        disagreement.map_or(String::new(), |part| part.to_string()),
        size.width(),
        size.height(),
        frames.len() as f64 / fastest,
        100.0 * f64::from(count) / size.count() as f64,
        (sum / f64::from(3 * count)).sqrt()
    );
    Ok(())
}

/// The truth's mean over a pixel of a smaller map; between its pixels' centres for a larger one.
fn at(truth: &Picture, scale: f64, x: usize, y: usize, c: usize) -> f64 {
    let (width, height) = (truth.width as usize, truth.height as usize);
    let level = |x: usize, y: usize| f64::from(truth.levels[y.min(height - 1) * width + x % width][c]);
    if scale >= 1.0 {
        let n = scale as usize;
        let all = (0..n * n).map(|i| level(x * n + i % n, y * n + i / n));
        return all.sum::<f64>() / (n * n) as f64;
    }
    let (u, v) = (((x as f64 + 0.5) * scale - 0.5).max(0.0), ((y as f64 + 0.5) * scale - 0.5).max(0.0));
    let (i, j, s, t) = (u as usize, v as usize, u.fract(), v.fract());
    let line = |j| level(i, j) * (1.0 - s) + level(i + 1, j) * s;
    line(j) * (1.0 - t) + line(j + 1) * t
}

/// The frames' orientations: yaw to the right, pitch up, roll clockwise about a camera with x right, y down, z forward, in a
/// world that has the same axes when nothing is turned, the map's centre before it.
fn orientations(path: &Path) -> Result<Vec<DQuat>> {
    let bytes = fs::read(path).map_err(Error::io("read", path))?;
    let header = 10 + usize::from(bytes[8]) + 256 * usize::from(bytes[9]);
    let numbers: Vec<f64> =
        bytes[header..].chunks_exact(8).map(|b| f64::from_le_bytes(std::array::from_fn(|i| b[i]))).collect();
    let world = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    let turn = |angles: &[f64]| {
        let [yaw, pitch, roll] = [0, 1, 2].map(|i| angles[i].to_radians());
        let turn = DMat3::from_rotation_y(yaw) * DMat3::from_rotation_x(pitch) * DMat3::from_rotation_z(roll);
        DQuat::from_mat3(&(world * turn))
    };
    Ok(numbers.chunks_exact(3).map(turn).collect())
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

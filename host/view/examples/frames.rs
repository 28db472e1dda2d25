//! Frames per second (of the median frame) of every kind of model, beside a plain shader that keeps every coefficient in float textures, in one run:
//! `cargo run --release -p rigel-view --example frames -- [WIDTH HEIGHT [FRAMES]]`.

use std::time::Instant;

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rigel::Result;
use rigel::fit::Model;
use rigel::geometry::{Lens, Pose, Surface, Texels};
use rigel::parameter_map::ParameterMap;
use rigel::shader::Look;
use rigel_view::{Graphics, PICTURE, Plain, Scene, Shading, View};
use wgpu::FilterMode;

const TEXELS: Texels = Texels { columns: 512, rows: 512 };

/// Texels of random coefficients: time does not depend on what they are.
fn random(model: Model) -> ParameterMap {
    let mut random = StdRng::seed_from_u64(1);
    let lobes = matches!(model, Model::Phong { .. });
    let mut texel = || {
        let mut p: Vec<f32> = (0..model.parameter_count()).map(|_| random.random_range(0.0..0.2)).collect();
        if lobes {
            for lobe in p[3..].chunks_exact_mut(7) {
                lobe[3] = random.random_range(5.0..80.0);
                (lobe[4], lobe[5], lobe[6]) = (0.28, 0.0, 0.96);
            }
        }
        p
    };
    ParameterMap {
        surface: Surface { width_m: 0.2, height_m: 0.2 },
        texels: TEXELS,
        models: vec![model],
        choice: vec![],
        parameters: (0..TEXELS.count()).flat_map(|_| texel()).collect(),
        diagnostics: None,
        uncertainty: None,
    }
}

fn main() -> Result<()> {
    let number =
        |i: usize, default: u32| std::env::args().nth(i).and_then(|n| n.parse().ok()).unwrap_or(default);
    let (width, height, frames) = (number(1, 800), number(2, 600), number(3, 30));
    let graphics = Graphics::open()?;
    println!(
        "{}; {width}x{height} pixels, {}x{} texels, frames per second",
        graphics.name(),
        TEXELS.columns,
        TEXELS.rows
    );
    println!(
        "{:>8} {:>12} {:>13} {:>14} {:>9} {:>9} {:>22}",
        "model",
        "plain, half",
        "plain, single",
        "plain, nearest",
        "by pixel",
        "by texel",
        "automatic / best plain"
    );
    let target = graphics.target(width, height);
    // The surface fills the picture's height.
    let lens = Lens::pinhole(width, height, 4.0 * f64::from(height));
    let look = Look { gamma: 1.0, false_colour: false, beside: [0.0; 3] };
    let view = |i: u32, shading| {
        let pose = Pose::from_rig(0.02 * f64::from(i), 0.3 + 0.01 * f64::from(i), 0.8);
        View { lens, pose, look, shading, halvings: 0 }
    };
    for name in
        ["phong", "phong2", "phong4", "msh15", "sh16", "msh36", "sh36", "msh66", "sh64", "msh91", "sh100"]
    {
        let map = random(Model::parse(name)?);
        // A model that it cannot show, or a device that does not interpolate, has no plain shader.
        let plain = |is_single, filter| Plain::new(&graphics, &map, is_single, filter).ok();
        let plains = [
            plain(false, FilterMode::Linear),
            plain(true, FilterMode::Linear),
            plain(true, FilterMode::Nearest),
        ];
        let scene = Scene::new(&graphics, &map, PICTURE)?;
        let draw = |which: usize, i: u32| -> bool {
            let shadings = [Shading::ByPixel, Shading::ByTexel, Shading::Automatic];
            match plains.get(which) {
                Some(Some(plain)) => plain.draw(&graphics, &view(i, Shading::Automatic), &target),
                Some(None) => return false,
                None => scene.draw(&graphics, &view(i, shadings[which - plains.len()]), &target),
            }
            true
        };
        let mut times_s = [const { vec![] }; 6];
        // In turn, so that a machine that is busy for a while is so for all; the first frame compiles.
        for i in 0..=frames {
            for (which, times_s) in times_s.iter_mut().enumerate() {
                let start = Instant::now();
                if draw(which, i) {
                    graphics.wait()?;
                    times_s.extend((i > 0).then(|| start.elapsed().as_secs_f64()));
                }
            }
        }
        let rate = |times_s: &mut Vec<f64>| {
            times_s.sort_by(f64::total_cmp);
            times_s.get(times_s.len() / 2).map_or(f64::NAN, |median_s| 1.0 / median_s)
        };
        let [half, single, nearest, by_pixel, by_texel, automatic] = times_s.each_mut().map(rate);
        println!(
            "{name:>8} {half:>12.1} {single:>13.1} {nearest:>14.1} {by_pixel:>9.1} {by_texel:>9.1} {:>22.2}",
            automatic / half.max(single).max(nearest)
        );
    }
    Ok(())
}

//! What the camera sees, and what its sensor makes of it.

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rigel::geometry::{Lens, Pose};

use super::Options;
use super::sensor::{FULL_EXPOSURE, Noise, response};
use crate::scene::Scene;

/// Sub-samples of a pixel, in pixels from its centre.
const SAMPLES: [DVec2; 4] =
    [DVec2::new(-0.25, -0.25), DVec2::new(0.25, -0.25), DVec2::new(-0.25, 0.25), DVec2::new(0.25, 0.25)];

/// The part of the camera that many threads share.
pub(super) struct Eye {
    pub scene: Scene,
    pub options: Options,
    /// Per pixel the unit directions of its sub-samples in the camera frame; `None` where no light comes from.
    pub rays: Vec<[Option<DVec3>; 4]>,
    /// Vignetting of every pixel.
    transmission: Vec<f64>,
}

impl Eye {
    /// What `options` make of the scene.
    pub fn new(scene: Scene, options: Options) -> Self {
        let lens = options.lens;
        let pixels: Vec<DVec2> = (0..lens.height)
            .flat_map(|y| (0..lens.width).map(move |x| DVec2::new(f64::from(x), f64::from(y))))
            .collect();
        let rays = pixels.par_iter().map(|&pixel| SAMPLES.map(|s| lens.unproject(pixel + s))).collect();
        let transmission =
            pixels.iter().map(|&p| if options.vignetting { vignetting(&lens, p) } else { 1.0 }).collect();
        Self { scene, options, rays, transmission }
    }

    /// The radiance that every pixel sees.
    pub fn render(&self, pose: &Pose) -> Vec<[f32; 3]> {
        let surface = self.scene.surface();
        let to_surface = pose.camera_from_surface.inverse();
        let mean = |rays: &[Option<DVec3>; 4]| {
            let mut sum = DVec3::ZERO;
            for ray in rays.iter().flatten().map(|&ray| to_surface * ray) {
                if let Some(point) = surface.intersect(pose.centre_m, ray) {
                    sum += DVec3::from_array(self.scene.radiance(point, -ray));
                }
            }
            (sum / SAMPLES.len() as f64).as_vec3().to_array()
        };
        self.rays.par_iter().map(mean).collect()
    }

    /// The levels of the `photograph`th photograph. Its noise depends on the seed, that number and the row alone,
    /// however many threads there are.
    pub fn develop(&self, radiance: &[[f32; 3]], exposure_s: f64, photograph: u64) -> Vec<u8> {
        let width = self.options.lens.width as usize;
        let mut levels = vec![0; radiance.len() * 3];
        levels.par_chunks_mut(width * 3).enumerate().for_each(|(row, levels)| {
            let mut noise =
                self.options.noise.then(|| Noise::new([self.options.seed, photograph, row as u64]));
            for (column, level) in levels.chunks_exact_mut(3).enumerate() {
                let pixel = row * width + column;
                for c in 0..3 {
                    let light = f64::from(radiance[pixel][c]) * self.transmission[pixel];
                    let full = light * exposure_s / FULL_EXPOSURE;
                    let full = noise.as_mut().map_or(full, |noise| noise.disturb(full));
                    level[c] = response(full * FULL_EXPOSURE).round() as u8;
                }
            }
        });
        levels
    }
}

/// The fraction of the light from the centre that reaches a pixel.
pub(super) fn vignetting(lens: &Lens, pixel: DVec2) -> f64 {
    let half_diagonal = DVec2::new(f64::from(lens.width), f64::from(lens.height)).length() / 2.0;
    let r2 = (pixel - DVec2::new(lens.cx, lens.cy)).length_squared() / (half_diagonal * half_diagonal);
    1.0 - 0.26 * r2 - 0.08 * r2 * r2
}

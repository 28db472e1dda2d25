//! What turns light into levels: the response curve and the noise.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};

/// The exposure (radiance times seconds) that just saturates a pixel in the picture's centre.
pub(super) const FULL_EXPOSURE: f64 = 0.02;
/// Electrons in a pixel that is just saturated.
pub(super) const FULL_ELECTRONS: f64 = 12_000.0;
/// Standard deviation of the read noise, electrons.
pub(super) const READ_ELECTRONS: f64 = 8.0;

/// The level (0 to 255, not rounded) of an exposure: a linear toe, a power of 0.45 and a soft contrast curve.
pub(super) fn response(exposure: f64) -> f64 {
    let x = (exposure / FULL_EXPOSURE).clamp(0.0, 1.0);
    let y = if x < 0.018 { 4.5 * x } else { 1.099 * x.powf(0.45) - 0.099 };
    255.0 * (y + 0.12 * y * (1.0 - y) * (2.0 * y - 1.0))
}

/// Shot and read noise from one stream of random numbers.
pub(super) struct Noise {
    random: StdRng,
    /// Box and Muller's formula gives two numbers at a time.
    spare: Option<f64>,
}

impl Noise {
    /// The noise of these numbers alone.
    pub(super) fn new(seeds: [u64; 3]) -> Self {
        let mut seed = [0; 32];
        for (bytes, value) in seed.chunks_exact_mut(8).zip(seeds) {
            bytes.copy_from_slice(&value.to_le_bytes());
        }
        Self { random: StdRng::from_seed(seed), spare: None }
    }

    /// What a pixel measures that should measure `full`, as a fraction of saturation.
    pub(super) fn disturb(&mut self, full: f64) -> f64 {
        let electrons = full * FULL_ELECTRONS;
        // For the thousands of electrons that matter the Poisson distribution is normal.
        let sigma = (electrons + READ_ELECTRONS * READ_ELECTRONS).sqrt();
        (electrons + sigma * self.normal()) / FULL_ELECTRONS
    }

    fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * (1.0 - self.random.random::<f64>()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.random.random::<f64>()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_response_rises_and_saturates() {
        let levels: Vec<f64> = (0..=1000).map(|i| response(FULL_EXPOSURE * f64::from(i) / 1000.0)).collect();
        assert!(levels.windows(2).all(|pair| pair[1] > pair[0]));
        assert!(levels[0] == 0.0 && (levels[1000] - 255.0).abs() < 1e-9 && response(1.0) == levels[1000]);
    }
}

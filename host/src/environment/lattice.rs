//! Directions spread evenly over the sphere.

use std::f64::consts::PI;

use glam::DVec3;

/// The `i`th of `count` directions on a Fibonacci spiral from +y to -y: each stands for the same solid angle.
pub(crate) fn evenly(i: usize, count: usize) -> DVec3 {
    let y = 1.0 - 2.0 * (i as f64 + 0.5) / count as f64;
    let (level, (sin, cos)) = ((1.0 - y * y).sqrt(), (i as f64 * PI * (1.0 + 5f64.sqrt())).sin_cos());
    DVec3::new(level * sin, y, level * cos)
}

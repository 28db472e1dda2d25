//! A pixel and how it moves with the lens and with the board's pose.

use glam::{DMat3, DVec2, DVec3};

use crate::geometry::Lens;

/// How many numbers a lens has: fx fy cx cy k1 k2 p1 p2 k3.
pub(super) const LENS: usize = 9;

/// Where a board lies in the camera's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BoardPose {
    pub rotation: DMat3,
    pub translation_m: DVec3,
}

impl BoardPose {
    /// The pose after a small turn (radians, camera frame) and shift.
    pub fn moved(&self, step: &[f64]) -> Self {
        let turn = DVec3::new(step[0], step[1], step[2]);
        let angle = turn.length();
        let turned = match angle > 1e-15 {
            true => DMat3::from_axis_angle(turn / angle, angle) * self.rotation,
            false => self.rotation,
        };
        Self { rotation: turned, translation_m: self.translation_m + DVec3::new(step[3], step[4], step[5]) }
    }
}

/// The pixel of a point of the camera frame and its derivatives by the numbers of the lens and by the point; `None` where
/// [`Lens::project`] has none.
pub(super) fn project(lens: &Lens, point: DVec3) -> Option<(DVec2, [DVec2; LENS], [DVec2; 3])> {
    if point.z <= 1e-12 {
        return None;
    }
    let inverse = 1.0 / point.z;
    let (x, y) = (point.x * inverse, point.y * inverse);
    let (xx, xy, yy) = (x * x, x * y, y * y);
    let r2 = xx + yy;
    let Lens { fx, fy, cx, cy, k1, k2, p1, p2, k3, .. } = *lens;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    // Twice the derivative of `radial` by r².
    let slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3));
    if radial + r2 * slope <= 0.0 {
        return None;
    }
    let dx = x * radial + 2.0 * p1 * xy + p2 * (r2 + 2.0 * xx);
    let dy = y * radial + p1 * (r2 + 2.0 * yy) + 2.0 * p2 * xy;
    let pixel = DVec2::new(fx * dx + cx, fy * dy + cy);
    let scaled = |a: f64, b: f64| DVec2::new(fx * a, fy * b);
    let by_lens = [
        DVec2::new(dx, 0.0),
        DVec2::new(0.0, dy),
        DVec2::X,
        DVec2::Y,
        scaled(x * r2, y * r2),
        scaled(x * r2 * r2, y * r2 * r2),
        scaled(2.0 * xy, r2 + 2.0 * yy),
        scaled(r2 + 2.0 * xx, 2.0 * xy),
        scaled(x * r2 * r2 * r2, y * r2 * r2 * r2),
    ];
    let cross = slope * xy + 2.0 * p1 * x + 2.0 * p2 * y;
    let by_x = scaled(radial + slope * xx + 2.0 * p1 * y + 6.0 * p2 * x, cross);
    let by_y = scaled(cross, radial + slope * yy + 6.0 * p1 * y + 2.0 * p2 * x);
    let by_point = [by_x * inverse, by_y * inverse, -(by_x * x + by_y * y) * inverse];
    Some((pixel, by_lens, by_point))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pixel_is_the_lens_s_and_the_derivatives_are_differences() {
        let numbers = [540.0, 538.0, 330.0, 236.0, -0.28, 0.09, 0.01, -0.005, -0.02];
        let lens = Lens::pinhole(640, 480, 1.0).with_numbers(numbers);
        let point = DVec3::new(0.3, -0.2, 0.9);
        let (pixel, by_lens, by_point) = project(&lens, point).unwrap();
        assert!(pixel.distance(lens.project(point).unwrap()) < 1e-9);
        for k in 0..LENS {
            let h = 1e-6 * numbers[k].abs().max(1.0);
            let at = |sign: f64| {
                let mut changed = numbers;
                changed[k] += sign * h;
                lens.with_numbers(changed).project(point).unwrap()
            };
            let difference = (at(1.0) - at(-1.0)) / (2.0 * h);
            assert!(difference.distance(by_lens[k]) < 1e-5 * by_lens[k].length().max(1.0), "{k}");
        }
        for k in 0..3 {
            let mut h = DVec3::ZERO;
            h[k] = 1e-6;
            let difference = (lens.project(point + h).unwrap() - lens.project(point - h).unwrap()) / 2e-6;
            assert!(difference.distance(by_point[k]) < 1e-4, "{k}");
        }
    }
}

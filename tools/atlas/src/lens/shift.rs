//! How far a lens shows things from where they truly appear, beyond what a turn of the camera makes good; and what is stated.

use glam::{DMat3, DVec2, DVec3};
use rigel::calibration::LensCalibration;
use rigel::geometry::Lens;

use super::covered;

/// Places across the picture, from edge to edge.
pub(super) const COLUMNS: usize = 17;
pub(super) const ROWS: usize = 13;

/// One place of the picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    pub pixel: DVec2,
    /// Found minus true, pixels.
    pub error: DVec2,
    /// What is stated of each coordinate, standard deviations.
    pub sigma: DVec2,
    /// Whether a board was there.
    pub covered: bool,
}

/// All places at which both lenses show something.
pub(super) fn shown(truth: &Lens, found: &LensCalibration) -> Vec<Shown> {
    let end = DVec2::new(f64::from(truth.width), f64::from(truth.height)) - 1.0;
    let places = (0..COLUMNS * ROWS).filter_map(|i| {
        let part = DVec2::new((i % COLUMNS) as f64, (i / COLUMNS) as f64)
            / DVec2::new((COLUMNS - 1) as f64, (ROWS - 1) as f64);
        let direction = truth.unproject(end * part)?;
        found.lens.project(direction).map(|_| (end * part, direction))
    });
    let (pixels, directions): (Vec<DVec2>, Vec<DVec3>) = places.unzip();
    let project = |lens: &Lens, i: usize| lens.project(directions[i]).unwrap_or(pixels[i]);
    let all = || 0..pixels.len();
    let error = without_turn(&found.lens, &directions, all().map(|i| project(&found.lens, i) - pixels[i]));
    // What each number of the lens does, and so what their covariance makes of it.
    let steps = [0.1, 0.1, 0.1, 0.1, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4];
    let by_number: Vec<Vec<DVec2>> = steps
        .iter()
        .enumerate()
        .map(|(number, &step)| {
            let moved = moved(&found.lens, number, step);
            let shift = all().map(|i| (project(&moved, i) - project(&found.lens, i)) / step);
            without_turn(&found.lens, &directions, shift)
        })
        .collect();
    let sigma = |i: usize| {
        let mut variance = DVec2::ZERO;
        for (row, a) in found.covariance.iter().zip(&by_number) {
            for (covariance, b) in row.iter().zip(&by_number) {
                variance += *covariance * a[i] * b[i];
            }
        }
        DVec2::new(variance.x.max(0.0).sqrt(), variance.y.max(0.0).sqrt())
    };
    all()
        .map(|i| Shown {
            pixel: pixels[i],
            error: error[i],
            sigma: sigma(i),
            covered: covered(found, pixels[i]),
        })
        .collect()
}

/// A lens one of whose numbers is larger.
fn moved(lens: &Lens, number: usize, by: f64) -> Lens {
    let mut lens = *lens;
    let numbers = [
        &mut lens.fx,
        &mut lens.fy,
        &mut lens.cx,
        &mut lens.cy,
        &mut lens.k1,
        &mut lens.k2,
        &mut lens.p1,
        &mut lens.p2,
        &mut lens.k3,
    ];
    *numbers.into_iter().nth(number).unwrap_or(&mut 0.0) += by;
    lens
}

/// Shifts in the picture less what the turn of the camera that fits them best does.
fn without_turn(lens: &Lens, directions: &[DVec3], shifts: impl Iterator<Item = DVec2>) -> Vec<DVec2> {
    let shifts: Vec<DVec2> = shifts.collect();
    let step = 1e-5;
    let by_turn = |direction: &DVec3| {
        DVec3::AXES.map(|axis| {
            let turned = |by: f64| lens.project(*direction + by * axis.cross(*direction));
            match (turned(step), turned(-step)) {
                (Some(a), Some(b)) => (a - b) / (2.0 * step),
                _ => DVec2::ZERO,
            }
        })
    };
    let by_turn: Vec<[DVec2; 3]> = directions.iter().map(by_turn).collect();
    let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for (by, shift) in by_turn.iter().zip(&shifts) {
        for (i, a) in by.iter().enumerate() {
            right[i] += a.dot(*shift);
            for (j, b) in by.iter().enumerate() {
                normal.col_mut(j)[i] += a.dot(*b);
            }
        }
    }
    let turn = normal.inverse() * right;
    let rest = |(by, shift): (&[DVec2; 3], &DVec2)| *shift - by[0] * turn.x - by[1] * turn.y - by[2] * turn.z;
    by_turn.iter().zip(&shifts).map(rest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn a_turn_is_no_error_and_another_focal_length_is() {
        let lens = super::super::truth();
        let directions: Vec<DVec3> = (0..30)
            .filter_map(|i| lens.unproject(DVec2::new(f64::from(i % 6) * 120.0, f64::from(i / 6) * 110.0)))
            .collect();
        let turn = DQuat::from_scaled_axis(DVec3::new(1e-4, -2e-4, 3e-4));
        let shift = |lens: &Lens, turn: DQuat| -> Vec<DVec2> {
            let before = super::super::truth();
            let shifts =
                directions.iter().map(|d| lens.project(turn * *d).unwrap() - before.project(*d).unwrap());
            without_turn(&before, &directions, shifts)
        };
        assert!(shift(&lens, turn).iter().all(|rest| rest.length() < 1e-3));
        let longer = Lens { fx: 541.0, fy: 539.0, ..lens };
        assert!(shift(&longer, turn).iter().any(|rest| rest.length() > 0.3));
    }
}

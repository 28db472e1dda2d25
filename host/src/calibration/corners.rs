//! Poses from corners that somebody else has found: another detector, a person, a simulation.

use glam::DVec2;
use nalgebra::SMatrix;

use super::adjust::{Frame, ViewData};
use super::lens::LensCovariance;
use super::register::{assumed, report, settle};
use super::registration::Registration;
use super::square::{CornerCovariance, MeasuredSquare, vector};
use super::squares::Squares;
use crate::geometry::Lens;
use crate::{Error, Result};

/// A square as it was found in a photograph.
#[derive(Debug, Clone, PartialEq)]
pub struct SquareCorners {
    /// Which one, an index of [`Squares::centres_m`].
    pub square: usize,
    /// Where its corners appear, pixels, in the order of [`Squares::corners_m`].
    pub pixels: [DVec2; 4],
    /// How sure that is: standard deviation of each coordinate, pixels.
    pub sigma_px: f64,
}

/// What one view shows.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewCorners {
    /// Its name.
    pub name: String,
    /// The commanded pan, radians.
    pub pan_rad: f64,
    /// The commanded tilt, radians.
    pub tilt_rad: f64,
    /// The squares; may be empty.
    pub squares: Vec<SquareCorners>,
}

/// [`register`](super::register()) without a session: one adjustment of all views of a rig whose camera stands at `distance_m`, from
/// the corners of `squares` that were found in them. `lens` comes with the covariance of its numbers if it was calibrated.
///
/// # Errors
/// [`Error::Request`] where a view names a square that the layout lacks or a corner is not known to any number of pixels, or
/// the corners cannot be where they are said to be.
pub fn register_corners(
    squares: &Squares,
    (lens, covariance): (Lens, Option<LensCovariance>),
    distance_m: f64,
    views: &[ViewCorners],
) -> Result<Registration> {
    let data = views.iter().map(|view| data(squares, view)).collect::<Result<Vec<_>>>()?;
    let lens_covariance = covariance.map_or_else(|| assumed(&lens), |c| SMatrix::from_fn(|i, j| c[i][j]));
    let frame =
        Frame { layout: squares, lens, lens_covariance, distance_m, points_m: vec![], is_rig_s: false };
    let mut dropped = vec![None; views.len()];
    let adjusted = settle(&frame, &data, &mut dropped, None)?;
    let name = |index: usize| views[index].name.clone();
    Ok(report(&frame, &data, &adjusted, &dropped, "corners".into(), &name))
}

fn data(layout: &Squares, view: &ViewCorners) -> Result<ViewData> {
    let measured = |found: &SquareCorners| {
        if found.square >= layout.centres_m.len() {
            let count = layout.centres_m.len();
            return Err(Error::request(
                format!("{} shows square {} of a layout of {count}", view.name, found.square),
                "number the squares from 0 in the order of the layout",
            ));
        }
        let numbers = found.pixels.iter().flat_map(|pixel| pixel.to_array());
        if !(found.sigma_px > 0.0 && numbers.chain([found.sigma_px]).all(f64::is_finite)) {
            return Err(Error::request(
                format!("{}: the corners of square {} are not known to any pixel", view.name, found.square),
                "leave out squares that were not found, and state a positive standard deviation",
            ));
        }
        let covariance = CornerCovariance::identity() * found.sigma_px.powi(2);
        Ok(MeasuredSquare { square: found.square, corners: vector(&found.pixels), covariance })
    };
    let squares = view.squares.iter().map(measured).collect::<Result<_>>()?;
    Ok(ViewData { pan_rad: view.pan_rad, tilt_rad: view.tilt_rad, squares, points: vec![] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::RigModel;
    use glam::DVec3;

    fn layout() -> Squares {
        let centres_m = [(-0.1, -0.08), (0.1, 0.08)].map(|(x, y)| DVec3::new(x, y, 0.0)).to_vec();
        Squares { size_m: 0.012, ground_m: 0.003, centres_m }
    }

    fn view(lens: &Lens, pan_rad: f64) -> ViewCorners {
        let rig = RigModel { camera_shift_m: [0.002, -0.001, 0.0], ..RigModel::nominal(0.9) };
        let pose = rig.pose(pan_rad, 0.5);
        let pixels = |square| {
            layout().corners_m(square, 0.0).map(|point| lens.project(pose.to_camera(point)).unwrap())
        };
        let squares = (0..2).map(|square| SquareCorners { square, pixels: pixels(square), sigma_px: 0.05 });
        ViewCorners { name: format!("pan{pan_rad}"), pan_rad, tilt_rad: 0.5, squares: squares.collect() }
    }

    #[test]
    fn exact_corners_give_the_poses() {
        let lens = Lens::pinhole(640, 480, 1350.0);
        let views: Vec<ViewCorners> = (0..8).map(|i| view(&lens, f64::from(i))).collect();
        let covariance = [[0.0; 9]; 9];
        let found = register_corners(&layout(), (lens, Some(covariance)), 0.9, &views).unwrap();
        assert_eq!((found.views.len(), found.dropped.len()), (8, 0));
        for (found, view) in found.views.iter().zip(&views) {
            for (square, corners) in view.squares.iter().enumerate() {
                let shown =
                    layout().corners_m(square, 0.0).map(|p| lens.project(found.pose.to_camera(p)).unwrap());
                let off = shown.iter().zip(&corners.pixels).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
                assert!(off < 0.02, "{off}");
            }
        }
    }

    #[test]
    fn an_adjustment_that_has_not_come_to_rest_says_so() {
        let lens = Lens::pinhole(640, 480, 1350.0);
        let views: Vec<ViewCorners> = (0..8).map(|i| view(&lens, f64::from(i))).collect();
        let layout = layout();
        let data: Vec<ViewData> = views.iter().map(|view| data(&layout, view).unwrap()).collect();
        let frame = Frame {
            layout: &layout,
            lens,
            lens_covariance: assumed(&lens),
            distance_m: 0.9,
            points_m: vec![],
            is_rig_s: false,
        };
        let mut dropped = vec![None; 8];
        let mut adjusted = settle(&frame, &data, &mut dropped, None).unwrap();
        let mut notes = |settled| {
            adjusted.settled = settled;
            report(&frame, &data, &adjusted, &dropped, String::new(), &|i| views[i].name.clone()).notes
        };
        assert!(notes(true).is_empty());
        assert!(notes(false)[0].contains("not come to rest"));
    }

    #[test]
    fn what_cannot_be_is_refused_by_name() {
        let lens = Lens::pinhole(640, 480, 1350.0);
        let mut wrong = view(&lens, 1.0);
        wrong.squares[1].square = 2;
        let error = register_corners(&layout(), (lens, None), 0.9, &[wrong]).unwrap_err().to_string();
        assert!(error.contains("pan1 shows square 2 of a layout of 2"), "{error}");
        let mut unknown = view(&lens, 1.0);
        unknown.squares[0].pixels[2].x = f64::NAN;
        assert!(register_corners(&layout(), (lens, None), 0.9, &[unknown]).is_err());
    }
}

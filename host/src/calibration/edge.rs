//! What a pixel sees of a polygon: the coverage of a convex quadrilateral through the pixel's own square and the blur
//! of the optics.

use glam::DVec2;

/// The narrowest width over which a step is spread, pixels: keeps the formula's divisions tame.
const NARROWEST: f64 = 0.05;

/// A straight edge seen through a pixel (a square of side 1) and a Gaussian-like blur of standard deviation `blur_px`: the
/// part of the light that comes from its bright side at the signed distance `d` (pixels) of the pixel's centre, and its
/// derivative by `d`.
///
/// The pixel's shadow along the normal is two boxes of the widths |normal.x| and |normal.y|; two more boxes stand for the
/// blur. A step smoothed by four boxes is a spline of the fourth order: the sum over the boxes' ends of signed truncated
/// powers (the divided difference, de Boor, "A Practical Guide to Splines", chapter IX).
pub(super) fn step(d: f64, normal: DVec2, blur_px: f64) -> (f64, f64) {
    let (a, b) = (normal.x.abs().max(NARROWEST), normal.y.abs().max(NARROWEST));
    // Two boxes of width c have the variance c² / 6.
    let c = (blur_px * 6f64.sqrt()).max(NARROWEST);
    let reach = (a + b) / 2.0 + c;
    if d >= reach {
        return (1.0, 0.0);
    }
    if d <= -reach {
        return (0.0, 0.0);
    }
    let (outer, inner) = ((a + b) / 2.0, (a - b) / 2.0);
    let (mut fourth, mut third) = (0.0, 0.0);
    for (shift, sign) in [(outer, 1.0), (inner, -1.0), (-inner, -1.0), (-outer, 1.0)] {
        for (more, factor) in [(c, 1.0), (0.0, -2.0), (-c, 1.0)] {
            let x = d + shift + more;
            if x > 0.0 {
                let cube = sign * factor * x * x * x;
                third += cube;
                fourth += cube * x;
            }
        }
    }
    let boxes = a * b * c * c;
    ((fourth / (24.0 * boxes)).clamp(0.0, 1.0), third / (6.0 * boxes))
}

/// A convex quadrilateral in the picture.
pub(super) struct Quad {
    edges: [Edge; 4],
}

struct Edge {
    from: DVec2,
    along: DVec2,
    /// Unit vector towards the inside.
    inward: DVec2,
    length_px: f64,
}

impl Quad {
    /// `None` where the corners do not go round a convex area (in either sense).
    pub fn new(corners: &[DVec2; 4]) -> Option<Self> {
        let turn = |i: usize| {
            let (a, b, c) = (corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4]);
            (b - a).perp_dot(c - b)
        };
        let sign = turn(0).signum();
        // Written so that a corner that is not a number is refused.
        if !(0..4).all(|i| turn(i) * sign > 1e-9) {
            return None;
        }
        let edges = [0, 1, 2, 3].map(|i| {
            let (from, to) = (corners[i], corners[(i + 1) % 4]);
            let length_px = from.distance(to);
            let along = (to - from) / length_px;
            Edge { from, along, inward: along.perp() * sign, length_px }
        });
        Some(Self { edges })
    }

    /// How far `pixel` lies inside, pixels; negative outside.
    pub fn depth(&self, pixel: DVec2) -> f64 {
        self.edges.iter().map(|edge| (pixel - edge.from).dot(edge.inward)).fold(f64::INFINITY, f64::min)
    }

    /// The corners of the quadrilateral whose edges lie `by_px` further out.
    pub fn grown(&self, by_px: f64) -> [DVec2; 4] {
        [0, 1, 2, 3].map(|i| {
            let (a, b) = (&self.edges[(i + 3) % 4], &self.edges[i]);
            // The corner between two edges moves so that it keeps its distance to both.
            let cosine = a.inward.dot(b.inward);
            b.from - (a.inward + b.inward) * (by_px / (1.0 + cosine))
        })
    }

    /// The part of what `pixel` sees that lies inside, and its derivative by the corners (x0 y0 x1 y1 ...).
    ///
    /// The product over the edges is exact along them and where they meet at right angles, and symmetric elsewhere.
    pub fn coverage(&self, pixel: DVec2, blur_px: f64) -> (f64, [f64; 8]) {
        let mut steps = [(0.0, 0.0); 4];
        for (step_, edge) in steps.iter_mut().zip(&self.edges) {
            *step_ = step((pixel - edge.from).dot(edge.inward), edge.inward, blur_px);
        }
        let coverage = steps.iter().map(|(value, _)| value).product();
        let mut by_corners = [0.0; 8];
        for (i, edge) in self.edges.iter().enumerate() {
            if steps[i].1 == 0.0 {
                continue;
            }
            let others: f64 = (0..4).filter(|&j| j != i).map(|j| steps[j].0).product();
            // A corner moves the edge at the pixel by its share of the way along it.
            let share = (pixel - edge.from).dot(edge.along) / edge.length_px;
            for (corner, share) in [(i, 1.0 - share), ((i + 1) % 4, share)] {
                by_corners[2 * corner] -= others * steps[i].1 * share * edge.inward.x;
                by_corners[2 * corner + 1] -= others * steps[i].1 * share * edge.inward.y;
            }
        }
        (coverage, by_corners)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_the_area_of_the_pixel_beyond_the_edge() {
        for angle in [0.0, 0.3, 0.785, 1.2] {
            let normal = DVec2::from_angle(angle);
            for d in [-0.8, -0.3, 0.0, 0.2, 0.55] {
                let n = 400;
                let inside = (0..n * n).filter(|i| {
                    let at = DVec2::new(f64::from(i % n), f64::from(i / n)) / f64::from(n) - 0.5;
                    d + at.dot(normal) > 0.0
                });
                let area = inside.count() as f64 / f64::from(n * n);
                let (value, _) = step(d, normal, 0.0);
                assert!((value - area).abs() < 0.02, "{angle} {d}: {value} {area}");
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_the_value() {
        let corners = [(10.0, 10.0), (21.0, 12.5), (23.0, 19.0), (11.0, 18.0)].map(DVec2::from);
        let quad = Quad::new(&corners).unwrap();
        for pixel in [(10.0, 14.0), (15.0, 11.0), (22.5, 18.6), (17.0, 18.4)].map(DVec2::from) {
            let (_, gradient) = quad.coverage(pixel, 0.3);
            for (i, slope) in gradient.into_iter().enumerate() {
                let moved = |by: f64| {
                    let mut corners = corners;
                    corners[i / 2][i % 2] += by;
                    Quad::new(&corners).unwrap().coverage(pixel, 0.3).0
                };
                let numeric = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                // Moving a corner also turns its edges, which the pixel's shadow follows a little.
                assert!((numeric - slope).abs() < 0.03, "{pixel} {i}: {numeric} {slope}");
            }
        }
    }

    #[test]
    fn coverage_adds_up_to_the_area_and_growing_moves_every_edge() {
        let corners = [(10.2, 10.1), (10.9, 24.0), (27.3, 25.2), (26.0, 11.0)].map(DVec2::from);
        let quad = Quad::new(&corners).unwrap();
        let sum: f64 = (0..40 * 40)
            .map(|i| quad.coverage(DVec2::new(f64::from(i % 40), f64::from(i / 40)), 0.4).0)
            .sum();
        let area: f64 = (0..4).map(|i| corners[i].perp_dot(corners[(i + 1) % 4])).sum::<f64>().abs() / 2.0;
        assert!((sum / area - 1.0).abs() < 2e-3, "{sum} {area}");
        let grown = Quad::new(&quad.grown(0.5)).unwrap();
        for corner in corners {
            assert!((grown.depth(corner) - 0.5).abs() < 1e-9);
        }
    }

    #[test]
    fn what_is_not_convex_is_no_quad() {
        let crossed = [(0.0, 0.0), (5.0, 5.0), (5.0, 0.0), (0.0, 5.0)].map(DVec2::from);
        assert!(Quad::new(&crossed).is_none());
        assert!(Quad::new(&[DVec2::NAN; 4]).is_none());
        assert!(Quad::new(&[DVec2::ZERO; 4]).is_none());
    }
}

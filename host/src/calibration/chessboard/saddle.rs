//! Where exactly a chessboard's corner is: the picture around it is fitted by two crossing blurred edges.
//!
//! The model `a + g·x + b F(u/s) F(v/s)`, u and v the distances from the two edges, has the corner's own symmetry: turned by
//! half a turn it stays as it is. So whatever it leaves out and has that symmetry too (the shape of the blur, a response
//! curve, edges that bleed) does not move the corner.

use glam::DVec2;
use multiversion::multiversion;
use nalgebra::{SMatrix, SVector};

use super::grey::Grey;

/// Unknowns: a, gx, gy, b, x, y, the angles of the two edges, s.
const N: usize = 9;
/// The model is at least this blurred, pixels: an edge between two pixels of a sharp picture must still reach both, else nothing tells where
/// between them it is.
const SHARPEST_PX: f64 = 1.3;

/// A corner to a few hundredths of a pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Saddle {
    pub at: DVec2,
    /// Standard deviation of either coordinate that the fit's own residuals tell, pixels.
    pub sigma_px: f64,
    /// Standard deviation of the blur across the edges, pixels.
    pub blur_px: f64,
}

/// Half an edge's brightness, -1 to 1, and its slope: (15 t - 10 t³ + 3 t⁵) / 8, near to the integral of a Gaussian.
fn edge(t: f64) -> (f64, f64) {
    let t = t.clamp(-1.0, 1.0);
    let t2 = t * t;
    let bell = 1.0 - t2;
    (t * (1.875 - t2 * (1.25 - 0.375 * t2)), 1.875 * bell * bell)
}

/// The standard deviation of [`edge`]'s slope.
const BLUR_PER_WIDTH: f64 = 0.377_964;

struct Window {
    centre: DVec2,
    radius_px: f64,
    /// Offset from the centre, brightness, weight.
    pixels: Vec<(f64, f64, f64, f64)>,
}

impl Window {
    fn new(grey: &Grey, centre: DVec2, radius_px: f64) -> Option<Self> {
        let reach = radius_px.floor() as i64;
        let (x0, y0) = (centre.x.round() as i64, centre.y.round() as i64);
        let mut pixels = Vec::with_capacity(((2 * reach + 1) * (2 * reach + 1)) as usize);
        for y in (y0 - reach).max(0)..=(y0 + reach).min(grey.height as i64 - 1) {
            let row = grey.row(y as usize);
            for x in (x0 - reach).max(0)..=(x0 + reach).min(grey.width as i64 - 1) {
                let offset = DVec2::new(x as f64, y as f64) - centre;
                let inside = 1.0 - offset.length_squared() / (radius_px * radius_px);
                if inside > 0.0 {
                    // The far pixels know most of the edges' directions, but their edges bend and have neighbours.
                    pixels.push((offset.x, offset.y, f64::from(row[x as usize]), inside));
                }
            }
        }
        // Cut off by the picture's border the symmetry would be lost.
        let whole = std::f64::consts::PI * radius_px * radius_px;
        (pixels.len() as f64 > 0.8 * whole).then_some(Self { centre, radius_px, pixels })
    }

    /// Normal equations of the model at `p`: matrix, right side, weighted sum of squares.
    fn normal(&self, p: &SVector<f64, N>) -> (SMatrix<f64, N, N>, SVector<f64, N>, f64) {
        let (normal, squares) = normal(&self.pixels, p.data.0[0]);
        let matrix = SMatrix::from_fn(|i, j| normal[i.min(j)][i.max(j)]);
        (matrix, SVector::from_fn(|i, _| normal[i][N]), squares)
    }
}

/// The unknowns and the residual, filled up to whole vectors.
const LANES: usize = 12;

/// What [`Window::normal`] takes its time for: per unknown its products with the others (from itself on) and with the residual.
#[multiversion(targets("x86_64+avx2+fma"))]
fn normal(pixels: &[(f64, f64, f64, f64)], p: [f64; N]) -> ([[f64; LANES]; N], f64) {
    let [a, gx, gy, b, x, y, alpha, beta, s] = p;
    let ((sin_a, cos_a), (sin_b, cos_b)) = (alpha.sin_cos(), beta.sin_cos());
    let (mut normal, mut squares) = ([[0.0; LANES]; N], 0.0);
    let inverse = 1.0 / s;
    for &(px, py, level, weight) in pixels {
        let (dx, dy) = (px - x, py - y);
        let (u, v) = ((cos_a * dy - sin_a * dx) * inverse, (cos_b * dy - sin_b * dx) * inverse);
        let ((fu, slope_u), (fv, slope_v)) = (edge(u), edge(v));
        let residual = level - (a + gx * px + gy * py + b * fu * fv);
        let (du, dv) = (b * slope_u * fv * inverse, b * fu * slope_v * inverse);
        let row: [f64; LANES] = [
            1.0,
            px,
            py,
            fu * fv,
            du * sin_a + dv * sin_b,
            -du * cos_a - dv * cos_b,
            -du * (cos_a * dx + sin_a * dy),
            -dv * (cos_b * dx + sin_b * dy),
            -du * u - dv * v,
            residual,
            0.0,
            0.0,
        ];
        for (i, sums) in normal.iter_mut().enumerate() {
            let scaled = weight * row[i];
            // Whole vectors from the one on that holds the diagonal.
            for j in i / 4 * 4..LANES {
                sums[j] += scaled * row[j];
            }
        }
        squares += weight * residual * residual;
    }
    (normal, squares)
}

/// Fits the corner near `start`, whose edges leave along `first` and `second` (the sector between them is dark), in a disc of
/// `radius_px`; `None` where the picture does not look like one.
pub(super) fn refine(
    grey: &Grey,
    start: DVec2,
    edges: [DVec2; 2],
    contrast: f32,
    radius_px: f64,
) -> Option<Saddle> {
    let mut centre = start;
    let mut p = SVector::<f64, N>::zeros();
    (p[6], p[7]) = (edges[0].to_angle(), edges[1].to_angle());
    (p[3], p[8]) = (0.5 * f64::from(contrast), 2.5f64.min(0.7 * radius_px));
    for _ in 0..3 {
        let window = Window::new(grey, centre, radius_px)?;
        if p[0] == 0.0 {
            p[0] = window.pixels.iter().map(|pixel| pixel.2).sum::<f64>() / window.pixels.len() as f64;
        }
        let (fitted, normal, squares) = fit(&window, p)?;
        let moved = DVec2::new(fitted[4], fitted[5]);
        if moved.length() > 0.7 * radius_px || fitted[3] < 2.0 {
            return None;
        }
        p = fitted;
        centre = window.centre + moved;
        if moved.length() < 0.6 {
            return judge(&window, &p, &normal, squares, centre);
        }
        (p[4], p[5]) = (0.0, 0.0);
    }
    None
}

/// Levenberg and Marquardt's way down.
fn fit(window: &Window, start: SVector<f64, N>) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>, f64)> {
    let mut p = start;
    let (mut normal, mut right, mut squares) = window.normal(&p);
    let mut damping = 1e-3;
    for _ in 0..20 {
        let mut damped = normal;
        for i in 0..N {
            damped[(i, i)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&right);
        let mut next = p + step;
        next[8] = next[8].clamp(SHARPEST_PX, window.radius_px);
        let tried = window.normal(&next);
        if tried.2 <= squares {
            let small = step[4].hypot(step[5]) < 2e-3 && step[8].abs() < 0.02;
            p = next;
            (normal, right, squares) = tried;
            damping = (0.1 * damping).max(1e-9);
            if small {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    Some((p, normal, squares))
}

fn judge(
    window: &Window,
    p: &SVector<f64, N>,
    normal: &SMatrix<f64, N, N>,
    squares: f64,
    at: DVec2,
) -> Option<Saddle> {
    let weights: f64 = window.pixels.iter().map(|pixel| pixel.3).sum();
    let variance = squares / weights;
    // What is left must be small against the contrast, and the edges must cross.
    let crossing = (p[7] - p[6]).sin();
    if variance.sqrt() > 0.35 * p[3] || crossing < 0.2 {
        return None;
    }
    let covariance = normal.cholesky()?.inverse();
    let sigma_px = (0.5 * variance * (covariance[(4, 4)] + covariance[(5, 5)])).sqrt();
    Some(Saddle { at, sigma_px, blur_px: BLUR_PER_WIDTH * p[8] })
}

//! Where a picture may show the corner of a chessboard: saddle points whose surroundings alternate four times.

use glam::DVec2;

use super::grey::Grey;

/// Radius of the ring that is looked at, pixels, and how many samples it has.
const RING_PX: f64 = 4.0;
const RING: usize = 24;
/// A saddle counts from this share of the picture's strongest one: contrast enters squared.
const WEAKEST: f32 = 0.003;
/// The weakest saddle (of [`Grey::saddles`]) that is looked at: a contrast of about 8 of 255.
const FAINTEST: f32 = 8.0;
/// More candidates than this are noise or foliage: only the strongest are kept.
const MOST: usize = 1500;

/// A point where two edges cross, one pair of opposite sectors dark and the other bright.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    /// Where it is, pixels, to about a quarter of one.
    pub at: DVec2,
    /// The unit vectors of the four edges that leave it, turning from x to y; the sector from the first to the second is dark.
    pub edges: [DVec2; 4],
    /// Bright minus dark.
    pub contrast: f32,
}

/// A picture prepared for the search of corners.
pub(super) struct Search {
    pub smooth: Grey,
    saddles: Grey,
    strongest: f32,
    ring: [(f64, f64); RING],
}

impl Search {
    pub fn new(grey: &Grey) -> Self {
        let smooth = grey.smoothed();
        let (saddles, strongest) = smooth.saddles();
        let ring = std::array::from_fn(|k| {
            let (sin, cos) = (k as f64 * std::f64::consts::TAU / RING as f64).sin_cos();
            (RING_PX * cos, RING_PX * sin)
        });
        Self { smooth, saddles, strongest, ring }
    }

    /// All corners, the strongest first.
    pub fn corners(&self) -> Vec<Corner> {
        let least = (WEAKEST * self.strongest).max(FAINTEST);
        let mut peaks = vec![];
        for y in 7..self.saddles.height.saturating_sub(7) {
            let row = self.saddles.row(y);
            for x in 7..row.len().saturating_sub(7) {
                if row[x] > least && row[x] >= row[x - 1] && row[x] > row[x + 1] && self.is_peak(x, y) {
                    peaks.push((row[x], x, y));
                }
            }
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut corners: Vec<Corner> = vec![];
        for (_, x, y) in peaks {
            if corners.len() < MOST
                && let Some(corner) = self.corner(x, y)
            {
                corners.push(corner);
            }
        }
        corners
    }

    /// The corner near a place where one is expected, however weak it is.
    pub fn corner_near(&self, at: DVec2, radius_px: f64) -> Option<Corner> {
        let edge = |value: f64, size: usize| (value.round().max(7.0) as usize).min(size.saturating_sub(8));
        let (width, height) = (self.saddles.width, self.saddles.height);
        let mut best = (FAINTEST, 0, 0);
        for y in edge(at.y - radius_px, height)..=edge(at.y + radius_px, height) {
            let row = self.saddles.row(y);
            let (first, last) = (edge(at.x - radius_px, width), edge(at.x + radius_px, width));
            for (x, &here) in row.iter().enumerate().take(last + 1).skip(first) {
                let near = (x as f64 - at.x).hypot(y as f64 - at.y) <= radius_px;
                if near && here > best.0 && self.is_peak(x, y) {
                    best = (here, x, y);
                }
            }
        }
        let (_, x, y) = best;
        if x == 0 { None } else { self.corner(x, y) }
    }

    fn is_peak(&self, x: usize, y: usize) -> bool {
        let here = self.saddles.row(y)[x];
        (y - 3..=y + 3).all(|row| self.saddles.row(row)[x - 3..=x + 3].iter().all(|&value| value <= here))
    }

    /// Looks around a peak of the saddle response.
    fn corner(&self, x: usize, y: usize) -> Option<Corner> {
        let saddle = |x: usize, y: usize| self.saddles.row(y)[x];
        let here = saddle(x, y);
        let top = |before: f32, after: f32| {
            let bend = before - 2.0 * here + after;
            if bend < 0.0 { f64::from(0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
        };
        let at = DVec2::new(
            x as f64 + top(saddle(x - 1, y), saddle(x + 1, y)),
            y as f64 + top(saddle(x, y - 1), saddle(x, y + 1)),
        );
        let ring: [f32; RING] =
            std::array::from_fn(|k| self.smooth.sample(at.x + self.ring[k].0, at.y + self.ring[k].1));
        let mut ordered = ring;
        ordered.sort_by(f32::total_cmp);
        let (dark, bright) = (ordered[RING / 12], ordered[RING - 1 - RING / 12]);
        let (middle, contrast) = (0.5 * (dark + bright), bright - dark);
        if contrast < 4.0 {
            return None;
        }
        let (mut crossings, mut count, mut first_falls) = ([0.0; 4], 0, false);
        for k in 0..RING {
            let (a, b) = (ring[k] - middle, ring[(k + 1) % RING] - middle);
            if (a > 0.0) != (b > 0.0) {
                if count == 4 {
                    return None;
                }
                if count == 0 {
                    first_falls = a > 0.0;
                }
                crossings[count] = k as f64 + f64::from(a / (a - b));
                count += 1;
            }
        }
        let half = RING as f64 / 2.0;
        let bent = |k: usize| (crossings[k + 2] - crossings[k] - half).abs();
        if count != 4 || bent(0) > 2.6 || bent(1) > 2.6 {
            return None;
        }
        let step = std::f64::consts::TAU / RING as f64;
        let line = |k: usize| 0.5 * (crossings[k] + crossings[k + 2] - half) * step;
        let (first, second) = (line(0), line(1));
        if second - first < 0.3 || first + std::f64::consts::PI - second < 0.3 {
            return None;
        }
        // Brightness falls where a dark sector begins.
        let (a, b) = if first_falls { (first, second) } else { (second, first + std::f64::consts::PI) };
        let (a, b) = (DVec2::from_angle(a), DVec2::from_angle(b));
        Some(Corner { at, edges: [a, b, -a, -b], contrast })
    }
}

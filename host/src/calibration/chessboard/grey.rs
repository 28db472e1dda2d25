//! A picture's brightness, which is all that a chessboard needs, and its saddle response.

use crate::picture::Picture;

/// Brightness, row by row from the top-left pixel; 255 is the picture's white.
pub(super) struct Grey {
    pub width: usize,
    pub height: usize,
    pub levels: Vec<f32>,
}

impl Grey {
    pub fn of(picture: &Picture) -> Self {
        let scale = 255.0 / (4.0 * f32::from(picture.white));
        let grey = |&[r, g, b]: &[u16; 3]| scale * (f32::from(r) + 2.0 * f32::from(g) + f32::from(b));
        Self {
            width: picture.width as usize,
            height: picture.height as usize,
            levels: picture.levels.iter().map(grey).collect(),
        }
    }

    /// Half the size: means of 2 x 2 pixels. A position x here is (x - 1/2) / 2 there.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut levels = vec![0.0; width * height];
        for (y, row) in levels.chunks_exact_mut(width.max(1)).enumerate() {
            let (a, b) = (self.row(2 * y), self.row(2 * y + 1));
            for ((out, a), b) in row.iter_mut().zip(a.chunks_exact(2)).zip(b.chunks_exact(2)) {
                *out = 0.25 * (a[0] + a[1] + b[0] + b[1]);
            }
        }
        Self { width, height, levels }
    }

    pub fn row(&self, y: usize) -> &[f32] {
        &self.levels[y * self.width..(y + 1) * self.width]
    }

    /// The brightness between pixels; beyond the border that of the border.
    pub fn sample(&self, x: f64, y: f64) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f64);
        let y = y.clamp(0.0, (self.height - 1) as f64);
        let (left, top) = ((x as usize).min(self.width - 2), (y as usize).min(self.height - 2));
        let (fx, fy) = ((x - left as f64) as f32, (y - top as f64) as f32);
        let at = top * self.width + left;
        let (a, b) = (&self.levels[at..at + 2], &self.levels[at + self.width..at + self.width + 2]);
        let (upper, lower) = (a[0] + fx * (a[1] - a[0]), b[0] + fx * (b[1] - b[0]));
        upper + fy * (lower - upper)
    }

    /// Smoothed by the binomial 1 4 6 4 1 (a blur of 1 pixel) along both axes; two pixels at the border stay as they are.
    pub fn smoothed(&self) -> Self {
        let (width, height) = (self.width, self.height);
        let mut across = self.levels.clone();
        for y in 0..height {
            let row = self.row(y);
            let out = &mut across[y * width + 2..(y + 1) * width - 2];
            let n = out.len();
            let (a, b, c, d, e) = (&row[..n], &row[1..n + 1], &row[2..n + 2], &row[3..n + 3], &row[4..n + 4]);
            for x in 0..n {
                out[x] = (a[x] + e[x] + 4.0 * (b[x] + d[x]) + 6.0 * c[x]) * (1.0 / 16.0);
            }
        }
        let mut levels = across.clone();
        for y in 2..height - 2 {
            let line = |k: usize| &across[(y + k - 2) * width..(y + k - 1) * width];
            let (a, b, c, d, e) = (line(0), line(1), line(2), line(3), line(4));
            let out = &mut levels[y * width..(y + 1) * width];
            for x in 0..width {
                out[x] = (a[x] + e[x] + 4.0 * (b[x] + d[x]) + 6.0 * c[x]) * (1.0 / 16.0);
            }
        }
        Self { width, height, levels }
    }

    /// How much each pixel is a saddle: the negative determinant of the second derivatives, taken over two pixels to either
    /// side (as of a smoothed picture); zero near the border. With it, the largest one.
    pub fn saddles(&self) -> (Self, f32) {
        let width = self.width;
        let mut levels = vec![0.0; self.levels.len()];
        let mut most = [0f32; 8];
        for y in 4..self.height - 4 {
            let (up, mid, down) = (self.row(y - 2), self.row(y), self.row(y + 2));
            let out = &mut levels[y * width + 4..(y + 1) * width - 4];
            let n = out.len();
            let (ul, uc, ur) = (&up[2..n + 2], &up[4..n + 4], &up[6..n + 6]);
            let (ml, mc, mr) = (&mid[2..n + 2], &mid[4..n + 4], &mid[6..n + 6]);
            let (dl, dc, dr) = (&down[2..n + 2], &down[4..n + 4], &down[6..n + 6]);
            for x in 0..n {
                let xx = ml[x] - 2.0 * mc[x] + mr[x];
                let yy = uc[x] - 2.0 * mc[x] + dc[x];
                let xy = 0.25 * (dr[x] - dl[x] - ur[x] + ul[x]);
                out[x] = xy * xy - xx * yy;
            }
            for chunk in out.chunks_exact(8) {
                for (most, value) in most.iter_mut().zip(chunk) {
                    *most = if *value > *most { *value } else { *most };
                }
            }
        }
        (Self { width, height: self.height, levels }, most.into_iter().fold(0.0, f32::max))
    }
}

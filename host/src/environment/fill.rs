//! What was never seen, filled from what is around: means of ever larger blocks, where there is nothing nearer.

use super::map::EnvironmentMap;

/// Fills unseen pixels smoothly and flags them.
pub(super) fn fill(map: &mut EnvironmentMap) {
    let (width, height) = (map.size.width(), map.size.height());
    let start: Vec<[f32; 4]> = map
        .radiance
        .iter()
        .zip(&map.flags)
        .map(|(p, &flag)| if flag & EnvironmentMap::UNSEEN == 0 { [p[0], p[1], p[2], 1.0] } else { [0.0; 4] })
        .collect();
    let filled = push_pull(start, width, height);
    for ((pixel, flag), filled) in map.radiance.iter_mut().zip(&mut map.flags).zip(filled) {
        if *flag & EnvironmentMap::UNSEEN != 0 {
            *pixel = [filled[0], filled[1], filled[2]];
            *flag = EnvironmentMap::FILLED;
        }
    }
}

/// Sums with weight at every level, those of a coarser one where a finer one has none.
fn push_pull(pixels: Vec<[f32; 4]>, width: usize, height: usize) -> Vec<[f32; 4]> {
    if pixels.iter().all(|pixel| pixel[3] > 0.0) || width <= 1 || height <= 1 {
        return pixels;
    }
    let (w, h) = (width.div_ceil(2), height.div_ceil(2));
    let mut small = vec![[0f32; 4]; w * h];
    for (i, pixel) in pixels.iter().enumerate().filter(|(_, pixel)| pixel[3] > 0.0) {
        let to = &mut small[i / width / 2 * w + i % width / 2];
        (0..3).for_each(|c| to[c] += pixel[c]);
        to[3] += 1.0;
    }
    for pixel in small.iter_mut().filter(|pixel| pixel[3] > 0.0) {
        let count = pixel[3];
        *pixel = [pixel[0] / count, pixel[1] / count, pixel[2] / count, 1.0];
    }
    let small = push_pull(small, w, h);
    let mut out = pixels;
    for i in (0..out.len()).filter(|&i| out[i][3] <= 0.0).collect::<Vec<_>>() {
        let (x, y) = ((i % width) as f32 / 2.0 - 0.25, ((i / width) as f32 / 2.0 - 0.25).max(0.0));
        let (s, t) = (x - x.floor(), y.fract());
        let column = |k: isize| (x.floor() as isize + k).rem_euclid(w as isize) as usize;
        let row = |k: usize| (y as usize + k).min(h - 1);
        let mut sum = [0f32; 4];
        for (j, wy) in [(0, 1.0 - t), (1, t)] {
            for (k, wx) in [(0, 1.0 - s), (1, s)] {
                let from = small[row(j) * w + column(k)];
                (0..4).for_each(|c| sum[c] += wx * wy * from[3] * from[c]);
            }
        }
        if sum[3] > 0.0 {
            out[i] = [sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3], 1.0];
        }
    }
    out
}

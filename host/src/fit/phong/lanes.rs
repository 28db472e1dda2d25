//! The loops over views, compiled for this processor's vector instructions and chosen when the program runs.
//!
//! All are plain loops over slices of the same length in single precision, which the compiler turns into vectors; sums
//! run in [`WIDTH`] separate lanes, because floating-point addition may not be reordered for us.
#![expect(clippy::needless_range_loop, reason = "lane by lane is what the compiler turns into vectors")]

use multiversion::multiversion;

/// Views that are treated at once.
pub(super) const WIDTH: usize = 8;

/// One number of each of [`WIDTH`] views.
pub(super) type Lane = [f32; WIDTH];

/// [`WIDTH`] views: where they look, the root of what they count, and their radiance times that root.
#[derive(Debug, Clone, Copy)]
pub(super) struct Block {
    pub direction: [Lane; 3],
    pub root_weight: Lane,
    pub radiance: [Lane; 3],
}

impl Block {
    /// No views: they count nothing.
    pub const EMPTY: Self = Self {
        direction: [[0.0; WIDTH], [0.0; WIDTH], [1.0; WIDTH]],
        root_weight: [0.0; WIDTH],
        radiance: [[0.0; WIDTH]; 3],
    };
}

/// A lobe as the loops want it.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneLobe {
    pub direction: [f32; 3],
    /// Two unit vectors that make a right-handed frame with the direction.
    pub turns: [[f32; 3]; 2],
    pub shininess: f32,
    /// Where the cosine is at most this, the lobe is 0.
    pub cosine_cut: f32,
}

/// Natural logarithm of a positive normal number, to about 1e-7 of itself (after Cephes' `logf`).
#[inline(always)]
fn ln(x: f32) -> f32 {
    let bits = x.to_bits() as i32;
    // The mantissa lies between √½ and √2, so that 1 has exponent 0 and nothing cancels near it.
    let exponent = (bits - 0x3f35_04f3) >> 23;
    let f = f32::from_bits((bits - (exponent << 23)) as u32) - 1.0;
    let mut p = 7.037_683_6e-2_f32;
    for c in [
        -1.151_461e-1,
        1.167_699_9e-1,
        -1.242_014_1e-1,
        1.424_932_3e-1,
        -1.666_805_8e-1,
        2.000_071_5e-1,
        -2.499_999_4e-1,
        3.333_333e-1,
    ] {
        p = p.mul_add(f, c);
    }
    let square = f * f;
    let tail = (square * f).mul_add(p, -0.5 * square);
    (exponent as f32).mul_add(std::f32::consts::LN_2, f + tail)
}

/// exp of a number between -80 and 0, to about 1e-7 of itself (after Cephes' `exp2f`).
#[inline(always)]
fn exp(x: f32) -> f32 {
    let x = x * std::f32::consts::LOG2_E;
    // Adding and taking away 1.5 * 2^23 rounds to an integer, which then stands in the last bits.
    const ROUND: f32 = 12_582_912.0;
    let shifted = x + ROUND;
    let f = x - (shifted - ROUND);
    let mut p = 1.535_336_2e-4_f32;
    for c in [1.339_887_4e-3, 9.618_437e-3, 5.550_332_5e-2, 2.402_264_8e-1, 6.931_472e-1, 1.0] {
        p = p.mul_add(f, c);
    }
    let exponent = (shifted.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32);
    f32::from_bits((p.to_bits() as i32 + (exponent << 23)) as u32)
}

#[inline(always)]
fn dot(views: &[Lane; 3], [x, y, z]: [f32; 3], lane: usize) -> f32 {
    z.mul_add(views[2][lane], y.mul_add(views[1][lane], x * views[0][lane]))
}

/// The columns of a lobe, each times the root weight: its value (row `first`), and that derived by the logarithm of the
/// shininess and by a turn towards either of the two vectors (rows `derived` and the two after it).
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn columns<const R: usize>(
    views: &[Block],
    lobe: &LaneLobe,
    rows: &mut [[Lane; R]],
    value: usize,
    derived: usize,
) {
    assert!(value < R && derived + 2 < R);
    for (block, rows) in views.iter().zip(rows) {
        let mut columns = [[0.0_f32; WIDTH]; 4];
        for lane in 0..WIDTH {
            let cosine = dot(&block.direction, lobe.direction, lane);
            let inside = cosine.max(lobe.cosine_cut).min(1.0);
            let log = lobe.shininess * ln(inside);
            let b = if cosine > lobe.cosine_cut { block.root_weight[lane] * exp(log) } else { 0.0 };
            let turn = lobe.shininess * b / inside;
            columns[0][lane] = b;
            columns[1][lane] = b * log;
            columns[2][lane] = turn * dot(&block.direction, lobe.turns[0], lane);
            columns[3][lane] = turn * dot(&block.direction, lobe.turns[1], lane);
        }
        rows[value] = columns[0];
        rows[derived] = columns[1];
        rows[derived + 1] = columns[2];
        rows[derived + 2] = columns[3];
    }
}

#[inline(always)]
fn value(block: &Block, lobe: &LaneLobe, lane: usize) -> f32 {
    let cosine = dot(&block.direction, lobe.direction, lane);
    let inside = cosine.max(lobe.cosine_cut).min(1.0);
    let b = block.root_weight[lane] * exp(lobe.shininess * ln(inside));
    if cosine > lobe.cosine_cut { b } else { 0.0 }
}

/// The value of a lobe alone, times the root weight.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn values<const R: usize>(views: &[Block], lobe: &LaneLobe, rows: &mut [[Lane; R]], at: usize) {
    assert!(at < R);
    for (block, rows) in views.iter().zip(rows) {
        let mut column = [0.0_f32; WIDTH];
        for lane in 0..WIDTH {
            column[lane] = value(block, lobe, lane);
        }
        rows[at] = column;
    }
}

/// What the linear terms leave: the last three rows are the radiance less row 0 × `linear[0]`, row 1 × `linear[1]` ...
/// (`terms` of them) for each channel; row 0 becomes the root weight.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn residuals<const R: usize>(
    views: &[Block],
    rows: &mut [[Lane; R]],
    linear: &[[f32; 5]; 3],
    terms: usize,
) {
    assert!(terms + 3 <= R && terms <= 5);
    for (block, rows) in views.iter().zip(rows) {
        rows[0] = block.root_weight;
        for c in 0..3 {
            let mut left = block.radiance[c];
            for t in 0..terms {
                for lane in 0..WIDTH {
                    left[lane] = (-linear[c][t]).mul_add(rows[t][lane], left[lane]);
                }
            }
            rows[R - 3 + c] = left;
        }
    }
}

/// The inner products of all rows: `gram[i][j] += row i · row j` for i ≤ j.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn products<const R: usize>(rows: &[[Lane; R]], gram: &mut [[f64; R]; R]) {
    // Two rows against four: as many sums as registers hold.
    for i in (0..R).step_by(2) {
        for j in (i..R).step_by(4) {
            let sums = tile(rows, i, j);
            for (a, sums) in sums.iter().enumerate() {
                for (b, sum) in sums.iter().enumerate() {
                    if i + a < R && j + b < R && i + a <= j + b {
                        gram[i + a][j + b] += sum;
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn tile<const R: usize>(rows: &[[Lane; R]], i: usize, j: usize) -> [[f64; 4]; 2] {
    let a: [usize; 2] = std::array::from_fn(|k| (i + k).min(R - 1));
    let b: [usize; 4] = std::array::from_fn(|k| (j + k).min(R - 1));
    let mut sums = [[[0.0_f32; WIDTH]; 4]; 2];
    for row in rows {
        for i in 0..2 {
            for j in 0..4 {
                for lane in 0..WIDTH {
                    sums[i][j][lane] = row[a[i]][lane].mul_add(row[b[j]][lane], sums[i][j][lane]);
                }
            }
        }
    }
    sums.map(|row| row.map(total))
}

/// The clamped cosine with a direction, squared: the first rung of a ladder.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn squared_cosine(views: &[Block], direction: [f32; 3], out: &mut [Lane]) {
    for (block, out) in views.iter().zip(out) {
        for lane in 0..WIDTH {
            let cosine = dot(&block.direction, direction, lane).clamp(0.0, 1.0);
            out[lane] = cosine * cosine;
        }
    }
}

/// One rung of a ladder: the inner products of root weight × value with each row and (last) with itself; the value is
/// squared in its place for the next rung. Row 0 is the root weight. `count` is `R`, `S` is one more: a loop whose
/// length the compiler does not know runs along the lanes, one that it unrolls may run across them.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn rung<const R: usize, const S: usize>(
    value: &mut [Lane],
    rows: &[[Lane; R]],
    count: usize,
) -> [f64; S] {
    let mut sums = [[0.0_f32; WIDTH]; S];
    for (value, row) in value.iter_mut().zip(rows) {
        let mut b = [0.0_f32; WIDTH];
        for lane in 0..WIDTH {
            b[lane] = row[0][lane] * value[lane];
        }
        for (sum, row) in sums.iter_mut().zip(row).take(count) {
            for lane in 0..WIDTH {
                sum[lane] = b[lane].mul_add(row[lane], sum[lane]);
            }
        }
        for lane in 0..WIDTH {
            sums[S - 1][lane] = b[lane].mul_add(b[lane], sums[S - 1][lane]);
            // What is smaller would soon be denormal, which is slow, and is nothing to see.
            value[lane] = if value[lane] > 1e-7 { value[lane] * value[lane] } else { 0.0 };
        }
    }
    sums.map(total)
}

#[inline(always)]
pub(super) fn total(lanes: Lane) -> f64 {
    lanes.iter().map(|lane| f64::from(*lane)).sum()
}

/// What is left of each view summed over the channels, as radiance; very dark where there is no view.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn brightness(views: &[Block], left: &[[Lane; 3]], out: &mut [Lane]) {
    for ((block, left), out) in views.iter().zip(left).zip(out) {
        for lane in 0..WIDTH {
            let root = block.root_weight[lane];
            let bright = (left[0][lane] + left[1][lane] + left[2][lane]) / root.max(1e-30);
            out[lane] = if root > 0.0 { bright } else { f32::MIN };
        }
    }
}

/// Directions times brightness, summed over the bright views whose cosine with `around` is above `cosine`.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn centre(views: &[Block], brightness: &[Lane], around: [f32; 3], cosine: f32) -> [f64; 3] {
    let (mut x, mut y, mut z) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH], [0.0_f32; WIDTH]);
    for (block, brightness) in views.iter().zip(brightness) {
        let mut bright = [0.0_f32; WIDTH];
        for lane in 0..WIDTH {
            let near = f32::from(u8::from(dot(&block.direction, around, lane) > cosine));
            bright[lane] = near * brightness[lane].max(0.0);
        }
        for lane in 0..WIDTH {
            x[lane] = bright[lane].mul_add(block.direction[0][lane], x[lane]);
        }
        for lane in 0..WIDTH {
            y[lane] = bright[lane].mul_add(block.direction[1][lane], y[lane]);
        }
        for lane in 0..WIDTH {
            z[lane] = bright[lane].mul_add(block.direction[2][lane], z[lane]);
        }
    }
    [total(x), total(y), total(z)]
}

/// The brightest view among those whose cosine with `from` is below `cosine`.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn brightest(
    views: &[Block],
    brightness: &[Lane],
    from: [f32; 3],
    cosine: f32,
) -> Option<[f32; 3]> {
    let (mut most, mut at) = ([f32::MIN; WIDTH], [0_u32; WIDTH]);
    for (index, (block, brightness)) in views.iter().zip(brightness).enumerate() {
        for lane in 0..WIDTH {
            let far = dot(&block.direction, from, lane) < cosine;
            let better = far & (brightness[lane] > most[lane]);
            most[lane] = if better { brightness[lane] } else { most[lane] };
            at[lane] = if better { index as u32 } else { at[lane] };
        }
    }
    let lane =
        (0..WIDTH).max_by(|a, b| most[*a].total_cmp(&most[*b])).filter(|lane| most[*lane] > f32::MIN)?;
    Some(views[at[lane] as usize].direction.map(|axis| axis[lane]))
}

/// What a constant leaves of the weighted radiance.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn leave(views: &[Block], constant: [f32; 3], left: &mut [[Lane; 3]]) {
    for (block, left) in views.iter().zip(left) {
        for c in 0..3 {
            for lane in 0..WIDTH {
                left[c][lane] = (-constant[c]).mul_add(block.root_weight[lane], block.radiance[c][lane]);
            }
        }
    }
}

/// What a lobe of this radiance leaves of what was left.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn deduct(views: &[Block], lobe: &LaneLobe, radiance: [f32; 3], left: &mut [[Lane; 3]]) {
    for (block, left) in views.iter().zip(left) {
        let mut column = [0.0_f32; WIDTH];
        for lane in 0..WIDTH {
            column[lane] = value(block, lobe, lane);
        }
        for c in 0..3 {
            for lane in 0..WIDTH {
                left[c][lane] = (-radiance[c]).mul_add(column[lane], left[c][lane]);
            }
        }
    }
}

/// Squares of what is left, summed over the channels of each view; the sum of them over the views for each channel, and the
/// greatest of a view.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn misses(left: &[[Lane; 3]], out: &mut [Lane]) -> ([f64; 3], f32) {
    let (mut sums, mut most) = ([[0.0_f32; WIDTH]; 3], [0.0_f32; WIDTH]);
    for (left, out) in left.iter().zip(out) {
        let mut miss = [0.0_f32; WIDTH];
        for c in 0..3 {
            let left = &left[c];
            for lane in 0..WIDTH {
                miss[lane] = left[lane].mul_add(left[lane], miss[lane]);
            }
            for lane in 0..WIDTH {
                sums[c][lane] = left[lane].mul_add(left[lane], sums[c][lane]);
            }
        }
        for lane in 0..WIDTH {
            most[lane] = most[lane].max(miss[lane]);
        }
        *out = miss;
    }
    (sums.map(total), most.into_iter().fold(0.0, f32::max))
}

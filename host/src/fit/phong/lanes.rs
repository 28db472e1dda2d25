//! The loops over views, compiled for this processor's vector instructions and chosen when the program runs.
//!
//! All are plain loops over slices of the same length in single precision, which the compiler turns into vectors; sums
//! run in [`WIDTH`] separate lanes, because floating-point addition may not be reordered for us.
#![expect(clippy::needless_range_loop, reason = "lane by lane is what the compiler turns into vectors")]

use glam::Vec3;
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

/// The value of a lobe alone, times the root weight.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn values<const R: usize>(views: &[Block], lobe: &LaneLobe, rows: &mut [[Lane; R]], value: usize) {
    assert!(value < R);
    for (block, rows) in views.iter().zip(rows) {
        let mut column = [0.0_f32; WIDTH];
        for lane in 0..WIDTH {
            let cosine = dot(&block.direction, lobe.direction, lane);
            let inside = cosine.max(lobe.cosine_cut).min(1.0);
            let b = block.root_weight[lane] * exp(lobe.shininess * ln(inside));
            column[lane] = if cosine > lobe.cosine_cut { b } else { 0.0 };
        }
        rows[value] = column;
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
fn total(lanes: Lane) -> f64 {
    lanes.iter().map(|lane| f64::from(*lane)).sum()
}

/// The residual of each view summed over the channels, as radiance; the last three rows hold it weighted. Very dark where
/// there is no view.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn brightness<const R: usize>(rows: &[[Lane; R]], out: &mut [Lane]) {
    for (row, out) in rows.iter().zip(out) {
        for lane in 0..WIDTH {
            let sum = row[R - 3][lane] + row[R - 2][lane] + row[R - 1][lane];
            let bright = sum / row[0][lane].max(1e-30);
            out[lane] = if row[0][lane] > 0.0 { bright } else { f32::MIN };
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

/// The greatest radiance, or NaN where anything is not finite.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn brightest_value(directions: &[Vec3], radiance: &[[f32; 3]], sigma: &[f32]) -> f32 {
    let (mut most, mut strange) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH]);
    let (chunks, rest) = radiance.as_flattened().as_chunks::<WIDTH>();
    for chunk in chunks {
        for lane in 0..WIDTH {
            most[lane] = most[lane].max(chunk[lane].abs());
            strange[lane] += 0.0 * chunk[lane];
        }
    }
    let (chunks, sigma_rest) = sigma.as_chunks::<WIDTH>();
    for chunk in chunks {
        for lane in 0..WIDTH {
            strange[lane] += 0.0 * chunk[lane];
        }
    }
    let mut strange: f32 = strange.iter().sum();
    strange += rest.iter().chain(sigma_rest).map(|value| 0.0 * value).sum::<f32>();
    let (chunks, directions) = directions.as_chunks::<WIDTH>();
    let mut strange_directions = [0.0_f32; WIDTH];
    for chunk in chunks {
        for (strange, d) in strange_directions.iter_mut().zip(chunk) {
            *strange += 0.0 * d.x + 0.0 * d.y + 0.0 * d.z;
        }
    }
    strange += strange_directions.iter().sum::<f32>();
    strange += directions.iter().map(|d| 0.0 * d.x + 0.0 * d.y + 0.0 * d.z).sum::<f32>();
    most.iter().chain(rest).fold(0.0, |most: f32, value| most.max(value.abs())) + strange
}

/// What [`lay`] needs to know of the expected error: of it, as radiance × `per_unit`, the squares of its parts relative to the sum of the
/// channels and absolute.
#[derive(Debug, Clone, Copy)]
pub(super) struct Error {
    pub per_unit: f32,
    pub relative_squared: f32,
    pub floor_squared: f32,
}

/// Lays eight views out; the root weight is 1 / expected error, to be scaled later.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn lay(
    directions: &[Vec3],
    radiance: &[[f32; 3]],
    sigma: &[f32],
    error: Error,
    blocks: &mut Vec<Block>,
) {
    let (directions, last_directions) = directions.as_chunks::<WIDTH>();
    let (radiance, last_radiance) = radiance.as_chunks::<WIDTH>();
    let (sigma, last_sigma) = sigma.as_chunks::<WIDTH>();
    for ((directions, radiance), sigma) in directions.iter().zip(radiance).zip(sigma) {
        blocks.push(block(directions, radiance, sigma, error));
    }
    let left = last_directions.len();
    if left > 0 {
        let (mut directions, mut radiance, mut sigma) = ([Vec3::Z; WIDTH], [[0.0; 3]; WIDTH], [0.0; WIDTH]);
        directions[..left].copy_from_slice(last_directions);
        radiance[..left].copy_from_slice(last_radiance);
        sigma[..left].copy_from_slice(last_sigma);
        let mut block = block(&directions, &radiance, &sigma, error);
        block.root_weight[left..].fill(0.0);
        blocks.push(block);
    }
}

#[inline(always)]
fn block(
    directions: &[Vec3; WIDTH],
    radiance: &[[f32; 3]; WIDTH],
    sigma: &[f32; WIDTH],
    error: Error,
) -> Block {
    let mut block =
        Block { direction: [[0.0; WIDTH]; 3], root_weight: [0.0; WIDTH], radiance: [[0.0; WIDTH]; 3] };
    for lane in 0..WIDTH {
        let direction = directions[lane].to_array();
        for axis in 0..3 {
            block.direction[axis][lane] = direction[axis];
            block.radiance[axis][lane] = radiance[lane][axis] * error.per_unit;
        }
    }
    for lane in 0..WIDTH {
        let sum = block.radiance[0][lane] + block.radiance[1][lane] + block.radiance[2][lane];
        // Its square still fits into single precision.
        let sigma = (sigma[lane] * error.per_unit).min(1e15);
        let variance = sigma.mul_add(sigma, (error.relative_squared * sum).mul_add(sum, error.floor_squared));
        block.root_weight[lane] = 1.0 / variance.sqrt();
    }
    block
}

/// Multiplies each view's root weight and weighted radiance.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn scale(views: &mut [Block], factors: &[Lane]) {
    for (block, factor) in views.iter_mut().zip(factors) {
        for lane in 0..WIDTH {
            block.root_weight[lane] *= factor[lane];
        }
        for c in 0..3 {
            for lane in 0..WIDTH {
                block.radiance[c][lane] *= factor[lane];
            }
        }
    }
}

/// Multiplies the root weights, and the radiance by the root weights that come of it; gives the sum of weight × radiance and of weight × radiance².
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn weigh(views: &mut [Block], factor: f32) -> [f64; 5] {
    let (mut weight, mut energy) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH]);
    let mut right = [[0.0_f32; WIDTH]; 3];
    for block in views {
        for lane in 0..WIDTH {
            block.root_weight[lane] *= factor;
        }
        let root = block.root_weight;
        for lane in 0..WIDTH {
            weight[lane] = root[lane].mul_add(root[lane], weight[lane]);
        }
        for (radiance, right) in block.radiance.iter_mut().zip(&mut right) {
            for lane in 0..WIDTH {
                radiance[lane] *= root[lane];
            }
            for lane in 0..WIDTH {
                right[lane] = root[lane].mul_add(radiance[lane], right[lane]);
            }
            for lane in 0..WIDTH {
                energy[lane] = radiance[lane].mul_add(radiance[lane], energy[lane]);
            }
        }
    }
    [total(weight), total(right[0]), total(right[1]), total(right[2]), total(energy)]
}

/// Squares of the last three rows, summed for each view; and over all views the sums of that, of the same without its weight, and of
/// the radiance squared without its weight.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn misses<const R: usize>(views: &[Block], rows: &[[Lane; R]], out: &mut [Lane]) -> [f64; 3] {
    let (mut weighted, mut squares, mut energy) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH], [0.0_f32; WIDTH]);
    for ((block, row), out) in views.iter().zip(rows).zip(out) {
        let (mut miss, mut bright, mut per_weight) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH], [0.0_f32; WIDTH]);
        for c in 0..3 {
            let (left, radiance) = (&row[R - 3 + c], &block.radiance[c]);
            for lane in 0..WIDTH {
                miss[lane] = left[lane].mul_add(left[lane], miss[lane]);
            }
            for lane in 0..WIDTH {
                bright[lane] = radiance[lane].mul_add(radiance[lane], bright[lane]);
            }
        }
        for lane in 0..WIDTH {
            let root = block.root_weight[lane].max(1e-15);
            per_weight[lane] = 1.0 / (root * root);
        }
        *out = miss;
        for lane in 0..WIDTH {
            weighted[lane] += miss[lane];
        }
        for lane in 0..WIDTH {
            squares[lane] = per_weight[lane].mul_add(miss[lane], squares[lane]);
        }
        for lane in 0..WIDTH {
            energy[lane] = per_weight[lane].mul_add(bright[lane], energy[lane]);
        }
    }
    [total(weighted), total(squares), total(energy)]
}

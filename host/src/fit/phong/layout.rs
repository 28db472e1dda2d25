//! From a texel's observations to blocks of views.
#![expect(clippy::needless_range_loop, reason = "lane by lane is what the compiler turns into vectors")]

use glam::Vec3;
use multiversion::multiversion;

use super::lanes::{Block, Lane, WIDTH, total};

/// The greatest radiance, or NaN where any is not finite.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn brightest_value(radiance: &[[f32; 3]]) -> f32 {
    let (mut most, mut strange) = ([0.0_f32; WIDTH], [0.0_f32; WIDTH]);
    let (chunks, rest) = radiance.as_flattened().as_chunks::<WIDTH>();
    for chunk in chunks {
        for lane in 0..WIDTH {
            most[lane] = most[lane].max(chunk[lane].abs());
        }
        for lane in 0..WIDTH {
            strange[lane] += 0.0 * chunk[lane];
        }
    }
    let strange = strange.iter().sum::<f32>() + rest.iter().map(|value| 0.0 * value).sum::<f32>();
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

/// Lays views out, eight by eight; the root weight is 1 / expected error, to be scaled later. Gives 0, or NaN where a direction
/// or a standard deviation is not finite.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn lay(
    directions: &[Vec3],
    radiance: &[[f32; 3]],
    sigma: &[f32],
    error: Error,
    blocks: &mut Vec<Block>,
) -> f32 {
    let mut strange = [0.0_f32; WIDTH];
    let (directions, last_directions) = directions.as_chunks::<WIDTH>();
    let (radiance, last_radiance) = radiance.as_chunks::<WIDTH>();
    let (sigma, last_sigma) = sigma.as_chunks::<WIDTH>();
    for ((directions, radiance), sigma) in directions.iter().zip(radiance).zip(sigma) {
        let block = block(directions, radiance, sigma, error);
        for axis in block.direction {
            for lane in 0..WIDTH {
                strange[lane] += 0.0 * axis[lane];
            }
        }
        for lane in 0..WIDTH {
            strange[lane] += 0.0 * sigma[lane];
        }
        blocks.push(block);
    }
    let left = last_directions.len();
    if left > 0 {
        let (mut directions, mut radiance, mut sigma) = ([Vec3::Z; WIDTH], [[0.0; 3]; WIDTH], [0.0; WIDTH]);
        directions[..left].copy_from_slice(last_directions);
        radiance[..left].copy_from_slice(last_radiance);
        sigma[..left].copy_from_slice(last_sigma);
        let mut block = block(&directions, &radiance, &sigma, error);
        block.root_weight[left..].fill(0.0);
        for lane in 0..WIDTH {
            strange[lane] += 0.0 * directions[lane].x
                + 0.0 * directions[lane].y
                + 0.0 * directions[lane].z
                + 0.0 * sigma[lane];
        }
        blocks.push(block);
    }
    strange.iter().sum()
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

/// Multiplies the weighted radiance of each channel.
#[multiversion(targets("x86_64+avx2+fma", "aarch64+neon"))]
pub(super) fn scale_channels(views: &mut [Block], factors: [f32; 3]) {
    for block in views {
        for (channel, factor) in block.radiance.iter_mut().zip(factors) {
            for lane in 0..WIDTH {
                channel[lane] *= factor;
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

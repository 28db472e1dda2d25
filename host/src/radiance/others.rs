//! The methods that everybody knows, as their authors published them, to be compared with. They give no variance.

use nalgebra::{DMatrix, DVector};

use super::{Response, Stack};
use crate::{Error, Result};

const LEVELS: usize = 256;

/// Debevec's and Malik's weight of a level (SIGGRAPH 97, equation 4): a hat over 0 to 255.
pub fn hat(level: usize) -> f64 {
    level.min(LEVELS - 1 - level) as f64
}

/// A weight that grows up to white, saturated levels included: with it, and not with the hat, the radiance map of the memorial
/// church that goes round is met (`tests/tests/radiance.rs`).
pub fn rise(level: usize) -> f64 {
    level as f64
}

/// Robertson's, Borman's and Stevenson's weight of a level ("Estimation-theoretic approach to dynamic range enhancement using
/// multiple exposures", Journal of Electronic Imaging 12(2), 2003, equation 17): a bell that ends at black and white.
pub fn bell(level: usize) -> f64 {
    let at = |level: f64| (-4.0 * (level / 127.5 - 1.0).powi(2)).exp();
    (at(level as f64) - at(0.0)) / (1.0 - at(0.0))
}

/// The response after Debevec and Malik (equation 3 and their MATLAB program `gsolve`): ln exposure per level from about
/// `pixels` pixels on a grid over the picture, with `smoothness` their lambda.
///
/// # Errors
/// [`Error::Request`] for photographs that are not 8 bits deep or have one exposure time only.
pub fn debevec_response(stack: &Stack, pixels: usize, smoothness: f64) -> Result<Response> {
    check(stack)?;
    let places = grid(stack, pixels);
    let mut tables = [const { Vec::new() }; 3];
    for (c, table) in tables.iter_mut().enumerate() {
        let n = LEVELS + places.len();
        let (mut matrix, mut right) = (DMatrix::<f64>::zeros(n, n), DVector::<f64>::zeros(n));
        let mut add = |parts: &[(usize, f64)], value: f64| {
            for &(i, a) in parts {
                right[i] += a * value;
                parts.iter().for_each(|&(k, b)| matrix[(i, k)] += a * b);
            }
        };
        for (p, &place) in places.iter().enumerate() {
            for (picture, &time_s) in stack.pictures.iter().zip(&stack.exposure_s) {
                let level = usize::from(picture.levels[place][c]);
                let weight = hat(level);
                add(&[(level, weight), (LEVELS + p, -weight)], weight * time_s.ln());
            }
        }
        add(&[(LEVELS / 2, 1.0)], 0.0);
        for level in 1..LEVELS - 1 {
            let weight = smoothness * hat(level);
            add(&[(level - 1, weight), (level, -2.0 * weight), (level + 1, weight)], 0.0);
        }
        // A pixel that is black or white everywhere has no equation; they take the shortest solution.
        (0..n).for_each(|i| matrix[(i, i)] += 1e-9);
        let solved = matrix.cholesky().map(|factor| factor.solve(&right));
        let solved = solved
            .ok_or_else(|| Error::request("the curve cannot be solved for", "ask for more smoothness"))?;
        table.extend(solved.iter().take(LEVELS).map(|g| g.exp() as f32));
    }
    Ok(Response::from_tables(tables))
}

/// Radiance after Debevec and Malik (equation 6): the mean of ln exposure - ln time, weighted by level: with [`hat`], as they
/// wrote, or with [`rise`].
///
/// # Errors
/// [`Error::Request`] for photographs or a response that are not 8 bits deep.
pub fn debevec_merge(stack: &Stack, response: &Response, weight: fn(usize) -> f64) -> Result<Vec<[f32; 3]>> {
    check_depth(&[stack.white(), response.white()])?;
    let weights: Vec<f32> = (0..LEVELS).map(|level| weight(level) as f32).collect();
    let logs =
        [0, 1, 2].map(|c| response.exposure(c).iter().map(|x| x.max(1e-12).ln()).collect::<Vec<f32>>());
    let times: Vec<f32> = stack.exposure_s.iter().map(|t| t.ln() as f32).collect();
    let mean = |place: usize, c: usize| {
        let (mut sum, mut total) = (0.0, 1e-12);
        for (picture, time) in stack.pictures.iter().zip(&times) {
            let level = usize::from(picture.levels[place][c]);
            sum += weights[level] * (logs[c][level] - time);
            total += weights[level];
        }
        (sum / total).exp()
    };
    Ok((0..stack.pictures[0].levels.len()).map(|place| [0, 1, 2].map(|c| mean(place, c))).collect())
}

/// Response after Robertson, Borman and Stevenson (equations 9 and 11 in turn, from a straight line, until the curve changes
/// by less than a thousandth or 30 times).
///
/// # Errors
/// [`Error::Request`] for photographs that are not 8 bits deep or have one exposure time only.
pub fn robertson_response(stack: &Stack) -> Result<Response> {
    check(stack)?;
    let places = grid(stack, 20_000);
    let mut tables: [Vec<f32>; 3] = [const { Vec::new() }; 3];
    for (c, result) in tables.iter_mut().enumerate() {
        let mut table: Vec<f64> = (0..LEVELS).map(|level| level as f64 / 128.0).collect();
        for _ in 0..30 {
            let (mut sum, mut count) = ([0.0; LEVELS], [0.0; LEVELS]);
            for &place in &places {
                let level = |j: usize| usize::from(stack.pictures[j].levels[place][c]);
                let (mut up, mut down) = (0.0, 1e-12);
                for (j, t) in stack.exposure_s.iter().enumerate() {
                    let weight = bell(level(j));
                    up += weight * t * table[level(j)];
                    down += weight * t * t;
                }
                for (j, t) in stack.exposure_s.iter().enumerate() {
                    sum[level(j)] += t * up / down;
                    count[level(j)] += 1.0;
                }
            }
            let mut next = table.clone();
            (0..LEVELS).filter(|&z| count[z] > 0.0).for_each(|z| next[z] = sum[z] / count[z]);
            let middle = next[LEVELS / 2].max(f64::MIN_POSITIVE);
            next.iter_mut().for_each(|x| *x /= middle);
            let change = table.iter().zip(&next).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            table = next;
            if change < 1e-3 {
                break;
            }
        }
        *result = table.iter().map(|&x| x as f32).collect();
    }
    Ok(Response::from_tables(tables))
}

/// Radiance after Robertson, Borman and Stevenson (equation 9): sum of w t exposure over sum of w t squared.
///
/// # Errors
/// [`Error::Request`] for photographs or a response that are not 8 bits deep.
pub fn robertson_merge(stack: &Stack, response: &Response) -> Result<Vec<[f32; 3]>> {
    check_depth(&[stack.white(), response.white()])?;
    let weights: Vec<f32> = (0..LEVELS).map(|level| bell(level) as f32).collect();
    let mean = |place: usize, c: usize| {
        let (mut sum, mut total) = (0.0, 1e-12);
        for (picture, &time_s) in stack.pictures.iter().zip(&stack.exposure_s) {
            let (level, t) = (usize::from(picture.levels[place][c]), time_s as f32);
            sum += weights[level] * t * response.exposure(c)[level];
            total += weights[level] * t * t;
        }
        sum / total
    };
    Ok((0..stack.pictures[0].levels.len()).map(|place| [0, 1, 2].map(|c| mean(place, c))).collect())
}

fn check_depth(whites: &[u16]) -> Result<()> {
    match whites.iter().all(|&white| usize::from(white) + 1 == LEVELS) {
        true => Ok(()),
        false => Err(Error::request("the published methods know 8 bits only", "use Rigel's own")),
    }
}

fn check(stack: &Stack) -> Result<()> {
    check_depth(&[stack.white()])?;
    if stack.exposure_s.iter().all(|t| *t == stack.exposure_s[0]) {
        return Err(Error::request("the exposure times are all the same", "photograph a bracket"));
    }
    Ok(())
}

/// About so many pixels, evenly over the picture (the grid of OpenCV's CalibrateDebevec).
fn grid(stack: &Stack, pixels: usize) -> Vec<usize> {
    let (width, height) = (stack.pictures[0].width as usize, stack.pictures[0].height as usize);
    let columns = ((pixels * width) as f64 / height as f64).sqrt().max(1.0) as usize;
    let rows = (pixels / columns).max(1);
    let (dx, dy) = ((width / columns).max(1), (height / rows).max(1));
    let row = |y: usize| (dx / 2..width).step_by(dx).take(columns).map(move |x| y * width + x);
    (dy / 2..height).step_by(dy).take(rows).flat_map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{self, CURVES};
    use super::*;

    fn error(radiance: &[[f32; 3]], scene: &[[f64; 3]]) -> f64 {
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let ratio: Vec<f64> =
            radiance.iter().zip(scene).map(|(r, truth)| f64::from(r[1]) / truth[1]).collect();
        let scale = median(ratio.clone());
        median(ratio.iter().map(|r| (r / scale - 1.0).abs()).collect())
    }

    #[test]
    fn the_published_methods_do_what_they_are_known_to_do() {
        let (_, curve) = CURVES[0];
        let scene = simulated::scene(128, 96, 3);
        let sixteen: Vec<f64> = (-8..8).map(|k| 2f64.powi(k)).collect();
        let stack = simulated::shoot(&scene, 128, &sixteen, curve, 1.0, 3);
        let debevec = debevec_response(&stack, 300, 30.0).unwrap();
        let robertson = robertson_response(&stack).unwrap();
        let (d, r) = (
            error(&debevec_merge(&stack, &debevec, hat).unwrap(), &scene),
            error(&robertson_merge(&stack, &robertson).unwrap(), &scene),
        );
        println!("Debevec {:.2} %, Robertson {:.2} %", 100.0 * d, 100.0 * r);
        assert!(d < 0.03 && r < 0.03, "{d} {r}");
    }

    #[test]
    fn weights_are_even_and_vanish_at_the_ends() {
        for weight in [hat, bell] {
            assert!(weight(0).abs() < 1e-12 && weight(255).abs() < 1e-12);
            for level in 0..128 {
                assert!((weight(level) - weight(255 - level)).abs() < 1e-12);
                assert!(weight(level) < weight(level + 1) || level == 127);
            }
        }
    }

    #[test]
    fn what_they_cannot_do_is_refused() {
        let stack = simulated::shoot(&[[0.1; 3]; 64], 8, &[1.0, 1.0], CURVES[0].1, 1.0, 1);
        assert!(debevec_response(&stack, 10, 1.0).unwrap_err().to_string().contains("all the same"));
        let mut deep = simulated::shoot(&[[0.1; 3]; 64], 8, &[1.0, 2.0], CURVES[0].1, 1.0, 1);
        deep.pictures.iter_mut().for_each(|p| p.white = u16::MAX);
        assert!(robertson_response(&deep).unwrap_err().to_string().contains("8 bits"));
        for response in [Response::srgb(255), Response::srgb(u16::MAX)] {
            assert!(debevec_merge(&deep, &response, hat).unwrap_err().to_string().contains("8 bits"));
            assert!(robertson_merge(&deep, &response).unwrap_err().to_string().contains("8 bits"));
        }
    }
}

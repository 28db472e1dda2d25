//! One gain for each view, where nobody knows exposure times.

use crate::{Error, Result};

/// Rounds at most; gains that change by less are at rest, by more are none (logarithms).
const ROUNDS: usize = 200;
const RESTING: f32 = 1e-4;
const STILL_MOVING: f32 = 0.01;

/// Estimates the gain of each view from texels that several views measured: `logs[texel][view]` is the logarithm of the radiance
/// over gain, NaN where absent. Alternates between a texel's median over views and a view's median over texels, so that
/// highlights, which few views see in few texels, do not pull. The gains' geometric mean is 1.
///
/// What the surface does in the same way at all its texels (a highlight as large as the surface) cannot be told from a gain.
///
/// # Errors
/// [`Error::Request`] when some views share no texel with the others, not even by way of a third view, or the gains contradict
/// each other so much that they do not come to rest.
pub(super) fn estimate(logs: &[Vec<f32>], names: &[String]) -> Result<Vec<f64>> {
    let views = names.len();
    let mut gains = vec![0f32; views];
    // A texel that a single view measured agrees with any gain: it must not vote for the present one.
    let shared = |texel: &&Vec<f32>| texel.iter().filter(|log| !log.is_nan()).count() >= 2;
    let logs: Vec<&Vec<f32>> = logs.iter().filter(shared).collect();
    refuse_groups(&logs, names)?;
    let mut restless = (0f32, 0);
    for _ in 0..ROUNDS {
        let references: Vec<f32> =
            logs.iter().map(|texel| median(texel.iter().zip(&gains).map(|(log, gain)| log - gain))).collect();
        restless = (0.0, 0);
        for view in 0..views {
            let gain = median(logs.iter().zip(&references).map(|(texel, reference)| texel[view] - reference));
            let change = (gain - gains[view]).abs();
            if change > restless.0 {
                restless = (change, view);
            }
            gains[view] = gain;
        }
        let mean = gains.iter().sum::<f32>() / views as f32;
        gains.iter_mut().for_each(|gain| *gain -= mean);
        if restless.0 < RESTING {
            break;
        }
    }
    let (change, view) = restless;
    if change > STILL_MOVING {
        return Err(Error::request(
            format!(
                "the gains of the views do not come to rest, that of {} still changes by {:.1} %",
                names[view],
                100.0 * change
            ),
            "leave the view out, or give the exposure times",
        ));
    }
    Ok(gains.iter().map(|&gain| f64::from(gain).exp()).collect())
}

/// Views that are linked by texels have gains relative to each other; between groups that are not, any ratio would do.
fn refuse_groups(logs: &[&Vec<f32>], names: &[String]) -> Result<()> {
    let mut group: Vec<usize> = (0..names.len()).collect();
    for texel in logs {
        let mut seen = (0..names.len()).filter(|&view| !texel[view].is_nan());
        let Some(first) = seen.next() else { continue };
        for view in seen {
            let (one, other) = (root(&mut group, first), root(&mut group, view));
            group[one.max(other)] = one.min(other);
        }
    }
    let roots: Vec<usize> = (0..names.len()).map(|view| root(&mut group, view)).collect();
    let size = |view: usize| roots.iter().filter(|&&root| root == roots[view]).count();
    // The smallest group is the one to leave out.
    let Some(apart) = (0..names.len()).min_by_key(|&view| size(view)) else { return Ok(()) };
    let count = size(apart);
    if count == names.len() {
        return Ok(());
    }
    let what = match count {
        1 => format!("view {} shows no texel that another view shows", names[apart]),
        _ => format!(
            "view {} and {} others show no texel that the other {} views show",
            names[apart],
            count - 1,
            names.len() - count
        ),
    };
    Err(Error::request(what, "leave them out, or give the exposure times"))
}

/// The representative of a view's group; the way there is halved.
fn root(group: &mut [usize], mut view: usize) -> usize {
    while group[view] != view {
        group[view] = group[group[view]];
        view = group[view];
    }
    view
}

/// Median of the numbers that are not NaN; NaN of none.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.filter(|value| !value.is_nan()).collect();
    if values.is_empty() {
        return f32::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_recovered_in_spite_of_highlights_and_gaps() {
        let truth = [0.5f32, 1.0, 2.0, 1.3];
        let names: Vec<String> = (0..4).map(|view| view.to_string()).collect();
        let mean = truth.iter().map(|gain| gain.ln()).sum::<f32>() / 4.0;
        let logs: Vec<Vec<f32>> = (0..200)
            .map(|texel| {
                let albedo = 0.1 + 0.004 * texel as f32;
                let radiance =
                    |view: usize| albedo + if texel % 4 == view && texel % 3 == 0 { 5.0 } else { 0.0 };
                let absent = |view: usize| (texel + view).is_multiple_of(7);
                (0..4)
                    .map(|view| if absent(view) { f32::NAN } else { (radiance(view) * truth[view]).ln() })
                    .collect()
            })
            .collect();
        for (gain, truth) in estimate(&logs, &names).unwrap().iter().zip(truth) {
            assert!((gain.ln() - f64::from(truth.ln() - mean)).abs() < 0.01, "{gain} {truth}");
        }
    }

    #[test]
    fn texels_of_a_single_view_do_not_pin_the_gains() {
        let names = ["a".to_string(), "b".to_string()];
        let mut logs = vec![vec![4f32.ln(), 0.0]; 40];
        logs.extend(vec![vec![1.0, f32::NAN]; 60]);
        logs.extend(vec![vec![f32::NAN, 2.0]; 60]);
        let gains = estimate(&logs, &names).unwrap();
        assert!((gains[0] / gains[1] - 4.0).abs() < 1e-3, "{gains:?}");
    }

    #[test]
    fn groups_of_views_that_share_no_texel_have_no_common_gain() {
        let names: Vec<String> = ["a", "b", "c", "d", "e"].map(String::from).to_vec();
        let nan = f32::NAN;
        let mut logs = vec![vec![0.0, 1.0, 0.0, nan, nan]; 3];
        logs.extend(vec![vec![nan, nan, nan, 1.0, 1.5]; 3]);
        let error = estimate(&logs, &names).unwrap_err().to_string();
        assert!(error.contains("view d and 1 others") && error.contains("other 3 views"), "{error}");
        // One texel links them.
        logs.push(vec![nan, nan, 0.0, 0.0, nan]);
        assert!(estimate(&logs, &names).is_ok());
    }

    #[test]
    fn a_view_apart_from_the_others_is_named() {
        let mut logs = vec![vec![0.0, f32::NAN, 0.0]; 3];
        logs.extend(vec![vec![f32::NAN, 1.0, f32::NAN]; 3]);
        let error = estimate(&logs, &["a".into(), "b".into(), "c".into()]).unwrap_err().to_string();
        assert!(error.contains("view b"), "{error}");
    }
}

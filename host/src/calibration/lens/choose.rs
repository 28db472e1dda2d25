//! Which terms of the distortion the boards support: those that foretell boards which have not been seen.

use super::LensModel;
use super::adjust::{Estimate, Loss, Sight, adjust, residuals};
use super::project::LENS;
use crate::geometry::Lens;

/// Boards are held out in so many groups.
const GROUPS: usize = 6;

/// A lens whose terms beyond a model are zero.
pub(super) fn without(lens: &Lens, model: LensModel) -> Lens {
    let (all, free) = (lens.numbers(), model.estimated());
    lens.with_numbers(std::array::from_fn(|k| if free[k] { all[k] } else { 0.0 }))
}

/// The smallest model whose mean squared error on boards that were held out exceeds that of no larger model by more than
/// a standard error of the difference (taken board by board); `start` has the poses.
pub(super) fn choose(boards: &[Vec<Sight>], start: &Estimate) -> Option<LensModel> {
    let errors: Vec<Option<Vec<f64>>> =
        LensModel::LADDER.into_iter().map(|model| held_out(boards, start, model)).collect();
    let good_enough = |small: usize| {
        let Some(mine) = &errors[small] else { return false };
        errors[small + 1..].iter().flatten().all(|larger| {
            let gains: Vec<f64> = mine.iter().zip(larger).map(|(a, b)| a - b).collect();
            let count = gains.len() as f64;
            let mean = gains.iter().sum::<f64>() / count;
            let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0);
            mean <= (variance / count).sqrt()
        })
    };
    (0..LensModel::LADDER.len()).find(|&small| good_enough(small)).map(|small| LensModel::LADDER[small])
}

/// The mean squared residual of each board under the lens of the other boards, with the pose that suits it best; `None` where
/// the model cannot show it.
fn held_out(boards: &[Vec<Sight>], start: &Estimate, model: LensModel) -> Option<Vec<f64>> {
    let groups = GROUPS.min(boards.len());
    let whole = Estimate { lens: without(&start.lens, model), poses: start.poses.clone(), settled: false };
    let whole = adjust(boards, whole, model.estimated(), Loss::Squares)?;
    let mut errors = vec![0.0; boards.len()];
    for group in 0..groups {
        let part = |held: bool| (0..boards.len()).filter(move |i| (i % groups == group) == held);
        let others: Vec<Vec<Sight>> = part(false).map(|i| boards[i].clone()).collect();
        let poses = part(false).map(|i| whole.poses[i]).collect();
        let lens = adjust(
            &others,
            Estimate { lens: whole.lens, poses, settled: false },
            model.estimated(),
            Loss::Squares,
        )?
        .lens;
        for i in part(true) {
            let alone = Estimate { lens, poses: vec![whole.poses[i]], settled: false };
            let posed = adjust(&boards[i..=i], alone, [false; LENS], Loss::Squares)?;
            let left = residuals(&lens, &posed.poses[0], &boards[i])?;
            errors[i] = left.iter().map(|r| r.length_squared()).sum::<f64>() / left.len() as f64;
        }
    }
    Some(errors)
}

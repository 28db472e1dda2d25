//! The fewest further photographs that reach an error.

use super::Seen;

/// How often a choice of times is gone through in search of a better one.
const ROUNDS: usize = 4;

/// A view's brightness and the camera's precision. A photograph is told by how many bins lower than at the longest time its
/// exposures are.
pub(super) struct Search<'a> {
    curves: &'a [Vec<f64>; 3],
    /// Channel, bin and count of what is there.
    there: Vec<(usize, usize, u32)>,
    total: f64,
    /// So many values need not be measured so well.
    pub excused: f64,
    clipped: u32,
}

/// What a choice of times is worth, the smaller the better: the error that is reached, then how much all pixels gain.
type Worth = (f64, f64);

impl<'a> Search<'a> {
    pub fn new(curves: &'a [Vec<f64>; 3], seen: &Seen, share: f64) -> Self {
        let there: Vec<(usize, usize, u32)> = (0..3)
            .flat_map(|channel| {
                seen.counts[channel].iter().enumerate().map(move |(bin, &n)| (channel, bin, n))
            })
            .filter(|(_, _, count)| *count > 0)
            .collect();
        let total = f64::from(seen.clipped) + there.iter().map(|value| f64::from(value.2)).sum::<f64>();
        Self { curves, there, total, excused: (1.0 - share) * total, clipped: seen.clipped }
    }

    /// From now on this share of the values is wished for.
    pub fn excuse(&mut self, share: f64) {
        self.excused = (1.0 - share) * self.total;
    }

    /// The share of the values that have this relative error with these photographs.
    pub fn share_of(&self, taken: &[usize], relative_error: f64) -> f64 {
        let enough = relative_error.powi(-2) * (1.0 - 1e-9);
        let precisions = self.precisions(taken);
        let reached = precisions.iter().zip(&self.there).filter(|(precision, _)| **precision >= enough);
        reached.map(|(_, value)| f64::from(value.2)).sum::<f64>() / self.total.max(1.0)
    }

    /// The relative error that the wished share of the values has at most with these photographs.
    pub fn error(&self, taken: &[usize]) -> f64 {
        self.worth(&self.precisions(taken)).0
    }

    /// The first of the fewest further photographs with which the error is reached, of no more than `most` in all; where that
    /// is not possible, the best one, and `None` when there are as many as that.
    ///
    /// Tried are times of the `grid` and those of `halvings` that are not taken yet.
    pub fn more(
        &self,
        taken: &[usize],
        grid: &[usize],
        halvings: &[usize],
        most: usize,
        goal: f64,
    ) -> Option<usize> {
        let free = most.checked_sub(taken.len()).filter(|free| *free > 0)?;
        let before = self.precisions(taken);
        let mut chosen: Vec<usize> = Vec::new();
        for _ in 0..free {
            chosen = self.improved(&before, chosen, grid);
            if self.worth(&self.with(&before, &chosen)).0 <= goal {
                return chosen.into_iter().min();
            }
        }
        // As many photographs as halving takes are enough if halving is.
        let left: Vec<usize> = halvings.iter().copied().filter(|halving| !taken.contains(halving)).collect();
        if left.len() <= free
            && self.worth(&self.with(&before, &left)) < self.worth(&self.with(&before, &chosen))
        {
            chosen = left;
        }
        chosen.into_iter().min()
    }

    /// One time more, and each of them where it is worth most. What is chosen does not depend on what is wished for: whoever
    /// wishes for less gets no more photographs.
    fn improved(&self, before: &[f64], mut chosen: Vec<usize>, grid: &[usize]) -> Vec<usize> {
        chosen.push(self.best(&self.with(before, &chosen), grid));
        for _ in 0..ROUNDS {
            let old = chosen.clone();
            for index in 0..chosen.len() {
                let others: Vec<usize> =
                    chosen.iter().enumerate().filter(|(other, _)| *other != index).map(|(_, &t)| t).collect();
                chosen[index] = self.best(&self.with(before, &others), grid);
            }
            if chosen == old {
                break;
            }
        }
        chosen
    }

    /// The time that is worth most beside those with these precisions; of equals the longest.
    fn best(&self, precisions: &[f64], grid: &[usize]) -> usize {
        let mut best = (0, (f64::INFINITY, f64::INFINITY));
        for &time in grid {
            let worth = self.worth(&self.with(precisions, &[time]));
            if worth < best.1 {
                best = (time, worth);
            }
        }
        best.0
    }

    fn precisions(&self, taken: &[usize]) -> Vec<f64> {
        self.with(&vec![0.0; self.there.len()], taken)
    }

    /// The precision of every value, with further photographs.
    fn with(&self, before: &[f64], times: &[usize]) -> Vec<f64> {
        let more = |&(channel, bin, _): &(usize, usize, u32)| -> f64 {
            let one = |&below: &usize| bin.checked_sub(below).map_or(0.0, |bin| self.curves[channel][bin]);
            times.iter().map(one).sum()
        };
        before.iter().zip(&self.there).map(|(before, value)| before + more(value)).collect()
    }

    fn worth(&self, precisions: &[f64]) -> Worth {
        let mut order: Vec<(f64, u32)> =
            precisions.iter().zip(&self.there).map(|(&precision, value)| (precision, value.2)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut below = f64::from(self.clipped);
        let mut reached = if below > self.excused { Some(0.0) } else { None };
        let mut loss = below;
        for (precision, count) in order {
            below += f64::from(count);
            if below > self.excused {
                reached = reached.or(Some(precision));
            }
            loss += f64::from(count) / (1.0 + precision);
        }
        (reached.map_or(0.0, |precision: f64| precision.powf(-0.5)), loss)
    }
}

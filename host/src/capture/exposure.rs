//! Which exposure times a view needs, so that a stated share of its pixels is measured with a stated relative error.
//!
//! Pixels that the longest time leaves too dark are no part of the share: nothing measures them, and they are flagged later.
//!
//! The camera's noise says how well one photograph measures an exposure: well below saturation, badly near black. What the
//! photographs of a view show so far says how bright its pixels are. From both follows how well any further photograph would
//! measure them, and so the fewest that are enough. All in the unit of exposure at the longest time, and in bins of
//! [`BINS_PER_STOP`].

use crate::picture::Picture;
use crate::radiance::{NoiseModel, Response};
use crate::session::Precision;
use crate::{Error, Result};

use super::is_saturated;
use search::Search;

mod search;

/// How finely brightness is told apart.
const BINS_PER_STOP: f64 = 8.0;
/// How many stops of exposure, at one time, are looked at; the middle one is where a level of half of white is.
const STOPS: usize = 48;
const BINS: usize = STOPS * BINS_PER_STOP as usize;
/// Times that are tried lie so many bins apart: half a stop.
const STEP: usize = 4;
/// A photograph that looks for what is brighter than the last one could show is so many times less precise than the best at
/// most; what is still missing is filled in once all is seen.
const SCOUT_ERROR: f64 = 2.0;
/// So many stops at most are taken in one step.
const LONGEST_STEP: i32 = 8;
/// How much brighter the brightest pixel of a view may be than that of the view nearby without being saturated.
const ALIKE: f64 = 1.2;
/// So many pixels, spread over the picture, stand for all.
const MOST_PIXELS: usize = 1 << 17;

/// What is to be done next for a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Next {
    /// Another photograph with this time, seconds.
    Expose(f64),
    /// Nothing: this relative error is reached for the share that was wished for.
    Enough(f64),
    /// Nothing that would be worth it: as many photographs as halving takes do not reach what was wished for.
    Best {
        /// The share of the pixels that have the relative error that was wished for.
        share: f64,
        /// Whether some pixels are too bright for the camera's shortest time.
        clipped: bool,
    },
}

/// Decides about the exposure times of views.
#[derive(Debug, Clone)]
pub struct Planner {
    precision: Precision,
    response: Response,
    noise: NoiseModel,
    /// The times that halving would use, the longest first.
    halvings_s: Vec<f64>,
    /// Per channel: the inverse of the relative variance that one photograph gives an exposure in that bin; 0 where the
    /// exposure is saturated or too dark.
    curves: [Vec<f64>; 3],
}

/// What a photograph shows, as far as planning needs it.
#[derive(Debug, Clone, PartialEq)]
pub struct Glimpse {
    asked_s: f64,
    exposure_s: f64,
    saturated: bool,
    /// The highest level of each channel.
    brightest: [u16; 3],
    /// Of pixels that are spread over the picture, the same in every picture of this size.
    levels: Vec<[u16; 3]>,
}

impl Glimpse {
    /// A look at a photograph for which `asked_s` was asked and `exposure_s` used, seconds.
    pub fn new(picture: &Picture, asked_s: f64, exposure_s: f64) -> Self {
        let step = picture.levels.len().div_ceil(MOST_PIXELS).max(1);
        let levels = picture.levels.iter().step_by(step).copied().collect();
        let brightest = [0, 1, 2].map(|c| picture.levels.iter().map(|level| level[c]).max().unwrap_or(0));
        Self { asked_s, exposure_s, saturated: is_saturated(picture), brightest, levels }
    }
}

/// How bright the pixels of a view are: counts per channel and bin of the exposure at the longest time.
#[derive(Debug, Clone, PartialEq)]
struct Seen {
    counts: [Vec<u32>; 3],
    /// Values brighter than the shortest photograph shows.
    clipped: u32,
    /// Values darker than the longest photograph shows, where there is a longer time. They count as bright as they can be.
    dark: u32,
    /// The largest exposure at the longest time.
    brightest: f64,
}

impl Planner {
    /// A planner for a camera with this response and noise whose brackets have these times, each half of the one before.
    pub fn new(precision: Precision, response: Response, noise: NoiseModel, halvings_s: Vec<f64>) -> Self {
        let curves = [0, 1, 2].map(|channel| curve(&response, &noise, channel));
        Self { precision, response, noise, halvings_s, curves }
    }

    /// Whether a photograph is of this camera.
    ///
    /// # Errors
    /// [`Error::Input`] when the response belongs to photographs of another depth.
    pub fn check(&self, picture: &Picture) -> Result<()> {
        if picture.white == self.response.white() {
            return Ok(());
        }
        let what = format!("its levels go to {}, the response's to {}", picture.white, self.response.white());
        Err(Error::input(&picture.path, what, "give the response of this camera or none"))
    }

    /// The time with which a view begins, one of those of halving, given the shortest photograph of a view nearby: the longest
    /// that would saturate nothing there. It shows how bright all else is, and nothing is wasted on times that are too long.
    pub fn first(&self, nearby: &Glimpse) -> f64 {
        let white = usize::from(self.response.white());
        let room = (0..3).map(|channel| {
            let table = self.response.exposure(channel);
            f64::from(table[white - white / 50] / table[usize::from(nearby.brightest[channel]).min(white)])
        });
        let room = if nearby.saturated { 0.0 } else { room.fold(f64::INFINITY, f64::min) / ALIKE };
        let fitting = self.halvings_s.iter().find(|&&time_s| time_s <= room * nearby.exposure_s);
        fitting.or(self.halvings_s.last()).copied().unwrap_or(nearby.exposure_s)
    }

    /// What a view needs of which these photographs were taken.
    pub fn next(&self, taken: &[Glimpse]) -> Next {
        let (Some(&longest_s), Some(&shortest_s)) = (self.halvings_s.first(), self.halvings_s.last()) else {
            return Next::Best { share: 0.0, clipped: false };
        };
        let darkest = taken.iter().min_by(|a, b| a.asked_s.total_cmp(&b.asked_s));
        let Some(&Glimpse { asked_s: darkest_s, saturated: clipped, .. }) = darkest else {
            return Next::Expose(longest_s);
        };
        if clipped && darkest_s > shortest_s {
            return Next::Expose(self.shorter(darkest_s));
        }
        let seen = self.look(taken);
        let Precision { relative_error: goal, share } = self.precision;
        let bins: Vec<usize> =
            taken.iter().map(|glimpse| bins_below(glimpse.exposure_s, longest_s)).collect();
        let needed = self.halvings_needed(&seen);
        let most = match clipped {
            true => self.halvings_s.len(),
            // A view that did not begin with the longest time may have one that halving would not have come to.
            false if taken[0].asked_s < 0.999 * longest_s => {
                needed + usize::from(darkest_s < 0.75 * self.halvings_s[needed - 1])
            }
            false => needed,
        };
        let halvings: Vec<usize> =
            self.halvings_s.iter().take(most).map(|&time_s| bins_below(time_s, longest_s)).collect();
        let mut search = Search::new(&self.curves, &seen, share);
        if f64::from(seen.dark) > search.excused {
            // Whether they are part of the share, only the longest time tells.
            return Next::Expose(longest_s);
        }
        let attainable = search.share_of(&halvings, goal);
        let possible = attainable >= share && !clipped;
        if attainable < share && attainable > share / 2.0 {
            // For the sake of pixels that are too dark for this wish no more photographs are taken.
            search.excuse(share * attainable);
        }
        let end = |reached| match possible {
            true => Next::Enough(reached),
            false => Next::Best { share: search.share_of(&bins, goal), clipped },
        };
        let reached = search.error(&bins);
        if reached <= goal {
            return end(reached);
        }
        let grid: Vec<usize> = (0..=bins_below(shortest_s, longest_s)).step_by(STEP).collect();
        match search.more(&bins, &grid, &halvings, most, goal) {
            Some(below) => Next::Expose(longest_s * (-(below as f64) / BINS_PER_STOP).exp2()),
            None => Next::Best { share: search.share_of(&bins, goal), clipped },
        }
    }

    /// The time, one of those of halving, that shows what is brighter than `time_s` shows: as short as possible without a
    /// gap between the two.
    fn shorter(&self, time_s: f64) -> f64 {
        let stops = self.curves.iter().map(|curve| {
            let best = curve.iter().fold(0.0_f64, |best, &precision| best.max(precision));
            let enough = self.precision.relative_error.powi(-2).min(best / SCOUT_ERROR.powi(2));
            let top = curve.iter().rposition(|&precision| precision > 0.0).unwrap_or(0);
            let good = curve[..=top].iter().rev().take_while(|&&precision| precision >= enough).count();
            (good as f64 / BINS_PER_STOP) as i32
        });
        let stops = stops.min().unwrap_or(1).clamp(1, LONGEST_STEP);
        let goal_s = time_s * f64::from(-stops).exp2() * 0.999;
        let shorter = self.halvings_s.iter().filter(|&&time| time < time_s && time >= goal_s);
        shorter.copied().last().unwrap_or(time_s / 2.0)
    }

    /// How many photographs halving takes until no pixel is saturated.
    fn halvings_needed(&self, seen: &Seen) -> usize {
        let white = usize::from(self.response.white());
        let top = (0..3).map(|c| f64::from(self.response.exposure(c)[white - white / 50]));
        let top = top.fold(f64::MAX, f64::min);
        let stops = (seen.brightest / top).log2().ceil().max(0.0);
        (1 + stops as usize).min(self.halvings_s.len())
    }

    fn look(&self, taken: &[Glimpse]) -> Seen {
        let longest_s = self.halvings_s[0];
        let above = BINS_PER_STOP.recip().exp2();
        let longest_taken = taken.iter().any(|glimpse| glimpse.asked_s > 0.999 * longest_s);
        let mut seen = Seen { counts: [0; 3].map(|_| vec![0; BINS]), clipped: 0, dark: 0, brightest: 0.0 };
        let pixels = taken.iter().map(|glimpse| glimpse.levels.len()).min().unwrap_or(0);
        for pixel in 0..pixels {
            for channel in 0..3 {
                let table = self.response.exposure(channel);
                let (mut sum, mut weight) = (0.0, 0.0);
                // Where no photograph measures it: not below the one, not above the other.
                let (mut low, mut high) = (0.0_f64, f64::MAX);
                for glimpse in taken {
                    let level = glimpse.levels[pixel][channel];
                    let x = f64::from(table[usize::from(level).min(table.len() - 1)]);
                    let at_longest = x * longest_s / glimpse.exposure_s;
                    if level >= self.noise.saturated_level[channel] {
                        low = low.max(at_longest);
                    } else if level <= self.noise.dark_level[channel] {
                        high = high.min(at_longest);
                    } else {
                        let precision = self.curves[channel].get(bin(x)).copied().unwrap_or(0.0).max(1e-9);
                        sum += precision * at_longest;
                        weight += precision;
                    }
                }
                let exposure = if weight > 0.0 {
                    sum / weight
                } else if high == f64::MAX {
                    seen.clipped += 1;
                    continue;
                } else if low == 0.0 && longest_taken {
                    // The longest time does not show it, and no other will.
                    continue;
                } else {
                    seen.dark += u32::from(low == 0.0);
                    // Between the two, and not where the longer photograph measures.
                    if low == 0.0 { high } else { (low * high).sqrt().max(low * above) }
                };
                seen.brightest = seen.brightest.max(exposure);
                seen.counts[channel][bin(exposure)] += 1;
            }
        }
        seen
    }
}

/// The bin of an exposure.
fn bin(exposure: f64) -> usize {
    let stops = exposure.max(f64::MIN_POSITIVE).log2() + STOPS as f64 / 2.0;
    ((stops * BINS_PER_STOP) as usize).min(BINS - 1)
}

/// How many bins lower an exposure is with this time than with the longest.
fn bins_below(time_s: f64, longest_s: f64) -> usize {
    ((longest_s / time_s).log2() * BINS_PER_STOP).round().max(0.0) as usize
}

/// The inverse of the relative variance of an exposure in each bin.
fn curve(response: &Response, noise: &NoiseModel, channel: usize) -> Vec<f64> {
    let table = response.exposure(channel);
    let (dark, saturated) = (noise.dark_level[channel], noise.saturated_level[channel]);
    let levels = usize::from(dark) + 1..usize::from(saturated).min(table.len());
    let mut curve = vec![0.0; BINS];
    let mut filled = None;
    for level in levels {
        let x = f64::from(table[level]);
        let variance = noise.variance(channel, x, f64::from(response.slope(channel, level)));
        if x > 0.0 && variance > 0.0 {
            let (at, precision) = (bin(x), x * x / variance);
            // A level reaches down to the one before.
            let from = filled.map_or(at, |last: usize| (last + 1).min(at));
            curve[from..=at].fill(precision);
            filled = Some(at);
        }
    }
    curve
}

#[cfg(test)]
mod tests;

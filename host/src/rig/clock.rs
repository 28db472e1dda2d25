//! The rig's clock told in the host's time.
//!
//! Every ping gives one certainty and no guess: the rig read its clock after the host had said the ping and before the
//! host heard the answer. Over several pings that leaves a polygon of possible offsets and rates, and from it a bound that
//! no distribution of the delays can make wrong. The estimate is a straight line through the pings with the shortest round
//! trips, held within the middle half of what is possible: the line is best where delays vary either way, the middle where
//! some of them are only late.

use std::collections::VecDeque;

/// Neither clock is wrong by more than this, seconds per second: far beyond any crystal and what NTP does to a host.
const LARGEST_SKEW: f64 = 1e-3;
/// How fast the difference of the rates may change, per second: a part per million in a minute, as when a crystal warms up.
const LARGEST_DRIFT_PER_S: f64 = 2e-8;
/// How far the rates are expected to differ, seconds per second: a line through a few seconds of pings is steeper by chance.
const USUAL_SKEW: f64 = 50e-6;
/// How far the middle of a short round trip is expected to be from the moment when the rig read its clock, seconds.
const USUAL_ERROR_S: f64 = 1.5e-3;
/// Pings older than this teach nothing, seconds.
const MEMORY_S: f64 = 60.0;
/// The rig counts whole microseconds, seconds.
const TICK_S: f64 = 1e-6;

/// A moment in the host's time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Seconds on the scale of the pings' times.
    pub host_s: f64,
    /// By how much that can be wrong at most, either way, seconds.
    pub bound_s: f64,
}

/// What the pings tell of the rig's clock.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    pings: VecDeque<Ping>,
    /// The corners of the possible (host time minus rig time, seconds; rate minus 1), both at the newest ping, in order.
    possible: Vec<[f64; 2]>,
    /// The line through the shortest round trips, in the same terms.
    line: [f64; 2],
}

#[derive(Debug, Clone, Copy)]
struct Ping {
    said_s: f64,
    rig_us: u64,
    heard_s: f64,
}

impl Clock {
    /// A clock that no ping was answered of.
    pub const fn new() -> Self {
        Self { pings: VecDeque::new(), possible: vec![], line: [0.0; 2] }
    }

    /// Takes a ping: when it was said and its answer heard by the host (seconds on any scale of its own that never jumps),
    /// and what the rig's clock told.
    ///
    /// What contradicts older pings (the rig has restarted, the host has slept) replaces them.
    pub fn ping(&mut self, said_s: f64, rig_us: u64, heard_s: f64) {
        let round_trip_s = heard_s - said_s;
        if round_trip_s.is_nan() || round_trip_s < 0.0 {
            return;
        }
        self.pings.push_back(Ping { said_s, rig_us, heard_s });
        while self.pings.front().is_some_and(|first| heard_s - first.heard_s > MEMORY_S) {
            self.pings.pop_front();
        }
        // The newest first: it is the one that counts where they contradict each other.
        let half_s = round_trip_s / 2.0 + TICK_S;
        let middle_s = (said_s + heard_s) / 2.0;
        let mut possible = vec![
            [middle_s - half_s, -LARGEST_SKEW],
            [middle_s + half_s, -LARGEST_SKEW],
            [middle_s + half_s, LARGEST_SKEW],
            [middle_s - half_s, LARGEST_SKEW],
        ];
        let mut kept = 1;
        for ping in self.pings.iter().rev().skip(1) {
            let age_s = seconds(rig_us, ping.rig_us);
            let slack_s = wander(age_s) + TICK_S;
            // offset + age_s + skew * age_s lies between said_s and heard_s.
            let earlier = clip(&possible, age_s, ping.heard_s + slack_s - age_s);
            let both: Vec<[f64; 2]> = clip(&mirrored(&earlier), age_s, -(ping.said_s - slack_s - age_s));
            if both.is_empty() {
                break;
            }
            possible = mirrored(&both);
            kept += 1;
        }
        self.pings.drain(..self.pings.len() - kept);
        self.possible = possible;
        self.line = self.fit();
    }

    /// Least squares through the middles of the quarter of the pings with the shortest round trips (as NTP's clock filter
    /// prefers them, Mills 1991), the rate drawn towards 1.
    fn fit(&self) -> [f64; 2] {
        let Some(newest) = self.pings.back() else { return [0.0; 2] };
        let mut pings: Vec<&Ping> = self.pings.iter().collect();
        pings.sort_by(|a, b| (a.heard_s - a.said_s).total_cmp(&(b.heard_s - b.said_s)));
        pings.truncate(pings.len().div_ceil(4));
        let points: Vec<[f64; 2]> = pings
            .iter()
            .map(|ping| {
                let age_s = seconds(newest.rig_us, ping.rig_us);
                [age_s, f64::midpoint(ping.said_s, ping.heard_s) - age_s]
            })
            .collect();
        let mean = [0, 1].map(|i| points.iter().map(|point| point[i]).sum::<f64>() / points.len() as f64);
        let sum = |i: usize| -> f64 { points.iter().map(|p| (p[0] - mean[0]) * (p[i] - mean[i])).sum() };
        let skew = sum(1) / (sum(0) + (USUAL_ERROR_S / USUAL_SKEW).powi(2));
        [mean[1] - skew * mean[0], skew]
    }

    /// When the rig's clock showed `rig_us`; `None` before the first ping.
    pub fn at(&self, rig_us: u64) -> Option<Moment> {
        let newest = self.pings.back()?;
        let age_s = seconds(newest.rig_us, rig_us);
        let on_line = |[offset_s, skew]: [f64; 2]| offset_s + skew * age_s;
        let (low, high) = extremes(self.possible.iter().map(|&corner| on_line(corner)));
        let (middle, quarter) = (f64::midpoint(low, high), (high - low) / 4.0);
        let best = on_line(self.line).clamp(middle - quarter, middle + quarter);
        Some(Moment { host_s: best + age_s, bound_s: (best - low).max(high - best) + wander(age_s) })
    }

    /// By how much the host's clock is faster than the rig's, and how wrong that can be, seconds per second; `None` before
    /// the first ping.
    pub fn skew(&self) -> Option<[f64; 2]> {
        self.pings.back()?;
        let (low, high) = extremes(self.possible.iter().map(|[_, skew]| *skew));
        Some([f64::midpoint(low, high), (high - low) / 2.0])
    }
}

/// From one reading of the rig's clock to another, seconds.
fn seconds(from_us: u64, to_us: u64) -> f64 {
    let way_us = to_us.abs_diff(from_us) as f64;
    (if to_us < from_us { -way_us } else { way_us }) * 1e-6
}

/// How far a clock whose rate may drift can stray from a straight line within a time, seconds.
fn wander(time_s: f64) -> f64 {
    LARGEST_DRIFT_PER_S / 2.0 * time_s * time_s
}

fn extremes(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

fn mirrored(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    corners.iter().map(|[x, y]| [-x, -y]).collect()
}

/// The part of a convex polygon where x + y * `slope` is at most `limit` (Sutherland and Hodgman 1974).
fn clip(corners: &[[f64; 2]], slope: f64, limit: f64) -> Vec<[f64; 2]> {
    let beyond = |[x, y]: [f64; 2]| x + y * slope - limit;
    if corners.iter().all(|&corner| beyond(corner) <= 0.0) {
        return corners.to_vec();
    }
    let mut left = Vec::with_capacity(corners.len() + 1);
    for (i, &corner) in corners.iter().enumerate() {
        let next = corners[(i + 1) % corners.len()];
        let (here, there) = (beyond(corner), beyond(next));
        if here <= 0.0 {
            left.push(corner);
        }
        if (here < 0.0 && there > 0.0) || (here > 0.0 && there < 0.0) {
            let part = here / (here - there);
            left.push([0, 1].map(|i| corner[i] + part * (next[i] - corner[i])));
        }
    }
    left
}

#[cfg(test)]
mod tests {
    use rand::rngs::StdRng;
    use rand::{Rng, SeedableRng};

    use super::*;

    /// A host and a rig's clock with a line of random delays between them.
    struct Line<'a> {
        random: &'a mut StdRng,
        /// There and back, seconds.
        delays: fn(&mut StdRng) -> [f64; 2],
        offset_s: f64,
        skew: f64,
    }

    impl Line<'_> {
        fn rig_us(&self, host_s: f64) -> u64 {
            ((host_s - self.offset_s) / (1.0 + self.skew) * 1e6) as u64
        }

        /// The true time of a reading.
        fn host_s(&self, rig_us: u64) -> f64 {
            rig_us as f64 * 1e-6 * (1.0 + self.skew) + self.offset_s
        }

        fn exchange(&mut self, said_s: f64) -> (f64, u64, f64) {
            let [there_s, back_s] = (self.delays)(self.random);
            (said_s, self.rig_us(said_s + there_s), said_s + there_s + back_s)
        }

        fn ping(&mut self, clock: &mut Clock, said_s: f64) {
            let (said_s, rig_us, heard_s) = self.exchange(said_s);
            clock.ping(said_s, rig_us, heard_s);
        }
    }

    const TRIALS: u64 = 1000;
    const JITTER_S: f64 = 5e-3;
    const LEAST_S: f64 = 0.3e-3;

    fn uniform(random: &mut StdRng) -> f64 {
        random.random_range(0.0..JITTER_S)
    }

    fn normal(random: &mut StdRng) -> f64 {
        let u: f64 = random.random_range(1e-12..1.0);
        (-2.0 * u.ln()).sqrt() * random.random_range(0.0..std::f64::consts::TAU).cos()
    }

    /// Name, delays there and back.
    type Kind = (&'static str, fn(&mut StdRng) -> [f64; 2]);

    /// How wide the bound may be in the middle of the trials: what the least delays leave open and a bit.
    const LEAST_BOUND_S: [f64; 6] = [1e-3, 1e-3, 1e-3, 6e-3, 1e-3, 10e-3];

    const KINDS: [Kind; 6] = [
        ("answers late by 0 to 5 ms", |r| [LEAST_S, LEAST_S + uniform(r)]),
        ("requests late by 0 to 5 ms", |r| [LEAST_S + uniform(r), LEAST_S]),
        ("both late by 0 to 5 ms", |r| [LEAST_S + uniform(r), LEAST_S + uniform(r)]),
        ("both 8 ms, 5 ms sooner or later", |r| [0; 2].map(|_| 3e-3 + 2.0 * uniform(r))),
        ("both late, exponential of mean 5 ms", |r| {
            [0; 2].map(|_| LEAST_S - JITTER_S * r.random_range(1e-12..1.0_f64).ln())
        }),
        ("both 10 ms, normal of 2.5 ms", |r| {
            [0; 2].map(|_| (10e-3 + JITTER_S / 2.0 * normal(r)).max(LEAST_S))
        }),
    ];

    #[test]
    fn the_error_is_below_a_millisecond_after_ten_seconds_and_the_bound_holds() {
        for (seed, ((name, delays), least_bound_s)) in (1..).zip(KINDS.into_iter().zip(LEAST_BOUND_S)) {
            let mut random = StdRng::seed_from_u64(seed);
            let (mut errors, mut bounds, mut held) = (vec![], vec![], 0);
            for _ in 0..TRIALS {
                let offset_s = random.random_range(-1e5..0.0);
                let skew = if random.random() { 50e-6 } else { -50e-6 };
                let mut line = Line { random: &mut random, delays, offset_s, skew };
                let mut clock = Clock::new();
                for ping in 0..200 {
                    // The last one does the thinking, from all of them.
                    let (said_s, rig_us, heard_s) = line.exchange(f64::from(ping) * 0.05);
                    clock.pings.push_back(Ping { said_s, rig_us, heard_s });
                }
                line.ping(&mut clock, 10.0 - 2.0 * JITTER_S);
                let rig_us = line.rig_us(10.0);
                let moment = clock.at(rig_us).unwrap();
                let error_s = (moment.host_s - line.host_s(rig_us)).abs();
                held += u64::from(error_s <= moment.bound_s);
                errors.push(error_s);
                bounds.push(moment.bound_s);
            }
            errors.sort_by(f64::total_cmp);
            bounds.sort_by(f64::total_cmp);
            println!(
                "{name:<36} error median {:.3}, 99 % {:.3}, largest {:.3} ms; bound median {:.3} ms, held {held}/{TRIALS}",
                errors[500] * 1e3,
                errors[990] * 1e3,
                errors[999] * 1e3,
                bounds[500] * 1e3
            );
            assert!(errors[990] < 1e-3, "{name}: {} s", errors[990]);
            assert!(held >= TRIALS * 99 / 100, "{name}: {held}");
            // A bound that always holds because it is never tight would be worth nothing.
            assert!(bounds[500] < least_bound_s, "{name}: {} s", bounds[500]);
        }
    }

    #[test]
    fn the_skew_is_found_and_its_bound_holds() {
        let mut random = StdRng::seed_from_u64(9);
        for (_, delays) in KINDS {
            for skew in [-50e-6, 0.0, 20e-6, 300e-6] {
                let mut line = Line { random: &mut random, delays, offset_s: -17.0, skew };
                let mut clock = Clock::new();
                for ping in 0..600 {
                    line.ping(&mut clock, f64::from(ping) * 0.1);
                }
                let [found, bound] = clock.skew().unwrap();
                assert!((found - skew).abs() <= bound && bound < 400e-6, "{found} ± {bound}, {skew}");
            }
        }
    }

    #[test]
    fn one_ping_tells_as_much_as_its_round_trip_and_none_tells_nothing() {
        let mut clock = Clock::new();
        assert_eq!((clock.at(5), clock.skew()), (None, None));
        clock.ping(100.0, 7_000_000, 100.004);
        let moment = clock.at(7_000_000).unwrap();
        assert!(
            (moment.host_s - 100.002).abs() < 1e-9 && (moment.bound_s - 0.002).abs() < 2e-6,
            "{moment:?}"
        );
        // Further away the rates may differ by anything that clocks do.
        let later = clock.at(17_000_000).unwrap();
        assert!((later.host_s - 110.002).abs() < 1e-9 && (later.bound_s - 0.012).abs() < 1e-5, "{later:?}");
        // An answer before its question, or no times at all, teach nothing.
        clock.ping(101.0, 8_000_000, 100.9);
        clock.ping(f64::NAN, 8_000_000, 101.0);
        assert_eq!(clock.at(7_000_000), Some(moment));
    }

    #[test]
    fn a_clock_that_starts_anew_is_followed_at_once() {
        let mut random = StdRng::seed_from_u64(5);
        let mut clock = Clock::new();
        for offset_s in [-500.0, 40.0, 41.0] {
            let mut line = Line { random: &mut random, delays: KINDS[2].1, offset_s, skew: 30e-6 };
            for ping in 0..40 {
                line.ping(&mut clock, 50.0 + offset_s + f64::from(ping) * 0.1);
            }
            let rig_us = line.rig_us(54.0 + offset_s);
            let moment = clock.at(rig_us).unwrap();
            assert!((moment.host_s - line.host_s(rig_us)).abs() <= moment.bound_s && moment.bound_s < 3e-3);
        }
    }

    #[test]
    fn a_rate_that_drifts_as_a_crystal_does_stays_within_the_bound() {
        let mut random = StdRng::seed_from_u64(6);
        let mut clock = Clock::new();
        // The rig's clock is behind by the integral of a rate that drifts slower than the largest drift.
        let host_of = |rig_s: f64| rig_s + 40e-6 * rig_s + 0.8e-8 * rig_s * rig_s;
        let rig_of = |host_s: f64| (0..20).fold(host_s, |rig_s, _| rig_s - (host_of(rig_s) - host_s));
        for ping in 0..3000 {
            let said_s = f64::from(ping) * 0.1;
            let (there_s, back_s) = (LEAST_S + uniform(&mut random), LEAST_S + uniform(&mut random));
            clock.ping(said_s, (rig_of(said_s + there_s) * 1e6) as u64, said_s + there_s + back_s);
            let rig_us = (rig_of(said_s) * 1e6) as u64;
            let moment = clock.at(rig_us).unwrap();
            let error_s = (moment.host_s - host_of(rig_us as f64 * 1e-6)).abs();
            assert!(error_s <= moment.bound_s, "{said_s}: {error_s} {moment:?}");
        }
        assert!(clock.pings.len() > 590, "nothing contradicts");
    }
}

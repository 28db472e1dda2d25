//! The order in which a rig visits views, so that it travels little.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::pan_tilt;
use crate::rig::RigLimits;
use crate::{Error, Result};

/// Where a rig's tour begins: homed.
const HOME: [f64; 2] = [0.0, 0.0];

/// One stop of a tour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stop {
    /// Which of the views.
    pub view: usize,
    /// The pan that shows it, radians, within the rig's limits.
    pub pan_rad: f64,
    /// The tilt that shows it, radians, within the rig's limits.
    pub tilt_rad: f64,
}

/// The views in an order that keeps the travel short, beginning at the rig's home: nearest neighbour and 2-opt on the
/// time of travel. Never longer than the given order.
///
/// A view is shown by several pairs of pan and tilt (whole turns; half a turn and the tilt to the other side); the tour
/// takes those that suit it, within the limits.
///
/// # Errors
/// Views that the rig cannot show: the numbers and angles of all of them are named.
pub fn tour(views: &[DVec3], limits: &RigLimits) -> Result<Vec<Stop>> {
    let choices = all_choices(views, limits)?;
    let given: Vec<usize> = (0..views.len()).collect();
    let cost = Costs::new(&choices, limits);
    let candidates = [cost.improve(given.clone()), cost.improve(cost.nearest_neighbours())];
    let mut best = choose(&given, &choices, limits);
    for order in candidates {
        let stops = choose(&order, &choices, limits);
        if tour_time_s(&stops, limits) < tour_time_s(&best, limits) {
            best = stops;
        }
    }
    Ok(best)
}

/// The views in their given order, with the pairs of pan and tilt that make it shortest.
///
/// # Errors
/// As for [`tour`].
pub fn in_order(views: &[DVec3], limits: &RigLimits) -> Result<Vec<Stop>> {
    let given: Vec<usize> = (0..views.len()).collect();
    Ok(choose(&given, &all_choices(views, limits)?, limits))
}

/// How long a rig that starts at home travels and settles along a tour, seconds.
pub fn tour_time_s(stops: &[Stop], limits: &RigLimits) -> f64 {
    let places = stops.iter().map(|stop| [stop.pan_rad, stop.tilt_rad]);
    let before = std::iter::once(HOME).chain(places.clone());
    before.zip(places).map(|(from, to)| limits.travel_time_s(from, to)).sum()
}

/// The pairs of pan and tilt within the limits that show a view.
fn choices(view: DVec3, limits: &RigLimits) -> Vec<[f64; 2]> {
    let (pan_rad, tilt_rad) = pan_tilt(view);
    let mut found = Vec::new();
    for (pan_rad, tilt_rad) in [(pan_rad, tilt_rad), (pan_rad + PI, -tilt_rad)] {
        let first = ((limits.pan_rad[0] - pan_rad) / TAU).floor() as i64;
        let last = ((limits.pan_rad[1] - pan_rad) / TAU).ceil() as i64;
        found.extend((first..=last).map(|turn| [pan_rad + turn as f64 * TAU, tilt_rad]));
    }
    found.retain(|&[pan_rad, tilt_rad]| limits.contains(pan_rad, tilt_rad));
    found
}

/// Whether the rig can show a view.
pub fn is_reachable(view: DVec3, limits: &RigLimits) -> bool {
    !choices(view, limits).is_empty()
}

fn all_choices(views: &[DVec3], limits: &RigLimits) -> Result<Vec<Vec<[f64; 2]>>> {
    let (mut all, mut beyond) = (vec![], vec![]);
    for (number, view) in views.iter().enumerate() {
        let found = choices(*view, limits);
        if found.is_empty() {
            let (pan_rad, tilt_rad) = pan_tilt(*view);
            let (pan, tilt) = (pan_rad.to_degrees(), tilt_rad.to_degrees());
            beyond.push(format!("view {number} (pan {pan:.2}°, tilt {tilt:.2}°)"));
        }
        all.push(found);
    }
    if beyond.is_empty() {
        return Ok(all);
    }
    Err(Error::request(
        format!("the rig cannot show {}", beyond.join(", ")),
        "choose a smaller zenith limit or a rig that reaches further",
    ))
}

/// The shortest way through the choices of an order of views (dynamic programming: exact).
fn choose(order: &[usize], choices: &[Vec<[f64; 2]>], limits: &RigLimits) -> Vec<Stop> {
    // For every choice of every stop: the time up to there, and which choice of the stop before leads to it.
    let mut ways: Vec<Vec<(f64, usize)>> = Vec::with_capacity(order.len());
    let mut before: Vec<([f64; 2], f64)> = vec![(HOME, 0.0)];
    for &view in order {
        let way: Vec<(f64, usize)> = choices[view]
            .iter()
            .map(|&here| {
                let arrivals = before.iter().map(|&(there, time)| time + limits.travel_time_s(there, here));
                arrivals.zip(0..).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0))
            })
            .collect();
        before = choices[view].iter().copied().zip(way.iter().map(|w| w.0)).collect();
        ways.push(way);
    }
    let mut choice = (0..before.len()).min_by(|&a, &b| before[a].1.total_cmp(&before[b].1)).unwrap_or(0);
    let mut stops = Vec::with_capacity(order.len());
    for (&view, way) in order.iter().zip(&ways).rev() {
        let [pan_rad, tilt_rad] = choices[view][choice];
        stops.push(Stop { view, pan_rad, tilt_rad });
        choice = way[choice].1;
    }
    stops.reverse();
    stops
}

/// The shortest time between any choices of two views; the last row and column are home.
struct Costs {
    count: usize,
    times: Vec<f64>,
}

impl Costs {
    fn new(choices: &[Vec<[f64; 2]>], limits: &RigLimits) -> Self {
        let home = [vec![HOME]];
        let all: Vec<&Vec<[f64; 2]>> = choices.iter().chain(&home).collect();
        let between = |a: &Vec<[f64; 2]>, b: &Vec<[f64; 2]>| {
            let times = a.iter().flat_map(|&from| b.iter().map(move |&to| limits.travel_time_s(from, to)));
            times.fold(f64::INFINITY, f64::min)
        };
        let times = all.iter().flat_map(|a| all.iter().map(|b| between(a, b)).collect::<Vec<_>>()).collect();
        Self { count: choices.len(), times }
    }

    fn time(&self, a: usize, b: usize) -> f64 {
        self.times[a * (self.count + 1) + b]
    }

    fn nearest_neighbours(&self) -> Vec<usize> {
        let mut left: Vec<usize> = (0..self.count).collect();
        let mut order = Vec::with_capacity(self.count);
        let mut at = self.count;
        while let Some(next) =
            (0..left.len()).min_by(|&a, &b| self.time(at, left[a]).total_cmp(&self.time(at, left[b])))
        {
            at = left.remove(next);
            order.push(at);
        }
        order
    }

    /// 2-opt: turns parts of the order round for as long as that shortens it.
    fn improve(&self, mut order: Vec<usize>) -> Vec<usize> {
        let mut improved = true;
        while improved {
            improved = false;
            for i in 0..order.len() {
                let before = if i == 0 { self.count } else { order[i - 1] };
                for j in i + 1..order.len() {
                    let mut gain = self.time(before, order[i]) - self.time(before, order[j]);
                    if let Some(&after) = order.get(j + 1) {
                        gain += self.time(order[j], after) - self.time(order[i], after);
                    }
                    if gain > 1e-9 {
                        order[i..=j].reverse();
                        improved = true;
                    }
                }
            }
        }
        order
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::sampling::{icosphere, spiral, stratified};

    fn limits() -> RigLimits {
        RigLimits {
            pan_rad: [-PI, PI],
            tilt_rad: [-0.2, 1.6],
            speed_rad_s: 1.0,
            acceleration_rad_s2: 2.0,
            settle_s: 0.3,
        }
    }

    fn turned() -> RigLimits {
        RigLimits { pan_rad: [-0.1, 3.5], tilt_rad: [-1.6, 1.6], ..limits() }
    }

    #[test]
    fn a_tour_shows_every_view_once_within_the_limits() {
        for limits in [limits(), turned(), RigLimits { pan_rad: [-7.0, 7.0], ..limits() }] {
            for views in [icosphere(2, 1.3).unwrap(), stratified(60, 1.3, 1).unwrap()] {
                let stops = tour(&views, &limits).unwrap();
                let mut seen: Vec<usize> = stops.iter().map(|s| s.view).collect();
                seen.sort_unstable();
                assert_eq!(seen, (0..views.len()).collect::<Vec<_>>());
                for stop in &stops {
                    assert!(limits.contains(stop.pan_rad, stop.tilt_rad));
                    let centre = Pose::from_rig(stop.pan_rad, stop.tilt_rad, 1.0).centre_m;
                    assert!(centre.distance(views[stop.view]) < 1e-9);
                }
            }
        }
    }

    #[test]
    fn a_tour_is_never_longer_than_the_given_order_and_much_shorter_than_a_random_one() {
        for limits in [limits(), turned()] {
            for count in [1, 2, 3, 40, 120] {
                for views in [spiral(count, 1.3).unwrap(), stratified(count, 1.3, 5).unwrap()] {
                    let given = tour_time_s(&in_order(&views, &limits).unwrap(), &limits);
                    let stops = tour(&views, &limits).unwrap();
                    assert!(tour_time_s(&stops, &limits) <= given + 1e-9);
                    assert_eq!(stops, tour(&views, &limits).unwrap(), "deterministic");
                }
            }
            let mut views = stratified(120, 1.3, 5).unwrap();
            // 53 is coprime to 120: a thorough shuffle.
            views = (0..120).map(|i| views[i * 53 % 120]).collect();
            let shuffled = tour_time_s(&in_order(&views, &limits).unwrap(), &limits);
            let toured = tour_time_s(&tour(&views, &limits).unwrap(), &limits);
            assert!(toured < 0.6 * shuffled, "{toured} of {shuffled}");
        }
    }

    #[test]
    fn whole_turns_are_used_where_the_rig_has_them() {
        // Three views on either side of pan = π: with a wide range the rig goes on instead of unwinding.
        let wide = RigLimits { pan_rad: [-7.0, 7.0], ..limits() };
        let views: Vec<DVec3> =
            [2.9, 3.1, 3.3].map(|pan| Pose::from_rig(pan, 0.8, 1.0).centre_m).into_iter().collect();
        let range = |limits: &RigLimits| {
            let stops = in_order(&views, limits).unwrap();
            let pans: Vec<f64> = stops.iter().map(|s| s.pan_rad).collect();
            pans.iter().copied().fold(f64::MIN, f64::max) - pans.iter().copied().fold(f64::MAX, f64::min)
        };
        assert!((range(&wide) - 0.4).abs() < 1e-9);
        assert!(range(&limits()) > 5.0);
    }

    #[test]
    fn a_view_that_cannot_be_shown_is_named() {
        let narrow = RigLimits { tilt_rad: [-0.5, 0.5], ..limits() };
        let views = [DVec3::Z, Pose::from_rig(0.3, 0.9, 1.0).centre_m];
        let error = tour(&views, &narrow).unwrap_err().to_string();
        assert!(error.contains("view 1 (pan 17.19°, tilt 51.57°)"), "{error}");
    }

    #[test]
    fn no_views_make_no_tour() {
        assert_eq!(tour(&[], &limits()).unwrap(), []);
    }
}

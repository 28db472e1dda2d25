//! What else a lobe could be: other places that explain the views as well, and how much of all that is near the one found.
//!
//! The covariance at the best place knows nothing of other basins, and little of a valley that bends. Where a lobe
//! meets few views or is seen from its flank alone, the residual is therefore followed along a ladder of shininess, from every
//! basin found (a profile of the likelihood, with the direction integrated out by Laplace's method).

use super::Lobe;
use super::refine::{Place, Search, TERMS, hold_shininess, refine};
use super::views::Views;

/// What a right answer may be off: direction, and shininess relative to the true one.
pub(super) const DIRECTION_RAD: f64 = std::f64::consts::PI / 180.0;
pub(super) const SHININESS_PART: f64 = 0.2;

/// A lobe's other views, one lobe alone.
pub(super) struct Alone<'a> {
    pub views: &'a mut Views,
    pub lobe: Lobe,
    pub linear: [[f64; TERMS]; 3],
    /// Variance of a residual whose weight is 1.
    pub variance: f64,
}

/// Beyond any fit's bound: what is sharper must show.
const SHARPEST: f64 = 4000.0;
const SEARCH: Search = Search { shininess_max: SHARPEST, shared: false, small: 0.1, covariance: false };

struct Node {
    lobe: Lobe,
    squares: f64,
    /// Logarithm of the volume of direction and shininess for which it stands.
    log_volume: f64,
    /// Standard deviation of the direction along its two turns' main axes, greatest first.
    sigma_rad: [f64; 2],
}

/// Everything that explains the views about as well.
pub(super) struct Explored {
    nodes: Vec<Node>,
    least: f64,
    variance: f64,
}

impl Explored {
    /// The probability that a lobe is right; 0 where another place explains the views clearly better.
    pub fn right_of(&self, lobe: &Lobe) -> f64 {
        let (mut right, mut all) = (0.0, 0.0);
        for node in &self.nodes {
            let weight = (node.log_volume - 0.5 * (node.squares - self.least) / self.variance).exp();
            all += weight;
            right += weight * node.near(lobe);
        }
        if all > 0.0 { right / all } else { 0.0 }
    }
}

impl Alone<'_> {
    pub fn explore(mut self) -> Explored {
        let mut basins = self.basins();
        basins.sort_by(|a, b| a.total().total_cmp(&b.total()));
        let best = basins[0].total();
        let mut nodes: Vec<Node> = Vec::new();
        for basin in &basins {
            let far = (basin.total() - best) / self.variance > 16.0;
            if !far && !nodes.iter().any(|node| same(node, basin, self.variance)) {
                self.follow(basin, best, &mut nodes);
            }
        }
        let least = nodes.iter().map(|node| node.squares).fold(best, f64::min);
        Explored { nodes, least, variance: self.variance }
    }

    /// Refined places, from starts around the brightest view and from the lobe itself.
    fn basins(&mut self) -> Vec<Place<1, 3, 8>> {
        let (peak, neighbours) = self.views.peak();
        let mut directions = vec![self.lobe.direction, peak];
        for neighbour in &neighbours {
            directions.push((peak * 2.0 + *neighbour).normalize_or(peak));
            directions.push((peak * 0.9 + *neighbour).normalize_or(peak));
        }
        let mut starts = Vec::new();
        for direction in directions {
            for factor in [0.35, 1.0, 2.8] {
                let lobe = Lobe { direction, shininess: (self.lobe.shininess * factor).clamp(1.0, SHARPEST) };
                let place = Place::<1, 3, 8>::new(self.views, [lobe], &self.linear);
                starts.push((place.total(), lobe));
            }
        }
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut basins = vec![refine::<1, 3, 8>(self.views, [self.lobe], &self.linear, &SEARCH).0];
        let mut taken: Vec<Lobe> = vec![self.lobe];
        for (_, start) in starts {
            let near = |other: &Lobe| {
                start.direction.dot(other.direction) > 0.99995
                    && (start.shininess / other.shininess).ln().abs() < 0.5
            };
            if !taken.iter().any(near) {
                taken.push(start);
                basins.push(refine::<1, 3, 8>(self.views, [start], &self.linear, &SEARCH).0);
                if basins.len() > 5 {
                    break;
                }
            }
        }
        basins
    }

    /// Follows a basin's valley up and down the ladder of shininess, while it explains the views.
    fn follow(&mut self, basin: &Place<1, 3, 8>, least: f64, nodes: &mut Vec<Node>) {
        let (hessian, _) = basin.reduced();
        let turns = hessian[1][1] * hessian[2][2] - hessian[2][1] * hessian[2][1];
        let absorbed = (hessian[1][0] * hessian[1][0] * hessian[2][2]
            - 2.0 * hessian[1][0] * hessian[2][0] * hessian[2][1]
            + hessian[2][0] * hessian[2][0] * hessian[1][1])
            / turns;
        let information = (hessian[0][0] - absorbed) / self.variance;
        let step = if information > 0.0 { (0.5 / information.sqrt()).clamp(0.02, 0.15) } else { 0.15 };
        for way in [1.0, -1.0] {
            let mut place = *basin;
            for rung in 0..120 {
                if rung == 0 && way < 0.0 {
                    continue;
                }
                let log = basin.lobes[0].shininess.ln() + way * step * f64::from(rung);
                if log < 0.0 || log > SHARPEST.ln() {
                    break;
                }
                let lobe = Lobe { direction: place.lobes[0].direction, shininess: log.exp() };
                place = hold_shininess(self.views, lobe, &place.linear);
                if (place.total() - least) / self.variance > 16.0 {
                    break;
                }
                nodes.push(Node::new(&place, self.variance, step));
            }
        }
    }
}

/// Whether the basin is on a valley that was followed already.
fn same(node: &Node, basin: &Place<1, 3, 8>, variance: f64) -> bool {
    let lobe = &basin.lobes[0];
    (lobe.shininess / node.lobe.shininess).ln().abs() < 0.1
        && lobe.direction.angle_between(node.lobe.direction) < node.sigma_rad[0].max(1e-3)
        && (basin.total() - node.squares).abs() / variance < 4.0
}

impl Node {
    fn new(place: &Place<1, 3, 8>, variance: f64, step: f64) -> Self {
        let (hessian, _) = place.reduced();
        let [a, b, c] = [hessian[1][1], hessian[2][1], hessian[2][2]].map(|value| value / variance);
        let (middle, half) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
        // A turn that the views do not see at all goes anywhere in the hemisphere.
        let sigma = |information: f64| 1.0 / information.max(1.0).sqrt();
        let sigma_rad = [sigma(middle - half), sigma(middle + half)];
        let log_volume = (sigma_rad[0] * sigma_rad[1] * step).ln();
        Self { lobe: place.lobes[0], squares: place.total(), log_volume, sigma_rad }
    }

    /// The probability that the truth, if it is at this node, is near enough to `found`.
    fn near(&self, found: &Lobe) -> f64 {
        let ratio = found.shininess / self.lobe.shininess;
        if (ratio - 1.0).abs() > SHININESS_PART {
            return 0.0;
        }
        let away = self.lobe.direction.angle_between(found.direction);
        let [wide, narrow] = self.sigma_rad;
        // The valley lies along the wide axis.
        let within = |low: f64, high: f64| normal(high) - normal(low);
        within((-DIRECTION_RAD - away) / wide, (DIRECTION_RAD - away) / wide)
            * within(-DIRECTION_RAD / narrow, DIRECTION_RAD / narrow)
    }
}

/// The normal distribution (Abramowitz and Stegun 7.1.26, to 1e-7).
pub(super) fn normal(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let p = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let tail = 0.5 * p * (-z * z).exp();
    if x > 0.0 { 1.0 - tail } else { tail }
}

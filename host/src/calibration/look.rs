//! What the squares of one view say by themselves, and whether that is what its angles say.

use glam::DVec2;

use super::adjust::{Frame, ViewData, solo};
use super::luminance::Luminance;
use super::median;
use super::rig_model::{DEVIATIONS, Deviation, RigModel};
use super::square::{Found, MeasuredSquare, Search, Unseen, measure_square};

/// A view that deviates by more than so many standard deviations of the others, and by more than these (degrees, part of the
/// distance), is not what its angles say.
const DOUBTFUL_SIGMA: f64 = 8.0;
const DOUBTFUL_RAD: f64 = 0.02;
const DOUBTFUL_SHIFT: f64 = 0.012;
/// Squares are looked for within so many times their size of where they are expected.
const REACH: f64 = 2.0;
/// The least correlation of squares that are there with the picture of one.
const LEAST_SCORE: f64 = 0.55;
/// A square that is so many times less likely than expected (by corners good to 0.2 pixels) is something else.
const WORST_MISFIT: f64 = 20.0;
/// So many squares that agree with each other are no accident, however they look.
const SQUARES_THAT_AGREE: usize = 3;
/// Fewer squares do not fix a pose that can be checked.
pub(super) const FEWEST_SQUARES: usize = 2;

/// What the squares of one view say by themselves.
pub(super) struct Look {
    pub squares: Vec<MeasuredSquare>,
    /// Their mean correlation with the picture of a square.
    pub score: f64,
    deviation: Option<Deviation>,
    hidden: usize,
    outside: usize,
}

/// Squares may be so far from where a common shift puts them (pixels of some twentieth of a square): in a view that is
/// where its angles say; and in one that is a few degrees off.
const SPREADS: [i64; 2] = [4, 12];

/// A view and where the squares should be in it.
pub(super) struct Scene<'a> {
    frame: &'a Frame<'a>,
    picture: &'a Luminance,
    view: ViewData,
    expected: Vec<Option<[DVec2; 4]>>,
    ground: Vec<Option<[DVec2; 4]>>,
    search: Search,
}

impl<'a> Scene<'a> {
    /// A view that should be at these angles.
    pub fn new(frame: &'a Frame<'a>, picture: &'a Luminance, (pan_rad, tilt_rad): (f64, f64)) -> Self {
        let view = ViewData { pan_rad, tilt_rad, ..ViewData::default() };
        let seen = RigModel::nominal(frame.distance_m).see(pan_rad, tilt_rad, &[0.0; DEVIATIONS]);
        let corners = |out_m: f64| -> Vec<_> {
            let squares = 0..frame.layout.centres_m.len();
            squares.map(|square| frame.corners(square, &seen, &frame.lens, 0.0, out_m)).collect()
        };
        let expected = corners(0.0);
        let reach_px = REACH * frame.layout.size_m / frame.distance_m * frame.lens.fx;
        let search = Search::new(picture, &expected, reach_px);
        Self { frame, picture, view, expected, ground: corners(frame.layout.ground_m), search }
    }

    /// Finds and measures the squares that agree with each other.
    pub fn look(&self) -> Look {
        let within = |spread| self.agreeing(&self.search.within(spread));
        let [near, far] = SPREADS;
        let first = within(near);
        if first.is_there() { first } else { Some(within(far)).filter(Look::is_there).unwrap_or(first) }
    }

    /// Whatever looks like a square about where each is expected, whether the others agree or not.
    pub fn alike(&self) -> ViewData {
        let found = self.search.within(SPREADS[1]);
        let squares = 0..self.expected.len();
        let alike = squares.filter(|&square| found.scores[square] >= LEAST_SCORE);
        let squares = alike.filter_map(|square| self.measure(square, found.shifts[square]).ok()).collect();
        ViewData { squares, ..self.view.clone() }
    }

    fn measure(&self, square: usize, shift: DVec2) -> Result<MeasuredSquare, Unseen> {
        let (Some(expected), Some(ground)) = (&self.expected[square], &self.ground[square]) else {
            return Err(Unseen::Outside);
        };
        let moved = |corners: &[DVec2; 4]| corners.map(|corner| corner + shift);
        measure_square(self.picture, square, &moved(expected), &moved(ground))
    }

    /// Measures the squares where they were found and keeps those that agree.
    fn agreeing(&self, found: &Found) -> Look {
        let mut view = self.view.clone();
        let mut look = Look { squares: vec![], score: 0.0, deviation: None, hidden: 0, outside: 0 };
        for (square, shift) in found.shifts.iter().enumerate() {
            match self.measure(square, *shift) {
                Ok(measured) => view.squares.push(measured),
                Err(Unseen::Outside) => look.outside += 1,
                Err(_) => look.hidden += 1,
            }
        }
        while view.squares.len() >= FEWEST_SQUARES {
            let Some((deviation, misfit)) = solo(self.frame, &view) else { break };
            let worst = (0..misfit.len()).max_by(|&a, &b| misfit[a].total_cmp(&misfit[b]));
            match worst {
                Some(worst) if misfit[worst] > WORST_MISFIT => {
                    view.squares.remove(worst);
                    look.hidden += 1;
                }
                _ => {
                    look.deviation = Some(deviation);
                    break;
                }
            }
        }
        let scores = view.squares.iter().map(|measured| found.scores[measured.square]);
        look.score = scores.sum::<f64>() / view.squares.len().max(1) as f64;
        look.squares = view.squares;
        look
    }
}

/// By how much a view may deviate: the median over the views, and limits about it.
pub(super) struct Limits {
    middle: Deviation,
    pub most: Deviation,
}

/// How much a degree of freedom may deviate whose standard deviation over the views is `sigma`.
pub(super) fn most(k: usize, sigma: f64, distance_m: f64) -> f64 {
    let least = if k < 3 { DOUBTFUL_RAD } else { DOUBTFUL_SHIFT * distance_m };
    least.max(DOUBTFUL_SIGMA * sigma)
}

pub(super) fn limits(looks: &[Look], distance_m: f64) -> Limits {
    let mut limits = Limits { middle: [0.0; DEVIATIONS], most: [0.0; DEVIATIONS] };
    for k in 0..DEVIATIONS {
        let of_views: Vec<f64> = looks.iter().filter_map(|look| Some(look.deviation?[k])).collect();
        let middle = median(&of_views);
        let spread =
            median(&of_views.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>()) / 0.6745;
        limits.middle[k] = middle;
        limits.most[k] = most(k, spread, distance_m);
    }
    limits
}

const WHAT_DEVIATES: [&str; DEVIATIONS] = [
    "its pan",
    "its tilt",
    "its turn about the third axis",
    "its place along x",
    "its place along y",
    "its distance",
];

const DEVIATES: [&str; DEVIATIONS] = [
    "differ from the others in pan",
    "differ from the others in tilt",
    "differ from the others in their turn about the third axis",
    "differ from the others in their place along x",
    "differ from the others in their place along y",
    "differ from the others in their distance",
];

impl Look {
    /// Whether the squares are there: they look so, or are too many to agree by chance. Glare spoils the look of some.
    pub fn is_there(&self) -> bool {
        self.deviation.is_some() && (self.score >= LEAST_SCORE || self.squares.len() >= SQUARES_THAT_AGREE)
    }

    pub fn is_within(&self, limits: &Limits) -> bool {
        self.is_there() && self.excess(limits).is_none()
    }

    /// In which degree of freedom squares that are there deviate too much, and by how much.
    pub fn excess(&self, limits: &Limits) -> Option<(usize, f64)> {
        let deviation = self.deviation.filter(|_| self.is_there())?;
        let k = limits.exceeded(&deviation)?;
        Some((k, deviation[k] - limits.middle[k]))
    }

    /// What is wrong with it, as a clause that other views may share.
    pub fn kind(&self, limits: &Limits) -> &'static str {
        match self.excess(limits) {
            Some((k, _)) => DEVIATES[k],
            None if self.outside > self.hidden + self.squares.len() => {
                "should show most squares outside the picture"
            }
            None if self.squares.is_empty() => "show nothing like the squares there",
            None => "show too few squares that agree with each other",
        }
    }

    pub fn complaint(&self) -> String {
        format!(
            "shows {} squares that agree where its angles put them, {} are hidden or elsewhere and {} outside the picture",
            self.squares.len(),
            self.hidden,
            self.outside
        )
    }
}

impl Limits {
    fn exceeded(&self, deviation: &Deviation) -> Option<usize> {
        (0..DEVIATIONS).find(|&k| (deviation[k] - self.middle[k]).abs() > self.most[k])
    }
}

pub(super) fn deviates(k: usize, by: f64, most: f64) -> String {
    let text = |value: f64| match k {
        0..3 => format!("{:.2} degrees", value.to_degrees()),
        _ => format!("{:.1} mm", value * 1e3),
    };
    format!(
        "differs in {} by {} from what its angles say, more than {}",
        WHAT_DEVIATES[k],
        text(by),
        text(most)
    )
}

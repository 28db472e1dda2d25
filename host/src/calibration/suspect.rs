//! Why the squares are not where the commanded angles put them: what would explain the views if it were otherwise.

use rayon::prelude::*;

use super::adjust::Frame;
use super::look::Scene;
use super::luminance::Luminance;
use super::squares::Squares;

/// A change of what was given is tried by steps of this factor, so many times up and down: squares are found a few percent from
/// where they are expected.
const FACTOR: f64 = 1.1;
const STEPS: i32 = 6;
/// An explanation holds for this part of the views that are tried.
const HOLDS: f64 = 0.7;

/// A view that is not understood.
pub(super) struct Puzzle {
    pub picture: Luminance,
    pub pan_rad: f64,
    pub tilt_rad: f64,
}

/// What may have been given wrongly.
#[derive(Clone, Copy)]
enum Slip {
    Size(f64),
    Distance(f64),
    Layout(&'static str, fn(f64, f64) -> (f64, f64)),
    Angles(&'static str, fn(f64, f64) -> (f64, f64)),
}

/// Slips of the pen; of those that explain as many views, the one whose squares look best counts.
fn slips() -> Vec<Slip> {
    let mut slips = vec![
        Slip::Angles("every pan had the other sign", |pan, tilt| (-pan, tilt)),
        Slip::Angles("every tilt had the other sign", |pan, tilt| (pan, -tilt)),
        Slip::Angles("every pan and tilt had the other sign", |pan, tilt| (-pan, -tilt)),
        Slip::Angles("pan and tilt were exchanged", |pan, tilt| (tilt, pan)),
        Slip::Angles("every tilt were 90 degrees less it", |pan, tilt| {
            (pan, std::f64::consts::FRAC_PI_2 - tilt)
        }),
        Slip::Angles("every pan were 90 degrees more", |pan, tilt| (pan + std::f64::consts::FRAC_PI_2, tilt)),
        Slip::Angles("every pan were 90 degrees less", |pan, tilt| (pan - std::f64::consts::FRAC_PI_2, tilt)),
        Slip::Layout("the squares' x had the other sign (mirrored)", |x, y| (-x, y)),
        Slip::Layout("the squares' y had the other sign (mirrored)", |x, y| (x, -y)),
        Slip::Layout("the squares' x and y were exchanged", |x, y| (y, x)),
        Slip::Layout("the squares' places were twice as far from the centre", |x, y| (2.0 * x, 2.0 * y)),
        Slip::Layout("the squares' places were half as far from the centre", |x, y| (x / 2.0, y / 2.0)),
    ];
    for step in 1..=STEPS {
        for factor in [FACTOR.powi(step), FACTOR.powi(-step)] {
            slips.extend([Slip::Size(factor), Slip::Distance(factor)]);
        }
    }
    slips
}

impl Slip {
    /// How many of the views show the squares where they should be if this were so, and how well they look.
    fn explains(self, frame: &Frame, puzzles: &[Puzzle]) -> (usize, f64) {
        let (mut layout, mut distance_m) = (frame.layout.clone(), frame.distance_m);
        match self {
            Self::Size(factor) => {
                layout.size_m *= factor;
                layout.ground_m *= factor;
            }
            Self::Distance(factor) => distance_m *= factor,
            Self::Layout(_, moved) => {
                layout
                    .centres_m
                    .iter_mut()
                    .for_each(|centre| (centre.x, centre.y) = moved(centre.x, centre.y));
            }
            Self::Angles(..) => {}
        }
        let frame = Frame { layout: &layout, distance_m, ..frame.clone() };
        let looks = puzzles.par_iter().filter_map(|puzzle| {
            let angles = (puzzle.pan_rad, puzzle.tilt_rad);
            let angles = if let Self::Angles(_, turned) = self { turned(angles.0, angles.1) } else { angles };
            let look = Scene::new(&frame, &puzzle.picture, angles).look();
            // A pair of squares is soon found.
            let whole = look.squares.len() >= layout.centres_m.len().min(3);
            (look.is_there() && whole).then_some(look.score)
        });
        looks.map(|score| (1, score)).reduce(|| (0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1))
    }

    fn says(self, layout: &Squares, distance_m: f64) -> (String, &'static str) {
        match self {
            Self::Size(factor) => (
                format!(
                    "they look as squares of about {:.0} mm do, not {:.1} mm",
                    1e3 * factor * layout.size_m,
                    1e3 * layout.size_m
                ),
                "measure a square's side and correct size in the squares file",
            ),
            Self::Distance(factor) => (
                format!(
                    "they would be if the camera were about {:.0} mm away, not {:.0} mm",
                    1e3 * factor * distance_m,
                    1e3 * distance_m
                ),
                "measure the distance and import again, or correct the lens (a focal length that is wrong by as much looks the same)",
            ),
            Self::Layout(what, _) => (format!("they would be if {what}"), "correct the squares file"),
            Self::Angles(what, _) => {
                (format!("they would be if {what}"), "correct the table of angles and import again")
            }
        }
    }
}

/// What was given wrongly in all likelihood, and the remedy; `None` where nothing of the kind explains the views.
pub(super) fn suspect(frame: &Frame, puzzles: &[Puzzle]) -> Option<(String, &'static str)> {
    let needed = ((HOLDS * puzzles.len() as f64).ceil() as usize).max(2);
    let mut best: Option<(Slip, (usize, f64))> = None;
    // The first views rule most of them out.
    let first = &puzzles[..puzzles.len().min(2)];
    for slip in slips() {
        if slip.explains(frame, first).0 == 0 {
            continue;
        }
        let explained = slip.explains(frame, puzzles);
        if explained.0 >= needed && best.is_none_or(|(_, other)| explained > other) {
            best = Some((slip, explained));
        }
    }
    best.map(|(slip, _)| slip.says(frame.layout, frame.distance_m))
}

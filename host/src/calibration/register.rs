//! From a session's radiance and commanded angles to the pose of every view.

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec2;
use nalgebra::SMatrix;
use rayon::prelude::*;

use super::adjust::{Adjusted, Frame, LENS, ViewData, adjust, solo};
use super::lens::LensCovariance;
use super::luminance::Luminance;
use super::registration::{DeviationSigma, DroppedView, RegisteredView, Registration, made_from};
use super::rig_model::{DEVIATIONS, Deviation, RigModel};
use super::square::{Found, Search, Unseen, measure_square};
use super::squares::Squares;
use crate::geometry::Lens;
use crate::progress::Progress;
use crate::radiance::RadianceImage;
use crate::session::Session;
use crate::{Error, Result};

/// What `register` is given beside the session.
#[derive(Debug, Clone, Default)]
pub struct RegisterOptions {
    /// The squares around the surface, if there are any.
    pub squares: Option<Squares>,
    /// The lens, in place of the session's; and the covariance of fx fy cx cy k1 k2 p1 p2 k3 if it was calibrated.
    pub lens: Option<(Lens, Option<LensCovariance>)>,
}

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
const FEWEST_SQUARES: usize = 2;

/// Registers the session's finished views: squares found in the radiance, one adjustment over all views. Without
/// squares a view is where its commanded angles put it, as sure as such angles usually are.
///
/// # Errors
/// [`Error::Input`] where the session lacks radiance, commanded angles, the camera's distance or a lens, or has several
/// lenses; [`Error::Request`] where squares are given and hardly any view shows them; [`Error::Io`];
/// [`Error::Interrupted`].
pub fn register(
    session: &Session,
    options: &RegisterOptions,
    progress: &dyn Progress,
) -> Result<Registration> {
    let made_from = made_from(session)?;
    let views = session.done_views();
    let angles = commanded(session, &views)?;
    let none = Squares { size_m: 0.01, ground_m: 0.0, centres_m: vec![] };
    let layout = options.squares.as_ref().unwrap_or(&none);
    let frame = frame(session, options, layout, &views)?;
    let name = |index: usize| session.manifest.views[views[index]].name.clone();

    let done = AtomicUsize::new(0);
    let mut data: Vec<ViewData> = angles.iter().map(|&angles| at(angles)).collect();
    let mut dropped: Vec<Option<String>> = vec![None; views.len()];
    if options.squares.is_some() {
        let looks: Vec<Look> = (0..views.len())
            .into_par_iter()
            .map(|index| {
                let picture = luminance(session, views[index], &frame.lens)?;
                let look = look(&frame, &picture, angles[index]);
                progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, views.len())?;
                Ok(look)
            })
            .collect::<Result<_>>()?;
        let limits = limits(&looks, frame.distance_m);
        let doubtful: Vec<usize> = (0..views.len()).filter(|&i| !looks[i].is_within(&limits)).collect();
        if 2 * doubtful.len() > views.len() {
            return Err(Error::request(
                format!(
                    "in {} of {} views the squares are not where the commanded angles put them",
                    doubtful.len(),
                    views.len()
                ),
                "check the squares file, the lens, the distance and the table of angles",
            ));
        }
        let others = |&index: &usize| -> Result<Vec<usize>> {
            let picture = luminance(session, views[index], &frame.lens)?;
            Ok(others(&frame, &picture, &angles, index, &limits))
        };
        let shown: Vec<Vec<usize>> = doubtful.par_iter().map(others).collect::<Result<_>>()?;
        for (d, &index) in doubtful.iter().enumerate() {
            let mut others = shown[d].iter();
            let is_swapped = |&&other: &&usize| {
                doubtful.iter().position(|&o| o == other).is_some_and(|o| shown[o].contains(&index))
            };
            dropped[index] = Some(
                match (others.clone().find(is_swapped), looks[index].excess(&limits), others.next()) {
                    (Some(&other), ..) => format!(
                        "shows the surface as the angles of {} would, which shows it as those of {} would: the two are swapped; correct the table and import again",
                        name(other),
                        name(index)
                    ),
                    (None, Some((k, off)), _) => deviates(k, off, limits.most[k]),
                    (None, None, Some(&other)) => {
                        format!("shows the surface as the angles of {} would, not its own", name(other))
                    }
                    (None, None, None) => looks[index].complaint(),
                },
            );
        }
        for (data, look) in data.iter_mut().zip(looks) {
            data.squares = look.squares;
        }
    }
    let adjusted = settle(&frame, &mut data, &mut dropped)?;
    Ok(report(&frame, &data, &adjusted, &dropped, made_from, &name))
}

/// The commanded angles of the views, radians.
fn commanded(session: &Session, views: &[usize]) -> Result<Vec<(f64, f64)>> {
    let angles = |&view: &usize| {
        let record = &session.manifest.views[view];
        match (record.pan_deg, record.tilt_deg) {
            (Some(pan), Some(tilt)) => Ok((pan.to_radians(), tilt.to_radians())),
            _ => Err(Error::input(
                session.folder(),
                format!("view {} has no commanded pan and tilt to start from", record.name),
                "import it with --csv, or keep the poses that it has",
            )),
        }
    };
    views.iter().map(angles).collect()
}

fn at((pan_rad, tilt_rad): (f64, f64)) -> ViewData {
    ViewData { pan_rad, tilt_rad, ..ViewData::default() }
}

fn frame<'a>(
    session: &Session,
    options: &RegisterOptions,
    layout: &'a Squares,
    views: &[usize],
) -> Result<Frame<'a>> {
    let Some(&first) = views.first() else {
        return Err(Error::input(
            session.folder(),
            "has no finished view",
            "go on with `rigel capture --resume`",
        ));
    };
    let manifest = &session.manifest;
    let Some(distance_m) = manifest.distance_m else {
        return Err(Error::input(
            session.folder(),
            "does not know the camera's distance",
            "import with --distance 900mm",
        ));
    };
    if let Some(other) = views.iter().find(|&&view| manifest.views[view].lens != manifest.views[first].lens) {
        return Err(Error::input(
            session.folder(),
            format!("has views of several lenses ({} is the first)", manifest.views[*other].name),
            "register the views of each lens in a session of their own",
        ));
    }
    let (lens, covariance) = match &options.lens {
        Some((lens, covariance)) => (*lens, covariance.as_ref()),
        None => (*manifest.lens(first)?, None),
    };
    let lens_covariance = covariance.map_or_else(|| assumed(&lens), |c| SMatrix::from_fn(|i, j| c[i][j]));
    Ok(Frame { layout, lens, lens_covariance, distance_m })
}

/// How sure a lens is that somebody gave without saying: about as one calibrated with a dozen boards.
pub(super) fn assumed(lens: &Lens) -> SMatrix<f64, LENS, LENS> {
    let size = f64::from(lens.width.max(lens.height));
    let sigma = [0.003 * lens.fx, 0.003 * lens.fy, 0.008 * size, 0.008 * size, 0.03, 0.3, 1e-3, 1e-3, 0.0];
    SMatrix::from_diagonal(&nalgebra::SVector::from(sigma.map(|s| s * s)))
}

fn luminance(session: &Session, view: usize, lens: &Lens) -> Result<Luminance> {
    let path = session.radiance_path(view);
    let image = RadianceImage::read_exr(&path)?;
    if (image.width, image.height) != (lens.width, lens.height) {
        let what = format!(
            "is {}x{} pixels but the lens is for {}x{}",
            image.width, image.height, lens.width, lens.height
        );
        return Err(Error::input(&path, what, "give the lens of these photographs with --lens"));
    }
    Ok(Luminance::of(&image))
}

/// What the squares of one view say by themselves.
struct Look {
    squares: Vec<super::square::MeasuredSquare>,
    /// Their mean correlation with the picture of a square.
    score: f64,
    deviation: Option<Deviation>,
    hidden: usize,
    outside: usize,
}

/// Squares may be so far from where a common shift puts them (pixels of some twentieth of a square): in a view that is
/// where its angles say; and in one that is a few degrees off.
const SPREADS: [i64; 2] = [4, 12];

/// Finds and measures the squares of a view that should be at these angles.
fn look(frame: &Frame, picture: &Luminance, angles: (f64, f64)) -> Look {
    let view = at(angles);
    let seen = RigModel::nominal(frame.distance_m).see(view.pan_rad, view.tilt_rad, &[0.0; DEVIATIONS]);
    let corners = |square: usize, out_m: f64| frame.corners(square, &seen, &frame.lens, 0.0, out_m);
    let layout = frame.layout;
    let squares = 0..layout.centres_m.len();
    let expected: Vec<_> = squares.clone().map(|square| corners(square, 0.0)).collect();
    let ground: Vec<_> = squares.map(|square| corners(square, layout.ground_m)).collect();
    let reach_px = REACH * layout.size_m / frame.distance_m * frame.lens.fx;
    let search = Search::new(picture, &expected, reach_px);
    let within = |spread| agreeing(frame, picture, view.clone(), &expected, &ground, &search.within(spread));
    let [near, far] = SPREADS;
    let first = within(near);
    if first.is_there() { first } else { Some(within(far)).filter(Look::is_there).unwrap_or(first) }
}

/// Measures the squares where they were found and keeps those that agree.
fn agreeing(
    frame: &Frame,
    picture: &Luminance,
    mut view: ViewData,
    expected: &[Option<[DVec2; 4]>],
    ground: &[Option<[DVec2; 4]>],
    found: &Found,
) -> Look {
    let mut look = Look { squares: vec![], score: 0.0, deviation: None, hidden: 0, outside: 0 };
    for (square, shift) in found.shifts.iter().enumerate() {
        let (Some(expected), Some(ground)) = (&expected[square], &ground[square]) else {
            look.outside += 1;
            continue;
        };
        let moved = |corners: &[DVec2; 4]| corners.map(|corner| corner + *shift);
        match measure_square(picture, square, &moved(expected), &moved(ground)) {
            Ok(measured) => view.squares.push(measured),
            Err(Unseen::Outside) => look.outside += 1,
            Err(_) => look.hidden += 1,
        }
    }
    while view.squares.len() >= FEWEST_SQUARES {
        let Some((deviation, misfit)) = solo(frame, &view) else { break };
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

/// By how much a view may deviate: the median over the views, and limits about it.
struct Limits {
    middle: Deviation,
    most: Deviation,
}

fn limits(looks: &[Look], distance_m: f64) -> Limits {
    let mut limits = Limits { middle: [0.0; DEVIATIONS], most: [0.0; DEVIATIONS] };
    for k in 0..DEVIATIONS {
        let of_views: Vec<f64> = looks.iter().filter_map(|look| Some(look.deviation?[k])).collect();
        let middle = median(of_views.clone());
        let spread = median(of_views.iter().map(|value| (value - middle).abs()).collect()) / 0.6745;
        let least = if k < 3 { DOUBTFUL_RAD } else { DOUBTFUL_SHIFT * distance_m };
        limits.middle[k] = middle;
        limits.most[k] = least.max(DOUBTFUL_SIGMA * spread);
    }
    limits
}

/// 0 of none.
fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

const WHAT_DEVIATES: [&str; DEVIATIONS] = [
    "its pan",
    "its tilt",
    "its turn about the third axis",
    "its place along x",
    "its place along y",
    "its distance",
];

impl Look {
    /// Whether the squares are there: they look so, or are too many to agree by chance. Glare spoils the look of some.
    fn is_there(&self) -> bool {
        self.deviation.is_some() && (self.score >= LEAST_SCORE || self.squares.len() >= SQUARES_THAT_AGREE)
    }

    fn is_within(&self, limits: &Limits) -> bool {
        self.is_there() && self.excess(limits).is_none()
    }

    /// In which degree of freedom squares that are there deviate too much, and by how much.
    fn excess(&self, limits: &Limits) -> Option<(usize, f64)> {
        let deviation = self.deviation.filter(|_| self.is_there())?;
        let k = limits.exceeded(&deviation)?;
        Some((k, deviation[k] - limits.middle[k]))
    }

    fn complaint(&self) -> String {
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

fn deviates(k: usize, by: f64, most: f64) -> String {
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

/// Which other views' angles explain what a view shows, the best first. Squares that lie symmetrically are explained by
/// two.
fn others(
    frame: &Frame,
    picture: &Luminance,
    angles: &[(f64, f64)],
    index: usize,
    limits: &Limits,
) -> Vec<usize> {
    let candidates = (0..angles.len()).filter(|&other| angles[other] != angles[index]);
    let mut fits: Vec<(usize, f64)> = candidates
        .filter_map(|other| {
            let look = look(frame, picture, angles[other]);
            let rank = look.squares.len() as f64 + look.score;
            look.is_within(limits).then_some((other, rank))
        })
        .collect();
    fits.sort_by(|a, b| b.1.total_cmp(&a.1));
    fits.into_iter().map(|(other, _)| other).collect()
}

/// Adjusts the views that are not dropped; drops those that the adjustment shows to be doubtful, and adjusts again.
pub(super) fn settle(
    frame: &Frame,
    data: &mut [ViewData],
    dropped: &mut [Option<String>],
) -> Result<Adjusted> {
    loop {
        let kept: Vec<usize> = (0..data.len()).filter(|&i| dropped[i].is_none()).collect();
        let views: Vec<ViewData> = kept.iter().map(|&i| data[i].clone()).collect();
        let adjusted = adjust(frame, &views).ok_or_else(|| {
            Error::request(
                "the poses cannot be computed from these squares",
                "check the squares file, the lens, the distance and the table of angles",
            )
        })?;
        let mut again = false;
        for (deviation, &index) in adjusted.deviations.iter().zip(&kept) {
            for (k, (&off, sigma)) in deviation.iter().zip(&adjusted.sigma).enumerate() {
                let least = if k < 3 { DOUBTFUL_RAD } else { DOUBTFUL_SHIFT * frame.distance_m };
                let most = least.max(DOUBTFUL_SIGMA * sigma);
                if off.abs() > most {
                    dropped[index] = Some(deviates(k, off, most));
                    again = true;
                    break;
                }
            }
        }
        if !again {
            return Ok(adjusted);
        }
    }
}

pub(super) fn report(
    frame: &Frame,
    data: &[ViewData],
    adjusted: &Adjusted,
    dropped: &[Option<String>],
    made_from: String,
    name: &dyn Fn(usize) -> String,
) -> Registration {
    let kept = (0..data.len()).filter(|&i| dropped[i].is_none());
    let views = kept.enumerate().map(|(index, view)| {
        let [covariance, covariance_given_lens] = adjusted.covariance(frame, index, &data[view]);
        RegisteredView {
            name: name(view),
            corners: 4 * data[view].squares.len(),
            rms_px: adjusted.rms_px(frame, index, &data[view]),
            pose: adjusted.seen(frame, index, &data[view]).pose(),
            covariance,
            covariance_given_lens,
        }
    });
    let [pan_rad, tilt_rad, third_rad, x, y, z] = adjusted.sigma;
    let reasons = dropped.iter().enumerate();
    Registration {
        format: Registration::FORMAT,
        made_from,
        noise: adjusted.noise,
        lens: frame.lens(&adjusted.shared),
        rig: frame.rig(&adjusted.shared),
        deviations: DeviationSigma { pan_rad, tilt_rad, third_rad, shift_m: [x, y, z] },
        views: views.collect(),
        dropped: reasons
            .filter_map(|(view, reason)| Some(DroppedView { name: name(view), reason: reason.clone()? }))
            .collect(),
    }
}

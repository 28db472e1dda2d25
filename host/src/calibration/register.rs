//! From a session's radiance and commanded angles to the pose of every view.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::SMatrix;
use rayon::prelude::*;

use super::adjust::{Adjusted, Frame, LENS, ROUNDS, ViewData, adjust, adjust_from};
use super::lens::LensCovariance;
use super::look::{Limits, Look, Scene, deviates, limits, most};
use super::luminance::Luminance;
use super::misplaced::{Misplaced, misplaced};
use super::refine::{Refined, refine};
use super::registration::{DeviationSigma, DroppedView, RegisteredView, Registration, made_from};
use super::squares::Squares;
use super::suspect::{Puzzle, suspect};
use super::texture::{Plate, Texture};
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

/// What any of these is wrong does to the squares.
const CHECK_ALL: &str = "check the squares file, the lens, the distance and the table of angles";
/// So many views, spread over all, are asked whether a square is elsewhere; so many what else may be wrong.
const WITNESSES: usize = 25;
const PUZZLES: usize = 8;
/// A square that is elsewhere by this part of its side and more spoils every pose; by less it is worth a word.
const SPOILS: f64 = 0.1;

/// Views of a rig that holds its parts deviate by less (standard deviation) from what it was told, radians and part of the distance.
const WILD_RAD: f64 = 0.026;
const WILD_SHIFT: f64 = 0.006;

/// Registers the session's finished views: squares found in the radiance, one adjustment over all views, refined by the
/// surface's texture where the session says how large the surface is and squares that are left out are foretold better with it.
/// Without squares the texture alone aligns the views; one that it does not place is where its commanded angles put it, as sure
/// as such angles usually are.
///
/// # Errors
/// [`Error::Input`] where the session lacks radiance, commanded angles, the camera's distance or a lens, or has several
/// lenses; [`Error::Request`] where squares are given and hardly any view shows them where they should be, or one of them is
/// not where the file has it; [`Error::Io`]; [`Error::Interrupted`].
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
    let (mut frame, is_assumed) = frame(session, options, layout, &views)?;
    let texture =
        session.manifest.surface.map(|surface| Texture::new(surface, &frame.lens, frame.distance_m));
    let plate = |picture: &Luminance, index: usize| {
        texture.map(|texture| texture.plate(picture, &frame.lens, frame.commanded(angles[index])))
    };
    let name = |index: usize| session.manifest.views[views[index]].name.clone();

    let done = AtomicUsize::new(0);
    let mut data: Vec<ViewData> = angles.iter().map(|&angles| at(angles)).collect();
    let mut dropped: Vec<Option<String>> = vec![None; views.len()];
    let mut notes = vec![];
    if is_assumed {
        notes.push(
            "nobody has said how sure the lens is: it is taken to be as sure as one from a dozen boards; calibrate it with `rigel calibrate`, or give that file with --lens"
                .into(),
        );
    }
    let mut hidden = vec![];
    let plates: Vec<Option<Plate>>;
    if options.squares.is_some() {
        notes.extend(layout.weakness()?);
        let witness = views.len().div_ceil(WITNESSES);
        let looks: Vec<(Look, Option<ViewData>, Option<Plate>)> = (0..views.len())
            .into_par_iter()
            .map(|index| {
                let picture = luminance(session, views[index], &frame.lens)?;
                let scene = Scene::new(&frame, &picture, angles[index]);
                let looks = (
                    scene.look(),
                    index.is_multiple_of(witness).then(|| scene.alike()),
                    plate(&picture, index),
                );
                progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, views.len())?;
                Ok(looks)
            })
            .collect::<Result<_>>()?;
        let (mut found, mut witnesses, mut shown) = (vec![], vec![], vec![]);
        for (look, witness, plate) in looks {
            found.push(look);
            witnesses.extend(witness);
            shown.push(plate);
        }
        let looks = found;
        plates = shown;
        if let Some(found) = misplaced(&frame, &witnesses) {
            notes.push(told(layout, found)?);
        }
        let limits = limits(&looks, frame.distance_m);
        let doubtful: Vec<usize> = (0..views.len()).filter(|&i| !looks[i].is_within(&limits)).collect();
        if 2 * doubtful.len() > views.len() {
            let some = doubtful.iter().step_by(doubtful.len().div_ceil(PUZZLES));
            let puzzle = |&index: &usize| {
                progress.step(views.len(), views.len())?;
                let (pan_rad, tilt_rad) = angles[index];
                Ok(Puzzle { picture: luminance(session, views[index], &frame.lens)?, pan_rad, tilt_rad })
            };
            let puzzles: Vec<Puzzle> = some.map(puzzle).collect::<Result<_>>()?;
            let (why, remedy) = suspect(&frame, &puzzles).unwrap_or_else(|| {
                let usual = usual(doubtful.iter().map(|&index| looks[index].kind(&limits)));
                (format!("most of them {usual}"), CHECK_ALL)
            });
            let what = format!(
                "in {} of {} views the squares are not where the commanded angles put them: {why}",
                doubtful.len(),
                views.len()
            );
            return Err(Error::request(what, remedy));
        }
        let others = |&index: &usize| -> Result<Vec<usize>> {
            let picture = luminance(session, views[index], &frame.lens)?;
            others(&frame, &picture, &angles, index, &limits, &|| progress.step(views.len(), views.len()))
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
                    (None, None, None) => {
                        hidden.push(index);
                        looks[index].complaint()
                    }
                },
            );
        }
        for (data, look) in data.iter_mut().zip(looks) {
            data.squares = look.squares;
        }
        for &index in &hidden {
            // What little looks like squares there is none that could be trusted.
            data[index].squares.clear();
        }
    } else if texture.is_some() {
        plates = (0..views.len())
            .into_par_iter()
            .map(|index| {
                let picture = luminance(session, views[index], &frame.lens)?;
                progress.step(done.fetch_add(1, Ordering::Relaxed) + 1, views.len())?;
                Ok(plate(&picture, index))
            })
            .collect::<Result<_>>()?;
    } else {
        plates = vec![];
    }
    let mut adjusted = settle(&frame, &data, &mut dropped, None)?;
    if options.squares.is_some() {
        refuse_wild(&adjusted, frame.distance_m)?;
    }
    let plates: Option<Vec<Plate>> = plates.into_iter().collect();
    match (texture, plates) {
        (Some(texture), Some(plates)) => {
            let shown = (&plates[..], &hidden[..]);
            let Refined { adjusted: refined, notes: more } =
                refine(&texture, &mut frame, &mut data, &mut dropped, shown, adjusted, &name)?;
            adjusted = refined;
            notes.extend(more);
        }
        _ if options.squares.is_none() => notes.push(
            "nobody has said how large the surface is: with --surface at the import its texture may align the views".into(),
        ),
        _ => {}
    }
    let mut registration = report(&frame, &data, &adjusted, &dropped, made_from, &name);
    notes.append(&mut registration.notes);
    Ok(Registration { notes, ..registration })
}

/// Refuses poses whose deviations are those of no rig: three squares always fit some pose, wherever the file has them.
fn refuse_wild(adjusted: &Adjusted, distance_m: f64) -> Result<()> {
    let sigma = &adjusted.sigma;
    let shift_m = sigma[3..].iter().copied().fold(0.0, f64::max);
    let turn_rad = sigma[..3].iter().copied().fold(0.0, f64::max);
    if turn_rad < WILD_RAD && shift_m < WILD_SHIFT * distance_m {
        return Ok(());
    }
    let what = format!(
        "by their squares the views deviate from what their angles say by {:.1} degrees and {:.1} mm (standard deviations), more than a rig does",
        turn_rad.to_degrees(),
        1e3 * shift_m
    );
    Err(Error::request(what, CHECK_ALL))
}

/// What comes most often, and how often.
fn usual<'a>(kinds: impl Iterator<Item = &'a str>) -> String {
    let mut counts = BTreeMap::<&str, usize>::new();
    kinds.for_each(|kind| *counts.entry(kind).or_default() += 1);
    let most = counts.into_iter().max_by_key(|(_, count)| *count);
    most.map_or_else(String::new, |(kind, count)| format!("({count}) {kind}"))
}

/// What is to be said of a square that is elsewhere.
///
/// # Errors
/// [`Error::Request`] where it is so far off that no pose is what it seems.
fn told(layout: &Squares, Misplaced { square, by_m, is_certain }: Misplaced) -> Result<String> {
    let at = layout.centres_m[square];
    let what = format!(
        "square {} of the squares file (at {:.1}, {:.1} mm) seems {:.1} mm from where the file has it: all views together have it at {:.1}, {:.1} mm",
        square + 1,
        1e3 * at.x,
        1e3 * at.y,
        1e3 * by_m.length(),
        1e3 * (at.x + by_m.x),
        1e3 * (at.y + by_m.y)
    );
    let remedy = match is_certain {
        true => "measure it again",
        false => "measure it again, and the others, which would explain the views nearly as well",
    };
    match by_m.length() > SPOILS * layout.size_m {
        true => Err(Error::request(what, remedy)),
        false => Ok(format!("{what}; {remedy}")),
    }
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

/// What the views share, and whether nobody has said how sure the lens is.
fn frame<'a>(
    session: &Session,
    options: &RegisterOptions,
    layout: &'a Squares,
    views: &[usize],
) -> Result<(Frame<'a>, bool)> {
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
        None => (*manifest.lens(first)?, manifest.lens_covariance.as_ref()),
    };
    if options.squares.is_none() {
        // Where squares are looked for every view's size is compared with the lens's; here one stands for all.
        luminance(session, first, &lens)?;
    }
    let lens_covariance = covariance.map_or_else(|| assumed(&lens), |c| SMatrix::from_fn(|i, j| c[i][j]));
    Ok((
        Frame { layout, lens, lens_covariance, distance_m, points_m: vec![], is_rig_s: false },
        covariance.is_none(),
    ))
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

/// Which other views' angles explain what a view shows, the best first. Squares that lie symmetrically are explained by
/// two.
fn others(
    frame: &Frame,
    picture: &Luminance,
    angles: &[(f64, f64)],
    index: usize,
    limits: &Limits,
    interrupted: &dyn Fn() -> Result<()>,
) -> Result<Vec<usize>> {
    let mut fits: Vec<(usize, f64)> = vec![];
    for other in (0..angles.len()).filter(|&other| angles[other] != angles[index]) {
        interrupted()?;
        let look = Scene::new(frame, picture, angles[other]).look();
        if look.is_within(limits) {
            fits.push((other, look.squares.len() as f64 + look.score));
        }
    }
    fits.sort_by(|a, b| b.1.total_cmp(&a.1));
    Ok(fits.into_iter().map(|(other, _)| other).collect())
}

/// Adjusts the views that are not dropped, from what is known of them already if it is of just these; drops those that the
/// adjustment shows to be doubtful, and adjusts again.
pub(super) fn settle(
    frame: &Frame,
    data: &[ViewData],
    dropped: &mut [Option<String>],
    mut start: Option<Adjusted>,
) -> Result<Adjusted> {
    loop {
        let kept: Vec<usize> = (0..data.len()).filter(|&i| dropped[i].is_none()).collect();
        let views: Vec<ViewData> = kept.iter().map(|&i| data[i].clone()).collect();
        let adjusted = match start.take().filter(|start| start.deviations.len() == views.len()) {
            Some(start) => adjust_from(frame, &views, start, ROUNDS),
            None => adjust(frame, &views),
        };
        let adjusted = adjusted
            .ok_or_else(|| Error::request("the poses cannot be computed from these squares", CHECK_ALL))?;
        let mut again = false;
        for (deviation, &index) in adjusted.deviations.iter().zip(&kept) {
            for (k, (&off, sigma)) in deviation.iter().zip(&adjusted.sigma).enumerate() {
                let most = most(k, *sigma, frame.distance_m);
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
        let left = dropped.iter().filter(|reason| reason.is_none()).count();
        if 2 * left < data.len() {
            let reasons = dropped.iter().flatten().map(String::as_str);
            let what = format!(
                "only {left} of {} views have a pose that is what their angles say; one of the others {}",
                data.len(),
                reasons.clone().next_back().unwrap_or_default()
            );
            return Err(Error::request(what, CHECK_ALL));
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
            patches: data[view].points.len(),
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
        notes: match adjusted.settled {
            true => vec![],
            false => vec![
                "the adjustment had not come to rest when it was stopped: poses and their doubts are rough; check the squares file, or photograph more views"
                    .into(),
            ],
        },
        dropped: reasons
            .filter_map(|(view, reason)| Some(DroppedView { name: name(view), reason: reason.clone()? }))
            .collect(),
    }
}

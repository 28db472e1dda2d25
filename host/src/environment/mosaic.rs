//! The whole road: photographs with orientations to a map.

use std::path::PathBuf;

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::align::{Aligned, Prior, align, between};
use super::features::{Corners, Gray};
use super::gain::{Blocks, Photometry, shade_r2, solve};
use super::map::{EnvironmentMap, Unit};
use super::shots::Shots;
use super::tracked::{Known, Pair, Tracked, TrackerFit};
use super::{Filter, MergeOptions, Noise, Plate, Sphere, merge};
use crate::geometry::{LatLong, Lens};
use crate::picture::Picture;
use crate::progress::Progress;
use crate::radiance::{NoiseModel, Response};
use crate::{Error, Result};

/// How the map is made.
#[derive(Debug, Clone)]
pub struct Options {
    /// The map's size.
    pub size: LatLong,
    /// The lens; else the one of the shots' file.
    pub lens: Option<Lens>,
    /// The horizontal field of view, radians, where there is no lens.
    pub field_of_view_rad: Option<f64>,
    /// How sure the orientations are where their file does not say, standard deviation about each axis, radians.
    pub sigma_rad: f64,
    /// Whether the photographs refine orientations and focal length.
    pub refine: bool,
    /// What levels are worth: a table; `None` for sRGB, which stated exposures that differ by a factor of two then mend.
    pub response: Option<PathBuf>,
    /// Levels are proportional to exposure.
    pub linear: bool,
    /// What is known of the camera's curve beside sRGB, as a map's [`EnvironmentMap::curve`]; empty where the exposures are to tell.
    pub curve: Vec<f64>,
    /// How plates are merged.
    pub merge: MergeOptions,
    /// Whether what was never seen is filled from what is around.
    pub fill: bool,
}

impl Options {
    /// What suits photographs from the hand, for a map of this size: orientations good to two degrees, refined; levels as sRGB.
    pub fn new(size: LatLong) -> Self {
        Self {
            size,
            lens: None,
            field_of_view_rad: None,
            sigma_rad: 2f64.to_radians(),
            refine: true,
            response: None,
            linear: false,
            curve: vec![],
            merge: MergeOptions { feather: 4, disagreement: Some(0.1) },
            fill: false,
        }
    }
}

/// A photograph as it was found to be.
#[derive(Debug, Clone, PartialEq)]
pub struct Placed {
    /// Its file's name.
    pub name: String,
    /// Camera frame to the world.
    pub world_from_camera: DQuat,
    /// How sure that is, about each axis, radians.
    pub sigma_rad: f64,
    /// How many of its corners were found in others.
    pub matched: usize,
    /// Exposure over radiance, red, green, blue, relative to the geometric mean of all.
    pub gain: [f64; 3],
    /// The gain's relative standard deviation (green).
    pub gain_sigma: f64,
    /// What the tracker says by itself, camera frame to the world, once its delay, mount and drift are known, and how sure that is about each
    /// axis, radians; `None` where there is none.
    pub tracked: Option<(DQuat, f64)>,
}

/// A map and how it came about.
pub struct Mosaic {
    /// The map.
    pub map: EnvironmentMap,
    /// One for each photograph.
    pub placed: Vec<Placed>,
    /// The lens as it was refined.
    pub lens: Lens,
    /// Median distance of matched corners, radians.
    pub residual_rad: f64,
    /// What the photographs told of the tracker, where there is one.
    pub tracker: Option<TrackerFit>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// Blocks of pixels across a photograph for the gains; pixels across for corners.
const BLOCKS: u32 = 120;
const GRAY: u32 = 1000;
/// How little a pixel counts whose radiance is a lower bound, beside others of its photograph that were measured.
const BOUND: f32 = 1e-4;
/// Photographs with so many corners are detailed: others that point the same way, to within this part of their width, must show some.
pub(super) const DETAILED: usize = 60;
const NEAR: f64 = 0.7;
/// A gain's own standard deviation counts up to this, relative: without stated exposures most of it is what all photographs share.
const GAIN_SIGMA: f64 = 0.02;

/// How sure a calibrated focal length is, relative.
const CALIBRATED_SIGMA: f64 = 0.005;

/// Makes a map of photographs. Where exposures are stated, radiance 1 is what saturates a photograph whose exposure is 1 (a second, where the
/// file says neither sensitivity nor f-number); else its unit is that of the mean photograph.
///
/// # Errors
/// [`Error::Request`] or [`Error::Input`], naming the photograph: fewer than two, none overlaps another, sizes that differ, a lens for
/// another size, no lens at all; [`Error::Interrupted`].
pub fn mosaic(shots: &Shots, options: &Options, progress: &dyn Progress) -> Result<Mosaic> {
    let all = &shots.shots;
    if all.len() < 2 {
        return Err(Error::request(
            format!("a map of {} photograph", all.len()),
            "give at least two photographs that overlap",
        ));
    }
    if let Some(tracker) = shots.tracker.as_ref().filter(|tracker| tracker.times_s.len() != all.len()) {
        let what = format!("{} photographs and the times of {}", all.len(), tracker.times_s.len());
        return Err(Error::request(what, "give a tracked photograph its time"));
    }
    let steps = 4 * all.len();
    let counted = std::sync::atomic::AtomicUsize::new(0);
    let pictures: Vec<Picture> = all
        .par_iter()
        .map(|shot| {
            let picture = Picture::read(&shot.path)?;
            progress.step(counted.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, steps)?;
            Ok(picture)
        })
        .collect::<Result<_>>()?;
    let first = &pictures[0];
    for picture in &pictures {
        if (picture.width, picture.height, picture.white) != (first.width, first.height, first.white) {
            return Err(Error::input(
                &picture.path,
                format!("is {}x{} pixels to level {}", picture.width, picture.height, picture.white),
                format!(
                    "give photographs of one size and depth, as {} has: {}x{}",
                    all[0].name(),
                    first.width,
                    first.height
                ),
            ));
        }
    }
    let (lens, calibrated) = lens_of(shots.lens, options, first)?;
    let mut notes = vec![];
    if let (Some(angle), Some(own), None) = (options.field_of_view_rad, shots.lens, options.lens) {
        let across = 2.0 * (f64::from(own.width) / 2.0 / own.fx).atan();
        notes.push(format!(
            "the field of view given, {:.1} degrees, stands for the lens of the table, which sees {:.1}",
            angle.to_degrees(),
            across.to_degrees()
        ));
    }
    let response = match (&options.response, options.linear) {
        (Some(path), _) => Response::read_csv(path)?,
        (None, true) => Response::linear(first.white),
        (None, false) if first.white == Picture::FLOAT_WHITE => Response::linear(first.white),
        (None, false) => Response::srgb(first.white),
    };
    if response.white() != first.white {
        let what =
            format!("its levels go to {}, those of the photographs to {}", response.white(), first.white);
        return Err(Error::request(what, "give the response of these photographs"));
    }
    let noise = NoiseModel::assumed(&response);

    let (aligned, known, corners) = orient(shots, options, (&pictures, &lens, calibrated), progress)?;
    require_partners(shots, &aligned, &corners, &lens)?;
    let grown = if options.refine { aligned.lens.fx / gray_fx(&lens) } else { 1.0 };
    if calibrated && (grown - 1.0).abs() > CALIBRATED_SIGMA.max(3.0 * aligned.focal_sigma) {
        notes.push(off_centre(grown, aligned.focal_sigma));
    }
    let lens = Lens { fx: lens.fx * grown, fy: lens.fy * grown, k1: aligned.lens.k1, ..lens };
    let unmatched: Vec<String> = all
        .iter()
        .zip(&aligned.matched)
        .filter(|(_, matched)| **matched == 0)
        .map(|(shot, _)| shot.name())
        .collect();
    if options.refine && !unmatched.is_empty() {
        notes.push(format!(
            "no corner of {} was found in another photograph: the orientation {} stands",
            unmatched.join(", "),
            if shots.tracker.is_some() { "by the tracker" } else { "given" }
        ));
    }
    let tracked: Vec<Option<(DQuat, f64)>> = (0..all.len())
        .map(|i| {
            let Prior { turn, sigma_rad } = shots.tracker.as_ref()?.place(i, known.as_ref()?);
            Some((turn, sigma_rad))
        })
        .collect();
    let tracker = shots.tracker.as_ref().zip(known.as_ref()).map(|(tracker, known)| {
        let names: Vec<String> = all.iter().map(|shot| shot.name()).collect();
        let (fit, told) = tracker.told(known, &names);
        notes.splice(0..0, told);
        fit
    });

    let blocks: Vec<Blocks> =
        pictures.par_iter().map(|picture| blocks(picture, &lens, &response, &noise)).collect();
    let stated: Vec<Option<f64>> = all.iter().map(|shot| shot.exposure).collect();
    let white = f64::from(response.exposure(1)[usize::from(response.white())]);
    let bends = response.is_assumed() && !options.linear;
    if !options.curve.is_empty() && !bends {
        return Err(Error::request(
            "the map's photographs were taken by sRGB with a curve that their exposures told, not by this response",
            "leave --response out, or make the map with it too",
        ));
    }
    let photometry = solve(&blocks, &aligned.turns, &stated, (white, bends, &options.curve))?;
    let alone = &photometry[1].alone;
    if alone.len() + 1 >= all.len() {
        return Err(Error::request(
            format!(
                "none of the {} photographs shows what another one shows, at these orientations",
                all.len()
            ),
            "check the orientations and the field of view, or take photographs that overlap by a third",
        ));
    }
    if !alone.is_empty() {
        let names: Vec<String> = alone.iter().map(|&i| all[i].name()).collect();
        let how =
            if alone.iter().all(|&i| stated[i].is_some()) { "the stated exposure" } else { "the mean gain" };
        notes.push(format!(
            "{} are not linked by overlaps with most photographs: {how} stands for their gain",
            names.join(", ")
        ));
    }
    // Gains are relative to the mean of the stated exposures, which brings radiance to one unit for all maps of a camera.
    let known: Vec<f64> = stated.iter().flatten().map(|exposure| exposure.ln()).collect();
    let ln_unit = known.iter().sum::<f64>() / known.len().max(1) as f64
        + if known.is_empty() { 0.0 } else { white.ln() };
    let plates: Vec<Plate> = pictures
        .par_iter()
        .enumerate()
        .map(|(i, picture)| {
            let place = (i, aligned.turns[i], options.size);
            plate(picture, &lens, (&response, &noise), (&photometry, ln_unit), place)
        })
        .collect::<Result<_>>()?;
    let merged = merge(&Sphere::new(options.size), &plates, &options.merge, progress)?;
    let flags = merged.coverage.iter().zip(&merged.measured).map(|(&coverage, &measured)| match coverage {
        0 => EnvironmentMap::UNSEEN,
        _ if measured < 0.5 => EnvironmentMap::LOWER_BOUND,
        _ => 0,
    });
    let flags = flags.collect();
    let mut map = EnvironmentMap {
        size: options.size,
        radiance: merged.radiance,
        variance: merged.variance,
        coverage: merged.coverage,
        flags,
        unit: if known.is_empty() { Unit::MeanPhotograph } else { shots.unit },
        curve: if photometry[1].curve.iter().any(|knot| *knot != 0.0) {
            photometry[1].curve.to_vec()
        } else {
            vec![]
        },
    };
    if options.fill {
        super::fill::fill(&mut map);
    }
    let placed = all.iter().enumerate().map(|(i, shot)| Placed {
        name: shot.name(),
        world_from_camera: aligned.turns[i],
        sigma_rad: aligned.sigma_rad[i],
        matched: aligned.matched[i],
        gain: [0, 1, 2].map(|c| photometry[c].gains[i].exp()),
        gain_sigma: photometry[1].sigmas[i],
        tracked: tracked[i],
    });
    Ok(Mosaic { map, placed: placed.collect(), lens, residual_rad: aligned.residual_rad, tracker, notes })
}

/// How the photographs were turned, what that tells of their tracker, and how many corners each has that others might show.
fn orient(
    shots: &Shots,
    options: &Options,
    (pictures, lens, calibrated): (&[Picture], &Lens, bool),
    progress: &dyn Progress,
) -> Result<(Aligned, Option<Known>, Vec<usize>)> {
    let tracker = shots.tracker.as_ref();
    let mut known = tracker.map(Tracked::before);
    let given = || -> Vec<Prior> {
        let prior = |shot: &super::Shot| Prior {
            turn: shot.world_from_camera,
            sigma_rad: shot.sigma_rad.unwrap_or(options.sigma_rad).max(1e-5),
        };
        shots.shots.iter().map(prior).collect()
    };
    let tracked = |tracker: &Tracked, known: &Known| -> Vec<Prior> {
        (0..shots.shots.len()).map(|i| tracker.place(i, known)).collect()
    };
    if !options.refine {
        let priors =
            tracker.zip(known.as_ref()).map_or_else(given, |(tracker, known)| tracked(tracker, known));
        let aligned = Aligned {
            turns: priors.iter().map(|prior| prior.turn).collect(),
            sigma_rad: priors.iter().map(|prior| prior.sigma_rad).collect(),
            matched: vec![0; priors.len()],
            lens: *lens,
            focal_sigma: 0.0,
            residual_rad: 0.0,
            is_linked: vec![false; priors.len()],
        };
        return Ok((aligned, known, vec![]));
    }
    let white = f32::from(pictures[0].white) * 3.0;
    let gray = |picture: &Picture| {
        let level = |i: usize| picture.levels[i].iter().map(|&level| f32::from(level)).sum::<f32>() / white;
        Gray::new(lens, level, GRAY)
    };
    let grays: Vec<Gray> = pictures.par_iter().map(gray).collect();
    let corners: Vec<Corners> = grays.par_iter().map(Gray::corners).collect();
    let many = corners.iter().map(|corners| corners.at.len()).collect();
    let doubt = if calibrated { (CALIBRATED_SIGMA, 0.005) } else { (0.05, 0.05) };
    let (Some(tracker), Some(known)) = (tracker, &mut known) else {
        return Ok((align(grays, &corners, given(), doubt, None, progress)?, None, many));
    };
    let pair = |i: usize| {
        let expected = tracker.expected([i, i + 1], known);
        between([&grays[i], &grays[i + 1]], [&corners[i], &corners[i + 1]], [i, i + 1], expected)
    };
    let pairs: Vec<Pair> = (0..grays.len() - 1).into_par_iter().filter_map(pair).collect();
    *known = tracker.known_by_pairs(&pairs);
    let priors = tracked(tracker, known);
    let mut refit = |aligned: &Aligned| {
        let linked = (0..aligned.turns.len()).filter(|&i| aligned.is_linked[i]);
        let views: Vec<(usize, DQuat)> = linked.map(|i| (i, aligned.turns[i])).collect();
        *known = tracker.known_by_views(&views, known);
        tracked(tracker, known)
    };
    let aligned = align(grays, &corners, priors, doubt, Some(&mut refit), progress)?;
    let known = Some(known.clone());
    Ok((aligned, known, many))
}

/// What a focal length says that is not the calibrated one. A camera e in front of the point about which it turns sees what is D away from that point, at an
/// angle a from its axis, at a + e/D sin(a) to first order, as with a focal length longer by e/D. An offset to the side is a turn
/// that all photographs share.
fn off_centre(grown: f64, sigma: f64) -> String {
    let percent = 100.0 * (grown - 1.0);
    format!(
        "the photographs agree with a focal length {:.1} ± {:.2} % {} than the calibrated one, and the map takes it: the lens was focused otherwise, or it turned about a point {:.1} % of the scene's distance {} it (then things nearer than the rest are double)",
        percent.abs(),
        100.0 * sigma,
        if percent > 0.0 { "longer" } else { "shorter" },
        percent.abs(),
        if percent > 0.0 { "behind" } else { "in front of" },
    )
}

/// Refuses photographs full of corners most of which no other photograph shows where it should: what is made of them would be no map.
fn require_partners(shots: &Shots, aligned: &Aligned, corners: &[usize], lens: &Lens) -> Result<()> {
    let axis: Vec<DVec3> = aligned.turns.iter().map(|turn| *turn * DVec3::Z).collect();
    let across_rad = 2.0 * (f64::from(lens.width) / 2.0 / lens.fx).atan();
    let overlaps = |i: usize| {
        let near = |j: usize| i != j && axis[i].angle_between(axis[j]) < NEAR * across_rad;
        (0..axis.len()).any(near)
    };
    let detailed: Vec<usize> =
        (0..corners.len()).filter(|&i| corners[i] >= DETAILED && overlaps(i)).collect();
    let lonely = detailed.iter().filter(|&&i| aligned.matched[i] == 0).count();
    if detailed.len() < 3 || 2 * lonely <= detailed.len() {
        return Ok(());
    }
    Err(Error::request(
        format!(
            "{lonely} of {} photographs that overlap show details that no other shows where it should, with a lens that sees {:.1} degrees across",
            detailed.len(),
            across_rad.to_degrees()
        ),
        format!(
            "check the lens (--lens, --fov) and the orientations (of {}, for one), or take both as they are with --no-refine",
            shots.shots[detailed[0]].name()
        ),
    ))
}

/// The focal length that [`Gray`] starts from.
fn gray_fx(lens: &Lens) -> f64 {
    lens.fx / f64::from(lens.width.div_ceil(GRAY).max(1))
}

/// The lens of photographs of this size, and whether it was calibrated; `given` is that of their table.
pub(super) fn lens_of(given: Option<Lens>, options: &Options, first: &Picture) -> Result<(Lens, bool)> {
    let size = format!("{}x{}", first.width, first.height);
    let Some(lens) = options.lens.or(if options.field_of_view_rad.is_some() { None } else { given }) else {
        let Some(angle) = options.field_of_view_rad else {
            return Err(Error::request("nothing tells the lens", "give --lens FILE or --fov DEGREES"));
        };
        if !(angle > 0.01 && angle < 3.0) {
            return Err(Error::request(
                format!("a field of view of {:.1} degrees", angle.to_degrees()),
                "give the angle across the picture, from 1 to 170 degrees",
            ));
        }
        let focal = f64::from(first.width) / 2.0 / (angle / 2.0).tan();
        return Ok((Lens::pinhole(first.width, first.height, focal), false));
    };
    if u64::from(lens.width) * u64::from(first.height) != u64::from(lens.height) * u64::from(first.width) {
        return Err(Error::input(
            &first.path,
            format!("is {size} pixels, the lens is for {}x{}", lens.width, lens.height),
            "calibrate the lens with photographs of this camera at this size",
        ));
    }
    Ok((lens.scaled_to(first.width, first.height), true))
}

/// Whether a pixel was measured: neither saturated nor too dark.
fn measured(levels: [u16; 3], noise: &NoiseModel) -> (bool, bool) {
    let saturated = (0..3).any(|c| levels[c] >= noise.saturated_level[c]);
    (saturated, (0..3).any(|c| levels[c] <= noise.dark_level[c]))
}

fn blocks(picture: &Picture, lens: &Lens, response: &Response, noise: &NoiseModel) -> Blocks {
    let by = picture.width.div_ceil(BLOCKS).clamp(1, picture.height.max(1));
    let small = lens.scaled_to((picture.width / by).max(1), (picture.height / by).max(1));
    let exposure = (0..small.width * small.height).map(|i| {
        let (x, y) = (i % small.width * by, i / small.width * by);
        let mut sum = [0f32; 3];
        for k in 0..by * by {
            let levels = picture.levels[((y + k / by) * picture.width + x + k % by) as usize];
            if measured(levels, noise) != (false, false) {
                return None;
            }
            (0..3).for_each(|c| sum[c] += response.exposure(c)[usize::from(levels[c])]);
        }
        Some(sum.map(|sum| sum / (by * by) as f32)).filter(|mean| mean.iter().all(|x| *x > 0.0))
    });
    Blocks { lens: small, exposure: exposure.collect() }
}

fn plate(
    picture: &Picture,
    lens: &Lens,
    (response, noise): (&Response, &NoiseModel),
    (photometry, ln_unit): (&[Photometry; 3], f64),
    (number, turn, size): (usize, DQuat, LatLong),
) -> Result<Plate> {
    // Radiance of every level on the axis; shading is a factor.
    let white = usize::from(response.white());
    let table = |c: usize| -> Vec<f32> {
        let p = &photometry[c];
        let mut most = 0f32;
        let value = |level: usize| {
            let exposure = f64::from(response.exposure(c)[level]);
            if exposure <= 0.0 {
                return 0.0;
            }
            most = most.max((p.ln_radiance(exposure.ln(), 0.0) - p.gains[number] - ln_unit).exp() as f32);
            most
        };
        (0..=white).map(value).collect()
    };
    let tables = [table(0), table(1), table(2)];
    let shade = photometry.each_ref().map(|p| [p.shape[0], p.shape[1]]);
    let width = picture.width as usize;
    let pixel = |i: usize| {
        let levels = picture.levels[i];
        let r2 = shade_r2(lens, (i % width) as f64, (i / width) as f64);
        let value = |c: usize| {
            let [a, b] = shade[c];
            tables[c][usize::from(levels[c])] * (r2 * (a + b * r2)).exp() as f32
        };
        let (saturated, _) = measured(levels, noise);
        [value(0), value(1), value(2), if saturated { BOUND } else { 1.0 }]
    };
    // The variance of a level in radiance, as a square of its radiance.
    let green = |level: usize| {
        let (x, slope) = (f64::from(response.exposure(1)[level]), f64::from(response.slope(1, level)));
        let radiance = f64::from(tables[1][level]);
        (radiance, noise.variance(1, x, slope) * (radiance / x.max(1e-9)).powi(2))
    };
    let at = |part: f64| green(((white as f64 * part) as usize).max(1));
    let (dark, middle, bright) = (at(0.04), at(0.35), at(0.9));
    let linear = ((bright.1 - dark.1) / (bright.0 - dark.0).max(1e-30)).max(0.0);
    let constant = (dark.1 - linear * dark.0).max(1e-3 * middle.1).max(1e-30);
    let square = 1e-5 + photometry[1].sigmas[number].min(GAIN_SIGMA).powi(2);
    let noise = Noise { constant: constant as f32, linear: linear as f32, square: square as f32 };
    Plate::new(size, lens, turn, pixel, noise, Filter::Bicubic)
}

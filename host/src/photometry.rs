//! One scale for a whole session, from views that overlap: how bright the lamp was in each view, and how the light falls off towards the
//! corners of the picture where no flat fields tell.
//!
//! The same texels are seen by many views. What one model of radiance against direction for each texel leaves, in one view at all texels
//! alike, is the lamp; at one place of the picture in all views alike, the lens. Both are solved for together with the models
//! (`equations`), as sure as patches of the surface agree. A gain for each view and the surface's own look are confounded where they
//! change with direction in the same way: so a gain counts as the lamp's only as far as views from about the same direction, or
//! about the same time, say so (`components`); it is drawn towards 1 by how much the lamp varies at all, and nothing is done
//! where that may be chance.

mod components;
mod equations;
mod looks;

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector};

use crate::calibration::{Photometry, Registration, ViewGain, Vignetting};
use crate::fit::{FitOptions, Fitter, Model};
use crate::geometry::Surface;
use crate::progress::Progress;
use crate::session::{Event, Session};
use crate::{Error, Result};
use components::{Component, Views};
use equations::{Equations, Solved, TERMS, Unknowns};
use looks::{Texel, look};

/// A matte patch in the picture of every view: where its radiance changes, the lamp did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// Its centre, surface frame; it may lie beside the sampled area.
    pub centre_m: DVec2,
    /// The length of its sides.
    pub side_m: f64,
}

/// What to look for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How bright the lamp was in each view.
    pub lamp: bool,
    /// The fall-off, where the session has no flat fields.
    pub vignetting: bool,
    /// Where to look for the lamp in place of the whole surface.
    pub reference: Option<Patch>,
}

impl Default for Options {
    /// Everything, from the surface itself.
    fn default() -> Self {
        Self { lamp: true, vignetting: true, reference: None }
    }
}

/// Fewer views than this tell nothing of the lamp: the models of the texels could be anything.
const FEWEST_VIEWS: usize = 12;
/// So many views determine two lobes for each texel, fewer one.
const VIEWS_FOR_TWO_LOBES: usize = 30;
/// Models and gains are fitted in turn so many times.
const ROUNDS: usize = 4;
/// What all models get wrong in one view alike, relative: in all channels, and in each. No patch tells it, so no gain is believed to be
/// surer. (On simulated surfaces 0.0005 in the root mean square.)
const COMMON: f64 = 5e-4;
const COLOUR: f64 = 3e-4;
/// The fall-off is told where it is surer than this over the places where the surface was seen, and so many times larger than its
/// standard deviation there.
const SURE: f64 = 0.03;
const TIMES: f64 = 3.0;
/// A reference patch whose gains differ from those of the surface by more is no reference (relative; standard deviations).
const STRANGE: f64 = 0.01;
const STRANGE_TIMES: f64 = 5.0;

/// Finds what there is to find; nothing of a session whose exposure times are unknown, where every view has a gain of its own anyway.
/// Everything is said in the notes of the result.
///
/// # Errors
/// [`crate::Error::Input`] when the session lacks radiance, poses, a lens or the surface's size; [`crate::Error::Request`] when the
/// reference patch is not seen; [`crate::Error::Interrupted`].
pub fn find(session: &Session, options: &Options, progress: &dyn Progress) -> Result<Photometry> {
    let mut found = Photometry::nothing(session)?;
    let registration = Registration::of(session)?;
    let mut views = session.done_views();
    if let Some(registration) = &registration {
        views.retain(|&view| registration.view(&session.manifest.views[view].name).is_some());
    }
    let is_timed = |view: &usize| session.photographs(*view).iter().all(|photo| photo.exposure_s.is_some());
    if !views.iter().all(is_timed) || !(options.lamp || options.vignetting) {
        return Ok(found);
    }
    let lens = lens_of_all(session, &views);
    let has_flats = !session.flats()?.is_empty();
    let falls_off = options.vignetting && !has_flats;
    if falls_off && lens.is_none() {
        found.notes.push(
            "vignetting stays in the radiance: the views have lenses of their own; photograph flat fields"
                .into(),
        );
    }
    if views.len() < FEWEST_VIEWS {
        found.notes.push(format!(
            "{} views tell neither the lamp's drift nor vignetting, {FEWEST_VIEWS} would: both stay in the radiance",
            views.len()
        ));
        return Ok(found);
    }
    let falls_off = falls_off.then_some(lens).flatten();
    let surface = session.manifest.surface()?;
    let names: Vec<&str> = views.iter().map(|&view| session.manifest.views[view].name.as_str()).collect();
    let whole = look(session, registration.as_ref(), &views, (surface, DVec3::ZERO), &found, progress)?;
    let model = Model::Phong { lobes: if views.len() < VIEWS_FOR_TWO_LOBES { 1 } else { 2 } };
    let estimate = estimate(&whole, views.len(), model, falls_off, progress)?;
    let order = in_time(session, &views);
    let seen = Views { direction: &whole.direction, time: &order };
    if options.lamp && options.reference.is_none() {
        lamp(&estimate, &seen, &names, &mut found);
    }
    if let Some(start) = falls_off {
        fall_off(&estimate, &seen, &whole.texels, options, start, &mut found);
    }
    if let (true, Some(patch)) = (options.lamp, options.reference) {
        let side = Surface { width_m: patch.side_m, height_m: patch.side_m };
        let (patch_at, at) = (patch.centre_m, (side, patch.centre_m.extend(0.0)));
        let patch = look(session, registration.as_ref(), &views, at, &found, progress)?;
        if patch.pixels().is_empty() {
            return Err(Error::request(
                format!(
                    "no view shows the reference patch at {:.1}, {:.1} mm",
                    1e3 * patch_at.x,
                    1e3 * patch_at.y
                ),
                "give its centre from the centre of the surface, x right and y up",
            ));
        }
        let reference = self::estimate(&patch, views.len(), Model::Constant, None, progress)?;
        lamp(&reference, &Views { direction: &[], time: &order }, &names, &mut found);
        found.notes.extend(reference.contradiction(&estimate));
    }
    Ok(found)
}

/// Width and height of the pictures where one lens took all of them.
fn lens_of_all(session: &Session, views: &[usize]) -> Option<(u32, u32)> {
    let first = session.manifest.lens(*views.first()?).ok()?;
    let same = |view: &usize| session.manifest.lens(*view).is_ok_and(|lens| lens == first);
    views.iter().all(same).then_some((first.width, first.height))
}

/// When each view was taken, from 0 to 1: its rank in the journal.
fn in_time(session: &Session, views: &[usize]) -> Vec<f64> {
    let mut first = BTreeMap::new();
    for (place, event) in session.events().iter().enumerate() {
        if let Event::Photograph(photograph) = event {
            first.entry(photograph.view).or_insert(place);
        }
    }
    let mut ranks: Vec<usize> = (0..views.len()).collect();
    ranks.sort_by_key(|&i| first.get(&views[i]));
    let mut times = vec![0.0; views.len()];
    for (rank, &i) in ranks.iter().enumerate() {
        times[i] = rank as f64 / (views.len().max(2) - 1) as f64;
    }
    times
}

/// Gains (logarithms) and fall-off, free of each other's priors.
struct Estimate {
    unknowns: Unknowns,
    solved: Solved,
    /// What the models leave, root mean square, relative.
    residual: f64,
}

fn estimate(
    looks: &looks::Looks,
    views: usize,
    model: Model,
    size: Option<(u32, u32)>,
    progress: &dyn Progress,
) -> Result<Estimate> {
    let mut unknowns = Unknowns::new(views, size);
    let mut round = 0;
    loop {
        progress.step(round, ROUNDS)?;
        let corrected: Vec<Texel> = looks.texels.iter().map(|texel| unknowns.correct(texel)).collect();
        let sample: Vec<_> = corrected.iter().map(|texel| texel.observations.clone()).collect();
        let fitter = Fitter::new(model, &FitOptions::default(), &sample)?;
        let equations = Equations::of(&corrected, &fitter, &unknowns);
        let solved = equations.solve(&unknowns);
        unknowns.step(&solved.step);
        round += 1;
        if round == ROUNDS {
            return Ok(Estimate { unknowns, residual: equations.residual(), solved });
        }
    }
}

/// What three channels have in common, and two ways in which their colour changes: orthonormal.
const MIXES: [[f64; 3]; 3] = {
    const A: f64 = 0.577_350_269_189_625_8;
    const B: f64 = std::f64::consts::FRAC_1_SQRT_2;
    const C: f64 = 0.408_248_290_463_863;
    [[A, A, A], [B, -B, 0.0], [C, C, -2.0 * C]]
};

impl Estimate {
    /// One mix of the channels' ln gains, and its covariance.
    fn mixed(&self, mix: [f64; 3]) -> (DVector<f64>, DMatrix<f64>) {
        let views = self.unknowns.views();
        let gains = &self.unknowns.ln_gain;
        let value = DVector::from_fn(views, |v, _| (0..3).map(|c| mix[c] * gains[3 * v + c]).sum());
        let covariance = &self.solved.covariance;
        let wrong = (mix.iter().sum::<f64>() * COMMON).powi(2) + COLOUR * COLOUR;
        let of = |v: usize, w: usize| {
            let pairs = (0..9).map(|i| (i / 3, i % 3));
            let found = pairs.map(|(a, b)| mix[a] * covariance[(3 * v + a, 3 * w + b)] * mix[b]).sum::<f64>();
            if v == w { found + wrong } else { found }
        };
        (value, DMatrix::from_fn(views, views, of))
    }

    /// What is to be said where a reference patch tells of another lamp than the surface does.
    fn contradiction(&self, surface: &Estimate) -> Option<String> {
        let [(here, sure_here), (there, sure_there)] =
            [self, surface].map(|estimate| estimate.mixed(MIXES[0]));
        let views = here.len() as f64;
        let off = ((here - there).norm_squared() / views).sqrt() * MIXES[0][0];
        let sigma = ((sure_here.trace() + sure_there.trace()) / views).sqrt() * MIXES[0][0];
        (off > STRANGE && off > STRANGE_TIMES * sigma).then(|| {
            format!(
                "warning: the reference patch tells of another lamp than the surface does, by {:.1} %: it is not matte, or not where it is said to be",
                100.0 * off
            )
        })
    }

    fn components(&self, seen: &Views) -> [Component; 3] {
        MIXES.map(|mix| {
            let (value, covariance) = self.mixed(mix);
            Component::find(&value, &covariance, seen)
        })
    }
}

/// The lamp's gains, where it was not steady.
fn lamp(estimate: &Estimate, seen: &Views, names: &[&str], found: &mut Photometry) {
    let components = estimate.components(seen);
    let [common, ..] = &components;
    let open =
        middle((0..names.len()).map(|v| estimate.mixed(MIXES[0]).1[(v, v)].sqrt() * MIXES[0][0]).collect());
    if !components.iter().any(|component| component.is_there) {
        found.notes.push(format!(
            "the lamp was steady as far as the views tell, each of them to {:.2} %: nothing is changed",
            100.0 * open
        ));
        return;
    }
    let mut views: Vec<ViewGain> =
        names.iter().map(|&name| ViewGain { name: name.into(), gain: [1.0; 3], sigma: [0.0; 3] }).collect();
    for (v, view) in views.iter_mut().enumerate() {
        for c in 0..3 {
            let parts = || components.iter().zip(MIXES).filter(|(component, _)| component.is_there);
            view.gain[c] = parts().map(|(component, mix)| mix[c] * component.lamp[v]).sum::<f64>().exp();
            view.sigma[c] =
                parts().map(|(component, mix)| mix[c].powi(2) * component.variance[v]).sum::<f64>().sqrt();
        }
    }
    let spread = |mix: usize| components[mix].spread();
    let sigma = middle(views.iter().map(|view| view.sigma.iter().sum::<f64>() / 3.0).collect());
    let mut note = match common.is_there {
        true => format!(
            "the lamp's gain varied by {:.1} % over the views (standard deviation)",
            100.0 * spread(0) * MIXES[0][0]
        ),
        false => "the lamp's gain was steady".into(),
    };
    if components[1..].iter().any(|component| component.is_there) {
        note += &format!(", its colour by {:.1} %", 100.0 * spread(1).hypot(spread(2)));
    }
    found.notes.push(format!("{note}; it is removed, each view's to {:.2} % (median)", 100.0 * sigma));
    found.views = views;
}

/// The fall-off, given what gains the lamp explains.
fn fall_off(
    estimate: &Estimate,
    seen: &Views,
    texels: &[Texel],
    options: &Options,
    (width, height): (u32, u32),
    found: &mut Photometry,
) {
    let views = estimate.unknowns.views();
    let n = estimate.unknowns.len();
    // What is known of the gains: as much as the lamp varies at all, and what the surface does in all texels alike.
    let mut information = estimate.solved.information.clone();
    let right = &information * estimate.unknowns.values();
    for (component, mix) in estimate.components(seen).iter().zip(MIXES) {
        let lamp = options.lamp && component.is_there;
        let Some(inverse) = component.prior(seen, lamp, COMMON).cholesky().map(|factor| factor.inverse())
        else {
            continue;
        };
        for v in 0..views {
            for w in 0..views {
                for (a, b) in (0..9).map(|i| (i / 3, i % 3)) {
                    information[(3 * v + a, 3 * w + b)] += mix[a] * inverse[(v, w)] * mix[b];
                }
            }
        }
    }
    let Some(factor) = information.cholesky() else { return };
    let solution = factor.solve(&right);
    let inverse = factor.inverse();
    let first = n - TERMS;
    let mut vignetting = Vignetting::centred(width, height);
    let [a, b, c, x, y]: [f64; TERMS] = std::array::from_fn(|i| solution[first + i]);
    vignetting.coefficients = [a, b, c];
    vignetting.centre_x += x;
    vignetting.centre_y += y;
    vignetting.covariance = std::array::from_fn(|i| std::array::from_fn(|k| inverse[(first + i, first + k)]));
    vignetting.residual = estimate.residual;
    vignetting.settled = true;

    let pixels: Vec<DVec2> = texels.iter().flat_map(|texel| texel.pixel.iter().copied()).collect();
    // The scale is nobody's: what counts is by how much places differ.
    let slopes: Vec<[f64; TERMS]> = pixels.iter().map(|pixel| vignetting.ln_at(pixel.x, pixel.y).1).collect();
    let mean: [f64; TERMS] =
        std::array::from_fn(|i| slopes.iter().map(|s| s[i]).sum::<f64>() / slopes.len() as f64);
    let variance = |slope: &[f64; TERMS]| {
        let pairs = (0..TERMS * TERMS).map(|i| (i / TERMS, i % TERMS));
        pairs
            .map(|(i, k)| (slope[i] - mean[i]) * vignetting.covariance[i][k] * (slope[k] - mean[k]))
            .sum::<f64>()
    };
    let told = (slopes.iter().map(variance).sum::<f64>() / slopes.len() as f64).max(0.0).sqrt();
    // No surer than what models get wrong; the less the places of a texel differ, the more that counts.
    let sigma = told.hypot(COMMON * lever(texels, &vignetting));
    let wider = (sigma / told.max(1e-3 * COMMON)).powi(2);
    let own = vignetting.covariance.map(|row| row.map(|value| wider * value));
    let values: Vec<f64> = pixels.iter().map(|pixel| vignetting.ln_at(pixel.x, pixel.y).0).collect();
    let size = (scatter(&values) / values.len() as f64).sqrt();
    let (least, most) = values.iter().fold((f64::MAX, f64::MIN), |(l, m), v| (v.min(l), v.max(m)));
    if sigma > SURE {
        found.notes.push(format!(
            "no flats, and the views do not tell the vignetting (to {:.1} % only, where the surface was seen): it stays in the radiance; photograph flat fields",
            100.0 * sigma
        ));
    } else if size < TIMES * sigma {
        found.notes.push(format!(
            "no flats, and the views show no vignetting (to {:.2} %, where the surface was seen): nothing is changed",
            100.0 * sigma
        ));
    } else {
        vignetting.covariance = own;
        found.notes.push(format!(
            "no flats: vignetting is found from the overlapping views, {:.0} % from the brightest to the darkest place where the surface was seen, to {:.2} % there; it is removed",
            100.0 * (1.0 - (least - most).exp()),
            100.0 * sigma
        ));
        found.vignetting = Some(vignetting);
    }
}

/// How much more places differ in their distance from the centre (squared, as the fall-off goes) from texel to texel than within a texel from
/// view to view.
fn lever(texels: &[Texel], vignetting: &Vignetting) -> f64 {
    let (mut all, mut within) = (vec![], 0.0);
    for texel in texels.iter().filter(|texel| !texel.pixel.is_empty()) {
        let r2: Vec<f64> = texel.pixel.iter().map(|pixel| vignetting.ln_at(pixel.x, pixel.y).1[0]).collect();
        within += scatter(&r2);
        all.extend(r2);
    }
    (scatter(&all) / within.max(f64::MIN_POSITIVE)).sqrt()
}

/// Sum of the squares about the mean.
fn scatter(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The unit vector towards a view.
fn toward(centre_m: DVec3) -> DVec3 {
    centre_m.normalize_or(DVec3::Z)
}

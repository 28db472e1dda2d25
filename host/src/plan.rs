//! Where to look next: after a coarse pass, the directions where the expected error falls most.
//!
//! Lobes are fitted to some hundred texels. How wrong each may be is a covariance of their coefficients and of lobes that it may hide
//! ([`doubts`]); a view lowers it for all texels at once, since all are seen from nearly the same direction. Directions are
//! taken one by one, each where the mean squared error over all directions falls most once those before it are taken
//! (sequential design for the integrated variance; Fedorov 1972). Errors are of the brightness 1 - exp(-gamma L), as in
//! [`crate::evaluate`]: a highlight counts as what is seen of it.
//!
//! Without a fit there is nothing to expect: then the largest gaps are filled.

mod doubts;

use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::fit::{FitFlags, FitOptions, Fitter, Model, TexelFit};
use crate::geometry::azimuth_zenith;
use crate::observation::{ObservationMap, TexelObservations};
use crate::progress::Progress;
use crate::render::{expose, gamma_for_median};
use crate::rig::RigLimits;
use crate::sampling::{is_reachable, spiral};
use crate::{Error, Result, file};
use doubts::{Doubts, Lobe, Lobes, Seen, Surroundings};

/// So far apart are the directions among which a plan chooses, radians: half of what the smallest lobes are wide.
const SPACING_RAD: f64 = 0.06;
/// A direction nearer than this to one that is photographed tells nothing new, radians.
const SAME_RAD: f64 = 0.03;
/// So many texels stand for the surface.
const TEXELS: usize = 500;
/// Lobes by which the error is expected: the most of them that the views allow.
const MODELS: [Model; 2] = [Model::Phong { lobes: 2 }, Model::Phong { lobes: 1 }];
/// A plan looks so many views ahead for the one that halves the error.
const AHEAD: usize = 48;
/// Views within this angle of each other look at the same thing, radians.
const TOGETHER_RAD: f64 = 0.35;

/// The next views, and what they are expected to bring.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewPlan {
    /// Unit vectors to the camera, surface frame, the most telling first.
    pub directions: Vec<DVec3>,
    /// What is expected of them; `None` where no lobes could be fitted and gaps are filled instead.
    pub expected: Option<Expected>,
}

/// What is expected of a plan. Errors are root mean squares over texels and directions of the brightness 1 - exp(-gamma L).
#[derive(Debug, Clone, PartialEq)]
pub struct Expected {
    /// Which model the errors are those of.
    pub model: Model,
    /// The part of the error that views can remove: before the plan, and after each further view, also those looked at ahead of it.
    pub removable: Vec<f64>,
    /// The part that no view removes: noise, and what the model does not say.
    pub lasting: f64,
    /// The part of the texels that have a lobe which the views do not determine.
    pub undetermined: f64,
    /// The views that were looked at ahead of the plan, after it.
    ahead: Vec<DVec3>,
}

impl Expected {
    /// The whole error after so many of the views.
    pub fn error(&self, views: usize) -> f64 {
        let last = self.removable.len().saturating_sub(1);
        self.removable.get(views.min(last)).map_or(self.lasting, |part| part.hypot(self.lasting))
    }

    /// The fewest further views that halve what views can remove; `None` where more are needed than were looked at.
    pub fn halving(&self) -> Option<usize> {
        let first = *self.removable.first()?;
        self.removable.iter().position(|part| *part <= 0.5 * first)
    }

    /// The fewest further views with which the whole error is at most `error`; `None` where those looked at do not suffice.
    pub fn sufficient(&self, error: f64) -> Option<usize> {
        (0..self.removable.len()).find(|views| self.error(*views) <= error)
    }
}

impl ViewPlan {
    /// Writes the directions, in their order, as a table that [`crate::sampling::read_directions`] reads, with the error (of 255) that is
    /// expected once a line and those above it are photographed.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        let mut text = String::from("azimuth_deg,zenith_deg,expected_error_255\n");
        for (index, direction) in self.directions.iter().enumerate() {
            let (azimuth_rad, zenith_rad) = azimuth_zenith(*direction);
            let error = self.expected.as_ref().map(|expected| 255.0 * expected.error(index + 1));
            let error = error.map_or(String::new(), |error| format!("{error:.3}"));
            let _ = writeln!(text, "{:.3},{:.3},{error}", azimuth_rad.to_degrees(), zenith_rad.to_degrees());
        }
        file::write_bytes(path, text.as_bytes())
    }

    /// Around which direction the first `views` lie thickest, and how many of them.
    pub fn thickest(&self, views: usize) -> Option<(DVec3, usize)> {
        let ahead = self.expected.iter().flat_map(|expected| &expected.ahead);
        let first: Vec<DVec3> = self.directions.iter().chain(ahead).take(views).copied().collect();
        let around = |centre: &DVec3| {
            let near = first.iter().filter(|view| view.angle_between(*centre) <= TOGETHER_RAD);
            (near.clone().sum::<DVec3>().normalize_or(*centre), near.count())
        };
        first.iter().map(around).reduce(|best, other| if other.1 > best.1 { other } else { best })
    }
}

/// The directions among which a plan chooses: spread evenly down to `zenith_limit_rad`, those that the rig can show.
///
/// # Errors
/// [`Error::Request`] for a limit outside (0, π/2], or a rig that shows none of them.
pub fn candidates(limits: Option<&RigLimits>, zenith_limit_rad: f64) -> Result<Vec<DVec3>> {
    let count = TAU * (1.0 - zenith_limit_rad.cos()) / SPACING_RAD.powi(2);
    let mut all = spiral((count.ceil() as usize).max(1), zenith_limit_rad)?;
    all.retain(|direction| limits.is_none_or(|limits| is_reachable(*direction, limits)));
    if all.is_empty() {
        return Err(Error::request(
            format!("the rig shows no direction within zenith {:.1}°", zenith_limit_rad.to_degrees()),
            "choose a larger zenith limit",
        ));
    }
    Ok(all)
}

/// The next `count` views of a surface, chosen from `candidates` (unit vectors, surface frame) by what the map's views say.
///
/// # Errors
/// [`Error::Request`] for no view, or more than there are candidates from which nobody has photographed yet; [`Error::Io`] when the map
/// cannot be read; [`Error::Interrupted`].
pub fn plan_views(
    map: &ObservationMap,
    candidates: &[DVec3],
    count: usize,
    progress: &dyn Progress,
) -> Result<ViewPlan> {
    if count == 0 {
        return Err(Error::request("a plan of no views", "ask for at least one"));
    }
    let views: Vec<DVec3> = map.header().views.iter().map(|view| view.centre_m).collect();
    let taken: Vec<DVec3> = views.iter().map(|centre_m| centre_m.normalize_or(DVec3::Z)).collect();
    let is_new = |direction: &&DVec3| taken.iter().all(|view| view.angle_between(**direction) > SAME_RAD);
    let open: Vec<DVec3> = candidates.iter().filter(is_new).copied().collect();
    if count > open.len() {
        return Err(Error::request(
            format!(
                "a plan of {count} views, where {} directions within reach, {:.1}° apart, are not photographed yet",
                open.len(),
                SPACING_RAD.to_degrees()
            ),
            format!("ask for at most {}, or for a larger zenith limit", open.len()),
        ));
    }
    let (places, texels): (Vec<_>, Vec<_>) = map.spread(TEXELS)?.into_iter().unzip();
    let options = FitOptions::default();
    let fitter = MODELS.iter().find_map(|model| Fitter::new(*model, &options, &texels).ok());
    let gamma = gamma_for_median(&radiances(&texels));
    let (Some(fitter), Ok(gamma)) = (fitter, gamma) else {
        return Ok(ViewPlan { directions: fill(&taken, &open, count), expected: None });
    };
    let fits: Vec<TexelFit> = texels.par_iter().map(|texel| fitter.fit(texel)).collect();
    progress.step(0, count)?;
    let pool: Vec<Lobe> = fits.iter().flat_map(|fit| Lobes::of(&fit.parameters).lobes).collect();
    let around = Surroundings {
        gamma,
        relative: options.relative_error as f32,
        floor: fitter.floor() as f32,
        pool: &pool,
    };
    let (surface, size) = (map.header().surface, map.header().texels);
    let distance_m = middle(views.iter().map(|centre_m| centre_m.length()).collect());
    let doubts = |(index, fit): (usize, &TexelFit)| {
        let (column, row) = places[index];
        let point = surface.texel_centre(size, column, row);
        let toward: Vec<Vec3> =
            open.iter().map(|direction| (*direction * distance_m - point).normalize().as_vec3()).collect();
        let seen = Seen {
            parameters: &fit.parameters,
            flags: fit.flags,
            residual: fit.residual,
            directions: &texels[index].direction,
        };
        Doubts::new(index, &seen, &around, &toward)
    };
    let mut doubts: Vec<Doubts> = fits.par_iter().enumerate().map(doubts).collect();

    let error = |doubts: &[Doubts]| {
        (doubts.par_iter().map(Doubts::expected).sum::<f64>() / doubts.len() as f64).sqrt()
    };
    let (mut chosen, mut removable) = (Vec::<usize>::new(), vec![error(&doubts)]);
    let last = open.len().min(count.max(AHEAD));
    while chosen.len() < last {
        progress.step(chosen.len(), last)?;
        if chosen.len() >= count && removable[chosen.len()] <= 0.5 * removable[0] {
            break;
        }
        let falls = doubts
            .par_iter()
            .fold(
                || vec![0.0; open.len()],
                |mut falls, doubts| {
                    doubts.add_falls(&mut falls);
                    falls
                },
            )
            .reduce(|| vec![0.0; open.len()], |a, b| a.iter().zip(b).map(|(a, b)| a + b).collect());
        let free = (0..open.len()).filter(|candidate| !chosen.contains(candidate));
        let Some(best) = free.max_by(|&a, &b| falls[a].total_cmp(&falls[b])) else { break };
        doubts.par_iter_mut().for_each(|doubts| doubts.see(best));
        chosen.push(best);
        removable.push(error(&doubts));
    }
    progress.step(last, last)?;
    let mut directions: Vec<DVec3> = chosen.iter().map(|&candidate| open[candidate]).collect();
    let ahead = directions.split_off(count);
    let undetermined = fits.iter().filter(|fit| fit.flags.contains(FitFlags::UNIDENTIFIED)).count();
    let expected = Expected {
        model: fitter.model(),
        removable,
        lasting: lasting(&fitter, &fits, &texels, gamma),
        undetermined: undetermined as f64 / fits.len() as f64,
        ahead,
    };
    Ok(ViewPlan { directions, expected: Some(expected) })
}

/// Root mean square of what the fits leave of their own views, as brightness, with the degrees of freedom that they used.
fn lasting(fitter: &Fitter, fits: &[TexelFit], texels: &[TexelObservations], gamma: f32) -> f64 {
    let of = |(fit, texel): (&TexelFit, &TexelObservations)| {
        let views = texel.direction.iter().zip(&texel.radiance).map(|(direction, measured)| {
            let predicted = fitter.model().radiance(&fit.parameters, *direction);
            let miss = |c: usize| f64::from(expose(predicted[c], gamma) - expose(measured[c], gamma));
            [0, 1, 2].map(|c| miss(c).powi(2)).iter().sum::<f64>() / 3.0
        });
        let free = texel.len().saturating_sub(fitter.model().unknowns()).max(1);
        views.sum::<f64>() / free as f64
    };
    let squares = fits.iter().zip(texels).filter(|(_, texel)| !texel.is_empty()).map(of);
    (squares.sum::<f64>() / fits.len().max(1) as f64).sqrt()
}

/// Radiance of some texels, all channels, what is no number left out.
fn radiances(texels: &[TexelObservations]) -> Vec<f32> {
    let all = texels.iter().flat_map(|texel| texel.radiance.iter().flatten().copied());
    all.filter(|radiance| radiance.is_finite()).collect()
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(1.0)
}

/// One after the other the candidate that is farthest from all views.
fn fill(taken: &[DVec3], candidates: &[DVec3], count: usize) -> Vec<DVec3> {
    let nearest = |candidate: &DVec3, views: &[DVec3]| {
        views.iter().map(|view| view.dot(*candidate)).fold(-1.0, f64::max)
    };
    let mut closeness: Vec<f64> = candidates.iter().map(|candidate| nearest(candidate, taken)).collect();
    let mut chosen = vec![];
    for _ in 0..count {
        let Some(best) = (0..candidates.len()).min_by(|&a, &b| closeness[a].total_cmp(&closeness[b])) else {
            break;
        };
        chosen.push(candidates[best]);
        for (closeness, candidate) in closeness.iter_mut().zip(candidates) {
            *closeness = closeness.max(candidates[best].dot(*candidate));
        }
    }
    chosen
}

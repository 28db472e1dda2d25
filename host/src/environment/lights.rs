//! The few lights that stand for an environment map, and a smooth remainder.
//!
//! What is brighter than half of the sphere is dealt into regions of equal luminance (median cut, Debevec 2005); regions whose union
//! costs the irradiance least are joined, two by two (Ward 1963, weighted by luminance), or the dimmest is left to the remainder, whichever
//! does less harm, and the fewest lights are kept that with the remainder reproduce the irradiance on all orientations, open and behind walls, to a tolerance.

mod blocks;
mod irradiance;
mod remainder;

use std::fmt::Write as _;

use glam::DVec3;
use rayon::prelude::*;

use super::EnvironmentMap;
use crate::{Error, Result};
use blocks::{Blocks, Sum};
use irradiance::Irradiance;
use remainder::Fit;
pub use remainder::Remainder;

/// Regions to begin with.
const REGIONS: usize = 512;
/// From so many on, leaving one to the remainder is tried beside joining two.
const SEARCHED: usize = 32;

const COLUMN_NAMES: &str = "kind,longitude_deg,latitude_deg,x,y,z,solid_angle_sr,radiance_r,radiance_g,radiance_b,share,is_lower_bound\n";

/// How lights are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Regions of equal luminance over the whole sphere, nothing beside them (Debevec 2005).
    MedianCut,
    /// Regions above the median radiance, joined where that costs least, and a remainder up to this order of spherical harmonics
    /// (0 to [`Remainder::MOST_ORDER`]), the smallest that suffices.
    Joined(usize),
}

/// One light.
#[derive(Debug, Clone, PartialEq)]
pub struct Light {
    /// Unit vector towards it, in the world of environments.
    pub direction: DVec3,
    /// The solid angle that an even light of its power and sharpness has, steradians.
    pub solid_angle_sr: f64,
    /// Red, green and blue irradiance on a surface that faces it; over the solid angle it is the radiance.
    pub irradiance: [f64; 3],
    /// Its part of the luminance from all directions.
    pub share: f64,
    /// Whether photographs were saturated there: it is at least so bright.
    pub is_lower_bound: bool,
}

/// Lights, and what comes from everywhere beside them.
#[derive(Debug, Clone, PartialEq)]
pub struct Lights {
    /// The brightest first.
    pub lights: Vec<Light>,
    /// Radiance from every direction beside them.
    pub remainder: Remainder,
    /// Root mean square of the irradiance's error over orientations, open and behind walls, relative to that of the irradiance.
    pub error: f64,
    /// The same over orientations alone, nothing hidden.
    pub open_error: f64,
    /// The part of the sphere that was never seen, and counts as dark.
    pub unseen: f64,
}

impl Lights {
    /// The error that decides: the larger one of the two, mostly that with walls.
    pub fn worst(&self) -> f64 {
        self.error.max(self.open_error)
    }

    /// Red, green and blue irradiance on a surface with this unit normal from which nothing is hidden.
    pub fn irradiance(&self, normal: DVec3) -> [f64; 3] {
        self.lights.iter().fold(self.remainder.irradiance(normal), |sum, light| {
            let cosine = normal.dot(light.direction).max(0.0);
            [0, 1, 2].map(|c| sum[c] + cosine * light.irradiance[c])
        })
    }

    /// As a table: direction, solid angle, radiance, share and whether it is a lower bound; then the remainder's coefficients.
    pub fn csv(&self) -> String {
        let mut csv = String::from(COLUMN_NAMES);
        for Light { direction, solid_angle_sr, irradiance, share, is_lower_bound } in &self.lights {
            let (longitude, latitude) = (
                direction.x.atan2(direction.z).to_degrees(),
                direction.y.clamp(-1.0, 1.0).asin().to_degrees(),
            );
            let [r, g, b] = irradiance.map(|value| value / solid_angle_sr);
            let DVec3 { x, y, z } = direction;
            let bound = u8::from(*is_lower_bound);
            let _ = writeln!(
                csv,
                "light,{longitude:.3},{latitude:.3},{x:.6},{y:.6},{z:.6},{solid_angle_sr:.6e},{r:.6e},{g:.6e},{b:.6e},{share:.5},{bound}"
            );
        }
        let share = 1.0 - self.lights.iter().map(|light| light.share).sum::<f64>();
        for (i, [r, g, b]) in self.remainder.coefficients().iter().enumerate() {
            let (order, share) = (i.isqrt(), if i == 0 { share.max(0.0) } else { 0.0 });
            let degree = i as i64 - (order * order + order) as i64;
            let _ = writeln!(csv, "harmonic {order} {degree},,,,,,,{r:.6e},{g:.6e},{b:.6e},{share:.5},0");
        }
        csv
    }
}

/// Finds the fewest lights, at most `most`, whose irradiance is off by no more than `tolerance` (relative, root mean square, see
/// [`Lights::worst`]). Where `most` do not suffice, it is the set of at most so many that leaves least.
///
/// # Errors
/// [`Error::Request`] for a map without light.
pub fn lights(map: &EnvironmentMap, method: Method, tolerance: f64, most: usize) -> Result<Lights> {
    let blocks = Blocks::of(map, method == Method::MedianCut);
    let all: f64 = blocks.all.iter().map(|(_, radiance)| luminance(*radiance)).sum();
    if !(all > 0.0 && all.is_finite()) {
        return Err(Error::request("the map holds no light", "photograph the room with longer exposures"));
    }
    let most = most.max(1);
    let truth = Irradiance::of(blocks.all.iter().copied());
    let highest = match method {
        Method::MedianCut => None,
        Method::Joined(order) => Some(order.min(Remainder::MOST_ORDER)),
    };
    let fit = highest.map(|_| Fit::new());
    let made = |sums: &[Sum], order: Option<usize>| {
        let mut lights: Vec<Light> = sums.iter().map(|sum| sum.light(all)).collect();
        lights.sort_by(|a, b| b.share.total_cmp(&a.share));
        let rest = truth.without(&Irradiance::of(lights.iter().map(|l| (l.direction, l.irradiance))));
        let remainder = match (&fit, order) {
            (Some(fit), Some(order)) => fit.remainder(&rest, order),
            _ => Remainder::none(),
        };
        let rest = match &fit {
            Some(fit) => rest.without(&fit.irradiance(&remainder)),
            None => rest,
        };
        let (error, open_error) = (rest.size() / truth.size(), rest.open_size() / truth.open_size());
        Lights { lights, remainder, error, open_error, unseen: blocks.unseen }
    };
    let Some(highest) = highest else {
        let mut best: Option<Lights> = None;
        for count in 1..=most {
            let found = made(&blocks.cut(count), None);
            let is_enough = found.worst() <= tolerance;
            if best.as_ref().is_none_or(|best| found.worst() < best.worst()) {
                best = Some(found);
            }
            if is_enough {
                break;
            }
        }
        return Ok(best.unwrap_or_else(|| made(&[], None)));
    };
    let mut best = (made(&[], Some(highest)), vec![]);
    // The same road from many to none whatever is allowed. On the way down the error may rise and fall again (one light is one point:
    // a few of them do more harm to an even sky behind walls than none), so it is walked to its end.
    let mut sums = if best.0.worst() <= tolerance { vec![] } else { blocks.cut(REGIONS) };
    let mut found = None;
    while !sums.is_empty() {
        if sums.len() <= most {
            let found = found.take().unwrap_or_else(|| made(&sums, Some(highest)));
            if found.worst() < best.0.worst() || found.worst() <= tolerance {
                best = (found, sums.clone());
            }
        }
        let mut joined = sums.clone();
        join(&mut joined);
        if sums.len() > SEARCHED {
            sums = joined;
            continue;
        }
        // What is wide and dim the remainder may tell as well.
        let mut without = sums;
        let radiance = |sum: &Sum| luminance(sum.irradiance) / sum.solid_angle_sr();
        let dimmest =
            (0..without.len()).min_by(|a, b| radiance(&without[*a]).total_cmp(&radiance(&without[*b])));
        dimmest.map(|at| without.swap_remove(at));
        let (by_joining, by_leaving) =
            rayon::join(|| made(&joined, Some(highest)), || made(&without, Some(highest)));
        // What costs next to nothing is joined: a lamp's own parts are not left to what is smooth.
        let is_nothing = 0.25 * tolerance;
        let (next, left) = match by_joining.worst() < by_leaving.worst().max(is_nothing) {
            true => (by_joining, joined),
            false => (by_leaving, without),
        };
        (found, sums) = (Some(next), left);
    }
    if best.0.worst() <= tolerance {
        let mut smaller = (0..highest).map(|order| made(&best.1, Some(order)));
        best.0 = smaller.find(|found| found.worst() <= tolerance).unwrap_or(best.0);
    }
    Ok(best.0)
}

/// Joins the two that cost least; a last one is left to the remainder.
fn join(sums: &mut Vec<Sum>) {
    if sums.len() < 2 {
        sums.clear();
        return;
    }
    let nearest = (0..sums.len() - 1).into_par_iter().map(|i| {
        let costs = (i + 1..sums.len()).map(|k| (sums[i].cost(&sums[k]), i, k));
        costs.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, i, i))
    });
    let Some((_, i, k)) = nearest.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
    let joined = sums[i].plus(sums[k]);
    sums.swap_remove(k);
    sums[i] = joined;
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

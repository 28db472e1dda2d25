//! From maps to the surfaces: every texel looks through the capture points at which it can be seen.

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::charts::Charts;
use super::model::Model;
use super::tree::Tree;
use crate::environment::lattice::evenly;
use crate::environment::{EnvironmentMap, Flag, Unit};
use crate::progress::Progress;
use crate::{Error, Result};

/// Places across a texel at which it is looked at, at most, where it is larger than the map's pixels.
const PLACES: usize = 6;
/// A face is not seen from so near to its own plane, sine of the angle.
const GRAZING: f64 = 0.01;
/// What is hidden by less than this part of the model's size is not hidden: corners and edges are touched, not passed.
const TOUCHED: f64 = 1e-5;
/// Directions in which holes are looked for.
const DIRECTIONS: usize = 4000;
/// Texels that two maps must share for the one to tell the other's scale.
const COMMON: usize = 50;
/// Maps contradict each other where they are further apart, as a factor.
const CONTRARY: f64 = 1.3;

/// A map and where in the room it was taken.
#[derive(Debug, Clone, Copy)]
pub struct Capture<'a> {
    /// Radiance from every direction.
    pub map: &'a EnvironmentMap,
    /// Where the camera turned, in the model's frame, metres.
    pub centre_m: DVec3,
    /// Takes directions of the model's frame to those of the map.
    pub map_from_model: DQuat,
}

/// A model with radiance on its surfaces.
pub struct Room {
    /// Its triangles.
    pub model: Model,
    /// Where they lie in the texture.
    pub charts: Charts,
    /// Linear red, green and blue of each texel; 0 where nothing is known.
    pub radiance: Vec<[f32; 3]>,
    /// [`EnvironmentMap`]'s flags, and [`Room::NO_SURFACE`], [`Room::BEHIND`] and [`Room::CONTRARY`].
    pub flags: Vec<Flag>,
    /// What the radiance is counted in: the first map's unit, whose scale the others take.
    pub unit: Unit,
    /// What the user should know, a sentence each.
    pub notes: Vec<String>,
    pub(super) tree: Tree,
}

impl Room {
    /// No part of the model lies at this texel.
    pub const NO_SURFACE: Flag = 8;
    /// Seen from behind: the face is turned the wrong way, or it is a sheet.
    pub const BEHIND: Flag = 16;
    /// Two maps see different radiance here: it shines, has moved, or the maps are not where they are said to be.
    pub const CONTRARY: Flag = 32;

    /// Where on the model a texel is.
    pub(super) fn place(&self, face: usize, texel: usize) -> DVec3 {
        place(&self.model, face, self.charts.weights(face, at(&self.charts, texel)))
    }

    /// The map that a camera turning at `centre_m` would see, in the model's axes; what meets no surface, or one that no map has seen,
    /// is unseen.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where `progress` says so.
    pub fn look(
        &self,
        centre_m: DVec3,
        size: crate::geometry::LatLong,
        progress: &dyn Progress,
    ) -> Result<EnvironmentMap> {
        let done = AtomicUsize::new(0);
        let rows: Vec<Vec<([f32; 3], Flag)>> = (0..size.height())
            .into_par_iter()
            .map(|row| {
                progress.step(done.fetch_add(1, Ordering::Relaxed), size.height())?;
                let look = |column: usize| {
                    let direction = size.direction(DVec2::new(column as f64, row as f64));
                    let Some(hit) = self.tree.hit(centre_m, direction, f64::INFINITY) else {
                        return ([0.0; 3], EnvironmentMap::UNSEEN);
                    };
                    self.sample(hit.face, hit.weights)
                };
                Ok((0..size.width()).map(look).collect())
            })
            .collect::<Result<_>>()?;
        let (radiance, flags) = rows.into_iter().flatten().unzip();
        Ok(EnvironmentMap {
            size,
            radiance,
            variance: vec![],
            coverage: vec![],
            flags,
            unit: self.unit,
            curve: vec![],
        })
    }

    /// The radiance at a place of a face, between the texels that show this face and are known.
    fn sample(&self, face: usize, weights: [f64; 2]) -> ([f32; 3], Flag) {
        let point = self.charts.at(face, weights);
        let (low, part) = (point.floor(), point - point.floor());
        let (mut sum, mut all, mut flags) = ([0.0; 3], 0.0, 0);
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (x, y) = (low.x as i64 + i, low.y as i64 + j);
            let side = i64::from(self.charts.size);
            if !(0..side).contains(&x) || !(0..side).contains(&y) {
                continue;
            }
            let texel = (y * side + x) as usize;
            let unknown = self.flags[texel] & (EnvironmentMap::UNSEEN | Self::NO_SURFACE) != 0;
            if unknown || self.charts.face(texel) != Some(face) {
                continue;
            }
            let share = |part: f64, step: i64| if step == 1 { part } else { 1.0 - part };
            // A texel's own centre on the border of four must not count for nothing.
            let weight = (share(part.x, i) * share(part.y, j)).max(1e-9) as f32;
            (0..3).for_each(|c| sum[c] += weight * self.radiance[texel][c]);
            all += weight;
            flags |= self.flags[texel];
        }
        if all > 0.0 {
            (sum.map(|sum| sum / all), flags & (EnvironmentMap::LOWER_BOUND | EnvironmentMap::FILLED))
        } else {
            ([0.0; 3], EnvironmentMap::UNSEEN)
        }
    }
}

fn at(charts: &Charts, texel: usize) -> DVec2 {
    let side = charts.size as usize;
    DVec2::new((texel % side) as f64, (texel / side) as f64)
}

fn place(model: &Model, face: usize, [u, v]: [f64; 2]) -> DVec3 {
    let [a, b, c] = model.corners(face);
    a + u * (b - a) + v * (c - a)
}

/// What one map says of a texel.
#[derive(Clone, Copy, Default)]
struct Seen {
    radiance: [f32; 3],
    /// The solid angle of a square metre there, as far as it is not hidden; 0 where nothing is seen.
    weight: f32,
    flags: Flag,
}

/// Puts maps on a model, with a texture of `size` x `size` texels. A texel is the mean of what the maps see of it, by the solid
/// angle that it has for them; a further map takes its scale from what it shares with those before it.
///
/// # Errors
/// [`Error::Request`] for no map, one without light or with a pixel that is negative or infinite, a capture point that is none,
/// a texture too small or too large; [`Error::Interrupted`].
pub fn texture(model: Model, captures: &[Capture], size: u32, progress: &dyn Progress) -> Result<Room> {
    let model = model.checked()?;
    if captures.is_empty() {
        return Err(Error::request(
            "no map of the room",
            "give at least one, with the place where it was taken",
        ));
    }
    if !(16..=8192).contains(&size) {
        return Err(Error::request(format!("a texture of {size}x{size} texels"), "choose 16 to 8192"));
    }
    for (number, capture) in captures.iter().enumerate() {
        check(number + 1, capture)?;
    }
    let (charts, why) = Charts::new(&model, size)?;
    let tree = Tree::new(&model);
    let mut notes = model.notes.clone();
    // A model that was read has been looked at before.
    notes.dedup();
    notes.extend(why);
    let count = (size * size) as usize;
    let total = captures.len() * size as usize;
    let mut all: Vec<Vec<Seen>> = vec![];
    for (number, capture) in captures.iter().enumerate() {
        let lost = (0..DIRECTIONS)
            .into_par_iter()
            .filter(|&i| tree.hit(capture.centre_m, evenly(i, DIRECTIONS), f64::INFINITY).is_none());
        let lost = lost.count() as f64 / DIRECTIONS as f64;
        if lost > 0.0 {
            notes.push(format!(
                "around the place of map {} {:.1} % of the directions meet no surface: the model has holes there, or the place lies outside",
                number + 1,
                100.0 * lost
            ));
        }
        let done = AtomicUsize::new(number * size as usize);
        let rows: Vec<Vec<Seen>> = (0..size as usize)
            .into_par_iter()
            .map(|row| {
                progress.step(done.fetch_add(1, Ordering::Relaxed), total)?;
                let look = |column: usize| {
                    let texel = row * size as usize + column;
                    charts.face(texel).map_or_else(Seen::default, |face| {
                        look(&model, &charts, &tree, capture, (face, texel))
                    })
                };
                Ok((0..size as usize).map(look).collect())
            })
            .collect::<Result<_>>()?;
        let mut seen: Vec<Seen> = rows.into_iter().flatten().collect();
        if number > 0 {
            notes.push(scale(&all, &mut seen, number + 1));
        }
        all.push(seen);
    }
    let mut room = Room {
        model,
        charts,
        radiance: vec![[0.0; 3]; count],
        flags: vec![Room::NO_SURFACE; count],
        unit: captures[0].map.unit,
        notes,
        tree,
    };
    for texel in 0..count {
        if room.charts.face(texel).is_none() {
            continue;
        }
        let mean = mean(&all, texel);
        room.flags[texel] = mean.flags | if mean.weight > 0.0 { 0 } else { EnvironmentMap::UNSEEN };
        room.radiance[texel] = mean.radiance;
    }
    room.note();
    Ok(room)
}

fn check(number: usize, Capture { map, centre_m, map_from_model }: &Capture) -> Result<()> {
    if !centre_m.is_finite() || !map_from_model.is_normalized() {
        return Err(Error::request(
            format!("map {number} was taken at {centre_m}"),
            "give the place in metres: x,y,z",
        ));
    }
    let wrong =
        map.radiance.iter().position(|pixel| !pixel.iter().all(|value| value.is_finite() && *value >= 0.0));
    if let Some(at) = wrong {
        let what = format!("map {number} holds {:?} in pixel {at}", map.radiance[at]);
        return Err(Error::request(what, "give a map of radiance, which is finite and not negative"));
    }
    if map.radiance.iter().flatten().all(|value| *value == 0.0) {
        return Err(Error::request(
            format!("map {number} holds no light"),
            "photograph the room with longer exposures",
        ));
    }
    Ok(())
}

fn look(
    model: &Model,
    charts: &Charts,
    tree: &Tree,
    capture: &Capture,
    (face, texel): (usize, usize),
) -> Seen {
    let middle = at(charts, texel);
    let centre = place(model, face, charts.weights(face, middle));
    let away = centre - capture.centre_m;
    let distance = away.length();
    let cosine = model.normal(face).dot(away) / distance;
    if cosine.abs() < GRAZING || distance == 0.0 {
        return Seen::default();
    }
    let [a, b, c] = charts.corners[face];
    let texels = 0.5 * (b - a).perp_dot(c - a).abs().max(f64::MIN_POSITIVE);
    let side_m = (model.area_m2(face) / texels).sqrt();
    let pixel = std::f64::consts::PI / capture.map.size.height() as f64;
    let places = ((side_m / distance / pixel).ceil() as usize).clamp(1, PLACES);
    let tolerance = TOUCHED * model.size_m();
    let middle_m = model.corners(face).iter().sum::<DVec3>() / 3.0;
    let (mut sum, mut all, mut flags) = ([0f64; 3], 0.0, 0);
    for i in 0..places * places {
        let step = |k: usize| (k as f64 + 0.5) / places as f64 - 0.5;
        let point = middle + DVec2::new(step(i % places), step(i / places));
        let point = place(model, face, charts.weights(face, point));
        // Not on an edge, which is the next face's as well.
        let inward = middle_m - point;
        let point = point + inward * (20.0 * tolerance / inward.length()).clamp(1e-3, 0.3);
        let ray = point - capture.centre_m;
        let length = ray.length();
        if tree.hit(capture.centre_m, ray, 1.0 - tolerance / length).is_some_and(|hit| hit.face != face) {
            continue;
        }
        let (radiance, weight, flag) = capture.map.toward(capture.map_from_model * ray);
        (0..3).for_each(|c| sum[c] += weight * radiance[c]);
        all += weight;
        flags |= flag;
    }
    // Half of it hidden: what is seen there is rather the border of what hides it.
    let visible = all / (places * places) as f64;
    if visible < 0.5 {
        return Seen::default();
    }
    Seen {
        radiance: sum.map(|sum| (sum / all) as f32),
        weight: (visible * cosine.abs() / (distance * distance)) as f32,
        flags: flags | if cosine > 0.0 { Room::BEHIND } else { 0 },
    }
}

/// The mean of what maps see of a texel.
fn mean(all: &[Vec<Seen>], texel: usize) -> Seen {
    // What was measured stands against any bound or guess.
    const DOUBT: Flag = EnvironmentMap::LOWER_BOUND | EnvironmentMap::FILLED;
    let is_seen = |seen: &Seen| seen.weight > 0.0;
    let is_sure = |seen: &Seen| is_seen(seen) && seen.flags & DOUBT == 0;
    let any_sure = all.iter().any(|map| is_sure(&map[texel]));
    let seen = || {
        all.iter()
            .map(|map| map[texel])
            .filter(move |seen| if any_sure { is_sure(seen) } else { is_seen(seen) })
    };
    let weight: f32 = seen().map(|seen| seen.weight).sum();
    if weight <= 0.0 {
        return Seen::default();
    }
    let radiance = [0, 1, 2].map(|c| seen().map(|seen| seen.weight * seen.radiance[c]).sum::<f32>() / weight);
    let bright = |seen: Seen| seen.radiance.iter().sum::<f32>();
    let (least, most) =
        seen().fold((f32::INFINITY, 0f32), |(a, b), seen| (a.min(bright(seen)), b.max(bright(seen))));
    let mut flags = seen().fold(0, |flags, seen| flags | seen.flags);
    if seen().count() > 1 && f64::from(most) > CONTRARY * f64::from(least) {
        flags |= Room::CONTRARY;
    }
    Seen { radiance, weight, flags }
}

/// Brings a further map to the scale of those before it, by the median over the texels that both see, and says so.
fn scale(all: &[Vec<Seen>], seen: &mut [Seen], number: usize) -> String {
    let mut ratios: Vec<f64> = (0..seen.len())
        .filter_map(|texel| {
            let (own, other) = (seen[texel], mean(all, texel));
            let is_measured = own.weight > 0.0
                && other.weight > 0.0
                && (own.flags | other.flags) & (EnvironmentMap::LOWER_BOUND | EnvironmentMap::FILLED) == 0;
            let bright = |seen: Seen| f64::from(seen.radiance.iter().sum::<f32>());
            (is_measured && bright(own) > 0.0 && bright(other) > 0.0).then(|| bright(other) / bright(own))
        })
        .collect();
    if ratios.len() < COMMON {
        return format!(
            "map {number} shares next to no texel with those before it: its scale was taken as it is"
        );
    }
    let middle = ratios.len() / 2;
    let (_, factor, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
    let factor = *factor;
    seen.iter_mut().for_each(|seen| seen.radiance = seen.radiance.map(|value| value * factor as f32));
    format!(
        "map {number} was multiplied by {factor:.3}, the median over the texels that it shares with those before it"
    )
}

impl Room {
    /// The part of the model's area whose texels have one of these flags.
    pub fn share(&self, flags: Flag) -> f64 {
        let area = |texel: usize| f64::from(self.charts.area_m2[texel]);
        let with =
            (0..self.flags.len()).filter(|&texel| self.flags[texel] & flags != 0).map(area).sum::<f64>();
        // A sum of nothing is -0.
        (with / (0..self.flags.len()).map(area).sum::<f64>()).max(0.0)
    }

    fn note(&mut self) {
        for (flag, what) in [
            (
                Self::BEHIND,
                "was seen from behind: faces are turned the wrong way, or are sheets; they are flagged",
            ),
            (
                Self::CONTRARY,
                "looks different from two places: it shines, has moved, or a map is not where it is said to be; it is flagged",
            ),
        ] {
            let share = self.share(flag);
            if share > 0.0 {
                self.notes.push(format!("{:.1} % of the surface {what}", 100.0 * share));
            }
        }
    }
}

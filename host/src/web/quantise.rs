//! Coefficients as small whole numbers, as coarse as a picture allows.

use glam::{DVec2, Vec3};
use serde_json::{Value, json};

use crate::Result;
use crate::fit::Model;
use crate::parameter_map::ParameterMap;
use crate::render::{expose, gamma_for_median};
use crate::sampling::spiral;
use crate::shader::Stored;

/// What a number stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// The number times the step.
    Linear,
    /// Its square (with its sign) times the step's: finer where it is dark.
    Root,
    /// e to the power of the number times the step.
    Logarithm,
    /// Two numbers for the three components of a unit vector: where it meets an octahedron, unfolded.
    Direction,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Root => "root",
            Self::Logarithm => "logarithm",
            Self::Direction => "direction",
        }
    }
}

/// Some parameters of a model that are quantised alike, each colour beside the others.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Group {
    kind: Kind,
    /// The first parameter, and how many there are.
    first: usize,
    count: usize,
    /// Of one whole number.
    step: f32,
}

/// One model's texels.
#[derive(Debug, Clone, PartialEq)]
struct Part {
    model: Model,
    groups: Vec<Group>,
    /// How many texels have a fit of their own, those of a palette entry counted once.
    slots: usize,
    /// Plane after plane: for each whole number of a fit, those of all slots.
    planes: Vec<Vec<i16>>,
}

/// A map with coefficients as whole numbers of steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantised {
    /// Gamma of the exposure in which the error is measured: half grey for the median radiance.
    pub gamma: f32,
    /// Mean absolute difference that quantisation makes to exposed levels, of 255.
    pub error_255: f64,
    /// The map that the whole numbers stand for.
    pub map: ParameterMap,
    parts: Vec<Part>,
    /// For each texel its model, and its palette entry (both absent where all are 0).
    choice: Vec<u8>,
    palette: Vec<u8>,
}

/// In so many texels, spread over the surface, and directions the error is measured.
const TEXELS: usize = 2000;
const DIRECTIONS: usize = 24;

/// The steps for a fineness of 1: one of 255 at the median, about.
fn groups(model: &Model, median: f32, fineness: f32) -> Vec<Group> {
    // At half grey a level of 255 is 1 / (255 ln 2 / 2) of the radiance.
    let level = median * fineness / 88.0;
    let angle = 0.002 * fineness;
    let group = |kind, first, count, step| Group { kind, first, count, step };
    let colour = |first| group(Kind::Root, first, 3, level / (2.0 * median.sqrt()));
    match model {
        Model::Constant => vec![colour(0)],
        Model::Phong { lobes } => {
            let lobe = |lobe: usize| {
                let first = 3 + 7 * lobe;
                [
                    colour(first),
                    group(Kind::Logarithm, first + 3, 1, 0.01 * fineness),
                    group(Kind::Direction, first + 4, 3, angle),
                ]
            };
            std::iter::once(colour(0)).chain((0..usize::from(*lobes)).flat_map(lobe)).collect()
        }
        Model::SharedPhong { lobes } => {
            let lobe = |lobe: usize| [colour(4 + 6 * lobe), group(Kind::Direction, 7 + 6 * lobe, 3, angle)];
            let shared = [colour(0), group(Kind::Logarithm, 3, 1, 0.01 * fineness)];
            shared.into_iter().chain((0..usize::from(*lobes)).flat_map(lobe)).collect()
        }
        Model::LogQuadratic => vec![group(Kind::Linear, 0, 21, 0.005 * fineness)],
        // The functions are orthonormal: an error counts alike in each.
        Model::Harmonics { order, method } => {
            vec![group(Kind::Linear, 0, 3 * method.count(*order), level)]
        }
    }
}

/// Where a unit vector meets the octahedron |x| + |y| + |z| = 1, its lower half folded out.
fn octahedral(v: Vec3) -> [f32; 2] {
    let sum = (v.x.abs() + v.y.abs() + v.z.abs()).max(1e-30);
    let (x, y) = (v.x / sum, v.y / sum);
    if v.z >= 0.0 { [x, y] } else { [(1.0 - y.abs()) * 1f32.copysign(x), (1.0 - x.abs()) * 1f32.copysign(y)] }
}

fn unit_vector([x, y]: [f32; 2]) -> Vec3 {
    let z = 1.0 - x.abs() - y.abs();
    let (x, y) = if z >= 0.0 {
        (x, y)
    } else {
        ((1.0 - y.abs()) * 1f32.copysign(x), (1.0 - x.abs()) * 1f32.copysign(y))
    };
    Vec3::new(x, y, z).normalize_or(Vec3::Z)
}

impl Group {
    fn whole(&self, values: &[f32]) -> Vec<i16> {
        let round = |value: f32| (value / self.step).round().clamp(-32767.0, 32767.0) as i16;
        match self.kind {
            Kind::Linear => values.iter().map(|value| round(*value)).collect(),
            Kind::Root => values.iter().map(|value| round(value.abs().sqrt().copysign(*value))).collect(),
            Kind::Logarithm => values.iter().map(|value| round(value.max(1e-3).ln())).collect(),
            Kind::Direction => octahedral(Vec3::new(values[0], values[1], values[2])).map(round).to_vec(),
        }
    }

    fn values(&self, whole: &[i16]) -> Vec<f32> {
        let back = |whole: &i16| f32::from(*whole) * self.step;
        match self.kind {
            Kind::Linear => whole.iter().map(back).collect(),
            Kind::Root => whole.iter().map(|whole| back(whole) * back(whole).abs()).collect(),
            Kind::Logarithm => whole.iter().map(|whole| back(whole).exp()).collect(),
            Kind::Direction => unit_vector([back(&whole[0]), back(&whole[1])]).to_array().to_vec(),
        }
    }

    /// How many whole numbers it takes.
    fn planes(&self) -> usize {
        if self.kind == Kind::Direction { 2 } else { self.count }
    }
}

impl Quantised {
    /// The gamma that shows the median radiance of a map, over many directions, half grey.
    ///
    /// # Errors
    /// [`Error::Request`](crate::Error::Request) when the radiance has no median.
    pub fn gamma_of(map: &ParameterMap) -> Result<f32> {
        Ok(Probe::new(map)?.gamma)
    }

    /// The coarsest that costs at most `allowed_255` (mean absolute difference of exposed levels, of 255).
    ///
    /// # Errors
    /// [`Error::Request`](crate::Error::Request) when the map's radiance has no positive median, or 16 bits do not suffice.
    pub fn within(map: &ParameterMap, allowed_255: f64) -> Result<Self> {
        let probe = Probe::new(map)?;
        let mut fineness = 1.0;
        // The error is nearly proportional to the step: two or three corrections suffice.
        let mut found = Self::with_fineness(map, &probe, fineness);
        for _ in 0..12 {
            if found.error_255 <= allowed_255 && found.error_255 > 0.85 * allowed_255 {
                break;
            }
            let factor = (0.93 * allowed_255 / found.error_255.max(1e-3)).clamp(0.1, 4.0) as f32;
            if factor > 1.0 && fineness * factor > 16.0 {
                break;
            }
            fineness *= factor;
            found = Self::with_fineness(map, &probe, fineness);
        }
        if found.error_255 > allowed_255 {
            return Err(crate::Error::request(
                format!(
                    "{} cannot be told in 16 bits to {allowed_255} of 255, but to {:.1}",
                    map.name(),
                    found.error_255
                ),
                "export another model of this surface",
            ));
        }
        Ok(found)
    }

    fn with_fineness(map: &ParameterMap, probe: &Probe, fineness: f32) -> Self {
        let mut parts: Vec<Part> = map
            .models
            .iter()
            .map(|model| {
                let groups = groups(model, probe.median, fineness);
                let planes = groups.iter().map(Group::planes).sum();
                Part { model: *model, groups, slots: 0, planes: vec![vec![]; planes] }
            })
            .collect();
        let (stride, texels) = (map.stride(), map.texels.count());
        let mut back = ParameterMap { uncertainty: None, ..map.clone() };
        let mut entries: [Option<usize>; 256] = [None; 256];
        for texel in 0..texels {
            let number = map.choice.get(texel).map_or(0, |choice| usize::from(*choice));
            let entry = map.palette().get(texel).map_or(0, |entry| usize::from(*entry));
            if let Some(first) = entries[entry].filter(|_| entry > 0) {
                back.parameters.copy_within(first * stride..(first + 1) * stride, texel * stride);
                continue;
            }
            entries[entry] = Some(texel);
            let (part, mut plane) = (&mut parts[number], 0);
            part.slots += 1;
            for group in &part.groups {
                let range = texel * stride + group.first..texel * stride + group.first + group.count;
                let whole = group.whole(&map.parameters[range.clone()]);
                back.parameters[range].copy_from_slice(&group.values(&whole));
                for value in whole {
                    part.planes[plane].push(value);
                    plane += 1;
                }
            }
        }
        Self {
            gamma: probe.gamma,
            error_255: probe.error_255(map, &back),
            map: back,
            parts,
            choice: map.choice.clone(),
            palette: map.palette().to_vec(),
        }
    }

    /// How the page finds its way in [`Quantised::compressed`].
    pub(super) fn layout(&self, stored: &[Stored]) -> Value {
        let part = |(part, stored): (&Part, &Stored)| {
            let group = |group: &Group| json!({ "kind": group.kind.name(), "first": group.first, "count": group.count, "step": group.step });
            let order: Vec<usize> = match part.model {
                Model::Harmonics { order, method } => {
                    method.written(order).iter().map(|written| written.index).collect()
                }
                _ => vec![],
            };
            json!({
                "name": part.model.name(),
                "parameters": part.model.parameter_count(),
                "slots": part.slots,
                "groups": part.groups.iter().map(group).collect::<Vec<_>>(),
                // Of the harmonics, in the order in which the shader computes them.
                "order": order,
                "is_half": stored.is_half(),
            })
        };
        json!({
            "parts": self.parts.iter().zip(stored).map(part).collect::<Vec<_>>(),
            "has_choice": !self.choice.is_empty(),
            "has_palette": !self.palette.is_empty(),
        })
    }

    /// Choice and palette (a byte for each texel, where there is one), then plane after plane of every model: green as it is, red
    /// and blue as the difference from it, each as the difference from the slot before where that is smaller (a byte says so);
    /// the sign in the lowest bit, all low bytes before all high ones. Deflated (zlib).
    pub(super) fn compressed(&self) -> Vec<u8> {
        let mut bytes = self.choice.clone();
        bytes.extend(&self.palette);
        for part in &self.parts {
            let mut plane = 0;
            for group in &part.groups {
                let is_colour = group.count % 3 == 0 && group.kind != Kind::Direction;
                for i in 0..group.planes() {
                    let own = &part.planes[plane + i];
                    let from = (is_colour && i % 3 != 1).then(|| &part.planes[plane + i - i % 3 + 1]);
                    let less = |k: usize| own[k].wrapping_sub(from.map_or(0, |from| from[k]));
                    put(&mut bytes, &(0..own.len()).map(less).collect::<Vec<i16>>());
                }
                plane += group.planes();
            }
        }
        miniz_oxide::deflate::compress_to_vec_zlib(&bytes, 9)
    }
}

fn put(bytes: &mut Vec<u8>, values: &[i16]) {
    let size =
        |values: &mut dyn Iterator<Item = i16>| -> u64 { values.map(|v| u64::from(v.unsigned_abs())).sum() };
    let steps = || {
        std::iter::once(0).chain(values.iter().copied()).zip(values).map(|(before, v)| v.wrapping_sub(before))
    };
    let is_stepped = size(&mut steps()) < size(&mut values.iter().copied());
    bytes.push(u8::from(is_stepped));
    let chosen: Vec<i16> = if is_stepped { steps().collect() } else { values.to_vec() };
    let folded: Vec<[u8; 2]> = chosen.iter().map(|v| ((v << 1) ^ (v >> 15)).to_le_bytes()).collect();
    bytes.extend(folded.iter().map(|pair| pair[0]));
    bytes.extend(folded.iter().map(|pair| pair[1]));
}

/// Where the error is measured.
struct Probe {
    places: Vec<(u32, u32)>,
    directions: Vec<Vec3>,
    median: f32,
    gamma: f32,
}

impl Probe {
    fn new(map: &ParameterMap) -> Result<Self> {
        let directions = spiral(DIRECTIONS, 75f64.to_radians())?.iter().map(|d| d.as_vec3()).collect();
        let step = map.texels.count().div_ceil(TEXELS);
        let columns = map.texels.columns as usize;
        let places = (0..map.texels.count())
            .step_by(step)
            .map(|i| ((i % columns) as u32, (i / columns) as u32))
            .collect();
        let mut probe = Self { places, directions, median: 0.0, gamma: 1.0 };
        let seen: Vec<f32> =
            probe.radiance(map).as_flattened().iter().copied().filter(|l| *l > 0.0).collect();
        // A map that is black everywhere is shown as it is.
        probe.gamma = if seen.is_empty() { 1.0 } else { gamma_for_median(&seen)? };
        probe.median = std::f32::consts::LN_2 / probe.gamma;
        Ok(probe)
    }

    fn radiance(&self, map: &ParameterMap) -> Vec<[f32; 3]> {
        let at = |&(column, row): &(u32, u32)| DVec2::new(column.into(), row.into());
        self.directions
            .iter()
            .flat_map(|direction| self.places.iter().map(move |place| map.radiance_at(at(place), *direction)))
            .collect()
    }

    fn error_255(&self, map: &ParameterMap, other: &ParameterMap) -> f64 {
        let [a, b] = [map, other].map(|map| self.radiance(map));
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        let off = |(a, b): (&f32, &f32)| f64::from((expose(*a, self.gamma) - expose(*b, self.gamma)).abs());
        255.0 * pairs.map(off).sum::<f64>() / (3 * a.len()) as f64
    }
}

//! A parameter map as words that a shader loads.

use glam::Vec3;
use half::f16;

use crate::fit::Model;
use crate::geometry::{Surface, Texels};
use crate::parameter_map::ParameterMap;
use crate::{Error, Result};

/// A model, and how its coefficients are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stored {
    /// The model.
    pub model: Model,
    /// Of harmonics: floats, where half floats would be seen (large coefficients that nearly cancel), instead of half floats.
    pub is_wide: bool,
}

impl Stored {
    /// Whether coefficients are half floats.
    pub(crate) fn is_half(&self) -> bool {
        is_harmonic(&self.model) && !self.is_wide
    }

    /// How many vectors a texel takes.
    pub(super) fn vectors(&self) -> usize {
        self.model.parameter_count().div_ceil(if self.is_half() { 8 } else { 4 })
    }
}

/// A parameter map as the shader of [`source`](super::source) reads it.
#[derive(Debug, Clone, PartialEq)]
pub struct Packed {
    /// The sampled area.
    pub surface: Surface,
    /// How finely it is divided.
    pub texels: Texels,
    /// What the coefficients mean, and how they are stored.
    pub models: Vec<Stored>,
    /// Texel after texel from the top-left one: the number of its model (the upper 5 bits) and the place of its first vector in
    /// `coefficients`.
    pub places: Vec<u32>,
    /// Vectors of four words: harmonics as eight half floats in the order in which the shader computes the functions, R G B
    /// each, other models' parameters as four floats. Texels of one palette entry share them.
    pub coefficients: Vec<[u32; 4]>,
    /// What the half floats of harmonics are multiplied by: a power of two, so that neither dim nor bright scenes leave their range.
    pub scale: f32,
}

/// A vector's place has 27 bits.
const MOST_VECTORS: usize = 1 << 27;
/// A model's number has 5.
const MOST_MODELS: usize = 1 << 5;

pub(super) fn is_harmonic(model: &Model) -> bool {
    matches!(model, Model::Harmonics { .. })
}

/// Where each of a harmonic model's functions is among the parameters, in the shader's order.
fn order(model: &Model) -> Vec<usize> {
    match model {
        Model::Harmonics { order, method } => {
            method.written(*order).iter().map(|written| written.index).collect()
        }
        _ => vec![],
    }
}

/// Of so many texels, spread over the map, the half floats are tried.
const TRIED: usize = 4000;
/// What rounding may change, root mean square over all directions, of the median radiance; more texels than one in a hundred
/// make a model's coefficients wide.
const ROUNDING: f32 = 0.001;

/// Whether half floats of harmonics would be seen.
fn is_wide(map: &ParameterMap, number: usize, scale: f32) -> bool {
    let model = map.models[number];
    if !is_harmonic(&model) {
        return false;
    }
    let stride = map.stride();
    let own = |&texel: &usize| map.choice.get(texel).map_or(0, |choice| usize::from(*choice)) == number;
    let texels: Vec<usize> =
        (0..map.texels.count()).step_by(map.texels.count().div_ceil(TRIED)).filter(own).collect();
    let parameters = |texel: usize| &map.parameters[texel * stride..][..model.parameter_count()];
    let mut levels: Vec<f32> =
        texels.iter().map(|&texel| model.radiance(parameters(texel), Vec3::Z)[1]).collect();
    levels.sort_by(f32::total_cmp);
    let median = levels.get(levels.len() / 2).copied().unwrap_or_default();
    let rounding = |texel: &&usize| {
        let off = |value: &f32| (f16::from_f32(value / scale).to_f32() * scale - value).powi(2);
        // A unit of an orthonormal function is a quarter on average.
        0.28 * (parameters(**texel).iter().map(off).sum::<f32>() / 3.0).sqrt() > ROUNDING * median
    };
    100 * texels.iter().filter(rounding).count() > texels.len()
}

impl Packed {
    /// How many of [`Packed::coefficients`] stand in a row of the texture that holds them.
    pub const ROW: usize = 4096;

    /// Asks whether a shader can number a map's coefficients.
    ///
    /// # Errors
    /// [`Error::Request`] when it has too many models or texels for that.
    pub fn require(map: &ParameterMap) -> Result<()> {
        let vectors = map.texels.count() * map.stride().div_ceil(4);
        if vectors <= MOST_VECTORS && map.models.len() <= MOST_MODELS {
            return Ok(());
        }
        Err(Error::request(
            format!(
                "{}x{} texels of {} are more than a shader can number",
                map.texels.columns,
                map.texels.rows,
                map.name()
            ),
            "observe fewer texels, or fit a smaller model",
        ))
    }

    /// Packs a map.
    ///
    /// # Errors
    /// Those of [`Packed::require`].
    pub fn new(map: &ParameterMap) -> Result<Self> {
        Self::require(map)?;
        let (models, stride, palette) = (&map.models, map.stride(), map.palette());
        let choice = |texel: usize| map.choice.get(texel).map_or(0, |choice| usize::from(*choice));
        let largest = (0..map.texels.count())
            .filter(|&texel| is_harmonic(&models[choice(texel)]))
            .flat_map(|texel| &map.parameters[texel * stride..(texel + 1) * stride])
            .fold(0f32, |most, value| most.max(value.abs()));
        // The largest at a quarter of what a half float holds: small ones keep their digits.
        let scale =
            if largest > 0.0 { (largest / 16384.0).log2().ceil().clamp(-126.0, 126.0).exp2() } else { 1.0 };
        let orders: Vec<Vec<usize>> = models.iter().map(order).collect();
        let mut packed = Self {
            surface: map.surface,
            texels: map.texels,
            models: (0..models.len())
                .map(|number| Stored { model: models[number], is_wide: is_wide(map, number, scale) })
                .collect(),
            places: Vec::with_capacity(map.texels.count()),
            coefficients: vec![],
            scale,
        };
        let mut entries = [None; 256];
        for texel in 0..map.texels.count() {
            let entry = palette.get(texel).map_or(0, |entry| usize::from(*entry));
            let number = choice(texel);
            if let Some(place) = entries[entry].filter(|_| entry > 0) {
                packed.places.push(place);
                continue;
            }
            let place = packed.coefficients.len();
            let parameters = &map.parameters[texel * stride..][..models[number].parameter_count()];
            packed.push(number, &orders[number], parameters);
            let word = (number as u32) << 27 | place as u32;
            packed.places.push(word);
            entries[entry] = Some(word);
        }
        Ok(packed)
    }

    fn push(&mut self, number: usize, order: &[usize], parameters: &[f32]) {
        let in_order = order.iter().flat_map(|&index| &parameters[3 * index..3 * index + 3]);
        if self.models[number].is_half() {
            let halves: Vec<u32> =
                in_order.map(|value| u32::from(f16::from_f32(value / self.scale).to_bits())).collect();
            let word = |vector: &[u32], i: usize| {
                let half = |i: usize| vector.get(i).copied().unwrap_or(0);
                half(2 * i) | half(2 * i + 1) << 16
            };
            self.coefficients.extend(halves.chunks(8).map(|vector| std::array::from_fn(|i| word(vector, i))));
        } else {
            let floats: Vec<f32> =
                if order.is_empty() { parameters.to_vec() } else { in_order.copied().collect() };
            let word = |vector: &[f32], i: usize| vector.get(i).map_or(0, |value| value.to_bits());
            self.coefficients.extend(floats.chunks(4).map(|vector| std::array::from_fn(|i| word(vector, i))));
        }
    }

    /// Rows of the texture that holds the coefficients.
    pub fn rows(&self) -> usize {
        self.coefficients.len().div_ceil(Self::ROW).max(1)
    }
}

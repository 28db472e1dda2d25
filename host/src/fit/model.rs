//! What a model is called, what its coefficients mean, and what radiance they stand for.

use glam::Vec3;

use super::harmonics::{self, HarmonicsMethod};
use crate::{Error, Result};

/// A model of the radiance that leaves a texel, as a function of the direction to the viewer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// One RGB radiance for all directions.
    Constant,
    /// Kd + Σ Ks max(0, r·d)^m over 1 to 4 lobes, each with its own colour, shininess and direction.
    Phong {
        /// Number of lobes, 1 to 4.
        lobes: u8,
    },
    /// The same with one shininess for all lobes (thesis, equation 11.2).
    SharedPhong {
        /// Number of lobes, 2 to 4.
        lobes: u8,
    },
    /// exp of a quadratic in the direction's x and y, up to a greatest value: seven numbers for each channel. For few
    /// views in a narrow cone.
    LogQuadratic,
    /// Real harmonics below `order`: [`HarmonicsMethod::count`] coefficients for each channel (after the thesis, chapter
    /// 12).
    Harmonics {
        /// One more than the highest degree; see [`HarmonicsMethod::orders`].
        order: u8,
        /// How the coefficients are found.
        method: HarmonicsMethod,
    },
}

/// Shininess beyond which a lobe is narrower than any spacing of views can show.
pub(super) const SHININESS: std::ops::RangeInclusive<f64> = 1.0..=2000.0;

impl Model {
    /// Every model that has a name.
    pub fn all() -> Vec<Self> {
        let mut all = vec![Self::Constant, Self::LogQuadratic];
        all.extend((1..=4).map(|lobes| Self::Phong { lobes }));
        all.extend((2..=4).map(|lobes| Self::SharedPhong { lobes }));
        for method in HarmonicsMethod::ALL {
            all.extend(method.orders().map(|order| Self::Harmonics { order, method }));
        }
        all
    }

    /// The model of a name such as `phong` or `sh36`.
    ///
    /// # Errors
    /// [`Error::Request`] that lists the choices when the name is none of them.
    pub fn parse(name: &str) -> Result<Self> {
        Self::all().into_iter().find(|model| model.name() == name).ok_or_else(|| {
            let names: Vec<_> = Self::all().iter().map(Self::name).collect();
            Error::request(
                format!("there is no model called {name:?}"),
                format!("choose one of {}", names.join(", ")),
            )
        })
    }

    /// The name that [`Model::parse`] understands.
    pub fn name(&self) -> String {
        match self {
            Self::Constant => "constant".into(),
            Self::Phong { lobes: 1 } => "phong".into(),
            Self::Phong { lobes } => format!("phong{lobes}"),
            Self::SharedPhong { lobes } => format!("phong{lobes}-shared"),
            Self::LogQuadratic => "log-quadratic".into(),
            Self::Harmonics { order, method } => {
                let (prefix, suffix) = match method {
                    HarmonicsMethod::Mirrored => ("msh", ""),
                    HarmonicsMethod::Hemispherical => ("hsh", ""),
                    HarmonicsMethod::Smoothed => ("sh", ""),
                    HarmonicsMethod::ZeroHemisphere => ("sh", "-zero"),
                    HarmonicsMethod::Lsop => ("sh", "-lsop"),
                };
                format!("{prefix}{}{suffix}", method.count(*order))
            }
        }
    }

    /// How many numbers are kept for each texel.
    pub fn parameter_count(&self) -> usize {
        match self {
            Self::Constant => 3,
            Self::Phong { lobes } => 3 + 7 * usize::from(*lobes),
            Self::SharedPhong { lobes } => 4 + 6 * usize::from(*lobes),
            Self::LogQuadratic => 21,
            Self::Harmonics { order, method } => 3 * method.count(*order),
        }
    }

    /// How many unknowns one colour channel's curve has: the fewest views that can determine it.
    pub fn unknowns(&self) -> usize {
        match self {
            Self::Constant => 1,
            // Diffuse, and for each lobe specular, shininess and two angles.
            Self::Phong { lobes } => 1 + 4 * usize::from(*lobes),
            Self::SharedPhong { lobes } => 2 + 3 * usize::from(*lobes),
            Self::LogQuadratic => 6,
            Self::Harmonics { order, method } => method.count(*order),
        }
    }

    /// Memory of one texel's coefficients, bytes: half floats, single precision for logarithms.
    pub fn bytes_per_texel(&self) -> usize {
        if *self == Self::LogQuadratic { 4 * self.parameter_count() } else { 2 * self.parameter_count() }
    }

    /// One name for each parameter, in their order, as a stranger finds them in the file: `diffuse.R`, `shininess`,
    /// `lobe.X` (of the second lobe `lobe2.X`), `l2.m-1.R`.
    pub fn channel_names(&self) -> Vec<String> {
        let rgb = |base: &str| ["R", "G", "B"].map(|channel| format!("{base}.{channel}"));
        match self {
            Self::Constant => rgb("radiance").into(),
            Self::Phong { lobes } | Self::SharedPhong { lobes } => {
                let is_shared = matches!(self, Self::SharedPhong { .. });
                let mut names: Vec<_> = rgb("diffuse").into();
                names.extend(is_shared.then(|| "shininess".to_owned()));
                for lobe in 1..=*lobes {
                    let number = if lobe == 1 { String::new() } else { lobe.to_string() };
                    names.extend(rgb(&format!("specular{number}")));
                    names.extend((!is_shared).then(|| format!("shininess{number}")));
                    names.extend(["X", "Y", "Z"].map(|axis| format!("lobe{number}.{axis}")));
                }
                names
            }
            Self::LogQuadratic => ["log.1", "log.x", "log.y", "log.xx", "log.xy", "log.yy", "log.most"]
                .iter()
                .flat_map(|t| rgb(t))
                .collect(),
            Self::Harmonics { order, method } => {
                // Other functions than the spherical harmonics, so other names.
                let prefix = if *method == HarmonicsMethod::Hemispherical { "h" } else { "" };
                let names = method.basis().indices(usize::from(*order));
                names.flat_map(|(l, m)| rgb(&format!("{prefix}l{l}.m{m}"))).collect()
            }
        }
    }

    /// Linear RGB radiance toward `direction` (unit vector, surface frame) of one texel's `parameters`; never negative.
    pub fn radiance(&self, parameters: &[f32], direction: Vec3) -> [f32; 3] {
        match self {
            Self::Constant | Self::Phong { .. } => bounded(lobes(parameters, direction)),
            Self::SharedPhong { .. } => bounded(shared_lobes(parameters, direction)),
            _ => self.toward(direction).radiance(parameters),
        }
    }

    /// Prepares the evaluation of many texels toward one direction: harmonics compute their basis once.
    pub fn toward(&self, direction: Vec3) -> Toward {
        let mut toward = Toward { model: *self, direction, basis: [0.0; harmonics::MOST] };
        match self {
            Self::LogQuadratic => {
                toward.basis[..6].copy_from_slice(&super::log_quadratic::terms(direction).map(|t| t as f32))
            }
            Self::Harmonics { order, method } => {
                let mut basis = [0.0; harmonics::MOST];
                method.basis().at(usize::from(*order), direction.as_dvec3(), &mut basis);
                for (to, from) in toward.basis.iter_mut().zip(basis) {
                    *to = from as f32;
                }
            }
            Self::Constant | Self::Phong { .. } | Self::SharedPhong { .. } => {}
        }
        toward
    }

    /// The parameters of this model that give the same radiance in every direction.
    pub(super) fn constant(&self, radiance: [f32; 3]) -> Vec<f32> {
        let mut parameters = vec![0.0; self.parameter_count()];
        let first = match self {
            Self::Constant | Self::Phong { .. } | Self::SharedPhong { .. } => radiance,
            Self::LogQuadratic => radiance.map(|l| (f64::from(l).max(f64::MIN_POSITIVE).ln()) as f32),
            Self::Harmonics { method, .. } => {
                radiance.map(|l| (l * method.basis().one() as f32).min(f32::MAX))
            }
        };
        parameters[..3].copy_from_slice(&first);
        if *self == Self::LogQuadratic {
            parameters[18..].copy_from_slice(&first);
        }
        if let Self::Phong { .. } = self {
            for lobe in parameters[3..].chunks_exact_mut(7) {
                lobe[3..].copy_from_slice(&[1.0, 0.0, 0.0, 1.0]);
            }
        }
        if let Self::SharedPhong { .. } = self {
            parameters[3] = 1.0;
            for lobe in parameters[4..].chunks_exact_mut(6) {
                lobe[3..].copy_from_slice(&[0.0, 0.0, 1.0]);
            }
        }
        parameters
    }
}

/// A model evaluated toward one direction, for any number of texels.
#[derive(Debug, Clone)]
pub struct Toward {
    model: Model,
    direction: Vec3,
    basis: [f32; harmonics::MOST],
}

impl Toward {
    /// Linear RGB radiance of one texel's `parameters` (as many as [`Model::parameter_count`]); never negative.
    pub fn radiance(&self, parameters: &[f32]) -> [f32; 3] {
        let radiance = match self.model {
            Model::Constant | Model::Phong { .. } => lobes(parameters, self.direction),
            Model::SharedPhong { .. } => shared_lobes(parameters, self.direction),
            Model::LogQuadratic => {
                let log = self.sum(parameters, 6);
                std::array::from_fn(|c| log[c].min(parameters[18 + c]).exp())
            }
            Model::Harmonics { order, method } => self.sum(parameters, method.count(order)),
        };
        bounded(radiance)
    }

    fn sum(&self, parameters: &[f32], terms: usize) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for (basis, coefficients) in self.basis[..terms].iter().zip(parameters.chunks_exact(3)) {
            for (value, coefficient) in sum.iter_mut().zip(coefficients) {
                *value += basis * coefficient;
            }
        }
        sum
    }
}

/// Finite also where a hostile file says otherwise.
fn bounded(radiance: [f32; 3]) -> [f32; 3] {
    radiance.map(|value| value.clamp(0.0, f32::MAX))
}

/// A diffuse part and any number of lobes.
fn lobes(parameters: &[f32], direction: Vec3) -> [f32; 3] {
    let mut sum = [parameters[0], parameters[1], parameters[2]];
    for lobe in parameters[3..].chunks_exact(7) {
        let cosine = Vec3::new(lobe[4], lobe[5], lobe[6]).dot(direction).clamp(0.0, 1.0);
        let power = cosine.powf(lobe[3]);
        for (value, specular) in sum.iter_mut().zip(lobe) {
            *value += specular * power;
        }
    }
    sum
}

/// The same with one shininess for all.
fn shared_lobes(parameters: &[f32], direction: Vec3) -> [f32; 3] {
    let mut sum = [parameters[0], parameters[1], parameters[2]];
    for lobe in parameters[4..].chunks_exact(6) {
        let cosine = Vec3::new(lobe[3], lobe[4], lobe[5]).dot(direction).clamp(0.0, 1.0);
        let power = cosine.powf(parameters[3]);
        for (value, specular) in sum.iter_mut().zip(lobe) {
            *value += specular * power;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn names_are_inverse_to_parsing_and_unique() {
        let all = Model::all();
        assert_eq!(all.iter().map(Model::name).collect::<HashSet<_>>().len(), all.len());
        for model in all {
            assert_eq!(Model::parse(&model.name()).unwrap(), model);
        }
        let error = Model::parse("fong").unwrap_err().to_string();
        assert!(error.contains("fong") && error.contains("phong2") && error.contains("sh36-lsop"), "{error}");
    }

    #[test]
    fn every_parameter_has_a_channel_of_its_own() {
        for model in Model::all() {
            let names = model.channel_names();
            assert_eq!(names.len(), model.parameter_count(), "{}", model.name());
            assert_eq!(names.iter().collect::<HashSet<_>>().len(), names.len(), "{}", model.name());
        }
    }

    #[test]
    fn a_constant_looks_the_same_from_everywhere_in_every_model() {
        for model in Model::all() {
            let parameters = model.constant([0.3, 0.2, 5.0]);
            for direction in [Vec3::Z, Vec3::X, Vec3::new(0.48, -0.64, 0.6)] {
                let radiance = model.radiance(&parameters, direction);
                for (got, want) in radiance.iter().zip([0.3, 0.2, 5.0]) {
                    assert!((got / want - 1.0).abs() < 1e-5, "{}: {got} for {want}", model.name());
                }
            }
        }
    }
}

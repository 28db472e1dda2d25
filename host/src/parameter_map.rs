//! The parameter map: a model's coefficients for every texel, in a file that other programs open.

mod coverage;
mod exchange;
mod facts;
mod fitted;
pub(crate) mod memory;
mod resolution;
mod selected;

pub use coverage::{Within, coverage, together};
pub use fitted::fit_surface;
pub use resolution::{Coarser, coarser};
pub use selected::{Selection, select_surface};

use glam::{DVec2, Vec3};

use crate::fit::{BANDS, FitFlags, Model, Reason, zenith_band};

use crate::geometry::{Surface, Texels};

/// Coefficients for every texel of a surface, of one model or of the one that each texel needs.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterMap {
    /// The sampled area.
    pub surface: Surface,
    /// How finely it is divided.
    pub texels: Texels,
    /// What the coefficients mean: one model for all texels, or those that `choice` chooses from.
    pub models: Vec<Model>,
    /// Index into `models`, texel after texel from the top-left one; empty where there is one model.
    pub choice: Vec<u8>,
    /// Texel after texel from the top-left one, [`ParameterMap::stride`] values each; what a texel's model does not use is 0.
    pub parameters: Vec<f32>,
    /// How far each texel's coefficients can be trusted, where that is known.
    pub diagnostics: Option<Diagnostics>,
    /// Where the choice of models has measured it.
    pub uncertainty: Option<Uncertainty>,
}

/// How well each texel was fitted, texel after texel from the top-left one.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Diagnostics {
    /// Root mean square of (model − measured) / expected error; see [`TexelFit::residual`](crate::fit::TexelFit::residual).
    pub residual: Vec<f32>,
    /// Number of views that took part.
    pub views: Vec<u32>,
    /// What is doubtful.
    pub flags: Vec<FitFlags>,
    /// The names of the views that the fit has seen; empty in maps of which that is not known.
    pub seen: Vec<String>,
    /// The largest zenith angle of these views, from the centre of the surface, radians; what is farther down is extrapolated.
    pub zenith_rad: Option<f64>,
    /// By what light the radiance was divided that the fit has seen, see [`Header::photometry`](crate::observation::Header::photometry).
    pub photometry: Option<String>,
    /// Where each texel has a model of its own: index into `models` of the one that was nearly taken.
    pub runner_up: Vec<u8>,
    /// And why each texel has the one that it has.
    pub reason: Vec<Reason>,
    /// Texels with the same number above 0 have the same coefficients, an entry of the palette; empty where there is none.
    pub palette: Vec<u8>,
    /// The part of (radiance + [`Uncertainty::floor`]) within which 68 % of measurements in unseen directions lie, averaged over
    /// them; infinite where that is not known.
    pub sigma: Vec<f32>,
}

/// What turns [`Diagnostics::sigma`] into a standard deviation of radiance toward a direction.
#[derive(Debug, Clone, PartialEq)]
pub struct Uncertainty {
    /// Radiance.
    pub floor: f32,
    /// Per model a factor for each band of zeniths, 15 degrees wide.
    pub zenith: Vec<[f32; BANDS]>,
}

impl ParameterMap {
    /// How many numbers each texel has in `parameters`: as many as the largest model needs.
    pub fn stride(&self) -> usize {
        self.models.iter().map(Model::parameter_count).max().unwrap_or(0)
    }

    /// Which of `models` texel number `index` has.
    fn choice_at(&self, index: usize) -> usize {
        self.choice.get(index).map_or(0, |choice| usize::from(*choice))
    }

    /// The model and coefficients of texel (`column`, `row`).
    pub fn texel(&self, column: u32, row: u32) -> (Model, &[f32]) {
        let index = row as usize * self.texels.columns as usize + column as usize;
        let (model, start) = (self.models[self.choice_at(index)], index * self.stride());
        (model, &self.parameters[start..start + model.parameter_count()])
    }

    /// Standard deviation of what a measurement toward `direction` will differ by from the radiance predicted for texel
    /// (`column`, `row`), linear RGB: 68 % are within. `None` where nobody has measured it.
    pub fn sigma(&self, column: u32, row: u32, direction: Vec3) -> Option<[f32; 3]> {
        let (uncertainty, diagnostics) = (self.uncertainty.as_ref()?, self.diagnostics.as_ref()?);
        let index = row as usize * self.texels.columns as usize + column as usize;
        let (model, parameters) = self.texel(column, row);
        let factor =
            uncertainty.zenith[self.choice_at(index)][zenith_band(direction.z)] * diagnostics.sigma[index];
        let radiance = model.radiance(parameters, direction);
        factor.is_finite().then(|| radiance.map(|radiance| factor * (radiance + uncertainty.floor)))
    }

    /// The models' names, apart by blanks.
    pub fn name(&self) -> String {
        self.models.iter().map(Model::name).collect::<Vec<_>>().join(" ")
    }

    /// Memory that the texels' coefficients need on average, bytes; one more where each texel names its model or an entry of the
    /// palette, whose coefficients count once.
    pub fn bytes_per_texel(&self) -> f64 {
        let sizes: Vec<usize> = self.models.iter().map(Model::bytes_per_texel).collect();
        let (count, palette) = (self.texels.count(), self.palette());
        if self.choice.is_empty() && palette.is_empty() {
            return sizes.iter().sum::<usize>() as f64;
        }
        let mut counted = [false; 256];
        let counts = |texel: &usize| {
            let entry = palette.get(*texel).map_or(0, |entry| usize::from(*entry));
            entry == 0 || !std::mem::replace(&mut counted[entry], true)
        };
        let bytes = (0..count).filter(counts).map(|texel| sizes[self.choice_at(texel)]).sum::<usize>();
        1.0 + bytes as f64 / count as f64
    }

    /// See [`Diagnostics::palette`].
    pub fn palette(&self) -> &[u8] {
        self.diagnostics.as_ref().map_or(&[], |diagnostics| &diagnostics.palette)
    }

    /// Linear RGB radiance toward `direction` (unit vector, surface frame) at a fractional column and row (a texel's
    /// centre is an integer; see [`Surface::texel_at`]).
    ///
    /// The radiance of the four texels around is blended, never their coefficients: half way between two lobes lies
    /// no lobe. Beyond the outermost centres the border texels continue.
    pub fn radiance_at(&self, at: DVec2, direction: Vec3) -> [f32; 3] {
        let last = DVec2::new(f64::from(self.texels.columns - 1), f64::from(self.texels.rows - 1));
        let at = at.clamp(DVec2::ZERO, last);
        let (column, row) = (at.x.floor() as u32, at.y.floor() as u32);
        let (right, below) = ((at.x - at.x.floor()) as f32, (at.y - at.y.floor()) as f32);
        let (mut sum, mut prepared) = ([0.0; 3], None);
        for (row_step, row_share) in [(0, 1.0 - below), (1, below)] {
            for (column_step, column_share) in [(0, 1.0 - right), (1, right)] {
                let share = row_share * column_share;
                if share > 0.0 {
                    let (column, row) = (column + column_step, row + row_step);
                    let (model, parameters) = self.texel(column, row);
                    // Neighbours mostly have the same model.
                    if prepared.as_ref().is_none_or(|(of, _)| *of != model) {
                        prepared = Some((model, model.toward(direction)));
                    }
                    let radiance = prepared.iter().map(|(_, toward)| toward.radiance(parameters)).next();
                    let radiance = radiance.unwrap_or_default();
                    for c in 0..3 {
                        sum[c] += share * radiance[c];
                    }
                }
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_texels_radiance_is_blended_and_beyond_them_it_continues() {
        let map = ParameterMap {
            surface: Surface { width_m: 0.2, height_m: 0.1 },
            texels: Texels { columns: 2, rows: 2 },
            models: vec![Model::Constant],
            choice: vec![],
            parameters: [[1.0; 3], [3.0; 3], [5.0; 3], [7.0; 3]].concat(),
            diagnostics: None,
            uncertainty: None,
        };
        let mixed = ParameterMap {
            models: vec![Model::Phong { lobes: 1 }, Model::Constant],
            choice: vec![1; 4],
            parameters: map.parameters.chunks(3).flat_map(|rgb| [rgb, &[0.0; 7]].concat()).collect(),
            ..map.clone()
        };
        for (at, want) in
            [((0.0, 0.0), 1.0), ((0.5, 0.0), 2.0), ((0.5, 0.5), 4.0), ((1.0, 1.0), 7.0), ((9.0, -3.0), 3.0)]
        {
            let got = map.radiance_at(at.into(), Vec3::Z);
            assert!(got.iter().all(|l| (l - want).abs() < 1e-6), "{at:?}: {got:?}, not {want}");
            assert_eq!(mixed.radiance_at(at.into(), Vec3::Z), got);
        }
    }
}

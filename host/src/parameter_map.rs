//! The parameter map: a model's coefficients for every texel, in a file that other programs open.

mod exchange;
mod fitted;

pub use fitted::fit_surface;

use glam::{DVec2, Vec3};

use crate::fit::{FitFlags, Model};

use crate::geometry::{Surface, Texels};

/// Coefficients of one model for every texel of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterMap {
    /// The sampled area.
    pub surface: Surface,
    /// How finely it is divided.
    pub texels: Texels,
    /// What the coefficients mean.
    pub model: Model,
    /// Texel after texel from the top-left one, `model.parameter_count()` values each.
    pub parameters: Vec<f32>,
    /// How far each texel's coefficients can be trusted, where that is known.
    pub diagnostics: Option<Diagnostics>,
}

/// How well each texel was fitted, texel after texel from the top-left one.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Diagnostics {
    /// Root mean square of (model − measured) / expected error; see [`TexelFit::residual`].
    pub residual: Vec<f32>,
    /// Number of views that took part.
    pub views: Vec<u32>,
    /// What is doubtful.
    pub flags: Vec<FitFlags>,
}

impl ParameterMap {
    /// The coefficients of texel (`column`, `row`).
    pub fn texel(&self, column: u32, row: u32) -> &[f32] {
        let count = self.model.parameter_count();
        let index = row as usize * self.texels.columns as usize + column as usize;
        &self.parameters[index * count..(index + 1) * count]
    }

    /// Linear RGB radiance toward `direction` (unit vector, surface frame) at a fractional column and row (a texel's
    /// centre is an integer; see [`Surface::texel_at`]).
    ///
    /// The radiance of the four texels around is blended, never their coefficients: half way between two lobes lies
    /// no lobe. Beyond the outermost centres the border texels continue.
    pub fn radiance_at(&self, at: DVec2, direction: Vec3) -> [f32; 3] {
        let toward = self.model.toward(direction);
        let last = DVec2::new(f64::from(self.texels.columns - 1), f64::from(self.texels.rows - 1));
        let at = at.clamp(DVec2::ZERO, last);
        let (column, row) = (at.x.floor() as u32, at.y.floor() as u32);
        let (right, below) = ((at.x - at.x.floor()) as f32, (at.y - at.y.floor()) as f32);
        let mut sum = [0.0; 3];
        for (row_step, row_share) in [(0, 1.0 - below), (1, below)] {
            for (column_step, column_share) in [(0, 1.0 - right), (1, right)] {
                let share = row_share * column_share;
                if share > 0.0 {
                    let radiance = toward.radiance(self.texel(column + column_step, row + row_step));
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
            model: Model::Constant,
            parameters: [[1.0; 3], [3.0; 3], [5.0; 3], [7.0; 3]].concat(),
            diagnostics: None,
        };
        for (at, want) in
            [((0.0, 0.0), 1.0), ((0.5, 0.0), 2.0), ((0.5, 0.5), 4.0), ((1.0, 1.0), 7.0), ((9.0, -3.0), 3.0)]
        {
            let got = map.radiance_at(at.into(), Vec3::Z);
            assert!(got.iter().all(|l| (l - want).abs() < 1e-6), "{at:?}: {got:?}, not {want}");
        }
    }
}

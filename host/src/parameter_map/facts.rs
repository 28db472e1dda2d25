//! What a parameter map is, in lines for people.

use super::ParameterMap;

impl ParameterMap {
    /// What it is and where it came from, a line each.
    pub fn facts(&self) -> Vec<String> {
        let (width, height) = (1e3 * self.surface.width_m, 1e3 * self.surface.height_m);
        let mut facts = vec![
            format!("{}x{} texels on {width:.4} mm x {height:.4} mm", self.texels.columns, self.texels.rows),
            format!("{:.1} bytes per texel", self.bytes_per_texel()),
        ];
        if self.choice.is_empty() {
            facts.push(format!("model {}", self.name()));
        } else {
            for (index, model) in self.models.iter().enumerate() {
                let chosen = self.choice.iter().filter(|choice| usize::from(**choice) == index).count();
                if chosen == 0 {
                    continue;
                }
                let share = 100.0 * chosen as f64 / self.choice.len() as f64;
                facts.push(format!("{}: {share:.1} % of the texels", model.name()));
            }
        }
        if let Some(entries) = self.palette().iter().max().filter(|entries| **entries > 0) {
            facts.push(format!("a palette of {entries}"));
        }
        if let Some(diagnostics) = &self.diagnostics {
            match diagnostics.seen.len() {
                0 => {}
                1 => facts.push("fitted to 1 view".into()),
                views => facts.push(format!("fitted to {views} views")),
            }
            if let Some(zenith_rad) = diagnostics.zenith_rad {
                facts.push(format!(
                    "measured down to zenith {:.1} degrees, extrapolated below",
                    zenith_rad.to_degrees()
                ));
            }
            let mut residuals = diagnostics.residual.clone();
            residuals.sort_by(f32::total_cmp);
            if let Some(median) = residuals.get(residuals.len() / 2) {
                facts.push(format!("residual over expected error: median {median:.2}"));
            }
            let mut sigmas = diagnostics.sigma.clone();
            sigmas.retain(|sigma| sigma.is_finite());
            sigmas.sort_by(f32::total_cmp);
            if let Some(median) = sigmas.get(sigmas.len() / 2) {
                facts.push(format!("68 % of unseen measurements within {:.1} % (median)", 100.0 * median));
            }
        }
        facts
    }
}

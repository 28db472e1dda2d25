//! The radiance of one texel against direction: measured, fitted, and how sure the fit is.

use glam::{DVec3, Vec2, Vec3};
use rigel::Result;
use rigel::fit::Model;
use rigel::geometry::Texels;
use rigel::observation::{Cut, ObservationMap, TexelObservations};
use rigel::parameter_map::ParameterMap;
use rigel::sampling::spiral;

use crate::font::{ADVANCE, LINE};
use crate::raster::{Colour, DIM, FAINT, INK, Raster, text_size};

/// Width and height of a panel that shows everything, pixels of scale 1.
pub const PANEL: (u32, u32) = (372, 420);
/// The brightest direction is looked for among so many, down to this zenith where nothing was measured.
const DIRECTIONS: usize = 4000;
const ZENITH_DEG: f64 = 75.0;
/// Curves are drawn so far from the normal.
const HALF_DEG: i32 = 85;
/// Red, green, blue, readable on a dark ground.
const CHANNELS: [[u8; 3]; 3] = [[255, 96, 88], [96, 214, 96], [112, 156, 255]];

/// What one view measured, and what the fit says in its direction.
struct Measured {
    direction: DVec3,
    radiance: [f32; 3],
    sigma: f32,
    fitted: [f32; 3],
    /// Within this the fit expects 68 % of measurements.
    doubt: Option<[f32; 3]>,
}

/// Radiance against direction.
pub struct Profile {
    facts: Vec<String>,
    /// The brightest fitted direction, and the plane through it.
    brightest: DVec3,
    cut: Cut,
    /// Degree by degree in the plane: what the fit says, and its doubt.
    curve: Vec<(i32, [f32; 3], Option<[f32; 3]>)>,
    measured: Vec<Measured>,
    /// How far from the normal the flattest view was, degrees.
    reach_deg: f64,
}

impl Profile {
    /// Of texel (`column`, `row`) of a map, with what `observations` hold of the same place.
    ///
    /// # Errors
    /// [`rigel::Error::Io`] when the observations cannot be read.
    pub fn new(
        map: &ParameterMap,
        (column, row): (u32, u32),
        observations: Option<&ObservationMap>,
    ) -> Result<Self> {
        let observed = observations.map(|observations| at_the_same_place(map, (column, row), observations));
        let observed = observed.transpose()?.flatten();
        let (model, parameters) = map.texel(column, row);
        let radiance = |direction: Vec3| model.radiance(parameters, direction);
        let measured = observed.iter().flat_map(|texel| {
            (0..texel.len()).map(|i| Measured {
                direction: texel.direction[i].as_dvec3(),
                radiance: texel.radiance[i],
                sigma: texel.sigma[i],
                fitted: radiance(texel.direction[i]),
                doubt: map.sigma(column, row, texel.direction[i]),
            })
        });
        let measured: Vec<Measured> = measured.collect();
        let flattest =
            measured.iter().map(|m| m.direction.z.clamp(-1.0, 1.0).acos().to_degrees()).reduce(f64::max);
        let reach_deg = flattest.unwrap_or(ZENITH_DEG);
        let luminance = |direction: &DVec3| radiance(direction.as_vec3()).iter().sum::<f32>();
        let looked_at = spiral(DIRECTIONS, reach_deg.clamp(1.0, 89.0).to_radians())?;
        let brightest =
            looked_at.into_iter().max_by(|a, b| luminance(a).total_cmp(&luminance(b))).unwrap_or(DVec3::Z);
        let cut = Cut::through(brightest);
        let point = |degrees: i32| {
            let direction = cut.direction(f64::from(degrees)).as_vec3();
            (degrees, radiance(direction), map.sigma(column, row, direction))
        };
        Ok(Self {
            facts: facts(map, (column, row), model, observations.is_some().then_some(measured.len())),
            brightest,
            cut,
            curve: (-HALF_DEG..=HALF_DEG).map(point).collect(),
            measured,
            reach_deg,
        })
    }

    /// A panel of this size with text of `scale`.
    pub fn draw(&self, (width, height): (u32, u32), scale: u32) -> Raster {
        let mut panel = Raster::new(width, height);
        panel.fill((0, 0), (width, height), DIM);
        let (line, margin) = ((LINE * scale) as i32, (4 * scale) as i32);
        let mut y = margin;
        for (number, fact) in self.facts.iter().enumerate() {
            panel.text((margin, y), scale, fact, if number == 0 { INK } else { FAINT });
            y += line;
        }
        y += margin;
        let rest = (height as i32 - y - 4 * line - 2 * margin).max(0);
        let most = self.most();
        let axes = |top: i32, from: f64, to: f64| Axes {
            left: margin + (7 * ADVANCE * scale) as i32,
            right: width as i32 - 2 * margin,
            top,
            bottom: top + rest / 2 - line,
            from,
            to,
            most,
            scale,
        };
        let (y_text, half) = (y, f64::from(HALF_DEG));
        panel.text((margin, y_text), scale, "in the plane of the brightest direction, deg from normal", INK);
        let in_plane = axes(y + line + margin / 2, -half, half);
        if in_plane.is_drawable() {
            self.draw_cut(&mut panel, &in_plane);
        }
        let y = y + 2 * line + rest / 2;
        panel.text((margin, y), scale, "every view, degrees from the brightest direction", INK);
        let farthest = self.measured.iter().map(|m| self.off_deg(m.direction)).fold(10.0, f64::max);
        let all = axes(y + line + margin / 2, 0.0, (farthest / 10.0).ceil() * 10.0);
        match (all.is_drawable(), self.measured.is_empty()) {
            (true, false) => self.draw_all(&mut panel, &all),
            (true, true) => {
                panel.text((all.left, all.top), scale, "nothing measured is at hand (--session)", FAINT)
            }
            (false, _) => {}
        }
        panel
    }

    fn off_deg(&self, direction: DVec3) -> f64 {
        direction.dot(self.brightest).clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// The top of the radiance axis: what was measured, and the fit where views were.
    fn most(&self) -> f32 {
        let curve = self.curve.iter().filter(|(degrees, ..)| f64::from(degrees.abs()) <= self.reach_deg);
        let fitted = curve.flat_map(|(_, radiance, _)| *radiance);
        let measured = self.measured.iter().flat_map(|m| m.radiance.map(|l| l + m.sigma));
        let most = fitted.chain(measured).filter(|value| value.is_finite()).fold(0.0, f32::max);
        if most > 0.0 { 1.05 * most } else { 1.0 }
    }

    fn draw_cut(&self, panel: &mut Raster, axes: &Axes) {
        axes.draw(panel, 30.0);
        for (channel, [r, g, b]) in CHANNELS.into_iter().enumerate() {
            for pair in self.curve.windows(2) {
                let [(degrees, radiance, doubt), (next, after, _)] = pair else { continue };
                let (x, ahead) = (f64::from(*degrees), f64::from(*next));
                // Where no view was the fit guesses: drawn thin.
                let is_seen = x.abs() <= self.reach_deg;
                if let Some(doubt) = doubt {
                    let (low, high) =
                        (radiance[channel] - doubt[channel], radiance[channel] + doubt[channel]);
                    axes.band(panel, (x, ahead), (low, high), [r, g, b, 44]);
                }
                let (from, to) = (axes.at(x, radiance[channel]), axes.at(ahead, after[channel]));
                let side = if is_seen { axes.scale.max(2) } else { 1 };
                axes.line(panel, from, to, side, [r, g, b, if is_seen { 255 } else { 110 }]);
            }
            for m in &self.measured {
                if let Some(degrees) = self.cut.from_normal_deg(m.direction) {
                    axes.mark(panel, degrees, m.radiance[channel], m.sigma, [r, g, b, 255]);
                }
            }
        }
    }

    fn draw_all(&self, panel: &mut Raster, axes: &Axes) {
        axes.draw(panel, if axes.to > 60.0 { 30.0 } else { 10.0 });
        for (channel, [r, g, b]) in CHANNELS.into_iter().enumerate() {
            for m in &self.measured {
                let off = self.off_deg(m.direction);
                if let Some(doubt) = m.doubt {
                    let (low, high) =
                        (m.fitted[channel] - doubt[channel], m.fitted[channel] + doubt[channel]);
                    let half = 0.004 * (axes.to - axes.from);
                    axes.band(panel, (off - half, off + half), (low, high), [r, g, b, 80]);
                }
                // The fit is a dash, the measurement a mark.
                let at = axes.at(off, m.fitted[channel]);
                let half = Vec2::new(3.0 * axes.scale as f32, 0.0);
                axes.line(panel, at - half, at + half, axes.scale, [r, g, b, 150]);
                axes.mark(panel, off, m.radiance[channel], m.sigma, [r, g, b, 255]);
            }
        }
    }
}

/// Where the same point of the surface is in the observations, which may be finer or coarser; `None` beside them.
fn at_the_same_place(
    map: &ParameterMap,
    (column, row): (u32, u32),
    observations: &ObservationMap,
) -> Result<Option<TexelObservations>> {
    let header = observations.header();
    let at =
        header.surface.texel_at(header.texels, map.surface.texel_centre(map.texels, column, row)).round();
    let Texels { columns, rows } = header.texels;
    let is_inside = at.min_element() >= 0.0 && at.x < f64::from(columns) && at.y < f64::from(rows);
    is_inside.then(|| Ok(observations.texel(at.x as u32, at.y as u32)?.usable().into_owned())).transpose()
}

fn facts(
    map: &ParameterMap,
    (column, row): (u32, u32),
    model: Model,
    measured: Option<usize>,
) -> Vec<String> {
    let mut facts = vec![format!("texel {column},{row}: {}", model.name())];
    let index = row as usize * map.texels.columns as usize + column as usize;
    if let Some(diagnostics) = &map.diagnostics {
        let of = |values: &[f32]| values.get(index).copied().filter(|value| value.is_finite());
        if let (Some(residual), Some(views)) = (of(&diagnostics.residual), diagnostics.views.get(index)) {
            facts.push(format!("{views} views, residual {residual:.2} of the expected error"));
        }
        if let Some(sigma) = of(&diagnostics.sigma) {
            facts.push(format!("68 % of unseen measurements within {:.1} %: bands", 100.0 * sigma));
        }
    }
    facts.push(match measured {
        Some(count) => format!("fit: lines; {count} views measured: marks +- sigma"),
        None => "fit: lines".into(),
    });
    facts
}

/// A plot's frame: degrees across, radiance up.
struct Axes {
    left: i32,
    right: i32,
    top: i32,
    bottom: i32,
    from: f64,
    to: f64,
    most: f32,
    scale: u32,
}

impl Axes {
    /// A frame that is too small is left out.
    fn is_drawable(&self) -> bool {
        self.right - self.left >= 40 && self.bottom - self.top >= 20
    }

    fn at(&self, degrees: f64, radiance: f32) -> Vec2 {
        let across = (degrees - self.from) / (self.to - self.from);
        let x = f64::from(self.left) + across * f64::from(self.right - self.left);
        let y = self.bottom as f32 - radiance / self.most * (self.bottom - self.top) as f32;
        Vec2::new(x as f32, y)
    }

    fn draw(&self, panel: &mut Raster, step_deg: f64) {
        let (width, height) = ((self.right - self.left) as u32, (self.bottom - self.top) as u32);
        panel.fill((self.left, self.bottom), (width, 1), FAINT);
        panel.fill((self.left, self.top), (1, height), FAINT);
        let mut tick = (self.from / step_deg).ceil() * step_deg;
        while tick <= self.to {
            let x = self.at(tick, 0.0).x as i32;
            panel.fill((x, self.bottom), (1, 3 * self.scale), FAINT);
            let text = format!("{tick:.0}");
            let (wide, _) = text_size(std::slice::from_ref(&text), self.scale);
            let y = self.bottom + (4 * self.scale) as i32;
            panel.text((x - wide as i32 / 2, y), self.scale, &text, FAINT);
            tick += step_deg;
        }
        for part in [0.0, 0.5, 1.0] {
            let value = part * self.most / 1.05;
            let text = label(value, self.most);
            let y = self.at(self.from, value).y as i32;
            panel.fill((self.left - 2, y), (3, 1), FAINT);
            let (wide, _) = text_size(std::slice::from_ref(&text), self.scale);
            let at = (self.left - 3 - wide as i32, y - (4 * self.scale) as i32);
            panel.text(at, self.scale, &text, FAINT);
        }
    }

    /// A line as far as the frame goes.
    fn line(&self, panel: &mut Raster, from: Vec2, to: Vec2, side: u32, colour: Colour) {
        let (top, bottom) = (self.top as f32, self.bottom as f32);
        if from.y.min(to.y) <= bottom && from.y.max(to.y) >= top {
            let clip = |at: Vec2| Vec2::new(at.x, at.y.clamp(top, bottom));
            panel.line(clip(from), clip(to), side, colour);
        }
    }

    fn band(&self, panel: &mut Raster, (from, to): (f64, f64), (low, high): (f32, f32), colour: Colour) {
        let (high, low) = (self.at(from, high), self.at(to, low.max(0.0)));
        let top = (high.y as i32).clamp(self.top, self.bottom);
        let bottom = (low.y as i32).clamp(self.top, self.bottom);
        let width = (low.x as i32 - high.x as i32).max(1) as u32;
        panel.fill((high.x as i32, top), (width, (bottom - top) as u32), colour);
    }

    /// A measurement with its standard deviation above and below.
    fn mark(&self, panel: &mut Raster, degrees: f64, radiance: f32, sigma: f32, colour: Colour) {
        let ends = (self.at(degrees, radiance - sigma), self.at(degrees, radiance + sigma));
        self.line(panel, ends.0, ends.1, 1, colour);
        let (at, side) = (self.at(degrees, radiance).round().as_ivec2(), 2 * self.scale + 1);
        panel.fill((at.x - self.scale as i32, at.y - self.scale as i32), (side, side), colour);
    }
}

/// A value on an axis that goes up to `most`, in no more than seven letters.
fn label(value: f32, most: f32) -> String {
    match most.log10().floor() {
        _ if value == 0.0 => "0".into(),
        power @ -3.0..5.0 => format!("{value:.0$}", (2.0 - power).clamp(0.0, 4.0) as usize),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigel::geometry::Surface;

    fn map(specular: f32) -> ParameterMap {
        ParameterMap {
            surface: Surface { width_m: 0.2, height_m: 0.15 },
            texels: Texels { columns: 1, rows: 1 },
            models: vec![Model::Phong { lobes: 1 }],
            choice: vec![],
            parameters: vec![0.1, 0.2, 0.3, specular, specular, specular, 30.0, 0.0, 0.6, 0.8],
            diagnostics: None,
            uncertainty: None,
        }
    }

    #[test]
    fn the_plane_goes_through_the_lobe_and_its_top_is_the_curves() {
        let profile = Profile::new(&map(2.0), (0, 0), None).unwrap();
        assert!(profile.brightest.dot(DVec3::new(0.0, 0.6, 0.8)) > 0.999, "{}", profile.brightest);
        let (degrees, top, _) = profile.curve.iter().max_by(|a, b| a.1[1].total_cmp(&b.1[1])).unwrap();
        assert!((f64::from(*degrees) - 0.6f64.asin().to_degrees()).abs() < 2.0, "{degrees}");
        assert!((top[1] - 2.2).abs() < 0.02 && profile.most() >= 2.2);
    }

    #[test]
    fn labels_tell_values_apart_on_an_axis_of_any_height() {
        for power in -12..=12 {
            let most = 1.3 * 10f32.powi(power);
            let labels = [0.0, 0.5, 1.0].map(|part| (part * most, label(part * most, most)));
            for (value, label) in labels {
                let off = (label.parse::<f32>().unwrap() - value).abs();
                assert!(off <= 0.06 * most && label.len() <= 7, "{label} for {value} of {most}");
            }
        }
    }

    #[test]
    fn a_panel_of_any_size_is_drawn_and_a_brighter_channel_higher() {
        let profile = Profile::new(&map(0.0), (0, 0), None).unwrap();
        for size in [(0, 0), (1, 1), (30, 400), (400, 30), PANEL] {
            profile.draw(size, 1);
        }
        let panel = profile.draw(PANEL, 1);
        // The middle column of the upper plot: the three even curves, blue above green above red.
        let row = |[r, g, b]: [u8; 3]| {
            let is = |y: &u32| {
                let at = (y * panel.width + panel.width / 2 + 40) as usize;
                panel.pixels[at] == [r, g, b, 255]
            };
            (0..panel.height).find(is).unwrap()
        };
        assert!(row(CHANNELS[2]) < row(CHANNELS[1]) && row(CHANNELS[1]) < row(CHANNELS[0]));
    }
}

//! What is drawn: the scene or a photographed view's picture, a texel's radiance, text.

use std::path::{Path, PathBuf};

use rigel::evaluate::Reference;
use rigel::render::png;
use rigel::shader::Look;
use rigel::{Result, file};
use winit::dpi::PhysicalSize;

use super::pane::Pane;
use super::{App, Face, words};
use crate::contact_sheet::scale;
use crate::flip::{difference, photograph};
use crate::profile::PANEL;
use crate::raster::{DIM, Raster, text_size};
use crate::scene::{Shading, View};

/// A name that nothing has yet: `view.png`, `view-2.png`, ...
pub(super) fn unused(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let numbered = (2..).map(|number| path.with_file_name(format!("{stem}-{number}.png")));
    [path.to_owned()].into_iter().chain(numbered).find(|path| !path.exists()).unwrap_or_else(|| path.into())
}

/// Where a picture of this size lies in a window: in its middle, as large as fits.
pub(super) fn framed(size: PhysicalSize<u32>, (width, height): (u32, u32)) -> ((i32, i32), (u32, u32)) {
    let (across, down) = (f64::from(size.width), f64::from(size.height));
    let by = (across / f64::from(width)).min(down / f64::from(height));
    let shown = [width, height].map(|side| ((by * f64::from(side)).round() as u32).max(1));
    let corner = ((across - f64::from(shown[0])) / 2.0, (down - f64::from(shown[1])) / 2.0);
    ((corner.0 as i32, corner.1 as i32), (shown[0], shown[1]))
}

/// Pixels of letters: large where they leave room for the surface.
pub(super) fn letters(size: PhysicalSize<u32>) -> u32 {
    if size.width >= 1500 && size.height >= 900 { 2 } else { 1 }
}

impl App {
    /// The photographed view's picture that is shown.
    fn flipped(&self, pane: &Pane, reference: &Reference) -> Result<Vec<[u8; 3]>> {
        let view = self.view();
        let exposed = || {
            let look = Look { false_colour: false, ..view.look };
            pane.map_alone(&View { look, ..view })
        };
        Ok(match self.face {
            Face::Photograph => photograph(reference, &view.look),
            Face::Reconstruction => pane.map_alone(&view)?,
            Face::Difference => difference(&self.show.maps[self.map].1, reference, &exposed()?, &view.look)?,
        })
    }

    /// What lies over the scene: a photographed view's picture, a texel's radiance, text.
    fn overlay(&self, pane: &Pane) -> Result<Raster> {
        let size = pane.size();
        let mut over = Raster::new(size.width, size.height);
        if let Some((_, reference)) = &self.step {
            let own = (reference.lens.width, reference.lens.height);
            let (corner, shown) = framed(self.free(), own);
            over.picture(corner, shown, &self.flipped(pane, reference)?, own);
        }
        self.write(&mut over);
        Ok(over)
    }

    pub(super) fn write(&self, over: &mut Raster) {
        let scale = letters(PhysicalSize::new(over.width, over.height));
        let margin = (4 * scale) as i32;
        if let Some(place) = self.place_of_texel() {
            over.ring(place, scale);
        }
        if let Some(profile) = &self.profile {
            let size = (PANEL.0 * scale, (PANEL.1 * scale).min(over.height));
            over.place((over.width as i32 - size.0 as i32, 0), &profile.draw(size, scale));
        }
        if self.is_written {
            let mut lines = self.facts.clone();
            lines.push(String::new());
            lines.extend(self.seen());
            let keys = words::keys();
            let (_, high) = text_size(&keys, scale);
            over.note((margin, margin), scale, &lines);
            over.note((margin, over.height as i32 - high as i32 - 3 * margin), scale, &keys);
        }
        if self.step.is_some() && self.face == Face::Difference && self.show.view.look.false_colour {
            let corner = (over.width as i32 - 352, over.height as i32 - 16);
            over.fill((corner.0 - 4, corner.1 - 4), (356, 20), DIM);
            self::scale(over, corner);
        }
    }

    pub(super) fn draw(&mut self) -> Result<()> {
        let Some(pane) = &self.pane else { return Ok(()) };
        pane.title(&format!("rigel view: {}", self.show.maps[self.map].0));
        let view = self.step.is_none().then(|| self.view());
        pane.draw(view.as_ref(), &self.overlay(pane)?)?;
        if std::mem::take(&mut self.show.at_once) {
            let path = self.show.screenshot.clone();
            self.screenshot(&path)?;
        }
        Ok(())
    }

    /// What is seen, and how, in lines.
    pub(super) fn seen(&self) -> Vec<String> {
        let view = self.view();
        let by_choice = view.halvings > 0 || view.shading == Shading::ByTexel;
        let is_by_texel = self.pane.as_ref().map_or(by_choice, |pane| pane.is_by_texel(&view));
        let is_floor_shown = self.is_floor_lit && self.step.is_none();
        words::seen(&view, is_by_texel, self.of().as_deref(), is_floor_shown)
    }

    /// Which picture of which photographed view is shown.
    pub(super) fn of(&self) -> Option<String> {
        let (index, reference) = self.step.as_ref()?;
        let face = match self.face {
            Face::Photograph => "photograph",
            Face::Reconstruction => "reconstruction",
            Face::Difference if self.show.view.look.false_colour => "difference",
            Face::Difference => "difference x 4",
        };
        Some(format!("{face} {} ({} of {})", reference.name, index + 1, self.show.photographs))
    }

    /// Writes what is seen.
    pub(super) fn screenshot(&self, path: &Path) -> Result<()> {
        let Some(pane) = &self.pane else { return Ok(()) };
        let (size, over) = (pane.size(), self.overlay(pane)?);
        let levels = match &self.step {
            None => over.on(pane.picture(&self.view())?),
            Some(_) => over.levels(),
        };
        file::write_bytes(path, &png(size.width, size.height, levels.as_flattened())?)
    }
}

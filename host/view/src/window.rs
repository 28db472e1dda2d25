//! A window: turn a map with mouse and keys, or step through photographed views.

mod draw;
mod events;
mod pane;
mod turn;
mod words;

use std::path::PathBuf;

use glam::{IVec2, UVec2, Vec2};
use rigel::emitter::Floor;
use rigel::evaluate::Reference;
use rigel::geometry::{Lens, Pose};
use rigel::observation::ObservationMap;
use rigel::parameter_map::ParameterMap;
use rigel::{Error, Result};
use winit::dpi::PhysicalSize;
use winit::event_loop::EventLoop;

use crate::flip::matched;
use crate::profile::{PANEL, Profile};
use crate::scene::{View, most_halvings};
use draw::{framed, letters};
use pane::Pane;
use turn::{fitting, moved, turned};
pub use words::KEYS;

/// What a window shows.
pub struct Show {
    /// Maps with their names; at least one.
    pub maps: Vec<(String, ParameterMap)>,
    /// The first view.
    pub view: View,
    /// How many photographed views there are, and how to get one.
    pub photographs: usize,
    /// Gets one of them.
    pub photograph: Box<dyn Fn(usize) -> Result<Reference>>,
    /// What was measured, where it is at hand.
    pub observations: Option<ObservationMap>,
    /// The texel (column, row) of the first map whose radiance against direction is drawn at first.
    pub texel: Option<(u32, u32)>,
    /// Where a screenshot goes, or beside it under another number; the first frame is written there if `at_once` says so.
    pub screenshot: PathBuf,
    /// Write the first frame.
    pub at_once: bool,
}

/// Opens a window and returns when it is closed.
///
/// # Errors
/// [`Error::Device`] where there is no display or no graphics device; [`Error::Request`] where a map is too large for it, and what a
/// photograph's reading says.
pub fn open(show: Show) -> Result<()> {
    let events = EventLoop::new().map_err(|error| no_display(&error))?;
    let mut app = App::new(show);
    app.look_at_texel()?;
    events.run_app(&mut app).map_err(|error| no_display(&error))?;
    app.failed.map_or(Ok(()), Err)
}

fn no_display(error: &dyn std::fmt::Display) -> Error {
    // Before the reason stands the place in winit's source.
    let told = error.to_string();
    Error::Device {
        device: "display".into(),
        what: format!(
            "no window can be opened ({})",
            told.rsplit(": ").next().unwrap_or_default().trim_end_matches('.')
        ),
        remedy:
            "start it on a desktop (or set DISPLAY), or draw without a window: --headless --screenshot FILE"
                .into(),
    }
}

/// What is shown of a photographed view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Face {
    Photograph,
    Reconstruction,
    Difference,
}

struct App {
    show: Show,
    pose: Pose,
    map: usize,
    /// The photographed view that is shown, instead of one from anywhere.
    step: Option<(usize, Reference)>,
    face: Face,
    /// What the map is, in lines.
    facts: Vec<String>,
    /// Keys and facts are written.
    is_written: bool,
    is_floor_lit: bool,
    /// The texel whose radiance is drawn.
    profile: Option<Profile>,
    pointer: (f64, f64),
    /// Where the button was pressed, and whether it has been moved since.
    pressed: Option<((f64, f64), bool)>,
    pane: Option<Pane>,
    failed: Option<Error>,
}

impl App {
    fn new(show: Show) -> Self {
        let (name, map) = &show.maps[0];
        Self {
            facts: words::facts(name, map),
            pose: show.view.pose,
            map: 0,
            step: None,
            face: Face::Reconstruction,
            is_written: true,
            is_floor_lit: false,
            profile: None,
            pointer: (0.0, 0.0),
            pressed: None,
            pane: None,
            failed: None,
            show,
        }
    }

    fn size(&self) -> PhysicalSize<u32> {
        let lens = &self.show.view.lens;
        self.pane.as_ref().map_or(PhysicalSize::new(lens.width, lens.height), Pane::size)
    }

    /// The part of the window, from its left edge on, that no texel's radiance takes.
    fn free(&self) -> PhysicalSize<u32> {
        let size = self.size();
        let taken = if self.profile.is_some() { PANEL.0 * letters(size) } else { 0 };
        // A small window shows the one through the other.
        let width = if size.width >= 2 * taken { size.width - taken } else { size.width };
        PhysicalSize::new(width, size.height)
    }

    fn view(&self) -> View {
        let view = self.show.view;
        match &self.step {
            Some((_, reference)) => View { lens: reference.lens, pose: reference.pose, ..view },
            None => {
                let lens = Lens { width: self.size().width, ..fitting(&view.lens, self.free()) };
                View { lens, pose: self.pose, ..view }
            }
        }
    }

    fn step(&mut self, by: usize) -> Result<()> {
        let count = self.show.photographs;
        if count > 0 {
            let next = self.step.as_ref().map_or(0, |(index, _)| (index + by) % count);
            self.step = Some((next, matched((self.show.photograph)(next)?, &self.show.maps[self.map].1)));
        }
        Ok(())
    }

    fn turn(&mut self, azimuth_rad: f64, zenith_rad: f64) {
        self.step = None;
        self.pose = turned(&self.pose, azimuth_rad, zenith_rad);
    }

    fn zoom(&mut self, factor: f64) {
        self.step = None;
        let first_m = self.show.view.pose.centre_m.length();
        self.pose = moved(&self.pose, factor, (0.02 * first_m, 100.0 * first_m));
    }

    /// The texel that is seen at a place of the window.
    fn texel_at(&self, (x, y): (f64, f64)) -> Option<(u32, u32)> {
        let view = self.view();
        let pixel = match &self.step {
            // The middle of the first pixel is half a pixel from the corner.
            None => (x - 0.5, y - 0.5),
            Some(_) => {
                let (corner, shown) = framed(self.free(), (view.lens.width, view.lens.height));
                let along = |at: f64, corner: i32, shown: u32, side: u32| {
                    (at - f64::from(corner)) / f64::from(shown) * f64::from(side) - 0.5
                };
                (along(x, corner.0, shown.0, view.lens.width), along(y, corner.1, shown.1, view.lens.height))
            }
        };
        let map = &self.show.maps[self.map].1;
        let ray = view.pose.direction_to_surface(view.lens.unproject(pixel.into())?);
        let point_m = map.surface.intersect(view.pose.centre_m, ray)?;
        let at = map.surface.contains(point_m).then(|| map.surface.texel_at(map.texels, point_m).round())?;
        let within = |at: f64, count: u32| (at.max(0.0) as u32).min(count - 1);
        Some((within(at.x, map.texels.columns), within(at.y, map.texels.rows)))
    }

    /// Where the chosen texel is seen in the window: the other way round.
    fn place_of_texel(&self) -> Option<Vec2> {
        let (view, map) = (self.view(), &self.show.maps[self.map].1);
        let (column, row) = self.show.texel?;
        let place = view.place_of(map.surface.texel_centre(map.texels, column, row))?;
        Some(match &self.step {
            None => place,
            Some(_) => {
                let own = UVec2::new(view.lens.width, view.lens.height);
                let (corner, shown) = framed(self.free(), own.into());
                IVec2::from(corner).as_vec2() + place * UVec2::from(shown).as_vec2() / own.as_vec2()
            }
        })
    }

    /// Draws the chosen texel's radiance against direction, of the map that is shown.
    fn look_at_texel(&mut self) -> Result<()> {
        let map = &self.show.maps[self.map].1;
        let observations = self.show.observations.as_ref();
        let profile = self.show.texel.map(|texel| Profile::new(map, texel, observations));
        self.profile = profile.transpose()?;
        Ok(())
    }

    fn next_map(&mut self) -> Result<()> {
        let before = self.show.maps[self.map].1.texels;
        self.map = (self.map + 1) % self.show.maps.len();
        let (name, map) = &self.show.maps[self.map];
        let after = map.texels;
        self.facts = words::facts(name, map);
        self.show.view.halvings = self.show.view.halvings.min(most_halvings(after));
        // The same place, on a map that may be finer or coarser.
        let scaled = |at: u32, from: u32, to: u32| {
            ((u64::from(at) * 2 + 1) * u64::from(to) / (2 * u64::from(from))) as u32
        };
        self.show.texel = self.show.texel.map(|(column, row)| {
            (scaled(column, before.columns, after.columns), scaled(row, before.rows, after.rows))
        });
        if let Some(pane) = &mut self.pane {
            pane.load(&self.show.maps[self.map].1)?;
        }
        self.light_floor();
        if self.step.is_some() {
            // The photograph's exposure follows the map's.
            self.step(0)?;
        }
        self.look_at_texel()
    }

    fn light_floor(&mut self) {
        let floor = self.is_floor_lit.then(|| Floor::lit_by(&self.show.maps[self.map].1));
        if let Some(pane) = &mut self.pane {
            pane.set_floor(floor.as_ref());
        }
    }

    fn click(&mut self) -> Result<()> {
        self.show.texel = self.texel_at(self.pointer);
        self.look_at_texel()
    }
}

#[cfg(test)]
mod tests;

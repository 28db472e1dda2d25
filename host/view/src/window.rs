//! A window: turn a map with mouse and keys, or step through photographed views.

mod pane;
mod turn;
mod words;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rigel::emitter::Floor;
use rigel::evaluate::Reference;
use rigel::geometry::{Lens, Pose};
use rigel::observation::ObservationMap;
use rigel::parameter_map::ParameterMap;
use rigel::render::png;
use rigel::shader::Look;
use rigel::{Error, Result, file};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::keyboard::{Key, NamedKey};
use winit::window::{Window, WindowId};

use crate::contact_sheet::scale;
use crate::flip::{difference, matched, photograph};
use crate::profile::{PANEL, Profile};
use crate::raster::{DIM, Raster, text_size};
use crate::scene::{Shading, View};
use pane::Pane;
use turn::{fitting, moved, turned};
pub use words::KEYS;

/// A pointer that moves no farther between press and release has clicked, pixels.
const CLICK_PX: f64 = 4.0;
/// Coarser than an eighth of the texels along each side nothing is to be seen.
const MOST_HALVINGS: u32 = 3;

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

/// A name that nothing has yet: `view.png`, `view-2.png`, ...
fn unused(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let numbered = (2..).map(|number| path.with_file_name(format!("{stem}-{number}.png")));
    [path.to_owned()].into_iter().chain(numbered).find(|path| !path.exists()).unwrap_or_else(|| path.into())
}

/// Where a picture of this size lies in a window: in its middle, as large as fits.
fn framed(size: PhysicalSize<u32>, (width, height): (u32, u32)) -> ((i32, i32), (u32, u32)) {
    let (across, down) = (f64::from(size.width), f64::from(size.height));
    let by = (across / f64::from(width)).min(down / f64::from(height));
    let shown = [width, height].map(|side| ((by * f64::from(side)).round() as u32).max(1));
    let corner = ((across - f64::from(shown[0])) / 2.0, (down - f64::from(shown[1])) / 2.0);
    ((corner.0 as i32, corner.1 as i32), (shown[0], shown[1]))
}

/// Pixels of letters: large where they leave room for the surface.
fn letters(size: PhysicalSize<u32>) -> u32 {
    if size.width >= 1500 && size.height >= 900 { 2 } else { 1 }
}

impl App {
    fn new(show: Show) -> Self {
        Self {
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

    /// The photographed view's picture that is shown.
    fn flipped(&self, pane: &Pane, reference: &Reference) -> Result<Vec<[u8; 3]>> {
        let view = self.view();
        let exposed = || {
            let look = Look { false_colour: false, ..view.look };
            pane.picture(&View { look, ..view })
        };
        Ok(match self.face {
            Face::Photograph => photograph(reference, &view.look),
            Face::Reconstruction => pane.picture(&view)?,
            Face::Difference => difference(reference, &exposed()?, &view.look),
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

    fn write(&self, over: &mut Raster) {
        let scale = letters(PhysicalSize::new(over.width, over.height));
        let margin = (4 * scale) as i32;
        if let Some(profile) = &self.profile {
            let size = (PANEL.0 * scale, (PANEL.1 * scale).min(over.height));
            over.place((over.width as i32 - size.0 as i32, 0), &profile.draw(size, scale));
        }
        if self.is_written {
            let (name, map) = &self.show.maps[self.map];
            let mut lines = words::facts(name, map);
            lines.push(String::new());
            lines.extend(words::seen(&self.view(), self.of().as_deref(), self.is_floor_lit));
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

    fn draw(&mut self) -> Result<()> {
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

    /// Which picture of which photographed view is shown.
    fn of(&self) -> Option<String> {
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
    fn screenshot(&self, path: &Path) -> Result<()> {
        let Some(pane) = &self.pane else { return Ok(()) };
        let (size, over) = (pane.size(), self.overlay(pane)?);
        let levels = match &self.step {
            None => over.on(pane.picture(&self.view())?),
            Some(_) => over.levels(),
        };
        file::write_bytes(path, &png(size.width, size.height, levels.as_flattened())?)
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

    /// Draws the chosen texel's radiance against direction, of the map that is shown.
    fn look_at_texel(&mut self) -> Result<()> {
        let map = &self.show.maps[self.map].1;
        let observations = self.show.observations.as_ref();
        let profile = self.show.texel.map(|texel| Profile::new(map, texel, observations));
        self.profile = profile.transpose()?;
        Ok(())
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

    /// Does what a key is for; false ends the window.
    fn key(&mut self, key: &Key) -> Result<bool> {
        let look = &mut self.show.view.look;
        match key.as_ref() {
            Key::Named(NamedKey::ArrowLeft) => self.turn(-0.05, 0.0),
            Key::Named(NamedKey::ArrowRight) => self.turn(0.05, 0.0),
            Key::Named(NamedKey::ArrowUp) => self.turn(0.0, -0.05),
            Key::Named(NamedKey::ArrowDown) => self.turn(0.0, 0.05),
            Key::Named(NamedKey::Escape) | Key::Character("q") => return Ok(false),
            Key::Named(NamedKey::Space) => {
                self.face = match self.face {
                    Face::Photograph => Face::Reconstruction,
                    Face::Reconstruction => Face::Difference,
                    Face::Difference => Face::Photograph,
                }
            }
            Key::Character("+" | "=") => self.zoom(0.9),
            Key::Character("-") => self.zoom(1.0 / 0.9),
            Key::Character("[") => look.gamma /= 1.1,
            Key::Character("]") => look.gamma *= 1.1,
            Key::Character("f") => look.false_colour = !look.false_colour,
            Key::Character("h") => self.is_written = !self.is_written,
            Key::Character("0") => (self.pose, self.step) = (self.show.view.pose, None),
            Key::Character("n") => self.step(1)?,
            Key::Character("p") => self.step(self.show.photographs.saturating_sub(1))?,
            Key::Character("s") => self.screenshot(&unused(&self.show.screenshot))?,
            Key::Character("l") => {
                self.is_floor_lit = !self.is_floor_lit;
                self.light_floor();
            }
            Key::Character("r") => {
                let most = self.pane.as_ref().map_or(MOST_HALVINGS, Pane::most_halvings).min(MOST_HALVINGS);
                self.show.view.halvings = (self.show.view.halvings + 1) % (most + 1);
            }
            Key::Character("x") => {
                let shading = &mut self.show.view.shading;
                *shading = match shading {
                    Shading::Automatic => Shading::ByPixel,
                    Shading::ByPixel => Shading::ByTexel,
                    Shading::ByTexel => Shading::Automatic,
                }
            }
            Key::Character("m") => {
                let before = self.show.maps[self.map].1.texels;
                self.map = (self.map + 1) % self.show.maps.len();
                let after = self.show.maps[self.map].1.texels;
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
                self.look_at_texel()?;
            }
            _ => {}
        }
        Ok(true)
    }

    /// What went wrong ends the window and is told.
    fn heed(&mut self, result: Result<()>, events: &ActiveEventLoop) {
        match result {
            Err(error) => {
                self.failed = Some(error);
                events.exit();
            }
            Ok(()) => {
                if let Some(pane) = &self.pane {
                    pane.ask_to_draw();
                }
            }
        }
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.pane.is_some() {
            return;
        }
        let size = PhysicalSize::new(self.show.view.lens.width, self.show.view.lens.height);
        let window =
            events.create_window(Window::default_attributes().with_title("rigel").with_inner_size(size));
        let opened = window
            .map_err(|error| no_display(&error))
            .and_then(|window| Pane::new(Arc::new(window), &self.show.maps[self.map].1));
        let result = opened.map(|pane| self.pane = Some(pane));
        self.heed(result, events);
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => events.exit(),
            WindowEvent::RedrawRequested => {
                if let Err(error) = self.draw() {
                    self.heed(Err(error), events);
                }
            }
            WindowEvent::Resized(size) => {
                if let Some(pane) = &mut self.pane {
                    pane.resize(size);
                }
                self.heed(Ok(()), events);
            }
            WindowEvent::KeyboardInput { event, .. } if event.state == ElementState::Pressed => {
                let result = self.key(&event.logical_key);
                if let Ok(false) = result {
                    events.exit();
                }
                self.heed(result.map(drop), events);
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left, .. } => {
                let was_pressed = self.pressed.take();
                if state == ElementState::Pressed {
                    self.pressed = Some((self.pointer, false));
                } else if let Some((_, false)) = was_pressed {
                    let result = self.click();
                    self.heed(result, events);
                }
            }
            WindowEvent::CursorMoved { position, .. } => {
                let (x, y) = std::mem::replace(&mut self.pointer, (position.x, position.y));
                let Some((from, is_dragged)) = self.pressed else { return };
                let off_px = (position.x - from.0).hypot(position.y - from.1);
                if is_dragged || off_px > CLICK_PX {
                    self.pressed = Some((from, true));
                    self.turn(0.008 * (x - position.x), 0.008 * (y - position.y));
                    self.heed(Ok(()), events);
                }
            }
            WindowEvent::MouseWheel { delta, .. } => {
                let lines = match delta {
                    MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                    MouseScrollDelta::PixelDelta(pixels) => pixels.y / 40.0,
                };
                self.zoom(0.9f64.powf(lines));
                self.heed(Ok(()), events);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests;

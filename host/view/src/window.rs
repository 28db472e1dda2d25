//! A window: turn a map with mouse and keys, or step through photographed views.

mod pane;

use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use rigel::evaluate::Reference;
use rigel::geometry::{Lens, Pose, Surface, unit_vector};
use rigel::parameter_map::ParameterMap;
use rigel::render::{expose, png};
use rigel::{Error, Result, file};
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, EventLoop};
use winit::keyboard::{Key, NamedKey};
use winit::window::{Window, WindowId};

use crate::scene::{Shading, View};
use pane::Pane;

/// What the keys do, line by line.
pub const KEYS: [&str; 8] = [
    "drag or arrows: turn; wheel or + -: distance; 0: as at first",
    "[ ]: exposure; f: false colours",
    "m: next map",
    "n p: next and previous photographed view (with --session)",
    "space: photograph, reconstruction, difference (x 4)",
    "x: by pixel, by texel, automatic",
    "s: screenshot",
    "q or Escape: end",
];

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
    /// Where a screenshot goes; the first frame is written there if `at_once` says so.
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
    let orbit = Orbit::of(&show.view);
    let mut app = App {
        orbit,
        first: orbit,
        map: 0,
        step: None,
        face: Face::Reconstruction,
        dragged: None,
        pane: None,
        failed: None,
        show,
    };
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

/// Where the camera is: it looks at the middle of the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Orbit {
    azimuth_rad: f64,
    zenith_rad: f64,
    distance_m: f64,
}

impl Orbit {
    fn of(view: &View) -> Self {
        let (azimuth_rad, zenith_rad) = rigel::geometry::azimuth_zenith(view.pose.centre_m);
        // From straight above any azimuth is right: this one has y up.
        let azimuth_rad = if zenith_rad < 1e-6 { -std::f64::consts::FRAC_PI_2 } else { azimuth_rad };
        Self { azimuth_rad, zenith_rad, distance_m: view.pose.centre_m.length() }
    }

    fn pose(&self) -> Pose {
        let centre_m = unit_vector(self.azimuth_rad, self.zenith_rad) * self.distance_m;
        let up = DVec3::new(
            -self.azimuth_rad.cos() * self.zenith_rad.cos(),
            -self.azimuth_rad.sin() * self.zenith_rad.cos(),
            self.zenith_rad.sin(),
        );
        Pose::from_axes(centre_m, -centre_m, up)
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
    orbit: Orbit,
    first: Orbit,
    map: usize,
    /// The photographed view that is shown, instead of an orbit.
    step: Option<(usize, Reference)>,
    face: Face,
    dragged: Option<Option<(f64, f64)>>,
    pane: Option<Pane>,
    failed: Option<Error>,
}

/// A lens that shows as much of the surface in a window of any size.
fn lens(surface: &Surface, size: PhysicalSize<u32>, view: &View) -> Lens {
    let (width, height) = (size.width.max(1), size.height.max(1));
    let by = f64::from(width.min(height)) / f64::from(view.lens.width.min(view.lens.height).max(1));
    let focal_px = (view.lens.fx * by).max(1e-3 * surface.width_m);
    Lens::pinhole(width, height, focal_px)
}

/// Levels of a photographed view, or four times its difference from what the map says, around middle grey.
fn levels(reference: &Reference, reconstruction: Option<&[[u8; 3]]>, gamma: f32) -> Vec<[u8; 3]> {
    let exposed = |l: &[f32; 3]| l.map(|l| (255.0 * expose(l, gamma)).round() as u8);
    let photograph = reference.radiance.radiance.iter().map(exposed);
    let Some(reconstruction) = reconstruction else { return photograph.collect() };
    let difference = |(a, b): ([u8; 3], &[u8; 3])| {
        std::array::from_fn(|c| (128 + 4 * (i32::from(b[c]) - i32::from(a[c]))).clamp(0, 255) as u8)
    };
    photograph.zip(reconstruction).map(difference).collect()
}

impl App {
    fn view(&self, size: PhysicalSize<u32>) -> View {
        let view = self.show.view;
        match &self.step {
            Some((_, reference)) => View { lens: reference.lens, pose: reference.pose, ..view },
            None => View {
                lens: lens(&self.show.maps[self.map].1.surface, size, &view),
                pose: self.orbit.pose(),
                ..view
            },
        }
    }

    fn draw(&mut self) -> Result<()> {
        let Some(pane) = &self.pane else { return Ok(()) };
        let view = self.view(pane.size());
        let picture = match &self.step {
            None => None,
            Some((_, reference)) => {
                let own = || pane.picture(&view);
                Some(match self.face {
                    Face::Photograph => levels(reference, None, view.look.gamma),
                    Face::Reconstruction => own()?,
                    Face::Difference => levels(reference, Some(&own()?), view.look.gamma),
                })
            }
        };
        pane.title(&self.title());
        match &picture {
            Some(picture) => pane.show(picture, (view.lens.width, view.lens.height))?,
            None => pane.draw(&view)?,
        }
        if std::mem::take(&mut self.show.at_once) {
            self.screenshot()?;
        }
        Ok(())
    }

    fn title(&self) -> String {
        let name = &self.show.maps[self.map].0;
        let shading = match self.show.view.shading {
            Shading::Automatic => "automatic",
            Shading::ByPixel => "by pixel",
            Shading::ByTexel => "by texel",
        };
        let seen = match (&self.step, self.face) {
            (None, _) => String::new(),
            (Some((_, view)), Face::Photograph) => format!(", photograph {}", view.name),
            (Some((_, view)), Face::Reconstruction) => format!(", reconstruction of {}", view.name),
            (Some((_, view)), Face::Difference) => format!(", difference from {} x 4", view.name),
        };
        format!(
            "{name}{seen}, gamma {:.3}, {shading} | drag [ ] m n p space f x s 0 q",
            self.show.view.look.gamma
        )
    }

    fn screenshot(&self) -> Result<()> {
        let Some(pane) = &self.pane else { return Ok(()) };
        let view = self.view(pane.size());
        let picture = pane.picture(&view)?;
        file::write_bytes(
            &self.show.screenshot,
            &png(view.lens.width, view.lens.height, picture.as_flattened())?,
        )
    }

    fn step(&mut self, by: usize) -> Result<()> {
        let count = self.show.photographs;
        if count > 0 {
            let next = self.step.as_ref().map_or(0, |(index, _)| (index + by) % count);
            self.step = Some((next, (self.show.photograph)(next)?));
        }
        Ok(())
    }

    fn turn(&mut self, azimuth_rad: f64, zenith_rad: f64) {
        self.step = None;
        self.orbit.azimuth_rad += azimuth_rad;
        self.orbit.zenith_rad = (self.orbit.zenith_rad + zenith_rad).clamp(0.0, 1.55);
    }

    fn zoom(&mut self, factor: f64) {
        self.step = None;
        let most = 100.0 * self.first.distance_m;
        self.orbit.distance_m = (self.orbit.distance_m * factor).clamp(0.02 * self.first.distance_m, most);
    }

    fn key(&mut self, key: &Key, events: &ActiveEventLoop) -> Result<()> {
        let look = &mut self.show.view.look;
        match key.as_ref() {
            Key::Named(NamedKey::ArrowLeft) => self.turn(-0.05, 0.0),
            Key::Named(NamedKey::ArrowRight) => self.turn(0.05, 0.0),
            Key::Named(NamedKey::ArrowUp) => self.turn(0.0, -0.05),
            Key::Named(NamedKey::ArrowDown) => self.turn(0.0, 0.05),
            Key::Named(NamedKey::Escape) | Key::Character("q") => events.exit(),
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
            Key::Character("0") => (self.orbit, self.step) = (self.first, None),
            Key::Character("n") => self.step(1)?,
            Key::Character("p") => self.step(self.show.photographs.saturating_sub(1))?,
            Key::Character("s") => self.screenshot()?,
            Key::Character("x") => {
                let shading = &mut self.show.view.shading;
                *shading = match shading {
                    Shading::Automatic => Shading::ByPixel,
                    Shading::ByPixel => Shading::ByTexel,
                    Shading::ByTexel => Shading::Automatic,
                }
            }
            Key::Character("m") => {
                self.map = (self.map + 1) % self.show.maps.len();
                if let Some(pane) = &mut self.pane {
                    pane.load(&self.show.maps[self.map].1)?;
                }
            }
            _ => {}
        }
        Ok(())
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
                let result = self.key(&event.logical_key, events);
                self.heed(result, events);
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left, .. } => {
                self.dragged = (state == ElementState::Pressed).then_some(None);
            }
            WindowEvent::CursorMoved { position, .. } => {
                if let Some(before) = self.dragged.replace(Some((position.x, position.y))) {
                    if let Some((x, y)) = before {
                        self.turn(0.008 * (x - position.x), 0.008 * (y - position.y));
                        self.heed(Ok(()), events);
                    }
                } else {
                    self.dragged = None;
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

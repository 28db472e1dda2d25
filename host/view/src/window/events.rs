//! What keys and the pointer do.

use std::sync::Arc;

use rigel::Result;
use winit::application::ApplicationHandler;
use winit::dpi::PhysicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::ActiveEventLoop;
use winit::keyboard::{Key, NamedKey};
use winit::window::{Window, WindowId};

use super::draw::unused;
use super::pane::Pane;
use super::{App, Face, no_display};
use crate::scene::{Shading, most_halvings};

/// A pointer that moves no farther between press and release has clicked, pixels.
const CLICK_PX: f64 = 4.0;
/// Coarser than an eighth of the texels along each side nothing is to be seen.
const MOST_HALVINGS: u32 = 3;

impl App {
    /// Does what a key is for; false ends the window.
    pub(super) fn key(&mut self, key: &Key) -> Result<bool> {
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
                let most = most_halvings(self.show.maps[self.map].1.texels).min(MOST_HALVINGS);
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
            Key::Character("m") => self.next_map()?,
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

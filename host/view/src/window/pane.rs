//! The window's surface: a scene drawn into it, or a picture.

use std::sync::Arc;

use rigel::parameter_map::ParameterMap;
use rigel::{Error, Result};
use wgpu::{
    CurrentSurfaceTexture, Extent3d, Instance, InstanceDescriptor, Surface, SurfaceConfiguration,
    SurfaceTexture, TexelCopyBufferLayout, TextureUsages,
};
use winit::dpi::PhysicalSize;
use winit::window::Window;

use crate::graphics::Graphics;
use crate::scene::{Scene, View};

/// A window with a map on a device.
pub(super) struct Pane {
    window: Arc<Window>,
    surface: Surface<'static>,
    configuration: SurfaceConfiguration,
    graphics: Graphics,
    scene: Scene,
}

fn lost(what: impl Into<String>) -> Error {
    Error::Device { device: "window".into(), what: what.into(), remedy: "run the command again".into() }
}

impl Pane {
    pub fn new(window: Arc<Window>, map: &ParameterMap) -> Result<Self> {
        let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
        let surface = instance
            .create_surface(window.clone())
            .map_err(|error| lost(format!("the device cannot draw into it ({error})")))?;
        let graphics = Graphics::for_surface(&instance, Some(&surface))?;
        let size = window.inner_size();
        let mut configuration = surface
            .get_default_config(&graphics.adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| lost(format!("{} cannot draw into it", graphics.name())))?;
        let capabilities = surface.get_capabilities(&graphics.adapter);
        // Levels are exposed radiance as they are: no further curve.
        if let Some(format) = capabilities.formats.iter().find(|format| !format.is_srgb()) {
            configuration.format = *format;
        }
        configuration.usage |= capabilities.usages & TextureUsages::COPY_DST;
        surface.configure(&graphics.device, &configuration);
        let scene = Scene::new(&graphics, map, configuration.format)?;
        Ok(Self { window, surface, configuration, graphics, scene })
    }

    pub fn size(&self) -> PhysicalSize<u32> {
        PhysicalSize::new(self.configuration.width, self.configuration.height)
    }

    pub fn title(&self, title: &str) {
        self.window.set_title(title);
    }

    pub fn ask_to_draw(&self) {
        self.window.request_redraw();
    }

    pub fn resize(&mut self, size: PhysicalSize<u32>) {
        (self.configuration.width, self.configuration.height) = (size.width.max(1), size.height.max(1));
        self.surface.configure(&self.graphics.device, &self.configuration);
    }

    /// Shows another map.
    pub fn load(&mut self, map: &ParameterMap) -> Result<()> {
        self.scene = Scene::new(&self.graphics, map, self.configuration.format)?;
        Ok(())
    }

    /// The next frame; `None` where there is none to draw now.
    fn frame(&self) -> Result<Option<SurfaceTexture>> {
        match self.surface.get_current_texture() {
            CurrentSurfaceTexture::Success(frame) | CurrentSurfaceTexture::Suboptimal(frame) => {
                Ok(Some(frame))
            }
            CurrentSurfaceTexture::Timeout | CurrentSurfaceTexture::Occluded => Ok(None),
            CurrentSurfaceTexture::Outdated => {
                self.surface.configure(&self.graphics.device, &self.configuration);
                self.ask_to_draw();
                Ok(None)
            }
            _ => Err(lost("it was lost")),
        }
    }

    pub fn draw(&self, view: &View) -> Result<()> {
        if let Some(frame) = self.frame()? {
            self.scene.draw(&self.graphics, view, &frame.texture.create_view(&Default::default()));
            self.graphics.queue.present(frame);
        }
        Ok(())
    }

    pub fn picture(&self, view: &View) -> Result<Vec<[u8; 3]>> {
        self.scene.picture(&self.graphics, view)
    }

    /// Shows a picture in the middle of the window, as large as fits (nearest pixels).
    pub fn show(&self, picture: &[[u8; 3]], (width, height): (u32, u32)) -> Result<()> {
        let Some(frame) = self.frame()? else { return Ok(()) };
        if !frame.texture.usage().contains(TextureUsages::COPY_DST) {
            return Err(lost("the device cannot copy pictures into it"));
        }
        let (across, down) = (frame.texture.width(), frame.texture.height());
        let by = (f64::from(across) / f64::from(width)).min(f64::from(down) / f64::from(height));
        let pixel = |x: u32, y: u32| {
            let column = (f64::from(x) - (f64::from(across) - by * f64::from(width)) / 2.0) / by;
            let row = (f64::from(y) - (f64::from(down) - by * f64::from(height)) / 2.0) / by;
            let is_inside =
                column >= 0.0 && row >= 0.0 && column < f64::from(width) && row < f64::from(height);
            let [r, g, b] =
                if is_inside { picture[row as usize * width as usize + column as usize] } else { [0; 3] };
            if self.scene.is_blue_first() { [b, g, r, 255] } else { [r, g, b, 255] }
        };
        let bytes: Vec<u8> = (0..down).flat_map(|y| (0..across).flat_map(move |x| pixel(x, y))).collect();
        self.graphics.queue.write_texture(
            frame.texture.as_image_copy(),
            &bytes,
            TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * across), rows_per_image: None },
            Extent3d { width: across, height: down, depth_or_array_layers: 1 },
        );
        self.graphics.queue.submit([]);
        self.graphics.queue.present(frame);
        Ok(())
    }
}

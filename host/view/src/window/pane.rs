//! The window's surface: a scene drawn into it, and a picture over that.

use std::sync::Arc;

use bytemuck::cast_slice;
use rigel::emitter::Floor;
use rigel::parameter_map::ParameterMap;
use rigel::{Error, Result};
use wgpu::{
    BindGroupDescriptor, BindGroupEntry, BindingResource, BlendState, CommandEncoderDescriptor,
    CurrentSurfaceTexture, Instance, InstanceDescriptor, RenderPipeline, ShaderModuleDescriptor,
    ShaderSource, Surface, SurfaceConfiguration, SurfaceTexture, TextureFormat,
};
use winit::dpi::PhysicalSize;
use winit::window::Window;

use crate::graphics::Graphics;
use crate::pipelines::pipeline;
use crate::raster::Raster;
use crate::scene::{Scene, View, pass, pass_over};

/// A window with a map on a device.
pub(super) struct Pane {
    window: Arc<Window>,
    surface: Surface<'static>,
    configuration: SurfaceConfiguration,
    graphics: Graphics,
    scene: Scene,
    overlay: RenderPipeline,
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
        surface.configure(&graphics.device, &configuration);
        let scene = Scene::new(&graphics, map, configuration.format)?;
        let module = graphics.device.create_shader_module(ShaderModuleDescriptor {
            label: Some("overlay"),
            source: ShaderSource::Wgsl(include_str!("overlay.wgsl").into()),
        });
        let blend = Some(BlendState::PREMULTIPLIED_ALPHA_BLENDING);
        let overlay = pipeline(&graphics.device, None, &module, "over", configuration.format, blend);
        Ok(Self { window, surface, configuration, graphics, scene, overlay })
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

    pub fn set_floor(&mut self, floor: Option<&Floor>) {
        self.scene.set_floor(&self.graphics, floor);
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

    /// Draws the scene, where `view` says how, and a picture of the window's size over it, or else on black.
    pub fn draw(&self, view: Option<&View>, over: &Raster) -> Result<()> {
        let Some(frame) = self.frame()? else { return Ok(()) };
        let target = frame.texture.create_view(&Default::default());
        if let Some(view) = view {
            self.scene.draw(&self.graphics, view, &target);
        }
        let size = (over.width.max(1), over.height.max(1));
        let texture = self.graphics.filled(size, TextureFormat::Rgba8Unorm, cast_slice(&over.pixels));
        let group = self.graphics.device.create_bind_group(&BindGroupDescriptor {
            label: None,
            layout: &self.overlay.get_bind_group_layout(0),
            entries: &[BindGroupEntry { binding: 0, resource: BindingResource::TextureView(&texture) }],
        });
        let mut encoder = self.graphics.device.create_command_encoder(&CommandEncoderDescriptor::default());
        let draw = if view.is_some() { pass_over } else { pass };
        draw(&mut encoder, &self.overlay, &group, &target);
        self.graphics.queue.submit([encoder.finish()]);
        self.graphics.queue.present(frame);
        Ok(())
    }

    pub fn is_by_texel(&self, view: &View) -> bool {
        self.scene.is_by_texel(view)
    }

    pub fn picture(&self, view: &View) -> Result<Vec<[u8; 3]>> {
        self.scene.picture(&self.graphics, view)
    }

    /// The same without the floor.
    pub fn map_alone(&self, view: &View) -> Result<Vec<[u8; 3]>> {
        self.scene.map_alone(&self.graphics, view)
    }
}

//! The device, and pictures read back from it.

use rigel::{Error, Result};
use wgpu::{
    BufferDescriptor, BufferUsages, CommandEncoderDescriptor, DeviceDescriptor, Extent3d, Instance,
    InstanceDescriptor, MapMode, PollType, PowerPreference, RequestAdapterOptions, Texture,
    TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView,
};

/// What to do where there is no device.
const INSTALL: &str = "install a Vulkan driver; Mesa's software one needs no graphics card (Debian: apt install mesa-vulkan-drivers libvulkan1)";

/// A graphics device with Vulkan.
#[derive(Debug)]
pub struct Graphics {
    pub(crate) adapter: wgpu::Adapter,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
}

fn failed(what: String, remedy: &str) -> Error {
    Error::Device { device: "graphics".into(), what, remedy: remedy.into() }
}

impl Graphics {
    /// Opens the fastest device; the environment variable `VK_ICD_FILENAMES` names the drivers that are asked.
    ///
    /// # Errors
    /// [`Error::Device`] that says what to install where there is none.
    pub fn open() -> Result<Self> {
        Self::for_surface(&Instance::new(InstanceDescriptor::new_without_display_handle()), None)
    }

    /// The same, able to draw into a window.
    pub(crate) fn for_surface(instance: &Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<Self> {
        let options = RequestAdapterOptions {
            power_preference: PowerPreference::HighPerformance,
            force_fallback_adapter: false,
            compatible_surface: surface,
            apply_limit_buckets: false,
        };
        let adapter = pollster::block_on(instance.request_adapter(&options))
            .map_err(|error| failed(format!("no device with Vulkan was found ({error})"), INSTALL))?;
        let descriptor = DeviceDescriptor {
            label: None,
            // For comparison with plain textures of single floats.
            required_features: adapter.features() & wgpu::Features::FLOAT32_FILTERABLE,
            required_limits: adapter.limits(),
            ..DeviceDescriptor::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| failed(format!("{} refuses: {error}", adapter.get_info().name), INSTALL))?;
        Ok(Self { adapter, device, queue })
    }

    /// The device's name, with its driver.
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({} {})", info.name, info.driver, info.driver_info)
    }

    /// Asks whether a texture of this size can be had.
    ///
    /// # Errors
    /// [`Error::Request`] with the device's limit.
    pub(crate) fn require_size(&self, what: &str, width: u32, height: u32) -> Result<()> {
        let most = self.device.limits().max_texture_dimension_2d;
        if width.max(height) <= most {
            return Ok(());
        }
        Err(Error::request(
            format!(
                "{what} need {width}x{height} cells of a texture, and {} takes at most {most}x{most}",
                self.name()
            ),
            "show a map of fewer texels or of a smaller model",
        ))
    }

    /// A picture of this size to draw into.
    pub fn target(&self, width: u32, height: u32) -> TextureView {
        let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
        self.texture((width, height), 1, crate::scene::PICTURE, usage).create_view(&Default::default())
    }

    pub(crate) fn texture(
        &self,
        size: (u32, u32),
        levels: u32,
        format: TextureFormat,
        usage: TextureUsages,
    ) -> Texture {
        self.device.create_texture(&TextureDescriptor {
            label: None,
            size: Extent3d { width: size.0, height: size.1, depth_or_array_layers: 1 },
            mip_level_count: levels,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format,
            usage,
            view_formats: &[],
        })
    }

    /// A texture that holds `data`, rows from the top.
    pub(crate) fn filled(&self, size: (u32, u32), format: TextureFormat, data: &[u8]) -> TextureView {
        let texture = self.texture(size, 1, format, TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST);
        self.queue.write_texture(
            texture.as_image_copy(),
            data,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(data.len() as u32 / size.1),
                rows_per_image: Some(size.1),
            },
            Extent3d { width: size.0, height: size.1, depth_or_array_layers: 1 },
        );
        texture.create_view(&Default::default())
    }

    /// Waits until everything that was asked for is done.
    ///
    /// # Errors
    /// [`Error::Device`] when the device was lost.
    pub fn wait(&self) -> Result<()> {
        match self.device.poll(PollType::wait_indefinitely()) {
            Ok(_) => Ok(()),
            Err(error) => Err(failed(format!("{} was lost: {error}", self.name()), "run the command again")),
        }
    }

    /// The bytes of a texture's first level, row by row from the top; four bytes a pixel.
    ///
    /// # Errors
    /// [`Error::Device`] when the device was lost.
    pub(crate) fn read(&self, texture: &Texture) -> Result<Vec<u8>> {
        let (width, height) = (texture.width(), texture.height());
        let row = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = self.device.create_buffer(&BufferDescriptor {
            label: None,
            size: u64::from(row) * u64::from(height),
            usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&CommandEncoderDescriptor::default());
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row),
                    rows_per_image: None,
                },
            },
            texture.size(),
        );
        self.queue.submit([encoder.finish()]);
        let (tell, told) = std::sync::mpsc::channel();
        buffer.slice(..).map_async(MapMode::Read, move |result| {
            // Whoever waits below is there as long as this call.
            let _ = tell.send(result);
        });
        self.wait()?;
        let lost = |error: String| {
            failed(format!("{} gave no picture back: {error}", self.name()), "run the command again")
        };
        match told.recv() {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(lost(error.to_string())),
            Err(error) => return Err(lost(error.to_string())),
        }
        let mapped = buffer.slice(..).get_mapped_range().map_err(|error| lost(error.to_string()))?;
        Ok(mapped.chunks(row as usize).flat_map(|line| &line[..4 * width as usize]).copied().collect())
    }
}

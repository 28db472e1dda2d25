//! The shader that one would write first, to compare speeds with: see [`rigel::shader::plain_source`].

use bytemuck::cast_slice;
use half::f16;
use rigel::parameter_map::ParameterMap;
use rigel::shader::{camera_numbers, plain_source};
use rigel::{Error, Result};
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindingResource, BufferDescriptor, BufferUsages,
    Extent3d, FilterMode, Origin3d, RenderPipeline, SamplerDescriptor, ShaderModuleDescriptor, ShaderSource,
    TextureDescriptor, TextureDimension, TextureFormat, TextureUsages, TextureView, TextureViewDescriptor,
    TextureViewDimension,
};

use crate::graphics::Graphics;
use crate::pipelines::pipeline;
use crate::scene::{PICTURE, View, pass};

/// A map of one model with every coefficient in a float texture that the device interpolates.
pub struct Plain {
    pipeline: RenderPipeline,
    group: BindGroup,
    uniform: wgpu::Buffer,
    surface: rigel::geometry::Surface,
    texels: rigel::geometry::Texels,
}

impl Plain {
    /// Brings a map of harmonics or of `phong` onto the device: half floats, or single ones where `is_single` says so and the
    /// device interpolates them. `filter` is between texels: [`FilterMode::Nearest`] is fast and shows squares.
    ///
    /// # Errors
    /// [`Error::Request`] for other models, and where the device does not interpolate single floats.
    pub fn new(graphics: &Graphics, map: &ParameterMap, is_single: bool, filter: FilterMode) -> Result<Self> {
        let model = map.models[0];
        let refused = |what: &str| Error::request(format!("{}: {what}", map.name()), "compare another model");
        let text = plain_source(&model).ok_or_else(|| refused("there is no plain shader for it"))?;
        if is_single && !graphics.device.features().contains(wgpu::Features::FLOAT32_FILTERABLE) {
            return Err(refused("the device does not interpolate single floats"));
        }
        let device = &graphics.device;
        let phong = !matches!(model, rigel::fit::Model::Harmonics { .. });
        let layers = if phong { 3 } else { model.parameter_count() / 3 };
        let size = Extent3d {
            width: map.texels.columns,
            height: map.texels.rows,
            depth_or_array_layers: layers as u32,
        };
        let texture = device.create_texture(&TextureDescriptor {
            label: None,
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: TextureDimension::D2,
            format: if is_single { TextureFormat::Rgba32Float } else { TextureFormat::Rgba16Float },
            usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
            view_formats: &[],
        });
        for layer in 0..layers {
            let cell = |texel: usize| {
                let p = &map.parameters[texel * map.stride()..];
                match (phong, layer) {
                    (true, 0) => [p[0], p[1], p[2], 0.0],
                    (true, 1) => [p[3], p[4], p[5], p[6]],
                    (true, _) => [p[7], p[8], p[9], 0.0],
                    _ => [p[3 * layer], p[3 * layer + 1], p[3 * layer + 2], 0.0],
                }
            };
            let cells: Vec<f32> = (0..map.texels.count()).flat_map(cell).collect();
            let halves: Vec<u16> = if is_single {
                vec![]
            } else {
                cells.iter().map(|value| f16::from_f32(*value).to_bits()).collect()
            };
            let bytes: &[u8] = if is_single { cast_slice(&cells) } else { cast_slice(&halves) };
            graphics.queue.write_texture(
                wgpu::TexelCopyTextureInfo {
                    origin: Origin3d { z: layer as u32, ..Origin3d::ZERO },
                    ..texture.as_image_copy()
                },
                bytes,
                wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(bytes.len() as u32 / size.height),
                    rows_per_image: None,
                },
                Extent3d { depth_or_array_layers: 1, ..size },
            );
        }
        let module = device.create_shader_module(ShaderModuleDescriptor {
            label: None,
            source: ShaderSource::Wgsl(text.into()),
        });
        let pipeline = pipeline(device, None, &module, "plain", PICTURE, None);
        let uniform = device.create_buffer(&BufferDescriptor {
            label: None,
            size: size_of::<[[f32; 4]; 10]>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let sampler = device.create_sampler(&SamplerDescriptor {
            mag_filter: filter,
            min_filter: filter,
            ..SamplerDescriptor::default()
        });
        let view = texture.create_view(&TextureViewDescriptor {
            dimension: Some(TextureViewDimension::D2Array),
            ..TextureViewDescriptor::default()
        });
        let group = device.create_bind_group(&BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[
                BindGroupEntry { binding: 0, resource: uniform.as_entire_binding() },
                BindGroupEntry { binding: 2, resource: BindingResource::TextureView(&view) },
                BindGroupEntry { binding: 4, resource: BindingResource::Sampler(&sampler) },
            ],
        });
        Ok(Self { pipeline, group, uniform, surface: map.surface, texels: map.texels })
    }

    /// Draws a view into `target`.
    pub fn draw(&self, graphics: &Graphics, view: &View, target: &TextureView) {
        let numbers = camera_numbers(&self.surface, self.texels, &view.lens, &view.pose, &view.look, 1.0, 0);
        graphics.queue.write_buffer(&self.uniform, 0, cast_slice(&numbers));
        let mut encoder = graphics.device.create_command_encoder(&Default::default());
        pass(&mut encoder, &self.pipeline, &self.group, target);
        graphics.queue.submit([encoder.finish()]);
    }
}

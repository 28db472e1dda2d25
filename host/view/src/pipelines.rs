//! The steps that a frame takes on the device.

use rigel::shader::{Stored, source};
use wgpu::{
    BindGroupLayout, BindGroupLayoutDescriptor, BindGroupLayoutEntry, BindingType, BlendState,
    BufferBindingType, ColorTargetState, ColorWrites, Device, FragmentState, MultisampleState,
    PipelineLayout, PipelineLayoutDescriptor, PrimitiveState, RenderPipeline, RenderPipelineDescriptor,
    SamplerBindingType, ShaderModule, ShaderModuleDescriptor, ShaderSource, ShaderStages, TextureFormat,
    TextureSampleType, TextureViewDimension, VertexState,
};

use crate::graphics::Graphics;

/// Radiance of every texel.
pub(crate) const SHADED: TextureFormat = TextureFormat::Rgba16Float;

/// One for each entry point of the shader.
pub(crate) struct Pipelines {
    pub layout: BindGroupLayout,
    pub by_pixel: RenderPipeline,
    pub shade_texel: RenderPipeline,
    pub halve: RenderPipeline,
    pub by_texel: RenderPipeline,
    pub floor: RenderPipeline,
}

impl Pipelines {
    /// For maps of these models, drawn into pictures of `format`.
    pub fn new(graphics: &Graphics, models: &[Stored], format: TextureFormat) -> Self {
        let device = &graphics.device;
        let module = device.create_shader_module(ShaderModuleDescriptor {
            label: Some("surface"),
            source: ShaderSource::Wgsl(source(models).into()),
        });
        let entry = |binding, ty| BindGroupLayoutEntry {
            binding,
            visibility: ShaderStages::VERTEX_FRAGMENT,
            ty,
            count: None,
        };
        let texture = |sample_type| BindingType::Texture {
            sample_type,
            view_dimension: TextureViewDimension::D2,
            multisampled: false,
        };
        let uniform = BindingType::Buffer {
            ty: BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let layout = device.create_bind_group_layout(&BindGroupLayoutDescriptor {
            label: None,
            entries: &[
                entry(0, uniform),
                entry(1, texture(TextureSampleType::Uint)),
                entry(2, texture(TextureSampleType::Uint)),
                entry(3, texture(TextureSampleType::Float { filterable: true })),
                entry(4, BindingType::Sampler(SamplerBindingType::Filtering)),
            ],
        });
        let pipeline_layout = device.create_pipeline_layout(&PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline =
            |fragment, format| pipeline(device, Some(&pipeline_layout), &module, fragment, format, None);
        Self {
            by_pixel: pipeline("by_pixel", format),
            shade_texel: pipeline("shade_texel", SHADED),
            halve: pipeline("halve", SHADED),
            by_texel: pipeline("by_texel", format),
            floor: pipeline("floor_before", format),
            layout,
        }
    }
}

/// What draws the whole target with an entry point of a shader.
pub(crate) fn pipeline(
    device: &Device,
    layout: Option<&PipelineLayout>,
    module: &ShaderModule,
    fragment: &str,
    format: TextureFormat,
    blend: Option<BlendState>,
) -> RenderPipeline {
    device.create_render_pipeline(&RenderPipelineDescriptor {
        label: Some(fragment),
        layout,
        vertex: VertexState {
            module,
            entry_point: Some("everywhere"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: PrimitiveState::default(),
        depth_stencil: None,
        multisample: MultisampleState::default(),
        fragment: Some(FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: Default::default(),
            targets: &[Some(ColorTargetState { format, blend, write_mask: ColorWrites::ALL })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

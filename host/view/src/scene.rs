//! A parameter map on the device.

use bytemuck::cast_slice;
use glam::{DVec3, UVec2, Vec2};
use half::f16;
use rigel::emitter::Floor;
use rigel::geometry::{Lens, Pose, Surface, Texels};
use rigel::parameter_map::ParameterMap;
use rigel::shader::{Look, Packed, SMOOTH, camera_numbers, sharpness};
use rigel::{Error, Result};
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindingResource, BufferDescriptor, BufferUsages, Color,
    CommandEncoder, CommandEncoderDescriptor, FilterMode, LoadOp, MipmapFilterMode, Operations,
    RenderPassColorAttachment, RenderPassDescriptor, RenderPipeline, Sampler, SamplerDescriptor, StoreOp,
    TextureFormat, TextureUsages, TextureView, TextureViewDescriptor,
};

use crate::graphics::Graphics;
use crate::pipelines::{Pipelines, SHADED};

/// The format of pictures that are read back.
pub const PICTURE: TextureFormat = TextureFormat::Rgba8Unorm;

/// Where models are evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shading {
    /// At every pixel, four texels each: exact.
    ByPixel,
    /// Once for each texel, from its centre: faster, filtered where a pixel covers many texels, and indistinguishable where texels
    /// are small beside the sharpest highlight.
    ByTexel,
    /// By texel where that is indistinguishable, and not more work or needed because a pixel covers many texels; else by pixel.
    #[default]
    Automatic,
}

/// What is to be seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Lens and size of the picture.
    pub lens: Lens,
    /// Where the camera stands.
    pub pose: Pose,
    /// How radiance becomes a picture.
    pub look: Look,
    /// Where models are evaluated.
    pub shading: Shading,
    /// How often the texels are halved in number along each side: the radiance of 2 x 2 becomes one. Anything but 0 is shaded by
    /// texel.
    pub halvings: u32,
}

impl View {
    /// Where a point of the surface's frame (metres) is seen, in pixels from the picture's top-left corner; `None` beside the picture.
    pub fn place_of(&self, point_m: DVec3) -> Option<Vec2> {
        let place = (self.lens.project(self.pose.to_camera(point_m))? + 0.5).as_vec2();
        let size = UVec2::new(self.lens.width, self.lens.height).as_vec2();
        (place.cmpge(Vec2::ZERO) & place.cmple(size)).all().then_some(place)
    }
}

/// A floor that the map lights: what draws it, its width and its depth in metres.
type LitFloor = (BindGroup, [f32; 2]);

/// A parameter map on the device, ready to be drawn.
pub struct Scene {
    surface: Surface,
    texels: Texels,
    scale: f32,
    format: TextureFormat,
    /// See [`sharpness()`].
    sharpness: f64,
    pipelines: Pipelines,
    uniform: wgpu::Buffer,
    /// To shade texels: without the texture that this fills.
    shade: BindGroup,
    draw: BindGroup,
    levels: Vec<TextureView>,
    /// To make each level but the first from the one before.
    halve: Vec<BindGroup>,
    places: TextureView,
    coefficients: TextureView,
    sampler: Sampler,
    floor: Option<LitFloor>,
}

impl Scene {
    /// Brings a map onto the device, for pictures of `format`.
    ///
    /// # Errors
    /// [`Error::Request`] when it is larger than a texture of the device can be.
    pub fn new(graphics: &Graphics, map: &ParameterMap, format: TextureFormat) -> Result<Self> {
        let mut packed = Packed::new(map)?;
        let (columns, rows) = (map.texels.columns, map.texels.rows);
        graphics.require_size("the texels", columns, rows)?;
        let coefficient_rows = packed.rows();
        graphics.require_size("the coefficients", Packed::ROW as u32, coefficient_rows as u32)?;
        packed.coefficients.resize(coefficient_rows * Packed::ROW, [0; 4]);
        let places = graphics.filled((columns, rows), TextureFormat::R32Uint, cast_slice(&packed.places));
        let coefficients = graphics.filled(
            (Packed::ROW as u32, coefficient_rows as u32),
            TextureFormat::Rgba32Uint,
            cast_slice(&packed.coefficients),
        );
        let count = most_halvings(map.texels) + 1;
        let usage = TextureUsages::TEXTURE_BINDING | TextureUsages::RENDER_ATTACHMENT;
        let shaded = graphics.texture((columns, rows), count, SHADED, usage);
        let level = |level| {
            shaded.create_view(&TextureViewDescriptor {
                base_mip_level: level,
                mip_level_count: Some(1),
                ..TextureViewDescriptor::default()
            })
        };
        let levels: Vec<TextureView> = (0..count).map(level).collect();
        let nothing = graphics.texture((1, 1), 1, SHADED, TextureUsages::TEXTURE_BINDING);
        let uniform = graphics.device.create_buffer(&BufferDescriptor {
            label: None,
            size: size_of::<[[f32; 4]; 10]>() as u64,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let sampler = graphics.device.create_sampler(&SamplerDescriptor {
            mag_filter: FilterMode::Linear,
            min_filter: FilterMode::Linear,
            mipmap_filter: MipmapFilterMode::Linear,
            ..SamplerDescriptor::default()
        });
        let pipelines = Pipelines::new(graphics, &packed.models, format);
        let group = |shaded: &TextureView| {
            bind(graphics, &pipelines, (&uniform, &sampler), [&places, &coefficients, shaded])
        };
        Ok(Self {
            surface: map.surface,
            texels: map.texels,
            scale: packed.scale,
            format,
            sharpness: sharpness(map),
            shade: group(&nothing.create_view(&Default::default())),
            draw: group(&shaded.create_view(&Default::default())),
            halve: levels[..levels.len() - 1].iter().map(group).collect(),
            pipelines,
            uniform,
            levels,
            places,
            coefficients,
            sampler,
            floor: None,
        })
    }

    /// Shows, from now on, a floor before the map that the map lights; or none.
    pub fn set_floor(&mut self, graphics: &Graphics, floor: Option<&Floor>) {
        self.floor = floor.map(|floor| {
            let halves = |radiance: &[f32; 3]| {
                let [r, g, b] = radiance.map(|value| f16::from_f32(value.min(f16::MAX.to_f32())).to_bits());
                [r, g, b, f16::ONE.to_bits()]
            };
            let texels: Vec<[u16; 4]> = floor.radiance.iter().map(halves).collect();
            let size = (floor.points.0 as u32, floor.points.1 as u32);
            let radiance = graphics.filled(size, SHADED, cast_slice(&texels));
            let textures = [&self.places, &self.coefficients, &radiance];
            let group = bind(graphics, &self.pipelines, (&self.uniform, &self.sampler), textures);
            (group, [floor.width_m as f32, floor.depth_m as f32])
        });
    }

    /// Whether pictures come with blue first.
    fn is_blue_first(&self) -> bool {
        matches!(self.format, TextureFormat::Bgra8Unorm | TextureFormat::Bgra8UnormSrgb)
    }

    /// Whether texels are shaded one by one in this view.
    pub fn is_by_texel(&self, view: &View) -> bool {
        match view.shading {
            _ if view.halvings > 0 => true,
            Shading::ByPixel => false,
            Shading::ByTexel => true,
            Shading::Automatic => {
                let size_m = (self.surface.width_m / f64::from(self.texels.columns))
                    .max(self.surface.height_m / f64::from(self.texels.rows));
                let nearest_m = view.pose.centre_m.z.max(1e-9);
                let pixels = f64::from(view.lens.width) * f64::from(view.lens.height);
                size_m / nearest_m * self.sharpness.sqrt() <= SMOOTH
                    && (self.averages(view) > 0 || self.texels.count() as f64 <= 4.0 * pixels)
            }
        }
    }

    /// How many averages are needed where a pixel covers many texels.
    fn averages(&self, view: &View) -> u32 {
        let (width_m, height_m) = (self.surface.width_m, self.surface.height_m);
        let corner = |x: f64, y: f64| {
            view.pose.to_camera(glam::DVec3::new(x * width_m / 2.0, y * height_m / 2.0, 0.0)).z
        };
        let farthest_m = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)].map(|(x, y)| corner(x, y));
        let farthest_m = farthest_m.into_iter().fold(0.0, f64::max);
        let texel_m = (width_m / f64::from(self.texels.columns)).min(height_m / f64::from(self.texels.rows));
        let covered = farthest_m / view.lens.fx.min(view.lens.fy) / texel_m;
        let level = (covered.max(1e-9).log2() - 1.0).ceil().max(0.0) as u32;
        level.min(most_halvings(self.texels))
    }

    /// Draws a view into `target`.
    pub fn draw(&self, graphics: &Graphics, view: &View, target: &TextureView) {
        self.draw_with(graphics, view, target, self.floor.as_ref());
    }

    fn draw_with(&self, graphics: &Graphics, view: &View, target: &TextureView, floor: Option<&LitFloor>) {
        let is_by_texel = self.is_by_texel(view);
        let halvings = view.halvings.min(most_halvings(self.texels));
        let averages = if is_by_texel { self.averages(view).max(halvings) } else { 0 };
        let mut numbers = camera_numbers(
            &self.surface,
            self.texels,
            &view.lens,
            &view.pose,
            &view.look,
            self.scale,
            averages,
        );
        numbers[9][2] = halvings as f32;
        if let Some((_, [width_m, depth_m])) = floor {
            (numbers[0][3], numbers[1][3]) = (*width_m, *depth_m);
        }
        graphics.queue.write_buffer(&self.uniform, 0, cast_slice(&numbers));
        let mut encoder = graphics.device.create_command_encoder(&CommandEncoderDescriptor::default());
        if is_by_texel {
            pass(&mut encoder, &self.pipelines.shade_texel, &self.shade, &self.levels[0]);
            for level in 0..averages as usize {
                pass(&mut encoder, &self.pipelines.halve, &self.halve[level], &self.levels[level + 1]);
            }
        }
        let pipeline = if is_by_texel { &self.pipelines.by_texel } else { &self.pipelines.by_pixel };
        pass(&mut encoder, pipeline, if is_by_texel { &self.draw } else { &self.shade }, target);
        if let Some((floor, _)) = floor {
            pass_over(&mut encoder, &self.pipelines.floor, floor, target);
        }
        graphics.queue.submit([encoder.finish()]);
    }

    /// A view as a picture: RGB levels, row by row from the top.
    ///
    /// # Errors
    /// [`Error::Request`] when the picture is empty or too large or `gamma` is not positive, [`Error::Device`] when the device
    /// was lost.
    pub fn picture(&self, graphics: &Graphics, view: &View) -> Result<Vec<[u8; 3]>> {
        self.picture_with(graphics, view, self.floor.as_ref())
    }

    /// The same without a floor.
    ///
    /// # Errors
    /// As [`Scene::picture`].
    pub fn map_alone(&self, graphics: &Graphics, view: &View) -> Result<Vec<[u8; 3]>> {
        self.picture_with(graphics, view, None)
    }

    fn picture_with(
        &self,
        graphics: &Graphics,
        view: &View,
        floor: Option<&LitFloor>,
    ) -> Result<Vec<[u8; 3]>> {
        let (width, height) = (view.lens.width, view.lens.height);
        if width == 0 || height == 0 || !view.look.gamma.is_finite() || view.look.gamma <= 0.0 {
            return Err(Error::request(
                format!(
                    "a picture of {width}x{height} pixels with gamma = {} cannot be drawn",
                    view.look.gamma
                ),
                "give at least one pixel and a positive gamma",
            ));
        }
        graphics.require_size("the pixels of the picture", width, height)?;
        let usage = TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC;
        let target = graphics.texture((width, height), 1, self.format, usage);
        self.draw_with(graphics, view, &target.create_view(&Default::default()), floor);
        let order = if self.is_blue_first() { [2, 1, 0] } else { [0, 1, 2] };
        Ok(graphics.read(&target)?.chunks_exact(4).map(|pixel| order.map(|c| pixel[c])).collect())
    }
}

/// How often texels can be halved in number along each side.
pub(crate) fn most_halvings(texels: Texels) -> u32 {
    texels.columns.max(texels.rows).max(1).ilog2()
}

fn bind(
    graphics: &Graphics,
    pipelines: &Pipelines,
    (uniform, sampler): (&wgpu::Buffer, &Sampler),
    [places, coefficients, shaded]: [&TextureView; 3],
) -> BindGroup {
    let view = |binding, view| BindGroupEntry { binding, resource: BindingResource::TextureView(view) };
    graphics.device.create_bind_group(&BindGroupDescriptor {
        label: None,
        layout: &pipelines.layout,
        entries: &[
            BindGroupEntry { binding: 0, resource: uniform.as_entire_binding() },
            view(1, places),
            view(2, coefficients),
            view(3, shaded),
            BindGroupEntry { binding: 4, resource: BindingResource::Sampler(sampler) },
        ],
    })
}

/// Draws everywhere.
pub(crate) fn pass(
    encoder: &mut CommandEncoder,
    pipeline: &RenderPipeline,
    group: &BindGroup,
    target: &TextureView,
) {
    draw(encoder, (pipeline, group), target, LoadOp::Clear(Color::BLACK));
}

/// Draws over what is there.
pub(crate) fn pass_over(
    encoder: &mut CommandEncoder,
    pipeline: &RenderPipeline,
    group: &BindGroup,
    target: &TextureView,
) {
    draw(encoder, (pipeline, group), target, LoadOp::Load);
}

fn draw(
    encoder: &mut CommandEncoder,
    (pipeline, group): (&RenderPipeline, &BindGroup),
    target: &TextureView,
    load: LoadOp<Color>,
) {
    let mut pass = encoder.begin_render_pass(&RenderPassDescriptor {
        color_attachments: &[Some(RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: Operations { load, store: StoreOp::Store },
        })],
        ..RenderPassDescriptor::default()
    });
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, group, &[]);
    pass.draw(0..3, 0..1);
}
